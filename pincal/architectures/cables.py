"""Cable robots from a data sheet's dimensions, and cables that run over pulleys.

A cable over a pulley comes along the axis of a swivel and meets the pulley at the anchor A. It is
wrapped by an angle θ and leaves the pulley of radius r at the tangent, so that its length is r θ
plus the free length (A. Pott, Cable-Driven Parallel Robots, Springer 2018, section 7.2). Its joints
are the swivel; a revolute joint by θ about the pulley's middle; a slide that follows θ by the ratio
r and takes back the wrapped length; and the line, whose position is the whole length.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from math import atan2, hypot, pi, sqrt

import numpy as np

from pincal.architectures.architecture import Architecture, Values, length, text
from pincal.errors import MechanismError
from pincal.model import Follows, Joint, Leg, Mechanism, Placement, Platform, Sensor
from pincal.model.checks import EXACT, check_kinds
from pincal.types import Array

UP = (0.0, 0.0, 1.0)
_LABELS = {
    f"{letter}_{axis}": f"{label}, {axis}"
    for letter, label in (("A", "anchor"), ("b", "platform's corner"))
    for axis in "xyz"
} | {"k": "gain of the reading", "r": "radius of the pulley"}
_WITHIN = 0.8  # part of the room in the frame that a platform uses


def _cable(number: int, anchor: Array, corner: Array, home: Array) -> Leg:
    """Return a cable; anchor, corner (platform frame) and home have shape (2,) or (3,), [m]."""
    axes = "xyz"[: len(anchor)]
    values = {f"A_{axis}": float(value) for axis, value in zip(axes, anchor, strict=True)}
    values |= {f"b_{axis}": float(value) for axis, value in zip(axes, corner, strict=True)}
    along = home + corner - anchor
    length = float(np.linalg.norm(along))
    foot = Placement.of(values, **{axis: f"A_{axis}" for axis in axes})
    if len(axes) == 2:
        swivel = [Joint("swivel", "revolute", foot, home=atan2(along[1], along[0]))]
        direction = (1.0, 0.0, 0.0)
    else:
        frame, direction = np.eye(4), (0.0, 0.0, 1.0)  # z along the cable, y horizontal
        frame[:3, 2] = along / length
        level = np.cross((0.0, 0.0, 1.0), along)
        frame[:3, 1] = level / np.linalg.norm(level) if level.any() else (0.0, 1.0, 0.0)
        frame[:3, 0] = np.cross(frame[:3, 1], frame[:3, 2])
        turned = foot.at(values, frame)
        swivel = [
            Joint("swivel_x", "revolute", turned, (1.0, 0.0, 0.0), -pi / 2, pi / 2),
            Joint("swivel_y", "revolute", Placement(), (0.0, 1.0, 0.0), -pi / 2, pi / 2),
        ]
    line = Joint("line", "prismatic", Placement(), direction, 0.02 * length, 3.0 * length, length)
    end = Placement.of(values, **{axis: f"b_{axis}" for axis in axes})
    return Leg(
        name=f"cable_{number}",
        joints=(*swivel, line, Joint("tip", "fixed")),
        point=Joint(f"b_{number}", "fixed", end),
        sensors=(Sensor("line", form="reading", gain="k", zero="home"),),
        parameters=(*values.items(), ("k", 1.0)),
    )


def _robot(anchors: Array, corners: Array, platform: Platform) -> Mechanism:
    """Return a cable robot; anchors and corners have the shape (n_cables, 2) or (…, 3), [m]."""
    home = np.array(platform.home[: anchors.shape[1]])
    pairs = zip(anchors, corners, strict=True)
    legs = tuple(_cable(i, *pair, home) for i, pair in enumerate(pairs, start=1))
    return Mechanism("cables", platform, legs, labels=tuple(_LABELS.items()))


def _planar(d: Values) -> Mechanism:
    """Return a planar robot centred at the origin; if crossed, the cables of a side cross."""
    signs = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], dtype=float)
    side = (1, -1) if d["cables"] == "crossed" else (1, 1)
    anchors = signs * (d["frame_width"] / 2, d["frame_height"] / 2)
    corners = signs * side * np.array((d["platform_width"] / 2, d["platform_height"] / 2))
    return _robot(anchors, corners, Platform("planar", (0.0, 0.0, 0.0)))


def _spatial(d: Values) -> Mechanism:
    """Return a robot in a frame centred on z; cables turn one way above, the other way below."""
    anchors, corners = [], []
    for level, (x, y) in product((1, -1), ((1, 1), (-1, 1), (-1, -1), (1, -1))):
        z = d["upper"] if level > 0 else d["lower"]
        anchors.append((x * d["frame_length"] / 2, y * d["frame_width"] / 2, z))
        side = -level
        if d["cables"] == "turned":
            x, y = (-y, x) if level > 0 else (y, -x)
        elif d["cables"] == "straight":
            side = level
        sides = d["platform_length"], d["platform_width"], d["platform_height"]
        corners.append(np.multiply((x, y, side), sides) / 2)
    home = Platform("spatial", (0.0, 0.0, d["height"], 0.0, 0.0, 0.0))
    robot, radius = _robot(np.array(anchors), np.array(corners), home), d["pulley_radius"]
    if radius:
        robot = replace(robot, legs=tuple(over_pulley(leg, radius) for leg in robot.legs))
    return robot


def _in_plane(d: Values) -> str:
    """Return ranges in which a platform is well inside its frame, turned by at most 20°."""
    x, y = _free(d, "width", "height")
    return f"x={-x:g}..{x:g}, y={-y:g}..{y:g}, phi=-20deg..20deg"


def _in_space(d: Values) -> str:
    """Return ranges in which it is well inside its frame, tilted and turned by at most 20°."""
    x, y, z = _free({**d, "frame_height": d["upper"] - d["lower"]}, "length", "width", "height")
    middle = (d["upper"] + d["lower"]) / 2
    heights = f"z={middle - z:g}..{middle + z:g}"
    return f"x={-x:g}..{x:g}, y={-y:g}..{y:g}, {heights}, tilt=..20deg, torsion=-20deg..20deg"


def _free(d: Values, *sides: str) -> Array:
    """Return the range, ± [m], that a platform uses along each side of its frame."""
    room = [d[f"frame_{side}"] - d[f"platform_{side}"] for side in sides]
    return _WITHIN * np.maximum(room, 0.0) / 2


_FOUR = (
    length("frame_width", "distance of the anchors along x", 2.0),
    length("frame_height", "distance of the anchors along y", 0.75, "frame_width"),
    length("platform_width", "width of the platform", 0.15, "frame_width", below="frame_width"),
    length("platform_height", "platform's height", 1.0, "platform_width", below="frame_height"),
    text("cables", "way of the cables", "crossed", "straight"),
)
_EIGHT = (
    length("frame_length", "distance of the anchors along x", 4.0),
    length("frame_width", "distance of the anchors along y", 1.0, "frame_length"),
    length("upper", "height of the upper anchors", 0.75, "frame_length"),
    length("lower", "height of the lower anchors", 0.1, "upper", least=0.0),
    length("platform_length", "length of the platform", 0.2, "frame_length", below="frame_length"),
    length("platform_width", "width of the platform", 0.2, "frame_width", below="frame_width"),
    length("platform_height", "height of the platform", 1.0, "platform_width"),
    length("height", "height of the platform's middle at home", 0.5, "upper"),
    length("pulley_radius", "radius of the swivelling pulleys", 0.0, least=0.0),
    text("cables", "way of the cables", "turned", "crossed", "straight"),
)


CABLE_ROBOTS = (
    Architecture("cable-4", "Planar cable robot, four cables", _FOUR, _planar, _in_plane),
    Architecture("cable-8", "Cable robot in space, eight cables", _EIGHT, _spatial, _in_space),
)


def over_pulley(
    leg: Leg, radius: float, name: str = "r", axis: tuple[float, float, float] = UP
) -> Leg:
    """Return a cable, a universal joint at its anchor and a line, led over a pulley.

    Args:
        leg: The cable, closed at home.
        radius: Radius of the pulley, [m]; it becomes the last parameter of the leg.
        name: Name of that parameter.
        axis: Unit vector of the swivel, along which the cable comes to the pulley; base frame.

    Raises:
        MechanismError: the leg is no such cable, or its tip at home is within the pulley.

    Example:
        >>> import pincal
        >>> robot = pincal.load_mechanism("8cable")
        >>> pincal.over_pulley(robot.legs[0], 0.03).parameter_names[-1]
        'r'
    """
    check_kinds(locals(), over_pulley, MechanismError)
    if not is_cable(leg):
        raise MechanismError(
            f"{leg.name} cannot run over a pulley: expected a universal joint at the anchor, and a "
            "driven line through it that is zero there"
        )
    places = leg.link_placements(leg.home[None])[0, :, :3, 3]
    along = places[-1] - places[0]
    height = float(along @ axis)
    level = along - height * np.array(axis)
    radial = float(np.linalg.norm(level)) - radius
    if hypot(radial, height) <= radius or radial <= -radius:
        raise MechanismError(f"{leg.name}: its tip at home is within a pulley of {radius:g} m")
    free = sqrt(radial**2 + height**2 - radius**2)
    wrap = atan2(free * radial + radius * height, free * height - radius * radial)
    first, second, line, tip = leg.joints
    values = leg.nominal_by_name | {name: radius}
    constant = first.placement.rest(leg.nominal_by_name, leg.name).copy()
    drawn = first.placement.origin()[:3, :3] @ constant[:3, :3].T  # turn by coordinates
    x = level / np.linalg.norm(level) if level.any() else np.linalg.svd(np.array([axis]))[2][1]
    constant[:3, :3] = drawn.T @ np.stack((x, np.cross(axis, x), axis), axis=1)  # x towards home
    to_middle = Placement.of(values, x=name)
    middle = to_middle.at(values, np.diag((-1.0, -1.0, 1.0, 1.0)))  # x points back to the anchor
    arc = Joint("arc", "prismatic", to_middle, (0.0, 0.0, -1.0))
    joints = (
        replace(first, placement=first.placement.at(values, constant), axis=UP, home=0.0),
        replace(second, placement=middle, axis=(0.0, -1.0, 0.0), lower=0.0, upper=pi, home=wrap),
        replace(arc, follows=Follows(second.name, radius), ratio=name),
        replace(line, placement=Placement(), axis=UP, home=free + radius * wrap),
    )
    parameters = (*leg.parameters, (name, radius))
    return replace(leg, joints=(*joints, tip), parameters=parameters, settled=False)


def is_cable(leg: Leg) -> bool:
    """Return whether a leg is a universal joint and a driven line that is zero at its centre."""
    kinds = [joint.kind for joint in leg.joints[:4]]
    if kinds != ["revolute", "revolute", "prismatic", "fixed"] or len(leg.joints) > 4:
        return False
    places = leg.link_placements(leg.home[None])[0, :, :3, 3]
    to_second, length = np.linalg.norm(places[[1, 3]] - places[0], axis=1).tolist()
    driven = leg.active == [2] and not leg.ends and leg.closes == "point"
    return driven and max(to_second, abs(length - leg.home[2])) <= EXACT * leg.size
