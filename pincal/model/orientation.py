"""Orientations as people write them: tilt and torsion, rotation vectors, quaternions, Z-Y-X."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from pincal.errors import MeasurementError
from pincal.model.checks import wrapped
from pincal.types import Array

#: For each way: columns and their unit.
WAYS: dict[str, tuple[tuple[str, ...], str]] = {
    "tilt-torsion": (("azimuth", "tilt", "torsion"), "rad"),
    "rotation-vector": (("rx", "ry", "rz"), "rad"),
    "quaternion": (("qw", "qx", "qy", "qz"), "1"),
    "zyx": (("yaw", "pitch", "roll"), "rad"),
}
_UNIT_NORM = 1e-3  # by which a quaternion's length may miss 1
_POLE = 1e-13  # sine of an angle from a pole, below which rounding decides what turns about it


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
    error = np.abs(np.linalg.norm(values, axis=1) - 1.0)
    if (error > _UNIT_NORM).any():
        raise MeasurementError(
            f"row {int(np.argmax(error)) + 1}: the quaternion's length misses 1 by "
            f"{error.max():.2g}; "
            "expected qw, qx, qy, qz of length 1"
        )
    return Rotation.from_quat(values, scalar_first=True)


def _quaternions(values: Array) -> Array:
    """Return the unit quaternions of azimuth, tilt and torsion, (N, 3) to (4, N), scalar last."""
    azimuth, tilt, torsion = values.T
    half = torsion / 2
    across, along = np.sin(tilt / 2), np.cos(tilt / 2)
    x, y = across * np.sin(half - azimuth), across * np.cos(half - azimuth)
    return np.array((x, y, along * np.sin(half), along * np.cos(half)))


def columns_of(way: str, rotation: Rotation) -> Array:
    """Return the columns of orientations, shape (N, 3), [rad], or (N, 4): see ``rotation_of``.

    Angles have poles, where two of them turn about the same axis. The second of the two is
    found from what the first leaves of the orientation, so that ``rotation_of`` gives the
    orientation back everywhere; at a pole itself the azimuth (tilt 0), the torsion (tilt π) or
    the roll (pitch ±π/2) is 0. Quaternions have a scalar part of 0 or more.
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
    """Return the positions of three joints that turn about x, y, z, one on the other.

    R = Rx(a) Ry(b) Rz(c), the inverse of Z-Y-X angles of the inverse: shape (N, 3, 3) to (N, 3).
    """
    return -yaw_pitch_roll(R.transpose(0, 2, 1))[:, ::-1] + 0.0
