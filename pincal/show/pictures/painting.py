"""Shapes in parallel projection, painted from the farthest to the nearest.

Every shape is convex, so that its outline is the convex hull of its projected points. Rods are
cut into short pieces, so that of two that cross the nearer one is painted over the other.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from pincal.show.style import PICTURE
from pincal.show.view.bodies import Body, Shape

Array = NDArray[np.float64]
_TURNS = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)
_CIRCLE = np.stack((np.cos(_TURNS), np.sin(_TURNS)), axis=1)
_LIGHT = np.array([0.3, 0.8, 0.5])  # where it comes from: right, up, towards the viewer
_CORNERS = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), axis=-1).reshape(-1, 3)

#: Points whose hulls are a piece, whole and smaller by the edge, [m]; how bright it is; where
#: between its farthest and its nearest point others are behind it.
_Piece: TypeAlias = tuple[Array, Array, float, float]


def placed(body: Body, row: int) -> list[tuple[Shape, Array]]:
    """Return the shapes of a body at a pose, each with ``T_base_part``; those that are reached."""
    return [
        (shape, place)
        for part, place in zip(body.parts, body.placements[row], strict=True)
        for shape in part.shapes
        if np.isfinite(place).all()
    ]


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
    most = 1 if colour else PICTURE.pieces  # where pieces of one colour overlap they would show
    pieces = [
        (
            whole @ V.T,
            inner @ V.T,
            np.minimum(bright * np.array(to_rgb(colour or shape.colour)), 1),
            behind,
        )
        for shape, place in shapes
        for whole, inner, bright, behind in _pieces(
            shape, place @ shape.T_link_shape, V, edge, most
        )
    ]
    pieces.sort(key=lambda piece: round(float(np.quantile(piece[0][:, 2], piece[3])), 9))
    polygons = [_hull(points[:, :2]) for whole, inner, *_ in pieces for points in (whole, inner)]
    colours = [c for *_, own, _ in pieces for c in (PICTURE.dark * own, own)]
    opacity = 0.45 if colour else None
    axes.add_collection(PolyCollection(polygons, facecolors=colours, lw=0, alpha=opacity))


def _pieces(shape: Shape, T: Array, V: Array, edge: float, most: int) -> list[_Piece]:
    """Return the pieces of a shape, rods in so many at most."""
    if shape.points is not None:
        whole = shape.points @ T[:3, :3].T + T[:3, 3]
        middle = whole.mean(axis=0)
        least = 1.0 - 2.0 * edge / float(np.linalg.norm(whole - middle, axis=1).max())
        return [(whole, middle + max(least, 0.5) * (whole - middle), 1.0, 0.25)]
    thin = min(edge, min(shape.size) / 5)
    if shape.kind == "box":
        return _faces(shape, T, V, thin)
    if shape.kind == "sphere":
        outline = np.concatenate((_CIRCLE @ V[:2], V[2:]))
        whole, inner = (T[:3, 3] + r * outline for r in (shape.size[0], shape.size[0] - thin))
        return [(whole, inner, 1.0, 1.0)]
    radius, length = shape.size
    stretch = float(np.linalg.norm(T[:3, 2]))  # of the rod of a prismatic joint
    if length * stretch < 1e-3 * edge:  # too short to be seen
        return []
    count = int(np.clip(np.ceil(length * stretch / (PICTURE.piece * radius)), 1, most))
    cuts = np.linspace(-length / 2, length / 2, count + 1)
    thin = min(thin, length * stretch / 5)
    end = length / 2 - thin / stretch
    along = float(T[:3, 2] @ V[2]) / stretch  # cosine between the rod and the view
    over = 2 * thin / stretch / max(np.sqrt(1.0 - along**2), 0.1)  # hides where it was cut
    around = _CIRCLE @ T[:3, :2].T

    def tube(radius: float, low: float, high: float) -> Array:
        return np.concatenate([T[:3, 3] + radius * around + z * T[:3, 2] for z in (low, high)])

    return [
        (
            tube(radius, low, high),
            tube(radius - thin, max(low - over, -end), min(high + over, end)),
            1.0,
            1.0,
        )
        for low, high in pairwise(cuts)
    ]


def _faces(shape: Shape, T: Array, V: Array, thin: float) -> list[_Piece]:
    """Return the faces of a box that are seen, those that face the light brighter."""
    faces = []
    size = np.array(shape.size)
    for axis, towards in enumerate(V[2] @ T[:3, :3]):
        if abs(towards) < 1e-6:  # edge on
            continue
        side = np.sign(towards)
        corners = _CORNERS[_CORNERS[:, axis] == side / 2]
        less = np.where(np.arange(3) == axis, 0.0, 2 * thin)
        whole, inner = (corners * (size - cut) @ T[:3, :3].T + T[:3, 3] for cut in (0.0, less))
        faces.append((whole, inner, 0.8 + 0.4 * float(side * T[:3, axis] @ V.T @ _LIGHT), 1.0))
    return faces


def _hull(points: Array) -> Array:
    """Return the corners of the convex hull of points in a plane, shape (n, 2), in order.

    From the lowest on, so that rounding errors do not choose where the outline begins.
    """
    corners = points[ConvexHull(points).vertices]
    first = int(np.lexsort(corners.round(9).T)[0])
    return np.roll(corners, -first, axis=0)
