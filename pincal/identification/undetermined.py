"""What the measurements leave undetermined may be held: parameters stay nearest to nominal there.

Not told at all, or told so weakly that noise would move parameters farther than those of machines
differ from their drawings. The machine is then calibrated where it was measured; elsewhere these
directions may move it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.errors import ObservabilityError
from pincal.estimation.drawings import plausible_changes
from pincal.estimation.observability import identifiability
from pincal.identification.alignment import settle
from pincal.identification.consistent import consistent, lost_directions
from pincal.identification.determined import taking_part
from pincal.identification.latent import LatentPoses
from pincal.identification.problem import Problem, State
from pincal.identification.unknowns import Unknowns
from pincal.kinematics.closure import largest_size
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Held:
    """What measurements do not tell and was held as near to nominal as can be."""

    unknowns: Unknowns
    """Less these freedoms."""
    of_legs: Array
    """Directions in the legs' parameters, as far as machines may differ, (n_params, n_lost)."""
    words: str
    """Empty if there are none."""


def hold_undetermined(mechanism: Mechanism, problem: LatentPoses, unknowns: Unknowns) -> Held:
    """Return the unknowns less what the measurements leave undetermined.

    Of all parameters that fit as well, those nearest to the nominal ones, each change measured by
    what it alone would do to the measurements; then, where they hardly tell something, by how much
    machines may differ.

    Args:
        mechanism: The nominal mechanism.
        problem: The problem, at its start.
        unknowns: Of the problem, less gauge freedoms.
    """
    J = consistent(mechanism, problem, unknowns, generic=False).jacobian(unknowns)
    lost, lengths = lost_directions(J)
    held = unknowns.held(lost * lengths) if len(lost) else unknowns
    weak, scale = hardly_told(mechanism, problem, held)
    moved = [(lost / lengths) @ unknowns.map.T, (weak * scale) @ held.map.T]
    plausible = plausible_changes(mechanism)
    directions = np.concatenate(moved)[:, : len(plausible)].T
    directions = directions / np.abs(directions / plausible[:, None]).max(axis=0, initial=0.0)
    words = [identifiability(J, unknowns.free_labels).in_words()] if len(lost) else []
    if len(weak):
        words.append(f"{taking_part(held.free_labels, weak)} are hardly told apart")
        held = held.held(weak / scale)
    return Held(held, directions, "; ".join(words))


def hardly_told(mechanism: Mechanism, problem: Problem, unknowns: Unknowns) -> tuple[Array, Array]:
    """Return along which directions noise moves parameters farther than machines may differ.

    Rows of shape (k, n_free), in unknowns over their scale, and these scales: by how much machines
    may differ, shape (n_free,).

    Args:
        mechanism: The nominal mechanism.
        problem: The problem, at its start.
        unknowns: Of the problem, none lost.
    """
    size, T = largest_size(mechanism.legs, mechanism.platform), unknowns.map
    plausible = plausible_changes(mechanism, problem.legs)
    state = problem.start(unknowns.start[: problem.columns[-1].stop])
    if isinstance(problem, LatentPoses):
        outside = [size if unit == "m" else 1.0 for unit in problem.observation.external.units]
        plausible, state = np.concatenate((plausible, outside)), settle(problem, state)
    scale = 1.0 / np.abs(T / plausible[:, None]).max(axis=0)
    rows = _rows(problem, unknowns, state) * scale
    _, told, axes = np.linalg.svd(np.linalg.qr(rows, mode="r"), full_matrices=True)
    return axes[int((told > 1.0).sum()) :], scale


def _lost(mechanism: Mechanism, problem: Problem, unknowns: Unknowns) -> bool:
    """Return whether the measurements do not tell something at all."""
    if isinstance(problem, LatentPoses):
        J = consistent(mechanism, problem, unknowns, generic=False).jacobian(unknowns)
        return len(lost_directions(J)[0]) > 0
    start = problem.start(unknowns.start[: problem.columns[-1].stop])
    return not identifiability(_rows(problem, unknowns, start), unknowns.free_labels).complete


def _rows(problem: Problem, unknowns: Unknowns, state: State) -> Array:
    """Return the whitened Jacobian of a problem in the free unknowns, rows of priors below."""
    J = problem.linearise(state).jacobian @ unknowns.map
    _, prior = unknowns.prior_rows(unknowns.start)
    return np.concatenate((J.reshape(-1, J.shape[2]), prior))


def check_told(
    mechanism: Mechanism, problem: Problem, unknowns: Unknowns, cause: ObservabilityError
) -> None:
    """Raise if the measurements hardly tell something, though nothing is lost.

    Raises:
        ObservabilityError: that is so; the message names what.
    """
    if _lost(mechanism, problem, unknowns):
        return
    weak, _ = hardly_told(mechanism, problem, unknowns)
    if len(weak):
        raise ObservabilityError(
            f"the measured poses hardly tell {taking_part(unknowns.free_labels, weak)} apart: "
            "noise moves them farther than machines differ from their drawings. Measure poses that "
            "tell them apart, hold what is not told as near to nominal as can be (--method latent "
            "--hold-undetermined), or say how well nominal values are known (--prior)"
        ) from cause
