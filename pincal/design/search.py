"""The search among candidates: for one leg, for its orbits, or for all legs together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pincal.design.certificate import ContinuousDesign, continuous_design
from pincal.design.criteria import Held, MeanVariance, Parts, Rows, Some, most_of
from pincal.design.exchange import accurate_design, exchange
from pincal.design.information import leg_rows
from pincal.design.orbits import orbit_of, repeated
from pincal.errors import MeasurementError, ObservabilityError
from pincal.estimation.observability.indices import identifiability
from pincal.files.read import as_noise
from pincal.kinematics.batches import CHUNK, chunks
from pincal.kinematics.closure import LegClosure
from pincal.kinematics.derivatives import leg_demands_at
from pincal.kinematics.inverse import reached
from pincal.model.checks import count_of, generator_of
from pincal.model.measurements import Noise
from pincal.model.mechanism import Mechanism
from pincal.symmetry.elements import IDENTITY, Element
from pincal.types import Array, Index
from pincal.workspace.chunks import check_jobs, run

_TASK = 1 << 16  # candidates whose rows are evaluated in one go
HELD = 1 << 26  # numbers that are held in memory


@dataclass(frozen=True)
class LegRows:
    """Whitened rows of legs at poses, or at all poses of their orbits."""

    mechanism: Mechanism
    poses: Array
    """Coordinates, shape (M, dof), all finite, or matrices, shape (M, 4, 4)."""
    legs: tuple[str, ...]
    """Of each part, as often as it is to count."""
    noise: Noise
    elements: tuple[Element, ...] = (IDENTITY,)
    """Of a group, the identity first."""

    @property
    def total(self) -> int:
        """See ``Rows``."""
        return len(self.poses)

    @property
    def shapes(self) -> tuple[tuple[int, int], ...]:
        """Of a candidate's rows, (r, n) of each part."""
        equations, times = self.mechanism.platform.equations, len(self.elements)
        legs = map(self.mechanism.leg, self.legs)
        return tuple((equations(leg) * times, len(leg.parameters)) for leg in legs)

    def matrices(self, places: Some) -> Array:
        """Return poses as matrices, shape (s, 4, 4)."""
        some = self.poses[places]
        return some if some.ndim == 3 else self.mechanism.platform.form.matrices(some)

    def __call__(self, places: Some) -> Parts:
        """See ``Rows``; an image that is an earlier one of its pose is measured once."""
        images, own = orbit_of(self.elements, self.matrices(places))
        rows = {}
        for leg in dict.fromkeys(self.legs):
            parts = [self._of(leg, matrices) for matrices in images]
            for part, counts in zip(parts, own, strict=True):
                if not counts.all():
                    part[~counts] = 0.0
            rows[leg] = np.concatenate(parts, axis=1) if len(parts) > 1 else parts[0]
        return tuple(rows[leg] for leg in self.legs)

    def _of(self, leg: str, matrices: Array) -> Array:
        closure = LegClosure(self.mechanism.leg(leg), self.mechanism.platform)
        (demand,) = leg_demands_at((closure,), (matrices,))
        return leg_rows(demand, self.mechanism, self.noise)

    def admitted(self, places: Index) -> Index:
        """Return those of some of which no earlier one is the same pose, or one of its orbit."""
        images, _ = orbit_of(self.elements, self.matrices(places))
        return places[~repeated(images)]


def held(rows: LegRows, jobs: int = 1, scheduler: str | None = None) -> Rows:
    """Return rows in memory if they are few enough, evaluated on cores or a cluster.

    Args:
        rows: The rows.
        jobs: Processes on this machine; -1 for one a core.
        scheduler: Address of a Dask scheduler to run there.

    Raises:
        WorkspaceError: see ``run``.
    """
    if sum(r * n for r, n in rows.shapes) * rows.total > HELD:
        return rows
    parts = tuple(np.empty((rows.total, *shape)) for shape in rows.shapes)
    if jobs == 1 and scheduler is None:
        for some in chunks(rows.total, CHUNK):
            for part, own in zip(parts, rows(some), strict=True):
                part[some] = own
        return Held(parts)
    ends = [(some.start, some.stop) for some in chunks(rows.total, _TASK)]
    for (begin, end), found in run(_Task(rows), ends, jobs, scheduler):
        values, place = np.frombuffer(found), 0
        for part in parts:
            own = part[begin:end]
            own[:] = values[place : (place := place + own.size)].reshape(own.shape)
    return Held(parts)


@dataclass(frozen=True)
class _Task:
    """What a worker does."""

    rows: LegRows

    def __call__(self, begin: int, end: int) -> bytes:
        return b"".join(one.tobytes() for one in self.rows(slice(begin, end)))


_FIRST = 1000  # candidates that are asked first whether they are reached and determine all
_ASKED = 1 << 17  # candidates that are asked at most which of them are copies
_FOREMOST = 250  # of those on which the bound rests, asked whether they are reached


@dataclass(frozen=True)
class SelectionOptions:
    """Options of ``select_poses`` and ``select_configurations``."""

    noise: Noise | None = None
    """Standard deviations of the measurements to come; only their ratios matter."""
    seed: int | np.random.Generator = 0
    """Seed or generator of the random starts."""
    starts: int = 5
    """Starts of the exchange; the best is kept."""
    jobs: int = 1
    """Processes on this machine that evaluate candidates; -1 for one a core."""
    scheduler: str | None = None
    """Address of a Dask scheduler to evaluate them on."""
    progress: Callable[[str], None] | None = None
    """Called with what is being done."""

    def __post_init__(self) -> None:
        as_noise(self.noise)
        count_of(self.starts, "starts", MeasurementError, 1)
        check_jobs(self.jobs)
        generator_of(self.seed, MeasurementError)

    def say(self, text: str) -> None:
        """Pass on what is being done."""
        if self.progress is not None:
            self.progress(text)


class Search:
    """Candidates of a mechanism, and the best of them."""

    def __init__(self, mechanism: Mechanism, candidates: Array, options: SelectionOptions) -> None:
        """Hold candidates; which of them are reached and alike is asked of those that matter.

        Args:
            mechanism: The mechanism.
            candidates: Coordinates, shape (M, dof), [m] and [rad].
            options: How to search.

        Raises:
            MechanismError: poses of a wrong shape, or not finite.
            ObservabilityError: no candidates.
        """
        self.mechanism, self.options = mechanism, options
        platform = mechanism.platform
        self.candidates = platform.checked(platform.coordinates_of(candidates))
        self.rng = np.random.default_rng(options.seed)
        self.usable, self.unreachable = len(self.candidates), 0
        if not len(self.candidates):
            raise self._too_few(0, 1)
        self._known = np.zeros(len(self.candidates), dtype=bool)  # to be reached
        self._within: Index | None = None  # all that are, once one was not

    def some(self, count: int) -> Array:
        """Return some candidates that all legs reach, coordinates."""
        places = _sample(np.arange(len(self.candidates)))
        if not self._all_reach(places):
            places = self._reached()
        return self.candidates[places[:: max(1, len(places) // count)][:count]]

    def _all_reach(self, places: Index) -> bool:
        """Return whether all legs reach candidates."""
        asked = places[~self._known[places]]
        found = reached(self.mechanism, self.candidates[asked]).all(axis=1)
        self._known[asked[found]] = True
        return bool(found.all())

    def _reached(self) -> Index:
        """Return the candidates that all legs reach; all are asked."""
        if self._within is None:
            self._all_reach(np.arange(len(self.candidates)))
            self._within = np.flatnonzero(self._known)
        return self._within

    def rows(self, legs: Sequence[str], elements: Sequence[Element] = (IDENTITY,)) -> LegRows:
        """Return the rows of legs at the candidates, or at all poses of their orbits."""
        noise = as_noise(self.options.noise)
        return LegRows(self.mechanism, self.candidates, tuple(legs), noise, tuple(elements))

    def own(self, leg: str, count: int) -> tuple[Index, float]:
        """Return the chosen candidates for one leg, and their efficiency."""
        self.options.say(f"choosing poses for {leg}")
        return self._choose(self.rows([leg]), count)

    def orbits(
        self, legs: Sequence[str], count: int, elements: Sequence[Element]
    ) -> tuple[Array, float]:
        """Return the poses of chosen orbits, each once, and the orbits' efficiency.

        Args:
            legs: A leg of each orbit of legs, as often as it is to count.
            count: Number of orbits.
            elements: Group that makes the orbits.
        """
        self.options.say("choosing orbits")
        rows = self.rows(legs, elements)
        chosen, efficiency = self._choose(rows, count)
        found, own = orbit_of(elements, rows.matrices(chosen))
        poses = self.mechanism.platform.from_matrices(found.reshape(-1, 4, 4))
        return poses[own.ravel()], efficiency

    def efficiency(self, leg: str, element: Element, chosen: Index) -> float:
        """Return the efficiency of carried poses for a leg, among carried candidates.

        Args:
            leg: The leg.
            element: Carries candidates to its own.
            chosen: Which of them are chosen.
        """
        platform = self.mechanism.platform
        poses = element.poses(platform, self.candidates)
        rows = LegRows(self.mechanism, poses, (leg,), as_noise(self.options.noise))
        design = continuous_design(held(rows, self.options.jobs, self.options.scheduler))
        log_det, n = _value(rows, chosen)
        return design.efficiency(log_det, len(chosen), n)

    def common(self, count: int) -> tuple[Index, float]:
        """Return the candidates chosen for all legs together, and their efficiency."""
        self.options.say("choosing common poses")
        return self._choose(self.rows(self.mechanism.leg_names), count)

    def _choose(self, rows: LegRows, count: int) -> tuple[Index, float]:
        """Return the candidates chosen by their rows, and their efficiency.

        Raises:
            ObservabilityError: too few poses or candidates, or some parameter undetermined.
        """
        where = rows.legs[0] if len(rows.legs) == 1 else self.mechanism.name
        r, n = (sum(shape[axis] for shape in rows.shapes) for axis in (0, 1))
        if count * r < n:
            raise ObservabilityError(
                f"{count} poses give {count * r} equations for the {n} parameters of {where}; "
                f"choose at least {-(-n // r)}, better two or three times as many"
            )
        how = self.options
        quick, places = held(rows, how.jobs, how.scheduler), np.arange(rows.total)
        if self._within is not None or not self._all_reach(_sample(places)):
            places = self._reached()
        if len(places) < count:
            raise self._too_few(len(places), count)
        design = self._bound(quick, rows.legs, places)
        usable = np.flatnonzero(np.isfinite(design.variance))
        foremost = usable[most_of(design.variance[usable], _FOREMOST)]
        if self._within is None and not self._all_reach(foremost):
            design = self._bound(quick, rows.legs, self._reached())
            usable = np.flatnonzero(np.isfinite(design.variance))
            foremost = usable[most_of(design.variance[usable], _FOREMOST)]
        self.usable = min(self.usable, len(usable))
        self.unreachable = max(self.unreachable, rows.total - len(usable))
        seed, chosen = int(self.rng.integers(1 << 62)), foremost

        def choose(priority: Array) -> tuple[Index, float]:
            return exchange(quick, count, priority, np.random.default_rng(seed), how.starts)

        if len(self._alone(rows, foremost)) == len(foremost):
            chosen, log_det = choose(design.priority)
        if len(self._alone(rows, chosen)) < len(chosen):  # copies, or out of reach: left out
            kept = self._alone(rows, usable[most_of(design.variance[usable], _ASKED)])
            priority = np.full(rows.total, -np.inf)
            if len(kept) >= count:
                priority = continuous_design(quick, kept).priority
            chosen, log_det = choose(priority)
        return chosen, design.efficiency(log_det, count, n)

    def _alone(self, rows: LegRows, places: Index) -> Index:
        """Return which candidates are reached, and no copies of earlier ones."""
        return rows.admitted(places if self._all_reach(places) else places[self._known[places]])

    def _too_few(self, found: int, count: int) -> ObservabilityError:
        return ObservabilityError(
            f"{self.mechanism.name} reaches {found} of {len(self.candidates)} candidate "
            f"poses; {count} are to be chosen"
        )

    def _bound(self, rows: Rows, legs: Sequence[str], places: Index) -> ContinuousDesign:
        """Return the continuous design among candidates at their places.

        Raises:
            ObservabilityError: they leave some parameter undetermined.
        """
        for some in (_sample(places), places):
            lost = []
            for leg, one in zip(legs, rows(some), strict=True):
                ids = [f"{leg}.{name}" for name in self.mechanism.leg(leg).parameter_names]
                own = one[np.isfinite(one).all(axis=(1, 2))]
                found = identifiability(own.reshape(-1, one.shape[2]), ids)
                lost += [] if found.complete else [found.describe()]
            if not lost:
                return continuous_design(rows, places)
        raise ObservabilityError(
            f"the candidate poses leave parameters undetermined: {'; '.join(lost)}. "
            "Add poses that determine each of them, or make one of them a constant"
        )


def _sample(places: Index) -> Index:
    """Return some candidates, from all over."""
    return places[:: max(1, len(places) // _FIRST)]


def _value(rows: Rows, chosen: Index) -> tuple[float, int]:
    """Return log det of a choice's information, and of how many parameters."""
    total, n = 0.0, 0
    for one in rows(chosen):
        flat = one.reshape(-1, one.shape[2])
        total, n = total + float(np.linalg.slogdet(flat.T @ flat)[1]), n + one.shape[2]
    return total, n


def accurate(
    blocks: Array, C: Array, count: int, rng: np.random.Generator, starts: int
) -> tuple[Index, float]:
    """Return a choice by which quantities Cᵀφ are known best, and its efficiency.

    Args:
        blocks: Rows that each candidate contributes, shape (M, r, n); together of rank n.
        C: Shape (n, q).
        count: Size of the choice, without repetition.
        rng: Source of the random starts.
        starts: Number of starts.
    """
    design = accurate_design(blocks, C)
    chosen, value = exchange((blocks,), count, design.weights, rng, starts, MeanVariance(C))
    return chosen, design.efficiency(float(np.exp(-value)), count)


def d_optimal(
    parts: Parts, count: int, rng: np.random.Generator, starts: int
) -> tuple[Index, float]:
    """Return a D-optimal choice, and its efficiency against the bound on any choice.

    Args:
        parts: Rows that each candidate contributes, of each part of the parameters, shape
            (M, r, n); together of rank n.
        count: Size of the choice, without repetition.
        rng: Source of the random starts.
        starts: Number of starts.
    """
    design = continuous_design(parts)
    chosen, log_det = exchange(parts, count, design.priority, rng, starts)
    return chosen, design.efficiency(log_det, count, sum(one.shape[2] for one in parts))
