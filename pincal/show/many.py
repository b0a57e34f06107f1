"""Studies of many machines, and the history of a single machine, as lines, tables and a page."""

from collections import Counter
from functools import cached_property, partial

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy.special import ndtr, stdtrit

from pincal.calibration.history import History
from pincal.calibration.many import MonteCarlo, error_columns
from pincal.calibration.result import CalibrationResult
from pincal.errors import MeasurementError
from pincal.estimation.system import holm
from pincal.files.journal import FAILURE, Columns, Row
from pincal.model import Mechanism, Parameter, Plan
from pincal.model.checks import counted
from pincal.show import answers
from pincal.show.misses import workspace_errors
from pincal.show.report import Page
from pincal.show.style import GROUND, IDENTIFIED, OUTLIER, page_figure
from pincal.types import Array
from pincal.words.numbers import (
    SMALL,
    VALUES,
    amount,
    capital,
    chance,
    fixed,
    listed,
    measured,
    per_si,
)
from pincal.words.table import Cell, Table, Value
from pincal.words.wording import rendered

_QUANTILES = {"median": 0.5, "95 %": 0.95, "99 %": 0.99, "worst": 1.0}
_FAMILY, _ALARM = 5, 0.01  # fewest machines of a family; chance of an alarm in a sound line
_TESTS = 5  # tests per calibration, each with a false alarm for one sound machine in a hundred
_HEADS = {
    "before": "before calibration",
    "after": "after calibration",
    "worst": "after calibration, worst pose",
}
_LIMIT = 3.0  # control limits of an individuals chart, in standard errors
_MONTH = 30.44  # days
_CHARTS = 6  # parameters that are drawn


def montecarlo_lines(study: MonteCarlo) -> list[str | Table]:
    """Return a study's verdict, reasons of failures, quantiles of errors and shares of causes."""
    name, unit = study.mechanism.name, study.mechanism.platform.units[0]
    fine = study.columns[FAILURE] == ""
    causes = Counter(cause for cause in study.columns[FAILURE] if cause).most_common(3)
    failures = [f"{count} of {len(fine)} have no result: {cause}" for cause, count in causes]
    if not fine.any():
        return [f"✗ {name}: no machine could be calibrated", *failures]
    before, after = (amount(float(np.quantile(e, 0.95)), unit) for e in study.known)
    verdict = (
        f"{'✓' if fine.all() else '⚠'} {name}: 95 % of calibrated machines are within {after} "
        f"({before} before calibration)"
    )
    rows, costs = list[list[Value]](), list[list[Value]]()
    for head, errors in study.columns.items():
        key, _, unit = head.removesuffix("]").partition(" [")
        if key in _HEADS and not np.isnan(errors[fine]).any():
            sizes = np.quantile(errors[fine], [*_QUANTILES.values()]).tolist()
            rows.append([_HEADS[key], *(Cell(size, amount(size, unit)) for size in sizes)])
    title = f"Errors of the platform of {fine.sum()} machines, each over the workspace (RMS)"
    by_noise = 100.0
    for cost in study.costs():
        sigma = Cell(cost.sigma, amount(cost.sigma, cost.unit))
        costs.append([cost.name, sigma, 100.0 * cost.before, 100.0 * cost.after])
        by_noise -= 100.0 * cost.after
    costs.append(["noise of the measurements", None, None, by_noise])
    heads = ["", "tolerance (σ)", "before [%]:.0f", "after [%]:.0f"]
    shares = Table("Contributions to the mean square error", heads, costs)
    return [verdict, *failures, Table(title, ["", *_QUANTILES], rows), shares]


def montecarlo_text(study: MonteCarlo) -> str:
    """Return the output of ``pincal montecarlo``."""
    return "\n".join(map(str, montecarlo_lines(study)))


def row_columns(mechanism: Mechanism) -> list[str]:
    """Return the column heads of a table of calibrations, one machine a row."""
    texts = ["file", "sha256", FAILURE, "verdict"]
    values = [name for p in mechanism.parameters for name in (p.column, f"std {p.column}")]
    errors = error_columns(mechanism, "limit")
    return [*texts, "rows", "chi2", "p_value", "p_warnings", *errors, *values]


def row_of_result(result: CalibrationResult, workspace: Plan | None) -> Row:
    """Return the row of a calibration in such a table: verdict, accuracy, χ², parameters.

    Raises:
        MeasurementError: the fit did not converge.
    """
    if not result.converged:
        raise MeasurementError(f"the fit {result.message}")
    errors = workspace_errors(result, workspace)
    chances = [
        f.values.get("p_value", 2.0 * f.values.get("total", 0) * ndtr(-f.values.get("sigma", 0.0)))
        for f in result.findings
        if f.severity == "warning"
    ]
    row: Row = {
        "verdict": answers.verdict(result, errors)[0].replace(f" {result.nominal.name}:", ""),
        "rows": len(result.measurements),
        "chi2": result.reduced_chi2,
        "p_value": result.chi2_p_value,
        "p_warnings": float(min(chances, default=np.nan)),
    }
    parts = (errors.mean_before(), errors.mean_after(), errors.inside.limit)
    for name, sizes in zip(("before", "after", "limit"), parts, strict=True):
        row |= {f"{name} [{unit}]": size for unit, size in zip(("m", "rad"), sizes, strict=True)}
    for p in (p for leg in result.legs for p in leg.parameters):
        row |= {p.column: p.identified, f"std {p.column}": p.std}
    return row


def out_of_family(columns: Columns, mechanism: Mechanism) -> list[tuple[str, str]]:
    """Return files with a parameter outside the control limits of the other files, and a sentence.

    Each value is compared with the mean of the others by its externally studentised difference
    (Student's t); in one of a hundred sound families a value lies outside.
    """
    fine = columns[FAILURE] == ""
    n, outside = int(fine.sum()), list[tuple[str, str]]()
    if n < _FAMILY:
        return outside
    limit = float(stdtrit(n - 2, 1.0 - _ALARM / (2.0 * n * len(mechanism.parameters))))
    for p in mechanism.parameters:
        x = columns[p.column][fine]
        centred = x - x.mean()
        variances = (centred @ centred - n / (n - 1) * centred**2) / (n - 2)  # of the others
        sigma = np.sqrt(np.maximum(variances, 1e-12 * np.mean(centred**2)) * (1.0 + 1.0 / (n - 1)))
        differences = x - (x.sum() - x) / (n - 1)
        for i in np.flatnonzero(np.abs(differences) > limit * sigma):
            half, value = float(limit * sigma[i]), float(x[i])
            limits = measured(value - float(differences[i]), half, p.unit)
            text = f"{p.id} is {fixed(value, half, p.unit)}, outside {limits} of the others"
            outside.append((columns["file"][fine][i], text))
    return outside


def warned_by_chance(columns: Columns) -> NDArray[np.bool_]:
    """Return which machines have only warnings that a sound line has by chance, shape (N,).

    All tests of a line are one family with the level of a single test (Holm 1979).
    """
    p_values = columns["p_warnings"]
    corrected = holm(np.nan_to_num(p_values, nan=1.0), _TESTS * len(p_values))
    return np.asarray(np.isfinite(p_values) & (corrected > _ALARM))


def batch_lines(columns: Columns, mechanism: Mechanism) -> tuple[list[str | Table], list[str]]:
    """Return the verdict on many calibrations with machines out of family; and the bad files."""
    fine, unit = columns[FAILURE] == "", mechanism.platform.units[0]
    outside, by_chance = out_of_family(columns, mechanism), warned_by_chance(columns)
    rows, bad = list[list[Value]](), list[str]()
    expected = columns[f"after [{unit}]"]
    for i, (name, verdict) in enumerate(zip(columns["file"], columns["verdict"], strict=True)):
        if by_chance[i]:
            p_value = chance(columns["p_warnings"][i])
            verdict = f"⚠{verdict[1:]}, expected by chance among {len(fine)} machines ({p_value})"
        size = Cell(expected[i], amount(expected[i], unit)) if np.isfinite(expected[i]) else None
        rows.append([name, size, verdict or f"✗ no result: {columns[FAILURE][i]}"])
        bad += [name] * (verdict[:1] in ("", "✗"))
    mark = "⚠" if (bad or outside) and fine.any() else "✗" if bad else "✓"
    parts = [f"{len(fine) - len(bad)} of {len(fine)} machines calibrated"]
    if fine.any():
        parts.append(f"the worst to {amount(float(np.max(expected[fine])), unit)}")
    parts.append(f"{len({name for name, _ in outside})} out of family")
    parts += [f"{by_chance.sum()} with warnings expected by chance"] * bool(by_chance.any())
    lines: list[str | Table] = [f"{mark} {mechanism.name}: {' · '.join(parts)}"]
    lines += [f"out of family: {name}: {text}" for name, text in outside]
    return [*lines, Table("", ["machine", "error", "verdict"], rows)], bad


class HistoryPage(Page):
    """The page of a machine's history; ``accuracy`` is the one required, [m] or [rad]."""

    def __init__(self, history: History, accuracy: float | None = None) -> None:
        self.history, self.accuracy = history, accuracy

    @property
    def lines(self) -> list[str | Table]:
        """The verdict, changed parameters, drift and a table, as ``pincal history`` prints them."""
        history, name = self.history, self.history.results[0].nominal.name
        trusted = history.results[-1].promises and "now" not in self._due
        mark = "✓" if trusted and not self._changed else "⚠"
        since = f"in {counted(len(history.dates), 'calibration')} since {history.dates[0]:%Y-%m-%d}"
        first = f"{mark} {name}: {'' if self._changed else 'un'}changed {since} · {self._due}"
        return [first, *self._changed, self._drift, self._table]

    def __str__(self) -> str:
        return "\n".join(map(str, self.lines))

    @cached_property
    def _changed(self) -> list[str]:
        """One line for each change of a parameter between successive calibrations."""
        lines, names = list[str](), self.history.names
        for before, after, changes in zip(names, names[1:], self.history.changes, strict=False):
            for change in changes:
                p, others = change.parameter, listed(change.alternatives[:3] or [""], "or")
                size = fixed(change.value, change.std, p.unit, SMALL, "+")
                moved = f"{p.id} moved by {size} {SMALL[p.unit]}"
                sigmas = f"({abs(change.value / change.std):.0f} σ) between {before} and {after}"
                as_well = f"; {others} would explain it as well" * bool(others)
                lines.append(f"{moved} {sigmas}{as_well}")
        return lines

    @property
    def _drift(self) -> str:
        if (drift := self.history.drift) is None:
            return f"drift: too few calibrations; a trend needs three dates{self._since}"
        unit = self.history.results[0].nominal.platform.units[0]
        rate, twice = (amount(_MONTH * value, unit, 2) for value in drift)
        return f"drift at the measured poses{self._since}: {rate} a month (± {twice})"

    @property
    def _since(self) -> str:
        steady = self.history.since_jump
        return "" if steady is self.history else f" since the jump before {steady.names[0]}"

    @property
    def _due(self) -> str:
        due = None if self.accuracy is None else self.history.due(self.accuracy)
        if self.history.drift is None:
            needed = f"a trend needs calibrations on three dates{self._since}"
            return f"next check: not known, since {needed}"
        if self.accuracy is None:
            return "next check: give --accuracy (such as 0.1mm) to compute it"
        if due is None or due <= self.history.dates[-1]:
            return "next check: now"
        return f"next check: not before {due:%Y-%m-%d}"

    @property
    def _table(self) -> Table:
        rows: list[list[Value]] = []
        entries = zip(self.history.names, self.history.dates, self.history.results, strict=True)
        for name, day, result in entries:
            error, unit = result.expected_error(), result.nominal.platform.units[0]
            kind = ("m", "rad").index(unit)
            warm = result.measurements.influences.get("temperature")
            sizes = [(error.position, error.orientation)[kind], error.limit[kind]]
            shown = [Cell(v, amount(v, unit) if np.isfinite(v) else "none") for v in sizes]
            mean = None if warm is None else float(np.nanmean(warm))
            rows.append(
                [name, str(day), len(result.measurements), *shown, result.reduced_chi2, mean]
            )
        columns = ["calibration", "date", "rows", "error", "95 %: ≤", "χ²", "temperature"]
        if all(row[-1] is None for row in rows):
            rows, columns = [row[:-1] for row in rows], columns[:-1]
        return Table("Accuracy at the measured poses (RMS)", columns, rows)

    @cached_property
    def _page(self) -> str:
        changed, history, Answer = self._changed, self.history, answers.Answer
        verdict = "Yes" if changed else "No more than by the noise"
        count, (first, *_, last) = counted(len(history.dates), "calibration"), history.dates
        due = capital(self._due.removeprefix("next check: "))
        note = (
            "Bars: 95 % intervals. Band: ± 3 standard errors about the weighted mean of all "
            "calibrations. Red: outside."
        )
        return rendered(
            "report.html",
            kind="history",
            name=history.results[0].nominal.name,
            description="",
            subtitle=f"{count}, {first} to {last}",
            warnings=[],
            answers=[
                Answer("Did it change?", verdict, "care" if changed else "good", [changed]),
                Answer("When to check it next?", due, "", [capital(self._drift) + "."]),
            ],
            sections=[
                {"name": "accuracy", "title": "Accuracy", "parts": [self._table]},
                {"name": "parameters", "title": "Parameters", "parts": [note, *_charts(history)]},
            ],
        )


def _charts(history: History) -> list[Markup]:
    """Return charts of parameters over time, the largest deviation in standard errors first."""
    charts = []
    for p in (p for leg in history.results[-1].legs for p in leg.parameters):
        entries = [result[p.id] for result in history.results]
        values, stds = np.array([(entry.identified, entry.std) for entry in entries]).T
        if (np.isfinite(stds) & (stds > 0.0)).all():
            far = np.abs(values - np.average(values, weights=stds**-2.0)) / stds
            draw = partial(_draw, np.array(history.dates, "datetime64[D]"), values, stds, p)
            charts.append((float(far.max()), p, draw))
    charts.sort(key=lambda chart: -chart[0])
    return [page_figure(p.id, draw, p.label or p.id, 2.4) for _, p, draw in charts[:_CHARTS]]


def _draw(days: NDArray[np.datetime64], values: Array, stds: Array, p: Parameter, ax: Axes) -> None:
    """Draw an individuals chart: values with 95 % intervals, and the control limits of each."""
    scale, mean = per_si(p.unit, VALUES), np.average(values, weights=stds**-2.0)
    outside, half = np.abs(values - mean) > _LIMIT * stds, scale * _LIMIT * stds
    ax.fill_between(days, scale * mean - half, scale * mean + half, color=GROUND, alpha=0.5, lw=0)
    ax.errorbar(days, scale * values, 1.96 * scale * stds, fmt="o", ms=4, color=IDENTIFIED)
    ax.plot(days[outside], scale * values[outside], "o", ms=6, color=OUTLIER)
    ax.ticklabel_format(axis="y", useOffset=False)
    ax.set_ylabel(f"{p.id} [{VALUES[p.unit]}]")
