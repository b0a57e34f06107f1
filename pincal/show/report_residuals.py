"""Figures of residuals: of the legs or, if their readings are exact, of what was measured."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from pincal.show.colours import COLOURS
from pincal.show.findings import Findings
from pincal.show.markup import Element
from pincal.show.plots import MARKERS
from pincal.show.report_figures import WIDTH
from pincal.show.series import Series, series_of
from pincal.show.svg import drawing, figure
from pincal.show.tables import SHOWN

_MANY = 1500  # points from which they are drawn as pixels
_BAD = COLOURS[1]
_NAMED = 6  # outliers with their row written beside them


def residuals_figure(found: Findings) -> Element:
    """Return residuals before and after against the row, one line of panels for each series."""
    series = series_of(found.result)
    with drawing():
        drawn = Figure(figsize=(WIDTH, 0.5 + 1.25 * len(series)), layout="constrained")
        panels = drawn.subplots(len(series), 2, sharex=True, sharey="col", squeeze=False)
        for index, (one, (left, right)) in enumerate(zip(series, panels, strict=True)):
            unit, factor = SHOWN[one.unit]
            style = {"color": COLOURS[index % len(COLOURS)], "rasterized": len(one.rows) > _MANY}
            marker, rows = MARKERS[index % len(MARKERS)], one.rows + 1
            left.plot(rows, factor * one.before, marker, ms=3, mfc="none", **style)
            right.plot(rows, factor * one.after, marker, ms=3, **style)
            bound = 1.96 * factor * one.sigma
            ends = np.stack((np.stack((rows, -bound), 1), np.stack((rows, bound), 1)), 1)
            bars = LineCollection(list(ends), colors="0.8", lw=3, zorder=0)
            bars.set_rasterized(len(rows) > _MANY)
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
        whose = "of each leg" if series[0].of_leg else "of the platform as measured"
        caption = (
            f"Residuals {whose} against the row "
            "of the measurements, before and after; the "
            "scales differ. Grey bars: where 95 of 100 are expected by the noise. Rings: rows that "
            "do not fit the others; crosses at the upper edge: rows that were rejected."
        )
        return figure(drawn, "figure-residuals", caption, caption)


def _mark_outliers(axes: Axes, found: Findings, series: Series, factor: float) -> None:
    """Ring rows that do not fit, and name the worst."""
    place = {int(row): i for i, row in enumerate(series.rows)}
    named = 0
    for one in found.result.outliers:
        if series.of_leg and series.name not in one.legs:
            continue
        row = one.row + 1
        if one.row in place:
            value = factor * float(series.after[place[one.row]])
            axes.plot(row, value, "o", ms=8, mfc="none", mec=_BAD, mew=1.2)
            where, system = (row, value), axes.transData
        else:
            where, system = (row, 0.93), axes.get_xaxis_transform()
            axes.plot(*where, "X", ms=6, color=_BAD, transform=system, clip_on=False)
        if named < _NAMED:
            axes.annotate(
                str(row), where, xycoords=system, xytext=(6, 2), textcoords="offset points", size=7
            )
            named += 1


def histogram_figure(found: Findings) -> Element | None:
    """Return the distribution of residuals in standard deviations, against the normal one.

    None if all that was measured is exact.
    """
    series = series_of(found.result)
    sigma = np.concatenate([one.sigma for one in series])
    noisy = sigma > 0.0
    if not noisy.any():
        return None
    white = np.concatenate([one.after for one in series])[noisy] / sigma[noisy]
    white = white[np.isfinite(white)]
    with drawing():
        drawn = Figure(figsize=(WIDTH, 2.4), layout="constrained")
        axes = drawn.subplots()
        edge = max(4.0, float(np.ceil(np.abs(white).max(initial=0.0))))
        shown = min(edge, 8.0)
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
        beyond = 100 * float((np.abs(white) > 1.96).mean()) if len(white) else 0.0
        caption = (
            "Distribution of the residuals after the calibration, each over its standard "
            f"deviation; {beyond:.0f} % lie beyond 1.96. Expected are 5 %, or less: the fit makes "
            "residuals smaller."
        )
        return figure(drawn, "figure-histogram", caption, caption)
