"""Noise that is surely there: of columns that come in steps, and of play that no term models.

What is rounded to steps of h is off by up to h/2 either way: its noise is h/√12 at least. Play of
2a puts a joint a to one side or the other: unmodelled, that is a noise of a in its position, and of
a over the sensor's slope in its reading.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pincal.calibration.calibration import Calibration
from pincal.calibration.terms.kinds import BACKLASH
from pincal.calibration.terms.screen import Candidate
from pincal.estimation.residuals.losses import CLEAR
from pincal.kinematics.legs.closing import sensor_law
from pincal.kinematics.legs.closure import nominal_legs

Array = NDArray[np.float64]
_FEW = 8  # values that differ: of fewer nothing is said
_EVEN = 1e-2  # of a step: how nearly values are whole numbers of it
_FINE = 1e-7  # of the range: steps so small matter nowhere
_MATTERS = 1.0 / 3.0  # of the noise that is reckoned with


@dataclass(frozen=True)
class Bound:
    """A quantity whose noise cannot be less than something."""

    quantity: str
    """The reading or measured column."""
    unit: str
    """``"m"`` or ``"rad"``."""
    cause: Literal["steps", "play"]
    size: float
    """The step, or the whole play, of the reading, [m] or [rad]."""
    least: float
    """Standard deviation that it makes at least, [m] or [rad]."""
    reckoned: float
    """Noise that the calibration reckons with, [m] or [rad]; 0 if it is taken as exact."""

    @property
    def too_small(self) -> bool:
        """Whether the noise reckoned with is less than what is surely there."""
        return self.reckoned < self.least


def bounds(calibration: Calibration, candidates: Sequence[Candidate] = ()) -> tuple[Bound, ...]:
    """Return lower bounds of noise that matter: a third of the noise reckoned with, or more.

    Args:
        calibration: What was measured, its noise as it was found.
        candidates: The screen of its residuals, in which play shows.
    """
    found = [*_of_steps(calibration), *_of_play(calibration, candidates)]
    return tuple(one for one in found if one.least > _MATTERS * one.reckoned)


def step_of(values: Array) -> float:
    """Return the step in which values come, 0 if they come in none, in their unit.

    The greatest number of which all differences are whole multiples, by Euclid's algorithm.

    Args:
        values: Shape (N,); NaN where nothing was measured.
    """
    every = np.unique(values[np.isfinite(values)])
    if len(every) < _FEW:
        return 0.0
    gaps = np.sort(np.diff(every))
    step = float(gaps[0])
    while step > _FINE * (every[-1] - every[0]):
        length, times = 0.0, 0
        for gap in gaps.tolist():
            rest = abs(gap - round(gap / step) * step)
            if rest > _EVEN * step:
                step = rest
                break
            length, times = length + gap, times + round(gap / step)
            step = length / times  # better known than from one gap
        else:
            return step
    return 0.0


def _of_steps(calibration: Calibration) -> Iterator[Bound]:
    mechanism, data, noise = calibration.mechanism, calibration.measurements, calibration.noise
    columns = zip(mechanism.reading_names, mechanism.reading_units, strict=True)
    for place, (name, unit) in enumerate(columns):
        step = step_of(data.readings[:, place])
        if step:
            usual = float(np.median(noise.readings[:, place]))
            yield Bound(name, unit, "steps", step, step / np.sqrt(12.0), usual)
    seen = calibration.observation
    lengths = mechanism.platform.units.count("m")
    named = dict(zip(mechanism.platform.coordinates[:lengths], data.poses.T, strict=False))
    sigma = seen.noise(data, noise.noise).sigma
    for name, values in {**named, **data.extra}.items():
        if name in seen.names and (step := step_of(values)):
            usual = float(np.median(sigma[:, seen.names.index(name)]))
            unit = seen.units[seen.names.index(name)]
            yield Bound(name, unit, "steps", step, step / np.sqrt(12.0), usual)


def _of_play(calibration: Calibration, candidates: Sequence[Candidate]) -> Iterator[Bound]:
    mechanism = calibration.mechanism
    slopes = np.concatenate([sensor_law(leg).slope for leg in nominal_legs(mechanism)])
    for one in candidates:
        if one.kind.name != BACKLASH or len(one.names) > 1 or not one.rank:
            continue
        if abs(one.amplitudes[0]) < CLEAR * one.std[0]:
            continue
        place = mechanism.reading_names.index(one.reading)
        half = float(abs(one.amplitudes[0] / slopes[place]))
        usual = float(np.median(calibration.noise.readings[:, place]))
        yield Bound(one.reading, mechanism.reading_units[place], "play", 2.0 * half, half, usual)
