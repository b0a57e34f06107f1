"""Legs closed at poses, in their working modes, and what their sensors read there.

Newton's method on closure from a start in the mode. A pose that a leg cannot reach in
its mode is NaN, never a wrong branch. A homed sensor counts from the joint's
position at the platform's home pose, which is a leg closed too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from pincal.errors import MechanismError
from pincal.kinematics.batches import (
    Matrices,
    least_squares,
    matrix_chunks,
    product,
    repeated,
    stacked,
)
from pincal.kinematics.closure import (
    Closure,
    LegClosure,
    Newton,
    evaluate,
    nominal_legs,
    rows_of_each,
)
from pincal.kinematics.starts import in_home_modes, start_joints
from pincal.model.checks import ROUNDING, wrapped
from pincal.model.mechanism import Mechanism
from pincal.model.sensor import SensorLaw, sensor_laws
from pincal.types import Array, Mask

_ATTEMPTS = 6
_NEWTON = Newton(steps=15, small=1e-4, closed=1e-11)  # the step after that is rounding
_EXACT = 2e-15  # of a leg's size, what rounding leaves of a closed form


@dataclass(frozen=True)
class ClosedLegs:
    """L alike legs closed at N poses each, rows of each leg below those of the one before."""

    joints: Array
    """Positions of the moving joints, shape (L N, n_joints), [rad] or [m]; NaN where not
    reached."""
    reached: Mask
    """Where a leg closes in its working mode, shape (L N,)."""
    closure: Closure
    """Closure and derivatives there; of no meaning where not reached."""


def close(
    leg: LegClosure, matrices: Array, influences: Array | None = None, near: Array | None = None
) -> ClosedLegs:
    """Return one leg closed at poses.

    Args:
        leg: The leg at its parameter values.
        matrices: Poses ``T_base_platform``, shape (N, 4, 4).
        influences: Of the leg, by which its parameters deform, shape (N, n_influences); at their
            reference if not given.
        near: Positions of the moving joints near those that close it, shape (N, n_joints); where
            NaN it counts as not reached. Found in its working mode if not given.
    """
    return close_alike((leg,), matrices, influences, near)


def close_alike(
    legs: Sequence[LegClosure],
    matrices: Array,
    influences: Array | None = None,
    near: Array | None = None,
) -> ClosedLegs:
    """Return L alike legs closed at poses, N rows of each below those of the one before.

    Args:
        legs: Legs of one form, at their parameter values.
        matrices: Poses ``T_base_platform``, shape (L N, 4, 4).
        influences: See ``close``; of no effect unless one leg that deforms is alone.
        near: See ``close``, shape (L N, n_joints).
    """
    rows, count = rows_of_each(len(legs), len(matrices)), len(matrices) // len(legs)
    if near is None:
        starts = [start_joints(leg, matrices[own]) for leg, own in zip(legs, rows, strict=True)]
        start, attempts = stacked([joints for joints, _ in starts]), _ATTEMPTS
        possible = stacked([one for _, one in starts])
    else:
        possible = np.asarray(np.isfinite(near).all(axis=1))
        start, attempts = np.where(possible[:, None], near, _homes(legs, count)), 1
    joints, n = legs[0].deformed(start, influences), start.shape[1]
    if near is None:
        possible = possible | joints[:, n:].any(axis=1)  # a start knows nothing of deformations
    closure = evaluate(legs, joints, matrices)
    off = _off(legs, closure)
    closed = possible & (off <= _NEWTON.closed)
    exact = closed & (off <= _EXACT)
    if not exact.all():
        step = _newton_step(legs[0], closure)
        last = (np.abs(step) <= _NEWTON.small).all(axis=1)  # not at a singularity
        stays = exact | (closed & ~last)
        joints = np.where(stays[:, None], joints, joints + step)
    searched = possible & ~closed
    if searched.any():
        for leg, own in zip(legs, rows, strict=True):
            if searched[own].any():
                joints[own], closed[own] = _search(
                    leg, matrices[own], joints[own], closed[own], possible[own], attempts
                )
        about = _homes(legs, count) if near is None else start
        turning = [i for i, joint in enumerate(legs[0].leg.moving) if joint.kind == "revolute"]
        some = np.ix_(searched, turning)
        around = wrapped(joints[some] - about[some])
        joints[some] = about[some] + around  # Newton's method may have gone round
        home = legs[0].deformed(_homes(legs, count))
        closure = evaluate(legs, np.where(closed[:, None], joints, home), matrices)
    joints = joints[:, :n]
    if near is None:
        for leg, own in zip(legs, rows, strict=True):
            _turn_within_limits(leg, joints[own])
    reached = closed & in_home_modes(legs, closure)
    return ClosedLegs(np.where(reached[:, None], joints, np.nan), reached, closure)


def _homes(legs: Sequence[LegClosure], rows: int) -> Array:
    """Return the home joints of legs, so many rows of each, shape (L rows, n_joints)."""
    return np.repeat([leg.leg.home for leg in legs], rows, axis=0)


def _turn_within_limits(leg: LegClosure, joints: Array) -> None:
    """Add full turns to joints, in place, where that brings them within their limits."""
    turn = 2 * np.pi
    for place, joint in enumerate(leg.leg.moving):
        if joint.kind == "revolute" and joint.limited:
            own = joints[:, place]
            low, high = joint.lower - ROUNDING, joint.upper + ROUNDING
            outside = np.flatnonzero(((own < low) | (own > high)) & np.isfinite(own))
            if len(outside):
                turned = own[outside] - turn * np.floor((own[outside] - low) / turn)
                fits = turned <= high
                own[outside[fits]] = turned[fits]


def _search(
    leg: LegClosure, matrices: Array, joints: Array, closed: Mask, possible: Mask, attempts: int
) -> tuple[Array, Mask]:
    """Return joints and where they close the leg, by Newton's method from several starts."""
    joints, closed = joints.copy(), closed.copy()
    for attempt in range(attempts):
        rows = np.flatnonzero(possible & ~closed)
        if attempt:
            again, may = start_joints(leg, matrices[rows], attempt)
            joints[rows, : again.shape[1]] = again
            rows = rows[may]
        found = rows
        for _ in range(_NEWTON.steps):
            part = leg.evaluate(joints[rows], matrices[rows])
            joints[rows] += _newton_step(leg, part)
            going = ~_small(leg, part) & np.isfinite(joints[rows]).all(axis=1)
            rows = rows[going]
            if not len(rows):
                break
        found = found[np.isfinite(joints[found]).all(axis=1)]
        part = leg.evaluate(joints[found], matrices[found])
        closed[found] = _small(leg, part) & in_home_modes((leg,), part)
        if (closed | ~possible).all():
            break
    return joints, closed


def _newton_step(leg: LegClosure, closure: Closure) -> Array:
    """Return the Newton step of all joints, deformations staying, (N, n_joints + n_deformed)."""
    with np.errstate(all="ignore"):
        active = closure.active_step()
        change = product(closure.active, active[:, :, None])[:, :, 0]
        passive = closure.passive_step(change)
        width = active.shape[1] + passive.shape[1] + len(leg.leg.deformed)
        step = np.zeros((len(active), width))
        step[:, leg.leg.active], step[:, leg.leg.passive] = active, passive
        return step


def _off(legs: Sequence[LegClosure], closure: Closure) -> Array:
    """Return the largest gap of alike legs over their sizes, shape (L N,)."""
    gaps = np.abs(closure.gap).max(axis=1).reshape(len(legs), -1)
    return np.asarray(gaps / np.array([[leg.size] for leg in legs])).ravel()


def _small(leg: LegClosure, closure: Closure) -> Mask:
    """Return where the gap of a leg is small against its size, shape (N,)."""
    return _off((leg,), closure) <= _NEWTON.closed


@lru_cache(maxsize=64)
def sensor_law(leg: LegClosure) -> SensorLaw:
    """Return what a leg's sensors read at the leg's parameter values, made once.

    Raises:
        MechanismError: a homed sensor, and a home pose out of the leg's reach.
    """
    sensors = leg.leg.sensors
    if any(sensor.homed for sensor in sensors):
        zeros, slopes = _at_home(leg)
    else:
        zeros, slopes = np.zeros(len(sensors)), np.zeros((len(sensors), len(leg.parameters)))
    columns = (*leg.leg.reading_names, *leg.leg.influences)
    return sensor_laws(sensors, leg.by_name, zeros, slopes, columns)


def driven(leg: LegClosure, joints: Array, known: Array) -> Array:
    """Return joint positions with those that rows say: active joints, and deformations behind.

    Shape (N, n_joints + n_deformed), [rad] or [m].

    Args:
        leg: The leg at its parameter values.
        joints: Shape (N, n_joints), which may be overwritten.
        known: Readings [rad] or [m], then influences, shape (N, n_active [+ n_influences]).
    """
    joints = leg.deformed(joints, known[:, len(leg.leg.sensors) :])
    joints[:, leg.leg.active] = sensor_law(leg).position(known)
    return joints


def _at_home(leg: LegClosure) -> tuple[Array, Array]:
    """Return the active joints' positions at the home pose, and their derivatives.

    q_home in [rad] or [m], shape (n_active,), and ∂q_home/∂φ = −(Nᵀ ∂c/∂θ)⁻¹ (Nᵀ ∂c/∂φ), shape
    (n_active, n_params).
    """
    closed = close(leg, leg.platform.home_pose.as_matrix())
    if not closed.reached[0]:
        values = ", ".join(f"{name} = {value:.6g}" for name, value in leg.by_name.items())
        raise MechanismError(
            f"{leg.leg.name}: its readings count from the platform's home pose, which it does not "
            f"reach with {values}; correct the home pose or these values"
        )
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = -least_squares(closed.closure.drive, closed.closure.constraint_by_parameter)
    return closed.joints[0, leg.leg.active], slopes[0]


_FEW = 8192  # rows of all legs: those of more are quicker leg by leg, near the processor


@dataclass(frozen=True)
class ClosedGroup:
    """Some of all legs, closed in one call."""

    places: list[int]
    """Of the legs, among all."""
    closed: ClosedLegs


def close_legs(
    legs: Sequence[LegClosure],
    matrices: Array,
    influences: Sequence[Array | None] | None = None,
    near: Sequence[Array] | None = None,
) -> list[ClosedGroup]:
    """Return all legs closed at the same poses, alike ones in one call where poses are few.

    Args:
        legs: The legs at their parameter values.
        matrices: Poses ``T_base_platform``, shape (N, 4, 4).
        influences: Of each leg, shape (N, n_influences); at their reference if not given.
        near: Of each leg, positions of its moving joints near those that close it, shape
            (N, n_joints); found in its working mode if not given.
    """
    found = []
    for places in grouped([leg.form for leg in legs], len(matrices)):
        own = [legs[place] for place in places]
        there = repeated(matrices, len(own))
        at = None if influences is None else influences[places[0]]  # what deforms is alone
        start = None if near is None else stacked([near[place] for place in places])
        found.append(ClosedGroup(places, close_alike(own, there, at, start)))
    return found


def grouped(forms: Sequence[object], rows: int) -> list[list[int]]:
    """Return the places of legs that are best evaluated in one call: alike ones, rows being few.

    Args:
        forms: Of the legs: see ``LegClosure.form``.
        rows: Of each leg.
    """
    groups: dict[object, list[int]] = {}
    for place, form in enumerate(forms):
        groups.setdefault(form if len(forms) * rows <= _FEW else place, []).append(place)
    return list(groups.values())


def by_leg(closed: Sequence[ClosedGroup], value: Callable[[ClosedLegs], Any]) -> list[Any]:
    """Return values of all legs in order, shape (N, …) each, from those of each call."""
    return in_order([one.places for one in closed], [value(one.closed) for one in closed])


def in_order(places: Sequence[Sequence[int]], values: Sequence[Any]) -> list[Any]:
    """Return values of all legs in order, shape (N, …) each.

    Args:
        places: Of the legs of each group, among all.
        values: Of each group, shape (L N, …), rows of each leg below those of the one before.
    """
    found: dict[int, Any] = {}
    for group, own in zip(places, values, strict=True):
        found |= zip(group, np.split(own, len(group)), strict=True)
    return [found[place] for place in sorted(found)]


def close_chunks(
    mechanism: Mechanism,
    placed: Matrices,
    influences: Array | None = None,
    near: Mapping[str, Array] | None = None,
) -> Iterator[tuple[slice, list[ClosedGroup]]]:
    """Yield the closed legs of poses in chunks of bounded memory, and their rows.

    Args:
        mechanism: The mechanism, at its nominal parameters.
        placed: N poses, ``PoseMatrices`` or matrices (N, 4, 4).
        influences: Of all legs, shape (N, n_influences); at their reference if not given.
        near: By leg, positions of its moving joints near those that close it, found if not given.
    """
    legs = nominal_legs(mechanism)
    for rows, matrices in matrix_chunks(placed):
        own = start = None
        if influences is not None:
            own = [mechanism.influences_at(i, influences[rows]) for i in range(len(legs))]
        if near is not None:
            start = [near[leg.leg.name][rows] for leg in legs]
        yield rows, close_legs(legs, matrices, own, start)
