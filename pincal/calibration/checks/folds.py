"""Which rows are held out together: regions of the workspace, rows in turn, or runs."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MeasurementError
from pincal.model.measuring.measurements import Measurements

Array = NDArray[np.float64]
By = Literal["region", "turn", "run"]
FOLDS = 5


def folds_of(data: Measurements, folds: int, by: By = "turn") -> NDArray[np.intp]:
    """Return the fold of each row, shape (N,); -1 of rows that are seen by every fit.

    Raises:
        MeasurementError: too few rows, or fewer than two folds or runs.
    """
    if data.verifying.any():
        return np.where(data.verifying, 0, -1)
    if by == "run":
        names = tuple(dict.fromkeys(data.runs or ()))
        if len(names) < 2:
            raise MeasurementError("runs are left out by a column 'run' with at least two in it")
        return np.array([names.index(one) for one in data.runs or ()])
    places = clusters(data)
    sets = data.sets or ("",) * len(data)
    groups: dict[str, dict[str, list[int]]] = {}
    for row, (chosen, place) in enumerate(zip(sets, places, strict=True)):
        groups.setdefault(chosen, {}).setdefault(place, []).append(row)
    most = max(len(one) for one in groups.values())
    if not 2 <= folds <= most:
        raise MeasurementError(
            f"{folds} folds of {most} poses; expected at least two folds, and no more than there "
            "are poses"
        )
    found = np.zeros(len(data), dtype=np.intp)
    for poses in groups.values():
        firsts = np.array([rows[0] for rows in poses.values()])
        own = np.arange(len(poses)) % folds
        if by == "region":
            own = _regions(_scaled(data.readings[firsts]), min(folds, len(poses)))
        for rows, fold in zip(poses.values(), own, strict=True):
            found[rows] = fold
    return found


def clusters(data: Measurements) -> list[str]:
    """Return the pose of each row: by its name, or by equal readings; length N."""
    if data.places is None:
        return [row.tobytes().hex() for row in data.readings]
    return [place or str(row) for row, place in enumerate(data.places)]  # an empty one is its own


def _scaled(readings: Array) -> Array:
    """Return readings over the ranges that they have, in the middle where there is none, (N, n)."""
    measured = np.isfinite(readings)
    low = np.min(readings, axis=0, where=measured, initial=np.inf)
    high = np.max(readings, axis=0, where=measured, initial=-np.inf)
    some = high > low
    shares = (readings - np.where(some, low, 0.0)) / np.where(some, high - low, 1.0)
    return np.where(measured & some, shares, 0.5)


def _regions(readings: Array, count: int) -> NDArray[np.intp]:
    """Return the region of each row, shape (N,): halves of halves along the widest reading."""
    if count == 1:
        return np.zeros(len(readings), dtype=np.intp)
    spread = np.ptp(readings, axis=0)
    order = np.argsort(readings[:, int(np.argmax(spread))], kind="stable")
    first = count // 2
    low, high = np.split(order, [round(len(order) * first / count)])
    found = np.empty(len(readings), dtype=np.intp)
    found[low] = _regions(readings[low], first)
    found[high] = first + _regions(readings[high], count - first)
    return found
