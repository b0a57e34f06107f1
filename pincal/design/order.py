"""In which order poses are measured: in rounds of short ways, or beside the robot the best next.

A plan that is driven blind is driven in rounds, so that what drifts is no error of one leg. Beside
the robot the next row is that which says most: the information of priors and of the rows that were
measured is M = diag(σ⁻²) + Σ Aⱼᵀ Aⱼ, with rows of forecasts by the nominal mechanism, so that no
measured number has a say.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from scipy.spatial.distance import cdist
from scipy.special import chdtri

from pincal.blas import one_thread
from pincal.design.forecast import forecast, information_rows, touching
from pincal.design.optimal import DETERMINANT, inverse_roots
from pincal.design.platform_error import CONFIDENCE, seen_of
from pincal.errors import MeasurementError, ObservabilityError
from pincal.kinematics.configurations import (
    as_plan,
    inverse,
    joints_at,
    legs_at,
    planned_influences,
)
from pincal.model.checks import count_of
from pincal.model.measurements import EVERY_LEG, VERIFY, Noise, Plan
from pincal.model.mechanism import Mechanism
from pincal.model.relations import ROW, TO
from pincal.model.setup import Setup
from pincal.types import Array, Mask
from pincal.workspace.sampling import sample_configurations

REFERENCE = "reference"
"""Name of the pose that is measured again and again."""
_ROUND = 8  # rows that a round has at least
_BLOCKED = 1e3  # length of a way that must not be driven
_WORKSPACE, _SEED = 200, 1  # configurations over which errors are stated
_FAR = 10.0  # sizes of the machine, or rad, within which frames are sought
_COURSE = 100  # poses that are looked ahead, at most


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
    the middle (least sum of squared ways to the others) and back to it. Rows of the middle pose
    have the name ``reference``, and differ by noise and by what drifts.

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
    """Return lengths of ways between rows, (N, N): the platform's, and the most moved drive's."""
    readings = plan.readings
    if readings is None:
        readings = inverse(mechanism, plan.poses, planned_influences(mechanism, plan)).readings
    positions, driven = plan.poses[:, : mechanism.platform.lengths], np.nan_to_num(readings)
    spans = np.ptp(driven, axis=0)
    driven = driven / np.where(spans > 0.0, spans, 1.0)
    ways = cdist(positions, positions) if positions.size else np.zeros((len(plan), len(plan)))
    return np.asarray(ways / (ways.max() or 1.0) + cdist(driven, driven, "chebyshev"))


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


def with_verification(
    mechanism: Mechanism, plan: Plan, offered: Plan, count: int, seed: int = 0
) -> Plan:
    """Return a plan with poses beside it that no fit follows: those of the set ``verify``.

    So many are taken at random from those offered, which are spread over the workspace.

    Raises:
        ObservabilityError: fewer are in reach.
    """
    offered, taken = as_plan(mechanism, offered), {pose.tobytes() for pose in plan.poses}
    free = [row for row, pose in enumerate(offered.poses) if pose.tobytes() not in taken]
    rows = np.random.default_rng(seed).permutation(np.array(free, dtype=np.intp))
    chosen = offered.rows(rows[joints_at(mechanism, offered.rows(rows)).reached.all(axis=1)])
    if len(chosen) < count:
        raise ObservabilityError(
            f"{len(chosen)} poses are left to verify with, of {count} that were asked for; offer "
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


class Candidates:
    """Rows of a plan: which are offered, what they say of the unknowns and of the platform."""

    offered: Mask
    """Rows in reach that a fit follows, shape (N,)."""
    rows: Array
    """White rows of the plan, zero where not offered, shape (N, k, n)."""
    beforehand: Array
    """White rows of what is known beforehand, shape (m, n)."""
    workspace: Plan
    """Configurations over which errors are stated."""

    @one_thread()
    def __init__(
        self,
        mechanism: Mechanism,
        plan: Plan,
        noise: Noise,
        measured: Sequence[str] | None,
        setup: Setup,
        priors: Mapping[str, float],
    ) -> None:
        """Look at a plan by the nominal mechanism, whose parameters are known to ± priors by id.

        What is measured, and what it means, is said as to ``forecast``.
        """
        legs = legs_at(mechanism, touching(mechanism, plan, setup))
        frames = forecast(mechanism, plan, noise, measured, setup).frames
        white, known, _, unknowns, _ = information_rows(mechanism, legs, noise, measured, setup)
        self.offered = legs.reached & ~plan.verifying
        self.rows = np.zeros((len(plan), *white.shape[1:]))
        self.rows[legs.reached] = white * self.offered[legs.reached, None, None]
        far = _FAR * max(mechanism.size, 1.0)
        spread = np.array([priors.get(name, far) for name in unknowns])
        self.beforehand = np.concatenate((np.diag(1.0 / spread), known))
        self.workspace = sample_configurations(mechanism, _WORKSPACE, _SEED)
        legs = legs_at(mechanism, self.workspace)
        gain, units = seen_of(mechanism, legs.poses, legs.gain, frames)
        gain = gain[np.isfinite(gain).all(axis=(1, 2))]
        G = gain[:, [unit == units[0] for unit in units]].reshape(-1, gain.shape[2])
        half = np.asarray(np.linalg.qr(G / np.sqrt(len(gain)), mode="r")).T
        unmoving = len(unknowns) - len(half)
        self._moved = np.pad(half, ((0, unmoving), (0, 0)))  # C: tr Cᵀ M⁻¹ C is a mean square
        self.limit = cache(self._limit)  # rows come one by one

    def information(self, measured: Sequence[int]) -> Array:
        """Return M of priors and rows of the plan, shape (n, n)."""
        flat = self.rows[list(measured)].reshape(-1, self.rows.shape[2])
        rows = np.concatenate((self.beforehand, flat))
        return np.asarray(rows.T @ rows)

    def limits(self, measured: Sequence[int]) -> list[float]:
        """Return the limit of the platform's error to expect after each of some rows, [m]."""
        return [self.limit(*measured[: count + 1]) for count in range(len(measured))]

    @one_thread()
    def _limit(self, *measured: int) -> float:
        """Return below which the platform's position error is in 95 of 100 machines, [m].

        Root mean square over the workspace, [rad] of a platform that only turns. Its square is a
        weighted sum of squares, with the quantile of the χ² of its mean and variance (Satterthwaite
        1946): weights are eigenvalues of V = Cᵀ M⁻¹ C, of sum tr V; their squares' is tr V².
        """
        half = inverse_roots(self.information(measured)[None])[0].T @ self._moved
        V = half.T @ half
        mean = float(np.trace(V))
        freedoms = mean**2 / float((V**2).sum())
        return float(np.sqrt(mean * chdtri(freedoms, 1.0 - CONFIDENCE) / freedoms))

    @one_thread()
    def best(self, measured: Sequence[int]) -> tuple[int, float]:
        """Return the row of the plan to measure next, and by what share errors then fall.

        By no other do they fall by more, in the geometric mean of all unknowns. Rows that were
        measured come again when no other is left.

        Raises:
            MeasurementError: no row is offered.
        """
        fresh = self.fresh(measured)
        places = np.flatnonzero(fresh if fresh.any() else self.offered)
        if not len(places):
            raise MeasurementError("no pose of the plan is in reach; give another plan")
        root = inverse_roots(self.information(measured)[None])
        gains = DETERMINANT.gain(self.rows[places], root)[0]
        falls = -np.expm1(-gains.max() / (2 * self.rows.shape[2]))
        return int(places[gains.argmax()]), float(falls)

    def fresh(self, measured: Sequence[int]) -> Mask:
        """Return which rows are offered and were not measured, shape (N,)."""
        fresh = self.offered.copy()
        fresh[list(measured)] = False
        return fresh

    def course(self) -> list[int]:
        """Return rows of the plan in the order in which they will be chosen, 100 at most."""
        measured: list[int] = []
        while len(measured) < _COURSE and self.fresh(measured).any():
            measured.append(self.best(measured)[0])
        return measured
