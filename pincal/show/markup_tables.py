"""Tables of a calibration as HTML, in the units in which people read them."""

from __future__ import annotations

import numpy as np

from pincal.calibration.result import CalibrationResult
from pincal.model.mechanism import Mechanism
from pincal.show.markup import Element, table
from pincal.show.parameters import HEADS, PLAIN, READ, given_cells, parameter_cells
from pincal.show.series import observed_cells, observed_heads, residual_sigma
from pincal.show.tables import SHOWN

LISTED = 50  # outliers in the table; all are in result.json


def parameters_table(result: CalibrationResult) -> Element:
    """Return all parameters by leg."""
    rows = [
        [leg.name if place == 0 else "", *parameter_cells(p)]
        for leg in result.legs
        for place, p in enumerate(leg.parameters)
    ]
    heads = ["leg", *HEADS]
    if (given := given_cells(result)) is not None:
        heads.append("given")
        rows = [[*row, words] for row, words in zip(rows, given, strict=True)]
    caption = "Parameters: nominal and identified, and by how many standard errors (σ) they changed"
    return table(caption, heads, rows, groups=1)


def nominal_table(mechanism: Mechanism) -> Element:
    """Return the nominal parameters of a mechanism by leg."""
    rows = []
    for leg in mechanism.legs:
        for place, (name, value) in enumerate(leg.nominal_by_name.items()):
            digits, (unit, factor) = PLAIN[leg.units[name]], READ[leg.units[name]]
            shown = f"{factor * value:.{digits}f}"
            rows.append((leg.name if place == 0 else "", name, shown, unit))
    return table("Nominal parameters", ("leg", "parameter", "nominal", "unit"), rows, groups=1)


def external_table(result: CalibrationResult) -> Element:
    """Return the unknowns outside the mechanism."""
    return table(
        "Outside the mechanism: where its base stands in the frame of the measurements "
        "(rx, ry, rz a rotation vector), and where what was measured sits on the platform",
        ("unknown", "start", *HEADS[2:5]),
        [parameter_cells(p)[:5] for p in result.external],
    )


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
        sizes, unit = observed_cells(result, one)
        rows.append((one.name, str(one.count), *sizes, unit))
    heads = ("measured", "rows", *observed_heads(result), "unit")
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
            f"{one.quantity} off by {one.off:.1f} σ",
        )
        for one in result.outliers[:most]
    ]
    heads = ("data row", "residual [σ]", "weight", "of", "what")
    return table("Rows that do not fit, the worst first", heads, rows)
