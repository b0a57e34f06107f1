"""A machine over months, to read: what changed, how accurate it is, when to check it again."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from numpy.typing import NDArray

from pincal.calibration.history import Change, History
from pincal.model.checks import counted
from pincal.model.parameter import Parameter
from pincal.show.answers import Answer
from pincal.show.pictures.files import page_figure
from pincal.show.report import Page
from pincal.show.style import GROUND, IDENTIFIED, OUTLIER
from pincal.types import Array
from pincal.words.numbers import SMALL, VALUES, amount, capital, fixed, listed, per_si
from pincal.words.table import Cell, Table, Value
from pincal.words.wording import rendered

_LIMIT = 3.0  # standard errors within which an individuals chart has its points
_MONTH = 30.44  # days
_CHARTS = 6  # parameters that are drawn


@dataclass(eq=False)
class HistoryPage(Page):
    """The page of a machine's history."""

    history: History
    accuracy: float | None = None
    """Wanted of the platform, [m] or [rad]."""

    @property
    def lines(self) -> list[str | Table]:
        """The verdict, what changed, and a table, as ``pincal history`` prints them."""
        changed, drift, due = self._changed, self._drift, self._due
        mark = "⚠" if changed or "now" in due else "✓"
        name, count = self.history.results[0].nominal.name, len(self.history.dates)
        since = f"in {counted(count, 'calibration')} since {self.history.dates[0]:%Y-%m-%d}"
        first = f"{mark} {name}: {'changed' if changed else 'unchanged'} {since} · {due}"
        return [first, *changed, drift, self._table]

    def __str__(self) -> str:
        return "\n".join(map(str, self.lines))

    @cached_property
    def _changed(self) -> list[str]:
        names = self.history.names
        pairs = zip(names, names[1:], self.history.changes, strict=False)
        return [_sentence(change, a, b) for a, b, changes in pairs for change in changes]

    @property
    def _drift(self) -> str:
        if (drift := self.history.drift) is None:
            return "drift: too few calibrations, a trend needs three dates"
        unit = self.history.results[0].nominal.platform.units[0]
        rate, twice = (amount(_MONTH * value, unit, 2) for value in drift)
        return f"drift at the measured poses: {rate} a month (± {twice})"

    @property
    def _due(self) -> str:
        due = None if self.accuracy is None else self.history.due(self.accuracy)
        if self.history.drift is None:
            return "next check: too few calibrations to say, three dates at least"
        if self.accuracy is None:
            return "next check: --accuracy 0.1mm says when"
        if due is None or due <= self.history.dates[-1]:
            return "next check: now"
        return f"next check: not before {due:%Y-%m-%d}"

    @property
    def _table(self) -> Table:
        rows: list[list[Value]] = []
        entries = zip(self.history.names, self.history.dates, self.history.results, strict=True)
        for name, day, result in entries:
            error, kind = result.expected_error(), int(not result.nominal.platform.lengths)
            size, limit = (error.position, error.orientation)[kind], error.limit[kind]
            unit = result.nominal.platform.units[0]
            warm = result.measurements.influences.get("temperature")
            mean = None if warm is None else float(np.nanmean(warm))
            sizes = [Cell(value, amount(value, unit)) for value in (size, limit)]
            row = [name, str(day), len(result.measurements), *sizes, result.reduced_chi2, mean]
            rows.append(row)
        columns = ["calibration", "date", "rows", "error", "95 %: ≤", "χ²", "temperature"]
        if all(row[-1] is None for row in rows):
            rows, columns = [row[:-1] for row in rows], columns[:-1]
        return Table("Accuracy at the measured poses (RMS)", columns, rows)

    @cached_property
    def _page(self) -> str:
        changed, history = self._changed, self.history
        count, (first, *_, last) = len(history.dates), history.dates
        due = capital(self._due.removeprefix("next check: "))
        verdict = "Yes" if changed else "No more than by the noise"
        note = (
            "Bars: 95 % intervals. Band: ± 3 standard errors about the mean, by variance, of all "
            "calibrations. Red: outside."
        )
        return rendered(
            "report.html",
            kind="history",
            name=history.results[0].nominal.name,
            description="",
            subtitle=f"{counted(count, 'calibration')}, {first} to {last}",
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
    """Return charts of parameters over time, of those first that strayed farthest."""
    charts = []
    for p in (p for leg in history.results[-1].legs for p in leg.parameters):
        entries = [result[p.id] for result in history.results]
        values, stds = np.array([(entry.identified, entry.std) for entry in entries]).T
        if not (np.isfinite(stds) & (stds > 0.0)).all():
            continue
        far = np.abs(values - np.average(values, weights=stds**-2.0)) / stds
        draw = partial(_draw, np.array(history.dates, dtype="datetime64[D]"), values, stds, p)
        charts.append((float(far.max()), p, draw))
    charts.sort(key=lambda chart: -chart[0])
    return [page_figure(p.id, draw, p.label or p.id, 2.4) for _, p, draw in charts[:_CHARTS]]


def _draw(days: NDArray[np.datetime64], values: Array, stds: Array, p: Parameter, ax: Axes) -> None:
    """Draw an individuals chart: values with their intervals, and the limits of each."""
    scale, mean = per_si(p.unit, VALUES), np.average(values, weights=stds**-2.0)
    outside, half = np.abs(values - mean) > _LIMIT * stds, scale * _LIMIT * stds
    ax.fill_between(days, scale * mean - half, scale * mean + half, color=GROUND, alpha=0.5, lw=0)
    ax.errorbar(days, scale * values, 1.96 * scale * stds, fmt="o", ms=4, color=IDENTIFIED)
    ax.plot(days[outside], scale * values[outside], "o", ms=6, color=OUTLIER)
    ax.ticklabel_format(axis="y", useOffset=False)
    ax.set_ylabel(f"{p.id} [{VALUES[p.unit]}]")


def _sentence(change: Change, before: str, after: str) -> str:
    """Return what a parameter changed by, between which calibrations."""
    p = change.parameter
    size = fixed(change.value, change.std, p.unit, SMALL, "+")
    alternatives = (
        f"; {listed(change.alternatives[:3], 'or')} would explain it as well"
        if change.alternatives
        else ""
    )
    sigmas = abs(change.value / change.std)
    moved = f"{p.id} moved by {size} {SMALL[p.unit]} ({sigmas:.0f} σ)"
    return f"{moved} between {before} and {after}{alternatives}"
