"""Single angles of an orientation, and how they change as it turns: for partial measurements."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_CROSS = np.cross(np.eye(3)[:, None], np.eye(3)).transpose(0, 2, 1)  # matrices of e_a ×


def angle(name: str, R: Array) -> tuple[Array, Array]:
    """Return an angle of orientations and its derivative by turns in the outer axes.

    Args:
        name: ``yaw``, ``pitch``, ``roll`` (intrinsic Z-Y-X), ``azimuth``, ``tilt``, ``torsion``.
        R: Orientations, shape (N, 3, 3).

    Returns:
        The angle, shape (N,), [rad], and its derivative, shape (N, 3); zero where the angle has
        no meaning, as the azimuth at tilt 0.
    """
    turned = _CROSS @ R[:, None]  # e_a × R, shape (N, 3, 3, 3)

    def entry(i: int, j: int, sign: float = 1.0) -> tuple[Array, Array]:
        return sign * R[:, i, j], sign * turned[:, :, i, j]

    def length(a: tuple[Array, Array], b: tuple[Array, Array]) -> tuple[Array, Array]:
        size = np.hypot(a[0], b[0])
        safe = np.where(size > 0.0, size, 1.0)[:, None]
        return size, (a[0][:, None] * a[1] + b[0][:, None] * b[1]) / safe

    def arctan(f: tuple[Array, Array], g: tuple[Array, Array]) -> tuple[Array, Array]:
        square = f[0] ** 2 + g[0] ** 2
        safe = np.where(square > 0.0, square, 1.0)[:, None]
        slope = (g[0][:, None] * f[1] - f[0][:, None] * g[1]) / safe
        return np.arctan2(f[0], g[0]), slope

    if name == "yaw":
        return arctan(entry(1, 0), entry(0, 0))
    if name == "pitch":
        return arctan(entry(2, 0, -1.0), length(entry(0, 0), entry(1, 0)))
    if name == "roll":
        return arctan(entry(2, 1), entry(2, 2))
    azimuth = arctan(entry(1, 2), entry(0, 2))
    if name == "azimuth":
        return azimuth
    if name == "tilt":
        return arctan(length(entry(0, 2), entry(1, 2)), entry(2, 2))
    spin = arctan(entry(2, 1), entry(2, 0, -1.0))
    return azimuth[0] + spin[0], azimuth[1] + spin[1]
