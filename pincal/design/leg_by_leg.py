"""What a plan gives a calibration of each leg alone, by the poses chosen for it.

That is ``calibrate`` without options. It takes no notice of what the legs have in common: the pose,
measured once, and poses that were chosen for other legs. So it cannot do better than ``forecast``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.design.forecast import poses_needed
from pincal.design.platform_error import PlatformError, platform_error
from pincal.estimation.observability import identifiability, scaled_axes
from pincal.kinematics.configurations import legs_at
from pincal.kinematics.derivatives import leg_demand
from pincal.model.measurements import Noise, Plan
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LegByLeg:
    """What a plan of measurements in full tells of the parameters, each leg calibrated alone."""

    mechanism: Mechanism
    poses: int
    """Number of poses that all legs reach."""
    least: int
    """Fewest poses, dealt to the legs as these are, that can tell all parameters."""
    covariance: Array
    """Of the parameters of all legs, shape (n, n)."""

    def platform_error(self, poses: Plan | Array) -> PlatformError:
        """Return the error to expect of the calibrated platform over poses, shape (N, dof)."""
        return platform_error(self.mechanism, self.covariance, poses)

    def poses_for(self, accuracy: float, poses: Plan | Array) -> float:
        """Return how many poses like these bring the position error over others to a value."""
        now = self.platform_error(poses).position
        return max(self.least, poses_needed(self.poses, now, accuracy))


def leg_by_leg(mechanism: Mechanism, plan: Plan, noise: Noise) -> LegByLeg | None:
    """Return what each leg calibrated alone will tell, poses measured in full in the base frame.

    Poses of other legs' sets, and those that some leg does not reach, do not count. With e of a
    leg and V its covariance by the noise, δφ = −(Jᵀ V⁻¹ J)⁻¹ Jᵀ V⁻¹ e for J = ∂e/∂φ; what legs do
    with the noise of one pose goes together.

    Args:
        mechanism: The mechanism, at its nominal parameters.
        plan: Poses to measure, and for which leg each was chosen.
        noise: Standard deviations of what is measured.

    Returns:
        None where a leg's poses do not determine its parameters, e has no noise, or poses do not
        tell readings.

    Raises:
        MechanismError: poses of a wrong shape, or not finite.
    """
    if mechanism.by_readings:
        return None
    reached = legs_at(mechanism, plan).reached
    sigma, count = noise.of_poses(mechanism), sum(len(leg.parameters) for leg in mechanism.legs)
    noisy = np.zeros((len(reached), count, len(sigma) + len(mechanism.reading_names)))
    place, least = 0, 0.0
    for leg, columns in zip(mechanism.legs, mechanism.reading_columns, strict=True):
        rows = np.flatnonzero(reached & plan.serves(leg.name))
        told = leg_demand(mechanism, leg.name, plan.poses[rows])
        root = np.concatenate((told.pose * sigma, told.reading * noise.reading), axis=2)
        try:
            factor = np.linalg.cholesky(root @ root.transpose(0, 2, 1))
        except np.linalg.LinAlgError:
            return None
        J, white = np.linalg.solve(factor, told.parameter), np.linalg.solve(factor, root)
        flat = J.reshape(-1, len(leg.parameters))
        if not identifiability(flat, leg.parameter_names).complete:
            return None
        least = max(least, reached.sum() * flat.shape[1] / len(flat))
        lengths, s, axes = scaled_axes(flat)
        half = axes / lengths / s[:, None]
        moved = (half.T @ half) @ J.transpose(0, 2, 1) @ white
        own = slice(place, place := place + flat.shape[1])
        noisy[rows, own, : len(sigma)] = moved[:, :, : len(sigma)]
        noisy[rows, own, len(sigma) + columns.start : len(sigma) + columns.stop] = moved[
            :, :, len(sigma) :
        ]
    return LegByLeg(
        mechanism,
        int(reached.sum()),
        int(np.ceil(least)),
        np.einsum("nid,njd->ij", noisy, noisy, optimize=True),
    )
