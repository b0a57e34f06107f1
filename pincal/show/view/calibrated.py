"""A scene with what a calibration found: arrows of misses, and where instruments stand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pincal.calibration.promise import pose_misses
from pincal.calibration.result import CalibrationResult
from pincal.errors import MeasurementError
from pincal.model.setup import ORIGIN
from pincal.show.style import DIMENSION, IDENTIFIED, OUTLIER
from pincal.show.view.scene import Layer, Scene, rounded_down
from pincal.types import Array, Mask

_LONG, _LONGEST = 0.08, 0.5  # of the scene's size: a long arrow; where it is cut
_HEAD = 0.2  # of an arrow's length


def calibrated(scene: Scene, result: CalibrationResult) -> Scene:
    """Return a scene with what a calibration of its mechanism found.

    Arrows of rows that fit, and of outliers, magnified alike. Of a calibration that did not
    converge, the places of instruments alone.
    """
    layers = _arrow_layers(result, scene) if result.converged else []
    for number, (name, T) in enumerate(stations(result), 1):
        ends = T[:3, 3] + scene.body.axis * T[:3, :3].T
        axes = np.stack((np.broadcast_to(T[:3, 3], (3, 3)), ends), axis=1)
        shown = f"{name}, {np.linalg.norm(T[:3, 3]):.3g} m from the base frame"
        layers.append(Layer(f"stations/{number}", shown, axes, DIMENSION))
    return replace(scene, layers=(*scene.layers, *layers))


def _arrow_layers(result: CalibrationResult, scene: Scene) -> list[Layer]:
    """Return arrows, cut at a length, as three segments each, shafts first."""
    measured, shifts, outlying = misses_of(result)
    if not len(measured):
        return []
    size, lengths = scene.size, np.linalg.norm(shifts, axis=1)
    usual = lengths if outlying.all() else lengths[~outlying]
    magnify = rounded_down(_LONG * size / max(float(np.quantile(usual, 0.95)), 1e-12 * size))
    cut = magnify * lengths > _LONGEST * size
    lifted = 0.1 * size * scene.planar * np.eye(3)[2]  # over a platform that is seen from above
    begin = measured + lifted
    along = shifts * np.where(cut, _LONGEST * size / np.maximum(lengths, 1e-300), magnify)[:, None]
    upright = np.abs(along[:, [2]]) > 0.9 * np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along, np.where(upright, [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]))
    tips = begin + along
    ends = (begin, *(tips - _HEAD * (along + side * across) for side in (-0.5, 0.5)))
    layers = []
    for path, name, rows, colour in (
        ("misses", "measured → predicted", ~outlying, IDENTIFIED),
        ("outlying", "outliers", outlying, OUTLIER),
    ):
        if rows.any():
            lines = np.concatenate([np.stack((tips[rows], end[rows]), axis=1) for end in ends])
            text = f"{name}, errors × {magnify:,.12g}"
            text += f", {cut[rows].sum()} longer than drawn" if cut[rows].any() else ""
            layers.append(Layer(path, text, lines, colour))
    return layers


def misses_of(result: CalibrationResult) -> tuple[Array, Array, Mask]:
    """Return how rows miss what was measured of the platform's position, after the calibration.

    By the residuals of x, y and z, or of poses that were measured in full by what closes the legs.

    Returns:
        Points as measured, and predicted less measured, base frame, shape (n, 3), [m], of rows of
        which both are known; which of them are outliers.
    """
    calibration, platform, outside = result.calibration, result.nominal.platform, result.outside
    observed = {block.name: block for block in result.observed}
    axes = ("x", "y", "z")[: platform.space]
    measured, shifts = np.zeros((2, len(result.measurements), 3))
    if result.estimated_poses is not None and set(axes) <= set(observed):
        shifts[:, : len(axes)] = np.nan
        for axis, name in enumerate(axes):
            shifts[observed[name].rows, axis] = observed[name].residuals
        offset = np.array(result.options.setup.targets[ORIGIN].offset)
        if outside is not None:
            shifts, offset = shifts @ outside.frame[:3, :3], outside.offsets[0]
        matrices = platform.matrices(result.estimated_poses)
        measured = matrices[:, :3, 3] + matrices[:, :3, :3] @ offset - shifts
    else:
        twists, lengths = pose_misses(calibration, result.identified, outside), platform.lengths
        shifts[:, :lengths] = twists[:, [row < 3 for row in platform.twist_rows]]
        whole = np.asarray(np.isfinite(shifts).all(axis=1))
        if whole.any():
            measured[whole, :lengths] = calibration.rows(whole).given_poses(outside)[:, :lengths]
    rows = np.flatnonzero(np.isfinite(np.hstack((measured, shifts))).all(axis=1))
    outlying = np.isin(rows, [outlier.row for outlier in result.outliers])
    return measured[rows], shifts[rows], outlying


def stations(result: CalibrationResult) -> list[tuple[str, Array]]:
    """Return the tracker, or the frame of the measurements where it was unknown, and instruments.

    Those that say where they stand, by a method ``stand(values)`` that returns
    T_frame_instrument, shape (4, 4).

    Returns:
        Of each its name and ``T_base_station``, shape (4, 4), [m].

    Raises:
        MeasurementError: an instrument that stands at no rigid transform.
    """
    setup, outside = result.options.setup, result.outside
    T_base_frame = np.eye(4) if outside is None else np.asarray(np.linalg.inv(outside.frame))
    every: list[tuple[str, Array]] = []
    if setup.tracker is not None:
        T_frame_tracker = np.eye(4)
        T_frame_tracker[:3, 3] = setup.tracker.at
        every.append(("tracker", T_base_frame @ T_frame_tracker))
    elif setup.unknown_frame:
        every.append(("frame of the measurements", T_base_frame))
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
        every.append((device.name, T_base_frame @ T))
    return every
