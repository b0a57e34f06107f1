"""The fit of one problem: the search, and what is known at its end: covariance, rank, χ²."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import chdtri

from pincal.errors import ObservabilityError
from pincal.estimation.adjusted import adjusts, last_steps
from pincal.estimation.linear import Linear, Orthonormal, State
from pincal.estimation.observability.identifiable import check_information, check_rank
from pincal.estimation.problem import Problem
from pincal.estimation.residuals.losses import FALSE_ALARM, outlying
from pincal.estimation.solver import SLOW, search, solve_poses
from pincal.estimation.start import near_start
from pincal.estimation.system import ROWS_FOLLOW, NormalEquations, System
from pincal.estimation.unknowns import Unknowns
from pincal.types import Array, Mask

_FALLEN = 0.9  # of what determines a direction, that falling slopes may take away


@dataclass(frozen=True)
class Spread:
    """What each row gives to B and M."""

    system: System
    linear: Linear
    slopes: Array
    """Of ψ, in B: the mean one of rows that fit, an outlier's weight; shape (N,)."""
    falls: Array
    """By how much an outlier's slope along its residuals is less, shape (N,)."""
    noises: Array
    """Root mean square of ψ in M of rows that fit, 0 of outliers, shape (N,)."""
    pulls: Array
    """ψ over the residuals of outliers, 0 of rows that fit, shape (N,)."""

    @classmethod
    def of(
        cls, system: System, linear: Linear, weights: Array, scale: float, variance: float
    ) -> Spread:
        """Return how the optimum of a system spreads.

        Args:
            system: What was minimised.
            linear: Conditions at the optimum.
            weights: Of the rows, shape (N,).
            scale: Of the noise, as the loss estimates it.
            variance: Of white residuals of rows that are not outliers.
        """
        if system.loss is None:
            none = np.zeros_like(weights)
            return cls(system, linear, weights, none, weights, none)
        counts = system.in_use(linear)
        squares, equations, unit = (
            linear.squares / scale**2,
            linear.equations,
            max(variance, 1e-300),
        )
        far = squares > chdtri(np.maximum(equations, 1), FALSE_ALARM)
        good, n = counts & ~far, system.unknowns.map.shape[1]
        slope, square, factor = system.loss.moments(squares[good], equations[good], n)
        return cls(
            system,
            linear,
            np.where(good, slope, weights),
            np.where(counts & far, weights - system.loss.slope(squares, equations), 0.0),
            np.where(good, factor * np.sqrt(square * scale**2 / unit), 0.0),
            np.where(counts & far, factor * weights / np.sqrt(unit), 0.0),
        )

    @cached_property
    def root(self) -> Array:
        """Root of B⁻¹, shape (n_free, n_free): that of (RᵀR − GᵀG)⁻¹, G what outliers' slopes fall.

        Of least squares R⁻¹.
        """
        normal = NormalEquations.of(self.system.triangle(self.linear, self.slopes))
        half = np.asarray(np.linalg.inv(normal.R)) / normal.lengths[:, None]
        if not self.falls.any():
            return half
        along = self._along / np.sqrt(np.maximum(self.linear.squares, 1e-300))[:, None]
        C = np.sqrt(np.maximum(self.falls, 0.0))[:, None] * along @ self.system.unknowns.map @ half
        share, V = np.linalg.eigh(C.T @ C)
        return np.asarray(half @ (V / np.sqrt(1.0 - np.minimum(share, _FALLEN))))

    @property
    def bread(self) -> Array:
        """B⁻¹, shape (n_free, n_free)."""
        return np.asarray(self.root @ self.root.T)

    @property
    def meat_in_root(self) -> Array:
        """Root of B⁻¹, transposed, M, root of B⁻¹: 1 of least squares, shape (n_free, n_free)."""
        if (rows := self._meat) is None:
            return np.eye(len(self.root))
        half = rows @ self.root
        return np.asarray(half.T @ half)

    @property
    def covariance(self) -> Array:
        """Covariance of all unknowns in units of the noise, shape (n, n).

        Of unweighted residuals with the covariance V = S Sᵀ of each row, M = Σ Jᵀ V J.
        """
        T, bread = self.system.unknowns.map, self.bread
        if (rows := self._meat) is None:
            return np.asarray(T @ bread @ T.T)
        half = rows @ bread
        return np.asarray(T @ (half.T @ half) @ T.T)

    @property
    def _meat(self) -> Array | None:
        """Rows whose squares are M, shape (k, n_free); None of least squares, where M = B."""
        system, linear, T = self.system, self.linear, self.system.unknowns.map
        if system.problem.weighted:
            if system.loss is None:
                return None
            n = T.shape[1]
            rows = [system.triangle(linear, self.noises**2)[:n, :n]]
        else:
            J = system.derivatives(linear) @ T
            meat = linear.white.noise.transpose(0, 2, 1) / system.unit @ J
            fits = self.noises > 0.0
            rows = [(self.noises[:, None, None] * meat)[fits].reshape(-1, T.shape[1])]
        return np.concatenate((*rows, self._pulled[self.pulls > 0.0] @ T))

    @property
    def _along(self) -> Array:
        """rᵀ J of each row, shape (N, n)."""
        J, r = self.system.derivatives(self.linear), self.system.residuals(self.linear)
        return np.asarray(np.einsum("nm,nmk->nk", r, J))

    @property
    def _pulled(self) -> Array:
        """ψᵀ J of outliers, shape (N, n)."""
        return np.where(self.pulls[:, None] > 0.0, self.pulls[:, None] * self._along, 0.0)

    def response(self, errors: Array) -> Array:
        """Return how all unknowns follow errors of the conditions, −B⁻¹ Σ Jᵀ ψ' c, shape (n, q).

        Args:
            errors: c, by how much the conditions are off for each, shape (N, k, q).
        """
        linear, system, T = self.linear, self.system, self.system.unknowns.map
        white = linear.white(errors) if system.problem.weighted else errors / system.unit
        weighted = self.slopes[:, None, None] * white
        moved = np.einsum("nmk,nmq->kq", system.derivatives(linear), weighted, optimize=True)
        return np.asarray(-(T @ self.bread @ T.T) @ moved)

    @property
    def influence(self) -> Array:
        """How all unknowns follow the noise in standard deviations, shape (N, n, s + 1).

        K = −B⁻¹ Jᵀ W at each pose, W = L⁻¹NᵀS; the last column is what an outlier moves.
        """
        linear, system, T = self.linear, self.system, self.system.unknowns.map
        W = linear.white.by_noise if system.problem.weighted else linear.white.noise / system.unit
        fits = (self.noises > 0.0)[:, None, None]
        J = system.derivatives(linear)
        noise = self.noises[:, None, None] * (J.transpose(0, 2, 1) @ W)
        by_noise = np.concatenate((np.where(fits, noise, 0.0), self._pulled[:, :, None]), axis=2)
        return np.asarray(-(T @ self.bread @ T.T) @ by_noise)


@dataclass(frozen=True)
class Fit:
    """Optimum of a problem, and what is known about it."""

    system: System
    """What was minimised."""
    first: Linear
    """Conditions where the search began."""
    last: Linear
    """Conditions at the optimum."""
    weights: Array
    """Of the rows, 1 without a robust loss, shape (N,)."""
    scale: float
    """Of the noise, as a robust loss estimates it; 1 without."""
    covariance: Array
    """Of all unknowns, shape (n, n); scaled by χ² if the noise was assumed."""
    spread: Spread
    """How it follows what rows are off by."""
    ranks: list[tuple[int, float]]
    """Rank and condition of each leg."""
    chi2: float
    degrees_of_freedom: int
    evaluations: int
    converged: bool
    distance: float
    """How far the optimum is, to first order, in standard errors."""
    costs: tuple[float, ...]
    """Sums of squares at the start, where the search began if elsewhere, after each step taken."""

    @property
    def problem(self) -> Problem:
        """The problem."""
        return self.system.problem

    @property
    def unknowns(self) -> Unknowns:
        """What was free."""
        return self.system.unknowns

    @property
    def known(self) -> bool:
        """Whether the scale of the noise was known; else the covariance is scaled by χ²."""
        return self.system.known

    @property
    def parameters(self) -> Array:
        """Identified parameters of the legs, shape (n_params,)."""
        return self.last.state.parameters

    @cached_property
    def good(self) -> Mask:
        """Which rows take part and are no outliers, shape (N,)."""
        return _good(self.system, self.last, self.weights, self.scale)

    @cached_property
    def orthonormal(self) -> Orthonormal:
        """What makes the columns of good rows and priors orthonormal."""
        _, prior = self.unknowns.prior_rows(self.unknowns.start)
        return Orthonormal.of(self._good_rows, prior)

    @cached_property
    def Q(self) -> Array:
        """Good rows in orthonormal columns: what the unknowns take up; (n_good, m, n_free)."""
        return self.orthonormal(self._good_rows)

    @property
    def _good_rows(self) -> Array:
        return self.last.jacobian[self.good] @ self.unknowns.map

    @cached_property
    def influence(self) -> Array:
        """How all unknowns follow the noise in standard deviations, shape (N, n, s + 1).

        The last column is what an outlier moves.
        """
        return self.noise_scale * self.spread.influence

    @cached_property
    def noise_scale(self) -> float:
        """Standard deviation of white residuals: 1 if the noise is known."""
        if self.known:
            return 1.0
        return float(np.sqrt(max(self.chi2 / max(self.degrees_of_freedom, 1), 0.0)))


def fit(
    system: System,
    *,
    start: State | None = None,
    progress: Callable[[str], None] | None = None,
    ran_away: Callable[[ObservabilityError], None] | None = None,
    max_evaluations: int | None = None,
) -> Fit:
    """Return the least-squares fit of a problem.

    Args:
        system: What is minimised.
        start: Where the search starts; the nominal parameters if not given.
        progress: Called with what is being done.
        ran_away: Called if the rank is lost where the search ended; may raise what says more.
        max_evaluations: Evaluations of the conditions after which to stop searching.

    Raises:
        ObservabilityError: parameters are not determined, or by the noise only.
        MeasurementError: residuals that do not exist, or have no noise.
    """
    problem, unknowns = system.problem, system.unknowns
    state = start or problem.start(unknowns.start[: problem.leg_block.n_parameters])
    first, count = solve_poses(problem, problem.evaluate(state))
    check_rank(problem, unknowns, first)
    if not problem.weighted:
        system = replace(system, unit=float(np.median(np.linalg.norm(first.noise_root, axis=2))))
    begun = highest = system.cost_at(first)
    if start is not None:  # where the last steps ended, which the search does not know of
        highest *= 1.0 + ROWS_FOLLOW
    near, easy_evaluations = near_start(system, first, progress) if start is None else (first, 0)
    enough = SLOW if adjusts(problem) else 0.0  # the last steps go on from there
    solution = search(
        system, near, progress, highest=highest, enough=enough, max_evaluations=max_evaluations
    )
    solution = last_steps(system, solution)
    linear, weights = solution.linear, solution.weights
    if system.known:  # where the search starts, a pose may be nearer to a singularity than it is
        check_information(problem, unknowns, (first, linear))
    try:
        ranks = check_rank(problem, unknowns, linear, ended=True)
    except ObservabilityError as error:
        if ran_away:
            ran_away(error)
        raise
    chi2, dof = _chi2(system, linear, weights, solution.scale)
    if dof < 1 and not system.known:
        n = unknowns.map.shape[1]
        raise ObservabilityError(
            f"{dof + n} equations for {n} parameters, and the scale of the noise is not known; "
            "measure more, or give the noise"
        )
    spread = Spread.of(system, linear, weights, solution.scale, chi2 / max(dof, 1))
    covariance = spread.covariance
    if not system.known:
        size = float(np.sqrt(chi2 / dof))
        judged = (linear, size) if solution.converged else (first, 1.0)
        check_information(problem, unknowns, (judged[0],), judged[1])
        covariance = covariance * size**2
    return Fit(
        system=system,
        first=first,
        last=linear,
        weights=weights,
        scale=solution.scale,
        covariance=covariance,
        spread=spread,
        ranks=ranks,
        chi2=chi2,
        degrees_of_freedom=dof,
        evaluations=solution.evaluations + count + easy_evaluations,
        converged=solution.converged,
        distance=solution.distance,
        costs=solution.costs if near is first else (float(begun), *solution.costs),
    )


def _good(system: System, linear: Linear, weights: Array, scale: float) -> Mask:
    if system.loss is None:
        return weights > 0.0
    return (weights > 0.0) & ~outlying(linear.squares / scale**2, linear.equations)


def _chi2(system: System, linear: Linear, weights: Array, scale: float) -> tuple[float, int]:
    """Return χ² and the degrees of freedom of rows in use and priors.

    With a robust loss, that of the rows that are not outliers, at their own optimum.
    """
    prior, _ = system.unknowns.prior_rows(system.values(linear.state))
    good = _good(system, linear, weights, scale)
    dof = int(linear.equations[good].sum()) + len(prior) - system.unknowns.map.shape[1]
    if system.loss is None and system.problem.weighted:
        return float(weights[good] @ linear.squares[good] + prior @ prior), dof
    triangle = system.triangle(linear, good.astype(float), white=True)
    return float(triangle[-1, -1] ** 2), dof  # what white residuals would be at their own optimum


def without(system: System, rows: Mask) -> System:
    """Return the least squares of some rows."""
    return replace(system, loss=None, kept=rows)


_PAIRS, _CLEARLY = 3, 0.1


def curvature(fit: Fit, threshold: float = 0.0) -> float:
    """Return the relative curvature of a fit; infinite where its poses get lost so near to it.

    Args:
        fit: The fit.
        threshold: Curvature far below which one pair of draws will do.
    """
    problem, linear, rows = fit.problem.thinned(fit.last)
    used, n = (fit.weights > 0.0)[rows], len(fit.covariance)
    size = np.sqrt(np.diagonal(fit.covariance))
    size = np.where(size > 0.0, size, 1.0)  # so that draws are the same in any unit
    values, axes = np.linalg.eigh(fit.covariance / np.outer(size, size))
    root = size[:, None] * axes * np.sqrt(values.clip(0.0))
    steps = [root @ draw for draw in np.random.default_rng(0).standard_normal((_PAIRS, n))]
    relative = _relative(problem, linear, used, steps[:1], solved=False)
    if not relative <= _CLEARLY * threshold:
        relative = _relative(problem, linear, used, steps, solved=True)
    return relative if np.isfinite(relative) else np.inf


def _relative(
    problem: Problem, linear: Linear, used: Mask, steps: list[Array], *, solved: bool
) -> float:
    """Return the bent part of steps over the straight one.

    Args:
        problem: The problem.
        linear: Where the steps begin.
        used: Rows that count, shape (N,).
        steps: Of all unknowns, shape (n,) each.
        solved: Whether poses are solved at the ends. To second order rows do not see them move.
    """
    bent, straight = 0.0, 0.0
    for step in steps:
        ends = []
        for sign in (1.0, -1.0):
            end = problem.evaluate(problem.moved(linear, sign * step))
            if solved:
                end, _ = solve_poses(problem, end, ~used)
            ends.append(linear.whitened(end.conditions))
        bent += float(((0.5 * (ends[0] + ends[1]) - linear.residuals)[used] ** 2).sum())
        along = linear.after(step) - linear.conditions
        straight += float((linear.white(along[:, :, None])[used] ** 2).sum())
    return float(np.sqrt(bent / straight)) if straight > 0.0 else 0.0
