"""The conditions of all poses at a state: what the legs demand, and what was measured, stacked.

        legs:         e(x, ψ; φ) = 0      noise of the readings ψ
        instruments:  h(x; φ) − m = 0     noise of what was measured, m

Poses are unknowns, of which any part or none was measured; or they are taken as measured, and
their noise enters the legs' conditions (the papers' divide and conquer). Nothing else differs:
in the latter the columns of the pose are multiplied by its noise and join S.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pincal.errors import MeasurementError
from pincal.estimation.blocks.alike_legs import all_met
from pincal.estimation.blocks.covariances import RowNoise
from pincal.estimation.blocks.leg_condition import LegCondition
from pincal.estimation.blocks.observation import Observation
from pincal.estimation.linear import Block, Linear, Stack, State
from pincal.estimation.rows import NoNoiseError, white_rows
from pincal.kinematics.closing import grouped
from pincal.kinematics.closure import LegClosure
from pincal.kinematics.derivatives import Demand
from pincal.kinematics.nearest_closure import arm_poses
from pincal.model.leg import Leg
from pincal.model.platform import Platform
from pincal.types import Array, Index, Mask

NO_NOISE = (
    "some measurements carry no noise at all; give standard deviations above zero for what is "
    "measured, and for readings (--noise-reading) where there are more of them than freedoms"
)


@dataclass(frozen=True)
class Problem:
    """Conditions of some legs and of what was measured at N poses."""

    conditions: tuple[LegCondition, ...]
    """One for each leg."""
    used: Mask
    """Which row serves which leg, shape (N, n_legs)."""
    observation: Observation
    """What was measured of the platform, and what is unknown outside the mechanism."""
    sigma_observed: Array
    """Standard deviations of that, shape (N, r)."""
    sigma_readings: Array
    """Standard deviations of the readings, shape (N, n_readings)."""
    correlation: Array | None = None
    """Symmetric roots of the correlations of what was observed, shape (N, r, r), if there are."""
    pose_roots: Array | None = None
    """If poses are taken as measured: roots of their covariance, as twists in base axes, shape
    (N, dof, dof)."""
    first: State | None = None
    """Where the search starts."""

    @cached_property
    def legs(self) -> tuple[Leg, ...]:
        """Legs whose parameters are identified, in order."""
        return tuple(one.leg for one in self.conditions)

    @property
    def platform(self) -> Platform:
        """The platform."""
        return self.conditions[0].platform

    @property
    def latent(self) -> bool:
        """Whether poses are unknowns."""
        return self.pose_roots is None

    @property
    def weighted(self) -> bool:
        """Whether white residuals are minimised, or, as the papers have it, plain joint ones."""
        return self.conditions[0].kind == "closure"

    @cached_property
    def alike(self) -> list[list[int]]:
        """Places of legs that are evaluated in one call."""
        return grouped([one.form for one in self.conditions], len(self.used))

    @cached_property
    def columns(self) -> list[slice]:
        """Parameters of each leg among the unknowns."""
        return _slices([len(leg.parameters) for leg in self.legs])

    @cached_property
    def reading_columns(self) -> list[slice]:
        """Readings of each leg among those of all."""
        return _slices([len(leg.sensors) for leg in self.legs])

    @cached_property
    def leg_rows(self) -> list[slice]:
        """Equations of each leg among those of all at a pose."""
        return _slices([one.width for one in self.conditions])

    @property
    def n_parameters(self) -> int:
        """Number of parameters of all legs."""
        return self.columns[-1].stop

    @property
    def readings(self) -> Array:
        """Readings of all legs, shape (N, n_readings), [rad] or [m]."""
        return np.concatenate([one.readings for one in self.conditions], axis=1)

    @property
    def influences(self) -> dict[str, Array]:
        """Influence quantities of all legs by column, each of shape (N,)."""
        return {
            name: values
            for one in self.conditions
            for name, values in zip(
                one.leg.influences, one.known[:, len(one.leg.sensors) :].T, strict=False
            )
        }

    @cached_property
    def quantities(self) -> tuple[str, ...]:
        """What each column of the noise belongs to, as people call it."""
        readings = [
            f"reading of {name}" if len(leg.sensors) == 1 else f"reading {name}"
            for leg in self.legs
            for name in leg.reading_names
        ]
        if self.latent:
            return (*readings, *(f"measured {name}" for name in self.observation.names))
        return (*readings, *(f"measured {name}" for name in self.platform.freedoms))

    def unit_of(self, quantity: str) -> str:
        """Return the unit of one of the quantities, ``"m"`` or ``"rad"``."""
        readings = [unit for leg in self.legs for unit in leg.reading_units]
        own = self.observation.units if self.latent else self.platform.units
        return (*readings, *own)[self.quantities.index(quantity)]

    @cached_property
    def _leg_rows_used(self) -> Mask:
        return np.repeat(self.used, [one.width for one in self.conditions], axis=1)

    @property
    def equations(self) -> Index:
        """How many equations each pose gives, poses eliminated, shape (N,)."""
        legs = self._leg_rows_used.sum(axis=1)
        if not self.latent:
            return np.asarray(legs)
        return np.asarray(legs + self.observation.measured.sum(axis=1) - self.platform.dof)

    def part(self, rows: Index) -> Problem:
        """Return the problem of some poses."""
        return replace(
            self,
            conditions=tuple(one.part(rows) for one in self.conditions),
            used=self.used[rows],
            observation=self.observation.rows(rows),
            sigma_observed=self.sigma_observed[rows],
            sigma_readings=self.sigma_readings[rows],
            correlation=None if self.correlation is None else self.correlation[rows],
            pose_roots=None if self.pose_roots is None else self.pose_roots[rows],
            first=None if self.first is None else self.first.rows(rows),
        )

    def thinned(self, linear: Linear, most: int = 2000) -> tuple[Problem, Linear, Index]:
        """Return the problem and its conditions at some poses, spread over all; and which.

        Both as they are where there are no more.

        Args:
            linear: The conditions of all poses.
            most: Number of poses; enough to judge by, if not given.
        """
        some = spread(len(linear.value), most)
        if len(some) == len(linear.value):
            return self, linear, some
        part = self.part(some)
        return part, part.linearise(linear.state.rows(some)), some

    def start(self, parameters: Array) -> State:
        """Return the state from which the search starts, at parameters of the legs."""
        if self.first is None:
            raise TypeError("the poses have no start yet")
        return replace(self.first, parameters=parameters)

    def stack(self, state: State) -> Stack:
        """Return the conditions at a state.

        Raises:
            MeasurementError: a residual that does not exist.
        """
        found, follow = all_met(self.conditions, self.alike, self.columns, state)
        demands = [one.demand for one in found]
        state = replace(state, joints=tuple(one.joints for one in found))
        n_legs, outside = self.leg_rows[-1].stop, len(self.observation.external)
        count, dof = len(self.used), self.platform.dof
        seen = self.observation.evaluate(state.matrices, state.external) if self.latent else None
        r = 0 if seen is None else seen.value.shape[1]
        value, pose = np.zeros((count, n_legs + r)), np.zeros((count, n_legs + r, dof))
        blocks = []
        for demand, rows, columns, used in zip(
            demands, self.leg_rows, self.columns, self.used.T, strict=True
        ):
            by_leg = demand.parameter
            value[:, rows], pose[:, rows] = demand.value, demand.pose
            if not used.all():
                value[~used, rows], pose[~used, rows] = 0.0, 0.0
                by_leg = np.where(used[:, None, None], by_leg, 0.0)
            blocks.append(Block(rows, columns, by_leg))
        n = self.n_parameters
        if seen is not None:
            value[:, n_legs:], pose[:, n_legs:] = seen.value, seen.pose
        by_outside = np.zeros((count, r, outside)) if seen is None else seen.external
        blocks.append(Block(slice(n_legs, n_legs + r), slice(n, n + outside), by_outside))
        noise = self.noise(demands, state)
        pose = pose if self.latent else pose[:, :, :0]
        return Stack(state, found, follow, value, tuple(blocks), pose, noise)

    def noise(self, demands: Sequence[Demand], state: State) -> Array:
        """Return S at a state and what the legs demand there, shape (N, k, s)."""
        n_legs, n_readings = self.leg_rows[-1].stop, self.reading_columns[-1].stop
        r = self.sigma_observed.shape[1] if self.latent else 0
        more = self.platform.dof if self.pose_roots is not None else r
        noise = np.zeros((len(self.used), n_legs + r, n_readings + more))
        for demand, rows, own, used in zip(
            demands, self.leg_rows, self.reading_columns, self.used.T, strict=True
        ):
            keep = used[:, None, None]
            by_reading = demand.reading * self.sigma_readings[:, None, own]
            noise[:, rows, own] = np.where(keep, by_reading, 0.0)
            if self.pose_roots is not None:
                noise[:, rows, n_readings:] = np.where(keep, demand.pose @ self.pose_roots, 0.0)
        if self.latent:
            measured = self.observation.measured[:, :, None]
            roots = self.observation.noise_roots(
                self.observed_roots, state.matrices, state.external
            )
            noise[:, n_legs:, n_readings:] = np.where(measured, roots, 0.0)
        return noise

    @cached_property
    def observed_roots(self) -> Array:
        """Roots of the covariance of what was observed, shape (N, r, r)."""
        roots = RowNoise(self.sigma_observed, self.correlation).roots
        roots.setflags(write=False)
        return roots

    def linearise(self, state: State) -> Linear:
        """Return the conditions at a state as rows of ordinary least squares.

        Raises:
            MeasurementError: a residual that does not exist; conditions without noise.
        """
        return self.whitened(self.stack(state))

    def with_this_noise(self, linear: Linear) -> Linear:
        """Return what another problem's conditions are with the noise of this one.

        Raises:
            MeasurementError: conditions without noise.
        """
        noise = self.noise(linear.stack.demands, linear.state)
        return self.whitened(replace(linear.stack, noise=noise))

    def whitened(self, stack: Stack) -> Linear:
        """Return conditions freed of the poses and whitened.

        Raises:
            MeasurementError: conditions without noise.
        """
        try:
            white = white_rows(stack.pose, self._with_idle_noise(stack.noise))
        except NoNoiseError as error:
            raise MeasurementError(NO_NOISE) from error
        return Linear(
            stack,
            white,
            white(stack.value[:, :, None])[:, :, 0],
            self.equations,
        )

    def _with_idle_noise(self, noise: Array) -> Array:
        """Return S with noise of their own for rows of which nothing was measured."""
        idle = ~self._leg_rows_used
        if self.latent:
            idle = np.concatenate((idle, ~self.observation.measured), axis=1)
        if not idle.any():
            return noise
        size = float(np.median(np.abs(noise[noise != 0.0]))) if noise.any() else 1.0
        columns = idle.any(axis=0)
        own = np.where(idle[:, :, None], size * np.eye(idle.shape[1]), 0.0)[:, :, columns]
        return np.concatenate((noise, own), axis=2)

    def moved(self, linear: Linear, step: Array) -> State:
        """Return the state after a step of all unknowns, shape (n,), the poses following."""
        state, stack, n = linear.state, linear.stack, self.n_parameters
        external = self.observation.external.moved(state.external, step[n:])
        parameters = state.parameters + step[:n]
        matrices, twists = state.matrices, np.zeros((len(state.matrices), self.platform.dof))
        if self.latent:
            twists = linear.white.pose_step(stack.after(step))
            there = self._carried(stack, step, twists, parameters)
            matrices = self.platform.displaced(matrices, twists) if there is None else there
        joints = stack.follow(step, twists)
        return State(parameters, matrices, joints, external)

    def _carried(self, stack: Stack, step: Array, twists: Array, parameters: Array) -> Array | None:
        """Return poses at which an arm's closure is what a step was to make it, (N, 4, 4).

        An arm that is read carries the platform exactly, along no straight line; None if no leg
        is one.
        """
        for one, demand, columns in zip(self.conditions, stack.demands, self.columns, strict=True):
            if one.leg.is_arm and self.platform.dof == 6:
                gap = demand.value + demand.parameter @ step[columns]
                gap += (demand.pose @ twists[:, :, None])[:, :, 0]
                leg = LegClosure(one.leg, self.platform, parameters[columns])
                return arm_poses(leg, one.known, gap)
        return None

    def pose_draws(self, linear: Linear) -> Array:
        """Return poses' twists drawn from what is not known about them, shape (N, dof)."""
        rng = np.random.default_rng(0)
        if self.pose_roots is not None:
            draws = rng.standard_normal(self.pose_roots.shape[:2])
            return np.asarray((self.pose_roots @ draws[:, :, None])[:, :, 0])
        S, W = linear.white.noise, linear.white.by_noise
        nu = rng.standard_normal((len(S), S.shape[2], 1))
        left = nu - W.transpose(0, 2, 1) @ (W @ nu)  # what white rows do not see
        return linear.white.poses_by(S @ left)[:, :, 0]


def spread(count: int, most: int) -> Index:
    """Return at most so many of rows 0 … count - 1, evenly spread."""
    return np.arange(0, count, -(-count // most))


def _slices(sizes: Sequence[int]) -> list[slice]:
    ends = np.cumsum(sizes).tolist()
    return [slice(end - size, end) for size, end in zip(sizes, ends, strict=True)]
