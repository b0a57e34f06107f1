"""The rule: a hypothesis explains measurements if each fault put right leaves a third of misfit.

The misfit of a leg is what machines near the nominal one leave of its closure. Hypotheses that
leave as little as the best cannot be separated from it; all of them are named.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pincal.calibration.hypotheses.faults import (
    Hypothesis,
    factors_of,
    offsets_of,
    scales,
    several_units,
    single_faults,
    zeros,
)
from pincal.calibration.hypotheses.sample import (
    RULE,
    LegFit,
    LegMeasurements,
    Sample,
    leg_fits,
    placed,
)
from pincal.estimation.observability.indices import DIFFER
from pincal.finding import Finding
from pincal.kinematics.singularity import margins
from pincal.model.mechanism import Mechanism
from pincal.types import Array, Index
from pincal.words.sentences import finding

AS_MEASURED = Hypothesis("nothing", lambda sample: (sample.poses, sample.readings))


@dataclass(frozen=True)
class Judged:
    """A hypothesis and how the measurements, put right, fit the legs."""

    hypothesis: Hypothesis
    fits: tuple[LegFit, ...]
    """Of each leg; empty if readings and measurements cannot be brought together."""
    legs: tuple[int, ...] = ()
    """Legs whose readings it concerns, if not all."""
    matrices: Array | None = None
    """Poses put right, in the nominal machine's frame, shape (N, 4, 4)."""
    rows: Index | None = None
    """Their rows in the sample."""
    free: bool = False
    """Whether the base's place was aligned."""
    elsewhere: float = 0.0
    """Share of poses on the other side of a type-2 singularity than home, if it was asked."""

    @property
    def misfits(self) -> Array:
        """Of each leg with rows, 0 of the others, shape (n_legs,)."""
        return np.array([leg_fit.misfit if leg_fit.rows > 1 else 0.0 for leg_fit in self.fits])

    @property
    def misfit(self) -> float:
        """Mean over the legs that have rows; 1 where nothing fits, or on the other side."""
        judged = [leg_fit.misfit for leg_fit in self.fits if leg_fit.rows > 1]
        mean = float(np.mean(judged)) if judged else 1.0
        return max(mean, 1.0) if self.elsewhere > 0.5 else mean

    @property
    def near(self) -> bool:
        """Whether a few rows fit so that all may be plausible."""
        return bool(self.fits) and bool((self.misfits <= RULE.equal * DIFFER).all())

    @property
    def questioned(self) -> list[int]:
        """Legs of which machines near nominal leave much of what was measured; all without fits."""
        return [i for i, fit in enumerate(self.fits) if fit.questioned]

    @property
    def plausible(self) -> bool:
        """Whether every leg fits such as a machine may that differs from its drawing."""
        return bool(self.fits) and bool((self.misfits <= DIFFER).all())


def judge(sample: Sample, hypotheses: Sequence[Hypothesis] = (AS_MEASURED,)) -> list[Judged]:
    """Return how measurements fit all legs if a hypothesis is true, of each hypothesis."""
    if not hypotheses:
        return []
    mechanism, right = sample.mechanism, []
    for hypothesis in hypotheses:
        poses, readings = hypothesis.put_right(sample)
        right.append(replace(sample, poses=poses, readings=readings))
    places = placed(right)
    parts = [
        (place[0], one.readings[place[1]])
        for one, place in zip(right, places, strict=True)
        if place is not None
    ]
    columns = mechanism.reading_columns
    rows = [
        LegMeasurements(i, T, psi[:, column])
        for T, psi in parts
        for i, column in enumerate(columns)
    ]
    every = leg_fits(mechanism, rows, free=sample.free)
    fits = (tuple(every[i : i + len(columns)]) for i in range(0, len(every), len(columns)))
    return [
        Judged(one, (), free=sample.free)
        if place is None
        else Judged(one, next(fits), (), *place, sample.free)
        for one, place in zip(hypotheses, places, strict=True)
    ]


def explanations(sample: Sample, given: Judged) -> list[Judged]:
    """Return the hypotheses that explain measurements, the simplest, as good as the best.

    Args:
        sample: The measurements.
        given: How they fit as they are.
    """
    for stage in _stages(sample, given):
        found = [judged for judged in stage if explains(judged, given)]
        if found:
            best = min(one.misfit for one in found)
            equal = [one for one in found if one.misfit <= RULE.equal * best]
            here = [
                judged for judged in equal if other_side(sample.mechanism, judged.matrices) <= 0.5
            ]
            return here or ([] if given.elsewhere > 0.5 else equal)
    return []


def _stages(sample: Sample, given: Judged) -> Iterator[list[Judged]]:
    """Yield hypotheses with their fits, the simplest first.

    A base that is near where it should be is a change of parameters, and no hypothesis.
    """
    alone = sample.oriented and not sample.free  # legs can be judged one by one
    framed = replace(sample, free=True).part(np.arange(len(sample.rows))[: RULE.rows_framed])
    single = _judged(sample, given, single_faults(sample))
    if alone and not given.plausible:
        single += _judged(framed, given, [replace(AS_MEASURED, code="unknown-frame")])
    scaled = _judged(sample, given, _scales(sample, given))
    yield single + scaled + (_zeros(sample, given) if alone else [])
    if not alone:
        yield _zeros(sample, given)
    yield _judged(sample, given, several_units(sample))
    if alone and not given.plausible:
        second = (
            replace(hypothesis, faults=hypothesis.faults + 1)
            for hypothesis in single_faults(framed)
        )
        yield _judged(framed, given, second)


def explains(one: Judged, given: Judged) -> bool:
    """Return whether a hypothesis leaves little enough of the misfit of what was given."""
    if not given.fits and one.questioned:
        return False  # anything is better than nothing
    units = one.hypothesis.values.get("units", ())
    shrinks = any((unit, how) == ("m", "mm") for _, unit, how in units)
    gap = max((fit.gap for fit in given.fits if fit.rows > 1), default=np.inf)
    if shrinks and (gap < 1.0 or one.questioned):
        return False  # lengths too large miss by far, and shrinking makes any misfit small
    return one.plausible and one.misfit * RULE.each**one.hypothesis.faults <= given.misfit


def _judged(sample: Sample, given: Judged, hypotheses: Iterable[Hypothesis]) -> list[Judged]:
    """Return hypotheses with their fits; those of single legs for the legs that they help."""
    every, hypotheses = range(len(sample.mechanism.legs)), list(hypotheses)
    if sample.oriented and not sample.free:
        found = judge(sample, hypotheses)
        return [
            _helped(sample.mechanism, one, given) if one.hypothesis.by_leg else one for one in found
        ]
    tried: list[tuple[Hypothesis, tuple[int, ...]]] = []
    for hypothesis in hypotheses:  # the frame depends on all legs
        single = every if hypothesis.by_leg and len(every) > 1 else ()
        tried += [
            (hypothesis, ()),
            *((_of_legs(sample.mechanism, hypothesis, [i]), (i,)) for i in single),
        ]
    return _likely(sample, tried)


def _likely(sample: Sample, tried: Sequence[tuple[Hypothesis, tuple[int, ...]]]) -> list[Judged]:
    """Return hypotheses, each with the legs that it concerns, of which a few rows fit the legs."""
    few = judge(_few(sample), [one for one, _ in tried])
    likely = [pair for pair, one in zip(tried, few, strict=True) if one.near]
    found = judge(sample, [one for one, _ in likely])
    return [replace(one, legs=legs) for one, (_, legs) in zip(found, likely, strict=True)]


def _few(sample: Sample) -> Sample:
    """Return a few of the rows, where the frame is unknown."""
    count = len(sample.rows)
    return sample.part(np.linspace(0, count - 1, min(RULE.rows_zeros, count)).astype(int))


def _helped(mechanism: Mechanism, found: Judged, given: Judged) -> Judged:
    """Return a hypothesis for those legs only whose readings it puts right."""
    every = range(len(found.fits))
    rows = [i for i in every if found.fits[i].rows > 1]
    helped = [i for i in rows if found.fits[i].misfit * RULE.each <= given.fits[i].misfit]
    fits = tuple(found.fits[i] if i in helped else given.fits[i] for i in every)
    if helped == list(every):
        return replace(found, fits=fits, legs=())
    hypothesis = _of_legs(mechanism, found.hypothesis, helped)
    return replace(found, hypothesis=hypothesis, fits=fits, legs=tuple(helped))


def _of_legs(mechanism: Mechanism, hypothesis: Hypothesis, legs: Sequence[int]) -> Hypothesis:
    """Return a hypothesis as of the readings of some legs only."""

    def right(sample: Sample) -> tuple[Array, Array]:
        poses, changed = hypothesis.put_right(sample)
        readings = sample.readings.copy()
        for own in (mechanism.reading_columns[i] for i in legs):
            readings[:, own] = changed[:, own]
        return poses, readings

    return replace(hypothesis, right=right)


def _zeros(sample: Sample, given: Judged) -> list[Judged]:
    """Return that motors' zeros are off by constants."""
    mechanism = sample.mechanism
    if mechanism.by_readings:
        return []
    if given.matrices is not None and not sample.free and sample.oriented:
        return _judged(sample, given, [zeros(offsets_of(sample, given.matrices))])
    few, units = _few(sample), np.eye(len(mechanism.legs))
    far = [np.pi if leg.reading_units[0] == "rad" else leg.size / 2 for leg in mechanism.legs]
    best, reach, equal = np.zeros(len(units)), np.array(far), 1.0
    for _ in range(RULE.times):
        grid = best + np.linspace(-1, 1, RULE.zeros + 1)[1:, None] * reach
        tried = [zeros(off * unit) for offs in grid for off, unit in zip(offs, units, strict=True)]
        costs = np.reshape([judged.misfit for judged in judge(few, tried)], grid.shape)
        among = costs <= equal * costs.min(axis=0)
        best = (grid * among).sum(axis=0) / among.sum(axis=0)
        reach, equal = (
            2 * reach / RULE.zeros,
            RULE.equal,
        )  # where no measurement says more, the middle
    offsets = [replace(zeros(offsets), by_leg=False) for offsets in best[:, None] * units]
    return _likely(sample, [(offset, (index,)) for index, offset in enumerate(offsets)])


def _scales(sample: Sample, given: Judged) -> list[Hypothesis]:
    """Return that readings have another scale than their header says, such as counts."""
    if sample.mechanism.by_readings:
        return []
    if given.matrices is not None and not sample.free and sample.oriented:
        return [scales(factors_of(sample, given.matrices))]
    count = len(sample.mechanism.reading_names)
    return [scales(np.full(count, factor)) for factor in RULE.scales]


def other_side(mechanism: Mechanism, matrices: Array | None) -> float:
    """Return the share of poses on the other side of a type-2 singularity than home."""
    if mechanism.by_readings or matrices is None:
        return 0.0
    return float(
        (margins(mechanism, mechanism.platform.from_matrices(matrices)).type2 < 0.0).mean()
    )


def as_findings(
    mechanism: Mechanism, given: Judged, found: Sequence[Judged]
) -> tuple[Finding, ...]:
    """Return hypotheses that explain measurements as findings."""
    names = mechanism.leg_names
    asked = given.questioned or list(range(len(names)))
    common: dict[str, Any] = {
        "other_side": given.elsewhere,
        "questioned": tuple(names[i] for i in asked),
        "given": float(given.misfits[asked].max()) if given.fits else None,
    }
    return tuple(
        finding(
            one.hypothesis.code,
            **common,
            **_values(mechanism, one),
            legs=tuple(names[i] for i in one.legs),
            left=float(one.misfits[asked].max()),
            unknown_frame=one.free and not given.free,
        )
        for one in found
    )


def _values(mechanism: Mechanism, one: Judged) -> Mapping[str, Any]:
    """Return the values of a hypothesis; numbers of the legs that it concerns, with names."""
    values = dict(one.hypothesis.values)
    names, units = mechanism.reading_names, mechanism.reading_units
    legs = one.legs or range(len(mechanism.legs))
    for key in values.keys() & {"offsets", "factors"}:
        every = list(zip(names, values[key], units, strict=True))
        values[key] = tuple(v for i in legs for v in every[mechanism.reading_columns[i]])
    return values
