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
    covariances,
    exceeded,
    quantiles,
    systematic,
    tie_tests,
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


def assemble(fits_of_all: Fits, without_ties: Fits | None) -> CalibrationResult:
    """Return the result of all legs from one fit of all, or one fit each.

    Args:
        fits_of_all: The fits.
        without_ties: The fits without ties, if there were any.
    """
    calibration, gauge, held = fits_of_all.calibration, fits_of_all.gauge, fits_of_all.held
    mechanism = calibration.mechanism
    fits = fits_of_all.fits
    covariance, outer = covariances(fits_of_all)
    sure = confidence(fits_of_all)
    dof = sum(fit.degrees_of_freedom for fit in fits)
    chi2 = float(sum(fit.chi2 for fit in fits) / dof) if dof > 0 else np.nan
    free = float(dof) if fits_of_all.latent else chi2_freedoms(fits_of_all.fits)
    p_value = exceeded(chi2, free, sure.of_chi2) if calibration.noise.known else 1.0
    excess = excess_of(chi2, p_value)
    covariance, outer = excess**2 * covariance, None if outer is None else excess**2 * outer
    G = systematic(fits_of_all)
    n = len(covariance)
    systematic_part = G[:n] @ G[:n].T
    sizes = [len(leg.parameters) for leg in mechanism.legs]
    lost = np.zeros((n + len(G[n:]), 0)) if held is None else held.directions
    errors = determined(
        np.sqrt(np.stack((np.diagonal(covariance), np.diagonal(systematic_part)))), lost[:n]
    )
    parts = np.split(errors, np.cumsum(sizes)[:-1], axis=1)
    std = dict(zip(mechanism.leg_names, parts, strict=True))
    covariance = covariance + systematic_part
    redundancies = [redundancy(fit) for fit in fits_of_all.fits]
    by_name = {
        leg.name: leg
        for fit, freedoms, own in zip(fits_of_all.fits, sure.of_unknowns, redundancies, strict=True)
        for leg in _leg_results(calibration, fit, std, quantiles(freedoms), *own)
    }
    legs = tuple(by_name[name] for name in mechanism.leg_names)
    return CalibrationResult(
        calibration=calibration,
        identified=mechanism.with_parameters({leg.name: leg.identified for leg in legs}),
        legs=legs,
        external=_external(fits_of_all, outer, G[n:], lost[n:], sure),
        covariance=covariance,
        systematic=systematic_part if G.size else None,
        noise=_noise(calibration, chi2),
        noise_source=calibration.noise.source,
        degrees_of_freedom=dof,
        reduced_chi2=chi2,
        chi2_p_value=p_value,
        chi2_freedoms=free,
        noise_freedoms=sure.least,
        evaluations=sum(fit.evaluations for fit in fits),
        left=max(fit.distance for fit in fits),
        converged=all(fit.converged for fit in fits),
        costs=tuple(
            tuple(cost / max(fit.degrees_of_freedom, 1) for cost in fit.costs) for fit in fits
        ),
        outliers=_merged([outlier for fit in fits_of_all.fits for outlier in fit.outliers]),
        gauge=() if gauge is None else gauge.found,
        gauge_directions=None if gauge is None else gauge.of_legs,
        frames_moved=None if gauge is None else gauge.frames,
        undetermined_directions=lost[:n] if lost.shape[1] else None,
        ties=() if without_ties is None else tie_tests(without_ties),
        observed=_observed(fits_of_all, redundancies[0][1][-1]) if fits_of_all.latent else (),
        outside=fits_of_all.external if len(calibration.observation.external) else None,
        estimated_poses=mechanism.platform.from_matrices(fits[0].last.state.matrices)
        if fits_of_all.latent
        else None,
    )


def determined(std: Array, lost: Array) -> Array:
    """Return standard errors, infinite of what a direction that was held may move.

    Args:
        std: By noise, and by what is off in all rows, shape (2, n).
        lost: Directions, as far as machines may differ, shape (n, n_lost).
    """
    moved = np.linalg.norm(lost, axis=1)
    return np.asarray(np.where(moved > _UNMOVED * np.hypot(*std), np.inf, std))


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
    parameter: Parameter, value: float, std: float, quantile: float, given: str = ""
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
        given=given,
        label=parameter.label,
    )


def _leg_results(
    calibration: Calibration,
    fit: Fit,
    std: dict[str, Array],
    quantile: Array,
    residuals: Sequence[LegResiduals],
    redundancies: Sequence[Array],
) -> list[LegResult]:
    """Return the results of the legs of a fit.

    Args:
        calibration: What was calibrated.
        fit: The fit.
        std: Standard errors by noise, and by what is off in all rows, shape (2, n) of each leg.
        quantile: How many of them half an interval is, of the fit's unknowns, shape (n,).
        residuals: Of the legs.
        redundancies: Redundancies of these, (N, k) each.
    """
    problem = fit.problem
    nominal, results = calibration.mechanism.parameters, []
    for index, (leg, columns) in enumerate(
        zip(problem.legs, problem.leg_block.columns, strict=True)
    ):
        counted = problem.leg_block.used[:, index] & (fit.weights > 0.0)
        before = leg_residuals(problem, fit.first, index)
        after = residuals[index]
        rank, condition = fit.ranks[index]
        values = after.value[counted]
        parameters = [nominal[f"{leg.name}.{name}"] for name in leg.parameter_names]
        results.append(
            LegResult(
                name=leg.name,
                parameters=tuple(
                    _identified(p, value, error, half, _given(calibration, p, error))
                    for p, value, error, half in zip(
                        parameters,
                        fit.parameters[columns],
                        np.hypot(*std[leg.name]),
                        quantile[columns],
                        strict=True,
                    )
                ),
                rank=rank,
                condition=condition,
                rms_before=_rms(before.value[counted]),
                rms_after=_rms(values),
                unit=after.unit,
                n_residuals=values.size,
                sigma=after.sigma[counted].ravel(),
                rows=np.repeat(fit.rows[counted], values.shape[1]),
                residuals_before=before.value[counted].ravel(),
                residuals=values.ravel(),
                quantity=after.quantity,
                redundancy=redundancies[index][counted].ravel(),
            )
        )
    return results


def _given(calibration: Calibration, parameter: Parameter, std: float) -> str:
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
    fits: Fits, outer: Array | None, systematic_rows: Array, lost: Array, sure: Confidence
) -> tuple[IdentifiedParameter, ...]:
    """Return frame and targets with their intervals, and where the search for them began.

    Args:
        fits: The fits.
        outer: Covariance of their steps by noise, shape (n, n); None if there are none.
        systematic_rows: How they follow what is off by the same in all rows, shape (n, q).
        lost: Directions of them that were held, shape (n, n_lost).
        sure: How well the noise is known.
    """
    outside, values = fits.calibration.observation.external, fits.external
    if values is None or outer is None or not len(outside):
        return ()
    began = fits.fits[0].first.state.external
    # of instruments, what their makers say
    began = replace(began, instruments=outside.start.instruments)
    start, estimates = (outside.coordinates(external) for external in (began, values))
    D = outside.coordinates_by_step(values)
    freedoms = [freedoms.min(initial=np.inf) for freedoms in sure.of_unknowns]
    quantile = float(quantiles(np.array(min(freedoms))))
    std = np.stack(
        (np.sqrt(np.diagonal(D @ outer @ D.T)), np.linalg.norm(D @ systematic_rows, axis=1))
    )
    std = determined(std, D @ lost)
    return tuple(
        _identified(
            _outside(id_, unit, first), value, error, quantile, "" if np.isfinite(error) else HELD
        )
        for id_, unit, first, value, error in zip(
            outside.names, outside.units, start, estimates, np.hypot(*std), strict=True
        )
    )


def _outside(id_: str, unit: str, nominal: float) -> Parameter:
    owner, _, name = id_.partition(".")
    return Parameter(owner, name, unit, float(nominal))


def _observed(fits: Fits, redundancies: Array) -> tuple[Observed, ...]:
    """Return how the measured quantities of the platform fit; left: redundancies, (N, r)."""
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


def _merged(outliers: Sequence[Outlier]) -> tuple[Outlier, ...]:
    """Return outliers of all fits, one for each row, the worst first."""
    rows: dict[int, Outlier] = {}
    for outlier in sorted(outliers, key=lambda o: -o.sigma):
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
    again = replace(calibration, mechanism=machine, measurements=data)
    differences = [0.0]
    for fitted_leg, saved_leg, reported in zip(
        _leg_misses(calibration, result, [leg.identified for leg in result.legs]),
        _leg_misses(again, result, [leg.nominal for leg in machine.legs]),
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
        poses = calibration.given_poses(result.outside)
        problems = [
            (*calibration.measured_problem([leg], *poses), range(leg, leg + 1)) for leg in every_leg
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
