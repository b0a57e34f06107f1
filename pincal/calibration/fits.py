"""The fits of a calibration: all legs at once, or each leg alone, with estimated variances.

Standard deviations of the noise that are not given are variance components, estimated in turn with
the fits.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pincal.calibration.calibration import Calibration
from pincal.errors import ObservabilityError
from pincal.estimation import components
from pincal.estimation.fit import Fit, robust_fit
from pincal.estimation.holding import checked, fit_holding, fit_strictly
from pincal.estimation.noise import assumed_noise
from pincal.estimation.observability.gauge import Gauge, find_gauge
from pincal.estimation.observability.identifiable import HeldUnknowns
from pincal.estimation.problem import Linear, Problem
from pincal.estimation.system import NEGLIGIBLE, System
from pincal.estimation.unknowns import External, State
from pincal.model import Leg, Noise
from pincal.types import Array, Index, Mask

ROUNDS = 20  # largest number of alternations of fits with the noise
_REFITS = 5  # largest number of fits with estimated noise
_AUXILIARY = 0.03  # distance [σ] at which fits end that only predict other rows, or are screened
SETTLED = 1e-3  # relative change of an estimated standard deviation that is negligible


@dataclass(frozen=True)
class Fits:
    """Fits that together identify all legs."""

    calibration: Calibration
    """The calibration, with the noise that was given or estimated."""
    fits: list[Fit]
    gauge: Gauge | None = None
    """Gauge freedoms."""
    held: HeldUnknowns | None = None
    """Directions that the measurements do not determine and that were held, if any."""
    variances: Array | None = None
    """Covariance of the groups' relative variances, if these were estimated, shape (g, g)."""

    @property
    def latent(self) -> bool:
        """Whether poses were unknowns."""
        return self.calibration.options.latent

    @property
    def external(self) -> External:
        """Values of the unknowns outside the mechanism."""
        return self.fits[0].last.state.external

    @property
    def degrees_of_freedom(self) -> int:
        """Degrees of freedom of all fits."""
        return sum(fit.degrees_of_freedom for fit in self.fits)

    @property
    def chi2(self) -> float:
        """χ² of all fits."""
        return sum(fit.chi2 for fit in self.fits)

    @property
    def converged(self) -> bool:
        """Whether all fits converged."""
        return all(fit.converged for fit in self.fits)

    @property
    def sound(self) -> bool:
        """Whether the residuals tell something about the noise."""
        return self.converged and all(fit.degrees_of_freedom > 0 for fit in self.fits)

    @property
    def noise(self) -> Noise:
        """Standard deviations of all rows, given or estimated."""
        return self.calibration.noise.noise

    @property
    def moments(self) -> components.Moments:
        """Moments of the residuals for the variances of groups, exact readings at assumed noise."""
        assumed = assumed_noise(self.calibration.mechanism, exact=False).reading
        return components.Moments.of(self.fits, self.noise.reading or assumed)

    @property
    def places(self) -> list[Index]:
        """Indices of each fit's unknowns among the unknowns of all legs and the external ones."""
        if self.latent:
            return [np.arange(len(self.fits[0].unknowns.labels))]
        owners = np.array([p.owner for p in self.calibration.mechanism.parameters])
        groups = ([leg.name for leg in fit.problem.legs] for fit in self.fits)
        return [np.flatnonzero(np.isin(owners, group)) for group in groups]

    @property
    def parameters(self) -> Array:
        """Identified parameters of all legs, shape (n_params,)."""
        values = np.empty(len(self.calibration.mechanism.parameters))
        for fit, places in zip(self.fits, self.places, strict=True):
            values[places[: len(fit.parameters)]] = fit.parameters
        return values


def fitted(
    calibration: Calibration,
    near: Fits | None = None,
    rows: Mask | None = None,
    patience: int | None = None,
) -> Fits:
    """Return the fits of a calibration, the noise estimated by group if it was not given.

    The search of all legs at once begins at the fits ``near``. If they have more rows or fewer
    terms, the mask ``rows``, shape (N,), selects their rows that are fitted here. ``patience`` is
    the largest number of steps of a search in which no direction may be held any more.
    """
    latent = calibration.options.latent
    fits = _all_legs(calibration, near, rows, patience) if latent else _legs_alone(calibration)
    known = calibration.fixed_noise or calibration.noise.known
    return fits if known else _with_estimated_noise(fits)


def _with_estimated_noise(fits: Fits) -> Fits:
    """Return fits at the noise that their residuals show, with covariances widened for it."""
    calibration, mechanism = fits.calibration, fits.calibration.mechanism
    exact = bool(np.isfinite(calibration.measurements.poses).all()) and not mechanism.redundant
    assumed = components.Assumptions(assumed_noise(mechanism, exact=False), exact)
    plausible = 0.0 if calibration.lacks else assumed.unit.reading
    for _ in range(_REFITS):
        if not fits.sound:
            return fits
        estimate = _noise_of(fits, assumed)
        tie = assumed.tie or components.tie_of(fits.fits[0], estimate, plausible)
        if tie != assumed.tie:
            assumed = assumed._replace(tie=tie)
            estimate = _noise_of(fits, assumed)
        if _same_noise(fits.noise, estimate):
            break
        calibration = fits.calibration.with_noise(estimate)
        fits = _all_legs(calibration, fits) if fits.latent else _legs_alone(calibration)
    fits = replace(fits, fits=assumed.with_exact_readings(fits.fits, fits.noise))
    moments = fits.moments
    if not fits.sound or moments.rounding:
        return fits
    information = moments.information(assumed.information(fits.noise, moments.scale))
    variances: Array = np.asarray(np.linalg.inv(information))
    widened = [
        replace(fit, widening=fit.widening + fit.noise_scale**2 * widening)
        for fit, widening in zip(fits.fits, moments.widenings(variances), strict=True)
    ]
    return replace(fits, fits=widened, variances=variances)


def with_misfit_as_noise(fits: Fits) -> Fits:
    """Return fits at the noise that residuals show, what the machine lacks being its readings'."""
    unit = assumed_noise(fits.calibration.mechanism, exact=False)
    sizes = zip(vars(fits.noise).values(), vars(unit).values(), strict=True)
    begin = _at_noise(fits, Noise(*(size or other for size, other in sizes)))
    return _at_noise(begin, _noise_of(begin, components.Assumptions(unit, exact=False)))


def _at_noise(fits: Fits, noise: Noise) -> Fits:
    """Return fits at other noise, to first order: they need no new search."""
    calibration, refits = fits.calibration.with_noise(noise), list[Fit]()
    for fit in fits.fits:
        names = [leg.name for leg in fit.problem.legs]
        measured = None if fits.latent else calibration.measured_problem(names)[0]
        refits.append(fit.at_noise_of(measured or calibration.latent_problem))
    return replace(fits, calibration=calibration, fits=refits)


def _noise_of(fits: Fits, assumed: components.Assumptions) -> Noise:
    """Return the noise that the residuals of fits show, under assumptions on its groups.

    It is estimated in turn with the fits at that noise.
    """
    for _ in range(ROUNDS):
        fits = replace(fits, fits=assumed.with_exact_readings(fits.fits, fits.noise))
        moments = fits.moments
        estimate = assumed.estimate(moments, fits.noise)
        if moments.rounding or _same_noise(fits.noise, estimate):
            break
        fits = _at_noise(fits, estimate)
    scale = moments.scale**0.5 or 1.0  # differs from 1 because of the assumptions
    return Noise(*(scale * value for value in vars(fits.noise).values()))


def _same_noise(noise: Noise, estimate: Noise) -> bool:
    changes = zip(vars(noise).values(), vars(estimate).values(), strict=True)
    return all(abs(a - b) <= SETTLED * max(a, b) for a, b in changes)


def _all_legs(
    calibration: Calibration,
    begin: Fits | None = None,
    rows: Mask | None = None,
    patience: int | None = None,
) -> Fits:
    """Return the fit of all legs, poses and frames at once; arguments are as in ``fitted``."""
    mechanism, options = calibration.mechanism, calibration.options
    if not calibration.counts.any():
        raise ObservabilityError(
            "every row is for verification (set 'verify'); none is left to fit"
        )
    problem, unknowns = calibration.latent_problem, calibration.unknowns
    if options.setup.plain and not options.tied and (options.strict or not calibration.noise.known):
        calibration.check_counts()
    start, gauge, first = _search_start(problem, begin, rows)
    problem = calibration.started(problem) if first is None else replace(problem, first=first)
    if gauge is None:
        gauge = find_gauge(mechanism, problem, unknowns)
    free = unknowns.held(gauge.constraints) if gauge.found else unknowns
    options.report("identifying all legs and poses")
    known, former = calibration.noise.known, begin if rows is None else None
    counts, rejects, progress = calibration.counts, options.rejects, options.progress
    tolerance = _AUXILIARY if calibration.fixed_noise else NEGLIGIBLE
    system = System(problem, free, counts, known, rejects, patience, tolerance, progress=progress)
    if options.strict:
        fit, held = fit_strictly(mechanism, system, start), None
    else:
        fit, held = fit_holding(mechanism, system, start, former.held if former else None)
    if former:  # its search began where this one would have begun
        fit = replace(fit, first=former.fits[0].first)
    return Fits(calibration, [fit], gauge, held)


def _search_start(
    problem: Problem, begin: Fits | None, rows: Mask | None
) -> tuple[Linear | None, Gauge | None, State | None]:
    """Return where a search starts, its gauge, and its start without ``begin``; None if unknown.

    Fits of more rows have the same gauge if the same quantities are measured. Terms begin at zero.
    """
    if begin is None:
        return None, None, None
    fit = begin.fits[0]
    if rows is None:
        return replace(fit.last, problem=problem), begin.gauge, fit.problem.first
    start = fit.last.state.rows(np.flatnonzero(rows))
    if problem.leg_block.n_parameters != fit.problem.leg_block.n_parameters:
        nominal, values = _by_id(problem.legs), _by_id(fit.problem.legs, start.parameters)
        parameters = np.array([values.get(id_, value) for id_, value in nominal.items()])
        start = State(parameters, start.matrices, external=start.external)
        return problem.evaluate(start), None, None
    columns = (part.observation.measured.T for part in (fit.problem, problem))
    if any(a.any() != b.any() for a, b in zip(*columns, strict=True)):
        return problem.evaluate(start), None, None
    # held directions depend on the start that the search would have had
    holds = begin.held is not None and begin.held.directions.size > 0
    return problem.evaluate(start), begin.gauge, None if holds else start


def _by_id(legs: Sequence[Leg], parameters: Array | None = None) -> dict[str, float]:
    """Return values of the legs' parameters, shape (n_params,), by ids; nominal values if None."""
    nominal = np.concatenate([leg.nominal for leg in legs])
    ids = [id_ for leg in legs for id_ in leg.parameter_ids]
    return dict(zip(ids, nominal if parameters is None else parameters, strict=True))


def _legs_alone(calibration: Calibration) -> Fits:
    """Return the fits of each leg alone, at poses as measured, from nominal values."""
    mechanism, options = calibration.mechanism, calibration.options
    calibration.check_counts()
    unknowns, fits = calibration.unknowns, []
    tied = [leg.name for leg in mechanism.legs if set(options.tied) & set(leg.parameter_names)]
    singly = [[name] for name in mechanism.leg_names if name not in tied]
    for names in [tied, *singly] if tied else singly:  # tied legs are identified together
        options.report(f"identifying {', '.join(names)}")
        problem, rows = calibration.measured_problem(names)
        free, counts = unknowns.part(names), calibration.counts[rows]
        known, progress = calibration.noise.known, options.progress
        system = System(problem, free, counts, known, options.rejects, progress=progress)
        begin = problem.evaluate(problem.start(free.start))
        fits.append(checked(mechanism, robust_fit(system, begin), "--method per-leg"))
    return Fits(calibration, fits)
