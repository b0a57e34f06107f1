"""Are the measurements such as this mechanism can have made? Units and signs are suspects.

Readings and poses that fit the nominal mechanism leave closure gaps that are small
against the legs, and readings follow those of nominal inverse kinematics. If they do not
as given but would in another unit, with another sign, or without whole turns, that is
said; if nothing fits, nothing is identified.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MeasurementError
from pincal.identification.residuals import LegResidual
from pincal.kinematics.closure import LegClosure
from pincal.kinematics.inverse import inverse
from pincal.model.measurements import Measurements, Noise
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]
_DOUBTFUL = 0.02  # median gap over the leg's size from which another unit is tried
_REFUSED = 0.05  # from which nothing is identified
_EXPLAINED = 0.01  # in another unit: it explains the measurements
_BETTER = 0.1  # of the gap as given
_FOLLOWS = 0.5  # spread of measured less nominal readings, over the spread of the nominal ones
_ROWS = 500  # enough to judge by
_LARGEST_NOISE = 0.02  # of a leg's size, and [rad]: beyond it, nothing can be calibrated


def check_plausible(mechanism: Mechanism, data: Measurements) -> None:
    """Raise if measurements cannot come from a mechanism like the nominal one.

    Raises:
        MeasurementError: they do not fit; the message says what would explain it.
    """
    step = max(1, len(data) // _ROWS)
    poses, readings = data.poses[::step], data.readings[::step]
    for index, leg in enumerate(mechanism.legs):
        gap = _gap(mechanism, index, poses, readings)
        if gap <= _DOUBTFUL:
            continue
        for suspect, changed_poses, changed_readings in _suspects(mechanism, poses, readings):
            other = _gap(mechanism, index, changed_poses, changed_readings)
            if other <= min(_EXPLAINED, _BETTER * gap):
                raise MeasurementError(
                    f"{leg.name}: as given, the measurements miss the nominal mechanism by "
                    f"{100 * gap:.0f} % of the leg's length; {suspect} they would by "
                    f"{100 * other:.2g} %. Correct the units in the headers"
                )
        if gap <= _REFUSED:
            continue
        raise MeasurementError(
            f"{leg.name}: measured poses and readings miss the nominal mechanism by "
            f"{100 * gap:.0f} % of the leg's length (median). Check the units, the order and signs "
            "of the readings, the frame of the poses, and that this is the right mechanism"
        )
    _check_readings(mechanism, data)


def _check_readings(mechanism: Mechanism, data: Measurements) -> None:
    """Raise if readings do not follow the nominal ones: a sign, or whole turns.

    Raises:
        MeasurementError: they do not; the message names the leg and, for turns, the row.
    """
    nominal = inverse(mechanism, data.poses).readings
    for index, leg in enumerate(mechanism.legs):
        reached = np.flatnonzero(np.isfinite(nominal[:, index]))
        if len(reached) < 2:
            continue
        expected, given = nominal[reached, index], data.readings[reached, index]
        if leg.reading_unit == "rad":
            gain, _ = leg.sensor.constants(leg.nominal_by_name)
            turn = 2 * np.pi * (abs(gain) if leg.sensor.form == "reading" else 1 / abs(gain))
            turns = np.round((given - expected) / turn)
            if turns.any():
                row = int(reached[np.argmax(turns != 0)])
                raise MeasurementError(
                    f"{leg.name}: {int((turns != 0).sum())} readings are off by whole turns, the "
                    f"first in data row {row + 1}: {data.readings[row, index]:.6g} rad, where the "
                    f"nominal mechanism reads {nominal[row, index]:.6g} rad. Count them without "
                    "the turns, or correct the nominal offset"
                )
        spread = _spread(expected)
        if spread > 0.0 and _spread(given - expected) > _FOLLOWS * spread:
            if _spread(given + expected) < _FOLLOWS * spread:
                raise MeasurementError(
                    f"{leg.name}: the readings run against the nominal ones. Change their sign, or "
                    "the sensor's 'direction' in mechanism.yaml"
                )
            raise MeasurementError(
                f"{leg.name}: the readings do not follow those of the nominal mechanism. Check "
                "their order and signs, the signs and frame of the poses, and the mechanism"
            )


def _spread(values: Array) -> float:
    """Return the median distance from the median."""
    return float(np.median(np.abs(values - np.median(values))))


def check_noise(mechanism: Mechanism, noise: Noise) -> None:
    """Raise if the noise given is so large that a unit must be wrong.

    Raises:
        MeasurementError: position noise above 2 % of a leg's size, or 0.02 rad of orientation.
    """
    size = max(LegClosure(leg, mechanism.platform).size for leg in mechanism.legs)
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


def _suspects(
    mechanism: Mechanism, poses: Array, readings: Array
) -> list[tuple[str, Array, Array]]:
    """Return what might have gone wrong: in words, and the measurements put right."""
    degree = np.pi / 180
    linear = np.array([unit == "m" for unit in mechanism.platform.units])
    turned = np.where(linear, poses, poses * degree)
    return [
        ("if the readings are in degrees under a radian header", poses, readings * degree),
        ("if the readings are in radians under a degree header", poses, readings / degree),
        (
            "if the positions are in mm under a metre header",
            poses * np.where(linear, 1e-3, 1),
            readings,
        ),
        (
            "if the positions are in metres under a mm header",
            poses * np.where(linear, 1e3, 1),
            readings,
        ),
        ("if the orientations are in degrees under a radian header", turned, readings),
        ("if all angles are in degrees under radian headers", turned, readings * degree),
    ]


def _gap(mechanism: Mechanism, index: int, poses: Array, readings: Array) -> float:
    """Return the median closure residual of a leg at its nominal parameters, over its size."""
    leg, platform = mechanism.legs[index], mechanism.platform
    matrices = platform.transforms(poses).as_matrix()
    found, _ = LegResidual(leg, platform, readings[:, index])(leg.nominal, matrices)
    values = np.abs(found.value)
    return float(np.median(np.nan_to_num(values, nan=np.inf))) / LegClosure(leg, platform).size
