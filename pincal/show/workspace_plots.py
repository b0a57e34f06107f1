"""Plots of workspaces: what counts, its fundamental domain, the largest circle; readings."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Patch
from numpy.typing import NDArray

from pincal.model.mechanism import Mechanism
from pincal.show.style import CARRIED, COLOURS, DOMAIN, MANY, look
from pincal.workspace.articular import equal_sums
from pincal.workspace.inscribed import Inscribed
from pincal.workspace.positions import Grid
from pincal.workspace.region import Workspace

Array = NDArray[np.float64]
_MOST_SLICES = 9
_CURVED = 4  # straight pieces of a cell's arc


def workspace_figure(workspace: Workspace, inscribed: Inscribed | None = None) -> Figure:
    """Return a figure of a workspace seen from above, in slices of equal z in space."""
    levels = _levels(workspace)
    columns = min(3, len(levels))
    rows = -(-len(levels) // columns)
    figure = Figure(figsize=(4.6 * columns + 1.0, 4.4 * rows + 0.9), layout="constrained")
    panels = np.atleast_1d(figure.subplots(rows, columns, sharex=True, sharey=True)).ravel()
    for axes, level in zip(panels, levels, strict=False):
        draw_workspace(axes, workspace, level, inscribed)
    for axes in panels[len(levels) :]:
        axes.set_axis_off()
    handles = [Patch(color=DOMAIN, label="computed: fundamental domain")]
    if len(workspace.elements) > 1:
        handles.append(Patch(color=CARRIED, label="follows by symmetry"))
    else:
        handles = [Patch(color=DOMAIN, label="counts")]
    if inscribed:
        handles.append(Patch(fill=False, edgecolor=COLOURS[1], label="largest inscribed"))
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    name = workspace.test.mechanism.name
    size = f"{workspace.measure:.4g} ± {workspace.uncertainty:.2g} {workspace.unit}"
    if not workspace.count:
        size = "empty"
    elif len(levels) > 1:
        grid = workspace.asked
        total = len(grid.axes[2].values) if isinstance(grid, Grid) else 0
        size += f"; {len(levels)} of {total} heights"
    elif not isinstance(workspace.asked, Grid) and workspace.asked.dimension == 3:
        size += "; samples of all heights"
    figure.suptitle(f"{name}: {workspace.kind} workspace, {size}")
    return figure


def draw_workspace(
    axes: Axes,
    workspace: Workspace,
    level: float | None = None,
    inscribed: Inscribed | None = None,
    *,
    plain: bool = False,
) -> Axes:
    """Draw positions that count, at one height in space; the fundamental domain is darker.

    Args:
        axes: Where to draw.
        workspace: The workspace.
        level: Height, [m]; None in a plane.
        inscribed: Largest circle or ball to draw.
        plain: Draw all positions alike, and no base points.
    """
    index = np.flatnonzero(workspace.inside)
    positions = workspace.asked.at(index)
    if level is not None:
        here = np.abs(positions[:, 2] - level) <= 1e-9 * max(1.0, abs(level))
        index, positions = index[here], positions[here]
    own = workspace.representative(index)
    colours = np.where(own & (not plain), DOMAIN, CARRIED)
    if isinstance(workspace.asked, Grid):
        cells = _cells(workspace.asked, index)
        outlines = PolyCollection(list(cells), facecolors=colours, edgecolors="face", lw=0.2)
        outlines.set_rasterized(len(index) > MANY)  # a vector picture stays small
        axes.add_collection(outlines)
    else:
        many = len(index) > MANY
        axes.scatter(positions[:, 0], positions[:, 1], c=colours, s=2, lw=0, rasterized=many)
    for place, leg in enumerate(() if plain else workspace.test.mechanism.legs):
        base = leg.joints[0].placement.xyz
        axes.plot(*base[:2], look(place).marker, color="0.25", ms=6)
        if level is None:
            axes.annotate(leg.name, base[:2], xytext=(5, 5), textcoords="offset points", size=7)
    if inscribed and abs(inscribed.centre[2] - (level or 0.0)) < inscribed.radius:
        height = inscribed.centre[2] - (level if level is not None else inscribed.centre[2])
        radius = float(np.sqrt(inscribed.radius**2 - height**2))
        centre = (float(inscribed.centre[0]), float(inscribed.centre[1]))
        axes.add_patch(Circle(centre, radius, fill=False, ec=COLOURS[1], lw=2))
        axes.plot(*centre, "+", color=COLOURS[1])
    axes.set_title("" if level is None else f"z = {level:.4g} m", fontsize=9)
    axes.margins(0.12)
    axes.autoscale_view()
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    return axes


def _levels(workspace: Workspace) -> list[float | None]:
    """Return the heights at which to draw slices, or None for the plane."""
    grid = workspace.asked
    if not isinstance(grid, Grid) or len(grid.shape) < 3:
        return [None]
    counts = workspace.inside.reshape(grid.shape).any(axis=(0, 1))
    values = grid.axes[2].values
    home = workspace.test.mechanism.platform.home_pose.translation[0, 2]
    heights = values[counts] if counts.any() else values[[np.argmin(np.abs(values - home))]]
    pick = np.linspace(0, len(heights) - 1, min(_MOST_SLICES, len(heights))).round().astype(int)
    return [float(heights[i]) for i in pick]


def _cells(grid: Grid, index: NDArray[np.int64]) -> Array:
    """Return the outlines of cells seen from above, shape (N, n_corners, 2)."""
    first, second = (a.values[i] for a, i in zip(grid.axes[:2], grid.split(index)[:2], strict=True))
    half = [(axis.step or 0.0) / 2 for axis in grid.axes[:2]]
    low, high = first - half[0], first + half[0]
    if grid.polar:
        low = np.maximum(low, 0.0)
    along = np.linspace(-half[1], half[1], _CURVED + 1 if grid.polar else 2)
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
    names, units = mechanism.reading_names, mechanism.reading_units
    pairs = [(i, (i + 1) % len(names)) for i in range(len(names))]
    if len(names) == 2:
        pairs = pairs[:1]
    columns = min(3, len(pairs))
    rows = -(-len(pairs) // columns)
    figure = Figure(figsize=(4.4 * columns, 4.2 * rows + 0.4), layout="constrained")
    panels = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    for axes, (first, second) in zip(panels, pairs, strict=False):
        for index, (title, readings) in enumerate(spaces.items()):
            x, y = readings[:, first], readings[:, second]
            colour = look(index).colour
            axes.plot(x, y, ".", ms=1.5, color=colour, label=title, rasterized=len(x) > MANY)
        axes.set_xlabel(f"{names[first]} [{units[first]}]")
        axes.set_ylabel(f"{names[second]} [{units[second]}]")
        axes.set_aspect("equal")
    for axes in panels[len(pairs) :]:
        axes.set_axis_off()
    panels[0].legend(fontsize=8, markerscale=5)
    figure.suptitle(f"{mechanism.name}: articular-variables space")
    return figure


def _plane_of_equal_sums(mechanism: Mechanism, spaces: Mapping[str, Array]) -> Figure:
    """Return the plane of equal sums for each space, and the first as a cloud (3-RRR, Fig. 7)."""
    columns = min(3, len(spaces) + 1)
    rows = -(-(len(spaces) + 1) // columns)
    figure = Figure(figsize=(4.4 * columns, 4.4 * rows + 0.3), layout="constrained")
    unit = mechanism.reading_units[0]
    cloud = figure.add_subplot(rows, columns, 1, projection="3d")
    title, readings = next(iter(spaces.items()))
    height = equal_sums(readings)[:, 2]
    cloud.scatter(*readings.T, s=1, c=height, cmap="viridis", lw=0, rasterized=True)
    cloud.set(xlabel=f"ψ₁ [{unit}]", ylabel=f"ψ₂ [{unit}]", zlabel=f"ψ₃ [{unit}]", title=title)
    cloud.set_box_aspect(None, zoom=0.85)
    for place, (title, readings) in enumerate(spaces.items(), 2):
        axes = figure.add_subplot(rows, columns, place)
        across, up, _ = equal_sums(readings).T
        colour = look(place - 2).colour
        axes.plot(across, up, ".", ms=1.5, color=colour, rasterized=len(across) > MANY)
        reach = 1.1 * float(np.abs([across, up]).max(initial=1e-9))
        for k in range(3):
            direction = np.array([np.cos(2 * np.pi * k / 3), np.sin(2 * np.pi * k / 3)])
            axes.plot(*(np.outer([0, reach], direction).T), "-", color="0.6", lw=0.8, zorder=0)
            axes.annotate(f"ψ{'₁₂₃'[k]}", tuple(reach * direction), size=8, ha="center")
        axes.set_aspect("equal")
        across_label, up_label = "(2ψ₁ − ψ₂ − ψ₃)/√6", "(ψ₂ − ψ₃)/√2"
        axes.set(title=title, xlabel=f"{across_label} [{unit}]", ylabel=f"{up_label} [{unit}]")
        axes.margins(0.1)
    figure.suptitle(f"{mechanism.name}: articular-variables space, plane ψ₁ + ψ₂ + ψ₃ = constant")
    return figure
