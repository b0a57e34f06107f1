"""The parameters of a leg as dimensions of a drawing: lengths, angles, and what the sensors read.

Each named coordinate of a placement is one: a displacement is a length from where it begins to
where it ends, a turn is an angle about where it happens.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from pincal.kinematics.closing import sensor_law
from pincal.kinematics.closure import LegClosure
from pincal.model.checks import EXACT
from pincal.model.joint import Joint
from pincal.model.sensor import Sensor
from pincal.types import Array
from pincal.words.wording import clean

_ARC = np.linspace(0.0, 1.0, 41)
_GREEK = re.compile(
    "alpha|beta|gamma|delta|epsilon|zeta|eta|theta|kappa|lambda|mu|nu|xi|pi|rho|sigma|tau|phi|chi"
    "|psi|omega"
)


@dataclass(frozen=True, eq=False)
class Dimension:
    """A length or an angle in a drawing."""

    name: str
    """Of the parameter; of a reading that of its gain, or empty if that is none."""
    kind: Literal["length", "angle", "reading", "offset"]
    line: Array
    """Points along it, from where it is measured, shape (n, 3), base frame, [m]."""
    corner: Array | None = None
    """Of an angle, shape (3,), [m]."""
    beside: bool = False
    """Whether the line lies on a link, so that it is better drawn beside that."""

    @property
    def extent(self) -> float:
        """How far the line goes, [m]: nothing where the parameter is zero."""
        return float(np.linalg.norm(np.diff(self.line, axis=0), axis=1).sum())


def dimensions_of(
    closure: LegClosure, joints: Array, T_base_platform: Array, size: float
) -> list[Dimension]:
    """Return the dimensions of a leg at its nominal parameters, smallest arcs of a size, [m].

    Joints are positions of moving ones, shape (n_joints,), [rad] or [m]; the pose has shape (4, 4).

    Raises:
        MechanismError: a homed sensor, and a home pose out of the leg's reach.
    """
    leg, law = closure.leg, sensor_law(closure)
    values = leg.nominal_by_name
    links = leg.link_placements(np.asarray(joints)[None])[0]
    dimensions: list[Dimension] = []
    for joint, carrier in zip(leg.joints, leg.carriers, strict=True):
        parent = links[carrier] if carrier >= 0 else np.eye(4)
        dimensions += _placed(joint, values, parent, size, shifted=carrier >= 0)
        for place, sensor in enumerate(leg.sensors):
            if sensor.joint == joint.name:
                start = float(law.start[place])
                positions = start - sensor.law(values)[1], start, float(joints[leg.active[place]])
                frame = parent @ joint.placement.origin()
                dimensions += _read(sensor, joint, frame, links[:, :3, 3], positions, size)
    for point in leg.points:
        dimensions += _placed(point, values, T_base_platform, size, shifted=False)
    return dimensions


def _placed(
    joint: Joint, values: dict[str, float], T: Array, size: float, *, shifted: bool
) -> Iterator[Dimension]:
    """Yield the dimensions of a joint's placement on its parent link, that at T, (4, 4).

    An angle goes from the axis that its turn moves first to where that comes to be.
    """
    for coordinate in joint.placement.coordinates:
        reach = sum(abs(step.amount(values)) for step in coordinate.steps if step.axis in "xyz")
        radius, names, after = max(size, 0.3 * reach), set(), T
        for step in coordinate.steps:
            before, after = after, after @ step.matrix(values)
            if not isinstance(step.value, str) or step.value in names:
                continue
            names.add(step.value)
            origin = before[:3, 3]
            if step.axis in "xyz":
                ends = np.stack((origin, after[:3, 3]))
                yield Dimension(step.value, "length", ends, beside=shifted)
                continue
            axis = before[:3, "xyz".index(step.axis[-1])]
            first = before[:3, {"rx": 1, "ry": 2, "rz": 0}[step.axis]]
            arc = _turned(first, axis, step.amount(values) * _ARC)
            line = origin + radius * (1.0 + 0.35 * len(names)) * arc
            yield Dimension(step.value, "angle", line, origin)
        T = T @ coordinate.displacement(values)


def _read(
    sensor: Sensor,
    joint: Joint,
    frame: Array,
    places: Array,
    positions: tuple[float, float, float],
    size: float,
) -> Iterator[Dimension]:
    """Yield what a sensor reads, and its offset if that is a parameter.

    The frame is the joint's at its zero; places, shape (n, 3), are of joints and tip; the joint
    counts from the first position, the sensor from the second, up to the third.
    """
    zero, start, position = positions
    origin, axis = frame[:3, 3], frame[:3, :3] @ np.array(joint.axis)
    arms = places - origin
    distant = arms[np.linalg.norm(np.cross(arms, axis), axis=1) > EXACT * size]
    link = distant[0] - axis * (distant[0] @ axis) if len(distant) else frame[:3, 0]

    def line(low: float, high: float, radius: float) -> tuple[Array, Array | None, bool]:
        if joint.kind == "prismatic":
            return origin + np.array([[low], [high]]) * axis, None, True
        arc = _turned(link / np.linalg.norm(link), axis, low - position + (high - low) * _ARC)
        return origin + radius * size * arc, origin, False

    gain = sensor.gain if isinstance(sensor.gain, str) else ""
    yield Dimension(gain, "reading", *line(start, position, 1.7))
    if isinstance(sensor.offset, str):
        yield Dimension(sensor.offset, "offset", *line(zero, start, 1.2))


def _turned(vector: Array, axis: Array, angles: Array) -> Array:
    """Return a vector (3,) turned about a unit axis by angles (n,), shape (n, 3)."""
    return np.asarray(Rotation.from_rotvec(np.multiply.outer(angles, axis)).apply(vector))


def symbol(name: str) -> str:
    """Return a parameter's name as a symbol of mathematics: ``beta_b`` as β with an index."""
    if not re.fullmatch(r"[A-Za-z0-9]+(_[A-Za-z0-9]+)*", name):
        return clean(name).replace("\\", "\\\\").replace("$", r"\$")
    first, *index = name.split("_")
    first = f"\\{first}" if _GREEK.fullmatch(first) else rf"\mathit{{{first}}}"
    return f"${first}_{{{','.join(index)}}}$" if index else f"${first}$"
