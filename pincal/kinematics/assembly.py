"""Home configurations in which all legs close, and independent parameters, of imported files.

Loops with more equations than freedoms close exactly only if the file has all digits: where a small
gap asks for a long motion, that direction is no freedom, and joints do not move along it. A passive
joint's zero changes nothing, nor does a shift along its axis that the next placement has, too. Of
the parameters in order those are taken that add to the rank of the closure's derivatives.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pincal.errors import MechanismError
from pincal.kinematics.batches import block_diagonal, motion_of_points
from pincal.kinematics.closing import sensor_law, started
from pincal.kinematics.closure import LegClosure, joint_range, nominal_legs
from pincal.model import Leg, Mechanism, Platform
from pincal.model.checks import ROUNDING, wrapped
from pincal.types import Array, Mask

_STEPS, _LARGEST = 100, 0.3  # most steps of Newton's method, and longest step, [rad] or size
_STARTS, _WIDEST = 32, 1.5  # further starts, and their range about the drawing, [rad] or size
_CLOSED = 1e-10  # largest gap of closed legs over the size
_SINGULAR = 1e-10  # largest singular value over the size that counts as zero
_ERRORS = 1e-3  # share of the largest singular value that errors of a machine may make, to 1e-2
_CONFIGURATIONS, _ABOUT = 120, 0.3  # their number, and range about home, [rad] or size
_GRIP = 0.1  # share of the usual motion of ends by passive joints, below which they are singular
_IDLE = 1e-4  # singular value over the size, below which joints usually do not move ends
_SAME = 1e-2  # largest difference of joints of one branch, [rad] or [m]
_DEPENDS = 1e-7  # share of a column that others leave of it, below which it depends on them


def assembled(
    legs: Sequence[Leg], platform: Platform, slack: float = 0.0
) -> tuple[tuple[Leg, ...], Platform]:
    """Return the legs with home positions that close them, and the platform at its home pose.

    The search starts from the legs' home positions, and from others about them within the limits
    if these do not close there. The nearest configuration is taken, if possible within the limits
    and, where loops are drawn open, not singular. The platform's home is ignored. Cut digits may
    have moved frames by the slack, relative to a leg's size and in [rad].

    Raises:
        MechanismError: no such configuration was found.
    """
    free = Platform.at_origin(platform.kind, platform.twist)
    closures, size = [LegClosure(leg, free) for leg in legs], max(leg.size for leg in legs)
    home, scales = (np.concatenate([getattr(leg, k) for leg in legs]) for k in ("home", "scales"))
    low, high = np.concatenate([joint_range(leg) for leg in legs], axis=1)
    enough = max(slack, _CLOSED) * size
    poses, joints, gaps = _closed(closures, _fitted(closures, home[None]), home[None], _SINGULAR)
    far = np.abs(joints - home).max() * size * slack > opening(legs, free)
    shares = np.random.default_rng(0).uniform(-1.0, 1.0, (_STARTS, len(home)))
    starts = home + np.linspace(0.0, _WIDEST, _STARTS)[:, None] * scales * shares
    starts = np.clip(starts, low, high)
    drawn = np.concatenate([_fitted(closures, start[None]) for start in starts])
    drawn_open = opening(legs, free) > enough
    far |= drawn_open and _singular(closures, poses, joints, drawn, starts).any()
    if far or gaps[0] > _CLOSED * size or (joints != np.clip(joints, low, high)).any():
        further = _closed(closures, drawn, starts, max(slack, _SINGULAR), low, high)
        poses, joints, gaps = map(np.concatenate, zip((poses, joints, gaps), further, strict=True))
    outside = (joints != np.clip(joints, low, high)).any(axis=1)
    moved = (np.abs(joints - home) / scales).max(axis=1)
    singular = drawn_open & _singular(closures, poses, joints, drawn, starts)
    best = int(np.lexsort((moved, outside, singular, np.where(gaps > enough, gaps, 0.0)))[0])
    if not gaps[best] <= enough:
        raise MechanismError(
            "the loops do not close near the joint positions that the file draws: "
            f"{_widest(closures, poses[[best]], joints[[best]])}. Give positions that close them "
            "(keyframe of MJCF, 'home' of the YAML file), or look at the loops' frames and types"
        )
    pose, parts = free.from_matrices(poses[[best]])[0], _parts(closures, joints[[best]])
    pairs = zip(legs, parts, strict=True)
    closed = tuple(replace(leg.with_home(q[0]), settled=False) for leg, q in pairs)
    return closed, replace(platform, home=tuple(pose.tolist()))


def closed_near(
    mechanism: Mechanism, poses: Array, readings: Array, influences: Array
) -> tuple[Array, Array, Mask]:
    """Return poses and readings near given ones at which all legs close, and which rows do.

    More drives than freedoms may contradict each other, fewer leave freedoms open. Poses and
    readings must lead from home to the same branch of all loops, as those measured there will.
    Shapes are (N, dof), (N, n_readings) and (N, n_influences); deformations are ignored.
    """
    legs, matrices = nominal_legs(mechanism), mechanism.platform.matrices(poses)
    known = [mechanism.known(place, readings, influences) for place in range(len(legs))]
    drawn = [started((leg,), matrices, rows) for leg, rows in zip(legs, known, strict=True)]
    matrices, joints, gaps = _closed(legs, matrices, np.hstack(drawn), _SINGULAR)
    parts = _parts(legs, joints)
    read = [
        sensor_law(leg).reading(q[:, leg.leg.active], rows[:, len(leg.leg.sensors) :])
        for leg, q, rows in zip(legs, parts, known, strict=True)
    ]
    readings, closes = np.hstack(read), gaps <= _CLOSED * mechanism.size
    for place, (leg, q) in enumerate(zip(legs, parts, strict=True)):
        if leg.leg.ends:
            rows = np.flatnonzero(closes)
            at_rows = mechanism.known(place, readings[rows], influences[rows])
            led = started((leg,), matrices[rows], at_rows)
            closes[rows] = np.abs(wrapped(led - q[rows])).max(axis=1) <= _SAME
    return mechanism.platform.from_matrices(matrices), readings, closes


def mobility(mechanism: Mechanism) -> int:
    """Return the number of freedoms of joints and platform at home while all legs close.

    Errors of a machine make redundant equations differ slightly, which does not constrain it.
    """
    home = mechanism.platform.home_pose.as_matrix()
    joints = np.hstack([leg.home for leg in mechanism.legs])[None]
    rows = _linearised(nominal_legs(mechanism), home, joints)[1][0]
    lengths = np.linalg.norm(rows, axis=0)
    sizes = np.linalg.svd(rows / np.where(lengths > 0.0, lengths, 1.0), compute_uv=False)
    return rows.shape[1] - int((sizes > cut_in_gap(sizes, _ERRORS * sizes[0])).sum())


def _parts(closures: Sequence[LegClosure], joints: Array) -> list[Array]:
    """Return the joint positions of each leg, (N, n_joints), of those of all, (N, n)."""
    return np.split(joints, np.cumsum([len(c.leg.moving) for c in closures])[:-1], axis=1)


def _linearised(closures: Sequence[LegClosure], poses: Array, joints: Array) -> tuple[Array, Array]:
    """Return gaps of all legs, (N, m), and derivatives by pose and joints, (N, m, dof + n)."""
    by_leg = zip(closures, _parts(closures, joints), strict=True)
    parts = [closure.evaluate(q, poses) for closure, q in by_leg]
    by_pose = np.concatenate([part.pose for part in parts], axis=1)
    J = np.concatenate((by_pose, block_diagonal([part.by_joints for part in parts])), axis=2)
    return np.concatenate([part.gap for part in parts], axis=1), J


def _singular(
    closures: Sequence[LegClosure], poses: Array, joints: Array, drawn: Array, starts: Array
) -> Mask:
    """Return where passive joints of a leg move its ends less than they usually do, shape (N,).

    Usual is the median at drawn poses (M, 4, 4) and starts (M, n); idle joints do not count.
    """
    count, singular = len(joints), np.zeros(len(joints), dtype=bool)
    every = np.concatenate((poses, drawn))
    for closure, q in zip(closures, _parts(closures, np.vstack((joints, starts))), strict=True):
        values = np.linalg.svd(closure.evaluate(q, every).passive, compute_uv=False)
        usual = np.median(values[count:], axis=0)
        less = (values[:count] < _GRIP * usual) & (usual > _IDLE * closure.size)
        singular |= less.any(axis=1)
    return singular


def _widest(closures: Sequence[LegClosure], pose: Array, joints: Array) -> str:
    """Return a text on the largest gap, and on conditions that no motion of the joints can meet."""
    (gaps,), (J,) = _linearised(closures, pose, joints)
    ends = [(closure, end) for closure in closures for end in closure.leg.every_end]
    counts = np.cumsum([len(closure.platform.closing(end)) for closure, end in ends])
    largest = [np.abs(rows).max() for rows in np.split(gaps, counts[:-1])]
    closure, end = ends[int(np.argmax(largest))]
    met = f"{end.tip!r} and " + ("the platform" if end.point else repr(end.frames[-1]))
    rank = int(np.linalg.matrix_rank(J, tol=_IDLE * closure.size))
    more = f", and joints can meet {rank} of all {len(gaps)} conditions" * (rank < len(gaps))
    return f"{max(largest):.3g} m stay open between {met}{more}"


def _closed(
    closures: Sequence[LegClosure], poses: Array, joints: Array, least: float, *limits: Array
) -> tuple[Array, Array, Array]:
    """Return poses (N, 4, 4) and joints of all legs (N, n), closed nearby, and largest gaps, (N,).

    Directions of singular values below ``least``, over the size of the largest leg, do not move.
    Limits, (n,) each, hold for the first half of the steps. Full turns are removed at the end.
    """
    platform, size = closures[0].platform, max(closure.size for closure in closures)
    turning = [unit == "rad" for unit in platform.units]
    turning += [joint.turns for closure in closures for joint in closure.leg.moving]
    scale = np.where(turning, 1.0, size)
    poses, joints, moving = poses.copy(), joints.copy(), np.arange(len(joints))
    largest = np.empty(len(joints))
    for step in range(_STEPS):
        gaps, J = _linearised(closures, poses[moving], joints[moving])
        u, values, vt = np.linalg.svd(J * scale / size, full_matrices=False)
        cuts = np.array([[cut_in_gap(of_row, least)] for of_row in values])
        with np.errstate(divide="ignore"):
            inverse = np.where(values > cuts, 1.0 / values, 0.0)[:, :, None]
        along = inverse * (u.transpose(0, 2, 1) @ gaps[:, :, None] / size)
        steps = -scale * (vt.transpose(0, 2, 1) @ along)[:, :, 0]
        largest[moving], longest = np.abs(gaps).max(axis=1), np.abs(steps).max(axis=1)
        far = (largest[moving] > ROUNDING * size) & (longest > ROUNDING * max(1.0, size))
        if not far.any():
            break
        steps *= np.minimum(1.0, _LARGEST * max(1.0, size) / np.maximum(longest, 1e-300))[:, None]
        moving, (twists, moves) = moving[far], np.split(steps[far], [platform.dof], axis=1)
        poses[moving] = platform.displaced(poses[moving], twists)
        joints[moving] += moves
        if limits and step < _STEPS // 2:
            joints[moving] = np.clip(joints[moving], *limits)
    middle = np.concatenate([joint_range(closure.leg) for closure in closures], axis=1).mean(axis=0)
    turns = np.round((joints - middle) / (2 * np.pi)) * turning[platform.dof :]
    return poses, joints - 2 * np.pi * turns, largest


def cut_in_gap(values: Array, least: float) -> float:
    """Return the bound of zero singular values, in their widest gap up to ten times the least."""
    if least <= _SINGULAR:
        return least
    ends = np.sort(np.clip([least, 10.0 * least, *values], least, 10.0 * least))
    widest = int(np.argmax(np.diff(np.log(ends))))
    return float(np.sqrt(ends[widest] * ends[widest + 1]))


def opening(legs: Sequence[Leg], platform: Platform) -> float:
    """Return the distance at home of ends that should meet, [m], with the platform between them."""
    free = Platform.at_origin(platform.kind, platform.twist)
    closures, home = [LegClosure(leg, free) for leg in legs], np.hstack([leg.home for leg in legs])
    pose, parts = _fitted(closures, home[None]), _parts(closures, home[None])
    gaps = [closure.evaluate(q, pose).gap[0] for closure, q in zip(closures, parts, strict=True)]
    ends = np.array([gap[: free.space] for gap in gaps])
    widest = np.linalg.norm(ends[:, None] - ends, axis=2).max()
    return float(max(widest, *(np.linalg.norm(gap[free.space :]) for gap in gaps)))


def _fitted(closures: Sequence[LegClosure], joints: Array) -> Array:
    """Return the pose in which the platform's points are nearest to the tips, shape (1, 4, 4)."""
    platform = closures[0].platform
    by_leg = list(zip(closures, _parts(closures, joints), strict=True))
    for closure, q in by_leg:
        if closure.leg.closes == "frame":
            return closure.frame(q)
    tips = np.concatenate([closure.tips(q) for closure, q in by_leg])
    points = np.concatenate([closure.targets(np.eye(4)[None]) for closure in closures])
    if platform.space == 2:
        tips[:, 2] = points[:, 2] = 0.0
    if "rad" in platform.units and len(closures) > 1:
        return motion_of_points(points, tips, platform.space)[None]
    matrix = np.eye(4)
    matrix[:3, 3] = (tips - points).mean(axis=0)
    return matrix[None]


def independent(
    leg: Leg, platform: Platform, order: tuple[str, ...], slack: float = 0.0
) -> tuple[str, ...]:
    """Return the names of a leg's parameters, in an order, that depend on none before them.

    Cut digits may have moved frames by the slack, relative to the leg's size and in [rad].
    """
    closure, rng = LegClosure(leg, platform), np.random.default_rng(0)
    lengths = [leg.size if unit == "m" else 1.0 for unit in platform.units]
    moves = rng.uniform(-_ABOUT, _ABOUT, (_CONFIGURATIONS, platform.dof + len(leg.moving)))
    twists, shifts = np.split(moves, [platform.dof], axis=1)
    homes = np.repeat(platform.home_pose.as_matrix(), _CONFIGURATIONS, axis=0)
    drawn = platform.displaced(homes, twists * lengths)
    poses, joints, gaps = _closed([closure], drawn, leg.home + shifts * leg.scales, _SINGULAR)
    joints, poses = (part[gaps <= _CLOSED * leg.size] for part in (joints, poses))
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
