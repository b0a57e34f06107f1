"""Start values for inverse kinematics that lie in the leg's working mode.

Some legs have a closed form. Any other leg is sampled once: of many joint positions in its
mode, the one whose tip is nearest is a start from which Newton's method stays in the
mode. The working mode is the sign of det ∂c/∂(θ, p) at home.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from scipy.spatial import KDTree

from pincal.kinematics.batches import cross
from pincal.kinematics.closed_forms import closed_form
from pincal.kinematics.closure import Closure, LegClosure, joint_range
from pincal.model.leg import Leg
from pincal.model.platform import Platform
from pincal.types import Array, Mask

_SAMPLES = 20_000
_OUT_OF_REACH = 3.0  # times the widest gap between sampled tips: farther tips are out of reach


def start_joints(closure: LegClosure, matrices: Array, attempt: int = 0) -> tuple[Array, Mask]:
    """Return joint positions near those that close the leg, and where that may be possible.

    A planar dyad that cannot reach a pose starts stretched or folded towards it. Shapes
    (N, n_joints), [rad] or [m], and (N,).

    Args:
        closure: The leg at its parameter values.
        matrices: Poses ``T_base_platform``, shape (N, 4, 4).
        attempt: Counts from 0; each gives another sampled start. A closed form has one.
    """
    form = closed_form(closure)
    if form:
        joints, possible = form(closure, closure.targets(matrices))
        return joints, possible & (attempt == 0)
    tree, joints, reach = _samples(closure.leg, closure.platform)
    distance, nearest = tree.query(_places(closure, matrices), [attempt + 1])
    index = np.minimum(nearest[:, 0], len(joints) - 1)  # none is near where a target is infinite
    return joints[index], distance[:, 0] <= reach


@lru_cache(maxsize=64)
def _samples(leg: Leg, platform: Platform) -> tuple[KDTree, Array, float]:
    """Return sampled tips of the leg in its mode, their joints, and how far around it reaches."""
    closure = LegClosure(leg, platform)
    rng = np.random.default_rng(0)
    joints = rng.uniform(*joint_range(leg), (_SAMPLES, len(leg.moving)))
    poses = np.broadcast_to(platform.home_pose.as_matrix(), (_SAMPLES, 4, 4))
    keep = in_home_mode(closure, closure.evaluate(joints, poses))
    joints = joints[keep]
    if leg.closes == "frame":
        tree = KDTree(_places(closure, closure.frame(joints)))
    else:
        tree = KDTree(closure.tips(joints)[:, list(platform.closure_rows)])
    gaps = tree.query(tree.data, [2])[0]
    return tree, joints, _OUT_OF_REACH * float(gaps.max())


def _places(closure: LegClosure, matrices: Array) -> Array:
    """Return where poses put a leg's end, shape (N, k), [m]: its point, and its axes if it turns.

    The axes' tips are as far from the point as the leg is long.
    """
    points = closure.targets(matrices)[:, list(closure.platform.closure_rows)]
    if closure.leg.closes == "point":
        return points
    axes = matrices[:, :3, :3].reshape(len(matrices), 9)
    return np.concatenate((points, closure.size * axes), axis=1)


def mode_sign(closure: Closure) -> Array:
    """Return the sign of det ∂c/∂(θ, p), shape (N,).

    One where the closure is not square, or where no joint is passive: those that are read say
    themselves how the leg bends.
    """
    passive = closure.passive.shape[2]
    if closure.active.shape[2] + passive != closure.gap.shape[1] or not passive:
        return np.ones(len(closure.gap))
    columns = [*closure.active.transpose(2, 0, 1), *closure.passive.transpose(2, 0, 1)]
    if len(columns) == 2:
        (a, b), (c, d) = (column.T for column in columns)
        return np.sign(a * d - b * c)
    if len(columns) == 3:
        first, second, third = columns
        return np.sign((first * cross(second, third)).sum(axis=1))
    return np.sign(np.linalg.det(np.stack(columns, axis=2)))


def in_home_mode(leg: LegClosure, closure: Closure) -> Mask:
    """Return where a closure of a leg is in the leg's working mode, shape (N,)."""
    return in_home_modes((leg,), closure)


def in_home_modes(legs: Sequence[LegClosure], closure: Closure) -> Mask:
    """Return where closures of alike legs are in their working modes, shape (L N,)."""
    signs = mode_sign(closure)
    own = np.repeat([_home_mode(leg) for leg in legs], len(signs) // len(legs))
    return np.asarray(signs == own)


@lru_cache(maxsize=256)
def _home_mode(leg: LegClosure) -> float:
    return home_mode(leg.leg, leg.platform)


@lru_cache(maxsize=256)
def home_mode(leg: Leg, platform: Platform) -> float:
    """Return the sign of det ∂c/∂(θ, p) in the home configuration: the leg's working mode."""
    closure = LegClosure(leg, platform).evaluate(leg.home[None], platform.home_pose.as_matrix())
    return float(mode_sign(closure)[0])
