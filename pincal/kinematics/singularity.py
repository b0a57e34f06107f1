"""Dimensionless distances of poses from singularities, and tensions of cables.

Type 1 (a drive loses its leg): |Nᵀ ∂c/∂θ| over the lever of the drive; for a planar dyad the sine
of the elbow angle. Type 2 (the platform gains a freedom): the determinant of the legs' constraint
lines, with unit directions and moments over the platform's radius. Its sign is relative to the home
pose: negative poses lie across a type-2 singularity, in another assembly mode.

Cables only pull. Their tensions t hold the platform against its weight if Jᵀ t = w, where J has the
derivatives of the cables' lengths by motions of the platform, and w is the wrench of the weight.
With r cables more than freedoms the solutions are a polytope of r dimensions. The least sum is at a
corner, where r cables are at a limit, or at several corners, whose mean is taken. All corners are
computed for many poses at once (a linear program for each pose gives the same).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations, product

import numpy as np

from pincal.errors import MechanismError
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.kinematics.batches import chunks, cross, point_velocity
from pincal.kinematics.closed_forms import closed_form
from pincal.kinematics.closing import ClosedLegs, by_leg, close, close_legs, sensor_law
from pincal.kinematics.closure import Closure, nominal_legs
from pincal.kinematics.derivatives import nearest_closure
from pincal.kinematics.influences import weight
from pincal.model import Mechanism, Poses
from pincal.model.checks import EXACT, ROUNDING
from pincal.model.terms import Cables
from pincal.types import Array, Mask

_MOST = 3  # cables more than freedoms; more have too many corners


@dataclass(frozen=True)
class SingularityMargins:
    """Distances of N poses from singularities; NaN where a leg does not reach."""

    type1: Array
    """Margin of each leg's drive, shape (N, n_legs), in [0, 1]."""
    type2: Array
    """Margin of the platform, shape (N,), signed relative to home."""


def margins(mechanism: GivenMechanism, poses: Poses) -> SingularityMargins:
    """Return the distances of poses from both types of singularity.

    Args:
        mechanism: The mechanism; or its name or folder.
        poses: N poses, coordinates of shape (N, dof), [m] and [rad].

    Raises:
        MechanismError: poses have a wrong shape, or are not finite.
    """
    mechanism = as_mechanism(mechanism)
    placed = mechanism.platform.matrices(poses)
    type1, type2 = np.empty((len(placed), len(mechanism.legs))), np.empty(len(placed))
    for rows in chunks(len(placed)):
        closed = close_legs(nominal_legs(mechanism), placed[rows])
        reached = np.stack(by_leg(closed, lambda group: group.reached), axis=1)
        type1[rows] = np.where(reached, drive_margins(closed), np.nan)
        lines = by_leg(closed, lambda group: group.closure.constraint_by_pose)
        type2[rows] = np.where(reached.all(axis=1), platform_margin(mechanism, lines), np.nan)
    return SingularityMargins(type1, type2)


def drive_margins(closed: Sequence[tuple[list[int], ClosedLegs]]) -> Array:
    """Return |Nᵀ ∂c/∂θ| over the drive's lever, (N, n_legs); the least of several drives."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.stack(by_leg(closed, lambda group: _grip(group.closure)), axis=1)


def _grip(closure: Closure) -> Array:
    """Return the type-1 margin of a leg's drives, (N,); 1 for a leg without any.

    The lever is the speed of the next revolute axis (for a planar dyad the length l), or the tip's.
    """
    if not closure.drive.shape[2]:
        return np.ones(len(closure.gap))
    if closure.drive.shape[2] > 1:
        speed = np.linalg.norm(closure.active, axis=1, keepdims=True)
        relative = np.nan_to_num(closure.drive / speed)
        return np.asarray(np.linalg.svd(relative, compute_uv=False)[:, -1])
    leg, lever = closure.leg.leg, np.linalg.norm(closure.active[:, :, 0], axis=1)
    (active,) = leg.active
    if revolute := [i for i in range(active + 1, len(leg.moving)) if leg.moving[i].turns]:
        drive, turn = closure.motion.twists([active, revolute[0]]).swapaxes(0, 1)
        arm = cross(turn[3:].T, turn[:3].T)  # from the tip to the next axis
        speed = np.linalg.norm(drive[:3].T + cross(drive[3:].T, arm), axis=1)
        lever = np.where(speed > 1e-9 * lever, speed, lever)
    return np.asarray(np.linalg.norm(closure.drive, axis=(1, 2)) / lever)


def platform_margin(mechanism: Mechanism, lines: Sequence[Array]) -> Array:
    """Return the determinant of unit constraint lines, with its sign relative to home, (N,).

    ``lines`` are Nᵀ ∂c/∂x of each leg, (N, k, dof). NaN if a leg does not close at home.
    """
    side = np.sign(home_determinant(mechanism)) or 1.0
    return _volume(mechanism, np.concatenate(lines, axis=1)) * side


def rods_margin(mechanism: Mechanism, matrices: Array) -> Array | None:
    """Return the platform's margin at poses (N, 4, 4) by closed forms without closing legs, (N,).

    None if a leg is neither a rod nor a slide, or does not close at home. The margin has no meaning
    where a leg does not reach.
    """
    poses = np.concatenate((mechanism.platform.home_pose.as_matrix(), matrices))
    rows, lines = mechanism.platform.twist_rows, []
    for closure in nominal_legs(mechanism):
        form, targets = closed_form(closure), closure.targets(poses)
        if form is None or closure.leg.active != [form.driven]:  # other forces, too
            return None
        velocity, rod = point_velocity(targets - poses[:, :3, 3], rows), form.to_tip(targets)
        with np.errstate(invalid="ignore"):  # a rod without a direction
            lines.append((rod[:, None] @ velocity)[:, 0] / np.linalg.norm(rod, axis=1)[:, None])
    volume = _volume(mechanism, np.stack(lines, axis=1))
    if np.isnan(volume[0]) or not np.isfinite(home_determinant(mechanism)):
        return None
    return volume[1:] * (np.sign(volume[0]) or 1.0)


def _volume(mechanism: Mechanism, lines: Array) -> Array:
    """Return volumes that lines span, (N,): determinants, if there are as many as freedoms."""
    turns = [i for i, row in enumerate(mechanism.platform.twist_rows) if row >= 3]
    points = np.array([leg.point.placement.xyz for leg in mechanism.legs])
    lines[:, :, turns] /= np.sqrt((points**2).sum(axis=1).mean()) or 1.0  # root mean square radius
    with np.errstate(invalid="ignore"):  # a leg whose passive joints are singular is NaN
        if lines.shape[1] == lines.shape[2]:
            return np.asarray(np.linalg.det(lines))
        across = lines.transpose(0, 2, 1)
        gram = across @ lines if lines.shape[1] > lines.shape[2] else lines @ across
        return np.sqrt(np.clip(np.linalg.det(gram), 0.0, None))


@lru_cache(maxsize=64)
def home_determinant(mechanism: Mechanism) -> float:
    """Return the signed determinant at home; NaN if a leg does not close there."""
    matrices = mechanism.platform.home_pose.as_matrix()
    lines = []
    for closure in nominal_legs(mechanism):
        if mechanism.by_readings:
            leg = closure.leg
            readings = sensor_law(closure).reading(leg.home[None, leg.active])
            home = nearest_closure((closure,), matrices, readings, leg.home[None])[0]
            lines.append(home.constraint_by_pose)
            continue
        closed = close((closure,), matrices)
        if not closed.reached[0]:
            return float("nan")
        lines.append(closed.closure.constraint_by_pose)
    return float(_volume(mechanism, np.concatenate(lines, axis=1))[0])


def tensions(mechanism: GivenMechanism, poses: Poses) -> Array:
    """Return the tensions of least sum within the limits of ``Mechanism.cables``, (N, n_legs), [N].

    NaN where cables cannot hold the platform, or do not reach. The weight is that of
    ``Mechanism.load``.

    Args:
        mechanism: The mechanism; or its name or folder.
        poses: N poses, coordinates of shape (N, dof), [m] and [rad].

    Raises:
        MechanismError: it is not a cable robot, or poses have a wrong shape or are not finite.

    Example:
        >>> import pincal
        >>> pincal.tensions("8cable", [[0.0, 0.0, 1.5, 0.0, 0.0, 0.0]]).round(1).tolist()
        [[51.2, 51.2, 51.2, 51.2, 51.2, 51.2, 51.2, 51.2]]
    """
    mechanism = as_mechanism(mechanism)
    placed = mechanism.platform.matrices(poses)
    least = np.empty((len(placed), len(mechanism.legs)))
    for rows in chunks(len(placed)):
        closed = close_legs(nominal_legs(mechanism), placed[rows])
        lines = by_leg(closed, lambda legs: legs.closure.constraint_by_pose / legs.closure.drive)
        reached = np.all(by_leg(closed, lambda legs: legs.reached), axis=0)
        least[rows] = np.where(
            reached[:, None], least_tensions(mechanism, placed[rows], lines), np.nan
        )
    return least


def least_tensions(
    mechanism: Mechanism, matrices: Array, lines: list[Array], least: float | None = None
) -> Array:
    """Return the tensions of least sum at poses (N, 4, 4), (N, n_legs), [N]; NaN where none hold.

    ``lines`` are −∂L/∂x of each leg, (N, 1, dof). ``least`` is the lower limit of the tensions, by
    default that of the cables.
    """
    cables, count = mechanism.cables, len(mechanism.legs)
    surplus = count - mechanism.platform.dof
    if cables is None or not 0 <= surplus <= _MOST:
        raise MechanismError(
            f"{mechanism.name!r} has no tensions: expected 'cables: {{least: …, most: …}}' in its "
            f"mechanism.yaml, and as many cables as freedoms, or up to {_MOST} more"
        )
    low = cables.least if least is None else max(least, cables.least)
    A = np.concatenate(lines, axis=1).transpose(0, 2, 1)  # A t + weight = 0
    w, best, times = weight(mechanism, matrices), np.zeros((len(A), count)), np.zeros(len(A))
    sums, slack = np.full(len(A), np.inf), ROUNDING * max(low, 1.0)
    for at_limits in map(list, combinations(range(count), surplus)):
        others = [i for i in range(count) if i not in at_limits]
        ends = np.array(list(product((low, cables.most), repeat=surplus))).T  # (r, 2^r)
        right = -w[:, :, None] - A[:, :, at_limits] @ ends
        corner = np.empty((len(A), ends.shape[1], count))
        corner[:, :, at_limits] = ends.T
        inner = A[:, :, others]  # singular where the free cables are dependent
        solvable = (np.abs(np.linalg.det(inner)) > ROUNDING)[:, None, None]
        solution = np.linalg.solve(np.where(solvable, inner, np.eye(len(others))), right)
        corner[:, :, others] = np.where(solvable, solution, np.nan).transpose(0, 2, 1)
        holds = ((corner >= low - slack) & (corner <= cables.most + slack)).all(axis=2)
        total = np.where(holds, corner.sum(axis=2), np.inf)
        lower = total.min(axis=1) < (1.0 - EXACT) * sums
        best[lower], times[lower] = 0.0, 0.0
        sums = np.minimum(sums, total.min(axis=1))
        equal = holds & (total <= (1.0 + EXACT) * sums[:, None])
        best += np.where(equal[:, :, None], corner, 0.0).sum(axis=1)
        times += equal.sum(axis=1)
    with np.errstate(invalid="ignore"):
        return best / times[:, None]


def can_hold(
    mechanism: Mechanism, matrices: Array, lines: list[Array], least: float | None = None
) -> Mask:
    """Return where tensions within limits hold the platform, (N,)."""
    A, limits = np.concatenate(lines, axis=1).transpose(0, 2, 1), mechanism.cables or Cables()
    low = max(least or 0.0, limits.least)
    middle = np.sqrt(max(low, 1.0) * min(limits.most, 1e6))
    change = np.linalg.pinv(A) @ (weight(mechanism, matrices) + A.sum(axis=2) * middle)[..., None]
    tried = middle - change[:, :, 0]
    holds: Mask = ((tried >= low) & (tried <= limits.most)).all(axis=1)
    rows = np.flatnonzero(~holds)
    few = [lines_of_leg[rows] for lines_of_leg in lines]
    holds[rows] = np.isfinite(least_tensions(mechanism, matrices[rows], few, least)).all(axis=1)
    return holds
