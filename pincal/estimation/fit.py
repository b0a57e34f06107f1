"""The fit of one problem: the search, then covariance, rank and χ² at its end."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from scipy.special import chdtri

from pincal.errors import MeasurementError, ObservabilityError
from pincal.estimation.noise import RowNoise
from pincal.estimation.observability.identifiable import check_information, check_rank
from pincal.estimation.problem import Linear, Problem
from pincal.estimation.solver import SolverResult, optimum, search, solve_poses
from pincal.estimation.system import FALSE_ALARM, NormalEquations, System, outlying
from pincal.estimation.unknowns import Unknowns
from pincal.types import Array, Index, Mask

_FALLEN = 0.9  # share of what determines a direction that falling slopes may take away


@dataclass(frozen=True)
class Outlier:
    """A row of the measurements that does not fit the others."""

    row: int
    """Index of the row, from 0."""
    legs: tuple[str, ...]
    """Legs in whose fit the row does not fit."""
    sigma: float
    """Misfit of the row, in σ: the size of a single normal residual as unlikely as the row's χ²."""
    weight: float
    """Weight of the row in the fit, from 1 to 0 (rejected)."""
    quantity: str
    """The quantity with the largest residual."""
    off: float
    """The largest residual in standard deviations."""


@dataclass(frozen=True)
class Fit(SolverResult):
    """The optimum of a problem with its covariance.

    An error ρ of the rows moves it by δz = −B⁻¹ Σ ψ' Jᵀ ρ; its covariance is B⁻¹ M B⁻¹.
    """

    system: System
    """What was minimised."""
    first: Linear
    """Conditions where the search began."""
    outliers: tuple[Outlier, ...] = ()
    """Rows that did not fit, the worst first."""
    widening: Array | float = 0.0
    """Added to the covariance because noise and tolerances were estimated, shape (n, n)."""
    exact: int = 0
    """Degrees of freedom of readings whose estimated noise is at its floor (exact readings)."""

    def at_noise_of(self, problem: Problem) -> Self:
        """Return the fit of a problem with other noise, to first order without a new search."""
        system, last = replace(self.system, problem=problem), replace(self.last, problem=problem)
        scale = self.scale if system.loss is None else system.scale(last.squares)
        return replace(self, system=system, last=last, scale=scale)

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
        """The parameters and external unknowns, and which were free."""
        return self.system.unknowns

    @property
    def parameters(self) -> Array:
        """Identified parameters of the legs, shape (n_params,)."""
        return self.last.state.parameters

    @cached_property
    def good(self) -> Mask:
        """Which rows take part and are not outliers, shape (N,)."""
        if self.system.loss is None:
            return self.weights > 0.0
        squares = self.last.squares / self.scale**2
        return (self.weights > 0.0) & ~outlying(squares, self.last.equations)

    @cached_property
    def degrees_of_freedom(self) -> int:
        """Equations of good rows and priors, less free unknowns and exact readings."""
        n_priors, used = int(np.isfinite(self.unknowns.priors).sum()), self.unknowns.n_free
        return int(self.last.equations[self.good].sum()) + n_priors - used - self.exact

    @cached_property
    def chi2(self) -> float:
        """Weighted sum of squares; under a robust loss that of good rows at their own optimum."""
        if self.system.loss is None:
            return self.system.cost(self.last, self.weights)
        return self.normal.left

    @cached_property
    def normal(self) -> NormalEquations:
        """Normal equations of good white rows and priors."""
        return NormalEquations.of(self.system.triangle(self.last, self.good.astype(float)))

    @cached_property
    def Q(self) -> Array:
        """Orthonormal basis of the good rows' Jacobian, shape (n_good, m, n_free)."""
        return self.normal.orthonormal(self.last.jacobian[self.good] @ self.unknowns.map)

    @cached_property
    def noise_scale(self) -> float:
        """Standard deviation of white residuals: 1 if the noise is known."""
        if self.system.known:
            return 1.0
        return float(np.sqrt(max(self.chi2 / max(self.degrees_of_freedom, 1), 0.0)))

    @cached_property
    def slopes(self) -> Array:
        """ψ' in B: its mean for rows that fit, the weight for outliers, shape (N,)."""
        return self._psi[0]

    @cached_property
    def _psi(self) -> tuple[Array, Array, Array, Array]:
        """Slopes of ψ, and their decrease along the residuals of outliers, shape (N,) each.

        Then the root mean square of ψ for rows that fit, and ψ over the residual for outliers;
        both are zero elsewhere.
        """
        system, weights, none = self.system, self.weights, np.zeros_like(self.weights)
        if system.loss is None:
            return weights, none, weights, none
        squares, equations = self.last.squares / self.scale**2, self.last.equations
        unit = max(self.chi2 / max(self.degrees_of_freedom, 1), 1e-300)
        far = squares > chdtri(np.maximum(equations, 1), FALSE_ALARM)
        good, far = system.kept & ~far, system.kept & far
        n = system.unknowns.n_free
        slope, square, factor = system.loss.moments(squares[good], equations[good], n)
        return (
            np.where(good, slope, weights),
            np.where(far, weights - system.loss.slope(squares, equations), 0.0),
            np.where(good, factor * np.sqrt(square * self.scale**2 / unit), 0.0),
            np.where(far, factor * weights / np.sqrt(unit), 0.0),
        )

    @cached_property
    def root(self) -> Array:
        """Root L of B⁻¹ = (RᵀR − GᵀG)⁻¹, G by the decreasing slopes of outliers, (n_free, n_free).

        For least squares it is R⁻¹.
        """
        root = NormalEquations.of(self.system.triangle(self.last, self.slopes)).root
        falls = self._psi[1]
        if not falls.any():
            return root
        along = self._along / np.sqrt(np.maximum(self.last.squares, 1e-300))[:, None]
        C = np.sqrt(np.maximum(falls, 0.0))[:, None] * along @ self.unknowns.map @ root
        share, V = np.linalg.eigh(C.T @ C)
        return np.asarray(root @ (V / np.sqrt(1.0 - np.minimum(share, _FALLEN))))

    @cached_property
    def meat_in_root(self) -> Array:
        """Lᵀ M L with B⁻¹ = L Lᵀ, the identity for least squares, shape (n_free, n_free)."""
        linear, noises = self.last, self._psi[2]
        if self.system.loss is None:
            return np.eye(len(self.root))
        by_free, W = self.unknowns.map @ self.root, linear.white.by_noise
        pulled = self._pulled[self._psi[3] > 0.0] @ by_free
        prior = self.unknowns.prior_rows(self.unknowns.start)[1] @ self.root
        fits = noises > 0.0
        rows = W[fits].transpose(0, 2, 1) @ (linear.jacobian[fits] @ by_free)
        rows = (noises[fits, None, None] * rows).reshape(-1, by_free.shape[1])
        return np.asarray(pulled.T @ pulled + prior.T @ prior + rows.T @ rows)

    @cached_property
    def covariance(self) -> Array:
        """B⁻¹ M B⁻¹ of all unknowns, shape (n, n), scaled by reduced χ² if noise was estimated."""
        by_free = self.unknowns.map @ self.root
        covariance = by_free @ self.meat_in_root @ by_free.T
        return np.asarray(self.noise_scale**2 * covariance + self.widening)

    @property
    def _along(self) -> Array:
        """rᵀ J of each row, shape (N, n)."""
        return np.einsum("nm,nmk->nk", self.last.residuals, self.last.jacobian)

    @property
    def _pulled(self) -> Array:
        """ψᵀ J of outliers, shape (N, n)."""
        pulls = self._psi[3][:, None]
        return np.where(pulls > 0.0, pulls * self._along, 0.0)

    def response(self, errors: Array) -> Array:
        """Return the changes −B⁻¹ Σ Jᵀ ψ' c of all unknowns, (n, q), by errors c of conditions.

        The errors have shape (N, k, q).
        """
        weighted = self.slopes[:, None, None] * self.last.white(errors)
        J, by_free = self.last.jacobian, self.unknowns.map @ self.root
        right = np.einsum("nmk,nmq->kq", J, weighted, optimize=True)
        return np.asarray(-by_free @ (by_free.T @ right))

    @cached_property
    def influence(self) -> Array:
        """Derivatives of all unknowns by the noise in standard deviations, shape (N, n, s + 1).

        They are −B⁻¹ Jᵀ W at each pose; the last column is the change by an outlier.
        """
        W, J = self.last.white.by_noise, self.last.jacobian
        noises, by_free = self._psi[2][:, None, None], self.unknowns.map @ self.root
        noise = np.where(noises > 0.0, noises * (J.transpose(0, 2, 1) @ W), 0.0)
        follows = np.concatenate((noise, self._pulled[:, :, None]), axis=2)
        return -self.noise_scale * (by_free @ by_free.T) @ follows


def fit(system: System, begin: Linear, *, near: bool = False) -> Fit:
    """Return the fit of a problem, from nominal parameters or from near the optimum.

    Raises:
        ObservabilityError: parameters are not determined, or by the noise only.
        MeasurementError: residuals do not exist, or have no noise.
    """
    problem, unknowns = system.problem, system.unknowns
    first, evaluations = solve_poses(begin)
    check_rank(problem, unknowns, first)
    start, easier = (first, 0) if near else _easier_start(system, begin, first)
    solution = optimum(system, start, system.cost(first), evaluations + easier, near=near)
    if system.known:  # at the start of a search a pose may be too near to a singularity
        check_information(problem, unknowns, (first, solution.last))
    check_rank(problem, unknowns, solution.last, ended=True)
    end = Fit(**vars(solution), system=system, first=first)
    if not system.known:
        n, dof = unknowns.n_free, end.degrees_of_freedom
        if dof < 1:
            raise ObservabilityError(
                f"{dof + n} equations for {n} parameters, and the scale of the noise is not known; "
                "measure more, or give the noise"
            )
        judged = (end.last, end.noise_scale) if solution.converged else (first, 1.0)
        check_information(problem, unknowns, judged[:1], judged[1])
    return end


_UNEVEN = 100.0  # ratio of noise up to which valleys are wide enough
_GROSS = 10.0  # misfit over the median at the start, above which the easier problem omits a row
_EASY_NEAR = 0.1  # distance from the easier problem's optimum, in σ, at which its search ends
_EASY_EVALUATIONS = 50


def _easier_start(system: System, begin: Linear, first: Linear) -> tuple[Linear, int]:
    """Return where the search begins, and the evaluations that this took.

    It is near the optimum of an easier problem if that is better than the start: the evened problem
    by least squares without gross errors, since a robust loss is not convex far from its optimum.
    ``first`` is the start with its poses solved.
    """
    problem = system.problem
    sound = first.squares <= _GROSS**2 * np.median(first.squares)
    easier = _evened(problem, first) or (problem if system.loss or not sound.all() else None)
    if easier is None:
        return first, 0
    easier_begin, solved = solve_poses(replace(begin, problem=easier))
    easy = replace(system, problem=easier, kept=system.kept & sound, loss=None)
    end = search(replace(easy, max_evaluations=_EASY_EVALUATIONS), easier_begin, enough=_EASY_NEAR)
    evaluations = solved + end.evaluations
    try:
        with np.errstate(all="ignore"):
            near, solved = solve_poses(replace(end.last, problem=problem))
            costs = [system.cost(linear) for linear in (first, near)]
    except MeasurementError:
        return first, evaluations
    better = np.isfinite(costs[1]) and not costs[1] > costs[0]
    return (near if better else first), evaluations + solved


def _evened(problem: Problem, linear: Linear) -> Problem | None:
    """Return the problem with no noise below the typical one, None if there is little to raise.

    Its optimum is nearby and has no narrow valleys: where readings are exact, a pose near a
    singularity of the nominal machine goes far astray. A serial arm has no such singularities.
    """
    if not problem.latent or any(leg.is_arm for leg in problem.legs):
        return None
    legs, observation = problem.leg_block, problem.observation
    lengths = np.array([unit == "m" for unit in observation.units], dtype=bool)
    of_legs = np.linalg.norm(linear.reading_root, axis=2)
    observed = (observation.sigma * np.where(lengths, 1.0, problem.size))[observation.measured]
    noisy = [values[values > 0.0] for values in (observed, of_legs) if (values > 0.0).any()]
    if not noisy:
        return None
    typical = float(np.median(noisy[0]))
    sigma = np.maximum(observation.sigma, np.where(lengths, typical, typical / problem.size))
    slopes = np.median(np.linalg.norm(linear.by_measured, axis=1), axis=0)
    floors = typical / np.maximum(slopes, 1e-300)
    readings = np.maximum(legs.sigma, np.where(np.isfinite(floors), floors, 0.0))
    even = (sigma <= _UNEVEN * observation.sigma) | ~observation.measured
    if even.all() and (readings <= _UNEVEN * legs.sigma).all():
        return None
    observation = observation.changed(noise=RowNoise(sigma, observation.noise.correlation))
    return replace(problem, leg_block=replace(legs, sigma=readings), observation=observation)
