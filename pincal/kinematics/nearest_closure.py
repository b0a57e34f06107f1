"""The nearest closure of a leg: at poses and readings that need not agree, passive joints do best.

What is left of the closure, Nᵀ c, exists out of reach and stays tame near singularities.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pincal.kinematics.batches import lengths, product
from pincal.kinematics.closing import driven, start_joints
from pincal.kinematics.closure import Closure, LegClosure, each, evaluate
from pincal.model.checks import EXACT
from pincal.types import Array, Mask

_STEPS = 60  # of Newton's method
_SMALL = 1e-8  # step at which it ends: Nᵀ c is off by its square
_FAR = 1e-2  # of a leg's size, from which a gap's curvature counts


def nearest_closure(
    legs: Sequence[LegClosure], matrices: Array, known: Array, joints: Array | None = None
) -> tuple[Closure, Array]:
    """Return the closure of L alike legs at poses and readings, |c| least, and the joints there.

    N rows of each leg stand below those of the one before. Deformations of parameters stand behind
    joint positions, if there are any.

    Args:
        legs: Legs of one form, at their parameter values.
        matrices: Poses ``T_base_platform``, shape (L N, 4, 4).
        known: Readings [rad] or [m], then influences, shape (L N, n_active [+ n_influences]).
        joints: Where the search for passive joints starts, shape (L N, n_joints [+ n_deformed]);
            near those that close the legs if not given.
    """
    leg, n = legs[0].leg, len(legs[0].leg.moving)
    if joints is not None:
        start = joints[:, :n].copy()
    elif leg.passive:
        start = each(lambda leg, poses: start_joints(leg, poses)[0], legs, matrices)
    else:
        start = np.empty((len(matrices), n))
    positions, count = each(driven, legs, start, known), len(matrices) // len(legs)
    scales = np.repeat([closure.leg.passive_scales for closure in legs], count, axis=0)
    far_gaps = _FAR * np.repeat([closure.size for closure in legs], count)
    for _ in range(_STEPS):
        closed = evaluate(legs, positions, matrices)
        step = closed.passive_step()
        if leg.passive and closed.gap.shape[1] <= 3:  # of points
            far = lengths(closed.gap) > far_gaps
            if far.any():
                step[far] = _curved_step(closed, far)
        positions[:, leg.passive] += step
        if np.abs(step / scales).max(initial=0.0) <= _SMALL:
            break
    return closed, positions


def _curved_step(closed: Closure, rows: Mask) -> Array:
    """Return Newton steps of passive joints where points stay far apart, shape (n, n_passive).

    Gauss-Newton steps are right where c is 0; out of reach the paths' curvature c · (ω_i × v_j),
    i ≤ j, counts as much, and without it they overshoot. Where |c| is no minimum along a
    direction, the step goes down it (saddle-free Newton).
    """
    gap, J = closed.gap[rows], closed.passive[rows]
    n, m = len(gap), gap.shape[1]
    turning, space = np.zeros((3, J.shape[2], n)), np.zeros((n, 3, J.shape[2] + 1))
    rates = closed.motion.twists_at_tip(list(closed.leg.leg.passive))[
        len(closed.motion.tips) :, :, rows
    ]
    turning[3 - len(rates) :] = rates
    space[:, :m, :-1], space[:, :m, -1] = J, gap
    v, c = space[:, :, :-1], space[:, :, -1]
    (x, y, z), (u, w, t) = c.T, turning
    crossed = np.array((y * t - z * w, z * u - x * t, x * w - y * u))
    pulled = crossed.transpose(2, 1, 0)  # c · (ω × v) = (c × ω) · v
    bend = np.triu(pulled @ v)
    bend += np.triu(bend, 1).transpose(0, 2, 1)
    transposed = J.transpose(0, 2, 1)
    values, vectors = np.linalg.eigh(product(transposed, J) + bend)
    downhill = vectors.transpose(0, 2, 1) @ product(transposed, gap[:, :, None])
    steepest = np.abs(values).max(axis=1, keepdims=True)
    least = np.maximum(EXACT * steepest, np.finfo(float).tiny)  # a slide of no length goes nowhere
    steps = vectors @ (downhill[:, :, 0] / np.maximum(np.abs(values), least))[:, :, None]
    return -np.asarray(steps)[:, :, 0]


def arm_poses(leg: LegClosure, known: Array) -> Array:
    """Return where an arm puts the platform, ``T_base_platform``, shape (N, 4, 4).

    Known are readings, then influences, shape (N, n_active [+ n_influences]).
    """
    joints = np.empty((len(known), len(leg.leg.moving)))
    return leg.frame(driven(leg, joints, known))
