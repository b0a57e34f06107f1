"""Choosing poses to measure, for one leg and mapped to all, or for all legs at once.

- ``independent``: each leg its own poses (5R paper);
- ``symmetric``: one leg's poses, carried to the other legs of its orbit by the group (3-RRR paper,
  Eqs. 14, 22); of several orbits one reference leg each;
- ``orbits``: whole orbits of the group, so that each measured pose serves every leg;
- ``common``: poses that are best for the parameters of all legs together (the papers'
  traditional identification).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np

from pincal.blas import on_one_thread
from pincal.design.orbits import (
    merged,
    multiplicities,
    orbit_of,
    orbits_of_legs,
    selection_group,
    smallest,
)
from pincal.design.search import Search, SelectionOptions
from pincal.errors import MeasurementError, ObservabilityError
from pincal.estimation.observability.indices import Indices, identifiability, indices, r_diagonal
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.kinematics.closure import largest_size, nominal_legs
from pincal.kinematics.configurations import as_plan, joints_at
from pincal.kinematics.derivatives import leg_demands_at
from pincal.model.checks import ALIKE, count_of, described
from pincal.model.measurements import EVERY_LEG, VERIFY, Plan
from pincal.model.mechanism import Mechanism
from pincal.types import Array
from pincal.words.wording import mapped_diagonals

_SAMPLE = 64  # candidates on which it is looked at whether rows map
Protocol = Literal["independent", "symmetric", "orbits", "common"]


@dataclass(frozen=True)
class LegDesign:
    """What a selection gives one leg."""

    leg: str
    poses: int
    """Poses that serve the leg."""
    efficiency: float
    """(det/det of the continuous bound)^(1/n) of the search that chose them."""
    indices: Indices
    """Of the identification Jacobian in readings, not weighted."""
    r_diagonal: Array
    """|R_ii| of the same, shape (n_params,)."""
    condition: float
    reference: str
    """Leg whose poses were mapped to this one; the leg itself if none was."""


@dataclass(frozen=True, repr=False)
class Selection:
    """Selected poses and how good they are.

    Example:
        >>> import pincal
        >>> candidates = pincal.sample_workspace("5R", 200, seed=0)
        >>> selection = pincal.select_poses("5R", candidates, 8)
        >>> len(selection.plan), bool(0.8 < selection.efficiency <= 1.0)
        (16, True)
    """

    plan: Plan
    protocol: Protocol
    legs: tuple[LegDesign, ...]
    candidates: int
    """Number of poses that all legs reach, copies counted."""
    unreachable: int
    """Number of candidate poses out of reach of a leg, which were left out."""

    @property
    def efficiency(self) -> float:
        """Smallest efficiency of all legs."""
        return min(leg.efficiency for leg in self.legs)

    @property
    def diagonals_differ(self) -> float:
        """Largest part by which |R_ii| of a leg differ from those of its reference leg.

        Mapped poses make them equal (3-RRR paper, Eq. 10) if one leg's parameters become the
        other's one by one: with equal offsets and gains, of radii and angles, but not of Cartesian
        coordinates, which the element turns into each other. Their product is equal even then.
        """
        diagonals = {leg.leg: leg.r_diagonal for leg in self.legs}
        return max(
            float(np.abs(leg.r_diagonal / diagonals[leg.reference] - 1.0).max())
            for leg in self.legs
        )

    @property
    def mapped(self) -> bool:
        """Whether poses of a leg were mapped to others, whose |R_ii| can be compared with its."""
        return self.protocol == "symmetric" and len(self.legs) > 1

    def __repr__(self) -> str:
        size = f"{len(self.plan.poses)} poses of {self.candidates}"
        return f"Selection({self.protocol}, {size}, efficiency {self.efficiency:.3f})"

    def __str__(self) -> str:
        rows = [
            f"  {leg.leg:<12} {leg.poses:5d} {leg.efficiency:11.4f} {leg.condition:10.3g}"
            for leg in self.legs
        ]
        lines = [repr(self), "  leg          poses  efficiency  condition", *rows]
        if self.mapped and self.diagonals_differ >= ALIKE:
            lines.append(f"  {mapped_diagonals(self.diagonals_differ)}")
        return "\n".join(lines)


@on_one_thread
def select_poses(
    mechanism: GivenMechanism,
    candidates: Array,
    count: int = 24,
    protocol: Protocol = "symmetric",
    **options: Any,
) -> Selection:
    """Return poses chosen from candidates for D-optimality, with a certificate.

    Rows are weighted by the noise they carry, so that poses near type-1 singularities do
    not look better than they are.

    Args:
        mechanism: The mechanism.
        candidates: Poses to choose from, coordinates of shape (M, dof), [m] and [rad]; one that
            is there twice counts once, whatever its whole turns and its last digits.
        count: Poses for each leg; with ``orbits``, number of orbits; with ``common``, poses.
        protocol: See the module.
        **options: ``noise``, ``seed``, ``starts``, ``progress``: see ``SelectionOptions``.

    Raises:
        ObservabilityError: too few poses for the parameters, too few candidates in reach, or
            candidates that leave a parameter undetermined.
        SymmetryError: the mechanism lacks the symmetry that ``symmetric`` or ``orbits`` needs.
        MeasurementError: a residual without noise.
    """
    mechanism = as_mechanism(mechanism).at_reference
    count_of(count, "count", MeasurementError)
    if not isinstance(protocol, str) or protocol not in get_args(Protocol):
        known = ", ".join(get_args(Protocol))
        raise MeasurementError(f"no protocol {described(protocol)}; expected one of {known}")
    _refuse_ranks(mechanism)
    search = Search(mechanism, candidates, count, SelectionOptions(**options))
    names = references = mechanism.leg_names
    if protocol == "independent":
        choices = [_for_leg(search, name) for name in names]
        sets = tuple(name for name in names for _ in range(count))
        plan = Plan(np.concatenate([poses for poses, _ in choices]), sets)
        efficiencies = [efficiency for _, efficiency in choices]
    elif protocol == "common":
        search.options.say("choosing common poses")
        poses, efficiency = search.choose(names)
        plan, efficiencies = Plan(poses, (EVERY_LEG,) * count), [efficiency] * len(names)
    else:
        plan, efficiencies, references = _by_symmetry(search, orbits=protocol == "orbits")
    legs = _leg_designs(mechanism, plan, efficiencies, references)
    return Selection(plan, protocol, legs, search.in_reach, search.unreachable)


def _for_leg(search: Search, leg: str) -> tuple[Array, float]:
    """Return the best poses for one leg, and their efficiency."""
    search.options.say(f"choosing poses for {leg}")
    return search.choose([leg])


def _by_symmetry(search: Search, *, orbits: bool) -> tuple[Plan, list[float], tuple[str, ...]]:
    """Return poses mapped by the mechanism's group, and each leg's efficiency and reference leg.

    Args:
        search: The search.
        orbits: Whether every pose is to serve every leg.

    Raises:
        SymmetryError: the group carries no leg onto another one, or not its parameters.
    """
    mechanism, platform = search.mechanism, search.mechanism.platform
    group = selection_group(mechanism)
    spread = search.poses[:: max(1, len(search.poses) // _SAMPLE)][:_SAMPLE]
    leg_orbits = orbits_of_legs(group, spread, search.noise)
    first = {leg: orbit.legs[0] for orbit in leg_orbits for leg in orbit.legs}
    references = tuple(first[name] for name in mechanism.leg_names)
    if orbits:
        search.options.say("choosing orbits")
        times = multiplicities(leg_orbits)
        legs = np.repeat([orbit.legs[0] for orbit in leg_orbits], times).tolist()
        elements = smallest(group)
        chosen, efficiency = search.choose(legs, elements)
        matrices, first_images = orbit_of(elements, platform.matrices(chosen))
        poses = platform.from_matrices(matrices[first_images])
        return Plan(poses, (EVERY_LEG,) * len(poses)), [efficiency] * len(first), references
    images, serving, efficiencies = [], [], {}
    for orbit in leg_orbits:
        chosen, efficiency = _for_leg(search, orbit.legs[0])
        carried = zip(orbit.legs, orbit.carriers, orbit.equivalent, strict=True)
        for leg, element, equivalent in carried:
            images.append(element.poses(platform, chosen))
            serving += [leg] * len(chosen)
            efficiencies[leg] = (
                efficiency if equivalent else search.efficiency(leg, element, chosen)
            )
    plan = merged(mechanism, np.concatenate(images), serving)
    return plan, [efficiencies[name] for name in mechanism.leg_names], references


def _refuse_ranks(mechanism: Mechanism) -> None:
    """Raise if a leg demands more of a pose than it has readings.

    Raises:
        ObservabilityError: its rows by readings lack rank, so that no index of them has a meaning.
    """
    for leg in mechanism.legs:
        rows = mechanism.platform.equations(leg)
        if rows > len(leg.sensors):
            raise ObservabilityError(
                f"{leg.name} of {mechanism.name!r} makes {rows} equations at a pose and has "
                f"{len(leg.sensors)} reading: rows of readings lack rank, and poses for single "
                "legs cannot be compared by them. Choose configurations for all parameters "
                "together: select_configurations, or 'pincal select' without a protocol"
            )


def _leg_designs(
    mechanism: Mechanism, plan: Plan, efficiencies: Sequence[float], references: Sequence[str]
) -> tuple[LegDesign, ...]:
    """Return what a plan gives each leg, whose efficiency and reference leg are known."""
    matrices, legs = mechanism.platform.matrices(plan.poses), nominal_legs(mechanism)
    served = [matrices[plan.serves(name)] for name in mechanism.leg_names]
    demands, designs = leg_demands_at(legs, served), []
    parts = zip(mechanism.legs, demands, efficiencies, references, strict=True)
    for leg, demand, efficiency, reference in parts:
        C = demand.as_joint().parameter.reshape(-1, len(leg.parameters))
        names = [f"{leg.name}.{name}" for name in leg.parameter_names]
        designs.append(
            LegDesign(
                leg.name,
                len(demand.value),
                efficiency,
                indices(C),
                r_diagonal(C),
                identifiability(C, names).condition,
                reference,
            )
        )
    return tuple(designs)


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
    """Return a plan in which one pose is measured again every so many rows, and at its end.

    The pose in the middle: with the least sum of squared twists to the others. Its rows have the
    name ``reference``, and differ by noise and by what drifts.

    Args:
        mechanism: The mechanism.
        plan: The poses, in their order.
        every: How many rows lie between.

    Raises:
        MeasurementError: no rows between.
    """
    count_of(every, "every", MeasurementError, 1)
    platform, count = mechanism.platform, len(plan)
    size = largest_size(mechanism.legs)
    per = np.array([1.0 / size if unit == "m" else 1.0 for unit in platform.units])
    fitted = np.flatnonzero(~plan.verifying)
    twists = (
        platform.twists_between(np.tile(plan.poses[row], (len(fitted), 1)), plan.poses[fitted])
        for row in fitted
    )
    middle = int(fitted[np.argmin([((per * twist) ** 2).sum() for twist in twists])])
    order: list[int] = []
    for begin in range(0, count, every):
        order += [middle, *range(begin, min(begin + every, count))]
    order.append(middle)
    ordered = plan.rows(np.array(order))
    sets = list(ordered.serving)
    for row in (*range(0, len(order) - 1, every + 1), -1):
        sets[row] = EVERY_LEG
    names = ordered.places or ("",) * len(order)
    places = tuple(REFERENCE if row == middle else names[i] for i, row in enumerate(order))
    return replace(ordered, sets=tuple(sets), places=places)


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
    )
