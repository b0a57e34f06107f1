"""Plots of workspaces: what counts, its fundamental domain, the largest circle; readings."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Patch
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from pincal.model.mechanism import Mechanism
from pincal.show.style import CARRIED, DOMAIN, EVERY, PAGE, look
from pincal.types import Array
from pincal.workspace.criteria import equal_sums
from pincal.workspace.grid import Grid
from pincal.workspace.inscribed import Inscribed
from pincal.workspace.region import Workspace

#: What is dark is seen on dark ground too.
_HALO = [withStroke(linewidth=4, foreground="white")]
_LEAST_SHARE = 0.2  # of a picture: less of it than this shows nothing


def _panels(count: int, edge: float, share: bool = False) -> tuple[Figure, list[Axes]]:
    """Return a figure with panels of an edge [inch], three side by side at most."""
    columns = min(3, count)
    rows = -(-count // columns)
    size = (edge * columns + 0.4, edge * rows + 0.6)
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(rows, columns, sharex=share, sharey=share, squeeze=False).ravel()
    for axes in panels[count:]:
        axes.set_axis_off()
    return figure, list(panels[:count])


def workspace_figure(workspace: Workspace, inscribed: Inscribed | None = None) -> Figure:
    """Return a figure of a workspace seen from above, in slices of equal z in space."""
    levels = _levels(workspace)
    figure, panels = _panels(len(levels), 4.5, share=True)
    names, bases = workspace.test.mechanism.leg_names, _bases(workspace)
    for axes, level in zip(panels, levels, strict=True):
        _draw_workspace(axes, workspace, level, inscribed)
        for leg, base in bases.items():
            axes.plot(*base, look(names.index(leg)).marker, color="0.25", ms=6)
            if level is None:
                axes.annotate(
                    leg, (base[0], base[1]), xytext=(5, 5), textcoords="offset points", size=7
                )
        axes.autoscale_view()
    handles = [Patch(color=DOMAIN, label="counts")]
    if len(workspace.elements) > 1:
        handles[0].set_label("computed: fundamental domain")
        handles.append(Patch(color=CARRIED, label="follows by symmetry"))
    if inscribed:
        handles.append(Patch(fill=False, edgecolor=EVERY, label="largest inscribed"))
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    size = workspace.size
    if not workspace.count:
        size = "empty"
    elif len(levels) > 1:
        size += f"; {len(levels)} of {workspace.asked.shape[2]} heights"
    size += "" if bases else "; base points lie outside"
    name = workspace.test.mechanism.name
    figure.suptitle(f"{name}: {workspace.kind} workspace\n{size}")
    return figure


def _bases(workspace: Workspace) -> dict[str, Array]:
    """Return the base points of the legs seen from above; none if what counts were tiny beside."""
    legs = workspace.test.mechanism.legs
    bases = {leg.name: np.array(leg.joints[0].placement.xyz[:2]) for leg in legs}
    counts = workspace.asked.at(np.flatnonzero(workspace.inside))[:, :2]
    if not len(counts):
        return bases
    extent = np.ptp([*bases.values(), counts.min(axis=0), counts.max(axis=0)], axis=0).max()
    return bases if np.ptp(counts, axis=0).max() > _LEAST_SHARE * extent else {}


def _draw_workspace(
    axes: Axes, workspace: Workspace, level: float | None, inscribed: Inscribed | None
) -> None:
    """Draw positions that count, at one height in space; the fundamental domain is darker."""
    grid, index = workspace.asked, np.flatnonzero(workspace.inside)
    if level is not None:
        at_level = np.abs(grid.at(index)[:, 2] - level) <= 1e-9 * max(1.0, abs(level))
        index = index[at_level]
    colours = np.where(workspace.representative(index), DOMAIN, CARRIED)
    cells = PolyCollection(list(_cells(grid, index)), facecolors=colours, edgecolors="face", lw=0.2)
    cells.set_rasterized(len(index) > PAGE.raster_from)  # a vector picture stays small
    axes.add_collection(cells)
    if inscribed:
        x, y, z = map(float, inscribed.centre)
        height = 0.0 if level is None else z - level
        if abs(height) < inscribed.radius:
            radius = float(np.sqrt(inscribed.radius**2 - height**2))
            axes.add_patch(Circle((x, y), radius, fill=False, ec=EVERY, lw=2, path_effects=_HALO))
            axes.plot(x, y, "+", color=EVERY, path_effects=_HALO)
    axes.set_title("" if level is None else f"z = {level:.4g} m", fontsize=9)
    axes.margins(0.12)
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")


def _levels(workspace: Workspace) -> list[float | None]:
    """Return the heights at which to draw slices, nine at most, or None for the plane."""
    grid = workspace.asked
    if len(grid.shape) < 3:
        return [None]
    counts = workspace.inside.reshape(grid.shape).any(axis=(0, 1))
    values = grid.axes[2].values
    home = workspace.test.mechanism.platform.home_pose.translation[0, 2]
    heights = values[counts] if counts.any() else values[[np.argmin(np.abs(values - home))]]
    pick = np.linspace(0, len(heights) - 1, min(9, len(heights))).round().astype(int)
    return [float(heights[i]) for i in pick]


def _cells(grid: Grid, index: NDArray[np.int64]) -> Array:
    """Return the outlines of cells seen from above, shape (N, n_corners, 2)."""
    first, second = (a.values[i] for a, i in zip(grid.axes[:2], grid.split(index)[:2], strict=True))
    half = [(axis.step or 0.0) / 2 for axis in grid.axes[:2]]
    low, high = first - half[0], first + half[0]
    if grid.polar:
        low = np.maximum(low, 0.0)
    along = np.linspace(-half[1], half[1], 5 if grid.polar else 2)
    outer = [(high, second + step) for step in along]
    inner = [(low, second + step) for step in along[::-1]]
    return np.stack([grid.cartesian(corner)[:, :2] for corner in (*outer, *inner)], axis=1)


def articular_figure(mechanism: Mechanism, spaces: Mapping[str, Array]) -> Figure:
    """Return pictures of spaces of readings: three legs in the plane of equal sums and as a cloud.

    Mechanisms with other numbers of legs are drawn by pairs of neighbouring legs.

    Args:
        mechanism: The mechanism.
        spaces: Readings by title, shape (N, n_legs).
    """
    if len(mechanism.legs) == 3:
        return _plane_of_equal_sums(mechanism, spaces)
    read = zip(mechanism.reading_names, mechanism.reading_units, strict=True)
    names = [f"{name} [{unit}]" for name, unit in read]
    count = len(names)
    pairs = [(i, (i + 1) % count) for i in range(count if count > 2 else 1)]
    figure, panels = _panels(len(pairs), 4.3)
    for axes, (first, second) in zip(panels, pairs, strict=True):
        for index, (title, readings) in enumerate(spaces.items()):
            _dots(axes, readings[:, first], readings[:, second], index, _sampled(title))
        axes.set(xlabel=names[first], ylabel=names[second], aspect="equal")
    panels[0].legend(fontsize=8, markerscale=5)
    figure.suptitle(f"{mechanism.name}: articular-variables space")
    return figure


def _sampled(title: str) -> str:
    """Return the title of a space of readings; that of all orientations is a sample."""
    return "all (a sample)" if title == "all" else title


def _dots(axes: Axes, x: Array, y: Array, index: int, label: str = "") -> None:
    colour, rasterized = look(index).colour, len(x) > PAGE.raster_from
    axes.plot(x, y, ".", ms=1.5, color=colour, label=label, rasterized=rasterized)


def _plane_of_equal_sums(mechanism: Mechanism, spaces: Mapping[str, Array]) -> Figure:
    """Return the plane of equal sums for each space, and the first as a cloud (3-RRR, Fig. 7)."""
    figure, panels = _panels(len(spaces) + 1, 4.4)
    unit = mechanism.reading_units[0]
    cloud = figure.add_subplot(panels[0].get_subplotspec(), projection="3d")
    panels[0].remove()
    title, readings = next(iter(spaces.items()))
    height = equal_sums(readings)[:, 2]
    cloud.scatter(*readings.T, s=1, c=height, cmap="viridis", lw=0, rasterized=True)
    cloud.set(
        xlabel=f"ψ₁ [{unit}]", ylabel=f"ψ₂ [{unit}]", zlabel=f"ψ₃ [{unit}]", title=_sampled(title)
    )
    cloud.set_box_aspect(None, zoom=0.85)
    for index, (axes, (title, readings)) in enumerate(zip(panels[1:], spaces.items(), strict=True)):
        across, upward, _ = equal_sums(readings).T
        _dots(axes, across, upward, index)
        reach = 1.1 * float(np.abs([across, upward]).max(initial=1e-9))
        for k in range(3):
            direction = np.array([np.cos(2 * np.pi * k / 3), np.sin(2 * np.pi * k / 3)])
            axes.plot(*(np.outer([0, reach], direction).T), "-", color="0.6", lw=0.8, zorder=0)
            axes.annotate(f"ψ{'₁₂₃'[k]}", tuple(reach * direction), size=8, ha="center")
        axes.set_xlabel(f"(2ψ₁ − ψ₂ − ψ₃)/√6 [{unit}]")
        axes.set_ylabel(f"(ψ₂ − ψ₃)/√2 [{unit}]")
        axes.set(title=_sampled(title), aspect="equal")
        axes.margins(0.1)
    figure.suptitle(f"{mechanism.name}: articular-variables space, plane ψ₁ + ψ₂ + ψ₃ = constant")
    return figure
