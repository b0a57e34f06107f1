"""Whether a reading says one position of its joint: q(ψ) with its terms rises, or falls, always."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pincal.model.sensors.sensor import SensorLaw
from pincal.model.sensors.terms import Harmonic

Array = NDArray[np.float64]
_POINTS = 2000
_OF_A_PERIOD = 24


def turning(law: SensorLaw, low: Array, high: Array) -> Array:
    """Return the first reading at which q(ψ) turns back, shape (n_active,); NaN where it does not.

    By ∂q/∂ψ on a grid over the joint's range, fine enough for the shortest harmonic of a machine;
    what terms of influences add does not depend on the reading.

    Args:
        law: The law at parameter values.
        low: Least positions of the active joints, shape (n_active,), [rad] or [m].
        high: Largest ones.
    """
    first, last = np.sort([(end - law.start) / law.slope for end in (low, high)], axis=0)
    waves = [
        (last - first)[one.target] * one.term.basis.rate / (2.0 * np.pi)
        for one in law.terms
        if isinstance(one.term.basis, Harmonic)
    ]
    count = int(max([_POINTS, *(_OF_A_PERIOD * wave for wave in waves)]))
    count = min(count, 500 * _POINTS)  # shorter waves are met at other phases, period by period
    readings = np.linspace(first, last, count + 1)
    back = np.broadcast_to(law.slopes(readings), readings.shape) * np.sign(law.slope) <= 0.0
    return np.where(back.any(axis=0), readings[back.argmax(axis=0), np.arange(len(first))], np.nan)
