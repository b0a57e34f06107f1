"""Choice of poses to measure: for single legs, mapped to all, or for all legs together.

The protocol says which legs use a pose:

- ``independent``: each leg has its own poses (5R paper);
- ``symmetric``: one leg's poses, carried to the other legs of its orbit by the group (3-RRR paper,
  Eqs. 14, 22); each orbit of legs has a reference leg;
- ``orbits``: whole orbits of the group, so that each measured pose serves every leg;
- ``common``: poses that are best for the parameters of all legs together (the papers'
  traditional identification).

Configurations for all legs together are chosen by the rows of the best estimator (see
``forecast``), for any measured quantities and unknown frames; directions that no candidate
determines are left out. Each choice has its efficiency against a bound that no choice exceeds.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from math import gcd
from typing import Any, Literal, get_args

import numpy as np

from pincal.attached import attached
from pincal.blas import one_thread
from pincal.design import orbits
from pincal.design.forecast import (
    apart_from_frames,
    information_rows,
    leg_rows,
    null_directions,
    touching,
)
from pincal.design.optimal import Criterion, Parts, continuous_design, exchange, triangles
from pincal.design.platform_error import seen_of
from pincal.errors import MeasurementError, ObservabilityError
from pincal.estimation.observability.identifiable import (
    NEGLIGIBLE,
    Identifiability,
    Indices,
    identifiability,
    indices,
    r_diagonal,
    scaled_axes,
)
from pincal.files.measurements import as_noise
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.instruments.setup_file import read_setup
from pincal.kinematics.closure import LegClosure, nominal_legs
from pincal.kinematics.configurations import as_plan, check_reached, inverse, legs_at
from pincal.kinematics.derivatives import leg_demands_at
from pincal.model import EVERY_LEG, Mechanism, Noise, Plan, Setup
from pincal.model.checks import choice_of, count_of, generator_of
from pincal.symmetry.elements import IDENTITY, Element
from pincal.types import Array, Mask

_SAMPLE = 64  # candidates on which the mapping of rows is tested
Protocol = Literal["independent", "symmetric", "orbits", "common"]
Goal = Literal["parameters", "platform"]


@dataclass(frozen=True)
class LegDesign:
    """Quality of a selection for a single leg."""

    leg: str
    poses: int
    """Number of poses that serve the leg."""
    efficiency: float
    """(det/det of the continuous bound)^(1/n) of the search that chose the poses."""
    indices: Indices
    """Observability indices of the unweighted identification Jacobian of readings."""
    r_diagonal: Array
    """|R_ii| of the same Jacobian, shape (n_params,)."""
    condition: float
    reference: str
    """Leg whose poses were mapped to this one; the leg itself if none was."""


@dataclass(frozen=True, repr=False)
class Selection:
    """Selected poses and their quality.

    Example:
        >>> import pincal
        >>> candidates = pincal.sample_workspace("5R", 200, seed=0)
        >>> selection = pincal.select_poses("5R", candidates, 8)
        >>> len(selection.plan), bool(0.8 < selection.efficiency <= 1.0)
        (16, True)
    """

    plan: Plan
    count: int
    """Number of poses chosen; a plan that is driven has further rows."""
    protocol: Protocol | Goal
    """Protocol of ``select_poses``, or goal of ``select_configurations``."""
    efficiency: float
    """Efficiency, 0 to 1, against the bound on any choice: the smallest of all legs; or of all
    parameters, by determinant^(1/n) of those identifiable or by the platform's mean variance."""
    candidates: int
    """Number of candidates that all legs reach; for ``select_poses`` with copies."""
    unreachable: int = 0
    """Number of candidate poses out of reach of a leg, which were left out."""
    legs: tuple[LegDesign, ...] = ()
    """Quality for each leg, from ``select_poses``."""
    rank: Identifiability | None = None
    """Rank of all candidates of ``select_configurations`` together."""
    measured: tuple[str, ...] = ()

    def __repr__(self) -> str:
        size = f"{self.count} poses of {self.candidates}"
        return f"Selection({self.protocol}, {size}, efficiency {self.efficiency:.3f})"

    @attached
    def __str__(self) -> str:
        """Return the table of legs, or the measured quantities and the rank."""


class Search:
    """Search for the best poses among the candidates that a mechanism reaches."""

    def __init__(self, mechanism: Mechanism, candidates: Array, count: int, **options: Any) -> None:
        """Keep the candidates, coordinates of shape (M, dof), that all legs reach, without copies.

        Raises:
            ObservabilityError: fewer candidates are in reach than poses or orbits are wanted.
        """
        self.mechanism, self.count = mechanism, count
        self.noise, self.rng, self.starts = _search_options(**options)
        platform = mechanism.platform
        coordinates = platform.checked(platform.coordinates_of(candidates))
        poses = coordinates[inverse(mechanism, coordinates).reached.all(axis=1)]
        self.in_reach, self.unreachable = len(poses), len(coordinates) - len(poses)
        if len(poses) < max(count, 1):
            raise ObservabilityError(
                f"{mechanism.name} reaches {len(poses)} of {len(coordinates)} candidate poses; "
                f"{count} are to be chosen"
            )
        self.poses = poses[orbits.distinct(platform, poses)]

    def choose(
        self, legs: Sequence[str], elements: Sequence[Element] = (IDENTITY,)
    ) -> tuple[Array, float]:
        """Return the best poses for legs with their orbits, shape (N, dof), and their efficiency.

        A leg counts as often as it is listed. The first of ``elements`` is the identity.

        Raises:
            ObservabilityError: there are too few poses or candidates, or undetermined parameters.
        """
        poses, platform = self.poses, self.mechanism.platform
        images, first = orbits.orbit_of(elements, platform.matrices(poses))
        if len(elements) > 1:
            originals = orbits.distinct(
                platform, platform.from_matrices(orbits.representatives(images))
            )
            poses, images, first = poses[originals], images[:, originals], first[:, originals]
        rows = self.rows(images, legs, first)
        r, n = (sum(part.shape[axis] for part in rows) for axis in (1, 2))
        subject = legs[0] if len(legs) == 1 else self.mechanism.name
        _check_equations(self.count, r, n, f"parameters of {subject}")
        ranks = [
            identifiability(factor, self.mechanism.leg(leg).parameter_ids)
            for leg, factor in zip(legs, triangles(rows), strict=True)
        ]
        if lost := [rank.describe() for rank in ranks if not rank.complete]:
            raise ObservabilityError(
                f"the candidate poses leave parameters undetermined: {'; '.join(lost)}. "
                "Add poses that determine each of them, or make one of them a constant"
            )
        design = continuous_design(rows)
        chosen, value = exchange(rows, self.count, design.priority, self.rng, self.starts)
        efficiency = design.efficiency(value, self.count)
        if len(elements) == 1:
            return poses[chosen], efficiency
        return platform.from_matrices(images[:, chosen][first[:, chosen]]), efficiency

    def rows(self, images: Array, legs: Sequence[str], first: Mask | None = None) -> Parts:
        """Return whitened rows of legs, a part for each, at images of poses, shape (E, M, 4, 4).

        They are zero at images outside the mask ``first``, (E, M): each pose is measured once.
        """
        rows: dict[str, Array] = {}
        for leg in dict.fromkeys(legs):
            closure = LegClosure(self.mechanism.leg(leg), self.mechanism.platform)
            demands = (leg_demands_at((closure,), (image,))[0] for image in images)
            parts = np.stack([leg_rows(demand, self.mechanism, self.noise) for demand in demands])
            counts = np.isfinite(parts).all(axis=(2, 3), keepdims=True)
            if first is not None:
                counts &= first[:, :, None, None]
            rows[leg] = np.concatenate(np.where(counts, parts, 0.0), axis=1)
        return tuple(rows[leg] for leg in legs)


def _search_options(
    noise: Noise | None = None, seed: int | np.random.Generator = 0, starts: int = 5
) -> tuple[Noise, np.random.Generator, int]:
    """Return the noise of measurements, the generator of random starts, and their number."""
    count = count_of(starts, "starts", MeasurementError, 1, 1000)
    return as_noise(noise), generator_of(seed, MeasurementError), count


def _check_equations(count: int, r: int, n: int, subject: str) -> None:
    """Raise unless ``count`` poses of r equations each are enough for n unknowns."""
    if count * r < n:
        raise ObservabilityError(
            f"{count} poses give {count * r} equations for the {n} {subject}; choose at least "
            f"{-(-n // r)}, better two or three times as many"
        )


@one_thread()
def select_poses(
    mechanism: GivenMechanism,
    candidates: Array,
    count: int = 24,
    protocol: Protocol = "symmetric",
    **options: Any,
) -> Selection:
    """Return a D-optimal choice of poses from candidates, with a certificate.

    Rows are weighted by their noise, so that poses near type-1 singularities do not look better
    than they are.

    Args:
        mechanism: The mechanism.
        candidates: Poses to choose from, coordinates of shape (M, dof), [m] and [rad]; copies (up
            to whole turns and rounding errors) count once.
        count: Number of poses for each leg; with ``orbits``, of orbits; with ``common``, of poses.
        protocol: See the module.
        **options: ``noise`` of the future measurements, of which only ratios matter; ``seed`` of
            the random starts, a number or generator; ``starts``, their number.

    Raises:
        ObservabilityError: there are too few poses for the parameters, too few candidates in
            reach, or the candidates leave a parameter undetermined.
        SymmetryError: the mechanism lacks the symmetry that ``symmetric`` or ``orbits`` needs.
        MeasurementError: a residual has no noise.
    """
    mechanism = as_mechanism(mechanism).at_reference
    count_of(count, "count", MeasurementError)
    choice_of(protocol, get_args(Protocol), "protocol", MeasurementError)
    for leg in mechanism.legs:
        equations, readings = mechanism.platform.equations(leg), len(leg.sensors)
        if equations > readings:
            raise ObservabilityError(
                f"{leg.name} of {mechanism.name!r} has {equations} equations at a pose but "
                f"{readings} reading: rows of readings lack rank, and cannot compare poses for "
                "single legs. Choose configurations for all parameters together: "
                "select_configurations, or 'pincal select' without a protocol"
            )
    search, names = Search(mechanism, candidates, count, **options), mechanism.leg_names
    carried = {name: (name, IDENTITY, True) for name in names}
    if protocol in ("symmetric", "orbits"):
        group = orbits.selection_group(mechanism)
        spread = search.poses[:: max(1, len(search.poses) // _SAMPLE)][:_SAMPLE]
        carried = orbits.carried_legs(group, spread, search.noise)
    if protocol in ("common", "orbits"):
        # a reference leg counts once for each leg of its orbit, less the common factor of orbits
        times = Counter(reference for reference, _, _ in carried.values())
        legs = [leg for leg, size in times.items() for _ in range(size // gcd(*times.values()))]
        elements = orbits.smallest(group) if protocol == "orbits" else (IDENTITY,)
        poses, efficiency = search.choose(legs, elements)
        plan, efficiencies = Plan(poses, (EVERY_LEG,) * len(poses)), [efficiency] * len(names)
    else:
        plan, efficiencies = _leg_by_leg(search, carried)
    matrices = mechanism.platform.matrices(plan.poses)
    demands = leg_demands_at(
        nominal_legs(mechanism), [matrices[plan.serves(name)] for name in names]
    )
    designs = []
    for leg, demand, efficiency in zip(mechanism.legs, demands, efficiencies, strict=True):
        C = demand.jacobian.reshape(-1, len(leg.parameters))
        figures = indices(C), r_diagonal(C), identifiability(C, leg.parameter_ids).condition
        served, reference = len(demand.value), carried[leg.name][0]
        designs.append(LegDesign(leg.name, served, efficiency, *figures, reference))
    offered = search.in_reach, search.unreachable, tuple(designs)
    return Selection(plan, len(plan), protocol, min(efficiencies), *offered)


def _leg_by_leg(
    search: Search, carried: dict[str, tuple[str, Element, bool]]
) -> tuple[Plan, list[float]]:
    """Return a plan of each leg's own or carried poses, and the efficiencies of legs in order.

    If rows do not map, the carried poses are compared with carried candidates.
    """
    platform = search.mechanism.platform
    choices: dict[str, tuple[Array, float]] = {}
    poses, efficiencies = [], []
    for leg, (reference, element, equivalent) in carried.items():
        if reference not in choices:
            choices[reference] = search.choose([reference])
        chosen, efficiency = choices[reference]
        poses.append(chosen if element.is_identity else element.poses(platform, chosen))
        if not equivalent:
            matrices = map(platform.matrices, (search.poses, chosen))
            offered, taken = (search.rows(element.matrices(m)[None], (leg,)) for m in matrices)
            value = Criterion().value(taken)
            efficiency = continuous_design(offered).efficiency(value, len(chosen))
        efficiencies.append(efficiency)
    legs, every = np.repeat(list(carried), search.count).tolist(), np.concatenate(poses)
    unmapped = all(element.is_identity for _, element, _ in carried.values())
    plan = Plan(every, tuple(legs)) if unmapped else orbits.merged(search.mechanism, every, legs)
    return plan, efficiencies


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
    """Return an optimal choice of configurations from candidates, with a certificate.

    Args:
        mechanism: The mechanism.
        candidates: Poses of shape (M, dof), or a plan with readings; copies (up to whole turns and
            rounding errors) count once.
        count: Number of configurations.
        measured: Quantities of the platform to measure (see ``forecast``).
        setup: Meaning of the measured numbers.
        goal: ``"parameters"``: D-optimality. ``"platform"``: least mean variance of the calibrated
            platform over the candidates (L-optimality), of its position and its orientation times
            the mean radius of the legs' joints on it.
        **options: ``noise``, ``seed``, ``starts``: as for ``select_poses``.

    Raises:
        ObservabilityError: there are too few configurations for the identifiable unknowns.
        MeasurementError: freedoms or goal are unknown, measurements have no noise or equations, or
            no candidate is in reach.
    """
    mechanism = as_mechanism(mechanism).at_reference
    count_of(count, "count", MeasurementError, 1)
    noise, rng, starts = _search_options(**options)
    choice_of(goal, get_args(Goal), "goal", MeasurementError)
    plan = as_plan(mechanism, candidates)
    originals = orbits.distinct(mechanism.platform, plan.poses, plan.readings)
    setup = read_setup(Setup() if setup is None else setup)
    plan = Plan(plan.poses, readings=plan.readings, contacts=plan.contacts).rows(originals)
    setup = setup.of_rows(plan.contacts)
    plan = touching(mechanism, plan, setup)
    legs = legs_at(mechanism, plan)
    if not len(legs.poses):
        check_reached(mechanism, plan, "the candidates")
    white, priors, _, unknowns, names, *_ = information_rows(
        mechanism, legs, noise, measured, setup
    )
    flat = np.concatenate((white.reshape(-1, white.shape[2]), priors))
    identifiable = identifiability(flat, unknowns)
    rank, (lengths, _, axes) = identifiable.rank, scaled_axes(flat)
    _check_equations(count, white.shape[1], rank - len(priors), "unknowns that can be identified")
    shares = np.broadcast_to(priors / np.sqrt(count), (len(white), *priors.shape))
    blocks = (np.concatenate((white, shares), axis=1) / lengths) @ axes[:rank].T
    criterion = Criterion()
    if goal == "platform":
        n = legs.gain.shape[2]
        lost = null_directions(lengths, axes, rank, n)
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
    chosen, value = exchange((blocks,), count, design.priority, rng, starts, criterion)
    plan = Plan(legs.poses, readings=legs.readings, contacts=legs.contacts).rows(chosen)
    offered = goal, design.efficiency(value, count), len(blocks)
    return Selection(plan, count, *offered, rank=identifiable, measured=names)
