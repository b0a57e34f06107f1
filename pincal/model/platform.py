"""The platform's freedoms: the coordinates people use, and the rigid transforms used inside."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from pincal.errors import MechanismError
from pincal.model.orientation import columns_of, rotation_of

Array = NDArray[np.float64]
Poses: TypeAlias = Array | RigidTransform  # coordinates (N, dof), or transforms of length N


@dataclass(frozen=True)
class _Kind:
    coordinates: tuple[str, ...]
    units: tuple[str, ...]
    twist_rows: tuple[int, ...]
    closure_rows: tuple[int, ...]
    bounds: tuple[tuple[float, float], ...]
    """Of each coordinate; lengths are bounded by the reach of the legs."""


_ANY, _TURN, _TILT = (-np.inf, np.inf), (-np.pi, np.pi), (0.0, np.pi)
_KINDS = {
    "point": _Kind(("x", "y"), ("m", "m"), (0, 1), (0, 1), (_ANY, _ANY)),
    "planar": _Kind(("x", "y", "phi"), ("m", "m", "rad"), (0, 1, 5), (0, 1), (_ANY, _ANY, _TURN)),
    "translational": _Kind(
        ("x", "y", "z"), ("m", "m", "m"), (0, 1, 2), (0, 1, 2), (_ANY, _ANY, _ANY)
    ),
    "spatial": _Kind(
        ("x", "y", "z", "azimuth", "tilt", "torsion"),
        ("m", "m", "m", "rad", "rad", "rad"),
        (0, 1, 2, 3, 4, 5),
        (0, 1, 2),
        (_ANY, _ANY, _ANY, _TURN, _TILT, _TURN),
    ),
}


@dataclass(frozen=True)
class Platform:
    """Platform of a mechanism, with its coordinates.

    - ``point``: x, y of a point in the plane;
    - ``planar``: x, y, phi;
    - ``translational``: x, y, z;
    - ``spatial``: x, y, z and tilt and torsion, R = Rz(azimuth) Ry(tilt) Rz(torsion − azimuth)
      (6-UPS paper, Section 2.2); the azimuth has no meaning at tilt 0 and is 0 there.

    Poses are ``T_base_platform``, a SciPy ``RigidTransform`` of length N, or the
    coordinates, shape (N, dof), in [m] and [rad].
    """

    kind: str
    home: tuple[float, ...]
    """Coordinates of the home pose, [m] and [rad]."""

    def __post_init__(self) -> None:
        if self.kind not in _KINDS:
            raise MechanismError(
                f"unknown platform kind {self.kind!r}; expected one of {', '.join(_KINDS)}"
            )
        if len(self.home) != self.dof:
            raise MechanismError(
                f"the home pose of a {self.kind!r} platform has {self.dof} coordinates "
                f"({', '.join(self.coordinates)}), got {len(self.home)}"
            )

    @staticmethod
    def dof_of(kind: str) -> int:
        """Return the number of freedoms of a kind of platform."""
        return len(_KINDS[kind].coordinates)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return _KINDS[self.kind].coordinates

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the coordinates, and of the twist rows in the same order."""
        return _KINDS[self.kind].units

    @property
    def freedoms(self) -> tuple[str, ...]:
        """Names of the twist rows: turns of a spatial platform are rx, ry, rz in base axes."""
        names = (*self.coordinates[:3], "rx", "ry", "rz")
        return names if self.kind == "spatial" else self.coordinates

    @property
    def bounds(self) -> tuple[tuple[float, float], ...]:
        """Least and largest value of each coordinate, infinite for lengths."""
        return _KINDS[self.kind].bounds

    @property
    def twist_rows(self) -> tuple[int, ...]:
        """Rows of a twist (linear first) that the platform can move in, one per freedom."""
        return _KINDS[self.kind].twist_rows

    @property
    def closure_rows(self) -> tuple[int, ...]:
        """Rows of the loop closure that are kept: two in a plane, three in space."""
        return _KINDS[self.kind].closure_rows

    def closing(self, closes: str) -> tuple[int, ...]:
        """Return the rows of a twist in which a leg closes a ``"point"`` or a ``"frame"``."""
        if closes == "point":
            return self.closure_rows
        return (0, 1, 5) if self.space == 2 else (0, 1, 2, 3, 4, 5)

    @property
    def space(self) -> int:
        """Dimension of the space that the mechanism moves in: 2 or 3."""
        return len(self.closure_rows)

    @property
    def dof(self) -> int:
        """Number of freedoms."""
        return len(self.coordinates)

    def transforms(self, poses: Poses) -> RigidTransform:
        """Return poses ``T_base_platform`` of length N; rigid transforms pass unchanged.

        Args:
            poses: N poses: coordinates, shape (N, dof), [m] and [rad], or rigid transforms.

        Raises:
            MechanismError: wrong shape, or a coordinate that is not a finite number.
        """
        if isinstance(poses, RigidTransform):
            return poses
        coordinates = np.asarray(poses, dtype=np.float64)
        if coordinates.ndim != 2 or coordinates.shape[1] != self.dof:
            raise MechanismError(
                f"poses of a {self.kind!r} platform have shape (N, {self.dof}) for "
                f"{', '.join(self.coordinates)}; got shape {coordinates.shape}"
            )
        if not np.isfinite(coordinates).all():
            row = int(np.argmin(np.isfinite(coordinates).all(axis=1)))
            raise MechanismError(f"pose {row + 1} has a coordinate that is not a finite number")
        lengths = [i for i, unit in enumerate(self.units) if unit == "m"]
        position = np.zeros((len(coordinates), 3))
        position[:, : len(lengths)] = coordinates[:, lengths]
        return RigidTransform.from_components(position, self._rotation(coordinates))

    def _rotation(self, coordinates: Array) -> Rotation:
        if self.kind == "spatial":
            return rotation_of("tilt-torsion", coordinates[:, 3:])
        quaternion = np.zeros((len(coordinates), 4))
        quaternion[:, 3] = 1.0
        if self.kind == "planar":
            quaternion[:, 2] = np.sin(coordinates[:, 2] / 2)
            quaternion[:, 3] = np.cos(coordinates[:, 2] / 2)
        return Rotation.from_quat(quaternion)

    def coordinates_of(self, poses: Poses) -> Array:
        """Return the coordinates of poses, shape (N, dof), [m] and [rad], angles in (-pi, pi]."""
        if not isinstance(poses, RigidTransform):
            return np.asarray(poses, dtype=np.float64)
        return self.from_matrices(poses.as_matrix())

    def from_matrices(self, matrices: Array) -> Array:
        """Return the coordinates of homogeneous matrices, shape (N, 4, 4) to (N, dof)."""
        lengths = self.units.count("m")
        columns = list(matrices[:, :lengths, 3].T)
        R = matrices[:, :3, :3]
        if self.kind == "planar":
            columns.append(np.arctan2(R[:, 1, 0], R[:, 0, 0]))
        elif self.kind == "spatial":
            columns += list(columns_of("tilt-torsion", Rotation.from_matrix(R)).T)
        return np.stack(columns, axis=1)

    def moved(self, poses: Array, twists: Array) -> Array:
        """Return poses moved by small twists at the platform's origin, axes of the base.

        Args:
            poses: Coordinates, shape (N, dof).
            twists: In the platform's freedoms, shape (N, dof), [m] and [rad].
        """
        if self.kind != "spatial":
            return poses + twists
        return self.from_matrices(self.displaced(self.transforms(poses).as_matrix(), twists))

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
        """Return the twists that take first poses to second ones, shape (N, dof): see ``moved``."""
        if self.kind != "spatial":
            turn = [unit == "rad" for unit in self.units]
            twists = second - first
            twists[:, turn] = (twists[:, turn] + np.pi) % (2 * np.pi) - np.pi
            return twists
        a, b = self.transforms(first), self.transforms(second)
        turns = (b.rotation * a.rotation.inv()).as_rotvec()
        return np.concatenate((b.translation - a.translation, turns), axis=1)

    @cached_property
    def home_pose(self) -> RigidTransform:
        """Home pose, length 1."""
        return self.transforms(np.array([self.home]))
