"""Figures of residuals: of the legs or, if their readings are exact, of what was measured."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pincal.show.pictures.svg import SvgFigure, on_page
from pincal.show.report.findings import Findings
from pincal.show.results import Series, noisy_series, whose
from pincal.show.style import COLOURS, HEIGHT, MANY, WIDTH, look
from pincal.words.numbers import FACTORS, SMALL

_NAMED = 6  # outliers with their row written beside them


@on_page("figure-residuals")
def residuals_figure(found: Findings) -> tuple[Figure, str]:
    """Return residuals before and after against the row, one line of panels for each series."""
    series = noisy_series(found.result)
    drawn = Figure(figsize=(WIDTH, min(0.5 + 1.25 * len(series), HEIGHT)), layout="constrained")
    panels = drawn.subplots(len(series), 2, sharex=True, sharey="col", squeeze=False)
    for index, (one, (left, right)) in enumerate(zip(series, panels, strict=True)):
        unit = SMALL[one.unit]
        factor, rows, many = FACTORS[unit], one.rows + 1, len(one.rows) > MANY
        colour, marker, _ = look(index)
        style = {"color": colour, "rasterized": many, "ms": 3}
        left.plot(rows, factor * one.before, marker, mfc="none", **style)
        right.plot(rows, factor * one.after, marker, **style)
        bound = 1.96 * factor * one.sigma
        ends = np.stack((np.stack((rows, -bound), 1), np.stack((rows, bound), 1)), 1)
        bars = LineCollection(list(ends), colors="0.8", lw=3, zorder=0, rasterized=many)
        right.add_collection(bars)
        _mark_outliers(right, found, one, factor)
        left.set_ylabel(f"{one.name} [{unit}]")
        for axes in (left, right):
            axes.axhline(0.0, color="0.5", lw=0.6, zorder=0)
            axes.tick_params(labelleft=True)
    panels[0][0].set_title("nominal parameters (before)")
    panels[0][1].set_title("identified parameters (after)")
    for axes in panels[-1]:
        axes.set_xlabel("data row")
    return drawn, (
        f"Residuals of each {whose(series)} against the row of the measurements, before and "
        "after; the scales differ. Grey bars: where 95 of 100 are expected by the noise. Rings: "
        "rows that do not fit the others; crosses at the upper edge: rows that were rejected."
    )


def _mark_outliers(axes: Axes, found: Findings, series: Series, factor: float) -> None:
    """Ring rows that do not fit, and name the worst."""
    place = {int(row): i for i, row in enumerate(series.rows)}
    bad, named = COLOURS[1], 0
    for one in found.result.outliers:
        if series.of_leg and series.name not in one.legs:
            continue
        row = one.row + 1
        if one.row in place:
            where, system = (row, factor * float(series.after[place[one.row]])), axes.transData
            axes.plot(*where, "o", ms=8, mfc="none", mec=bad, mew=1.2)
        else:
            where, system = (row, 0.93), axes.get_xaxis_transform()
            axes.plot(*where, "X", ms=6, color=bad, transform=system, clip_on=False)
        if named < _NAMED:
            axes.annotate(
                str(row), where, xycoords=system, xytext=(6, 2), textcoords="offset points", size=7
            )
            named += 1


def histogram_figure(found: Findings) -> SvgFigure | None:
    """Return the distribution of residuals in standard deviations, against the normal one.

    None if all that was measured is exact.
    """
    series = noisy_series(found.result)
    sigma = np.concatenate([one.sigma for one in series])
    noisy = sigma > 0.0
    if not noisy.any():
        return None
    white = np.concatenate([one.after for one in series])[noisy] / sigma[noisy]
    return _histogram(white[np.isfinite(white)])


@on_page("figure-histogram")
def _histogram(white: NDArray[np.float64]) -> tuple[Figure, str]:
    drawn = Figure(figsize=(WIDTH, 2.4), layout="constrained")
    axes = drawn.subplots()
    shown = min(max(4.0, float(np.ceil(np.abs(white).max(initial=0.0)))), 8.0)
    bins = np.linspace(-shown, shown, int(4 * shown) + 1)
    share = np.full(len(white), 1.0 / max(len(white), 1) / (bins[1] - bins[0]))
    axes.hist(
        white.clip(-shown, shown),
        bins.tolist(),
        weights=share,
        color=COLOURS[5],
        edgecolor="white",
        label=f"{len(white)} residuals",
    )
    z = np.linspace(-shown, shown, 200)
    normal = np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi)
    axes.plot(z, normal, "k--", lw=1.2, label="normal distribution")
    axes.set(xlabel="residual [standard deviations]", ylabel="density")
    axes.legend(frameon=False)
    outside = 100 * float((np.abs(white) > 1.96).mean()) if len(white) else 0.0
    return drawn, (
        "Distribution of the residuals after the calibration, each over its standard "
        f"deviation; {outside:.0f} % are larger than 1.96. Expected are 5 %, or less: the fit "
        "makes residuals smaller."
    )
