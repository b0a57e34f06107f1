"""Inverse kinematics of legs in their working modes, and the readings of their sensors.

Newton's method closes a leg from a start in its working mode, which is the sign of det ∂c/∂(θ, p)
at home. The start is a closed form, or follows the platform from home, or is the nearest of sampled
tips. Joints are NaN where a leg cannot reach the pose in its mode. A homed sensor counts from the
joint's position at the platform's home pose, which is found by closing the leg there.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple, TypeVar

import numpy as np
from scipy.spatial import KDTree

from pincal.errors import MechanismError
from pincal.kinematics.batches import cross, least_squares, parted, product, repeated, stacked
from pincal.kinematics.closed_forms import closed_form
from pincal.kinematics.closure import Closure, LegClosure, each, evaluate, joint_range
from pincal.model import Leg, Platform
from pincal.model.checks import EXACT, ROUNDING, wrapped
from pincal.model.sensor import SensorLaw, law_of_sensors
from pincal.types import Array, Mask

Group = TypeVar("Group")

_SAMPLES = 20_000
_WAY, _ABOUT = 10, 0.3  # steps of a tree on its way from home; largest step, [rad] or of the size
_ALIKE = 8  # nearest sampled tips, among which the one bent most as at home is the start
_OUT_OF_REACH = 3.0  # reach around the sampled tips, over the widest gap between them


def start_joints(closure: LegClosure, matrices: Array, attempt: int = 0) -> tuple[Array, Mask]:
    """Return joints from which to search, (N, n_joints), and the mask of poses within reach, (N,).

    Each attempt, from 0, gives another sampled start. Positions are in [rad] or [m].
    """
    form = closed_form(closure)
    if form:
        joints, possible = form.joints(closure.targets(matrices))
        return joints, possible & (attempt == 0)
    if closure.leg.ends or (closure.leg.passive and not attempt):  # its branch goes on from home
        joints = _followed(closure, matrices)
        return joints, np.full(len(joints), attempt == 0)
    tree, joints, reach = _samples(closure.leg, closure.platform)
    turning = [i for i in closure.leg.passive if not closure.leg.moving[i].limited]
    count = _ALIKE if turning else 1  # a mode may have several solutions
    columns = list(range(attempt + 1, attempt + 1 + count))
    distance, nearest = tree.query(_places(closure, matrices), columns)
    index = np.minimum(nearest, len(joints) - 1)  # an infinite target has no neighbour
    if count > 1:
        bent = np.abs(wrapped(joints[index][:, :, turning] - closure.leg.home[turning])).sum(axis=2)
        bent[distance > 2.0 * distance[:, :1] + reach / _OUT_OF_REACH] = np.inf
        index = np.take_along_axis(index, bent.argmin(axis=1)[:, None], axis=1)
    return joints[index[:, 0]], distance[:, 0] <= reach


def _followed(closure: LegClosure, matrices: Array, active: Array | None = None) -> Array:
    """Return joints that follow the platform on a straight way from home to poses (N, 4, 4).

    Passive joints close the leg on the way. Active joints go straight to ``active``, (N, n_active),
    if it is given; otherwise they close the leg too.
    """
    leg, platform, count = closure.leg, closure.platform, len(matrices)
    homes, joints = np.tile(platform.home, (count, 1)), np.tile(leg.home, (count, 1))
    poses, free = platform.matrices(homes), leg.passive
    twists = platform.twists_between(homes, platform.from_matrices(matrices))
    if active is None:
        active, free = joints[:, leg.active], list(range(len(leg.moving)))
    for share in np.repeat((1.0, 0.0), _WAY) / _WAY:  # the last steps let joints settle
        poses = platform.displaced(poses, share * twists)
        joints[:, leg.active] += share * (active - leg.home[leg.active])
        closed = closure.evaluate(closure.deformed(joints), poses)
        step = -least_squares(closed.by_joints[:, :, free], closed.gap[:, :, None])[:, :, 0]
        step = np.nan_to_num(step / leg.scales[free], posinf=0.0, neginf=0.0)
        longest = np.abs(step).max(axis=1, keepdims=True)
        joints[:, free] += step * leg.scales[free] * _ABOUT / np.maximum(longest, _ABOUT)
        if not share and longest.max(initial=0.0) <= EXACT:
            break
    return joints


@lru_cache(maxsize=64)
def _samples(leg: Leg, platform: Platform) -> tuple[KDTree, Array, float]:
    """Return a tree of sampled tips in the leg's mode, their joints, and the reach around them."""
    closure = LegClosure(leg, platform)
    joints = np.random.default_rng(0).uniform(*joint_range(leg), (_SAMPLES, len(leg.moving)))
    poses = np.broadcast_to(platform.home_pose.as_matrix(), (_SAMPLES, 4, 4))
    joints = joints[in_home_modes((closure,), closure.evaluate(joints, poses))]
    if leg.closes == "frame":
        tree = KDTree(_places(closure, closure.frame(joints)))
    else:
        tree = KDTree(closure.tips(joints)[:, : platform.space])
    gaps = tree.query(tree.data, [2])[0]
    return tree, joints, _OUT_OF_REACH * float(gaps.max())


def _places(closure: LegClosure, matrices: Array) -> Array:
    """Return the end's point, and its axes times the leg's size if it closes a frame, (N, k)."""
    points = closure.targets(matrices)[:, : closure.platform.space]
    if closure.leg.closes == "point":
        return points
    axes = matrices[:, :3, :3].reshape(len(matrices), 9)
    return np.concatenate((points, closure.size * axes), axis=1)


def mode_sign(closure: Closure) -> Array:
    """Return the sign of det ∂c/∂(θ, p), (N,); 1 if it is not square or no joint is passive."""
    leg = closure.leg.leg
    order = [*leg.active, *leg.passive]
    if len(order) != closure.gap.shape[1] or not leg.passive:
        return np.ones(len(closure.gap))
    columns = list(closure.by_joints.transpose(2, 0, 1)[order])
    if len(columns) == 2:  # quicker than NumPy's determinants
        (a, b), (c, d) = (column.T for column in columns)
        return np.sign(a * d - b * c)
    if len(columns) == 3:
        return np.sign((columns[0] * cross(*columns[1:])).sum(axis=1))
    return np.sign(np.linalg.det(np.stack(columns, axis=2)))


def in_home_modes(legs: Sequence[LegClosure], closure: Closure) -> Mask:
    """Return the mask of closures in the working modes of legs of one form, shape (L N,)."""
    signs = mode_sign(closure)
    home_signs = [home_mode(leg.leg, leg.platform) for leg in legs]
    return np.asarray(signs == np.repeat(home_signs, len(signs) // len(legs)))


@lru_cache(maxsize=256)
def home_mode(leg: Leg, platform: Platform) -> float:
    """Return the sign of det ∂c/∂(θ, p) in the home configuration: the leg's working mode."""
    closure = LegClosure(leg, platform).evaluate(leg.home[None], platform.home_pose.as_matrix())
    return float(mode_sign(closure)[0])


_ATTEMPTS = 6
_STEPS = 15  # largest number of Newton steps
_SMALL = 1e-4  # step after which only rounding errors remain
_SAME_DRIVES = 0.1  # difference of drives, [rad] or of the leg's size, that errors of legs cause
_CLOSED = 1e-11  # gap of a closed leg, over its size
_EXACT = 2e-15  # gap that rounding leaves after a closed form, over the leg's size


class ClosedLegs(NamedTuple):
    """Closures of L legs of one form at N poses each, stacked leg by leg."""

    joints: Array
    """Positions of the moving joints, shape (L N, n_joints), [rad] or [m]; NaN where not
    reached."""
    reached: Mask
    """Mask of the poses that a leg reaches in its working mode, shape (L N,)."""
    closure: Closure
    """Closure and its derivatives at the joints; without meaning where not reached."""


def close(
    legs: Sequence[LegClosure],
    matrices: Array,
    influences: Array | None = None,
    near: Array | None = None,
) -> ClosedLegs:
    """Return L legs of one form closed at poses (L N, 4, 4), stacked leg by leg.

    The search starts at joints ``near``, (L N, n_joints), by default at ``start_joints``; rows with
    NaN are not reached. A leg that deforms, by ``influences`` (N, n_influences), must be alone.
    """
    if near is None:
        by_leg = zip(legs, parted(matrices, len(legs)), strict=True)
        starts = [start_joints(leg, poses) for leg, poses in by_leg]
        start, possible = (stacked(parts) for parts in zip(*starts, strict=True))
    else:
        possible = np.asarray(np.isfinite(near).all(axis=1))
        start = np.where(possible[:, None], near, _homes(legs, len(matrices)))
    joints, n = legs[0].deformed(start, influences), start.shape[1]
    if near is None:
        possible = possible | joints[:, n:].any(axis=1)  # starts ignore deformations
    closure = evaluate(legs, joints, matrices)
    gap = _relative_gap(legs, closure)
    in_mode = possible & in_home_modes(legs, closure)  # ways may end beyond a singularity
    closed, exact = in_mode & (gap <= _CLOSED), in_mode & (gap <= _EXACT)
    if not exact.all():
        step = _newton_step(legs[0], closure)
        stays = exact | (closed & ~(np.abs(step) <= _SMALL).all(axis=1))  # singular
        joints = np.where(stays[:, None], joints, joints + step)
    searched = possible & ~closed
    if searched.any():
        attempts = _ATTEMPTS if near is None else 1
        columns = (parted(column, len(legs)) for column in (matrices, joints, closed, possible))
        for leg, poses, *rows in zip(legs, *columns, strict=True):
            _search(leg, poses, attempts, *rows)
        homes = _homes(legs, len(matrices))
        centre = homes if near is None else start
        turning = np.ix_(searched, [i for i, joint in enumerate(legs[0].leg.moving) if joint.turns])
        # Newton's method may have added full turns
        joints[turning] = centre[turning] + wrapped(joints[turning] - centre[turning])
        settled = np.where(closed[:, None], joints, legs[0].deformed(homes))
        closure = evaluate(legs, settled, matrices)
        closed &= in_home_modes(legs, closure)
    joints = joints[:, :n]
    if near is None:
        for leg, rows in zip(legs, parted(joints, len(legs)), strict=True):
            _turn_within_limits(leg, rows)
    return ClosedLegs(np.where(closed[:, None], joints, np.nan), closed, closure)


def _homes(legs: Sequence[LegClosure], rows: int) -> Array:
    """Return the home positions of legs of one form, repeated to shape (rows, n_joints)."""
    return np.repeat([leg.leg.home for leg in legs], rows // len(legs), axis=0)


def _turn_within_limits(leg: LegClosure, joints: Array) -> None:
    """Add full turns to joints, in place, where this brings them within their limits."""
    for joint, positions in zip(leg.leg.moving, joints.T, strict=True):
        if joint.turns and joint.limited:
            low, high = joint.lower - ROUNDING, joint.upper + ROUNDING
            with np.errstate(invalid="ignore"):
                turned = positions - 2 * np.pi * np.floor((positions - low) / (2 * np.pi))
                outside = (positions < low) | (positions > high)
            np.copyto(positions, turned, where=outside & (turned <= high))


def _search(
    leg: LegClosure, matrices: Array, attempts: int, joints: Array, closed: Mask, possible: Mask
) -> None:
    """Search joints that close the leg by Newton's method; ``joints`` and ``closed`` are set."""
    for attempt in range(min(attempts, 2) if leg.leg.passive else attempts):
        rows = np.flatnonzero(possible & ~closed)
        if not len(rows):
            break
        if attempt:
            sampled, in_reach = start_joints(leg, matrices[rows], attempt)
            joints[rows, : sampled.shape[1]] = sampled
            rows = rows[in_reach]
        started = rows
        for _ in range(_STEPS):
            closure = leg.evaluate(joints[rows], matrices[rows])
            joints[rows] += _newton_step(leg, closure)
            closes = _relative_gap((leg,), closure) <= _CLOSED
            rows = rows[~closes & np.isfinite(joints[rows]).all(axis=1)]
            if not len(rows):
                break
        ended = started[np.isfinite(joints[started]).all(axis=1)]
        closure = leg.evaluate(joints[ended], matrices[ended])
        small = _relative_gap((leg,), closure) <= _CLOSED
        closed[ended] = small & in_home_modes((leg,), closure)


def _newton_step(leg: LegClosure, closure: Closure) -> Array:
    """Return the Newton step of all joints, (N, n_joints + n_deformed); deformations stay."""
    with np.errstate(all="ignore"):
        active = -least_squares(closure.drive, closure.constraint[:, :, None])[:, :, 0]
        passive = closure.passive_step(product(closure.active, active[:, :, None])[:, :, 0])
        step = np.zeros((len(active), len(leg.leg.moving) + len(leg.leg.deformed)))
        step[:, leg.leg.active], step[:, leg.leg.passive] = active, passive
        return step


def _relative_gap(legs: Sequence[LegClosure], closure: Closure) -> Array:
    """Return the largest gap over the leg's size of legs of one form, shape (L N,)."""
    gaps = np.abs(closure.gap).max(axis=1).reshape(len(legs), -1)
    return np.asarray(gaps / np.array([[leg.size] for leg in legs])).ravel()


@lru_cache(maxsize=64)
def sensor_law(leg: LegClosure) -> SensorLaw:
    """Return the law of a leg's sensors at the leg's parameter values, cached."""
    sensors = leg.leg.sensors
    zeros, slopes = np.zeros(len(sensors)), np.zeros((len(sensors), len(leg.parameters)))
    if any(sensor.homed for sensor in sensors):
        zeros, slopes = _at_home(leg)
    return law_of_sensors(leg.leg, leg.by_name, zeros, slopes)


def started(
    legs: Sequence[LegClosure], matrices: Array, known: Array, near: Array | None = None
) -> Array:
    """Return joints of L legs of one form, then deformations, (L N, n_joints [+ n_deformed]).

    Active joints follow readings, in ``known`` before influences, (L N, n_active [+ n_influences]).
    Passive joints are as in ``near``, or nearly close the legs at poses (L N, 4, 4).
    """
    if near is None and closed_form(legs[0]):
        near = each(lambda leg, poses: start_joints(leg, poses)[0], legs, matrices)
    elif near is None and legs[0].leg.passive:  # readings select the branches
        drives = each(lambda leg, rows: sensor_law(leg).position(rows), legs, known)
        near = _in_mode(legs, matrices, each(_followed, legs, matrices, drives))
    start = np.zeros((len(matrices), len(legs[0].leg.moving))) if near is None else near

    def driven(leg: LegClosure, joints: Array, rows: Array) -> Array:
        moving, influences = joints[:, : len(leg.leg.moving)], rows[:, len(leg.leg.sensors) :]
        joints = leg.deformed(moving.copy(), influences)
        joints[:, leg.leg.active] = sensor_law(leg).position(rows)
        return joints

    return each(driven, legs, start, known)


def _in_mode(legs: Sequence[LegClosure], matrices: Array, joints: Array) -> Array:
    """Return joints, in the home's working mode where that closes legs with the same drives.

    A way from home may pass a singularity of passive joints alone, such as a gimbal lock.
    """
    if in_home_modes(legs, evaluate(legs, legs[0].deformed(joints), matrices)).all():
        return joints
    closed, active = close(legs, matrices).joints, legs[0].leg.active
    differences = np.abs(closed - joints)[:, active] / legs[0].leg.scales[active]
    return np.where((differences <= _SAME_DRIVES).all(axis=1, keepdims=True), closed, joints)


def _at_home(leg: LegClosure) -> tuple[Array, Array]:
    """Return q_home, (n_active,), and ∂q_home/∂φ = −(Nᵀ ∂c/∂θ)⁻¹ (Nᵀ ∂c/∂φ), (n_active, k)."""
    closed = close((leg,), leg.platform.home_pose.as_matrix())
    if not closed.reached[0]:
        values = ", ".join(f"{name} = {value:.6g}" for name, value in leg.by_name.items())
        raise MechanismError(
            f"{leg.leg.name}: its readings count from the platform's home pose, which it does not "
            f"reach with {values}; correct the home pose or these values"
        )
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = -least_squares(closed.closure.drive, closed.closure.constraint_by_parameter)
    return closed.joints[0, leg.leg.active], slopes[0]


_FEW = 8192  # rows of all legs together, above which legs are faster one by one (cache)


def grouped(forms: Sequence[object], rows: int) -> list[list[int]]:
    """Return groups of indices of legs to evaluate in one call: of one form, with few rows."""
    groups: dict[object, list[int]] = {}
    for place, form in enumerate(forms):
        groups.setdefault(form if len(forms) * rows <= _FEW else place, []).append(place)
    return list(groups.values())


def close_legs(
    legs: Sequence[LegClosure],
    matrices: Array,
    influences: Sequence[Array | None] | None = None,
    near: Sequence[Array] | None = None,
) -> list[tuple[list[int], ClosedLegs]]:
    """Return groups of legs of one form, indices and closures, closed at the same poses."""
    groups = []
    for places in grouped([leg.form for leg in legs], len(matrices)):
        deforming = None if influences is None else influences[places[0]]  # one leg
        start = None if near is None else stacked([near[place] for place in places])
        every = repeated(matrices, len(places))
        groups.append((places, close([legs[i] for i in places], every, deforming, start)))
    return groups


def by_leg(
    groups: Sequence[tuple[Sequence[int], Group]], value: Callable[[Group], Any]
) -> list[Any]:
    """Return a value of each leg in order, shape (N, …), from values of groups, (L N, …).

    ``groups`` have the indices of their legs, and an object to which ``value`` is applied.
    """
    values: dict[int, Any] = {}
    for places, group in groups:
        values |= zip(places, parted(value(group), len(places)), strict=True)
    return [values[place] for place in sorted(values)]
