"""What people hold, in notebooks and in print: their ``_repr_html_`` and ``__str__``."""

from __future__ import annotations

import numpy as np

from pincal.calibration.result import CalibrationResult
from pincal.calibration.runs import RunComparison
from pincal.calibration.validation import Validation
from pincal.design.forecast import Forecast
from pincal.design.select import Selection
from pincal.model.measurements import Plan
from pincal.model.mechanism import Mechanism
from pincal.show import result_tables, summary
from pincal.show.answers import warning_lines
from pincal.show.pictures.files import svg_figure
from pincal.show.pictures.picture import picture
from pincal.show.result_tables import calibration_tables, runs_table
from pincal.show.summary import (
    check_lines,
    held_out_line,
    method_line,
    missed_lines,
    noise_line,
    systematic_lines,
    tie_lines,
    tolerance_lines,
    weak_lines,
)
from pincal.show.tables import nominal_table, selection_table, standard_errors
from pincal.words.sentences import sentences
from pincal.words.table import Table, columns
from pincal.words.wording import rendered

_ROWS = 12  # of a plan, in a notebook


def mechanism_html(mechanism: Mechanism) -> str:
    """Return a mechanism: a picture and its nominal parameters."""
    caption = f"{mechanism.name} at home"
    drawn = svg_figure("figure-mechanism", lambda: (picture(mechanism).figure(), caption))
    table = nominal_table(mechanism)
    return rendered("mechanism.html", mechanism=mechanism, figure=drawn, table=table)


def result_html(result: CalibrationResult) -> str:
    """Return a calibration: what to know first, parameters, residuals."""
    warnings = warning_lines(result)
    return rendered(
        "result.html", result=result, warnings=warnings, tables=result_tables, summary=summary
    )


def selection_html(selection: Selection) -> str:
    """Return what a selection gives each leg, and its first poses."""
    return f"{selection_table(selection).__html__()}{plan_html(selection.plan)}"


def forecast_html(forecast: Forecast) -> str:
    """Return the standard errors to expect, and what the plan determines."""
    words = [] if forecast.rank.complete else [f"Not determined apart: {forecast.rank.describe()}."]
    lines = [*words, *weak_lines(forecast.weak, forecast.mechanism)]
    return rendered("held.html", tables=[standard_errors(forecast)], lines=lines)


def plan_html(plan: Plan) -> str:
    """Return the first rows of a plan or of measurements, in SI; empty where not measured."""
    parts = [("coordinate", plan.poses)]
    parts += [("reading", plan.readings)] if plan.readings is not None else []
    names = [f"{kind} {i + 1}:.6g" for kind, array in parts for i in range(array.shape[1])]
    values = np.concatenate([array for _, array in parts], axis=1)[:_ROWS]
    sets = plan.sets or ("",) * len(plan)
    rows = [
        (i + 1, *([name] if plan.sets else []), *(v if np.isfinite(v) else None for v in row))
        for i, (name, row) in enumerate(zip(sets, values.tolist(), strict=False))
    ]
    heads = columns("row", *(["set"] if plan.sets else []), *names)
    omitted = len(plan) - len(rows)
    return Table(
        repr(plan), heads, rows, f"and {omitted} more rows" if omitted > 0 else ""
    ).__html__()


def validation_html(validation: Validation) -> str:
    """Return how rows that a fit has not seen compare with its own."""
    table = Table(
        f"{validation.rows} rows held out in {validation.folds} folds",
        columns("rows", "miss by [σ]:.3g"),
        [
            ("of the fit", validation.fit),
            ("held out", validation.held_out),
            ("expected", validation.expected),
        ],
    )
    lines = [held_out_line(validation), *missed_lines(validation), *sentences(validation.findings)]
    return rendered("held.html", tables=[table], lines=lines)


def runs_html(runs: RunComparison) -> str:
    """Return how well runs agree, parameter by parameter."""
    return rendered("held.html", tables=[runs_table(runs)], lines=str(runs).splitlines())


def result_text(result: CalibrationResult) -> str:
    """Return a calibration as a page of text: how it was made, tables, what to know first."""
    parts = [f"{result.nominal.name}: {method_line(result)}; {result.message}"]
    if result.converged:
        parts += [str(table) for table in calibration_tables(result)]
        lines = [noise_line(result), *systematic_lines(result), *tie_lines(result)]
        lines += [*tolerance_lines(result), *check_lines(result)]
        parts.append("\n".join(lines))
    return "\n\n".join([*parts, *(f"warning: {warning}" for warning in warning_lines(result))])
