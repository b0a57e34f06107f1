"""Motions of the base and of the platform's frame: changes of parameters that are only these.

A base frame that moves by a twist τ moves poses by τ's velocity at the platform's origin; a
platform frame that moves by η moves them by η in platform axes. A change of parameters that
moves all poses so, says where frames lie and nothing about the mechanism.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pincal.errors import ObservabilityError
from pincal.estimation.observability.indices import NEGLIGIBLE, RANK_TOLERANCE
from pincal.kinematics.batches import point_velocity
from pincal.model.platform import Platform

Array = NDArray[np.float64]
_STILL = 1e-7  # motion of the platform below which it is none, of what each parameter would do


def frame_motions(platform: Platform, matrices: Array) -> Array:
    """Return the twists of the platform for unit motions of the frames, shape (N, dof, k).

    Args:
        platform: The platform.
        matrices: Poses ``T_base_platform``, shape (N, 4, 4).
    """
    base, body = np.zeros((2, len(matrices), 6, 6))
    base[:, :3] = point_velocity(matrices[:, :3, 3], tuple(range(6)))
    base[:, 3:, 3:] = np.eye(3)
    body[:, :3, :3] = body[:, 3:, 3:] = matrices[:, :3, :3]
    rows = list(platform.twist_rows)
    frame = [0, 1, 5] if platform.space == 2 else list(range(6))
    return np.concatenate((base[:, :, frame], body[:, :, rows]), axis=2)[:, rows]


def unexplained(platform: Platform, twists: Array, motions: Array, size: float) -> Array:
    """Return twists of the platform less what motions explain of them.

    Least squares over all poses together, angles counting as lengths at a radius.

    Args:
        platform: The platform.
        twists: One column for each change of parameters, shape (N, dof, k).
        motions: Shape (N, dof, m).
        size: The radius, [m].
    """
    scale = np.array([1.0 if unit == "m" else size for unit in platform.units])[:, None]
    count = twists.shape[0] * twists.shape[1]
    flat = (motions * scale).reshape(count, motions.shape[2])
    wanted = (twists * scale).reshape(count, twists.shape[2])
    if not flat.size:
        return twists
    lengths = np.linalg.norm(flat, axis=0)
    U, s, _ = np.linalg.svd(flat / np.where(lengths > 0.0, lengths, 1.0), full_matrices=False)
    U = U[:, s > RANK_TOLERANCE * s[0]]
    return (wanted - U @ (U.T @ wanted)).reshape(twists.shape) / scale


def reach(gain: Array, directions: Array) -> Array:
    """Return how far directions would move the platform if parameters did not compensate, (k,)."""
    return np.linalg.norm(np.abs(gain) @ np.abs(directions), axis=(0, 1))


def still(gain: Array, directions: Array) -> int:
    """Return how many of the directions' combinations do not move the platform at all.

    Args:
        gain: ∂(pose)/∂(parameter), shape (N, dof, n).
        directions: Columns, shape (n, k).
    """
    far = reach(gain, directions)
    moved = (gain @ directions).reshape(-1, directions.shape[1]) / np.where(far > 0.0, far, 1.0)
    s = (
        np.linalg.svd(np.linalg.qr(moved, mode="r"), compute_uv=False)
        if moved.size
        else moved[:0, 0]
    )
    return directions.shape[1] - int((s > _STILL).sum())


def frames_moved(platform: Platform, matrices: Array, gain: Array, directions: Array) -> Array:
    """Return by which motions of the frames directions move the platform, shape (k, n_moved).

    Combinations of the columns of ``frame_motions``: unlike directions of parameters, which only
    move frames at the parameters where they were found, these are frame motions anywhere.
    Directions that do not move the platform have no part in it.

    Args:
        platform: The platform.
        matrices: Poses ``T_base_platform``, shape (N, 4, 4).
        gain: ∂(pose)/∂(parameter) there, shape (N, dof, n).
        directions: Columns that only move frames, shape (n, n_directions).
    """
    motions = frame_motions(platform, matrices)
    flat = motions.reshape(-1, motions.shape[2])
    far = reach(gain, directions)
    moved = (gain @ directions / np.where(far > 0.0, far, 1.0)).reshape(len(flat), -1)
    if not moved.size:
        return np.zeros((motions.shape[2], 0))
    _, s, axes = np.linalg.svd(np.linalg.qr(moved, mode="r"))
    return np.asarray(np.linalg.lstsq(flat, moved @ axes[s > _STILL].T, rcond=None)[0])


def split_frames(
    platform: Platform, matrices: Array, gain: Array, directions: Array, size: float
) -> tuple[Array, Array]:
    """Return the part of directions of parameters that only moves frames, and the other part.

    Args:
        platform: The platform.
        matrices: Poses ``T_base_platform``, shape (N, 4, 4).
        gain: ∂(pose)/∂(parameter), shape (N, dof, n).
        directions: Columns, shape (n, k).
        size: A length of the mechanism, [m].

    Raises:
        ObservabilityError: no pose is held by the legs.
    """
    held = np.isfinite(gain).all(axis=(1, 2))  # not at a type-2 singularity
    if not held.any():
        raise ObservabilityError(
            "the legs do not hold the platform at any of these poses (type-2 singularities), so "
            "what parameters do to it is not determined; take other poses"
        )
    matrices, gain = matrices[held], gain[held]
    moved = gain @ directions
    left = unexplained(platform, moved, frame_motions(platform, matrices), size)
    scale = np.maximum(np.linalg.norm(moved, axis=(0, 1)), _STILL * reach(gain, directions))
    scale[scale == 0.0] = 1.0
    flat = (left / scale).reshape(-1, left.shape[2]) if left.size else np.zeros((1, left.shape[2]))
    flat = np.linalg.qr(flat, mode="r")  # the same singular values and axes, quicker
    _, s, axes = np.linalg.svd(flat, full_matrices=True)
    only = np.ones(directions.shape[1], dtype=bool)
    only[: len(s)] = s <= NEGLIGIBLE
    turned = directions / scale @ axes.T
    return turned[:, only], turned[:, ~only]
