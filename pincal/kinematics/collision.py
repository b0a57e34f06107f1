"""Configurations at which a URDF's own collision geometry is free of itself."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pincal.errors import FileError, MechanismError

Array = NDArray[np.float64]
_CLOSE = 2  # joints: bodies nearer than that along the chain touch by design


def free_of_collision(
    path: str | Path, joints: Sequence[str], positions: Array, neutral: bool = True
) -> NDArray[np.bool_]:
    """Return where the bodies of a robot do not collide with each other, shape (N,).

    Bodies of neighbouring joints touch by design and are not compared, nor are those that already
    collide where all joints are at zero. ``package://`` is looked for above the URDF's folder.

    Args:
        path: URDF with collision geometry.
        joints: Names of the joints that move; the others stay at their neutral positions.
        positions: Of these joints, shape (N, n), [rad] or [m].
        neutral: Whether what collides at zero is taken as touching by design.

    Raises:
        FileError: the file or one of its meshes cannot be read.
        MechanismError: no such joint, or no collision geometry.
    """
    path = Path(path).absolute()
    if not path.is_file():
        raise FileError(f"cannot read {path}: no such file")
    try:
        model = pin.buildModelFromUrdf(str(path))
        places = [str(folder) for folder in path.parents]
        shapes = pin.buildGeomFromUrdf(
            model, str(path), pin.GeometryType.COLLISION, package_dirs=places
        )
    except (ValueError, RuntimeError) as error:
        raise FileError(
            f"{path}: its collision geometry cannot be read: {error}. 'package://' "
            "is looked for in the folders above the URDF and in those of ROS_PACKAGE_PATH"
        ) from error
    if not shapes.ngeoms:
        raise MechanismError(f"{path}: no <collision> geometry to check")
    entries = [_entry(model, name, path) for name in joints]
    shapes.addAllCollisionPairs()
    for pair in list(shapes.collisionPairs):
        ends = (shapes.geometryObjects[i].parentJoint for i in (pair.first, pair.second))
        if _apart(model, *ends) < _CLOSE:
            shapes.removeCollisionPair(pair)
    data, found = model.createData(), shapes.createData()
    rest = pin.neutral(model)
    if neutral:
        pin.computeCollisions(model, data, shapes, found, rest, False)
        touching = [
            pair
            for pair, result in zip(
                list(shapes.collisionPairs), found.collisionResults, strict=True
            )
            if result.isCollision()
        ]
        for pair in touching:
            shapes.removeCollisionPair(pair)
        found = shapes.createData()
    free = np.empty(len(positions), dtype=bool)
    for row, values in enumerate(np.asarray(positions, dtype=np.float64)):
        q = rest.copy()
        for (index, width), value in zip(entries, values, strict=True):
            q[index : index + width] = value if width == 1 else (np.cos(value), np.sin(value))
        free[row] = not pin.computeCollisions(model, data, shapes, found, q, True)
    return free


def _entry(model: pin.Model, name: str, path: Path) -> tuple[int, int]:
    """Return where a joint's configuration is, and how many entries it has."""
    if not model.existJointName(name):
        known = ", ".join(list(model.names)[1:])
        raise MechanismError(f"{path}: no joint named {name!r}; it has {known}")
    joint = model.joints[model.getJointId(name)]
    return joint.idx_q, joint.nq


def _apart(model: pin.Model, first: int, second: int) -> int:
    """Return how many joints lie between two bodies, given by the joints that carry them."""

    def up(joint: int) -> list[int]:
        chain = [joint]
        while chain[-1]:
            chain.append(model.parents[chain[-1]])
        return chain

    a, b = up(first), up(second)
    common = next(joint for joint in a if joint in b)
    return a.index(common) + b.index(common)
