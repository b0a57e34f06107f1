"""Plans in the order in which they are measured, with poses measured again, and some to verify."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pincal.errors import MeasurementError, ObservabilityError
from pincal.kinematics.configurations import as_plan, joints_at
from pincal.model.checks import count_of
from pincal.model.measurements import EVERY_LEG, VERIFY, Plan
from pincal.model.mechanism import Mechanism
from pincal.model.relations import ROW, TO


def with_distances(plan: Plan, count: int) -> Plan:
    """Return a plan whose rows, called 1, 2, …, are each measured from so many others.

    Rows far from each other in the plan and near ones alike, no pair twice.

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
    columns = {
        f"distance_{slot}{TO}": tuple(np.roll(names, -step).tolist())
        for slot, step in enumerate(steps, start=1)
    }
    return replace(plan, contacts={**plan.contacts, ROW: names, **columns}) if count else plan


REFERENCE = "reference"
"""Name of the pose that is measured again and again."""


def in_turns(plan: Plan, seed: int = 0) -> Plan:
    """Return a plan whose sets take turns, each in a random order.

    Sets of one size have the same order: poses that a symmetry maps follow one another.
    """
    sets = np.array(plan.serving)
    when = np.empty(len(plan))
    for name in np.unique(sets):
        rows = np.flatnonzero(sets == name)
        order = np.random.default_rng(seed).permutation(len(rows))
        when[rows[order]] = (np.arange(len(rows)) + 0.5) / len(rows)
    return plan.rows(np.argsort(when, kind="stable"))


def with_reference(mechanism: Mechanism, plan: Plan, every: int) -> Plan:
    """Return a plan in which one pose is measured again every so many rows, and at both ends.

    The pose in the middle: with the least sum of squared twists to the others. Its rows have the
    name ``reference``, and differ by noise and by what drifts.

    Raises:
        MeasurementError: no rows between.
    """
    count_of(every, "every", MeasurementError, 1)
    platform, count = mechanism.platform, len(plan)
    per = np.array([1.0 / mechanism.size if unit == "m" else 1.0 for unit in platform.units])
    fitted = np.flatnonzero(~plan.verifying)
    twists = (
        platform.twists_between(np.tile(plan.poses[row], (len(fitted), 1)), plan.poses[fitted])
        for row in fitted
    )
    middle = int(fitted[np.argmin([((per * twist) ** 2).sum() for twist in twists])])
    places = [*range(0, count, every), count]  # before which it is measured
    repeated = np.insert(np.zeros(count, dtype=bool), places, True)
    order = np.insert(np.arange(count), places, middle)
    ordered = plan.rows(order)
    names = np.array(ordered.places or ("",) * len(order), dtype=object)
    return replace(
        ordered,
        sets=tuple(np.where(repeated, EVERY_LEG, ordered.serving).tolist()),
        places=tuple(np.where(order == middle, REFERENCE, names).tolist()),
    )


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
