"""Residuals that carry noise: of the legs or, if their readings are exact, of what was measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.calibration.result import CalibrationResult, LegResult, Observed
from pincal.show.tables import SHOWN

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Series:
    """Residuals of a leg, or of a measured quantity of the platform."""

    name: str
    unit: str
    rows: NDArray[np.intp]
    before: Array
    after: Array
    sigma: Array
    of_leg: bool


def series_of(result: CalibrationResult) -> list[Series]:
    """Return the residuals that carry noise: the legs', or those of the platform as measured."""
    legs = [
        Series(
            leg.name,
            leg.unit,
            leg.rows,
            leg.residuals_before,
            leg.residuals,
            residual_sigma(result, leg),
            of_leg=True,
        )
        for leg in result.legs
    ]
    if not readings_exact(result):
        return legs
    return [
        Series(
            one.name,
            one.unit,
            one.rows,
            one.residuals_before,
            one.residuals,
            one.sigmas,
            of_leg=False,
        )
        for one in result.observed
    ]


def readings_exact(result: CalibrationResult) -> bool:
    """Return whether legs close by construction, so that only the platform can miss something."""
    return bool(result.observed) and not any((leg.sigma > 0.0).any() for leg in result.legs)


def observed_heads(result: CalibrationResult) -> tuple[str, ...]:
    """Return what is told of a measured quantity; before, only where readings say the poses."""
    return ("rms before", "rms after", "σ") if readings_exact(result) else ("rms misfit", "σ")


def observed_cells(result: CalibrationResult, one: Observed) -> tuple[list[str], str]:
    """Return how a measured quantity fits, below ``observed_heads``, and the unit."""
    unit, factor = SHOWN[one.unit]
    before = [float(np.sqrt(np.mean(one.residuals_before**2)))] if readings_exact(result) else []
    return [f"{factor * value:.4f}" for value in (*before, one.rms, one.sigma)], unit


def residual_sigma(result: CalibrationResult, leg: LegResult) -> Array:
    """Return standard deviations of a leg's residuals, shape (n_residuals,).

    Those modelled; where the noise was estimated, with its scale.
    """
    if result.noise_source != "estimated":
        return leg.sigma
    return leg.sigma * np.sqrt(result.reduced_chi2)
