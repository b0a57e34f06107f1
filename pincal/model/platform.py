"""The platform's freedoms: the coordinates people use, and the rigid transforms used inside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from pincal.errors import MechanismError
from pincal.model.checks import array_of, must_be, names_of, numbers_of, sine_and_cosine, wrapped
from pincal.model.orientation import WAYS, columns_of, tilted
from pincal.model.overview import one_line, triple
from pincal.types import Array, Index, Mask

if TYPE_CHECKING:
    from pincal.model.leg import Leg


Rows: TypeAlias = slice | Index | Mask
TWIST = ("x", "y", "z", "rx", "ry", "rz")
"""Rows of a twist, linear first."""
_ANY, _TURN, _TILT = (-np.inf, np.inf), (-np.pi, np.pi), (0.0, np.pi)


@dataclass(frozen=True)
class PlatformKind:
    """What a platform can do: ``PlatformKind("3T1R", ("x", "y", "z", "rz"))``."""

    name: str
    freedoms: tuple[str, ...]
    """Of ``x, y, z, rx, ry, rz``, in this order: x, x and y, or all three; one turn, three or none.
    The base's axes are chosen so that a platform that moves along one moves along x."""

    def __post_init__(self) -> None:
        must_be(self.name, str, "the name of a platform kind", MechanismError)
        if not (self.name and self.name.isprintable() and len(self.name) <= 64):
            raise MechanismError(f"{self.name!r} is no name for a platform kind")
        label = f"freedoms of a {self.name!r} platform"
        count = len(must_be(self.freedoms, Sequence, label, MechanismError))
        freedoms = names_of(self.freedoms, count, label, MechanismError)
        object.__setattr__(self, "freedoms", freedoms)
        lengths = tuple(name for name in freedoms if not name.startswith("r"))
        expected = ""
        if not freedoms or freedoms != tuple(name for name in TWIST if name in freedoms):
            expected = f"; expected some of {', '.join(TWIST)}, in this order"
        elif lengths != TWIST[: len(lengths)]:
            expected = (
                "; a platform moves along x, along x and y, or along x, y and z: choose the base's "
                "axes so"
            )
        elif len(freedoms) - len(lengths) == 2:
            expected = (
                "; turns about two axes are turns about a third as well: give all three, the legs "
                "hold what the platform does not do"
            )
        if expected:
            raise MechanismError(f"{label}: {', '.join(freedoms) or 'none'}{expected}")


@dataclass(frozen=True)
class PoseMatrices:
    """Matrices of N poses, made of the rows that are asked for: no others fill memory."""

    platform: Platform
    poses: RigidTransform | Array
    """Coordinates, shape (N, dof), or transforms."""

    def __len__(self) -> int:
        return len(self.poses)

    def __getitem__(self, rows: Rows) -> Array:
        """Return ``T_base_platform`` of some, shape (s, 4, 4)."""
        poses = self.poses[rows]
        if not isinstance(poses, RigidTransform):
            return self.platform.matrices_of(poses)
        entries = poses.as_matrix().transpose(1, 2, 0)
        return np.ascontiguousarray(entries).transpose(2, 0, 1)  # memory runs along the poses


#: Kinds with a name that files may say.
KINDS = {
    kind.name: kind
    for kind in (
        PlatformKind("point", ("x", "y")),
        PlatformKind("planar", ("x", "y", "rz")),
        PlatformKind("translational", ("x", "y", "z")),
        PlatformKind("spatial", TWIST),
    )
}


Poses: TypeAlias = Array | RigidTransform  # coordinates (N, dof), or transforms of length N


@dataclass(frozen=True)
class Platform:
    """Platform of a mechanism, with its coordinates.

    - ``point``: x, y of a point in the plane;
    - ``planar``: x, y, phi;
    - ``translational``: x, y, z;
    - ``spatial``: x, y, z and tilt and torsion, R = Rz(azimuth) Ry(tilt) Rz(torsion − azimuth)
      (6-UPS paper, Section 2.2); azimuth and torsion turn about one axis at tilt 0, where the
      azimuth is 0, and at tilt π, where the torsion is 0: orientations come back as they were.

    A ``PlatformKind`` of one's own has other freedoms, such as x, y, z, phi.

    Poses are ``T_base_platform``, a SciPy ``RigidTransform`` of length N, or the
    coordinates, shape (N, dof), in [m] and [rad].
    """

    kind: str | PlatformKind
    """Name of a kind above, or a ``PlatformKind`` of one's own; its name from then on."""
    home: tuple[float, ...]
    """Coordinates of the home pose, [m] and [rad]."""
    form: PlatformKind = None  # type: ignore[assignment]
    """The kind's freedoms; follows from ``kind``."""

    def __post_init__(self) -> None:
        form: Any = self.form
        kind: Any = must_be(self.kind, (str, PlatformKind), "a platform's kind", MechanismError)
        if isinstance(kind, PlatformKind):
            form, kind = kind, kind.name
        if kind in KINDS and form not in (None, KINDS[kind]) and form.name == kind:
            raise MechanismError(f"the kind {kind!r} has other freedoms; name your own otherwise")
        if form is None or form.name != kind:
            if kind not in KINDS:
                raise MechanismError(
                    f"unknown platform kind {kind!r}; expected one of {', '.join(KINDS)}"
                )
            form = KINDS[kind]
        object.__setattr__(self, "kind", kind)
        object.__setattr__(self, "form", form)
        home = array_of(self.home, ("dof",), "the home pose", MechanismError).tolist()
        object.__setattr__(self, "home", tuple(home))
        if len(self.home) != self.dof:
            raise MechanismError(
                f"the home pose of a {self.kind!r} platform has {self.dof} coordinates "
                f"({', '.join(self.coordinates)}), got {len(self.home)}"
            )

    def __repr__(self) -> str:
        return one_line("Platform", repr(self.kind), f"home={triple(self.home)}")

    @staticmethod
    def at_origin(kind: str | PlatformKind) -> Platform:
        """Return a platform of a kind whose home coordinates are zero."""
        form = KINDS[kind] if isinstance(kind, str) else kind
        return Platform(kind, (0.0,) * len(form.freedoms))

    @cached_property
    def lengths(self) -> int:
        """Number of coordinates that are positions; they come first."""
        return sum(not name.startswith("r") for name in self.form.freedoms)

    @property
    def turns(self) -> int:
        """Number of coordinates that are angles: none, one or three."""
        return self.dof - self.lengths

    @property
    def dof(self) -> int:
        """Number of freedoms."""
        return len(self.form.freedoms)

    @cached_property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates: positions; ``phi``, or azimuth, tilt and torsion."""
        angles = {0: (), 1: ("phi",), 3: WAYS["tilt-torsion"][0]}[self.turns]
        return (*self.form.freedoms[: self.lengths], *angles)

    @property
    def freedoms(self) -> tuple[str, ...]:
        """Names of the twist rows: three turns are rx, ry, rz in base axes, one is phi."""
        return self.form.freedoms if self.turns == 3 else self.coordinates

    @cached_property
    def units(self) -> tuple[str, ...]:
        """Units of the coordinates, and of the twist rows in the same order."""
        return ("m",) * self.lengths + ("rad",) * self.turns

    @cached_property
    def bounds(self) -> tuple[tuple[float, float], ...]:
        """Least and largest value of each coordinate, infinite for lengths."""
        angles = (_TURN,) if self.turns == 1 else (_TURN, _TILT, _TURN)[: self.turns]
        return (_ANY,) * self.lengths + angles

    @cached_property
    def twist_rows(self) -> tuple[int, ...]:
        """Rows of a twist (linear first) that the platform can move in, one per freedom."""
        return tuple(TWIST.index(name) for name in self.form.freedoms)

    @property
    def space(self) -> int:
        """Dimension of the space that the mechanism moves in: 2 or 3."""
        plane = self.lengths == 2 and set(self.form.freedoms) <= {"x", "y", "rz"}
        return 2 if plane else 3

    def closing(self, closes: str) -> tuple[int, ...]:
        """Return the rows of a twist in which a leg closes a ``"point"`` or a ``"frame"``."""
        if self.space == 2:
            return (0, 1) if closes == "point" else (0, 1, 5)
        return (0, 1, 2) if closes == "point" else (0, 1, 2, 3, 4, 5)

    def equations(self, leg: Leg) -> int:
        """Return how many equations a leg demands of a pose, passive joints eliminated."""
        return len(self.closing(leg.closes)) - len(leg.passive)

    def transforms(self, poses: Poses) -> RigidTransform:
        """Return poses ``T_base_platform`` of length N; rigid transforms pass unchanged.

        Args:
            poses: N poses: coordinates, shape (N, dof), [m] and [rad], or rigid transforms.

        Raises:
            MechanismError: wrong shape, or a coordinate that is not a finite number.
        """
        if isinstance(poses, RigidTransform):
            return poses
        return RigidTransform(self.matrices(poses), normalize=False, copy=False)

    def placed(self, poses: Poses) -> PoseMatrices:
        """Return poses whose matrices are made where they are asked for: see ``transforms``."""
        if not isinstance(poses, RigidTransform):
            return PoseMatrices(self, self.checked(poses))
        if poses.single:
            raise MechanismError("poses are N transforms; got a single one: put it in brackets")
        return PoseMatrices(self, poses)

    def matrices(self, poses: Poses) -> Array:
        """Return poses as homogeneous matrices, shape (N, 4, 4); see ``transforms``."""
        return self.placed(poses)[:]

    def matrices_of(self, coordinates: Array) -> Array:
        """Return ``T_base_platform`` of sound coordinates, shape (N, dof) to (N, 4, 4)."""
        T = np.zeros((4, 4, len(coordinates)))  # memory runs along the poses: see ``batches``
        T[range(4), range(4)] = 1.0
        T[: self.lengths, 3] = coordinates[:, : self.lengths].T
        if self.turns == 1:
            j, k = self._across
            T[k, j], T[j, j] = sine_and_cosine(coordinates[:, -1])
            T[k, k], T[j, k] = T[j, j], -T[k, j]
        elif self.turns == 3:
            T[:3, :3] = tilted(coordinates[:, self.lengths :])
        return T.transpose(2, 0, 1)

    def from_matrices(self, matrices: Array) -> Array:
        """Return the coordinates of homogeneous matrices, shape (N, 4, 4) to (N, dof)."""
        columns = list(matrices[:, : self.lengths, 3].T)
        R = matrices[:, :3, :3]
        if self.turns == 1:
            j, k = self._across
            columns.append(np.arctan2(R[:, k, j], R[:, j, j]))
        elif self.turns == 3:
            columns += list(columns_of("tilt-torsion", Rotation.from_matrix(R)).T)
        return np.stack(columns, axis=1)

    @property
    def _across(self) -> tuple[int, int]:
        """Axes across that of the one turn."""
        axis = self.twist_rows[-1] - 3
        return (axis + 1) % 3, (axis + 2) % 3

    def checked(self, poses: object) -> Array:
        """Return coordinates of poses, shape (N, dof), their shape and numbers checked."""
        coordinates = numbers_of(poses, "poses", MechanismError)
        if coordinates.ndim != 2 or coordinates.shape[1] != self.dof:
            raise MechanismError(
                f"poses of a {self.kind!r} platform have shape (N, {self.dof}) for "
                f"{', '.join(self.coordinates)}; got shape {coordinates.shape}"
            )
        if not np.isfinite(coordinates).all():
            row = int(np.argmin(np.isfinite(coordinates).all(axis=1)))
            raise MechanismError(f"pose {row + 1} has a coordinate that is not a finite number")
        return coordinates

    def coordinates_of(self, poses: Poses) -> Array:
        """Return the coordinates of poses, shape (N, dof), [m] and [rad], angles in (-pi, pi]."""
        if not isinstance(poses, RigidTransform):
            return numbers_of(poses, "poses", MechanismError)
        return self.from_matrices(poses.as_matrix())

    def moved(self, poses: Array, twists: Array) -> Array:
        """Return poses moved by small twists at the platform's origin, axes of the base.

        Coordinates and twists in the platform's freedoms, both of shape (N, dof), [m] and [rad].
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
        """Return the twists that take first poses to second ones, shape (N, dof): see ``moved``."""
        if self.turns < 3:
            turn = [unit == "rad" for unit in self.units]
            twists = second - first
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
