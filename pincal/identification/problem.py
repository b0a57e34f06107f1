"""The least-squares problem of some legs whose poses were measured in full.

Residuals of different legs at one pose share that pose's noise. Their covariance at each
pose, Σ = X Σ_x Xᵀ + diag(∂e/∂ψ)² σ_ψ², is modelled from the residuals' own derivatives
and removed by its Cholesky factor. With one leg this is one weight a row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MeasurementError
from pincal.estimation.external import NOTHING, External
from pincal.identification.residuals import LegResidual
from pincal.identification.stacking import (
    by_readings,
    joined_units,
    leg_columns,
    leg_readings,
    leg_rows,
)
from pincal.kinematics.derivatives import Demand
from pincal.model.leg import Leg

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
NOT_THIS_MACHINE = (
    "They are hardly this machine's: check signs, units, the order of the readings, the frame of "
    "the poses, and rows that are far off (--robust cauchy)"
)


@dataclass(frozen=True)
class State:
    """Values of everything that is unknown."""

    parameters: Array
    """Of the legs, shape (n_params,)."""
    matrices: Array
    """Poses ``T_base_platform``, shape (N, 4, 4)."""
    joints: tuple[Array | None, ...]
    """Joint positions of each leg, shape (N, n_joints); None before the first evaluation."""
    external: External
    """Unknowns outside the mechanism."""

    def rows(self, chosen: NDArray[np.intp]) -> State:
        """Return the state at some poses."""
        joints = tuple(None if q is None else q[chosen] for q in self.joints)
        return replace(self, matrices=self.matrices[chosen], joints=joints)


@dataclass(frozen=True)
class Linear:
    """Residuals and derivatives at a state: k rows at each of N poses, in all n unknowns."""

    state: State
    demands: list[Demand]
    white: Array
    """Residuals in standard deviations, shape (N, k)."""
    jacobian: Array
    """Their derivatives, shape (N, k, n)."""
    equations: NDArray[np.intp]
    """How many equations each pose gives, shape (N,)."""
    root: Array | None = None
    """If residuals are minimised unweighted: root of their covariance, shape (N, k, k)."""
    pose_noise: Array | None = None
    """How residuals follow the noise of measured poses, in standard deviations, (N, k, dof)."""

    @property
    def squares(self) -> Array:
        """Sum of the squared residuals of each pose in standard deviations, shape (N,)."""
        return np.einsum("nk,nk->n", self.white, self.white)

    @property
    def minimised(self) -> tuple[Array, Array]:
        """What is minimised, and its derivatives, shapes (N, k) and (N, k, n)."""
        if self.root is None:
            return self.white, self.jacobian
        return (self.root @ self.white[:, :, None])[:, :, 0], self.root @ self.jacobian

    @property
    def plain(self) -> Array:
        """Each measured quantity's residual in standard deviations, shape (N, r)."""
        return self.white

    def damped(self, damping: float) -> Linear:  # noqa: ARG002
        """Return the same with poses held back, if they are unknown."""
        return self

    def comparable(self) -> Array:
        """Return the Jacobian in rows that do not turn from state to state, (N, k, n)."""
        return self.jacobian


@dataclass(frozen=True)
class LegRows:
    """Residuals of one leg as people read them, k at a pose."""

    value: Array
    """Shape (N, k)."""
    sigma: Array
    """Their modelled standard deviations, shape (N, k)."""
    unit: str


class Problem(Protocol):
    """Residuals of some legs at N poses as a function of all unknowns."""

    @property
    def legs(self) -> Sequence[Leg]:
        """Legs whose parameters are identified, in order."""

    @property
    def columns(self) -> Sequence[slice]:
        """Parameters of each leg among the unknowns."""

    @property
    def used(self) -> Mask:
        """Which row serves which leg, shape (N, n_legs)."""

    @property
    def row_names(self) -> Sequence[str]:
        """What the columns of ``Linear.plain`` are residuals of."""

    def start(self, parameters: Array) -> State:
        """Return the state from which the search starts."""

    def eased(self) -> Problem:
        """Return a problem with the optimum nearby that is searched more easily."""

    def part(self, rows: NDArray[np.intp]) -> Problem:
        """Return the problem of some poses."""

    def linearise(self, state: State) -> Linear:
        """Return residuals and derivatives at a state."""

    def moved(self, linear: Linear, step: Array) -> State:
        """Return the state after a step of all unknowns, shape (n,)."""

    def shaken(self, linear: Linear) -> State:
        """Return a state with poses shaken once more by what is not known about them."""

    def leg_residual(self, linear: Linear, index: int) -> LegRows:
        """Return what a leg misses at each pose."""


class MeasuredPoses:
    """Residuals of some legs at measured poses, stacked and whitened."""

    def __init__(
        self,
        residuals: Sequence[LegResidual],
        coordinates: Array,
        used: Mask,
        pose_roots: Array,
        sigma_readings: Array,
        *,
        weighted: bool = True,
    ) -> None:
        """Hold the residuals and the standard deviations behind them.

        Args:
            residuals: One for each leg.
            coordinates: Measured poses, shape (N, dof).
            used: Which poses serve which leg, shape (N, n_legs).
            pose_roots: Roots L of the covariances L Lᵀ of the measured poses, as twists in base
                axes, shape (N, dof, dof).
            sigma_readings: Standard deviations of the readings, shape (N, n_readings).
            weighted: Whether whitened residuals are minimised, or plain ones.
        """
        self.residuals = residuals
        self.used = used
        self.legs = [residual.leg for residual in residuals]
        self.columns = leg_columns(self.legs)
        self._coordinates = coordinates
        self._pose_roots = pose_roots
        self._sigma_readings = sigma_readings
        self._weighted = weighted
        self._rows = leg_rows(residuals)
        self._used = np.repeat(used, [one.width for one in residuals], axis=1)
        self._readings = leg_readings(self.legs)
        self.row_names = [f"closure of {name}" for one in residuals for name in one.names]

    def start(self, parameters: Array) -> State:
        """Return the state of measured poses."""
        platform = self.residuals[0].platform
        matrices = platform.transforms(self._coordinates).as_matrix()
        return State(parameters, matrices, (None,) * len(self.legs), NOTHING)

    def eased(self) -> MeasuredPoses:
        """Return the problem itself."""
        return self

    def part(self, rows: NDArray[np.intp]) -> MeasuredPoses:
        """Return the problem of some poses."""
        return MeasuredPoses(
            [residual.part(rows) for residual in self.residuals],
            self._coordinates[rows],
            self.used[rows],
            self._pose_roots[rows],
            self._sigma_readings[rows],
            weighted=self._weighted,
        )

    def linearise(self, state: State) -> Linear:
        """Return residuals and derivatives at a state.

        Raises:
            MeasurementError: a residual that does not exist or has no noise; legs whose
                residuals at a pose are dependent.
        """
        found = [
            residual(state.parameters[columns], state.matrices, joints)
            for residual, columns, joints in zip(
                self.residuals, self.columns, state.joints, strict=True
            )
        ]
        demands = [demand for demand, _ in found]
        values = np.where(self._used, np.concatenate([d.value for d in demands], axis=1), 0.0)
        jacobian = np.zeros((*self._used.shape, len(state.parameters)))
        for demand, rows, columns in zip(demands, self._rows, self.columns, strict=True):
            own = self._used[:, rows, None]
            jacobian[:, rows, columns] = np.where(own, demand.parameter, 0.0)
        root = self._root(demands)
        whitener = np.linalg.inv(root)
        return Linear(
            replace(state, joints=tuple(joints for _, joints in found)),
            demands,
            np.asarray((whitener @ values[:, :, None])[:, :, 0]),
            np.asarray(whitener @ jacobian),
            self._used.sum(axis=1),
            None if self._weighted else root,
            np.asarray(whitener @ self._pose_columns(demands)),
        )

    def moved(self, linear: Linear, step: Array) -> State:
        """Return the state after a step of the parameters, shape (n_params,)."""
        return replace(linear.state, parameters=linear.state.parameters + step)

    def shaken(self, linear: Linear) -> State:
        """Return the state with poses shaken once more by their noise."""
        shake = np.random.default_rng(0).standard_normal(self._pose_roots.shape[:2])
        twists = (self._pose_roots @ shake[:, :, None])[:, :, 0]
        platform = self.residuals[0].platform
        return replace(linear.state, matrices=platform.displaced(linear.state.matrices, twists))

    def leg_residual(self, linear: Linear, index: int) -> LegRows:
        """Return a leg's closure or joint residual at each pose."""
        demand = linear.demands[index]
        by_pose = demand.pose @ self._pose_roots
        by_reading = by_readings(demand, self._sigma_readings[:, self._readings[index]])
        variance = np.einsum("nki,nki->nk", by_pose, by_pose) + np.einsum("nkk->nk", by_reading)
        unit = "m" if self._weighted else joined_units(self.legs[index])
        return LegRows(demand.value, np.sqrt(variance), unit)

    def _pose_columns(self, demands: list[Demand]) -> Array:
        """Return how residuals follow the roots of the poses' noise, shape (N, m, dof)."""
        X = np.concatenate([d.pose for d in demands], axis=1) @ self._pose_roots
        return np.where(self._used[:, :, None], X, 0.0)

    def _root(self, demands: list[Demand]) -> Array:
        """Return Cholesky factors of the residuals' covariance at each pose, shape (N, m, m).

        Rows and columns that are not used are those of the identity.
        """
        X = self._pose_columns(demands)
        covariance = X @ X.transpose(0, 2, 1)
        for demand, rows, readings in zip(demands, self._rows, self._readings, strict=True):
            covariance[:, rows, rows] += by_readings(demand, self._sigma_readings[:, readings])
        m = self._used.shape[1]
        together = self._used[:, :, None] & self._used[:, None, :]
        covariance = np.where(together, covariance, 0.0)
        diagonal = covariance[:, range(m), range(m)]
        if (diagonal[self._used] <= 0.0).any():
            raise MeasurementError(
                "a residual has no noise at all; give a standard deviation above zero for "
                "position, orientation or reading (only their ratios matter to the estimate)"
            )
        covariance[:, range(m), range(m)] = np.where(self._used, diagonal, 1.0)
        try:
            return np.asarray(np.linalg.cholesky(covariance))
        except np.linalg.LinAlgError as error:
            if m <= self.residuals[0].platform.dof:
                raise MeasurementError(
                    "the search ran away, to parameters at which the legs do not hold the platform "
                    f"at the measured poses. {NOT_THIS_MACHINE}"
                ) from error
            raise MeasurementError(
                "the legs' residuals at a pose are dependent: with more legs than freedoms "
                "the readings need noise of their own (--noise-reading), or use --method per-leg"
            ) from error
