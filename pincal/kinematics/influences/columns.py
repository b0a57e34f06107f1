"""Influence quantities of rows: what terms depend on beside readings, as columns.

Temperature, time and whatever else is measured are given. From which side a joint came follows from
the order of rows where no column says it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MeasurementError
from pincal.model.checks import array_of
from pincal.model.measuring.measurements import Measurements, Plan
from pincal.model.mechanism import Mechanism
from pincal.model.sensors.terms import APPROACH

Array = NDArray[np.float64]
_STILL = 1e-3  # of the range of a reading: it has not moved
Influences = Mapping[str, Array | float] | Array


def influence_columns(mechanism: Mechanism, given: Influences | None, count: int) -> Array | None:
    """Return the columns of a mechanism's influences, shape (N, n_influences).

    NaN, at its reference, where nothing is given; None if no term depends on any.

    Args:
        mechanism: The mechanism.
        given: By column, a number for all rows or one for each, shape (N,); or all columns.
        count: Number of rows N.

    Raises:
        MeasurementError: a column on which nothing depends, or of a wrong shape.
    """
    if isinstance(given, np.ndarray):
        shape = (count, len(mechanism.influences))
        return array_of(given, shape, "influences", MeasurementError)
    given = given or {}
    if unknown := [name for name in given if name not in mechanism.influences]:
        known = ", ".join(mechanism.influences) or "none"
        raise MeasurementError(
            f"no term of {mechanism.name!r} depends on {unknown[0]!r}; its influences: {known}"
        )
    if not mechanism.influences:
        return None
    columns = np.full((count, len(mechanism.influences)), np.nan)
    for place, name in enumerate(mechanism.influences):
        if name in given:
            values = np.asarray(given[name])
            values = np.full(count, values) if values.ndim == 0 else values
            columns[:, place] = array_of(values, (count,), f"influence {name!r}", MeasurementError)
    if np.isinf(columns).any():
        raise MeasurementError("an influence is infinite; expected numbers, or NaN where not known")
    return columns


def influences_of(mechanism: Mechanism, plan: Plan, readings: Array | None = None) -> Array | None:
    """Return the columns of influences of a plan's or measurements' rows, in order of time.

    Args:
        mechanism: The mechanism.
        plan: The rows, with the influences that were given.
        readings: Of each row, shape (N, n_readings); those of the plan if not given.

    Returns:
        Shape (N, n_influences); None if no term depends on any.
    """
    own = own_influences(mechanism, plan.influences)
    columns = influence_columns(mechanism, own, len(plan))
    readings = plan.readings if readings is None else readings
    if columns is None or readings is None:
        return columns
    runs = plan.runs if isinstance(plan, Measurements) else None
    for place, name in enumerate(mechanism.reading_names):
        column = f"{APPROACH}_{name}"
        if column in mechanism.influences and column not in own:
            columns[:, mechanism.influences.index(column)] = sides(readings[:, place], runs)
    return columns


def own_influences(mechanism: Mechanism, given: Mapping[str, Array]) -> dict[str, Array]:
    """Return those of given columns on which terms of a mechanism depend."""
    return {name: given[name] for name in mechanism.influences if name in given}


def by_name(mechanism: Mechanism, columns: Array | None) -> dict[str, Array]:
    """Return columns of a mechanism's influences by name, each of shape (N,); none if None."""
    return {} if columns is None else dict(zip(mechanism.influences, columns.T, strict=True))


def sides(readings: Array, runs: Sequence[str] | None = None) -> Array:
    """Return from which side readings were come to, +1 from below, -1 from above, shape (N,).

    A reading that stays keeps its side, and one that goes back by less than a thousandth of its
    range, which is noise. NaN until it first moves, in each run, and where it was not read.

    Args:
        readings: In order of time, shape (N,).
        runs: Run of each row, if there were several.
    """
    found = np.full(len(readings), np.nan)
    read = np.flatnonzero(np.isfinite(readings))
    if not len(read):
        return found
    noise = _STILL * float(np.ptp(readings[read]))
    begins = [0]
    if runs is not None:
        names = np.array(runs)[read]
        begins += (1 + np.flatnonzero(names[1:] != names[:-1])).tolist()
    for rows in np.split(read, begins[1:]):
        found[rows] = _sides_of_run(readings[rows].tolist(), noise)
    return found


def _sides_of_run(readings: Sequence[float], noise: float) -> list[float]:
    """Return the sides of one run, what moves by more than the noise from where it last turned.

    However finely rows follow a motion, it has the same sides.
    """
    side, turned, found = np.nan, readings[0], []
    for reading in readings:
        moved = reading - turned
        if abs(moved) > noise and not moved * side > 0.0:
            side = float(np.sign(moved))
        if moved * side > 0.0:
            turned = reading  # the farthest so far
        found.append(side)
    return found
