"""The conditions of all poses at a state: residual blocks of legs and of measurements, stacked.

        legs:         e(x, ψ; φ) = 0      noise of the readings ψ
        instruments:  h(x; φ) − m = 0     noise of what was measured, m

Poses are unknowns, measured in full, in part or not at all; or they are taken as measured, and
their noise enters the legs' conditions (the papers' divide and conquer). Nothing else differs: in
the second case the columns of the pose are multiplied by its noise and join S.

The residual of a leg is Nᵀ c at a pose and a reading, with the passive joints that minimise |c|:
for a planar dyad, the platform point's distance from the elbow less L. It exists out of reach and
stays finite near type-1 singularities.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pincal.estimation.observation import Observation
from pincal.estimation.rows import WhiteRows, split_rows, white_rows
from pincal.estimation.unknowns import BlockRows, State
from pincal.kinematics.batches import block_diagonal
from pincal.kinematics.closure import LegClosure
from pincal.kinematics.derivatives import leg_demands_at
from pincal.model import Leg, Platform
from pincal.types import Array, Index, Mask

_MANY = 2  # rows with independent noise over freedoms of a pose, above which they are turned


@dataclass(frozen=True)
class LegBlock:
    """Residuals of some legs at N rows of measured readings."""

    legs: tuple[Leg, ...]
    """The nominal legs."""
    platform: Platform
    readings: Array
    """Measured readings of all legs, shape (N, n_readings), [rad] or [m]."""
    influences: Mapping[str, Array]
    """Influence quantities (temperature, load) that terms of the legs depend on, (N,) each."""
    data_rows: Index
    """Rows of the measurements, counted from 0, shape (N,)."""
    used: Mask
    """Which rows are used for which leg, shape (N, n_legs)."""
    sigma: Array
    """Standard deviations of the readings of all legs, shape (N, n_readings), [rad] or [m]."""
    pose_roots: Array | None = None
    """Roots of the covariance of measured poses, as twists in base axes, shape (N, dof, dof); None
    if poses are unknowns."""

    @cached_property
    def widths(self) -> list[int]:
        """Number of equations that each leg gives at a pose."""
        return [self.platform.equations(leg) for leg in self.legs]

    @cached_property
    def leg_rows(self) -> list[slice]:
        """Rows of each leg among the equations of a pose."""
        return _slices(self.widths)

    @cached_property
    def columns(self) -> list[slice]:
        """Columns of each leg's parameters among the unknowns."""
        return _slices([len(leg.parameters) for leg in self.legs])

    @cached_property
    def reading_columns(self) -> list[slice]:
        """Columns of each leg's readings among all readings."""
        return _slices([len(leg.sensors) for leg in self.legs])

    @property
    def n_rows(self) -> int:
        """Number of equations of all legs at a pose."""
        return self.leg_rows[-1].stop

    @property
    def n_parameters(self) -> int:
        """Number of parameters of all legs."""
        return self.columns[-1].stop

    @property
    def n_readings(self) -> int:
        """Number of readings of all legs."""
        return self.reading_columns[-1].stop

    @cached_property
    def active(self) -> Mask:
        """Which equations are used at each pose, shape (N, n_rows)."""
        return np.repeat(self.used, self.widths, axis=1)

    @cached_property
    def known(self) -> list[Array]:
        """Readings of each leg and its influences, shape (N, n_active [+ n_influences])."""
        influences = [leg.influences for leg in self.legs]
        return [
            np.column_stack([self.readings[:, columns], *(self.influences[name] for name in names)])
            for columns, names in zip(self.reading_columns, influences, strict=True)
        ]

    @cached_property
    def quantities(self) -> dict[str, str]:
        """Names and units (m or rad) of the quantities whose noise the columns of S are."""
        names = {
            f"reading of {name}" if len(leg.sensors) == 1 else f"reading {name}": unit
            for leg in self.legs
            for name, unit in zip(leg.reading_names, leg.reading_units, strict=True)
        }
        if self.pose_roots is None:
            return names
        platform = zip(self.platform.freedoms, self.platform.units, strict=True)
        return names | {f"measured {name}": unit for name, unit in platform}

    def evaluate(self, state: State) -> BlockRows:
        """Return the residuals of the legs, passive joints at best closure; zero where unused."""
        pairs = zip(self.legs, self.columns, strict=True)
        closures = [LegClosure(leg, self.platform, state.parameters[c]) for leg, c in pairs]
        placed, serves = [state.matrices] * len(closures), self.active[:, :, None]
        of_legs = leg_demands_at(closures, placed, self.known, near=state.joints)
        return BlockRows(
            np.where(self.active, np.concatenate([d.value for d in of_legs], axis=1), 0.0),
            np.where(serves, np.concatenate([d.pose for d in of_legs], axis=1), 0.0),
            np.where(serves, block_diagonal([d.parameter for d in of_legs]), 0.0),
            block_diagonal([d.reading for d in of_legs]),
            tuple(demand.joints for demand in of_legs),
        )


def _slices(sizes: Sequence[int]) -> list[slice]:
    """Return consecutive slices of the given sizes."""
    ends = np.cumsum(sizes).tolist()
    return [slice(end - size, end) for size, end in zip(sizes, ends, strict=True)]


@dataclass(frozen=True)
class Linear:
    """Conditions of all blocks at a state, linearised, whitened and with poses eliminated."""

    problem: Problem
    state: State
    """Values of the unknowns, and joints at best closure."""
    conditions: Array
    """Residuals e of all blocks, shape (N, k), [m] and [rad]."""
    by_parameter: Array
    """A: derivatives by all parameters and external unknowns, shape (N, k, n)."""
    by_pose: Array
    """B: derivatives by the platform's twist, shape (N, k, dof)."""
    by_measured: Array
    """Derivatives of the legs' rows by readings, shape (N, k of legs, n_readings)."""

    @property
    def equations(self) -> Index:
        """Number of equations of each pose after its elimination, shape (N,)."""
        return self.problem.equations

    @property
    def by_reading(self) -> Array:
        """Derivatives of all rows by readings, zero where unused, shape (N, k, n_readings)."""
        active, (count, n_legs, n) = self.problem.active, self.by_measured.shape
        rest = np.zeros((count, active.shape[1] - n_legs, n))
        return np.where(active[:, :, None], np.concatenate((self.by_measured, rest), axis=1), 0.0)

    @cached_property
    def reading_root(self) -> Array:
        """Root of the readings' noise in the legs' rows, shape (N, k of legs, n_readings)."""
        legs = self.problem.leg_block
        return np.where(legs.active[:, :, None], self.by_measured * legs.sigma[:, None], 0.0)

    @cached_property
    def noise_root(self) -> Array:
        """S: root of the noise of readings and of measurements of the platform, (N, k, s).

        Where poses are taken as measured, their noise enters the legs' rows.
        """
        return self._noise_of(None)

    def _noise_of(self, quantities: Index | None) -> Array:
        """Return the root of the noise of the legs and of some (None: all) measured quantities."""
        roots = self.problem.leg_block.pose_roots
        if roots is not None:
            return np.concatenate((self.reading_root, self.by_pose @ roots), axis=2)
        observed = self.problem.observation.noise_root(quantities)
        return block_diagonal((self.reading_root, observed))

    def after(self, step: Array) -> Array:
        """Return the conditions to first order after a step (n,) of the unknowns, (N, k)."""
        return self.conditions + self.by_parameter @ step

    def moved(self, step: Array) -> State:
        """Return the state after a step (n,) of the unknowns, poses moved to first order."""
        state, matrices = self.state, self.state.matrices
        legs, external = self.problem.leg_block, self.problem.observation.external
        if self.problem.latent:
            matrices = legs.platform.displaced(matrices, self.white.pose_step(self.after(step)))
        parameters, outside = np.split(step, [legs.n_parameters])
        moved = external.moved(state.external, outside)
        return State(state.parameters + parameters, matrices, state.joints, moved)

    def with_poses(self, places: Mask, elsewhere: Linear) -> Linear:
        """Return conditions that at masked poses (N,) are those of ``elsewhere``."""

        def chosen(old: Array, new: Array) -> Array:
            return np.where(places.reshape(-1, *[1] * (old.ndim - 1)), new, old)

        matrices = chosen(self.state.matrices, elsewhere.state.matrices)
        joints = tuple(map(chosen, self.state.joints, elsewhere.state.joints))
        return replace(
            self,
            state=replace(self.state, matrices=matrices, joints=joints),
            conditions=chosen(self.conditions, elsewhere.conditions),
            by_parameter=chosen(self.by_parameter, elsewhere.by_parameter),
            by_pose=chosen(self.by_pose, elsewhere.by_pose),
            by_measured=chosen(self.by_measured, elsewhere.by_measured),
        )

    @cached_property
    def white(self) -> WhiteRows:
        """The map that eliminates the poses and whitens the rows.

        Rows without a measurement get independent noise, so that they carry no information.
        """
        problem, n_rows = self.problem, self.problem.leg_block.n_rows
        dof, width = self.by_pose.shape[2] * problem.latent, self.by_measured.shape[2]
        single = np.flatnonzero(problem.observation.single * problem.latent)
        splits = len(single) > _MANY * self.by_pose.shape[2]
        joint = np.setdiff1d(np.arange(len(problem.observation.units)), single)
        quantities = joint if splits else None
        noise, rows = self._noise_of(quantities), np.arange(self.conditions.shape[1])
        if splits:
            rows = np.append(np.arange(n_rows), n_rows + joint)
        idle = ~problem.active[:, rows]
        if idle.any():
            size = float(np.median(np.abs(noise[noise != 0.0]))) if noise.any() else 1.0
            idle_noise = np.where(idle[:, :, None], size * np.eye(idle.shape[1]), 0.0)
            noise = np.concatenate((noise, idle_noise[:, :, idle.any(axis=0)]), axis=2)
        if not splits:
            return white_rows(self.by_pose[:, :, :dof], noise)
        observation, count = problem.observation, width + len(joint)
        further = width + len(observation.units) + np.arange(noise.shape[2] - count)
        columns = np.concatenate((np.arange(width), width + joint, further))
        sigma = np.where(observation.measured[:, single], observation.sigma[:, single], 1.0)
        places = (rows, n_rows + single), (columns, width + single)
        return split_rows(self.by_pose, noise, sigma, *places)

    def whitened(self, conditions: Array) -> Array:
        """Return conditions (N, k), such as those of another state, as white rows, (N, m)."""
        return self.white(conditions[:, :, None])[:, :, 0]

    @cached_property
    def residuals(self) -> Array:
        """Residuals in standard deviations, poses eliminated, shape (N, m)."""
        return self.whitened(self.conditions)

    @property
    def jacobian(self) -> Array:
        """Derivatives of the residuals, shape (N, m, n); not cached, as it is large."""
        return self.white(self.by_parameter)

    @cached_property
    def triangle(self) -> Array:
        """R of J = Q R over all poses, shape (n, n)."""
        rows = self.jacobian.reshape(-1, self.by_parameter.shape[2])
        return np.asarray(np.linalg.qr(rows, mode="r"))

    @property
    def squares(self) -> Array:
        """Sum of the squared residuals of each pose in standard deviations, shape (N,)."""
        return np.einsum("nm,nm->n", self.residuals, self.residuals)

    @cached_property
    def noise(self) -> Array:
        """The least noise that explains the conditions, in standard deviations, shape (N, s)."""
        return -(self.white.by_noise.transpose(0, 2, 1) @ self.residuals[:, :, None])[:, :, 0]

    @cached_property
    def noise_by_parameter(self) -> Array:
        """Derivative of ``noise``, (N, s, n); unlike white rows, in the same basis everywhere."""
        return -(self.white.by_noise.transpose(0, 2, 1) @ self.jacobian)


@dataclass(frozen=True)
class Problem:
    """Residual blocks at N poses: the legs, and where poses are unknowns the measurements."""

    leg_block: LegBlock
    """The legs with their readings and the readings' noise."""
    observation: Observation
    """Measurements of the platform, their noise, and the unknowns outside the mechanism."""
    first: State | None = None
    """Where the search starts."""

    @property
    def legs(self) -> tuple[Leg, ...]:
        """Legs whose parameters are identified."""
        return self.leg_block.legs

    @property
    def size(self) -> float:
        """Length of the longest stretched leg, [m]."""
        return max(leg.size for leg in self.legs)

    @property
    def platform(self) -> Platform:
        """The platform."""
        return self.leg_block.platform

    @property
    def latent(self) -> bool:
        """Whether poses are unknowns."""
        return self.leg_block.pose_roots is None

    @property
    def blocks(self) -> tuple[LegBlock] | tuple[LegBlock, Observation]:
        """Residual blocks whose rows are stacked."""
        return (self.leg_block, self.observation) if self.latent else (self.leg_block,)

    @cached_property
    def quantities(self) -> dict[str, str]:
        """Names and units (m or rad) of the quantities whose noise the columns of S are."""
        return {name: unit for block in self.blocks for name, unit in block.quantities.items()}

    @property
    def units(self) -> list[str]:
        """Units of the conditions at a pose, m or rad."""
        return [*["m"] * self.leg_block.n_rows, *self.observation.units * self.latent]

    @cached_property
    def equations(self) -> Index:
        """Number of equations of each pose after its elimination, shape (N,)."""
        return np.asarray(self.active.sum(axis=1) - self.platform.dof * self.latent)

    @cached_property
    def active(self) -> Mask:
        """Which rows have a measurement, shape (N, k)."""
        return np.concatenate([block.active for block in self.blocks], axis=1)

    def start(self, parameters: Array) -> State:
        """Return the start of the search with parameters (n,), those of the legs first."""
        if self.first is None:
            raise TypeError("the poses have no start yet")
        return replace(self.first, parameters=parameters[: self.leg_block.n_parameters])

    def values(self, state: State) -> Array:
        """Return the values of all unknowns except poses, shape (n,)."""
        external = self.observation.external.coordinates(state.external)
        return np.concatenate((state.parameters, external))

    def evaluate(self, state: State) -> Linear:
        """Return the linearised conditions at a state: the stacked rows of the blocks.

        ┌ e ┐   ┌ legs ┐    A = ┌ leg 1             ┐    B = ┌ legs ┐
        └   ┘   └ seen ┘        │        leg 2      │        └ seen ┘
                                └             frame ┘
        """
        legs = self.leg_block.evaluate(state)
        state = replace(state, joints=legs.joints)
        parts = [legs, *(block.evaluate(state) for block in self.blocks[1:])]
        return Linear(
            problem=self,
            state=state,
            conditions=np.concatenate([part.value for part in parts], axis=1),
            by_parameter=block_diagonal([part.by_parameter for part in parts]),
            by_pose=np.concatenate([part.by_pose for part in parts], axis=1),
            by_measured=legs.by_measured,
        )
