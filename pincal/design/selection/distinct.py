"""Candidates that are one configuration in other coordinates, or nearly, are one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from pincal.model.checks import ALIKE
from pincal.model.platform import Platform, Poses

Array = NDArray[np.float64]
_LINES = 3  # along which places are looked at before they are looked at in full


def places_of(platform: Platform, poses: Poses, readings: Array | None = None) -> Array:
    """Return positions, rotation matrices and readings over their extents, shape (N, 12 or more).

    Coordinates that say the same pose, such as angles a whole turn apart, have the same place.

    Args:
        platform: The platform.
        poses: Coordinates, shape (N, dof), [m] and [rad], or transforms.
        readings: Shape (N, n_readings), where poses do not determine them, [rad] or [m].

    Raises:
        MechanismError: a pose of a wrong shape, or not finite.
    """
    return places_at(platform.matrices(poses), readings)


def places_at(matrices: Array, readings: Array | None = None) -> Array:
    """Return where poses as matrices, shape (N, 4, 4), are: see ``places_of``."""
    parts = [matrices[:, :3, 3], matrices[:, :3, :3].reshape(-1, 9)]
    parts += [] if readings is None else list(readings.T[:, :, None])
    sizes = [np.abs(part).max(initial=0.0) for part in parts]
    extents = [
        max(np.ptp(part, axis=0).max(), ALIKE * size) if size > 0.0 else 1.0
        for part, size in zip(parts, sizes, strict=True)
    ]
    return np.concatenate([p / e for p, e in zip(parts, extents, strict=True)], axis=1)


def distinct(platform: Platform, poses: Poses, readings: Array | None = None) -> NDArray[np.intp]:
    """Return the configurations that are no copies of earlier ones, as indices in order.

    Args:
        platform: The platform.
        poses: Coordinates, shape (N, dof), [m] and [rad], or transforms.
        readings: Shape (N, n_readings), where poses do not determine them, [rad] or [m].

    Raises:
        MechanismError: a pose of a wrong shape, or not finite.
    """
    places = places_of(platform, poses, readings)
    alike = perhaps_alike(places)
    places, others = places[alike], np.flatnonzero(~alike)
    kept = np.sort(np.unique(places, axis=0, return_index=True)[1])
    while len(kept) > 1:  # of a pair of nearest neighbours the later one goes
        distance, other = KDTree(places[kept]).query(places[kept], k=2, p=np.inf)
        own = np.arange(len(kept))
        nearest = np.where(other[:, 0] == own, 1, 0)
        copies = (distance[own, nearest] <= ALIKE) & (other[own, nearest] < own)
        if not copies.any():
            break
        kept = kept[~copies]
    return np.sort(np.concatenate((others, np.flatnonzero(alike)[kept])))


def perhaps_alike(places: Array) -> NDArray[np.bool_]:
    """Return which places may be copies: they lie together along every line, shape (N,)."""
    alike = np.ones(len(places), dtype=bool)
    for line in np.random.default_rng(0).uniform(-1.0, 1.0, (_LINES, places.shape[1])):
        along = places[alike] @ line
        order = np.argsort(along)
        together = np.diff(along[order]) <= ALIKE * np.abs(line).sum()
        own = np.zeros(len(along), dtype=bool)
        own[order[:-1][together]] = own[order[1:][together]] = True
        alike[alike] = own
    return alike
