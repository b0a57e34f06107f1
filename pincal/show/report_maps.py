"""Maps of the platform's error over the workspace, for colour, black and white, and paper."""

from __future__ import annotations

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pincal.show.findings import ErrorMaps
from pincal.show.markup import Element
from pincal.show.report_figures import WIDTH
from pincal.show.svg import drawing, figure

Array = NDArray[np.float64]
_HIGHEST = 9.5  # [inch], of A4
#: Light enough for black lines; brighter is more, in black and white too.
_LIGHT = ListedColormap(colormaps["cividis"](np.linspace(0.35, 1.0, 128)))


def maps_figure(maps: ErrorMaps, turns: bool) -> Element:
    """Return the platform's errors over x and y, before and after (3-RRR paper, Figs. 6, 11).

    Args:
        maps: The errors.
        turns: Whether the platform has an orientation.
    """
    quantities = ((0, "position", "mm"), (1, "orientation", "mrad"))[: 1 + turns]
    rows = [
        (f"{what} {when}", unit, 1e3 * values[..., column])
        for column, what, unit in quantities
        for when, values in (("before", maps.before), ("after, expected", maps.after))
    ]
    spatial = len(maps.heights) > 1
    across = len(maps.heights) if spatial else 2
    down = len(rows) * len(maps.heights) // across
    panel = 0.8 * WIDTH / across * float(np.ptp(maps.y) / np.ptp(maps.x))
    with drawing():
        size = (WIDTH, min(down * (panel + 0.5), _HIGHEST))
        drawn = Figure(figsize=size, layout="constrained")
        panels = iter(drawn.subplots(down, across, sharex=True, sharey=True).ravel())
        for title, unit, values in rows:
            own = [next(panels) for _ in maps.heights]
            limits = float(np.nanmin(values)), float(np.nanmax(values))
            for axes, error in zip(own, values, strict=True):
                _draw_map(axes, maps, error, limits)
            for axes, height in zip(own, maps.heights, strict=True):
                axes.set_title("" if height is None else f"z = {height:.3g} m")
            own[0].set_title("\n".join((title, own[0].get_title())) if spatial else title)
            drawn.colorbar(own[0].images[0], ax=own if spatial else own[0], label=unit)
        drawn.supxlabel("x [m]", size=8)
        drawn.supylabel("y [m]", size=8)
        where = "the workspace at home orientation" if turns else "the workspace"
        caption = (
            f"Error of the platform over {where}: how far the nominal model is off, and what is "
            "to be expected of the calibrated one (standard error). Scales differ; white: not in "
            "the workspace."
        )
        return figure(drawn, "figure-maps", caption, caption)


def _draw_map(axes: Axes, maps: ErrorMaps, error: Array, limits: tuple[float, float]) -> None:
    """Draw one map, with lines of equal error and their values."""
    ends = (maps.x[0], maps.x[-1], maps.y[0], maps.y[-1])
    half = [(values[1] - values[0]) / 2 for values in (maps.x, maps.y)]
    extent = (ends[0] - half[0], ends[1] + half[0], ends[2] - half[1], ends[3] + half[1])
    low, high = limits
    axes.imshow(error, origin="lower", extent=extent, vmin=low, vmax=high, cmap=_LIGHT)
    told = error[np.isfinite(error)]
    levels = np.quantile(told, (0.25, 0.5, 0.75)) if told.size else np.zeros(3)
    if (np.diff(levels) <= 1e-6 * levels[-1]).any():
        return
    masked = np.ma.masked_invalid(error)
    lines = axes.contour(maps.x, maps.y, masked, levels, colors="black", linewidths=0.7)
    axes.clabel(lines, fmt="%.2g", fontsize=6.5)
