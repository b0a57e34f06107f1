"""What a model lacks: all terms that there may be, each tried against residuals without a fit.

A term is a parameter at zero, and its score test is its column: with M the projection on what the
fit does not take up and W the white rows of the amplitudes, the share of χ² that lies in M W is,
if the machine has no such term, one like any other (C. R. Rao 1948; an F test, since the scale
of the rest is taken from the residuals). One step gives the amplitudes: a = −(Wᵀ M W)⁻¹ Wᵀ M r.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pincal.calibration.calibration import Calibration
from pincal.calibration.fits import Fits
from pincal.calibration.terms.candidates import with_columns, with_terms
from pincal.calibration.terms.kinds import GROWTH, Kind, Pair
from pincal.estimation.fit import Fit
from pincal.estimation.observability.residuals import Amplitudes, Residuals
from pincal.estimation.system import CLEAR, FALSE_ALARM
from pincal.estimation.unknowns import State
from pincal.types import Array, Index


@dataclass(frozen=True)
class Candidate(Amplitudes):
    """One kind of term in one place, and what residuals say of it, once they were asked."""

    reading: str
    """The place: a reading, a length or angle by its id, or ``"growth"`` of all lengths;
    ``"readings"``, or a name, of all such, each with its own amplitudes."""
    kind: Kind
    unit: str
    """Of the amplitudes."""
    names: tuple[str, ...]
    """Ids of the amplitudes."""
    share: float = 0.0
    """Share of χ² that the term would take off."""
    corrected: float = 1.0
    """Its probability by chance with the number of tests taken in (Holm 1979)."""
    or_else: tuple[Pair, ...] = ()
    """What else it may be: places and kinds that these rows cannot separate from it. Said of the
    first, and of those that are improbable by chance."""
    rows: Array = field(default_factory=lambda: np.zeros((0, 0, 0)), repr=False)
    """White rows of the amplitudes, by which it would show in a fit, shape (n_used, m, k)."""

    @property
    def pair(self) -> Pair:
        """Place and kind, by which a candidate is known."""
        return self.reading, self.kind


def screen(fits: Fits, pairs: Sequence[Pair]) -> list[Candidate]:
    """Return what readings, lengths and angles may lack, the most improbable by chance first."""
    return screened(trials(fits, pairs))


def screened(parts: Sequence[tuple[Residuals, Sequence[Candidate]]]) -> list[Candidate]:
    """Return what residuals say of the terms that are tried on them."""
    tried = [
        (_asked(residuals, candidate), residuals)
        for residuals, candidates_of_part in parts
        for candidate in candidates_of_part
    ]
    tried.sort(key=lambda entry: (entry[0].p_value, -entry[0].share))
    ranked = np.array([candidate.rank > 0 for candidate, _ in tried], dtype=bool)
    times = np.count_nonzero(ranked) - np.arange(len(tried))
    chances = np.clip(times * [candidate.p_value for candidate, _ in tried], 0.0, 1.0)
    chances = np.where(ranked, np.maximum.accumulate(chances), 1.0)  # Holm 1979
    candidates = [
        replace(candidate, corrected=chance)
        for (candidate, _), chance in zip(tried, chances.tolist(), strict=True)
    ]
    for index, (candidate, (_, residuals)) in enumerate(zip(candidates, tried, strict=True)):
        if index and candidate.corrected >= FALSE_ALARM:
            break
        rivals = [rival for rival, of_rival in tried[index + 1 :] if of_rival is residuals]
        dof = max(residuals.degrees_of_freedom - candidate.rank, 1)
        variance = (1.0 - candidate.share) * residuals.chi2 / dof  # of what is left, as in F tests
        alike = inseparable(candidate, rivals, residuals.chi2 / max(variance, 1e-300))
        without = residuals.without(candidate.rows) if alike else residuals
        rescreened = [_asked(without, rival) for rival in alike]
        gone = [rival.pair for rival in rescreened if rival.rank * (rival.F - 1.0) < CLEAR**2]
        candidates[index] = replace(candidate, or_else=tuple(gone))
    return candidates


def _asked(residuals: Residuals, candidate: Candidate) -> Candidate:
    """Return a candidate with what residuals say of it."""
    answer = residuals.amplitudes(candidate.rows)
    share = float(answer.inside / max(residuals.chi2, 1e-300))
    return replace(candidate, share=share, **vars(answer))


def trials(fits: Fits, pairs: Sequence[Pair]) -> list[tuple[Residuals, list[Candidate]]]:
    """Return residuals of fits, and the terms that may be tried on them; see ``screen``."""
    calibration = fits.calibration
    data = with_columns(calibration, [kind for _, kind in pairs])
    mechanism, ids = with_terms(calibration.mechanism, data, pairs)
    extended = Calibration(mechanism, data, calibration.options, known_noise=calibration.noise)
    return [_trials_of(fit, extended, ids) for fit in fits.fits]


def _trials_of(
    fit: Fit, extended: Calibration, ids: Mapping[Pair, tuple[str, ...]]
) -> tuple[Residuals, list[Candidate]]:
    """Return residuals of a fit without terms, and the terms, by ids, that may be tried on them."""
    residuals, parameters = Residuals.of(fit), extended.mechanism.parameters
    names, W = _columns(extended, fit, residuals.used)
    by_amplitudes: dict[tuple[str, ...], Candidate] = {}  # not of several places where one has it
    for (reading, kind), amplitudes in ids.items():
        places = [names.index(name) for name in amplitudes if name in names]
        in_fit = len(places) == len(amplitudes) or reading == GROWTH
        units = {parameters[name].unit for name in amplitudes}
        if not places or not in_fit or len(units) > 1 or amplitudes in by_amplitudes:
            continue
        rows, shown = W[:, :, places], amplitudes
        if reading == GROWTH:  # one amplitude of all legs
            rows, shown = rows.sum(axis=2, keepdims=True), amplitudes[:1]
        none = np.zeros(len(shown)), np.full(len(shown), np.inf), 0.0, 0, 0.0, 1.0
        by_amplitudes[amplitudes] = Candidate(*none, reading, kind, units.pop(), shown, rows=rows)
    return residuals, list(by_amplitudes.values())


def inseparable(candidate: Candidate, rivals: Sequence[Candidate], chi2: float) -> list[Candidate]:
    """Return the rivals that take off as much as a candidate, of χ² over the variance left.

    They are of its kind, elsewhere; or another function of the same reading, such as a polynomial
    for harmonics, whose χ² counts less two for each amplitude (Akaike 1974).
    """
    alike = []
    for rival in rivals:
        same = (rival.kind, rival.rank) == (candidate.kind, candidate.rank)
        curves = bool(candidate.kind.numbers and rival.kind.numbers and rival.rank)
        behind = (candidate.share - rival.share) * chi2 - 2 * (candidate.rank - rival.rank)
        if (same or (curves and rival.reading == candidate.reading)) and behind < CLEAR**2:
            alike.append(rival)
    return alike


def _columns(extended: Calibration, fit: Fit, used: Index) -> tuple[list[str], Array]:
    """Return the ids of all legs' parameters, terms included, and their white rows of rows used."""
    before, state = fit.problem.leg_block, fit.last.state
    places = [extended.mechanism.leg_names.index(leg.name) for leg in before.legs]
    legs = extended.leg_block(places, fit.rows, before.used, before.pose_roots)
    legs = replace(legs, sigma=before.sigma)
    names = [name for leg in legs.legs for name in leg.parameter_ids]
    values: list[Array] = []
    for leg, columns in zip(legs.legs, before.columns, strict=True):
        fitted = fit.parameters[columns]
        values += [fitted, np.zeros(len(leg.parameters) - len(fitted))]
    state = State(np.concatenate(values), state.matrices, state.joints, state.external)
    problem = replace(fit.problem, leg_block=legs, first=None)
    return names, problem.evaluate(state).jacobian[used]
