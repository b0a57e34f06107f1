"""A kind of platform: the freedoms that it has, from which its coordinates follow.

Freedoms are rows of a twist at the platform's origin in axes of the base, the same at every pose:
positions along x, y, z, and turns about none of these axes, one, or all three. What else a machine
does is held by its legs: take all freedoms that it moves in, as ``3RPS`` does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from pincal.errors import MechanismError
from pincal.model.angles import sine_and_cosine
from pincal.model.checks import must_be, names_of
from pincal.model.orientation import WAYS, columns_of, tilted

Array = NDArray[np.float64]
Rows: TypeAlias = slice | NDArray[np.intp] | NDArray[np.bool_]
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
            raise MechanismError(f"{self.name[:64]!r} is no name for a platform kind")
        what = f"freedoms of a {self.name!r} platform"
        count = len(must_be(self.freedoms, Sequence, what, MechanismError))
        freedoms = names_of(self.freedoms, count, what, MechanismError)
        object.__setattr__(self, "freedoms", freedoms)
        ordered = tuple(name for name in TWIST if name in freedoms)
        if freedoms != ordered or not freedoms:
            raise MechanismError(
                f"{what}: {', '.join(freedoms) or 'none'}; expected some of {', '.join(TWIST)}, "
                "in this order"
            )
        if freedoms[: self.lengths] != TWIST[: self.lengths]:
            raise MechanismError(
                f"{what}: {', '.join(freedoms)}; a platform moves along x, along x and y, or along "
                "x, y and z: choose the base's axes so"
            )
        if len(freedoms) - self.lengths == 2:
            raise MechanismError(
                f"{what}: {', '.join(freedoms)}; turns about two axes are turns about a third as "
                "well: give all three, the legs hold what the platform does not do"
            )

    @cached_property
    def lengths(self) -> int:
        """Number of coordinates that are positions; they come first."""
        return sum(not name.startswith("r") for name in self.freedoms)

    @property
    def turns(self) -> int:
        """Number of coordinates that are angles: none, one or three."""
        return len(self.freedoms) - self.lengths

    @cached_property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates: positions; ``phi``, or azimuth, tilt and torsion."""
        angles = {0: (), 1: ("phi",), 3: WAYS["tilt-torsion"][0]}[self.turns]
        return (*self.freedoms[: self.lengths], *angles)

    @cached_property
    def units(self) -> tuple[str, ...]:
        """Units of the coordinates, and of the freedoms in the same order."""
        return ("m",) * self.lengths + ("rad",) * self.turns

    @cached_property
    def twist_rows(self) -> tuple[int, ...]:
        """Rows of a twist (linear first) that the platform can move in, one per freedom."""
        return tuple(TWIST.index(name) for name in self.freedoms)

    @cached_property
    def closure_rows(self) -> tuple[int, ...]:
        """Rows of the loop closure that are kept: two in a plane, three in space."""
        plane = self.lengths == 2 and set(self.freedoms) <= {"x", "y", "rz"}
        return (0, 1) if plane else (0, 1, 2)

    @cached_property
    def bounds(self) -> tuple[tuple[float, float], ...]:
        """Least and largest value of each coordinate, infinite for lengths."""
        angles = (_TURN,) if self.turns == 1 else (_TURN, _TILT, _TURN)[: self.turns]
        return (_ANY,) * self.lengths + angles

    @property
    def _axis(self) -> int:
        """Axis of the one turn."""
        return self.twist_rows[-1] - 3

    def matrices(self, coordinates: Array) -> Array:
        """Return ``T_base_platform`` of coordinates, shape (N, dof) to (N, 4, 4)."""
        T = np.zeros((4, 4, len(coordinates)))  # memory runs along the poses: see ``batches``
        T[range(4), range(4)] = 1.0
        T[: self.lengths, 3] = coordinates[:, : self.lengths].T
        if self.turns == 1:
            j, k = (self._axis + 1) % 3, (self._axis + 2) % 3
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
            j, k = (self._axis + 1) % 3, (self._axis + 2) % 3
            columns.append(np.arctan2(R[:, k, j], R[:, j, j]))
        elif self.turns == 3:
            columns += list(columns_of("tilt-torsion", Rotation.from_matrix(R)).T)
        return np.stack(columns, axis=1)


@dataclass(frozen=True)
class PoseMatrices:
    """Matrices of N poses, made of the rows that are asked for: no others fill memory."""

    form: PlatformKind
    poses: RigidTransform | Array
    """Coordinates, shape (N, dof), or transforms."""

    def __len__(self) -> int:
        return len(self.poses)

    def __getitem__(self, rows: Rows) -> Array:
        """Return ``T_base_platform`` of some, shape (s, 4, 4)."""
        some = self.poses[rows]
        if not isinstance(some, RigidTransform):
            return self.form.matrices(some)
        entries = some.as_matrix().transpose(1, 2, 0)
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
