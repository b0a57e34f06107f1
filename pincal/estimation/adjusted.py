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
from pincal.estimation.problem import Linear, Problem
from pincal.estimation.solver import NEGLIGIBLE, SolverResult, solve_poses
from pincal.estimation.system import NormalEquations, System
from pincal.types import Array

_STEPS = 30  # steps at most; most fits need two or three
_SHORTEST = 1e-4  # share of a step that is still tried
_CORRECTIONS = 4  # corrections of the readings in a step, at most
_UNCHANGED = 1e-3  # standard deviations by which corrections may still change


def adjusted(problem: Problem, linear: Linear) -> Linear:
    """Return the conditions at adjusted readings, less what the adjustment makes of them.

    Corrections follow from the conditions at the readings that they correct: found again until
    they stay.

    Raises:
        MeasurementError: a residual that does not exist there.
    """
    noise = np.zeros_like(problem.leg_block.sigma)
    at_adjusted = linear
    for _ in range(_CORRECTIONS):
        before, noise = noise, _corrections(problem, at_adjusted)
        if np.abs(noise - before).max(initial=0.0) <= _UNCHANGED:
            break
        at_adjusted = _at(problem, linear, noise)
    return at_adjusted


def _corrections(problem: Problem, linear: Linear) -> Array:
    """Return the corrections of readings in standard deviations, shape (N, n_readings)."""
    noise = linear.noise[:, : problem.leg_block.n_readings]
    return np.where(np.isfinite(noise), noise, 0.0)


def _at(problem: Problem, linear: Linear, noise: Array) -> Linear:
    """Return the conditions at readings that are corrected by so many standard deviations."""
    legs = problem.leg_block.corrected(problem.leg_block.sigma * noise)
    corrected = replace(problem, leg_block=legs).evaluate(linear.state)
    shift_back = (corrected.noise_root[:, :, : noise.shape[1]] @ noise[:, :, None])[:, :, 0]
    return replace(corrected, conditions=corrected.conditions - shift_back)


def adjusts(problem: Problem) -> bool:
    """Return whether a problem's fit ends at adjusted readings."""
    noisy = np.nanmax(problem.leg_block.sigma, initial=0.0) > 0.0
    return problem.weighted and problem.latent and bool(noisy)


def last_steps(system: System, optimum: SolverResult) -> SolverResult:
    """Return the optimum with all conditions at adjusted readings, found from that without.

    As it is where readings are exact, residuals are not whitened, or nothing gets better. A step
    that does not make the cost fall is tried shorter.

    Args:
        system: What is minimised.
        optimum: Its optimum at readings as measured.
    """
    problem = system.problem
    if not (adjusts(problem) and optimum.converged):
        return optimum
    current = optimum
    try:
        with np.errstate(all="ignore"):
            conditions = adjusted(problem, current.last)
            normal = system.solve(conditions, current.weights, current.scale)
            share, tried = 1.0, 0
            while normal.decrement > NEGLIGIBLE and tried < _STEPS and share > _SHORTEST:
                tried += 1
                reached, trial = _stepped(system, current, normal, share)
                costs = [
                    system.cost(candidate.residuals, current.weights, candidate)
                    for candidate in (conditions, trial)
                ]
                if not costs[1] < costs[0]:
                    share /= 4.0
                    continue
                reached = replace(reached, costs=(*current.costs, float(costs[1])))
                current, conditions, share = reached, trial, min(1.0, 2.0 * share)
                normal = system.solve(conditions, current.weights, current.scale)
    except (MeasurementError, np.linalg.LinAlgError):  # no such conditions there: as it was
        return optimum
    cost = system.cost(conditions.residuals, current.weights, conditions)
    dof = max(int(conditions.equations[current.weights > 0.0].sum()) - system.unknowns.n_free, 1)
    distance = normal.decrement / (1.0 if system.known else max(float(np.sqrt(cost / dof)), 1e-300))
    return replace(current, distance=distance, converged=distance <= 10.0 * NEGLIGIBLE)


def _stepped(
    system: System, current: SolverResult, normal: NormalEquations, share: float
) -> tuple[SolverResult, Linear]:
    """Return where a share of a step leads, and the conditions there at adjusted readings."""
    problem = system.problem
    state = problem.moved(current.last, share * (system.unknowns.map @ normal.step()))
    linear, count = solve_poses(problem, problem.evaluate(state))
    weights, scale = system.weights(linear)
    reached = replace(
        current,
        last=linear,
        weights=weights,
        scale=scale,
        evaluations=current.evaluations + count + 2,
    )
    return reached, adjusted(problem, linear)
