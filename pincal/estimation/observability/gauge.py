"""Gauge freedoms: motions of frames that no measurement of this kind can observe.

If the base is at an unknown place in the tracker's frame, turning the base frame and all
base points with it changes nothing that is measured; so does turning the platform's frame if
its orientation is not measured. Such directions are found as what generic poses leave
undetermined, distinguished from parameters that are truly lost by what they do to the platform, and
fixed by a choice: of all equal parameters those nearest to the nominal ones, each change
measured by how much machines differ from their drawings. So the choice is the machine's alone,
wherever and however it was measured.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.errors import ObservabilityError
from pincal.estimation.observability.drawings import DIFFER, plausible_changes
from pincal.estimation.observability.frames import frames_moved, split_frames, still
from pincal.estimation.observability.generic import derivatives_near, lost_directions
from pincal.estimation.observability.indices import NEGLIGIBLE, identifiability
from pincal.estimation.problem import Problem
from pincal.estimation.unknowns import Unknowns
from pincal.finding import Finding
from pincal.kinematics.legs.closure import largest_size
from pincal.model.mechanism import Mechanism
from pincal.words.sentences import finding
from pincal.words.wording import groups_in_words

Array = NDArray[np.float64]
_TARGETS = 1e-6  # how much targets count beside parameters in what is nearest to nominal


@dataclass(frozen=True)
class Gauge:
    """Directions that only move frames."""

    directions: Array
    """Rows in the free unknowns, shape (n_gauge, n_free)."""
    constraints: Array
    """Rows g with g · z = 0 that fix them, shape (n_gauge, n_free)."""
    found: tuple[Finding, ...]
    """What is free, and was fixed by choice."""
    of_legs: Array | None
    """The directions in the legs' parameters, columns of shape (n_params, n_gauge); None if there
    are none."""
    frames: Array
    """Motions of frames that these are (see ``frames_moved``), shape (k, n_moved)."""


def find_gauge(mechanism: Mechanism, problem: Problem, unknowns: Unknowns) -> Gauge:
    """Return the gauge freedoms of a problem at its start.

    Raises:
        ObservabilityError: what is measured leaves parameters undetermined at any poses; the
            message names them.
    """
    generic = derivatives_near(mechanism, problem, unknowns, generic=True)
    n_legs, T = generic.leg_parameter.shape[2], unknowns.map
    J = generic.jacobian(unknowns)
    if not len(J):
        raise ObservabilityError(
            "no machine near the nominal one reaches the poses as measured; check their frame, "
            "their units, and that this is the right mechanism"
        )
    lost, lengths = lost_directions(J)
    directions = lost / lengths
    size = largest_size(problem.legs)
    gain = -np.linalg.pinv(generic.leg_pose) @ generic.leg_parameter
    moved = (directions @ T.T)[:, :n_legs].T
    _, inside = split_frames(mechanism.platform, generic.matrices, gain, moved, size)
    if inside.shape[1]:
        follows = gain.reshape(-1, n_legs) @ T[:n_legs]
        raise ObservabilityError(
            f"what is measured leaves parameters undetermined at any poses: "
            f"{_undetermined(mechanism, J, unknowns, moved, inside.shape[1], follows)}"
        )
    n_still = still(gain, moved) if len(lost) else 0
    found = _freedoms(len(lost) - n_still, mechanism, unknowns, directions @ T.T)
    if n_still:
        groups = identifiability(gain.reshape(-1, n_legs), unknowns.labels[:n_legs]).groups
        found.append(finding("redundant-parameters", count=n_still, groups=groups))
    frames = frames_moved(mechanism.platform, generic.matrices, gain, moved)
    nearest = (directions @ T.T * _weights(mechanism, problem)) @ T
    return Gauge(directions, nearest, tuple(found), moved if found else None, frames)


def _undetermined(
    mechanism: Mechanism, J: Array, unknowns: Unknowns, lost: Array, count: int, gain: Array
) -> str:
    """Return what is unobservable but for motions of frames, and what to do about it.

    Args:
        mechanism: The mechanism.
        J: What free unknowns do to the measurements, shape (m, n_free).
        unknowns: The unknowns.
        lost: Directions of the legs' parameters that are lost, columns of shape (n_params, n_lost).
        count: How many of them are no motions of frames.
        gain: How the platform follows the free unknowns, shape (m, n_free).
    """
    if lost.shape[1] == len(unknowns.free_labels):
        return (
            "all of them, as readings that are no more than the platform's freedoms fit any "
            "machine. Measure the platform, or a part of its pose, or distances"
        )
    parameters = [(leg, name) for leg in mechanism.legs for name in leg.parameter_names]
    units = np.array([leg.units[name] for leg, name in parameters])
    nominal = np.concatenate([leg.nominal for leg in mechanism.legs])
    Q = np.linalg.qr(lost / np.linalg.norm(lost, axis=0))[0]
    for sign in (1.0, -1.0):
        grown = np.where(units == "m", nominal, np.where(units == "1", sign * nominal, 0.0))
        if count == 1 and np.linalg.norm(grown - Q @ (Q.T @ grown)) < NEGLIGIBLE * np.linalg.norm(
            grown
        ):
            gains = dict.fromkeys(
                name for (_, name), unit in zip(parameters, units, strict=True) if unit == "1"
            )
            return (
                "the scale. Lengths alone do not fix it where the gains of their sensors "
                f"({', '.join(gains)}) are free: a machine twice as large reads the same. Fix the "
                f"gains ({' '.join(f'--fix {name}' for name in gains)}), or measure a position or "
                "a distance"
            )
    groups = identifiability(J, unknowns.free_labels).groups
    where = {label: index for index, label in enumerate(unknowns.free_labels)}
    needed = [one for one in groups if _apart(gain[:, [where[name] for name in one]])] or groups
    words = groups_in_words(tuple(needed), most=len(needed))
    return (
        f"{words}. Measure more of the platform, or fix one of them, or make it a constant in "
        "mechanism.yaml"
    )


def _apart(columns: Array) -> bool:
    """Return whether the platform follows these unknowns in ways that differ, shape (m, n)."""
    s = np.linalg.svd(columns, compute_uv=False)
    return bool(s[-1] > NEGLIGIBLE * s[0])


def _weights(mechanism: Mechanism, problem: Problem) -> Array:
    """Return how much the square of each unknown's change counts in what is nearest to nominal.

    The frame is taken as it comes; targets too, unless nothing else tells the frame from them.
    """
    outside, legs = problem.observation.external, plausible_changes(mechanism)
    length = DIFFER * largest_size(mechanism.legs)
    scales = np.array([length if unit == "m" else DIFFER for unit in outside.units])
    counts = [0.0 if name.startswith("tracker.") else _TARGETS for name in outside.names]
    return np.concatenate((1.0 / legs**2, np.array(counts) / scales**2))


def _freedoms(
    count: int, mechanism: Mechanism, unknowns: Unknowns, directions: Array
) -> list[Finding]:
    """Return which frames are free, and by how many freedoms."""
    if not count:
        return []
    frame = np.array([name.startswith("tracker.") for name in unknowns.labels])
    n_base = int(np.linalg.matrix_rank(directions[:, frame], tol=1e-6)) if frame.any() else 0
    if "rad" not in mechanism.platform.units:  # a point has no frame of its own
        return [finding("gauge-base-frame", freedoms=count, unknown_frame=n_base > 0)]
    found = []
    if n_base:
        found.append(finding("gauge-base-frame", freedoms=n_base, unknown_frame=True))
    if count > n_base:
        found.append(finding("gauge-platform-frame", freedoms=count - n_base))
    return found
