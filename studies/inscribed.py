"""The largest circle inside a planar workspace, from points on its boundary.

The centre of the largest circle that holds none of some points is a vertex of their Voronoi
diagram. The points are first the cells next to the workspace; those near the circle are then moved
to the boundary, by bisection towards their neighbour that counts, and so are rim positions that do
not count. What remains free around the centre is a circle inside; it is done when that comes near
the bound, the circle free of the points.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree, Voronoi

import pincal

Array = NDArray[np.float64]
_ROUNDS = 60
_NEAR = 1e-4  # of the radius, how near to the bound is enough; of a step, on the boundary
_RIM = 500  # positions on a circle


class Circle(NamedTuple):
    """A circle over x and y."""

    centre: Array
    """Shape (3,), [m]."""
    radius: float
    """[m]."""


def largest_circle(workspace: pincal.Workspace) -> Circle:
    """Return the largest circle inside a workspace over x and y.

    Raises:
        ValueError: none fits between the cells that count.
    """
    inner, points, edge = _boundary(workspace)
    moved = np.zeros(len(points), dtype=bool)
    best, best_radius, bound = np.zeros(3), 0.0, np.inf
    for _ in range(_ROUNDS):
        centre, radius = _emptiest(np.concatenate((points, edge)), workspace)
        bound = min(bound, radius)
        if best_radius >= (1 - _NEAR) * bound:
            break
        distance = np.linalg.norm(points - centre, axis=1)
        step = np.linalg.norm(points - inner, axis=1)
        near = np.flatnonzero(~moved & (distance - step <= radius))
        points[near] = _bisected(workspace, inner[near], points[near])
        moved[near] = True
        directions = np.random.default_rng(0).normal(size=(_RIM, 2))
        rim = np.repeat(centre[None], _RIM, axis=0)
        rim[:, :2] += radius * directions / np.linalg.norm(directions, axis=1)[:, None]
        bad = rim[~workspace.test(rim)]
        within = np.broadcast_to(centre, bad.shape)
        points = np.concatenate((points, _bisected(workspace, within, bad)))
        inner = np.concatenate((inner, within))
        moved = np.append(moved, np.ones(len(bad), dtype=bool))
        free = float(np.linalg.norm(points - centre, axis=1).min(initial=radius))
        if free > best_radius:
            best, best_radius = centre, free
    return Circle(best, best_radius)


def _boundary(workspace: pincal.Workspace) -> tuple[Array, Array, Array]:
    """Return neighbours of which one counts, that one first, (M, 3) each, and ends of the grid.

    These are half a step outside, shape (K, 3), [m].
    """
    grid, cells = workspace.asked, workspace.inside.reshape(workspace.asked.shape)
    numbers, pairs, ends = np.arange(grid.size).reshape(grid.shape), [], [np.empty((0, 3))]
    for place, axis in enumerate(grid.axes):
        along, counts = np.moveaxis(numbers, place, 0), np.moveaxis(cells, place, 0)
        differ = counts[:-1] != counts[1:]
        neighbours = np.stack((along[:-1][differ], along[1:][differ]), axis=1)
        pairs.append(np.where(counts[:-1][differ][:, None], neighbours, neighbours[:, ::-1]))
        for end, sign in ((0, -1.0), (-1, 1.0)):
            outside = grid.at(along[end][counts[end]])
            outside[:, place] += sign * axis.step / 2
            ends.append(outside)
    inner, outer = (grid.at(index) for index in np.concatenate(pairs).T)
    return inner, outer, np.concatenate(ends)


def _bisected(workspace: pincal.Workspace, inner: Array, outer: Array) -> Array:
    """Return points between positions that count and others that do not, shape (M, 3)."""
    for _ in range(math.ceil(-math.log2(_NEAR))):
        middle = (inner + outer) / 2
        counts = workspace.test(middle)[:, None]
        inner, outer = np.where(counts, middle, inner), np.where(counts, outer, middle)
    return outer


def _emptiest(points: Array, workspace: pincal.Workspace) -> tuple[Array, float]:
    """Return centre and radius of the largest circle free of points, centred where it counts."""
    vertices = Voronoi(points[:, :2]).vertices
    radii, cells = KDTree(points[:, :2]).query(vertices)[0], KDTree(workspace.positions[:, :2])
    for index in np.argsort(radii)[::-1]:
        centre = np.append(vertices[index], 0.0)
        if cells.query(vertices[index])[0] <= radii[index] and workspace.test(centre[None])[0]:
            return centre, float(radii[index])
    raise ValueError("no circle fits between the cells that count; take smaller steps")
