"""Do the measurements determine the parameters? Rank, and information that is only noise.

Poses that leave parameters undetermined lose rank. Measured poses are never exactly such:
their noise makes every Jacobian full, and a fit would read parameters out of the noise. So
each direction in parameter space must carry clearly more information than shaking the
poses by their own noise makes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MeasurementError, ObservabilityError
from pincal.estimation.observability import identifiability
from pincal.identification.problem import NOT_THIS_MACHINE, Linear, Problem
from pincal.identification.unknowns import Unknowns

Array = NDArray[np.float64]
_CLEARLY = 3.0  # times what noise makes
_POSES = 500  # enough to judge by: both grow alike with the number of poses
_TAKES_PART = 0.1  # of the largest entry of a direction


def check_rank(
    problem: Problem, unknowns: Unknowns, linear: Linear, *, ended: bool = False
) -> list[tuple[int, float]]:
    """Return rank and condition of each leg's part of the whitened Jacobian.

    Args:
        problem: The problem.
        unknowns: What is free.
        linear: Residuals and derivatives where to look.
        ended: Whether a search ended there that began where the rank was full.

    Raises:
        ObservabilityError: a parameter is not determined; the message names it.
        MeasurementError: a derivative does not exist at some pose.
    """
    J = linear.jacobian.reshape(-1, linear.jacobian.shape[2])
    if not np.isfinite(J).all():
        names = [leg.name for leg in problem.legs]
        raise MeasurementError(
            f"{', '.join(names)}: a residual or its derivative is not finite at some measured "
            "pose; a leg may be folded or stretched there"
        )
    J = np.asarray(np.linalg.qr(J, mode="r"))  # the same columns but for a rotation
    _, prior = unknowns.prior_rows(unknowns.start)
    all_ = identifiability(np.concatenate((J @ unknowns.map, prior)), unknowns.free_labels)
    if ended and not all_.complete:
        raise ObservabilityError(
            "the search ran away: the measurements tell the parameters apart at their nominal "
            f"values, but not where it ended ({all_.describe()}). {NOT_THIS_MACHINE}"
        )
    if not all_.complete:
        raise ObservabilityError(
            f"the measured poses leave parameters undetermined: {all_.describe()} "
            f"(rank {all_.rank} of {all_.n_params}). Measure poses that tell them apart, fix "
            "one of them, make it a constant in mechanism.yaml, or hold what is not told as near "
            "to nominal as can be (--method latent --hold-undetermined)"
        )
    own = (
        identifiability(J[:, columns], leg.parameter_names)
        for leg, columns in zip(problem.legs, problem.columns, strict=True)
    )
    return [(one.rank, one.condition) for one in own]


def check_information(
    problem: Problem, unknowns: Unknowns, places: Sequence[Linear], scale: float = 1.0
) -> None:
    """Raise if some direction in parameter space is told by the noise of the poses only.

    At one of several places it must be told by more.

    Args:
        problem: The problem.
        unknowns: What is free.
        places: Residuals and derivatives where to look.
        scale: By how much the noise is larger than the shaking.

    Raises:
        ObservabilityError: there is one; the message names the parameters that take part.
    """
    for linear in places:
        hollow = _hollow(problem, unknowns, linear, scale)
        if not len(hollow):
            return
    raise ObservabilityError(
        f"the measured poses tell {taking_part(unknowns.free_labels, hollow)} apart by their "
        "noise only. Measure poses that differ more (in orientation above all), or fix one of "
        "these parameters, or make it a constant in mechanism.yaml"
    )


def _hollow(problem: Problem, unknowns: Unknowns, linear: Linear, scale: float) -> Array:
    """Return directions in parameter space that noise tells as well as the poses, shape (k, n)."""
    some = np.linspace(0, len(linear.white) - 1, min(_POSES, len(linear.white))).astype(int)
    part = problem.part(some)
    linear = part.linearise(linear.state.rows(some))
    shaken = part.linearise(part.shaken(linear)).comparable()
    here, T = linear.comparable(), unknowns.map
    _, prior = unknowns.prior_rows(unknowns.start)
    own = np.concatenate(((here @ T).reshape(-1, T.shape[1]), prior))
    difference = ((shaken - here) @ T).reshape(-1, T.shape[1])
    lengths = np.linalg.norm(own, axis=0)
    triangle = np.linalg.qr(own / lengths, mode="r")
    _, information, directions = np.linalg.svd(triangle, full_matrices=False)
    made = scale * np.linalg.norm(difference / lengths @ directions.T, axis=0)
    return np.asarray(directions[information < _CLEARLY * made])


def taking_part(names: Sequence[str], directions: Array) -> str:
    """Return in words which unknowns take part in directions, rows of shape (k, n)."""
    size = np.abs(directions).max(axis=0)
    return ", ".join(
        name for name, part in zip(names, size, strict=True) if part > _TAKES_PART * size.max()
    )
