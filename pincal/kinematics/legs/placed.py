"""A leg and the platform at configurations and poses: the gap between them, and how it changes.

What a row of Nᵀc, a wrench on the tip, changes by along a motion is its power. It is the same at
every point, so Pinocchio's joint columns serve as they are: the few numbers of a wrench are carried
to where they are taken, not the twists of all parameters to the tip.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pincal.kinematics.batches import (
    applied,
    inverse_left_jacobian,
    point_velocity,
    turn_between,
)
from pincal.kinematics.legs.chain import PlatformPoint
from pincal.kinematics.legs.forest import Motion, moments

if TYPE_CHECKING:
    from pincal.kinematics.legs.closure import LegClosure

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Placed:
    """A leg at N configurations, the platform at N poses, and what is between them."""

    leg: LegClosure
    matrices: Array
    """Poses, shape (N, 4, 4)."""
    motion: Motion
    """Of the leg's tip by its joints, then by its parameters."""
    point: PlatformPoint

    @cached_property
    def error(self) -> Array | None:
        """Rotation vectors from the platform's frame to the tip's, (N, 3), if it closes a frame."""
        if not self.leg.turns:
            return None
        return turn_between(self.motion.turns, self.matrices[:, :3, :3] @ self.point.turn)

    @property
    def gap(self) -> Array:
        """c, shape (N, m), [m]; rotation vectors times the leg's size: all rows are lengths."""
        m = self.leg.platform.space
        gap = (self.motion.tips[:m] - applied(self.matrices, self.point.place)[:m, 0]).T
        if self.error is None:
            return gap
        return np.concatenate((gap, self.leg.size * self.error[:, self.leg.axes]), axis=1)

    @property
    def by_joints(self) -> Array:
        """∂c/∂(θ, p) of all joints in order, shape (N, m, n_joints)."""
        return self._rows(self.motion.some(slice(len(self.leg.leg.moving))))

    def by_parameter(self) -> Array:
        """Return ∂c/∂φ, shape (N, m, n_params)."""
        rows = self._rows(self.motion.some(slice(len(self.leg.leg.moving), None)))
        if len(own := self.point.parameters):
            m = self.leg.platform.space
            rows[:, :m, own] -= applied(self.matrices, self.point.speeds)[:m].transpose(2, 0, 1)
            if self.error is not None:
                turned = self._back @ self.matrices[:, :3, :3] @ self.point.turning
                rows[:, m:, own] -= turned
        return rows

    def by_pose(self) -> Array:
        """Return ∂c/∂x, shape (N, m, dof)."""
        arm = applied(self.matrices, self.point.arm)[:, 0].T
        twist_rows = self.leg.platform.twist_rows
        pose = -point_velocity(arm, twist_rows)[:, : self.leg.platform.space]
        if self.error is None:
            return pose
        turned = np.equal.outer((3, 4, 5), twist_rows).astype(float)
        return np.concatenate((pose, -(self._back @ turned)), axis=1)

    def power_by_parameter(self, normal: Array) -> Array:
        """Return Nᵀ ∂c/∂φ of N, shape (N, m, k): shape (N, k, n_params)."""
        found = np.empty((normal.shape[2], len(self.leg.parameters), len(normal)))
        m, n, own = self.leg.platform.space, len(self.leg.leg.moving), self.point.parameters
        for row, y in zip(found, normal.transpose(2, 1, 0), strict=True):
            force, turning = np.zeros((len(self.motion.tips), len(normal))), y[m:].T[:, None]
            force[:m] = y[:m]
            moment = None if self.error is None else (turning @ self._spread)[:, 0].T
            row[:] = self.motion.power(force, moment, n)
            if len(own):
                row[own] -= _along(self.matrices, self.point.speeds, y[:m])
                if self.error is not None:
                    back = (turning @ self._back) @ self.matrices[:, :3, :3]
                    row[own] -= (back @ self.point.turning)[:, 0].T
        return found.transpose(2, 0, 1)

    def power_by_pose(self, normal: Array) -> Array:
        """Return Nᵀ ∂c/∂x of N, shape (N, m, k): shape (N, k, dof)."""
        m, rows = self.leg.platform.space, list(self.leg.platform.twist_rows)
        arm = applied(self.matrices, self.point.arm)[:, 0]
        found = np.zeros((normal.shape[2], 6, len(normal)))
        for row, y in zip(found, normal.transpose(2, 1, 0), strict=True):
            row[:m] = y[:m]
            row[6 - (1 if m == 2 else 3) :] = moments(arm[:m], y[:m])
            if self.error is not None:
                row[3:] += (y[m:].T[:, None] @ self._back)[:, 0].T
        return -found[:, rows].transpose(2, 0, 1)

    def passive_turning(self) -> Array:
        """Return how passive joints turn the tip, (1 or 3, n_passive, N): across z, or all."""
        return self.motion.some(list(self.leg.leg.passive))[len(self.motion.tips) :]

    def drive_twists(self) -> tuple[Array, Array | None]:
        """Return the tip twists (6, N) of the first active joint and of the next revolute joint."""
        moving, active = self.leg.leg.moving, self.leg.leg.active[0]
        following = [i for i in range(active + 1, len(moving)) if moving[i].kind == "revolute"]
        turn = self.motion.twists(following[:1])[:, 0] if following else None
        return self.motion.twists([active])[:, 0], turn

    @cached_property
    def _spread(self) -> Array:
        """How a turn of the tip changes the turn's rows, shape (N, 1 or 3, 3)."""
        assert self.error is not None
        return self.leg.size * inverse_left_jacobian(self.error)[:, self.leg.axes]

    @cached_property
    def _back(self) -> Array:
        """How a turn of the platform changes them, but for the sign, shape (N, 1 or 3, 3)."""
        assert self.error is not None
        back = inverse_left_jacobian(self.error).transpose(0, 2, 1)
        return self.leg.size * back[:, self.leg.axes]

    def _rows(self, twists: Array) -> Array:
        """Return rows of the closure by twists of the tip, (3 or 6, k, N), shape (N, m, k)."""
        rows = twists[: self.leg.platform.space].transpose(2, 0, 1)
        if self.error is None:
            return rows
        turned = self._spread @ np.ascontiguousarray(twists[3:].transpose(2, 0, 1))
        return np.concatenate((rows, turned), axis=1)


def _along(matrices: Array, vectors: Array, force: Array) -> Array:
    """Return f · (R v) of vectors (4, k[, N]) in the platform frame and f (2 or 3, N), (k, N)."""
    within = np.einsum("nij,in->jn", matrices[:, : len(force), :3], force)
    if vectors.ndim == 3:
        return np.einsum("jkn,jn->kn", vectors[:3], within)
    return np.asarray(vectors[:3].T @ within)
