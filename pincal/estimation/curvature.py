"""How curved a problem is over its own uncertainty: where standard errors stop meaning much.

Along draws δ of the covariance, poses following, residuals are r + J δ + c(δ): the root mean square
of c over that of J δ is the relative curvature at one standard error (D. M. Bates and D. G. Watts
1980, their intrinsic and parameter effects together, as seen in the rows).
"""

from __future__ import annotations

import numpy as np

from pincal.estimation.fit import Fit
from pincal.estimation.pose_search import solve_poses

_PAIRS, _CLEARLY = 3, 0.1
_ROWS = 2000  # enough to judge by


def curvature(one: Fit, asked: float = 0.0) -> float:
    """Return the relative curvature of a fit; infinite where its poses get lost so near to it.

    Args:
        one: The fit.
        asked: Where it is clear that the curvature is far below this, one pair of draws will do.
    """
    problem, here, used = one.problem, one.last, one.weights > 0.0
    some = np.arange(0, len(used), -(-len(used) // _ROWS))
    if len(some) < len(used):
        problem, used = problem.part(some), used[some]
        here = problem.linearise(here.state.rows(some))
    n = len(one.covariance)
    values, axes = np.linalg.eigh(one.covariance)
    root = axes * np.sqrt(values.clip(0.0))
    bent, straight = 0.0, 0.0
    for draw in np.random.default_rng(0).standard_normal((_PAIRS, n)):
        step = root @ draw
        ends = []
        for sign in (1.0, -1.0):
            there = problem.linearise(problem.moved(here, sign * step))
            ends.append(here.frozen(solve_poses(problem, there, ~used)[0]))
        bent += float(((0.5 * (ends[0] + ends[1]) - here.value)[used] ** 2).sum())
        straight += float(((here.jacobian[used] @ step) ** 2).sum())
        if bent <= (_CLEARLY * asked) ** 2 * straight:
            break
    found = np.sqrt(bent / straight) if straight > 0.0 else 0.0
    return float(found) if np.isfinite(found) else np.inf
