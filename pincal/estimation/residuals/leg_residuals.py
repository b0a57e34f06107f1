"""Residuals of one leg as people read them: closure at the measured pose, or of its readings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.estimation.linear import Linear
from pincal.estimation.problem import Problem
from pincal.kinematics.batches import least_squares

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LegResiduals:
    """Residuals of one leg, k at a pose."""

    value: Array
    """Shape (N, k)."""
    sigma: Array
    """Their modelled standard deviations, shape (N, k)."""
    unit: str
    """m of closures, that of the readings otherwise."""
    quantity: str
    """``"closure"`` or ``"reading"``."""
    follows: Array
    """Derivatives by the conditions at each pose, shape (N, k, n_conditions)."""


def leg_residuals(problem: Problem, linear: Linear, index: int) -> LegResiduals:
    """Return what a leg misses at each pose.

    Poses as measured: its closure, or joint residual, there. Poses that were estimated: predicted
    less measured reading; of exact readings, which are missed by nothing, the closure at the pose
    that was measured (to first order), where it was.
    """
    demand = linear.stack.demands[index]
    condition, own = problem.conditions[index], problem.reading_columns[index]
    by_reading = demand.reading * problem.sigma_readings[:, None, own]
    rows, (count, k) = problem.leg_rows[index], demand.value.shape
    follows = np.zeros((count, k, linear.stack.value.shape[1]))
    follows[:, :, rows] = np.eye(k)
    if problem.pose_roots is not None:
        noise = np.concatenate((by_reading, demand.pose @ problem.pose_roots), axis=2)
        what = ("m", "closure") if problem.weighted else (condition.reading_unit, "reading")
        return LegResiduals(demand.value, np.linalg.norm(noise, axis=2), *what, follows)
    if problem.sigma_readings[:, own].any() and k == 1:
        sigma = problem.sigma_readings[:, own]  # of as many readings as there are
        follows = np.repeat(follows, sigma.shape[1], axis=1)
        follows[:, :, rows] = -least_squares(demand.reading, np.ones((count, 1, 1)))
        value = demand.as_joint().value
        return LegResiduals(value, sigma, condition.reading_unit, "reading", follows)
    n_legs = problem.leg_rows[-1].stop
    h, B = linear.stack.value[:, n_legs:], linear.stack.pose[:, n_legs:]
    whole = problem.observation.measured.sum(axis=1) >= problem.platform.dof
    back = np.where(whole[:, None, None], np.linalg.pinv(B, rcond=1e-9), 0.0)
    moved = demand.pose @ back  # from what was measured to the estimated pose
    noise = np.concatenate((by_reading, moved @ problem.observed_roots), axis=2)
    value = demand.value - (moved @ h[:, :, None])[:, :, 0]
    follows[:, :, n_legs:] = -moved
    return LegResiduals(value, np.linalg.norm(noise, axis=2), "m", "closure", follows)
