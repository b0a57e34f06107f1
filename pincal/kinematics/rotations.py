"""Rotation vectors of small and large turns, and their derivatives, in batches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


def turn_between(first: Array, second: Array) -> Array:
    """Return the rotation vectors, base axes, that take second to first, shape (N, 3), [rad].

    e = log(R₁ R₂ᵀ): a turn ω of R₁ changes it by J⁻¹(e) ω, one of R₂ by −J⁻¹(e)ᵀ ω, with the
    inverse left Jacobian J⁻¹.

    Args:
        first: Rotation matrices, shape (N, 3, 3).
        second: Rotation matrices, shape (N, 3, 3).
    """
    return Rotation.from_matrix(first @ second.transpose(0, 2, 1)).as_rotvec()


def inverse_left_jacobian(vectors: Array) -> Array:
    """Return the derivative of a rotation vector by a turn on the left, shape (N, 3, 3)."""
    angles = np.linalg.norm(vectors, axis=1)
    small = angles < 1e-4
    safe = np.where(small, 1.0, angles)
    factor = np.where(
        small,
        1 / 12,
        1 / safe**2 - (1 + np.cos(safe)) / (2 * safe * np.sin(np.where(small, 1.0, safe))),
    )
    S = np.cross(vectors[:, None], np.eye(3)).transpose(0, 2, 1)
    return np.eye(3) - 0.5 * S + factor[:, None, None] * (S @ S)
