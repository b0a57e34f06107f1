"""Are the measurements such as this mechanism can have made?

Readings and poses that fit the nominal mechanism leave closure gaps that are small against
the legs, and that machines near it explain, with the legs bent as at home; and readings follow
those of nominal inverse kinematics. Else what often goes wrong is put right, one suspect at a
time, and those that then fit much better are named. If none does, nothing is identified.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MeasurementError
from pincal.identification.explanation import (
    EXPLAINED,
    REFUSED,
    beyond,
    check_gaps,
    doubtful,
    explained,
)
from pincal.identification.leg_fit import LegFit, leg_fits
from pincal.identification.suspects import mirrored, shifted
from pincal.kinematics.closure import LegClosure, largest_size
from pincal.kinematics.inverse import inverse
from pincal.model.measurements import Measurements, Noise
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]
_FOLLOWS = 0.5  # spread of measured less nominal readings, over the spread of the nominal ones
_STILL = 1e-3  # of a leg's size, and [rad]: readings that differ by less hardly move
_ROWS = 500  # enough to judge by
_LARGEST_NOISE = 0.02  # of a leg's size, and [rad]: beyond it, nothing can be calibrated


def check_plausible(mechanism: Mechanism, data: Measurements) -> None:
    """Raise if measurements cannot come from a mechanism like the nominal one.

    Only rows with complete poses are looked at, and of a leg those with its reading.

    Raises:
        MeasurementError: they do not fit; the message says what would explain it.
    """
    complete, some = _complete(data)
    if len(complete) < 2:
        return
    poses, readings = data.poses[some], data.readings[some]
    still = _still(mechanism, poses, readings)
    if still:
        raise MeasurementError(still)
    fits = leg_fits(mechanism, poses, readings)
    if doubtful(fits).any():
        check_gaps(mechanism, poses, readings, fits, shifted(data.poses, data.readings, some))
    _check_modes(mechanism, fits)
    _check_side(mechanism, poses, readings)
    _check_readings(mechanism, data, complete)


def suspected(mechanism: Mechanism, data: Measurements) -> str:
    """Return what would explain that measurements do not fit, in words; empty if nothing does."""
    complete, some = _complete(data)
    if len(complete) < 2:
        return ""
    poses, readings = data.poses[some], data.readings[some]
    if still := _still(mechanism, poses, readings):
        return still
    fits = leg_fits(mechanism, poses, readings)
    if not doubtful(fits).any():
        return ""
    shifts = shifted(data.poses, data.readings, some)
    return explained(mechanism, poses, readings, fits, shifts)


def _complete(data: Measurements) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return rows with complete poses, and enough of them to judge by."""
    complete = np.flatnonzero(np.isfinite(data.poses).all(axis=1))
    return complete, complete[:: max(-(-len(complete) // _ROWS), 1)]


def check_copies(data: Measurements, *, every_pose: bool = False) -> None:
    """Raise if rows that serve the same leg are equal in all that was measured.

    Rows chosen for several legs may be copies of each other: each leg has its own. But if
    ``every_pose`` serves every leg, whatever its set, copies would count as so many measurements.
    Where equal readings come with different poses, measurements were repeated, and poses
    written with few digits may be equal by chance.

    Raises:
        MeasurementError: rows that are copies.
    """
    told = np.column_stack([data.poses, *data.extra.values()])
    first: dict[tuple[str, bytes], int] = {}
    copies = []
    for row in range(len(data)):
        served = "" if data.sets is None or every_pose else data.sets[row]
        other = first.setdefault((served, data.readings[row].tobytes()), row)
        if other == row:
            continue
        if not np.array_equal(told[other], told[row], equal_nan=True):
            return
        copies.append((other + 1, row + 1))
    if copies:
        more = f" (and {len(copies) - 1} more such pairs)" if len(copies) > 1 else ""
        raise MeasurementError(
            f"data rows {copies[0][0]} and {copies[0][1]} are identical in all that was measured"
            f"{more}; measured twice, they would differ by noise. Remove the copies"
        )


def _still(mechanism: Mechanism, poses: Array, readings: Array) -> str:
    """Return which readings are the same in all rows though the poses move their sensors.

    In words; empty if there are none.
    """
    still = np.ptp(readings, axis=0) == 0.0
    if mechanism.by_readings or not still.any():
        return ""
    nominal = inverse(mechanism, poses).readings
    found, moves = [], []
    for index, (leg, name) in enumerate(zip(mechanism.legs, mechanism.reading_names, strict=True)):
        told = nominal[np.isfinite(nominal[:, index]), index]
        unit = mechanism.reading_units[index]
        size = 1.0 if unit == "rad" else LegClosure(leg, mechanism.platform).size
        if still[index] and len(told) > 1 and np.ptp(told) > _STILL * size:
            found.append(f"{name} reads the same in all rows ({readings[0, index]:.6g} {unit})")
            moves.append(f"{np.ptp(told):.2g} {unit}")
    if not found:
        return ""
    return (
        f"{', '.join(found)}, where readings of the nominal mechanism differ by "
        f"{', '.join(moves)} over these poses. Check the sensor, its cable and the log"
    )


def _check_modes(mechanism: Mechanism, fits: list[LegFit]) -> None:
    """Raise if legs close, but bent to the other side than at home.

    Raises:
        MeasurementError: naming the legs, their passive joints and in how many rows.
    """
    found = []
    for leg, fit in zip(mechanism.legs, fits, strict=True):
        if not fit.as_home and fit.gap <= REFUSED:
            passive = [leg.moving[i].name for i in leg.passive]
            found.append(f"{leg.name} ({' and '.join(passive)}, in {fit.bent} of {fit.rows} rows)")
    if found:
        raise MeasurementError(
            "readings and poses close the legs, but these bend the other way than in "
            f"mechanism.yaml's home: {', '.join(found)}. Correct 'home' there, or measure in its "
            "working mode"
        )


def _check_side(mechanism: Mechanism, poses: Array, readings: Array) -> None:
    """Raise if poses lie beyond a type-2 singularity from home, and a mirror brings them back.

    Mirrored in the plane of base and platform points, a hexapod has the same leg lengths.

    Raises:
        MeasurementError: naming the axis.
    """
    share = beyond(mechanism, poses)
    if share <= 0.5:
        return
    for suspect in mirrored(mechanism, poses, readings):
        fits = leg_fits(mechanism, suspect.poses, readings)
        gap = max((fit.gap for fit in fits if fit.rows > 1), default=np.inf)
        bent = not all(fit.as_home for fit in fits)
        if gap <= EXPLAINED and not bent and beyond(mechanism, suspect.poses) < 0.5:
            raise MeasurementError(
                f"{100 * share:.0f} % of the poses lie beyond a singularity from mechanism.yaml's "
                f"home; they would lie on its side, and fit to {100 * gap:.2g} % of the legs' "
                f"length, if {suspect.words}. {suspect.remedy}"
            )


def _check_readings(mechanism: Mechanism, data: Measurements, complete: NDArray[np.intp]) -> None:
    """Raise if readings do not follow the nominal ones, or are whole turns off.

    Only where poses tell readings.

    Raises:
        MeasurementError: they do not; the message names the leg and, for turns, the row.
    """
    if mechanism.by_readings:
        return
    nominal = inverse(mechanism, data.poses[complete]).readings
    for index, leg in enumerate(mechanism.legs):
        (sensor,), (unit,) = leg.sensors, leg.reading_units
        given = data.readings[complete, index]
        reached = np.isfinite(nominal[:, index]) & np.isfinite(given)
        if reached.sum() < 2:
            continue
        rows, expected, given = complete[reached], nominal[reached, index], given[reached]
        if unit == "rad":
            gain, _ = sensor.constants(leg.nominal_by_name)
            turn = 2 * np.pi * (abs(gain) if sensor.form == "reading" else 1 / abs(gain))
            turns = np.round((given - expected) / turn)
            if turns.any():
                first = int(np.argmax(turns != 0))
                count = int((turns != 0).sum())
                many = "reading is" if count == 1 else "readings are"
                raise MeasurementError(
                    f"{leg.name}: {count} {many} off by whole turns, the "
                    f"first in data row {rows[first] + 1}: {given[first]:.6g} rad, where the "
                    f"nominal mechanism reads {expected[first]:.6g} rad. Count without the turns, "
                    "or correct the nominal offset"
                )
        spread, off = _spread(expected), _spread(given - expected)
        size = 1.0 if unit == "rad" else LegClosure(leg, mechanism.platform).size
        if off > max(_FOLLOWS * spread, _STILL * size):
            raise MeasurementError(
                f"{leg.name}: the readings do not follow those of the nominal mechanism (spread of "
                f"the differences {off:.2g}, of the nominal readings {spread:.2g} "
                f"{unit}). Check their order and signs, the signs and frame of the "
                "poses, and the mechanism"
            )


def _spread(values: Array) -> float:
    """Return the median distance from the median."""
    return float(np.median(np.abs(values - np.median(values))))


def check_noise(mechanism: Mechanism, noise: Noise) -> None:
    """Raise if the noise given is so large that a unit must be wrong.

    Raises:
        MeasurementError: position noise above 2 % of a leg's size, or 0.02 rad of orientation.
    """
    size = largest_size(mechanism.legs, mechanism.platform)
    if noise.position > _LARGEST_NOISE * size:
        raise MeasurementError(
            f"the noise of position is given as {noise.position:g} m, more than "
            f"{100 * _LARGEST_NOISE:.0f} % of a leg's length ({size:.3g} m). It is in metres"
        )
    if "rad" in mechanism.platform.units and noise.orientation > _LARGEST_NOISE:
        raise MeasurementError(
            f"the noise of orientation is given as {noise.orientation:g} rad; expected less than "
            f"{_LARGEST_NOISE:g}. It is in radians"
        )
