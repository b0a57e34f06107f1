"""Do the measurements determine the parameters? Rank, and information that is only noise.

Poses that leave parameters undetermined lose rank. Measured poses are never exactly such:
their noise makes every Jacobian full, and a fit would read parameters out of the noise. So
each direction in parameter space must carry clearly more information than the noise of the
poses makes when it is drawn once more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pincal.errors import MeasurementError, ObservabilityError
from pincal.estimation.observability.indices import (
    NEGLIGIBLE,
    identifiability,
    jacobian_near,
    lost_directions,
    plausible_changes,
)
from pincal.estimation.problem import Linear, Problem
from pincal.estimation.system import System
from pincal.estimation.unknowns import Unknowns
from pincal.model.mechanism import Mechanism
from pincal.types import Array

_CLEARLY = 3.0  # times what noise makes of information: less is none
_TAKES_PART = 0.1  # share of a direction's largest entry, from which a parameter is named
_WEAKLY = 3.0  # times better that one would be known with the other: correlation 0.943


def check_rank(
    problem: Problem, unknowns: Unknowns, linear: Linear, *, ended: bool = False
) -> None:
    """Raise if rows leave some free unknown undetermined.

    What is not determined where a search ``ended`` was so where it began: it ran away.

    Raises:
        ObservabilityError: a parameter is not determined; the message names it.
        MeasurementError: a derivative does not exist at some pose.
    """
    if not all(np.isfinite(x).all() for x in (linear.by_parameter, linear.white.whitener)):
        raise MeasurementError(
            f"{', '.join(leg.name for leg in problem.legs)}: a residual or its derivative is not "
            "finite at some measured pose; a leg may be folded or stretched there"
        )
    total = identifiability(unknowns.free_rows(linear.triangle), unknowns.free_labels)
    if not total.complete:
        raise ObservabilityError(
            "the search ran away: the measurements determine the parameters at their nominal "
            f"values, but not where it ended ({total.describe()}). They are hardly this machine's: "
            "check signs, units, the order of the readings, the frame of the poses, and rows that "
            "are far off (--loss cauchy)"
            if ended
            else f"the measured poses leave parameters undetermined: {total.describe()} "
            f"(rank {total.rank} of {total.n_params}). Measure poses that separate them, fix "
            "one of them, make it a constant in mechanism.yaml, or hold it as near to nominal as "
            "can be (leave out --strict; leave out --method per-leg)"
        )


def check_information(
    problem: Problem, unknowns: Unknowns, places: Sequence[Linear], scale: float = 1.0
) -> None:
    """Raise if some direction in parameter space is observed by the noise of the poses only.

    At one of several places it must be observed by more; noise is a scale larger than drawn.

    Raises:
        ObservabilityError: there is one; the message names the parameters that take part.
    """
    roots = problem.leg_block.pose_roots
    for linear in places:  # poses are drawn from what is not known about them
        rng, white = np.random.default_rng(0), linear.white
        if roots is None:
            W = white.by_noise
            draws = rng.standard_normal((len(W), W.shape[2], 1))
            hidden = draws - W.transpose(0, 2, 1) @ (W @ draws)  # what white rows do not see
            twists = white.poses_by(white.noise @ hidden)
        else:
            twists = roots @ rng.standard_normal((*roots.shape[:2], 1))
        matrices = problem.platform.displaced(linear.state.matrices, twists[:, :, 0])
        drawn = problem.evaluate(replace(linear.state, matrices=matrices)).noise_by_parameter
        difference = (drawn - linear.noise_by_parameter) @ unknowns.map
        rows = unknowns.free_rows(linear.triangle)  # that of the rows here: W Wᵀ = 1
        lengths = np.linalg.norm(rows, axis=0)
        _, information, directions = np.linalg.svd(rows / lengths, full_matrices=False)
        made = scale * np.linalg.norm(difference / lengths @ directions.T, axis=(0, 1))
        by_noise = directions[information < _CLEARLY * made]
        if not len(by_noise):
            return
    raise ObservabilityError(
        f"the measured poses determine {', '.join(taking_part(unknowns.free_labels, by_noise))} by "
        "their noise only. Measure poses that differ more (in orientation above all), or fix one "
        "of these parameters, or make it a constant in mechanism.yaml"
    )


def taking_part(names: Sequence[str], directions: Array) -> tuple[str, ...]:
    """Return which unknowns take part in directions, rows of shape (k, n)."""
    size = np.abs(directions).max(axis=0)
    parts = zip(names, size > _TAKES_PART * size.max(), strict=True)
    return tuple(name for name, takes_part in parts if takes_part)


class HeldUnknowns(NamedTuple):
    """What measurements cannot observe and was held as near to nominal as can be."""

    unknowns: Unknowns
    """Less these freedoms."""
    observable: Unknowns
    """Less only those that no noise, however small, would let be observed."""
    nominal: Linear
    """Conditions at the nominal parameters, where a search starts."""
    directions: Array
    """Directions of all unknowns, as far as machines may differ, shape (n, n_lost)."""
    groups: tuple[tuple[str, ...], ...]
    """Ids of the unknowns that are unobservable together, a group for each direction."""
    weak: tuple[str, ...]
    """Ids of those that are weakly determined."""
    least: float
    """By how many times better than machines differ a direction had to be determined."""
    weakest: float
    """By how many times the weakest is of those that were not held."""


def hold_unobservable(
    mechanism: Mechanism, system: System, nominal: Linear, held: HeldUnknowns | None, least: float
) -> HeldUnknowns:
    """Return the unknowns, gauge freedoms held, less what the measurements leave unobservable.

    Poses are unknowns, conditions those where a search starts. Of all parameters that fit as well,
    those nearest to the nominal ones, each change measured by what it alone would do to the
    measurements; then, where noise determines them less than ``least`` times better than machines
    differ, by how much these differ. What was held at other noise says what noise does not change.

    Raises:
        ObservabilityError: no measured pose is one that the legs reach.
    """
    free, problem = system.unknowns, system.problem
    if held is None:
        rows = np.flatnonzero(system.kept)
        J = jacobian_near(mechanism, problem.at(rows), free, generic=False)[1]
        if not len(J):
            raise ObservabilityError(
                "the nominal legs reach none of the measured poses, so that nothing is determined; "
                "compare the mechanism and its units with the measurements (pincal doctor)"
            )
        lost, lengths = lost_directions(J)
        directions = free.map @ (lost / lengths).T
        groups = identifiability(J, free.free_labels).groups if len(lost) else ()
        observable = free.held(lost * lengths) if len(lost) else free
    else:
        observable, groups = held.observable, held.groups
        directions = held.directions[:, : free.n_free - observable.n_free]
    # how many times better than machines differ noise determines the rest, the best first
    differ = problem.observation.external.sizes(mechanism.size)
    plausible = np.concatenate((plausible_changes(mechanism, problem.legs), differ))
    scale = 1.0 / np.abs(observable.map / plausible[:, None]).max(axis=0)
    R = replace(system, unknowns=observable).triangle(nominal, system.kept.astype(float))
    _, information, axes = np.linalg.svd(R[:-1, :-1] * scale)
    weak = axes[int((information > least).sum()) :]
    weakest = float(information[information > least].min(initial=np.inf))
    directions = np.column_stack((directions, observable.map @ (weak * scale).T))
    directions = directions / np.abs(directions / plausible[:, None]).max(axis=0, initial=0.0)
    names = taking_part(observable.free_labels, weak) if len(weak) else ()
    less = observable.held(weak / scale) if len(weak) else observable
    return HeldUnknowns(less, observable, nominal, directions, groups, names, least, weakest)


class WeakPair(NamedTuple):
    """Two parameters whose errors mostly compensate each other."""

    first: str
    """Its id, such as ``"leg_1.l"``."""
    second: str
    correlation: float


def weak_pairs(ids: Sequence[str], covariance: Array) -> tuple[WeakPair, ...]:
    """Return the pairs of parameters that are weakly determined together, the weakest first.

    Of a covariance, shape (n, n). Those whose variance is zero, or not finite, and pairs that are
    tied, are left out.
    """
    std = np.sqrt(np.diagonal(covariance))
    known = np.isfinite(std) & (std > 0.0)
    scale = np.where(known, std, np.inf)
    rho = np.where(np.outer(known, known), covariance, 0.0) / np.outer(scale, scale)
    left = 1.0 - np.triu(rho, 1) ** 2  # share of a variance that stays if the other one is known
    pairs = np.argwhere((left < _WEAKLY**-2) & (left > NEGLIGIBLE**2)).tolist()
    pairs.sort(key=lambda pair: -abs(rho[*pair]))
    return tuple(WeakPair(ids[i], ids[j], float(rho[i, j])) for i, j in pairs)
