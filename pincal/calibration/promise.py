"""What a calibration promises of the platform's error, and what contradicts a promise."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import chdtrc, chdtri, fdtrc

from pincal.calibration.calibration import Calibration
from pincal.design.platform_error import (
    PlatformError,
    Seen,
    Unidentified,
    closing_twists,
    platform_error,
    root_mean_squares,
    sizes,
)
from pincal.estimation.observability.gauge import unexplained
from pincal.estimation.unknowns import External
from pincal.model.measurements import Plan
from pincal.model.mechanism import Mechanism
from pincal.types import Array, Mask

if TYPE_CHECKING:
    from pincal.calibration.result import CalibrationResult

_SAME = 1e-6  # by which the uncertainty of one pose may differ by rounding
UNEXPLAINED = 1e-4  # probability of a χ² at which the noise as given is questioned


def excess_of(chi2: float, p_value: float) -> float:
    """Return how many times larger residuals are than the noise makes them; 1 if it may be."""
    return float(np.sqrt(chi2)) if p_value < UNEXPLAINED else 1.0


def exceeded(chi2: float, degrees_of_freedom: float, of_noise: float = np.inf) -> float:
    """Return the probability of a reduced χ², or a larger one; by F of noise that is estimated."""
    if not degrees_of_freedom:
        return 1.0
    if np.isfinite(of_noise):
        return float(fdtrc(degrees_of_freedom, of_noise, chi2))
    return float(chdtrc(degrees_of_freedom, degrees_of_freedom * chi2))


def unseen(chi2: float, degrees_of_freedom: float) -> float:
    """Return how many times larger than the noise residuals may be by their reduced χ², at 95 %.

    Errors of the model of that size cannot be distinguished from noise; 1 or more.
    """
    if not degrees_of_freedom:
        return 1.0
    return float(np.sqrt(max(1.0, chi2 * degrees_of_freedom / chdtri(degrees_of_freedom, 0.95))))


def expected_error(result: CalibrationResult, poses: Plan | Array | None) -> PlatformError:
    """Return what ``CalibrationResult.expected_error`` does.

    The measured region is where no pose is more uncertain than the most uncertain one that was
    measured: what the model lacks there, the measurements show or parameters have taken up; beyond,
    it grows with the uncertainty.
    """
    error = _by_covariance(result, measured_plan(result) if poses is None else poses)
    largest = most_uncertain(result)
    known = np.where(largest == 0.0, np.inf, np.nan_to_num(largest))  # 0: it does not turn
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.where(np.isinf(error.sizes), np.inf, error.sizes / known).max(axis=1)
    error = replace(error, outside=ratios * (1.0 - _SAME), uncovered=uncovered(result))
    if result.promises:
        return error
    # how many times farther measured poses are missed than uncertainties say, 1 or more; what is
    # not measured, position or orientation, is off by as much as the other
    expected = root_mean_squares(_by_covariance(result, measured_plan(result)).sizes)
    pairs = zip(result.misses, expected, strict=True)
    ratios = np.array([seen / said if said > 0.0 else np.nan for seen, said in pairs])
    ratios = np.where(np.isnan(ratios), np.nanmax([1.0, *ratios]), np.maximum(ratios, 1.0))
    std = error.std * [ratios[int(unit == "rad")] for unit in error.units]
    return replace(error, std=std, weights=error.weights * ratios[:, None] ** 2, promised=False)


def most_uncertain(result: CalibrationResult) -> Array:
    """Return the largest standard errors of position [m] and orientation [rad] at measured poses.

    They bound the measured region, shape (2,); NaN where no measured pose is determined.
    """
    measured = _by_covariance(result, measured_plan(result)).sizes.copy()
    measured[[outlier.row for outlier in result.outliers if outlier.weight == 0.0]] = np.nan
    measured = measured[np.isfinite(measured).all(axis=1)]
    return np.asarray(measured.max(axis=0) if len(measured) else np.full(2, np.nan))


def uncovered(result: CalibrationResult) -> tuple[str, ...]:
    """Return what a promise does not cover: nothing was said of it, and it can hide in parameters.

    ``"weight"`` that bends the machine without terms for it, a wrong ``"scale"`` of the instrument
    or the machine's temperature, and what changes with ``"time"`` where no pose was measured again.
    """
    observation = result.calibration.observation
    columns = zip(observation.units, observation.measured.T, strict=True)
    lengths = any(unit == "m" and column.any() for unit, column in columns)
    named = {
        "weight": not result.nominal.loaded,
        "scale": lengths and not result.options.setup.systematic.relative,
        "time": not any(result.measurements.places or ()),
    }
    return tuple(code for code, applies in named.items() if applies)


def _by_covariance(result: CalibrationResult, poses: Plan | Array) -> PlatformError:
    lost, seen = result.undetermined_directions, seen_by(result)
    data, distances = result.measurements, result.options.setup.distances
    measures = callable(seen) or (np.isfinite(data.poses).all() and not distances)
    measured = measured_plan(result) if measures and np.isfinite(data.readings).all() else None
    error = platform_error(
        result.identified,
        result.covariance,
        poses,
        None if lost is None else Unidentified(lost, result.nominal, measured),
        seen,
        result.noise_freedoms,
    )
    return replace(error, unseen=unseen(result.reduced_chi2, result.chi2_freedoms))


def seen_by(result: CalibrationResult) -> Array | Seen | None:
    """Return what is seen of the platform: where frame or targets were unknown, what was measured.

    That are the targets, and the orientation if that was measured, but for where the unknown
    frame, offsets and turns lie. What no such measurement can fix, such as a point of the platform
    that is far from the targets, is no error of the machine. Else motions of frames, or none.
    """
    observation, values = result.calibration.observation, result.outside
    platform, outside = result.nominal.platform, observation.external
    columns = zip(observation.names, observation.measured.T, strict=True)
    known = {name for name, rows in columns if rows.any()}
    positions = observation.setup.positions(platform).values()
    names = [name for axes in positions if known.issuperset(axes) for name in axes]
    if values is None or not names or observation.setup.instruments:
        return result.frames_moved
    places = [observation.names.index(name) for name in names]
    turns = platform.freedoms[platform.lengths :]
    rotations = [row - 3 for row in platform.twist_rows if row >= 3 and known.issuperset(turns)]
    units = ("m",) * len(names) + ("rad",) * len(rotations)
    size, n_targets = result.identified.size, len(names) / platform.space

    def seen(poses: Array, twists: Array) -> tuple[Array, tuple[str, ...]]:
        """Return what is seen of twists at poses: see ``Seen``."""
        count, n = len(poses), len(names)
        moved = np.zeros((count, len(units), twists.shape[2]))
        if not count:
            return moved, units
        motions = np.zeros((count, len(units), len(outside)))
        matrices, F = platform.matrices(poses), values.frame[:3, :3]
        rows = observation.at(np.zeros(count, dtype=np.intp)).anywhere().only(names)
        _, by_pose, by_outside = rows.residuals(matrices, values)
        moved[:, :n] = by_pose[:, places] @ twists / np.sqrt(n_targets)
        motions[:, :n] = by_outside[:, places] / np.sqrt(n_targets)
        if rotations:
            turned = np.zeros((count, 3, twists.shape[2]))
            turned[:, rotations] = twists[:, platform.lengths :]
            moved[:, n:] = (F @ turned)[:, rotations]
            by_values = np.zeros((count, 3, outside.own.stop))
            by_values[:, :, 3:6] = np.eye(3)  # by turns of the frame
            by_values[:, :, outside.turn] = F @ matrices[:, :3, :3]
            motions[:, n:] = by_values[:, rotations][:, :, outside.free]
        return unexplained(units, moved, motions, size), units

    return seen


def measured_plan(result: CalibrationResult) -> Plan:
    """Return the measured configurations: poses, and readings where these do not follow."""
    read = result.measurements.readings if result.nominal.by_readings else None
    return Plan(result.poses, readings=read)


def misses(result: CalibrationResult) -> tuple[float, float]:
    """Return by how much the platform misses poses that were measured in full, [m] and [rad]."""
    held = result.validation
    if held is not None and (held.position or held.orientation):
        _, position = held.position or (np.nan, np.nan)
        _, orientation = held.orientation or (np.nan, np.nan)
        return position, orientation
    twists = pose_misses(result.calibration, result.identified, result.outside)
    twists[[outlier.row for outlier in result.outliers if outlier.weight == 0.0]] = np.nan
    twists = twists[np.isfinite(twists).all(axis=1)]
    if len(twists):
        return root_mean_squares(sizes(result.nominal.platform.units, twists))
    return _missed_targets(result), np.nan


def _missed_targets(result: CalibrationResult) -> float:
    """Return by how much targets are missed in the fit, [m], less the instrument's known noise."""
    lengths = [part for part in result.observed if part.unit == "m"]
    if not lengths or result.degrees_of_freedom < 1:
        return np.nan
    count = sum(part.n_residuals for part in (*result.legs, *result.observed))
    squares = np.mean(np.concatenate([part.residuals for part in lengths]) ** 2)
    squares *= count / result.degrees_of_freedom
    if result.noise_source != "estimated":
        squares -= np.mean(np.concatenate([part.sigma for part in lengths]) ** 2)
    return float(np.sqrt(result.nominal.platform.space * max(squares, 0.0)))


def pose_misses(calibration: Calibration, machine: Mechanism, external: External | None) -> Array:
    """Return by how much a machine misses poses that were measured in full, shape (N, dof).

    Twists, NaN where a pose was not, or something else was measured than poses. External says where
    base and target are, if that was unknown.
    """
    setup, data = calibration.options.setup, calibration.measurements
    twists = np.full(data.poses.shape, np.nan)
    complete: Mask = np.asarray(np.isfinite(data.poses).all(axis=1))
    if complete.any() and not setup.distances and len(setup.targets) <= 1:
        poses = calibration.rows(complete).given_poses(external)
        rows = data.rows(complete)
        known = {name: rows.influences[name] for name in machine.influences}
        plan = Plan(poses, readings=rows.readings, influences=known)
        twists[complete] = closing_twists(machine, plan)
    return twists
