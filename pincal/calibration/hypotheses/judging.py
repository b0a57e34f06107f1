"""How measurements that were put right fit: by the estimator's own cost, each leg alone.

Where the base is at an unknown place, or no orientation was measured, forward kinematics of the
readings says where the nominal machine was, and the alignment from which searches start brings
both together. The misfit of a leg is what a few steps of the estimator then leave of its closure,
poses as measured, with a robust loss, each parameter known as well as machines follow drawings.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial
from itertools import accumulate
from typing import Any

import numpy as np

from pincal.calibration.calibration import Calibration
from pincal.calibration.options import Options
from pincal.errors import MeasurementError
from pincal.estimation.alignment import aligned
from pincal.estimation.observability.indices import DIFFER, changes_of
from pincal.estimation.observation import Observation
from pincal.estimation.problem import Problem, spread
from pincal.estimation.system import LOSSES, NormalEquations, System
from pincal.estimation.unknowns import State, unknowns
from pincal.kinematics.closing import home_mode, mode_sign
from pincal.kinematics.closure import LegClosure, largest_size
from pincal.kinematics.forward import forward
from pincal.kinematics.inverse import inverse
from pincal.kinematics.singularity import margins
from pincal.model.measurements import Measurements, Noise
from pincal.model.mechanism import Mechanism
from pincal.model.setup import ORIGIN, Setup, Target
from pincal.types import Array, Index, Mask

QUESTIONED = 0.02  # misfit over the stroke that was measured, from which legs are questioned
PRECISE = 1e-4  # of the leg's size: gaps that are none
EQUAL = 2.0  # times the misfit that the best leaves: cannot be separated from it
_ROWS, _ROWS_FORWARD = 500, 100  # enough to judge by; where forward kinematics is needed
_STEPS = 4  # on the way to the machine near nominal that fits best


@dataclass(frozen=True)
class Hypothesis:
    """One thing that may have gone wrong."""

    code: str
    """Kebab case; its sentence and remedy are in ``pincal.words.faults``."""
    right: Callable[[Mechanism, Measurements], Measurements]
    """Returns measurements put right."""
    values: Mapping[str, Any] = field(default_factory=dict)
    """What is wrong: names and numbers of which its sentence is made."""
    by_leg: bool = False
    """Whether it may concern the readings of some legs only."""
    faults: int = 1
    """How many things went wrong."""


AS_MEASURED = Hypothesis("nothing", lambda _, data: data)


@dataclass(frozen=True, eq=False)
class Case:
    """Measurements that are judged, and the rows by which this is done."""

    mechanism: Mechanism
    data: Measurements
    """All measurements."""
    free: bool
    """Whether the base is at an unknown place in the frame of the measurements."""
    target: Target
    """The target whose poses were measured."""
    rows: Index
    """Rows by which the measurements are judged."""
    oriented: bool
    """Whether orientations were measured there."""

    @staticmethod
    @lru_cache(maxsize=4)
    def of(mechanism: Mechanism, data: Measurements, free: bool, target: Target) -> Case | None:
        """Return a case; None without rows, or if only the target's place is unknown.

        Its rows are those with complete poses, or else those with positions and all readings.
        Who asks again gets the same case: what explains it is found once.
        """
        known = np.isfinite(data.poses)
        rows, oriented = np.flatnonzero(known.all(axis=1)), True
        if len(rows) < 2:
            known_rows = np.isfinite(data.readings).all(axis=1)
            rows = np.flatnonzero(known[:, : mechanism.platform.lengths].all(axis=1) & known_rows)
            oriented = False
        if len(rows) < 2 or (target.unknown and np.any(target.offset) and not free):
            return None
        target = replace(target, unknown=target.unknown and free)
        rows = rows[spread(len(rows), _ROWS if oriented and not free else _ROWS_FORWARD)]
        return Case(mechanism, data, free, target, rows, oriented)

    @property
    def alone(self) -> bool:
        """Whether each leg can be judged without the others."""
        return self.oriented and not self.free

    @property
    def readings(self) -> Array:
        """Readings of the rows, shape (N, n_readings), [rad] or [m]; NaN where not measured."""
        return self.data.readings[self.rows]

    def anywhere(self, count: int) -> Case:
        """Return the case with the base at an unknown place, judged by its first rows."""
        return replace(self, free=True, rows=self.rows[:count])

    def nominal_readings(self, matrices: Array) -> Array:
        """Return what the nominal machine reads at poses, shape (N, n_readings)."""
        return inverse(self.mechanism, self.mechanism.platform.from_matrices(matrices)).readings

    def put_right(self, hypothesis: Hypothesis) -> Calibration:
        """Return the calibration of the rows put right: nearly exact poses and readings."""
        mechanism = self.mechanism
        right = hypothesis.right(mechanism, self.data).rows(self.rows)
        poses = right.poses.copy()
        poses[:, mechanism.platform.lengths :] *= 1.0 if self.oriented else np.nan
        data = Measurements(poses, readings=right.readings, influences=right.influences)
        noise = Noise(PRECISE * largest_size(mechanism.legs), PRECISE)
        setup = Setup(unknown_frame=self.free, targets={ORIGIN: self.target})
        return Calibration(mechanism, data, Options(noise=noise, setup=setup))


@dataclass(frozen=True)
class LegFit:
    """How measurements fit a leg; lengths over the leg's size."""

    rows: int
    """Number of rows with a reading."""
    gap: float
    """Median closure residual at the nominal parameters; NaN with fewer than two rows."""
    stroke: float
    """Median distance by which readings move the leg's end over the rows."""
    bent: int
    """Number of rows that close the leg in another working mode than home's."""
    nearest: Callable[[], Array]
    """Returns what machines near nominal leave of the closure; see ``left``."""

    @cached_property
    def left(self) -> Array:
        """Closure residual of each row at the parameters near nominal that fit best, shape (N,).

        NaN where there is no reading.
        """
        return self.nearest()

    @property
    def as_home(self) -> bool:
        """Whether most rows close the leg in home's working mode."""
        return 2 * self.bent <= self.rows

    @property
    def near(self) -> float:
        """What machines near nominal leave of the gaps; all, if machines do not differ so far."""
        return self.gap if not self.gap <= DIFFER else min(self.gap, float(np.nanmedian(self.left)))

    @property
    def misfit(self) -> float:
        """The leg's share in a hypothesis' score: what is left, or 1 in another working mode."""
        return self.near if self.as_home else max(1.0, self.gap)

    @property
    def questioned(self) -> bool:
        """Whether machines near nominal leave much of what was measured."""
        most = max(min(QUESTIONED * self.stroke, DIFFER), PRECISE)
        return self.rows > 1 and not (self.gap <= most or self.near <= most)


@dataclass(frozen=True)
class Judged:
    """A hypothesis and how the measurements, put right, fit the legs."""

    hypothesis: Hypothesis
    fits: tuple[LegFit, ...]
    """How each leg fits; empty if readings and measurements cannot be brought together."""
    matrices: Array | None
    """Poses put right, in the nominal machine's frame, shape (N, 4, 4); NaN where not known."""
    free: bool
    """Whether the base's place was aligned."""
    legs: tuple[int, ...] = ()
    """Legs whose readings it concerns, if not all."""
    elsewhere: float = 0.0
    """Share of poses on the other side of a type-2 singularity than home, if it was asked."""

    @property
    def judged(self) -> list[LegFit]:
        """Fits of the legs that have rows."""
        return [leg_fit for leg_fit in self.fits if leg_fit.rows > 1]

    @property
    def misfits(self) -> Array:
        """Misfit of each leg, none below what is no gap, shape (n_legs,)."""
        return np.array([max(fit.misfit if fit.rows > 1 else 0.0, PRECISE) for fit in self.fits])

    @property
    def gap(self) -> float:
        """Mean gap over the legs that have rows, 1 at most and where nothing fits."""
        return float(np.mean([min(leg_fit.gap, 1.0) for leg_fit in self.judged] or [1.0]))

    @property
    def misfit(self) -> float:
        """Mean over the legs that have rows; 1 where nothing fits, or on the other side."""
        mean = float(np.mean([leg_fit.misfit for leg_fit in self.judged] or [1.0]))
        return max(mean, 1.0) if self.elsewhere > 0.5 else mean

    def leaves(self, most: float) -> bool:
        """Return whether the misfit is so small; legs are asked until it cannot be."""
        sums = accumulate(leg_fit.misfit for leg_fit in self.judged)
        return bool(self.judged) and all(total <= most * len(self.judged) for total in sums)

    @property
    def questioned(self) -> list[int]:
        """Legs of which machines near nominal leave much of what was measured."""
        return [i for i, fit in enumerate(self.fits) if fit.questioned]

    def within(self, most: float) -> bool:
        """Return whether every leg misses by so much of its size at most: ``DIFFER`` or more."""
        return bool(self.fits) and all(fit.as_home and fit.gap <= most for fit in self.judged)

    @property
    def fits_well(self) -> bool:
        """Whether nothing is to be explained."""
        return bool(self.fits) and not self.questioned and self.elsewhere <= 0.5


def judge(case: Case, hypotheses: Sequence[Hypothesis] = (AS_MEASURED,)) -> list[Judged]:
    """Return how measurements fit all legs if a hypothesis is true, of each hypothesis."""
    calibrations = [case.put_right(hypothesis) for hypothesis in hypotheses]
    return [
        Judged(hypothesis, () if T is None else _leg_fits(calibration, T), T, case.free)
        for hypothesis, calibration, T in zip(
            hypotheses, calibrations, _placed(case, calibrations), strict=True
        )
    ]


def poses_as_measured(case: Case) -> Array | None:
    """Return the poses of a case, shape (N, 4, 4); None if they cannot be aligned."""
    return _placed(case, [case.put_right(AS_MEASURED)])[0]


def other_side(mechanism: Mechanism, matrices: Array | None) -> float:
    """Return the share of poses on the other side of a type-2 singularity than home."""
    if mechanism.by_readings or matrices is None:
        return 0.0
    known = matrices[np.isfinite(matrices).all(axis=(1, 2))]
    return float((margins(mechanism, mechanism.platform.from_matrices(known)).type2 < 0.0).mean())


def _placed(case: Case, calibrations: Sequence[Calibration]) -> list[Array | None]:
    """Return poses ``T_base_platform`` of several calibrations, shape (N, 4, 4) each.

    NaN where readings lead nowhere; None if readings and measurements cannot be brought together.
    """
    platform = case.mechanism.platform
    if case.alone:
        starts = (calibration.observation.external.start for calibration in calibrations)
        pairs = zip(calibrations, starts, strict=True)
        return [platform.matrices(calibration.given_poses(start)) for calibration, start in pairs]
    every = [calibration.measurements.readings for calibration in calibrations]
    known = np.isfinite(readings := np.concatenate(every or [case.readings[:0]])).all(axis=1)
    distinct, index = np.unique(readings[known], axis=0, return_inverse=True)
    with np.errstate(all="ignore"):
        solution = forward(case.mechanism, distinct)
    reached = np.tile(platform.home_pose.as_matrix(), (len(readings), 1, 1))
    converged = np.zeros(len(readings), dtype=bool)
    converged[known] = solution.converged[index.ravel()]
    reached[converged] = platform.matrices(solution.poses[index.ravel()][converged[known]])
    parts = (np.split(values, len(calibrations) or 1) for values in (reached, known, converged))
    return [
        _aligned(calibration, T, good) if 2 * good.sum() >= max(known_rows.sum(), 6) else None
        for calibration, T, known_rows, good in zip(calibrations, *parts, strict=False)
    ]


def _aligned(calibration: Calibration, reached: Array, good: Mask) -> Array | None:
    """Return where the platform was by the measurements, in the base frame, shape (N, 4, 4).

    Args:
        calibration: The measurements put right.
        reached: Poses of the nominal machine by its readings, shape (N, 4, 4).
        good: Where there is such a pose, shape (N,).
    """
    mechanism, data = calibration.mechanism, calibration.measurements
    every, observation = np.arange(len(data)), calibration.observation
    problem = Problem(calibration.leg_block([0], every), observation)
    start = State(mechanism.legs[0].nominal, reached, external=observation.external.start)
    try:
        external, _ = aligned(problem, data, start, good, however_far=True)
    except MeasurementError:
        return None
    oriented = np.isfinite(data.poses).all(axis=1)
    if oriented.all():
        return mechanism.platform.matrices(calibration.given_poses(external))
    position = np.zeros((len(data), 3))
    position[:, : mechanism.platform.space] = data.poses[:, : mechanism.platform.space]
    matrices = np.where(good[:, None, None], reached, np.nan)
    inside = (position - external.frame[:3, 3]) @ external.frame[:3, :3]
    matrices[good, :3, 3] = (inside - reached[:, :3, :3] @ external.offsets[0])[good]
    return matrices


def _leg_fits(calibration: Calibration, matrices: Array) -> tuple[LegFit, ...]:
    """Return how measurements fit each leg.

    Args:
        calibration: The measurements put right.
        matrices: Poses ``T_base_platform``, shape (N, 4, 4); NaN where not known.
    """
    mechanism, data = calibration.mechanism, calibration.measurements
    used: Mask = calibration.used & np.isfinite(matrices[:, :1, 0])
    rows, fits = np.flatnonzero(used.any(axis=1)), []
    block = calibration.leg_block(range(len(mechanism.legs)), rows, used[rows])
    nominal = np.concatenate([leg.nominal for leg in mechanism.legs])
    with np.errstate(all="ignore"):  # units may be far off
        closed = block.evaluate(State(nominal, matrices[rows]))
    for place, (leg, columns) in enumerate(
        zip(mechanism.legs, mechanism.reading_columns, strict=True)
    ):
        served, demand = used[rows, place], closed.demands[place]
        nearest = partial(_nearest, calibration, place, matrices, used[:, place])
        if served.sum() < 2:
            fits.append(LegFit(int(served.sum()), np.nan, np.nan, 0, nearest))
            continue
        readings = data.readings[rows[served]][:, columns]
        with np.errstate(all="ignore"):
            moved = demand.reading[served] * (readings - np.median(readings, axis=0))[:, None]
            closure = LegClosure(leg, mechanism.platform).evaluate(
                closed.joints[place][served], matrices[rows[served]]
            )
            bent = mode_sign(closure) * home_mode(leg, mechanism.platform) < 0.0
            fit = LegFit(
                rows=int(served.sum()),
                gap=float(np.median(_missed(demand.value[served])) / leg.size),
                stroke=float(np.median(np.linalg.norm(moved, axis=(1, 2))) / leg.size),
                bent=int(bent.sum()),
                nearest=nearest,
            )
        fits.append(fit)
    return tuple(fits)


def _missed(conditions: Array) -> Array:
    """Return by how much rows miss, shape (N,)."""
    return np.nan_to_num(np.linalg.norm(conditions, axis=1), nan=np.inf)


def _nearest(calibration: Calibration, place: int, matrices: Array, used: Mask) -> Array:
    """Return what the machine near nominal that fits best leaves of a leg's closure, shape (N,).

    To first order and over the leg's size, by Gauss–Newton steps from the nominal parameters, in
    the weights of where the last one ended, none of them farther than machines differ.

    Args:
        calibration: The measurements put right.
        place: Of the leg.
        matrices: Poses ``T_base_platform``, taken as measured, shape (N, 4, 4).
        used: Rows that serve the leg, shape (N,).
    """
    leg, rows = calibration.mechanism.legs[place], np.flatnonzero(used)
    observation = Observation(calibration.mechanism, calibration.measurements.rows(rows), Setup())
    roots = calibration.noise.poses.roots[rows]
    problem = Problem(calibration.leg_block([place], rows, None, roots), observation)
    differ, left = changes_of(leg, leg.size), np.full(len(used), np.nan)
    free = replace(unknowns([leg]), priors=differ)
    system = System(problem, free, known=True, loss=LOSSES["huber"])
    with np.errstate(all="ignore"):
        nominal = best = problem.evaluate(State(leg.nominal, matrices[rows]))
        for _ in range(_STEPS):
            weights, scale = system.weights(best)
            scaled = system.with_priors(differ / scale)
            step = NormalEquations.of(scaled.triangle(nominal, weights)).step()
            step /= max(1.0, float(np.abs(step / differ).max(initial=0.0)))
            best = replace(nominal, conditions=nominal.after(step))
    left[rows] = _missed(best.conditions) / leg.size
    return left
