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


@dataclass(frozen=True)
class Way:
    """How an end is looked for."""

    refits: int = 12
    """Of one end, at most; a straight problem takes one, a curved one three or four."""
    same: float = 2e-3
    """Of half an interval, by which an end may be off."""
    farthest: float = 100.0
    """Half intervals, past which there is no end."""
    growth: float = 3.0
    """Times as far a next step leads, at most."""
    most: int = 60
    """Evaluations of a refit."""
    nodes: int = 24
    """Of the integral of a loss's weights."""


_BY = Way()


def profile(one: Fit, rows: Array, halves: Array) -> Array:
    """Return the ends of intervals less the estimates, shape (k, 2); infinite where there is none.

    Args:
        one: The fit, converged.
        rows: Derivatives of the quantities by all unknowns, shape (k, n).
        halves: Half widths of the intervals of the same problem straightened, shape (k,).
    """
    system, T = one.system, one.unknowns.map
    if system.loss is not None:
        system = replace(system, held_scale=one.scale)
    normal = system.solve(one.last, one.weights, one.scale)
    bread, best = T @ normal.covariance @ T.T, _cost(system, one.last)
    ends, found = np.stack((-halves, halves), axis=1), {}
    for i, (row, half) in enumerate(zip(rows, halves, strict=True)):
        free, variance = row @ T, float(row @ bread @ row)
        if not (half > 0.0 and variance > 0.0):
            continue
        rise = half**2 / variance
        if rise <= rounding(system, one.last) ** 2:  # of which nothing can be read
            continue
        if (key := free.tobytes()) not in found:  # tied parameters have one interval
            held = replace(system, unknowns=one.unknowns.held(free[None]))
            path = _Path(held, one.last, bread @ row / variance, half, best, rise)
            found[key] = [sign * path.end(sign) for sign in (-1.0, 1.0)]
        ends[i] = found[key]
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
        here, at, below, above = self.optimum, 0.0, 0.0, np.inf
        before, to = (0.0, 0.0), self.half
        for _ in range(_BY.refits):
            there = self._refit(here, sign * (to - at))
            root = np.inf if there is None else self._root(there)
            if abs(root - 1.0) <= _BY.same:
                return to + (to - before[0]) * (1.0 - root) / (root - before[1])
            if root < 1.0:
                below = to
            else:
                above = to
            if there is None or not root > before[1]:
                next_ = _BY.growth * to
            elif before[1] == 0.0:  # straight at the estimate: to = half root + bend root²
                next_ = self.half + (to - self.half * root) / root**2
            else:
                next_ = to + (to - before[0]) * (1.0 - root) / (root - before[1])
            if there is not None:
                here, at, before = there, to, (to, root)
            to = min(next_, _BY.growth * max(below, self.half))
            if not below < to < above:
                to = 0.5 * (below + above) if np.isfinite(above) else _BY.growth * below
            if to > _BY.farthest * self.half:
                return np.inf
        return np.inf

    def _refit(self, here: Linear, amount: float) -> Linear | None:
        """Return the optimum with the quantity held farther on; None where there is none."""
        problem = self.system.problem
        try:
            with np.errstate(all="ignore"):
                state = problem.moved(here, amount * self.along)
                start, _ = solve_poses(problem, problem.evaluate(state))
                highest = (1.0 + ROWS_FOLLOW) * self.system.cost_at(
                    start
                )  # the last steps were taken here before
                near = search(self.system, start, highest=highest, most=_BY.most)
                found = last_steps(self.system, near)
        except (MeasurementError, np.linalg.LinAlgError):
            return None
        return found.linear if found.converged else None

    def _root(self, there: Linear) -> float:
        """Return the root of the cost's rise, 1 at an end."""
        return float(np.sqrt(max(_cost(self.system, there) - self.best, 0.0) / self.rise))


def _cost(system: System, linear: Linear) -> float:
    """Return what a fit minimises: with a loss, the integral of its weights."""
    problem = system.problem
    at = adjusted(problem, linear) if adjusts(problem) else linear
    kept = np.ones(len(at.residuals)) if system.kept is None else system.kept.astype(float)
    if system.loss is None or system.held_scale is None:
        return system.cost(system.residuals(at), kept, at.state)
    squares = at.squares / system.held_scale**2
    nodes, shares = np.polynomial.legendre.leggauss(_BY.nodes)
    mean = np.zeros(len(squares))
    for node, share in zip(0.5 * (nodes + 1.0), 0.5 * shares, strict=True):
        mean += share * system.loss.weights(node * squares, at.equations)
    return system.cost(system.residuals(at), kept * mean, at.state)
