"""Inverse kinematics: joints and readings of poses, each leg in its working mode.

A pose that a leg cannot reach in its mode is NaN with a reason, never a wrong branch.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pincal.blas import one_thread
from pincal.errors import MechanismError
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.kinematics.closing import by_leg, close_chunks, sensor_law
from pincal.kinematics.closure import largest_size, nominal_legs
from pincal.kinematics.forward import LOADS, with_loads
from pincal.kinematics.influences import Influences, influence_columns
from pincal.model.checks import ROUNDING, ROWS, array_of
from pincal.model.leg import Leg
from pincal.model.mechanism import Mechanism
from pincal.model.platform import Poses
from pincal.types import Array, Mask


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
        missing = [self.leg_names[place] for place in np.flatnonzero(~self.reached[row])]
        return f"out of reach of {', '.join(missing)} in its working mode" if missing else ""

    def __repr__(self) -> str:
        """Return the solution in a line."""
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
        influences: What terms depend on, by column (``Mechanism.influences``): a number
            for all poses, or one for each, shape (N,); at their reference if not given.
        near: By leg, positions of its moving joints near the solution, shape (N, n_joints), as
            ``joints`` of another one; of arms they say which of several is meant. Those of the
            working mode if not given.

    Raises:
        MechanismError: poses of a wrong shape, or not finite; a homed sensor and a home pose
            out of its leg's reach.
        MeasurementError: an influence on which nothing depends, or of a wrong shape.
    """
    mechanism = as_mechanism(mechanism)
    placed = mechanism.platform.matrices(poses)
    columns = influence_columns(mechanism, influences, len(placed))
    if near is not None:
        near = {
            name: array_of(near.get(name), (len(placed), n), f"joints of {name}", MechanismError)
            for name, n in ((leg.name, len(leg.moving)) for leg in mechanism.legs)
        }
    solution = _inverse(mechanism, placed, columns, near)
    if columns is None:
        return solution
    coordinates = mechanism.platform.from_matrices(placed)
    tolerance = ROUNDING * max(1.0, largest_size(mechanism.legs))
    for _ in range(LOADS):  # loads follow from joints, and bend them little
        loaded, before = with_loads(mechanism, columns, solution.readings, coordinates), solution
        if loaded is columns:
            break
        solution = _inverse(mechanism, placed, loaded, near)
        if not (np.abs(solution.readings - before.readings) > tolerance).any():
            break
    return solution


def _inverse(
    mechanism: Mechanism,
    placed: Array,
    columns: Array | None,
    near: Mapping[str, Array] | None,
) -> InverseSolution:
    """Return inverse kinematics at given influences, shape (N, n_influences)."""
    laws, count = [sensor_law(leg) for leg in nominal_legs(mechanism)], len(placed)
    joints = {leg.name: np.empty((count, len(leg.moving))) for leg in mechanism.legs}
    readings = np.empty((count, len(mechanism.reading_names)))
    reached = np.empty((count, len(mechanism.legs)), dtype=bool)
    for rows, groups in close_chunks(mechanism, placed, columns, near):
        positions = by_leg(groups, lambda group: group.joints)
        ends = by_leg(groups, lambda group: group.reached)
        for index, (leg, law) in enumerate(zip(mechanism.legs, laws, strict=True)):
            joints[leg.name][rows] = positions[index]
            at_rows = None if columns is None else mechanism.influences_at(index, columns[rows])
            read = law.reading(positions[index][:, leg.active], at_rows)
            readings[rows, mechanism.reading_columns[index]] = read
            reached[rows, index] = ends[index] & np.isfinite(read).all(axis=1)
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
    names: list[list[str]] = [[] for _ in solution.reached]
    for leg in mechanism.legs:
        for row, place in np.argwhere(beyond_limits(leg, solution.joints[leg.name])):
            names[row].append(f"{leg.name} {leg.moving[place].name}")
    return [tuple(pose_names) for pose_names in names]
