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
from pincal.estimation.problem import Problem
from pincal.estimation.solver import NEGLIGIBLE, SolverResult, solve_poses
from pincal.estimation.system import NormalEquations, System
from pincal.types import Array

_STEPS = 30  # steps at most; most fits need two or three
_SHORTEST = 1e-4  # share of a step that is still tried
_CORRECTIONS = 4  # corrections of the readings in a step, at most
_SAME = 1e-3  # standard deviations by which corrections may still change


def adjusted(problem: Problem, linear: Linear) -> Linear:
    """Return the conditions at adjusted readings, less what the adjustment makes of them.

    Corrections follow from the conditions at the readings that they correct: found again until
    they stay.

    Raises:
        MeasurementError: a residual that does not exist there.
    """
    noise = np.zeros_like(problem.leg_block.sigma)
    found = linear
    for _ in range(_CORRECTIONS):
        before, noise = noise, _corrections(problem, found)
        if np.abs(noise - before).max(initial=0.0) <= _SAME:
            break
        found = _at(problem, linear, noise)
    return found


def _corrections(problem: Problem, linear: Linear) -> Array:
    """Return the corrections of readings in standard deviations, shape (N, n_readings)."""
    noise = linear.noise[:, : problem.leg_block.n_readings]
    return np.where(np.isfinite(noise), noise, 0.0)


def _at(problem: Problem, linear: Linear, noise: Array) -> Linear:
    """Return the conditions at readings that are corrected by so many standard deviations."""
    legs = problem.leg_block.corrected(problem.leg_block.sigma * noise)
    there = replace(problem, leg_block=legs).evaluate(linear.state)
    back = (there.noise_root[:, :, : noise.shape[1]] @ noise[:, :, None])[:, :, 0]
    return replace(there, conditions=there.conditions - back)


def adjusts(problem: Problem) -> bool:
    """Return whether a problem's fit ends at adjusted readings."""
    noisy = np.nanmax(problem.leg_block.sigma, initial=0.0) > 0.0
    return problem.weighted and problem.latent and bool(noisy)


def last_steps(system: System, found: SolverResult) -> SolverResult:
    """Return the optimum with all conditions at adjusted readings, found from that without.

    As it is where readings are exact, residuals are not whitened, or nothing gets better. A step
    that does not make the cost fall is tried shorter.

    Args:
        system: What is minimised.
        found: Its optimum at readings as measured.
    """
    problem = system.problem
    if not (adjusts(problem) and found.converged):
        return found
    here = found
    try:
        with np.errstate(all="ignore"):
            now = adjusted(problem, here.linear)
            normal = system.solve(now, here.weights, here.scale)
            share, tried = 1.0, 0
            while normal.decrement > NEGLIGIBLE and tried < _STEPS and share > _SHORTEST:
                tried += 1
                there, trial = _stepped(system, here, normal, share)
                costs = [
                    system.cost(one.residuals, here.weights, one.state) for one in (now, trial)
                ]
                if not costs[1] < costs[0]:
                    share /= 4.0
                    continue
                there = replace(there, costs=(*here.costs, float(costs[1])))
                here, now, share = there, trial, min(1.0, 2.0 * share)
                normal = system.solve(now, here.weights, here.scale)
    except (MeasurementError, np.linalg.LinAlgError):  # no such conditions there: as it was
        return found
    cost = system.cost(now.residuals, here.weights, here.linear.state)
    dof = max(int(now.equations[here.weights > 0.0].sum()) - system.unknowns.map.shape[1], 1)
    left = normal.decrement / (1.0 if system.known else max(float(np.sqrt(cost / dof)), 1e-300))
    return replace(here, distance=left, converged=left <= 10.0 * NEGLIGIBLE)


def _stepped(
    system: System, here: SolverResult, normal: NormalEquations, share: float
) -> tuple[SolverResult, Linear]:
    """Return where a share of a step leads, and the conditions there at adjusted readings."""
    problem = system.problem
    state = problem.moved(here.linear, share * (system.unknowns.map @ normal.step()))
    linear, count = solve_poses(problem, problem.evaluate(state))
    weights, scale = system.weights(linear)
    there = replace(
        here,
        linear=linear,
        weights=weights,
        scale=scale,
        evaluations=here.evaluations + count + 2,
    )
    return there, adjusted(problem, linear)
