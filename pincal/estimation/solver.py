"""Levenberg–Marquardt on the exact problem, damped to the end: it never ends above its start.

A step is judged by the conditions at its end, in the rows of its beginning (the rows follow the
state; where they are held, the step's gradient is exact). So a step short enough always falls,
until Jᵀ W r = 0 with W at the optimum (feasible generalised least squares). Poses follow: they are
solved again wherever a step left them more than first order away.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pincal.errors import MeasurementError
from pincal.estimation.problem import Linear, Problem
from pincal.estimation.system import NormalEquations, System
from pincal.kinematics.closure import Newton, largest_size
from pincal.types import Array, Mask

# Where a search ends, distances in standard errors:
NO_STEP = 1e-9  # distance from the optimum at which it ends
SLOW = 1e-6  # distance below which each step must halve it
NEGLIGIBLE = 1e-3  # distance that counts as converged where no step falls further
_STAYS = 1e-3  # share by which a step must shorten the distance where the cost is blind to it
_ROUNDING = 1e-10  # share of the cost below which predicted falls cannot be judged by it
# How many evaluations of the conditions it may take:
_EVALUATIONS = 1000
_LONGER = 3  # times as many within a standard deviation of the optimum: in a curved valley
_ASTRAY_EVALUATIONS = 100  # while the conditions are farther off than this
_FAR = 1e6  # cost of a condition: a thousand standard deviations, no correction of a machine
# How far it goes at once:
_DAMPING = 1e-14, 1e10  # least and largest, relative to the squares of the columns
_PROBE = 0.1  # share of a step at which its bend is measured
_BEND = 0.75  # twice the second-order part of a step over the step, at most


@dataclass(frozen=True)
class Iterate:
    """A state that the search has reached, and the step that leads on from there."""

    linear: Linear
    """Conditions, poses solved."""
    weights: Array
    """Weights of the rows, shape (N,)."""
    scale: float
    """Scale of the noise, as a robust loss estimates it; 1 without."""
    cost: float
    """Weighted sum of squares, the priors' included."""
    normal: NormalEquations
    """Normal equations of the next step."""

    @classmethod
    def of(cls, system: System, linear: Linear) -> Iterate:
        """Return the iterate of a system at conditions."""
        weights, scale = system.weights(linear)
        cost = system.cost(system.residuals(linear), weights, linear)
        return cls(linear, weights, scale, cost, system.solve(linear, weights, scale))

    @property
    def blind(self) -> bool:
        """Whether the next step changes the cost by less than rounding errors do."""
        return self.normal.decrement**2 <= _ROUNDING * self.cost

    def limit(self, max_evaluations: int | None) -> int:
        """Return how many evaluations a search may take that has come here."""
        size = self.linear.residuals.size
        near = max_evaluations is None and self.normal.decrement**2 * size <= self.cost
        limit = max_evaluations or _EVALUATIONS * (_LONGER if near else 1)
        return min(limit, _ASTRAY_EVALUATIONS) if self.cost > _FAR * size else limit


@dataclass(frozen=True)
class SolverResult:
    """Where a search ended."""

    last: Linear
    """Conditions at the end."""
    weights: Array
    """Weights of the rows, shape (N,)."""
    scale: float
    """Scale of the noise, as a robust loss estimates it; 1 without."""
    evaluations: int
    """Number of evaluations of the conditions."""
    distance: float
    """Distance of the optimum, to first order, in standard errors."""
    converged: bool
    """Whether that is negligible, or rounding."""
    costs: tuple[float, ...]
    """Sums of squares, the priors' included, where the search began and after each step taken."""


def search(
    system: System,
    start: Linear,
    progress: Callable[[str], None] | None = None,
    *,
    highest: float = 0.0,
    enough: float = 0.0,
    max_evaluations: int | None = None,
) -> SolverResult:
    """Return the optimum near a start, or the best state on the way to it.

    Args:
        system: What is minimised.
        start: The conditions where the search begins, poses solved.
        progress: Called with what is being done.
        highest: Cost above which no step is taken, if that at the start is not lower.
        enough: Distance from the optimum in standard deviations of residuals at which to stop.
        max_evaluations: Evaluations of the conditions after which to stop; a usual number if None.
    """
    current, damping, growth, evaluations = Iterate.of(system, start), 0.0, 10.0, 1
    costs, highest = [current.cost], max(current.cost, highest)
    unused = ~system.in_use(start)
    fixed_poses, cost_when_fixed = unused, np.inf
    while current.normal.decrement > _tolerance(system, current, enough):
        if evaluations >= current.limit(max_evaluations) or damping > _DAMPING[1]:
            break
        _report(progress, current, evaluations)
        # 1. A damped step of all unknowns; then each pose alone.
        step = current.normal.step(damping)
        if damping > 0.0:
            step = step + _along_the_valley(system, current, step, damping)
            evaluations += 1
        trial, count = _reached(system, current.linear, system.unknowns.map @ step, fixed_poses)
        evaluations += count
        if trial is not None and _better(system, current, trial, highest):
            # 2. Taken: less damping where the fall is as predicted.
            cost = min(system.cost_in(current.linear, trial.linear, current.weights), trial.cost)
            damping *= _change((current.cost - cost) / max(current.normal.fall(step), 1e-300))
            damping, growth = (damping if damping > _DAMPING[0] else 0.0), 10.0
            at_end = current.blind and _at_end(current, trial)
            current = trial
            costs.append(current.cost)
            if current.cost < 0.5 * cost_when_fixed:
                fixed_poses, cost_when_fixed = unused, np.inf
            if at_end:
                break
        elif (astray := unsolved(system.problem, current.linear) & ~fixed_poses).any():
            # 3. Not taken: poses that find no place stay where they are from now on.
            fixed_poses, cost_when_fixed = fixed_poses | astray, current.cost
        elif current.blind:
            break
        else:
            damping, growth = max(damping, _DAMPING[0]) * growth, 2.0 * growth
    return _result(system, current, evaluations, costs)


def _tolerance(system: System, current: Iterate, enough: float) -> float:
    """Return the distance from the optimum at which a search ends."""
    deviation = np.sqrt(max(current.cost / current.linear.residuals.size, 1.0))
    return max(NO_STEP, rounding(system, current.linear), enough * float(deviation))


def _report(progress: Callable[[str], None] | None, current: Iterate, evaluations: int) -> None:
    """Say how far a search is, now and then."""
    if progress and evaluations % 5 == 0:
        deviation = np.sqrt(current.cost / len(current.weights))
        progress(f"step {evaluations}: {deviation:.3g} σ a pose")


def _result(
    system: System, last: Iterate, evaluations: int, costs: Sequence[float]
) -> SolverResult:
    """Return what a search came to."""
    equations = int(last.linear.equations[last.weights > 0.0].sum())
    freedoms = max(equations - system.unknowns.n_free, 1)
    unit = 1.0 if system.known else np.sqrt(last.cost / freedoms)
    distance = last.normal.decrement / max(unit, 1e-300)
    exact = last.normal.decrement <= max(NO_STEP, 10.0 * rounding(system, last.linear))
    return SolverResult(
        last.linear,
        last.weights,
        last.scale,
        evaluations,
        distance,
        exact or distance <= NEGLIGIBLE,
        tuple(float(cost) for cost in costs),
    )


def _better(system: System, current: Iterate, trial: Iterate, highest: float) -> bool:
    """Return whether a step is taken: the cost falls, or, where it is blind, the distance does."""
    if current.blind:
        return trial.normal.decrement < current.normal.decrement
    falls = system.falls(current.linear, trial.linear, current.weights, current.cost)
    return falls and (system.loss is not None or trial.cost <= highest)


def _at_end(current: Iterate, trial: Iterate) -> bool:
    """Return whether nothing but rounding is left to gain by steps that the cost is blind to."""
    before, after = current.normal.decrement, trial.normal.decrement
    return after > (1.0 - _STAYS) * before or (after > 0.5 * before and after <= SLOW)


def _along_the_valley(system: System, current: Iterate, step: Array, damping: float) -> Array:
    """Return the second-order part of a step (geodesic acceleration, Transtrum and Sethna 2012).

    Along a curved valley it lets steps be long that would else climb its walls. Zero where it is
    not small against the step.
    """
    problem, T, linear, normal = system.problem, system.unknowns.map, current.linear, current.normal
    try:
        with np.errstate(all="ignore"):
            probe = problem.evaluate(problem.moved(linear, _PROBE * (T @ step)))
    except (MeasurementError, np.linalg.LinAlgError):
        return np.zeros_like(step)
    slope = (system.residuals(probe, linear) - system.residuals(linear)) / _PROBE
    gradient = np.zeros_like(step)
    for poses in linear.parts():
        J = system.derivatives(linear, poses) @ T
        bend = (slope[poses] - J @ step) * current.weights[poses, None]
        gradient += np.einsum("nmk,nm->k", J, bend)
    change = normal.solve(-gradient / _PROBE, damping)
    lengths = [
        float(np.linalg.norm(change_of_all * normal.lengths)) for change_of_all in (change, step)
    ]
    small = np.isfinite(change).all() and 2.0 * lengths[0] <= _BEND * lengths[1]
    return change if small else np.zeros_like(step)


def _change(gain: float) -> float:
    """Return the factor on the damping after a step, by its fall over the predicted one."""
    if gain > 0.75:
        return 0.1
    return 1.0 if gain > 0.25 else 4.0


def _reached(
    system: System, linear: Linear, step: Array, fixed_poses: Mask
) -> tuple[Iterate | None, int]:
    """Return where a step of all unknowns leads, poses solved, and the evaluations that it took.

    None where conditions do not exist. Fixed poses stay where they are.
    """
    problem = system.problem
    try:
        with np.errstate(all="ignore"):
            state = problem.moved(linear, step)
            fixed = fixed_poses[:, None, None]
            matrices = np.where(fixed, linear.state.matrices, state.matrices)
            state = replace(state, matrices=matrices)
            trial, count = solve_poses(problem, problem.evaluate(state), fixed_poses)
            finite = np.isfinite(trial.residuals).all() and trial.finite
    except (MeasurementError, np.linalg.LinAlgError):
        return None, 1
    return (Iterate.of(system, trial) if finite else None), 1 + count


def rounding(system: System, linear: Linear) -> float:
    """Return the decrement that rounding errors of the conditions make."""
    if not system.problem.weighted:
        return 0.0
    size = largest_size(system.problem.legs)
    rows = max(linear.residuals.size, 1)
    noise = 2.0 * np.finfo(float).eps * size * np.linalg.norm(linear.white.whitener)  # of a chain
    return float(noise * np.sqrt(system.unknowns.n_free / rows))


_POSES = Newton(steps=10, small=1e-4, largest=0.2)  # solved again until first order away
_SHORTEST = 1e-2  # share of a step: poses that need shorter ones stay where they are
_ASTRAY = 1e-3  # of the machine's size, or [rad]: a pose that wants to move farther is not solved


def solve_poses(
    problem: Problem, linear: Linear, fixed_poses: Mask | None = None
) -> tuple[Linear, int]:
    """Return the conditions with poses at their optimum, to second order, and the evaluations.

    Gauss–Newton steps of each pose alone, shortened until the next one is shorter (natural
    monotonicity); a pose that finds none stays where it is.
    """
    if not problem.latent:
        return linear, 0
    scale, count, share = _pose_scale(problem), 0, np.ones(len(linear.conditions))
    if fixed_poses is not None:
        share = np.where(fixed_poses, 0.0, share)
    for _ in range(_POSES.steps):
        twists, length = _pose_steps(linear, scale)
        moving = (length > _POSES.small) & (share > _SHORTEST)
        if not moving.any():
            break
        short = share * np.minimum(1.0, _POSES.largest / np.maximum(length, _POSES.largest))
        twists = np.where(moving[:, None], twists * short[:, None], 0.0)
        state = linear.state
        matrices = problem.platform.displaced(state.matrices, twists)
        trial = problem.evaluate(replace(state, matrices=matrices))
        count += 1
        worse = moving & ~(_pose_steps(trial, scale)[1] < length)
        share = np.where(worse, share / 4.0, np.minimum(1.0, 2.0 * share))
        if worse.any():
            stay = worse[:, None, None]
            matrices = np.where(stay, state.matrices, trial.state.matrices)
            trial = problem.evaluate(replace(state, matrices=matrices))
            count += 1
        linear = trial
    return linear, count


def unsolved(problem: Problem, linear: Linear) -> Mask:
    """Return which poses are not at their optimum, shape (N,)."""
    if not problem.latent:
        return np.zeros(len(linear.conditions), dtype=bool)
    return np.asarray(_pose_steps(linear, _pose_scale(problem))[1] > _ASTRAY)


def _pose_scale(problem: Problem) -> Array:
    """Return what a pose's twist is compared with, shape (dof,)."""
    size = largest_size(problem.legs)
    return np.array([size if unit == "m" else 1.0 for unit in problem.platform.units])


def _pose_steps(linear: Linear, scale: Array) -> tuple[Array, Array]:
    """Return the poses' steps, shape (N, dof), and their lengths over a scale, shape (N,).

    Steps that are not finite count as none.
    """
    twists = linear.white.pose_step(linear.conditions)
    twists = np.where(np.isfinite(twists).all(axis=1, keepdims=True), twists, 0.0)
    return twists, np.abs(twists / scale).max(axis=1)
