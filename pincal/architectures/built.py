"""Architectures built from numbers: cable robots, and serial arms of a table."""

from __future__ import annotations

from itertools import product
from math import atan2, pi
from typing import Any

import numpy as np

from pincal.architectures.dimension import Architecture, Values, length, text
from pincal.errors import MechanismError
from pincal.files.table import is_dataframe, read_table
from pincal.formats.arm import arm
from pincal.model.leg import Joint, Leg
from pincal.model.mechanism import Mechanism
from pincal.model.placement import Placement, placement_of
from pincal.model.platform import Platform
from pincal.model.sensor import Sensor
from pincal.types import Array

_LABELS = {
    f"{letter}_{axis}": f"{label}, {axis}"
    for letter, label in (("A", "anchor"), ("b", "platform's corner"))
    for axis in "xyz"
} | {"k": "gain of the reading"}
_WITHIN, _TURN = 0.8, pi / 9  # of the room that a platform has in its frame; from upright


def _cable(number: int, anchor: Array, corner: Array, home: Array) -> Leg:
    """Return a cable by number; anchor, corner in the platform, home are (2,) or (3,), [m]."""
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
        frame, direction = np.eye(4), (0.0, 0.0, 1.0)  # z along the cable, y level
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
    """Return a cable robot of anchors and corners, shape (n_cables, 2) or (n_cables, 3), [m]."""
    home = np.array(platform.home[: anchors.shape[1]])
    pairs = zip(anchors, corners, strict=True)
    legs = tuple(_cable(i, *pair, home) for i, pair in enumerate(pairs, start=1))
    return Mechanism("cables", platform, legs, labels=tuple(_LABELS.items()))


def _planar(d: Values) -> Mechanism:
    """Frame and platform have their middle at the origin; crossed, cables of one side cross."""
    signs = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], dtype=float)
    side = (1, -1) if d["cables"] == "crossed" else (1, 1)
    anchors = signs * (d["frame_width"] / 2, d["frame_height"] / 2)
    corners = signs * side * np.array((d["platform_width"] / 2, d["platform_height"] / 2))
    return _robot(anchors, corners, Platform("planar", (0.0, 0.0, 0.0)))


def _spatial(d: Values) -> Mechanism:
    """The frame's middle is over the origin; a quarter turn goes one way above, the other below."""
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
    return _robot(np.array(anchors), np.array(corners), home)


def _in_plane(d: Values) -> tuple[Array, Array]:
    """Return where a platform is well inside its frame, turned by 20° at most."""
    half = _free(d, "width", "height")
    high = np.array([*half, _TURN])
    return -high, high


def _in_space(d: Values) -> tuple[Array, Array]:
    """Return where a platform is well inside its frame, tilted and turned by 20° at most."""
    height = d["upper"] - d["lower"]
    half = _free({**d, "frame_height": height}, "length", "width", "height")
    middle = np.array([0.0, 0.0, (d["upper"] + d["lower"]) / 2])
    return (
        np.array([*(middle - half), -np.pi, 0.0, -_TURN]),
        np.array([*(middle + half), np.pi, _TURN, _TURN]),
    )


def _free(d: Values, *sides: str) -> Array:
    """Return most of half the room that a platform has along the sides of its frame, [m]."""
    room = [d[f"frame_{side}"] - d[f"platform_{side}"] for side in sides]
    return _WITHIN * np.maximum(room, 0.0) / 2


_FOUR = (
    length("frame_width", "distance of the anchors along x", 2.0),
    length("frame_height", "distance of the anchors along y", 0.75, "frame_width"),
    length("platform_width", "width of the platform", 0.15, "frame_width", below="frame_width"),
    length("platform_height", "its height", 1.0, "platform_width", below="frame_height"),
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
    text("cables", "way of the cables", "turned", "crossed", "straight"),
)
CABLES = (
    Architecture("cable-4", "Planar cable robot, four cables", _FOUR, _planar, _in_plane),
    Architecture("cable-8", "Cable robot in space, eight cables", _EIGHT, _spatial, _in_space),
)


def dh_joints(table: Any, convention: str = "standard") -> tuple[Joint, ...]:
    """Return the joints of a table of Denavit and Hartenberg, the tool's frame last.

    Row i of the standard convention is Rz(θ) Tz(d) Tx(a) Rx(α), turned by its joint about z first;
    of the modified one (Craig) Rx(α) Tx(a) Rz(θ) Tz(d), turned about z behind Tx(a).

    The table, a CSV file or pandas DataFrame, is of revolute joints: ``a [mm]``, ``alpha [deg]``,
    ``d [mm]``, ``theta [deg]`` (where the joint reads zero); if wanted ``lower [deg]`` and
    ``upper [deg]``, limits.
    """
    read = read_table(table)
    units = {"a": "m", "alpha": "rad", "d": "m", "theta": "rad"}
    rows = np.column_stack([read.numbers(name, unit) for name, unit in units.items()])
    limits = [
        read.numbers(name, "rad") if name in read else np.full(len(rows), usual)
        for name, usual in (("lower", -pi), ("upper", pi))
    ]
    T_behind_joint, joints = np.eye(4), []
    for number, ((a, alpha, d, theta), lower, upper) in enumerate(
        zip(rows.tolist(), *map(Array.tolist, limits), strict=True), start=1
    ):
        turn, lift = Placement.of({}, rz=theta).origin(), Placement.of({}, z=d).origin()
        link = before = np.eye(4)
        if convention == "standard":
            link = Placement.of({}, x=a, rx=alpha).origin()
        else:
            before = Placement.of({}, rx=alpha, x=a).origin()
        place = placement_of(T_behind_joint @ before @ turn)
        joints.append(Joint(f"joint_{number}", "revolute", place, lower=lower, upper=upper))
        T_behind_joint = lift @ link
    return (*joints, Joint("tip", "fixed", placement_of(T_behind_joint)))


def _arm(d: Values) -> Mechanism:
    """Return the arm of a table."""
    if not is_dataframe(d["dh"]) and not d["dh"]:
        raise MechanismError(
            "an arm is made of a table of Denavit and Hartenberg (dh); one of a URDF is read by "
            "'pincal import --tip LINK', or Mechanism.from_urdf"
        )
    convention = d["convention"]
    description = f"Serial arm of a table of Denavit and Hartenberg, {convention} convention."
    return arm("arm", dh_joints(d["dh"], convention), description)


_ARM = (
    text("dh", "CSV table of Denavit and Hartenberg"),
    text("convention", "of the table", "standard", "modified"),
)
ARM = Architecture("arm", "Serial arm", _ARM, _arm)
