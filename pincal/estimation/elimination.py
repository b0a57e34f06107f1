"""Unknown poses eliminated from linear rows r + A δφ + B δx, pose by pose.

Each pose's rows are turned by an orthogonal matrix that makes B triangular: the rows below it are
free of the pose and go on to the parameters (the square root of the Schur complement); the rows
beside it give the pose once the parameters are known. The cost is linear in the number of poses.
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

    triangle: Array
    """Triangular factor of B, shape (N, dof, dof)."""
    turned: Array
    """Rows of [A, r] turned by the orthogonal factor of B, shape (N, k, n + 1)."""

    @property
    def dof(self) -> int:
        """Number of freedoms of a pose."""
        return self.triangle.shape[2]

    @property
    def value(self) -> Array:
        """Residuals free of the poses, shape (N, k - dof)."""
        return self.turned[:, self.dof :, -1]

    @property
    def parameter(self) -> Array:
        """Their derivatives by the parameters, shape (N, k - dof, n)."""
        return self.turned[:, self.dof :, :-1]

    def poses(self, step: Array) -> Array:
        """Return the poses' steps for a step of the parameters, shape (n,) to (N, dof)."""
        top = self.turned[:, : self.dof]
        wanted = top[:, :, -1] + top[:, :, :-1] @ step
        return -solve(self.triangle, wanted[:, :, None])[:, :, 0]

    def poses_by_parameter(self) -> Array:
        """Return by how much poses follow the parameters, ∂x/∂φ, shape (N, dof, n)."""
        return -solve(self.triangle, self.turned[:, : self.dof, :-1])


def eliminate(value: Array, parameter: Array, pose: Array, damping: float = 0.0) -> Eliminated:
    """Return rows free of the poses.

    Args:
        value: r, shape (N, k).
        parameter: A, shape (N, k, n).
        pose: B, shape (N, k, dof).
        damping: Of the poses' steps, relative to the squares of their columns
            (Levenberg-Marquardt).
    """
    (count, k, dof), n = pose.shape, parameter.shape[2]
    more = dof if damping > 0.0 else 0
    rows, own = np.zeros((count, k + more, n + 1)), np.zeros((count, k + more, dof))
    rows[:, :k, :-1], rows[:, :k, -1], own[:, :k] = parameter, value, pose
    if more:
        lengths = np.sqrt(damping) * np.linalg.norm(pose, axis=1)
        own[:, k:] = lengths[:, :, None] * np.eye(dof)
    Q, R = np.linalg.qr(own, mode="complete")
    return Eliminated(R[:, :dof], Q.transpose(0, 2, 1) @ rows)
