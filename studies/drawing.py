"""What several studies draw: mechanisms, workspaces, poses, bars, times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

import pincal

Array = NDArray[np.float64]
#: Okabe and Ito's colours, distinct in every common colour-blindness.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
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
    from_above(axes)
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    room = 0.1 * max(right - left, high - low)
    axes.set(xlim=(left - room, right + room), ylim=(low - room, high + room))


def draw_workspace(axes: Axes, workspace: pincal.Workspace) -> None:
    """Draw the positions of a workspace."""
    x, y = workspace.positions[:, :2].T
    axes.plot(x, y, "s", ms=1.5, color="#A9CBE8", mew=0, zorder=0, rasterized=True)


def draw_poses(axes: Axes, mechanism: pincal.Mechanism, plan: pincal.Plan) -> None:
    """Draw the poses of a plan by the leg that they serve; a stroke shows the orientation."""
    size = 0.05 * float(np.ptp(plan.poses[:, :2], axis=0).max())
    for index, name in enumerate((*mechanism.leg_names, "all")):
        own = plan.poses[[one == name for one in plan.sets or ()]]
        if not len(own):
            continue
        label = f"set {name}" if name != "all" else "every leg"
        axes.plot(*own[:, :2].T, MARKERS[index], ms=4, color=COLOURS[index], label=label)
        if own.shape[1] > 2:
            ends = own[:, :2] + size * np.stack((np.cos(own[:, 2]), np.sin(own[:, 2])), axis=1)
            strokes = list(np.stack((own[:, :2], ends), axis=1))
            axes.add_collection(LineCollection(strokes, colors=COLOURS[index], lw=0.8))
    axes.legend(fontsize=8)


def draw_bars(axes: Axes, names: Sequence[str], series: Mapping[str, Sequence[float]]) -> Array:
    """Draw bars of several series side by side; return their places, shape (n_series, n)."""
    width = 0.8 / len(series)
    shifts = width * (np.arange(len(series)) - (len(series) - 1) / 2)
    places: Array = np.arange(len(names)) + shifts[:, None]
    for index, ((label, values), place) in enumerate(zip(series.items(), places, strict=True)):
        bars = axes.bar(place, values, width, label=label, color=COLOURS[index])
        for bar in bars:
            bar.set(hatch=HATCHES[index], edgecolor="white")
    axes.set_xticks(range(len(names)), names, fontsize=8)
    axes.legend(fontsize=8)
    return places


def observability(selection: pincal.Selection, names: Sequence[str]) -> Figure:
    """Return bars of |R_ii| by parameter and leg (3-RRR paper, Fig. 9)."""
    figure, (axes,) = panels(1, 8, 4)
    draw_bars(axes, names, {leg.leg: leg.r_diagonal.tolist() for leg in selection.legs})
    axes.set_ylabel("observability |R_ii| [rad/unit]")
    return figure


def times(seconds: Mapping[str, float], title: str = "") -> Figure:
    """Return bars of times, [s]."""
    figure, (axes,) = panels(1, 9, 0.34 * len(seconds) + 1)
    bars = axes.barh(list(seconds), list(seconds.values()), color=COLOURS[0])
    axes.bar_label(bars, [f" {time:.3g} s" for time in seconds.values()], fontsize=8)
    axes.set_xscale("log")
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
    cloud.scatter(*first.T, s=1, c=first.sum(axis=1), lw=0, rasterized=True)
    cloud.set(xlabel="ψ₁ [rad]", ylabel="ψ₂ [rad]", zlabel="ψ₃ [rad]")
    for place, (title, readings) in enumerate(spaces.items()):
        axes = figure.add_subplot(2, 3, place + 2)
        across = readings @ np.array([2.0, -1.0, -1.0]) / np.sqrt(6)
        up = readings @ np.array([0.0, 1.0, -1.0]) / np.sqrt(2)
        axes.plot(across, up, ".", ms=1.5, color=COLOURS[place], rasterized=True)
        axes.set(aspect="equal", title=title)
        axes.set(xlabel="(2ψ₁ − ψ₂ − ψ₃)/√6 [rad]", ylabel="(ψ₂ − ψ₃)/√2 [rad]")
    return figure
