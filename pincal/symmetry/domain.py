"""A fundamental domain of positions: the sector of which a group's elements make the whole."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pincal.symmetry.detect import SymmetryGroup
from pincal.symmetry.elements import SAME

Array = NDArray[np.float64]


def in_domain(group: SymmetryGroup, positions: Array) -> NDArray[np.bool_]:
    """Return which positions lie in one fundamental domain of a group, shape (N,).

    The one that begins at a mirror plane, or at azimuth 0 where there are rotations only, and
    goes round until an element carries it onto itself. Images of a position in the
    domain lie at its azimuth from there or further round.

    Args:
        group: The group, of isometries about the base's z axis.
        positions: In the base frame, shape (N, 2) or (N, 3), [m].
    """
    mirrors = [element.angle / 2 for element in group.elements if element.reflection]
    azimuths = np.arctan2(positions[:, 1], positions[:, 0])
    images = [
        (element.angle - azimuths) if element.reflection else (element.angle + azimuths)
        for element in group.elements
    ]
    begin = min((angle % np.pi for angle in mirrors), default=0.0)
    around = [(image - begin + SAME) % (2 * np.pi) for image in images]  # the identity first
    return np.asarray(around[0] <= np.min(around, axis=0) + 2 * SAME)
