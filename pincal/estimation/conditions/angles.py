"""Single angles of an orientation, and how they change as it turns: for partial measurements.

An angle is the direction of a vector (g, f) in a plane, atan2(f, g), whose length h is zero at the
angle's pole: a turn changes it by up to 1/h of itself. Angle times h is a turn, without a pole.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Entry = tuple[Array, Array]
"""A function of orientations, shape (N,), and its derivative by turns, shape (N, 3)."""
_CROSS = np.cross(np.eye(3)[:, None], np.eye(3)).transpose(0, 2, 1)  # matrices of e_a ×


def angle(name: str, R: Array) -> tuple[Entry, Entry]:
    """Return an angle of orientations and its h, each with its derivative by turns, outer axes.

    Args:
        name: ``yaw``, ``pitch``, ``roll`` (intrinsic Z-Y-X), ``azimuth``, ``tilt``, ``torsion``.
        R: Orientations, shape (N, 3, 3).

    Returns:
        The angle, [rad], and the h of which its derivative is 1/h long, 1 for pitch and tilt.
        Derivatives are zero where h is: the azimuth at tilt 0.
    """
    turned = _CROSS @ R[:, None]  # e_a × R, shape (N, 3, 3, 3)

    def entry(i: int, j: int, sign: float = 1.0) -> Entry:
        return sign * R[:, i, j], sign * turned[:, :, i, j]

    if name == "yaw":
        f, g = entry(1, 0), entry(0, 0)
    elif name == "pitch":
        f, g = entry(2, 0, -1.0), _length(entry(0, 0), entry(1, 0))
    elif name == "roll":
        f, g = entry(2, 1), entry(2, 2)
    elif name == "azimuth":
        f, g = entry(1, 2), entry(0, 2)
    elif name == "tilt":
        f, g = _length(entry(0, 2), entry(1, 2)), entry(2, 2)
    else:  # 1 + cos tilt, which is 2 h², times sine and cosine of the torsion
        f = _sum(entry(1, 0), entry(0, 1, -1.0))
        g = _sum(entry(0, 0), entry(1, 1))
    size, by_size = _length(f, g)
    safe = np.where(size > 0.0, size, 1.0)[:, None]
    slope = (g[0][:, None] * f[1] - f[0][:, None] * g[1]) / safe**2
    if name == "torsion":
        root = np.sqrt(0.5 * size)
        by_size = 0.25 * by_size / np.sqrt(0.5 * safe)
        size = root
    return (np.arctan2(f[0], g[0]), slope), (size, by_size)


def _length(a: Entry, b: Entry) -> Entry:
    size = np.hypot(a[0], b[0])
    safe = np.where(size > 0.0, size, 1.0)[:, None]
    return size, (a[0][:, None] * a[1] + b[0][:, None] * b[1]) / safe


def _sum(a: Entry, b: Entry) -> Entry:
    return a[0] + b[0], a[1] + b[1]
