"""The rule: a hypothesis explains measurements if each fault put right leaves a third of misfit.

Hypotheses that leave as little as the best cannot be separated from it; all of them are named.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pincal.calibration.hypotheses.faults import faults, of_legs, scale, zeros, zeros_by_poses
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
_CELLS = 12  # zeros of a motor tried at a time, over a turn,
_TIMES = 3  # then over a cell of the last


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
    every, framed = list(faults(case)), case.anywhere(_ROWS_FRAMED)
    single = [hypothesis for hypothesis in every if hypothesis.faults == 1]
    if case.alone and (nominal := as_measured.nominal_readings) is not None:
        single += [scale(case, nominal), zeros(zeros_by_poses(case, nominal))]
    moved = case.alone and not as_measured.within(DIFFER)
    stage = _judged(case, as_measured, single)
    if moved:
        stage += judge(framed, [replace(AS_MEASURED, code="unknown-frame")])
    yield stage
    if not case.alone:
        yield _zeros(case)
    yield _judged(case, as_measured, (several for several in every if several.faults > 1))
    if moved:
        singly = (hypothesis for hypothesis in faults(framed) if hypothesis.faults == 1)
        yield _judged(framed, as_measured, (replace(second, faults=2) for second in singly))


def _explains(judged: Judged, as_measured: Judged) -> bool:
    """Return whether a hypothesis leaves little enough of the misfit of what was given."""
    if as_measured.matrices is None and 2 * len(judged.questioned) >= len(judged.judged):
        return False  # anything is better than nothing: most legs must fit
    wrong_units = judged.hypothesis.values.get("units", ())
    shrinks = any((unit, written) == ("m", "mm") for _, unit, written in wrong_units)
    gap = max(as_measured.gap[as_measured.judged], default=np.inf)
    if shrinks and (gap < 1.0 or judged.questioned):
        return False  # lengths too large miss by far, and shrinking makes any misfit small
    most = as_measured.misfit / _EACH**judged.hypothesis.faults
    return judged.within(DIFFER) and judged.leaves(most)


def _judged(case: Case, as_measured: Judged, hypotheses: Iterable[Hypothesis]) -> list[Judged]:
    """Return hypotheses with their fits; those of single legs for the legs that they help."""
    mechanism, every = case.mechanism, range(len(case.mechanism.legs))
    if not case.alone:  # the frame depends on all legs
        tried: list[Hypothesis] = []
        for hypothesis in hypotheses:
            single = every if hypothesis.by_leg and len(every) > 1 else ()
            tried += [hypothesis, *(of_legs(hypothesis, mechanism, [i]) for i in single)]
        return _likely(case, tried)
    stage = []
    for judged in judge(case, list(hypotheses)):
        if judged.hypothesis.by_leg:
            divided = judged.misfits * _EACH <= as_measured.misfits
            helped = [i for i in judged.judged if divided[i]]
            if helped and len(helped) < len(every):
                stage += judge(case, [of_legs(judged.hypothesis, mechanism, helped)])
            if len(helped) < len(every):
                continue
        stage.append(judged)
    return stage


def _likely(case: Case, tried: Sequence[Hypothesis]) -> list[Judged]:
    """Return hypotheses with their fits, those of which a few rows fit the legs."""
    on_few_rows = judge(case.few(_ROWS_FEW), tried)
    return judge(case, [few.hypothesis for few in on_few_rows if few.within(EQUAL * DIFFER)])


def _zeros(case: Case) -> list[Judged]:
    """Return that the zero of one motor is off by a constant, where poses do not say it."""
    mechanism = case.mechanism
    if mechanism.by_readings:
        return []
    on_few_rows, axes = case.few(_ROWS_FEW), np.eye(len(mechanism.legs))
    far = [np.pi if leg.reading_units[0] == "rad" else leg.size / 2 for leg in mechanism.legs]
    best, reach, equal = np.zeros(len(axes)), np.array(far), 1.0
    for _ in range(_TIMES):
        grid = best + np.linspace(-1, 1, _CELLS + 1)[1:, None] * reach
        tried = [
            zeros(offset * axis) for row in grid for offset, axis in zip(row, axes, strict=True)
        ]
        costs = np.reshape([judged.mean_gap for judged in judge(on_few_rows, tried)], grid.shape)
        among = costs <= equal * costs.min(axis=0)
        best = (grid * among).sum(axis=0) / among.sum(axis=0)
        # where no measurement says more, the middle
        reach, equal = 2 * reach / _CELLS, EQUAL
    offsets = enumerate(best[:, None] * axes)
    return _likely(case, [replace(zeros(offset), legs=(leg,)) for leg, offset in offsets])


def as_findings(
    mechanism: Mechanism, as_measured: Judged, explaining: Sequence[Judged]
) -> tuple[Finding, ...]:
    """Return hypotheses that explain measurements as findings."""
    names, reading_names = mechanism.leg_names, mechanism.reading_names
    named_legs, found = as_measured.questioned or list(range(len(names))), []
    placed = as_measured.matrices is not None
    for judged in explaining:
        hypothesis, values = judged.hypothesis, dict[str, Any](judged.hypothesis.values)
        legs = hypothesis.legs or range(len(names))
        for key in values.keys() & {"offsets", "factors"}:  # those of its legs, with their names
            every = list(zip(reading_names, values[key], mechanism.reading_units, strict=True))
            values[key] = tuple(v for i in legs for v in every[mechanism.reading_columns[i]])
        values |= {
            "legs": tuple(names[i] for i in hypothesis.legs),
            "questioned": tuple(names[i] for i in named_legs),
            "given": float(as_measured.misfits[named_legs].max()) if placed else None,
            "left": float(judged.misfits[named_legs].max()),
            "other_side": as_measured.elsewhere,
            "unknown_frame": judged.free and not as_measured.free,
        }
        found.append(finding(hypothesis.code, **values))
    return tuple(found)
