"""Levenberg–Marquardt on the exact problem, damped to the end: it never ends above its start.

A step is judged by the conditions at its end, whitened as at its start (whitening changes with the
state; held fixed, the step's gradient is exact). So a step that is short enough always lowers the
cost, until Jᵀ W r = 0 with W at the optimum (feasible generalised least squares). Poses are solved
again wherever a step left them more than first order away from their optimum.

The last steps take the conditions at adjusted readings. Derivatives at measured readings are
correlated with their noise, and a sum over many rows keeps that bias (errors in variables: a gain
comes out too small). The Gauss–Helmert model evaluates e(ψ + σν) − S ν at its own corrections ν,
with A, B and S there. (E. M. Mikhail and F. Ackermann, Observations and Least Squares, 1976,
chapter 9; A. J. Pope, Some pitfalls to be avoided in the iterative adjustment of nonlinear
problems, 1972.)
"""

from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np

from pincal.errors import MeasurementError
from pincal.estimation.problem import Linear
from pincal.estimation.system import NEGLIGIBLE, NormalEquations, System
from pincal.types import Array, Mask

# Where a search ends, distances in standard errors:
NO_STEP = 1e-9  # distance from the optimum at which it ends
SLOW = 1e-6  # distance below which each step must halve it
_STAYS = 1e-3  # least relative decrease of the distance where the cost is blind to a step
_ROUNDING = 1e-10  # predicted relative decrease of the cost below which rounding dominates
ROWS_FOLLOW = 1e-3  # relative increase of the cost allowed because whitening changes
# Largest numbers of steps:
_MOST_STEPS = 300
_LONGER = 3  # times as many within a standard deviation of the optimum: in a curved valley
_STEPS_ASTRAY = 15  # while the cost of a condition is above _FAR
_FAR = 1e6  # cost of a condition: a thousand standard deviations, no correction of a machine
_DAMPING = 1e-14, 1e10  # least and largest, relative to the squares of the columns
_BENT = 0.75  # largest length of a bend relative to its step
_GROWTH = 2.0  # of the damping by a refused step; twice as much by the next
# Adjustment of readings:
_CORRECTIONS = 4  # largest number of corrections of the readings in a step
_UNCHANGED = 1e-3  # change of the corrections, in standard deviations, that is negligible
# Solving poses:
_POSE_STEPS, _POSE_SMALL, _POSE_LARGEST = 10, 1e-4, 0.2  # largest number; lengths of steps
_SHORTEST = 1e-2  # share of a step: poses that need shorter ones stay where they are
_ASTRAY = 1e-3  # of the machine's size, or [rad]: a pose with a longer step is not solved


@dataclass(frozen=True)
class SolverResult:
    """Where a search ended."""

    last: Linear
    """Conditions at the end, at measured readings."""
    distance: float
    """Distance of the optimum, to first order, in standard errors."""
    converged: bool
    """Whether the distance is negligible, or rounding."""


class Iterate(NamedTuple):
    """A state of the search, and the normal equations of its next step."""

    linear: Linear
    """Conditions at measured readings, poses solved."""
    judged: Linear
    """Conditions that steps minimise: ``linear``, or the conditions at adjusted readings."""
    weights: Array
    cost: float
    """Weighted sum of squares, priors included."""
    normal: NormalEquations
    """Normal equations of the next step."""

    @classmethod
    def of(cls, system: System, linear: Linear) -> Self:
        """Return the iterate at given conditions."""
        judged = adjusted(linear) if system.adjusted else linear
        weights = system.weights(linear.squares)
        normal = NormalEquations.of(system.triangle(judged, weights))
        return cls(linear, judged, weights, system.cost(judged, weights), normal)

    @property
    def blind(self) -> bool:
        """Whether the next step changes the cost by less than rounding errors."""
        return self.normal.decrement**2 <= _ROUNDING * self.cost

    def limit(self, max_steps: int | None) -> int:
        """Return the largest number of steps of a search that has reached this state."""
        size = self.linear.residuals.size
        near = self.normal.decrement**2 * size <= self.cost
        limit = max_steps or _MOST_STEPS * (_LONGER if near else 1)
        return min(limit, _STEPS_ASTRAY) if self.cost > _FAR * size else limit


def search(
    system: System, start: Linear, *, highest: float = 0.0, enough: float = 0.0
) -> SolverResult:
    """Return the optimum near a start whose poses are solved, or the best state on the way to it.

    No step is accepted above the cost at the start, or ``highest``. The search stops ``enough``
    standard deviations of residuals from the optimum.
    """
    current, damping, growth = Iterate.of(system, start), 0.0, _GROWTH
    steps, highest = 0, max(current.cost, highest)
    while current.normal.decrement > _tolerance(system, current, enough):
        if steps >= current.limit(system.max_steps) or damping > _DAMPING[1]:
            break
        steps += 1
        if system.progress and steps % 5 == 0:
            deviation = np.sqrt(current.cost / len(current.weights))
            system.progress(f"step {steps}: {deviation:.3g} σ a pose")
        # 1. A damped step of all unknowns; then each pose alone.
        trial, step = _step(system, current, damping, highest)
        if trial is not None:
            # 2. Accepted: less damping where the cost falls as predicted.
            factor, at_end = _adapt_damping(system, current, trial, step)
            damping, growth = damping * factor, _GROWTH
            damping *= damping > _DAMPING[0]  # none below the least
            current = trial
            if at_end:
                break
        elif current.blind:
            break
        else:
            damping, growth = max(damping, _DAMPING[0]) * growth, 2.0 * growth
    distance = current.normal.decrement
    if not system.known:  # over the standard deviation of residuals
        equations = int(current.linear.equations[current.weights > 0.0].sum())
        freedoms = max(equations - system.unknowns.n_free, 1)
        distance /= max(float(np.sqrt(current.cost / freedoms)), 1e-300)
    exact = current.normal.decrement <= max(NO_STEP, 10.0 * rounding(system, current.linear))
    near = 10.0 * system.tolerance if system.adjusted else NEGLIGIBLE
    return SolverResult(current.linear, distance, exact or distance <= near)


def optimum(system: System, start: Linear, highest: float, *, near: bool) -> SolverResult:
    """Return the optimum at adjusted readings, or at measured ones where the former does not exist.

    ``start`` and ``highest`` are as in ``search``. A start may be ``near`` the optimum at adjusted
    readings, of other noise or rows: a search at measured readings would lead away from it.
    """
    adjusts = system.problem.latent and np.nanmax(system.problem.leg_block.sigma, initial=0.0) > 0.0
    with_adjustment = replace(system, adjusted=True)
    end = _try_search(with_adjustment, start) if near and adjusts else None
    if end is None or not end.converged:
        highest *= 1.0 + ROWS_FOLLOW * near
        end = search(system, start, highest=highest, enough=SLOW * float(adjusts))
        if adjusts and end.converged:
            end = _try_search(replace(with_adjustment, max_steps=None), end.last) or end
    return end


def _try_search(system: System, start: Linear) -> SolverResult | None:
    """Return where a search ends; None if it reaches conditions that do not exist."""
    try:
        with np.errstate(all="ignore"):
            return search(system, start)
    except (MeasurementError, np.linalg.LinAlgError):
        return None


def adjusted(linear: Linear) -> Linear:
    """Return the conditions e(ψ + σν) − S ν at adjusted readings.

    The corrections ν depend on the conditions at the readings that they correct, so they are
    iterated to a fixed point.
    """
    problem, block = linear.problem, linear.problem.leg_block
    noise = np.zeros_like(block.sigma)
    at_adjusted = linear
    for _ in range(_CORRECTIONS):
        before, noise = noise, at_adjusted.noise[:, : block.n_readings]
        noise = np.where(np.isfinite(noise), noise, 0.0)
        if np.abs(noise - before).max(initial=0.0) <= _UNCHANGED:
            break
        legs = replace(block, readings=block.readings + block.sigma * noise)
        corrected = replace(problem, leg_block=legs).evaluate(linear.state)
        conditions = corrected.conditions.copy()
        conditions[:, : block.n_rows] -= (corrected.reading_root @ noise[:, :, None])[:, :, 0]
        at_adjusted = replace(corrected, conditions=conditions)
    return at_adjusted


def _tolerance(system: System, current: Iterate, enough: float) -> float:
    """Return the distance from the optimum at which a search ends."""
    if system.adjusted:
        return system.tolerance
    deviation = np.sqrt(max(current.cost / current.linear.residuals.size, 1.0))
    return max(NO_STEP, rounding(system, current.linear), enough * float(deviation))


def _accepted(system: System, current: Iterate, trial: Iterate | None, highest: float) -> bool:
    """Return whether a step lowers the cost or, where rounding hides that, the distance.

    The cost takes the weights at the start of the step, which bound a robust cost from above
    (majorisation). Rows are whitened as at the end of the step; near the optimum as at its start,
    if the distance falls too: otherwise steps go back and forth.
    """
    if trial is None:
        return False
    nearer = trial.normal.decrement < current.normal.decrement
    if current.blind:
        return nearer
    weights, cost = current.weights, system.cost(trial.judged, current.weights)
    if not cost < current.cost:
        near = nearer and cost <= (1.0 + ROWS_FOLLOW) * current.cost
        if not (near and system.cost(trial.judged, weights, current.judged) <= current.cost):
            return False
    return system.robust or trial.cost <= highest


def _adapt_damping(
    system: System, current: Iterate, trial: Iterate, step: Array
) -> tuple[float, bool]:
    """Return the factor on the damping by the actual over the predicted decrease of the cost.

    It is that of H. B. Nielsen, Damping parameter in Marquardt's method (1999). Also return whether
    rounding leaves nothing to gain.
    """
    costs = [system.cost(trial.judged, current.weights, rows) for rows in (current.judged, None)]
    gain = (current.cost - min(costs)) / max(current.normal.fall(step), 1e-300)
    before, after = current.normal.decrement, trial.normal.decrement
    stays = after > (1.0 - _STAYS) * before or (after > 0.5 * before and after <= SLOW)
    factor = max(1.0 / 3.0, 1.0 - (2.0 * float(np.clip(gain, 0.0, 1.0)) - 1.0) ** 3)
    return factor, current.blind and stays


def _step(
    system: System, current: Iterate, damping: float, highest: float
) -> tuple[Iterate | None, Array]:
    """Return the end of a damped step (None if refused), and the step.

    A step that is refused is taken once more without the poses that cannot be solved, as beside a
    singularity: each solution leaves them at another place. One in a curved valley is bent by how
    far the conditions at its end are from linear (M. K. Transtrum and J. P. Sethna 2012), unless
    the bend is nearly as long.
    """
    normal, linear, T = current.normal, current.judged, system.unknowns.map
    step = normal.step(damping)
    trial = _end_of_step(system, current, step)
    if trial is None or _accepted(system, current, trial, highest):
        return trial, step
    if (astray := unsolved(current.linear)).any():
        without = _end_of_step(system, current, step, astray)
        return without if _accepted(system, current, without, highest) else None, step
    if current.blind:
        return None, step
    off = linear.whitened(trial.judged.conditions) - linear.residuals
    off -= linear.jacobian @ (T @ step)
    slope = np.einsum("nmk,nm,n->k", linear.jacobian, off, current.weights) @ T
    along = np.linalg.solve(normal.R.T, slope / normal.lengths)
    bend = normal._replace(c=along).step(damping)
    length, bend_length = (float(np.linalg.norm(part * normal.lengths)) for part in (step, bend))
    if not bend_length < _BENT * length:
        return None, step
    trial = _end_of_step(system, current, step + bend)
    return trial if _accepted(system, current, trial, highest) else None, step


def _end_of_step(
    system: System, current: Iterate, step: Array, fixed_poses: Mask | bool = False
) -> Iterate | None:
    """Return the end of a step, poses solved but for fixed ones; None if it does not exist."""
    try:
        with np.errstate(all="ignore"):
            state, before = current.linear.moved(system.unknowns.map @ step), current.linear.state
            stays = np.reshape(fixed_poses, (-1, 1, 1))
            state = replace(state, matrices=np.where(stays, before.matrices, state.matrices))
            trial = solve_poses(system.problem.evaluate(state), fixed_poses)
            finite = np.isfinite(trial.residuals).all() and np.isfinite(trial.by_parameter).all()
            return Iterate.of(system, trial) if finite else None
    except (MeasurementError, np.linalg.LinAlgError):
        return None


def rounding(system: System, linear: Linear) -> float:
    """Return the decrement that rounding errors of the conditions cause."""
    rows = max(linear.residuals.size, 1)
    of_chain = 2.0 * np.finfo(float).eps * system.problem.size
    noise = of_chain * np.linalg.norm(linear.white.whitener)
    return float(noise * np.sqrt(system.unknowns.n_free / rows))


def solve_poses(linear: Linear, fixed_poses: Mask | bool = False) -> Linear:
    """Return the conditions with poses solved to second order, but for fixed ones.

    Each pose takes Gauss–Newton steps, shortened until the next step is shorter (natural
    monotonicity); a pose without such a step stays where it is.
    """
    problem, share = linear.problem, np.where(fixed_poses, 0.0, np.ones(len(linear.conditions)))
    if not problem.latent:
        return linear
    for _ in range(_POSE_STEPS):
        twists, length = _pose_steps(linear)
        moving = (length > _POSE_SMALL) & (share > _SHORTEST)
        if not moving.any():
            break
        short = share * np.minimum(1.0, _POSE_LARGEST / np.maximum(length, _POSE_LARGEST))
        twists = np.where(moving[:, None], twists * short[:, None], 0.0)
        matrices = problem.platform.displaced(linear.state.matrices, twists)
        trial = problem.evaluate(replace(linear.state, matrices=matrices))
        worse = moving & ~(_pose_steps(trial)[1] < length)
        share = np.where(worse, share / 4.0, np.minimum(1.0, 2.0 * share))
        linear = trial.with_poses(worse, linear) if worse.any() else trial
    return linear


def unsolved(linear: Linear) -> Mask:
    """Return which poses are not at their optimum, shape (N,)."""
    if not linear.problem.latent:
        return np.zeros(len(linear.conditions), dtype=bool)
    return np.asarray(_pose_steps(linear)[1] > _ASTRAY)


def _pose_steps(linear: Linear) -> tuple[Array, Array]:
    """Return the pose steps, (N, dof), and their lengths relative to the machine's size, (N,).

    Steps that are not finite are zero.
    """
    problem = linear.problem
    scale = [problem.size if unit == "m" else 1.0 for unit in problem.platform.units]
    twists = linear.white.pose_step(linear.conditions)
    twists = np.where(np.isfinite(twists).all(axis=1, keepdims=True), twists, 0.0)
    return twists, np.abs(twists / scale).max(axis=1)
