"""A placement puts a joint on its parent link by named coordinates: every parameter is a joint.

A placement is the URDF origin of a joint together with the coordinates that are
identified in it. Each coordinate expands into elementary displacements along or
about the axes of the parent link, applied in order (``x`` and ``rz`` are
Pinocchio's ``PX`` and ``RZ`` joints). A constant displacement follows the
coordinates: the part of the origin that they do not explain.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from math import cos, sin
from typing import NamedTuple

import numpy as np

from pincal.errors import MechanismError
from pincal.model.checks import EXACT, choice_of, one_line, triple
from pincal.model.platform import yaw_pitch_roll
from pincal.types import Array

Value = str | float  # a parameter's name, or a constant
Values = tuple[Value, ...] | list[Value]

#: Kinds of coordinates, with the unit of each of their values.
KINDS: dict[str, tuple[str, ...]] = {
    "x": ("m",),
    "y": ("m",),
    "z": ("m",),
    "rx": ("rad",),
    "ry": ("rad",),
    "rz": ("rad",),
    "polar": ("m", "rad"),  # radius, azimuth about z: a point, orientation kept
    "spherical": ("m", "rad", "rad"),  # radius, angle from z, azimuth: a point
}


class Step(NamedTuple):
    """Elementary displacement by ``sign * value`` along (x, y, z) or about (rx, ry, rz) an axis."""

    axis: str
    value: Value
    sign: int = 1

    def amount(self, parameters: Mapping[str, float]) -> float:
        """Return the displacement, [m] or [rad]."""
        return self.sign * (parameters[self.value] if isinstance(self.value, str) else self.value)

    def matrix(self, parameters: Mapping[str, float]) -> Array:
        """Return the displacement as a homogeneous matrix, shape (4, 4)."""
        return _elementary(self.axis, self.amount(parameters))


def _elementary(axis: str, amount: float) -> Array:
    matrix, i = np.eye(4), "xyz".index(axis[-1])
    if axis.startswith("r"):
        j, k = (i + 1) % 3, (i + 2) % 3
        matrix[j, j] = matrix[k, k] = cos(amount)
        matrix[k, j] = sin(amount)
        matrix[j, k] = -matrix[k, j]
    else:
        matrix[i, 3] = amount
    return matrix


@dataclass(frozen=True)
class Coordinate:
    """A named coordinate of a placement, such as ``polar: [OA, beta]`` or ``x: l``."""

    kind: str
    values: tuple[Value, ...]

    def __post_init__(self) -> None:
        choice_of(self.kind, KINDS, "coordinate", MechanismError)
        if len(self.values) != len(KINDS[self.kind]):
            raise MechanismError(
                f"coordinate {self.kind!r} takes {len(KINDS[self.kind])} value(s), "
                f"got {list(self.values)}"
            )

    @cached_property
    def steps(self) -> tuple[Step, ...]:
        """Elementary displacements, in order.

        The angles of a point move the origin but keep the orientation: each turns forward before
        the radius and back after it, so that two joints share one parameter.
        """
        if self.kind == "polar":
            radius, azimuth = self.values
            return Step("rz", azimuth), Step("x", radius), Step("rz", azimuth, -1)
        if self.kind == "spherical":
            radius, polar, azimuth = self.values
            outward = Step("rz", azimuth), Step("ry", polar), Step("z", radius)
            return (*outward, Step("ry", polar, -1), Step("rz", azimuth, -1))
        return (Step(self.kind, self.values[0]),)

    @property
    def turns(self) -> bool:
        """Whether the coordinate changes the orientation of the joint's frame."""
        return self.kind in ("rx", "ry", "rz")

    def displacement(self, parameters: Mapping[str, float]) -> Array:
        """Return the product of the elementary displacements, shape (4, 4)."""
        matrix = np.eye(4)
        for step in self.steps:
            matrix = matrix @ step.matrix(parameters)
        if not self.turns:  # exact: a point keeps the orientation
            matrix[:3, :3] = np.eye(3)
        return matrix


@dataclass(frozen=True)
class Placement:
    """Place of a joint on its parent link: URDF origin, and the coordinates identified in it."""

    coordinates: tuple[Coordinate, ...] = ()
    xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Position of the URDF origin, [m]."""
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Orientation of the URDF origin: roll, pitch, yaw about fixed axes, [rad]."""

    @classmethod
    def of(cls, parameters: Mapping[str, float], /, **coordinates: Value | Values) -> Placement:
        """Return the placement of coordinates, in the order given, at nominal values.

        ``Placement.of(values, polar=("OA", "beta"), rz=0.3)`` puts a joint at a radius and an
        azimuth, and turns it by 0.3 rad.

        Args:
            parameters: Nominal values by name.
            **coordinates: Value or values of each kind of coordinate (a key of ``KINDS``): names
                of parameters, or numbers.

        Raises:
            MechanismError: an unknown kind, or a wrong number of values for a kind.
        """
        placed = tuple(
            Coordinate(kind, tuple(values) if isinstance(values, tuple | list) else (values,))
            for kind, values in coordinates.items()
        )
        return cls(placed).at(parameters, np.eye(4))

    def __repr__(self) -> str:
        parts = [f"{c.kind}({', '.join(map(str, c.values))})" for c in self.coordinates]
        turned = f"rpy={triple(self.rpy)}" if any(self.rpy) else ""
        return one_line("Placement", *parts, f"xyz={triple(self.xyz)}", turned)

    @cached_property
    def steps(self) -> tuple[Step, ...]:
        """Elementary displacements of all coordinates, in order."""
        return tuple(step for c in self.coordinates for step in c.steps)

    def corrects(self, parameters: Mapping[str, float]) -> bool:
        """Return whether the coordinates are mere corrections: all are zero at these values."""
        return not any(step.amount(parameters) for step in self.steps)

    @property
    def parameter_units(self) -> dict[str, str]:
        """Units of the parameters that this placement uses, by name."""
        return {
            value: unit
            for c in self.coordinates
            for value, unit in zip(c.values, KINDS[c.kind], strict=True)
            if isinstance(value, str)
        }

    @property
    def turns(self) -> bool:
        """Whether any coordinate changes the orientation of the joint's frame."""
        return any(c.turns for c in self.coordinates)

    def displacement(self, parameters: Mapping[str, float]) -> Array:
        """Return the product of the coordinates' displacements, shape (4, 4)."""
        matrix = np.eye(4)
        for coordinate in self.coordinates:
            matrix = matrix @ coordinate.displacement(parameters)
        return matrix

    def origin(self) -> Array:
        """Return the URDF origin as a homogeneous matrix, shape (4, 4)."""
        matrix = np.eye(4)
        if any(self.rpy):
            for axis, angle in zip(("rx", "ry", "rz"), self.rpy, strict=True):
                matrix = _elementary(axis, angle) @ matrix
        matrix[:3, 3] = self.xyz
        return matrix

    def rest(self, parameters: Mapping[str, float], context: str) -> Array:
        """Return the constant displacement after the coordinates, shape (4, 4).

        Coordinates whose nominal values are all zero correct the URDF origin. Others must give its
        whole position, or a MechanismError is raised, whose message ``context`` heads.
        """
        origin = self.origin()
        if not self.coordinates:
            return origin
        displacement = self.displacement(parameters)
        constant = np.asarray(np.linalg.inv(displacement) @ origin)
        R, exact = constant[:3, :3], np.round(constant[:3, :3])
        # within rounding of 0 or ±1 set to it: the same constant part at all parameter values
        R = np.where(np.abs(R - exact) < 1e-15, exact, R)
        constant[:3, :3] = R if self.turns else origin[:3, :3]
        if not self.corrects(parameters):
            expected = displacement[:3, 3]
            scale = float(np.abs([*self.xyz, *expected]).max())
            if float(np.abs(constant[:3, 3]).max()) > EXACT * scale:
                drawn, placed = (
                    ", ".join(f"{v:.9g}" for v in place) for place in (self.xyz, expected)
                )
                raise MechanismError(
                    f"{context}: the URDF origin is at ({drawn}) m, but its coordinates and "
                    f"nominal parameters put it at ({placed}) m. Make them agree, or write a "
                    "constant part as a number, for example '- z: 0.3'."
                )
            constant[:3, 3] = 0.0
        return constant

    def moved(self, old: Mapping[str, float], new: Mapping[str, float], context: str) -> Placement:
        """Return the placement at new parameter values, with the same constant part."""
        if not self.coordinates:
            return self
        return self.at(new, self.rest(old, context))

    def at(self, parameters: Mapping[str, float], constant: Array) -> Placement:
        """Return the placement whose origin is ``displacement(parameters) @ constant``.

        Unless the coordinates are corrections at these values, the position of the constant part
        becomes further coordinates, because coordinates must then give the whole position.
        """
        origin = self.displacement(parameters) @ constant
        rpy, coordinates = self.rpy, self.coordinates
        if not self.corrects(parameters):
            parts = zip("xyz", floats(constant[:3, 3]), strict=True)
            coordinates += tuple(Coordinate(axis, (value,)) for axis, value in parts if value)
        if self.turns or not np.array_equal(constant[:3, :3], self.origin()[:3, :3]):
            rpy = _roll_pitch_yaw(origin[:3, :3])
        return replace(self, coordinates=coordinates, xyz=floats(origin[:3, 3]), rpy=rpy)


def placement_of(matrix: Array) -> Placement:
    """Return the placement without coordinates of a homogeneous matrix, shape (4, 4)."""
    return Placement((), floats(matrix[:3, 3]), _roll_pitch_yaw(matrix[:3, :3]))


def _roll_pitch_yaw(rotation: Array) -> tuple[float, float, float]:
    """Return roll, pitch, yaw about fixed axes, [rad], of a rotation matrix, also at the poles.

    Angles within rounding of a multiple of pi/2 are set to it, so that files are clean.
    """
    angles = yaw_pitch_roll(rotation[None])[0, ::-1]
    quarter = np.round(angles / (np.pi / 2)) * (np.pi / 2)
    return floats(np.where(np.abs(angles - quarter) < 1e-14, quarter, angles))


def floats(values: Array) -> tuple[float, float, float]:
    """Return the three numbers of an array as a tuple, without negative zeros."""
    x, y, z = (float(v) + 0.0 for v in values)
    return x, y, z
