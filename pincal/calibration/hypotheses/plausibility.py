"""Test whether this mechanism can have made the measurements.

Readings and poses are plausible if machines near the nominal one explain their closure gaps, with
legs bent as at home. Otherwise frequent faults are corrected, one hypothesis at a time; it explains
the measurements if each corrected fault reduces the misfit to a third. All hypotheses that do as
well as the best are named, as they cannot be separated. If there is none, nothing is identified.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from operator import attrgetter
from typing import Any

import numpy as np

from pincal.calibration.calibration import Calibration
from pincal.calibration.hypotheses.faults import faults, of_legs, scale, zeros, zeros_by_poses
from pincal.calibration.hypotheses.judging import (
    AS_MEASURED,
    EQUAL,
    PRECISE,
    QUESTIONED,
    Case,
    Hypothesis,
    Judged,
    case_of,
    judge,
    other_side,
)
from pincal.calibration.hypotheses.photos import photo_faults
from pincal.errors import MeasurementError
from pincal.estimation.observability.identifiable import DIFFER
from pincal.estimation.observation import Observation
from pincal.estimation.unknowns import External
from pincal.finding import Finding
from pincal.kinematics.closing import sensor_law
from pincal.kinematics.closure import nominal_legs
from pincal.kinematics.forward import forward
from pincal.model import ROW, TO, Measurements
from pincal.model.checks import ROUNDING
from pincal.words.findings import finding
from pincal.words.numbers import amount

_STILL = 1e-3  # least range of moving readings, over a leg's size, or [rad]
_FOLLOWS = 0.5  # largest misfit, over the stroke, of readings that follow the poses
_PAST = 0.1  # [rad] beyond half a turn from home that a reading may have: encoders wrap there
_SLIP = 10.0  # factor on the median misfit of bad rows, if fewer than one row in so many is bad
_EACH = 3.0  # factor by which each corrected fault must reduce the misfit
_ROWS_FRAMED, _ROWS_FEW = 40, 12  # rows to judge in another frame; rows for a first selection
_CELLS = 12  # zeros of a motor on a grid over a turn,
_TIMES = 3  # number of grids, each over a cell of the last


def implausible(calibration: Calibration) -> tuple[Finding, ...]:
    """Return findings that exclude a mechanism near the nominal one, by complete poses."""
    case = case_of(calibration)
    return () if case is None or not case.oriented else _faults(case) or _strange(case)


def explain_misfit(calibration: Calibration, frame: External | None = None) -> tuple[Finding, ...]:
    """Return findings that would explain why measurements do not fit; empty if none does.

    ``frame`` has estimated frame and targets. Zeros from which the fit started do not count.
    """
    if calibration.options.setup.pixels and (faults := photo_faults(calibration)):
        return faults
    case, started = case_of(calibration, frame), calibration.start is not None
    explaining = () if case is None else _faults(case) or _slips(case)
    return tuple(f for f in explaining if not (started and f.code == "reading-offset"))


def hypotheses_of(calibration: Calibration) -> list[tuple[Finding, Judged]]:
    """Return the hypotheses that explain why measurements do not fit, with their findings."""
    if (case := case_of(calibration)) is None:
        return []
    explaining = explanations(case)
    return list(zip(as_findings(case, explaining), explaining, strict=True))


def _faults(case: Case) -> tuple[Finding, ...]:
    """Return findings on readings that stand still, or else the explanations of the misfit."""
    return _still(case) or as_findings(case, explanations(case))


@lru_cache(maxsize=4)
def explanations(case: Case) -> list[Judged]:
    """Return the simplest hypotheses that explain measurements about as well as the best."""
    if case.as_measured.fits_well:
        return []
    slips = _slips(case)  # few rows may be all that is wrong
    if slips and judge(replace(case, rows=np.setdiff1d(case.rows, slips[0].rows)))[0].fits_well:
        return []
    for stage in _stages(case):
        explaining = [judged for judged in stage if _explains(judged, case.as_measured)]
        if explaining:
            best = max(PRECISE, min(map(attrgetter("misfit"), explaining)))
            equal = [judged for judged in explaining if judged.misfit <= EQUAL * best]
            sides = [other_side(case.mechanism, judged.matrices) for judged in equal]
            on_this_side = [j for j, side in zip(equal, sides, strict=True) if side <= 0.5]
            return on_this_side or ([] if case.as_measured.elsewhere > 0.5 else equal)
    return []


def _stages(case: Case) -> Iterator[list[Judged]]:
    """Yield hypotheses with their fits, the simplest first; a base nearly in place is none."""
    every, framed = list(faults(case)), case.few(_ROWS_FRAMED)
    setup = case.calibration.options.setup.anywhere(frame=True)
    framed = replace(framed, calibration=case.calibration.with_options(setup=setup))
    single = [hypothesis for hypothesis in every if hypothesis.faults == 1]
    if case.alone and (nominal := case.as_measured.nominal_readings) is not None:
        single += [scale(case, nominal), zeros(zeros_by_poses(case, nominal))]
    moved = case.alone and not case.as_measured.within(DIFFER)
    stage = _judged(case, single)
    if moved:
        stage += judge(framed, [replace(AS_MEASURED, code="unknown-frame")])
    yield stage
    if not case.alone:
        yield _zeros(case)
    yield _judged(case, (several for several in every if several.faults > 1))
    if moved:
        singly = (hypothesis for hypothesis in faults(framed) if hypothesis.faults == 1)
        yield _judged(framed, (replace(second, faults=2) for second in singly))


def _explains(judged: Judged, as_measured: Judged) -> bool:
    """Return whether a hypothesis reduces the misfit of the given measurements enough."""
    if not as_measured.placed and 2 * len(judged.questioned) >= len(judged.judged_legs):
        return False  # any alignment is better than none, so most legs must fit
    wrong_units = judged.hypothesis.values.get("units", ())
    shrinks = any((unit, written) == ("m", "mm") for _, unit, written in wrong_units)
    gap = max(as_measured.gap[as_measured.judged_legs], default=np.inf)
    if shrinks and (gap < 1.0 or judged.questioned):
        return False  # shrinking makes any misfit small, but lengths in mm miss by far
    most = as_measured.misfit / _EACH**judged.hypothesis.faults
    return judged.within(DIFFER) and judged.misfit <= most


def _judged(case: Case, hypotheses: Iterable[Hypothesis]) -> list[Judged]:
    """Return hypotheses with their fits; those by leg are restricted to the legs they improve."""
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
            misfits, before = (np.maximum(j.misfits, PRECISE) for j in (judged, case.as_measured))
            divided = misfits * _EACH <= before
            helped = [i for i in judged.judged_legs if divided[i]]
            if helped and len(helped) < len(every):
                stage += judge(case, [of_legs(judged.hypothesis, mechanism, helped)])
            if len(helped) < len(every):
                continue
        stage.append(judged)
    return stage


def _likely(case: Case, tried: Sequence[Hypothesis]) -> list[Judged]:
    """Return the fits of the hypotheses that fit the legs on a few rows."""
    on_few_rows = judge(case.few(_ROWS_FEW), tried)
    return judge(case, [few.hypothesis for few in on_few_rows if few.within(EQUAL * DIFFER)])


def _zeros(case: Case) -> list[Judged]:
    """Return the fits of an offset of each motor's zero, where poses do not determine it."""
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
        gaps = np.array([judged.gap for judged in judge(on_few_rows, tried)])
        costs = np.fmin(gaps, 1.0).mean(axis=1).reshape(grid.shape)  # 1 where nothing fits
        among = costs <= equal * costs.min(axis=0)
        best = (grid * among).sum(axis=0) / among.sum(axis=0)
        # the middle of all offsets that fit equally well
        reach, equal = 2 * reach / _CELLS, EQUAL
    offsets = enumerate(best[:, None] * axes)
    return _likely(case, [replace(zeros(offset), legs=(leg,)) for leg, offset in offsets])


def as_findings(case: Case, explaining: Sequence[Judged]) -> tuple[Finding, ...]:
    """Return the findings of hypotheses that explain measurements."""
    mechanism, as_measured = case.mechanism, case.as_measured
    names, reading_names = mechanism.leg_names, mechanism.reading_names
    named_legs, findings = as_measured.questioned or list(range(len(names))), []
    for judged in explaining:
        misfit, before = (
            max(PRECISE, float(j.misfits[named_legs].max())) for j in (judged, as_measured)
        )
        hypothesis, values = judged.hypothesis, dict[str, Any](judged.hypothesis.values)
        legs = hypothesis.legs or range(len(names))
        for key in values.keys() & {"offsets", "factors"}:  # those of its legs, with their names
            every = list(zip(reading_names, values[key], mechanism.reading_units, strict=True))
            values[key] = tuple(v for i in legs for v in every[mechanism.reading_columns[i]])
        values |= {
            "legs": tuple(names[i] for i in hypothesis.legs),
            "given": before if as_measured.placed else None,
            "left": misfit,
            "other_side": as_measured.elsewhere,
            "unknown_frame": judged.free and not as_measured.free,
        }
        findings.append(finding(hypothesis.code, **values))
    return tuple(findings)


def _strange(case: Case) -> tuple[Finding, ...]:
    """Return the findings that rule out a fit although no hypothesis explains the misfit."""
    as_measured = case.as_measured
    legs = [(i, case.mechanism.legs[i]) for i in as_measured.judged_legs]
    if not legs:
        return ()
    worst, leg = max(legs, key=lambda pair: as_measured.gap[pair[0]])
    if as_measured.gap[worst] > DIFFER:
        return (finding("not-this-mechanism", leg=leg.name, gap=float(as_measured.gap[worst])),)
    counts = np.stack((as_measured.bent, as_measured.row_counts), axis=1).astype(int).tolist()
    bent = tuple(
        (leg.name, tuple(leg.moving[j].name for j in leg.passive), *counts[i])
        for i, leg in legs
        if not as_measured.as_home[i]
    )
    if bent:
        return (finding("other-working-mode", legs=bent),)
    if turned := _turns(case):
        return turned
    for i, leg in legs:
        stroke = float(as_measured.stroke[i])
        most = max(_FOLLOWS * stroke, _STILL)
        if as_measured.gap[i] > most and (left := as_measured.near(i)) > most:  # ``near`` is slow
            return (finding("readings-do-not-follow", leg=leg.name, left=left, stroke=stroke),)
    return ()


def _still(case: Case) -> tuple[Finding, ...]:
    """Return the readings that are the same in all rows although the poses move their sensors."""
    mechanism, readings, as_measured = case.mechanism, case.readings, case.as_measured
    still = np.ptp(readings, axis=0) == 0.0
    if as_measured.free or not still.any() or as_measured.nominal_readings is None:
        return ()
    named = []
    for i, (leg, name) in enumerate(zip(mechanism.legs, mechanism.reading_names, strict=True)):
        nominal, unit = as_measured.nominal_readings[:, i], mechanism.reading_units[i]
        known = nominal[np.isfinite(nominal)]
        moved = float(np.ptp(known)) if len(known) > 1 else 0.0
        if still[i] and moved > _STILL * (1.0 if unit == "rad" else leg.size):
            named.append((name, float(readings[0, i]), unit, moved))
    return (finding("readings-still", readings=tuple(named)),) if named else ()


def _turns(case: Case) -> tuple[Finding, ...]:
    """Return the readings that are off by whole turns, for the first leg that has any."""
    mechanism, nominal = case.mechanism, case.as_measured.nominal_readings
    if nominal is None or any(len(leg.active) != 1 for leg in mechanism.legs):
        return ()
    for i, leg in enumerate(mechanism.legs):
        if leg.reading_units[0] != "rad":
            continue
        measured, law = case.readings[:, i], sensor_law(nominal_legs(mechanism)[i])
        position = law.position(measured[:, None])[:, 0] - leg.home[leg.active[0]]
        far = np.abs(position) > np.pi + _PAST  # beyond the wrap of encoders
        if not far.any():
            continue
        expected = nominal[:, i]
        gain, _ = leg.sensors[0].constants(leg.nominal_by_name)
        turn = 2 * np.pi * (abs(gain) if leg.sensors[0].form == "reading" else 1 / abs(gain))
        off = np.flatnonzero(far & (np.nan_to_num(np.round((measured - expected) / turn)) != 0.0))
        if len(off) and np.isfinite(measured - expected).sum() > 1:
            values = {"reading": measured[off[0]], "nominal": expected[off[0]]}
            return (finding("whole-turns", case.rows[off], leg=leg.name, **values),)
    return ()


def _slips(case: Case) -> tuple[Finding, ...]:
    """Return few rows, with full poses, that miss machines near nominal far more than others."""
    as_measured = case.as_measured
    if not case.oriented or not as_measured.judged_legs:
        return ()
    left = np.array([as_measured.remaining(leg) for leg in as_measured.judged_legs])
    usual = np.maximum(np.nanmedian(left, axis=1, keepdims=True), ROUNDING)
    times = np.nan_to_num(left / usual).max(axis=0)
    far = np.flatnonzero(times > _SLIP)
    if not 0 < len(far) <= max(1.0, len(times) / _SLIP):
        return ()
    worst = int(case.rows[np.argmax(times)])
    return (finding("bad-rows", case.rows[far], worst=worst, times=float(times.max())),)


def check_contacts(observation: Observation, data: Measurements) -> None:
    """Raise if a touched point has as many unknowns as its rows have equations."""
    for place, (name, columns, rows) in enumerate(observation.touches()):
        column, point, _ = observation.setup.touched[name]
        unknown, count = int(np.isinf(observation.external.sigmas[place]).sum()), int(rows.sum())
        if column != ROW and unknown and count * len(columns) <= unknown:
            row = f"{data.place(int(np.argmax(rows)))} alone touches" if count else "no row touches"
            raise MeasurementError(
                f"{row if count < 2 else f'{count} rows touch'} {column} {point!r}, whose place is "
                f"unknown, which tells nothing about the machine. Touch it in at least "
                f"{unknown // len(columns) + 1} poses, or leave it out"
            )


_MISTAKEN = {25.4: "inches", 10.0: "centimetres", 1e3: "metres"}
_MISTAKEN |= dict.fromkeys((1 / 25.4, 0.1, 1e-3), "millimetres")
"""Real unit of lengths that are too short by a factor: they were taken for mm, or are in mm."""
_ABOUT = 0.1  # relative tolerance on that factor


def check_distances(calibration: Calibration) -> None:
    """Raise if distances between rows fit the nominal machine only in another unit or sign.

    If more distances miss it, whatever the unit, their unit is not what is wrong.
    """
    observation, data = calibration.observation, calibration.measurements
    least = QUESTIONED * calibration.mechanism.size
    if not observation.setup.between_rows or not np.isfinite(data.readings).all():
        return
    solution = forward(calibration.mechanism, data.readings)
    matrices = calibration.mechanism.platform.matrices(solution.poses)
    nearest = observation.at_touch(matrices, observation.external.start)
    missed = observation.residuals(matrices, nearest)[0]
    for column in observation.setup.between_rows:
        kind, place = column.partition("_")[0], observation.names.index(column)
        measured = data.extra[column]
        nominal = missed[:, place] + measured
        clear = observation.measured[:, place] & (np.abs(nominal) > least)
        for factor in _MISTAKEN if kind == "distance" else (-1.0,):
            expected = factor * measured
            wrong = clear & (np.abs(nominal - expected) < _ABOUT * np.abs(expected))
            missing = clear & (np.abs(missed[:, place]) > least)
            if 2 * wrong.sum() > missing.sum():
                row = int(np.argmax(wrong))
                a, b = (data.contacts[name][row] for name in (f"{column}{TO}", ROW))
                lengths = [amount(float(values[row]), "m") for values in (measured, nominal)]
                question = f"{factor:.3g} times as much; is it in {_MISTAKEN.get(factor)}?"
                if kind != "distance":
                    question = (
                        f"the opposite; are its rows swapped? It is row {b}'s minus row {a}'s."
                    )
                raise MeasurementError(
                    f"the {kind} from row {a} to row {b} is {lengths[0]}, by the nominal machine "
                    f"{lengths[1]}, {question} Correct it, or the unit in the header"
                )
