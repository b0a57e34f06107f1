"""What other programs' files do not say: a home in which all legs close, parameters that count.

Files say how bodies hang together, and at which joint positions they were drawn, not that the loops
are closed there. Newton's method on the platform's pose and all joints takes the shortest steps
that close them. Loops of more equations than freedoms close exactly only if every digit is there: a
joint that has to move far for a small gap moves along no freedom, and stays.

A passive joint's zero, or a shift along a joint's axis that the next placement has too, changes
nothing: over random configurations the closure's derivatives by such parameters depend on those by
others. Of the parameters in order, those that add to the rank are kept, ranks cut in a widest gap.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from pincal.errors import MechanismError
from pincal.kinematics.closure import LegClosure, joint_range
from pincal.model.checks import ROUNDING
from pincal.model.leg import Leg
from pincal.model.platform import Platform
from pincal.types import Array

_STEPS, _LARGEST = 100, 0.3  # of Newton's method: how many, and how far at once
_CLOSED = 1e-10  # gap, of the size, of what is closed
_SINGULAR = 1e-10  # of singular values, over the size: none
_CONFIGURATIONS, _ABOUT = 120, 0.3  # how many, and how far about home, [rad] or of the size
_DEPENDS = 1e-7  # of a column, what others leave of it


def assembled(
    legs: Sequence[Leg], platform: Platform, slack: float = 0.0
) -> tuple[tuple[Leg, ...], Platform]:
    """Return the legs with home positions that close them, and the platform at its home pose.

    The legs' home positions are where to start, the platform's home does not count. Cut digits may
    have moved frames by the slack, of a leg's size and [rad].

    Raises:
        MechanismError: no such configuration was found.
    """
    free = Platform.at_origin(platform.kind, platform.twist)
    size = max(leg.size for leg in legs)
    pose, joints, gap = _closed(legs, free, size, _SINGULAR)
    ends = zip(legs, joints, strict=True)
    moved = max(float(np.abs(q[0] - leg.home).max(initial=0.0)) for leg, q in ends)
    far = slack > _SINGULAR and moved > opening(legs, platform) / size / slack
    if far or not gap <= _CLOSED * size:
        pose, joints, gap = _closed(legs, free, size, max(slack, _SINGULAR))
    if not gap <= max(_CLOSED, slack) * size:
        raise MechanismError(
            f"the loops do not close near the joint positions that the file draws: {gap:.3g} m "
            "stay open. Give positions that close them (keyframe of MJCF, 'home' of the YAML "
            "file), or look at the frames of the loops"
        )
    home = free.from_matrices(pose)[0]
    placed = tuple(leg.with_home(q[0]) for leg, q in zip(legs, joints, strict=True))
    return placed, replace(platform, home=tuple(home.tolist()))


def _closed(
    legs: Sequence[Leg], free: Platform, size: float, least: float
) -> tuple[Array, list[Array], float]:
    """Return pose (1, 4, 4) and joints (1, n) of the legs where Newton's method ends, and the gap.

    It starts at the legs' home. Along singular values below the least, over the size of the largest
    leg, [m], nothing moves.
    """
    closures = [LegClosure(leg, free) for leg in legs]
    joints = [leg.home[None].copy() for leg in legs]
    pose = _fitted(closures, joints, free)
    turning = [unit == "rad" for unit in free.units]
    turning += [joint.turns for leg in legs for joint in leg.moving]
    scale = np.where(turning, 1.0, size)
    ends = np.cumsum([free.dof, *(len(leg.moving) for leg in legs)])[:-1]
    gap = np.inf
    for _ in range(_STEPS):
        parts = [closure.evaluate(q, pose) for closure, q in zip(closures, joints, strict=True)]
        gaps = np.concatenate([part.gap[0] for part in parts])
        gap = float(np.abs(gaps).max())
        by_pose = np.concatenate([part.pose[0] for part in parts])
        J = np.hstack((by_pose, block_diag(*(part.by_joints[0] for part in parts))))
        u, values, vt = np.linalg.svd(J * scale / size, full_matrices=False)
        free_to = values > cut_in_gap(values, least)
        step = -scale * (vt[free_to].T @ ((u[:, free_to].T @ gaps / size) / values[free_to]))
        longest = float(np.abs(step).max())
        if gap <= ROUNDING * size or longest <= ROUNDING * max(1.0, size):
            break
        step *= min(1.0, _LARGEST * max(1.0, size) / longest)
        twist, *moves = np.split(step, ends)
        pose = free.displaced(pose, twist[None])
        for q, move in zip(joints, moves, strict=True):
            q[0] += move
    return pose, joints, gap


def cut_in_gap(values: Array, least: float) -> float:
    """Return where singular values end that are freedoms: in the widest gap above what is none.

    Of a matrix whose entries are near one. Rounding reaches the least; the gap is looked for up to
    ten times that.
    """
    if least <= _SINGULAR:
        return least
    near = values[(values > least) & (values < 10.0 * least)]
    ends = np.sort(np.concatenate(([least, 10.0 * least], near)))
    widest = int(np.argmax(np.diff(np.log(ends))))
    return float(np.sqrt(ends[widest] * ends[widest + 1]))


def opening(legs: Sequence[Leg], platform: Platform) -> float:
    """Return how far ends that should meet are apart at home, the platform put in between, [m].

    Where whole frames meet, their turn counts times the leg's size.
    """
    free = Platform.at_origin(platform.kind, platform.twist)
    closures, joints = [LegClosure(leg, free) for leg in legs], [leg.home[None] for leg in legs]
    pose = _fitted(closures, joints, free)
    gaps = [closure.evaluate(q, pose).gap[0] for closure, q in zip(closures, joints, strict=True)]
    ends = np.array([gap[: free.space] for gap in gaps])
    widest = np.linalg.norm(ends[:, None] - ends, axis=2).max()
    return float(max(widest, *(np.linalg.norm(gap[free.space :]) for gap in gaps)))


def _fitted(closures: Sequence[LegClosure], joints: Sequence[Array], platform: Platform) -> Array:
    """Return the pose in which the platform's points are nearest to the tips, shape (1, 4, 4)."""
    for closure, q in zip(closures, joints, strict=True):
        if closure.leg.closes == "frame":
            return closure.frame(q)
    matrix, space = np.eye(4), platform.space
    tips = np.concatenate([closure.tips(q) for closure, q in zip(closures, joints, strict=True)])
    points = np.concatenate([closure.targets(np.eye(4)[None]) for closure in closures])
    if space == 2:
        tips[:, 2] = points[:, 2] = 0.0
    if "rad" in platform.units and len(closures) > 1:  # Kabsch 1976
        M = ((tips - tips.mean(axis=0)).T @ (points - points.mean(axis=0)))[:space, :space]
        u, _, vt = np.linalg.svd(M)
        straight = np.ones(space)
        straight[-1] = np.sign(np.linalg.det(u @ vt)) or 1.0
        matrix[:space, :space] = (u * straight) @ vt
    matrix[:3, 3] = tips.mean(axis=0) - matrix[:3, :3] @ points.mean(axis=0)
    return matrix[None]


def _closed_at_random(closure: LegClosure) -> tuple[Array, Array]:
    """Return joints (N, n_joints) and poses (N, 4, 4) about home at which a tree's ends meet."""
    leg, platform, rng = closure.leg, closure.platform, np.random.default_rng(0)
    shares = rng.uniform(-_ABOUT, _ABOUT, (_CONFIGURATIONS, platform.dof + len(leg.moving)))
    lengths = [leg.size if unit == "m" else 1.0 for unit in platform.units]
    scale = np.concatenate((lengths, leg.scales))
    moves = shares * scale
    poses = np.repeat(platform.home_pose.as_matrix(), _CONFIGURATIONS, axis=0)
    joints = np.tile(leg.home, (_CONFIGURATIONS, 1))
    for _ in range(_STEPS // 5):
        poses = platform.displaced(poses, moves[:, : platform.dof])
        joints = joints + moves[:, platform.dof :]
        part = closure.evaluate(joints, poses)
        J = np.concatenate((part.pose, part.by_joints), axis=2) * scale / leg.size
        inverse = np.linalg.pinv(J, rcond=_DEPENDS)
        moves = -scale * (inverse @ (part.gap / leg.size)[:, :, None])[:, :, 0]
        longest = np.abs(moves / scale).max(axis=1, keepdims=True)
        moves *= _LARGEST / np.maximum(longest, _LARGEST)
    near = np.abs(part.gap).max(axis=1) <= _CLOSED * leg.size
    return joints[near], poses[near]


def independent(
    leg: Leg, platform: Platform, order: tuple[str, ...], slack: float = 0.0
) -> tuple[str, ...]:
    """Return the names of a leg's parameters that are independent of those before them.

    In an order of all names, those to keep rather first. Cut digits may have moved frames by the
    slack, of the leg's size and [rad].
    """
    closure, rng = LegClosure(leg, platform), np.random.default_rng(0)
    joints = rng.uniform(*joint_range(leg), (_CONFIGURATIONS, len(leg.moving)))
    if leg.ends:
        joints, poses = _closed_at_random(closure)
    elif leg.closes == "frame":
        poses = closure.frame(joints)
    else:  # the platform is where the leg puts it, turned at random
        twists = rng.uniform(-np.pi, np.pi, (_CONFIGURATIONS, platform.dof))
        poses = platform.displaced(np.tile(np.eye(4), (_CONFIGURATIONS, 1, 1)), twists)
        poses[:, :3, 3] = closure.tips(joints) - closure.targets(poses)
    rows = closure.evaluate(joints, poses).constraint_by_parameter
    rows = rows.reshape(-1, rows.shape[2])
    scale = np.array([1.0 if leg.units[name] == "m" else 1.0 / closure.size for name in order])
    columns = rows[:, [leg.parameter_names.index(name) for name in order]] * scale
    columns = columns[np.isfinite(columns).all(axis=1)]
    columns = columns / np.sqrt(len(columns))
    least = _DEPENDS
    if slack > _DEPENDS:
        least = cut_in_gap(np.linalg.svd(columns, compute_uv=False), slack)
    names: list[str] = []
    basis = np.empty((len(columns), 0))
    for name, column in zip(order, columns.T, strict=True):
        remainder = column.copy()
        for _ in range(2):  # twice is enough: Gram-Schmidt's rounding errors are gone
            remainder -= basis @ (basis.T @ remainder)
        length = np.linalg.norm(remainder)
        if length > least:
            basis = np.column_stack((basis, remainder / length))
            names.append(name)
    return tuple(names)
