"""Derivatives where readings and poses agree: what measurements there can observe, and what not.

Where a search starts, readings and measured poses contradict each other in the nominal mechanism,
and directions that are unobservable look as if they were not. At poses that its legs have, they are
unobservable exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.estimation.observability.indices import RANK_TOLERANCE, scaled_axes
from pincal.estimation.problem import Problem
from pincal.estimation.unknowns import Unknowns
from pincal.kinematics.configurations import legs_at, nearby
from pincal.kinematics.legs.closure import largest_size
from pincal.model.measuring.measurements import Plan
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]
GENERIC = 200  # configurations, at least


@dataclass(frozen=True)
class Derivatives:
    """Derivatives at poses that all legs have."""

    matrices: Array
    """``T_base_platform``, shape (N, 4, 4)."""
    leg_pose: Array
    """Of the legs, over the mechanism's size, shape (N, k, dof)."""
    leg_parameter: Array
    """Shape (N, k, n_params)."""
    seen_pose: Array
    """Of what is measured, shape (N, r, dof)."""
    seen_parameter: Array
    """By all parameters and external unknowns, shape (N, r, n)."""

    def jacobian(self, unknowns: Unknowns) -> Array:
        """Return what the free unknowns do to the measurements, poses eliminated: (m, n_free).

        Rows of priors are below those of the measurements.
        """
        T = unknowns.map
        more = T.shape[0] - self.leg_parameter.shape[2]
        legs = np.pad(self.leg_parameter, ((0, 0), (0, 0), (0, more)))
        parameter = np.concatenate((legs, self.seen_parameter), axis=1)
        pose = np.concatenate((self.leg_pose, self.seen_pose), axis=1)
        Q = np.linalg.qr(pose, mode="complete")[0]
        free = Q[:, :, pose.shape[2] :].transpose(0, 2, 1) @ parameter
        _, prior = unknowns.prior_rows(unknowns.start)
        return np.concatenate((free.reshape(-1, T.shape[0]) @ T, prior))


def derivatives_near(
    mechanism: Mechanism, problem: Problem, unknowns: Unknowns, *, generic: bool
) -> Derivatives:
    """Return derivatives at the start's poses or readings, or at generic ones about them.

    Args:
        mechanism: The nominal mechanism.
        problem: The problem, at its start.
        unknowns: Of the problem.
        generic: Whether configurations are moved about, and everything is measured in every row
            that is measured in some row.
    """
    platform = mechanism.platform
    start = problem.start(unknowns.start[: problem.columns[-1].stop])
    size = largest_size(problem.legs)
    chosen = np.arange(len(start.matrices))
    if generic:  # the same ones in whatever order rows were measured
        chosen = np.lexsort((*start.matrices[:, :3, 3].T, *problem.readings.T))[:GENERIC]
    planned = Plan(
        platform.from_matrices(start.matrices[chosen]),
        readings=problem.readings[chosen] if mechanism.by_readings else None,
        influences={name: values[chosen] for name, values in problem.influences.items()},
    )
    values = (start.parameters[columns] for columns in problem.columns)
    at = mechanism.with_parameters(dict(zip(mechanism.leg_names, values, strict=True)))
    legs = legs_at(at, nearby(at, planned, GENERIC, size) if generic else planned)
    matrices = platform.matrices(legs.poses)
    rows = chosen[np.flatnonzero(legs.reached) % len(chosen)]
    observation = problem.observation.anywhere() if generic else problem.observation
    seen = observation.rows(rows).evaluate(matrices, start.external)
    outer = np.zeros((*seen.pose.shape[:2], len(unknowns.names)))
    outer[:, :, legs.parameter.shape[2] :] = seen.external
    per = np.array([1.0 / size if unit == "m" else 1.0 for unit in observation.units])
    ok = np.isfinite(seen.pose).all(axis=(1, 2)) & np.isfinite(outer).all(axis=(1, 2))
    return Derivatives(
        matrices[ok],
        legs.pose[ok] / size,
        legs.parameter[ok] / size,
        seen.pose[ok] * per[:, None],
        outer[ok] * per[:, None],
    )


def lost_directions(J: Array) -> tuple[Array, Array]:
    """Return unobservable directions of a Jacobian, and the lengths of its columns.

    Rows v of shape (n_lost, n), in columns of unit length: unknowns may move along v / lengths; and
    v · lengths is what that leaves as it is in the changes nearest to none, each measured by what
    it alone does.

    Args:
        J: Shape (m, n).
    """
    lengths, s, axes = scaled_axes(J)
    return axes[int((s > RANK_TOLERANCE * s[0]).sum()) :], lengths
