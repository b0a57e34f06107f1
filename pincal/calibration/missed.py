"""How far targets are missed at held-out rows, in metres and radians, with intervals.

The calibrated machine goes where its readings take it; each target is predicted there and compared
with what was measured, measuring noise included. Rows of one pose are no more than one piece of
evidence, so intervals are by a bootstrap of poses (A. C. Davison and D. V. Hinkley 1997).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pincal.calibration.calibration import Calibration
from pincal.calibration.fits import Fits
from pincal.calibration.options import clusters
from pincal.design.platform_error import CONFIDENCE, DRAWS
from pincal.kinematics.batches import CHUNK
from pincal.kinematics.forward import forward
from pincal.model.setup import ORIGIN
from pincal.types import Array, Index


@dataclass(frozen=True)
class Missed:
    """How far one target is missed, its position or its orientation."""

    target: str
    """``"platform"``, or the name of a further target of the setup."""
    unit: str
    """``"m"`` of its position, ``"rad"`` of the measured orientation."""
    poses: int
    """Poses that were held out; rows of one pose count as one cluster."""
    fit: float
    """Root mean square at rows of the fit, [m] or [rad]."""
    mean: float
    """Mean at held-out rows."""
    rms: float
    """Root mean square at held-out rows."""
    largest: float
    """The largest; no bootstrap says how much larger another would be."""
    mean_ends: tuple[float, float]
    """Ends of the mean's 95 % interval; infinite of a single pose."""
    rms_ends: tuple[float, float]
    """Ends of the root mean square's 95 % interval."""


Misses = dict[tuple[str, str], Array]


def misses_of(calibration: Calibration, fits: Fits) -> Misses:
    """Return by how much targets are missed, by target and unit, each of shape (N,).

    NaN where a target was not measured, a reading is missing, or no pose belongs to the readings.

    Args:
        calibration: What was measured.
        fits: The fits that predict it.
    """
    observation, data = calibration.observation, calibration.measurements
    machine = calibration.mechanism.with_parameters(fits.parameters(calibration.mechanism))
    platform, setup = machine.platform, calibration.options.setup
    external = fits.external
    complete = np.isfinite(data.readings).all(axis=1) & observation.measured.any(axis=1)
    rows = np.flatnonzero(complete)
    influences = None if calibration.influences is None else calibration.influences[rows]
    guess = None  # measured in another frame
    if setup.plain:
        guess = np.where(np.isfinite(data.poses[rows]), data.poses[rows], platform.home)
    solution = forward(machine, data.readings[rows], guess, influences)
    rows, poses = rows[solution.converged], solution.poses[solution.converged]
    observed = observation.at(rows)
    errors = np.where(
        observed.measured, observed.residuals(platform.matrices(poses), external)[0], np.nan
    )
    names = list(observation.names)
    columns = {
        (target, "m"): [
            names.index(name)
            for axis in "xyz"
            if (name := axis if target == ORIGIN else f"{target}_{axis}") in names
        ]
        for target in setup.targets
    }
    turns = zip(platform.freedoms, platform.units, strict=True)
    columns[ORIGIN, "rad"] = [names.index(name) for name, unit in turns if unit == "rad"]
    misses: Misses = {}
    for key, column in columns.items():
        known = np.isfinite(errors[:, column]).any(axis=1)
        if known.any():
            values = np.full(len(data), np.nan)
            values[rows[known]] = np.sqrt(np.nansum(errors[known][:, column] ** 2, axis=1))
            misses[key] = values
    return misses


def per_row(misses: Misses, count: int) -> Array:
    """Return sizes of misses of position [m], of all targets, and orientation [rad], (N, 2)."""
    none = np.full(count, np.nan)
    squares = np.array(
        [
            [np.square(values) if of == unit else none for (_, of), values in misses.items()]
            or [none]
            for unit in ("m", "rad")
        ]
    )
    known = np.isfinite(squares)
    times = known.sum(axis=1)
    sums = np.where(known, squares, 0.0).sum(axis=1)
    return np.sqrt(np.divide(sums, times, out=np.full(times.shape, np.nan), where=times > 0)).T


def missed(fitted: Misses, unseen: Sequence[tuple[Calibration, Misses]]) -> tuple[Missed, ...]:
    """Return how far targets are missed, each over all rows held out.

    Args:
        fitted: Misses at rows of the fit.
        unseen: Of each fold, its rows and misses there.
    """
    answers = []
    for (target, unit), at_fit in fitted.items():
        parts = [
            (misses[target, unit], clusters(rows.measurements))
            for rows, misses in unseen
            if (target, unit) in misses
        ]
        if not parts:
            continue
        values = np.concatenate([misses for misses, _ in parts])
        places = np.concatenate([names for _, names in parts])
        known = np.isfinite(values)
        values, (_, pose) = values[known], np.unique(places[known], return_inverse=True)
        mean_ends, rms_ends = _ends(values, pose)
        answers.append(
            Missed(
                target=target,
                unit=unit,
                poses=int(pose.max()) + 1,
                fit=float(np.sqrt(np.nanmean(at_fit**2))),
                mean=float(values.mean()),
                rms=float(np.sqrt((values**2).mean())),
                largest=float(values.max()),
                mean_ends=mean_ends,
                rms_ends=rms_ends,
            )
        )
    return tuple(answers)


def _ends(values: Array, pose: Index) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return ends of the intervals of mean and root mean square of misses, by poses; (N,) both."""
    sums = np.stack(
        [np.bincount(pose, weights=w) for w in (values, values**2, np.ones_like(values))]
    )
    poses = sums.shape[1]
    if poses < 2:
        return (0.0, np.inf), (0.0, np.inf)
    random = np.random.default_rng(0)
    drawn = [
        sums @ _times(random.integers(poses, size=(len(part), poses))).T
        for part in np.array_split(np.empty(DRAWS), min(DRAWS, 1 + DRAWS * poses // CHUNK))
    ]
    totals = np.concatenate(drawn, axis=1)
    means = totals[:2] / totals[2]
    low, high = np.quantile(means, (0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2), axis=1)
    (mean_low, square_low), (mean_high, square_high) = low.tolist(), high.tolist()
    return (mean_low, mean_high), (square_low**0.5, square_high**0.5)


def _times(drawn: Index) -> Array:
    """Return how often each of n poses was drawn, by draws of n: shape (draws, n) both."""
    draws, n = drawn.shape
    places = drawn + n * np.arange(draws)[:, None]
    return np.bincount(places.ravel(), minlength=draws * n).reshape(draws, n).astype(float)
