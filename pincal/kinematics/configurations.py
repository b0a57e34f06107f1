"""All legs at configurations, which poses determine by inverse kinematics, or readings.

A pose does not determine the readings of a serial arm, and legs with fewer joints than closure rows
reach only a surface of poses. Plans for such mechanisms have readings, and forward kinematics gives
the poses.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pincal.blas import one_thread
from pincal.errors import MeasurementError, MechanismError
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.kinematics.assembly import closed_near, mobility
from pincal.kinematics.batches import block_diagonal, chunks, least_squares
from pincal.kinematics.closing import by_leg, close_legs, sensor_law
from pincal.kinematics.closure import nominal_legs
from pincal.kinematics.derivatives import Demand, leg_demands_at, nearest_closure
from pincal.kinematics.forward import LOADS, forward, reading_range, with_loads
from pincal.kinematics.influences import Influences, influence_columns, influences_of
from pincal.model import Leg, Mechanism, Plan, Poses
from pincal.model.checks import ROUNDING, ROWS, array_of, must_be
from pincal.types import Array, Mask

_CLOSES = 0.01  # largest gap of a leg at measured readings and poses, over its size
_NOWHERE = "no readings lead there"
_ABOUT = 0.05  # spread of generic configurations, over the mechanism's size and [rad]


@dataclass(frozen=True, repr=False)
class InverseSolution:
    """Inverse kinematics of N poses."""

    joints: dict[str, Array]
    """Positions of each leg's moving joints, by its name, (N, n_joints); NaN where not reached."""
    readings: Array
    """Sensor readings, shape (N, n_readings), [rad] or [m]; NaN where not reached."""
    reached: Mask
    """Whether each leg closes in its working mode, shape (N, n_legs)."""
    leg_names: tuple[str, ...]

    def reason(self, row: int) -> str:
        """Return why a pose has no solution, or an empty string if it has one."""
        missing = [self.leg_names[place] for place in np.flatnonzero(~self.reached[row])]
        return f"out of reach of {', '.join(missing)} in its working mode" if missing else ""

    def __repr__(self) -> str:
        count, legs = self.reached.shape
        reached_rows = int(np.count_nonzero(self.reached.all(axis=1)))
        return f"InverseSolution: {reached_rows} of {count} poses reached by all {legs} legs"

    def __str__(self) -> str:
        """Return a page: the poses that are out of reach, the first ones at least."""
        missed = np.flatnonzero(~self.reached.all(axis=1))
        lines = [repr(self), *(f"  pose {row + 1}: {self.reason(row)}" for row in missed[:ROWS])]
        return "\n".join(lines + [f"  and {len(missed) - ROWS} more"] * (len(missed) > ROWS))


@one_thread()
def inverse(
    mechanism: GivenMechanism,
    poses: Poses,
    influences: Influences | None = None,
    near: Mapping[str, Array] | None = None,
) -> InverseSolution:
    """Return joints and readings of poses; NaN where a leg cannot reach in its working mode.

    Args:
        mechanism: The mechanism, at its nominal parameters.
        poses: N platform poses: coordinates, shape (N, dof), [m] and [rad], or transforms.
        influences: Influence quantities of terms, by column (``Mechanism.influences``): a number
            for all poses, or one for each, shape (N,); by default at their reference.
        near: Joint positions near the solution by name of leg, shape (N, n_joints), such as
            ``joints`` of another solution. They select one of an arm's solutions; by default the
            search starts in the working mode.

    Raises:
        MechanismError: poses have a wrong shape, or are not finite; the leg of a homed sensor does
            not reach the home pose.
        MeasurementError: no term depends on an influence, or it has a wrong shape.
    """
    mechanism = as_mechanism(mechanism)
    placed = mechanism.platform.matrices(poses)
    columns = influence_columns(mechanism, influences, len(placed))
    if near is not None:
        must_be(near, Mapping, "near", MechanismError)
        near = {
            name: array_of(near.get(name), (len(placed), n), f"joints of {name}", MechanismError)
            for name, n in ((leg.name, len(leg.moving)) for leg in mechanism.legs)
        }
    solution = _inverse(mechanism, placed, columns, near)
    if not mechanism.loaded:
        return solution
    coordinates = mechanism.platform.from_matrices(placed)
    tolerance = ROUNDING * max(1.0, mechanism.size)
    for _ in range(LOADS):  # loads follow from joints, and bend them little
        loaded, before = with_loads(mechanism, columns, solution.readings, coordinates), solution
        if loaded is columns:
            break
        solution = _inverse(mechanism, placed, loaded, near)
        if not (np.abs(solution.readings - before.readings) > tolerance).any():
            break
    return solution


def _inverse(
    mechanism: Mechanism, placed: Array, columns: Array, near: Mapping[str, Array] | None
) -> InverseSolution:
    """Return inverse kinematics at given influences, shape (N, n_influences)."""
    legs, count, n = nominal_legs(mechanism), len(placed), range(len(mechanism.legs))
    laws = [sensor_law(leg) for leg in legs]
    joints = {leg.name: np.empty((count, len(leg.moving))) for leg in mechanism.legs}
    readings = np.empty((count, len(mechanism.reading_names)))
    reached = np.empty((count, len(mechanism.legs)), dtype=bool)
    for rows in chunks(count):
        influences = [mechanism.influences_at(i, columns[rows]) for i in n]
        start = None if near is None else [near[name][rows] for name in mechanism.leg_names]
        groups = close_legs(legs, placed[rows], influences, start)
        positions = by_leg(groups, lambda group: group.joints)
        ends = by_leg(groups, lambda group: group.reached)
        for index, (leg, law) in enumerate(zip(mechanism.legs, laws, strict=True)):
            joints[leg.name][rows] = positions[index]
            read = law.reading(positions[index][:, leg.active], influences[index])
            readings[rows, mechanism.reading_columns[index]] = read
            reached[rows, index] = ends[index] & np.isfinite(read).all(axis=1)
    return InverseSolution(joints, readings, reached, mechanism.leg_names)


def beyond_limits(leg: Leg, joints: Array) -> Mask:
    """Return the mask of joint positions, (N, n_joints), that are outside the joints' limits."""
    slack = ROUNDING * max(1.0, leg.size)
    low = [joint.lower - slack if joint.limited else -np.inf for joint in leg.moving]
    high = [joint.upper + slack if joint.limited else np.inf for joint in leg.moving]
    with np.errstate(invalid="ignore"):  # NaN where the leg does not close
        return np.asarray((joints < low) | (joints > high))


class Legs(NamedTuple):
    """Linearised conditions of all legs at the N configurations of a plan that they reach."""

    poses: Array
    """Coordinates, shape (N, dof), [m] and [rad]."""
    readings: Array | None
    """Readings, shape (N, n_readings), if poses do not determine them."""
    reached: Mask
    """Mask of these configurations among the M planned ones, shape (M,)."""
    parameter: Array
    """∂e/∂φ, shape (N, n_rows, n_params)."""
    pose: Array
    """∂e/∂x, shape (N, n_rows, dof)."""
    reading: Array
    """∂e/∂ψ, shape (N, n_rows, n_readings)."""
    contacts: Mapping[str, tuple[str, ...]]
    """Names of the points touched, by column, length N."""

    @property
    def gain(self) -> Array:
        """∂(pose)/∂(parameter), (N, dof, n_params), by least squares if legs are redundant."""
        return -least_squares(self.pose, self.parameter)


def as_plan(mechanism: Mechanism, planned: Plan | Array) -> Plan:
    """Return a plan, of poses if these are given; readings stay if poses do not determine them."""
    if not isinstance(planned, Plan):
        return Plan(planned)
    readings = planned.readings if mechanism.by_readings else None
    influences, contacts = planned.influences, planned.contacts
    return Plan(planned.poses, planned.sets, readings, influences=influences, contacts=contacts)


def planned_influences(mechanism: Mechanism, plan: Plan) -> Array:
    """Return the influences at the rows of a plan, loads included, shape (N, n_influences)."""
    readings = plan.readings
    if readings is None and mechanism.followed & set(mechanism.influences):
        readings = inverse(mechanism, plan.poses, influences_of(mechanism, plan)).readings
    columns = influences_of(mechanism, plan, readings)
    return columns if readings is None else with_loads(mechanism, columns, readings, plan.poses)


def home_of(mechanism: Mechanism) -> Plan:
    """Return the home configuration as a plan of one row."""
    readings = reading_range(mechanism)[2][None] if mechanism.by_readings else None
    return Plan(np.array([mechanism.platform.home]), readings=readings)


def joints_at(mechanism: Mechanism, planned: Plan | Array) -> InverseSolution:
    """Return all joints at planned configurations, by inverse kinematics or by readings.

    By readings, a leg counts as reached if it closes within a hundredth of its size.
    """
    plan = as_plan(mechanism, planned)
    if plan.readings is None:
        return inverse(mechanism, plan.poses, planned_influences(mechanism, plan))
    matrices, influences = mechanism.platform.matrices(plan.poses), influences_of(mechanism, plan)
    joints, reached = {}, []
    for index, leg in enumerate(nominal_legs(mechanism)):
        known = mechanism.known(index, plan.readings, influences)
        closed, positions = nearest_closure((leg,), matrices, known)
        reached.append(np.abs(closed.gap).max(axis=1) <= _CLOSES * leg.size)
        positions = positions[:, : len(leg.leg.moving)]
        joints[leg.leg.name] = np.where(reached[-1][:, None], positions, np.nan)
    return InverseSolution(joints, plan.readings, np.stack(reached, axis=1), mechanism.leg_names)


def legs_at(mechanism: Mechanism, planned: Plan | Array) -> Legs:
    """Return the linearised conditions of all legs at the planned configurations in reach."""
    plan = as_plan(mechanism, planned)
    solved, reached = np.arange(len(plan)), np.zeros(len(plan), dtype=bool)
    if mechanism.by_readings:  # forward kinematics gives the poses
        poses, readings, reasons = command(mechanism, plan)
        solved = np.flatnonzero([not reason for reason in reasons])
        plan = replace(plan.rows(solved), poses=poses[solved], readings=readings[solved])
    demands = leg_demands(mechanism, plan)
    parameter = block_diagonal([row.parameter for row in demands])
    pose = np.concatenate([row.pose for row in demands], axis=1)
    reading = block_diagonal([row.reading for row in demands])
    ok = np.isfinite(parameter).all(axis=(1, 2)) & np.isfinite(pose).all(axis=(1, 2))
    reached[solved[ok]], plan = True, plan.rows(ok)
    derivatives = parameter[ok], pose[ok], reading[ok]
    return Legs(plan.poses, plan.readings, reached, *derivatives, plan.contacts)


def leg_demands(mechanism: Mechanism, plan: Plan) -> list[Demand]:
    """Return the linearised condition of each leg at configurations in reach."""
    columns, legs = planned_influences(mechanism, plan), nominal_legs(mechanism)
    placed, places = [mechanism.platform.matrices(plan.poses)] * len(legs), range(len(legs))
    if plan.readings is None:
        influences = [mechanism.influences_at(place, columns) for place in places]
        return leg_demands_at(legs, placed, influences=influences)
    known = [mechanism.known(place, plan.readings, columns) for place in places]
    return leg_demands_at(legs, placed, known)


def command(mechanism: Mechanism, planned: Plan | Array) -> tuple[Array, Array, list[str]]:
    """Return poses (N, dof) and readings (N, n_readings) to command, and why a row has none.

    A reason is empty if the row has a pose and readings. The readings of a plan are commanded; with
    more or fewer drives than freedoms, the nearest configurations at which all legs close are.
    """
    plan = as_plan(mechanism, planned)
    if plan.readings is not None:
        known, home = np.isfinite(plan.readings), reading_range(mechanism)[2]
        readings, influences = np.where(known, plan.readings, home), influences_of(mechanism, plan)
        drives = sum(len(leg.active) for leg in mechanism.legs)
        if any(leg.deformed for leg in mechanism.legs) or drives == mobility(mechanism):
            solution = forward(mechanism, readings, plan.poses, influences)
            poses, readings, reasons = solution.poses, plan.readings, np.array(solution.reasons)
        else:
            poses, readings, closes = closed_near(mechanism, plan.poses, readings, influences)
            reasons = np.where(closes, "", "not near positions in which all legs close")
        return poses, readings, np.where(known.all(axis=1), reasons, _NOWHERE).tolist()
    solved = inverse(mechanism, plan.poses, planned_influences(mechanism, plan))
    return plan.poses, solved.readings, [solved.reason(row) for row in range(len(plan.poses))]


def shifted(mechanism: Mechanism, planned: Plan | Array, shifts: Callable[[Array], Array]) -> Plan:
    """Return configurations with the platform shifted but not turned, in reach or not.

    ``shifts`` gives shifts, (N, 3), base axes, [m], of poses ``T_base_platform``, (N, 4, 4).
    """
    plan, platform = as_plan(mechanism, planned), mechanism.platform
    poses = command(mechanism, plan)[0]
    poses = np.where(np.isfinite(poses), poses, plan.poses)
    matrices = platform.matrices(poses).copy()
    matrices[:, :3, 3] += shifts(matrices)
    moved = platform.from_matrices(matrices)
    if plan.readings is None:
        return replace(plan, poses=moved)
    near = joints_at(mechanism, replace(plan, poses=poses)).joints
    readings = inverse(mechanism, moved, influences_of(mechanism, plan), near).readings
    return replace(plan, poses=moved, readings=readings)


def check_reached(mechanism: Mechanism, planned: Plan | Array, name: str = "the plan") -> None:
    """Raise MeasurementError, which calls the plan by ``name``, if none of its rows is in reach."""
    reasons = command(mechanism, planned)[2]
    if all(reasons):
        first = planned.place(0) if isinstance(planned, Plan) else "row 1"
        explanation = f": {first} is {reasons[0]}" if reasons else ", it is empty"
        raise MeasurementError(f"no pose of {name} is in reach of {mechanism.name!r}{explanation}")


def nearby(mechanism: Mechanism, planned: Plan | Array, count: int, size: float) -> Plan:
    """Return at least ``count`` generic configurations near planned ones; the size is in [m].

    Parameters that move the platform like a frame at a few poses may not do so at generic ones.
    """
    plan, platform, rng = as_plan(mechanism, planned), mechanism.platform, np.random.default_rng(0)
    rounds, influences = -(-count // max(len(plan), 1)), {}
    for name, column in plan.influences.items():  # spread as far as they differ
        values, known = np.tile(column, rounds), column[np.isfinite(column)]
        if len(known):  # unknown values are filled
            filled = np.where(np.isfinite(values), values, known[0])
            values = filled + (np.ptp(known) or 1.0) * rng.standard_normal(len(values))
        influences[name] = values
    poses = np.tile(plan.poses, (rounds, 1))

    def drawn(units: tuple[str, ...]) -> Array:
        scale = _ABOUT * np.array([size if unit == "m" else 1.0 for unit in units])
        return scale * rng.standard_normal((len(poses), len(units)))

    if plan.readings is not None:
        readings = np.tile(plan.readings, (rounds, 1)) + drawn(mechanism.reading_units)
        return Plan(poses, readings=readings, influences=influences)
    moved = platform.displaced(platform.matrices(poses), drawn(platform.units))
    return Plan(platform.from_matrices(moved), influences=influences)
