"""Orientations as people write them: tilt and torsion, rotation vectors, quaternions, Z-Y-X."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pincal.errors import MeasurementError
from pincal.model.angles import sine_and_cosine

Array = NDArray[np.float64]

#: Angles that may be measured one by one.
SINGLE_ANGLES = ("yaw", "pitch", "roll")
#: For each way: columns and their unit.
WAYS: dict[str, tuple[tuple[str, ...], str]] = {
    "tilt-torsion": (("azimuth", "tilt", "torsion"), "rad"),
    "rotation-vector": (("rx", "ry", "rz"), "rad"),
    "quaternion": (("qw", "qx", "qy", "qz"), "1"),
    "zyx": (("yaw", "pitch", "roll"), "rad"),
}
_UNIT_NORM = 1e-3  # by which a quaternion's length may miss 1


def rotation_of(way: str, values: Array) -> Rotation:
    """Return the orientations of columns, ``R_base_platform``.

    - ``tilt-torsion``: R = Rz(azimuth) Ry(tilt) Rz(torsion − azimuth) (6-UPS paper, Eq. 4);
    - ``rotation-vector``: axis times angle;
    - ``quaternion``: scalar first, of length 1;
    - ``zyx``: intrinsic, R = Rz(yaw) Ry(pitch) Rx(roll).

    Args:
        way: One of ``WAYS``.
        values: Shape (N, 3), [rad], or (N, 4) for quaternions.

    Raises:
        MeasurementError: a quaternion that is not of length 1.
    """
    if way == "tilt-torsion":
        return Rotation.from_quat(_quaternions(values).T)
    if way == "rotation-vector":
        return Rotation.from_rotvec(values)
    if way == "zyx":
        return Rotation.from_euler("ZYX", values)
    off = np.abs(np.linalg.norm(values, axis=1) - 1.0)
    if (off > _UNIT_NORM).any():
        raise MeasurementError(
            f"row {int(np.argmax(off)) + 1}: the quaternion's length misses 1 by {off.max():.2g}; "
            "expected qw, qx, qy, qz of length 1"
        )
    return Rotation.from_quat(values, scalar_first=True)


def tilted(values: Array) -> Array:
    """Return the matrices of azimuth, tilt and torsion, [rad], shape (N, 3) to (3, 3, N)."""
    quaternions = _quaternions(values)
    (x, y, z, w), (a, b, c, _) = quaternions, 2.0 * quaternions
    R = np.empty((3, 3, len(x)))
    R[0, 0], R[1, 1], R[2, 2] = 1.0 - y * b - z * c, 1.0 - x * a - z * c, 1.0 - x * a - y * b
    for i, j, both, own in ((0, 1, x * b, w * c), (2, 0, x * c, w * b), (1, 2, y * c, w * a)):
        np.subtract(both, own, out=R[i, j])
        np.add(both, own, out=R[j, i])
    return R


def _quaternions(values: Array) -> Array:
    """Return the unit quaternions of azimuth, tilt and torsion, (N, 3) to (4, N), scalar last."""
    azimuth, tilt, torsion = values.T
    half = torsion / 2
    across, along = sine_and_cosine(tilt / 2)
    (x, y), (z, w) = sine_and_cosine(half - azimuth), sine_and_cosine(half)
    return np.array((across * x, across * y, along * z, along * w))


def columns_of(way: str, rotation: Rotation) -> Array:
    """Return the columns of orientations, shape (N, 3), [rad], or (N, 4): see ``rotation_of``.

    At tilt 0 the azimuth has no meaning and is 0; quaternions have a scalar part of 0 or more.
    """
    if way == "tilt-torsion":
        return _tilt_and_torsion(rotation.as_matrix())
    if way == "rotation-vector":
        return rotation.as_rotvec()
    if way == "quaternion":
        return rotation.as_quat(canonical=True, scalar_first=True)
    R = rotation.as_matrix()
    pitch = np.arctan2(-R[:, 2, 0], np.hypot(R[:, 0, 0], R[:, 1, 0]))
    level = np.hypot(R[:, 0, 0], R[:, 1, 0]) > 1e-12  # else yaw and roll turn alike: roll is 0
    yaw = np.where(level, np.arctan2(R[:, 1, 0], R[:, 0, 0]), np.arctan2(-R[:, 0, 1], R[:, 1, 1]))
    roll = np.where(level, np.arctan2(R[:, 2, 1], R[:, 2, 2]), 0.0)
    return np.stack((yaw, pitch, roll), axis=1)


def _tilt_and_torsion(R: Array) -> Array:
    """Return azimuth, tilt and torsion of rotation matrices, shape (N, 3, 3) to (N, 3)."""
    tilt = np.arctan2(np.hypot(R[:, 0, 2], R[:, 1, 2]), R[:, 2, 2])
    azimuth = np.arctan2(R[:, 1, 2], R[:, 0, 2])
    spin = np.arctan2(R[:, 2, 1], -R[:, 2, 0])
    upright = tilt < 1e-12
    azimuth = np.where(upright, 0.0, azimuth)
    spin = np.where(upright, np.arctan2(R[:, 1, 0], R[:, 0, 0]), spin)
    torsion = -((-(azimuth + spin) + np.pi) % (2 * np.pi) - np.pi)
    return np.stack((azimuth, tilt, torsion), axis=1)
