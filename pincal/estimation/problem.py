"""The conditions of all poses at a state: residual blocks of legs and of measurements, stacked.

        legs:         e(x, ψ; φ) = 0      noise of the readings ψ
        instruments:  h(x; φ) − m = 0     noise of what was measured, m

Poses are unknowns, of which any part or none was measured; or they are taken as measured, and
their noise enters the legs' conditions (the papers' divide and conquer). Nothing else differs:
in the latter the columns of the pose are multiplied by its noise and join S.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pincal.estimation.blocks.legs import LegBlock
from pincal.estimation.blocks.observation import Observation
from pincal.estimation.linear import Entry, Linear, State
from pincal.model.leg import Leg
from pincal.model.platform import Platform
from pincal.types import Array, Index


@dataclass(frozen=True)
class Problem:
    """Residual blocks at N poses: of legs, and of what was measured where poses are unknowns."""

    leg_block: LegBlock
    """The legs, their readings and the noise of these."""
    observation: Observation
    """What was measured of the platform, its noise, and what is unknown outside the mechanism."""
    first: State | None = None
    """Where the search starts."""

    @property
    def legs(self) -> tuple[Leg, ...]:
        """Legs whose parameters are identified, in order."""
        return self.leg_block.legs

    @property
    def platform(self) -> Platform:
        """The platform."""
        return self.leg_block.platform

    @property
    def latent(self) -> bool:
        """Whether poses are unknowns."""
        return self.leg_block.pose_roots is None

    @property
    def weighted(self) -> bool:
        """Whether white residuals are minimised, or, as the papers have it, plain joint ones."""
        return self.leg_block.kind == "closure"

    @property
    def blocks(self) -> tuple[LegBlock] | tuple[LegBlock, Observation]:
        """Residual blocks whose rows stand below each other."""
        return (self.leg_block, self.observation) if self.latent else (self.leg_block,)

    @cached_property
    def quantities(self) -> dict[str, str]:
        """Names of what the columns of the noise belong to, each with its unit, m or rad."""
        return {name: unit for block in self.blocks for name, unit in block.quantities.items()}

    @cached_property
    def equations(self) -> Index:
        """How many equations each pose gives, poses eliminated, shape (N,)."""
        rows = sum(block.active.sum(axis=1) for block in self.blocks)
        return np.asarray(rows - self.platform.dof * self.latent)

    def at(self, rows: Index) -> Problem:
        """Return the problem of some poses."""
        first = None if self.first is None else self.first.rows(rows)
        return Problem(self.leg_block.at(rows), self.observation.at(rows), first)

    def thinned(self, linear: Linear, max_poses: int = 2000) -> tuple[Problem, Linear, Index]:
        """Return the problem and its conditions at some poses, spread over all; and which.

        Both as they are where there are no more.

        Args:
            linear: The conditions of all poses.
            max_poses: Number of poses; enough to judge by, if not given.
        """
        rows = spread(len(linear.conditions), max_poses)
        if len(rows) == len(linear.conditions):
            return self, linear, rows
        part = self.at(rows)
        return part, part.evaluate(linear.state.rows(rows)), rows

    def start(self, parameters: Array) -> State:
        """Return the state from which the search starts, at parameters of the legs."""
        if self.first is None:
            raise TypeError("the poses have no start yet")
        return replace(self.first, parameters=parameters)

    def evaluate(self, state: State) -> Linear:
        """Return the conditions at a state: rows of the blocks below each other.

            ┌ e ┐   ┌ legs ┐    A = ┌ leg 1             ┐    S = ┌ readings          ┐
            └   ┘   └ seen ┘        │        leg 2      │        └           seen    ┘
                                    └             frame ┘

        Raises:
            MeasurementError: a residual that does not exist.
        """
        legs = self.leg_block.evaluate(state)
        state = replace(state, joints=legs.joints)
        parts = [legs, *(block.evaluate(state) for block in self.blocks[1:])]
        entries: list[Entry] = []
        first_row = first_column = 0
        for part in parts:
            entries += [
                (_shifted(rows, first_row), _shifted(columns, first_column), values)
                for rows, columns, values in part.by_parameter
            ]
            first_row += part.value.shape[1]
            first_column = self.leg_block.n_parameters
        return Linear(
            state=state,
            demands=legs.demands,
            follow=legs.follow,
            conditions=np.concatenate([part.value for part in parts], axis=1),
            entries=tuple(entries),
            by_pose=np.concatenate([part.by_pose for part in parts], axis=1),
            noise_root=_side_by_side([part.noise_root for part in parts]),
            active=np.concatenate([block.active for block in self.blocks], axis=1),
            equations=self.equations,
        )

    def renoised(self, linear: Linear) -> Linear:
        """Return what another problem's conditions are with the noise of this one."""
        roots = [self.leg_block.noise_root(linear.demands)]
        if self.latent:
            roots.append(self.observation.noise_root(linear.state))
        return replace(linear, noise_root=_side_by_side(roots))

    def moved(self, linear: Linear, step: Array) -> State:
        """Return the state after a step of all unknowns, shape (n,), the poses following."""
        state, n = linear.state, self.leg_block.n_parameters
        external = self.observation.external.moved(state.external, step[n:])
        parameters = state.parameters + step[:n]
        matrices, twists = state.matrices, np.zeros((len(state.matrices), self.platform.dof))
        if self.latent:
            twists = linear.white.pose_step(linear.after(step))
            carried = self.leg_block.carried(linear.demands, step, twists, parameters)
            matrices = self.platform.displaced(matrices, twists) if carried is None else carried
        return State(parameters, matrices, linear.follow(step, twists), external)


def spread(count: int, max_rows: int) -> Index:
    """Return at most so many of rows 0 … count - 1, evenly spread."""
    return np.arange(0, count, -(-count // max_rows))


def _shifted(places: slice, offset: int) -> slice:
    return slice(places.start + offset, places.stop + offset)


def _side_by_side(roots: list[Array]) -> Array:
    """Return roots of the noise of blocks, (N, k, s) each, in one that has all rows and columns."""
    rows, columns = (np.cumsum([0, *(root.shape[axis] for root in roots)]) for axis in (1, 2))
    noise = np.zeros((len(roots[0]), rows[-1], columns[-1]))
    for root, row, column in zip(roots, rows, columns, strict=False):
        noise[:, row : row + root.shape[1], column : column + root.shape[2]] = root
    return noise
