"""The parameters of a leg as dimensions of a drawing: lengths, angles, and what the sensors read.

Each named coordinate of a placement is one: a displacement is a length from where it begins to
where it ends, a turn is an angle about where it happens.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pincal.kinematics.legs.closing import sensor_law
from pincal.kinematics.legs.closure import LegClosure
from pincal.model.checks import EXACT
from pincal.model.joint import Joint
from pincal.model.links import link_placements
from pincal.model.placement import Coordinate, Step
from pincal.model.sensors.sensor import Sensor

Array = NDArray[np.float64]
_ARC = np.linspace(0.0, 1.0, 41)


@dataclass(frozen=True, eq=False)
class Dimension:
    """A length or an angle in a drawing."""

    names: tuple[str, ...]
    """Of the parameter; of a reading that of its gain, if it has one."""
    kind: Literal["length", "angle", "reading", "offset", "zero"]
    """``"zero"``: lengths and angles of one place that have no extent."""
    line: Array
    """Points along it, from where it is measured, shape (n, 3), base frame, [m]."""
    corner: Array | None = None
    """Of an angle, shape (3,), [m]."""
    beside: bool = False
    """Whether the line lies on a link, so that it is better drawn beside that."""
    part: Literal["base", "leg", "platform"] = "leg"
    """What it is a dimension of."""

    @property
    def extent(self) -> float:
        """How far the line goes, [m]: nothing where the parameter is zero."""
        return float(np.linalg.norm(np.diff(self.line, axis=0), axis=1).sum())


def dimensions_of(
    closure: LegClosure, joints: Array, T_base_platform: Array, size: float
) -> list[Dimension]:
    """Return the dimensions of a leg.

    Args:
        closure: The leg at its nominal parameters.
        joints: Positions of its moving joints, shape (n_joints,), [rad] or [m].
        T_base_platform: The pose, shape (4, 4).
        size: Radius of the smallest arc, [m].

    Raises:
        MechanismError: a homed sensor, and a home pose out of the leg's reach.
    """
    leg, law = closure.leg, sensor_law(closure)
    values = leg.nominal_by_name
    links = link_placements(leg, np.asarray(joints)[None])[0]
    found: list[Dimension] = []
    for index, joint in enumerate(leg.joints):
        parent = links[index - 1] if index else np.eye(4)
        own = _placed(joint, values, parent, size, beside=index > 0)
        found += [replace(one, part="leg" if index else "base") for one in own]
        for place, sensor in enumerate(leg.sensors):
            if sensor.joint == joint.name:
                position = float(joints[leg.active[place]])
                start = float(law.start[place])
                drive = _Drive(joint, parent @ joint.placement.origin(), links[:, :3, 3], size)
                found += _read(sensor, drive, start - sensor.law(values)[1], start, position)
    own = _placed(leg.point, values, T_base_platform, size, beside=False)
    found += [replace(one, part="platform") for one in own]
    return found


def _placed(
    joint: Joint, values: dict[str, float], T: Array, size: float, *, beside: bool
) -> Iterator[Dimension]:
    """Yield the dimensions of a joint's placement on its parent link, that at T, (4, 4)."""
    for coordinate in joint.placement.coordinates:
        yield from _of_coordinate(coordinate, values, T, size, beside)
        T = T @ coordinate.displacement(values)


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
            yield _angle(step.value, step, values, before, radius * (1.0 + 0.35 * len(done)))


def _angle(name: str, step: Step, values: dict[str, float], T: Array, radius: float) -> Dimension:
    """Return the angle of a turn, from the axis that it turns first to where that goes."""
    axis, zero = T[:3, "xyz".index(step.axis[-1])], {"rx": 1, "ry": 2, "rz": 0}[step.axis]
    arc = _turned(T[:3, zero], axis, step.amount(values) * _ARC)
    return Dimension((name,), "angle", T[:3, 3] + radius * arc, T[:3, 3])


def _turned(vector: Array, axis: Array, angles: Array) -> Array:
    """Return a vector (3,) turned about a unit axis by angles (n,), shape (n, 3)."""
    turns = Rotation.from_rotvec(np.multiply.outer(angles, axis))
    return np.asarray(turns.apply(vector))


@dataclass(frozen=True, eq=False)
class _Drive:
    """An active joint in a drawing."""

    joint: Joint
    frame: Array
    """Where it is at its zero, ``T_base_joint``, shape (4, 4)."""
    places: Array
    """Of the joints and the tip, shape (n, 3), [m]."""
    size: float
    """Radius of the smallest arc, [m]."""

    def line(self, position: float, low: float, high: float, radius: float) -> Dimension:
        """Return a nameless dimension from one position of the joint to another.

        Args:
            position: Where the joint is now, [rad] or [m].
            low: Where the dimension begins.
            high: Where it ends.
            radius: Of an arc, in those of the smallest.
        """
        here, axis = self.frame[:3, 3], self.frame[:3, :3] @ np.array(self.joint.axis)
        if self.joint.kind == "prismatic":
            ends = here + np.array([[low], [high]]) * axis
            return Dimension((), "reading", ends, beside=True)
        arms = self.places - here
        away = arms[np.linalg.norm(np.cross(arms, axis), axis=1) > EXACT * self.size]
        link = away[0] - axis * (away[0] @ axis) if len(away) else self.frame[:3, 0]
        arc = _turned(link / np.linalg.norm(link), axis, low - position + (high - low) * _ARC)
        return Dimension((), "reading", here + radius * self.size * arc, here)


def _read(
    sensor: Sensor, drive: _Drive, zero: float, start: float, position: float
) -> list[Dimension]:
    """Return what a sensor reads, and its offset if that is a parameter.

    Args:
        sensor: The sensor.
        drive: Its joint.
        zero: Position from which the joint is counted, [rad] or [m].
        start: Position at which the sensor reads zero.
        position: Where the joint is.
    """
    names = (sensor.gain,) if isinstance(sensor.gain, str) else ()
    found = [replace(drive.line(position, start, position, 1.7), names=names)]
    if isinstance(sensor.offset, str):
        offset = replace(drive.line(position, zero, start, 1.2), names=(sensor.offset,))
        found.append(replace(offset, kind="offset"))
    return found
