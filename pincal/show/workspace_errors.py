"""How far the platform is off over the workspace: with nominal parameters, and as expected now.

The nominal model drives the identified mechanism: what the calibration removes. What is left
follows from the covariance of the parameters, pose by pose. Where frames were fixed by choice,
motions of the base and platform frame are left out of both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pincal.calibration.result import CalibrationResult
from pincal.design.platform_error import slides
from pincal.design.simulate import platform_errors
from pincal.errors import WorkspaceError
from pincal.estimation.frames import frame_motions, unexplained
from pincal.kinematics.closure import largest_size
from pincal.kinematics.configurations import as_plan, legs_at
from pincal.model.measurements import Plan
from pincal.workspace.sampling import sample_configurations

Array = NDArray[np.float64]
_SAMPLED = 1000
_CONFIDENCE = 0.95
_DRAWS = 10_000


@dataclass(frozen=True)
class WorkspaceErrors:
    """Errors of the platform at poses; NaN where a mechanism does not reach one."""

    poses: Array
    """Coordinates, shape (N, dof)."""
    before: Array
    """Of the nominal model, position [m] and orientation [rad], shape (N, 2)."""
    after: Array
    """Standard errors to expect of the identified one, shape (N, 2)."""
    sampled: bool = True
    """Whether poses are of the workspace, or those of the measurements."""
    untold: NDArray[np.bool_] | None = None
    """Where what was held moves the platform (see ``calibrate``), shape (N,), if it was."""
    limit: tuple[float, float] = (np.nan, np.nan)
    """Below which the identified one's root mean square error is in 95 of 100 calibrations like
    this one, [m] and [rad]."""

    @property
    def where(self) -> str:
        """Over which poses means are taken, in words."""
        if not self.sampled:
            return "over the measured poses"
        told = self._told
        if told.all():
            return "over the workspace"
        return f"over the {told.sum()} of {len(told)} configurations that the measurements tell"

    @property
    def _told(self) -> NDArray[np.bool_]:
        """Configurations that count: where the measurements tell all, shape (N,)."""
        return ~self.untold if self.untold is not None else np.ones(len(self.poses), dtype=bool)

    def mean_before(self) -> tuple[float, float]:
        """Return root mean squares of the nominal model's errors, [m] and [rad]."""
        return _rms(self.before[self._told])

    def mean_after(self) -> tuple[float, float]:
        """Return root mean squares of the errors to expect, [m] and [rad]."""
        return _rms(self.after[self._told])


def workspace_errors(result: CalibrationResult, measured: Plan) -> WorkspaceErrors:
    """Return the platform's errors at samples of the workspace.

    Args:
        result: The calibration.
        measured: Measured configurations: taken if no workspace is found with the default margins.
    """
    try:
        found = errors_at(result, sample_configurations(result.nominal, _SAMPLED))
        if found.untold is None or not found.untold.all():
            return found
    except WorkspaceError:
        pass
    return replace(errors_at(result, measured), sampled=False, untold=None)


def errors_at(result: CalibrationResult, planned: Plan | Array) -> WorkspaceErrors:
    """Return the platform's errors at planned poses, coordinates of shape (N, dof), or a plan."""
    platform, plan = result.nominal.platform, as_plan(result.nominal, planned)
    moved = platform_errors(result.nominal, result.identified, plan)
    legs = legs_at(result.identified, plan)
    reached, gain = legs.reached, legs.gain
    both = np.asarray(reached & np.isfinite(moved).all(axis=1))
    if result.frames_moved is not None and result.frames_moved.shape[1] and both.any():
        size = largest_size(result.nominal.legs, platform)
        matrices = platform.transforms(legs.poses).as_matrix()
        motions = frame_motions(platform, matrices) @ result.frames_moved
        own = motions[both[reached]]
        moved[both] = unexplained(platform, moved[both, :, None], own, size)[:, :, 0]
        gain = unexplained(platform, gain, motions, size)
    variance = np.full(moved.shape, np.nan)
    variance[reached] = np.einsum("nip,pq,niq->ni", gain, result.covariance, gain)
    untold, lost = None, result.undetermined_directions
    if lost is not None:
        least = np.sqrt(np.median(variance[reached], axis=0)) if reached.any() else variance[0]
        untold = np.asarray(slides(result.nominal, plan, lost, least).any(axis=1))
        variance[untold] = np.nan
    before, after = _sizes(result, moved**2), _sizes(result, variance)
    told = np.isfinite(variance).all(axis=1)[reached]
    return WorkspaceErrors(
        plan.poses, before, after, untold=untold, limit=_limits(result, gain[told])
    )


def _limits(result: CalibrationResult, gain: Array) -> tuple[float, float]:
    """Return the 95 % quantiles of the root mean square errors of position and orientation.

    With parameter errors δ of covariance C, the mean square δᵀ M δ is a sum of squares of normal
    numbers, weighted by the eigenvalues of MC: drawn, with the scale of the noise if that was
    estimated.

    Args:
        result: The calibration.
        gain: What parameters do to the platform, shape (N, dof, n).
    """
    turns = np.array([unit == "rad" for unit in result.nominal.platform.units])
    rng = np.random.default_rng(0)
    values, axes = np.linalg.eigh(result.covariance)
    root = axes * np.sqrt(values.clip(0.0))
    squares = rng.standard_normal((_DRAWS, len(values))) ** 2
    if result.noise_source == "estimated":
        dof = max(result.degrees_of_freedom, 1)
        squares *= dof / rng.chisquare(dof, (_DRAWS, 1))
    limits = []
    for own in (~turns, turns):
        G = gain[:, own].reshape(-1, gain.shape[2]) @ root
        weights = np.linalg.eigvalsh(G.T @ G).clip(0.0) / max(len(gain), 1)
        limits.append(float(np.sqrt(np.quantile(squares @ weights, _CONFIDENCE))))
    return limits[0], limits[1]


def _sizes(result: CalibrationResult, squares: Array) -> Array:
    """Return roots of sums over positions and over orientations, shape (N, 2)."""
    turns = np.array([unit == "rad" for unit in result.nominal.platform.units])
    parts = (squares[:, ~turns].sum(axis=1), squares[:, turns].sum(axis=1))
    return np.sqrt(np.stack(parts, axis=1).clip(0.0))


def _rms(sizes: Array) -> tuple[float, float]:
    told = sizes[np.isfinite(sizes).all(axis=1)]
    if not len(told):
        return np.nan, np.nan
    position, orientation = np.sqrt((told**2).mean(axis=0)).tolist()
    return position, orientation
