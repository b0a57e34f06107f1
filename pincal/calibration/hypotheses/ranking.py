"""The rule: a hypothesis explains measurements if each fault put right leaves a third of misfit.

The misfit of a leg is what machines near the nominal one leave of its closure. Hypotheses that
leave as little as the best cannot be told from it; all of them are named.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from pincal.calibration.hypotheses.faults import (
    Hypothesis,
    offsets_of,
    several_units,
    single_faults,
    zeros,
)
from pincal.calibration.hypotheses.leg_fit import LegFit, leg_fit
from pincal.calibration.hypotheses.sample import Sample, placed
from pincal.estimation.observability.drawings import DIFFER
from pincal.finding import Finding
from pincal.kinematics.singularity import margins
from pincal.model.mechanism import Mechanism
from pincal.words.sentences import finding

Array = NDArray[np.float64]
_EACH = 3.0  # by which each fault that is put right divides the misfit
_EQUAL = 2.0  # times the misfit that the best leaves: cannot be told from it
_FEW, _GRID = 12, 12  # rows, and zeros of a motor that are tried, where the frame is unknown
_FRAMED = 40  # rows, where another frame is tried
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
    rows: NDArray[np.intp] | None = None
    """Their rows in the sample."""
    free: bool = False
    """Whether the base's place was aligned."""
    elsewhere: float = 0.0
    """Share of poses on the other side of a type-2 singularity than home, if it was asked."""

    @property
    def misfits(self) -> Array:
        """Of each leg with rows, 0 of the others, shape (n_legs,)."""
        return np.array([one.misfit if one.rows > 1 else 0.0 for one in self.fits])

    @property
    def misfit(self) -> float:
        """Mean over the legs that have rows; 1 where nothing fits, or on the other side."""
        judged = [one.misfit for one in self.fits if one.rows > 1]
        mean = float(np.mean(judged)) if judged else 1.0
        return max(mean, 1.0) if self.elsewhere > 0.5 else mean

    @property
    def questioned(self) -> list[int]:
        """Legs of which machines near nominal leave much of what was measured; all without fits."""
        return [i for i, one in enumerate(self.fits) if one.questioned]

    @property
    def plausible(self) -> bool:
        """Whether every leg fits such as a machine may that differs from its drawing."""
        return bool(self.fits) and bool((self.misfits <= DIFFER).all())


def judge(sample: Sample, hypothesis: Hypothesis = AS_MEASURED) -> Judged:
    """Return how measurements fit if a hypothesis is true, of all legs."""
    poses, readings = hypothesis.put_right(sample)
    right = replace(sample, poses=poses, readings=readings)
    found = placed(right)
    if found is None:
        return Judged(hypothesis, (), free=sample.free)
    matrices, rows = found
    mechanism = sample.mechanism
    fits = tuple(
        leg_fit(mechanism, i, matrices, readings[rows][:, own], free=sample.free)
        for i, own in enumerate(mechanism.reading_columns)
    )
    return Judged(hypothesis, fits, (), matrices, rows, sample.free)


def explanations(sample: Sample, given: Judged) -> list[Judged]:
    """Return the hypotheses that explain measurements, the simplest, as good as the best.

    Args:
        sample: The measurements.
        given: How they fit as they are.
    """
    for stage in _stages(sample, given):
        found = [one for one in stage if explains(one, given)]
        if found:
            best = min(one.misfit for one in found)
            equal = [one for one in found if one.misfit <= _EQUAL * best]
            here = [one for one in equal if other_side(sample.mechanism, one.matrices) <= 0.5]
            return here or ([] if given.elsewhere > 0.5 else equal)
    return []


def _stages(sample: Sample, given: Judged) -> Iterator[list[Judged]]:
    """Yield hypotheses with their fits, the simplest first.

    A base that stands near where it should is a change of parameters, and no hypothesis.
    """
    alone = sample.oriented and not sample.free  # legs can be judged one by one
    framed = replace(sample, free=True).part(np.arange(len(sample.rows))[:_FRAMED])
    single = _judged(sample, given, single_faults(sample))
    if alone and not given.plausible:
        single += _judged(framed, given, [replace(AS_MEASURED, code="unknown-frame")])
    yield single + (_zeros(sample, given) if alone else [])
    if not alone:
        yield _zeros(sample, given)
    yield _judged(sample, given, several_units(sample))
    if alone and not given.plausible:
        second = (replace(one, faults=one.faults + 1) for one in single_faults(framed))
        yield _judged(framed, given, second)


def explains(one: Judged, given: Judged) -> bool:
    """Return whether a hypothesis leaves little enough of the misfit of what was given."""
    if not given.fits and one.questioned:
        return False  # anything is better than nothing
    units = one.hypothesis.values.get("units", ())
    shrinks = any((unit, how) == ("m", "mm") for _, unit, how in units)
    gap = max((fit.gap for fit in given.fits if fit.rows > 1), default=np.inf)
    if shrinks and gap < 1.0:
        return False  # lengths too large miss by far, and shrinking makes any misfit small
    return one.plausible and one.misfit * _EACH**one.hypothesis.faults <= given.misfit


def _judged(sample: Sample, given: Judged, hypotheses: Iterable[Hypothesis]) -> list[Judged]:
    """Return hypotheses with their fits; those of single legs for the legs that they help."""
    return [
        one
        for hypothesis in hypotheses
        for one in (
            _by_leg(sample, given, hypothesis) if hypothesis.by_leg else [judge(sample, hypothesis)]
        )
    ]


def _by_leg(sample: Sample, given: Judged, hypothesis: Hypothesis) -> list[Judged]:
    """Return a hypothesis for the legs' readings that it puts right."""
    every = range(len(sample.mechanism.legs))
    if sample.free or not sample.oriented:  # the frame depends on all
        return [judge(sample, hypothesis)] + [
            replace(judge(sample, _of_leg(sample.mechanism, hypothesis, i)), legs=(i,))
            for i in (every if len(every) > 1 else ())
        ]
    found = judge(sample, hypothesis)
    rows = [i for i in every if found.fits[i].rows > 1]
    helped = [i for i in rows if found.fits[i].misfit * _EACH <= given.fits[i].misfit]
    fits = tuple(found.fits[i] if i in helped else given.fits[i] for i in every)
    return [replace(found, fits=fits, legs=() if helped == list(every) else tuple(helped))]


def _of_leg(mechanism: Mechanism, hypothesis: Hypothesis, leg: int) -> Hypothesis:
    """Return a hypothesis as of the readings of one leg only."""
    own = mechanism.reading_columns[leg]

    def right(sample: Sample) -> tuple[Array, Array]:
        poses, changed = hypothesis.put_right(sample)
        readings = sample.readings.copy()
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
    few = sample.part(np.linspace(0, len(sample.rows) - 1, _FEW).astype(int))
    found = []
    for index, leg in enumerate(mechanism.legs):
        far = np.pi if leg.reading_units[0] == "rad" else leg.size / 2
        unit = np.eye(len(mechanism.legs))[index]

        def cost(off: float, unit: Array = unit) -> float:
            return judge(few, zeros(off * unit)).misfit

        grid = np.linspace(-far, far, _GRID + 1)[1:]
        best = grid[int(np.argmin([cost(off) for off in grid]))]
        cell = 2 * far / _GRID
        near = minimize_scalar(cost, bounds=(best - cell, best + cell), options={"maxiter": 8})
        one = judge(sample, replace(zeros(near.x * unit), by_leg=False))
        found.append(replace(one, legs=(index,)))
    return found


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
    """Return the values of a hypothesis; offsets of the legs that it concerns, with names."""
    values = dict(one.hypothesis.values)
    if "offsets" in values:
        names, units = mechanism.reading_names, mechanism.reading_units
        every = list(zip(names, values["offsets"], units, strict=True))
        legs = one.legs or range(len(mechanism.legs))
        values["offsets"] = tuple(v for i in legs for v in every[mechanism.reading_columns[i]])
    return values
