"""What a search minimises: weighted rows and priors in the free unknowns, as normal equations.

A robust search weighs each row as a whole by Cauchy's loss of its χ², the sum of its squared
residuals in standard deviations. The tuning constant is the usual one of a single residual (2.385:
95 % efficiency), carried over to several residuals by equal probability.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import chdtr, chdtrc, chdtri, gammaincinv

from pincal.estimation.problem import Linear, Problem
from pincal.estimation.unknowns import Unknowns
from pincal.types import Array, Index, Mask

UNLIKELY = 1e-3  # probability that a good row is rejected, or that sound held-out rows disagree
_CAUCHY = float(chdtr(1, 2.385**2))  # probability that a good row is within the tuning constant
CLEAR = 3.0  # standard errors above which an effect is significant
FALSE_ALARM = 0.01  # probability of any finding of one kind where the model holds
NEGLIGIBLE = 1e-3  # distance that counts as converged where no step lowers the cost, [σ]


def cauchy(squares: Array, equations: Index) -> Array:
    """Return Cauchy's weights of rows, shape (N,), by their χ² and numbers of equations."""
    return np.asarray(1.0 / (1.0 + squares / _quantile(_CAUCHY, np.maximum(equations, 1))))


def outlying(squares: Array, equations: Index) -> Mask:
    """Return which rows have a χ² that only one good row in a thousand exceeds, shape (N,)."""
    return np.asarray(squares > chdtri(np.maximum(equations, 1), UNLIKELY))


def suspected(squares: Array, equations: Index) -> Mask:
    """Return which rows are outliers by Holm's procedure, shape (N,).

    One sound set of rows in a hundred has any, however many rows it has.
    """
    return holm(chdtrc(np.maximum(equations, 1), squares)) <= FALSE_ALARM


def holm(p_values: Array, tests: int | None = None) -> Array:
    """Return p-values corrected for a number of tests, (n,), by default n (S. Holm 1979)."""
    order, corrected = np.argsort(p_values, kind="stable"), np.empty(len(p_values))
    times = np.maximum((tests or len(order)) - np.arange(len(order)), 1)
    corrected[order] = np.maximum.accumulate(np.minimum(times * p_values[order], 1.0))
    return corrected


def robust_scale(squares: Array, equations: Index, share: float) -> float:
    """Return the scale of the noise by the median of the rows' χ².

    ``share`` is degrees of freedom over equations: a fit leaves that part of the squared noise.
    """
    counts = equations > 0
    ratio = squares[counts] / _quantile(0.5, equations[counts])
    return float(np.sqrt(np.median(ratio) / share)) if counts.any() else 1.0


def _quantile(probability: Array | float, equations: Index | int) -> Array:
    """Return quantiles of χ²; the function is slow, so it is called once for each number."""
    counts, places = np.unique(equations, return_inverse=True)
    return np.asarray(2.0 * gammaincinv(counts / 2.0, probability)[places])


@dataclass(frozen=True)
class System:
    """The weighted rows of a problem and its priors as functions of the free unknowns."""

    problem: Problem
    unknowns: Unknowns
    kept: Mask
    """Rows that take part, shape (N,)."""
    known: bool
    """Whether the scale of the noise is known."""
    robust: bool = False
    """Whether rows that do not fit are to be left out; a search weighs them by Cauchy's loss."""
    max_steps: int | None = None
    """Steps after which a search stops; None for the usual number."""
    tolerance: float = NEGLIGIBLE
    """Distance from the optimum at adjusted readings at which a search ends, [σ]."""
    adjusted: bool = False
    """Whether conditions are taken at adjusted readings."""
    progress: Callable[[str], None] | None = None
    """Called with a text that says what is being done."""

    def weights(self, squares: Array) -> Array:
        """Return the weights of rows by their χ², shape (N,)."""
        weights = self.kept.astype(float)
        if not self.robust:
            return weights
        return weights * cauchy(squares / self.scale(squares) ** 2, self.problem.equations)

    def scale(self, squares: Array) -> float:
        """Return the scale of the noise by the median χ² of the rows; at least 1 if it is known."""
        equations = self.problem.equations[self.kept]
        share = 1.0 - self.unknowns.n_free / max(int(equations.sum()), 1)
        scale = robust_scale(squares[self.kept], equations, max(share, 0.1))
        return max(scale, 1.0 if self.known else 1e-300)

    def triangle(self, linear: Linear, weights: Array) -> Array:
        """Return R of the Jacobian by the free unknowns and the residuals, with priors.

            ┌ J  r ┐
            │ J  r │ = Q R      one block row a pose, then the priors
            └ ⋮  ⋮ ┘

        R has shape (n_free + 1, n_free + 1); ``weights``, (N,), are of rows.
        """
        n, used, root = self.unknowns.n_free, weights > 0.0, np.sqrt(weights)[:, None]
        J, r = root[:, :, None] * linear.jacobian, root * linear.residuals
        J, r = J[used].reshape(-1, J.shape[2]) @ self.unknowns.map, r[used].ravel()
        prior, of_prior = self.unknowns.prior_rows(self.problem.values(linear.state))
        rows = np.column_stack((np.concatenate((J, of_prior)), np.append(r, prior)))
        rows = np.concatenate((rows, np.zeros((n + 1, n + 1))))  # at least as many rows as columns
        return np.asarray(np.linalg.qr(rows, mode="r"))

    def cost(
        self, linear: Linear, weights: Array | None = None, frame: Linear | None = None
    ) -> float:
        """Return the minimised cost, by default with this state's own weights and whitening."""
        weights = self.weights(linear.squares) if weights is None else weights
        value = (frame or linear).whitened(linear.conditions)
        prior, _ = self.unknowns.prior_rows(self.problem.values(linear.state))
        return float(weights @ np.einsum("nm,nm->n", value, value) + prior @ prior)


class NormalEquations(NamedTuple):
    """R δz = −c of Q R = J, where J includes the priors and has columns of unit length.

    The least-squares step removes Q c from the residuals and leaves r − Q c.
    """

    lengths: Array
    """Lengths of the columns of J, shape (n,)."""
    R: Array
    """Shape (n, n)."""
    c: Array
    """Qᵀ r, shape (n,)."""
    left: float
    """Squared norm of the remaining residuals, |r − Q c|²."""

    @classmethod
    def of(cls, triangle: Array) -> NormalEquations:
        """Return the normal equations from R of Jacobian and residuals, shape (n + 1, n + 1)."""
        n = len(triangle) - 1
        lengths = np.linalg.norm(triangle[:n, :n], axis=0)
        lengths[lengths == 0.0] = 1.0
        R, c = triangle[:n, :n] / lengths, triangle[:n, n]
        return cls(lengths, R, c, float(triangle[n, n] ** 2))

    def orthonormal(self, rows: Array) -> Array:
        """Return Q of rows of J, of the same shape (…, n)."""
        scaled = (rows / self.lengths).reshape(int(np.prod(rows.shape[:-1])), rows.shape[-1])
        return np.asarray(np.linalg.solve(self.R.T, scaled.T)).T.reshape(rows.shape)

    @property
    def root(self) -> Array:
        """Root of (JᵀJ)⁻¹, shape (n, n)."""
        return np.asarray(np.linalg.inv(self.R)) / self.lengths[:, None]

    @property
    def decrement(self) -> float:
        """Distance from the optimum to first order, in σ: root of the decrease of the cost."""
        return float(np.linalg.norm(self.c))

    def fall(self, step: Array) -> float:
        """Return the decrease of the cost by a step, shape (n,), to first order."""
        return float(self.c @ self.c - ((self.c + self.R @ (step * self.lengths)) ** 2).sum())

    def step(self, damping: float = 0.0) -> Array:
        """Return the step, shape (n,), damped relative to the squared lengths of the columns."""
        R, c, n = self.R, self.c, len(self.c)
        if damping > 0.0:
            R = np.concatenate((R, np.sqrt(damping) * np.eye(n)))
            c = np.concatenate((c, np.zeros(n)))
        return -np.linalg.lstsq(R, c, rcond=None)[0] / self.lengths
