"""Where other readers of URDF put a leg's tip: a check of the files that pincal writes."""

from __future__ import annotations

from io import BytesIO

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pincal.model.leg import Leg
from pincal.model.urdf import leg_urdf

Array = NDArray[np.float64]


def tips_by_reader(leg: Leg, joints: Array | None = None) -> dict[str, Array]:
    """Return the tip in the base frame, shape (3,), [m], by Pinocchio and by yourdfpy.

    Args:
        leg: The leg, exported as URDF.
        joints: Positions of the moving joints, shape (n_joints,); home if not given.
    """
    import yourdfpy  # slow to import, and needed here only

    joints = leg.home if joints is None else np.asarray(joints, dtype=np.float64)
    text = leg_urdf(leg)
    model = pin.buildModelFromXML(text)
    data = model.createData()
    by_name = dict(zip((j.name for j in leg.moving), joints.tolist(), strict=True))
    q = np.zeros(model.nq)
    for name, value in by_name.items():
        joint = model.joints[model.getJointId(name)]
        angle = [np.cos(value), np.sin(value)] if joint.nq == 2 else [value]
        q[joint.idx_q : joint.idx_q + joint.nq] = angle
    pin.framesForwardKinematics(model, data, q)
    frame = model.getFrameId(leg.tip, pin.FrameType.BODY)
    robot = yourdfpy.URDF.load(BytesIO(text.encode()), load_meshes=False)
    robot.update_cfg(by_name)
    return {
        "Pinocchio": np.array(data.oMf[frame].translation),
        "yourdfpy": np.array(robot.get_transform(leg.tip)[:3, 3]),
    }
