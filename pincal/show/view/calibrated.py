"""A scene with what a calibration found: how it is worked out from the result."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pincal.calibration.promise import pose_misses
from pincal.calibration.result import CalibrationResult
from pincal.errors import MeasurementError, PincalError
from pincal.model.setup import ORIGIN
from pincal.show.result_tables import directions, parameters
from pincal.show.view.scene import (
    Errors,
    Instrument,
    Misses,
    Overlay,
    Scene,
    Station,
    Weakest,
    driven,
    rounded_down,
)
from pincal.show.workspace_answers import WorkspaceErrors, workspace_errors
from pincal.types import Array, Mask

#: Of the scene's size: a long arrow, and how far a parameter moves along the weakest direction.
_ARROW, _SWING = 0.08, 0.08
_NAMED = 3
_SHARES = (1.0, 0.3, 0.1, 0.03)  # of that motion, until the machine can be built
_DRAWN = 0.5  # of the poses, at least


def calibrated(
    scene: Scene, result: CalibrationResult, errors: WorkspaceErrors | None = None
) -> Scene:
    """Return a scene with what a calibration of its mechanism found.

    Args:
        scene: The mechanism at poses.
        result: Its calibration; of one that did not converge, the places of instruments alone.
        errors: Over the workspace, computed if not given.
    """
    if not result.converged:
        placed = Overlay(instrument=instrument(result), stations=stations(result))
        return replace(scene, overlay=placed)
    size = float(np.linalg.norm(np.ptp(scene.bounds(), axis=0)))
    overlay = Overlay(
        misses(result, size),
        _errors(result, workspace_errors(result) if errors is None else errors),
        weakest(scene, result, size),
        instrument(result),
        stations(result),
    )
    return replace(scene, overlay=overlay)


def misses(result: CalibrationResult, size: float) -> Misses | None:
    """Return how rows miss what was measured of the platform's position; None if nothing was.

    Args:
        result: The calibration.
        size: Of what is drawn, [m].
    """
    measured, shifts = _measured(result)
    rows = np.flatnonzero(np.isfinite(np.hstack((measured, shifts))).all(axis=1))
    if not len(rows):
        return None
    bad = {outlier.row for outlier in result.outliers}
    outlying = np.array([row in bad for row in rows.tolist()])
    lengths = np.linalg.norm(shifts[rows], axis=1)
    usual = lengths if outlying.all() else lengths[~outlying]
    long = max(float(np.quantile(usual, 0.95)), 1e-12 * size)
    return Misses(measured[rows], shifts[rows], outlying, rounded_down(_ARROW * size / long))


def _measured(result: CalibrationResult) -> tuple[Array, Array]:
    """Return measured points and predicted less measured, shape (N, 3), [m]; NaN if unknown.

    Of poses that were measured in full, by what closes the legs there; of other rows by the
    residuals of x, y and z.
    """
    calibration, platform = result.calibration, result.nominal.platform
    twists = pose_misses(calibration, result.identified, result.outside)
    poses, lengths = np.full(twists.shape, np.nan), platform.lengths
    complete: Mask = np.asarray(np.isfinite(result.measurements.poses).all(axis=1))
    if complete.any():
        poses[complete] = calibration.rows(complete).given_poses(result.outside)[0]
    measured, shifts = np.zeros((2, len(poses), 3))
    measured[:, :lengths] = poses[:, :lengths]
    shifts[:, :lengths] = twists[:, [row < 3 for row in platform.twist_rows]]
    observed = {block.name: block for block in result.observed}
    axes = ("x", "y", "z")[: platform.space]
    if result.estimated_poses is None or not set(axes) <= set(observed):
        return measured, shifts
    differences = np.full((len(poses), 3), np.nan)
    differences[:, platform.space :] = 0.0
    for axis, name in enumerate(axes):
        differences[observed[name].rows, axis] = observed[name].residuals
    offset = np.array(result.options.setup.targets[ORIGIN].offset)
    if result.outside is not None:
        differences, offset = differences @ result.outside.frame[:3, :3], result.outside.offsets[0]
    matrices = platform.matrices(result.estimated_poses)
    points = matrices[:, :3, 3] + matrices[:, :3, :3] @ offset
    missing = ~np.isfinite(shifts).all(axis=1)
    measured[missing], shifts[missing] = (points - differences)[missing], differences[missing]
    return measured, shifts


def _errors(result: CalibrationResult, errors: WorkspaceErrors) -> Errors | None:
    """Return errors of position over the workspace; None where none can be promised."""
    before, after = errors.before[:, 0], errors.after[:, 0]
    rows = np.isfinite(before) & np.isfinite(after)
    if not result.explained or not (rows & (np.fmax(before, after) > 0.0)).any():
        return None
    positions = result.nominal.platform.matrices(errors.poses[rows])[:, :3, 3]
    return Errors(positions, before[rows], after[rows])


def weakest(scene: Scene, result: CalibrationResult, size: float) -> Weakest | None:
    """Return the machine off along its weakest direction.

    None where nothing was identified, or where it cannot be built at half of the poses.

    Args:
        scene: The mechanism at poses.
        result: The calibration.
        size: Of what is drawn, [m].
    """
    ranked = directions(result)
    if not len(ranked.values):
        return None
    every = {p.id: p for _, p in parameters(result)}
    weakest = ranked.vectors[:, -1] / ranked.values[-1]
    step = dict(zip(ranked.ids, (weakest * ranked.units).tolist(), strict=True))
    largest = max(abs(v) * (size if every[i].unit == "rad" else 1.0) for i, v in step.items())
    moved = {
        leg.name: [p.nominal + step.get(p.id, 0.0) for p in leg.parameters] for leg in result.legs
    }
    shifted = scene.mechanism.with_parameters(
        {leg: np.array(values) for leg, values in moved.items()}
    )
    order = np.argsort(-np.abs(weakest), kind="stable")
    names = [ranked.ids[i] for i in order[:_NAMED]]
    for share in _SHARES:  # where a machine that far off cannot be built, nearer
        magnify = rounded_down(share * _SWING * size / max(largest, 1e-300))
        try:
            body = driven(scene, shifted, magnify).body
        except PincalError:
            continue
        if np.isfinite(body.placements).all(axis=(1, 2, 3)).mean() >= _DRAWN:
            return Weakest(body, magnify, ", ".join(names))
    return None


def instrument(result: CalibrationResult) -> Instrument | None:
    """Return where the tracker stands; None if its place is not known."""
    tracker = result.options.setup.tracker
    if tracker is None:
        return None
    T_base_frame = _base_frame(result)
    position = T_base_frame[:3, :3] @ np.array(tracker.at) + T_base_frame[:3, 3]
    return Instrument(position, T_base_frame)


def stations(result: CalibrationResult) -> tuple[Station, ...]:
    """Return the frame of the measurements, where it was unknown, and instruments of one's own.

    Those that say where they stand, by a method ``stand(values)`` that returns
    T_frame_instrument, shape (4, 4); what a camera sees, by an attribute ``sees``.

    Raises:
        MeasurementError: an instrument that stands at no rigid transform.
    """
    setup, T_base_frame, placed_stations = result.options.setup, _base_frame(result), []
    if setup.unknown_frame and setup.tracker is None:
        placed_stations.append(Station("frame of the measurements", T_base_frame))
    for device in setup.instruments:
        if (stand := getattr(device, "stand", None)) is None:
            continue
        values = np.array([result[parameter.id].identified for parameter in device.parameters])
        T = np.asarray(stand(values), dtype=np.float64)
        R = T[:3, :3]
        if T.shape != (4, 4) or not np.allclose(R @ R.T, np.eye(3), atol=1e-6):
            raise MeasurementError(
                f"instrument {device.name!r} stands at an array of shape {T.shape}; expected "
                "T_frame_instrument, a rigid transform of shape (4, 4)"
            )
        placed_stations.append(
            Station(device.name, T_base_frame @ T, getattr(device, "sees", None))
        )
    return tuple(placed_stations)


def _base_frame(result: CalibrationResult) -> Array:
    """Return the frame of the measurements in the base frame, shape (4, 4)."""
    if result.outside is None:
        return np.eye(4)
    return np.asarray(np.linalg.inv(result.outside.frame), dtype=np.float64)
