"""Do the measurements determine the parameters? Rank, and information that is only noise.

Poses that leave parameters undetermined lose rank. Measured poses are never exactly such:
their noise makes every Jacobian full, and a fit would read parameters out of the noise. So
each direction in parameter space must carry clearly more information than the noise of the
poses makes when it is drawn once more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MeasurementError, ObservabilityError
from pincal.estimation.linear import Linear
from pincal.estimation.observability.indices import identifiability
from pincal.estimation.problem import Problem
from pincal.estimation.unknowns import Unknowns

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Judgement:
    """What is undetermined by measured poses."""

    clearly: float = 3.0
    """Times what noise makes of information: less is none."""
    poses: int = 500
    """Enough to judge by: both grow alike with the number of poses."""
    takes_part: float = 0.1
    """Of the largest entry of a direction: parameters with more are named."""


_BY = Judgement()
NOT_THIS_MACHINE = (
    "They are hardly this machine's: check signs, units, the order of the readings, the frame of "
    "the poses, and rows that are far off (--robust cauchy)"
)


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
    if not (linear.stack.finite and np.isfinite(linear.white.whitener).all()):
        names = [leg.name for leg in problem.legs]
        raise MeasurementError(
            f"{', '.join(names)}: a residual or its derivative is not finite at some measured "
            "pose; a leg may be folded or stretched there"
        )
    J = linear.triangle
    _, prior = unknowns.prior_rows(unknowns.start)
    all_ = identifiability(np.concatenate((J @ unknowns.map, prior)), unknowns.free_labels)
    if ended and not all_.complete:
        raise ObservabilityError(
            "the search ran away: the measurements determine the parameters at their nominal "
            f"values, but not where it ended ({all_.describe()}). {NOT_THIS_MACHINE}"
        )
    if not all_.complete:
        raise ObservabilityError(
            f"the measured poses leave parameters undetermined: {all_.describe()} "
            f"(rank {all_.rank} of {all_.n_params}). Measure poses that separate them, fix "
            "one of them, make it a constant in mechanism.yaml, or hold it as near to nominal as "
            "can be (--hold-undetermined; leave out --per-leg)"
        )
    own = (
        identifiability(J[:, columns], leg.parameter_names)
        for leg, columns in zip(problem.legs, problem.columns, strict=True)
    )
    return [(one.rank, one.condition) for one in own]


def check_information(
    problem: Problem, unknowns: Unknowns, places: Sequence[Linear], scale: float = 1.0
) -> None:
    """Raise if some direction in parameter space is observed by the noise of the poses only.

    At one of several places it must be observed by more.

    Args:
        problem: The problem.
        unknowns: What is free.
        places: Residuals and derivatives where to look.
        scale: By how much the noise is larger than what is drawn.

    Raises:
        ObservabilityError: there is one; the message names the parameters that take part.
    """
    for linear in places:
        by_noise = _by_noise_only(problem, unknowns, linear, scale)
        if not len(by_noise):
            return
    raise ObservabilityError(
        f"the measured poses determine {', '.join(taking_part(unknowns.free_labels, by_noise))} by "
        "their noise only. Measure poses that differ more (in orientation above all), or fix one "
        "of these parameters, or make it a constant in mechanism.yaml"
    )


def _by_noise_only(problem: Problem, unknowns: Unknowns, linear: Linear, scale: float) -> Array:
    """Return directions in parameter space that noise observes as well as poses, shape (k, n)."""
    part, linear, _ = problem.thinned(linear, _BY.poses)
    state = linear.state
    matrices = problem.platform.displaced(state.matrices, part.pose_draws(linear))
    drawn = part.linearise(replace(state, matrices=matrices)).noise_by_parameter
    here, T = linear.noise_by_parameter, unknowns.map
    _, prior = unknowns.prior_rows(unknowns.start)
    own = np.concatenate((linear.triangle @ T, prior))  # that of the rows here: W Wᵀ = 1
    difference = ((drawn - here) @ T).reshape(-1, T.shape[1])
    lengths = np.linalg.norm(own, axis=0)
    _, information, directions = np.linalg.svd(own / lengths, full_matrices=False)
    made = scale * np.linalg.norm(difference / lengths @ directions.T, axis=0)
    return np.asarray(directions[information < _BY.clearly * made])


def taking_part(names: Sequence[str], directions: Array) -> tuple[str, ...]:
    """Return which unknowns take part in directions, rows of shape (k, n)."""
    size = np.abs(directions).max(axis=0)
    return tuple(
        name for name, part in zip(names, size, strict=True) if part > _BY.takes_part * size.max()
    )
