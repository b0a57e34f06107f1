"""Shapes painted into axes, from the farthest to the nearest, with dark outlines."""

from __future__ import annotations

from itertools import pairwise
from typing import TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from scipy.spatial import ConvexHull

from pincal.show.view.shapes import Shape
from pincal.types import Array

_DARK = 0.55  # brightness of an outline, of its shape's
_PIECE = 10.0  # length of a rod's piece, of its radius
_PIECES = 12  # of a rod, at most
_TURNS = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)
_CIRCLE = np.stack((np.cos(_TURNS), np.sin(_TURNS)), axis=1)
_CORNERS = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), axis=-1).reshape(-1, 3)

#: Points whose hulls are a piece, whole and smaller by the edge, [m]; where between its farthest
#: and its nearest point others are behind it.
_Piece: TypeAlias = tuple[Array, Array, float]


def paint(
    axes: Axes, shapes: list[tuple[Shape, Array]], V: Array, edge: float, colour: str = ""
) -> None:
    """Paint shapes in their own colours, or in one that lets through what is behind.

    Each piece is painted dark, and over it, smaller by the edge, in its colour; where a rod
    was cut, the colour goes on into the next piece.

    Args:
        axes: Where to paint.
        shapes: Shapes with ``T_base_part``, [m].
        V: What points right, up and towards the viewer, shape (3, 3), rows in the base frame.
        edge: Width of outlines, [m].
        colour: One for all.
    """
    count = 1 if colour else _PIECES  # where pieces of one colour overlap they would show
    pieces = []
    for shape, place in shapes:
        fill = np.array(to_rgb(colour or shape.colour))
        for outline, inner, behind in _pieces(shape, place @ shape.T_link_shape, V, edge, count):
            depth = float(np.quantile(outline @ V[2], behind))
            pieces.append((round(depth, 9), _hull(outline @ V[:2].T), _hull(inner @ V[:2].T), fill))
    pieces.sort(key=lambda piece: piece[0])
    polygons = [polygon for _, outline, inner, _ in pieces for polygon in (outline, inner)]
    colours = [c for *_, fill in pieces for c in (_DARK * fill, fill)]
    opacity = 0.45 if colour else None
    axes.add_collection(PolyCollection(polygons, facecolors=colours, lw=0, alpha=opacity))


def _pieces(shape: Shape, T: Array, V: Array, edge: float, limit: int) -> list[_Piece]:
    """Return the pieces of a shape, rods in so many at most."""
    if shape.kind in ("hull", "box"):
        points = shape.points if shape.points is not None else _CORNERS * shape.size
        outline = points @ T[:3, :3].T + T[:3, 3]
        middle = outline.mean(axis=0)
        least = 1.0 - 2.0 * edge / float(np.linalg.norm(outline - middle, axis=1).max())
        behind = 0.25 if shape.kind == "hull" else 1.0
        return [(outline, middle + max(least, 0.5) * (outline - middle), behind)]
    thin = min(edge, min(shape.size) / 5)
    if shape.kind == "sphere":
        directions = np.concatenate((_CIRCLE @ V[:2], V[2:]))
        outline, inner = (T[:3, 3] + r * directions for r in (shape.size[0], shape.size[0] - thin))
        return [(outline, inner, 1.0)]
    radius, length = shape.size
    stretch = float(np.linalg.norm(T[:3, 2]))  # of the rod of a prismatic joint
    if length * stretch < 1e-3 * edge:  # too short to be seen
        return []
    count = int(np.clip(np.ceil(length * stretch / (_PIECE * radius)), 1, limit))
    cuts = np.linspace(-length / 2, length / 2, count + 1)
    thin = min(thin, length * stretch / 5)
    end = length / 2 - thin / stretch
    along = float(T[:3, 2] @ V[2]) / stretch  # cosine between the rod and the view
    overlap = 2 * thin / stretch / max(np.sqrt(1.0 - along**2), 0.1)  # hides where it was cut
    around = _CIRCLE @ T[:3, :2].T

    def tube(radius: float, low: float, high: float) -> Array:
        return np.concatenate([T[:3, 3] + radius * around + z * T[:3, 2] for z in (low, high)])

    return [
        (
            tube(radius, low, high),
            tube(radius - thin, max(low - overlap, -end), min(high + overlap, end)),
            1.0,
        )
        for low, high in pairwise(cuts)
    ]


def _hull(points: Array) -> Array:
    """Return the corners of the convex hull of points in a plane, shape (n, 2), in order.

    From the lowest on, so that rounding errors do not choose where the outline begins.
    """
    corners = points[ConvexHull(points).vertices]
    first = int(np.lexsort(corners.round(9).T)[0])
    return np.roll(corners, -first, axis=0)
