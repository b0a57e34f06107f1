"""How well rows determine the parameters: observability indices, rank, information above noise.

Observability is judged by singular values, by the diagonal of R in C = Q R, and by rank, with the
groups of parameters that are identifiable only together. Poses that leave parameters undetermined
lose rank; but the noise of measured poses gives every Jacobian full rank, and a fit would read
parameters out of the noise. Where all legs are identified at once, directions are held along which
parameters are known worse than from the drawing. Of a leg alone, at poses as measured, each
direction must carry clearly more information than comes from their noise, drawn once more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import qr, svd

from pincal.errors import MeasurementError, ObservabilityError
from pincal.estimation.problem import Linear, Problem
from pincal.estimation.rows import white_rows
from pincal.estimation.system import System
from pincal.estimation.unknowns import Unknowns
from pincal.kinematics.batches import block_diagonal
from pincal.kinematics.configurations import Legs, legs_at, nearby
from pincal.model import Leg, Mechanism, Plan
from pincal.model.checks import ROUNDING, array_of
from pincal.types import Array, Index
from pincal.words.wording import group_in_words

RANK_TOLERANCE = 1e-9
"""Singular value relative to the largest, with columns of unit length, below which rank is lost."""
NEGLIGIBLE = 1e-6
"""Component of a direction below which a parameter or a motion takes no part in it."""


@dataclass(frozen=True)
class Indices:
    """Observability indices of a set of poses (Sun and Hollerbach 2008), from singular values s."""

    O1: float
    """(s₁ … sₙ)^(1/n) / √m for m rows (Borm and Menq)."""
    O1_per_parameter: float
    """(s₁ … sₙ)^(1/n) / n, as the papers print it (3-RRR paper, Eq. 13)."""
    O2: float
    """sₙ / s₁."""


def indices(C: Array) -> Indices:
    """Return the observability indices of an identification Jacobian, shape (m, n).

    Singular values carry the units of the columns; compare sets of poses with them, not
    mechanisms.

    Args:
        C: The identification Jacobian, shape (m, n).

    Example:
        >>> import numpy as np, pincal
        >>> indices = pincal.indices(np.diag([4.0, 1.0]))
        >>> round(float(indices.O2), 6)  # least over greatest singular value
        0.25
    """
    C = array_of(C, ("m", "n"), "an identification Jacobian", ObservabilityError)
    m, n = C.shape
    s = np.linalg.svd(C, compute_uv=False)
    if m < n or s[-1] == 0.0:
        return Indices(0.0, 0.0, 0.0)
    mean = float(np.exp(np.log(s).mean()))
    return Indices(mean / np.sqrt(m), mean / n, float(s[-1] / s[0]))


def r_diagonal(C: Array) -> Array:
    """Return |R_ii| of C = Q R, shape (n,): the observability of each parameter (Eq. 9).

    The value of a parameter is what it adds to those before it; zero is not observable.
    """
    entries = np.abs(np.diagonal(np.linalg.qr(C, mode="r")))
    return np.pad(entries, (0, C.shape[1] - len(entries)))


def unit_columns(J: Array) -> tuple[Array, Array]:
    """Return the lengths of J's columns, shape (n,), and J with columns of unit length.

    A column that is rounding beside the longest one is zero, and counts as of length 1.
    """
    lengths = np.linalg.norm(J, axis=0)
    nonzero = lengths > ROUNDING * lengths.max(initial=0.0)
    lengths = np.where(nonzero, lengths, 1.0)
    return lengths, np.where(nonzero, J / lengths, 0.0)


def scaled_axes(J: Array) -> tuple[Array, Array, Array]:
    """Return the lengths of J's columns, (n,), and ``axes_of`` J with columns of unit length."""
    lengths, unit = unit_columns(J)
    return lengths, *axes_of(unit)


def axes_of(J: Array) -> tuple[Array, Array]:
    """Return singular values, (n,), and right axes as rows, (n, n), of rows J, shape (…, n)."""
    flat = J.reshape(int(np.prod(J.shape[:-1])), J.shape[-1])
    triangle = np.linalg.qr(flat, mode="r")  # the same values and axes, quicker
    _, s, axes = svd(triangle, lapack_driver="gesvd")  # divide and conquer may not converge
    return np.pad(s, (0, len(axes) - len(s))), axes


@dataclass(frozen=True)
class Identifiability:
    """Rank of an identification Jacobian, and the parameters that it does not determine."""

    rank: int
    n_params: int
    condition: float
    """Condition number with columns of unit length, of the determined directions only."""
    groups: tuple[tuple[str, ...], ...]
    """Ids of parameters that move together, one group for each lost rank."""

    @property
    def complete(self) -> bool:
        """Whether every parameter is determined."""
        return self.rank == self.n_params

    def describe(self) -> str:
        """Return a text such as ``leg_2.l and leg_2.L move together``."""
        return "; ".join(map(group_in_words, self.groups))

    def __str__(self) -> str:
        start = f"rank {self.rank} of {self.n_params}, condition {self.condition:.3g}"
        return "\n".join((start, *map(group_in_words, self.groups)))


def identifiability(C: Array, names: Sequence[str]) -> Identifiability:
    """Return rank and undetermined combinations of an identification Jacobian, shape (m, n)."""
    n, (_, scaled) = C.shape[1], unit_columns(C)
    s = np.linalg.svd(scaled, compute_uv=False)
    rank = int((s > RANK_TOLERANCE * s.max(initial=0.0)).sum())
    condition = float(s[0] / s[rank - 1]) if rank else np.inf if n else 1.0
    if rank == n:
        return Identifiability(rank, n, condition, ())
    _, R, order = qr(scaled, mode="economic", pivoting=True)
    pivots, lost = order[:rank], order[rank:]
    weights = np.linalg.solve(R[:rank, :rank], R[:rank, rank:])  # lost columns from the kept
    members = [
        sorted({int(index), *pivots[np.abs(column) > NEGLIGIBLE].tolist()})
        for column, index in zip(weights.T, lost, strict=True)
    ]
    members.sort(key=lambda group: (len(group), group))  # the order of pivots depends on rounding
    groups = tuple(tuple(names[i] for i in group) for group in members)
    return Identifiability(rank, n, condition, groups)


GENERIC = 200  # least number of generic configurations


def jacobian_near(
    mechanism: Mechanism, problem: Problem, unknowns: Unknowns, chosen: Index | None = None
) -> tuple[Legs, Array]:
    """Return the legs' derivatives at the start of chosen rows, and the whole Jacobian.

    By default they are generic ones nearby, where every quantity that is measured in some row
    counts as measured in all rows. The Jacobian, shape (m, n_free), is of all measured quantities
    over the mechanism's size by the free unknowns, poses eliminated, with rows of priors below.
    """
    start, block = problem.start(unknowns.start), problem.leg_block
    contacts, generic = problem.observation.setup.contacts, chosen is None
    if chosen is None:  # the same ones in whatever order rows were measured
        chosen = np.lexsort((*start.matrices[:, :3, 3].T, *block.readings.T))
        chosen = chosen if contacts else chosen[:GENERIC]  # every point is touched
    plan = Plan(
        mechanism.platform.from_matrices(start.matrices[chosen]),
        readings=block.readings[chosen] if mechanism.by_readings else None,
        influences={name: values[chosen] for name, values in block.influences.items()},
    )
    values = (start.parameters[columns] for columns in block.columns)
    started = mechanism.with_parameters(dict(zip(mechanism.leg_names, values, strict=True)))
    size = problem.size
    plan = nearby(started, plan, GENERIC, size) if generic else plan
    observation = problem.observation.anywhere() if generic else problem.observation
    every = chosen[np.arange(len(plan)) % len(chosen)]
    if contacts:  # frames and scale do not show where they touch exactly
        plan = observation.at(every).touching(started, plan, start.external)
    legs = legs_at(started, plan)
    rows = every[legs.reached]
    matrices, observation = mechanism.platform.matrices(legs.poses), observation.at(rows)
    nearest = observation.at_touch(matrices, start.external)
    _, seen_pose, by_external = observation.residuals(matrices, nearest)
    per = np.array([1.0 / size if unit == "m" else 1.0 for unit in observation.units])[:, None]
    # ┌ A          0        ┐  legs            ┌ B ┐
    # └ 0  by external      ┘  what is seen    └ B ┘
    pose = np.concatenate((legs.pose / size, seen_pose * per), axis=1)
    parameter = block_diagonal((legs.parameter / size, by_external * per))
    unit_noise = np.broadcast_to(np.eye(pose.shape[1]), (len(pose), *2 * pose.shape[1:2]))
    free = white_rows(pose, unit_noise)(parameter)
    return legs, unknowns.free_rows(free[np.isfinite(free).all(axis=(1, 2))])


def lost_directions(J: Array) -> tuple[Array, Array]:
    """Return unobservable directions of a Jacobian, and the lengths of its columns.

    Directions are rows v, shape (n_lost, n), for columns of unit length: unknowns may move along
    v / lengths. The smallest changes, each weighted by its column's length, satisfy
    (v · lengths) · z = 0.
    """
    lengths, s, axes = scaled_axes(J)
    return axes[int((s > RANK_TOLERANCE * s[0]).sum()) :], lengths


DIFFER = 0.05
"""Largest difference of a machine from its drawing: of its size, of a gain, and [rad]."""


def plausible_changes(mechanism: Mechanism, legs: Sequence[Leg] | None = None) -> Array:
    """Return how far parameters of legs may differ from the drawing, shape (n_params,).

    They are in the parameters' order and units, of all legs by default.
    """
    return np.concatenate([changes_of(leg, mechanism.size) for leg in legs or mechanism.legs])


def nearest_to_nominal(mechanism: Mechanism, directions: Array) -> Array:
    """Return the projection of parameter changes along directions to the smallest, shape (n, n).

    P = I − G (W G)⁺ W with the directions G of all legs' parameters, shape (n, k), and weights W,
    the inverse of how far machines differ from their drawing.
    """
    scales = plausible_changes(mechanism)
    amounts = np.linalg.pinv(directions / scales[:, None]) / scales
    return np.asarray(np.eye(len(scales)) - directions @ amounts)


def changes_of(leg: Leg, size: float) -> Array:
    """Return how far a leg's parameters may differ from the drawing, shape (n_params,).

    It is a share of ``size`` for lengths, of their value for gains, of 1 for angles and numbers.
    """
    gains = {sensor.gain for sensor in leg.sensors}
    scales = [
        (abs(value) or 1.0) if name in gains else size if leg.units[name] == "m" else 1.0
        for name, value in leg.parameters
    ]
    return DIFFER * np.array(scales)


_CLEARLY = 3.0  # information over that from noise, above which a direction is observed
_TAKES_PART = 0.1  # component over a direction's largest one, above which a parameter is named


def check_rank(
    problem: Problem, unknowns: Unknowns, linear: Linear, *, ended: bool = False
) -> None:
    """Raise if rows leave some free unknown undetermined.

    If that is so only where a search ``ended``, the search ran away.

    Raises:
        ObservabilityError: a parameter is not determined; the message names it.
        MeasurementError: a derivative does not exist at some pose.
    """
    if not all(np.isfinite(x).all() for x in (linear.by_parameter, linear.white.whitener)):
        raise MeasurementError(
            f"{', '.join(leg.name for leg in problem.legs)}: a residual or its derivative is not "
            "finite at some measured pose; a leg may be folded or stretched there"
        )
    total = identifiability(unknowns.free_rows(linear.triangle), unknowns.free_labels)
    if not total.complete:
        raise ObservabilityError(
            "the search ran away: the measurements determine the parameters at their nominal "
            f"values, but not where it ended ({total.describe()}). They are hardly this machine's: "
            "check signs, units, the order of the readings, the frame of the poses, and rows that "
            "are far off (--loss reject)"
            if ended
            else f"the measured poses leave parameters undetermined: {total.describe()} "
            f"(rank {total.rank} of {total.n_params}). Measure poses that separate them, fix "
            "one of them, make it a constant in mechanism.yaml, or hold it as near to nominal as "
            "can be (leave out --method per-leg)"
        )


def check_information(
    problem: Problem, unknowns: Unknowns, places: Sequence[Linear], scale: float = 1.0
) -> None:
    """Raise if some direction in parameter space is observed by the noise of measured poses only.

    It is enough that all directions are observed at one of several places. ``scale`` multiplies
    the noise.

    Raises:
        ObservabilityError: a direction is not observed; the message names its parameters.
    """
    roots = problem.leg_block.pose_roots
    assert roots is not None
    for linear in places:
        draws = np.random.default_rng(0).standard_normal((*roots.shape[:2], 1))
        matrices = problem.platform.displaced(linear.state.matrices, (roots @ draws)[:, :, 0])
        drawn = problem.evaluate(replace(linear.state, matrices=matrices)).noise_by_parameter
        difference = (drawn - linear.noise_by_parameter) @ unknowns.map
        rows = unknowns.free_rows(linear.triangle)  # the same information as J, since W Wᵀ = 1
        lengths = np.linalg.norm(rows, axis=0)
        _, information, directions = np.linalg.svd(rows / lengths, full_matrices=False)
        made = scale * np.linalg.norm(difference / lengths @ directions.T, axis=(0, 1))
        by_noise = directions[information < _CLEARLY * made]
        if not len(by_noise):
            return
    raise ObservabilityError(
        f"the measured poses determine {', '.join(taking_part(unknowns.free_labels, by_noise))} by "
        "their noise only. Measure poses that differ more (in orientation above all), or fix one "
        "of these parameters, or make it a constant in mechanism.yaml"
    )


def taking_part(names: Sequence[str], directions: Array) -> tuple[str, ...]:
    """Return the names of unknowns that take part in directions, rows of shape (k, n)."""
    size = np.abs(directions).max(axis=0)
    parts = zip(names, size > _TAKES_PART * size.max(), strict=True)
    return tuple(name for name, takes_part in parts if takes_part)


class HeldUnknowns(NamedTuple):
    """Directions that measurements cannot observe, held as near to nominal as possible."""

    unknowns: Unknowns
    """The unknowns without the held directions."""
    observable: Unknowns
    """The unknowns without the directions that are unobservable even without noise."""
    nominal: Linear
    """Conditions where a search starts: nominal, or where a fit with more held directions ended."""
    directions: Array
    """Held directions of all unknowns, as long as machines may differ, shape (n, n_lost)."""
    groups: tuple[tuple[str, ...], ...]
    """Ids of the unknowns that are unobservable together, a group for each direction."""
    weak: tuple[str, ...]
    """Ids of the unknowns that are weakly determined."""
    fewest: int
    """Least number of weakly determined directions that are held."""
    weakest: float
    """How far machines may differ over the standard error, along the weakest free direction."""


def hold_unobservable(
    mechanism: Mechanism, system: System, nominal: Linear, held: HeldUnknowns | None, fewest: int
) -> HeldUnknowns:
    """Return the unknowns without the directions that the measurements do not determine.

    Unobservable directions are held first: of all parameters that fit equally well those nearest to
    nominal, each change weighted by its effect on the measurements. Then directions are held along
    which the standard error exceeds how far machines differ, and at least the ``fewest`` weakest.

    In ``system`` gauge freedoms are held; a search starts at the ``nominal`` conditions. ``held``
    is what was held before, which has the same unobservable directions.

    Raises:
        ObservabilityError: the legs reach none of the measured poses.
    """
    free, problem = system.unknowns, system.problem
    if held is None:
        legs, J = jacobian_near(mechanism, problem, free, np.flatnonzero(system.kept))
        if not len(legs.poses):
            raise ObservabilityError(
                "the nominal legs reach none of the measured poses, so that nothing is determined; "
                "compare the mechanism and its units with the measurements (pincal doctor)"
            )
        lost, lengths = lost_directions(J)
        directions = free.map @ (lost / lengths).T
        groups = identifiability(J, free.free_labels).groups if len(lost) else ()
        observable = free.held(lost * lengths) if len(lost) else free
    else:
        observable, groups = held.observable, held.groups
        directions = held.directions[:, : free.n_free - observable.n_free]
    # how far machines differ over the standard error of each direction, the best first
    differ = problem.observation.external.sizes(mechanism.size)
    plausible = np.concatenate((plausible_changes(mechanism, problem.legs), differ))
    scale = 1.0 / np.abs(observable.map / plausible[:, None]).max(axis=0)
    R = replace(system, unknowns=observable).triangle(nominal, system.kept.astype(float))
    _, information, axes = np.linalg.svd(R[:-1, :-1] * scale)
    free_count = min(int((information > 1.0).sum()), len(information) - fewest)
    weak = axes[free_count:]
    weakest = float(information[:free_count].min(initial=np.inf))
    directions = np.column_stack((directions, observable.map @ (weak * scale).T))
    directions = directions / np.abs(directions / plausible[:, None]).max(axis=0, initial=0.0)
    names = taking_part(observable.free_labels, weak) if len(weak) else ()
    less = observable.held(weak / scale) if len(weak) else observable
    return HeldUnknowns(less, observable, nominal, directions, groups, names, fewest, weakest)
