"""Tests of residuals for errors of what was measured, each with a course that a model lacks.

What may err is a reading, a target, the frame of all positions, the orientation, or another
measured quantity. Its error may drift with the order of rows, begin at some row (a step), or move a
pose that is measured repeatedly; that of a reading may follow itself, the pose or the side of
approach, in one reading or in all of them, with the same error in each or separate amplitudes. All
tests are combined into one: the probability of any such finding by chance.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from pincal.estimation.fit import Fit
from pincal.estimation.observability.residuals import TAKEN, Amplitudes, Residuals
from pincal.estimation.system import CLEAR, FALSE_ALARM
from pincal.kinematics.batches import block_diagonal
from pincal.kinematics.influences import sides
from pincal.model import ORIGIN
from pincal.types import Array, Index

_HARMONICS = (1, 2, 3)
_MAX_SLIPS = 3
_FLAT = 0.01
"""Range of a coordinate over the widest of its unit, below which it has no visible effect."""
ALL, FRAME, LENGTHS = "readings", "positions", "lengths"
"""All readings; all positions, which move with their frame; all lengths, which grow."""
What = Literal["frame", "target", "orientation", "reading", "quantity"]


@dataclass(frozen=True)
class Score:
    """An error of something that was measured, its course, and the result of its test."""

    what: What
    name: str
    """Name of the target, reading or quantity; ``"positions"`` of the frame, ``"orientation"``;
    ``"readings"`` for all of them, ``"lengths"`` for those of the legs."""
    unit: str = "m"
    """``"m"`` or ``"rad"``."""
    axes: tuple[str, ...] = ("",)
    """Axes of the components of ``size``, such as ``("x", "y", "z")``."""
    term: str = ""
    """``"angle"``, ``"pose"``, ``"order"`` (a drift), ``"approach"``, ``"step"`` or ``"again"``."""
    p_value: float = 1.0
    """p-value; for a step that of a step at any row."""
    share: float = 0.0
    """Share of χ² that the error explains."""
    size: Array = field(default_factory=lambda: np.zeros(0))
    """Error after a step, or of a drift or a pose from its first measurement to its last, shape
    (f,), [m] or [rad], in the axes of the measurements; a target's in those of the platform."""
    row: int = 0
    """First row after a step, as an index in the fit."""
    place: str = ""
    """Name of a pose that was measured repeatedly."""
    correlation: float = 0.0
    """Correlation from row to row that a step or a drift leaves, 0 if not significant."""
    or_else: tuple[tuple[What, str], ...] = ()
    """What else may have slipped: these rows cannot distinguish it."""

    @property
    def common(self) -> bool:
        """Whether the test is of all readings or all lengths together."""
        return self.what == "quantity" and self.name in (ALL, LENGTHS)

    @property
    def total(self) -> float:
        """Error of one quantity with its sign, or the length of the error of several."""
        return float(self.size[0] if len(self.size) == 1 else np.linalg.norm(self.size))


Test = tuple[Score, Array]
"""An error, before or after its test, and its white rows, shape (n_used, m, f)."""


def scores(fit: Fit, repeated: Mapping[str, Index] | None = None) -> list[Score]:
    """Return the score tests of a fit, which are not independent of each other.

    ``repeated`` has rows of the fit by names of poses that were measured repeatedly; they are
    tested for motion with time.
    """
    if fit.degrees_of_freedom < 2 or not fit.chi2 > 0.0:
        return []
    residuals = Residuals.of(fit)
    subjects, used = list(_subjects(fit, residuals.used)), residuals.used
    tests = [test for subject in subjects for test in _step_and_drift(residuals, *subject)]
    for course, W in _courses(fit, subjects, used):
        tests.append((_scored(residuals, course, residuals.amplitudes(W, TAKEN)), W))
    results = [
        replace(score, correlation=_correlation(residuals, score, W, subjects))
        for score, W in tests
    ]
    for place, rows in (repeated or {}).items():
        at_place, since = np.isin(used, rows), np.zeros((len(used), 1, 1))
        if at_place.sum() > 1:  # the time about its mean, 1 from first to last
            times = used[at_place]
            since[at_place, 0, 0] = (times - times.mean()) / np.ptp(times)
        for subject, W in subjects:
            moved = residuals.amplitudes(W * since)
            results.append(_scored(residuals, subject, moved, term="again", place=place))
    return results


def _correlation(residuals: Residuals, score: Score, W: Array, subjects: Sequence[Test]) -> float:
    """Return the correlation from row to row that a significant step or drift leaves, or 0."""
    if score.term not in ("step", "order") or score.p_value >= FALSE_ALARM:
        return 0.0
    peers = [of_peer for peer, of_peer in subjects if peer.what == score.what] or [W]
    return residuals.alike_after(W, np.concatenate(peers, axis=2))


def _scored(residuals: Residuals, tested: Score, answer: Amplitudes, **values: Any) -> Score:
    share, size = answer.inside / residuals.chi2, -answer.values
    return replace(tested, p_value=answer.p_value, share=share, size=size, **values)


def _courses(fit: Fit, subjects: Sequence[Test], used: Index) -> Iterator[Test]:
    """Yield errors with their courses: of each reading, of all readings, and of all lengths.

    All readings have the same error or separate amplitudes; lengths grow with time.
    """
    readings = [(subject, W) for subject, W in subjects if subject.what == "reading"]
    time = np.linspace(-1.0, 1.0, len(used))[:, None]
    for term, courses in {**_reading_courses(fit, used), "order": [time] * len(readings)}.items():
        rows = [W * course[:, None] for (_, W), course in zip(readings, courses, strict=True)]
        for (reading, _), W in zip(readings, rows, strict=True):
            if term != "order":  # a drift is tested already
                yield replace(reading, term=term), W
        yield from _of_all_readings(term, rows) if len(rows) > 1 else ()
    grown = np.zeros((len(fit.unknowns.labels), 1))
    for leg, columns in zip(fit.problem.legs, fit.problem.leg_block.columns, strict=True):
        of_leg = [leg.units[n] == "m" and n not in leg.amplitudes for n in leg.parameter_names]
        grown[columns, 0] = np.where(of_leg, fit.parameters[columns], 0.0)
    growth = (fit.last.jacobian[used] @ grown) * time[:, None]
    yield Score("quantity", LENGTHS, term="order"), growth


def _of_all_readings(term: str, rows: Sequence[Array]) -> Iterator[Test]:
    """Yield a course of all readings, whose white rows are given, as one error and as several."""
    score = Score("quantity", ALL, term=term)
    for width in dict.fromkeys(W.shape[2] for W in rows):  # [rad] and [m] differ
        yield score, np.sum([W for W in rows if W.shape[2] == width], axis=0)
    if term != "pose":  # motors differ in amplitude
        yield score, np.concatenate(rows, axis=2)


def errors_of(fit: Fit, used: Index) -> dict[str, Array]:
    """Return the white rows of a unit error of each measured quantity, (n_used, m, 1)."""
    linear, r = fit.last, fit.last.conditions.shape[1] - fit.problem.leg_block.n_rows
    by_measured = np.broadcast_to(-np.eye(r), (len(linear.conditions), r, r))
    errors = block_diagonal((linear.by_measured, by_measured))
    errors = np.where(fit.problem.active[:, :, None], errors, 0.0)
    white = fit.last.white(errors)[used].transpose(2, 0, 1)[..., None]
    return dict(zip(fit.problem.quantities, white, strict=False))


def _reading_courses(fit: Fit, used: Index) -> dict[str, list[Array]]:
    """Return functions of value, pose and approach that an error of each reading may follow.

    Shapes are (n_used, f). The pose is taken to second order, without coordinates that hardly vary,
    such as heights over a plane: their variation is noise, to which residuals are related.
    """
    block, platform = fit.problem.leg_block, fit.problem.platform
    poses = platform.from_matrices(fit.last.state.matrices[used])
    same_unit = np.equal.outer(platform.units, platform.units)
    scale = np.ptp(poses, axis=0)
    varied = scale >= _FLAT * (same_unit * scale).max(axis=1)  # all of them, if none varies
    x = ((poses - poses.mean(axis=0)) / np.where(scale > 0.0, scale, 1.0))[:, varied]
    i, j = np.triu_indices(x.shape[1])
    pose = np.concatenate((x, x[:, i] * x[:, j]), axis=1)
    units = [unit for leg in block.legs for unit in leg.reading_units]
    by_value = []
    for value, unit in zip(block.readings[used].T, units, strict=True):
        if unit == "rad" and np.ptp(value) > np.pi:
            by_value += [[f(k * value) for k in _HARMONICS for f in (np.sin, np.cos)]]
        else:
            along = (value - value.mean()) / (float(np.ptp(value)) or 1.0)
            by_value += [[along**2, along**3]]
    return {
        "angle": [np.stack(columns, axis=1) for columns in by_value],
        "pose": [pose] * len(units),
        "approach": [np.nan_to_num(sides(v)[used])[:, None] for v in block.readings.T],
    }


def slips(fit: Fit) -> list[Score]:
    """Return slips and drifts, the most significant first; empty if there are none.

    Their p-values are of any slip or drift by chance, with all that was tried.
    """
    if fit.degrees_of_freedom < 2 or not fit.chi2 > 0.0:
        return []
    residuals, clearest = Residuals.of(fit), list[Score]()
    subjects = list(_subjects(fit, residuals.used))
    while len(clearest) < _MAX_SLIPS:
        tried = [trial for slip, W in subjects for trial in _step_and_drift(residuals, slip, W)]
        tried.sort(key=lambda trial: (trial[0].p_value, -trial[0].share))
        if not tried or tried[0][0].p_value * len(tried) >= FALSE_ALARM:
            break
        first, white = tried[0]
        free = max(residuals.degrees_of_freedom - len(first.size), 1)
        clear = CLEAR**2 * (1.0 - first.share) / free  # as in F tests
        indistinct = tuple(
            (slip.what, slip.name)
            for slip, _ in tried[1:]
            if slip.term == first.term and first.share - slip.share < clear
            if slip.unit == first.unit and len(slip.size) == len(first.size)
        )
        if _correlation(residuals, first, white, subjects):
            break  # neither a slip nor a drift
        chance = first.p_value * len(tried)
        clearest.append(replace(first, p_value=chance, or_else=indistinct))
        residuals = residuals.without(white)
    return clearest


def _step_and_drift(residuals: Residuals, slip: Score, W: Array) -> Iterator[Test]:
    """Yield a slip at its most significant row, and a drift; each with its white rows."""
    row, after, step = residuals.step(W)
    yield _scored(residuals, slip, step, term="step", row=row), after
    time = (residuals.used - residuals.used[0]) / max(float(np.ptp(residuals.used)), 1.0)
    steady = W * time[:, None, None]
    drift = residuals.amplitudes(steady)
    if drift.rank == W.shape[2]:
        yield _scored(residuals, slip, drift, term="order"), steady


def _subjects(fit: Fit, used: Index) -> Iterator[Test]:
    """Yield what may err, with the white rows of its unit errors, shape (n_used, m, f)."""
    errors, units = errors_of(fit, used), fit.problem.quantities
    for name in (name for leg in fit.problem.legs for name in leg.reading_names):
        quantity = next(iter(errors))  # readings are first
        yield Score("reading", name, units[quantity]), errors.pop(quantity)
    if fit.problem.latent:
        yield from _measured(fit, errors, used)
    for quantity, white in errors.items():
        if white.any():
            yield Score("quantity", quantity, units[quantity]), white


def _measured(fit: Fit, errors: dict[str, Array], used: Index) -> Iterator[Test]:
    """Yield targets, their frame and the orientation; their errors are taken out of ``errors``."""
    problem, platform, state = fit.problem, fit.problem.platform, fit.last.state
    axes, turns = tuple("xyz"[: platform.space]), state.external.frame @ state.matrices[used]
    moved = none = np.zeros((*fit.last.residuals[used].shape, 1))
    for target in problem.observation.setup.targets:
        stem = "measured " if target == ORIGIN else f"measured {target}_"
        white = np.concatenate([errors.pop(stem + axis, none) for axis in axes], axis=2)
        moved = moved + white
        if white.any():
            yield Score("target", target, "m", axes), white @ turns[:, : len(axes), : len(axes)]
    known = moved.any(axis=(0, 1))
    if known.any():
        axes = tuple(np.array(axes)[known].tolist())
        yield Score("frame", FRAME, "m", axes), moved[:, :, known]
    if angles := platform.freedoms[platform.lengths :]:
        turned = np.concatenate([errors.pop(f"measured {name}") for name in angles], axis=2)
        if turned.any(axis=(0, 1)).all():
            yield Score("orientation", "orientation", "rad", angles), turned
