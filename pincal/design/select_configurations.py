"""Configurations chosen for all parameters together.

Rows are those of the best estimator (see ``forecast``), whatever part of the platform is
measured and wherever the tracker is. Directions that no candidate determines are left out. The
choice is D-optimal in what can be identified, or makes the calibrated platform most accurate over
the candidates; its efficiency is against the bound that no choice exceeds.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, get_args

import numpy as np

from pincal.blas import one_thread
from pincal.design.forecast import apart_from_frames, information_rows, null_directions, touching
from pincal.design.optimal import Criterion, continuous_design, exchange
from pincal.design.orbits import distinct
from pincal.design.platform_error import seen_of
from pincal.design.select import Goal, Selection, SelectionOptions
from pincal.errors import MeasurementError, ObservabilityError
from pincal.estimation.observability.indices import NEGLIGIBLE, identifiability, scaled_axes
from pincal.files.measurements import as_noise
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.instruments.setup_file import read_setup
from pincal.kinematics.closure import nominal_legs
from pincal.kinematics.configurations import as_plan, check_reached, legs_at
from pincal.model.checks import count_of
from pincal.model.measurements import Plan
from pincal.model.setup import Setup
from pincal.types import Array


@one_thread()
def select_configurations(
    mechanism: GivenMechanism,
    candidates: Plan | Array,
    count: int,
    *,
    measured: Sequence[str] | None = None,
    setup: Setup | None = None,
    goal: Goal = "parameters",
    **options: Any,
) -> Selection:
    """Return configurations chosen from candidates, with a certificate.

    Args:
        mechanism: The mechanism.
        candidates: Poses of shape (M, dof), or a plan with readings; one that is there twice
            counts once, whatever its whole turns and its last digits.
        count: Number of configurations.
        measured: What will be measured of the platform (see ``forecast``).
        setup: What measured numbers will mean.
        goal: ``"parameters"``: D-optimality. ``"platform"``: the calibrated platform's mean
            variance over the candidates is smallest (L-optimality), of its position and, times
            the radius at which its legs hold it, its orientation.
        **options: ``noise``, ``seed``, ``starts``: see ``SelectionOptions``.

    Raises:
        ObservabilityError: too few configurations for what can be identified.
        MeasurementError: unknown freedoms or goal, or measurements without noise or equations, or
            no candidate in reach.
    """
    mechanism = as_mechanism(mechanism).at_reference
    count_of(count, "count", MeasurementError, 1)
    search = SelectionOptions(**options)
    if goal not in get_args(Goal):
        raise MeasurementError(f"no goal {goal!r}; expected one of {', '.join(get_args(Goal))}")
    plan = as_plan(mechanism, candidates)
    originals = distinct(mechanism.platform, plan.poses, plan.readings)
    noise, setup = as_noise(search.noise), read_setup(setup or Setup())
    plan = Plan(plan.poses, readings=plan.readings, contacts=plan.contacts).rows(originals)
    setup = setup.of_rows(plan.contacts)
    plan = touching(mechanism, plan, setup)
    legs = legs_at(mechanism, plan)
    if not len(legs.poses):
        check_reached(mechanism, plan, "the candidates")
    if len(legs.poses) < count:
        raise ObservabilityError(
            f"{mechanism.name!r} reaches {len(legs.poses)} of {len(plan)} candidates, of which no "
            f"two are alike; {count} are to be chosen. Give more candidates"
        )
    white, _, unknowns, names = information_rows(mechanism, legs, noise, measured, setup)
    flat = white.reshape(-1, white.shape[2])
    identifiable = identifiability(flat, unknowns)
    rank, (lengths, _, axes) = identifiable.rank, scaled_axes(flat)
    blocks = (white / lengths) @ axes[:rank].T
    if count * blocks.shape[1] < rank:
        raise ObservabilityError(
            f"{count} of {len(blocks)} configurations give {count * blocks.shape[1]} equations for "
            f"{rank} unknowns that can be identified; choose at least "
            f"{-(-rank // blocks.shape[1])}, better two or three times as many"
        )
    rng, criterion = np.random.default_rng(search.seed), Criterion()
    if goal == "platform":
        n = legs.gain.shape[2]
        lost = null_directions(lengths, axes, rank)[:n]
        frames = apart_from_frames(mechanism, legs, lost, setup)[2]
        gain, units = seen_of(mechanism, legs.poses, legs.gain, frames)
        gain = gain[np.isfinite(gain).all(axis=(1, 2))]
        points = [leg.targets(np.eye(4)[None])[:, :3] for leg in nominal_legs(mechanism)]
        radius = np.sqrt((np.concatenate(points) ** 2).sum(axis=1).mean()) or mechanism.size
        size = np.where([unit == "m" for unit in units], 1.0, radius)
        moved = (gain * size[:, None]).reshape(-1, n) / lengths[:n] @ axes[:rank, :n].T
        values, directions = np.linalg.eigh(moved.T @ moved)
        moving = values > NEGLIGIBLE**2 * values.max()
        criterion = Criterion(directions[:, moving] * np.sqrt(values[moving]))
    design = continuous_design((blocks,), criterion)
    chosen, value = exchange((blocks,), count, design.priority, rng, search.starts, criterion)
    plan = Plan(legs.poses, readings=legs.readings, contacts=legs.contacts).rows(chosen)
    efficiency = design.efficiency(value, count)
    chosen_of = goal, efficiency, len(blocks)
    return Selection(plan, count, *chosen_of, rank=identifiable, measured=names)
