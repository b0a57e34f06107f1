"""Residuals of a calibration, by leg and by measured quantity, as charts and tables show them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pincal.calibration.leg_result import LegResult, Observed
from pincal.calibration.result import CalibrationResult
from pincal.types import Array, Index

#: Redundancy up to which a residual is what the fit made of it, and says nothing of the noise.
CONTROLLED = 1e-3


@dataclass(frozen=True)
class Series:
    """Residuals of a leg, or of a measured quantity of the platform."""

    name: str
    unit: str
    """``"m"`` or ``"rad"``."""
    rows: Index
    """Rows of the measurements."""
    before: Array
    """With nominal parameters, at the poses that suit these best where poses are unknowns."""
    after: Array
    sigma: Array
    """Standard deviations of the noise."""
    redundancy: Array | None
    """Variance after the fit over that of the noise, 1 − h; None of results saved before that was
    kept."""
    of_leg: bool

    @property
    def standardised(self) -> Array:
        """Residuals after the fit over their standard deviations σ√(1−h), h being the leverage.

        Over σ where h is not known; NaN where nothing checks one.
        """
        share = 1.0 if self.redundancy is None else self.redundancy
        spread = self.sigma * np.sqrt(share)
        checked = (spread > np.sqrt(CONTROLLED) * self.sigma) & (self.sigma > 0.0)
        return np.where(checked, self.after, np.nan) / np.where(checked, spread, 1.0)

    @property
    def rms(self) -> list[float]:
        """Root mean squares before, after, and of the noise."""
        parts = np.array([self.before, self.after, self.sigma])
        return np.sqrt(np.mean(parts**2, axis=1)).tolist()


def legs_series(result: CalibrationResult) -> list[Series]:
    """Return the residuals of the legs."""
    scale = np.sqrt(result.reduced_chi2) if result.noise_source == "estimated" else 1.0
    return [_series(leg, leg.sigma * scale) for leg in result.legs]


def observed_series(result: CalibrationResult) -> list[Series]:
    """Return the residuals of what was measured of the platform, where poses are unknowns."""
    return [_series(observed, observed.sigmas) for observed in result.observed]


def _series(block: LegResult | Observed, sigma: Array) -> Series:
    residuals = block.residuals_before, block.residuals, sigma, block.redundancy
    return Series(block.name, block.unit, block.rows, *residuals, isinstance(block, LegResult))


def noisy_series(result: CalibrationResult) -> list[Series]:
    """Return residuals that carry noise: of legs, of the platform if legs cannot miss, or both.

    Both where readings have noise: they share with the platform what is missed.
    """
    if readings_exact(result):
        return observed_series(result)
    shared = any(leg.quantity == "reading" for leg in result.legs)
    return legs_series(result) + (observed_series(result) if shared else [])


def readings_exact(result: CalibrationResult) -> bool:
    """Return whether legs close by construction, so that only the platform can miss something."""
    return bool(result.observed) and not any((leg.sigma > 0.0).any() for leg in result.legs)
