"""From fits to a result: parameters with intervals, residuals leg by leg."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pincal.calibration.calibration import Calibration, located
from pincal.calibration.covariance import (
    Confidence,
    chi2_freedoms,
    confidence,
    covariance_by_noise,
    exceeded,
    parameter_places,
    quantiles,
    systematic,
)
from pincal.calibration.fits import Fits
from pincal.calibration.leg_result import HELD, IdentifiedParameter, LegResult, Observed
from pincal.calibration.promise import excess_of
from pincal.calibration.result import CalibrationResult
from pincal.estimation.fit import Fit, Outlier
from pincal.estimation.observability.residuals import LegResiduals, leg_residuals, redundancy
from pincal.estimation.unknowns import State
from pincal.kinematics.closure import largest_size
from pincal.kinematics.configurations import planned_influences
from pincal.kinematics.influences import by_name
from pincal.model.measurements import Noise
from pincal.model.mechanism import Mechanism
from pincal.model.parameter import Parameter, means
from pincal.model.terms import LOAD
from pincal.types import Array

_UNMOVED = 0.1  # of a standard error: what is held and moves a value by less leaves its interval


def assemble(fits: Fits) -> CalibrationResult:
    """Return the result of all legs from one fit of all, or one fit each."""
    calibration, gauge = fits.calibration, fits.gauge
    mechanism = calibration.mechanism
    sure = confidence(fits)
    dof, chi2 = fits.degrees_of_freedom, _reduced_chi2(fits)
    chi2_dof = chi2_freedoms(fits.fits)
    p_value = exceeded(chi2, chi2_dof, sure.of_chi2) if calibration.noise.known else 1.0
    by_noise = excess_of(chi2, p_value) ** 2 * covariance_by_noise(fits)
    by_systematic = systematic(fits)
    held = np.zeros((len(by_noise), 0)) if fits.held is None else fits.held.directions
    n = len(mechanism.parameters)
    systematic_part = by_systematic[:n] @ by_systematic[:n].T
    std = _standard_errors(by_noise[:n, :n], by_systematic[:n], held[:n])
    redundancies = [redundancy(fit) for fit in fits.fits]
    legs = _leg_results(fits, std, sure, redundancies)
    return CalibrationResult(
        calibration=calibration,
        identified=mechanism.with_parameters({leg.name: leg.identified for leg in legs}),
        legs=legs,
        external=_external(fits, by_noise[n:, n:], by_systematic[n:], held[n:], sure),
        covariance=by_noise[:n, :n] + systematic_part,
        systematic=systematic_part if by_systematic.size else None,
        noise=_noise(calibration, chi2),
        noise_source=calibration.noise.source,
        degrees_of_freedom=dof,
        reduced_chi2=chi2,
        chi2_p_value=p_value,
        chi2_freedoms=chi2_dof,
        noise_freedoms=sure.least,
        evaluations=sum(fit.evaluations for fit in fits.fits),
        left=max(fit.distance for fit in fits.fits),
        converged=fits.converged,
        outliers=_merged_outliers(fits.fits),
        gauge=() if gauge is None else gauge.found,
        gauge_directions=None if gauge is None else gauge.of_legs,
        frames_moved=None if gauge is None else gauge.frames,
        undetermined_directions=held[:n] if held.shape[1] else None,
        observed=_observed(fits, redundancies[0][1][-1]),
        outside=fits.external if len(calibration.observation.external) else None,
        estimated_poses=mechanism.platform.from_matrices(fits.fits[0].last.state.matrices)
        if fits.latent
        else None,
    )


def _reduced_chi2(fits: Fits) -> float:
    """Return χ² of all fits over its degrees of freedom, NaN if there are none."""
    dof = fits.degrees_of_freedom
    return float(sum(fit.chi2 for fit in fits.fits) / dof) if dof > 0 else np.nan


def _standard_errors(covariance: Array, by_systematic: Array, held: Array) -> Array:
    """Return standard errors of n values, infinite of what a direction that was held may move.

    Args:
        covariance: By noise, shape (n, n).
        by_systematic: How the values follow what is off in all rows, shape (n, q).
        held: Directions that were held, as far as machines may differ, shape (n, n_held).
    """
    std = np.hypot(np.sqrt(np.diagonal(covariance)), np.linalg.norm(by_systematic, axis=1))
    moved = np.linalg.norm(held, axis=1)
    return np.asarray(np.where(moved > _UNMOVED * std, np.inf, std))


def _noise(calibration: Calibration, chi2: float) -> Noise | None:
    """Return the noise of all rows; estimated noise to its last digit by χ²."""
    model = calibration.noise
    if model.source == "rows":
        return None
    if model.known:
        return model.noise
    scale = float(np.sqrt(chi2)) if np.isfinite(chi2) else 1.0
    return Noise(*(scale * value for value in vars(model.noise).values()))


def _identified(
    parameter: Parameter, value: float, std: float, quantile: float, beforehand: str = ""
) -> IdentifiedParameter:
    """Return a parameter with its 95 % interval, half of which is so many standard errors."""
    return IdentifiedParameter(
        owner=parameter.owner,
        name=parameter.name,
        unit=parameter.unit,
        nominal=parameter.nominal,
        identified=float(value),
        std=float(std),
        low=float(value - quantile * std),
        high=float(value + quantile * std),
        given=beforehand,
        label=parameter.label,
    )


def _leg_results(
    fits: Fits,
    std: Array,
    sure: Confidence,
    redundancies: Sequence[tuple[list[LegResiduals], list[Array]]],
) -> tuple[LegResult, ...]:
    """Return the results of all legs in the mechanism's order.

    Args:
        fits: The fits.
        std: Standard errors of all legs' parameters, shape (n_params,).
        sure: How well the noise is known.
        redundancies: Of each fit, residuals of its legs and their redundancies, (N, k) each.
    """
    mechanism = fits.calibration.mechanism
    nominal, results = mechanism.parameters, {}
    for fit, freedoms, (residuals, shares) in zip(
        fits.fits, sure.of_unknowns, redundancies, strict=True
    ):
        errors = std[parameter_places(mechanism, fit.problem.legs)]
        quantile = quantiles(freedoms)
        for index, (leg, columns) in enumerate(
            zip(fit.problem.legs, fit.problem.leg_block.columns, strict=True)
        ):
            parameters = tuple(
                _identified(p, value, error, half, _beforehand(fits.calibration, p, error))
                for p, value, error, half in zip(
                    [nominal[name] for name in leg.parameter_ids],
                    fit.parameters[columns],
                    errors[columns],
                    quantile[columns],
                    strict=True,
                )
            )
            results[leg.name] = _leg_result(fit, index, parameters, residuals[index], shares[index])
    return tuple(results[name] for name in mechanism.leg_names)


def _leg_result(
    fit: Fit,
    index: int,
    parameters: tuple[IdentifiedParameter, ...],
    after: LegResiduals,
    redundancies: Array,
) -> LegResult:
    """Return the result of one leg of a fit, of its residuals at the rows that count."""
    counted = fit.problem.leg_block.used[:, index] & (fit.weights > 0.0)
    before = leg_residuals(fit.problem, fit.first, index).value[counted]
    residuals = after.value[counted]
    rank, condition = fit.ranks[index]
    return LegResult(
        name=fit.problem.legs[index].name,
        parameters=parameters,
        rank=rank,
        condition=condition,
        rms_before=_rms(before),
        rms_after=_rms(residuals),
        unit=after.unit,
        n_residuals=residuals.size,
        sigma=after.sigma[counted].ravel(),
        rows=np.repeat(fit.rows[counted], residuals.shape[1]),
        residuals_before=before.ravel(),
        residuals=residuals.ravel(),
        quantity=after.quantity,
        redundancy=redundancies[counted].ravel(),
    )


def _beforehand(calibration: Calibration, parameter: Parameter, std: float) -> str:
    """Return what was given of a parameter beforehand, or that it was held nearest to nominal."""
    options = calibration.options
    names_by_kind = {"fixed": options.fixed, "tied": options.tied, "prior": calibration.priors}
    kinds = [
        kind
        for kind, names in names_by_kind.items()
        if any(means(name, parameter.owner, parameter.name) for name in names)
    ]
    kinds += [] if np.isfinite(std) else [HELD]
    return "fixed" if "fixed" in kinds else ", ".join(kinds)


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean())) if len(values) else np.nan


def _external(
    fits: Fits, covariance: Array, by_systematic: Array, held: Array, sure: Confidence
) -> tuple[IdentifiedParameter, ...]:
    """Return frame and targets with their intervals, and where the search for them began.

    Args:
        fits: The fits.
        covariance: Of their steps by noise, shape (n, n).
        by_systematic: How they follow what is off by the same in all rows, shape (n, q).
        held: Directions of them that were held, shape (n, n_held).
        sure: How well the noise is known.
    """
    outside, values = fits.calibration.observation.external, fits.external
    if not len(outside):
        return ()
    began = fits.fits[0].first.state.external
    # of instruments, what their makers say
    began = replace(began, instruments=outside.start.instruments)
    start, estimates = (outside.coordinates(external) for external in (began, values))
    D = outside.coordinates_by_step(values)
    freedoms = [freedoms.min(initial=np.inf) for freedoms in sure.of_unknowns]
    quantile = float(quantiles(np.array(min(freedoms))))
    std = _standard_errors(D @ covariance @ D.T, D @ by_systematic, D @ held)
    return tuple(
        _identified(
            Parameter(owner, name, unit, float(first)),
            value,
            error,
            quantile,
            "" if np.isfinite(error) else HELD,
        )
        for (owner, _, name), unit, first, value, error in zip(
            (id_.partition(".") for id_ in outside.names),
            outside.units,
            start,
            estimates,
            std,
            strict=True,
        )
    )


def _observed(fits: Fits, redundancies: Array) -> tuple[Observed, ...]:
    """Return how the measured quantities of the platform fit; none where poses are as measured.

    Args:
        fits: The fits.
        redundancies: Of the quantities, shape (N, r).
    """
    if not fits.latent:
        return ()
    fit = fits.fits[0]
    problem, observation = fit.problem, fit.problem.observation
    n_legs = problem.leg_block.n_rows
    before, values = (linear.conditions[:, n_legs:] for linear in (fit.first, fit.last))
    results = []
    for column, (name, unit) in enumerate(zip(observation.names, observation.units, strict=True)):
        counted = observation.measured[:, column] & (fit.weights > 0.0)
        if counted.any():
            sigmas = fit.noise_scale * problem.observation.sigma[counted, column]
            results.append(
                Observed(
                    name=name,
                    unit=unit,
                    count=int(counted.sum()),
                    rms=_rms(values[counted, column]),
                    sigma=_rms(sigmas),
                    rows=np.flatnonzero(counted),
                    sigmas=sigmas,
                    residuals_before=before[counted, column],
                    residuals=values[counted, column],
                    redundancy=redundancies[counted, column],
                )
            )
    return tuple(results)


def _merged_outliers(fits: Sequence[Fit]) -> tuple[Outlier, ...]:
    """Return outliers of all fits, one for each row, the worst first."""
    outliers = [outlier for fit in fits for outlier in fit.outliers]
    rows: dict[int, Outlier] = {}
    for outlier in sorted(outliers, key=lambda outlier: -outlier.sigma):
        worst = rows.setdefault(outlier.row, outlier)
        if worst is not outlier:
            legs = (*worst.legs, *outlier.legs)
            rows[outlier.row] = replace(worst, legs=legs, weight=min(worst.weight, outlier.weight))
    return tuple(rows.values())


def unreproduced(result: CalibrationResult, machine: Mechanism) -> float:
    """Return how far a calibrated machine is from the fit that a result reports, over its size.

    The largest difference at rows of the fit: of the residuals that the fitted parameters give from
    those reported, and of the twists by which the machine's legs miss the poses, with what its own
    terms follow there, from those of the fit.

    Args:
        result: A calibration that converged.
        machine: Its calibrated mechanism, as it was saved and loaded again.
    """
    calibration = result.calibration
    influences = _influences_again(calibration, machine)
    data = replace(calibration.measurements, influences=influences)
    reproduced = replace(calibration, mechanism=machine, measurements=data)
    differences = [0.0]
    for fitted_leg, saved_leg, reported in zip(
        _leg_misses(calibration, result, [leg.identified for leg in result.legs]),
        _leg_misses(reproduced, result, [leg.nominal for leg in machine.legs]),
        result.legs,
        strict=True,
    ):
        residuals, twists = fitted_leg
        differences += np.abs(residuals.ravel() - reported.residuals).tolist()
        differences += np.abs(twists - saved_leg[1]).ravel().tolist()
    return float(np.max(differences) / max(1.0, largest_size(machine.legs)))  # NaN stays


def _leg_misses(
    calibration: Calibration, result: CalibrationResult, parameters: Sequence[Array]
) -> list[tuple[Array, Array]]:
    """Return residuals of each leg at its rows of a fit, and the least twists that undo them.

    At the poses of the fit. The twists of the platform, shape (N, dof), are those of a leg's
    conditions whatever their axes and scale, which go with the machine as it is drawn.

    Args:
        calibration: Rows and mechanism by which to evaluate.
        result: Poses and rows of the fit.
        parameters: Of each leg, shape (n_params,).
    """
    every_leg = range(len(result.legs))
    if calibration.options.latent:
        every_row = np.arange(len(calibration.measurements))
        problems = [(calibration.latent_problem, every_row, every_leg)]
    else:
        problems = [
            (*calibration.measured_problem([leg]), range(leg, leg + 1)) for leg in every_leg
        ]
    misses = []
    for problem, rows, legs in problems:
        values = np.concatenate([parameters[leg] for leg in legs])
        matrices = calibration.mechanism.platform.matrices(result.poses[rows])
        external = result.outside or problem.observation.external.start
        state = State(values, matrices, external=external)
        linear = problem.evaluate(state)
        for index, leg in enumerate(legs):
            demand = linear.demands[index]
            residuals = leg_residuals(problem, linear, index).value
            used = np.searchsorted(rows, result.legs[leg].rows[:: residuals.shape[1]])
            twists = np.linalg.pinv(demand.pose[used]) @ demand.value[used, :, None]
            misses.append((residuals[used], twists[:, :, 0]))
    return misses


def _influences_again(calibration: Calibration, machine: Mechanism) -> dict[str, Array]:
    """Return what terms follow at the rows of a calibration, as a machine works it out itself.

    Sides of approach and loads, at the poses by which they were worked out before the fit, unless
    they were measured: then they are not what the nominal mechanism says.
    """
    data = calibration.measurements
    names = calibration.mechanism.followed & set(calibration.mechanism.influences)
    if not names:
        return dict(data.influences)
    loads = names & {f"{LOAD}_{name}" for name in calibration.mechanism.load_names}
    rows = located(calibration) if loads else data
    measured = {name: v for name, v in data.influences.items() if name not in names}
    rows = replace(rows, influences=measured)
    before, after = (
        by_name(mechanism, planned_influences(mechanism, rows))
        for mechanism in (calibration.mechanism, machine)
    )
    followed = {
        name: after[name]
        for name in names
        if np.allclose(before[name], data.influences[name], rtol=1e-9, atol=0.0, equal_nan=True)
    }
    return {**data.influences, **followed}
