"""What a calibration found: parameters with uncertainties, and whether to trust them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pincal.model.measurements import Noise
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]


@dataclass(frozen=True)
class IdentifiedParameter:
    """One parameter: nominal and identified value, and how sure the latter is."""

    name: str
    unit: str
    nominal: float
    identified: float
    std: float
    """Standard error."""
    low: float
    """Lower end of the 95 % confidence interval."""
    high: float
    """Upper end of the 95 % confidence interval."""


@dataclass(frozen=True)
class LegResult:
    """Calibration of one leg."""

    name: str
    parameters: tuple[IdentifiedParameter, ...]
    rank: int
    condition: float
    """Of the leg's whitened identification Jacobian, columns scaled to unit length."""
    rms_before: float
    """Root mean square residual with nominal parameters, [m] closure or [rad] joint."""
    rms_after: float
    """Root mean square residual with identified parameters."""
    n_residuals: int
    sigma: Array
    """Modelled standard deviation of each residual used, shape (n_residuals,)."""
    rows: NDArray[np.intp]
    """Rows of the measurements used, shape (n_residuals,)."""
    residuals: Array
    """Residuals with identified parameters, shape (n_residuals,)."""

    @property
    def identified(self) -> Array:
        """Identified values, shape (n_params,)."""
        return np.array([p.identified for p in self.parameters])

    @property
    def std(self) -> Array:
        """Standard errors, shape (n_params,)."""
        return np.array([p.std for p in self.parameters])


@dataclass(frozen=True)
class CalibrationResult:
    """Result of ``calibrate``: knows its nominal and its identified mechanism."""

    nominal: Mechanism
    identified: Mechanism
    legs: tuple[LegResult, ...]
    method: str
    residual: str
    poses: str
    noise: Noise | None
    """Standard deviations given or estimated for all rows; None if rows have their own."""
    noise_source: str
    """``"given"``, ``"rows"`` of the measurements, or ``"estimated"`` from the residuals."""
    covariance: Array
    """Covariance of all parameters, legs in order, shape (n, n)."""
    degrees_of_freedom: int
    reduced_chi2: float
    """χ² over degrees of freedom, near 1 if the noise is as given; if it was estimated, of the
    assumed one (1e-4 m and rad), and no sign of a good fit."""
    iterations: int
    """Evaluations of the residuals."""
    converged: bool
    message: str
    warnings: tuple[str, ...] = ()

    def leg(self, name: str) -> LegResult:
        """Return the result of one leg by name."""
        return self.legs[self.nominal.leg_names.index(self.nominal.leg(name).name)]

    def __str__(self) -> str:
        """Return a table of all parameters, with what to make of it."""
        unit = "m" if self.residual == "closure" else "rad"
        lines = [
            f"{self.nominal.name}: {self.method}, {self.residual} residual, {self.message}",
            f"  {'leg':8s} {'parameter':10s} {'nominal':>12s} {'identified':>14s} {'± 95 %':>10s}",
        ]
        for leg in self.legs:
            for p in leg.parameters:
                half = (p.high - p.low) / 2
                lines.append(
                    f"  {leg.name:8s} {p.name:10s} {p.nominal:12.6f} {p.identified:14.7f} "
                    f"{half:10.2g} {p.unit}"
                )
            lines.append(
                f"  {leg.name:8s} rms residual {leg.rms_before:.3g} to {leg.rms_after:.3g} {unit}, "
                f"{leg.n_residuals} residuals, rank {leg.rank}, condition {leg.condition:.3g}"
            )
        lines.append(
            f"  reduced χ² {self.reduced_chi2:.3g} on {self.degrees_of_freedom} degrees of freedom"
        )
        return "\n".join(lines + [f"  warning: {text}" for text in self.warnings])

    def save(self, folder: str | Path, *, force: bool = False) -> Path:
        """Write ``result.json``, ``residuals.csv`` and the calibrated mechanism to a folder.

        Raises:
            FileError: the folder exists and ``force`` is not set, or cannot be written.
        """
        from pincal.identification.result_files import save_result

        return save_result(self, folder, force=force)
