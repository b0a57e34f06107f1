"""Plain shapes that a mechanism is drawn with: boxes, rods, balls, plates, frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from lxml import etree
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from pincal.show.style import DIMENSION
from pincal.types import Array

GREY, PALE = "#595959", "#9aa0a6"
_FLAT = 1e-6  # of what is a plane's size


@dataclass(frozen=True, eq=False)
class Shape:
    """A box, cylinder (along z) or sphere on a link, the hull of points, or a mesh."""

    kind: str
    size: tuple[float, ...]
    """Edges of a box; radius and length of a cylinder; radius of a sphere; else none; [m]."""
    T_link_shape: Array
    """Shape (4, 4)."""
    colour: str
    """``"#rrggbb"``."""
    points: Array | None = None
    """Of a hull, or corners of a mesh, shape (n, 3), [m]."""
    faces: NDArray[np.int64] | None = None
    """Corners of a mesh's triangles, shape (m, 3)."""


def rod(begin: Array, end: Array, radius: float, colour: str) -> Shape:
    """Return a cylinder between two points, shape (3,) each, [m]."""
    along = end - begin
    length = float(np.linalg.norm(along))
    T = np.eye(4)
    T[:3, 2] = along / length
    first = np.cross(T[:3, 2], np.eye(3)[int(np.argmin(np.abs(along)))])
    T[:3, 0] = first / np.linalg.norm(first)
    T[:3, 1] = np.cross(T[:3, 2], T[:3, 0])
    T[:3, 3] = (begin + end) / 2
    return Shape("cylinder", (radius, length), T, colour)


def axes_shapes(length: float) -> tuple[Shape, ...]:
    """Return the axes x, y and z of a frame."""
    return tuple(rod(np.zeros(3), end, 0.02 * length, DIMENSION) for end in length * np.eye(3))


def plate(points: Array, thickness: float) -> tuple[Shape, ...]:
    """Return a plate through points (n, 3), or a body if they are in no plane; none of a line."""
    sizes, axes = _principal(points)
    if sizes[1] <= _FLAT * sizes[0]:
        return ()
    shift = 0.5 * thickness * axes[2]
    corners = np.concatenate((points + shift, points - shift))
    return (Shape("hull", (), np.eye(4), GREY, corners[ConvexHull(corners).vertices]),)


def frame(feet: Array, radius: float) -> tuple[Shape, ...]:
    """Return rods around feet (n, 3) in a plane; none of a single foot or where there is none."""
    feet = np.unique(feet.round(9), axis=0)
    sizes, axes = _principal(feet)
    if len(feet) < 2 or sizes[2] > _FLAT * sizes[0]:
        return ()
    if sizes[1] <= _FLAT * sizes[0]:
        along = feet @ axes[0]
        return (rod(feet[np.argmin(along)], feet[np.argmax(along)], radius, PALE),)
    corners = feet[ConvexHull(feet @ axes[:2].T).vertices]
    return tuple(rod(corners[i - 1], corners[i], radius, PALE) for i in range(len(corners)))


def _principal(points: Array) -> tuple[Array, Array]:
    """Return sizes along the principal axes, shape (3,), and these, shape (3, 3), as rows."""
    _, sizes, axes = np.linalg.svd(points - points.mean(axis=0))
    return np.concatenate((sizes, np.zeros(3)))[:3], axes


def urdf_shapes(text: str) -> list[tuple[Shape, ...]]:
    """Return the visuals of a URDF that pincal wrote, link by link in the URDF's order."""
    robot: Any = etree.fromstring(text.encode())
    return [tuple(map(_shape, link.iter("visual"))) for link in robot.iter("link")]


def _shape(visual: Any) -> Shape:
    """Return a visual element: a box, a cylinder or a sphere."""
    (geometry,) = visual.find("geometry")
    size = [value for text in geometry.attrib.values() for value in _numbers(text)]
    origin = np.eye(4)
    if (placed := visual.find("origin")) is not None:
        origin[:3, :3] = Rotation.from_euler("xyz", _numbers(placed.get("rpy"))).as_matrix()
        origin[:3, 3] = _numbers(placed.get("xyz"))
    rgb = _numbers(visual.find("material/color").get("rgba"))[:3]
    colour = "#" + "".join(f"{round(255 * part):02x}" for part in rgb)
    return Shape(geometry.tag, tuple(size), origin, colour)


def _numbers(text: str) -> list[float]:
    return [float(word) for word in text.split()]
