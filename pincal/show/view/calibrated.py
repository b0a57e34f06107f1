"""A scene with what a calibration found: arrows of misses, and where instruments stand."""

from __future__ import annotations

from dataclasses import dataclass, replace

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
_DEPTH = 0.3  # of what a camera sees, of the scene's size


@dataclass(frozen=True, eq=False)
class Misses:
    """From the measured to the predicted point of each row, after the calibration."""

    measured: Array
    """Of the platform, shape (n, 3), base frame, [m]."""
    shifts: Array
    """Predicted less measured, shape (n, 3), [m]."""
    outlying: Mask
    """Which rows are outliers, shape (n,)."""


@dataclass(frozen=True, eq=False)
class Station:
    """A tracker, a frame of measurements, or an instrument that says where it stands."""

    name: str
    T_base_station: Array
    """Shape (4, 4), [m]; a camera looks along z."""
    sees: tuple[float, float] | None = None
    """Half width and half height of what a camera sees at a distance of 1; None if it is none."""


def calibrated(scene: Scene, result: CalibrationResult) -> Scene:
    """Return a scene with what a calibration of its mechanism found.

    Of one that did not converge, the places of instruments alone.
    """
    size, layers = scene.size, []
    misses = misses_of(result) if result.converged else None
    if misses is not None:
        layers += _arrow_layers(misses, size, 0.1 * size if scene.planar else 0.0)
    for number, station in enumerate(stations(result), 1):
        T = station.T_base_station
        ends = scene.body.axis * np.stack((np.zeros((3, 3)), np.eye(3)), axis=1)
        if station.sees:
            ends = np.concatenate((ends, frustum(station.sees, _DEPTH * size)))
        name = f"{station.name}, {np.linalg.norm(T[:3, 3]):.3g} m from the base frame"
        lines = ends @ T[:3, :3].T + T[:3, 3]
        layers.append(Layer(f"stations/{number}", name, lines, DIMENSION))
    return replace(scene, layers=(*scene.layers, *layers))


def _arrow_layers(misses: Misses, size: float, lift: float) -> list[Layer]:
    """Return arrows of rows that fit, and of outliers, magnified alike.

    Args:
        misses: From where to where.
        size: Of the scene, [m].
        lift: Over the platform, where that is seen from above, [m].
    """
    lengths = np.linalg.norm(misses.shifts, axis=1)
    usual = lengths if misses.outlying.all() else lengths[~misses.outlying]
    magnify = rounded_down(_LONG * size / max(float(np.quantile(usual, 0.95)), 1e-12 * size))
    layers = []
    for path, name, rows, colour in (
        ("misses", "measured → predicted", ~misses.outlying, IDENTIFIED),
        ("outlying", "outliers", misses.outlying, OUTLIER),
    ):
        if not rows.any():
            continue
        lines = arrows(misses.measured[rows], magnify * misses.shifts[rows], _LONGEST * size)
        lines[..., 2] += lift
        shortened = int((magnify * lengths[rows] > _LONGEST * size).sum())
        text = f"{name}, errors × {magnify:,.12g}"
        text += f", {shortened} longer than drawn" if shortened else ""
        layers.append(Layer(path, text, lines, colour))
    return layers


def arrows(begin: Array, shifts: Array, longest: float) -> Array:
    """Return arrows as three segments each, shafts first, shape (3n, 2, 3), [m].

    Args:
        begin: Where they begin, shape (n, 3).
        shifts: From there to their tips, shape (n, 3).
        longest: Length at which they are cut.
    """
    lengths = np.linalg.norm(shifts, axis=1, keepdims=True)
    drawn = shifts * np.minimum(1.0, longest / np.maximum(lengths, 1e-300))
    tips = begin + drawn
    upright = np.abs(drawn[:, [2]]) > 0.9 * np.linalg.norm(drawn, axis=1, keepdims=True)
    across = np.cross(drawn, np.where(upright, [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]))
    heads = [tips - _HEAD * drawn + side * _HEAD * across for side in (-0.5, 0.5)]
    return np.concatenate([np.stack((tips, end), axis=1) for end in (begin, *heads)])


def misses_of(result: CalibrationResult) -> Misses | None:
    """Return how rows miss what was measured of the platform's position; None if nothing was."""
    measured, shifts = _measured(result)
    rows = np.flatnonzero(np.isfinite(np.hstack((measured, shifts))).all(axis=1))
    if not len(rows):
        return None
    outlying = np.isin(rows, [outlier.row for outlier in result.outliers])
    return Misses(measured[rows], shifts[rows], outlying)


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
        poses[complete] = calibration.rows(complete).given_poses(result.outside)
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


def stations(result: CalibrationResult) -> tuple[Station, ...]:
    """Return the tracker, or the frame of the measurements where it was unknown, and instruments.

    Those that say where they stand, by a method ``stand(values)`` that returns
    T_frame_instrument, shape (4, 4); what a camera sees, by an attribute ``sees``.

    Raises:
        MeasurementError: an instrument that stands at no rigid transform.
    """
    setup, placed_stations = result.options.setup, []
    T_base_frame: Array = np.eye(4)
    if result.outside is not None:
        T_base_frame = np.asarray(np.linalg.inv(result.outside.frame), dtype=np.float64)
    if setup.tracker is not None:
        T = T_base_frame.copy()
        T[:3, 3] += T[:3, :3] @ np.array(setup.tracker.at)
        placed_stations.append(Station("tracker", T))
    elif setup.unknown_frame:
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


def frustum(sees: tuple[float, float], depth: float) -> Array:
    """Return what a camera sees up to a depth, as segments in its frame, shape (9, 2, 3), [m].

    Four edges from where it stands, the rectangle of its picture there, and a mark on the side
    of the picture's top, which is towards −y.

    Args:
        sees: Half width and half height of that rectangle at a depth of 1.
        depth: [m].
    """
    x, y = sees
    corners = depth * np.array([[-x, -y, 1.0], [x, -y, 1.0], [x, y, 1.0], [-x, y, 1.0]])
    edges = [(np.zeros(3), corner) for corner in corners]
    edges += [(corners[i], corners[i - 1]) for i in range(4)]
    edges.append((depth * np.array([0.0, -y, 1.0]), depth * np.array([0.0, -1.4 * y, 1.0])))
    return np.array(edges)
