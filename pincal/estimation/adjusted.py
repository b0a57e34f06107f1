"""The last steps: conditions at the adjusted readings, so that their noise leaves no bias.

Derivatives at readings as measured follow their noise, and a sum over many rows does not forget
that (errors in variables: a gain comes out too small). The Gauss–Helmert model takes them where
its own corrections ν lead: e(ψ + σν) − S ν, with A, B and S there. (E. M. Mikhail and F. Ackermann,
Observations and Least Squares, 1976, chapter 9; A. J. Pope, Some pitfalls to be avoided in the
iterative adjustment of nonlinear problems, 1972.)
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pincal.errors import MeasurementError
from pincal.estimation.linear import Linear
from pincal.estimation.pose_search import solve_poses
from pincal.estimation.problem import Problem
from pincal.estimation.solve import Found
from pincal.estimation.system import System


def adjusted(problem: Problem, linear: Linear) -> Linear:
    """Return the conditions at adjusted readings, less what the adjustment makes of them.

    Raises:
        MeasurementError: a residual that does not exist there.
    """
    n = problem.reading_columns[-1].stop
    noise = np.where(np.isfinite(linear.noise[:, :n]), linear.noise[:, :n], 0.0)
    shift = problem.sigma_readings * noise
    conditions = tuple(
        replace(condition, readings=condition.readings + shift[:, own])
        for condition, own in zip(problem.conditions, problem.reading_columns, strict=True)
    )
    stack = replace(problem, conditions=conditions).stack(linear.state)
    back = (stack.noise[:, :, :n] @ noise[:, :, None])[:, :, 0]
    return problem.whitened(replace(stack, value=stack.value - back))


def last_steps(system: System, found: Found, steps: int = 5, near: float = 1e-3) -> Found:
    """Return the optimum with all conditions at adjusted readings, found from that without.

    As it is where readings are exact, residuals are not whitened, or nothing gets better.

    Args:
        system: What is minimised.
        found: Its optimum at readings as measured.
        steps: How many, at most.
        near: Of a standard error: a step that is shorter changes nothing for anyone.
    """
    problem = system.problem
    if not (problem.weighted and problem.latent and found.converged):
        return found
    if not np.nanmax(problem.sigma_readings, initial=0.0) > 0.0:
        return found
    here, T = found, system.unknowns.map
    try:
        with np.errstate(all="ignore"):
            now = adjusted(problem, here.linear)
            for _ in range(steps):
                normal = system.solve(now, here.weights, here.scale)
                if not normal.decrement > near:
                    break
                state = problem.moved(here.linear, T @ normal.step())
                linear, count = solve_poses(problem, problem.linearise(state))
                trial = adjusted(problem, linear)
                costs = [system.cost(one.value, here.weights, one.state) for one in (now, trial)]
                if not costs[1] < costs[0]:
                    break
                weights, scale = system.weights(linear)
                here = replace(
                    here,
                    linear=linear,
                    weights=weights,
                    scale=scale,
                    evaluations=here.evaluations + count + 2,
                )
                now = trial
    except (MeasurementError, np.linalg.LinAlgError):
        pass
    return here
