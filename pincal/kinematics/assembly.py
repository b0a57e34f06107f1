"""What other programs' files do not say: a home in which all legs close, parameters that count.

Loops of more equations than freedoms close exactly only if every digit is there: a joint that has
to move far for a small gap moves along no freedom, and stays. A passive joint's zero, or a shift
along a joint's axis that the next placement has too, changes nothing: of the parameters in order,
those are kept that add to the rank of the closure's derivatives, ranks cut in a widest gap.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pincal.errors import MechanismError
from pincal.kinematics.batches import block_diagonal, turn_of_points
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
    closures, homes = [LegClosure(leg, free) for leg in legs], [leg.home[None] for leg in legs]
    drawn = _fitted(closures, homes, free)
    pose, joints, gap = _closed(closures, drawn, homes, _SINGULAR)
    ends = zip(homes, joints, strict=True)
    moved = max(float(np.abs(q - home).max(initial=0.0)) for home, q in ends)
    far = slack > _SINGULAR and moved > opening(legs, platform) / size / slack
    if far or not gap[0] <= _CLOSED * size:
        pose, joints, gap = _closed(closures, drawn, homes, max(slack, _SINGULAR))
    if not gap[0] <= max(_CLOSED, slack) * size:
        raise MechanismError(
            f"the loops do not close near the joint positions that the file draws: {gap[0]:.3g} m "
            "stay open. Give positions that close them (keyframe of MJCF, 'home' of the YAML "
            "file), or look at the frames of the loops"
        )
    home = free.from_matrices(pose)[0]
    placed = tuple(leg.with_home(q[0]) for leg, q in zip(legs, joints, strict=True))
    return placed, replace(platform, home=tuple(home.tolist()))


def _closed(
    closures: Sequence[LegClosure], poses: Array, joints: Sequence[Array], least: float
) -> tuple[Array, list[Array], Array]:
    """Return poses (N, 4, 4) and joints (N, n) of each leg, closed nearby, and largest gaps, (N,).

    Along singular values below the least, over the size of the largest leg, [m], nothing moves.
    """
    platform, size = closures[0].platform, max(closure.size for closure in closures)
    turning = [unit == "rad" for unit in platform.units]
    turning += [joint.turns for closure in closures for joint in closure.leg.moving]
    scale = np.where(turning, 1.0, size)
    ends = np.cumsum([platform.dof, *(q.shape[1] for q in joints)])[:-1]
    for _ in range(_STEPS):
        parts = [closure.evaluate(q, poses) for closure, q in zip(closures, joints, strict=True)]
        gaps = np.concatenate([part.gap for part in parts], axis=1)
        by_pose = np.concatenate([part.pose for part in parts], axis=1)
        J = np.concatenate((by_pose, block_diagonal([part.by_joints for part in parts])), axis=2)
        u, values, vt = np.linalg.svd(J * scale / size, full_matrices=False)
        cuts = np.array([[cut_in_gap(of_row, least)] for of_row in values])
        with np.errstate(divide="ignore"):
            inverse = np.where(values > cuts, 1.0 / values, 0.0)[:, :, None]
        along = inverse * (u.transpose(0, 2, 1) @ gaps[:, :, None] / size)
        steps = -scale * (vt.transpose(0, 2, 1) @ along)[:, :, 0]
        largest, longest = np.abs(gaps).max(axis=1), np.abs(steps).max(axis=1)
        if ((largest <= ROUNDING * size) | (longest <= ROUNDING * max(1.0, size))).all():
            break
        steps *= np.minimum(1.0, _LARGEST * max(1.0, size) / np.maximum(longest, 1e-300))[:, None]
        twists, *moves = np.split(steps, ends, axis=1)
        poses = platform.displaced(poses, twists)
        joints = [q + move for q, move in zip(joints, moves, strict=True)]
    return poses, list(joints), largest


def cut_in_gap(values: Array, least: float) -> float:
    """Return where freedoms' singular values end: in the widest gap up to ten times the least."""
    if least <= _SINGULAR:
        return least
    near = values[(values > least) & (values < 10.0 * least)]
    ends = np.sort(np.concatenate(([least, 10.0 * least], near)))
    widest = int(np.argmax(np.diff(np.log(ends))))
    return float(np.sqrt(ends[widest] * ends[widest + 1]))


def opening(legs: Sequence[Leg], platform: Platform) -> float:
    """Return how far ends that should meet are apart at home, [m], the platform put in between."""
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
    matrix = np.eye(4)
    tips = np.concatenate([closure.tips(q) for closure, q in zip(closures, joints, strict=True)])
    points = np.concatenate([closure.targets(np.eye(4)[None]) for closure in closures])
    if platform.space == 2:
        tips[:, 2] = points[:, 2] = 0.0
    if "rad" in platform.units and len(closures) > 1:
        matrix[:3, :3] = turn_of_points(points, tips, platform.space)
    matrix[:3, 3] = tips.mean(axis=0) - matrix[:3, :3] @ points.mean(axis=0)
    return matrix[None]


def independent(
    leg: Leg, platform: Platform, order: tuple[str, ...], slack: float = 0.0
) -> tuple[str, ...]:
    """Return the names of a leg's parameters, in an order, that depend on none before them.

    Cut digits may have moved frames by the slack, of the leg's size and [rad].
    """
    closure, rng = LegClosure(leg, platform), np.random.default_rng(0)
    joints = rng.uniform(*joint_range(leg), (_CONFIGURATIONS, len(leg.moving)))
    if leg.ends:  # closed about home
        lengths = [leg.size if unit == "m" else 1.0 for unit in platform.units]
        moves = rng.uniform(-_ABOUT, _ABOUT, (_CONFIGURATIONS, platform.dof + len(leg.moving)))
        twists, shifts = np.split(moves, [platform.dof], axis=1)
        homes = np.repeat(platform.home_pose.as_matrix(), _CONFIGURATIONS, axis=0)
        drawn = platform.displaced(homes, twists * lengths)
        poses, (joints,), gaps = _closed(
            [closure], drawn, [leg.home + shifts * leg.scales], _SINGULAR
        )
        near = gaps <= _CLOSED * leg.size
        joints, poses = joints[near], poses[near]
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
