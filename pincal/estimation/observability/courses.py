"""Tests of residuals for errors of measured quantities, each with a course that a model lacks.

An error may depend on its own reading, the pose, the order of rows or the side of approach, or
begin at some row (a step). Each reading is tested alone, and all readings together, with the same
error in each or with separate amplitudes. Positions that drift together belong to a frame. All
tests are combined into one: the probability of any such finding by chance.
"""

from collections.abc import Iterator, Mapping
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
"""Errors of all readings; of all positions, in a moving frame; of all lengths, which grow."""
What = Literal["frame", "target", "orientation", "reading", "quantity"]


@dataclass(frozen=True)
class Score:
    """An error of something that was measured, its course, and the result of its test."""

    what: What
    name: str
    """Name of the target or reading, empty for the frame; or a quantity, as ``Problem.quantities``
    names it; all ``"readings"`` or ``"positions"``, or the ``"lengths"`` of the legs."""
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
        """Whether the test is of all readings, positions or lengths together."""
        return self.what == "quantity" and self.name in (ALL, FRAME, LENGTHS)

    @property
    def total(self) -> float:
        """Error of one quantity with its sign, or the length of the error of several."""
        return float(self.size[0] if len(self.size) == 1 else np.linalg.norm(self.size))


def scores(fit: Fit, repeated: Mapping[str, Index] | None = None) -> list[Score]:
    """Return the score tests of a fit, which are not independent of each other.

    ``repeated`` has rows of the fit by names of poses that were measured repeatedly; they are
    tested for motion with time.
    """
    if fit.degrees_of_freedom < 2 or not fit.chi2 > 0.0:
        return []
    residuals, results = Residuals.of(fit), list[Score]()
    used, errors = residuals.used, errors_of(fit, residuals.used)
    (kinds, of_kind), units = _kinds(fit, errors), fit.problem.quantities
    for quantity, term, course in _course_tests(fit, errors, used):
        followed, correlation = residuals.amplitudes(course, TAKEN), 0.0
        if term == "order" and followed.p_value < FALSE_ALARM:
            peers = of_kind[kinds[quantity]] if quantity in errors else course
            correlation = residuals.alike_after(course, peers)
        tested = Score("quantity", quantity, units.get(quantity, "m"), term=term)
        results.append(_scored(residuals, tested, followed, correlation=correlation))
    for name, error in errors.items():
        tested, correlation = Score("quantity", name, units[name], term="step"), 0.0
        row, after, step = residuals.step(error)
        if step.p_value < FALSE_ALARM:
            correlation = residuals.alike_after(after, of_kind[kinds[name]])
        results.append(_scored(residuals, tested, step, row=row, correlation=correlation))
    for name, error in errors.items():
        for place, rows in (repeated or {}).items():
            at_place, since = np.isin(used, rows), np.zeros((len(used), 1, 1))
            if at_place.sum() > 1:  # the time about its mean, 1 from first to last
                times = used[at_place]
                since[at_place, 0, 0] = (times - times.mean()) / np.ptp(times)
            tested = Score("quantity", name, units[name], term="again", place=place)
            results.append(_scored(residuals, tested, residuals.amplitudes(error * since)))
    return results


def _scored(residuals: Residuals, tested: Score, answer: Amplitudes, **values: Any) -> Score:
    share, size = answer.inside / residuals.chi2, -answer.values
    return replace(tested, p_value=answer.p_value, share=share, size=size, **values)


def _kinds(
    fit: Fit, errors: Mapping[str, Array]
) -> tuple[dict[str, tuple[bool, str]], dict[tuple[bool, str], Array]]:
    """Return each quantity's kind (is it a reading, its unit), and white rows of each kind."""
    n = fit.problem.leg_block.n_readings
    units = enumerate(fit.problem.quantities.items())
    kinds = {name: (place < n, unit) for place, (name, unit) in units}
    of_kind: dict[tuple[bool, str], list[Array]] = {}
    for name, error in errors.items():
        of_kind.setdefault(kinds[name], []).append(error)
    return kinds, {kind: np.concatenate(rows, axis=2) for kind, rows in of_kind.items()}


def _course_tests(
    fit: Fit, errors: Mapping[str, Array], used: Index
) -> Iterator[tuple[str, str, Array]]:
    """Yield quantities and courses to test, with their white rows, (n_used, m, f).

    Each quantity is tested alone, then all readings with the same error or separate amplitudes,
    then growth of all lengths and motion of all positions with time.
    """
    n_readings, time = fit.problem.leg_block.n_readings, np.linspace(-1.0, 1.0, len(used))[:, None]
    courses = {"order": [time] * len(errors), **_reading_courses(fit, used)}
    for term, of_quantities in courses.items():
        named = zip(errors.items(), of_quantities, strict=False)
        rows = {name: error * course[:, None] for (name, error), course in named}
        yield from ((name, term, of_quantity) for name, of_quantity in rows.items())
        readings = list(rows.values())[:n_readings]
        widths = dict.fromkeys(of_reading.shape[2] for of_reading in readings)
        for width in widths if n_readings > 1 else ():  # [rad] and [m] differ
            yield ALL, term, np.sum([e for e in readings if e.shape[2] == width], axis=0)
        if n_readings > 1 and term != "pose":  # motors differ in amplitude
            yield ALL, term, np.concatenate(readings, axis=2)
    grown = np.zeros((len(fit.unknowns.labels), 1))
    for leg, columns in zip(fit.problem.legs, fit.problem.leg_block.columns, strict=True):
        of_leg = [leg.units[n] == "m" and n not in leg.amplitudes for n in leg.parameter_names]
        grown[columns, 0] = np.where(of_leg, fit.parameters[columns], 0.0)
    yield LENGTHS, "order", (fit.last.jacobian[used] @ grown) * time[:, None]
    moved, axes = _frame_errors(fit, errors)
    if len(axes) > 1:
        yield FRAME, "order", moved * time[:, None]


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


def _target_errors(fit: Fit, errors: Mapping[str, Array], target: str) -> Array:
    """Return the white rows of unit errors of a target along x, y, z, (n_used, m, n_axes)."""
    stem = "" if target == ORIGIN else f"{target}_"
    none = np.zeros_like(next(iter(errors.values())))
    names = [f"measured {stem}{axis}" for axis in "xyz"[: fit.problem.platform.space]]
    return np.concatenate([errors.get(name, none) for name in names], axis=2)


def _frame_errors(fit: Fit, errors: Mapping[str, Array]) -> tuple[Array, tuple[str, ...]]:
    """Return white rows of unit errors of all positions, (n_used, m, n_axes), and the axes."""
    targets = fit.problem.observation.setup.targets
    moved = np.sum([_target_errors(fit, errors, target) for target in targets], axis=0)
    known = moved.any(axis=(0, 1))
    return moved[:, :, known], tuple(np.array(list("xyz"[: len(known)]))[known].tolist())


def slips(fit: Fit) -> list[Score]:
    """Return slips and drifts, the most significant first; empty if there are none.

    Their p-values are of any slip or drift by chance, with all that was tried.
    """
    if fit.degrees_of_freedom < 2 or not fit.chi2 > 0.0:
        return []
    residuals, clearest = Residuals.of(fit), list[Score]()
    errors = errors_of(fit, residuals.used)
    candidates, (_, of_kind) = (list(_candidates(fit, errors, residuals.used)), _kinds(fit, errors))
    while len(clearest) < _MAX_SLIPS:
        tried = [trial for slip, W in candidates for trial in _step_and_drift(residuals, slip, W)]
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
        if residuals.alike_after(white, of_kind[first.what == "reading", first.unit]):
            break  # neither a slip nor a drift
        chance = first.p_value * len(tried)
        clearest.append(replace(first, p_value=chance, or_else=indistinct))
        residuals = residuals.without(white)
    return clearest


def _step_and_drift(residuals: Residuals, slip: Score, W: Array) -> Iterator[tuple[Score, Array]]:
    """Yield a slip at its most significant row, and a drift; each with its white rows."""
    row, after, step = residuals.step(W)
    yield _scored(residuals, slip, step, term="step", row=row), after
    time = (residuals.used - residuals.used[0]) / max(float(np.ptp(residuals.used)), 1.0)
    steady = W * time[:, None, None]
    drift = residuals.amplitudes(steady)
    if drift.rank == W.shape[2]:
        yield _scored(residuals, slip, drift, term="order"), steady


def _candidates(
    fit: Fit, errors: Mapping[str, Array], used: Index
) -> Iterator[tuple[Score, Array]]:
    """Yield what may slip, with the white rows of its unit errors, shape (n_used, m, f)."""
    problem, platform = fit.problem, fit.problem.platform
    readings = [name for leg in problem.legs for name in leg.reading_names]
    quantities = zip(readings, errors.values(), problem.quantities.values(), strict=False)
    for name, error, unit in quantities:
        yield Score("reading", name, unit), error
    if not problem.latent:
        return
    state, axes = fit.last.state, tuple("xyz"[: platform.space])
    turns = state.external.frame[:3, :3] @ state.matrices[used, :3, :3]
    for target in problem.observation.setup.targets:
        white = _target_errors(fit, errors, target)
        if white.any():
            yield Score("target", target, "m", axes), white @ turns[:, : len(axes), : len(axes)]
    moved, known = _frame_errors(fit, errors)
    if known:
        yield Score("frame", "", "m", known), moved
    angles = platform.freedoms[platform.lengths :]
    if angles:
        turned = np.concatenate([errors[f"measured {name}"] for name in angles], axis=2)
        if turned.any(axis=(0, 1)).all():
            yield Score("orientation", ORIGIN, "rad", angles), turned
