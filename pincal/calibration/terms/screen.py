"""What a model lacks: all terms that there may be, each tried against residuals without a fit.

A term is a parameter at zero, and its score test is its column: with M the projection on what the
fit does not take up and W the white rows of the amplitudes, the share of χ² that lies in M W is,
if the machine has no such term, one like any other (C. R. Rao 1948; an F test, since the scale
of the rest is taken from the residuals). One step gives the amplitudes: a = −(Wᵀ M W)⁻¹ Wᵀ M r.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pincal.calibration.calibration import Calibration
from pincal.calibration.fits import Fits
from pincal.calibration.terms.candidates import with_columns, with_terms
from pincal.calibration.terms.kinds import GROWTH, ORDER, Kind
from pincal.estimation.fit import Fit
from pincal.estimation.observability.residuals import Residuals
from pincal.estimation.system import CLEAR, FALSE_ALARM
from pincal.estimation.unknowns import State
from pincal.types import Array, Index


@dataclass(frozen=True)
class Candidate:
    """One kind of term in one place, and what residuals say of it."""

    reading: str
    """The place: a reading, a length or angle by its id, or ``"growth"`` of all lengths;
    ``"readings"``, or a name, of all such, each with its own amplitudes."""
    kind: Kind
    unit: str
    """Of the amplitudes."""
    names: tuple[str, ...]
    """Ids of the amplitudes."""
    amplitudes: Array
    """As one step finds them, shape (k,)."""
    std: Array
    """Standard errors, shape (k,); infinite where geometry takes the term up."""
    F: float
    """χ² in the term by its degrees of freedom, over that of the rest."""
    rank: int
    """Degrees of freedom; 0 where geometry takes up all of it."""
    share: float
    """Share of χ² that the term would take off."""
    p_value: float
    """Probability of so large an F by chance, for this test alone."""
    corrected: float
    """The same with the number of tests (Holm 1979)."""
    or_else: tuple[tuple[str, Kind], ...] = ()
    """What else it may be: places and kinds that these rows cannot separate from it. Said of the
    first, and of those that are improbable by chance."""

    @property
    def pair(self) -> tuple[str, Kind]:
        """Place and kind, by which a candidate is known."""
        return self.reading, self.kind


@dataclass(frozen=True)
class Trial:
    """A kind of term in one place, and how it would show in the white rows of a fit."""

    reading: str
    kind: Kind
    unit: str
    names: tuple[str, ...]
    """Ids of the amplitudes."""
    rows: Array
    """White rows of the amplitudes, shape (n_used, m, k)."""


def screen(found: Fits, pairs: Sequence[tuple[str, Kind]]) -> list[Candidate]:
    """Return what readings and parameters may lack, the most improbable by chance first.

    Args:
        found: The fits whose residuals are looked at.
        pairs: Readings, lengths and angles, and kinds of term that they may lack.
    """
    return screened(trials(found, pairs))


def screened(parts: Sequence[tuple[Residuals, Sequence[Trial]]]) -> list[Candidate]:
    """Return what residuals say of the terms that are tried on them."""
    tried = [
        (part, _candidate(residuals, term), term.rows)
        for part, (residuals, terms) in enumerate(parts)
        for term in terms
    ]
    tried.sort(key=lambda one: (one[1].p_value, -one[1].share))
    found = _corrected([candidate for _, candidate, _ in tried])
    for index, one in enumerate(found):
        if index and one.corrected >= FALSE_ALARM:
            break
        part, _, rows = tried[index]
        residuals = parts[part][0]
        others = {other.pair: (other, W) for own, other, W in tried[index + 1 :] if own == part}
        rest = (1.0 - one.share) * residuals.chi2 / max(residuals.degrees_of_freedom - one.rank, 1)
        chi2 = residuals.chi2 / max(rest, 1e-300)  # by what is left, as F tests have it
        alike = inseparable(one, [other for other, _ in others.values()], chi2)
        left = residuals.without(rows) if alike else residuals
        gone = [other.pair for other in alike if not _clear(left, others[other.pair][1])]
        found[index] = replace(one, or_else=tuple(gone))
    return found


def _candidate(residuals: Residuals, one: Trial) -> Candidate:
    answer = residuals.amplitudes(one.rows)
    return Candidate(
        reading=one.reading,
        kind=one.kind,
        unit=one.unit,
        names=one.names,
        amplitudes=answer.values,
        std=answer.std,
        F=answer.F,
        rank=answer.rank,
        share=float(answer.inside / max(residuals.chi2, 1e-300)),
        p_value=answer.p_value,
        corrected=1.0,
    )


def _clear(residuals: Residuals, rows: Array) -> bool:
    """Return whether a term is still there."""
    answer = residuals.amplitudes(rows)
    return answer.rank * (answer.F - 1.0) >= CLEAR**2


def trials(found: Fits, pairs: Sequence[tuple[str, Kind]]) -> list[tuple[Residuals, list[Trial]]]:
    """Return residuals of fits, and the terms that may be tried on them; see ``screen``."""
    calibration = found.calibration
    kinds = [kind for _, kind in pairs]
    data = with_columns(calibration, kinds)
    order = {ORDER: np.linspace(-1.0, 1.0, len(data))}
    data = replace(data, influences={**order, **data.influences})
    mechanism, ids = with_terms(calibration.mechanism, data, pairs)
    asked = Calibration(mechanism, data, calibration.options, known_noise=calibration.noise)
    units = {parameter.id: parameter.unit for parameter in mechanism.parameters}
    parts = []
    for fit in found.fits:
        if not fit.problem.weighted:
            continue
        residuals, terms = Residuals.of(fit), list[Trial]()
        names, W = _columns(asked, fit, residuals.used)
        asked_for = set()
        for (reading, kind), own in ids.items():
            places = [names.index(name) for name in own if name in names]
            alike = len({units[name] for name in own}) == 1
            whole = alike and (len(places) == len(own) or reading == GROWTH)
            if places and whole and own not in asked_for:  # not of several places where one has it
                asked_for.add(own)
                by = W[:, :, places]
                if reading == GROWTH:  # one amplitude of all legs
                    by, own = by.sum(axis=2, keepdims=True), own[:1]
                terms.append(Trial(reading, kind, units[own[0]], own, by))
        parts.append((residuals, terms))
    return parts


def inseparable(one: Candidate, others: Sequence[Candidate], chi2: float) -> list[Candidate]:
    """Return those that take off as much as a candidate.

    They are of its kind, elsewhere; or another function of the same reading, such as a polynomial
    for harmonics, whose χ² counts less two for each amplitude (Akaike 1974).

    Args:
        one: The candidate.
        others: Among which they are.
        chi2: Of which shares are, in units of the variance that is left.
    """
    found = []
    for other in others:
        alike = (other.kind, other.rank) == (one.kind, one.rank)
        curves = bool(one.kind.numbers and other.kind.numbers and other.rank)
        more = (one.share - other.share) * chi2 - 2 * (one.rank - other.rank)
        if (alike or (curves and other.reading == one.reading)) and more < CLEAR**2:
            found.append(other)
    return found


def _corrected(tried: list[Candidate]) -> list[Candidate]:
    """Return candidates with probabilities that take the number of tests in (Holm 1979)."""
    count, largest, found = sum(one.rank > 0 for one in tried), 0.0, []
    for place, one in enumerate(tried):
        largest = max(largest, min(1.0, (count - place) * one.p_value)) if one.rank else 1.0
        found.append(replace(one, corrected=largest))
    return found


def _columns(asked: Calibration, fit: Fit, used: Index) -> tuple[list[str], Array]:
    """Return the ids of all legs' parameters, terms included, and their white rows.

    Args:
        asked: The calibration of the mechanism with all terms, at zero.
        fit: The fit without them.
        used: Rows of the fit that count.
    """
    before = fit.problem.leg_block
    places = [asked.mechanism.leg_names.index(leg.name) for leg in before.legs]
    legs = asked.leg_block(places, fit.rows, before.used, before.pose_roots)
    legs = replace(legs, sigma=before.sigma)
    names, values = [], []
    for leg, columns in zip(legs.legs, before.columns, strict=True):
        nominal = fit.parameters[columns]
        values += [nominal, np.zeros(len(leg.parameters) - len(nominal))]
        names += [f"{leg.name}.{name}" for name in leg.parameter_names]
    state = fit.last.state
    there = State(np.concatenate(values), state.matrices, state.joints, state.external)
    problem = replace(fit.problem, leg_block=legs, first=None)
    return names, problem.evaluate(there).jacobian[used]
