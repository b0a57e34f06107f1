"""Misfit of corrected measurements, by the estimator's own cost, for each leg alone.

If the base's place is unknown, or no orientation was measured, forward kinematics of the readings
gives the nominal machine's poses, which are aligned with the measured ones as where fits start. The
misfit of a leg is its closure residual after a few steps of the estimator at the measured poses,
with Cauchy's loss, and priors on parameters as wide as machines differ from drawings.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, lru_cache, partial
from typing import Any

import numpy as np

from pincal.calibration.calibration import Calibration
from pincal.calibration.options import Options
from pincal.errors import MeasurementError
from pincal.estimation.noise import assumed_noise
from pincal.estimation.observability.identifiable import DIFFER, changes_of
from pincal.estimation.problem import LegBlock
from pincal.estimation.start import aligned, placed
from pincal.estimation.system import NormalEquations, System
from pincal.estimation.unknowns import BlockRows, External, State, unknowns
from pincal.kinematics.closing import home_mode, mode_sign
from pincal.kinematics.closure import nominal_legs
from pincal.kinematics.configurations import inverse
from pincal.kinematics.forward import forward
from pincal.kinematics.singularity import margins
from pincal.model import ORIGIN, Measurements, Mechanism, Setup, Target
from pincal.types import Array, Index, Mask

QUESTIONED = 0.02  # misfit over the measured stroke, above which legs are questioned
PRECISE = 1e-4  # gap over the leg's size that is negligible
EQUAL = 2.0  # factor on the best misfit within which hypotheses cannot be separated
_ROWS, _ROWS_FORWARD = 500, 100  # most rows that are judged, without and with forward kinematics
_STEPS = 4  # Gauss–Newton steps to the machine near nominal that fits best


@dataclass(frozen=True)
class Hypothesis:
    """A hypothesis on a fault in measurements, with its correction."""

    code: str
    """Code of its finding; sentence and remedy are in ``pincal.words.findings``."""
    correct: Callable[[Measurements], Measurements]
    """Function that returns corrected measurements."""
    values: Mapping[str, Any] = field(default_factory=dict)
    """Names and numbers for its sentence."""
    by_leg: bool = False
    """Whether it may concern only the readings of some legs."""
    faults: int = 1
    """Number of faults that it combines."""
    legs: tuple[int, ...] = ()
    """Indices of the legs whose readings it concerns; empty for all."""


AS_MEASURED = Hypothesis("nothing", lambda data: data)


@dataclass(frozen=True, eq=False)
class Case:
    """Measurements to be judged, with negligible noise, and the rows for it."""

    calibration: Calibration
    """All measurements, in the base frame or an unknown one, with orientations if measured."""
    rows: Index
    """Rows of the measurements that are judged."""

    @staticmethod
    @lru_cache(maxsize=4)
    def of(mechanism: Mechanism, data: Measurements, free: bool, target: Target) -> Case | None:
        """Return a case; None with less than two rows, or if only the target's place is unknown.

        ``free`` is an unknown place of the base. Rows have complete poses or, if there are none,
        positions and all readings.
        """
        known, poses = np.isfinite(data.poses), data.poses.copy()
        rows, oriented = np.flatnonzero(known.all(axis=1)), True
        if len(rows) < 2:
            lengths, oriented = mechanism.platform.lengths, False
            known_rows = np.isfinite(data.readings).all(axis=1)
            rows = np.flatnonzero(known[:, :lengths].all(axis=1) & known_rows)
            poses[:, lengths:] = np.nan
        if len(rows) < 2 or (target.unknown and np.any(target.offset) and not free):
            return None
        target = replace(target, unknown=target.unknown and free)
        most = _ROWS if oriented and not free else _ROWS_FORWARD
        setup = Setup(unknown_frame=free, targets={ORIGIN: target})
        noise = assumed_noise(mechanism, exact=True)
        bare = Measurements(
            poses, readings=data.readings, influences=data.influences, written=data.written
        )
        calibration = Calibration(mechanism, bare, Options(noise=noise, setup=setup))
        return Case(calibration, rows[:: -(-len(rows) // most)])

    @property
    def mechanism(self) -> Mechanism:
        """The nominal mechanism."""
        return self.calibration.mechanism

    @property
    def oriented(self) -> bool:
        """Whether orientations were measured."""
        return bool(np.isfinite(self.calibration.measurements.poses[self.rows]).all())

    @property
    def alone(self) -> bool:
        """Whether each leg can be judged without the others."""
        return self.oriented and not self.calibration.options.setup.unknown_frame

    @property
    def readings(self) -> Array:
        """Readings of the rows, shape (N, n_readings), [rad] or [m]; NaN where not measured."""
        return self.calibration.measurements.readings[self.rows]

    @cached_property
    def as_measured(self) -> Judged:
        """Fit to the measurements as given, with the share across singularities."""
        (judged,) = judge(self)
        return replace(judged, elsewhere=other_side(self.mechanism, judged.matrices))

    def corrected(self, hypotheses: Sequence[Hypothesis]) -> Calibration:
        """Return the rows as they should read under hypotheses, one below the other."""
        every = self.calibration.measurements
        trials = [hypothesis.correct(every).rows(self.rows) for hypothesis in hypotheses]
        data = replace(
            every.rows(np.tile(self.rows, len(trials))),
            poses=np.concatenate([trial.poses for trial in trials]),
            readings=np.concatenate([trial.readings for trial in trials]),
        )
        return replace(self.calibration, measurements=data, known_noise=None)

    def few(self, count: int) -> Case:
        """Return the case with at most ``count`` of its rows, evenly spaced."""
        places = np.linspace(0, len(self.rows) - 1, min(count, len(self.rows)))
        return replace(self, rows=self.rows[places.astype(int)])


def case_of(calibration: Calibration, frame: External | None = None) -> Case | None:
    """Return the case of a calibration, with the target's place from ``frame``, if estimated.

    Where no pose was measured it is of the target that was measured most often.
    """
    setup, data, name = calibration.options.setup, calibration.measurements, ORIGIN
    if not np.isfinite(data.poses).any():
        counts = {n: np.isfinite(data.extra.get(f"{n}_x", np.nan)).sum() for n in setup.targets}
        name = max(counts, key=counts.__getitem__)
        poses = data.poses.copy()
        for place, axis in enumerate("xyz"[: calibration.mechanism.platform.lengths]):
            poses[:, place] = data.extra.get(f"{name}_{axis}", np.nan)
        data = replace(data, poses=poses)
    target = setup.targets[name]
    if frame is not None and target.unknown:
        x, y, z = frame.offsets[[*setup.targets].index(name)].tolist()
        target = Target((x, y, z))
    return Case.of(calibration.mechanism, data, setup.unknown_frame, target)


@dataclass(frozen=True, eq=False)
class Judged:
    """A hypothesis, and the misfit of each leg to corrected measurements, over the leg's size."""

    hypothesis: Hypothesis
    calibration: Calibration
    """Measurements as corrected by this hypothesis and others, one below the other."""
    matrices: Array
    """Corrected poses in the base frame, shape (N, 4, 4); NaN where unknown, and everywhere if
    readings and measurements cannot be aligned."""
    row_counts: Index
    """Number of rows with a reading, shape (n_legs,)."""
    gap: Array
    """Median closure residual at the nominal parameters, (n_legs,); NaN with less than two rows."""
    stroke: Array
    """Median motion of the leg's end by its readings, (n_legs,); the largest for passive legs."""
    bent: Index
    """Number of rows that close the leg in another working mode than home's, shape (n_legs,)."""
    remaining: Callable[[int], Array]
    """Function of a leg's index that returns its closure residuals for the best machine near
    nominal, shape (N,); NaN where there is no reading."""
    elsewhere: float = 0.0
    """Share of poses across a type-2 singularity from home, if it was computed."""

    @property
    def free(self) -> bool:
        """Whether the base's place is unknown and was aligned."""
        return self.calibration.options.setup.unknown_frame

    @property
    def placed(self) -> bool:
        """Whether readings and measurements could be aligned."""
        return bool(np.isfinite(self.matrices).any())

    @cached_property
    def nominal_readings(self) -> Array | None:
        """Readings of the nominal machine at the poses, (N, n_readings); None if unknown."""
        mechanism = self.calibration.mechanism
        if not self.placed or mechanism.by_readings:
            return None
        return inverse(mechanism, mechanism.platform.from_matrices(self.matrices)).readings

    @property
    def judged_legs(self) -> list[int]:
        """Indices of the legs with two or more rows."""
        return np.flatnonzero(self.row_counts > 1).tolist()

    @property
    def as_home(self) -> Mask:
        """Whether most rows close a leg in home's working mode, shape (n_legs,)."""
        return 2 * self.bent <= self.row_counts

    def near(self, leg: int) -> float:
        """Return a leg's median misfit for machines near nominal; its gap if that is too large."""
        gap = float(self.gap[leg])
        return min(gap, float(np.nanmedian(self.remaining(leg)))) if gap <= DIFFER else gap

    @property
    def misfits(self) -> Array:
        """Misfit of each leg, (n_legs,): at least 1 in another working mode, 0 without rows."""
        sizes = np.zeros(len(self.row_counts))
        for i in self.judged_legs:
            sizes[i] = self.near(i) if self.as_home[i] else max(1.0, float(self.gap[i]))
        return sizes

    @property
    def misfit(self) -> float:
        """Mean misfit of legs with rows; at least 1 without any, or across a singularity."""
        mean = float(self.misfits[self.judged_legs].mean()) if self.judged_legs else 1.0
        return max(mean, 1.0) if self.elsewhere > 0.5 else mean

    @cached_property
    def questioned(self) -> list[int]:
        """Indices of the legs that no machine near nominal fits well."""
        most = np.maximum(np.minimum(QUESTIONED * self.stroke, DIFFER), PRECISE)
        return [
            i for i in self.judged_legs if not (self.gap[i] <= most[i] or self.near(i) <= most[i])
        ]

    def within(self, most: float) -> bool:
        """Return whether every leg's gap is at most ``most`` of its size, in home's mode."""
        return self.placed and all(
            self.as_home[i] and self.gap[i] <= most for i in self.judged_legs
        )

    @property
    def fits_well(self) -> bool:
        """Whether the measurements fit, so that there is nothing to explain."""
        return self.placed and not self.questioned and self.elsewhere <= 0.5


def judge(case: Case, hypotheses: Sequence[Hypothesis] = (AS_MEASURED,)) -> list[Judged]:
    """Return the fit of all legs to the measurements corrected by each hypothesis."""
    if not hypotheses:
        return []
    corrected, platform = case.corrected(hypotheses), case.mechanism.platform
    data, legs = corrected.measurements, range(len(case.mechanism.legs))
    parts = np.split(np.arange(len(data)), len(hypotheses))
    matrices = _placed(case, corrected, parts)
    known = np.asarray(np.isfinite(matrices).all(axis=(1, 2), keepdims=True))
    at_home = np.where(known, matrices, platform.home_pose.as_matrix())
    readings = np.where(known[:, :, 0], data.readings, np.nan)
    data = replace(data, poses=platform.from_matrices(at_home), readings=readings)
    calibration = replace(corrected, measurements=data)
    block = calibration.leg_block(legs, np.arange(len(data)), calibration.used)
    with np.errstate(all="ignore"):  # wrong units may overflow
        closed = block.evaluate(State(case.mechanism.parameters.values, at_home))
    fits = zip(hypotheses, parts, strict=True)
    return [
        _fit(hypothesis, calibration, part, matrices, block, closed) for hypothesis, part in fits
    ]


def other_side(mechanism: Mechanism, matrices: Array) -> float:
    """Return the share of poses that lie across a type-2 singularity from home."""
    known = matrices[np.isfinite(matrices).all(axis=(1, 2))]
    if mechanism.by_readings or not len(known):
        return 0.0
    return float((margins(mechanism, mechanism.platform.from_matrices(known)).type2 < 0.0).mean())


def _placed(case: Case, calibration: Calibration, parts: Sequence[Index]) -> Array:
    """Return the poses of all hypotheses, (N, 4, 4), whose rows are in parts; NaN if unknown."""
    platform, observation = case.mechanism.platform, calibration.observation
    data = calibration.measurements
    if case.alone:
        return placed(observation, data, observation.external.start)
    known = np.asarray(np.isfinite(data.readings).all(axis=1))
    distinct, index = np.unique(data.readings[known], axis=0, return_inverse=True)
    with np.errstate(all="ignore"):
        solution = forward(case.mechanism, distinct)
    reached = np.tile(platform.home_pose.as_matrix(), (len(known), 1, 1))
    converged = np.zeros(len(known), dtype=bool)
    converged[known] = solution.converged[index.ravel()]
    reached[converged] = platform.matrices(solution.poses[index.ravel()][converged[known]])
    poses = np.full_like(reached, np.nan)
    for part in parts:
        rows, seen, T, good = data.rows(part), observation.at(part), reached[part], converged[part]
        start = State(case.mechanism.legs[0].nominal, T, external=seen.external.start)
        with suppress(MeasurementError):
            if good.any() and 2 * good.sum() >= max(known[part].sum(), 6):
                external, _ = aligned(seen, rows, start, good)
                certain = good | np.isfinite(rows.poses).all(axis=1)
                matrices = placed(seen, rows, external, platform.from_matrices(T))
                poses[part[certain]] = matrices[certain]
    return poses


def _fit(
    hypothesis: Hypothesis,
    calibration: Calibration,
    part: Index,
    matrices: Array,
    block: LegBlock,
    closed: BlockRows,
) -> Judged:
    """Return the fit of each leg in some rows of corrected measurements at poses (N, 4, 4)."""
    mechanism, used = calibration.mechanism, block.used[part]
    (gap, stroke), bent = np.full((2, used.shape[1]), np.nan), np.zeros(used.shape[1], dtype=int)
    with np.errstate(all="ignore"):
        for i in np.flatnonzero(used.sum(axis=0) > 1).tolist():
            leg, rows, of_leg = mechanism.legs[i], part[used[:, i]], block.leg_rows[i]
            readings = block.readings[rows, block.reading_columns[i]]
            deviations = (readings - np.median(readings, axis=0))[:, None]
            by_reading = closed.by_measured[rows, of_leg, block.reading_columns[i]]
            moved = np.linalg.norm(by_reading * deviations, axis=(1, 2))
            closure = nominal_legs(mechanism)[i].evaluate(closed.joints[i][rows], matrices[rows])
            bent[i] = (mode_sign(closure) * home_mode(leg, mechanism.platform) < 0.0).sum()
            gap[i] = np.median(_missed(closed.value[rows, of_leg])) / leg.size
            stroke[i] = np.median(moved) / leg.size
    # the platform moves legs without a sensor, too
    stroke[[not leg.sensors for leg in mechanism.legs]] = np.nan_to_num(stroke).max()
    left, rows = cache(partial(_nearest, calibration, part)), used.sum(axis=0)
    return Judged(hypothesis, calibration, matrices[part], rows, gap, stroke, bent, left)


def _missed(conditions: Array) -> Array:
    return np.nan_to_num(np.linalg.norm(conditions, axis=1), nan=np.inf)


def _nearest(calibration: Calibration, part: Index, place: int) -> Array:
    """Return a leg's closure residuals, over its size, for the best machine near nominal, (N,).

    To first order at the measured poses: a few reweighted Gauss–Newton steps from nominal, none
    longer than machines differ from drawings.
    """
    leg = calibration.mechanism.legs[place]
    problem, rows = calibration.rows(part).measured_problem([leg.name])
    differ, left = changes_of(leg, leg.size), np.full(len(part), np.nan)
    free = replace(unknowns([leg]), priors=differ)
    system = System(problem, free, np.ones(len(rows), dtype=bool), known=True, robust=True)
    with np.errstate(all="ignore"):
        nominal = problem.evaluate(problem.start(leg.nominal))
        conditions = nominal.conditions
        for _ in range(_STEPS):
            squares = (nominal.whitened(conditions) ** 2).sum(axis=1)
            priors = differ / system.scale(squares)
            scaled = replace(system, unknowns=replace(free, priors=priors))
            step = NormalEquations.of(scaled.triangle(nominal, system.weights(squares))).step()
            step /= max(1.0, float(np.abs(step / differ).max(initial=0.0)))
            conditions = nominal.after(step)
        left[rows] = _missed(conditions) / leg.size
    return left
