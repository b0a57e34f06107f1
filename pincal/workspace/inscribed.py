"""The largest circle or ball inside a workspace, from points on its boundary.

The centre of the largest circle that holds none of some points is a vertex of their
Voronoi diagram; no circle free of these points is larger. The points are first the cells
next to the workspace; those near the circle are then moved to the boundary, by bisection
towards their neighbour that counts, and so are rim positions that do not count. What
remains free around the centre is a circle inside; it is done when that comes near the
bound.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree, QhullError, Voronoi

from pincal.errors import WorkspaceError
from pincal.types import Array
from pincal.workspace.grid import at_edge, edges
from pincal.workspace.region import Workspace

_ROUNDS = 60
_NEAR = 1e-4  # of the radius, how near to the bound is enough; of a step, on the boundary
_RIM = {2: 500, 3: 2000}  # positions on a circle, on a ball


@dataclass(frozen=True, repr=False)
class Inscribed:
    """Largest circle (in a plane) or ball (in space) in which every position asked counts.

    Example:
        >>> import pincal
        >>> grid = pincal.Grid.of("x=-1:1:0.1", "y=0.4:2:0.1")
        >>> workspace = pincal.compute_workspace("5R", "total-orientation", grid)
        >>> disc = pincal.largest_inscribed(workspace)
        >>> disc.centre.shape, bool(disc.radius > 0.1)
        ((3,), True)
    """

    centre: Array
    """Shape (3,), base frame, [m]."""
    radius: float
    """[m]."""
    bound: float
    """Radius that no circle free of the boundary points exceeds, [m]."""
    at_edge: bool
    """Whether it touches the edge of the grid: the workspace may hold a larger one."""

    def __repr__(self) -> str:
        position = ", ".join(f"{value:.6g}" for value in self.centre)
        edge = "; it touches the edge of the grid" if self.at_edge else ""
        return f"Inscribed: radius {self.radius:.6g} m, centre ({position}) m{edge}"


def largest_inscribed(workspace: Workspace) -> Inscribed:
    """Return the largest circle or ball inside a workspace.

    Raises:
        WorkspaceError: a grid with one axis, or too few cells.
    """
    grid, several = workspace.asked, [n > 1 for n in workspace.asked.shape]
    if grid.dimension < 2:
        raise WorkspaceError("an inscribed circle or ball needs a grid with two or three axes")
    if grid.polar and several[0] != several[1]:
        raise WorkspaceError("an inscribed circle needs values of both radius and bearing")
    if not workspace.count:
        raise WorkspaceError("the workspace is empty: no circle fits into it")
    axes = [place for place, varies in enumerate(several) if varies]  # of x, y, z
    pairs = edges(grid, workspace.inside)
    pairs = np.where(workspace.inside[pairs[:, :1]], pairs, pairs[:, ::-1])
    inner, points = (grid.at(index) for index in pairs.T)
    edge = at_edge(grid, workspace.inside)
    moved = np.zeros(len(points), dtype=bool)
    best, bound = None, np.inf
    for _ in range(_ROUNDS):
        centre, radius = _emptiest(np.concatenate((points, edge)), axes, workspace)
        bound = min(bound, radius)
        if best is not None and best.radius >= (1 - _NEAR) * bound:
            break
        distance = np.linalg.norm((points - centre)[:, axes], axis=1)
        step = np.linalg.norm(points - inner, axis=1)
        near = np.flatnonzero(~moved & (distance - step <= radius))
        points[near] = _bisected(workspace, inner[near], points[near])
        moved[near] = True
        directions = np.random.default_rng(0).normal(size=(_RIM[len(axes)], len(axes)))
        rim = np.repeat(centre[None], len(directions), axis=0)
        rim[:, axes] += radius * directions / np.linalg.norm(directions, axis=1)[:, None]
        bad = rim[~workspace.test(rim)]
        within = np.broadcast_to(centre, bad.shape)
        points = np.concatenate((points, _bisected(workspace, within, bad)))
        inner = np.concatenate((inner, within))
        moved = np.append(moved, np.ones(len(bad), dtype=bool))
        free = np.linalg.norm((points - centre)[:, axes], axis=1).min(initial=radius)
        if best is None or free > best.radius:
            to_edge = np.linalg.norm((edge - centre)[:, axes], axis=1).min(initial=np.inf)
            best = Inscribed(centre, float(min(free, radius)), bound, bool(to_edge <= free))
    if best is None:
        raise WorkspaceError("no circle fits between the cells that count; take smaller steps")
    return replace(best, bound=max(bound, best.radius))


def _bisected(workspace: Workspace, inner: Array, outer: Array) -> Array:
    """Return points between positions that count and others that do not, shape (M, 3)."""
    for _ in range(math.ceil(-math.log2(_NEAR))):
        middle = (inner + outer) / 2
        counts = workspace.test(middle)[:, None]
        inner, outer = np.where(counts, middle, inner), np.where(counts, outer, middle)
    return outer


def _emptiest(points: Array, axes: list[int], workspace: Workspace) -> tuple[Array, float]:
    """Return centre and radius of the largest circle free of points, centred where it counts."""
    inner = workspace.positions
    try:
        vertices = Voronoi(points[:, axes]).vertices
    except (QhullError, ValueError) as error:
        raise WorkspaceError(
            "too few cells count for an inscribed circle; take smaller steps"
        ) from error
    radii = KDTree(points[:, axes]).query(vertices)[0]
    cells = KDTree(inner[:, axes])
    for index in np.argsort(radii)[::-1]:
        centre = np.array(inner[0])
        centre[axes] = vertices[index]
        if cells.query(vertices[index])[0] <= radii[index] and workspace.test(centre[None])[0]:
            return centre, float(radii[index])
    raise WorkspaceError("no circle fits between the cells that count; take smaller steps")
