"""The order of measuring: sets take turns, so that what drifts with time is no leg's error.

Leg after leg, a tracker that drifts or a frame that warms up moves each leg's poses by another
amount, and the fit takes that for offsets of the legs.
"""

from __future__ import annotations

import numpy as np

from pincal.errors import ObservabilityError
from pincal.kinematics.configurations import as_plan, joints_at
from pincal.model.measurements import EVERY_LEG, VERIFY, Plan
from pincal.model.mechanism import Mechanism


def in_turns(plan: Plan, seed: int = 0) -> Plan:
    """Return a plan whose sets take turns, each in a random order.

    Sets of one size have the same order: poses that a symmetry maps follow one another.
    """
    sets = np.array(plan.sets or (EVERY_LEG,) * len(plan))
    when = np.empty(len(plan))
    for name in np.unique(sets):
        own = np.flatnonzero(sets == name)
        order = np.random.default_rng(seed).permutation(len(own))
        when[own[order]] = (np.arange(len(own)) + 0.5) / len(own)
    return plan.rows(np.argsort(when, kind="stable"))


def with_verification(
    mechanism: Mechanism, plan: Plan, offered: Plan, count: int, seed: int = 0
) -> Plan:
    """Return a plan with poses beside it that no fit follows: those of the set ``verify``.

    Args:
        mechanism: The mechanism.
        plan: Poses that were chosen.
        offered: Poses from which to take the others at random: spread over the workspace.
        count: How many.
        seed: Seed.

    Raises:
        ObservabilityError: fewer are in reach.
    """
    offered = as_plan(mechanism, offered)
    taken = {one.tobytes() for one in plan.poses}
    free = np.array([one.tobytes() not in taken for one in offered.poses], dtype=bool)
    some = np.random.default_rng(seed).permutation(np.flatnonzero(free))
    reached = joints_at(mechanism, offered.rows(some)).reached.all(axis=1)
    chosen = offered.rows(some[reached][:count])
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
        (*(plan.sets or (EVERY_LEG,) * len(plan)), *(VERIFY,) * count),
        readings,
    )
