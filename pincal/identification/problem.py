"""The least-squares problem of one leg, or of all legs together, on whitened residuals.

Residuals of different legs at one pose share that pose's noise. Their covariance at
each pose, Σ = X Σ_x Xᵀ + diag(∂e/∂ψ)² σ_ψ², is modelled from the residuals' own derivatives
and removed by its Cholesky factor. With one leg this is one weight a row.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MeasurementError
from pincal.identification.residuals import LegResidual
from pincal.kinematics.derivatives import Demand
from pincal.model.leg import Leg

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Problem:
    """Residuals of some legs at N poses, stacked, as a function of their parameters."""

    def __init__(
        self,
        residuals: Sequence[LegResidual],
        used: Mask,
        sigma_poses: Array,
        sigma_readings: Array,
    ) -> None:
        """Hold the residuals and the standard deviations behind them.

        Args:
            residuals: One for each leg.
            used: Which poses serve which leg, shape (N, n_legs).
            sigma_poses: Standard deviations of the coordinates, shape (N, dof).
            sigma_readings: Standard deviations of the readings, shape (N, n_legs).
        """
        self.residuals = residuals
        self.used = used
        self._sigma_poses = sigma_poses
        self._sigma_readings = sigma_readings
        sizes = [len(r.leg.parameters) for r in residuals]
        ends = np.cumsum(sizes)
        self.columns = [slice(int(e - n), int(e)) for e, n in zip(ends, sizes, strict=True)]
        self.n_params = int(ends[-1])
        self._cache: tuple[Array, list[Demand]] | None = None

    @property
    def legs(self) -> list[Leg]:
        """Legs whose parameters are identified, in order."""
        return [residual.leg for residual in self.residuals]

    def demands(self, parameters: Array) -> list[Demand]:
        """Return residual and derivatives of each leg; the last call's are kept."""
        if self._cache is None or not np.array_equal(self._cache[0], parameters):
            parts = [r(parameters[c]) for r, c in zip(self.residuals, self.columns, strict=True)]
            self._cache = (parameters.copy(), parts)
        return self._cache[1]

    def values(self, parameters: Array) -> Array:
        """Return the residuals, not weighted, shape (N, n_legs); zero where not used."""
        parts = self.demands(parameters)
        return np.where(self.used, np.concatenate([p.value for p in parts], axis=1), 0.0)

    def jacobian(self, parameters: Array) -> Array:
        """Return ∂residual/∂parameter, shape (N, n_legs, n_params); zero where not used."""
        parts = self.demands(parameters)
        full = np.zeros((*self.used.shape, self.n_params))
        for index, (part, columns) in enumerate(zip(parts, self.columns, strict=True)):
            full[:, index, columns] = np.where(self.used[:, index, None], part.parameter[:, 0], 0.0)
        return full

    def covariance(self, parameters: Array) -> Array:
        """Return the modelled covariance of the residuals at each pose, shape (N, m, m).

        Rows and columns that are not used are those of the identity.

        Raises:
            MeasurementError: some residual has no noise.
        """
        parts = self.demands(parameters)
        X = np.concatenate([p.pose for p in parts], axis=1) * self._sigma_poses[:, None, :]
        covariance = X @ X.transpose(0, 2, 1)
        by_reading = np.concatenate([p.reading for p in parts], axis=1) * self._sigma_readings
        m = len(parts)
        covariance[:, range(m), range(m)] += by_reading**2
        together = self.used[:, :, None] & self.used[:, None, :]
        covariance = np.where(together, covariance, 0.0)
        diagonal = covariance[:, range(m), range(m)]
        if (diagonal[self.used] <= 0.0).any():
            raise MeasurementError(
                "a residual has no noise at all; give a standard deviation above zero for "
                "position, orientation or reading (only their ratios matter to the estimate)"
            )
        covariance[:, range(m), range(m)] = np.where(self.used, diagonal, 1.0)
        return covariance

    def whitener(self, parameters: Array) -> Array:
        """Return the inverse Cholesky factors of the covariance, shape (N, m, m).

        Raises:
            MeasurementError: the residuals at a pose are dependent.
        """
        try:
            factor = np.linalg.cholesky(self.covariance(parameters))
        except np.linalg.LinAlgError as error:
            raise MeasurementError(
                "the legs' residuals at a pose are dependent: with more legs than freedoms "
                "the readings need noise of their own (--noise-reading), or use --method per-leg"
            ) from error
        return np.linalg.inv(factor)
