"""What residuals follow that a model lacks: errors of what was measured, each with its course.

An error follows its own reading, the pose, the order of rows, the side of approach, or begins at a
row. Each reading is asked alone, and what all readings have in common: the same error in each, or
each its own amplitudes. Positions that drift together are a frame's. All tests are one: the
probability that so much is found anywhere if nothing is there.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from operator import add
from typing import Literal

import numpy as np

from pincal.estimation.fit import Fit
from pincal.estimation.problem import Problem
from pincal.estimation.residuals.losses import CLEAR, FALSE_ALARM
from pincal.estimation.residuals.redundancy import ResidualForm, of_forms
from pincal.estimation.residuals.score import Error, Residuals
from pincal.kinematics.influences import sides
from pincal.model.setup import ORIGIN
from pincal.types import Array, Index

_HARMONICS = (1, 2, 3)
ALL, FRAME, LENGTHS = "readings", "positions", "lengths"
"""All readings; all positions, in a frame that moves; all lengths, which grow."""
_PER_READING = ("angle", "order", "approach")  # courses of which motors differ in amplitude
_OF_READING = ("angle", "approach")  # courses that each reading has its own of


@dataclass(frozen=True)
class Score:
    """One test: which quantity, which course, and how probable by chance."""

    quantity: str
    """Reading or measured quantity, as ``Problem.quantities`` names it; ``"readings"``, all,
    ``"positions"``, all, or ``"lengths"`` of the legs."""
    term: str
    """``"angle"``, ``"pose"``, ``"order"``, ``"approach"``, ``"step"`` or ``"again"``."""
    p_value: float
    """Of so much of the residuals, or more, in this term; of a step, anywhere."""
    row: int = 0
    """Of a step: the first row after it, among those of the fit."""
    size: float = 0.0
    """Of a step: by how much the quantity is off after it, [rad] or [m]; of a pose that was
    measured again: by how much it moved from the first time to the last."""
    place: str = ""
    """Of a pose that was measured again: its name."""

    @property
    def common(self) -> bool:
        """Whether it asks for what all readings, positions or lengths have in common."""
        return self.quantity in (ALL, FRAME, LENGTHS)


@dataclass
class _Tests:
    """Tests of one fit: what is asked, and what residuals say of it."""

    residuals: Residuals
    kinds: list[tuple[str, str]] = field(default_factory=list)
    forms: list[ResidualForm] = field(default_factory=list)

    def add(
        self, quantity: str, term: str, *errors: tuple[Error, Array], common: bool = False
    ) -> None:
        """Ask for errors with courses of shape (n_used, f), of one amplitude or each its own."""
        self.kinds.append((quantity, term))
        self.forms.append(self.residuals.form(*errors, common=common))

    def scores(self) -> Iterator[Score]:
        """Yield the answers."""
        chances = of_forms(self.forms, self.residuals.chi2, self.residuals.degrees_of_freedom)
        for (quantity, term), p_value in zip(self.kinds, chances.tolist(), strict=True):
            yield Score(quantity, term, p_value)


def scores(fit: Fit, again: Mapping[str, Index] | None = None) -> list[Score]:
    """Return the score tests of a fit, none of them independent of the others.

    Args:
        fit: The fit.
        again: Rows of poses that were measured again and again, among those of the fit: whether
            what was measured there moved with time.
    """
    if not _testable(fit):
        return []
    residuals, problem = Residuals.of(fit), fit.problem
    white = dict(errors_of(fit, residuals.used))
    tests, errors = _Tests(residuals), {name: residuals.error(w) for name, w in white.items()}
    time = np.linspace(-1.0, 1.0, len(residuals.used))[:, None]
    readings = list(errors)[: problem.leg_block.n_readings]
    pose = _of_pose(fit, residuals.used)
    by_course: dict[str, list[tuple[Error, Array]]] = {}
    for column, (name, error) in enumerate(errors.items()):
        courses = {"order": time}
        if name in readings:
            courses |= {"angle": _of_value(fit, column, residuals.used), "pose": pose}
            courses |= {"approach": _side(fit, column, residuals.used)}
        for term, b in courses.items():
            tests.add(name, term, (error, b))
            if name in readings:
                by_course.setdefault(term, []).append((error, b))
    if len(readings) > 1:
        _test_all_readings(tests, by_course)
    moved, axes = of_frame(problem, white)
    if len(axes) > 1:
        axis_errors = (residuals.error(moved[:, :, axis]) for axis in range(len(axes)))
        tests.add(FRAME, "order", *((error, time) for error in axis_errors))
    tests.add(LENGTHS, "order", (residuals.error(_grown(fit, residuals.used)), time))
    results = [*tests.scores()]
    for name, error in errors.items():
        results.append(Score(name, "step", *residuals.step(error)))
        results += _again(residuals, name, error, again or {})
    return results


def _testable(fit: Fit) -> bool:
    """Return whether residuals of a fit are white and say something."""
    return fit.problem.weighted and fit.degrees_of_freedom >= 2 and fit.chi2 > 0.0


def _test_all_readings(
    tests: _Tests, by_course: Mapping[str, Sequence[tuple[Error, Array]]]
) -> None:
    """Ask for errors of all readings at once, by the courses of each: alike, or each its own."""
    for term, errors in by_course.items():
        for width in dict.fromkeys(b.shape[1] for _, b in errors):  # [rad] and [m] differ
            same_width = [(error, b) for error, b in errors if b.shape[1] == width]
            if term not in _OF_READING:  # one course for all
                same_width = [(reduce(add, (error for error, _ in same_width)), same_width[0][1])]
            tests.add(ALL, term, *same_width, common=True)
    for term in _PER_READING:
        tests.add(ALL, term, *by_course[term])


def _again(
    residuals: Residuals, name: str, error: Error, repeated: Mapping[str, Index]
) -> Iterator[Score]:
    """Yield whether a quantity moved with time, at each pose that was measured again."""
    for place, rows in repeated.items():
        since = _since(residuals.used, rows)
        form = residuals.form((error, since[:, None]))
        p_value = float(of_forms([form], residuals.chi2, residuals.degrees_of_freedom)[0])
        yield Score(name, "again", p_value, size=residuals.size(error, since), place=place)


def errors_of(fit: Fit, used: Index) -> Iterator[tuple[str, Array]]:
    """Yield each measured quantity and the white rows of its unit error, shape (n_used, m)."""
    problem, linear, legs = fit.problem, fit.last, fit.problem.leg_block
    names, k = iter(problem.quantities), linear.conditions.shape[1]
    for demand, rows, serves in zip(linear.demands, legs.leg_rows, legs.used.T, strict=True):
        for by_reading in np.where(serves[:, None, None], demand.reading, 0.0).transpose(2, 0, 1):
            error = np.zeros((len(serves), k, 1))
            error[:, rows, 0] = by_reading
            yield next(names), linear.white(error)[used, :, 0]
    if problem.latent:
        for row in range(legs.n_rows, k):
            error = np.zeros((*linear.conditions.shape, 1))  # residuals are predicted less measured
            error[:, row, 0] = -linear.active[:, row].astype(float)
            yield next(names), linear.white(error)[used, :, 0]


def of_frame(problem: Problem, errors: Mapping[str, Array]) -> tuple[Array, tuple[str, ...]]:
    """Return the white rows of all positions that are off alike, (n_used, m, axes), and the axes.

    Args:
        problem: The problem.
        errors: White rows of unit errors by quantity (see ``errors_of``).
    """
    every = [of_target(problem, errors, name) for name in problem.observation.setup.targets]
    moved = np.sum(every, axis=0)
    known = moved.any(axis=(0, 1))
    axes = "xyz"[: problem.platform.space]
    return moved[:, :, known], tuple(axis for axis, is_ in zip(axes, known, strict=True) if is_)


def of_target(problem: Problem, errors: Mapping[str, Array], target: str) -> Array:
    """Return the white rows of a target's position that is off along x, y, z, (n_used, m, axes)."""
    stem = "" if target == ORIGIN else f"{target}_"
    none = np.zeros(next(iter(errors.values())).shape)
    axes = "xyz"[: problem.platform.space]
    return np.stack([errors.get(f"measured {stem}{axis}", none) for axis in axes], axis=2)


def _since(used: Index, rows: Index) -> Array:
    """Return the time at rows of one pose about its mean, 1 from first to last; 0 at others."""
    places = np.flatnonzero(np.isin(used, rows))
    when = np.zeros(len(used))
    if len(places) > 1:
        when[places] = (used[places] - used[places].mean()) / np.ptp(used[places])
    return when


def _grown(fit: Fit, used: Index) -> Array:
    """Return the white rows of legs whose lengths all grow by one part, shape (n_used, m)."""
    J, lengths = fit.last.jacobian[used], np.zeros(len(fit.unknowns.names))
    for leg, columns in zip(fit.problem.legs, fit.problem.leg_block.columns, strict=True):
        lengths_of_leg = {name for name, unit in leg.units.items() if unit == "m"} - leg.amplitudes
        long = np.array([name in lengths_of_leg for name in leg.parameter_names])
        lengths[columns] = long * fit.parameters[columns]
    return np.asarray(J @ lengths)


def _of_value(fit: Fit, column: int, used: Index) -> Array:
    """Return by what an error of a reading may follow its own value, shape (n_used, f)."""
    problem = fit.problem
    reading = problem.leg_block.readings[used, column]
    leg = next(
        i
        for i, columns in enumerate(problem.leg_block.reading_columns)
        if columns.start <= column < columns.stop
    )
    unit = problem.legs[leg].reading_units[column - problem.leg_block.reading_columns[leg].start]
    if unit == "rad":
        turns = [k * reading for k in _HARMONICS]
        return np.stack([f(turn) for turn in turns for f in (np.sin, np.cos)], axis=1)
    along = (reading - reading.mean()) / (float(np.ptp(reading)) or 1.0)
    return np.stack([along**2, along**3], axis=1)


def _of_pose(fit: Fit, used: Index) -> Array:
    """Return by what an error may follow the pose, to second order, shape (n_used, f)."""
    poses = fit.problem.platform.from_matrices(fit.last.state.matrices[used])
    scale = np.ptp(poses, axis=0)
    x = (poses - poses.mean(axis=0)) / np.where(scale > 0.0, scale, 1.0)
    i, j = np.triu_indices(x.shape[1])
    return np.concatenate((x, x[:, i] * x[:, j]), axis=1)


def _side(fit: Fit, column: int, used: Index) -> Array:
    """Return from which side a reading was come to, shape (n_used, 1)."""
    return np.nan_to_num(sides(fit.problem.leg_block.readings[:, column])[used])[:, None]


What = Literal["frame", "target", "orientation", "reading"]
_MAX_SLIPS = 3


@dataclass(frozen=True)
class Slip:
    """What is off from one row on, or more and more."""

    what: What
    name: str
    """The target or reading; empty of the frame."""
    row: int
    """The first row after it, among those of the fit; 0 of a drift."""
    size: Array
    """How far it is off after that row, shape (f,): in the axes of the measurements, of a target
    in those of the platform; of a drift from the first row to the last. [m] or [rad]."""
    axes: tuple[str, ...]
    """What the components of the size are along, such as ``("x", "y", "z")``."""
    unit: str
    """``"m"`` or ``"rad"``."""
    steady: bool
    """Whether it is a drift over the whole run rather than a slip."""
    p_value: float
    """Of so clear a change anywhere, by chance, all that was tried taken in."""
    or_else: tuple[tuple[What, str], ...] = ()
    """What else may have slipped: these rows cannot separate it."""


@dataclass(frozen=True)
class _Trial:
    slip: Slip
    inside: float
    white: Array
    """Of the error with its course, shape (n_used, m, f)."""


def slips(fit: Fit) -> list[Slip]:
    """Return what slipped or drifted, the clearest first; empty if nothing did."""
    if not _testable(fit):
        return []
    residuals, clearest = Residuals.of(fit), list[Slip]()
    candidates = list(_candidates(fit, residuals.used))
    while len(clearest) < _MAX_SLIPS:
        tried = [trial for candidate in candidates for trial in _tried(residuals, *candidate)]
        tried = sorted(tried, key=lambda trial: (trial.slip.p_value, -trial.inside))
        if not tried or tried[0].slip.p_value * len(tried) >= FALSE_ALARM:
            break
        first = tried[0]
        free = max(residuals.degrees_of_freedom - len(first.slip.size), 1)
        # by what is left, as F tests have it
        clear = CLEAR**2 * (residuals.chi2 - first.inside) / free
        indistinct = tuple(
            (trial.slip.what, trial.slip.name)
            for trial in tried[1:]
            if trial.slip.steady == first.slip.steady and first.inside - trial.inside < clear
            if trial.slip.unit == first.slip.unit and len(trial.slip.size) == len(first.slip.size)
        )
        chance = first.slip.p_value * len(tried)
        clearest.append(replace(first.slip, p_value=chance, or_else=indistinct))
        residuals = residuals.without(first.white)
    return clearest


def _tried(residuals: Residuals, slip: Slip, W: Array) -> Iterator[_Trial]:
    """Yield a slip at its clearest row, and a steady drift of the same quantities."""
    change = residuals.change(W)
    course = (residuals.used >= change.row).astype(float)
    after = replace(slip, row=change.row, size=change.size, p_value=change.p_value)
    yield _Trial(after, change.inside, W * course[:, None, None])
    time = (residuals.used - residuals.used[0]) / max(float(np.ptp(residuals.used)), 1.0)
    drift = residuals.amplitudes(W * time[:, None, None])
    if drift.rank == W.shape[2]:
        steady = replace(slip, size=-drift.values, steady=True, p_value=drift.p_value)
        yield _Trial(steady, drift.inside, W * time[:, None, None])


def _slip(kind: What, name: str, axes: tuple[str, ...], unit: str) -> Slip:
    return Slip(kind, name, 0, np.zeros(len(axes)), axes, unit, steady=False, p_value=1.0)


def _candidates(fit: Fit, used: Index) -> Iterator[tuple[Slip, Array]]:
    """Yield what may slip, and the white rows of its unit errors, shape (n_used, m, f)."""
    problem, platform = fit.problem, fit.problem.platform
    errors = dict(errors_of(fit, used))
    legs, readings = problem.leg_block, list(errors.values())[: problem.leg_block.n_readings]
    names = (name for leg in legs.legs for name in leg.reading_names)
    for name, unit, w in zip(names, problem.quantities.values(), readings, strict=False):
        yield _slip("reading", name, ("",), unit), w[:, :, None]
    if not problem.latent:
        return
    observation, state, axes = problem.observation, fit.last.state, "xyz"[: platform.space]
    turns = (state.external.frame[:3, :3] @ state.matrices[used, :3, :3])[:, :, : len(axes)]
    for target in observation.setup.targets:
        white = of_target(problem, errors, target)
        if white.any():
            turned = np.einsum("nma,nab->nmb", white, turns[:, : len(axes)])
            yield _slip("target", target, tuple(axes), "m"), turned
    moved, known = of_frame(problem, errors)
    if known:
        yield _slip("frame", "", known, "m"), moved
    pairs = zip(platform.freedoms, platform.units, strict=True)
    angles = tuple(name for name, unit in pairs if unit == "rad")
    if angles and all(errors[f"measured {name}"].any() for name in angles):
        W = np.stack([errors[f"measured {name}"] for name in angles], axis=2)
        yield _slip("orientation", ORIGIN, angles, "rad"), W
