"""Estimators on poses measured in full: each leg alone, or all legs together.

If the base stands at an unknown place in the tracker's frame, each leg's base point takes that
up: the legs are identified in the tracker's frame, aligned with the nominal machine, and the
frame is then moved so that the parameters are nearest to the nominal ones.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MeasurementError, ObservabilityError
from pincal.experiment.external import External
from pincal.experiment.observation import Observation
from pincal.identification.estimate import Estimate
from pincal.identification.gauge import Gauge, find_gauge
from pincal.identification.latent import LatentPoses
from pincal.identification.latent_fit import latent_problem
from pincal.identification.problem import MeasuredPoses
from pincal.identification.residuals import Residual
from pincal.identification.robust import Robust, robust_fit
from pincal.identification.task import Task
from pincal.identification.unknowns import Unknowns
from pincal.model.setup import ORIGIN

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
_ROUNDS = 20
_STANDS = 1e-10  # [m] and [rad]: the frame moves no more


def measured_fits(task: Task, *, together: bool, residual: Residual, every_pose: bool) -> Estimate:
    """Return the fits of all legs, one by one or together.

    Args:
        task: What is to be identified.
        together: Whether residuals of different legs at a pose share its noise.
        residual: What is minimised.
        every_pose: Whether every pose serves every leg, or those of its set.

    Raises:
        ObservabilityError: too few poses; parameters that are not determined.
        MeasurementError: poses or readings that are not whole; measurements that need latent
            poses.
    """
    _check_whole(task)
    used = _used(task, every_pose)
    unknowns = task.unknowns()
    groups = _groups(task, together)
    mechanism = task.mechanism
    if task.setup.plain:
        roots = task.noise.poses[:, :, None] * np.eye(mechanism.platform.dof)
        fits = _fit_groups(task, groups, unknowns, task.data.poses, roots, used, residual)
        return Estimate(fits)
    problem, external_unknowns = latent_problem(task)
    gauge = find_gauge(mechanism, problem, external_unknowns)
    n_external = len(problem.observation.external)
    if len(gauge.directions) != n_external or problem.first is None:
        raise ObservabilityError(
            f"the legs' parameters can take up {len(gauge.directions)} of the {n_external} "
            "unknowns outside the mechanism only; --method latent identifies the others with them"
        )
    external = problem.first.external
    for _ in range(_ROUNDS):
        poses, roots = _in_base_frame(task, problem.observation, external)
        fits = _fit_groups(task, groups, unknowns, poses, roots, used, residual)
        step = _toward_nominal(gauge, problem, external_unknowns, fits, external)
        if np.abs(step).max(initial=0.0) <= _STANDS:
            break
        external = problem.observation.external.moved(external, step)
    return Estimate(fits, problem.observation.external, external, gauge.words)


def _fit_groups(
    task: Task,
    groups: list[list[int]],
    unknowns: Unknowns,
    poses: Array,
    roots: Array,
    used: Mask,
    residual: Residual,
) -> list[Robust]:
    """Return a fit for each group of legs."""
    fits = []
    for group in groups:
        task.tell(f"identifying {', '.join(task.mechanism.leg_names[i] for i in group)}")
        rows = np.flatnonzero(used[:, group].any(axis=1))
        problem = MeasuredPoses(
            [task.residual(i, residual, rows) for i in group],
            poses[rows],
            used[rows][:, group],
            roots[rows],
            task.noise.readings[rows][:, group],
            weighted=residual == "closure",
        )
        names = [task.mechanism.leg_names[i] for i in group]
        fits.append(robust_fit(task, problem, unknowns.part(names), rows))
    return fits


def _groups(task: Task, together: bool) -> list[list[int]]:
    """Return the legs that are identified at once: those that share a tie, or all."""
    legs = task.mechanism.legs
    if together:
        return [list(range(len(legs)))]
    tied = [
        i for i, leg in enumerate(legs) if any(name in leg.parameter_names for name in task.tied)
    ]
    return ([tied] if tied else []) + [[i] for i in range(len(legs)) if i not in tied]


def _in_base_frame(task: Task, observation: Observation, external: External) -> tuple[Array, Array]:
    """Return poses in the base frame, shape (N, dof), and roots of their covariance."""
    platform, data = task.mechanism.platform, task.data
    F = external.frame[:3, :3]
    turns = observation.orientations if any(u == "rad" for u in platform.units) else None
    measured = np.zeros((len(data), 3))
    measured[:, : platform.space] = data.poses[:, : platform.space]
    matrices = np.tile(np.eye(4), (len(data), 1, 1))
    if turns is not None:
        matrices[:, :3, :3] = F.T @ turns @ external.turn.T
    arm = matrices[:, :3, :3] @ external.offsets[0]
    matrices[:, :3, 3] = (measured - external.frame[:3, 3]) @ F - arm
    by_measured = np.zeros((len(data), 6, 6))  # of the twist in base axes
    by_measured[:, :3, :3] = by_measured[:, 3:, 3:] = F.T
    by_measured[:, :3, 3:] = np.cross(arm[:, None], np.eye(3)).transpose(0, 2, 1) @ F.T
    rows = list(platform.twist_rows)
    roots = by_measured[:, rows][:, :, rows] * task.noise.poses[:, None, :]
    return platform.from_matrices(matrices), roots


def _toward_nominal(
    gauge: Gauge, problem: LatentPoses, unknowns: Unknowns, fits: list[Robust], external: External
) -> Array:
    """Return the step of the external unknowns that brings the parameters nearest to nominal."""
    n = problem.columns[-1].stop
    values = unknowns.start.copy()
    for one in fits:
        for leg, columns in zip(one.fit.problem.legs, one.fit.problem.columns, strict=True):
            place = [leg.name for leg in problem.legs].index(leg.name)
            values[problem.columns[place]] = one.fit.parameters[columns]
    outside = problem.observation.external
    values[n:] = outside.coordinates(external) - outside.coordinates(outside.start)
    off = np.linalg.lstsq(unknowns.map, values - unknowns.start, rcond=None)[0]
    along = gauge.constraints @ gauge.directions.T
    amounts = -np.linalg.solve(along, gauge.constraints @ off)
    return np.asarray((unknowns.map @ (gauge.directions.T @ amounts))[n:])


def _used(task: Task, every_pose: bool) -> Mask:
    """Return which poses serve which leg, shape (N, n_legs).

    Raises:
        ObservabilityError: too few poses for a leg.
    """
    data, mechanism = task.data, task.mechanism
    if every_pose:
        used = np.ones(data.readings.shape, dtype=bool)
    else:
        used = np.stack([data.serves(name) for name in mechanism.leg_names], axis=1)
    unknowns = task.unknowns()
    for leg, count in zip(mechanism.legs, used.sum(axis=0), strict=True):
        own = unknowns.part([leg.name])
        n = own.map.shape[1] - int(np.isfinite(own.priors).sum())
        least = n if task.noise.known else n + 1
        if count < least:
            why = "" if task.noise.known else " and the scale of the noise"
            raise ObservabilityError(
                f"{leg.name}: {count} measured poses for {n} parameters{why}; at least {least} are "
                f"needed, {2 * n} or more advised"
                + ("" if every_pose else ". --poses all uses every pose for every leg")
            )
    return used


def _check_whole(task: Task) -> None:
    """Raise if something was not measured.

    Raises:
        MeasurementError: a pose or reading that is not whole; further targets or distances.
    """
    data, platform = task.data, task.mechanism.platform
    if set(task.setup.targets) != {ORIGIN} or task.setup.distances:
        raise MeasurementError("further targets and distances need --method latent")
    for values, names in (
        (data.poses, platform.coordinates),
        (data.readings, task.mechanism.leg_names),
    ):
        if not (told := np.isfinite(values)).all():
            row, column = (int(i) for i in np.argwhere(~told)[0])
            raise MeasurementError(
                f"data row {row + 1}: {names[column]!r} is not measured; --method latent takes "
                "rows in which something is missing"
            )
