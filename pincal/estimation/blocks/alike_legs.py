"""Conditions of legs that differ only in where they begin, evaluated in one call.

A call costs more than the kinematics of some hundred rows, so rows of each leg stand below those of
the one before.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pincal.estimation.blocks.leg_condition import LegCondition, Met
from pincal.estimation.linear import Follow, State
from pincal.kinematics.batches import repeated
from pincal.kinematics.closure import LegClosure
from pincal.kinematics.derivatives import demands
from pincal.kinematics.nearest_closure import followed, nearest_closure
from pincal.types import Array


@dataclass(frozen=True)
class AlikeMet:
    """What some alike legs demand at a state."""

    legs: tuple[Met, ...]
    after: Callable[[Sequence[Array], Array], list[Array]]
    """Returns joints of each near those after changes of its parameters, (n_params,), and twists
    of the poses, (N, dof)."""


def all_met(
    conditions: Sequence[LegCondition],
    alike: Sequence[Sequence[int]],
    columns: Sequence[slice],
    state: State,
) -> tuple[tuple[Met, ...], Follow]:
    """Return what all legs demand at a state, and how their joints follow steps.

    Args:
        conditions: Of all legs, in order.
        alike: Places of those that are evaluated in one call.
        columns: Parameters of each leg among the unknowns.
        state: Where.

    Raises:
        MeasurementError: joint residual, and a pose out of reach.
        MechanismError: a homed sensor, and a home pose out of reach.
    """
    groups = []
    for places in alike:
        parameters = [state.parameters[columns[place]] for place in places]
        joints = [state.joints[place] for place in places]
        own = [conditions[place] for place in places]
        groups.append(evaluated(own, parameters, state.matrices, joints))
    order = np.argsort([place for places in alike for place in places])
    met = [one for group in groups for one in group.legs]

    def after(step: Array, twists: Array) -> tuple[Array, ...]:
        joints: list[Array] = []
        for places, group in zip(alike, groups, strict=True):
            joints += group.after([step[columns[place]] for place in places], twists)
        return tuple(joints[place] for place in order)

    return tuple(met[place] for place in order), after


def evaluated(
    alike: Sequence[LegCondition],
    parameters: Sequence[Array],
    matrices: Array,
    joints: Sequence[Array | None],
) -> AlikeMet:
    """Return the values and derivatives of the conditions of alike legs, evaluated in one call.

    Args:
        alike: Conditions of one form, at the same N rows.
        parameters: Of each leg its parameter values, shape (n_params,).
        matrices: Poses ``T_base_platform``, shape (N, 4, 4).
        joints: Of each leg where the search for passive joints starts, shape (N, n_joints
            [+ n_deformed]); None if that is not known.

    Raises:
        MeasurementError: joint residual, and a pose out of reach.
        MechanismError: a homed sensor, and a home pose out of reach.
    """
    legs = [
        LegClosure(one.leg, one.platform, own) for one, own in zip(alike, parameters, strict=True)
    ]
    if alike[0].kind == "joint":
        each_ = zip(alike, legs, strict=True)
        predicted = tuple(one.predicted(leg, matrices) for one, leg in each_)
        return AlikeMet(predicted, lambda *_: [one.joints for one in predicted])
    known = [one.known for one in alike]
    closed, found = nearest_closure(legs, repeated(matrices, len(legs)), known, joints)
    by_leg = found.reshape(len(legs), len(matrices), found.shape[1])

    def after(changes: Sequence[Array], twists: Array) -> list[Array]:
        there = found.copy()
        there[:, legs[0].leg.passive] += followed(legs, closed, known, changes, twists)
        return list(there.reshape(by_leg.shape))

    met = zip(demands(legs, closed, known), by_leg, strict=True)
    return AlikeMet(tuple(Met(*pair) for pair in met), after)
