"""Calibration: parameters of all legs from measured poses and readings.

Per leg (the papers' divide and conquer) or all legs together, on whitened closure
residuals or on the papers' joint residuals. A first search at the nominal weights is
followed by Gauss-Newton steps that renew the weights (feasible generalised least
squares) until no step is left, so at the optimum Jᵀ W r = 0 with W at the optimum.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import gammainc, ndtri, stdtrit

from pincal.errors import MeasurementError, ObservabilityError
from pincal.experiment.observability import identifiability
from pincal.identification.plausibility import check_plausible
from pincal.identification.problem import Problem
from pincal.identification.residuals import LegResidual, Residual
from pincal.identification.result import CalibrationResult, IdentifiedParameter, LegResult
from pincal.model.leg import Leg
from pincal.model.measurements import Measurements, Noise
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Method = Literal["per-leg", "together"]
_PRECISION = 1e-8  # of cost and step in the first search
_STANDS = 1e-8  # of a standard error: no step is left, with the weights renewed
_ROUNDS = 30
_UNLIKELY = 1e-4  # probability of a χ² at which the noise as given is doubted
_CONFIDENCE = 0.95


def calibrate(
    mechanism: Mechanism,
    measurements: Measurements,
    *,
    method: Method = "per-leg",
    residual: Residual = "closure",
    poses: Literal["own", "all"] = "own",
    noise: Noise | None = None,
    progress: Callable[[str], None] | None = None,
) -> CalibrationResult:
    """Return the identified parameters of a mechanism, with uncertainties.

    Args:
        mechanism: The nominal mechanism, where the search starts.
        measurements: Measured poses and readings.
        method: ``"per-leg"`` identifies each leg alone; ``"together"`` all legs at once,
            using that residuals at one pose share its noise.
        residual: ``"closure"``, whitened, or ``"joint"``, as the papers have it, unweighted.
        poses: ``"own"`` uses for each leg the poses chosen for it (their ``set``), ``"all"``
            every pose for every leg.
        noise: Standard deviations of the measurements. If neither this nor the measurements
            say them, equal ones of position and orientation are assumed and their scale
            is estimated from the residuals.
        progress: Called with what is being done.

    Raises:
        ObservabilityError: too few poses, or poses that leave parameters undetermined.
        MeasurementError: measurements that cannot be this mechanism's; noise that leaves a
            residual without any; the joint residual out of reach.
    """
    _check_shapes(mechanism, measurements)
    known = noise is not None or measurements.sigma_poses is not None
    noise = noise or Noise()
    used = _used(mechanism, measurements, poses, known)
    check_plausible(mechanism, measurements)
    matrices = mechanism.platform.transforms(measurements.poses).as_matrix()
    sigma_poses, sigma_readings = _sigmas(mechanism, measurements, noise)
    fits = []
    everything = list(range(len(mechanism.legs)))
    for group in [everything] if method == "together" else [[i] for i in everything]:
        legs = [mechanism.legs[i] for i in group]
        if progress:
            progress(f"identifying {', '.join(leg.name for leg in legs)}")
        rows = used[:, group].any(axis=1)
        parts = [
            LegResidual(
                leg,
                mechanism.platform,
                matrices[rows],
                measurements.readings[rows, i],
                residual,
                np.flatnonzero(rows),
            )
            for leg, i in zip(legs, group, strict=True)
        ]
        problem = Problem(
            parts, used[rows][:, group], sigma_poses[rows], sigma_readings[rows][:, group]
        )
        fits.append(_fit(problem, legs, np.flatnonzero(rows), residual, known))
    return _assemble(mechanism, fits, method, residual, poses, noise, known)


@dataclass(frozen=True)
class _Fit:
    legs: list[LegResult]
    covariance: Array
    chi2: float
    degrees_of_freedom: int
    iterations: int
    converged: bool
    message: str


def _fit(
    problem: Problem, legs: list[Leg], rows: NDArray[np.intp], kind: Residual, known: bool
) -> _Fit:
    """Return the least-squares fit of a problem, from the nominal parameters."""
    start = np.concatenate([leg.nominal for leg in legs])
    _check_rank(problem, problem.whitener(start), start, legs)
    weighted = kind == "closure"
    parameters, evaluations = _minimise(
        problem, problem.whitener(start) if weighted else None, start
    )
    for _ in range(_ROUNDS):
        whitener = problem.whitener(parameters)
        weigh = whitener if weighted else None
        covariance, ranks = _covariance(problem, whitener, parameters, legs, weighted=weighted)
        step = _gauss_newton_step(problem, weigh, parameters)
        decrement = float(np.abs(step / np.sqrt(np.diagonal(covariance))).max())
        if decrement <= _STANDS:
            break
        parameters = parameters + step
        evaluations += 1
    converged = decrement <= _STANDS
    message = (
        f"converged after {evaluations} evaluations"
        if converged
        else f"not converged after {evaluations} evaluations: the next step would be "
        f"{decrement:.2g} standard errors"
    )
    white = _weighed(problem.values(parameters)[:, :, None], whitener, problem.used)[:, 0]
    dof = len(white) - problem.n_params
    chi2 = float(white @ white)
    if not known and dof > 0:
        covariance = covariance * chi2 / dof
    quantile = float(ndtri((1 + _CONFIDENCE) / 2) if known else stdtrit(dof, (1 + _CONFIDENCE) / 2))
    results = _leg_results(problem, legs, rows, parameters, start, covariance, quantile, ranks)
    return _Fit(results, covariance, chi2, dof, evaluations, converged, message)


def _minimise(problem: Problem, weigh: Array | None, start: Array) -> tuple[Array, int]:
    """Return the parameters of least squares at fixed weights, and the number of evaluations.

    Levenberg-Marquardt (MINPACK) stops where the cost no longer falls, half the digits short.
    """
    solution = least_squares(
        lambda p: _weighed(problem.values(p)[:, :, None], weigh, problem.used)[:, 0],
        start,
        jac=lambda p: _weighed(problem.jacobian(p), weigh, problem.used),
        method="lm",
        x_scale="jac",
        **dict.fromkeys(("ftol", "xtol", "gtol"), _PRECISION),
    )
    return solution.x, int(solution.nfev)


def _gauss_newton_step(problem: Problem, weigh: Array | None, parameters: Array) -> Array:
    r = _weighed(problem.values(parameters)[:, :, None], weigh, problem.used)[:, 0]
    J = _weighed(problem.jacobian(parameters), weigh, problem.used)
    scale = np.linalg.norm(J, axis=0)
    return np.asarray(-np.linalg.lstsq(J / scale, r, rcond=None)[0] / scale)


def _weighed(values: Array, weigh: Array | None, used: Mask) -> Array:
    """Return values of shape (N, m, k) times weights (N, m, m), the rows in use: (n_rows, k)."""
    return (values if weigh is None else weigh @ values)[used]


def _covariance(
    problem: Problem, whitener: Array, parameters: Array, legs: list[Leg], *, weighted: bool
) -> tuple[Array, list[tuple[int, float]]]:
    """Return the covariance of the estimate, and rank and condition of each leg.

    Whitened least squares: (Jᵀ V⁻¹ J)⁻¹. Unweighted: (JᵀJ)⁻¹ Jᵀ V J (JᵀJ)⁻¹, with V the
    modelled covariance of the residuals.
    """
    ranks = _check_rank(problem, whitener, parameters, legs)
    J = problem.jacobian(parameters)
    if weighted:
        return _inverse_gram(_weighed(J, whitener, problem.used)), ranks
    bread = _inverse_gram(J[problem.used])
    spread = problem.covariance(parameters)
    meat = np.einsum("nip,nij,njq->pq", J, spread, J)
    return bread @ meat @ bread, ranks


def _inverse_gram(J: Array) -> Array:
    """Return (JᵀJ)⁻¹ by QR of the scaled columns."""
    scale = np.linalg.norm(J, axis=0)
    R = np.linalg.qr(J / scale, mode="r")
    inverse = np.linalg.inv(R)
    return (inverse @ inverse.T) / np.outer(scale, scale)


def _check_rank(
    problem: Problem, whitener: Array, parameters: Array, legs: list[Leg]
) -> list[tuple[int, float]]:
    """Return rank and condition of each leg's whitened Jacobian.

    Raises:
        ObservabilityError: a parameter is not determined.
    """
    J = problem.jacobian(parameters)
    found = []
    for index, (leg, columns) in enumerate(zip(legs, problem.columns, strict=True)):
        weights = whitener[:, index, index, None]
        own = (weights * J[:, index, columns])[problem.used[:, index]]
        if not np.isfinite(own).all():
            raise MeasurementError(
                f"{leg.name}: a residual or its derivative is not finite at some measured pose; "
                "the leg may be folded or stretched there"
            )
        one = identifiability(own, leg.parameter_names)
        if not one.complete:
            raise ObservabilityError(
                f"the measured poses leave parameters undetermined: {one.in_words(leg.name)} "
                f"(rank {one.rank} of {one.n_params}). Measure poses that tell them apart, or make "
                "one of them a constant in mechanism.yaml"
            )
        found.append((one.rank, one.condition))
    return found


def _leg_results(
    problem: Problem,
    legs: list[Leg],
    rows: NDArray[np.intp],
    parameters: Array,
    start: Array,
    covariance: Array,
    quantile: float,
    ranks: list[tuple[int, float]],
) -> list[LegResult]:
    before, after = problem.values(start), problem.values(parameters)
    m = len(legs)
    sigma = np.sqrt(problem.covariance(parameters)[:, range(m), range(m)])
    std = np.sqrt(np.diagonal(covariance))
    results = []
    for index, (leg, columns, (rank, condition)) in enumerate(
        zip(legs, problem.columns, ranks, strict=True)
    ):
        own = problem.used[:, index]
        values = zip(
            leg.parameter_names, leg.nominal, parameters[columns], std[columns], strict=True
        )
        results.append(
            LegResult(
                name=leg.name,
                parameters=tuple(
                    IdentifiedParameter(
                        name,
                        leg.units[name],
                        float(nominal),
                        float(value),
                        float(error),
                        float(value - quantile * error),
                        float(value + quantile * error),
                    )
                    for name, nominal, value, error in values
                ),
                rank=rank,
                condition=condition,
                rms_before=float(np.sqrt((before[own, index] ** 2).mean())),
                rms_after=float(np.sqrt((after[own, index] ** 2).mean())),
                n_residuals=int(own.sum()),
                sigma=sigma[own, index],
                rows=rows[own],
                residuals=after[own, index],
            )
        )
    return results


def _assemble(
    mechanism: Mechanism,
    fits: list[_Fit],
    method: str,
    residual: str,
    poses: str,
    noise: Noise,
    known: bool,
) -> CalibrationResult:
    legs = tuple(leg for fit in fits for leg in fit.legs)
    sizes = [len(fit.covariance) for fit in fits]
    covariance = np.zeros((sum(sizes), sum(sizes)))
    begin = 0
    for fit, size in zip(fits, sizes, strict=True):
        covariance[begin : begin + size, begin : begin + size] = fit.covariance
        begin += size
    dof = sum(fit.degrees_of_freedom for fit in fits)
    chi2 = sum(fit.chi2 for fit in fits) / dof if dof else np.nan
    failed = [fit.message for fit in fits if not fit.converged]
    iterations = sum(fit.iterations for fit in fits)
    return CalibrationResult(
        nominal=mechanism,
        identified=mechanism.with_parameters({leg.name: leg.identified for leg in legs}),
        legs=legs,
        method=method,
        residual=residual,
        poses=poses,
        noise=noise,
        noise_known=known,
        covariance=covariance,
        degrees_of_freedom=dof,
        reduced_chi2=float(chi2),
        iterations=iterations,
        converged=not failed,
        message="; ".join(failed) or f"converged after {iterations} evaluations",
        warnings=tuple(_warnings(legs, known, dof, float(chi2))),
    )


def _warnings(legs: tuple[LegResult, ...], known: bool, dof: int, chi2: float) -> list[str]:
    found = []
    if not known:
        found.append(
            "the noise was not given: equal standard deviations of position [m] and orientation "
            "[rad] were assumed and their scale estimated from the residuals"
        )
    elif dof and not _UNLIKELY <= gammainc(dof / 2, dof * chi2 / 2) <= 1.0 - _UNLIKELY:
        found.append(
            f"reduced χ² is {chi2:.3g} where 1 is expected: the noise is "
            f"{'larger' if chi2 > 1 else 'smaller'} than given, or the model lacks something; the "
            "uncertainties assume the noise as given"
        )
    found += [
        f"{leg.name}: {leg.n_residuals} poses for {len(leg.parameters)} parameters; two or "
        "three times as many poses as parameters are advised"
        for leg in legs
        if leg.n_residuals < 1.5 * len(leg.parameters)
    ]
    return found


def _used(mechanism: Mechanism, data: Measurements, poses: str, known: bool) -> Mask:
    """Return which poses serve which leg, shape (N, n_legs).

    Raises:
        ObservabilityError: too few poses for a leg.
    """
    if poses == "all":
        used = np.ones(data.readings.shape, dtype=bool)
    else:
        used = np.stack([data.serves(name) for name in mechanism.leg_names], axis=1)
    for leg, count in zip(mechanism.legs, used.sum(axis=0), strict=True):
        n = len(leg.parameters)
        least = n if known else n + 1
        if count < least:
            why = "" if known else " and the scale of the noise"
            raise ObservabilityError(
                f"{leg.name}: {count} measured poses for {n} parameters{why}; at least {least} are "
                f"needed, {2 * n} or more advised"
                + ("" if poses == "all" else ". --poses all uses every pose for every leg")
            )
    return used


def _sigmas(mechanism: Mechanism, data: Measurements, noise: Noise) -> tuple[Array, Array]:
    """Return standard deviations of coordinates (N, dof) and readings (N, n_legs)."""
    poses, readings = data.sigma_poses, data.sigma_readings
    if poses is None:
        poses = np.tile(noise.of_poses(mechanism), (len(data), 1))
    if readings is None:
        readings = np.full(data.readings.shape, noise.reading)
    return poses, readings


def _check_shapes(mechanism: Mechanism, data: Measurements) -> None:
    expected = ((len(data), mechanism.platform.dof), (len(data), len(mechanism.legs)))
    if (data.poses.shape, data.readings.shape) != expected:
        raise MeasurementError(
            f"poses {data.poses.shape} and readings {data.readings.shape} do not fit "
            f"{mechanism.name!r}; expected {expected[0]} and {expected[1]}"
        )
    if not (np.isfinite(data.poses).all() and np.isfinite(data.readings).all()):
        raise MeasurementError("a measured pose or reading is not a finite number")
