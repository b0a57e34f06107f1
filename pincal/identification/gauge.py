"""Gauge freedoms: motions of frames that no measurement of this kind can tell.

If the base stands at an unknown place in the tracker's frame, turning the base frame and all
base points with it changes nothing that is measured; so does turning the platform's frame if
its orientation is not measured. Such directions are found as what generic poses leave
undetermined, told from parameters that are truly lost by what they do to the platform, and
fixed by a choice: of all equal parameters those nearest to the nominal ones, each change
measured by what it alone would do to the measurements.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.errors import ObservabilityError
from pincal.experiment.elimination import eliminate
from pincal.experiment.frames import split_frames
from pincal.experiment.observability import identifiability
from pincal.identification.latent import LatentPoses
from pincal.identification.unknowns import Unknowns
from pincal.kinematics.closure import largest_size
from pincal.kinematics.derivatives import leg_demand
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]
_ROWS = 200  # generic poses, at least
_SPREAD = 0.05  # of the mechanism's size, and [rad], by which they are moved about
_LOST = 1e-9  # of the largest singular value, columns of unit length
_TARGETS = 1e-6  # how much targets count beside parameters in what is nearest to nominal


@dataclass(frozen=True)
class Gauge:
    """Directions that only move frames."""

    directions: Array
    """Rows in the free unknowns, shape (n_gauge, n_free)."""
    constraints: Array
    """Rows g with g · z = 0 that fix them, shape (n_gauge, n_free)."""
    words: tuple[str, ...]
    of_legs: Array | None
    """The directions in the legs' parameters, columns of shape (n_params, n_gauge); None if there
    are none."""


@dataclass(frozen=True)
class _Generic:
    """Derivatives at generic poses that all legs reach."""

    matrices: Array
    leg_pose: Array
    leg_parameter: Array
    seen_pose: Array
    seen_parameter: Array


def find_gauge(mechanism: Mechanism, problem: LatentPoses, unknowns: Unknowns) -> Gauge:
    """Return the gauge freedoms of a problem at its start.

    Raises:
        ObservabilityError: what is measured leaves parameters undetermined at any poses; the
            message names them.
    """
    generic = _generic(mechanism, problem, unknowns)
    n_legs, T = generic.leg_parameter.shape[2], unknowns.map
    legs = np.concatenate(
        (generic.leg_parameter, np.zeros((*generic.leg_parameter.shape[:2], T.shape[0] - n_legs))),
        axis=2,
    )
    parameter = np.concatenate((legs, generic.seen_parameter), axis=1)
    pose = np.concatenate((generic.leg_pose, generic.seen_pose), axis=1)
    free = eliminate(np.zeros(pose.shape[:2]), parameter, pose)
    _, prior = unknowns.prior_rows(unknowns.start)
    J = np.concatenate((free.parameter.reshape(-1, T.shape[0]) @ T, prior))
    lengths = np.linalg.norm(J, axis=0)
    lengths[lengths == 0.0] = 1.0
    _, s, axes = np.linalg.svd(J / lengths, full_matrices=len(J) < T.shape[1])
    lost = axes[int((s > _LOST * s[0]).sum()) :]
    directions = lost / lengths
    size = largest_size(problem.legs, mechanism.platform)
    gain = -np.linalg.pinv(generic.leg_pose) @ generic.leg_parameter
    moved = (directions @ T.T)[:, :n_legs].T
    _, beyond = split_frames(mechanism.platform, generic.matrices, gain, moved, size)
    if beyond.shape[1]:
        lost_words = identifiability(J, unknowns.free_labels).in_words()
        raise ObservabilityError(
            f"what is measured leaves parameters undetermined at any poses: {lost_words}. Measure "
            "more of the platform, or fix one of them, or make it a constant in mechanism.yaml"
        )
    weight = np.array([_weight(label) for label in unknowns.free_labels])
    words = _words(len(lost), mechanism, unknowns, directions @ T.T)
    return Gauge(directions, lost * lengths * weight, words, moved if words else None)


def _weight(label: str) -> float:
    """Return how much a free unknown counts in what is nearest to nominal.

    The frame is taken as it comes; targets too, unless nothing else tells the frame from them.
    """
    if label.startswith("frame "):
        return 0.0
    return 1.0 if " of " in label else _TARGETS


def _generic(mechanism: Mechanism, problem: LatentPoses, unknowns: Unknowns) -> _Generic:
    """Return derivatives at poses moved about those of the start, that all legs reach."""
    platform, rng = mechanism.platform, np.random.default_rng(0)
    start = problem.start(unknowns.start[: problem.columns[-1].stop])
    size = largest_size(problem.legs, platform)
    scale = np.array([size if unit == "m" else 1.0 for unit in platform.units]) * _SPREAD
    observation, parts = problem.observation.anywhere(), []
    chosen = np.arange(len(start.matrices))[:_ROWS]
    observation = observation.rows(chosen)
    for _ in range(-(-_ROWS // len(chosen))):
        twists = scale * rng.standard_normal((len(chosen), platform.dof))
        matrices = platform.displaced(start.matrices[chosen], twists)
        coordinates = platform.from_matrices(matrices)
        demands = [
            leg_demand(mechanism, leg.name, coordinates, start.parameters[columns])
            for leg, columns in zip(problem.legs, problem.columns, strict=True)
        ]
        seen = observation.evaluate(matrices, start.external)
        pose = np.concatenate([d.pose for d in demands], axis=1) / size
        parameter = np.zeros((*pose.shape[:2], problem.columns[-1].stop))
        for index, (demand, columns) in enumerate(zip(demands, problem.columns, strict=True)):
            parameter[:, index, columns] = demand.parameter[:, 0] / size
        outer = np.zeros((*seen.pose.shape[:2], len(unknowns.names)))
        outer[:, :, parameter.shape[2] :] = seen.external
        ok = np.isfinite(pose).all(axis=(1, 2)) & np.isfinite(parameter).all(axis=(1, 2))
        ok &= np.isfinite(seen.pose).all(axis=(1, 2)) & np.isfinite(outer).all(axis=(1, 2))
        parts.append((matrices[ok], pose[ok], parameter[ok], seen.pose[ok], outer[ok]))
    return _Generic(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def _words(
    count: int, mechanism: Mechanism, unknowns: Unknowns, directions: Array
) -> tuple[str, ...]:
    """Return in words what is free."""
    if not count:
        return ()
    if "rad" not in mechanism.platform.units:  # a point has no frame of its own
        return (f"the base frame: {_freedoms(count)}, since what was measured does not fix it",)
    frame = np.array([name.startswith("frame ") for name in unknowns.names])
    n_base = int(np.linalg.matrix_rank(directions[:, frame], tol=1e-6)) if frame.any() else 0
    words = []
    if n_base:
        words.append(
            f"the base frame: {_freedoms(n_base)}, since the frame of the measurements is unknown"
        )
    if count > n_base:
        words.append(
            f"the platform's frame: {_freedoms(count - n_base)}, since what was measured does not "
            "say how the platform's points lie in it"
        )
    return tuple(words)


def _freedoms(count: int) -> str:
    return f"{count} freedom" + ("s" if count > 1 else "")
