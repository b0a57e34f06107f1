"""The parameters of a leg as dimensions of a drawing: lengths, angles, and what the sensors read.

Each named coordinate of a placement is one: a displacement is a length from where it begins to
where it ends, a turn is an angle about where it happens.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pincal.model.leg import Joint, Leg
from pincal.model.placement import Coordinate, Step
from pincal.model.sensor import Sensor

Array = NDArray[np.float64]
_ARC = np.linspace(0.0, 1.0, 41)
_SHORT = 1e-6  # of an arc's radius: a length that cannot be seen


@dataclass(frozen=True, eq=False)
class Dimension:
    """A length or an angle in a drawing."""

    names: tuple[str, ...]
    """Of the parameters: one, or those of a sensor."""
    kind: Literal["length", "angle", "reading"]
    line: Array
    """Points along it, from where it is measured, shape (n, 3), base frame, [m]."""
    corner: Array | None = None
    """Of an angle, shape (3,), [m]."""
    beside: bool = False
    """Whether the line lies on a link, so that it is better drawn beside that."""


def dimensions_of(leg: Leg, joints: Array, T_base_platform: Array, size: float) -> list[Dimension]:
    """Return the dimensions of a leg.

    Args:
        leg: The leg, at its nominal parameters.
        joints: Positions of its moving joints, shape (n_joints,), [rad] or [m].
        T_base_platform: The pose, shape (4, 4).
        size: Radius of the smallest arc, [m].
    """
    values = leg.nominal_by_name
    found: list[Dimension] = []
    frames = [np.eye(4)]
    moving = iter(joints)
    read: list[tuple[Sensor, Joint, Array, float]] = []
    for index, joint in enumerate(leg.joints):
        found += _placed(joint, values, frames[-1], size, beside=index > 0)
        T = frames[-1] @ joint.placement.origin()
        position = float(next(moving)) if joint.kind != "fixed" else 0.0
        read += [(one, joint, T, position) for one in leg.sensors if one.joint == joint.name]
        frames.append(T @ _motion(joint, position))
    places = np.array([T[:3, 3] for T in frames[1:]])
    found += [_read(*one, places, size) for one in read]
    found += _placed(leg.point, values, T_base_platform, size, beside=False)
    return found


def _motion(joint: Joint, position: float) -> Array:
    """Return a joint's displacement, shape (4, 4)."""
    T = np.eye(4)
    if joint.kind == "revolute":
        T[:3, :3] = _turned(np.eye(3), np.array(joint.axis), position)
    elif joint.kind == "prismatic":
        T[:3, 3] = position * np.array(joint.axis)
    return T


def _turned(vectors: Array, axis: Array, angle: float | Array) -> Array:
    """Return vectors, (..., 3), turned about a unit axis (Rodrigues); columns of a matrix too."""
    K = np.cross(np.eye(3), axis)
    angles = np.asarray(angle)[..., None, None]
    return np.asarray((np.eye(3) + np.sin(angles) * K + (1.0 - np.cos(angles)) * (K @ K)) @ vectors)


def _placed(
    joint: Joint, values: dict[str, float], T: Array, size: float, *, beside: bool
) -> Iterator[Dimension]:
    """Yield the dimensions of a joint's placement on its parent link, that at T, (4, 4)."""
    for coordinate in joint.placement.coordinates:
        yield from _of_coordinate(coordinate, values, T, size, beside)
        part = np.eye(4)
        for step in coordinate.steps:
            part = part @ step.matrix(values)
        if not coordinate.turns:
            part[:3, :3] = np.eye(3)
        T = T @ part


def _of_coordinate(
    coordinate: Coordinate, values: dict[str, float], T: Array, size: float, beside: bool
) -> Iterator[Dimension]:
    """Yield the dimensions of a coordinate's values that are parameters."""
    reach = sum(abs(step.amount(values)) for step in coordinate.steps if step.axis in "xyz")
    radius = size if reach < size else max(size, 0.3 * reach)
    done: set[str] = set()
    frames = [T]
    for step in coordinate.steps:
        frames.append(frames[-1] @ step.matrix(values))
    for step, (before, after) in zip(coordinate.steps, pairwise(frames), strict=True):
        if not isinstance(step.value, str) or step.value in done:
            continue
        done.add(step.value)
        if step.axis in "xyz":
            yield Dimension(
                (step.value,), "length", np.stack((before[:3, 3], after[:3, 3])), beside=beside
            )
        else:
            yield _angle((step.value,), step, values, before, radius * (1.0 + 0.35 * len(done)))


def _angle(
    names: tuple[str, ...], step: Step, values: dict[str, float], T: Array, radius: float
) -> Dimension:
    """Return the angle of a turn, from the axis that it turns first to where that goes."""
    axis, zero = T[:3, "xyz".index(step.axis[-1])], {"rx": 1, "ry": 2, "rz": 0}[step.axis]
    arc = _turned(T[:3, zero], axis, step.amount(values) * _ARC)
    return Dimension(names, "angle", T[:3, 3] + radius * arc, T[:3, 3])


def _read(
    sensor: Sensor, joint: Joint, T: Array, position: float, places: Array, size: float
) -> Dimension:
    """Return what a sensor reads: the joint's angle from where it counts, or its stroke."""
    names = tuple(one for one in (sensor.gain, sensor.offset) if isinstance(one, str))
    here, axis = T[:3, 3], T[:3, :3] @ np.array(joint.axis)
    counted = position - (sensor.zero if isinstance(sensor.zero, float) else 0.0)
    if joint.kind == "prismatic":
        return Dimension(names, "reading", np.stack((here, here + counted * axis)), beside=True)
    away = [p - here for p in places if np.linalg.norm(np.cross(p - here, axis)) > _SHORT * size]
    link = away[0] - axis * (away[0] @ axis) if away else T[:3, 0]
    arc = _turned(link / np.linalg.norm(link), axis, counted * (_ARC - 1.0))
    return Dimension(names, "reading", here + 1.7 * size * arc, here)
