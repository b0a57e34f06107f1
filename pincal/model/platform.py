"""Platform freedoms: conversion between pose coordinates and rigid transforms.

Orientations are written as tilt and torsion, rotation vectors, quaternions, or Z-Y-X angles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from pincal.errors import MeasurementError, MechanismError
from pincal.model.checks import array_of, finite_rows, must_be, names_of, one_line, triple, wrapped
from pincal.types import Array

if TYPE_CHECKING:
    from pincal.model.joint import End
    from pincal.model.leg import Leg


#: Columns, and their unit, of each way to write an orientation.
WAYS: dict[str, tuple[tuple[str, ...], str]] = {
    "tilt-torsion": (("azimuth", "tilt", "torsion"), "rad"),
    "rotation-vector": (("rx", "ry", "rz"), "rad"),
    "quaternion": (("qw", "qx", "qy", "qz"), "1"),
    "zyx": (("yaw", "pitch", "roll"), "rad"),
}
_HALF_TURN = 1.005 * np.pi  # longest rotation vector, with a margin for rounding
_UNIT_NORM = 1e-3  # largest difference of a quaternion's length from 1
_POLE = 1e-13  # sine of the angle from a pole, below which rounding decides the angles about it
TWIST = ("x", "y", "z", "rx", "ry", "rz")
"""Names of the rows of a twist, linear velocity first."""
KINDS = {
    "point": ("x", "y"),
    "planar": ("x", "y", "rz"),
    "translational": ("x", "y", "z"),
    "spatial": TWIST,
}
"""Rows of the twist of each platform kind that files can name."""
_ANY, _TURN, _TILT = (-np.inf, np.inf), (-np.pi, np.pi), (0.0, np.pi)
Poses: TypeAlias = Array | RigidTransform  # coordinates (N, dof), or transforms of length N


@dataclass(frozen=True)
class Platform:
    """Platform of a mechanism: its freedoms, coordinates and home pose.

    - ``point``: x, y of a point in the plane;
    - ``planar``: x, y, phi;
    - ``translational``: x, y, z;
    - ``spatial``: x, y, z and tilt and torsion, R = Rz(azimuth) Ry(tilt) Rz(torsion − azimuth)
      (6-UPS paper, Section 2.2); azimuth and torsion turn about the same axis at tilt 0, where the
      azimuth is set to 0, and at tilt π, where the torsion is: the orientation is kept.

    A further kind states its freedoms: ``Platform("3T1R", home, ("x", "y", "z", "rz"))`` has the
    coordinates x, y, z, phi. Poses are ``T_base_platform``, a SciPy ``RigidTransform`` of length N,
    or the coordinates, shape (N, dof), in [m] and [rad].
    """

    kind: str
    """One of the kinds above, or a name of your own."""
    home: tuple[float, ...]
    """Coordinates of the home pose, [m] and [rad]."""
    twist: tuple[str, ...] = ()
    """Rows of the twist in which the platform moves, in the order ``x, y, z, rx, ry, rz``; by
    default those of the kind. It moves along no axis, x, x and y, or all three, and about none, one
    or three axes. Choose the base's axes so that motion along a single axis is along x."""

    def __post_init__(self) -> None:
        kind = must_be(self.kind, str, "a platform's kind", MechanismError)
        twist: tuple[str, ...] = KINDS.get(kind, ())
        names = must_be(self.twist, Sequence, f"freedoms of a {kind!r} platform", MechanismError)
        if twist and names and tuple(names) != twist:
            raise MechanismError(f"the kind {kind!r} has other freedoms; choose another name")
        object.__setattr__(self, "twist", twist or _own_twist(kind, names))
        home = array_of(self.home, ("dof",), "the home pose", MechanismError).tolist()
        object.__setattr__(self, "home", tuple(home))
        if len(home) != self.dof:
            raise MechanismError(
                f"the home pose of a {kind!r} platform has {self.dof} coordinates "
                f"({', '.join(self.coordinates)}), got {len(home)}"
            )

    def __repr__(self) -> str:
        return one_line("Platform", repr(self.kind), f"home={triple(self.home)}")

    @staticmethod
    def at_origin(kind: str, twist: tuple[str, ...] = ()) -> Platform:
        """Return a platform of a kind whose home coordinates are zero."""
        return Platform(kind, (0.0,) * len(twist or KINDS[kind]), twist)

    @cached_property
    def lengths(self) -> int:
        """Number of coordinates that are positions; they come first."""
        return sum(not name.startswith("r") for name in self.twist)

    @property
    def turns(self) -> int:
        """Number of coordinates that are angles: none, one or three."""
        return self.dof - self.lengths

    @property
    def dof(self) -> int:
        """Number of freedoms."""
        return len(self.twist)

    @cached_property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates: positions, then ``phi``, or azimuth, tilt and torsion."""
        angles = {0: (), 1: ("phi",), 3: WAYS["tilt-torsion"][0]}[self.turns]
        return (*self.twist[: self.lengths], *angles)

    @property
    def freedoms(self) -> tuple[str, ...]:
        """Names of the twist rows: three angles are rx, ry, rz about base axes, one is phi."""
        return self.twist if self.turns == 3 else self.coordinates

    @cached_property
    def units(self) -> tuple[str, ...]:
        """Units of the coordinates, and of the twist rows in the same order."""
        return ("m",) * self.lengths + ("rad",) * self.turns

    @cached_property
    def bounds(self) -> tuple[tuple[float, float], ...]:
        """Smallest and largest value of each coordinate, infinite for lengths."""
        angles = (_TURN,) if self.turns == 1 else (_TURN, _TILT, _TURN)[: self.turns]
        return (_ANY,) * self.lengths + angles

    @cached_property
    def twist_rows(self) -> tuple[int, ...]:
        """Indices of the platform's freedoms among the six rows of a twist."""
        return tuple(TWIST.index(name) for name in self.twist)

    @property
    def space(self) -> int:
        """Dimension of the space that the mechanism moves in: 2 or 3."""
        plane = self.lengths == 2 and set(self.twist) <= {"x", "y", "rz"}
        return 2 if plane else 3

    def closing(self, end: End) -> tuple[int, ...]:
        """Return the rows of a twist in which an end of a leg closes.

        In the plane they are the end's rows that lie in the plane. Where a platform that only
        turns meets a whole frame, they are the three rows of orientation.
        """
        if self.lengths == 0 and end.point is not None and end.closes == "frame":
            return (3, 4, 5)
        return tuple(row for row in end.rows if self.space == 3 or row in (0, 1, 5))

    def equations(self, leg: Leg) -> int:
        """Return the number of a leg's equations on the pose, passive joints eliminated."""
        return self.rows(leg) - len(leg.passive)

    def rows(self, leg: Leg) -> int:
        """Return the number of closure rows of a leg, of all its ends together."""
        return sum(len(self.closing(end)) for end in leg.every_end)

    def transforms(self, poses: Poses) -> RigidTransform:
        """Return poses, coordinates (N, dof) or transforms, as ``T_base_platform`` of length N.

        Raises:
            MechanismError: wrong shape, or a coordinate that is not a finite number.
        """
        if isinstance(poses, RigidTransform):
            return poses
        return RigidTransform(self.matrices(poses), normalize=False, copy=False)

    def matrices(self, poses: Poses) -> Array:
        """Return poses as homogeneous matrices, shape (N, 4, 4), contiguous along the poses."""
        if isinstance(poses, RigidTransform):
            if poses.single:
                raise MechanismError("poses must be N transforms; got a single one: make it a list")
            return np.ascontiguousarray(poses.as_matrix().transpose(1, 2, 0)).transpose(2, 0, 1)
        coordinates = self.checked(poses)
        T = np.zeros((4, 4, len(coordinates)))
        T[range(4), range(4)] = 1.0
        T[: self.lengths, 3] = coordinates[:, : self.lengths].T
        if self.turns == 1:
            j, k = self._across
            T[k, j], T[j, j] = np.sin(coordinates[:, -1]), np.cos(coordinates[:, -1])
            T[k, k], T[j, k] = T[j, j], -T[k, j]
        elif self.turns == 3:
            x, y, z, w = q = _quaternions(coordinates[:, self.lengths :])
            a, b, c = 2.0 * q[:3]
            T[0, :3] = 1.0 - y * b - z * c, x * b - w * c, x * c + w * b
            T[1, :3] = x * b + w * c, 1.0 - x * a - z * c, y * c - w * a
            T[2, :3] = x * c - w * b, y * c + w * a, 1.0 - x * a - y * b
        return T.transpose(2, 0, 1)

    def from_matrices(self, matrices: Array) -> Array:
        """Return the coordinates of homogeneous matrices, shape (N, 4, 4) to (N, dof)."""
        columns, R = list(matrices[:, : self.lengths, 3].T), matrices[:, :3, :3]
        if self.turns == 1:
            j, k = self._across
            columns.append(np.arctan2(R[:, k, j], R[:, j, j]))
        elif self.turns == 3:
            columns += list(columns_of("tilt-torsion", Rotation.from_matrix(R)).T)
        return np.stack(columns, axis=1)

    @property
    def _across(self) -> tuple[int, int]:
        """Indices of the two axes perpendicular to the single rotation axis."""
        axis = self.twist_rows[-1] - 3
        return (axis + 1) % 3, (axis + 2) % 3

    def checked(self, poses: object) -> Array:
        """Return coordinates as an array (N, dof); raise MechanismError if shape or values fail."""
        label = f"poses of a {self.kind!r} platform ({', '.join(self.coordinates)})"
        coordinates = array_of(poses, ("N", self.dof), label, MechanismError)
        return finite_rows(coordinates, "pose", MechanismError)

    def coordinates_of(self, poses: Poses) -> Array:
        """Return the coordinates of poses, shape (N, dof), [m] and [rad], angles in (-pi, pi]."""
        if not isinstance(poses, RigidTransform):
            return array_of(poses, ("N", self.dof), "poses", MechanismError)
        return self.from_matrices(poses.as_matrix())

    def moved(self, poses: Array, twists: Array) -> Array:
        """Return poses moved by small twists at the platform's origin, in the axes of the base.

        Both are in the platform's freedoms: ``poses`` coordinates and ``twists`` rows of a twist,
        shapes (N, dof), [m] and [rad].
        """
        if self.turns < 3:
            return poses + twists
        return self.from_matrices(self.displaced(self.matrices(poses), twists))

    def displaced(self, matrices: Array, twists: Array) -> Array:
        """Return ``T_base_platform``, shape (N, 4, 4), moved by twists: see ``moved``."""
        full = np.zeros((len(twists), 6))
        full[:, list(self.twist_rows)] = twists
        moved = matrices.copy()
        moved[:, :3, 3] += full[:, :3]
        if any(row >= 3 for row in self.twist_rows):
            turn = Rotation.from_rotvec(full[:, 3:]).as_matrix()
            moved[:, :3, :3] = turn @ matrices[:, :3, :3]
        return moved

    def twists_between(self, first: Array, second: Array) -> Array:
        """Return the twists that move the first poses to the second, (N, dof): see ``moved``."""
        if self.turns < 3:
            turn, twists = [unit == "rad" for unit in self.units], second - first
            twists[:, turn] = wrapped(twists[:, turn])
            return twists
        a, b = self.transforms(first), self.transforms(second)
        turns = (b.rotation * a.rotation.inv()).as_rotvec()
        shifts = (b.translation - a.translation)[:, : self.lengths]
        return np.concatenate((shifts, turns), axis=1)

    @cached_property
    def home_pose(self) -> RigidTransform:
        """Home pose, length 1."""
        return self.transforms(np.array([self.home]))


def _own_twist(kind: str, twist: Sequence[str]) -> tuple[str, ...]:
    """Return the rows of the twist of a user-defined platform kind, checked."""
    if not twist and kind not in KINDS:
        raise MechanismError(
            f"unknown platform kind {kind!r}; expected one of {', '.join(KINDS)}, or the rows of "
            "the twist in which yours moves"
        )
    if not (kind and kind.isprintable() and len(kind) <= 64):
        raise MechanismError(f"platform kind {kind!r}: expected 1 to 64 printable characters")
    label = f"freedoms of a {kind!r} platform"
    rows = names_of(twist, len(twist), label, MechanismError)
    lengths, expected = tuple(name for name in rows if not name.startswith("r")), ""
    if rows != tuple(name for name in TWIST if name in rows):
        expected = f"expected some of {', '.join(TWIST)}, in this order"
    elif lengths != TWIST[: len(lengths)]:
        expected = (
            "a platform moves along x, along x and y, or along x, y and z: choose the base's axes "
            "accordingly"
        )
    elif len(rows) - len(lengths) == 2:
        expected = (
            "turns about two axes include turns about the third: give all three; the legs' "
            "closures exclude the motions that the platform cannot make"
        )
    if expected:
        raise MechanismError(f"{label}: {', '.join(rows)}; {expected}")
    return rows


def in_part(names: Sequence[str]) -> str:
    """Return the message that some columns of an orientation are measured, and others not."""
    return (
        f"an orientation is measured in part; expected {', '.join(names)} or none of them (for a "
        "device that reads a single angle, define a pincal.Instrument)"
    )


def rotation_of(way: str, values: Array) -> Rotation:
    """Return the orientations ``R_base_platform`` of columns.

    - ``tilt-torsion``: R = Rz(azimuth) Ry(tilt) Rz(torsion − azimuth) (6-UPS paper, Eq. 4);
    - ``rotation-vector``: axis times angle;
    - ``quaternion``: scalar first, of length 1;
    - ``zyx``: intrinsic, R = Rz(yaw) Ry(pitch) Rx(roll).

    Args:
        way: One of ``WAYS``.
        values: Values of the columns, shape (N, 3), [rad], or (N, 4) for quaternions.

    Raises:
        MeasurementError: a quaternion's length is not 1, or a vector's more than half a turn.
    """
    if way == "tilt-torsion":
        return Rotation.from_quat(_quaternions(values).T)
    if way == "zyx":
        return Rotation.from_euler("ZYX", values)
    lengths, vector = np.linalg.norm(values, axis=1), way == "rotation-vector"
    wrong = lengths > _HALF_TURN if vector else np.abs(lengths - 1.0) > _UNIT_NORM
    if wrong.any():
        row = int(np.argmax(wrong))
        limit = "at most π; angles about fixed axes are roll, pitch, yaw, degrees [deg]"
        expected = limit if vector else "qw, qx, qy, qz of length 1"
        wrong_row = f"row {row + 1}: the {way.replace('-', ' ')}'s length is {lengths[row]:.4g}"
        raise MeasurementError(f"{wrong_row}; expected {expected}")
    return Rotation.from_rotvec(values) if vector else Rotation.from_quat(values, scalar_first=True)


def _quaternions(values: Array) -> Array:
    """Return unit quaternions of azimuth, tilt and torsion, (N, 3) to (4, N), scalar last."""
    azimuth, tilt, torsion = values.T
    t = np.tan(0.5 * np.array((tilt / 2, torsion / 2 - azimuth, torsion / 2)))
    squares = t * t  # half-angle tangents take a quarter of the time of sines and cosines
    sines, cosines = 2.0 * t / (1.0 + squares), (1.0 - squares) / (1.0 + squares)
    parts = sines[0] * sines[1], sines[0] * cosines[1], cosines[0] * sines[2]
    return np.array((*parts, cosines[0] * cosines[2]))


def columns_of(way: str, rotation: Rotation) -> Array:
    """Return the columns of orientations, shape (N, 3), [rad], or (N, 4): see ``rotation_of``.

    At a pole, two angles turn about one axis. The second is computed from the rotation that remains
    after the first, so that ``rotation_of`` restores the orientation everywhere; at the pole itself
    azimuth (tilt 0), torsion (tilt π) or roll (pitch ±π/2) is 0. Quaternions have a scalar >= 0.
    """
    if way == "tilt-torsion":  # the inverse of _quaternions
        x, y, z, w = rotation.as_quat().T
        across, along = np.hypot(x, y), np.hypot(z, w)
        half = np.where(along > _POLE, np.arctan2(z, w), 0.0)
        azimuth = np.where(across > _POLE, half - np.arctan2(x, y), 0.0)
        angles = -wrapped(-azimuth), 2.0 * np.arctan2(across, along), -wrapped(-2.0 * half)
        return np.stack(angles, axis=1) + 0.0
    if way == "rotation-vector":
        return rotation.as_rotvec()
    if way == "quaternion":
        return rotation.as_quat(canonical=True, scalar_first=True)
    return yaw_pitch_roll(rotation.as_matrix())


def yaw_pitch_roll(R: Array) -> Array:
    """Return the angles of R = Rz(yaw) Ry(pitch) Rx(roll), shape (N, 3, 3) to (N, 3), [rad]."""
    level = np.hypot(R[:, 2, 1], R[:, 2, 2]) > _POLE
    roll = np.where(level, np.arctan2(R[:, 2, 1], R[:, 2, 2]), 0.0)
    s, c = np.sin(roll), np.cos(roll)  # R Rx(-roll) = Rz(yaw) Ry(pitch)
    pitch = np.arctan2(-R[:, 2, 0], s * R[:, 2, 1] + c * R[:, 2, 2])
    yaw = np.arctan2(s * R[:, 0, 2] - c * R[:, 0, 1], c * R[:, 1, 1] - s * R[:, 1, 2])
    return np.stack((yaw, pitch, roll), axis=1) + 0.0  # no negative zero


def turns_in_series(R: Array) -> Array:
    """Return the positions a, b, c of three joints in series, about x, y and z, [rad].

    R = Rx(a) Ry(b) Rz(c), by the Z-Y-X angles of the inverse rotation: (N, 3, 3) to (N, 3).
    """
    return -yaw_pitch_roll(R.transpose(0, 2, 1))[:, ::-1] + 0.0
