"""Configurations chosen for what measurements there tell of all parameters together.

Rows are those of the best estimator (see ``forecast``), whatever part of the platform is
measured and wherever the tracker stands. Directions that no candidate tells are left out: the
choice is D-optimal in what can be identified, its efficiency against the bound that no choice
exceeds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.design.certificate import continuous_design
from pincal.design.distinct import distinct
from pincal.design.exchange import exchange
from pincal.design.forecast import information_rows
from pincal.errors import ObservabilityError
from pincal.estimation.observability import Identifiability, identifiability, scaled_axes
from pincal.kinematics.configurations import as_plan, check_reached, legs_at
from pincal.model.measurements import Noise, Plan
from pincal.model.mechanism import Mechanism
from pincal.model.setup import Setup

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ConfigurationChoice:
    """Chosen configurations, and how good they are."""

    plan: Plan
    efficiency: float
    """Against the bound on any choice, 0 to 1 (D-efficiency in what can be identified)."""
    rank: Identifiability
    """Of all candidates together."""
    measured: tuple[str, ...]
    candidates: int
    """Configurations that the mechanism has."""


def select_configurations(
    mechanism: Mechanism,
    candidates: Plan | Array,
    count: int,
    *,
    noise: Noise | None = None,
    measured: Sequence[str] | None = None,
    setup: Setup | None = None,
    seed: int | np.random.Generator = 0,
    starts: int = 20,
    progress: Callable[[str], None] | None = None,
) -> ConfigurationChoice:
    """Return configurations chosen from candidates for D-optimality, with a certificate.

    Args:
        mechanism: The mechanism.
        candidates: Poses of shape (M, dof), or a plan with readings; one that is there twice
            counts once, whatever its whole turns and its last digits.
        count: Number of configurations.
        noise: Standard deviations of the measurements to come; only their ratios matter.
        measured: What will be measured of the platform (see ``forecast``).
        setup: What measured numbers will mean.
        seed: Seed or generator of the random starts.
        starts: Starts of the exchange; the best is kept.
        progress: Called with what is being done.

    Raises:
        ObservabilityError: too few configurations for what can be identified.
        MeasurementError: unknown freedoms, or measurements without noise or equations, or no
            candidate in reach.
    """
    tell = progress or (lambda _: None)
    plan = as_plan(mechanism, candidates)
    own = distinct(mechanism.platform, plan.poses, plan.readings)
    plan = Plan(plan.poses[own], readings=None if plan.readings is None else plan.readings[own])
    tell("looking at candidates")
    legs = legs_at(mechanism, plan)
    if not len(legs.poses):
        check_reached(mechanism, plan, "the candidates")
    rows, names, kept = information_rows(
        mechanism, legs, noise or Noise(), measured, setup or Setup()
    )
    flat = rows.reshape(-1, rows.shape[2])
    found = identifiability(flat, names)
    lengths, _, axes = scaled_axes(flat)
    blocks = (rows / lengths) @ axes[: found.rank].T
    if count * blocks.shape[1] < found.rank or len(blocks) < count:
        raise ObservabilityError(
            f"{count} of {len(blocks)} configurations give {count * blocks.shape[1]} equations for "
            f"{found.rank} unknowns that can be told; choose at least "
            f"{-(-found.rank // blocks.shape[1])}, better two or three times as many"
        )
    tell("choosing configurations")
    design = continuous_design(blocks)
    rng = np.random.default_rng(seed)
    chosen, log_det = exchange(blocks, count, design.weights, rng, starts)
    return ConfigurationChoice(
        Plan(
            legs.poses[chosen],
            readings=None if legs.readings is None else legs.readings[chosen],
        ),
        design.efficiency(log_det, count, found.rank),
        found,
        kept,
        len(blocks),
    )
