"""Tensions by which cables hold a platform: the least of those within limits.

Cables only pull. Their tensions t hold the platform against its weight if Jᵀ t = w, J by how much
each cable lengthens with motions of the platform, w the wrench of the weight. With r cables more
than freedoms the solutions fill a polytope of r dimensions; of least sum is one of its corners, at
which r cables are at a limit, or several, of which the mean is taken. All corners of many poses are
worked out in one call (a linear program for each pose says the same).
"""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations, product

import numpy as np

from pincal.errors import MechanismError
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.kinematics.batches import chunks
from pincal.kinematics.closing import by_leg, close_legs
from pincal.kinematics.closure import nominal_legs
from pincal.kinematics.influences import weight
from pincal.model.checks import EXACT, ROUNDING
from pincal.model.mechanism import Mechanism
from pincal.model.platform import Poses
from pincal.model.terms import Cables
from pincal.types import Array, Mask

_MOST = 3  # cables more than freedoms: with more, corners are too many


def tensions(mechanism: GivenMechanism, poses: Poses) -> Array:
    """Return the least tensions within the limits of ``Mechanism.cables``, (N, n_legs), [N].

    Of least sum; NaN where cables cannot hold the platform, or do not reach. The weight is that of
    ``Mechanism.load``.

    Args:
        mechanism: The mechanism; or its name or folder.
        poses: N poses, coordinates of shape (N, dof), [m] and [rad].

    Raises:
        MechanismError: a mechanism that is no cable robot; poses of a wrong shape, or not finite.

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
    """Return the least tensions at poses (N, 4, 4), shape (N, n_legs), [N]; NaN where none hold.

    Lines are of each leg −∂L/∂x, shape (N, 1, dof). Tensions are at least those of the mechanism's
    cables if not given, [N].
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
    for at_limits, others in _corners(count, surplus):
        ends = np.array(list(product((low, cables.most), repeat=surplus))).T  # (r, 2^r)
        right = -w[:, :, None] - A[:, :, at_limits] @ ends
        corner = np.empty((len(A), ends.shape[1], count))
        corner[:, :, at_limits] = ends.T
        with np.errstate(all="ignore"):
            corner[:, :, others] = _solved(A[:, :, others], right).transpose(0, 2, 1)
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
    """Return where tensions within limits hold the platform, (N,): see ``least_tensions``.

    Those nearest to a middle tension are tried first, which is enough nearly everywhere.
    """
    A = np.concatenate(lines, axis=1).transpose(0, 2, 1)
    limits = mechanism.cables or Cables()
    low = max(least or 0.0, limits.least)
    middle = np.sqrt(max(low, 1.0) * min(limits.most, 1e6))
    change = np.linalg.pinv(A) @ (weight(mechanism, matrices) + A.sum(axis=2) * middle)[..., None]
    tried = middle - change[:, :, 0]
    holds: Mask = ((tried >= low) & (tried <= limits.most)).all(axis=1)
    rows = np.flatnonzero(~holds)
    few = [lines_of_leg[rows] for lines_of_leg in lines]
    holds[rows] = np.isfinite(least_tensions(mechanism, matrices[rows], few, least)).all(axis=1)
    return holds


def _solved(A: Array, right: Array) -> Array:
    """Return solutions of square systems (N, n, n), NaN where cables at no limit are dependent."""
    singular = ~(np.abs(np.linalg.det(A)) > ROUNDING)
    A = np.where(singular[:, None, None], np.eye(A.shape[1]), A)
    return np.where(singular[:, None, None], np.nan, np.linalg.solve(A, right))


@lru_cache(maxsize=16)
def _corners(count: int, surplus: int) -> list[tuple[list[int], list[int]]]:
    """Return which cables are at a limit at a corner, and which are not."""
    chosen = [list(places) for places in combinations(range(count), surplus)]
    return [(places, [i for i in range(count) if i not in places]) for places in chosen]
