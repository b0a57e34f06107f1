"""Configurations without collisions of a robot's bodies, by the geometry in its URDF."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin

from pincal.errors import FileError, MechanismError, ObservabilityError
from pincal.files.text import check_name
from pincal.kinematics.closing import sensor_law
from pincal.kinematics.closure import LegClosure
from pincal.model import Mechanism, Plan
from pincal.model.checks import check_kinds
from pincal.types import Array, Mask

_CLOSE = 2  # joints between bodies; nearer ones touch by design


def arm_free_of_collision(mechanism: Mechanism, offered: Plan, path: str | Path) -> Plan:
    """Return the configurations, with readings, at which an arm does not collide with itself.

    Raises: see ``free_of_collision``; ObservabilityError if every configuration collides.
    """
    leg = mechanism.legs[0]
    if len(mechanism.legs) > 1 or leg.passive or offered.readings is None:
        raise MechanismError(f"{mechanism.name!r} is no serial arm; --collision is for such")
    positions = sensor_law(LegClosure(leg, mechanism.platform)).position(offered.readings)
    free = free_of_collision(path, [leg.moving[index].name for index in leg.active], positions)
    if not free.any():
        raise ObservabilityError(f"no candidate is free of collisions by {path}")
    return offered.rows(free)


def free_of_collision(path: str | Path, joints: Sequence[str], positions: Array) -> Mask:
    """Return at which positions the bodies of a robot do not collide, shape (N,).

    Bodies of neighbouring joints touch by design and are not compared, nor are bodies that collide
    with all joints at zero. ``package://`` is resolved in the folders above the URDF.

    Args:
        path: URDF with collision geometry.
        joints: Names of the joints that move; the others stay at their neutral positions.
        positions: Positions of these joints, shape (N, n), [rad] or [m].

    Raises:
        FileError: the file or one of its meshes cannot be read.
        MechanismError: a joint does not exist, or there is no collision geometry.
    """
    check_kinds(locals(), free_of_collision, MechanismError)
    model, shapes = _collision_model(Path(path).absolute())
    if unknown := [name for name in joints if not model.existJointName(name)]:
        known = ", ".join(list(model.names)[1:])
        raise MechanismError(f"{path}: no joint named {unknown[0]!r}; it has {known}")
    data, q = model.createData(), pin.neutral(model)
    shapes.addAllCollisionPairs()
    pairs = [(pair.first, pair.second) for pair in shapes.collisionPairs]
    supports = [set(model.supports[shape.parentJoint]) for shape in shapes.geometryObjects]
    touching = np.array([len(supports[a] ^ supports[b]) < _CLOSE for a, b in pairs], bool)
    collisions = shapes.createData()
    pin.computeCollisions(model, data, shapes, collisions, q, False)
    touching |= [result.isCollision() for result in collisions.collisionResults]
    shapes.removeAllCollisionPairs()
    for pair in itertools.compress(pairs, ~touching):
        shapes.addCollisionPair(pin.CollisionPair(*pair))
    collisions, indices = shapes.createData(), [model.getJointId(name) for name in joints]
    free = np.empty(len(positions), dtype=bool)
    for row, values in enumerate(np.asarray(positions, dtype=np.float64)):
        at_row = q.copy()
        for index, value in zip(indices, values, strict=True):
            begin, width = model.joints[index].idx_q, model.joints[index].nq  # continuous: cos, sin
            at_row[begin : begin + width] = value if width == 1 else (np.cos(value), np.sin(value))
        free[row] = not pin.computeCollisions(model, data, shapes, collisions, at_row, True)
    return free


def _collision_model(path: Path) -> tuple[pin.Model, pin.GeometryModel]:
    """Return the joints of a URDF, and the shapes of its bodies."""
    if not path.is_file():
        raise FileError(f"cannot read {path}: no such file")
    check_name(str(path))
    try:
        model, places = pin.buildModelFromUrdf(str(path)), [str(folder) for folder in path.parents]
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
    for shape in shapes.geometryObjects:
        if hasattr(shape.geometry, "num_tris"):  # a mesh
            check_mesh(shape.meshPath, shape.geometry.vertices(), shape.geometry.num_tris)
    return model, shapes


def check_mesh(path: str | Path, corners: Array, triangles: int) -> None:
    """Raise FileError if a mesh lacks triangles, finite corners (n, 3), or its end."""
    if not triangles or not len(corners):
        raise FileError(f"{path}: a mesh without triangles; write it anew, or take it out")
    if not np.isfinite(corners).all():
        raise FileError(f"{path}: a mesh with corners that are not finite numbers; write it anew")
    if Path(path).suffix.lower() == ".stl" and Path(path).is_file():
        data = Path(path).read_bytes()
        size = 84 + 50 * int.from_bytes(data[80:84], "little")
        text = data.lstrip().startswith(b"solid") and len(data) != size
        if b"endsolid" not in data[-200:] if text else len(data) < size:
            raise FileError(f"{path}: the end of this mesh is missing; copy or write it anew")
