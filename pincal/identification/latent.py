"""The least-squares problem in which every pose is an unknown.

At each pose the legs' closure residuals, e(x, ψ; φ) over the noise of their readings, and
what was measured of the platform stand together; the pose is eliminated from them. Full poses,
parts of them, other targets, distances, or nothing: all are rows of the same kind.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MeasurementError
from pincal.experiment.elimination import Eliminated, eliminate
from pincal.experiment.observation import Observation
from pincal.identification.problem import LegRows, Linear, State, leg_columns
from pincal.identification.residuals import LegResidual
from pincal.kinematics.inverse import inverse
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
_EXACT = 1e-3  # of the typical standard deviation: that of what is given as exact


@dataclass(frozen=True)
class Rows:
    """Residuals in standard deviations at N poses, and their derivatives."""

    value: Array
    """Shape (N, k)."""
    parameter: Array
    """By parameters and external unknowns, shape (N, k, n)."""
    pose: Array
    """By the platform's twist, shape (N, k, dof)."""


@dataclass(frozen=True, kw_only=True)
class LatentLinear(Linear):
    """Residuals and derivatives at a state, poses eliminated."""

    rows: Rows
    eliminated: Eliminated

    def damped(self, damping: float) -> Linear:
        """Return the same with the poses' steps held back."""
        rows = self.rows
        less = eliminate(rows.value, rows.parameter, rows.pose, damping)
        return replace(self, white=less.value, jacobian=less.parameter, eliminated=less)

    @property
    def plain(self) -> Array:
        """Each measured quantity's residual in standard deviations, shape (N, r)."""
        return self.rows.value

    @property
    def squares(self) -> Array:
        """Sum of the squared residuals of each pose in standard deviations, shape (N,)."""
        return np.einsum("nk,nk->n", self.rows.value, self.rows.value)

    def comparable(self) -> Array:
        """Return the Jacobian less its part along the poses, shape (N, k, n)."""
        return self.rows.parameter + self.rows.pose @ self.eliminated.poses_by_parameter()


class LatentPoses:
    """Closure residuals of all legs and what was measured of the platform, poses unknown."""

    def __init__(
        self,
        residuals: Sequence[LegResidual],
        used: Mask,
        observation: Observation,
        sigma_observed: Array,
        sigma_readings: Array,
    ) -> None:
        """Hold what was measured.

        Args:
            residuals: One for each leg.
            used: Which readings were measured, shape (N, n_legs).
            observation: What was measured of the platform.
            sigma_observed: Standard deviations of that, shape (N, r).
            sigma_readings: Standard deviations of the readings, shape (N, n_legs).

        Raises:
            MeasurementError: a row with too few measured quantities; nothing that has noise.
        """
        self.residuals = residuals
        self.used = used
        self.observation = observation
        self.legs = [residual.leg for residual in residuals]
        self.columns = leg_columns(self.legs)
        self._eased = False
        self.row_names = [f"reading of {leg.name}" for leg in self.legs]
        self.row_names += [f"measured {name}" for name in observation.names]
        self._platform = residuals[0].platform
        self._n_params = self.columns[-1].stop
        self.sigma_readings = np.where(used, sigma_readings, 1.0)
        self.sigma_observed = sigma_observed
        self._noisy = observation.measured & (sigma_observed > 0.0)
        self._check_counts()
        if ((used & (sigma_readings <= 0.0)).sum(axis=1) > self._platform.dof).any():
            raise MeasurementError(
                f"{len(self.legs)} exact readings contradict each other in "
                f"{self._platform.dof} freedoms of the platform; give the readings a standard "
                "deviation (--noise-reading)"
            )
        self.first: State | None = None
        """Where the search starts, once ``align`` has found it."""

    def _check_counts(self) -> None:
        told = self.used.sum(axis=1) + self.observation.measured.sum(axis=1)
        dof = self._platform.dof
        if (told < dof).any():
            row = int(np.argmax(told < dof))
            raise MeasurementError(
                f"data row {row + 1} has {told[row]} measured quantities, which do not fix the "
                f"{dof} freedoms of the platform; measure more, or leave the row out"
            )

    def start(self, parameters: Array) -> State:
        """Return the state from which the search starts: see ``first``."""
        if self.first is None:
            raise TypeError("the poses have no start yet")
        return replace(self.first, parameters=parameters)

    def eased(self) -> LatentPoses:
        """Return the problem with what is exact as uncertain as the rest: no narrow valleys."""
        found = copy(self)
        found._eased = True
        return found

    def part(self, rows: NDArray[np.intp]) -> LatentPoses:
        """Return the problem of some poses."""
        found = copy(self)
        found.residuals = [residual.part(rows) for residual in self.residuals]
        found.used, found.observation = self.used[rows], self.observation.rows(rows)
        found.sigma_readings = self.sigma_readings[rows]
        found.sigma_observed = self.sigma_observed[rows]
        found._noisy = self._noisy[rows]
        return found

    def without_observation(self) -> LatentPoses:
        """Return the problem of the readings alone."""
        found = copy(self)
        found.observation = self.observation.only(())
        return found

    def driven(self, mechanism: Mechanism, share: float) -> LatentPoses:
        """Return the problem of readings alone that are on the way from home to those measured."""
        found = self.without_observation()
        home = inverse(mechanism, np.array([mechanism.platform.home])).readings[0]
        found.residuals = [
            LegResidual(one.leg, one.platform, at + share * (one.readings - at))
            for one, at in zip(self.residuals, home, strict=True)
        ]
        return found

    def rows(self, state: State) -> tuple[Rows, Linear]:
        """Return all residuals in standard deviations, the poses still among the unknowns."""
        found = [
            residual(state.parameters[columns], state.matrices, joints)
            for residual, columns, joints in zip(
                self.residuals, self.columns, state.joints, strict=True
            )
        ]
        demands = [demand for demand, _ in found]
        seen = self.observation.evaluate(state.matrices, state.external)
        sigma_legs, sigma_seen = self._sigmas(np.concatenate([d.reading for d in demands], axis=1))
        n_legs, n = len(demands), self._n_params + len(self.observation.external)
        k = n_legs + seen.value.shape[1]
        value, pose = (
            np.empty((len(self.used), k)),
            np.empty((len(self.used), k, seen.pose.shape[2])),
        )
        parameter = np.zeros((len(self.used), k, n))
        for index, (demand, columns) in enumerate(zip(demands, self.columns, strict=True)):
            weight = self.used[:, index] / sigma_legs[:, index]
            value[:, index] = weight * demand.value[:, 0]
            pose[:, index] = weight[:, None] * demand.pose[:, 0]
            parameter[:, index, columns] = weight[:, None] * demand.parameter[:, 0]
        value[:, n_legs:] = seen.value / sigma_seen
        pose[:, n_legs:] = seen.pose / sigma_seen[:, :, None]
        parameter[:, n_legs:, self._n_params :] = seen.external / sigma_seen[:, :, None]
        here = replace(state, joints=tuple(joints for _, joints in found))
        told = self.used.sum(axis=1) + self.observation.measured.sum(axis=1)
        return Rows(value, parameter, pose), Linear(
            here, demands, value, parameter, told - self._platform.dof
        )

    def linearise(self, state: State) -> LatentLinear:
        """Return residuals and derivatives at a state, poses eliminated."""
        rows, plain = self.rows(state)
        less = eliminate(rows.value, rows.parameter, rows.pose)
        return LatentLinear(
            plain.state,
            plain.demands,
            less.value,
            less.parameter,
            plain.equations,
            rows=rows,
            eliminated=less,
        )

    def moved(self, linear: Linear, step: Array) -> State:
        """Return the state after a step of all unknowns, shape (n,), the poses following."""
        if not isinstance(linear, LatentLinear):
            raise TypeError("a step needs the rows from which the poses were eliminated")
        state = linear.state
        twists = linear.eliminated.poses(step)
        return State(
            state.parameters + step[: self._n_params],
            self._platform.displaced(state.matrices, twists),
            state.joints,
            self.observation.external.moved(state.external, step[self._n_params :]),
        )

    def shaken(self, linear: Linear) -> State:
        """Return the state with poses shaken by how well they are known."""
        if not isinstance(linear, LatentLinear):
            raise TypeError("shaking needs the rows from which the poses were eliminated")
        R = np.asarray(np.linalg.qr(linear.rows.pose, mode="r"))
        draws = np.random.default_rng(0).standard_normal(R.shape[:2])
        twists = np.linalg.solve(R, draws[:, :, None])[:, :, 0]
        state = linear.state
        return replace(state, matrices=self._platform.displaced(state.matrices, twists))

    def leg_residual(self, linear: Linear, index: int) -> LegRows:
        """Return predicted less measured readings at the estimated poses."""
        demand = linear.demands[index]
        return LegRows(
            -demand.value[:, 0] / demand.reading[:, 0],
            self.sigma_readings[:, index],
            self.legs[index].reading_unit,
        )

    def _sigmas(self, by_reading: Array) -> tuple[Array, Array]:
        """Return standard deviations of the legs' rows [m] and of the observed quantities.

        What is given as exact counts as a thousand times better than what is typical.

        Raises:
            MeasurementError: nothing has noise.
        """
        legs = np.abs(by_reading) * self.sigma_readings
        seen = self.observation.measured
        lengths = np.array([unit == "m" for unit in self.observation.units], dtype=bool)
        size = float(np.median(np.abs(by_reading)))  # [m/rad] or 1
        sigma = self.sigma_observed
        noisy = self._noisy
        own = [sigma[:, lengths][noisy[:, lengths]], size * sigma[:, ~lengths][noisy[:, ~lengths]]]
        known = next(
            (v for v in (own[0], legs[self.used & (legs > 0.0)], own[1]) if len(v)), np.zeros(0)
        )
        if not len(known):
            raise MeasurementError(
                "nothing that was measured has noise; give a standard deviation above zero for "
                "positions or readings (only their ratios matter to the estimate)"
            )
        typical = float(np.median(known))
        if self._eased:
            floor = np.where(lengths, typical, typical / size)
            return np.hypot(legs, typical), np.where(seen, np.maximum(sigma, floor), 1.0)
        noisy_legs = legs[self.used & (legs > 0.0)]
        small = _EXACT * float(np.median(noisy_legs)) if len(noisy_legs) else 0.0
        least = _EXACT * typical
        exact = np.where(lengths, least, least / size)
        return (
            np.where(self.sigma_readings > 0.0, np.hypot(legs, small), least),
            np.where(seen, np.where(sigma > 0.0, sigma, exact), 1.0),
        )
