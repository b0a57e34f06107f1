"""Poses at their optimum: solved each alone, all at once, after every step of the parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pincal.estimation.linear import Linear
from pincal.estimation.problem import Problem
from pincal.kinematics.legs.closure import Newton, largest_size

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
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
