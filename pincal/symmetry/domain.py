"""A fundamental domain of positions: a part of which a group's elements make the whole."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pincal.symmetry.detect import SymmetryGroup
from pincal.symmetry.elements import SAME

Array = NDArray[np.float64]


def in_domain(group: SymmetryGroup, positions: Array) -> NDArray[np.bool_]:
    """Return which positions lie in one fundamental domain of a group, shape (N,).

    Of a position and its images, that nearest to a point which no element leaves where it is
    (Dirichlet's domain): with mirrors through an axis, the sector between two of them.

    Args:
        group: The group.
        positions: In the base frame, shape (N, 2) or (N, 3), [m].
    """
    turns = group.mechanism.platform.home_pose.rotation.as_matrix()
    moves = [element.positions(turns) or element.base for element in group.elements]
    points = np.zeros((len(positions), 3))
    points[:, : positions.shape[1]] = positions
    size = max(leg.reach for leg in group.mechanism.legs)
    angles = np.linspace(0.0, 2 * np.pi, 48, endpoint=False) + 0.01
    centre = np.mean([move.t for move in moves], axis=0)
    ring = centre + size * np.stack(
        (np.cos(angles), np.sin(angles), 0.1 * np.sin(angles + 1.0)), axis=1
    )
    away = [np.linalg.norm(move(ring) - ring, axis=1) for move in moves[1:]]
    least = np.min(away, axis=0, initial=4.0 * size) / size
    point = ring[np.argmax(least.round(6))]  # in the middle of a sector
    distances = np.stack([np.linalg.norm(move(points) - point, axis=1) for move in moves])
    return np.asarray(distances[0] <= distances.min(axis=0) + SAME * size)
