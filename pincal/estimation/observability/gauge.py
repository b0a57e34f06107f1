"""Gauge freedoms: motions of frames that no measurement of this kind can observe.

If the base is at an unknown place in the tracker's frame, moving the base frame together with all
base points changes nothing that is measured; nor does turning the platform's frame if its
orientation is not measured. Such directions are those that generic poses leave undetermined. They
differ from redundant parameters by the motion of the platform that they cause. A choice fixes them:
of all equivalent parameters those nearest to the nominal ones, each change relative to how much
machines differ from their drawings. So the choice depends on the machine only, not on where or how
it was measured.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pincal.errors import ObservabilityError
from pincal.estimation.observability.identifiable import (
    DIFFER,
    NEGLIGIBLE,
    RANK_TOLERANCE,
    axes_of,
    identifiability,
    jacobian_near,
    lost_directions,
    plausible_changes,
)
from pincal.estimation.problem import Problem
from pincal.estimation.unknowns import Unknowns
from pincal.finding import Finding
from pincal.kinematics.batches import point_velocity
from pincal.model import Mechanism, Platform, Setup
from pincal.types import Array
from pincal.words.findings import finding

_STILL = 1e-7  # platform motion, over the sum of each parameter's, below which there is none


def frame_motions(platform: Platform, matrices: Array, *, scaled: bool = True) -> Array:
    """Return the twists of the platform for unit motions of base and platform frame, (N, dof, k).

    The last column is for growth of all lengths, which contacts and cameras do not see; it is zero
    unless ``scaled``.
    """
    base, body = np.zeros((2, len(matrices), 6, 6))
    base[:, :3] = point_velocity(matrices[:, :3, 3], tuple(range(6)))
    base[:, 3:, 3:] = np.eye(3)
    body[:, :3, :3] = body[:, 3:, 3:] = matrices[:, :3, :3]
    rows = list(platform.twist_rows)
    frame = [0, 1, 5] if platform.space == 2 else list(range(6))
    grown = scaled * np.pad(matrices[:, :3, 3:], ((0, 0), (0, 3), (0, 0)))
    return np.concatenate((base[:, :, frame], body[:, :, rows], grown), axis=2)[:, rows]


def unexplained(units: Sequence[str], twists: Array, motions: Array, size: float) -> Array:
    """Return the part of twists (N, dof, k) of the platform that motions (N, dof, m) do not span.

    It is by least squares over all poses, angles counting as lengths at a radius ``size``.
    """
    if not motions.size:
        return twists
    scale = np.array([1.0 if unit == "m" else size for unit in units])[:, None]
    count = twists.shape[0] * twists.shape[1]
    flat = (motions * scale).reshape(count, motions.shape[2])
    targets = (twists * scale).reshape(count, twists.shape[2])
    lengths = np.linalg.norm(flat, axis=0)
    U, s, _ = np.linalg.svd(flat / np.where(lengths > 0.0, lengths, 1.0), full_matrices=False)
    U = U[:, s > RANK_TOLERANCE * s[0]]
    return (targets - U @ (U.T @ targets)).reshape(twists.shape) / scale


def split_frames(
    mechanism: Mechanism, matrices: Array, gain: Array, directions: Array, *, scaled: bool
) -> tuple[Array, Array, Array]:
    """Split directions of parameters, columns (n, k), into those that only move frames and others.

    Also return the motions of the former as combinations of the columns of ``frame_motions``, (k,
    n_moved), without those that move no platform. ``gain``, (N, dof, n), is ∂(pose)/∂(parameter) at
    poses ``T_base_platform``, (N, 4, 4). Frames may grow if ``scaled``.

    Raises:
        ObservabilityError: the legs hold the platform at none of the poses.
    """
    held = np.isfinite(gain).all(axis=(1, 2))  # not at a type-2 singularity
    if not held.any():
        raise ObservabilityError(
            "the legs do not hold the platform at any of these poses (type-2 singularities), so "
            "what parameters do to it is not determined; take other poses"
        )
    platform, gain = mechanism.platform, gain[held]
    motions = frame_motions(platform, matrices[held], scaled=scaled)
    moved = gain @ directions
    scale = np.maximum(np.linalg.norm(moved, axis=(0, 1)), _STILL * _reach(gain, directions))
    scale[scale == 0.0] = 1.0
    s, axes = axes_of(unexplained(platform.units, moved, motions, mechanism.size) / scale)
    turned = directions / scale @ axes.T
    gauge, others = turned[:, s <= NEGLIGIBLE], turned[:, s > NEGLIGIBLE]
    far = _reach(gain, gauge)
    moved = gain @ gauge / np.where(far > 0.0, far, 1.0)
    s, axes = axes_of(moved)
    flat = motions.reshape(-1, motions.shape[2])
    along = moved.reshape(len(flat), gauge.shape[1]) @ axes[s > _STILL].T
    return gauge, others, np.asarray(np.linalg.lstsq(flat, along, rcond=None)[0])


def _reach(gain: Array, directions: Array) -> Array:
    """Return the platform's motion by directions if parameters did not compensate, shape (k,)."""
    return np.linalg.norm(np.abs(gain) @ np.abs(directions), axis=(0, 1))


_TARGETS = 1e-6  # weight of targets' changes, beside parameters', in the distance from nominal


class Gauge(NamedTuple):
    """Directions that only move frames."""

    constraints: Array
    """Rows g with g · z = 0 that fix them, shape (n_gauge, n_free)."""
    found: tuple[Finding, ...]
    """Findings that name the freedoms that were fixed by choice."""
    of_legs: Array | None
    """The directions of the legs' parameters as columns, (n_params, n_gauge); None without any."""
    frames: Array
    """Motions of frames by these directions (see ``split_frames``), shape (k, n_moved)."""


def find_gauge(mechanism: Mechanism, problem: Problem, unknowns: Unknowns) -> Gauge:
    """Return the gauge freedoms of a problem at its start.

    Raises:
        ObservabilityError: measurements of this kind determine no parameter at any poses.
    """
    platform, T = mechanism.platform, unknowns.map
    legs, J = jacobian_near(mechanism, problem, unknowns)
    if not len(legs.poses):
        raise ObservabilityError(
            "no machine near the nominal one reaches the poses as measured; check their frame, "
            "their units, and that this is the right mechanism"
        )
    lost, lengths = lost_directions(J)
    size, n_legs, gain = problem.size, legs.parameter.shape[2], legs.gain
    matrices, scaled = platform.matrices(legs.poses), problem.observation.setup.frameless
    every_gain = np.pad(gain, ((0, 0), (0, 0), (0, len(T) - n_legs)))
    directions = T @ (lost / lengths).T
    gauge, inside, frames = split_frames(mechanism, matrices, every_gain, directions, scaled=scaled)
    if not problem.equations.any() or (inside.shape[1] and len(lost) == T.shape[1]):
        raise ObservabilityError(
            "what is measured determines no parameter: readings that are no more than the "
            "platform's freedoms fit any machine. Measure the platform, or a part of its pose, or "
            "distances"
        )
    outside, of_legs = problem.observation.external, plausible_changes(mechanism)
    U, shares, _ = np.linalg.svd(gauge[:n_legs] / of_legs[:, None], full_matrices=False)
    # frame and target, or camera and markers, may move together without the legs
    moved = U[:, shares > NEGLIGIBLE * shares.max(initial=0.0)] * of_legs[:, None]
    n_still = moved.shape[1] - frames.shape[1]
    findings = _freedoms(frames, mechanism, problem.observation.setup)
    if n_still:
        groups = identifiability(gain.reshape(-1, n_legs), unknowns.labels[:n_legs]).groups
        findings.append(finding("redundant-parameters", count=n_still, groups=groups))
    # weights of squared changes in the distance from nominal: frames none, targets little
    counts = [0.0 if name.startswith("tracker.") else _TARGETS for name in outside.names]
    weights = np.concatenate(
        (1.0 / of_legs**2, np.array(counts) / (DIFFER * outside.sizes(size)) ** 2)
    )
    return Gauge((gauge.T * weights) @ T, tuple(findings), moved if findings else None, frames)


def _freedoms(frames: Array, mechanism: Mechanism, setup: Setup) -> list[Finding]:
    """Return findings of the free frames, with numbers of freedoms, and of a free scale."""
    least, findings = NEGLIGIBLE * np.abs(frames).max(initial=0.0), list[Finding]()
    grows = bool((np.abs(frames[-1]) > least).any())
    count, n_base = frames.shape[1] - grows, 0
    if setup.unknown_frame or setup.frameless:
        n_base = int(np.linalg.matrix_rank(frames[: -1 - mechanism.platform.dof], tol=least))
    if "rad" not in mechanism.platform.units:  # a point has no frame of its own
        n_base = count
    if n_base:
        free = setup.unknown_frame
        findings.append(finding("gauge-base-frame", freedoms=n_base, unknown_frame=free))
    if count > n_base:
        findings.append(finding("gauge-platform-frame", freedoms=count - n_base))
    return findings + [finding("gauge-scale")] * grows
