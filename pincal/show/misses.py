"""Errors of a calibration for charts, tables and answers, in SI units.

These are the residuals of rows, of cameras, and the platform's errors over the workspace.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pincal.calibration.promise import apart, errors_inside, measured_plan
from pincal.calibration.result import CalibrationResult
from pincal.calibration.result_parts import ResidualGroup
from pincal.design.platform_error import SAMPLES, PlatformError, root_mean_squares, seen_of, sizes
from pincal.errors import WorkspaceError
from pincal.estimation.unknowns import External
from pincal.instruments.camera import Camera
from pincal.instruments.lens import Lens
from pincal.kinematics.configurations import as_plan, legs_at
from pincal.kinematics.forward import forward
from pincal.model import Plan
from pincal.types import Array
from pincal.words.numbers import percent
from pincal.workspace.sampling import sample_configurations

_FEW_SAMPLES = 300  # sampled poses of the workspace
_MEASURED = "measured poses"
_MENTIONED = 0.01  # share of the workspace outside the measured region that is not mentioned


class CameraMisses(NamedTuple):
    """The n points that a camera saw in all photos, and their residuals."""

    camera: Camera
    points: NDArray[np.str_]
    """Names of points, shape (n,)."""
    seen: Array
    """Seen image points, right and down, shape (n, 2), [px]."""
    missed: Array
    """Predicted minus seen image points, shape (n, 2), [px]."""
    standardised: Array
    """Larger standardised residual of u and v, shape (n,); NaN where nothing checks the point."""
    metres: Array
    """Length of a pixel at the point, across the line of sight, shape (n,), [m/px]."""


def by_row(result: CalibrationResult, names: Sequence[str], values: str = "residuals") -> Array:
    """Return residuals, or standardised ones, of measured quantities by row, (N, k), else NaN."""
    every = np.full((len(result.measurements), len(names)), np.nan)
    for group in result.observed:
        if group.name in names:
            every[group.rows, names.index(group.name)] = getattr(group, values)
    return every


def camera_misses(result: CalibrationResult) -> list[CameraMisses]:
    """Return residuals by camera, for points of which both image coordinates were seen."""
    data, observation = result.measurements, result.calibration.observation
    matrices, every = result.nominal.platform.matrices(result.poses), list[CameraMisses]()
    metres = observation.metres_per_pixel(matrices, result.outside or External())
    for camera in (d for d in result.options.setup.instruments if isinstance(d, Camera)):
        parts = list[tuple[Array, ...]]()
        for point, pair in camera.marks.items():
            missed = by_row(result, pair)
            if not len(rows := np.flatnonzero(np.isfinite(missed).all(axis=1))):
                continue
            largest = np.fmax(*np.abs(by_row(result, pair, "standardised")[rows].T))
            seen = np.column_stack([data.extra[column] for column in pair])[rows]
            of_point = metres[rows, observation.names.index(pair[0])]
            parts.append((np.full(len(rows), point), seen, missed[rows], largest, of_point))
        if parts:
            every.append(CameraMisses(camera, *map(np.concatenate, zip(*parts, strict=True))))
    return every


def hand_eye_misses(result: CalibrationResult) -> dict[str, float]:
    """Return the RMS errors of hand–eye calibration at held-out photos, by unit (px, m).

    It takes the machine as drawn and the lenses as calibrated. The result is empty without OpenCV,
    or if no camera sees a board of known points.
    """
    data, missed = result.measurements, list[tuple[Array, Array]]()
    cameras = [d for d in result.options.setup.instruments if isinstance(d, Camera)]
    if not cameras:
        return {}
    poses = forward(result.nominal, data.readings, influences=result.calibration.influences).poses
    rows = np.isfinite(poses).all(axis=1)
    matrices = result.nominal.platform.matrices(poses[rows])
    for camera in cameras:
        values = dict(zip(camera.lens.names, camera.lens.values.tolist(), strict=True))
        values |= {p.name: p.identified for p in result.external if p.owner == camera.lens.name}
        fx, fy, cx, cy, *distortion = values.values()
        lens = Lens(camera.lens.size, (fx, fy), (cx, cy), tuple(distortion), camera.lens.fisheye)
        pixels = np.column_stack([data.extra[column][rows] for column in camera.columns])
        with suppress(ModuleNotFoundError):
            if misses := replace(camera, lens=lens).by_hand_eye(matrices, pixels):
                missed.append(misses)
    if not missed:
        return {}
    sizes = np.concatenate([np.reshape(pair, (2, -1, 2)) for pair in missed], axis=1)
    pixels, lengths = np.sqrt(np.nanmean((sizes**2).sum(axis=2), axis=1)).tolist()
    return {"m": lengths, "px": pixels}


def observed_groups(result: CalibrationResult) -> list[ResidualGroup]:
    """Return residuals of the platform's measured quantities; a camera's columns are one group."""
    cameras = [device for device in result.options.setup.instruments if isinstance(device, Camera)]
    owners = {column: camera.name for camera in cameras for column in camera.columns}
    groups = dict[str, ResidualGroup]()
    for group in result.observed:
        name = owners.get(group.name, group.name)
        if name in groups:
            former, arrays = vars(groups[name]), vars(group)
            keys = [key for key, value in former.items() if isinstance(value, np.ndarray)]
            joined: dict[str, Any] = {k: np.append(former[k], arrays[k]) for k in keys}
            group = replace(groups[name], **joined)
        groups[name] = replace(group, name=name)
    return [*groups.values()]


def noisy_residuals(result: CalibrationResult) -> list[ResidualGroup]:
    """Return residuals that carry noise: of the platform if readings are exact, else of the legs.

    Both are returned if readings have noise, since they share the misfit with the platform.
    """
    if readings_exact(result):
        return observed_groups(result)
    shared = any(leg.quantity == "reading" for leg in result.legs) or result.options.setup.pixels
    return [*result.legs, *(observed_groups(result) if shared else ())]


def readings_exact(result: CalibrationResult) -> bool:
    """Return whether legs close by construction, so that only the platform has residuals."""
    return bool(result.observed) and not any((leg.sigma > 0.0).any() for leg in result.legs)


@dataclass(frozen=True)
class WorkspaceErrors:
    """Errors of the platform at N poses; NaN where a mechanism does not reach a pose."""

    poses: Array
    """Coordinates of the poses, shape (N, dof)."""
    before: Array
    """Errors of the nominal model in position [m] and orientation [rad], shape (N, 2), with the
    identified zeros of motors and with best-fit frames where frames are unknown."""
    expected: PlatformError
    """Expected errors of the identified model at the same poses."""
    inside: PlatformError
    """Expected errors at the poses in the measured region (see ``expected_error``)."""
    region: str = "the workspace"
    """Name of the region that the poses sample, for sentences."""

    @cached_property
    def share(self) -> float:
        """Share of the reachable poses that lie in the measured region."""
        return float(self.expected.within.sum()) / max(self.expected.poses, 1)

    @property
    def where(self) -> str:
        """Region over which means are taken, for sentences: ``over 80 % of the workspace``."""
        if self.share > 1.0 - _MENTIONED:
            return f"over {self.region}"
        return f"over {percent(self.share)} of {self.region}"

    def mean_before(self) -> tuple[float, float]:
        """Return the nominal model's RMS errors in the measured region, [m] and [rad]."""
        return root_mean_squares(self.before[self.expected.within])

    def mean_after(self) -> tuple[float, float]:
        """Return the expected RMS errors in the measured region, [m] and [rad]."""
        return root_mean_squares(self.inside.sizes)

    @property
    def determined(self) -> bool:
        """Whether the measurements determine the error of the calibrated platform at any pose."""
        return bool(self.expected.determined.any() and np.isfinite(self.mean_after()).all())

    @property
    def moved(self) -> bool:
        """Whether the identified parameters move the platform at all."""
        return any((*self.mean_before(), *self.mean_after()))


def workspace_errors(result: CalibrationResult, poses: Plan | None = None) -> WorkspaceErrors:
    """Return the platform's errors at poses, by default at samples of the workspace.

    Without a workspace, or samples in the measured region, the measured configurations are taken.
    """
    if poses is not None:
        return errors_at(result, poses, "the poses given")
    with suppress(WorkspaceError):
        sampled = errors_at(result, sample_configurations(result.nominal, SAMPLES))
        if sampled.expected.within.any():
            return sampled
    return errors_at(result, measured_plan(result), _MEASURED)


def errors_at(
    result: CalibrationResult, planned: Plan | Array, region: str = "the workspace"
) -> WorkspaceErrors:
    """Return the platform's errors at a plan, or at poses of shape (N, dof)."""
    plan = as_plan(result.nominal, planned)
    expected, inside = errors_inside(result, plan)
    moved, units = apart(result, plan, result.begun, result.identified)
    return WorkspaceErrors(plan.poses, sizes(units, moved), expected, inside, region)


def effects(result: CalibrationResult) -> tuple[dict[str, float], str]:
    """Return by how much the change of each determined parameter moves the platform, and the unit.

    The values are RMS displacements of position (of orientation, for platforms without position)
    over the workspace, or over the measured poses if no workspace was found.
    """
    try:
        plan = sample_configurations(result.nominal, _FEW_SAMPLES)
    except WorkspaceError:
        plan = measured_plan(result)
    legs = legs_at(result.identified, plan)
    moved, units = seen_of(result.identified, legs.poses, legs.gain, result.frames_moved)
    part = moved[:, [unit == units[0] for unit in units]]
    per_unit = np.sqrt(np.square(part).sum(axis=1).mean(axis=0))  # shape (n_params,)
    parameters = [p for leg in result.legs for p in leg.parameters]
    return {
        p.id: factor * abs(p.change)
        for p, factor in zip(parameters, per_unit.tolist(), strict=True)
        if 0.0 < p.std < np.inf
    }, units[0]
