"""Figures of workspaces: what counts, its fundamental domain, the largest circle."""

from __future__ import annotations

from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from pincal.show.style import CARRIED, DOMAIN, MARKERS, RASTER_FROM
from pincal.types import Array
from pincal.workspace.grid import lowest
from pincal.workspace.region import Workspace

_LEAST_SHARE = 0.2  # of a picture: less of it than this shows nothing
_MOST_LEVELS = 9  # slices of a workspace in space


def workspace_figure(workspace: Workspace) -> Figure:
    """Return a figure of a workspace seen from above, in slices of equal z in space."""
    levels = _levels(workspace)
    columns = min(3, len(levels))
    rows = -(-len(levels) // columns)
    figure = Figure((4.5 * columns + 0.4, 4.5 * rows + 0.6), layout="constrained")
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for axes in panels[len(levels) :]:
        axes.set_axis_off()
    bases = _bases(workspace)
    for axes, level in zip(panels, levels, strict=False):
        _draw_workspace(axes, workspace, level)
        for (leg, (x, y)), marker in zip(bases.items(), cycle(MARKERS), strict=False):
            axes.plot(x, y, marker, color="0.25", ms=6)
            if level is None:
                axes.annotate(leg, (x, y), xytext=(5, 5), textcoords="offset points", size=7)
        axes.autoscale_view()
    handles = [Patch(color=DOMAIN, label="counts")]
    if len(workspace.elements) > 1:
        handles[0].set_label("computed: fundamental domain")
        handles.append(Patch(color=CARRIED, label="follows by symmetry"))
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    size = workspace.size
    if not workspace.count:
        size = "empty"
    elif len(levels) > 1:
        size += f"; {len(levels)} of {workspace.asked.shape[2]} heights"
    size += "" if bases else "; base points lie outside"
    figure.suptitle(f"{workspace.test.mechanism.name}: {workspace.kind} workspace\n{size}")
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


def _draw_workspace(axes: Axes, workspace: Workspace, level: float | None) -> None:
    """Draw positions that count, at one height in space; the fundamental domain is darker."""
    grid, index = workspace.asked, np.flatnonzero(workspace.inside)
    carried = np.full(grid.size, np.nan)
    carried[index] = lowest(workspace.elements.values(), index) == index
    cells = carried.reshape(grid.shape)
    if level is not None:
        cells = cells[:, :, np.abs(grid.axes[2].values - level).argmin()]
    ends = [np.append(a.values - a.step / 2, a.values[-1] + a.step / 2) for a in grid.axes[:2]]
    corners = np.meshgrid(ends[0].clip(0.0) if grid.polar else ends[0], ends[1], indexing="ij")
    colours = ListedColormap([CARRIED, DOMAIN])
    raster = len(index) > RASTER_FROM  # a vector picture stays small
    x, y, _ = np.moveaxis(grid.cartesian(corners), -1, 0)
    axes.pcolormesh(x, y, cells, cmap=colours, vmin=0.0, vmax=1.0, rasterized=raster)
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
    pick = np.linspace(0, len(heights) - 1, min(_MOST_LEVELS, len(heights))).round().astype(int)
    return [float(heights[i]) for i in pick]
