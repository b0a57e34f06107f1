"""Inverse kinematics: joints and readings of poses, each leg in its working mode.

Newton's method on closure from a start in the mode. A pose that a leg cannot reach in
its mode is NaN with a reason, never a wrong branch. A homed sensor counts from the joint's
position at the platform's home pose, which is inverse kinematics too.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from pincal.errors import MechanismError
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.kinematics.batches import least_squares, product
from pincal.kinematics.closed_forms import closed_form, wrapped
from pincal.kinematics.closure import Closure, LegClosure, Newton, nominal_legs
from pincal.kinematics.influences import Influences, influence_columns
from pincal.kinematics.starts import in_home_mode, start_joints
from pincal.model.checks import ROUNDING
from pincal.model.leg import Leg
from pincal.model.mechanism import Mechanism
from pincal.model.overview import ROWS
from pincal.model.platform import Poses
from pincal.model.sensor import SensorLaw, sensor_laws

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
CHUNK = 4096
_ATTEMPTS = 6
_NEWTON = Newton(steps=15, small=1e-4, closed=1e-11)  # the step after that is rounding


@dataclass(frozen=True)
class ClosedLeg:
    """One leg closed at N poses."""

    joints: Array
    """Positions of the moving joints, shape (N, n_joints), [rad] or [m]; NaN where not reached."""
    reached: Mask
    """Where the leg closes in its working mode, shape (N,)."""
    closure: Closure
    """Closure and derivatives there; of no meaning where not reached."""


def close(leg: LegClosure, matrices: Array) -> ClosedLeg:
    """Return one leg closed at poses ``T_base_platform``, shape (N, 4, 4)."""
    joints, possible = start_joints(leg, matrices)
    closure = leg.evaluate(joints, matrices)
    closed = possible & _small(leg, closure)
    step = _newton_step(leg, closure)
    last = (np.abs(step) <= _NEWTON.small).all(axis=1)  # not at a singularity
    joints = np.where((closed & ~last)[:, None], joints, joints + step)
    if not (closed | ~possible).all():
        joints, closed = _search(leg, matrices, joints, closed, possible)
        closure = leg.evaluate(np.where(closed[:, None], joints, leg.leg.home), matrices)
    joints = _within_limits(leg, joints)
    reached = closed & in_home_mode(leg, closure)
    return ClosedLeg(np.where(reached[:, None], joints, np.nan), reached, closure)


def _within_limits(leg: LegClosure, joints: Array) -> Array:
    """Return joints with full turns added where that brings them within their limits."""
    for place, joint in enumerate(leg.leg.moving):
        if joint.kind == "revolute" and joint.limited:
            own = joints[:, place]
            with np.errstate(invalid="ignore"):  # where the leg does not close
                turned = joint.lower + (own - joint.lower + ROUNDING) % (2 * np.pi) - ROUNDING
                outside = (own < joint.lower - ROUNDING) | (own > joint.upper + ROUNDING)
                fits = outside & (turned <= joint.upper + ROUNDING)
            joints[:, place] = np.where(fits, turned, own)
    return joints


def _search(
    leg: LegClosure, matrices: Array, joints: Array, closed: Mask, possible: Mask
) -> tuple[Array, Mask]:
    """Return joints and where they close the leg, by Newton's method from several starts."""
    joints, closed = joints.copy(), closed.copy()
    for attempt in range(_ATTEMPTS):
        rows = np.flatnonzero(possible & ~closed)
        if attempt:
            again, may = start_joints(leg, matrices[rows], attempt)
            joints[rows] = again
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
        closed[found] = _small(leg, part) & in_home_mode(leg, part)
        if (closed | ~possible).all():
            break
    turning = [i for i, joint in enumerate(leg.leg.moving) if joint.kind == "revolute"]
    home = leg.leg.home[turning]  # Newton's method may have gone round
    joints[:, turning] = home + wrapped(joints[:, turning] - home)
    return joints, closed


def _newton_step(leg: LegClosure, closure: Closure) -> Array:
    """Return the Newton step of all joints, shape (N, n_joints)."""
    with np.errstate(all="ignore"):
        active = closure.active_step()
        change = product(closure.active, active[:, :, None])[:, :, 0]
        passive = closure.passive_step(change)
        step = np.empty((len(active), active.shape[1] + passive.shape[1]))
        step[:, leg.leg.active], step[:, leg.leg.passive] = active, passive
        return step


def _small(leg: LegClosure, closure: Closure) -> Mask:
    return np.asarray((np.abs(closure.gap) <= _NEWTON.closed * leg.size).all(axis=1))


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
    return sensor_laws(sensors, columns, leg.by_name, zeros, slopes)


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
        by_parameter = closed.closure.project(closed.closure.parameter)
        slopes = -least_squares(closed.closure.drive, by_parameter)
    return closed.joints[0, leg.leg.active], slopes[0]


def close_chunks(
    mechanism: Mechanism, placed: RigidTransform | Array
) -> Iterator[tuple[slice, Array, list[ClosedLeg]]]:
    """Yield the closed legs of poses in chunks of bounded memory: rows, matrices, one per leg."""
    legs = nominal_legs(mechanism)
    for rows, matrices in matrix_chunks(placed):
        yield rows, matrices, [close(leg, matrices) for leg in legs]


def matrix_chunks(placed: RigidTransform | Array) -> Iterator[tuple[slice, Array]]:
    """Yield rows of poses and their matrices, shape (n, 4, 4), so many as memory holds well."""
    for begin in range(0, len(placed), CHUNK):
        rows = slice(begin, min(begin + CHUNK, len(placed)))
        part = placed[rows]
        yield rows, part.as_matrix() if isinstance(part, RigidTransform) else part


@dataclass(frozen=True, repr=False)
class InverseSolution:
    """Inverse kinematics of N poses."""

    joints: dict[str, Array]
    """By leg: positions of its moving joints, shape (N, n_joints); NaN where not reached."""
    readings: Array
    """Sensor readings, shape (N, n_readings), [rad] or [m]; NaN where not reached."""
    reached: Mask
    """Whether each leg closes in its working mode, shape (N, n_legs)."""
    leg_names: tuple[str, ...]

    def reason(self, row: int) -> str:
        """Return why a pose has no solution, or an empty string if it has one."""
        missing = [
            name for name, ok in zip(self.leg_names, self.reached[row], strict=True) if not ok
        ]
        return f"out of reach of {', '.join(missing)} in its working mode" if missing else ""

    def __repr__(self) -> str:
        """Return the solution in a line."""
        count, legs = self.reached.shape
        found = int(np.count_nonzero(self.reached.all(axis=1)))
        return f"InverseSolution: {found} of {count} poses reached by all {legs} legs"

    def __str__(self) -> str:
        """Return a page: the poses that are out of reach, the first ones at least."""
        missed = np.flatnonzero(~self.reached.all(axis=1))
        lines = [f"  pose {row + 1}: {self.reason(row)}" for row in missed[:ROWS]]
        more = len(missed) - len(lines)
        return "\n".join([repr(self), *lines, *([f"  and {more} more"] if more > 0 else [])])


def inverse(
    mechanism: GivenMechanism, poses: Poses, influences: Influences | None = None
) -> InverseSolution:
    """Return joints and readings of poses; NaN where a leg cannot reach in its working mode.

    Args:
        mechanism: The mechanism, at its nominal parameters.
        poses: N platform poses: coordinates, shape (N, dof), [m] and [rad], or transforms.
        influences: What terms of sensors depend on, by column (``Mechanism.influences``): a number
            for all poses, or one for each, shape (N,); at their reference if not given.

    Raises:
        MechanismError: poses of a wrong shape, or not finite; a homed sensor and a home pose
            out of its leg's reach.
        MeasurementError: an influence on which nothing depends, or of a wrong shape.
    """
    mechanism = as_mechanism(mechanism)
    placed = mechanism.platform.placed(poses)
    columns = influence_columns(mechanism, influences, len(placed))
    laws = [sensor_law(leg) for leg in nominal_legs(mechanism)]
    count = len(placed)
    joints = {leg.name: np.empty((count, len(leg.moving))) for leg in mechanism.legs}
    readings = np.empty((count, len(mechanism.reading_names)))
    reached = np.empty((count, len(mechanism.legs)), dtype=bool)
    for rows, _, closed in close_chunks(mechanism, placed):
        for index, (leg, law, one) in enumerate(zip(mechanism.legs, laws, closed, strict=True)):
            joints[leg.name][rows] = one.joints
            own = None if columns is None else mechanism.influences_at(index, columns[rows])
            at = law.reading(one.joints[:, leg.active], own)
            readings[rows, mechanism.reading_columns[index]] = at
            reached[rows, index] = one.reached
    return InverseSolution(joints, readings, reached, mechanism.leg_names)


def beyond_limits(leg: Leg, joints: Array) -> Mask:
    """Return which moving joints are outside their limits, of positions of shape (N, n_joints)."""
    slack = ROUNDING * max(1.0, leg.size)
    low = [joint.lower - slack if joint.limited else -np.inf for joint in leg.moving]
    high = [joint.upper + slack if joint.limited else np.inf for joint in leg.moving]
    with np.errstate(invalid="ignore"):  # where the leg does not close
        return np.asarray((joints < low) | (joints > high))


def outside_limits(mechanism: Mechanism, solution: InverseSolution) -> list[tuple[str, ...]]:
    """Return the joints of each pose that are outside their limits, as ``leg_1 slide``."""
    found: list[list[str]] = [[] for _ in solution.reached]
    for leg in mechanism.legs:
        for row, place in np.argwhere(beyond_limits(leg, solution.joints[leg.name])):
            found[row].append(f"{leg.name} {leg.moving[place].name}")
    return [tuple(one) for one in found]


def reached(mechanism: Mechanism, poses: Poses) -> Mask:
    """Return which legs reach poses in their working modes, shape (N, n_legs).

    A leg with a closed form is asked by it alone, about ten times faster than ``inverse``.

    Args:
        mechanism: The mechanism, at its nominal parameters.
        poses: N platform poses: coordinates, shape (N, dof), [m] and [rad], or transforms.

    Raises:
        MechanismError: poses of a wrong shape, or not finite.
    """
    placed = mechanism.platform.placed(poses)
    legs = nominal_legs(mechanism)
    found = np.empty((len(placed), len(legs)), dtype=bool)
    for rows, matrices in matrix_chunks(placed):
        for index, leg in enumerate(legs):
            solved = closed_form(leg) is not None
            found[rows, index] = (
                start_joints(leg, matrices)[1] if solved else close(leg, matrices).reached
            )
    return found
