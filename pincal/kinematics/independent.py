"""Which of a leg's parameters are identifiable from its own closure, whatever is measured.

A passive joint's zero, or a shift along a joint's axis that the next placement has too, changes
nothing. Over random configurations the closure's derivatives by such parameters depend on
those by others: of the parameters in order, those that add to the rank are kept.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pincal.kinematics.closure import LegClosure, joint_range
from pincal.model.leg import Leg
from pincal.model.platform import Platform

Array = NDArray[np.float64]
_CONFIGURATIONS = 120
_DEPENDS = 1e-7  # of a column, what others leave of it


def independent(leg: Leg, platform: Platform, order: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of parameters that are independent of those before them.

    Args:
        leg: The leg, at nominal parameters.
        platform: Of its mechanism.
        order: Names of all its parameters, those to keep rather first.
    """
    closure = LegClosure(leg, platform)
    rng = np.random.default_rng(0)
    joints = rng.uniform(*joint_range(leg), (_CONFIGURATIONS, len(leg.moving)))
    part = closure.evaluate(joints, _poses(closure, joints, rng))
    rows = part.project(part.parameter)
    rows = rows.reshape(-1, rows.shape[2])
    size = closure.size or 1.0
    scale = np.array([1.0 if leg.units[name] == "m" else 1.0 / size for name in order])
    columns = rows[:, [leg.parameter_names.index(name) for name in order]] * scale
    columns = columns[np.isfinite(columns).all(axis=1)]
    kept: list[str] = []
    basis: list[Array] = []
    for name, column in zip(order, columns.T, strict=True):
        rest = column.copy()
        for _ in range(2):  # twice is enough: Gram-Schmidt's rounding errors are gone
            for q in basis:
                rest -= (q @ rest) * q
        if np.linalg.norm(rest) > _DEPENDS * np.sqrt(len(column)):
            basis.append(rest / np.linalg.norm(rest))
            kept.append(name)
    return tuple(kept)


def _poses(closure: LegClosure, joints: Array, rng: np.random.Generator) -> Array:
    """Return poses in which the platform is where the leg puts it, turned at random."""
    platform = closure.platform
    if closure.leg.closes == "frame":
        return closure.frame(joints)
    matrices = np.tile(np.eye(4), (len(joints), 1, 1))
    if platform.turns == 3:
        matrices[:, :3, :3] = Rotation.random(len(joints), rng=rng).as_matrix()
    elif platform.turns == 1:
        turns = np.outer(
            rng.uniform(-np.pi, np.pi, len(joints)), np.eye(3)[platform.twist_rows[-1] - 3]
        )
        matrices[:, :3, :3] = Rotation.from_rotvec(turns).as_matrix()
    matrices[:, :3, 3] = closure.tips(joints) - closure.targets(matrices)
    return matrices
