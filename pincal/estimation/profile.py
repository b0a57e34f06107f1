"""Ends of intervals by the profile of the cost: one quantity held on a path, all others fitted.

Where the cost at its lowest along a quantity has risen as far as a straight problem's would by
half an interval, the interval ends: of a straight problem where ± half a width leads, of a curved
one nearer on one side, or nowhere (D. M. Bates and D. G. Watts, Nonlinear Regression Analysis and
Its Applications, 1988, 6.1; the rise is what ``half`` makes of it, so that a scale of the noise,
Student's quantile and the inflation of a loss are those of the standard error).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pincal.errors import MeasurementError
from pincal.estimation.adjusted import adjusted, adjusts, last_steps
from pincal.estimation.fit import Fit
from pincal.estimation.linear import Linear
from pincal.estimation.solver import rounding, search, solve_poses
from pincal.estimation.system import ROWS_FOLLOW, System
from pincal.types import Array

_REFITS = (
    12  # refits for one end, at most; a straight problem takes one, a curved one three or four
)
_SAME = 2e-3  # share of half an interval by which an end may be off
_FARTHEST = 100.0  # half intervals past which there is no end
_GROWTH = 3.0  # factor by which the next distance is longer, at most
_EVALUATIONS = 60  # evaluations of a refit
_NODES = 24  # nodes of the integral of a loss's weights


def profile(fit: Fit, rows: Array, halves: Array) -> Array:
    """Return the ends of intervals less the estimates, shape (k, 2); infinite where there is none.

    Args:
        fit: The fit, converged.
        rows: Derivatives of the quantities by all unknowns, shape (k, n).
        halves: Half widths of the intervals of the same problem straightened, shape (k,).
    """
    system, T = fit.system, fit.unknowns.map
    if system.loss is not None:
        system = replace(system, held_scale=fit.scale)
    normal = system.solve(fit.last, fit.weights, fit.scale)
    bread, best = T @ normal.covariance @ T.T, _cost(system, fit.last)
    ends, by_direction = np.stack((-halves, halves), axis=1), {}
    for i, (row, half) in enumerate(zip(rows, halves, strict=True)):
        free, variance = row @ T, float(row @ bread @ row)
        if not (half > 0.0 and variance > 0.0):
            continue
        rise = half**2 / variance
        if rise <= rounding(system, fit.last) ** 2:  # of which nothing can be read
            continue
        if (key := free.tobytes()) not in by_direction:  # tied parameters have one interval
            held = replace(system, unknowns=fit.unknowns.held(free[None]))
            path = _Path(held, fit.last, bread @ row / variance, half, best, rise)
            by_direction[key] = [sign * path.end(sign) for sign in (-1.0, 1.0)]
        ends[i] = by_direction[key]
    return ends


@dataclass(frozen=True)
class _Path:
    """Where a quantity is held, and the lowest cost there."""

    system: System
    """Without the freedom of the quantity."""
    optimum: Linear
    along: Array
    """How all unknowns follow the quantity, to first order, shape (n,)."""
    half: float
    best: float
    """Cost at the optimum."""
    rise: float
    """Of the cost at an end."""

    def end(self, sign: float) -> float:
        """Return how far the end of one side is from the estimate; infinite if there is none.

        Secants of the distance by the root of the rise, which of a straight problem is a line.
        """
        linear, distance, below, above = self.optimum, 0.0, 0.0, np.inf
        before, to = (0.0, 0.0), self.half
        for _ in range(_REFITS):
            refit = self._refit(linear, sign * (to - distance))
            root = np.inf if refit is None else self._root(refit)
            if abs(root - 1.0) <= _SAME:
                return to + (to - before[0]) * (1.0 - root) / (root - before[1])
            if root < 1.0:
                below = to
            else:
                above = to
            if refit is None or not root > before[1]:
                next_ = _GROWTH * to
            elif before[1] == 0.0:  # straight at the estimate: to = half root + bend root²
                next_ = self.half + (to - self.half * root) / root**2
            else:
                next_ = to + (to - before[0]) * (1.0 - root) / (root - before[1])
            if refit is not None:
                linear, distance, before = refit, to, (to, root)
            to = min(next_, _GROWTH * max(below, self.half))
            if not below < to < above:
                to = 0.5 * (below + above) if np.isfinite(above) else _GROWTH * below
            if to > _FARTHEST * self.half:
                return np.inf
        return np.inf

    def _refit(self, linear: Linear, amount: float) -> Linear | None:
        """Return the optimum with the quantity held farther on; None where there is none."""
        problem = self.system.problem
        try:
            with np.errstate(all="ignore"):
                state = problem.moved(linear, amount * self.along)
                start, _ = solve_poses(problem, problem.evaluate(state))
                highest = (1.0 + ROWS_FOLLOW) * self.system.cost_at(
                    start
                )  # the last steps were taken here before
                near = search(self.system, start, highest=highest, max_evaluations=_EVALUATIONS)
                solution = last_steps(self.system, near)
        except (MeasurementError, np.linalg.LinAlgError):
            return None
        return solution.linear if solution.converged else None

    def _root(self, linear: Linear) -> float:
        """Return the root of the cost's rise, 1 at an end."""
        return float(np.sqrt(max(_cost(self.system, linear) - self.best, 0.0) / self.rise))


def _cost(system: System, linear: Linear) -> float:
    """Return what a fit minimises: with a loss, the integral of its weights."""
    problem = system.problem
    conditions = adjusted(problem, linear) if adjusts(problem) else linear
    weights = system.in_use(conditions).astype(float)
    if system.loss is None or system.held_scale is None:
        return system.cost(system.residuals(conditions), weights, conditions.state)
    squares = conditions.squares / system.held_scale**2
    nodes, shares = np.polynomial.legendre.leggauss(_NODES)
    mean = np.zeros(len(squares))
    for node, share in zip(0.5 * (nodes + 1.0), 0.5 * shares, strict=True):
        mean += share * system.loss.weights(node * squares, conditions.equations)
    return system.cost(system.residuals(conditions), weights * mean, conditions.state)
