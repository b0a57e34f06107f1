"""What uncertain parameters mean for the platform: the error of where it goes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.experiment.frames import beyond
from pincal.kinematics.closure import largest_size, solve
from pincal.kinematics.derivatives import Demand, leg_demand
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]
_SLIDES = 1e-6  # of the largest motion, from which a direction is said to move the platform


@dataclass(frozen=True)
class PlatformError:
    """Root mean square error of the platform over poses; infinite where it is not determined."""

    position: float
    """[m]."""
    orientation: float
    """[rad]; zero for a platform without orientation."""
    poses: int
    """Poses that all legs reach."""


def platform_error(
    mechanism: Mechanism,
    covariance: Array,
    poses: Array,
    lost: Array | None = None,
    gauge: Array | None = None,
) -> PlatformError:
    """Return what the covariance of the parameters means for the platform.

    Single parameters may be uncertain and yet well known together. What counts is where the
    platform goes: with e of all legs, δx = −(∂e/∂x)⁻¹ (∂e/∂φ) δφ.

    Args:
        mechanism: The mechanism.
        covariance: Of the parameters of all legs, shape (n, n).
        poses: Poses over which to take the mean, coordinates of shape (N, dof).
        lost: Directions of parameters that are not determined, columns of shape (n, n_lost).
        gauge: Directions of parameters that only move frames which are not measured, columns of
            shape (n, n_gauge): what these motions explain is left out.

    Raises:
        MechanismError: poses of a wrong shape, or not finite.
    """
    by_parameter, by_pose = stacked([leg_demand(mechanism, n, poses) for n in mechanism.leg_names])
    ok = np.isfinite(by_pose).all(axis=(1, 2)) & np.isfinite(by_parameter).all(axis=(1, 2))
    gain = pose_gain(by_parameter[ok], by_pose[ok])
    if gauge is not None:
        size = largest_size(mechanism.legs, mechanism.platform)
        gain = beyond(mechanism.platform, gain, gain @ gauge, size)
    variance = np.einsum("nip,pq,niq->ni", gain, covariance, gain).mean(axis=0)
    if lost is not None and lost.shape[1]:
        slides = np.abs(gain @ lost).max(axis=(0, 2)) > _SLIDES * np.abs(gain).max(axis=(0, 2))
        variance = np.where(slides, np.inf, variance)
    linear = np.array([unit == "m" for unit in mechanism.platform.units])
    return PlatformError(
        float(np.sqrt(variance[linear].sum())),
        float(np.sqrt(variance[~linear].sum())),
        int(ok.sum()),
    )


def pose_gain(by_parameter: Array, by_pose: Array) -> Array:
    """Return ∂(pose)/∂(parameter), shape (N, dof, n); least squares for more legs than freedoms."""
    if by_pose.shape[1] != by_pose.shape[2]:
        transposed = by_pose.transpose(0, 2, 1)
        by_pose, by_parameter = transposed @ by_pose, transposed @ by_parameter
    return -solve(by_pose, by_parameter)


def stacked(demands: list[Demand]) -> tuple[Array, Array]:
    """Return ∂e/∂φ and ∂e/∂x of all legs, shapes (N, n_rows, n_params) and (N, n_rows, dof)."""
    by_pose = np.concatenate([row.pose for row in demands], axis=1)
    sizes = [row.parameter.shape[2] for row in demands]
    by_parameter = np.zeros((*by_pose.shape[:2], sum(sizes)))
    row, column = 0, 0
    for demand, size in zip(demands, sizes, strict=True):
        k = demand.parameter.shape[1]
        by_parameter[:, row : row + k, column : column + size] = demand.parameter
        row, column = row + k, column + size
    return by_parameter, by_pose
