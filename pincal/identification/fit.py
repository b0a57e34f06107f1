"""The fit of one problem: search, refinement with renewed weights, covariance.

A damped search (Levenberg-Marquardt) comes near; Gauss-Newton steps that renew all weights go
on until no step is left (feasible generalised least squares), so at the optimum Jᵀ W r = 0
with W at the optimum.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pincal.errors import ObservabilityError
from pincal.identification.determined import check_information, check_rank
from pincal.identification.losses import Loss, outlying, robust_scale
from pincal.identification.problem import Linear, Problem, State
from pincal.identification.unknowns import Unknowns

Array = NDArray[np.float64]
_NEAR = 0.1  # of a standard error: the search ends
_STALLS = 1e-12  # relative fall of the cost at which the search ends
_STEPS = 300  # of the search
_STANDS = 1e-9  # of a standard error: no step is left, with the weights renewed
_ROUNDED = 1e-7  # of a standard error: steps that shrink no more are rounding errors
_STANDS_ROBUST = 1e-6  # weights of rows follow their residuals: convergence is slower
_ROUNDS = 30
_LEAST_DAMPING = 1e-6
_ROUNDING = 1e-15  # of a parameter: steps below are none
_LARGEST_DAMPING = 1e10
_LIGHT = 1e-3  # damping that hardly shortens a step


@dataclass(frozen=True)
class Fit:
    """Optimum of a problem, and what is known about it."""

    problem: Problem
    unknowns: Unknowns
    first: Linear
    """Residuals at the start."""
    last: Linear
    """Residuals at the optimum."""
    weights: Array
    """Of the rows, 1 without a robust loss, shape (N,)."""
    scale: float
    """Of the noise, as a robust loss estimates it; 1 without."""
    covariance: Array
    """Of all unknowns, shape (n, n); scaled by χ² if the noise was assumed."""
    ranks: list[tuple[int, float]]
    """Rank and condition of each leg."""
    chi2: float
    degrees_of_freedom: int
    evaluations: int
    converged: bool
    message: str
    known: bool
    """Whether the scale of the noise is known; else the covariance is scaled by χ²."""

    @property
    def parameters(self) -> Array:
        """Identified parameters of the legs, shape (n_params,)."""
        return self.last.state.parameters


def fit(
    problem: Problem,
    unknowns: Unknowns,
    *,
    known: bool,
    loss: Loss | None = None,
    kept: NDArray[np.bool_] | None = None,
    start: State | None = None,
    tell: Callable[[str], None] | None = None,
    ran_away: Callable[[ObservabilityError], None] | None = None,
) -> Fit:
    """Return the least-squares fit of a problem.

    Args:
        problem: Residuals of some legs.
        unknowns: What is free, and priors.
        known: Whether the scale of the noise is known.
        loss: A robust loss, or none.
        kept: Rows that take part, shape (N,); all if not given.
        start: Where the search starts; the nominal parameters if not given.
        tell: Called with what is being done.
        ran_away: Called if the rank is lost where the search ended; may raise what says more.

    Raises:
        ObservabilityError: parameters are not determined, or by the noise only.
        MeasurementError: residuals that do not exist, or have no noise.
    """
    start = start or problem.start(unknowns.start[: problem.columns[-1].stop])
    eased = problem.eased()
    first = eased.linearise(start)
    system = _System(problem, unknowns, known, loss, kept)
    easy = replace(system, problem=eased)
    check_rank(problem, unknowns, first)
    near, evaluations = _search(easy, first, tell)
    linear = near if easy.problem is problem else problem.linearise(near.state)
    if known:  # where the search starts, a pose may be nearer to a singularity than it is
        check_information(problem, unknowns, (first, linear))
    stands, decrement = (_STANDS if loss is None else _STANDS_ROBUST), np.inf
    for _ in range(_ROUNDS if loss is None else 10 * _ROUNDS):
        weights, scale = system.weights(linear)
        step, std = system.step(linear, weights)
        rounding = _ROUNDING * np.abs(unknowns.map).T @ system.size(linear.state)
        last, decrement = decrement, float(((np.abs(step) - rounding) / std).max())
        if decrement <= stands or last / 2 < decrement <= _ROUNDED:  # no smaller but by chance
            stands = max(stands, decrement)
            break
        linear = problem.linearise(problem.moved(linear, unknowns.map @ step))
        evaluations += 1
    try:
        ranks = check_rank(problem, unknowns, linear, ended=True)
    except ObservabilityError as error:
        if ran_away:
            ran_away(error)
        raise
    chi2, dof = system.chi2(linear, weights)
    if dof < 1 and not known:
        raise ObservabilityError(
            f"{dof + unknowns.map.shape[1]} equations for {unknowns.map.shape[1]} parameters, and "
            "the scale of the noise is not known; measure more, or give the noise"
        )
    covariance = system.covariance(linear, weights, scale)
    converged = decrement <= stands
    if not known:
        size = float(np.sqrt(chi2 / dof)) if loss is None else scale
        check_information(
            problem, unknowns, (linear if converged else first,), size if converged else 1.0
        )
        covariance = covariance * size**2
    message = (
        f"converged after {evaluations} evaluations"
        if converged
        else f"not converged after {evaluations} evaluations: the next step would be "
        f"{decrement:.2g} standard errors"
    )
    return Fit(
        problem=problem,
        unknowns=unknowns,
        first=first,
        last=linear,
        weights=weights,
        scale=scale,
        covariance=covariance,
        ranks=ranks,
        chi2=chi2,
        degrees_of_freedom=dof,
        evaluations=evaluations,
        converged=converged,
        message=message,
        known=known,
    )


@dataclass(frozen=True)
class _System:
    """The weighted rows of a problem and its priors, in the free unknowns."""

    problem: Problem
    unknowns: Unknowns
    known: bool
    loss: Loss | None
    kept: NDArray[np.bool_] | None

    def weights(self, linear: Linear) -> tuple[Array, float]:
        """Return the weight of each row, shape (N,), and the scale of the noise."""
        kept = np.ones(len(linear.white)) if self.kept is None else self.kept.astype(float)
        if self.loss is None:
            return kept, 1.0
        scale = max(self._scale(linear), 1.0 if self.known else 1e-300)
        return kept * self.loss.weights(linear.squares / scale**2, linear.equations), scale

    def _scale(self, linear: Linear) -> float:
        """Return the scale of the noise that the rows in the middle tell."""
        own = np.ones(len(linear.white), dtype=bool) if self.kept is None else self.kept
        equations = linear.equations[own]
        share = 1.0 - self.unknowns.map.shape[1] / max(int(equations.sum()), 1)
        return robust_scale(linear.squares[own], equations, max(share, 0.1))

    def stacked(self, linear: Linear, weights: Array) -> tuple[Array, Array]:
        """Return the Jacobian in the free unknowns and the residuals, priors included."""
        value, jacobian = linear.minimised
        return self._with_priors(value, jacobian, weights, linear.state)

    def step(self, linear: Linear, weights: Array, damping: float = 0.0) -> tuple[Array, Array]:
        """Return the step of the free unknowns, and their standard errors, shape (n_free,)."""
        step, std = _step(*self.stacked(linear, weights), damping)
        if linear.root is not None:  # the step of what is minimised, errors of what is white
            white = self._with_priors(linear.white, linear.jacobian, weights, linear.state)
            _, std = _step(*white)
        return step, std

    def _with_priors(
        self, value: Array, jacobian: Array, weights: Array, state: State
    ) -> tuple[Array, Array]:
        rows = weights > 0.0
        root = np.sqrt(weights[rows])[:, None]
        J = (root[:, :, None] * jacobian[rows]).reshape(-1, jacobian.shape[2]) @ self.unknowns.map
        r, J_prior = self.unknowns.prior_rows(self._all(state))
        return np.concatenate((J, J_prior)), np.concatenate(((root * value[rows]).ravel(), r))

    def size(self, state: State) -> Array:
        """Return how large parameters are, to which rounding is relative, shape (n,)."""
        return np.maximum(np.abs(self._all(state)), 1.0)

    def _all(self, state: State) -> Array:
        """Return the parameters with zeros for the external unknowns, which have no priors."""
        n = len(self.unknowns.names)
        return np.concatenate((state.parameters, np.zeros(n - len(state.parameters))))

    def cost(self, linear: Linear, weights: Array) -> float:
        """Return what is minimised."""
        squares = linear.squares if linear.root is None else (linear.minimised[0] ** 2).sum(axis=1)
        prior, _ = self.unknowns.prior_rows(self._all(linear.state))
        return float(weights @ squares + prior @ prior)

    def chi2(self, linear: Linear, weights: Array) -> tuple[float, int]:
        """Return χ² and the degrees of freedom of rows in use and priors.

        With a robust loss, what χ² would be if all rows were like the middle ones.
        """
        prior, _ = self.unknowns.prior_rows(self._all(linear.state))
        own = weights > 0.0
        equations = int(linear.equations[own].sum()) + len(prior)
        dof = equations - self.unknowns.map.shape[1]
        if self.loss is not None:
            return dof * self._scale(linear) ** 2, dof
        if linear.root is not None:  # what white residuals would be at their own optimum
            J, r = self._with_priors(linear.white, linear.jacobian, weights, linear.state)
            left = r - J @ np.linalg.lstsq(J, r, rcond=None)[0]
            return float(left @ left), dof
        return float(weights[own] @ linear.squares[own] + prior @ prior), dof

    def covariance(self, linear: Linear, weights: Array, scale: float) -> Array:
        """Return the covariance of all unknowns, shape (n, n).

        Whitened least squares: (Jᵀ V⁻¹ J)⁻¹. Unweighted: (JᵀJ)⁻¹ Jᵀ V J (JᵀJ)⁻¹, with V the
        modelled covariance of the residuals. Robust: the rows that are not outliers, inflated.
        """
        T = self.unknowns.map
        if self.loss is not None:
            rows = (weights > 0.0) & ~outlying(linear.squares / scale**2, linear.equations)
            inflation = self.loss.inflation(int(np.median(linear.equations[rows])))
        else:
            rows, inflation = weights > 0.0, 1.0
        white, _ = self._with_priors(
            linear.white, linear.jacobian, rows.astype(float), linear.state
        )
        if linear.root is None:
            return inflation * T @ inverse_gram(white) @ T.T
        plain, _ = self.stacked(linear, rows.astype(float))
        bread = inverse_gram(plain)
        J = (linear.root.transpose(0, 2, 1) @ linear.minimised[1])[rows] @ T
        meat = J.reshape(-1, T.shape[1])
        return inflation * T @ bread @ (meat.T @ meat) @ bread @ T.T


def _search(
    system: _System, linear: Linear, tell: Callable[[str], None] | None
) -> tuple[Linear, int]:
    """Return residuals near the optimum, and the number of evaluations.

    Levenberg-Marquardt. Weights are renewed at each state; a step is judged with those that it
    was made with.
    """
    problem, T = system.problem, system.unknowns.map
    damping, growth, evaluations = 0.0, 10.0, 1
    while evaluations < _STEPS and damping < _LARGEST_DAMPING:
        weights, _ = system.weights(linear)
        cost = system.cost(linear, weights)
        if tell and evaluations % 5 == 0:
            tell(f"step {evaluations}: {np.sqrt(cost / len(weights)):.3g} σ a pose")
        held = linear.damped(damping) if damping else linear
        step, std = system.step(held, weights, damping)
        trial = problem.linearise(problem.moved(held, T @ step))
        evaluations += 1
        fall = cost - system.cost(trial, weights)
        better = bool(np.isfinite(fall) and fall >= 0.0)
        if better:
            linear = trial
        near = np.abs(step / std).max() <= _NEAR and damping <= _LIGHT
        if near or (better and fall <= _STALLS * cost):
            break
        if better:
            damping, growth = (0.1 * damping if damping > _LEAST_DAMPING else 0.0), 10.0
        else:
            damping, growth = max(damping, _LEAST_DAMPING) * growth, 2.0 * growth
    return linear, evaluations


def _step(J: Array, r: Array, damping: float = 0.0) -> tuple[Array, Array]:
    """Return the least-squares step and the standard errors that J gives, each of shape (n,).

    Args:
        J: Jacobian, shape (m, n).
        r: Residuals, shape (m,).
        damping: Relative to the squares of the columns.
    """
    n = J.shape[1]
    scale = np.linalg.norm(J, axis=0)
    scale[scale == 0.0] = 1.0
    triangle = np.asarray(np.linalg.qr(np.column_stack((J / scale, r)), mode="r"))
    R, right = triangle[:n, :n], triangle[:n, n]
    std = np.linalg.norm(np.linalg.pinv(R), axis=1) / scale
    if damping > 0.0:
        R = np.concatenate((R, np.sqrt(damping) * np.eye(n)))
        right = np.concatenate((right, np.zeros(n)))
    return -np.linalg.lstsq(R, right, rcond=None)[0] / scale, std


def inverse_gram(J: Array) -> Array:
    """Return (JᵀJ)⁻¹ by QR of the scaled columns."""
    scale = np.linalg.norm(J, axis=0)
    inverse = np.linalg.inv(np.linalg.qr(J / scale, mode="r"))
    return (inverse @ inverse.T) / np.outer(scale, scale)
