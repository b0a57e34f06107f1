"""An easier problem beside a problem: every quantity at least as uncertain as is typical."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pincal.estimation.linear import Stack
from pincal.estimation.problem import Problem

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
