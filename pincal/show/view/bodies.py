"""A mechanism as moving parts: shapes of its links, and their placements at every pose.

Parts are the links of legs, and shapes that rigid links cannot show: cylinder and piston of a
prismatic joint (a thin cable for joints called ``line`` or ``cable``), as long as the joint's
motion, and plates. Placements of a leg's links are NaN where it does not reach the pose.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from pincal.kinematics.configurations import as_plan, joints_at
from pincal.model import Joint, Leg, Mechanism, Plan
from pincal.show.style import ACTIVE, DIMENSION
from pincal.types import Array

GREY, PALE = "#595959", "#9aa0a6"
_CABLES = ("line", "cable")
_ORIGIN = np.zeros(3)
_FLAT = 1e-6  # thickness over size of points that count as a plane or a line


class Shape(NamedTuple):
    """A box, cylinder (along z), sphere or mesh on a link."""

    kind: str
    size: tuple[float, ...]
    """Edges of a box, radius and length of a cylinder, or radius of a sphere, [m]; else empty."""
    T_link_shape: Array
    """Pose of the shape in its link's frame, shape (4, 4)."""
    colour: str
    """Colour as ``"#rrggbb"``."""
    points: Array | None = None
    """Corners of a mesh, shape (n, 3), [m]."""
    faces: NDArray[np.int64] | None = None
    """Corners of a mesh's triangles, shape (m, 3)."""


def rod(begin: Array, end: Array, radius: float, colour: str) -> Shape:
    """Return a cylinder between two points, shape (3,) each, [m]."""
    along = end - begin
    size = radius, float(np.linalg.norm(along))
    return Shape("cylinder", size, _placed((begin + end) / 2, along), colour)


def plate(points: Array, thickness: float) -> tuple[Shape, ...]:
    """Return a plate through points, (n, 3), or a body if they span space; none for a line."""
    sizes, axes = _principal(points)
    if sizes[1] <= _FLAT * sizes[0]:
        return ()
    shift = 0.5 * thickness * axes[2]
    corners = np.concatenate((points + shift, points - shift))
    corners = corners[ConvexHull(corners).vertices]
    return (Shape("mesh", (), np.eye(4), PALE, corners, ConvexHull(corners).simplices),)


def frame(feet: Array, radius: float) -> tuple[Shape, ...]:
    """Return rods from each foot to the next, if all feet, (n, 3), lie in a plane; else none."""
    feet = np.unique(feet.round(9), axis=0)
    sizes, axes = _principal(feet)
    if len(feet) < 2 or sizes[2] > _FLAT * sizes[0]:
        return ()
    x, y = axes[:2] @ (feet - feet.mean(axis=0)).T
    corners = feet[np.argsort(np.arctan2(y, x))]
    return tuple(rod(corners[i - 1], corners[i], radius, PALE) for i in range(len(corners)))


def _principal(points: Array) -> tuple[Array, Array]:
    """Return sizes along the principal axes, shape (3,), and the axes as rows, shape (3, 3)."""
    _, sizes, axes = np.linalg.svd(points - points.mean(axis=0))
    return np.concatenate((sizes, np.zeros(3)))[:3], axes


def _placed(place: Array, along: Array) -> Array:
    """Return the pose of a shape at a place, with its z axis along a vector, shape (4, 4)."""
    (x, y, z), T = along, np.eye(4)
    turn = Rotation.from_euler("yz", (np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)))
    T[:3, :3], T[:3, 3] = turn.as_matrix(), place
    return T


def _link(joint: Joint, size: float) -> tuple[Shape, ...]:
    """Return the rod on a link to a joint; none to a joint at the link's origin."""
    end = np.array(joint.placement.xyz)
    return () if np.allclose(end, 0.0) else (rod(_ORIGIN, end, size / 2, GREY),)


def _size(leg: Leg) -> float:
    """Return a radius for joints, 3 % of the longest link or half stroke, to two digits, [m]."""
    lengths = [float(np.linalg.norm(joint.placement.xyz)) for joint in leg.joints[1:]]
    lengths += [abs(joint.home) / 2 for joint in leg.joints if joint.kind == "prismatic"]
    return float(f"{0.03 * (max(lengths) or 1.0):.1e}")


PISTON = "#b9bec5"
_UPWARD = np.eye(4)
_UPWARD[2, 3] = 0.5  # a cylinder of length 1 that begins at the origin


@dataclass(frozen=True, eq=False)
class Body:
    """A mechanism at N poses."""

    parts: dict[str, tuple[Shape, ...]]
    """Shapes of each moving part, by its place in the scene: ``leg 1/base``, ``leg 1/link 2``,
    ``leg 1/rod 3``, ``leg 1/cylinder 3``, ``platform/body``, ``platform/point 1``, ``base/frame``,
    ``base/axes``; legs, joints and points counted from 1."""
    placements: Array
    """``T_base_part``, shape (N, n_parts, 4, 4), [m]; NaN where a part is not drawn."""
    chains: tuple[tuple[int, ...], ...]
    """For each leg, the indices of its moving links among the parts, from the base on."""
    readings: Array
    """Sensor readings, shape (N, n_readings), [rad] or [m]; NaN where not reached."""
    problems: tuple[str, ...]
    """Reason, by pose, why a part is not drawn; empty if all parts are."""

    def part(self, path: str) -> int:
        """Return the index of a part by its path."""
        return list(self.parts).index(path)

    @property
    def platform(self) -> Array:
        """``T_base_platform``, shape (N, 4, 4)."""
        return self.placements[:, self.part("platform/body")]

    @property
    def axis(self) -> float:
        """Length of the axes of a frame, [m]."""
        return self.parts["base/axes"][0].size[1]

    @property
    def shapes(self) -> list[tuple[Shape, Array]]:
        """Shapes that are drawn at the first pose, each with its ``T_base_part``."""
        return [
            (shape, place)
            for shapes, place in zip(self.parts.values(), self.placements[0], strict=True)
            for shape in shapes
            if np.isfinite(place).all()
        ]


def body(mechanism: Mechanism, planned: Plan | Array) -> Body:
    """Return a mechanism at poses, (N, dof), with legs in their working modes or at readings.

    Raises:
        MechanismError: poses have a wrong shape, or are not finite.
    """
    solution = joints_at(mechanism, planned)
    T_base_platform = mechanism.platform.matrices(as_plan(mechanism, planned).poses)
    parts: dict[str, tuple[Shape, ...]] = {}
    placements: list[Array] = []
    chains = []

    def add(path: str, shapes: tuple[Shape, ...], placement: Array) -> None:
        parts[path] = shapes
        placements.append(np.broadcast_to(placement, T_base_platform.shape))

    for number, leg in enumerate(mechanism.legs, 1):
        joints = solution.joints[leg.name]
        foot, *shapes = _leg_shapes(leg)
        radius = foot[0].size[2]
        add(f"leg {number}/base", foot, np.eye(4))
        links = leg.link_placements(joints)
        chains.append(tuple(range(len(parts), len(parts) + len(shapes))))
        for place, link_shapes in enumerate(shapes):
            add(f"leg {number}/link {place + 1}", link_shapes, links[:, place])
        for path, shape, placement in _pistons(leg, joints, links, radius):
            add(f"leg {number}/{path}", (shape,), placement)
    points = {point.name: point for leg in mechanism.legs for point in leg.points}.values()
    size = max(map(_size, mechanism.legs))
    radius = 1.5 * size
    hub = Shape("cylinder", (radius, size), np.eye(4), GREY)
    arms = [arm for point in points for arm in _link(point, size)]
    solid = plate(np.array([point.placement.xyz for point in points]), 0.7 * size)
    ends = 5.0 * radius * np.eye(3)
    axes = tuple(rod(_ORIGIN, end, 0.1 * radius, DIMENSION) for end in ends)
    add("platform/body", (hub, *(solid or arms), *axes), T_base_platform)
    ball = (Shape("sphere", (1.2 * size,), np.eye(4), GREY),)
    for number, point in enumerate(points, 1):
        add(f"platform/point {number}", ball, T_base_platform @ point.placement.origin())
    feet = np.array([leg.joints[0].placement.xyz for leg in mechanism.legs])
    add("base/frame", frame(feet, 0.25 * size), np.eye(4))
    add("base/axes", axes, np.eye(4))
    problems = tuple(solution.reason(row) for row in range(len(T_base_platform)))
    T_base_part = np.stack(placements, axis=1)
    T_base_part[~np.isfinite(T_base_part).all(axis=(2, 3))] = np.nan
    return Body(parts, T_base_part, tuple(chains), np.array(solution.readings), problems)


def _leg_shapes(leg: Leg) -> list[tuple[Shape, ...]]:
    """Return the shapes of a leg's links, base first: a foot, joints, and rods to the next joints.

    Cylinders or winches drive sliders.
    """
    size, read = _size(leg), {sensor.joint for sensor in leg.sensors}
    foot = _placed(np.array(leg.joints[0].placement.xyz), np.eye(3)[2])
    links: list[tuple[Shape, ...]] = [(Shape("box", (3 * size, 3 * size, size), foot, GREY),)]
    for joint, carrier in zip(leg.joints, leg.carriers, strict=True):
        if carrier >= 0:
            links[carrier + 1] += _link(joint, size)
        place = _placed(_ORIGIN, np.array(joint.axis))
        colour = ACTIVE if joint.name in read else PALE
        if joint.kind == "revolute":
            shape = Shape("cylinder", (size, 3 * size), place, colour)
        elif joint.kind == "prismatic":
            if joint.name in _CABLES:
                links[0] = (links[0][0]._replace(colour=colour),)
            driven = joint.home or joint.name in _CABLES
            shape = Shape("box", (2 * size, 2 * size, 4 * size), place, PALE if driven else colour)
        else:
            shape = Shape("sphere", (size,), np.eye(4), PALE)
        links.append((shape,))
    return links


def _pistons(
    leg: Leg, joints: Array, links: Array, radius: float
) -> Iterator[tuple[str, Shape, Array]]:
    """Yield path, shape and placements of the rods and cylinders of prismatic joints.

    Rod and cylinder reach back from the slider to its zero; at home the cylinder is half of their
    length. Cables have no cylinder, and lose the length that a pulley has wrapped. Joints have
    shape (N, n_joints), links (N, n, 4, 4).
    """
    read = {sensor.joint for sensor in leg.sensors}
    positions = {joint.name: q for joint, q in zip(leg.moving, joints.T, strict=True)}
    for place, joint in enumerate(leg.joints):
        if joint.kind != "prismatic" or joint.ratio:
            continue
        axis, strokes = np.array(joint.axis), joint.position(positions)
        before = leg.joints[max(leg.carriers[place], 0)]
        if before.ratio and before.kind == "prismatic":
            strokes = strokes + before.position(positions) * float(axis @ before.axis)
        cable = joint.name in _CABLES
        inside = 0.0 if cable else 0.5 * joint.home
        drawn = strokes - inside * ((strokes - inside) * inside > 0.0)
        drawn = np.where(np.abs(drawn) > 1e-9, drawn, np.nan)
        T_slider_rod = np.tile(_placed(_ORIGIN, axis), (len(strokes), 1, 1))
        T_slider_rod[:, :3, 2] *= -drawn[:, None]
        thin = Shape("cylinder", ((0.16 if cable else 0.4) * radius, 1.0), _UPWARD, PISTON)
        yield f"rod {place + 1}", thin, links[:, place] @ T_slider_rod
        if inside:
            T_slider_zero = np.tile(np.eye(4), (len(strokes), 1, 1))
            T_slider_zero[:, :3, 3] = -strokes[:, None] * axis
            colour = ACTIVE if joint.name in read else GREY
            outer = rod(_ORIGIN, inside * axis, 0.8 * radius, colour)
            yield f"cylinder {place + 1}", outer, links[:, place] @ T_slider_zero
