"""A mechanism as parts that move: shapes of its links, and where each is at every pose.

Parts are what the exported URDFs draw, and a rod for each prismatic joint, as long as the joint
has moved; a URDF's rigid links cannot show that. Where a leg does not reach, its links are NaN.
"""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pincal.files.urdf_writing import leg_urdf, platform_urdf
from pincal.kinematics.configurations import as_plan, joints_at
from pincal.model.leg import Leg
from pincal.model.links import link_placements
from pincal.model.measuring.measurements import Plan
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Shape:
    """A box, cylinder (along z) or sphere on a link."""

    kind: str
    size: tuple[float, ...]
    """Edges of a box; radius and length of a cylinder; radius of a sphere; [m]."""
    T_link_shape: Array
    """Shape (4, 4)."""
    colour: str
    """``"#rrggbb"``."""


@dataclass(frozen=True)
class Part:
    """What moves as one."""

    path: str
    """Place in the scene: ``leg 1/base``, ``leg 1/link 2``, ``leg 1/rod 3``, ``platform/body``,
    ``platform/point 1``; legs, joints and points counted from 1."""
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


def body(mechanism: Mechanism, planned: Plan | Array) -> Body:
    """Return a mechanism at poses, each leg in its working mode, or as readings say.

    Args:
        mechanism: The mechanism, at its nominal parameters.
        planned: Platform coordinates, shape (N, dof), [m] and [rad], or a plan.

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

    def add(path: str, shapes: tuple[Shape, ...], placement: Array) -> None:
        parts.append(Part(path, shapes))
        placements.append(np.broadcast_to(placement, (len(poses), 4, 4)))

    for number, leg in enumerate(mechanism.legs, 1):
        joints = solution.joints[leg.name]
        base, *shapes = urdf_shapes(leg_urdf(leg))
        add(f"leg {number}/base", base, np.eye(4))
        links = link_placements(leg, joints)
        chains.append(tuple(range(len(parts), len(parts) + len(shapes))))
        for place, own in enumerate(shapes):
            add(f"leg {number}/link {place + 1}", own, links[:, place])
        for place, column in _strokes(leg):
            slider = shapes[place][0]
            rod = _rod(leg.joints[place].axis, joints[:, column])
            shape = Shape("cylinder", (slider.size[0] / 4, 1.0), _UPWARD, _GREY)
            add(f"leg {number}/rod {place + 1}", (shape,), links[:, place] @ rod)
    shapes = urdf_shapes(platform_urdf(mechanism.name, mechanism.legs))
    add("platform/body", shapes[0], T_base_platform)
    points = {leg.point.name: leg.point for leg in mechanism.legs}
    for number, (point, own) in enumerate(zip(points.values(), shapes[1:], strict=True), 1):
        add(f"platform/point {number}", own, T_base_platform @ point.placement.origin())
    problems = tuple(solution.reason(row) for row in range(len(poses)))
    T_base_part = np.stack(placements, axis=1)
    T_base_part[~np.isfinite(T_base_part).all(axis=(2, 3))] = np.nan
    return Body(tuple(parts), T_base_part, tuple(chains), problems)


_GREY = "#595959"
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


def _rod(axis: tuple[float, float, float], strokes: Array) -> Array:
    """Return ``T_slider_rod`` of rods from z = 0 to 1, stretched to reach back, shape (N, 4, 4)."""
    _, _, (_, across, other) = np.linalg.svd([axis])
    rod = np.zeros((len(strokes), 4, 4))
    rod[:] = np.eye(4)
    rod[:, :3, 0], rod[:, :3, 1] = across, other
    rod[:, :3, 2] = -np.where(np.abs(strokes) > 1e-9, strokes, np.nan)[:, None] * axis
    return rod


def urdf_shapes(text: str) -> list[tuple[Shape, ...]]:
    """Return the visuals of a URDF that pincal wrote, link by link in the URDF's order."""
    import yourdfpy  # slow to import, and needed here only

    urdf = yourdfpy.URDF.load(BytesIO(text.encode()), load_meshes=False, build_scene_graph=False)
    return [tuple(map(_shape, link.visuals)) for link in urdf.robot.links]


def _shape(visual: Any) -> Shape:
    """Return a visual of yourdfpy's."""
    geometry = visual.geometry
    if geometry.box is not None:
        kind, size = "box", geometry.box.size
    elif geometry.cylinder is not None:
        kind, size = "cylinder", (geometry.cylinder.radius, geometry.cylinder.length)
    else:
        kind, size = "sphere", (geometry.sphere.radius,)
    origin = np.eye(4) if visual.origin is None else np.asarray(visual.origin, dtype=np.float64)
    colour = "#" + "".join(f"{round(255 * c):02x}" for c in visual.material.color.rgba[:3])
    return Shape(kind, tuple(map(float, size)), origin, colour)
