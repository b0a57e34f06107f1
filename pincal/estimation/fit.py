"""The fit of one problem: the search, and what is known at its end: covariance, rank, χ²."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import chdtri

from pincal.errors import ObservabilityError
from pincal.estimation.observability.identifiable import check_information, check_rank
from pincal.estimation.problem import Linear, Problem
from pincal.estimation.solver import (
    SLOW,
    SolverResult,
    adjusts,
    last_steps,
    search,
    solve_poses,
)
from pincal.estimation.start import near_start
from pincal.estimation.system import FALSE_ALARM, ROWS_FOLLOW, NormalEquations, System, outlying
from pincal.estimation.unknowns import State, Unknowns
from pincal.types import Array, Index, Mask

_FALLEN = 0.9  # share of what determines a direction that falling slopes may take away


@dataclass(frozen=True)
class Spread:
    """How an optimum follows its rows ρ: δz = −B⁻¹ Σ ψ' Jᵀ ρ, of covariance B⁻¹ M B⁻¹."""

    system: System
    linear: Linear
    slopes: Array
    """ψ' in B: its mean over rows that fit, the weight of an outlier; shape (N,)."""
    falls: Array
    """By how much an outlier's slope along its residuals is less, shape (N,)."""
    noises: Array
    """Root mean square of ψ in M of rows that fit, 0 of outliers, shape (N,)."""
    pulls: Array
    """ψ over the residuals of outliers, 0 of rows that fit, shape (N,)."""

    @classmethod
    def of(cls, system: System, optimum: SolverResult, variance: float) -> Spread:
        """Return how an optimum spreads, by the variance of white residuals but outliers'."""
        linear, weights, scale = optimum.last, optimum.weights, optimum.scale
        none = np.zeros_like(weights)
        if system.loss is None:
            return cls(system, linear, weights, none, weights, none)
        squares, equations = linear.squares / scale**2, linear.equations
        unit = max(variance, 1e-300)
        far = squares > chdtri(np.maximum(equations, 1), FALSE_ALARM)
        good, far = system.in_use(linear) & ~far, system.in_use(linear) & far
        n = system.unknowns.n_free
        slope, square, factor = system.loss.moments(squares[good], equations[good], n)
        return cls(
            system,
            linear,
            np.where(good, slope, weights),
            np.where(far, weights - system.loss.slope(squares, equations), 0.0),
            np.where(good, factor * np.sqrt(square * scale**2 / unit), 0.0),
            np.where(far, factor * weights / np.sqrt(unit), 0.0),
        )

    @cached_property
    def root(self) -> Array:
        """Root of B⁻¹, shape (n_free, n_free): that of (RᵀR − GᵀG)⁻¹, G what outliers' slopes fall.

        Of least squares R⁻¹.
        """
        root = NormalEquations.of(self.system.triangle(self.linear, self.slopes)).root
        if not self.falls.any():
            return root
        along = self._along / np.sqrt(np.maximum(self.linear.squares, 1e-300))[:, None]
        C = np.sqrt(np.maximum(self.falls, 0.0))[:, None] * along @ self.system.unknowns.map @ root
        share, V = np.linalg.eigh(C.T @ C)
        return np.asarray(root @ (V / np.sqrt(1.0 - np.minimum(share, _FALLEN))))

    @cached_property
    def meat_in_root(self) -> Array:
        """Root of B⁻¹, transposed, M, root of B⁻¹: 1 of least squares, shape (n_free, n_free).

        Of plain residuals with the covariance S Sᵀ of each row, M = Σ Jᵀ S Sᵀ J.
        """
        system, linear = self.system, self.linear
        if system.problem.weighted and system.loss is None:
            return np.eye(len(self.root))
        by_free, W = system.unknowns.map @ self.root, system.rows(linear).by_noise
        pulled = self._pulled[self.pulls > 0.0] @ by_free
        prior = system.unknowns.prior_rows(linear.state.parameters)[1] @ self.root
        meat = pulled.T @ pulled + prior.T @ prior
        for poses in linear.parts():
            fits = self.noises[poses] > 0.0
            J = system.derivatives(linear, poses)[fits] @ by_free
            rows = W[poses][fits].transpose(0, 2, 1) @ J
            rows = (self.noises[poses][fits, None, None] * rows).reshape(-1, len(meat))
            meat += rows.T @ rows
        return np.asarray(meat)

    @property
    def covariance(self) -> Array:
        """Covariance of all unknowns in units of the noise, shape (n, n)."""
        by_free = self.system.unknowns.map @ self.root
        return np.asarray(by_free @ self.meat_in_root @ by_free.T)

    @property
    def _along(self) -> Array:
        """rᵀ J of each row, shape (N, n)."""
        J, r = self.system.derivatives(self.linear), self.system.residuals(self.linear)
        return np.asarray(np.einsum("nm,nmk->nk", r, J))

    @property
    def _pulled(self) -> Array:
        """ψᵀ J of outliers, shape (N, n)."""
        return np.where(self.pulls[:, None] > 0.0, self.pulls[:, None] * self._along, 0.0)

    @property
    def _bread(self) -> Array:
        """B⁻¹ in all unknowns, T B⁻¹ Tᵀ, shape (n, n)."""
        by_free = self.system.unknowns.map @ self.root
        return np.asarray(by_free @ by_free.T)

    def response(self, errors: Array) -> Array:
        """Return how all unknowns follow errors c of the conditions, (N, k, q) to (n, q).

        −B⁻¹ Σ Jᵀ ψ' c.
        """
        weighted = self.slopes[:, None, None] * self.system.rows(self.linear)(errors)
        J = self.system.derivatives(self.linear)
        return np.asarray(-self._bread @ np.einsum("nmk,nmq->kq", J, weighted, optimize=True))

    @property
    def influence(self) -> Array:
        """How all unknowns follow the noise in standard deviations, shape (N, n, s + 1).

        K = −B⁻¹ Jᵀ W at each pose; the last column is what an outlier moves.
        """
        W, J = self.system.rows(self.linear).by_noise, self.system.derivatives(self.linear)
        noise = self.noises[:, None, None] * (J.transpose(0, 2, 1) @ W)
        noise = np.where((self.noises > 0.0)[:, None, None], noise, 0.0)
        return -self._bread @ np.concatenate((noise, self._pulled[:, :, None]), axis=2)


@dataclass(frozen=True)
class Outlier:
    """A row of the measurements that does not fit the others."""

    row: int
    """Counted from 0."""
    legs: tuple[str, ...]
    """Legs in whose fit it does not fit."""
    sigma: float
    """Its residual in standard deviations: that of one residual as unlikely as its χ²."""
    weight: float
    """With which it took part, from 1 down to 0: rejected."""
    quantity: str
    """Which of its residuals is largest."""
    off: float
    """That residual in standard deviations."""


@dataclass(frozen=True)
class Fit(SolverResult):
    """Optimum of a problem, and what is known about it."""

    system: System
    """What was minimised."""
    first: Linear
    """Conditions where the search began."""
    ranks: list[tuple[int, float]]
    """Rank and condition of each leg."""
    outliers: tuple[Outlier, ...] = ()
    """Rows that did not fit, the worst first."""
    widening: Array | float = 0.0
    """What noise and tolerances that were estimated add to the covariance, shape (n, n)."""

    @property
    def problem(self) -> Problem:
        """The problem."""
        return self.system.problem

    @property
    def rows(self) -> Index:
        """Rows of the measurements that took part or were rejected, shape (N,)."""
        return self.problem.leg_block.data_rows

    @property
    def unknowns(self) -> Unknowns:
        """What was free."""
        return self.system.unknowns

    @property
    def parameters(self) -> Array:
        """Identified parameters of the legs, shape (n_params,)."""
        return self.last.state.parameters

    @cached_property
    def good(self) -> Mask:
        """Which rows take part and are no outliers, shape (N,)."""
        if self.system.loss is None:
            return self.weights > 0.0
        squares = self.last.squares / self.scale**2
        return (self.weights > 0.0) & ~outlying(squares, self.last.equations)

    @cached_property
    def degrees_of_freedom(self) -> int:
        """Equations of good rows and priors, less free unknowns."""
        n_priors = int(np.isfinite(self.unknowns.priors).sum())
        return int(self.last.equations[self.good].sum()) + n_priors - self.unknowns.n_free

    @cached_property
    def chi2(self) -> float:
        """Sum of squares; with a loss what good rows would have at their own optimum."""
        if self.system.loss is None and self.problem.weighted:
            return self.system.cost(self.last.residuals, self.weights, self.last)
        return self.normal.left

    @cached_property
    def normal(self) -> NormalEquations:
        """Normal equations of good white rows and priors."""
        good = self.good.astype(float)
        return NormalEquations.of(self.system.triangle(self.last, good, white=True))

    @cached_property
    def Q(self) -> Array:
        """Good rows in orthonormal columns: what the unknowns take up; (n_good, m, n_free)."""
        return self.normal.orthonormal(self.last.jacobian[self.good] @ self.unknowns.map)

    @cached_property
    def spread(self) -> Spread:
        """How it follows what rows are off by."""
        return Spread.of(self.system, self, self.chi2 / max(self.degrees_of_freedom, 1))

    @cached_property
    def noise_scale(self) -> float:
        """Standard deviation of white residuals: 1 if the noise is known."""
        if self.system.known:
            return 1.0
        return float(np.sqrt(max(self.chi2 / max(self.degrees_of_freedom, 1), 0.0)))

    @cached_property
    def covariance(self) -> Array:
        """Of all unknowns, shape (n, n); scaled by χ² if the noise was assumed."""
        return np.asarray(self.noise_scale**2 * self.spread.covariance + self.widening)

    @cached_property
    def influence(self) -> Array:
        """How all unknowns follow the noise in standard deviations, shape (N, n, s + 1).

        The last column is what an outlier moves.
        """
        return self.noise_scale * self.spread.influence


def fit(
    system: System,
    *,
    start: State | None = None,
    progress: Callable[[str], None] | None = None,
) -> Fit:
    """Return the fit of a problem, from its start at nominal parameters if no other is given.

    Raises:
        ObservabilityError: parameters are not determined, or by the noise only.
        MeasurementError: residuals that do not exist, or have no noise.
    """
    problem, unknowns = system.problem, system.unknowns
    state = start or problem.start(unknowns.start)
    first, evaluations = solve_poses(problem, problem.evaluate(state))
    check_rank(problem, unknowns, first)
    if not problem.weighted:
        system = replace(system, unit=float(np.median(np.linalg.norm(first.noise_root, axis=2))))
    highest = system.cost_at(first)
    near = first
    if start is not None:  # where the last steps ended, which the search does not know of
        highest *= 1.0 + ROWS_FOLLOW
    else:
        near, easy_evaluations = near_start(system, first, progress)
        evaluations += easy_evaluations
    enough = SLOW if adjusts(problem) else 0.0  # the last steps go on from there
    stop = system.max_evaluations
    solution = search(system, near, progress, highest=highest, enough=enough, max_evaluations=stop)
    solution = last_steps(system, solution)
    if system.known:  # where the search starts, a pose may be nearer to a singularity than it is
        check_information(problem, unknowns, (first, solution.last))
    optimum = Fit(
        **vars(solution),
        system=system,
        first=first,
        ranks=check_rank(problem, unknowns, solution.last, ended=True),
    )
    if not system.known:
        n, dof = unknowns.n_free, optimum.degrees_of_freedom
        if dof < 1:
            raise ObservabilityError(
                f"{dof + n} equations for {n} parameters, and the scale of the noise is not known; "
                "measure more, or give the noise"
            )
        judged = (optimum.last, optimum.noise_scale) if solution.converged else (first, 1.0)
        check_information(problem, unknowns, judged[:1], judged[1])
    return replace(optimum, evaluations=solution.evaluations + evaluations)


_PAIRS, _CLEARLY = 3, 0.1
_BY_PRIORS = 0.5  # share of what determines a direction, from which it is the priors'


def curvature(fit: Fit, threshold: float = 0.0) -> float:
    """Return the curved part of residuals over the straight one, at one standard error.

    Rows do not see to second order that poses move, so poses are not solved at the ends. What
    priors determine rather than rows is as wide as they are, and rows say nothing straight of it:
    it stays. Far below a threshold one pair of draws will do.
    """
    problem, linear, rows = fit.problem.thinned(fit.last)
    used, n = (fit.weights > 0.0)[rows], len(fit.covariance)
    size = np.sqrt(np.diagonal(fit.covariance))
    size = np.where(size > 0.0, size, 1.0)  # so that draws are the same in any unit
    values, axes = np.linalg.eigh(fit.covariance / np.outer(size, size))
    root = size[:, None] * axes * np.sqrt(values.clip(0.0))
    by_priors, axes = np.linalg.eigh(root.T @ (root / fit.unknowns.priors[:, None] ** 2))
    root = root @ (axes * (by_priors < _BY_PRIORS))
    bent = straight = 0.0
    for draw in np.random.default_rng(0).standard_normal((_PAIRS, n)):
        step = root @ draw
        ends = [problem.evaluate(problem.moved(linear, sign * step)) for sign in (1.0, -1.0)]
        middle = 0.5 * sum(linear.whitened(end.conditions) for end in ends)
        bent += float(((middle - linear.residuals)[used] ** 2).sum())
        straight += float(
            (linear.whitened(linear.after(step) - linear.conditions)[used] ** 2).sum()
        )
        relative = float(np.sqrt(bent / straight)) if straight > 0.0 else 0.0
        if relative <= _CLEARLY * threshold:
            break
    return relative if np.isfinite(relative) else np.inf
