"""Plans in the order in which they are measured, with poses measured again, and some to verify."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pincal.errors import MeasurementError, ObservabilityError
from pincal.kinematics.configurations import as_plan, inverse, joints_at, planned_influences
from pincal.model.checks import count_of
from pincal.model.measurements import EVERY_LEG, VERIFY, Plan
from pincal.model.mechanism import Mechanism
from pincal.model.relations import ROW, TO
from pincal.types import Array, Mask


def with_distances(plan: Plan, count: int) -> Plan:
    """Return a plan whose rows, called 1, 2, …, are each measured from so many others.

    Rows far from each other in the plan and near ones alike, no pair twice, and none of one pose
    that is measured again.

    Raises:
        ObservabilityError: there are not as many others.
    """
    rows = len(plan)
    if 2 * count > rows - 1:
        raise ObservabilityError(
            f"{rows} poses have at most {(rows - 1) // 2} distances each, no pair measured twice; "
            f"{count} were asked for"
        )
    names = tuple(str(1 + row) for row in range(rows))
    steps = np.linspace(1, (rows - 1) // 2, count).round().astype(int).tolist()
    places, columns = plan.places or ("",) * rows, {}
    for slot, step in enumerate(steps, start=1):
        leads = zip(names[step:] + names[:step], places[step:] + places[:step], places, strict=True)
        columns[f"distance_{slot}{TO}"] = tuple(
            "" if place and place == other else name for name, other, place in leads
        )
    return replace(plan, contacts={**plan.contacts, ROW: names, **columns}) if count else plan


REFERENCE = "reference"
"""Name of the pose that is measured again and again."""
_ROUND = 8  # rows that a round has at least
_BLOCKED = 1e3  # length of a way that must not be driven


def in_rounds(
    mechanism: Mechanism,
    plan: Plan,
    rounds: int = 3,
    every: int | None = None,
    seed: int = 0,
    blocked: Mask | bool = False,
) -> Plan:
    """Return a plan in the order in which it is driven, with a reference pose between.

    Each round has a random share of every set, and goes round it by a short way, from the pose in
    the middle (least sum of squared ways to the others) and back to it. What drifts slowly is then
    no error of one leg or one region. Rows of the middle pose have the name ``reference``, and
    differ by noise and by what drifts.

    Args:
        mechanism: The mechanism.
        plan: Rows in any order, N.
        rounds: Number of rounds; fewer where they would have less than eight rows.
        every: Rows between which the reference is measured, and at both ends; at the ends of all
            rounds if not given; 0 for never.
        seed: Seed of the shares.
        blocked: Ways between rows that must not be driven if others can, shape (N, N).

    Raises:
        MeasurementError: no round, or a negative number of rows between.
    """
    count_of(rounds, "rounds", MeasurementError, 1)
    count_of(every or 0, "every", MeasurementError, 0)
    sets, when = np.array(plan.serving), np.empty(len(plan))
    for name in np.unique(sets):
        rows = np.flatnonzero(sets == name)
        shares = (np.arange(len(rows)) + 0.5) / len(rows)
        when[np.random.default_rng(seed).permutation(rows)] = shares
    number = np.floor(when * np.clip(len(plan) // _ROUND, 1, rounds))
    ways, fitted = _ways(mechanism, plan), np.flatnonzero(~plan.verifying)
    middle = fitted[np.argmin((ways[np.ix_(fitted, fitted)] ** 2).sum(axis=1))]
    ways += _BLOCKED * blocked
    order, ends = list[int](), list[int]()
    for place in np.unique(number):
        rows = np.flatnonzero((number == place) & (np.arange(len(plan)) != middle))
        rows = np.append(middle, rows)
        rows = rows[_way_round(ways[np.ix_(rows, rows)])]
        if number[middle] != place:
            ends.append(len(order))
            rows = rows[1:]
        order += rows.tolist()
    ends.append(len(order))
    if every is not None:
        ends = [*range(0, len(plan), every), len(plan)] if every else []
    repeated = np.insert(np.zeros(len(plan), dtype=bool), ends, True)
    ordered = plan.rows(np.insert(order, ends, middle))
    if not ends:
        return ordered
    names = np.array(ordered.places or ("",) * len(ordered), dtype=object)
    is_middle = np.insert(np.array(order) == middle, ends, True)
    return replace(
        ordered,
        sets=tuple(np.where(repeated, EVERY_LEG, ordered.serving).tolist()),
        places=tuple(np.where(is_middle, REFERENCE, names).tolist()),
    )


def _ways(mechanism: Mechanism, plan: Plan) -> Array:
    """Return the lengths of ways between rows, shape (N, N).

    What the drive that moves most moves of its span, and the platform of its longest way.
    """
    readings = plan.readings
    if readings is None:
        readings = inverse(mechanism, plan.poses, planned_influences(mechanism, plan)).readings
    positions = plan.poses[:, : mechanism.platform.lengths]
    ways = np.zeros((len(plan), len(plan)))
    for column in positions.T:
        ways += (column[:, None] - column) ** 2
    ways = np.sqrt(ways / (ways.max(initial=0.0) or 1.0))
    driven = np.zeros_like(ways)
    for column in np.nan_to_num(readings).T:
        np.maximum(driven, np.abs(column[:, None] - column) / (np.ptp(column) or 1.0), out=driven)
    return ways + driven


def _way_round(ways: Array) -> Array:
    """Return all N places in the order of a short way from the first and back, shape (N,).

    Of lengths of ways (N, N): the nearest next (greedy), then ways are uncrossed while that makes
    it shorter (2-opt).
    """
    path, ahead = [0], list(range(1, len(ways)))
    while ahead:
        path.append(ahead.pop(int(np.argmin(ways[path[-1], ahead]))))
    order, shorter = np.array(path), True
    while shorter:
        shorter = False
        for place in range(len(order) - 2):
            before, first = order[place : place + 2]
            last, after = order[place + 1 :], np.roll(order, -1)[place + 1 :]
            gain = ways[before, first] + ways[last, after]
            gain -= ways[before, last] + ways[first, after]
            end = int(np.argmax(gain))
            if gain[end] > 1e-12:
                order[place + 1 : place + 2 + end] = order[place + 1 : place + 2 + end][::-1].copy()
                shorter = True
    return order


def with_verification(
    mechanism: Mechanism, plan: Plan, offered: Plan, count: int, seed: int = 0
) -> Plan:
    """Return a plan with poses beside it that no fit follows: those of the set ``verify``.

    So many are taken at random from those offered, which are spread over the workspace.

    Raises:
        ObservabilityError: fewer are in reach.
    """
    offered = as_plan(mechanism, offered)
    taken = {pose.tobytes() for pose in plan.poses}
    free = np.array([pose.tobytes() not in taken for pose in offered.poses], dtype=bool)
    rows = np.random.default_rng(seed).permutation(np.flatnonzero(free))
    reached = joints_at(mechanism, offered.rows(rows)).reached.all(axis=1)
    chosen = offered.rows(rows[reached][:count])
    if len(chosen) < count:
        raise ObservabilityError(
            f"{len(chosen)} poses are left to verify with, of {count} that were asked for; offer "
            "more candidates, or ask for fewer"
        )
    readings = None
    if plan.readings is not None and chosen.readings is not None:
        readings = np.concatenate((plan.readings, chosen.readings))
    return Plan(
        np.concatenate((plan.poses, chosen.poses)),
        (*plan.serving, *(VERIFY,) * count),
        readings,
        places=None if plan.places is None else (*plan.places, *("",) * count),
        contacts={name: names + chosen.contacts[name] for name, names in plan.contacts.items()},
    )
