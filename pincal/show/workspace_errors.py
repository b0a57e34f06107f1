"""Errors of the platform over a workspace, before and after a calibration, in SI units."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pincal.calibration.promise import measured_plan, seen_by
from pincal.calibration.result import CalibrationResult
from pincal.design.platform_error import PlatformError, root_mean_squares, seen_of, sizes
from pincal.design.simulate import platform_errors
from pincal.errors import MeasurementError, WorkspaceError
from pincal.finding import Finding
from pincal.kinematics.configurations import as_plan
from pincal.model.measurements import Plan
from pincal.model.mechanism import Mechanism
from pincal.types import Array
from pincal.words.numbers import percent
from pincal.words.sentences import finding
from pincal.workspace.criteria import in_workspace
from pincal.workspace.sampling import sample_configurations

_ACROSS = {2: 45, 3: 25}  # cells of a map by the dimension of space
_MENTIONED = 0.01  # share of the workspace outside the measured region, below which it is not said


@dataclass(frozen=True)
class WorkspaceErrors:
    """Errors of the platform at poses; NaN where a mechanism does not reach one."""

    poses: Array
    """Coordinates, shape (N, dof)."""
    before: Array
    """Of the nominal model, zeros of motors as they were found, position [m] and orientation [rad],
    shape (N, 2)."""
    expected: PlatformError
    """Of the identified one, at the same poses."""
    inside: PlatformError
    """Of those poses that lie in the measured region (see ``expected_error``)."""
    sampled: bool = True
    """Whether poses are of the workspace, or those of the measurements."""

    @property
    def after(self) -> Array:
        """Standard errors to expect of the identified mechanism, shape (N, 2), [m] and [rad]."""
        return np.where(np.isfinite(self.expected.sizes), self.expected.sizes, np.nan)

    @property
    def limit(self) -> tuple[float, float]:
        """Below which ``mean_after`` is in 95 of 100 such calibrations, [m] and [rad]."""
        return self.inside.limit

    @cached_property
    def share(self) -> float:
        """Share of the poses that are reached which lies in the measured region."""
        return float(self.expected.within.sum()) / max(self.expected.poses, 1)

    @property
    def units(self) -> dict[str, str]:
        """SI units of the platform's errors by their names."""
        every = {"position": "m", "orientation": "rad"}
        return {name: unit for name, unit in every.items() if unit in self.expected.units}

    @property
    def where(self) -> str:
        """Over which poses means are taken, for sentences."""
        if not self.sampled:
            return "over the measured poses"
        if self.share == 1.0:
            return "over the workspace"
        return f"over the measured region, {percent(self.share)} of the workspace"

    def mean_before(self) -> tuple[float, float]:
        """Return root mean squares of the nominal model's errors, [m] and [rad]."""
        return root_mean_squares(self.before[self.expected.within])

    def mean_after(self) -> tuple[float, float]:
        """Return root mean squares of the errors to expect, [m] and [rad]."""
        return self.inside.where_determined

    @property
    def beyond(self) -> Finding | None:
        """What is to be expected outside the measured region; None if little lies there."""
        outside = np.isinf(self.expected.outside) | (self.expected.outside > 1.0)
        if not self.sampled or outside.mean() < _MENTIONED:
            return None
        sizes = self.expected.sizes[outside]
        position, orientation = root_mean_squares(sizes)
        return finding(
            "beyond-measured",
            share=1.0 - self.share,
            position=position,
            orientation=orientation if "rad" in self.expected.units else None,
            undetermined=float(np.isinf(sizes).any(axis=1).mean()),
        )


@dataclass(frozen=True)
class ErrorMaps:
    """Errors over x and y, the other coordinates as at home; NaN outside of the workspace."""

    x: Array
    """Shape (n,), [m]."""
    y: Array
    """Shape (n,), [m]."""
    height: float | None
    """z in the middle of the workspace, [m]; None in a plane."""
    before: Array
    """Position [m] and orientation [rad] of the nominal model, shape (n, n, 2)."""
    after: Array
    """To expect of the identified one, of the same shape."""


def error_maps(result: CalibrationResult, errors: WorkspaceErrors | None = None) -> ErrorMaps:
    """Return errors over the workspace.

    Args:
        result: The calibration.
        errors: Those at samples of the workspace, computed if not given.

    Raises:
        MeasurementError: residuals are so large that no accuracy can be promised.
        WorkspaceError: none was found, or it fills no plane.
    """
    nominal, platform = result.nominal, result.nominal.platform
    if not result.explained:
        raise MeasurementError(
            "no maps: no accuracy can be promised, since residuals are far larger than the noise"
        )
    if nominal.by_readings:
        raise WorkspaceError("no maps: its poses follow from readings, and do not fill a plane")
    errors = errors or workspace_errors(result)
    height = float(np.median(errors.poses[:, 2])) if platform.space == 3 else None
    x, y, poses = bed(nominal, errors.poses, _ACROSS[platform.space], height)
    inside = in_workspace(nominal, poses)
    if not (errors.sampled and inside.any()):
        raise WorkspaceError("no maps: no workspace was found with the default margins")
    errors_inside = errors_at(result, poses[inside])
    maps = np.full((2, len(poses), 2), np.nan)
    maps[:, inside] = errors_inside.before, errors_inside.after
    before, after = maps.reshape(2, len(y), len(x), 2)
    return ErrorMaps(x, y, height, before, after)


def bed(
    mechanism: Mechanism, samples: Array, count: int, height: float | None = None
) -> tuple[Array, Array, Array]:
    """Return a grid over the x and y of samples, at a height: x, y, and poses, (n_y · n_x, dof).

    The other coordinates are as at home.
    """
    low, high = samples.min(axis=0), samples.max(axis=0)
    x, y = (np.linspace(low[i], high[i], count) for i in (0, 1))
    home = np.array(mechanism.platform.home)
    poses = np.tile(home, (count, count, 1))
    poses[..., 0], poses[..., 1] = x, y[:, None]
    if height is not None:
        poses[..., 2] = height
    return x, y, poses.reshape(-1, len(home))


def workspace_errors(result: CalibrationResult) -> WorkspaceErrors:
    """Return the platform's errors at samples of the workspace.

    At the measured configurations if no workspace is found with the default margins, or no sample
    lies in the measured region.
    """
    try:
        sampled = errors_at(result, sample_configurations(result.nominal, 1000))
        if sampled.expected.within.any():
            return sampled
    except WorkspaceError:
        pass
    return errors_at(result, measured_plan(result), sampled=False)


def errors_at(
    result: CalibrationResult, planned: Plan | Array, *, sampled: bool = True
) -> WorkspaceErrors:
    """Return the platform's errors at planned poses, coordinates of shape (N, dof), or a plan."""
    plan = as_plan(result.nominal, planned)
    expected = result.expected_error(plan)
    before = sizes(expected.units, moved_apart(result, result.begun, plan))
    within = expected.within
    inside = expected
    if not within.all():  # frames are those of other poses, the region is the same
        inside = replace(result.expected_error(plan.rows(within)), outside=expected.outside[within])
    return WorkspaceErrors(plan.poses, before, expected, inside, sampled)


def moved_apart(result: CalibrationResult, machine: Mechanism, plan: Plan) -> Array:
    """Return where the identified machine goes less where another sends it, shape (N, r).

    What is seen of it, as in ``expected_error``, frames apart; NaN out of reach.
    """
    moved = platform_errors(machine, result.identified, plan)
    reached = np.isfinite(moved).all(axis=1)
    seen, units = seen_of(
        result.identified, plan.poses[reached], moved[reached, :, None], seen_by(result)
    )
    apart = np.full((len(moved), len(units)), np.nan)
    apart[reached] = seen[:, :, 0]
    return apart
