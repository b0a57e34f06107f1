"""The estimator with latent poses: on whatever was measured of the platform."""

from __future__ import annotations

import numpy as np

from pincal.estimation.observation import Observation
from pincal.identification.alignment import align
from pincal.identification.contradiction import check_start
from pincal.identification.estimate import Estimate
from pincal.identification.gauge import find_gauge
from pincal.identification.latent import LatentPoses
from pincal.identification.robust import robust_fit
from pincal.identification.task import Task
from pincal.identification.undetermined import hold_undetermined
from pincal.identification.unknowns import Unknowns


def unaligned_problem(task: Task) -> LatentPoses:
    """Return the problem with latent poses, without a start.

    Raises:
        MeasurementError: rows with too little measured.
    """
    data = task.data
    observation = Observation(task.mechanism, data, task.setup)
    return LatentPoses(
        [task.residual(i) for i in range(len(task.mechanism.legs))],
        task.used,
        observation,
        observation.sigma(data, task.noise.noise),
        task.noise.readings,
    )


def latent_problem(task: Task) -> tuple[LatentPoses, Unknowns]:
    """Return the problem with latent poses at its start, and its unknowns.

    Raises:
        MeasurementError: rows with too little measured; frames that cannot be aligned.
    """
    problem = unaligned_problem(task)
    unknowns = task.unknowns(problem.observation.external.names)
    task.tell("finding poses and frames to start from")
    problem.first = align(
        task.mechanism, problem, task.data, unknowns.start[: problem.columns[-1].stop]
    )
    whole = task.setup.plain and np.isfinite(task.data.poses).all()
    if not (task.rough or whole):  # whole poses are checked as such
        check_start(problem, problem.first)
    return problem, unknowns


def latent_fit(task: Task) -> Estimate:
    """Return the fit of all legs, poses and frames at once.

    Raises:
        ObservabilityError: parameters that are not determined.
        MeasurementError: rows with too little measured; frames that cannot be aligned.
    """
    problem, unknowns = latent_problem(task)
    gauge = find_gauge(task.mechanism, problem, unknowns)
    free = unknowns.held(gauge.constraints) if gauge.words else unknowns
    held = hold_undetermined(task.mechanism, problem, free) if task.hold else None
    free = free if held is None else held.unknowns
    task.tell("identifying all legs and poses")
    found = robust_fit(task, problem, free, np.arange(len(task.data)))
    outside = problem.observation.external
    external = found.fit.last.state.external
    return Estimate([found], outside, external, gauge, unknowns, problem, held)
