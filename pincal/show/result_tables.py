"""Tables of a calibration, in the units in which people read them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pincal.calibration.checks.runs import RunComparison
from pincal.calibration.leg_result import IdentifiedParameter
from pincal.calibration.result import CalibrationResult
from pincal.show.results import (
    Series,
    legs_series,
    observed_series,
    parameters,
    readings_exact,
)
from pincal.words.numbers import VALUES, uneven
from pincal.words.table import Cell, Ends, Quantity, Table, Uncertainty, UnitOf, Value, columns

_MANY = 1e6  # standard errors, above which their number says nothing
_HEADS = ("parameter", "nominal", "identified", "± 95 %", "unit", "change", "change [σ]")
_SIZES = ("rms before", "rms after", "σ", "unit")
_SHIFT = "change [σ]: by how many standard errors the parameter moved"
_SIGMA = "σ: what the noise alone makes of residuals"
_CONDITION = "condition: of the leg's whitened identification Jacobian, columns scaled"


def calibration_tables(result: CalibrationResult) -> list[Table]:
    """Return all tables of a calibration that a terminal shows."""
    tables = [parameters_table(result), legs_table(result)]
    tables += [outside_table(result)] if result.external else []
    tables += [observed_table(result)] if result.observed else []
    tables += [outliers_table(result)] if result.outliers and result.loss != "none" else []
    return tables


def parameters_table(result: CalibrationResult) -> Table:
    """Return identified parameters with 95 % intervals and changes."""
    given = [p.given.replace("fixed", "") for _, p in parameters(result)]
    more = ["given"] if any(given) else []
    return Table(
        f"{result.nominal.name}: parameters, nominal and identified",
        columns("leg", *_HEADS, *more, units=VALUES),
        [
            (leg.name, *_cells(p), *[one] * len(more))
            for (leg, p), one in zip(parameters(result), given, strict=True)
        ],
        "; ".join(filter(None, (f"{_SHIFT}{_chosen(result)}", result.nominal.labelled))),
        grouped=True,
    )


def _chosen(result: CalibrationResult) -> str:
    """Return what values and ± depend on, where freedoms were fixed by choice."""
    if not result.gauge:
        return ""
    return (
        ". Values and ± depend on what was fixed by choice, of equal parameters those nearest to "
        "nominal; errors of the platform do not"
    )


def _cells(p: IdentifiedParameter) -> tuple[Value, ...]:
    """Return the cells of a parameter below ``_HEADS``."""
    half, change = min(*p.ends, p.half), p.identified - p.nominal
    known = half > 0.0 and np.isfinite(p.std)
    none = Cell(None, "∞" if half else p.given or "held")
    interval = Ends(*p.ends, p.unit) if uneven(*p.ends) else Uncertainty(half, p.unit)
    return (
        p.name,
        Quantity(p.nominal, p.unit, half),
        Quantity(p.identified, p.unit, half),
        interval if known else none,
        UnitOf(p.unit),
        Cell(change, "") if p.given == "fixed" else Quantity(change, p.unit, half, sign="+"),
        Cell(change / p.std, _moved(change / p.std)) if 0.0 < p.std < np.inf else None,
    )


def _moved(sigmas: float) -> str:
    """Return by how many standard errors a parameter moved, or that they are many."""
    return f"{sigmas:+.1f}" if abs(sigmas) < _MANY else "> 1e6"


def outside_table(result: CalibrationResult) -> Table:
    """Return the unknowns outside the mechanism: frames and targets."""
    return Table(
        "Outside the mechanism",
        columns("unknown", "start", *_HEADS[2:5], units=VALUES),
        [(p.id, *_cells(p)[1:5]) for p in result.external],
        "tracker: where the base is in the frame of the measurements (rx, ry, rz a rotation "
        "vector); others: where what was measured is on the platform; start: where the search "
        f"began, measured positions laid on those of the nominal machine{_chosen(result)}",
    )


def legs_table(result: CalibrationResult) -> Table:
    """Return residuals, rank and condition of each leg."""
    exact = readings_exact(result)
    found = Table(
        "Legs: residuals, rank and condition",
        columns("leg", *_SIZES, "poses", "rank", "condition:.3g"),
        [
            (
                leg.name,
                *_sizes(one),
                leg.n_poses,
                Cell(leg.rank, f"{leg.rank} of {len(leg.parameters)}"),
                leg.condition,
            )
            for leg, one in zip(result.legs, legs_series(result), strict=True)
        ],
        f"{_SIGMA}; {_CONDITION}",
    )
    if not exact:
        return found
    found = found.only("leg", "poses", "rank", "condition", caption=_CONDITION)
    return replace(found, title="Legs; readings were taken as exact")


def residuals_table(result: CalibrationResult) -> Table:
    """Return the residuals of the legs alone."""
    found = legs_table(result).only("leg", *_SIZES, "poses", caption=_SIGMA)
    return replace(found, title="Residuals of the legs")


def rank_table(result: CalibrationResult) -> Table:
    """Return rank and condition of the legs alone."""
    found = legs_table(result).only("leg", "rank", "condition", caption=_CONDITION)
    return replace(found, title="Rank and condition of the legs")


def observed_table(result: CalibrationResult) -> Table:
    """Return how the measured quantities of the platform fit, where poses are unknowns."""
    return Table(
        "The platform as measured, at the estimated poses",
        columns("measured", "rows", *_SIZES),
        [(one.name, len(one.rows), *_sizes(one)) for one in observed_series(result)],
    )


def _sizes(one: Series) -> tuple[Value, ...]:
    """Return root mean squares before and after, σ, and the unit."""
    return (*(Quantity(value, one.unit, format=".4f") for value in one.rms), UnitOf(one.unit))


def outliers_table(result: CalibrationResult, most: int = 20) -> Table:
    """Return the worst of the rows that do not fit."""
    every = {leg.name for leg in result.legs}
    more = len(result.outliers) - most
    return Table(
        f"Rows that do not fit, the worst first (robust loss: {result.loss})",
        columns("data row", "residual [σ]:.1f", "weight:.2f", "of", "what"),
        [
            (
                one.row + 1,
                one.sigma,
                Cell(0.0, "rejected") if one.weight == 0.0 else one.weight,
                "all legs" if set(one.legs) == every else ", ".join(one.legs),
                f"{one.quantity} off by {one.off:.1f} σ",
            )
            for one in result.outliers[:most]
        ],
        f"and {more} more in result.json" if more > 0 else "",
    )


def files_table(files: Sequence[tuple[str, str]]) -> Table:
    """Return files that were read, and their SHA-256."""
    return Table("Files read, and their SHA-256", columns("file", "SHA-256"), files)


def runs_table(runs: RunComparison) -> Table:
    """Return the spread of parameters over runs against their standard errors."""
    return Table(
        "Spread of the parameters over the runs, against their standard errors, in SI",
        columns("parameter", "spread:.3g", "predicted:.3g"),
        list(zip(runs.names, runs.spread.tolist(), runs.predicted.tolist(), strict=True)),
    )
