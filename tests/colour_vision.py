"""How far apart colours are to people, with full colour vision and without one kind of cone.

G. M. Machado, M. M. Oliveira, L. A. F. Fernandes, *A physiologically-based model for simulation of
color vision deficiency*, IEEE TVCG 15(6), 2009: matrices of severity 1. G. Sharma, W. Wu,
E. N. Dalal, *The CIEDE2000 color-difference formula*, Color Research and Application 30(1), 2005.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
VISIONS = {
    "full": np.eye(3),
    "protanopia": np.array(
        [
            [0.152286, 1.052583, -0.204868],
            [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998],
        ]
    ),
    "deuteranopia": np.array(
        [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ]
    ),
    "tritanopia": np.array(
        [
            [1.255528, -0.076749, -0.178779],
            [-0.078411, 0.930809, 0.147602],
            [0.004733, 0.691367, 0.303900],
        ]
    ),
}
#: From linear sRGB to XYZ, D65 (IEC 61966-2-1).
_XYZ = np.array(
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
)


def linear(colours: list[str]) -> Array:
    """Return linear sRGB of colours ``"#rrggbb"``, shape (n, 3)."""
    s = np.array([[int(c[i : i + 2], 16) for i in (1, 3, 5)] for c in colours]) / 255
    return np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4)


def lab(rgb: Array) -> Array:
    """Return CIE L*a*b* (D65) of linear sRGB, shape (n, 3)."""
    ratio = rgb.clip(0.0, 1.0) @ _XYZ.T / _XYZ.sum(axis=1)
    f = np.where(ratio > (6 / 29) ** 3, np.cbrt(ratio), ratio / (3 * (6 / 29) ** 2) + 4 / 29)
    x, y, z = f.T
    return np.stack((116 * y - 16, 500 * (x - y), 200 * (y - z)), axis=1)


def difference(first: Array, second: Array) -> Array:
    """Return CIEDE2000 of colours in L*a*b*, arrays (..., 3) that broadcast."""
    (L1, a1, b1), (L2, a2, b2) = (np.moveaxis(np.asarray(one), -1, 0) for one in (first, second))
    C = (np.hypot(a1, b1) + np.hypot(a2, b2)) / 2
    G = 0.5 * (1 - np.sqrt(C**7 / (C**7 + 25.0**7)))
    a1, a2 = (1 + G) * a1, (1 + G) * a2
    C1, C2 = np.hypot(a1, b1), np.hypot(a2, b2)
    h1, h2 = (np.degrees(np.arctan2(b, a)) % 360 for a, b in ((a1, b1), (a2, b2)))
    grey = C1 * C2 == 0
    dh = np.where(grey, 0.0, (h2 - h1 + 180) % 360 - 180)
    far = np.abs(h1 - h2) > 180
    h = (h1 + h2) / 2 + np.where(far, np.where(h1 + h2 < 360, 180, -180), 0)
    h = np.where(grey, h1 + h2, h)
    dL, dC = L2 - L1, C2 - C1
    dH = 2 * np.sqrt(C1 * C2) * np.sin(np.radians(dh / 2))
    L, C = (L1 + L2) / 2, (C1 + C2) / 2
    T = (
        1
        - 0.17 * np.cos(np.radians(h - 30))
        + 0.24 * np.cos(np.radians(2 * h))
        + 0.32 * np.cos(np.radians(3 * h + 6))
        - 0.20 * np.cos(np.radians(4 * h - 63))
    )
    S_L = 1 + 0.015 * (L - 50) ** 2 / np.sqrt(20 + (L - 50) ** 2)
    S_C, S_H = 1 + 0.045 * C, 1 + 0.015 * C * T
    turn = 60 * np.exp(-(((h - 275) / 25) ** 2))
    R = -2 * np.sqrt(C**7 / (C**7 + 25.0**7)) * np.sin(np.radians(turn))
    own = dL / S_L, dC / S_C, dH / S_H
    return np.sqrt(own[0] ** 2 + own[1] ** 2 + own[2] ** 2 + R * own[1] * own[2])


def differences(colours: list[str], vision: str) -> Array:
    """Return CIEDE2000 between all pairs of colours as seen, shape (n, n)."""
    seen = lab(linear(colours) @ VISIONS[vision].T)
    return difference(seen[:, None], seen[None])


def contrast(first: str, second: str) -> float:
    """Return the contrast of two colours by WCAG 2, 1 to 21."""
    light = np.sort(linear([first, second]) @ [0.2126, 0.7152, 0.0722]) + 0.05
    return float(light[1] / light[0])
