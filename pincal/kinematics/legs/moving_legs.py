"""Legs on the way to a pose that closes them all, alike ones evaluated in one call."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.kinematics.batches import product, repeated
from pincal.kinematics.legs.closed_forms import is_line
from pincal.kinematics.legs.closing import close_alike, driven
from pincal.kinematics.legs.closure import Closure, LegClosure, evaluate
from pincal.kinematics.legs.every_leg import grouped
from pincal.kinematics.legs.starts import in_home_modes, start_joints

Array = NDArray[np.float64]


@dataclass(frozen=True)
class MovingLegs:
    """Alike legs, and their joints on the way to a pose."""

    places: list[int]
    """Of the legs, among all."""
    legs: list[LegClosure]
    joints: Array
    """Shape (L, N, n_joints [+ n_deformed]); changed in place."""

    def closed(self, matrices: Array, joints: Array) -> Closure:
        """Return their closures at poses, rows of each leg below those of the one before."""
        flat = joints.reshape(-1, joints.shape[2])
        return evaluate(self.legs, flat, repeated(matrices, len(self.legs)))

    def in_mode(self, matrices: Array, rows: NDArray[np.intp]) -> Closure:
        """Return their closures at rows; lines that a step turned over are put back in mode."""
        closure = self.closed(matrices[rows], self.joints[:, rows])
        left = ~in_home_modes(self.legs, closure).reshape(len(self.legs), -1)
        turned = [i for i, leg in enumerate(self.legs) if left[i].any() and is_line(leg)]
        for i in turned:
            own, passive = rows[left[i]], self.legs[i].leg.passive
            there = start_joints(self.legs[i], matrices[own])[0]
            self.joints[i, own[:, None], passive] = there[:, passive]
        return self.closed(matrices[rows], self.joints[:, rows]) if turned else closure

    def follow(self, closure: Closure, rows: NDArray[np.intp], twists: Array) -> Array:
        """Let passive joints at rows follow twists of the poses, (n, dof); return how far, (n,)."""
        every = np.tile(twists, (len(self.legs), 1))[:, :, None]
        step = closure.passive_step(product(closure.pose, every)[:, :, 0])
        step = step.reshape(len(self.legs), len(rows), -1)
        self.joints[:, rows[:, None], self.legs[0].leg.passive] += step
        return np.asarray(np.abs(step).max(axis=(0, 2), initial=0.0))

    def closable(self, closure: Closure, twists: Array) -> Array:
        """Return the largest gap, over the leg's size, that twists and passive joints close, (N,).

        What is left besides is what readings contradict each other by.
        """
        count = len(self.legs)
        moved = product(closure.constraint_by_pose, np.tile(twists, (count, 1))[:, :, None])
        left = product(closure.normal, closure.constraint[:, :, None] + moved)[:, :, 0]
        gaps = np.abs(closure.gap - left).max(axis=1).reshape(count, -1)
        return np.asarray((gaps / np.array([[leg.size] for leg in self.legs])).max(axis=0))

    def all_in_mode(self, closure: Closure) -> NDArray[np.bool_]:
        """Return where all legs are in their working modes, shape (N,)."""
        modes = in_home_modes(self.legs, closure).reshape(len(self.legs), -1)
        return np.asarray(modes.all(axis=0))


def moving_legs(
    legs: Sequence[LegClosure], known: Sequence[Array], matrices: Array
) -> list[MovingLegs]:
    """Return legs with joints as readings say, passive ones near those that close them at poses.

    Args:
        legs: All legs, at their parameter values.
        known: Of each leg readings, then influences, shape (N, n_active [+ n_influences]).
        matrices: Poses ``T_base_platform``, shape (N, 4, 4).
    """
    groups = []
    for places in grouped([leg.form for leg in legs], len(matrices)):
        own = [legs[place] for place in places]
        said = [known[place] for place in places]
        near = zip(own, _joints_near(own, matrices), said, strict=True)
        groups.append(MovingLegs(places, own, np.stack([driven(*one) for one in near])))
    return groups


def _joints_near(legs: Sequence[LegClosure], matrices: Array) -> Array:
    """Return joints that close alike legs at poses, or starts out of reach, (L, N, n_joints)."""
    leg, count = legs[0], len(matrices)
    if not leg.leg.passive:  # all are read
        return np.empty((len(legs), count, len(leg.leg.moving)))
    if len(leg.leg.moving) < len(leg.platform.closing(leg.leg.closes)):  # few poses close it
        return np.stack([start_joints(one, matrices)[0] for one in legs])
    closed = close_alike(legs, repeated(matrices, len(legs)))
    joints = closed.joints.reshape(len(legs), count, -1)
    for own, one, reached in zip(joints, legs, np.split(closed.reached, len(legs)), strict=True):
        if not reached.all():
            own[~reached] = start_joints(one, matrices[~reached])[0]
    return joints
