"""What makes joints and points a machine: plates, the base, cylinders, cables, parallelograms.

Names of joints say what kinematics do not: a ``line`` or ``cable`` pulls, and a rod behind a joint
called ``elbow`` or ``sway`` of a platform that does not turn is a parallelogram.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from pincal.model.leg import Leg

Array = NDArray[np.float64]
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
    T[:3, 0], T[:3, 1] = across(T[:3, 2])
    T[:3, 3] = (begin + end) / 2
    return Shape("cylinder", (radius, length), T, colour)


def across(axis: Array) -> tuple[Array, Array]:
    """Return two unit vectors that make a right-handed frame with a unit vector as its z."""
    first = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    first /= np.linalg.norm(first)
    return first, np.cross(axis, first)


def plate(points: Array, thickness: float, colour: str = GREY) -> tuple[Shape, ...]:
    """Return a plate through points, or a body where they are in no plane; none of a line.

    Args:
        points: Shape (n, 3), [m].
        thickness: [m].
        colour: ``"#rrggbb"``.
    """
    sizes, turned = _principal(points)
    if sizes[1] < _FLAT * sizes[0] or not sizes[0]:
        return ()
    shift = 0.5 * thickness * turned[2]
    both = np.concatenate((points + shift, points - shift))
    return (Shape("hull", (), np.eye(4), colour, both[ConvexHull(both).vertices]),)


def base(feet: Array, home: Array, size: float) -> tuple[Shape, ...]:
    """Return what feet stand on: a plate where the machine is above them, else a frame.

    Args:
        feet: Shape (n, 3), [m].
        home: Of the platform, shape (3,), [m].
        size: Radius of joints, [m].
    """
    distinct = np.unique(feet.round(9), axis=0)
    if len(distinct) < 2:
        return ()
    sizes, turned = _principal(distinct)
    if sizes[1] < _FLAT * sizes[0]:
        along = distinct @ turned[0]
        ends = distinct[[int(np.argmin(along)), int(np.argmax(along))]]
        return (rod(ends[0], ends[1], 0.25 * size, PALE),)
    if sizes[2] > _FLAT * sizes[0]:
        return ()
    level = distinct.mean(axis=0)
    if (home - level) @ np.array([0, 0, 1.0]) > size and abs(turned[2, 2]) > 1 - _FLAT:
        lowered = distinct - np.array([0.0, 0.0, 0.9 * size])
        return plate(lowered, 0.6 * size, PALE)
    corners = distinct[ConvexHull(distinct @ turned[:2].T).vertices]
    pairs = zip(corners, np.roll(corners, -1, axis=0), strict=True)
    return tuple(rod(first, second, 0.25 * size, PALE) for first, second in pairs)


def _principal(points: Array) -> tuple[Array, Array]:
    """Return sizes along the principal axes, shape (3,), and these, shape (3, 3), as rows."""
    _, sizes, turned = np.linalg.svd(points - points.mean(axis=0))
    return np.concatenate((sizes, np.zeros(3)))[:3], turned


def pulls(leg: Leg) -> bool:
    """Return whether a leg is a cable."""
    return any(j.kind == "prismatic" and j.name in ("line", "cable") for j in leg.joints)


def parallelogram(leg: Leg) -> int | None:
    """Return the place, among all joints, of the one that carries a parallelogram's rods."""
    place = len(leg.joints) - 2
    hinge = leg.joints[place - 1] if place > 0 else None
    if hinge is None or not hinge.name.startswith(("elbow", "sway", "swing")):
        return None
    both = leg.joints[place].kind == hinge.kind == "revolute"
    return place if both and np.any(leg.joints[-1].placement.xyz) else None


def two_rods(leg: Leg, radius: float) -> tuple[Shape, ...]:
    """Return a parallelogram in a frame whose x is along its rods and whose y is along its hinges.

    Args:
        leg: The leg.
        radius: Of joints, [m].
    """
    length = float(np.linalg.norm(leg.joints[-1].placement.xyz))
    half, parts = 2.4 * radius, []
    for side in (-half, half):
        ends = np.array([[0.0, side, 0.0], [length, side, 0.0]])
        parts.append(rod(ends[0], ends[1], 0.35 * radius, GREY))
    for place in (0.0, length):
        ends = np.array([[place, -half, 0.0], [place, half, 0.0]])
        parts.append(rod(ends[0], ends[1], 0.4 * radius, GREY))
    return tuple(parts)


def parallel_frame(leg: Leg, links: Array, place: int) -> Array:
    """Return ``T_base_parallelogram``, shape (N, 4, 4): hinges stay parallel, so it shears.

    Args:
        leg: The leg.
        links: ``T_base_link`` of all joints, shape (N, n, 4, 4).
        place: Of the joint that carries the rods.
    """
    along = np.array(leg.joints[-1].placement.xyz)
    T = links[:, place].copy()
    T[:, :3, 0] = links[:, place, :3, :3] @ (along / np.linalg.norm(along))
    T[:, :3, 1] = links[:, place - 1, :3, :3] @ np.array(leg.joints[place - 1].axis)
    T[:, :3, 2] = np.cross(T[:, :3, 0], T[:, :3, 1])
    return T
