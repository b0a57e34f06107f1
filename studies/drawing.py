"""What several studies draw: mechanisms, workspaces, poses, bars, times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter
from numpy.typing import NDArray

import pincal

from .study import Study

Array = NDArray[np.float64]
#: Those of pincal's own drawings: of legs; before and after; of what counts, and follows from it.
COLOURS = ("#07a75a", "#0e11a3", "#ac5f71", "#7e7dfe", "#610f0a", "#1a5c4c", "#703e68", "#9f1042")
BEFORE, AFTER = "#909090", "#4402fc"
DOMAIN, CARRIED = "#520856", "#d8c3da"
HATCHES = ("", "//", "..", "xx", "\\\\", "++", "oo")
MARKERS = ("o", "^", "s", "D")


def panels(count: int, width: float, height: float) -> tuple[Figure, Sequence[Axes]]:
    """Return a figure with axes side by side, as sequence even of one."""
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(1, count, squeeze=False)[0]


def from_above(axes: Axes, title: str = "") -> None:
    """Name the axes of a plane, alike in scale."""
    axes.set_axis_on()
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]", title=title)


def draw_mechanism(axes: Axes, mechanism: pincal.Mechanism, pose: Sequence[float]) -> None:
    """Draw a planar mechanism at a pose, with room around it."""
    pincal.picture(mechanism, [pose]).draw(axes)
    if legend := axes.get_legend():
        legend.remove()
    for text in axes.texts:
        text.set_clip_on(True)  # names outside narrower limits leave no room for the axes
    from_above(axes)
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    room = 0.1 * max(right - left, high - low)
    axes.set(xlim=(left - room, right + room), ylim=(low - room, high + room))


def parameters(study: Study, number: str) -> None:
    """Add a picture of the study's mechanism, and what its parameters are."""
    mechanism = study.mechanism
    study.heading(f"The mechanism and its parameters ({number})")
    drawn = pincal.picture(mechanism).figure()
    study.figure("mechanism", f"{number}: the mechanism at home", drawn)
    study.say(f"Parameters: {mechanism.labelled}.")


def legend(figure: Figure, columns: int = 4) -> None:
    """Put one legend for all panels below them, off the data."""
    named = {
        text: handle
        for axes in figure.axes
        for handle, text in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        named.values(),
        named.keys(),
        loc="outside lower center",
        ncols=columns,
        frameon=False,
        fontsize=8,
    )


def draw_workspace(axes: Axes, workspace: pincal.Workspace, kept: Array | None = None) -> Any:
    """Draw the cells of a workspace's first section; by values if there are any, and return them.

    Args:
        axes: Where to draw.
        workspace: On a grid of one height, or in the plane.
        kept: A value of each position that counts, shape (count,).
    """
    grid = workspace.asked
    assert isinstance(grid, pincal.Grid)
    first, second = (
        np.append(axis.values - axis.step / 2, axis.values[-1] + axis.step / 2)
        for axis in grid.axes[:2]
    )
    a, b = np.meshgrid(first, second, indexing="ij")
    if grid.axes[0].name == "radius":
        a, b = a * np.cos(b), a * np.sin(b)
    cells = np.full(workspace.inside.shape, np.nan)
    cells[workspace.inside] = 0.0 if kept is None else kept
    colours = ListedColormap([CARRIED] if kept is None else [DOMAIN, CARRIED])
    shape = (len(first) - 1, len(second) - 1)
    return axes.pcolormesh(
        a, b, cells.reshape(shape), cmap=colours, vmin=0, vmax=1, zorder=0, rasterized=True
    )


def draw_poses(axes: Axes, mechanism: pincal.Mechanism, plan: pincal.Plan) -> None:
    """Draw the poses of a plan by the leg that they serve; a stroke shows the orientation."""
    size = 0.05 * float(np.ptp(plan.poses[:, :2], axis=0).max())
    for index, name in enumerate((*mechanism.leg_names, "all")):
        own = plan.poses[[one == name for one in plan.sets or ()]]
        if not len(own):
            continue
        label = f"set {name}" if name != "all" else "every leg"
        colour = COLOURS[index] if name != "all" else "#222222"
        axes.plot(*own[:, :2].T, MARKERS[index], ms=4, color=colour, label=label)
        if own.shape[1] > 2:
            ends = own[:, :2] + size * np.stack((np.cos(own[:, 2]), np.sin(own[:, 2])), axis=1)
            strokes = list(np.stack((own[:, :2], ends), axis=1))
            axes.add_collection(LineCollection(strokes, colors=colour, lw=0.8))


def draw_bars(axes: Axes, names: Sequence[str], series: Mapping[str, Sequence[float]]) -> Array:
    """Draw bars of several series side by side; return their places, shape (n_series, n)."""
    width = 0.8 / len(series)
    shifts = width * (np.arange(len(series)) - (len(series) - 1) / 2)
    places: Array = np.arange(len(names)) + shifts[:, None]
    for index, ((label, values), place) in enumerate(zip(series.items(), places, strict=True)):
        colour = BEFORE if label == "before" else COLOURS[index]
        bars = axes.bar(place, values, width, label=label, color=colour)
        for bar in bars:
            bar.set(hatch=HATCHES[index], edgecolor="white")
    axes.set_xticks(range(len(names)), names, fontsize=8)
    return places


def observability(selection: pincal.Selection, mechanism: pincal.Mechanism) -> Figure:
    """Return bars of |R_ii| by parameter and leg (3-RRR paper, Fig. 9)."""
    figure, (axes,) = panels(1, 8, 4)
    names = mechanism.legs[0].parameter_names
    draw_bars(axes, names, {leg.leg: leg.r_diagonal.tolist() for leg in selection.legs})
    axes.set_ylabel(f"observability |R_ii| [{mechanism.reading_units[0]}/unit]")
    legend(figure, 6)
    return figure


def times(seconds: Mapping[str, float], title: str = "") -> Figure:
    """Return bars of times, [s]."""
    figure, (axes,) = panels(1, 9, 0.34 * len(seconds) + 1)
    bars = axes.barh(list(seconds), list(seconds.values()), color=AFTER)
    axes.bar_label(bars, [f" {time:.3g} s" for time in seconds.values()], fontsize=8)
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.invert_yaxis()
    axes.margins(x=0.15)
    axes.set_xlabel("time on the machine that drew this [s]")
    axes.set_title(title, fontsize=10)
    return figure


def readings_of_three_legs(spaces: Mapping[str, Array]) -> Figure:
    """Return spaces of readings, shape (N, 3), along ψ₁ = ψ₂ = ψ₃; the first as a cloud too."""
    figure = Figure(figsize=(13.2, 9.1), layout="constrained")
    first = next(iter(spaces.values()))
    cloud = figure.add_subplot(2, 3, 1, projection="3d")
    cloud.scatter(*first.T, s=1, c=first.sum(axis=1), cmap="cividis", lw=0, rasterized=True)
    cloud.set(xlabel="ψ₁ [rad]", ylabel="ψ₂ [rad]", zlabel="ψ₃ [rad]")
    cloud.set_box_aspect(None, zoom=0.8)
    for place, (title, readings) in enumerate(spaces.items()):
        axes = figure.add_subplot(2, 3, place + 2)
        across = readings @ np.array([2.0, -1.0, -1.0]) / np.sqrt(6)
        up = readings @ np.array([0.0, 1.0, -1.0]) / np.sqrt(2)
        axes.plot(across, up, ".", ms=1.5, color=DOMAIN, rasterized=True)
        axes.set(aspect="equal", title=title)
        axes.set(xlabel="(2ψ₁ − ψ₂ − ψ₃)/√6 [rad]", ylabel="(ψ₂ − ψ₃)/√2 [rad]")
    return figure
