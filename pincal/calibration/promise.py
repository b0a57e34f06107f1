"""The promised error of the platform, the region in which it holds, and what contradicts it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import chdtrc, fdtrc

from pincal.calibration.calibration import Calibration
from pincal.design.platform_error import (
    PlatformError,
    Seen,
    Unidentified,
    moved_by_readings,
    outside_of,
    platform_error,
    root_mean_squares,
    seen_of,
    seen_targets,
    unnoticed,
)
from pincal.design.simulate import platform_errors
from pincal.estimation.observation import Observation
from pincal.estimation.unknowns import External, State
from pincal.kinematics.configurations import legs_at
from pincal.kinematics.forward import forward
from pincal.model import ORIGIN, ROW, Load, Mechanism, Plan
from pincal.types import Array

if TYPE_CHECKING:
    from pincal.calibration.result import CalibrationResult

_BEST_FIT = 1e-6, 1e6  # radii at which frames are aligned for positions, for orientations, [m]
UNEXPLAINED = 1e-4  # p-value of χ² below which the given noise is doubted


def excess_of(chi2: float, p_value: float) -> float:
    """Return residuals over the given noise as a factor; 1 if the noise may explain them."""
    return float(np.sqrt(chi2)) if p_value < UNEXPLAINED else 1.0


def exceeded(chi2: float, degrees_of_freedom: float, of_noise: float = np.inf) -> float:
    """Return the p-value of a reduced χ²; by F if the noise is estimated."""
    if not degrees_of_freedom:
        return 1.0
    if np.isfinite(of_noise):
        return float(fdtrc(degrees_of_freedom, of_noise, chi2))
    return float(chdtrc(degrees_of_freedom, degrees_of_freedom * chi2))


def expected_error(result: CalibrationResult, poses: Plan | Array | None) -> PlatformError:
    """Return the expected platform error: see ``CalibrationResult.expected_error``.

    The measured region is where no pose is more uncertain than the most uncertain measured pose:
    errors of the model in it have been seen, or parameters have absorbed them.

    Where something contradicts the model, errors are scaled to those at measured poses by fits
    without them; position or orientation, if not measured, is scaled like the other.
    """
    poses = measured_plan(result) if poses is None else poses
    return _with_hidden(result, poses, _in_region(result, poses))


def errors_inside(result: CalibrationResult, plan: Plan) -> tuple[PlatformError, PlatformError]:
    """Return the errors over all poses, and those stated over the poses in the measured region."""
    expected = _in_region(result, plan)
    within = expected.within
    if within.all():
        return expected, _with_hidden(result, plan, expected)
    poses = plan.rows(within)  # with frames that fit these poses, and the same region
    inside, outside = _by_covariance(result, poses), expected.outside[within]
    inside = _scaled(result, replace(inside, outside=outside, uncovered=expected.uncovered))
    return expected, _with_hidden(result, poses, inside)


def _with_hidden(
    result: CalibrationResult, poses: Plan | Array, error: PlatformError
) -> PlatformError:
    if not error.promised:
        return error
    return replace(error, hidden=_hidden(result, poses, error.unnoticed))


def _in_region(result: CalibrationResult, poses: Plan | Array) -> PlatformError:
    """Return the errors over poses, and how far these are outside the measured region."""
    error = _by_covariance(result, poses)
    outside = outside_of(error.sizes, most_uncertain(result))
    return _scaled(result, replace(error, outside=outside, uncovered=uncovered(result)))


def _scaled(result: CalibrationResult, error: PlatformError) -> PlatformError:
    """Return errors that are scaled as ``expected_error`` says."""
    if result.promises:
        return error
    expected = np.array(root_mean_squares(_by_covariance(result, measured_plan(result)).sizes))
    lacks = np.sqrt(np.maximum(np.square(result.misses) - expected**2, 0.0))
    std, lengths = error.std, np.array([unit == "m" for unit in error.units])
    times = np.nanmax([1.0, *np.hypot(1.0, lacks[expected > 0.0] / expected[expected > 0.0])])
    for lack, columns in zip(lacks, (lengths, ~lengths), strict=True):
        beside = np.hypot(std, lack / np.sqrt(max(columns.sum(), 1)))
        std = np.where(columns, std * times if np.isnan(lack) else beside, std)
    return replace(error, std=std, promised=False)


def _hidden(result: CalibrationResult, poses: Plan | Array, scale: float) -> tuple[float, float]:
    """Return root mean square errors of the machine that residuals cannot show, [m] and [rad].

    What no parameter holds, such as clearance, acts like errors of the readings, of one size in all
    of them. White rows show a share w of their variance. χ² bounds all noise by a scale
    (``unnoticed``), so that variances up to (scale² - 1) / w may be the machine's. They move the
    platform at every pose through B⁻¹ D, apart from the parameters.
    """
    calibration, legs = result.calibration, legs_at(result.identified, poses)
    if result.options.latent:
        problems = [calibration.every_leg(calibration.used)]
    else:
        problems = [calibration.measured_problem([leg.name])[0] for leg in result.legs]
    shown, rows = 0.0, sum(int(problem.equations.sum()) for problem in problems)
    for problem in problems:
        external = result.outside or problem.observation.external.start
        parameters = np.concatenate([result.leg(leg.name).identified for leg in problem.legs])
        matrices = problem.platform.matrices(result.poses[problem.leg_block.data_rows])
        linear = problem.evaluate(State(parameters, matrices, external=external))
        shown += float(np.nansum(linear.white(linear.by_reading) ** 2)) / rows
    parts = root_mean_squares(moved_by_readings(result.identified, legs, seen_by(result)))
    times = float(np.sqrt((scale**2 - 1.0) / shown))
    return parts[0] * times, parts[1] * times


def most_uncertain(result: CalibrationResult) -> Array:
    """Return the largest standard errors at measured poses, [m] and [rad], (2,), or NaN.

    They bound the measured region.
    """
    measured = _by_covariance(result, measured_plan(result)).sizes.copy()
    measured[[outlier.row for outlier in result.outliers if outlier.weight == 0.0]] = np.nan
    measured = measured[np.isfinite(measured).all(axis=1)]
    return np.asarray(measured.max(axis=0) if len(measured) else np.full(2, np.nan))


def uncovered(result: CalibrationResult) -> tuple[str, ...]:
    """Return the causes of errors that a promise does not cover, since parameters can absorb them.

    They are ``"weight"`` that is not given or has no terms, a wrong ``"scale"`` of the instrument
    or by temperature, and changes with ``"time"`` where no pose was measured repeatedly; first the
    motion of any ``"freedom"`` of the platform that the drives leave open.
    """
    observation = result.calibration.observation
    lengths = "m" in np.array(observation.units)[observation.measured.any(axis=0)]
    named = {
        "freedom": result.nominal.constraints < result.nominal.platform.dof,
        "weight": not result.nominal.loaded or (result.nominal.load or Load()).assumed,
        "scale": lengths and not result.options.setup.systematic.relative,
        "time": not any(result.measurements.places or ()),
    }
    return tuple(code for code, applies in named.items() if applies)


def _by_covariance(result: CalibrationResult, poses: Plan | Array) -> PlatformError:
    lost, seen = result.undetermined_directions, seen_by(result)
    data, distances = result.measurements, result.options.setup.distances
    fully = np.isfinite(data.poses).all() and not distances
    measures = callable(seen) or result.options.setup.pixels or fully
    measured = measured_plan(result) if measures and np.isfinite(data.readings).all() else None
    error = platform_error(
        result.identified,
        result.covariance,
        poses,
        None if lost is None else Unidentified(lost, result.nominal, measured),
        seen,
        result.noise_freedoms,
    )
    return replace(error, unnoticed=unnoticed(result.reduced_chi2, result.chi2_freedoms))


def seen_by(result: CalibrationResult) -> Array | Seen | None:
    """Return the view of the platform in which errors are stated.

    Where frame or targets were unknown, it is ``seen_targets``. Otherwise it is the platform apart
    from motions of frames that the gauge has fixed, if any.
    """
    observation, seen = result.calibration.observation, None
    if result.outside is not None:
        measured = np.array(observation.names)[observation.measured.any(axis=0)].tolist()
        seen = seen_targets(observation, measured, result.outside)
    return seen or result.frames_moved


def apart(
    result: CalibrationResult, plan: Plan, model: Mechanism, truth: Mechanism
) -> tuple[Array, tuple[str, ...]]:
    """Return the true minus the commanded motion when a model drives the true machine, and units.

    It is the visible motion, as in ``expected_error``, shape (N, r); NaN out of reach. Unknown
    frames are aligned to be best for positions, and for orientations.
    """
    twists = platform_errors(model, truth, plan)
    known = np.isfinite(twists).all(axis=1)
    moved, frames = twists[known, :, None], seen_by(result)
    (positions, units), (turns, _) = (
        seen_of(truth, plan.poses[known], moved, frames, radius) for radius in _BEST_FIT
    )
    differences = np.full((len(twists), len(units)), np.nan)
    lengths = np.array([unit == "m" for unit in units])
    differences[known] = np.where(lengths, positions[:, :, 0], turns[:, :, 0])
    return differences, units


def measured_plan(result: CalibrationResult) -> Plan:
    """Return the measured configurations: poses, and readings where poses do not give them."""
    read = result.measurements.readings if result.nominal.by_readings else None
    return Plan(result.poses, readings=read)


Misses = dict[tuple[str, str], Array]
"""Sizes of errors by target and unit, shape (N,), [m] or [rad]; NaN if unknown."""


def misses_of(calibration: Calibration, parameters: Array, external: External) -> Misses:
    """Return errors of targets at a calibration's rows with parameters (n,) of all legs.

    NaN where a target was not measured, a reading is missing, or the readings have no pose.
    """
    machine = calibration.identified(parameters)
    observation, data = calibration.observation, calibration.measurements
    complete = np.isfinite(data.readings).all(axis=1) & observation.measured.any(axis=1)
    complete &= machine.constraints >= machine.platform.dof  # else readings have no pose
    rows = np.flatnonzero(complete)
    influences = None if calibration.influences is None else calibration.influences[rows]
    poses = np.where(np.isfinite(data.poses[rows]), data.poses[rows], machine.platform.home)
    guess = poses if calibration.options.setup.plain else None  # measured in another frame
    solution = forward(machine, data.readings[rows], guess, influences)
    rows, poses = rows[solution.converged], solution.poses[solution.converged]
    observed = observation.at(rows)
    matrices = machine.platform.matrices(poses)
    errors, metres = np.full((2, *observation.measured.shape), np.nan)
    residuals = observed.residuals(matrices, external)[0]
    errors[rows] = np.where(observed.measured, residuals, np.nan)
    metres[rows] = observed.metres_per_pixel(matrices, external)
    return by_target(observation, errors, metres)


def by_target(observation: Observation, errors: Array, metres: Array | float = np.nan) -> Misses:
    """Return sizes of errors of measured quantities (N, r) by target; NaN where unknown.

    For cameras they are root mean squares over seen points, in px, and in m across the line of
    sight with ``metres`` per pixel, (N, r).
    """
    setup, sizes_by_target = observation.setup, dict[tuple[str, str], Array]()
    cameras = {device.name for device in setup.instruments if setup.pixels & {*device.columns}}
    for (target, unit), columns in _columns_by_target(observation).items():
        seen = target in cameras
        part = (errors * metres if seen and unit == "m" else errors)[:, columns]
        known, points = np.isfinite(part), 1.0
        if seen:
            points = np.maximum(known.sum(axis=1) / 2, 1.0)
        if known.any():
            size = np.sqrt(np.nansum(part**2, axis=1) / points)
            sizes_by_target[target, unit] = np.where(known.any(axis=1), size, np.nan)
    return sizes_by_target


def _columns_by_target(observation: Observation) -> dict[tuple[str, str], list[int]]:
    """Return the columns of measured quantities by target and unit (cameras: px and m)."""
    platform, names, setup = observation.platform, list(observation.names), observation.setup
    named = {(target, "m"): axes for target, axes in setup.positions(platform).items()}
    touched = setup.contact_axes(platform).items()
    named |= {(contact, "m"): axes for contact, axes in touched if contact != ROW}
    turns = zip(platform.freedoms, platform.units, strict=True)
    named[ORIGIN, "rad"] = [name for name, unit in turns if unit == "rad"]
    for device in setup.instruments:
        pixels = [name for name, unit in device.columns.items() if unit == "px"]
        named |= {(device.name, "m"): pixels, (device.name, "px"): pixels}
    every = ((key, [names.index(n) for n in part if n in names]) for key, part in named.items())
    return {key: columns for key, columns in every if columns}
