"""The fit of one problem: the search, then covariance, rank, χ² and outliers at its end."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from scipy.special import chdtrc, ndtri

from pincal.errors import MeasurementError, ObservabilityError
from pincal.estimation.noise import RowNoise
from pincal.estimation.observability.identifiable import check_information, check_rank
from pincal.estimation.problem import Linear, Problem
from pincal.estimation.solver import SolverResult, optimum, search, solve_poses, unsolved
from pincal.estimation.system import NormalEquations, System, outlying, robust_scale, suspected
from pincal.estimation.unknowns import Unknowns
from pincal.model import ROW
from pincal.types import Array, Index, Mask


@dataclass(frozen=True)
class Outlier:
    """A row of the measurements that does not fit the others."""

    row: int
    """Index of the row, from 0."""
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
    """The optimum of a problem with its covariance (JᵀJ)⁻¹; errors ρ move it by −(JᵀJ)⁻¹ Jᵀ ρ."""

    system: System
    """What was minimised."""
    first: Linear
    """Conditions where the search began."""
    outliers: tuple[Outlier, ...] = ()
    """Rows that did not fit, the worst first."""
    widening: Array | float = 0.0
    """Added to the covariance because the noise was estimated, shape (n, n)."""
    exact: int = 0
    """Degrees of freedom of readings whose estimated noise is at its floor (exact readings)."""

    def at_noise_of(self, problem: Problem) -> Self:
        """Return the fit of a problem with other noise, to first order without a new search."""
        system, last = replace(self.system, problem=problem), replace(self.last, problem=problem)
        return replace(self, system=system, last=last)

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

    @property
    def good(self) -> Mask:
        """Which rows take part, shape (N,)."""
        return self.system.kept

    @cached_property
    def degrees_of_freedom(self) -> int:
        """Equations of good rows and priors, less free unknowns and exact readings."""
        n_priors, used = int(np.isfinite(self.unknowns.priors).sum()), self.unknowns.n_free
        return int(self.last.equations[self.good].sum()) + n_priors - used - self.exact

    @cached_property
    def chi2(self) -> float:
        """Weighted sum of squares."""
        return self.system.cost(self.last)

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
    def root(self) -> Array:
        """Derivatives of all unknowns by orthonormal free ones, shape (n, n_free)."""
        return self.unknowns.map @ self.normal.root

    @cached_property
    def covariance(self) -> Array:
        """Covariance of all unknowns, (n, n), scaled by reduced χ² if noise was estimated."""
        return np.asarray(self.noise_scale**2 * self.root @ self.root.T + self.widening)

    def response(self, errors: Array) -> Array:
        """Return the changes of all unknowns, (n, q), by errors of conditions, (N, k, q)."""
        J, white = self.last.jacobian[self.good], self.last.white(errors)[self.good]
        right = np.einsum("nmk,nmq->kq", J, white, optimize=True)
        return np.asarray(-self.root @ (self.root.T @ right))

    @cached_property
    def influence(self) -> Array:
        """Derivatives of all unknowns by the noise in standard deviations, shape (N, n, s)."""
        follows = self.last.jacobian.transpose(0, 2, 1) @ self.last.white.by_noise
        follows[~self.good] = 0.0
        return -self.noise_scale * (self.root @ self.root.T) @ follows


def fit(system: System, begin: Linear, *, near: bool = False) -> Fit:
    """Return the fit of a problem, from nominal parameters or from near the optimum.

    Raises:
        ObservabilityError: parameters are not determined, or by the noise only.
        MeasurementError: residuals do not exist, or have no noise.
    """
    problem, unknowns = system.problem, system.unknowns
    first = solve_poses(begin)
    check_rank(problem, unknowns, first)
    start = first if near else _easier_start(system, first)
    solution = optimum(system, start, system.cost(first), near=near)
    check_rank(problem, unknowns, solution.last, ended=True)
    end = Fit(**vars(solution), system=system, first=first)
    n, dof = unknowns.n_free, end.degrees_of_freedom
    if not system.known and dof < 1:
        raise ObservabilityError(
            f"{dof + n} equations for {n} parameters, and the scale of the noise is not known; "
            "measure more, or give the noise"
        )
    if not problem.latent:  # at the start of a search a pose may be too near to a singularity
        check_information(problem, unknowns, (first, end.last), end.noise_scale)
    return end


_UNEVEN = 100.0  # ratio of noise up to which valleys are wide enough
_GROSS = 10.0  # misfit over the median at the start, above which the easier problem omits a row
_EASY_NEAR = 0.1  # distance from the easier problem's optimum, in σ, at which its search ends
_EASY_STEPS = 25


def _easier_start(system: System, first: Linear) -> Linear:
    """Return where the search begins, from the conditions at the first parameters, poses solved.

    It is near the optimum of an easier problem if that is better than the start: the evened problem
    by least squares without gross errors, since Cauchy's loss is not convex far from its optimum.
    """
    problem = system.problem
    sound = first.squares <= _GROSS**2 * np.median(first.squares)
    easier = _evened(problem, first) or (problem if system.robust or not sound.all() else None)
    if easier is None:
        return first
    easier_begin = solve_poses(replace(first, problem=easier))
    easy = replace(system, problem=easier, kept=system.kept & sound, robust=False)
    end = search(replace(easy, max_steps=_EASY_STEPS), easier_begin, enough=_EASY_NEAR)
    try:
        with np.errstate(all="ignore"):
            near = solve_poses(replace(end.last, problem=problem))
            costs = [system.cost(linear) for linear in (first, near)]
    except MeasurementError:
        return first
    return near if np.isfinite(costs[1]) and not costs[1] > costs[0] else first


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


_LEAST = float(np.finfo(float).tiny)  # smallest probability that a float can hold
_ROUNDS = 10  # largest number of rounds of leaving rows out
_LINEAR = 0.1  # share of the machine's size, or [rad], up to which noise acts linearly


def robust_fit(system: System, begin: Linear, *, near: bool = False) -> Fit:
    """Return the fit of a problem and its outliers, which a ``robust`` system leaves out.

    The search begins at nominal parameters, or near the optimum.
    """
    if system.robust:
        optimum, scale = _fit_rejecting(system, begin, near=near)
        judged = scale
    else:
        optimum = fit(system, begin, near=near)
        scale = judged = optimum.noise_scale
        squares, equations = optimum.last.squares, optimum.last.equations
        share = optimum.degrees_of_freedom / max(int(equations.sum()), 1)
        if share > 0.0:  # where every row misses by more, the noise given is wrong, and no row
            judged = max(scale, robust_scale(squares, equations, share))
    return replace(optimum, outliers=_outliers(optimum, scale, judged, system.kept))


def _fit_rejecting(system: System, begin: Linear, *, near: bool) -> tuple[Fit, float]:
    """Return the least-squares fit of the rows that fit each other, and the scale of the noise.

    From nominal parameters a search by Cauchy's loss, which gives every row some weight, comes
    first. Near an optimum the conditions there give the scale.
    """
    problem, squares_only = system.problem, replace(system, robust=False)
    linear = first = solve_poses(begin)
    if not near:
        check_rank(problem, system.unknowns, first)
        linear = search(system, _easier_start(system, first)).last
    scale = system.scale(linear.squares)
    # Rows whose pose was not found, or whose noise moves the machine by a large part of its size,
    # have meaningless derivatives, and no loss bounds their influence.
    moved = (linear.white.noise @ linear.noise[:, :, None])[:, :, 0]
    largest = {"m": _LINEAR * problem.size, "rad": _LINEAR}
    sound = (np.abs(moved) <= [largest.get(unit, np.inf) for unit in problem.units]).all(axis=1)
    sound &= system.kept & ~unsolved(linear)
    rows = None
    for _ in range(_ROUNDS):
        inliers = sound & ~outlying(linear.squares / scale**2, linear.equations)
        if rows is not None and (inliers == rows).all():
            break
        rows = inliers
        optimum = fit(replace(squares_only, kept=inliers), linear, near=True)
        linear = optimum.last
    return replace(optimum, first=first), scale


def _outliers(fit: Fit, scale: float, judged: float, counted: Mask) -> tuple[Outlier, ...]:
    """Return the rows that do not fit at a scale of the noise, the worst first.

    Rows in use are judged by the larger of ``scale`` and ``judged``. Rows that do not count, such
    as verification rows, are judged elsewhere.
    """
    linear = fit.last
    if not (fit.converged and scale > 0.0):
        return ()
    far = suspected(linear.squares / max(scale, judged) ** 2, linear.equations)
    rows = np.flatnonzero((~fit.good | far) & (linear.equations > 0) & counted)
    sigmas, outliers = as_one(linear.squares / scale**2, linear.equations), list[Outlier]()
    for i in rows[np.argsort(-sigmas[rows], kind="stable")].tolist():
        sigma, quantity = most_off(linear, i)
        row, weight = int(fit.rows[i]), float(fit.good[i])
        outliers.append(Outlier(row, float(sigmas[i]), weight, quantity, sigma / scale))
    return tuple(outliers)


def most_off(linear: Linear, row: int) -> tuple[float, str]:
    """Return by how much a row's worst quantity is off, in standard deviations, and its name.

    The place of a row itself, which follows distances measured from it, does not count.
    """
    noise = zip(np.abs(linear.noise[row]).tolist(), linear.problem.quantities, strict=False)
    sigma, name = max(pair for pair in noise if not pair[1].startswith(f"measured {ROW}_"))
    return sigma, linear.problem.observation.named(name, row)


def as_one(squares: Array, equations: Array | Index) -> Array:
    """Return sizes of single normal residuals that are as unlikely as χ² of several, shape (N,)."""
    chances = chdtrc(np.maximum(equations, 1), squares)
    return np.where(chances > _LEAST, -ndtri(chances / 2.0), np.sqrt(squares))
