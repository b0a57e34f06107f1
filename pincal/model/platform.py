"""The platform's freedoms: the coordinates people use, and the rigid transforms used inside."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from pincal.errors import MechanismError

Array = NDArray[np.float64]
Poses: TypeAlias = Array | RigidTransform  # coordinates (N, dof), or transforms of length N

#: For each kind: coordinate names, their units, and the rows of a twist (linear
#: first, as in Pinocchio) that the platform can move in.
_KINDS: dict[str, tuple[tuple[str, ...], tuple[str, ...], tuple[int, ...]]] = {
    "point": (("x", "y"), ("m", "m"), (0, 1)),
    "planar": (("x", "y", "phi"), ("m", "m", "rad"), (0, 1, 5)),
}


@dataclass(frozen=True)
class Platform:
    """Platform of a mechanism: ``point`` (x, y) or ``planar`` (x, y, phi).

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

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return _KINDS[self.kind][0]

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the coordinates."""
        return _KINDS[self.kind][1]

    @property
    def twist_rows(self) -> tuple[int, ...]:
        """Rows of a twist (linear first) that the platform can move in, one per coordinate."""
        return _KINDS[self.kind][2]

    @property
    def dof(self) -> int:
        """Number of freedoms."""
        return len(self.coordinates)

    @property
    def closure_rows(self) -> tuple[int, ...]:
        """Rows of the loop closure that are kept: two in a plane, three in space."""
        return (0, 1)

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
        position = np.zeros((len(coordinates), 3))
        position[:, :2] = coordinates[:, :2]
        quaternion = np.zeros((len(coordinates), 4))
        quaternion[:, 3] = 1.0
        if self.kind == "planar":
            quaternion[:, 2] = np.sin(coordinates[:, 2] / 2)
            quaternion[:, 3] = np.cos(coordinates[:, 2] / 2)
        return RigidTransform.from_components(position, Rotation.from_quat(quaternion))

    def coordinates_of(self, poses: Poses) -> Array:
        """Return the coordinates of poses, shape (N, dof), [m] and [rad]; phi in (-pi, pi]."""
        if not isinstance(poses, RigidTransform):
            return np.asarray(poses, dtype=np.float64)
        return self.from_matrices(poses.as_matrix())

    def from_matrices(self, matrices: Array) -> Array:
        """Return the coordinates of homogeneous matrices, shape (N, 4, 4) to (N, dof)."""
        columns = [matrices[:, 0, 3], matrices[:, 1, 3]]
        if self.kind == "planar":
            columns.append(np.arctan2(matrices[:, 1, 0], matrices[:, 0, 0]))
        return np.column_stack(columns)

    @property
    def home_pose(self) -> RigidTransform:
        """Home pose, length 1."""
        return self.transforms(np.array([self.home]))
