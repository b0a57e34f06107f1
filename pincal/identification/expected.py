"""What the uncertainty of the parameters means for the platform.

Single parameters may be uncertain and yet well known together. What counts is where the
platform goes: with e = Nᵀ c of all legs, δx = −(∂e/∂x)⁻¹ (∂e/∂φ) δφ, and the covariance of
δx follows from that of the parameters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.identification.result import CalibrationResult
from pincal.kinematics.closure import solve
from pincal.kinematics.derivatives import leg_demand

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ExpectedError:
    """Root mean square error of the platform over poses, by the covariance of the parameters."""

    position: float
    """[m]."""
    orientation: float
    """[rad]; zero for a platform without orientation."""
    poses: int
    """Poses that all legs reach."""


def expected_error(result: CalibrationResult, poses: Array) -> ExpectedError:
    """Return the platform error to expect of the calibrated mechanism.

    Args:
        result: The calibration.
        poses: Poses over which to take the mean, coordinates of shape (N, dof).

    Raises:
        MechanismError: poses of a wrong shape, or not finite.
    """
    mechanism = result.identified
    rows = [leg_demand(mechanism, leg.name, poses) for leg in mechanism.legs]
    sizes = [len(leg.parameters) for leg in mechanism.legs]
    by_parameter = np.zeros((len(poses), len(rows), sum(sizes)))
    begin = 0
    for index, (row, size) in enumerate(zip(rows, sizes, strict=True)):
        by_parameter[:, index, begin : begin + size] = row.parameter[:, 0]
        begin += size
    by_pose = np.concatenate([row.pose for row in rows], axis=1)
    if by_pose.shape[1] != by_pose.shape[2]:  # more legs than freedoms: least squares
        transposed = by_pose.transpose(0, 2, 1)
        by_pose, by_parameter = transposed @ by_pose, transposed @ by_parameter
    ok = np.isfinite(by_pose).all(axis=(1, 2))
    gain = solve(by_pose[ok], by_parameter[ok])
    variance = np.einsum("nip,pq,niq->ni", gain, result.covariance, gain).mean(axis=0)
    linear = np.array([unit == "m" for unit in mechanism.platform.units])
    return ExpectedError(
        float(np.sqrt(variance[linear].sum())),
        float(np.sqrt(variance[~linear].sum())),
        int(ok.sum()),
    )
