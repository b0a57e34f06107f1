"""A mechanism as parts that move: shapes of its links, and where each is at every pose.

Parts are what the exported URDFs draw, and what rigid links cannot show: cylinder and piston or
cable of a prismatic joint, as long as the joint has moved, parallelograms, plates (``solids``).
Where a leg does not reach, its links are NaN.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from lxml import etree
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pincal.files.urdf_writing import leg_urdf, platform_urdf
from pincal.kinematics.configurations import as_plan, joints_at
from pincal.model.leg import Leg
from pincal.model.links import link_placements
from pincal.model.measuring.measurements import Plan
from pincal.model.mechanism import Mechanism
from pincal.show.view.solids import (
    GREY,
    Shape,
    base,
    parallel_frame,
    parallelogram,
    plate,
    pulls,
    two_rods,
)

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Part:
    """What moves as one."""

    path: str
    """Place in the scene: ``leg 1/base``, ``leg 1/link 2``, ``leg 1/rod 3``, ``leg 1/cylinder 3``,
    ``leg 1/parallel 4``, ``platform/body``, ``platform/point 1``, ``base/frame``; legs, joints and
    points counted from 1."""
    shapes: tuple[Shape, ...]


@dataclass(frozen=True, eq=False)
class Body:
    """A mechanism at N poses."""

    parts: tuple[Part, ...]
    placements: Array
    """``T_base_part``, shape (N, n_parts, 4, 4), [m]; NaN where it is not to be drawn."""
    chains: tuple[tuple[int, ...], ...]
    """For each leg, its links' places among the parts, base first, without base link and rods."""
    problems: tuple[str, ...]
    """Why something is not drawn at a pose; empty strings where all is."""
    barrels: dict[str, float]
    """Lengths of cylinders around prismatic joints, by the path of the rod, [m]; 0 of none."""

    def part(self, path: str) -> int:
        """Return a part's place by its path."""
        return [part.path for part in self.parts].index(path)

    def skeletons(self) -> Array:
        """Return segments from joint to joint and tip to platform, shape (N, n, 2, 3), [m]."""
        at = self.placements[:, :, :3, 3]
        platform = self.part("platform/body")
        pairs = np.array(
            [pair for c in self.chains for pair in zip(c, (*c[1:], platform), strict=True)]
        )
        return at[:, pairs]


def body(
    mechanism: Mechanism, planned: Plan | Array, barrels: Mapping[str, float] | None = None
) -> Body:
    """Return a mechanism at poses, each leg in its working mode, or as readings say.

    Args:
        mechanism: The mechanism, at its nominal parameters.
        planned: Platform coordinates, shape (N, dof), [m] and [rad], or a plan.
        barrels: Lengths of cylinders, of a body at other poses; else they suit these.

    Raises:
        MechanismError: poses of a wrong shape, or not finite.
    """
    platform = mechanism.platform
    solution = joints_at(mechanism, planned)
    poses = as_plan(mechanism, planned).poses
    T_base_platform = platform.matrices(poses)
    parts: list[Part] = []
    placements: list[Array] = []
    chains = []
    lengths = dict(barrels or {})

    def add(path: str, shapes: tuple[Shape, ...], placement: Array) -> None:
        parts.append(Part(path, shapes))
        placements.append(np.broadcast_to(placement, (len(poses), 4, 4)))

    for number, leg in enumerate(mechanism.legs, 1):
        joints = solution.joints[leg.name]
        foot, *shapes = urdf_shapes(leg_urdf(leg))
        radius = foot[0].size[2]
        add(f"leg {number}/base", foot, np.eye(4))
        links = link_placements(leg, joints)
        chains.append(tuple(range(len(parts), len(parts) + len(shapes))))
        pair = parallelogram(leg) if mechanism.platform.kind == "translational" else None
        for place, own in enumerate(shapes):
            rigid = own[:1] if place == pair else own
            add(f"leg {number}/link {place + 1}", rigid, links[:, place])
        if pair is not None:
            frame = parallel_frame(leg, links, pair)
            add(f"leg {number}/parallel {pair + 1}", two_rods(leg, radius), frame)
        for place, column in _strokes(leg):
            axis, strokes = leg.joints[place].axis, joints[:, column]
            thin = 0.16 * radius if pulls(leg) else 0.4 * radius
            piston = Shape("cylinder", (thin, 1.0), _UPWARD, PISTON)
            path = f"leg {number}/rod {place + 1}"
            inside = lengths.setdefault(path, 0.0 if pulls(leg) else _barrel(strokes))
            rod, barrel = _rod(axis, strokes, inside)
            add(path, (piston,), links[:, place] @ rod)
            if inside:
                outer = Shape("cylinder", (0.8 * radius, 1.0), _UPWARD, GREY)
                add(f"leg {number}/cylinder {place + 1}", (outer,), links[:, place] @ barrel)
    shapes = urdf_shapes(platform_urdf(mechanism.name, mechanism.legs))
    points = {leg.point.name: leg.point for leg in mechanism.legs}
    corners = np.array([point.placement.xyz for point in points.values()])
    size = shapes[0][0].size[1]
    solid = plate(corners, 0.7 * size)
    add("platform/body", (*shapes[0][:1], *solid) if solid else shapes[0], T_base_platform)
    for number, (point, own) in enumerate(zip(points.values(), shapes[1:], strict=True), 1):
        add(f"platform/point {number}", own, T_base_platform @ point.placement.origin())
    feet = np.array([leg.joints[0].placement.xyz for leg in mechanism.legs])
    home = platform.home_pose.as_matrix()[0, :3, 3]
    add("base/frame", base(feet, home, size), np.eye(4))
    problems = tuple(solution.reason(row) for row in range(len(poses)))
    T_base_part = np.stack(placements, axis=1)
    T_base_part[~np.isfinite(T_base_part).all(axis=(2, 3))] = np.nan
    return Body(tuple(parts), T_base_part, tuple(chains), problems, lengths)


PISTON = "#b9bec5"
#: Length of a cylinder, of the shortest stroke.
BARREL = 0.62
_UPWARD = np.eye(4)
_UPWARD[2, 3] = 0.5  # a cylinder of length 1 that begins at the origin


def _strokes(leg: Leg) -> list[tuple[int, int]]:
    """Return the places of a leg's prismatic joints, among all joints and among the moving ones."""
    moving = [joint.name for joint in leg.moving]
    return [
        (place, moving.index(joint.name))
        for place, joint in enumerate(leg.joints)
        if joint.kind == "prismatic"
    ]


def _barrel(strokes: Array) -> float:
    """Return the length of a cylinder that suits strokes, shape (N,), [m]; 0 where none does."""
    shortest = float(np.nanmin(np.abs(strokes), initial=np.inf))
    longest = float(np.nanmax(np.abs(strokes), initial=0.0))
    return 0.0 if longest > 3.0 * shortest else BARREL * shortest


def _rod(axis: tuple[float, float, float], strokes: Array, inside: float) -> tuple[Array, Array]:
    """Return ``T_slider_rod`` and ``T_slider_cylinder``, from z = 0 to 1, shape (N, 4, 4) each.

    Together they reach back from the slider to where it is at zero.

    Args:
        axis: Of the joint.
        strokes: Shape (N,), [m].
        inside: Length of the cylinder, [m].
    """
    _, _, (_, across, other) = np.linalg.svd([axis])
    frames = np.zeros((2, len(strokes), 4, 4))
    frames[:] = np.eye(4)
    frames[..., :3, 0], frames[..., :3, 1] = across, other
    moved = np.where(np.abs(strokes) > 1e-9, strokes, np.nan)
    parts = (moved - inside * np.sign(moved), inside * np.sign(moved))
    frames[..., :3, 2] = -np.multiply.outer(np.array(parts), np.array(axis))
    frames[1, :, :3, 3] = frames[0, :, :3, 2]
    return frames[0], frames[1]


def urdf_shapes(text: str) -> list[tuple[Shape, ...]]:
    """Return the visuals of a URDF that pincal wrote, link by link in the URDF's order."""
    robot: Any = etree.fromstring(text.encode())
    return [tuple(map(_shape, link.iter("visual"))) for link in robot.iter("link")]


def _shape(visual: Any) -> Shape:
    """Return a visual element: a box, a cylinder or a sphere."""
    (geometry,) = visual.find("geometry")
    keys = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}
    size = [value for key in keys[geometry.tag] for value in _numbers(geometry.get(key))]
    origin = np.eye(4)
    if (placed := visual.find("origin")) is not None:
        origin[:3, :3] = Rotation.from_euler("xyz", _numbers(placed.get("rpy"))).as_matrix()
        origin[:3, 3] = _numbers(placed.get("xyz"))
    rgb = _numbers(visual.find("material/color").get("rgba"))[:3]
    colour = "#" + "".join(f"{round(255 * part):02x}" for part in rgb)
    return Shape(geometry.tag, tuple(size), origin, colour)


def _numbers(text: str) -> list[float]:
    return [float(word) for word in text.split()]
