"""The fit of one problem: search, refinement with renewed weights, covariance.

A first search at the nominal weights (Levenberg-Marquardt) is followed by Gauss-Newton
steps that renew the weights until no step is left (feasible generalised least squares),
so at the optimum Jᵀ W r = 0 with W at the optimum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from pincal.identification.determined import check_information, check_rank
from pincal.identification.problem import Problem

Array = NDArray[np.float64]
_PRECISION = 1e-8  # of cost and step in the first search
_STANDS = 1e-8  # of a standard error: no step is left, with the weights renewed
_ROUNDS = 30


@dataclass(frozen=True)
class Fit:
    """Optimum of a problem, and what is known about it."""

    problem: Problem
    start: Array
    """Nominal parameters, shape (n_params,)."""
    parameters: Array
    """Identified parameters, shape (n_params,)."""
    covariance: Array
    """Shape (n_params, n_params); scaled by χ² if the noise was assumed."""
    ranks: list[tuple[int, float]]
    """Rank and condition of each leg."""
    chi2: float
    degrees_of_freedom: int
    evaluations: int
    converged: bool
    message: str


def fit(problem: Problem, shaken: Problem, *, weighted: bool, known: bool) -> Fit:
    """Return the least-squares fit of a problem, from the nominal parameters.

    Args:
        problem: Residuals of some legs.
        shaken: The same with poses shaken by their noise; tells what noise alone makes.
        weighted: Whitened residuals, or unweighted ones.
        known: Whether the scale of the noise is known.

    Raises:
        ObservabilityError: parameters are not determined, or by the noise only.
        MeasurementError: residuals that do not exist, or have no noise.
    """
    start = np.concatenate([leg.nominal for leg in problem.legs])
    whitener = problem.whitener(start)
    check_rank(problem, whitener, start)
    if known:
        check_information(problem, shaken, start)
    parameters, evaluations = _minimise(problem, whitener if weighted else None, start)
    for _ in range(_ROUNDS):
        whitener = problem.whitener(parameters)
        ranks = check_rank(problem, whitener, parameters)
        covariance = _covariance(problem, whitener, parameters, weighted=weighted)
        step = _gauss_newton_step(problem, whitener if weighted else None, parameters)
        decrement = float(np.abs(step / np.sqrt(np.diagonal(covariance))).max())
        if decrement <= _STANDS:
            break
        parameters = parameters + step
        evaluations += 1
    converged = decrement <= _STANDS
    white = weighed(problem.values(parameters)[:, :, None], whitener, problem.used)[:, 0]
    dof = len(white) - problem.n_params
    chi2 = float(white @ white)
    if not known:
        scale = float(np.sqrt(chi2 / dof)) if converged else 1.0
        check_information(problem, shaken, parameters if converged else start, scale)
        covariance = covariance * chi2 / dof
    message = (
        f"converged after {evaluations} evaluations"
        if converged
        else f"not converged after {evaluations} evaluations: the next step would be "
        f"{decrement:.2g} standard errors"
    )
    return Fit(
        problem, start, parameters, covariance, ranks, chi2, dof, evaluations, converged, message
    )


def weighed(values: Array, weigh: Array | None, used: NDArray[np.bool_]) -> Array:
    """Return values of shape (N, m, k) times weights (N, m, m), the rows in use: (n_rows, k)."""
    return (values if weigh is None else weigh @ values)[used]


def _minimise(problem: Problem, weigh: Array | None, start: Array) -> tuple[Array, int]:
    """Return the parameters of least squares at fixed weights, and the number of evaluations.

    Levenberg-Marquardt (MINPACK) stops where the cost no longer falls, half the digits short.
    """
    solution = least_squares(
        lambda p: weighed(problem.values(p)[:, :, None], weigh, problem.used)[:, 0],
        start,
        jac=lambda p: weighed(problem.jacobian(p), weigh, problem.used),
        method="lm",
        x_scale="jac",
        **dict.fromkeys(("ftol", "xtol", "gtol"), _PRECISION),
    )
    return solution.x, int(solution.nfev)


def _gauss_newton_step(problem: Problem, weigh: Array | None, parameters: Array) -> Array:
    r = weighed(problem.values(parameters)[:, :, None], weigh, problem.used)[:, 0]
    J = weighed(problem.jacobian(parameters), weigh, problem.used)
    scale = np.linalg.norm(J, axis=0)
    return np.asarray(-np.linalg.lstsq(J / scale, r, rcond=None)[0] / scale)


def _covariance(problem: Problem, whitener: Array, parameters: Array, *, weighted: bool) -> Array:
    """Return the covariance of the estimate.

    Whitened least squares: (Jᵀ V⁻¹ J)⁻¹. Unweighted: (JᵀJ)⁻¹ Jᵀ V J (JᵀJ)⁻¹, with V the
    modelled covariance of the residuals.
    """
    J = problem.jacobian(parameters)
    if weighted:
        return _inverse_gram(weighed(J, whitener, problem.used))
    bread = _inverse_gram(J[problem.used])
    spread = problem.covariance(parameters)
    meat = np.einsum("nip,nij,njq->pq", J, spread, J)
    return bread @ meat @ bread


def _inverse_gram(J: Array) -> Array:
    """Return (JᵀJ)⁻¹ by QR of the scaled columns."""
    scale = np.linalg.norm(J, axis=0)
    inverse = np.linalg.inv(np.linalg.qr(J / scale, mode="r"))
    return (inverse @ inverse.T) / np.outer(scale, scale)
