"""Unknown poses eliminated from linear rows r + A δφ + B δx, pose by pose.

Each pose's rows are turned by the orthogonal factor of B: the part across B is free of the
pose and goes on to the parameters (the square root of the Schur complement); the part along B
gives the pose once the parameters are known. The cost is linear in the number of poses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.kinematics.closure import solve

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Eliminated:
    """Rows free of the poses, and the way back to these."""

    value: Array
    """Shape (N, k)."""
    parameter: Array
    """Shape (N, k, n)."""
    back_value: Array
    """Shape (N, dof)."""
    back_parameter: Array
    """Shape (N, dof, n)."""

    def poses(self, step: Array) -> Array:
        """Return the poses' steps for a step of the parameters, shape (n,) to (N, dof)."""
        return -(self.back_value + self.back_parameter @ step)


def eliminate(value: Array, parameter: Array, pose: Array, damping: float = 0.0) -> Eliminated:
    """Return rows free of the poses: the left null space of their columns.

    Args:
        value: r, shape (N, k).
        parameter: A, shape (N, k, n).
        pose: B, shape (N, k, dof).
        damping: Of the poses' steps, relative to the squares of their columns
            (Levenberg-Marquardt).
    """
    k, dof = pose.shape[1:]
    if damping > 0.0:
        lengths = np.sqrt(damping) * np.linalg.norm(pose, axis=1)
        pose = np.concatenate((pose, lengths[:, :, None] * np.eye(dof)), axis=1)
    Q, R = np.linalg.qr(pose, mode="complete")
    along, across = Q[:, :k, :dof].transpose(0, 2, 1), Q[:, :k, dof:].transpose(0, 2, 1)
    both = np.concatenate((parameter, value[:, :, None]), axis=2)
    free, back = across @ both, solve(R[:, :dof], along @ both)
    return Eliminated(free[:, :, -1], free[:, :, :-1], back[:, :, -1], back[:, :, :-1])
