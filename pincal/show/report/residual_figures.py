"""Figures of residuals: against the row, each series in a lane of its own, and how they spread."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from pincal.show.pictures.files import on_page
from pincal.show.pictures.parts import NORMAL, Drawn, draw_strokes, page_figure
from pincal.show.report.answers import Findings
from pincal.show.result_tables import Series, noisy_series, whose
from pincal.show.style import IDENTIFIED, OUTLIER, PAGE, look, other_look
from pincal.types import Array
from pincal.words import plots as words
from pincal.words.numbers import SMALL, per_si

_FULL = 0.86  # of a lane's height, what values take
_TICKS = MaxNLocator(4, steps=(1, 2, 5, 10))


@dataclass(frozen=True)
class _Lane:
    """Part of the height of axes, in which a series is drawn; lanes have height 1."""

    middle: float
    """Where it is in the axes."""
    low: float
    """Least value in it, in the unit in which it is read."""
    high: float

    def at(self, values: Array) -> Array:
        """Return where values are in the axes."""
        shares = (values - (self.low + self.high) / 2) / (self.high - self.low)
        return np.asarray(self.middle + _FULL * shares)

    @property
    def ticks(self) -> Array:
        """Round values in it."""
        values = np.asarray(_TICKS.tick_values(self.low, self.high))
        return np.asarray(values[(values >= self.low) & (values <= self.high)])


def _lanes(series: list[Series], shown: list[Array]) -> list[_Lane]:
    """Return a lane for what is shown of each series, those of a kind with the same limits."""
    kinds = [(one.unit, one.of_leg) for one in series]
    found = []
    for place, kind in enumerate(kinds):
        alike = [own for own, other in zip(shown, kinds, strict=True) if other == kind]
        values = np.concatenate([np.zeros(1), *(own.ravel() for own in alike)])
        values = values[np.isfinite(values)]
        low, high = float(values.min()), float(values.max())
        found.append(_Lane(-float(place), low, high if high > low else low + 1.0))
    return found


@on_page("figure-residuals")
def residuals_figure(found: Findings) -> Drawn:
    """Return residuals before and after against the row, a lane for each series."""
    series = noisy_series(found.result)
    high = min(1.25 * len(series), max(6.4, 0.75 * len(series)))  # a table and these fill a page
    drawn = page_figure(0.7 + high, left=0.95)
    left, right = drawn.subplots(1, 2, sharex=True)
    factors = [per_si(one.unit) for one in series]
    before = [factor * one.before for one, factor in zip(series, factors, strict=True)]
    after = [factor * one.after for one, factor in zip(series, factors, strict=True)]
    bounds = [NORMAL * factor * one.spread for one, factor in zip(series, factors, strict=True)]
    wide = [np.concatenate((a, b, -b)) for a, b in zip(after, bounds, strict=True)]
    lanes = _lanes(series, before), _lanes(series, wide)
    for index, one in enumerate(series):
        rows, many = one.rows + 1.0, len(one.rows) > PAGE.many
        colour, marker, _ = look(index) if one.of_leg else other_look(index)
        style: dict[str, Any] = {"color": colour, "rasterized": many, "ms": 3}
        left.plot(rows, lanes[0][index].at(before[index]), marker, mfc="none", **style)
        lane = lanes[1][index]
        right.plot(rows, lane.at(after[index]), marker, **style)
        ends = [np.stack((rows, lane.at(end)), axis=1) for end in (-bounds[index], bounds[index])]
        draw_strokes(right, ends[0], ends[1], colors="0.8", lw=3, zorder=0, rasterized=many)
        _mark_outliers(right, found, one, lane.at(after[index]), lane.middle + 0.45)
        place = (-0.275, lane.middle)
        said: dict[str, Any] = {"rotation": 90, "ha": "center", "va": "center", "size": 8}
        name = f"{one.name}\n[{SMALL[one.unit]}]"
        left.text(*place, name, transform=left.get_yaxis_transform(), **said)
    for axes, own, title in zip((left, right), lanes, words.NOMINAL_IDENTIFIED, strict=True):
        _name_lanes(axes, own)
        axes.set_title(title)
        axes.set_xlabel(words.ROW)
    return drawn, words.residuals(whose(series))


def _name_lanes(axes: Axes, lanes: list[_Lane]) -> None:
    """Write the values of lanes beside axes, and draw zeros and what is between lanes."""
    ticks = [(float(lane.at(value)), _short(value)) for lane in lanes for value in lane.ticks]
    axes.set_yticks([at for at, _ in ticks], [said for _, said in ticks])
    axes.set_ylim(0.5 - len(lanes), 0.5)
    for lane in lanes:
        axes.axhline(float(lane.at(np.zeros(()))), color="0.5", lw=0.6, zorder=0)
        if lane is not lanes[0]:
            axes.axhline(lane.middle + 0.5, color="0.2", lw=0.8, zorder=0)


def _short(value: float) -> str:
    """Return a round number in few letters."""
    return f"{value:g}".replace("e-0", "e-").replace("-", "−")


def _mark_outliers(axes: Axes, found: Findings, series: Series, after: Array, top: float) -> None:
    """Ring rows that do not fit, and name the worst six.

    Args:
        axes: Where to draw.
        found: What was found.
        series: Residuals in a lane.
        after: Where those after are in the axes, shape (N,).
        top: Where the lane's upper edge is.
    """
    place = {int(row): i for i, row in enumerate(series.rows)}
    own = [one for one in found.result.outliers if not series.of_leg or series.name in one.legs]
    for rank, one in enumerate(own):
        row = one.row + 1
        there = one.row in place
        where = row, float(after[place[one.row]]) if there else top
        if there:
            axes.plot(*where, "o", ms=8, mfc="none", mec=OUTLIER, mew=1.2)
        else:
            axes.plot(*where, "X", ms=6, color=OUTLIER, clip_on=False)
        if rank < 6:
            beside: dict[str, Any] = {"xytext": (6, 2), "textcoords": "offset points", "size": 7}
            axes.annotate(str(row), where, **beside)


@on_page("figure-histogram")
def histogram_figure(found: Findings) -> Drawn:
    """Return the distribution of residuals in standard deviations, against the normal one.

    None if all that was measured is exact.
    """
    white = np.concatenate([one.standardised for one in noisy_series(found.result)])
    if not len(white := white[np.isfinite(white)]):
        return None
    drawn = page_figure(2.6)
    axes = drawn.subplots()
    shown = min(max(4.0, float(np.ceil(np.abs(white).max()))), 8.0)
    bins = np.linspace(-shown, shown, int(4 * shown) + 1).tolist()
    looks: dict[str, Any] = {
        "color": IDENTIFIED,
        "edgecolor": "white",
        "label": words.counted(len(white)),
    }
    axes.hist(white.clip(-shown, shown), bins, density=True, **looks)
    z = np.linspace(-shown, shown, 200)
    normal = np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi)
    axes.plot(z, normal, "k--", lw=1.2, label=words.NORMALLY)
    axes.set(xlabel=words.WHITE, ylabel=words.DENSITY)
    axes.legend(frameon=False)
    outside = 100 * float((np.abs(white) > NORMAL).mean())
    return drawn, words.distribution(outside)
