"""What a search minimises: weighted rows and priors in the free unknowns, as normal equations.

A robust loss judges a row as a whole, by the sum of its squared residuals in standard deviations:
χ², for a good row, with as many degrees of freedom as it has equations. Tuning constants are the
usual ones of a single residual (Huber 1.345, Cauchy 2.385, Tukey 4.685: 95 % efficiency), carried
over to several residuals by equal probability.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from scipy.special import chdtr, chdtrc, chdtri, gammaincinv

from pincal.errors import MeasurementError
from pincal.estimation.problem import Linear, Problem
from pincal.estimation.unknowns import Unknowns
from pincal.types import Array, Index, Mask

LossName = Literal["none", "huber", "cauchy", "tukey", "reject"]
UNLIKELY = 1e-3  # probability that a good row is rejected, or that sound held-out rows disagree
_STEP = 1e-4  # step in the logarithm of a residual, for slopes by differences
_LEAST_BEND = 1e-2
CLEAR = 3.0  # standard errors above which an effect is significant
FALSE_ALARM = 0.01  # probability of any finding of one kind where the model holds


@dataclass(frozen=True)
class Loss:
    """Weights of rows by the root of their χ²."""

    name: str
    weigh: Callable[[Array], Array]
    """Weight by the root of χ² over the tuning constant."""
    probability: float
    """Probability with which a good row's χ² is below the square of the tuning constant."""

    def constant(self, equations: Index) -> Array:
        """Return the tuning constants of rows with given numbers of equations, same shape."""
        return np.sqrt(_quantile(self.probability, np.maximum(equations, 1)))

    def weights(self, squares: Array, equations: Index) -> Array:
        """Return the weights of rows, shape (N,), from their χ² and numbers of equations."""
        return self.weigh(np.sqrt(squares) / self.constant(equations))

    def slope(self, squares: Array, equations: Index) -> Array:
        """Return the curvature along the residuals, d(u w)/du, shape (N,)."""
        u, h = np.sqrt(squares) / self.constant(equations), _STEP
        less, upper = (np.exp(step) * self.weigh(u * np.exp(step)) for step in (-h, h))
        return np.asarray((upper - less) / (2.0 * np.sinh(h)))

    def bend(self, squares: Array, equations: Index) -> Array:
        """Return the slope over the weight, (N,), not below a least curvature above zero."""
        w = self.weights(squares, equations)
        bend = np.divide(self.slope(squares, equations), w, out=np.ones_like(w), where=w > 0.0)
        return np.clip(bend, _LEAST_BEND, 1.0)

    def moments(
        self, squares: Array, equations: Index, free: int = 0
    ) -> tuple[float, float, float]:
        """Return the mean slope of ψ, its mean square, and Huber's small-sample factor.

        With n equations and p free parameters: m, the mean of ψ's slopes (w across the residuals,
        d(u w)/du along them), the mean square Σ w² d² / (n − p), and K = 1 + (p / n) v / m², v the
        variance of the slopes (P. J. Huber, Robust Statistics, 1981, 7.6).
        """
        k, w = equations.astype(float), self.weights(squares, equations)
        n, along = max(float(k.sum()), 1.0), self.slope(squares, equations)
        along, across = np.where(k > 0.0, along, 0.0), np.maximum(k - 1.0, 0.0)
        m = max(float(across @ w + along.sum()) / n, _LEAST_BEND)
        v = float(across @ w**2 + (along**2).sum()) / n - m**2
        return m, float(w**2 @ squares) / max(n - free, 1.0), 1.0 + free / n * v / m**2


LOSSES: dict[str, Loss] = {
    "huber": Loss("huber", lambda u: 1.0 / np.maximum(1.0, u), float(chdtr(1, 1.345**2))),
    "cauchy": Loss("cauchy", lambda u: 1.0 / (1.0 + u**2), float(chdtr(1, 2.385**2))),
    "tukey": Loss("tukey", lambda u: (1.0 - np.minimum(u, 1.0) ** 2) ** 2, chdtr(1, 4.685**2)),
    "reject": Loss("reject", lambda u: np.where(u < 1.0, 1.0, 0.0), 1.0 - UNLIKELY),
}


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


def loss_of(loss: LossName | Loss) -> Loss | None:
    """Return a loss by its name, or the loss itself; None for ``"none"``.

    Raises:
        MeasurementError: the name is unknown.
    """
    if isinstance(loss, Loss):
        return loss
    if loss == "none":
        return None
    if loss not in LOSSES:
        raise MeasurementError(
            f"unknown loss {loss!r}; expected one of none, {', '.join(LOSSES)}, or a pincal.Loss"
        )
    return LOSSES[loss]


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
    loss: Loss | None = None
    max_evaluations: int | None = None
    """Evaluations of the conditions after which a search stops; None for the usual number."""
    held_scale: float | None = None
    """Scale of the noise for a robust loss; None to estimate it by the median χ² of the rows."""
    adjusted: bool = False
    """Whether conditions are taken at adjusted readings."""
    progress: Callable[[str], None] | None = None
    """Called with a text that says what is being done."""

    def with_priors(self, priors: Array) -> System:
        """Return the system with other standard deviations of nominal values, shape (n,)."""
        return replace(self, unknowns=replace(self.unknowns, priors=priors))

    def weights(self, squares: Array) -> tuple[Array, float]:
        """Return the weights of rows, shape (N,), by their χ², and the scale of the noise."""
        weights = self.kept.astype(float)
        if self.loss is None:
            return weights, 1.0
        scale = self.held_scale or max(self.scale(squares), 1.0 if self.known else 1e-300)
        return weights * self.loss.weights(squares / scale**2, self.problem.equations), scale

    def scale(self, squares: Array) -> float:
        """Return the scale of the noise by the median χ² of the rows."""
        equations = self.problem.equations[self.kept]
        share = 1.0 - self.unknowns.n_free / max(int(equations.sum()), 1)
        return robust_scale(squares[self.kept], equations, max(share, 0.1))

    def triangle(self, linear: Linear, weights: Array, bend: Array | None = None) -> Array:
        """Return R of the Jacobian by the free unknowns and the residuals, with priors.

            ┌ J  r ┐
            │ J  r │ = Q R      one block row a pose, then the priors
            └ ⋮  ⋮ ┘

        R has shape (n_free + 1, n_free + 1). ``weights``, (N,), are of rows; ``bend``, (N,), is the
        curvature of a robust loss along each row's residuals over its weight.
        """
        n, used, root = self.unknowns.n_free, weights > 0.0, np.sqrt(weights)[:, None]
        J, r = root[:, :, None] * linear.jacobian, root * linear.residuals
        if bend is not None:
            J, r = bent(J, r, np.sqrt(bend))
        J, r = J[used].reshape(-1, J.shape[2]) @ self.unknowns.map, r[used].ravel()
        prior, of_prior = self.unknowns.prior_rows(self.problem.values(linear.state))
        rows = np.column_stack((np.concatenate((J, of_prior)), np.append(r, prior)))
        rows = np.concatenate((rows, np.zeros((n + 1, n + 1))))  # at least as many rows as columns
        return np.asarray(np.linalg.qr(rows, mode="r"))

    def cost(
        self, linear: Linear, weights: Array | None = None, frame: Linear | None = None
    ) -> float:
        """Return the minimised cost, by default with this state's own weights and whitening."""
        weights = self.weights(linear.squares)[0] if weights is None else weights
        value = (frame or linear).whitened(linear.conditions)
        prior, _ = self.unknowns.prior_rows(self.problem.values(linear.state))
        return float(weights @ np.einsum("nm,nm->n", value, value) + prior @ prior)

    def solve(self, linear: Linear, weights: Array, scale: float) -> NormalEquations:
        """Return the normal equations in square-root form, with the curvature of a robust loss."""
        bend = None
        if self.loss is not None:
            bend = self.loss.bend(linear.squares / scale**2, linear.equations)
        return NormalEquations.of(self.triangle(linear, weights, bend))


def bent(J: Array, r: Array, root: Array) -> tuple[Array, Array]:
    """Return rows whose sum of squares has the gradient and the curvature of a robust loss.

    B. Triggs et al., Bundle adjustment (2000), 4.3. Shapes (N, m, n), (N, m) and (N,).
    """
    length = np.linalg.norm(r, axis=1)
    along = r / np.where(length > 0.0, length, 1.0)[:, None]
    J = J + ((root - 1.0)[:, None] * along)[:, :, None] * (along[:, None] @ J)
    return J, r / root[:, None]


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
