"""The fits of a calibration: all legs at once, or each leg alone, poses as measured.

Where poses are taken as measured in an unknown frame, each leg's base point takes that up: the legs
are identified in the tracker's frame, aligned with the nominal machine, and the frame is then moved
so that the parameters are nearest to the nominal ones, the same choice as all legs at once make.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pincal.calibration.calibration import Calibration
from pincal.errors import MeasurementError, ObservabilityError
from pincal.estimation.components import Beforehand, Moments, estimated_noise, widened
from pincal.estimation.fit import Fit
from pincal.estimation.noise import assumed_noise
from pincal.estimation.observability.gauge import Gauge, find_gauge
from pincal.estimation.observability.identifiable import HeldUnknowns, hold_unobservable
from pincal.estimation.problem import Problem
from pincal.estimation.robust import robust_fit
from pincal.estimation.system import Loss, System, loss_of
from pincal.estimation.unknowns import External, State, Unknowns
from pincal.kinematics.closure import largest_size
from pincal.model.measurements import Noise
from pincal.model.mechanism import Mechanism
from pincal.types import Array, Mask


@dataclass(frozen=True)
class Near:
    """Where all legs at once were identified from other rows, or from the same ones before."""

    state: State
    fits: Fits | None = None
    """The fits that ended there, whose gauge may be the same; None if they are not at hand."""

    @classmethod
    def of(cls, fits: Fits, rows: Mask) -> Near:
        """Return where fits of all legs at once ended, at some of their rows, shape (N,)."""
        return cls(fits.fits[0].last.state.rows(np.flatnonzero(rows)), fits)

    def gauge(self, problem: Problem, unknowns: Unknowns) -> Gauge | None:
        """Return the fits' gauge if it is a problem's too: the same is free, measured and known."""
        if self.fits is None or self.fits.unknowns is None:
            return None
        whole, free = self.fits.fits[0].problem, self.fits.unknowns
        same = (
            free.labels == unknowns.labels
            and np.array_equal(free.map, unknowns.map)
            and np.array_equal(free.priors, unknowns.priors, equal_nan=True)
            and _said(whole) == _said(problem)
        )
        return self.fits.gauge if same else None


def _said(problem: Problem) -> tuple[list[bool], dict[str, bool]]:
    """Return what is measured in some row, and which influences are known in some."""
    known = {
        name: bool(np.isfinite(influence).any())
        for name, influence in problem.leg_block.influences.items()
    }
    return [bool(column.any()) for column in problem.observation.measured.T], known


Tie = tuple[int, float] | None  # of the noise of readings to another, see ``Moments.tie``
ROUNDS = 20  # of noise, or of frames, in turn with the legs
# Weak directions are held where noise moves them farther than machines differ; where the search
_HELD_MORE = 10.0  # does not converge with them, also those moved a tenth as far, and so on
_HELD_MOST = 100.0  # until a hundredth,
_PATIENCE = 500  # so many evaluations each
_REFITS = 5  # with noise that was estimated
_STILL = 1e-10  # of the machine's size, and [rad]: the frame moves no more
SCALE_OFF = 5e-3  # of the scale of the noise that was estimated: fitted once more
SETTLED = 1e-3  # relative change of a standard deviation, below which it is estimated


@dataclass(frozen=True)
class Fits:
    """Fits that together identify all legs."""

    calibration: Calibration
    """With the noise that was given or estimated."""
    fits: list[Fit]
    external: External | None = None
    """Values of the unknowns outside the mechanism, if there are any."""
    gauge: Gauge | None = None
    """Gauge freedoms."""
    unknowns: Unknowns | None = None
    """Of legs and what is outside, of which the gauge speaks."""
    held: HeldUnknowns | None = None
    """What the measurements cannot observe, if that was held."""
    variances: Array | None = None
    """Covariance of the relative variances of positions, orientations and readings, if they were
    estimated, shape (3, 3)."""

    @property
    def latent(self) -> bool:
        """Whether poses were unknowns."""
        return self.calibration.options.latent

    @property
    def degrees_of_freedom(self) -> int:
        """Of all fits."""
        return sum(fit.degrees_of_freedom for fit in self.fits)

    @property
    def converged(self) -> bool:
        """Whether all fits converged."""
        return all(fit.converged for fit in self.fits)

    def parameters(self, mechanism: Mechanism) -> dict[str, Array]:
        """Return identified parameters by leg, each of shape (n_params,)."""
        by_leg = {
            leg.name: fit.parameters[columns]
            for fit in self.fits
            for leg, columns in zip(fit.problem.legs, fit.problem.leg_block.columns, strict=True)
        }
        return {name: by_leg[name] for name in mechanism.leg_names}


def fitted(calibration: Calibration, *, tied: bool = True, near: Near | None = None) -> Fits:
    """Return the fits of a calibration, the noise estimated by group if it was not given.

    Args:
        calibration: What is to be identified.
        tied: Whether ties count, or are left out for the test of the same estimator.
        near: Where the search for all legs at once begins, if the optimum is known to be near; each
            leg alone begins at its nominal parameters.

    Raises:
        ObservabilityError: too few poses, or poses that leave parameters undetermined.
        MeasurementError: measurements that do not suit the method.
    """
    latent = calibration.options.latent
    one = _all_legs(calibration, tied, None, near) if latent else _measured(calibration, tied, None)
    search = _all_legs if latent else _measured
    noise = calibration.noise.noise
    if (
        calibration.fixed_noise
        or calibration.noise.known
        or calibration.options.residual == "joint"
    ):
        return one
    unit = noise.reading or assumed_noise(calibration.mechanism, exact=False).reading
    unscaled, tie = noise, None
    for _ in range(_REFITS):
        if not _sound(one):
            break
        estimate = _noise_of(one, noise, unit, tie)
        if tie is None and (tie := _moments(one, estimate, unit).tie(estimate)):
            estimate = _noise_of(one, noise, unit, tie)
        if _alike(unscaled, estimate):
            break
        noise, unscaled, unit = estimate, estimate, estimate.reading or unit
        one = search(calibration.with_noise(noise), tied, one)
        scale = float(np.mean([fit.noise_scale for fit in one.fits]))
        if abs(scale - 1.0) > SCALE_OFF and scale > 0.0:  # a group at its floor leaves that to all
            noise = Noise(*(scale * value for value in vars(noise).values()))
            one = search(calibration.with_noise(noise), tied, one)
    return _with_variances(one, noise, unit, tie)


def _sound(fits_of_all: Fits) -> bool:
    """Return whether the residuals of fits say something about the noise."""
    fits = fits_of_all.fits
    return all(fit.converged and fit.degrees_of_freedom > 0 for fit in fits)


def _with_variances(fits_of_all: Fits, noise: Noise, unit: float, tie: Tie) -> Fits:
    """Return fits at noise that was estimated, with what that adds to their covariances."""
    if not _sound(fits_of_all):
        return fits_of_all
    moments = _moments(fits_of_all, None, noise.reading or unit)
    if moments.rounding:
        return fits_of_all
    information, _ = moments.information(_beforehand(fits_of_all.calibration, noise, tie))
    variances: Array = np.asarray(np.linalg.inv(information))
    fits = []
    for fit, part in zip(fits_of_all.fits, moments.parts, strict=True):
        widening = fit.noise_scale**2 * widened(part, variances)
        fits.append(replace(fit, widening=fit.widening + widening))
    return replace(fits_of_all, fits=fits, variances=variances)


def _beforehand(calibration: Calibration, noise: Noise, tie: Tie) -> Beforehand:
    """Return what is assumed of the noise before it is estimated."""
    mechanism, data = calibration.mechanism, calibration.measurements
    exact = assumed_noise(mechanism, exact=bool(np.isfinite(data.poses).all())).reading == 0.0
    return Beforehand.of(noise, assumed_noise(mechanism, exact=False), exact=exact, tie=tie)


def _noise_of(fits_of_all: Fits, noise: Noise, unit: float, tie: Tie) -> Noise:
    """Return the noise that the residuals of fits show.

    Args:
        fits_of_all: The fits.
        noise: At which they were made.
        unit: Standard deviation of readings to try where they were exact.
        tie: To which noise that of readings is tied, if it is.
    """
    for _ in range(ROUNDS):
        moments = _moments(fits_of_all, noise, noise.reading or unit)
        if moments.rounding:
            return noise
        before = _beforehand(fits_of_all.calibration, noise, tie)
        estimate = estimated_noise(moments, noise, noise.reading or unit, before)
        if _alike(noise, estimate):
            break
        noise = estimate
    return noise


def _alike(noise: Noise, estimate: Noise) -> bool:
    changes = zip(vars(noise).values(), vars(estimate).values(), strict=True)
    return all(abs(a - b) <= SETTLED * max(a, b) for a, b in changes)


def _moments(fits_of_all: Fits, noise: Noise | None, unit: float) -> Moments:
    """Return the moments of fits at some noise, or at their own; of readings over a unit."""
    fits, calibration = fits_of_all.fits, fits_of_all.calibration
    problems = [fit.problem for fit in fits]
    if noise is not None:
        calibration = calibration.with_noise(noise)
        if fits_of_all.latent:
            problems = [calibration.latent_problem]
        else:
            external = None if calibration.options.setup.plain else fits_of_all.external
            poses, names = calibration.given_poses(external), calibration.mechanism.leg_names
            groups = [[names.index(leg.name) for leg in problem.legs] for problem in problems]
            problems = [calibration.measured_problem(group, *poses)[0] for group in groups]
    return Moments.of(list(zip(fits, problems, strict=True)), unit)


def _loss(calibration: Calibration) -> Loss | None:
    return loss_of(calibration.options.loss)


def _all_legs(
    calibration: Calibration, tied: bool, before: Fits | None, near: Near | None = None
) -> Fits:
    """Return the fit of all legs, poses and frames at once.

    Args:
        calibration: What is to be identified.
        tied: Whether ties count.
        before: Fits at other noise, from which this one starts.
        near: Where it starts otherwise, if that is known.
    """
    mechanism, options = calibration.mechanism, calibration.options
    problem, unknowns = calibration.latent_problem, calibration.unknowns(tied=tied)
    if options.setup.plain and not options.tied and (options.strict or not calibration.noise.known):
        calibration.check_counts()
    start = gauge = None
    if before is not None:
        start, gauge = before.fits[0].last.state, before.gauge
        first = before.fits[0].problem.first
    else:
        if near is not None:
            start, gauge = near.state, near.gauge(problem, unknowns)
        held_before = None if near is None or near.fits is None else near.fits.held
        # what is held follows where the search would have started
        anything_held = held_before is not None and held_before.directions.size > 0
        started = gauge is not None and not anything_held
        first = start if started else calibration.started(problem).first
    problem = replace(problem, first=first)
    if gauge is None:
        gauge = find_gauge(mechanism, problem, unknowns, strict=not options.holds)
    free = unknowns.held(gauge.constraints) if gauge.found else unknowns
    options.report("identifying all legs and poses")
    kept = None if calibration.counts.all() else calibration.counts
    system = System(problem, free, calibration.noise.known, kept=kept)
    held, loss = None, _loss(calibration)
    least = 1.0 if before is None or before.held is None else before.held.least
    while options.holds:
        held = hold_unobservable(mechanism, problem, free, least)
        may_hold_more = held.weakest < _HELD_MORE * least and least < _HELD_MOST
        patience = _PATIENCE if may_hold_more else None
        system = replace(system, unknowns=held.unknowns, max_evaluations=patience)
        try:
            found = robust_fit(mechanism, system, loss, start, options.progress)
            if found.converged or not may_hold_more:
                break
        except ObservabilityError:
            if not may_hold_more:
                raise
        least *= _HELD_MORE
    else:
        found = robust_fit(mechanism, system, loss, start, options.progress)
    if before is not None:  # whose search began where this one's would have
        found = replace(found, first=before.fits[0].first)
    external = found.last.state.external
    return Fits(calibration, [found], external, gauge, unknowns, held)


def _measured(calibration: Calibration, tied: bool, before: Fits | None) -> Fits:
    """Return the fits of all legs, poses as measured; arguments are those of ``_all_legs``."""
    calibration.check_whole()
    calibration.check_counts()
    unknowns = calibration.unknowns(tied=tied)
    groups = _groups(calibration)
    if calibration.options.setup.plain:
        return Fits(calibration, _fit_groups(calibration, groups, unknowns, None))
    problem = calibration.started(calibration.latent_problem)
    gauge = find_gauge(calibration.mechanism, problem, unknowns, strict=True)
    n_external = len(problem.observation.external)
    if len(gauge.directions) != n_external or problem.first is None:
        raise ObservabilityError(
            f"the legs' parameters can take up {len(gauge.directions)} of the {n_external} "
            "unknowns outside the mechanism only; all legs at once identify the others with them "
            "(leave out --method per-leg)"
        )
    first = problem.first.external
    external = first if before is None or before.external is None else before.external
    size = largest_size(calibration.mechanism.legs)
    units = np.array([size if u == "m" else 1.0 for u in problem.observation.external.units])
    for _ in range(ROUNDS):
        fits = _fit_groups(calibration, groups, unknowns, external)
        step = _toward_nominal(gauge, problem, unknowns, fits, external)
        if np.abs(step / units).max(initial=0.0) <= _STILL:
            return Fits(calibration, fits, external, gauge, unknowns)
        external = problem.observation.external.moved(external, step)
    raise MeasurementError(
        "the frames of the measurements were not found by aligning leg after leg; all legs at once "
        "find them with the parameters (leave out --method per-leg)"
    )


def _fit_groups(
    calibration: Calibration,
    groups: list[list[int]],
    unknowns: Unknowns,
    external: External | None,
) -> list[Fit]:
    """Return a fit for each group of legs, poses as measured in a frame."""
    mechanism, options = calibration.mechanism, calibration.options
    poses, roots = calibration.given_poses(external)
    fits = []
    for group in groups:
        names = [mechanism.leg_names[i] for i in group]
        options.report(f"identifying {', '.join(names)}")
        problem, rows = calibration.measured_problem(group, poses, roots)
        kept = calibration.counts[rows]
        known = calibration.noise.known
        system = System(problem, unknowns.part(names), known, kept=None if kept.all() else kept)
        loss = _loss(calibration)
        fits.append(robust_fit(mechanism, system, loss, progress=options.progress))
    return fits


def _groups(calibration: Calibration) -> list[list[int]]:
    """Return the legs that are identified at once: those that share a tie, or all."""
    legs, options = calibration.mechanism.legs, calibration.options
    if options.method == "all-legs":
        return [list(range(len(legs)))]
    together = [
        i for i, leg in enumerate(legs) if any(name in leg.parameter_names for name in options.tied)
    ]
    single_legs = [[i] for i in range(len(legs)) if i not in together]
    return [together, *single_legs] if together else single_legs


def _toward_nominal(
    gauge: Gauge, problem: Problem, unknowns: Unknowns, fits: list[Fit], external: External
) -> Array:
    """Return the step of the external unknowns that brings the parameters nearest to nominal."""
    n = problem.leg_block.n_parameters
    if problem.first is None:
        raise TypeError("the problem has no start")
    values = unknowns.start.copy()
    for fit in fits:
        for leg, columns in zip(fit.problem.legs, fit.problem.leg_block.columns, strict=True):
            place = [leg.name for leg in problem.legs].index(leg.name)
            values[problem.leg_block.columns[place]] = fit.parameters[columns]
    outside = problem.observation.external
    values[n:] = outside.coordinates(external) - outside.coordinates(problem.first.external)
    deviations = np.linalg.lstsq(unknowns.map, values - unknowns.start, rcond=None)[0]
    along = gauge.constraints @ gauge.directions.T
    amounts = -np.linalg.solve(along, gauge.constraints @ deviations)
    return np.asarray((unknowns.map @ (gauge.directions.T @ amounts))[n:])
