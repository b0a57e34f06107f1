"""Parts of charts, drawn into axes: maps, poses, bars and their names."""

from __future__ import annotations

from textwrap import wrap
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.ticker import MaxNLocator

from pincal.model.measurements import EVERY_LEG, VERIFY, Plan
from pincal.model.mechanism import Mechanism
from pincal.show.style import (
    EVERY,
    LETTER_WIDTH,
    PAGE_HEIGHT,
    PAGE_INCHES,
    RASTER_FROM,
    look,
)
from pincal.types import Array
from pincal.words.numbers import STORED, amount, minus, per_si

#: Standard deviations within which 95 of 100 normal numbers lie.
NORMAL = 1.96
#: Of lines over a map, which is as light on dark ground: no colour that pages change there.
_LINES = "#101010"
#: Behind numbers of lines: dark letters are read on it wherever a map is dark.
_PLATE = {"boxstyle": "square,pad=0.1", "facecolor": "#EFEFEF", "edgecolor": "none", "alpha": 0.75}
#: Entries of a legend from which it is set closely.
_LONG = 8
_LONG_NAME = 32  # letters of a name that leaves too little room for axes beside it
#: Light enough for black lines; brighter is more, in black and white too.
_LIGHT = ListedColormap(colormaps["cividis"](np.linspace(0.35, 1.0, 128)))


def page_figure(height: float) -> Figure:
    """Return a figure as wide as a page; its height [inch] is at most that of one."""
    return Figure(figsize=(PAGE_INCHES, min(height, PAGE_HEIGHT)), layout="constrained")


def draw_map(
    axes: Axes,
    grid: tuple[Array, Array],
    values: Array,
    limits: tuple[float, float] | None = None,
    *,
    decades: bool = False,
) -> AxesImage:
    """Draw values over x and y, shape (n_y, n_x), with lines of equal value; return the image.

    Args:
        axes: Where to draw.
        grid: Coordinates x and y, shapes (n_x,) and (n_y,), [m].
        values: NaN where there is none.
        limits: Of the colours; those of the values if not given.
        decades: Whether colours follow the logarithm, so that small and large are both seen.
    """
    (x, y), known = (
        (per_si("m", STORED) * coordinate for coordinate in grid),
        values[np.isfinite(values)],
    )
    half = [(cells[1] - cells[0]) / 2 for cells in (x, y)]
    extent = (x[0] - half[0], x[-1] + half[0], y[0] - half[1], y[-1] + half[1])
    low, high = limits or (known.min(), known.max())
    norm = (LogNorm if decades and low > 0.0 else Normalize)(low, high)
    image = axes.imshow(values, origin="lower", extent=extent, norm=norm, cmap=_LIGHT)
    levels, places = _round_levels(known)
    if levels.size:
        masked = np.ma.masked_invalid(values)
        lines = axes.contour(
            x, y, masked, levels, colors=_LINES, linewidths=0.7, negative_linestyles="solid"
        )
        fmt = {level: minus(f"{level:.{places}f}") for level in levels}
        for text in axes.clabel(lines, fmt=fmt, fontsize=7):
            text.set_bbox(_PLATE)
    return image


def _round_levels(known: Array) -> tuple[Array, int]:
    """Return up to four round values among others, and how many decimal places they have."""
    if not known.size:
        return np.zeros(0), 0
    low, high = np.quantile(known, (0.05, 0.95))
    ticks = MaxNLocator(3, steps=[1, 2, 5, 10]).tick_values(low, high)
    places = max(0, int(np.ceil(-np.log10(ticks[1] - ticks[0]) - 1e-9)))
    return ticks[(ticks > low) & (ticks < high)].round(places) + 0.0, places  # no -0


def draw_poses(
    axes: Axes, mechanism: Mechanism, plan: Plan, projection: tuple[int, int] = (0, 1)
) -> None:
    """Draw poses of a plan by set, unfilled if no fit follows them; strokes show orientations.

    Args:
        axes: Where to draw.
        mechanism: The mechanism.
        plan: The poses, and the sets they belong to.
        projection: Coordinates that point right and up.
    """
    turns = "phi" in mechanism.platform.coordinates
    scale = per_si("m", STORED)
    size = 0.05 * scale * float(np.ptp(plan.poses[:, :2], axis=0).max())
    sets = np.array(plan.serving)
    names = dict.fromkeys((*mechanism.leg_names, EVERY_LEG, *plan.serving))
    for index, name in enumerate(names):
        colour, marker = look(index)
        colour = EVERY if name in (EVERY_LEG, VERIFY) else colour
        if not (poses := plan.poses[sets == name]).size:
            continue
        name_shown = {EVERY_LEG: "every leg", VERIFY: "verify (not fitted)"}.get(
            name, f"set {name}"
        )
        rasterized, points = len(poses) > RASTER_FROM, scale * poses[:, projection]
        unfilled: dict[str, Any] = (
            {"mfc": "none", "color": colour} if name == VERIFY else {"color": colour}
        )
        axes.plot(
            *points.T, marker, **unfilled, ms=4, label=name_shown, zorder=2, rasterized=rasterized
        )
        if turns:
            end = points + size * np.stack((np.cos(poses[:, 2]), np.sin(poses[:, 2])), axis=1)
            draw_strokes(axes, points, end, colors=colour, lw=0.8, zorder=2)
    axes.set(xlabel=axis_name("xyz"[projection[0]]), ylabel=axis_name("xyz"[projection[1]]))


def draw_strokes(axes: Axes, begin: Array, end: Array, **look: Any) -> None:
    """Draw lines from points to others, shapes (N, 2), as one path: each would be an element."""
    between = np.full((len(begin), 1, 2), np.nan)
    path = np.concatenate((begin[:, None], end[:, None], between), axis=1).reshape(-1, 2)
    axes.add_collection(LineCollection([path], **look))


def marks(index: int, *, of_leg: bool) -> dict[str, Any]:
    """Return the marker of a series of points: of a leg by its colour, of others by filling."""
    colour, marker = look(index)
    filled: dict[str, Any] = {} if of_leg or index % 2 == 0 else {"mfc": "none"}
    return {"marker": marker, "color": colour if of_leg else EVERY, **filled}


def legend_beside(axes: Axes) -> Axes:
    """Put the legend beside the axes, where it hides nothing; below them if a name is long."""
    handles, names = axes.get_legend_handles_labels()
    dense: dict[str, Any] = {"fontsize": 7, "labelspacing": 0.15}
    style: dict[str, Any] = dense if len(names) > _LONG else {"fontsize": 8}
    figure = axes.get_figure(root=True)
    if figure and max(map(len, names), default=0) > _LONG_NAME:
        figure.legend(handles, names, loc="outside lower left", frameon=False, **dense)
    else:
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, **style)
    return axes


def levels(axes: Axes, size: float, name: str) -> None:
    """Draw lines at zero and, dashed, at a size on both sides, with a name in the legend."""
    axes.axhline(0.0, color="0.5", lw=0.8, zorder=0)
    for level, entry in ((-size, f"_{name}"), (size, name)):
        axes.axhline(level, color="0.5", lw=0.8, ls="--", zorder=0, label=entry)


def axis_name(axis: str) -> str:
    """Return what names an axis of the base frame, with its unit."""
    return f"{axis} [{STORED['m']}]"


def height_name(value: float | None) -> str:
    """Return at which z something is drawn, [m]; nothing where there is no z."""
    return "" if value is None else minus(f"z = {amount(value, 'm', 3, STORED)}")


def room(axes: Axes) -> tuple[float, float]:
    """Return about how wide and high axes will be beside their labels, [inch]."""
    figure, place = axes.get_figure(root=True), axes.get_position()
    size = figure.get_size_inches() if figure else (PAGE_INCHES, PAGE_HEIGHT)
    return float(size[0] * place.width), float(size[1] * place.height)


def wrapped(text: str, inches: float) -> str:
    """Return a label in as many lines as it needs in a length; no-break spaces stay whole."""
    line = max(int(inches / LETTER_WIDTH), 12)
    return "\n".join(wrap(text, line, break_long_words=False, break_on_hyphens=False))


def label(name: str) -> str:
    """Return a name as a label that matplotlib does not leave out of legends."""
    return f" {name}" if name.startswith("_") else name
