"""Do the measurements determine the parameters? Rank, and information that is only noise.

Poses that leave parameters undetermined lose rank. Measured poses are never exactly such:
their noise makes every Jacobian full, and a fit would read parameters out of the noise. So
each direction in parameter space must carry clearly more information than shaking the
poses by their own noise makes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MeasurementError, ObservabilityError
from pincal.experiment.observability import identifiability
from pincal.identification.problem import Problem
from pincal.model.leg import Leg

Array = NDArray[np.float64]
_CLEARLY = 3.0  # times what noise makes
_TAKES_PART = 0.1  # of the largest entry of a direction


def leg_jacobian(problem: Problem, whitener: Array, parameters: Array, index: int) -> Array:
    """Return the whitened Jacobian of one leg at the poses it uses, shape (n_rows, n_params)."""
    J = problem.jacobian(parameters)[:, index, problem.columns[index]]
    return (whitener[:, index, index, None] * J)[problem.used[:, index]]


def check_rank(problem: Problem, whitener: Array, parameters: Array) -> list[tuple[int, float]]:
    """Return rank and condition of each leg's whitened Jacobian.

    Raises:
        ObservabilityError: a parameter is not determined; the message names it.
        MeasurementError: a derivative does not exist at some pose.
    """
    found = []
    for index, leg in enumerate(problem.legs):
        own = leg_jacobian(problem, whitener, parameters, index)
        if not np.isfinite(own).all():
            raise MeasurementError(
                f"{leg.name}: a residual or its derivative is not finite at some measured pose; "
                "the leg may be folded or stretched there"
            )
        one = identifiability(own, leg.parameter_names)
        if not one.complete:
            raise ObservabilityError(
                f"the measured poses leave parameters undetermined: {one.in_words(leg.name)} "
                f"(rank {one.rank} of {one.n_params}). Measure poses that tell them apart, or make "
                "one of them a constant in mechanism.yaml"
            )
        found.append((one.rank, one.condition))
    return found


def check_information(
    problem: Problem, shaken: Problem, parameters: Array, scale: float = 1.0
) -> None:
    """Raise if some direction in parameter space is told by the noise of the poses only.

    Args:
        problem: The problem at the measured poses.
        shaken: The same at these poses, shaken by their noise once more.
        parameters: Where to look, shape (n_params,).
        scale: By how much the noise is larger than the shaking.

    Raises:
        ObservabilityError: there is one; the message names the parameters that take part.
    """
    whitener = problem.whitener(parameters)
    for index, leg in enumerate(problem.legs):
        own = leg_jacobian(problem, whitener, parameters, index)
        difference = leg_jacobian(shaken, whitener, parameters, index) - own
        lengths = np.linalg.norm(own, axis=0)
        _, information, directions = np.linalg.svd(own / lengths, full_matrices=False)
        made = scale * np.linalg.norm(difference / lengths @ directions.T, axis=0)
        hollow = directions[information < _CLEARLY * made]
        if len(hollow):
            raise ObservabilityError(_in_words(leg, hollow))


def _in_words(leg: Leg, hollow: Array) -> str:
    size = np.abs(hollow).max(axis=0)
    named = [
        name
        for name, part in zip(leg.parameter_names, size, strict=True)
        if part > _TAKES_PART * size.max()
    ]
    return (
        f"the measured poses tell {', '.join(named)} of {leg.name} apart by their noise only. "
        "Measure poses that differ more (in orientation above all), or make one of these "
        "parameters a constant in mechanism.yaml"
    )
