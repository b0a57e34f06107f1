"""What the measurements leave unobservable may be held: parameters remain nearest to nominal there.

Unobservable, or determined so weakly that noise would move parameters farther than those of
machines differ from their drawings. The machine is then calibrated where it was measured; elsewhere
these directions may move it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.errors import ObservabilityError
from pincal.estimation.linear import State
from pincal.estimation.observability.drawings import DIFFER, plausible_changes
from pincal.estimation.observability.generic import derivatives_near, lost_directions
from pincal.estimation.observability.identifiable import taking_part
from pincal.estimation.observability.indices import identifiability
from pincal.estimation.problem import Problem
from pincal.estimation.start import poses_at_rest
from pincal.estimation.unknowns import Unknowns
from pincal.kinematics.legs.closure import largest_size
from pincal.model.mechanism import Mechanism
from pincal.words.numbers import listed
from pincal.words.wording import NAMED

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Held:
    """What measurements cannot observe and was held as near to nominal as can be."""

    unknowns: Unknowns
    """Less these freedoms."""
    directions: Array
    """Directions of all unknowns, as far as machines may differ, shape (n, n_lost)."""
    groups: tuple[tuple[str, ...], ...]
    """Ids of the unknowns that are unobservable together, a group for each direction."""
    weak: tuple[str, ...]
    """Ids of those that are weakly determined."""


def hold_unobservable(mechanism: Mechanism, problem: Problem, unknowns: Unknowns) -> Held:
    """Return the unknowns less what the measurements leave unobservable.

    Of all parameters that fit as well, those nearest to the nominal ones, each change measured by
    what it alone would do to the measurements; then, where they are weakly determined, by how much
    machines may differ.

    Args:
        mechanism: The nominal mechanism.
        problem: The problem, at its start.
        unknowns: Of the problem, less gauge freedoms.
    """
    J = _jacobian(mechanism, problem, unknowns)
    lost, lengths = lost_directions(J)
    held = unknowns.held(lost * lengths) if len(lost) else unknowns
    weak, scale = weakly_determined(mechanism, problem, held)
    moved = [(lost / lengths) @ unknowns.map.T, (weak * scale) @ held.map.T]
    plausible = _plausible(mechanism, problem)
    directions = np.concatenate(moved).T
    directions = directions / np.abs(directions / plausible[:, None]).max(axis=0, initial=0.0)
    groups = identifiability(J, unknowns.free_labels).groups if len(lost) else ()
    names = taking_part(held.free_labels, weak) if len(weak) else ()
    return Held(held.held(weak / scale) if len(weak) else held, directions, groups, names)


def weakly_determined(
    mechanism: Mechanism, problem: Problem, unknowns: Unknowns
) -> tuple[Array, Array]:
    """Return along which directions noise moves parameters farther than machines may differ.

    Rows of shape (k, n_free), in unknowns over their scale, and these scales: by how much machines
    may differ, shape (n_free,).

    Args:
        mechanism: The nominal mechanism.
        problem: The problem, at its start.
        unknowns: Of the problem, none unobservable.
    """
    T, plausible = unknowns.map, _plausible(mechanism, problem)
    state = problem.start(unknowns.start[: problem.n_parameters])
    if problem.latent:
        state = poses_at_rest(problem, state)
    scale = 1.0 / np.abs(T / plausible[:, None]).max(axis=0)
    rows = _rows(problem, unknowns, state) * scale
    _, information, axes = np.linalg.svd(np.linalg.qr(rows, mode="r"), full_matrices=True)
    return axes[int((information > 1.0).sum()) :], scale


def _plausible(mechanism: Mechanism, problem: Problem) -> Array:
    """Return by how much all unknowns may differ from where they start, shape (n,)."""
    size = largest_size(mechanism.legs)
    outside = [size if unit == "m" else 1.0 for unit in problem.observation.external.units]
    return np.concatenate((plausible_changes(mechanism, problem.legs), outside))


def _jacobian(mechanism: Mechanism, problem: Problem, unknowns: Unknowns) -> Array:
    """Return the Jacobian in the free unknowns that says what is unobservable, shape (m, n)."""
    if problem.latent:
        return derivatives_near(mechanism, problem, unknowns, generic=False).jacobian(unknowns)
    return _rows(problem, unknowns, problem.start(unknowns.start[: problem.n_parameters]))


def _rows(problem: Problem, unknowns: Unknowns, state: State) -> Array:
    """Return the whitened Jacobian of a problem in the free unknowns, rows of priors below."""
    J = problem.linearise(state).jacobian @ unknowns.map
    _, prior = unknowns.prior_rows(unknowns.start)
    return np.concatenate((J.reshape(-1, J.shape[2]), prior))


def check_weakly_determined(
    mechanism: Mechanism, problem: Problem, unknowns: Unknowns, cause: ObservabilityError
) -> None:
    """Raise if the measurements determine something weakly, though nothing is unobservable.

    Raises:
        ObservabilityError: that is so; the message names what.
    """
    lost, _ = lost_directions(_jacobian(mechanism, problem, unknowns))
    if len(lost):
        return
    weak, _ = weakly_determined(mechanism, problem, unknowns)
    if len(weak):
        raise _weak(taking_part(unknowns.free_labels, weak)) from cause


def check_covariance(
    mechanism: Mechanism,
    problem: Problem,
    parameters: Array,
    covariance: Array,
    *,
    converged: bool,
) -> None:
    """Raise if a search was lost among parameters, or found values that could be any.

    Lost where noise moves parameters farther than machines differ from their drawings; any where
    it has done so, and two standard errors are longer than the machine, or more than a radian: no
    linear covariance holds so far.

    Args:
        mechanism: The nominal mechanism.
        problem: The problem.
        parameters: Where the search ended, shape (n_params,).
        covariance: Of all its unknowns, shape (n, n).
        converged: Whether the search did.

    Raises:
        ObservabilityError: that is so; the message names the parameters.
    """
    n, limit = problem.n_parameters, plausible_changes(mechanism, problem.legs)
    std = np.sqrt(np.diagonal(covariance))[:n]
    moved = np.abs(parameters - np.concatenate([leg.nominal for leg in problem.legs]))
    far = std > limit
    anything = (2.0 * std > limit / DIFFER) & (moved > limit)
    if anything.any() if converged else far.any():
        ids = [f"{leg.name}.{name}" for leg in problem.legs for name in leg.parameter_names]
        raise _weak([one for one, weak in zip(ids, far, strict=True) if weak])


def _weak(ids: Sequence[str]) -> ObservabilityError:
    alone, more = len(ids) == 1, len(ids) - NAMED
    named = listed([*ids[:NAMED], f"{more} more parameters"] if more > 1 else ids)
    them = "it" if alone else "them"
    return ObservabilityError(
        f"{named} {'is' if alone else 'are'} weakly determined by the measured poses: noise moves "
        f"{them} farther than machines differ from their drawings. Measure poses that differ more "
        f"(in orientation above all), hold {them} as near to nominal as can be "
        "(--hold-undetermined), or say how well nominal values are known (--prior)"
    )
