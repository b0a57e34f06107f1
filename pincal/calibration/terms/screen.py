"""Screen for terms that a model lacks: score tests on the residuals, without further fits.

A candidate term is a parameter at zero. With M the projection on the residual space of the fit and
W the whitened rows of its amplitudes, the share of χ² in the range of M W follows an F test if the
machine has no such term (C. R. Rao 1948). One step gives the amplitudes: a = −(Wᵀ M W)⁻¹ Wᵀ M r.

For an unknown period, sine and cosine are tried over a grid of rates, a periodogram (N. R. Lomb
1976, J. D. Scargle 1982) of the reading's error in the residual space. The p-value of its highest
peak accounts for all others (R. B. Davies 1987): p (1 + w √z), z half of χ² along it, w the rate
times the span of log rates, whose prior is uniform: of equally clear periods the longest is first.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np

from pincal.calibration.calibration import Calibration
from pincal.calibration.fits import Fits
from pincal.calibration.terms.candidates import with_columns, with_terms
from pincal.calibration.terms.kinds import GROWTH, PERIOD, Kind, Pair, parts_of
from pincal.estimation.fit import Fit
from pincal.estimation.observability.residuals import Amplitudes, Residuals
from pincal.estimation.system import CLEAR, FALSE_ALARM, holm
from pincal.estimation.unknowns import State
from pincal.types import Array, Index
from pincal.words.numbers import UNITS

_PERIODS = (2, 250)  # fewest and most periods in the travel of a reading
_FINE = 3  # rates of the grid in the width of a peak
_STEPS = 2  # Gauss–Newton steps from the grid to the peak
_BETWEEN = 0.9  # least share of a peak's height at the nearest rate of the grid
_ALIASES = 4  # most peaks that become candidates


@dataclass(frozen=True)
class Candidate(Amplitudes):
    """A kind of term in a place, and the result of its test on the residuals."""

    reading: str
    """Place: a reading, an id, or ``"growth"`` for all lengths; ``"readings"``, or a name, for
    several places, each with its own amplitudes."""
    kind: Kind
    unit: str
    """SI unit of the amplitudes."""
    names: tuple[str, ...]
    """Ids of the amplitudes."""
    share: float = 0.0
    """Share of χ² that the term would remove."""
    corrected: float = 1.0
    """P-value, corrected for the number of tests (Holm 1979)."""
    or_else: tuple[Pair, ...] = ()
    """Places and kinds that these rows cannot separate from it, if it is significant."""
    spread: float = 0.0
    """Standard error of its period, [m] or [rad], if that was searched for."""
    searched: float = 0.0
    """Span of the search for its period: w of the module's docstring."""
    rows: Array = field(default_factory=lambda: np.zeros((0, 0, 0)), repr=False)
    """Whitened Jacobian by the amplitudes, shape (n_used, m, k)."""

    @property
    def pair(self) -> Pair:
        """Place and kind, which identify a candidate."""
        return self.reading, self.kind


def screen(fits: Fits, pairs: Sequence[Pair]) -> list[Candidate]:
    """Return candidate terms of readings, lengths and angles, the most significant first."""
    return screened(trials(fits, pairs))


def screened(parts: Sequence[tuple[Residuals, Sequence[Candidate]]]) -> list[Candidate]:
    """Test candidate terms on their residuals; return them with results, in order."""
    tried = [
        (_asked(residuals, candidate), residuals)
        for residuals, candidates_of_part in parts
        for candidate in candidates_of_part
    ]
    tried.sort(key=lambda entry: (entry[0].p_value, -entry[0].share))
    ranked = np.array([candidate.rank > 0 for candidate, _ in tried], dtype=bool)
    p_values = np.array([candidate.p_value for candidate, _ in tried])
    chances = np.where(ranked, holm(p_values, int(ranked.sum())), 1.0)
    candidates = [
        replace(candidate, corrected=chance)
        for (candidate, _), chance in zip(tried, chances.tolist(), strict=True)
    ]
    for index, (candidate, (_, residuals)) in enumerate(zip(candidates, tried, strict=True)):
        if index and candidate.corrected >= FALSE_ALARM:
            break
        rivals = [rival for rival, of_rival in tried[index + 1 :] if of_rival is residuals]
        dof = max(residuals.degrees_of_freedom - candidate.rank, 1)
        variance = (1.0 - candidate.share) * residuals.chi2 / dof  # with the term, as in F tests
        alike = inseparable(candidate, rivals, residuals.chi2 / max(variance, 1e-300))
        without = residuals.without(candidate.rows) if alike else residuals
        rescreened = [_asked(without, rival) for rival in alike]
        gone = [rival.pair for rival in rescreened if rival.rank * (rival.F - 1.0) < CLEAR**2]
        candidates[index] = replace(candidate, or_else=tuple(gone))
    return candidates


def _asked(residuals: Residuals, candidate: Candidate) -> Candidate:
    answer = residuals.amplitudes(candidate.rows)
    share = float(answer.inside / max(residuals.chi2, 1e-300))
    periods = 1.0 + candidate.searched * np.sqrt(0.5 * answer.rank * answer.F)
    answer = replace(answer, p_value=min(1.0, float(periods * answer.p_value)))
    return replace(candidate, share=share, **vars(answer))


def trials(fits: Fits, pairs: Sequence[Pair]) -> list[tuple[Residuals, list[Candidate]]]:
    """Return the residuals of fits, each with the candidate terms to test on them."""
    calibration = fits.calibration
    data = with_columns(calibration, [kind for _, kind in pairs])
    mechanism, ids = with_terms(calibration.mechanism, data, pairs)
    extended = Calibration(mechanism, data, calibration.options, known_noise=calibration.noise)
    return [_trials_of(fit, extended, ids) for fit in fits.fits]


def _trials_of(
    fit: Fit, extended: Calibration, ids: Mapping[Pair, tuple[str, ...]]
) -> tuple[Residuals, list[Candidate]]:
    """Return the residuals of a fit, and the candidate terms, with amplitudes ``ids``, for them."""
    residuals, parameters = Residuals.of(fit), extended.mechanism.parameters
    names, W = _columns(extended, fit, residuals.used)
    by_amplitudes: dict[tuple[str, ...], list[Candidate]] = {}  # equal amplitudes are tested once
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
        candidate = Candidate(*none, reading, kind, units.pop(), shown, rows=rows)
        by_amplitudes[amplitudes] = [candidate]
        if kind == PERIOD:
            parts = parts_of(reading, extended.mechanism)
            columns = np.array([extended.mechanism.reading_names.index(part) for part in parts])
            values = extended.measurements.readings[np.ix_(fit.rows[residuals.used], columns)]
            by_amplitudes[amplitudes] = _periodic(candidate, residuals, np.nan_to_num(values))
    return residuals, list(chain.from_iterable(by_amplitudes.values()))


def _periodic(candidate: Candidate, residuals: Residuals, readings: Array) -> list[Candidate]:
    """Return candidates for the clearest period in errors of readings, and for equally clear ones.

    The candidate's rows, (n_used, m, k), are the effect of a constant error of each reading;
    readings, (n_used, k), have one unit.
    """
    E, x = candidate.rows, readings
    if not (travel := float(np.ptp(x, axis=0).max())):
        return []
    width = 2.0 * np.pi / travel / _FINE
    rates = width * np.arange(_FINE * _PERIODS[0], _FINE * _PERIODS[1])
    along, squares = (np.einsum("nmk,nmk->nk", E, of) for of in (residuals.left[..., None], E))
    waves = [wave(rates[:, None, None] * x) for wave in (np.sin, np.cos)]
    sizes = [np.maximum((wave**2 * squares).sum(axis=1), 1e-300) for wave in waves]
    powers = [(w * along).sum(axis=1) ** 2 / size for w, size in zip(waves, sizes, strict=True)]
    power = np.sum(powers, axis=(0, 2))  # as if parameters absorbed nothing of a sine
    higher = np.r_[True, power[1:] >= power[:-1]] & np.r_[power[:-1] > power[1:], True]
    variance = (residuals.chi2 - power.max()) / max(residuals.degrees_of_freedom, 1)
    odds = power / max(variance, 1e-300) - 2.0 * np.log(rates)
    clear = np.flatnonzero(higher & (odds > _BETWEEN * odds[higher].max() - CLEAR**2))
    spans = np.log(rates[-1] / rates[0]) * np.sqrt(x.var(axis=0).max() / np.pi)
    names = tuple(f"{id_}_{phase}" for id_ in candidate.names for phase in ("sine", "cosine"))
    unit, periods = {"m": "mm", "rad": "deg"}[candidate.unit], []
    for rate in rates[clear[np.argsort(-odds[clear])][:_ALIASES]].tolist():
        for _ in range(_STEPS):  # Gauss–Newton by the rate, whose column is x (aₛ cos − a꜀ sin)
            W = _waves(E, rate * x)
            a = residuals.amplitudes(W).values.reshape(-1, 2)
            turned = _waves(E * x[:, None], rate * x) @ np.c_[-a[:, 1], a[:, 0]].ravel()
            step = residuals.amplitudes(np.dstack((W, turned)))
            rate += float(np.clip(step.values[-1], -0.5 * width, 0.5 * width))
        std = float(step.std[-1])
        digits = int(np.clip(np.log10(rate / min(std, rate)) + 2.0, 3.0, 12.0))
        kind = Kind.of(f"{PERIOD}:{2.0 * np.pi / rate / UNITS[unit][1]:.{digits}g}{unit}")
        rows, spread = _waves(E, 2.0 * np.pi / kind.numbers[0] * x), 2.0 * np.pi * std / rate**2
        named = replace(candidate, kind=kind, names=names, rows=rows)
        periods.append(replace(named, spread=spread, searched=float(rate * spans)))
    return periods


def _waves(errors: Array, angles: Array) -> Array:
    """Return errors, (N, m, k), times sine and cosine of angles, (N, k), as (N, m, 2 k)."""
    waves = errors[..., None] * np.stack((np.sin(angles), np.cos(angles)), axis=2)[:, None]
    return waves.reshape(*errors.shape[:2], -1)


def inseparable(candidate: Candidate, rivals: Sequence[Candidate], chi2: float) -> list[Candidate]:
    """Return the rivals that remove as much as a candidate of ``chi2``, over the variance left.

    They are of the same kind in another place, or other functions of the same reading, such as a
    polynomial for harmonics; then two are subtracted from χ² per amplitude (Akaike 1974).
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
    """Return the ids of all legs' parameters with terms, and the whitened Jacobian of used rows."""
    before, state = fit.problem.leg_block, fit.last.state
    places = [extended.mechanism.leg_names.index(leg.name) for leg in before.legs]
    legs = extended.leg_block(places, fit.rows, before.used, before.pose_roots)
    legs = replace(legs, sigma=before.sigma)
    names = [name for leg in legs.legs for name in leg.parameter_ids]
    values: list[Array] = []
    for leg, columns in zip(legs.legs, before.columns, strict=True):
        fitted = fit.parameters[columns]
        values += [fitted, np.zeros(len(leg.parameters) - len(fitted))]
    over_pulleys = [leg.joints for leg in legs.legs] != [leg.joints for leg in before.legs]
    joints = () if over_pulleys else state.joints
    state = State(np.concatenate(values), state.matrices, joints, state.external)
    problem = replace(fit.problem, leg_block=legs, first=None)
    return names, problem.evaluate(state).jacobian[used]
