"""What a model lacks: all terms that there may be, each tried against residuals without a fit.

A term is a parameter at zero, and its score test is its column: with M the projection on what the
fit does not take up and W the white rows of the amplitudes, the share of χ² that lies in M W is,
if the machine has no such term, one like any other (C. R. Rao 1948; an F test, since the scale
of the rest is taken from the residuals). One step gives the amplitudes: a = −(Wᵀ M W)⁻¹ Wᵀ M r.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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


def screen(fits: Fits, pairs: Sequence[tuple[str, Kind]]) -> list[Candidate]:
    """Return what readings and parameters may lack, the most improbable by chance first.

    Args:
        fits: The fits whose residuals are looked at.
        pairs: Readings, lengths and angles, and kinds of term that they may lack.
    """
    return screened(trials(fits, pairs))


def screened(parts: Sequence[tuple[Residuals, Sequence[Trial]]]) -> list[Candidate]:
    """Return what residuals say of the terms that are tried on them."""
    tried = [
        (_candidate(residuals, trial), residuals, trial.rows)
        for residuals, trials_of_part in parts
        for trial in trials_of_part
    ]
    tried.sort(key=lambda entry: (entry[0].p_value, -entry[0].share))
    candidates = _corrected([candidate for candidate, _, _ in tried])
    for index, candidate in enumerate(candidates):
        if index and candidate.corrected >= FALSE_ALARM:
            break
        _, residuals, rows = tried[index]
        rivals = {
            rival.pair: (rival, rival_rows)
            for rival, of_rival, rival_rows in tried[index + 1 :]
            if of_rival is residuals
        }
        dof = max(residuals.degrees_of_freedom - candidate.rank, 1)
        variance = (1.0 - candidate.share) * residuals.chi2 / dof  # of what is left, as in F tests
        chi2 = residuals.chi2 / max(variance, 1e-300)
        alike = inseparable(candidate, [rival for rival, _ in rivals.values()], chi2)
        without = residuals.without(rows) if alike else residuals
        gone = [rival.pair for rival in alike if not _clear(without, rivals[rival.pair][1])]
        candidates[index] = replace(candidate, or_else=tuple(gone))
    return candidates


def _candidate(residuals: Residuals, trial: Trial) -> Candidate:
    answer = residuals.amplitudes(trial.rows)
    return Candidate(
        reading=trial.reading,
        kind=trial.kind,
        unit=trial.unit,
        names=trial.names,
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


def trials(fits: Fits, pairs: Sequence[tuple[str, Kind]]) -> list[tuple[Residuals, list[Trial]]]:
    """Return residuals of fits, and the terms that may be tried on them; see ``screen``."""
    calibration = fits.calibration
    data = with_columns(calibration, [kind for _, kind in pairs])
    order = {ORDER: np.linspace(-1.0, 1.0, len(data))}
    data = replace(data, influences={**order, **data.influences})
    mechanism, ids = with_terms(calibration.mechanism, data, pairs)
    extended = Calibration(mechanism, data, calibration.options, known_noise=calibration.noise)
    return [_trials_of(fit, extended, ids) for fit in fits.fits if fit.problem.weighted]


def _trials_of(
    fit: Fit, extended: Calibration, ids: Mapping[tuple[str, Kind], tuple[str, ...]]
) -> tuple[Residuals, list[Trial]]:
    """Return residuals of a fit, and the terms that may be tried on them.

    Args:
        fit: The fit, without the terms.
        extended: The calibration of the mechanism with all of them, at zero.
        ids: Of their amplitudes, by place and kind.
    """
    residuals, parameters = Residuals.of(fit), extended.mechanism.parameters
    names, W = _columns(extended, fit, residuals.used)
    by_amplitudes: dict[tuple[str, ...], Trial] = {}  # not of several places where one has it
    for (reading, kind), amplitudes in ids.items():
        places = [names.index(name) for name in amplitudes if name in names]
        in_fit = len(places) == len(amplitudes) or reading == GROWTH
        units = {parameters[name].unit for name in amplitudes}
        if not places or not in_fit or len(units) > 1 or amplitudes in by_amplitudes:
            continue
        rows, shown = W[:, :, places], amplitudes
        if reading == GROWTH:  # one amplitude of all legs
            rows, shown = rows.sum(axis=2, keepdims=True), amplitudes[:1]
        by_amplitudes[amplitudes] = Trial(reading, kind, units.pop(), shown, rows)
    return residuals, list(by_amplitudes.values())


def inseparable(candidate: Candidate, rivals: Sequence[Candidate], chi2: float) -> list[Candidate]:
    """Return the rivals that take off as much as a candidate.

    They are of its kind, elsewhere; or another function of the same reading, such as a polynomial
    for harmonics, whose χ² counts less two for each amplitude (Akaike 1974).

    Args:
        candidate: The candidate.
        rivals: Among which they are.
        chi2: Of which shares are, in units of the variance that is left.
    """
    alike = []
    for rival in rivals:
        same = (rival.kind, rival.rank) == (candidate.kind, candidate.rank)
        curves = bool(candidate.kind.numbers and rival.kind.numbers and rival.rank)
        behind = (candidate.share - rival.share) * chi2 - 2 * (candidate.rank - rival.rank)
        if (same or (curves and rival.reading == candidate.reading)) and behind < CLEAR**2:
            alike.append(rival)
    return alike


def _corrected(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return candidates with probabilities that take the number of tests in (Holm 1979)."""
    count = sum(candidate.rank > 0 for candidate in candidates)
    largest, corrected = 0.0, []
    for place, candidate in enumerate(candidates):
        largest = max(largest, min(1.0, (count - place) * candidate.p_value))
        chance = largest if candidate.rank else 1.0
        corrected.append(replace(candidate, corrected=chance))
    return corrected


def _columns(extended: Calibration, fit: Fit, used: Index) -> tuple[list[str], Array]:
    """Return the ids of all legs' parameters, terms included, and their white rows of rows used."""
    before, state = fit.problem.leg_block, fit.last.state
    places = [extended.mechanism.leg_names.index(leg.name) for leg in before.legs]
    legs = extended.leg_block(places, fit.rows, before.used, before.pose_roots)
    legs = replace(legs, sigma=before.sigma)
    names, values = [], []
    for leg, columns in zip(legs.legs, before.columns, strict=True):
        fitted = fit.parameters[columns]
        values += [fitted, np.zeros(len(leg.parameters) - len(fitted))]
        names += [f"{leg.name}.{name}" for name in leg.parameter_names]
    state = State(np.concatenate(values), state.matrices, state.joints, state.external)
    problem = replace(fit.problem, leg_block=legs, first=None)
    return names, problem.evaluate(state).jacobian[used]
