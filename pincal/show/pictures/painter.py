"""What a picture is painted of: shapes from the farthest to the nearest, names where there is room.

Shapes have dark outlines; names are of legs, axes and dimensions, the last beside their lines.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.patches import FancyArrowPatch
from matplotlib.path import Path
from scipy.spatial import ConvexHull
from scipy.spatial.distance import cdist

from pincal.show.pictures.dimensions import Dimension, symbol
from pincal.show.style import DIMENSION
from pincal.show.view.bodies import Shape
from pincal.types import Array

_DARK, _EDGE = 0.55, 0.5  # brightness of an outline, of its shape's; its width, [point]
_SHORT = 1e-4  # of a rod's radius: shorter than that it is not seen
_TURNS = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)
_CIRCLE = np.stack((np.cos(_TURNS), np.sin(_TURNS)), axis=1)
_CORNERS = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), axis=-1).reshape(-1, 3)


def paint(axes: Axes, shapes: list[tuple[Shape, Array]], V: Array, colour: str = "") -> None:
    """Paint shapes, with ``T_base_part``, [m], in their colours, or in one that is seen through.

    V is what points right, up and towards the viewer, shape (3, 3), rows in the base frame.
    """
    polygons = []
    for shape, place in shapes:
        points = _points(shape, place @ shape.T_link_shape, V)
        if len(points):  # sorted by the nearest point, but of plates, on which others stand
            depth = float(np.quantile(points @ V[2], 0.25 if shape.kind == "mesh" else 1.0))
            polygons.append((round(depth, 9), _hull(points @ V[:2].T), colour or shape.colour))
    polygons.sort(key=lambda polygon: polygon[0])
    fills = np.array([to_rgb(fill) for *_, fill in polygons]).reshape(-1, 3)
    painted = PolyCollection(
        [outline for _, outline, _ in polygons],
        facecolors=fills,
        edgecolors=_DARK * fills,
        lw=_EDGE,
        joinstyle="round",
        alpha=0.45 if colour else None,
    )
    axes.add_collection(painted)


def _points(shape: Shape, T: Array, V: Array) -> Array:
    """Return points whose hull is a shape as seen, shape (n, 3), [m]; none of a rod too short."""
    if shape.kind == "sphere":
        return T[:3, 3] + shape.size[0] * np.concatenate((_CIRCLE @ V[:2], V[2:]))
    points = shape.points if shape.points is not None else _CORNERS
    if shape.kind == "box":
        points = _CORNERS * shape.size
    elif shape.kind == "cylinder":
        radius, length = shape.size
        if length * np.linalg.norm(T[:3, 2]) < _SHORT * radius:  # it stretches with its joint
            return np.zeros((0, 3))
        ends = [np.insert(radius * _CIRCLE, 2, end, axis=1) for end in (-length / 2, length / 2)]
        points = np.concatenate(ends)
    return np.asarray(points @ T[:3, :3].T + T[:3, 3])


def _hull(points: Array) -> Array:
    """Return the corners of the convex hull of points in a plane, shape (n, 2), in order."""
    corners = points[ConvexHull(points).vertices]
    return np.roll(corners, -int(np.lexsort(corners.round(9).T)[0]), axis=0)  # the lowest first


_NAME_HEIGHT = 8.5  # of a parameter's name, [point]
_ALONG = (0.5, 0.35, 0.65, 0.2, 0.8, 0.05, 0.95)  # where a name is tried, by a dimension's length
_NAME_DISTANCES = (1.0, -1.0, 1.8, -1.8, 2.8, -2.8, 4.0, -4.0)  # from it, in heights of the name
#: Of a name over another, outside the axes, nearer to another's line; in hidden points of lines.
_OVERLAP, _OUTSIDE, _ASTRAY = 300.0, 100.0, 8.0


class Names:
    """Names in axes whose limits are set, each where it hides least."""

    def __init__(self, axes: Axes, links: Array) -> None:
        """Begin with links that names should not hide, shape (n, 2, 2), right and up, [m]."""
        low, high = np.array((axes.get_xlim(), axes.get_ylim())).T
        figure: Any = axes.get_figure(root=True)
        paper = 72.0 * figure.get_size_inches() * axes.get_position().size
        self.axes = axes
        self._limits = low[1], high[1]
        self.point = float(np.max((high - low) / paper))
        """What a point of the paper is in the picture, [m]; legend and values take some room."""
        self.middle = links.mean(axis=(0, 1)) if len(links) else (low + high) / 2
        self._boxes = np.zeros((0, 2, 2))
        self._hidden = np.zeros((0, 2))
        for segment in links:
            self.keep_off(segment)

    def keep_off(self, line: Array) -> Array:
        """Let no name hide a line, shape (n, 2), if it can be helped; return 40 points of it."""
        places = np.linspace(0.0, len(line) - 1.0, 40)
        points = np.stack([np.interp(places, np.arange(len(line)), c) for c in line.T], axis=1)
        self._hidden = np.concatenate((self._hidden, points))
        return points

    def half(self, text: str, size: float) -> Array:
        """Return half the width and height of a name of a size in points, shape (2,), [m]."""
        shown = re.sub(r"[${}_]", "", re.sub(r"\\mathit|\\[a-z]+", "x", text).replace("x{", ""))
        return 0.5 * size * self.point * np.array((0.58 * (len(shown) + 0.8), 1.4))

    def write(
        self, text: str, places: Array, size: float, cost: Array | float = 0.0, **style: Any
    ) -> None:
        """Write a name at the first of some places, shape (n, 2), that hides and costs least."""
        half = self.half(text, size)
        low, high = places - half, places + half
        inside = np.abs(self._hidden - places[:, None]) < half + 0.3 * half[1]  # links are thick
        boxes = self._boxes
        over = (low[:, None] < boxes[:, 1]) & (boxes[:, 0] < high[:, None])
        cost = cost + inside.all(axis=2).sum(axis=1) + _OVERLAP * over.all(axis=2).sum(axis=1)
        bottom, top = self._limits  # what is beside them is in the picture all the same
        outside = (low[:, 1] < bottom) | (high[:, 1] > top)
        cost = cost + _OUTSIDE * outside + 0.4 * np.arange(len(places))
        best = int(np.argmin(cost))
        room = 0.3 * size * self.point  # names that touch read as one
        self._boxes = np.concatenate((boxes, [[low[best] - room, high[best] + room]]))
        x, y = places[best].tolist()
        self.axes.text(x, y, text, size=size, ha="center", va="center", zorder=9, **style)


def draw_dimensions(names: Names, dimensions: Sequence[Dimension], V: Array) -> None:
    """Draw dimensions as seen along V (see ``paint``), then their names beside their lines."""
    lines = [_draw_line(names, dimension, V) for dimension in dimensions]
    for dimension, line in zip(dimensions, lines, strict=True):
        text = symbol(dimension.name) if dimension.name else ""
        if dimension.kind == "reading":
            text = rf"$\psi$ ({text})" if text else r"$\psi$"
        half, places = names.half(text, _NAME_HEIGHT), []
        for distance, along in product(_NAME_DISTANCES, _ALONG):  # on its line first
            index = int(along * (len(line) - 1))
            across = _across(line[min(index + 1, len(line) - 1)] - line[max(index - 1, 0)])
            places.append(line[index] + 1.1 * distance * float(np.abs(across) @ half) * across)
        rest = np.vstack([[np.inf, np.inf], *(other for other in lines if other is not line)])
        astray = cdist(places, rest).min(axis=1) < 1.2 * cdist(places, line).min(axis=1)
        ground = {"fc": "white", "ec": "none", "alpha": 0.75, "pad": 0.6}
        style = {"color": DIMENSION, "parse_math": True, "bbox": ground}
        names.write(text, np.array(places), _NAME_HEIGHT, _ASTRAY * astray, **style)


def _draw_line(names: Names, dimension: Dimension, V: Array) -> Array:
    """Draw a dimension without its name; return points of its line as drawn, shape (n, 2)."""
    axes, height = names.axes, _NAME_HEIGHT * names.point
    line, thin, heads = dimension.line @ V[:2].T, [], "<|-|>"
    if dimension.beside:
        across = _across(line[-1] - line[0])
        across *= 1.0 if across @ (line.mean(axis=0) - names.middle) >= 0.0 else -1.0
        thin += [(end, end + 1.7 * height * across, "-") for end in line]
        line = line + 1.3 * height * across
    if dimension.corner is not None:
        corner, heads = dimension.corner @ V[:2].T, "-|>"
        thin += [(corner, corner + 1.15 * (end - corner), "--") for end in (line[0], line[-1])]
    for begin, end, dashes in thin:
        axes.plot(*np.stack((begin, end)).T, dashes, lw=0.5, color=DIMENSION, zorder=8)
    if np.linalg.norm(np.diff(line, axis=0), axis=1).sum() < 0.3 * height:
        heads = "-"
    arrow = FancyArrowPatch(path=Path(line), arrowstyle=heads, mutation_scale=6.0, lw=0.8)
    arrow.set(color=DIMENSION, fill=heads != "-", zorder=8)
    axes.add_patch(arrow)
    return names.keep_off(line)


def _across(along: Array) -> Array:
    """Return the unit vector to the left of one in the plane; upwards of none."""
    size = float(np.linalg.norm(along))
    return np.array([-along[1], along[0]]) / size if size > 0.0 else np.array([0.0, 1.0])
