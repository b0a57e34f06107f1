"""Tables of a calibration as HTML, in the units in which people read them."""

from __future__ import annotations

from math import floor, log10

import numpy as np
from numpy.typing import NDArray

from pincal.identification.result import CalibrationResult, IdentifiedParameter, LegResult
from pincal.model.mechanism import Mechanism
from pincal.show.markup import Element, table
from pincal.show.tables import SHOWN

Array = NDArray[np.float64]
LISTED = 50  # outliers in the table; all are in result.json
_HEADS = ("parameter", "nominal", "identified", "± 95 %", "unit", "change", "change [σ]")


def parameters_table(result: CalibrationResult) -> Element:
    """Return all parameters by leg."""
    rows = [
        (leg.name if place == 0 else "", *_cells(p))
        for leg in result.legs
        for place, p in enumerate(leg.parameters)
    ]
    caption = "Parameters: nominal and identified, and by how many standard errors they changed"
    return table(caption, ("leg", *_HEADS), rows, groups=1)


def nominal_table(mechanism: Mechanism) -> Element:
    """Return the nominal parameters of a mechanism by leg."""
    rows = []
    for leg in mechanism.legs:
        for place, (name, value) in enumerate(leg.nominal_by_name.items()):
            unit, factor = SHOWN[leg.units[name]]
            rows.append((leg.name if place == 0 else "", name, f"{factor * value:.4f}", unit))
    return table("Nominal parameters", ("leg", "parameter", "nominal", "unit"), rows, groups=1)


def external_table(result: CalibrationResult) -> Element:
    """Return the unknowns outside the mechanism."""
    return table(
        "Outside the mechanism: where its base stands in the frame of the measurements "
        "(rx, ry, rz a rotation vector), and where what was measured sits on the platform",
        ("unknown", "start", *_HEADS[2:5]),
        [_cells(p)[:5] for p in result.external],
    )


def residual_sigma(result: CalibrationResult, leg: LegResult) -> Array:
    """Return standard deviations of a leg's residuals, shape (n_residuals,).

    Those modelled; where the noise was estimated, with its scale.
    """
    if result.noise_source != "estimated":
        return leg.sigma
    return leg.sigma * np.sqrt(result.reduced_chi2)


def residuals_table(result: CalibrationResult) -> Element:
    """Return residuals of each leg, and the standard deviations that the noise gives them."""
    rows = []
    for leg in result.legs:
        unit, factor = SHOWN[leg.unit]
        sigma = float(np.sqrt(np.mean(residual_sigma(result, leg) ** 2)))
        sizes = (f"{factor * value:.4f}" for value in (leg.rms_before, leg.rms_after, sigma))
        rows.append((leg.name, *sizes, unit, str(leg.n_poses)))
    heads = ("leg", "rms before", "rms after", "σ", "unit", "poses")
    return table("Residuals, and what the noise alone makes of them (σ)", heads, rows, groups=1)


def observed_table(result: CalibrationResult) -> Element:
    """Return how the measured quantities of the platform fit, where poses are unknowns."""
    rows = []
    for one in result.observed:
        unit, factor = SHOWN[one.unit]
        sizes = (f"{factor * value:.4f}" for value in (one.rms, one.sigma))
        rows.append((one.name, str(one.count), *sizes, unit))
    heads = ("measured", "rows", "rms misfit", "σ", "unit")
    return table("The platform as measured, against the estimated poses", heads, rows, groups=1)


def outliers_table(result: CalibrationResult, most: int = LISTED) -> Element:
    """Return the rows that do not fit, the worst of them."""
    every = {leg.name for leg in result.legs}
    rows = [
        (
            str(one.row + 1),
            f"{one.sigma:.1f}",
            "rejected" if one.weight == 0.0 else f"{one.weight:.2f}",
            "all legs" if set(one.legs) == every else ", ".join(one.legs),
            one.why,
        )
        for one in result.outliers[:most]
    ]
    heads = ("data row", "residual [σ]", "weight", "of", "what")
    return table("Rows that do not fit, the worst first", heads, rows)


def _cells(p: IdentifiedParameter) -> tuple[str, ...]:
    """Return the cells of a parameter in the unit in which people read it."""
    unit, factor = SHOWN[p.unit]
    half = factor * (p.high - p.low) / 2
    digits = _digits(half)
    change = p.identified - p.nominal
    return (
        p.name,
        f"{factor * p.nominal:.{digits}f}",
        f"{factor * p.identified:.{digits}f}",
        f"{half:.{digits}f}" if half > 0.0 else "held" if half == 0.0 else "",
        unit,
        f"{factor * change:+.{digits}f}",
        f"{change / p.std:+.1f}" if p.std > 0.0 else "",
    )


def _digits(half: float) -> int:
    """Return how many digits behind the point an uncertainty leaves: two of its own."""
    return min(max(1 - floor(log10(half)), 0), 9) if half > 0.0 else 4
