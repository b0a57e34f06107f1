"""The space of sensor readings that a workspace spans, and its symmetry.

If the readings are counted alike at every leg, an element of the mechanism's group
permutes them: the articular-variables space is as symmetric as the workspace (3-RRR
paper, Section 3.2). The paper gives this as a conjecture; here it is checked by solving
the forward kinematics of permuted readings.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.files.given_mechanism import GivenMechanism, as_mechanism
from pincal.kinematics.forward import forward
from pincal.kinematics.inverse import inverse
from pincal.symmetry.detect import symmetry_group
from pincal.symmetry.elements import Element
from pincal.workspace.criteria import Margins, in_workspace

Array = NDArray[np.float64]
_ASIDE = 1e-2  # of the poses' spread: how far off the forward kinematics starts


@dataclass(frozen=True)
class ArticularSymmetry:
    """How well permuted readings stay in the space."""

    element: Element
    solved: int
    """Number of permuted readings whose forward kinematics converged."""
    asked: int
    off: float
    """Largest distance of the poses found from the carried ones, [m] and [rad] together."""
    inside: int
    """Number of poses found that are in the workspace."""


def articular_space(mechanism: GivenMechanism, poses: Array) -> Array:
    """Return the sensor readings of poses in the workspace, shape (N, n_legs), [rad] or [m]."""
    mechanism = as_mechanism(mechanism)
    return inverse(mechanism, poses).readings


def equal_sums(readings: Array) -> Array:
    """Return readings seen along the axis ψ₁ = ψ₂ = … (3-RRR paper, Fig. 7).

    The first two columns lie in the plane of equal sums, the last along its normal.

    Args:
        readings: Shape (N, n_legs); three legs give the plane of the paper.
    """
    readings = np.asarray(readings, dtype=np.float64)
    n = readings.shape[1]
    turn = 2 * np.pi * np.arange(n) / n
    axes = np.stack((np.cos(turn), np.sin(turn))) * np.sqrt(2 / n)
    along = np.full((1, n), 1 / np.sqrt(n))
    return readings @ np.concatenate((axes, along)).T


def articular_symmetry(
    mechanism: GivenMechanism, poses: Array, least: Margins | None = None, seed: int = 0
) -> tuple[ArticularSymmetry, ...]:
    """Return whether permuted readings are reached, for each element but the identity.

    Readings of poses are permuted as the element permutes legs; their forward kinematics,
    started aside, must give poses in the workspace, which are the carried ones.

    Args:
        mechanism: The mechanism.
        poses: Poses in its workspace, coordinates of shape (N, dof).
        least: Margins of the workspace.
        seed: Seed of where the forward kinematics starts.

    Raises:
        MechanismError: a mechanism whose forward kinematics is not determined.

    Example:
        >>> import pincal
        >>> found = pincal.articular_symmetry("5R", pincal.sample_workspace("5R", 50, seed=0))
        >>> len(found) > 0
        True
    """
    mechanism = as_mechanism(mechanism)
    platform, group = mechanism.platform, symmetry_group(mechanism)
    poses = platform.coordinates_of(poses)
    readings = articular_space(mechanism, poses)
    spread = np.ptp(platform.twists_between(poses[:1].repeat(len(poses), 0), poses), axis=0)
    aside = np.random.default_rng(seed).normal(size=poses.shape) * _ASIDE * spread
    found = []
    for element, permutation in list(zip(group.elements, group.permutations, strict=True))[1:]:
        permuted = np.empty_like(readings)
        permuted[:, list(permutation)] = readings
        carried = element.poses(platform, poses)
        solution = forward(mechanism, permuted, platform.moved(carried, aside))
        ok = solution.converged
        off = platform.twists_between(carried[ok], solution.poses[ok])
        inside = in_workspace(mechanism, solution.poses[ok], least)
        worst = float(np.linalg.norm(off, axis=1).max(initial=0.0))
        found.append(
            ArticularSymmetry(element, int(ok.sum()), len(poses), worst, int(inside.sum()))
        )
    return tuple(found)
