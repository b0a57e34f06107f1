"""What readers of URDF make of the files that pincal writes: Pinocchio and yourdfpy."""

from __future__ import annotations

from io import BytesIO

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pincal.files.urdf_writing import leg_urdf
from pincal.model.leg import Leg

Array = NDArray[np.float64]


def tips_by_reader(leg: Leg, joints: Array | None = None) -> dict[str, Array]:
    """Return the tip in the base frame, shape (3,), [m], by Pinocchio and by yourdfpy.

    Args:
        leg: The leg, exported as URDF.
        joints: Positions of the moving joints, shape (n_joints,); home if not given.
    """
    import yourdfpy  # slow to import, and needed here only

    joints = leg.home if joints is None else np.asarray(joints, dtype=np.float64)
    points = skeleton(leg, joints)
    robot = yourdfpy.URDF.load(BytesIO(leg_urdf(leg).encode()), load_meshes=False)
    robot.update_cfg({j.name: float(v) for j, v in zip(leg.moving, joints, strict=True)})
    return {
        "Pinocchio": points[-1],
        "yourdfpy": np.array(robot.get_transform(leg.tip)[:3, 3]),
    }


def skeleton(leg: Leg, joints: Array) -> Array:
    """Return the positions of a leg's moving joints and its tip, shape (n_joints + 1, 3), [m].

    Args:
        leg: The leg, exported as URDF and read by Pinocchio.
        joints: Positions of the moving joints, shape (n_joints,), [rad] or [m].
    """
    model, data, q = _configured(leg, joints)
    pin.framesForwardKinematics(model, data, q)
    frame = model.getFrameId(leg.tip, pin.FrameType.BODY)
    points = [data.oMi[model.getJointId(joint.name)].translation for joint in leg.moving]
    return np.array([*points, data.oMf[frame].translation])


def _configured(leg: Leg, joints: Array) -> tuple[pin.Model, pin.Data, Array]:
    """Return Pinocchio's model of a leg's URDF, its data, and the configuration of joints."""
    model = pin.buildModelFromXML(leg_urdf(leg))
    q = np.zeros(model.nq)
    for joint, value in zip(leg.moving, joints, strict=True):
        entry = model.joints[model.getJointId(joint.name)]
        # a continuous joint's configuration is (cos, sin)
        q[entry.idx_q : entry.idx_q + entry.nq] = (
            [np.cos(value), np.sin(value)] if entry.nq == 2 else [value]
        )
    return model, model.createData(), q
