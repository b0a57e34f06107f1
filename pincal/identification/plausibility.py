"""Are the measurements such as this mechanism can have made? Units are the usual suspects.

Readings and poses that fit the nominal mechanism leave closure gaps that are small
against the legs. If they do not fit as given but would in another unit, that is said;
if nothing fits, nothing is identified.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MeasurementError
from pincal.identification.residuals import LegResidual
from pincal.kinematics.closure import LegClosure
from pincal.model.measurements import Measurements
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]
_DOUBTFUL = 0.02  # median gap over the leg's size from which another unit is tried
_REFUSED = 0.05  # from which nothing is identified
_EXPLAINED = 0.01  # in another unit: it explains the measurements
_BETTER = 0.1  # of the gap as given
_ROWS = 500  # enough to judge by


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
    residual = LegResidual(leg, platform, matrices, readings[:, index], "closure")
    values = np.abs(residual(leg.nominal).value)
    return float(np.median(np.nan_to_num(values, nan=np.inf))) / LegClosure(leg, platform).size
