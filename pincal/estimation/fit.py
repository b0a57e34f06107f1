"""The fit of one problem: the search, and what is known at its end: covariance, rank, χ²."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pincal.errors import ObservabilityError
from pincal.estimation.adjusted import adjusts, last_steps
from pincal.estimation.linear import Linear, Orthonormal, State
from pincal.estimation.observability.identifiable import check_information, check_rank
from pincal.estimation.pose_search import solve_poses
from pincal.estimation.problem import Problem
from pincal.estimation.residuals.losses import outlying
from pincal.estimation.solve import BY, near_start, search
from pincal.estimation.spread import Spread
from pincal.estimation.system import ROWS_FOLLOW, System
from pincal.estimation.unknowns import Unknowns

Array = NDArray[np.float64]


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
    left: float
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
    def good(self) -> NDArray[np.bool_]:
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
    most: int | None = None,
) -> Fit:
    """Return the least-squares fit of a problem.

    Args:
        system: What is minimised.
        start: Where the search starts; the nominal parameters if not given.
        progress: Called with what is being done.
        ran_away: Called if the rank is lost where the search ended; may raise what says more.
        most: Evaluations of the conditions after which to stop searching.

    Raises:
        ObservabilityError: parameters are not determined, or by the noise only.
        MeasurementError: residuals that do not exist, or have no noise.
    """
    problem, unknowns = system.problem, system.unknowns
    state = start or problem.start(unknowns.start[: problem.n_parameters])
    first, count = solve_poses(problem, problem.linearise(state))
    check_rank(problem, unknowns, first)
    if not problem.weighted:
        system = replace(system, unit=float(np.median(np.linalg.norm(first.stack.noise, axis=2))))
    weights, _ = system.weights(first)
    begun = highest = system.cost(system.residuals(first), weights, first.state)
    if start is not None:  # where the last steps ended, which the search does not know of
        highest *= 1.0 + ROWS_FOLLOW
    near, more = near_start(system, first, progress) if start is None else (first, 0)
    enough = BY.slow if adjusts(problem) else 0.0  # the last steps go on from there
    found = search(system, near, progress, highest=highest, enough=enough, most=most)
    found = last_steps(system, found)
    linear, weights = found.linear, found.weights
    if system.known:  # where the search starts, a pose may be nearer to a singularity than it is
        check_information(problem, unknowns, (first, linear))
    try:
        ranks = check_rank(problem, unknowns, linear, ended=True)
    except ObservabilityError as error:
        if ran_away:
            ran_away(error)
        raise
    chi2, dof = _chi2(system, linear, weights, found.scale)
    if dof < 1 and not system.known:
        n = unknowns.map.shape[1]
        raise ObservabilityError(
            f"{dof + n} equations for {n} parameters, and the scale of the noise is not known; "
            "measure more, or give the noise"
        )
    spread = Spread.of(system, linear, weights, found.scale, chi2 / max(dof, 1))
    covariance = spread.covariance
    if not system.known:
        size = float(np.sqrt(chi2 / dof))
        at = (linear, size) if found.converged else (first, 1.0)
        check_information(problem, unknowns, (at[0],), at[1])
        covariance = covariance * size**2
    return Fit(
        system=system,
        first=first,
        last=linear,
        weights=weights,
        scale=found.scale,
        covariance=covariance,
        spread=spread,
        ranks=ranks,
        chi2=chi2,
        degrees_of_freedom=dof,
        evaluations=found.evaluations + count + more,
        converged=found.converged,
        left=found.left,
        costs=found.costs if near is first else (float(begun), *found.costs),
    )


def _good(system: System, linear: Linear, weights: Array, scale: float) -> NDArray[np.bool_]:
    if system.loss is None:
        return weights > 0.0
    return (weights > 0.0) & ~outlying(linear.squares / scale**2, linear.equations)


def _chi2(system: System, linear: Linear, weights: Array, scale: float) -> tuple[float, int]:
    """Return χ² and the degrees of freedom of rows in use and priors.

    With a robust loss, that of the rows that are not outliers, at their own optimum.
    """
    prior, _ = system.unknowns.prior_rows(system.values(linear.state))
    own = _good(system, linear, weights, scale)
    dof = int(linear.equations[own].sum()) + len(prior) - system.unknowns.map.shape[1]
    if system.loss is None and system.problem.weighted:
        return float(weights[own] @ linear.squares[own] + prior @ prior), dof
    triangle = system.triangle(linear, own.astype(float), white=True)
    return float(triangle[-1, -1] ** 2), dof  # what white residuals would be at their own optimum


def without(system: System, kept: NDArray[np.bool_]) -> System:
    """Return the least squares of some rows."""
    return replace(system, loss=None, kept=kept)
