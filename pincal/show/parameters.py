"""Identified parameters in cells: a row in one unit, to the digits that its uncertainty leaves."""

from __future__ import annotations

from math import floor, log10

from pincal.calibration.result import CalibrationResult, IdentifiedParameter

#: Units of a parameter's row, and how many of it: values as in mechanism.yaml, lengths in mm.
READ = {"m": ("mm", 1e3), "rad": ("rad", 1.0), "1": ("", 1.0)}
HEADS = ("parameter", "nominal", "identified", "± 95 %", "unit", "change", "change [σ]")
PLAIN = {"m": 3, "rad": 6, "1": 6}  # digits behind the point where there is no uncertainty


def parameter_cells(p: IdentifiedParameter) -> tuple[str, ...]:
    """Return the cells of a parameter below ``HEADS``."""
    unit, factor = READ[p.unit]
    half = factor * (p.high - p.low) / 2
    digits = _digits(half) if half > 0.0 else PLAIN[p.unit]
    change = p.identified - p.nominal
    return (
        p.name,
        f"{factor * p.nominal:.{digits}f}",
        f"{factor * p.identified:.{digits}f}",
        f"{half:.{digits}f}" if half > 0.0 else (p.given or "held") if half == 0.0 else "",
        unit,
        "" if p.given == "fixed" else f"{factor * change:+.{digits}f}",
        f"{change / p.std:+.1f}" if p.std > 0.0 else "",
    )


def given_cells(result: CalibrationResult) -> list[str] | None:
    """Return which parameters are tied or have priors, for a column; None where none has."""
    found = [p.given.replace("fixed", "") for leg in result.legs for p in leg.parameters]
    return found if any(found) else None


def _digits(half: float) -> int:
    """Return how many digits behind the point an uncertainty leaves: two of its own."""
    return min(max(1 - floor(log10(half)), 0), 9)
