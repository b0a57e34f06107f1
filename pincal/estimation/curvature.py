"""How curved a problem is over its own uncertainty: where standard errors stop meaning much.

Along draws δ of the covariance, poses following, residuals are r + J δ + c(δ): the root mean square
of c over that of J δ is the relative curvature at one standard error (D. M. Bates and D. G. Watts
1980, their intrinsic and parameter effects together, as seen in the rows).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pincal.estimation.fit import Fit
from pincal.estimation.linear import Linear
from pincal.estimation.pose_search import solve_poses
from pincal.estimation.problem import Problem

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_PAIRS, _CLEARLY = 3, 0.1


def curvature(one: Fit, asked: float = 0.0) -> float:
    """Return the relative curvature of a fit; infinite where its poses get lost so near to it.

    Args:
        one: The fit.
        asked: Where it is clear that the curvature is far below this, one pair of draws will do.
    """
    problem, here, some = one.problem.thinned(one.last)
    used, n = (one.weights > 0.0)[some], len(one.covariance)
    size = np.sqrt(np.diagonal(one.covariance))
    size = np.where(size > 0.0, size, 1.0)  # so that draws are the same in any unit
    values, axes = np.linalg.eigh(one.covariance / np.outer(size, size))
    root = size[:, None] * axes * np.sqrt(values.clip(0.0))
    steps = [root @ draw for draw in np.random.default_rng(0).standard_normal((_PAIRS, n))]
    found = _relative(problem, here, used, steps[:1], solved=False)
    if not found <= _CLEARLY * asked:
        found = _relative(problem, here, used, steps, solved=True)
    return found if np.isfinite(found) else np.inf


def _relative(
    problem: Problem, here: Linear, used: Mask, steps: list[Array], *, solved: bool
) -> float:
    """Return the bent part of steps over the straight one.

    Args:
        problem: The problem.
        here: Where the steps begin.
        used: Rows that count, shape (N,).
        steps: Of all unknowns, shape (n,) each.
        solved: Whether poses are solved at the ends. To second order rows do not see them move.
    """
    bent, straight = 0.0, 0.0
    for step in steps:
        ends = []
        for sign in (1.0, -1.0):
            stack = problem.stack(problem.moved(here, sign * step))
            if solved:
                stack = solve_poses(problem, problem.whitened(stack), ~used)[0].stack
            ends.append(here.white(stack.value[:, :, None])[:, :, 0])
        bent += float(((0.5 * (ends[0] + ends[1]) - here.value)[used] ** 2).sum())
        along = here.stack.after(step) - here.stack.value
        straight += float((here.white(along[:, :, None])[used] ** 2).sum())
    return float(np.sqrt(bent / straight)) if straight > 0.0 else 0.0
