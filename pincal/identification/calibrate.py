"""Calibration: parameters of all legs from measured poses and readings.

Per leg (the papers' divide and conquer) or all legs together, on whitened closure
residuals or on the papers' joint residuals.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainc, ndtri, stdtrit

from pincal.errors import MeasurementError, ObservabilityError
from pincal.identification.fit import Fit, fit
from pincal.identification.plausibility import check_noise, check_plausible
from pincal.identification.problem import Problem
from pincal.identification.residuals import LegResidual, Residual
from pincal.identification.result import CalibrationResult, IdentifiedParameter, LegResult
from pincal.model.measurements import Measurements, Noise
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Method = Literal["per-leg", "together"]
_CONFIDENCE = 0.95
_OUTLYING = 5.0  # standard deviations from which a residual is pointed out
_UNLIKELY = 1e-4  # probability of a χ² at which the noise as given is doubted


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
        MeasurementError: measurements that cannot be this mechanism's; noise that is given
            twice, or leaves a residual without any; the joint residual out of reach.
    """
    _check_shapes(mechanism, measurements)
    sigmas, source = _sigmas(mechanism, measurements, noise)
    known = source != "assumed"
    used = _used(mechanism, measurements, poses, known)
    if noise is not None:
        check_noise(mechanism, noise)
    check_plausible(mechanism, measurements)
    shake = sigmas[0] * np.random.default_rng(0).standard_normal(sigmas[0].shape)
    shaken = replace(measurements, poses=mechanism.platform.moved(measurements.poses, shake))
    everything = list(range(len(mechanism.legs)))
    fits = []
    for group in [everything] if method == "together" else [[i] for i in everything]:
        if progress:
            progress(f"identifying {', '.join(mechanism.leg_names[i] for i in group)}")
        problem, again = (
            _problem(mechanism, data, sigmas, group, used, residual)
            for data in (measurements, shaken)
        )
        fits.append(fit(problem, again, weighted=residual == "closure", known=known))
    return _assemble(mechanism, fits, used, method, residual, poses, noise, source)


def _problem(
    mechanism: Mechanism,
    data: Measurements,
    sigmas: tuple[Array, Array],
    group: list[int],
    used: Mask,
    kind: Residual,
) -> Problem:
    """Return the problem of some legs at the poses that serve one of them."""
    rows = np.flatnonzero(used[:, group].any(axis=1))
    matrices = mechanism.platform.transforms(data.poses[rows]).as_matrix()
    residuals = [
        LegResidual(
            mechanism.legs[i], mechanism.platform, matrices, data.readings[rows, i], kind, rows
        )
        for i in group
    ]
    return Problem(residuals, used[rows][:, group], sigmas[0][rows], sigmas[1][rows][:, group])


def _sigmas(
    mechanism: Mechanism, data: Measurements, noise: Noise | None
) -> tuple[tuple[Array, Array], str]:
    """Return standard deviations of poses (N, dof) and readings (N, n_legs), and where from.

    Raises:
        MeasurementError: given twice, or rows that give them for readings only.
    """
    if data.sigma_poses is None and data.sigma_readings is not None:
        raise MeasurementError(
            "the measurements give standard deviations of readings but none of poses; add columns "
            + ", ".join(f"'sigma_{name}'" for name in mechanism.platform.coordinates)
        )
    if data.sigma_poses is not None:
        if noise is not None:
            raise MeasurementError(
                "the measurements have columns of standard deviations, and the noise is given as "
                "well; leave out one of them"
            )
        exact = np.zeros(data.readings.shape)
        readings = exact if data.sigma_readings is None else data.sigma_readings
        return (data.sigma_poses, readings), "rows"
    one = noise or Noise()
    poses = np.tile(one.of_poses(mechanism), (len(data), 1))
    readings = np.full(data.readings.shape, one.reading)
    return (poses, readings), "assumed" if noise is None else "given"


def _assemble(
    mechanism: Mechanism,
    fits: list[Fit],
    used: Mask,
    method: str,
    residual: str,
    poses: str,
    noise: Noise | None,
    source: str,
) -> CalibrationResult:
    """Return the result of all legs from one fit of all, or one fit each."""
    legs = tuple(
        leg for one in fits for leg in _leg_results(mechanism, one, used, source != "assumed")
    )
    sizes = [len(one.covariance) for one in fits]
    covariance = np.zeros((sum(sizes), sum(sizes)))
    begin = 0
    for one, size in zip(fits, sizes, strict=True):
        covariance[begin : begin + size, begin : begin + size] = one.covariance
        begin += size
    dof = sum(one.degrees_of_freedom for one in fits)
    chi2 = sum(one.chi2 for one in fits) / dof if dof else np.nan
    if source == "assumed":
        scale = float(np.sqrt(chi2))
        noise = Noise(*(scale * value for value in vars(Noise()).values()))
    failed = [one.message for one in fits if not one.converged]
    iterations = sum(one.evaluations for one in fits)
    return CalibrationResult(
        nominal=mechanism,
        identified=mechanism.with_parameters({leg.name: leg.identified for leg in legs}),
        legs=legs,
        method=method,
        residual=residual,
        poses=poses,
        noise=noise,
        noise_source="estimated" if source == "assumed" else source,
        covariance=covariance,
        degrees_of_freedom=dof,
        reduced_chi2=float(chi2),
        iterations=iterations,
        converged=not failed,
        message="; ".join(failed) or f"converged after {iterations} evaluations",
        warnings=tuple(_warnings(mechanism, legs, source, dof, float(chi2))),
    )


def _leg_results(mechanism: Mechanism, one: Fit, used: Mask, known: bool) -> list[LegResult]:
    """Return the results of the legs of a fit."""
    problem, m = one.problem, len(one.problem.legs)
    half = (1 + _CONFIDENCE) / 2
    quantile = float(ndtri(half) if known else stdtrit(one.degrees_of_freedom, half))
    before, after = problem.values(one.start), problem.values(one.parameters)
    sigma = np.sqrt(problem.covariance(one.parameters)[:, range(m), range(m)])
    std = np.sqrt(np.diagonal(one.covariance))
    results = []
    for index, (leg, columns) in enumerate(zip(problem.legs, problem.columns, strict=True)):
        own = problem.used[:, index]
        parameters = tuple(
            IdentifiedParameter(
                name=name,
                unit=leg.units[name],
                nominal=float(nominal),
                identified=float(value),
                std=float(error),
                low=float(value - quantile * error),
                high=float(value + quantile * error),
            )
            for name, nominal, value, error in zip(
                leg.parameter_names,
                leg.nominal,
                one.parameters[columns],
                std[columns],
                strict=True,
            )
        )
        rank, condition = one.ranks[index]
        results.append(
            LegResult(
                name=leg.name,
                parameters=parameters,
                rank=rank,
                condition=condition,
                rms_before=float(np.sqrt((before[own, index] ** 2).mean())),
                rms_after=float(np.sqrt((after[own, index] ** 2).mean())),
                n_residuals=int(own.sum()),
                sigma=sigma[own, index],
                rows=np.flatnonzero(used[:, mechanism.leg_names.index(leg.name)]),
                residuals=after[own, index],
            )
        )
    return results


def _warnings(
    mechanism: Mechanism, legs: tuple[LegResult, ...], source: str, dof: int, chi2: float
) -> list[str]:
    """Return what the reader of a result should know first."""
    found = []
    if source == "assumed":
        turns = "rad" in mechanism.platform.units
        found.append(
            "the noise was not given: "
            + (
                "equal standard deviations of position [m] and orientation [rad] were"
                if turns
                else "exact readings were"
            )
            + " assumed, and the scale estimated from the residuals"
        )
    elif dof and not _UNLIKELY <= gammainc(dof / 2, dof * chi2 / 2) <= 1.0 - _UNLIKELY:
        found.append(
            f"reduced χ² is {chi2:.3g} where 1 is expected: the noise is "
            f"{'larger' if chi2 > 1 else 'smaller'} than given, or the model lacks something; the "
            "uncertainties assume the noise as given"
        )
    scale = np.sqrt(chi2) if source == "assumed" else 1.0
    for leg in legs:
        off = np.abs(leg.residuals) / (scale * leg.sigma) if scale > 0.0 else np.zeros(1)
        worst = int(np.argmax(off))
        if off[worst] > _OUTLYING:
            found.append(
                f"{leg.name}: the residual of data row {leg.rows[worst] + 1} is {off[worst]:.1f} "
                "standard deviations; look at this measurement (residuals.csv has all)"
            )
    found += [
        f"{leg.name}: {leg.n_residuals} poses for {len(leg.parameters)} parameters; two or three "
        "times as many poses as parameters are advised"
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


def _check_shapes(mechanism: Mechanism, data: Measurements) -> None:
    expected = ((len(data), mechanism.platform.dof), (len(data), len(mechanism.legs)))
    if (data.poses.shape, data.readings.shape) != expected:
        raise MeasurementError(
            f"poses {data.poses.shape} and readings {data.readings.shape} do not fit "
            f"{mechanism.name!r}; expected {expected[0]} and {expected[1]}"
        )
    if not (np.isfinite(data.poses).all() and np.isfinite(data.readings).all()):
        raise MeasurementError("a measured pose or reading is not a finite number")
