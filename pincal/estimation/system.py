"""What a search minimises: weighted rows and priors in the free unknowns, as normal equations."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pincal.estimation.problem import Linear, Problem
from pincal.estimation.residuals.losses import Loss, robust_scale
from pincal.estimation.rows import WhiteRows, plain_rows
from pincal.estimation.unknowns import Unknowns
from pincal.types import Array, Mask

ROWS_FOLLOW = 1e-3  # share of the cost by which it may grow as rows follow the state


@dataclass(frozen=True)
class System:
    """The weighted rows of a problem and its priors, in the free unknowns."""

    problem: Problem
    unknowns: Unknowns
    known: bool
    """Whether the scale of the noise is known."""
    loss: Loss | None = None
    kept: Mask | None = None
    """Rows that take part, shape (N,); all if not given."""
    held_scale: float | None = None
    """Scale of the noise that a loss goes by; by the rows in the middle if not given."""
    adjusted: bool = False
    """Whether conditions are those at adjusted readings."""
    unit: float = 1.0
    """Typical standard deviation of residuals that are minimised unweighted, [rad] or [m]."""

    def with_priors(self, priors: Array) -> System:
        """Return the system with other standard deviations of nominal values, shape (n,)."""
        return replace(self, unknowns=replace(self.unknowns, priors=priors))

    def in_use(self, linear: Linear) -> Mask:
        """Return which rows take part, shape (N,)."""
        return np.ones(len(linear.conditions), dtype=bool) if self.kept is None else self.kept

    def weights(self, linear: Linear) -> tuple[Array, float]:
        """Return the weight of each row, shape (N,), and the scale of the noise."""
        weights = self.in_use(linear).astype(float)
        if self.loss is None:
            return weights, 1.0
        scale = self.held_scale or max(self.scale(linear), 1.0 if self.known else 1e-300)
        return weights * self.loss.weights(linear.squares / scale**2, linear.equations), scale

    def scale(self, linear: Linear) -> float:
        """Return the scale of the noise by the rows in the middle."""
        rows = self.in_use(linear)
        equations = linear.equations[rows]
        share = 1.0 - self.unknowns.n_free / max(int(equations.sum()), 1)
        return robust_scale(linear.squares[rows], equations, max(share, 0.1))

    def rows(self, linear: Linear) -> WhiteRows:
        """Return what makes the rows that are minimised: white ones, or plain ones over a unit."""
        weighted = self.problem.weighted
        return linear.white if weighted else plain_rows(linear.white.noise, self.unit)

    def residuals(self, linear: Linear, frame: Linear | None = None) -> Array:
        """Return what is minimised, shape (N, m), in the rows of another state if one is given."""
        return self.rows(frame or linear)(linear.conditions[:, :, None])[:, :, 0]

    def derivatives(self, linear: Linear, poses: slice = slice(None)) -> Array:
        """Return the derivatives of what is minimised, shape (N, m, n)."""
        return linear.jacobian_of(poses, self.rows(linear))

    def triangle(
        self, linear: Linear, weights: Array, bend: Array | None = None, *, white: bool = False
    ) -> Array:
        """Return R of the Jacobian in the free unknowns beside the residuals, with priors.

            ┌ J  r ┐
            │ J  r │ = Q R      one block row a pose, those of the priors above
            └ ⋮  ⋮ ┘

        Args:
            linear: Where.
            weights: Of the rows, shape (N,).
            bend: Curvature of a loss along each row's residuals over its weight, shape (N,).
            white: Whether of white residuals, if others are minimised.

        Returns:
            Shape (n_free + 1, n_free + 1).
        """
        rows = linear.white if white else self.rows(linear)
        residuals = rows(linear.conditions[:, :, None])[:, :, 0]
        r, J = self.unknowns.prior_rows(linear.state.parameters)
        n = self.unknowns.n_free
        R = np.concatenate((np.column_stack((J, r)), np.zeros((n + 1, n + 1))))
        for poses in linear.parts():
            used, root = weights[poses] > 0.0, np.sqrt(weights[poses])[:, None]
            J, r = root[:, :, None] * linear.jacobian_of(poses, rows), root * residuals[poses]
            if bend is not None:
                J, r = bent(J, r, np.sqrt(bend[poses]))
            J = J[used].reshape(-1, J.shape[2]) @ self.unknowns.map
            below = np.column_stack((J, r[used].ravel()))
            R = np.asarray(np.linalg.qr(np.concatenate((R, below)), mode="r"))
        return R

    def cost(self, value: Array, weights: Array, linear: Linear) -> float:
        """Return what is minimised at a state, from residuals of shape (N, m)."""
        prior, _ = self.unknowns.prior_rows(linear.state.parameters)
        return float(weights @ np.einsum("nm,nm->n", value, value) + prior @ prior)

    def cost_at(self, linear: Linear) -> float:
        """Return what is minimised at conditions, in their own weights."""
        return self.cost(self.residuals(linear), self.weights(linear)[0], linear)

    def cost_in(self, frame: Linear, trial: Linear, weights: Array) -> float:
        """Return the cost at a trial, in the rows and weights of another state."""
        return self.cost(self.residuals(trial, frame), weights, trial)

    def falls(self, start: Linear, trial: Linear, weights: Array, cost: float) -> bool:
        """Return whether a step is a good one.

        In the weights of its beginning: what a loss minimises lies below (majorisation). Far from
        the optimum, where rows turn with the state, in the rows of its end; near it, in those of
        its beginning.
        """
        trial_cost = self.cost_in(trial, trial, weights)
        near = trial_cost <= (1.0 + ROWS_FOLLOW) * cost
        return trial_cost < cost or (near and self.cost_in(start, trial, weights) <= cost)

    def solve(self, linear: Linear, weights: Array, scale: float) -> NormalEquations:
        """Return the normal equations in square-root form, a loss with its curvature."""
        bend = None
        if self.loss is not None:
            bend = self.loss.bend(linear.squares / scale**2, linear.equations)
        return NormalEquations.of(self.triangle(linear, weights, bend))


def bent(J: Array, r: Array, root: Array) -> tuple[Array, Array]:
    """Return rows whose squares have the curvature of a loss along them, and its gradient.

    B. Triggs et al., Bundle adjustment (2000), 4.3. Shapes (N, m, n), (N, m) and (N,).
    """
    length = np.linalg.norm(r, axis=1)
    along = r / np.where(length > 0.0, length, 1.0)[:, None]
    J = J + ((root - 1.0)[:, None] * along)[:, :, None] * (along[:, None] @ J)
    return J, r / root[:, None]


@dataclass(frozen=True)
class NormalEquations:
    """R δz = −c of Q R = J, columns of J of unit length; rows of the priors are among those of J.

    Least squares with J take up Q c of the residuals and leave r − Q c.
    """

    lengths: Array
    """Of the columns of J, shape (n,)."""
    R: Array
    """Shape (n, n)."""
    c: Array
    """Qᵀ r, shape (n,)."""
    left: float
    """Square of what is left of the residuals, |r − Q c|²."""

    @classmethod
    def of(cls, triangle: Array) -> NormalEquations:
        """Return the normal equations of R of Jacobian and residuals, shape (n + 1, n + 1)."""
        n = len(triangle) - 1
        lengths = np.linalg.norm(triangle[:n, :n], axis=0)
        lengths[lengths == 0.0] = 1.0
        R, c = triangle[:n, :n] / lengths, triangle[:n, n]
        return cls(lengths, R, c, float(triangle[n, n] ** 2))

    def orthonormal(self, rows: Array) -> Array:
        """Return Q of rows of J, of the same shape (…, n)."""
        scaled = (rows / self.lengths).swapaxes(-1, -2)
        return np.asarray(np.linalg.solve(self.R.T, scaled)).swapaxes(-1, -2)

    @property
    def root(self) -> Array:
        """Root of (JᵀJ)⁻¹, shape (n, n)."""
        return np.asarray(np.linalg.inv(self.R)) / self.lengths[:, None]

    @property
    def decrement(self) -> float:
        """How far the optimum is, to first order: root of the fall of the cost, in σ."""
        return float(np.linalg.norm(self.c))

    def fall(self, step: Array) -> float:
        """Return by how much the cost falls by a step, shape (n,), to first order."""
        return float(self.c @ self.c - ((self.c + self.R @ (step * self.lengths)) ** 2).sum())

    def step(self, damping: float = 0.0) -> Array:
        """Return the least-squares step, shape (n,); damping relative to squares of columns."""
        R, c, n = self.R, self.c, len(self.c)
        if damping > 0.0:
            R = np.concatenate((R, np.sqrt(damping) * np.eye(n)))
            c = np.concatenate((c, np.zeros(n)))
        return -np.linalg.lstsq(R, c, rcond=None)[0] / self.lengths
