"""The rule: a hypothesis explains measurements if each fault put right leaves a third of misfit.

Hypotheses that leave as little as the best cannot be separated from it; all of them are named.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pincal.calibration.hypotheses.faults import (
    of_legs,
    scales,
    single_faults,
    units,
    zeros,
    zeros_by_poses,
)
from pincal.calibration.hypotheses.judging import (
    AS_MEASURED,
    EQUAL,
    PRECISE,
    Case,
    Hypothesis,
    Judged,
    judge,
    other_side,
)
from pincal.estimation.observability.indices import DIFFER
from pincal.finding import Finding
from pincal.model.mechanism import Mechanism
from pincal.words.sentences import finding

_EACH = 3.0  # by which each fault that is put right divides the misfit
_ROWS_FRAMED, _ROWS_FEW = 40, 12  # enough where another frame is tried; to see what is likely
_CELLS, _TIMES = (
    12,
    3,
)  # zeros of a motor tried at a time, over a turn, then over a cell of the last


def explanations(case: Case, as_measured: Judged) -> list[Judged]:
    """Return the hypotheses that explain measurements, the simplest, as good as the best.

    Args:
        case: The measurements.
        as_measured: How they fit as they are.
    """
    for stage in _stages(case, as_measured):
        explaining = [judged for judged in stage if _explains(judged, as_measured)]
        if explaining:
            best = max(min(judged.misfit for judged in explaining), PRECISE)
            equal = [judged for judged in explaining if judged.misfit <= EQUAL * best]
            on_this_side = [
                judged for judged in equal if other_side(case.mechanism, judged.matrices) <= 0.5
            ]
            return on_this_side or ([] if as_measured.elsewhere > 0.5 else equal)
    return []


def _stages(case: Case, as_measured: Judged) -> Iterator[list[Judged]]:
    """Yield hypotheses with their fits, the simplest first.

    A base that is near where it should be is a change of parameters, and no hypothesis.
    """
    framed = case.anywhere(_ROWS_FRAMED)
    moved = case.alone and not as_measured.within(DIFFER)
    by_poses = as_measured.matrices if case.alone else None
    single = [*single_faults(case), *scales(case, by_poses)]
    if case.alone and by_poses is not None and not case.mechanism.by_readings:
        single.append(zeros(zeros_by_poses(case, by_poses)))
    judged = _judged(case, as_measured, single)
    if moved:
        judged += _judged(framed, as_measured, [replace(AS_MEASURED, code="unknown-frame")])
    yield judged
    if not case.alone:
        yield _zeros(case)
    yield _judged(case, as_measured, (several for several in units(case) if several.faults > 1))
    if moved:
        second = (replace(fault, faults=fault.faults + 1) for fault in single_faults(framed))
        yield _judged(framed, as_measured, second)


def _explains(judged: Judged, as_measured: Judged) -> bool:
    """Return whether a hypothesis leaves little enough of the misfit of what was given."""
    if not as_measured.fits and 2 * len(judged.questioned) >= len(judged.judged):
        return False  # anything is better than nothing: most legs must fit
    wrong_units = judged.hypothesis.values.get("units", ())
    shrinks = any((unit, written) == ("m", "mm") for _, unit, written in wrong_units)
    gap = max((fit.gap for fit in as_measured.judged), default=np.inf)
    if shrinks and (gap < 1.0 or judged.questioned):
        return False  # lengths too large miss by far, and shrinking makes any misfit small
    largest = as_measured.misfit / _EACH**judged.hypothesis.faults
    return judged.within(DIFFER) and judged.leaves(largest)


def _judged(case: Case, as_measured: Judged, hypotheses: Iterable[Hypothesis]) -> list[Judged]:
    """Return hypotheses with their fits; those of single legs for the legs that they help."""
    every, hypotheses = range(len(case.mechanism.legs)), list(hypotheses)
    if case.alone:
        return [
            _helped(judged, as_measured) if judged.hypothesis.by_leg else judged
            for judged in judge(case, hypotheses)
        ]
    tried: list[tuple[Hypothesis, tuple[int, ...]]] = []
    for hypothesis in hypotheses:  # the frame depends on all legs
        single = every if hypothesis.by_leg and len(every) > 1 else ()
        tried.append((hypothesis, ()))
        tried += [(of_legs(hypothesis, [i]), (i,)) for i in single]
    return _likely(case, tried)


def _likely(case: Case, tried: Sequence[tuple[Hypothesis, tuple[int, ...]]]) -> list[Judged]:
    """Return hypotheses, each with the legs that it concerns, of which a few rows fit the legs."""
    on_few_rows = judge(_few(case), [hypothesis for hypothesis, _ in tried])
    likely = [
        pair
        for pair, judged in zip(tried, on_few_rows, strict=True)
        if judged.within(EQUAL * DIFFER)
    ]
    every = judge(case, [hypothesis for hypothesis, _ in likely])
    return [replace(judged, legs=legs) for judged, (_, legs) in zip(every, likely, strict=True)]


def _few(case: Case) -> Case:
    """Return the case by a few of its rows."""
    count = len(case.rows)
    chosen = np.linspace(0, count - 1, min(_ROWS_FEW, count)).astype(int)
    return replace(case, rows=case.rows[chosen])


def _helped(judged: Judged, as_measured: Judged) -> Judged:
    """Return a hypothesis for those legs only whose readings it puts right."""
    pairs = list(enumerate(zip(judged.fits, as_measured.fits, strict=True)))
    divided = judged.misfits * _EACH <= as_measured.misfits
    helped = [i for i, (after, _) in pairs if after.rows > 1 and divided[i]]
    fits = tuple(after if i in helped else before for i, (after, before) in pairs)
    if len(helped) == len(pairs):
        return judged
    hypothesis = of_legs(judged.hypothesis, helped)
    return replace(judged, hypothesis=hypothesis, fits=fits, legs=tuple(helped))


def _zeros(case: Case) -> list[Judged]:
    """Return that the zero of one motor is off by a constant, where poses do not say it."""
    mechanism = case.mechanism
    if mechanism.by_readings:
        return []
    on_few_rows, axes = _few(case), np.eye(len(mechanism.legs))
    far = [np.pi if leg.reading_units[0] == "rad" else leg.size / 2 for leg in mechanism.legs]
    best, reach, equal = np.zeros(len(axes)), np.array(far), 1.0
    for _ in range(_TIMES):
        grid = best + np.linspace(-1, 1, _CELLS + 1)[1:, None] * reach
        tried = [
            zeros(offset * axis) for row in grid for offset, axis in zip(row, axes, strict=True)
        ]
        costs = np.reshape([judged.gap for judged in judge(on_few_rows, tried)], grid.shape)
        among = costs <= equal * costs.min(axis=0)
        best = (grid * among).sum(axis=0) / among.sum(axis=0)
        # where no measurement says more, the middle
        reach, equal = 2 * reach / _CELLS, EQUAL
    offsets = [replace(zeros(offsets), by_leg=False) for offsets in best[:, None] * axes]
    return _likely(case, [(offset, (index,)) for index, offset in enumerate(offsets)])


def as_findings(
    mechanism: Mechanism, as_measured: Judged, explaining: Sequence[Judged]
) -> tuple[Finding, ...]:
    """Return hypotheses that explain measurements as findings."""
    names = mechanism.leg_names
    named_legs = as_measured.questioned or list(range(len(names)))
    common: dict[str, Any] = {
        "other_side": as_measured.elsewhere,
        "questioned": tuple(names[i] for i in named_legs),
        "given": float(as_measured.misfits[named_legs].max()) if as_measured.fits else None,
    }
    return tuple(
        finding(
            judged.hypothesis.code,
            **common,
            **_values(mechanism, judged),
            legs=tuple(names[i] for i in judged.legs),
            left=float(judged.misfits[named_legs].max()),
            unknown_frame=judged.free and not as_measured.free,
        )
        for judged in explaining
    )


def _values(mechanism: Mechanism, judged: Judged) -> Mapping[str, Any]:
    """Return the values of a hypothesis; numbers of the legs that it concerns, with names."""
    values = dict(judged.hypothesis.values)
    names, reading_units = mechanism.reading_names, mechanism.reading_units
    legs = judged.legs or range(len(mechanism.legs))
    for key in values.keys() & {"offsets", "factors"}:
        every = list(zip(names, values[key], reading_units, strict=True))
        values[key] = tuple(v for i in legs for v in every[mechanism.reading_columns[i]])
    return values
