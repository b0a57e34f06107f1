"""The search: damped to the end on the exact problem, so that it cannot get worse.

A step is judged by the conditions at its end, in the rows of its beginning (the rows follow the
state; where they are held, the step's gradient is exact). So a step short enough always falls,
until Jᵀ W r = 0 with W at the optimum (feasible generalised least squares). Poses follow: they are
solved again wherever a step left them more than first order away.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree

from pincal.errors import MeasurementError
from pincal.estimation.linear import Linear, Stack, State
from pincal.estimation.problem import Problem, spread
from pincal.estimation.system import Normal, System
from pincal.kinematics.closure import Newton, largest_size
from pincal.types import Array, Mask

_UNEVEN = 100.0  # ratio of noise up to which valleys are wide enough


def evened(problem: Problem, stack: Stack) -> Problem | None:
    """Return the problem with every quantity at least as uncertain as is typical.

    Its optimum is nearby and has no narrow valleys: where readings are exact, a pose near a
    singularity of the nominal machine goes far astray. None where nothing changes, or where an
    arm carries the platform.

    Args:
        problem: The problem.
        stack: Conditions at some state.
    """
    if not problem.latent or any(leg.is_arm for leg in problem.legs):
        return None
    lengths = np.array([unit == "m" for unit in problem.observation.units], dtype=bool)
    size = max(leg.size for leg in problem.legs)
    rows = np.linalg.norm(stack.noise[:, : problem.leg_rows[-1].stop], axis=2)
    seen = problem.sigma_observed * np.where(lengths, 1.0, size)
    seen = seen[problem.observation.measured]
    noisy = next((one for one in (seen[seen > 0.0], rows[rows > 0.0]) if len(one)), None)
    if noisy is None:
        return None
    typical = float(np.median(noisy))
    observed = np.maximum(problem.sigma_observed, np.where(lengths, typical, typical / size))
    follow = [np.median(np.linalg.norm(one.reading, axis=1), axis=0) for one in stack.demands]
    floors = typical / np.maximum(np.concatenate(follow), 1e-300)
    readings = np.maximum(problem.sigma_readings, np.where(np.isfinite(floors), floors, 0.0))
    even = (observed <= _UNEVEN * problem.sigma_observed) | ~problem.observation.measured
    if even.all() and (readings <= _UNEVEN * problem.sigma_readings).all():
        return None
    return replace(problem, sigma_observed=observed, sigma_readings=readings)


_POSES = Newton(steps=10, small=1e-4, largest=0.2)  # solved again until first order away
_SHORTEST = 1e-2  # of a step: poses that need shorter ones stay where they are
_ASTRAY = 1e-3  # of the machine's size, or [rad]: a pose that wants to move farther is not solved


def unsolved(problem: Problem, linear: Linear) -> Mask:
    """Return which poses are not at their optimum, shape (N,)."""
    if not problem.latent:
        return np.zeros(len(linear.value), dtype=bool)
    return np.asarray(_pose_steps(linear, _pose_scale(problem))[1] > _ASTRAY)


def _pose_scale(problem: Problem) -> Array:
    """Return what a pose's twist is compared with, shape (dof,)."""
    size = largest_size(problem.legs)
    return np.array([size if unit == "m" else 1.0 for unit in problem.platform.units])


def solve_poses(problem: Problem, linear: Linear, held: Mask | None = None) -> tuple[Linear, int]:
    """Return the conditions with poses at their optimum, to second order, and the evaluations.

    Gauss–Newton steps of each pose alone, shortened until the next one is shorter (natural
    monotonicity); a pose that finds none stays where it is.
    """
    if not problem.latent:
        return linear, 0
    platform = problem.platform
    scale = _pose_scale(problem)
    count, share = 0, np.ones(len(linear.value))
    if held is not None:
        share = np.where(held, 0.0, share)
    for _ in range(_POSES.steps):
        twists, length = _pose_steps(linear, scale)
        open_ = (length > _POSES.small) & (share > _SHORTEST)
        if not open_.any():
            break
        short = share * np.minimum(1.0, _POSES.largest / np.maximum(length, _POSES.largest))
        twists = np.where(open_[:, None], twists * short[:, None], 0.0)
        state = linear.state
        matrices = platform.displaced(state.matrices, twists)
        trial = problem.linearise(replace(state, matrices=matrices))
        count += 1
        worse = open_ & ~(_pose_steps(trial, scale)[1] < length)
        share = np.where(worse, share / 4.0, np.minimum(1.0, 2.0 * share))
        if worse.any():
            kept = np.where(worse[:, None, None], state.matrices, trial.state.matrices)
            trial = problem.linearise(replace(state, matrices=kept))
            count += 1
        linear = trial
    return linear, count


def _pose_steps(linear: Linear, scale: Array) -> tuple[Array, Array]:
    """Return the poses' steps, shape (N, dof), and their lengths over a scale, shape (N,).

    Steps that are not finite count as none.
    """
    twists = linear.white.pose_step(linear.stack.value)
    twists = np.where(np.isfinite(twists).all(axis=1, keepdims=True), twists, 0.0)
    return twists, np.abs(twists / scale).max(axis=1)


@dataclass(frozen=True)
class Settings:
    """When the search ends, and how far it goes at once."""

    evaluations: int = 1000
    """Of the conditions, at most."""
    astray: int = 100
    """Evaluations at most while the conditions are farther off than ``far``."""
    far: float = 1e6
    """Cost of a condition: a thousand standard deviations, which no correction of a machine is."""
    longer: int = 3
    """Times as many within a standard deviation of the optimum: in a curved valley."""
    damping: tuple[float, float] = (1e-14, 1e10)
    """Least and largest, relative to the squares of the columns."""
    probe: float = 0.1
    """Of a step, at which its bend is measured."""
    bend: float = 0.75
    """Twice the second-order part of a step, of the step, at most."""
    no_step: float = 1e-9
    """Of a standard error: the search ends."""
    slow: float = 1e-6
    """Of a standard error: nearer only if each step halves the distance."""
    stays: float = 1e-3
    """Of the distance, by which a step must make it smaller where the cost is blind to it."""
    negligible: float = 1e-3
    """Of a standard error: converged, where no step falls further."""
    rows: int = 2000
    """Enough to begin near the optimum."""
    near: float = 0.1
    """Of a residual's standard deviation: the easier problem is left."""
    begin: int = 50
    """Evaluations of the easier problem, at most."""
    gross: float = 100.0
    """Times as far off as usual, where the search starts: left out of the easier problem."""
    last: int = 30
    """Steps with conditions at adjusted readings, at most; most fits need two or three."""
    shortest: float = 1e-4
    """Share of such a step."""
    corrections: int = 4
    """Of the readings in such a step, at most."""
    same: float = 1e-3
    """Of a standard deviation, by which corrections may still change."""
    rounding: float = 1e-10
    """Of the cost: falls that are predicted smaller cannot be judged by it."""


BY = Settings()


@dataclass(frozen=True)
class Found:
    """Where a search ended."""

    linear: Linear
    weights: Array
    """Of the rows, shape (N,)."""
    scale: float
    """Of the noise, as a robust loss estimates it; 1 without."""
    evaluations: int
    left: float
    """How far the optimum is, to first order, in standard errors."""
    converged: bool
    costs: tuple[float, ...]
    """Sums of squares, the priors' included, where the search began and after each step taken."""


def search(
    system: System,
    start: Linear,
    progress: Callable[[str], None] | None = None,
    *,
    highest: float = np.inf,
    enough: float = 0.0,
    most: int | None = None,
) -> Found:
    """Return the optimum near a start, or the best state on the way to it.

    Args:
        system: What is minimised.
        start: The conditions where the search begins, poses solved.
        progress: Called with what is being done.
        highest: Cost above which no step is taken, if that at the start is not lower.
        enough: Distance from the optimum in standard deviations of residuals at which to stop.
        most: Evaluations of the conditions after which to stop; those of the settings if not given.
    """
    problem, T = system.problem, system.unknowns.map
    here, damping, growth, evaluations = start, 0.0, 10.0, 1
    weights, scale = system.weights(here)
    normal = system.solve(here, weights, scale)
    cost = system.cost(system.residuals(here), weights, here.state)
    left_out = np.zeros(len(weights), dtype=bool) if system.kept is None else ~system.kept
    held, cost_held = left_out, np.inf
    highest = max(cost, highest) if np.isfinite(highest) else cost
    costs = [cost]
    while normal.decrement > max(BY.no_step, rounding(system, here)):
        if normal.decrement <= enough * np.sqrt(max(cost / here.value.size, 1.0)):
            break
        near = most is None and normal.decrement**2 * here.value.size <= cost
        far = cost > BY.far * here.value.size
        limit = most or BY.evaluations * (BY.longer if near else 1)
        limit = min(limit, BY.astray) if far else limit
        if evaluations >= limit or damping > BY.damping[1]:
            break
        if progress and evaluations % 5 == 0:
            progress(f"step {evaluations}: {np.sqrt(cost / len(weights)):.3g} σ a pose")
        step = normal.step(damping)
        if damping > 0.0:
            step = step + _along_the_valley(system, here, weights, normal, step, damping)
            evaluations += 1
        trial, count = _trial(problem, here, T @ step, held)
        evaluations += count
        blind = normal.decrement**2 <= BY.rounding * cost
        better = False
        if trial is not None:
            new_weights, new_scale = system.weights(trial)
            new_cost = system.cost(system.residuals(trial), new_weights, trial.state)
            new = system.solve(trial, new_weights, new_scale)
            better = system.falls(here, trial, weights, cost)
            if blind:
                better = new.decrement < normal.decrement
            elif system.loss is None:
                better = better and new_cost <= highest
        if better and trial is not None:
            fall = cost - min(system.cost_in(here, trial, weights), new_cost)
            damping *= _change(fall / max(normal.fall(step), 1e-300))
            damping, growth = (damping if damping > BY.damping[0] else 0.0), 10.0
            slow = blind and new.decrement > 0.5 * normal.decrement
            stays = blind and new.decrement > (1.0 - BY.stays) * normal.decrement
            here, weights, scale, cost, normal = trial, new_weights, new_scale, new_cost, new
            costs.append(cost)
            if cost < 0.5 * cost_held:
                held, cost_held = left_out, np.inf
            if stays or (slow and normal.decrement <= BY.slow):  # rounding, or of no matter
                break
        elif (astray := unsolved(problem, here) & ~held).any():
            held, cost_held = held | astray, cost
        elif blind:  # nothing but rounding is left
            break
        else:
            damping, growth = max(damping, BY.damping[0]) * growth, 2.0 * growth
    dof = max(int(here.equations[weights > 0.0].sum()) - T.shape[1], 1)
    unit = 1.0 if system.known else np.sqrt(cost / dof)
    left = normal.decrement / max(unit, 1e-300)
    there = normal.decrement <= max(BY.no_step, 10.0 * rounding(system, here))
    ended = there or left <= BY.negligible
    return Found(here, weights, scale, evaluations, left, ended, tuple(float(c) for c in costs))


def _along_the_valley(
    system: System, here: Linear, weights: Array, normal: Normal, step: Array, damping: float
) -> Array:
    """Return the second-order part of a step (geodesic acceleration, Transtrum and Sethna 2012).

    Along a curved valley it lets steps be long that would else climb its walls. Zero where it is
    not small against the step.
    """
    problem, T = system.problem, system.unknowns.map
    try:
        with np.errstate(all="ignore"):
            probe = problem.stack(problem.moved(here, BY.probe * (T @ step)))
    except (MeasurementError, np.linalg.LinAlgError):
        return np.zeros_like(step)
    weighted = system.problem.weighted
    there = here.white(probe.value[:, :, None])[:, :, 0] if weighted else probe.value / system.unit
    slope = (there - system.residuals(here)) / BY.probe
    bent = np.zeros_like(step)
    for poses in here.parts():
        J = system.derivatives(here, poses) @ T
        beside = (slope[poses] - J @ step) * weights[poses, None]
        bent += np.einsum("nmk,nm->k", J, beside)
    change = normal.solve(-bent / BY.probe, damping)
    if not np.isfinite(change).all():
        return np.zeros_like(step)
    small = 2.0 * np.linalg.norm(change * normal.lengths) <= BY.bend * np.linalg.norm(
        step * normal.lengths
    )
    return change if small else np.zeros_like(step)


def _change(gain: float) -> float:
    """Return the factor on the damping after a step, by its fall over the predicted one."""
    if gain > 0.75:
        return 0.1
    return 1.0 if gain > 0.25 else 4.0


def near_start(
    system: System, first: Linear, progress: Callable[[str], None] | None = None
) -> tuple[Linear, int]:
    """Return where the search begins: near an easier optimum, if that is better.

    That of the evened problem, without gross errors, and of least squares: a loss bends the cost
    far from its optimum.

    Args:
        system: What is minimised.
        first: The conditions at the start, poses solved.
        progress: Called with what is being done.
    """
    problem = system.problem
    sound = first.squares <= BY.gross**2 * np.median(first.squares)
    easier = evened(problem, first.stack) or (problem if system.loss or not sound.all() else None)
    if easier is None:
        return first, 0
    kept = sound if system.kept is None else system.kept & sound
    start, every = problem.start(first.state.parameters), len(first.value)
    some = spread(every, BY.rows)
    if len(some) < every:
        easier, start = easier.part(some), start.rows(some)
    begin, count = solve_poses(easier, easier.linearise(start))
    easy = replace(system, problem=easier, kept=kept[some], loss=None)
    found = search(easy, begin, progress, enough=BY.near, most=BY.begin)
    there = found.linear.state
    if len(some) < every:
        there = replace(problem.start(there.parameters), external=there.external)
    there = _among_others(problem, there, sound)
    try:
        with np.errstate(all="ignore"):
            near, more = solve_poses(problem, problem.linearise(there))
    except MeasurementError:
        return first, count + found.evaluations
    costs = []
    for one in (first, near):
        weights, _ = system.weights(one)
        costs.append(system.cost(system.residuals(one), weights, one.state))
    better = np.isfinite(costs[1]) and not costs[1] > costs[0]
    return (near if better else first), count + found.evaluations + more


def _among_others(problem: Problem, state: State, sound: Mask) -> State:
    """Return a state whose rows that are far off start where the readings are most alike.

    What was measured there may lead to another assembly mode.
    """
    if not problem.latent or sound.all():
        return state
    readings = problem.readings / np.maximum(np.ptp(problem.readings, axis=0), 1e-300)
    others = np.flatnonzero(sound)
    alike = np.arange(len(sound))
    alike[~sound] = others[KDTree(readings[others]).query(readings[~sound])[1]]
    return state.rows(alike)


def _trial(problem: Problem, here: Linear, step: Array, held: Mask) -> tuple[Linear | None, int]:
    """Return the conditions after a step, poses solved, and the evaluations that it took.

    None where they do not exist. Poses that are held stay where they are.
    """
    try:
        with np.errstate(all="ignore"):
            state = problem.moved(here, step)
            if held.any():
                stay = held[:, None, None]
                state = replace(state, matrices=np.where(stay, here.state.matrices, state.matrices))
            trial, count = solve_poses(problem, problem.linearise(state), held)
    except (MeasurementError, np.linalg.LinAlgError):
        return None, 1
    finite = np.isfinite(trial.value).all() and trial.stack.finite
    return (trial if finite else None), 1 + count


def rounding(system: System, linear: Linear) -> float:
    """Return the decrement that rounding errors of the conditions make."""
    if not system.problem.weighted:
        return 0.0
    size = largest_size(system.problem.legs)
    rows = max(linear.value.size, 1)
    noise = 2.0 * np.finfo(float).eps * size * np.linalg.norm(linear.white.whitener)  # of a chain
    return float(noise * np.sqrt(system.unknowns.map.shape[1] / rows))
