"""From fits to a result: parameters with intervals, residuals leg by leg, what to know first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtrit

from pincal.identification.alignment import settle
from pincal.identification.cautions import warnings_of
from pincal.identification.covariance import covariances
from pincal.identification.estimate import Estimate
from pincal.identification.failure import causes
from pincal.identification.fit import Fit
from pincal.identification.latent import LatentPoses
from pincal.identification.misaligned import misaligned
from pincal.identification.problem import State
from pincal.identification.result import (
    CalibrationResult,
    IdentifiedParameter,
    LegResult,
    Observed,
)
from pincal.identification.robust import Outlier, Robust
from pincal.identification.scales import unequal_noise
from pincal.identification.task import Task
from pincal.identification.ties import tie_tests
from pincal.kinematics.closure import LegClosure
from pincal.kinematics.forward import placed_by_arm
from pincal.model.measurements import Noise

Array = NDArray[np.float64]
_CONFIDENCE = 0.95


def assemble(task: Task, estimate: Estimate, without_ties: Estimate | None) -> CalibrationResult:
    """Return the result of all legs from one fit of all, or one fit each.

    Args:
        task: What was to be identified.
        estimate: The fits.
        without_ties: The fits without ties, if there were any.
    """
    mechanism, source = task.mechanism, task.noise.source
    fits = [one.fit for one in estimate.fits]
    covariance, outer = covariances(task, estimate)
    variances = np.split(np.diagonal(covariance), np.cumsum(_sizes(task))[:-1])
    std = dict(zip(mechanism.leg_names, map(np.sqrt, variances), strict=True))
    by_name = {leg.name: leg for one in estimate.fits for leg in _leg_results(task, one, std)}
    legs = tuple(by_name[name] for name in mechanism.leg_names)
    dof = sum(one.degrees_of_freedom for one in fits)
    chi2 = sum(one.chi2 for one in fits) / dof if dof else np.nan
    noise = None if source == "rows" else task.noise.noise
    if source == "assumed":
        noise = Noise(*(float(np.sqrt(chi2)) * value for value in vars(task.noise.noise).values()))
    held = estimate.held
    lost = (held.words,) if held is not None and held.words else ()
    failed = [one.message for one in fits if not one.converged]
    evaluations = sum(one.evaluations for one in fits)
    latent = estimate.latent
    ties = () if without_ties is None else tie_tests(task, without_ties)
    outliers = _merged([outlier for one in estimate.fits for outlier in one.outliers])
    result = CalibrationResult(
        nominal=mechanism,
        identified=mechanism.with_parameters({leg.name: leg.identified for leg in legs}),
        legs=legs,
        method=task.method,
        residual="reading" if task.method == "latent" else task.kind,
        poses="all" if task.every_pose else "own",
        noise=noise,
        noise_source="estimated" if source == "assumed" else source,
        covariance=covariance,
        degrees_of_freedom=dof,
        reduced_chi2=float(chi2),
        iterations=evaluations,
        converged=not failed,
        message="; ".join(failed) or f"converged after {evaluations} evaluations",
        warnings=tuple(warnings_of(task, legs, outliers, ties, lost, dof, float(chi2))),
        loss=task.loss,
        outliers=outliers,
        shift=_shift(estimate.fits),
        external=_external(task, estimate, outer),
        gauge=() if estimate.gauge is None else estimate.gauge.words,
        gauge_directions=None if estimate.gauge is None else estimate.gauge.of_legs,
        frames_moved=None if estimate.gauge is None else estimate.gauge.frames,
        undetermined=lost,
        undetermined_directions=held.of_legs if held is not None and lost else None,
        ties=ties,
        observed=() if latent is None else _observed(task, latent, fits[0]),
        estimated_poses=None
        if latent is None
        else mechanism.platform.from_matrices(fits[0].last.state.matrices),
    )
    first = (*causes(task, result), *misaligned(task, result), *unequal_noise(task, estimate))
    return replace(result, warnings=(*first, *result.warnings))


def _leg_results(task: Task, one: Robust, std: dict[str, Array]) -> list[LegResult]:
    """Return the results of the legs of a fit."""
    found, problem = one.fit, one.fit.problem
    results = []
    for index, (leg, columns) in enumerate(zip(problem.legs, problem.columns, strict=True)):
        own = problem.used[:, index] & (found.weights > 0.0)
        before = problem.leg_residual(found.first, index)
        after = problem.leg_residual(found.last, index)
        rank, condition = found.ranks[index]
        values = after.value[own]
        results.append(
            LegResult(
                name=leg.name,
                parameters=tuple(
                    _parameters(
                        task,
                        found,
                        leg.parameter_names,
                        [leg.units[name] for name in leg.parameter_names],
                        leg.nominal,
                        found.parameters[columns],
                        std[leg.name],
                        [_given(task, leg.name, name) for name in leg.parameter_names],
                    )
                ),
                rank=rank,
                condition=condition,
                rms_before=_rms(before.value[own]),
                rms_after=_rms(values),
                unit=after.unit,
                n_residuals=values.size,
                sigma=after.sigma[own].ravel(),
                rows=np.repeat(one.rows[own], values.shape[1]),
                residuals_before=before.value[own].ravel(),
                residuals=values.ravel(),
            )
        )
    return results


def _parameters(
    task: Task,
    found: Fit,
    names: Sequence[str],
    units: Sequence[str],
    nominal: Array,
    values: Array,
    std: Array,
    given: Sequence[str] = (),
) -> list[IdentifiedParameter]:
    """Return parameters with their 95 % intervals."""
    half = (1 + _CONFIDENCE) / 2
    known = task.noise.known
    quantile = float(ndtri(half) if known else stdtrit(found.degrees_of_freedom, half))
    return [
        IdentifiedParameter(
            name=name,
            unit=unit,
            nominal=float(start),
            identified=float(value),
            std=float(error),
            low=float(value - quantile * error),
            high=float(value + quantile * error),
            given=said,
        )
        for name, unit, start, value, error, said in zip(
            names, units, nominal, values, std, given or [""] * len(names), strict=True
        )
    ]


def _given(task: Task, leg: str, name: str) -> str:
    """Return what was said of a parameter beforehand."""
    said = {"fixed": task.fixed, "tied": task.tied, "prior": task.priors}
    kinds = [kind for kind, names in said.items() if {name, f"{leg}.{name}"} & set(names)]
    return "fixed" if "fixed" in kinds else ", ".join(kinds)


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean())) if len(values) else np.nan


def _external(
    task: Task, estimate: Estimate, outer: Array | None
) -> tuple[IdentifiedParameter, ...]:
    """Return frame and targets with their intervals."""
    outside, external = estimate.outside, estimate.external
    if outside is None or external is None or outer is None or not len(outside):
        return ()
    start, values = (outside.coordinates(one) for one in (outside.start, external))
    D = outside.coordinates_by_step(external)
    std = np.sqrt(np.diagonal(D @ outer @ D.T))
    found = estimate.fits[0].fit
    return tuple(_parameters(task, found, outside.names, outside.units, start, values, std))


def _sizes(task: Task) -> list[int]:
    return [len(leg.parameters) for leg in task.mechanism.legs]


def _observed(task: Task, latent: LatentPoses, found: Fit) -> tuple[Observed, ...]:
    """Return how the measured quantities of the platform fit."""
    scale = (
        1.0 if task.noise.known else float(np.sqrt(found.chi2 / max(found.degrees_of_freedom, 1)))
    )
    seen = latent.observation
    before, values = (
        seen.evaluate(state.matrices, state.external).value
        for state in (_nominal(task, latent, found.first.state), found.last.state)
    )
    results = []
    for column, (name, unit) in enumerate(zip(seen.names, seen.units, strict=True)):
        own = seen.measured[:, column] & (found.weights > 0.0)
        if own.any():
            sigmas, after = scale * latent.sigma_observed[own, column], values[own, column]
            results.append(
                Observed(
                    name=name,
                    unit=unit,
                    count=int(own.sum()),
                    rms=_rms(after),
                    sigma=_rms(sigmas),
                    rows=np.flatnonzero(own),
                    sigmas=sigmas,
                    residuals_before=before[own, column],
                    residuals=after,
                )
            )
    return tuple(results)


def _nominal(task: Task, latent: LatentPoses, first: State) -> State:
    """Return the state before the fit with poses where exact readings put them.

    Where readings carry noise, residuals of them are shown in place of those of the platform, and
    poses stay where the search began.
    """
    if task.noise.readings.any():
        return first
    legs = [LegClosure(leg, task.mechanism.platform) for leg in task.mechanism.legs]
    there = placed_by_arm(task.mechanism, legs, latent.readings)
    return settle(latent, first) if there is None else replace(first, matrices=there)


def _merged(outliers: Sequence[Outlier]) -> tuple[Outlier, ...]:
    """Return outliers of all fits, one for each row, the worst first."""
    rows: dict[int, Outlier] = {}
    for one in sorted(outliers, key=lambda o: -o.sigma):
        worst = rows.setdefault(one.row, one)
        if worst is not one:
            legs = (*worst.legs, *one.legs)
            rows[one.row] = replace(worst, legs=legs, weight=min(worst.weight, one.weight))
    return tuple(rows.values())


def _shift(fits: Sequence[Robust]) -> float | None:
    """Return by how many standard errors parameters would move without the loss, at most."""
    shifts = []
    for one in fits:
        if one.plain is None:
            return None
        n = len(one.fit.parameters)
        std = np.sqrt(np.diagonal(one.fit.covariance))[:n]
        moved = np.abs(one.plain.parameters - one.fit.parameters)
        shifts.append((moved[std > 0.0] / std[std > 0.0]).max(initial=0.0))
    return float(max(shifts))
