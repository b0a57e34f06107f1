"""Order of a plan's poses: rounds of short ways, with repetitions of a reference pose.

Rounds mix the legs' poses, so that drift does not become an error of one leg.
"""

from dataclasses import replace

import numpy as np
from scipy.spatial.distance import cdist

from pincal.errors import MeasurementError, ObservabilityError
from pincal.kinematics.configurations import as_plan, inverse, joints_at, planned_influences
from pincal.model import EVERY_LEG, ROW, TO, VERIFY, Mechanism, Plan
from pincal.model.checks import count_of
from pincal.types import Array, Mask

REFERENCE = "reference"
"""Name of the pose that is measured repeatedly."""
_ROUND = 8  # fewest rows of a round
_BLOCKED = 1e3  # length of a blocked way


def in_rounds(
    mechanism: Mechanism,
    plan: Plan,
    rounds: int = 3,
    every: int | None = None,
    seed: int = 0,
    blocked: Mask | bool = False,
) -> Plan:
    """Return a plan in driving order, with repetitions of a reference pose.

    Each round visits a random share of every set by a short way, which begins and ends at the
    middle pose (least sum of squared ways to the others). Rows of the middle pose have the name
    ``reference``; they differ only by noise and drift.

    Args:
        mechanism: The mechanism.
        plan: N rows in any order.
        rounds: Number of rounds; fewer if they would have less than eight rows.
        every: Number of rows between measurements of the reference, which is measured at both ends,
            too. By default it is measured at the ends of all rounds; 0 for never.
        seed: Seed of the shares.
        blocked: Mask, shape (N, N), of ways between rows to avoid if possible.

    Raises:
        MeasurementError: there is no round, or ``every`` is negative.
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
    """Return lengths of ways between rows, (N, N): platform's plus most moved drive's, scaled."""
    readings = plan.readings
    if readings is None:
        readings = inverse(mechanism, plan.poses, planned_influences(mechanism, plan)).readings
    positions, driven = plan.poses[:, : mechanism.platform.lengths], np.nan_to_num(readings)
    spans = np.ptp(driven, axis=0)
    driven = driven / np.where(spans > 0.0, spans, 1.0)
    ways = cdist(positions, positions) if positions.size else np.zeros((len(plan), len(plan)))
    return np.asarray(ways / (ways.max() or 1.0) + cdist(driven, driven, "chebyshev"))


def _way_round(ways: Array) -> Array:
    """Return the order of N places on a short way from the first and back to it, shape (N,).

    ``ways`` are lengths, shape (N, N). The nearest place comes next (greedy); then ways are
    uncrossed as long as that shortens the total (2-opt).
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


def with_distances(plan: Plan, count: int) -> Plan:
    """Return a plan with ``count`` distances from each row to others; rows are named 1, 2, ….

    The other rows are near and far in the plan; no pair is measured twice, nor any between
    repetitions of one pose.

    Raises:
        ObservabilityError: there are not enough other rows.
    """
    rows = len(plan)
    if 2 * count > rows - 1:
        raise ObservabilityError(
            f"{rows} poses allow at most {(rows - 1) // 2} distances from each, no pair measured "
            f"twice; {count} were asked for"
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


def with_verification(
    mechanism: Mechanism, plan: Plan, offered: Plan, count: int, seed: int = 0
) -> Plan:
    """Return a plan with additional poses of the set ``verify``, which no fit uses.

    They are ``count`` random ones of the offered poses, which are spread over the workspace.

    Raises:
        ObservabilityError: fewer poses are in reach.
    """
    offered, taken = as_plan(mechanism, offered), {pose.tobytes() for pose in plan.poses}
    free = [row for row, pose in enumerate(offered.poses) if pose.tobytes() not in taken]
    rows = np.random.default_rng(seed).permutation(np.array(free, dtype=np.intp))
    chosen = offered.rows(rows[joints_at(mechanism, offered.rows(rows)).reached.all(axis=1)])
    if len(chosen) < count:
        raise ObservabilityError(
            f"only {len(chosen)} poses remain for verification, but {count} were asked for; offer "
            "more candidates, or ask for fewer"
        )
    chosen, readings = chosen.rows(np.arange(count)), None
    if plan.readings is not None and chosen.readings is not None:
        readings = np.concatenate((plan.readings, chosen.readings))
    return Plan(
        np.concatenate((plan.poses, chosen.poses)),
        (*plan.serving, *(VERIFY,) * count),
        readings,
        places=None if plan.places is None else (*plan.places, *("",) * count),
        contacts={name: names + chosen.contacts[name] for name, names in plan.contacts.items()},
    )
