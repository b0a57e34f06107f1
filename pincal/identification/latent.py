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
from pincal.estimation.elimination import Eliminated, eliminate
from pincal.estimation.observation import Observation
from pincal.identification.exactness import least_sigmas
from pincal.identification.problem import LegRows, Linear, State
from pincal.identification.residuals import LegResidual
from pincal.identification.stacking import (
    by_readings,
    joined_units,
    leg_columns,
    leg_readings,
    leg_rows,
)
from pincal.kinematics.closure import LegClosure, product
from pincal.kinematics.derivatives import Demand
from pincal.kinematics.held import carried
from pincal.kinematics.inverse import inverse
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


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
            sigma_readings: Standard deviations of the readings, shape (N, n_readings).

        Raises:
            MeasurementError: a row with too few measured quantities; nothing that has noise.
        """
        self.residuals = residuals
        self.used = used
        self.observation = observation
        self.legs = [residual.leg for residual in residuals]
        self.columns = leg_columns(self.legs)
        self._eased = False
        self.row_names = [
            f"reading of {name}" if one.width == 1 else f"closure of {name}"
            for one in residuals
            for name in one.names
        ]
        self.row_names += [f"measured {name}" for name in observation.names]
        self._platform = residuals[0].platform
        self._n_params = self.columns[-1].stop
        self._rows = leg_rows(residuals)
        self._readings = leg_readings(self.legs)
        read = np.repeat(used, [len(leg.sensors) for leg in self.legs], axis=1)
        self.sigma_readings = np.where(read, sigma_readings, 1.0)
        self.sigma_observed = sigma_observed
        self._noisy = observation.measured & (sigma_observed > 0.0)
        self._check_counts()
        noisy = np.stack([(self.sigma_readings[:, own] > 0.0).any(1) for own in self._readings], 1)
        if ((used & ~noisy) @ self._widths > self._platform.dof).any():
            raise MeasurementError(
                f"{len(self.legs)} exact readings contradict each other in "
                f"{self._platform.dof} freedoms of the platform; give the readings a standard "
                "deviation (--noise-reading)"
            )
        self.first: State | None = None
        """Where the search starts, once ``align`` has found it."""

    @property
    def readings(self) -> Array:
        """Readings of all legs, shape (N, n_readings), [rad] or [m]."""
        return np.concatenate([one.readings for one in self.residuals], axis=1)

    @property
    def _widths(self) -> NDArray[np.intp]:
        """Number of equations of each leg."""
        return np.array([one.width for one in self.residuals])

    def told(self, observed: bool = True) -> NDArray[np.intp]:
        """Return how many equations each pose has, shape (N,).

        Args:
            observed: Whether what was measured of the platform counts, or the legs alone.
        """
        legs = np.asarray(self.used @ self._widths)
        return legs + self.observation.measured.sum(axis=1) if observed else legs

    def _check_counts(self) -> None:
        told = self.told()
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
            LegResidual(one.leg, one.platform, home[own] + share * (one.readings - home[own]))
            for one, own in zip(self.residuals, self._readings, strict=True)
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
        whiteners, sigma_seen = self._whiteners(demands)
        n_legs, n = self._rows[-1].stop, self._n_params + len(self.observation.external)
        k = n_legs + seen.value.shape[1]
        value, pose = (
            np.empty((len(self.used), k)),
            np.empty((len(self.used), k, seen.pose.shape[2])),
        )
        parameter = np.zeros((len(self.used), k, n))
        for W, demand, own, columns in zip(
            whiteners, demands, self._rows, self.columns, strict=True
        ):
            value[:, own] = product(W, demand.value[:, :, None])[:, :, 0]
            pose[:, own] = product(W, demand.pose)
            parameter[:, own, columns] = product(W, demand.parameter)
        value[:, n_legs:] = seen.value / sigma_seen
        pose[:, n_legs:] = seen.pose / sigma_seen[:, :, None]
        parameter[:, n_legs:, self._n_params :] = seen.external / sigma_seen[:, :, None]
        here = replace(state, joints=tuple(joints for _, joints in found))
        return Rows(value, parameter, pose), Linear(
            here, demands, value, parameter, self.told() - self._platform.dof
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
        parameters = state.parameters + step[: self._n_params]
        there = self._carried(linear, step, twists, parameters)
        return State(
            parameters,
            self._platform.displaced(state.matrices, twists) if there is None else there,
            state.joints,
            self.observation.external.moved(state.external, step[self._n_params :]),
        )

    def _carried(
        self, linear: Linear, step: Array, twists: Array, parameters: Array
    ) -> Array | None:
        """Return poses at which an arm's closure is what a step was to make it, (N, 4, 4).

        An arm that is read carries the platform exactly, along no straight line; none if no leg is
        one.
        """
        for one, demand, columns in zip(self.residuals, linear.demands, self.columns, strict=True):
            if one.leg.is_arm and self._platform.dof == 6:
                gap = demand.value + demand.parameter @ step[columns]
                gap += (demand.pose @ twists[:, :, None])[:, :, 0]
                leg = LegClosure(one.leg, self._platform, parameters[columns])
                return carried(leg, one.readings, gap)
        return None

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
        """Return what a leg misses at the estimated poses.

        Predicted less measured reading; of a leg that demands several things its closure.
        """
        demand = linear.demands[index]
        if demand.value.shape[1] > 1:
            by_reading = by_readings(demand, self.sigma_readings[:, self._readings[index]])
            return LegRows(demand.value, np.sqrt(np.einsum("nkk->nk", by_reading)), "m")
        return LegRows(
            demand.as_joint().value,
            self.sigma_readings[:, self._readings[index]],
            joined_units(self.legs[index]),
        )

    def _whiteners(self, demands: Sequence[Demand]) -> tuple[list[Array], Array]:
        """Return what whitens each leg's rows, and standard deviations of the observed quantities.

        Inverse roots of the rows' covariance by the readings' noise, each of shape (N, k, k), zero
        where the readings were not measured; shape (N, r).

        Raises:
            MeasurementError: nothing has noise.
        """
        sigmas = [self.sigma_readings[:, own] for own in self._readings]
        own = [by_readings(demand, s) for demand, s in zip(demands, sigmas, strict=True)]
        by_reading = np.concatenate([np.linalg.norm(d.reading, axis=1) for d in demands], axis=1)
        legs = np.concatenate([np.sqrt(np.einsum("nkk->nk", one)) for one in own], axis=1)
        floors, sigma_seen = least_sigmas(
            by_reading,
            legs,
            np.repeat(self.used, self._widths, axis=1),
            self.sigma_observed,
            self.observation.measured,
            self._noisy,
            np.array([unit == "m" for unit in self.observation.units], dtype=bool),
            eased=self._eased,
        )
        whiteners: list[Array] = []
        for index, (covariance, rows) in enumerate(zip(own, self._rows, strict=True)):
            k = covariance.shape[1]
            covariance[:, range(k), range(k)] += floors[:, rows] ** 2
            root = np.sqrt(covariance) if k == 1 else np.linalg.cholesky(covariance)
            W = 1.0 / root if k == 1 else np.linalg.inv(root)
            whiteners.append(np.asarray(self.used[:, index, None, None] * W))
        return whiteners, sigma_seen
