"""Estimators on poses measured in full: each leg alone, or all legs together.

If the base stands at an unknown place in the tracker's frame, each leg's base point takes that
up: the legs are identified in the tracker's frame, aligned with the nominal machine, and the
frame is then moved so that the parameters are nearest to the nominal ones.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MeasurementError, ObservabilityError
from pincal.estimation.external import External
from pincal.estimation.observation import Observation
from pincal.identification.estimate import Estimate
from pincal.identification.gauge import Gauge, find_gauge
from pincal.identification.latent import LatentPoses
from pincal.identification.latent_fit import latent_problem
from pincal.identification.problem import MeasuredPoses
from pincal.identification.robust import Robust, robust_fit
from pincal.identification.task import Task
from pincal.identification.unknowns import Unknowns
from pincal.model.setup import ORIGIN

Array = NDArray[np.float64]
_ROUNDS = 20
_STANDS = 1e-10  # [m] and [rad]: the frame moves no more


def measured_fits(task: Task) -> Estimate:
    """Return the fits of all legs, one by one or together.

    Args:
        task: What is to be identified.

    Raises:
        ObservabilityError: too few poses; parameters that are not determined.
        MeasurementError: poses or readings that are not whole; measurements that need latent
            poses.
    """
    _check_whole(task)
    _check_counts(task)
    unknowns = task.unknowns()
    groups = _groups(task)
    mechanism = task.mechanism
    if task.setup.plain:
        return Estimate(_fit_groups(task, groups, unknowns, *given_poses(task, None, None)))
    problem, external_unknowns = latent_problem(task)
    gauge = find_gauge(mechanism, problem, external_unknowns)
    n_external = len(problem.observation.external)
    if len(gauge.directions) != n_external or problem.first is None:
        raise ObservabilityError(
            f"the legs' parameters can take up {len(gauge.directions)} of the {n_external} "
            "unknowns outside the mechanism only; --method latent identifies the others with them"
        )
    external = first = problem.first.external
    for _ in range(_ROUNDS):
        poses = given_poses(task, problem.observation, external)
        fits = _fit_groups(task, groups, unknowns, *poses)
        step = _toward_nominal(gauge, problem, external_unknowns, fits, external, first)
        if np.abs(step).max(initial=0.0) <= _STANDS:
            break
        external = problem.observation.external.moved(external, step)
    else:
        raise MeasurementError(
            "the frames of the measurements were not found by aligning leg after leg; --method "
            "latent finds them with the parameters"
        )
    return Estimate(fits, problem.observation.external, external, gauge, external_unknowns)


def _fit_groups(
    task: Task, groups: list[list[int]], unknowns: Unknowns, poses: Array, roots: Array
) -> list[Robust]:
    """Return a fit for each group of legs."""
    fits = []
    for group in groups:
        names = [task.mechanism.leg_names[i] for i in group]
        task.tell(f"identifying {', '.join(names)}")
        problem, rows = group_problem(task, group, poses, roots)
        fits.append(robust_fit(task, problem, unknowns.part(names), rows))
    return fits


def group_problem(
    task: Task, group: list[int], poses: Array, roots: Array
) -> tuple[MeasuredPoses, NDArray[np.intp]]:
    """Return the problem of some legs at the rows that serve one of them, and these rows.

    Args:
        task: What is to be identified.
        group: The legs, by index.
        poses: In the base frame, shape (N, dof).
        roots: Roots of their covariance, shape (N, dof, dof).
    """
    used = task.used[:, group]
    rows = np.flatnonzero(used.any(axis=1))
    every = np.arange(task.noise.readings.shape[1])
    columns = np.concatenate([every[task.mechanism.reading_columns[i]] for i in group])
    problem = MeasuredPoses(
        [task.residual(i, task.kind, rows) for i in group],
        poses[rows],
        used[rows],
        roots[rows],
        task.noise.readings[np.ix_(rows, columns)],
        weighted=task.kind == "closure",
    )
    return problem, rows


def _groups(task: Task) -> list[list[int]]:
    """Return the legs that are identified at once: those that share a tie, or all."""
    legs = task.mechanism.legs
    if task.method == "together":
        return [list(range(len(legs)))]
    tied = [
        i for i, leg in enumerate(legs) if any(name in leg.parameter_names for name in task.tied)
    ]
    return ([tied] if tied else []) + [[i] for i in range(len(legs)) if i not in tied]


def given_poses(
    task: Task, observation: Observation | None, external: External | None
) -> tuple[Array, Array]:
    """Return measured poses in the base frame, shape (N, dof), and roots of their covariance.

    Args:
        task: What is to be identified.
        observation: What was measured, if frames or targets are unknown.
        external: Their values.
    """
    platform, data = task.mechanism.platform, task.data
    if observation is None or external is None:
        return data.poses, task.noise.poses[:, :, None] * np.eye(platform.dof)
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
    gauge: Gauge,
    problem: LatentPoses,
    unknowns: Unknowns,
    fits: list[Robust],
    external: External,
    first: External,
) -> Array:
    """Return the step of the external unknowns that brings the parameters nearest to nominal."""
    n = problem.columns[-1].stop
    values = unknowns.start.copy()
    for one in fits:
        for leg, columns in zip(one.fit.problem.legs, one.fit.problem.columns, strict=True):
            place = [leg.name for leg in problem.legs].index(leg.name)
            values[problem.columns[place]] = one.fit.parameters[columns]
    outside = problem.observation.external
    values[n:] = outside.coordinates(external) - outside.coordinates(first)
    off = np.linalg.lstsq(unknowns.map, values - unknowns.start, rcond=None)[0]
    along = gauge.constraints @ gauge.directions.T
    amounts = -np.linalg.solve(along, gauge.constraints @ off)
    return np.asarray((unknowns.map @ (gauge.directions.T @ amounts))[n:])


def _check_counts(task: Task) -> None:
    """Raise if there are too few poses for a leg.

    Raises:
        ObservabilityError: there are.
    """
    unknowns = task.unknowns()
    for leg, count in zip(task.mechanism.legs, task.used.sum(axis=0), strict=True):
        own = unknowns.part([leg.name])
        n = own.map.shape[1] - int(np.isfinite(own.priors).sum())
        equations = len(task.mechanism.platform.closing(leg.closes)) - len(leg.passive)
        least = -(-(n if task.noise.known else n + 1) // equations)
        if count < least:
            why = "" if task.noise.known else " and the scale of the noise"
            raise ObservabilityError(
                f"{leg.name}: {count} measured poses for {n} parameters{why}; at least {least} are "
                f"needed, {2 * least} or more advised"
                + ("" if task.every_pose else ". --poses all uses every pose for every leg")
            )


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
        (data.readings, task.mechanism.reading_names),
    ):
        if not (told := np.isfinite(values)).all():
            row, column = (int(i) for i in np.argwhere(~told)[0])
            raise MeasurementError(
                f"data row {row + 1}: {names[column]!r} is not measured; --method latent takes "
                "rows in which something is missing"
            )
