"""A mechanism as one model of Pinocchio's: loops are closed where pincal says that they are."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from arms import loaded
from marks import quick

import pincal
from pincal.kinematics.configurations import joints_at

NAMES = ["6UPS", "3RPS", "3RRR", "delta", "3PRR", "5R", "8cable", "6PUS", "6RUS", "3PUU"]


def gap(model: pin.Model, constraints: list[pin.RigidConstraintModel], q: np.ndarray) -> np.ndarray:
    """Return how far frames that are to meet are apart, position and turn, by Pinocchio alone."""
    data, gaps = model.createData(), []
    pin.forwardKinematics(model, data, q)
    for closed in constraints:
        first = data.oMi[closed.joint1_id] * closed.joint1_placement
        between = first.actInv(data.oMi[closed.joint2_id] * closed.joint2_placement)
        gaps.append(between.translation)
        if closed.type == pin.ContactType.CONTACT_6D:
            gaps.append(pin.log3(between.rotation))
    return np.concatenate(gaps)


def check(mechanism: pincal.Mechanism, count: int) -> pin.Model:
    """Assert that constraints hold at configurations, and leave the platform's freedoms."""
    model, constraints = mechanism.pinocchio()
    platform, data = mechanism.platform, model.createData()
    plan = pincal.sample_configurations(mechanism, count)
    joints, transforms = joints_at(mechanism, plan).joints, platform.transforms(plan.poses)
    for row in range(count):
        moving = [joints[name][row] for name in mechanism.leg_names]
        turned = plan.poses[row, platform.lengths :]
        turned = transforms[row].rotation.as_quat() if platform.turns == 3 else turned
        q = np.concatenate([*moving, plan.poses[row, : platform.lengths], turned])
        pin.framesForwardKinematics(model, data, q)
        at = data.oMf[model.getFrameId("platform")].homogeneous
        np.testing.assert_allclose(at, transforms[row].as_matrix(), atol=1e-12)
        np.testing.assert_allclose(gap(model, constraints, q), 0.0, atol=1e-9)
    moves = 1e-6 * np.eye(model.nv)
    ends = [
        [gap(model, constraints, pin.integrate(model, q, s * v)) for v in moves] for s in (1, -1)
    ]
    rank = np.linalg.matrix_rank(np.subtract(*ends) / 2e-6, tol=1e-5)
    assert model.nv - rank == min(platform.dof, len(mechanism.reading_names))
    every = [joint for leg in mechanism.legs for joint in leg.moving]
    for joint, upper in zip(every, model.upperPositionLimit, strict=False):
        assert upper == (joint.upper if joint.limited else np.finfo(float).max)
    return model


@pytest.mark.parametrize("name", quick(4, NAMES))
def test_loops_close_at_configurations(name: str) -> None:
    """Constraints hold at poses and joints of a disturbed machine; what is left free moves it."""
    check(pincal.disturb(pincal.load_mechanism(name), 1e-3, seed=1), 4)


def test_an_arm_is_a_model_too() -> None:
    """Its tip meets the platform in a whole frame; joints are named by leg and joint."""
    arm = loaded("ur5")
    model = check(arm, 3)
    joints = arm.legs[0].moving
    assert list(model.names)[1:7] == [f"{arm.legs[0].name}.{joint.name}" for joint in joints]
