"""Serial arms: kinematics and derivatives against Pinocchio alone, and what can be identified."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from arms import ARMS, loaded, reference
from test_closure import check_derivative

import pincal
from pincal.kinematics.closure import LegClosure

Array = np.ndarray


@pytest.mark.parametrize("name", ARMS)
def test_forward_kinematics_are_pinocchios(name: str) -> None:
    """Poses of readings equal Pinocchio's frame placements, nominal and displaced, to 1e-12."""
    mechanism, rng = loaded(name), np.random.default_rng(1)
    readings = pincal.sample_configurations(mechanism, 6, 1).readings
    leg = mechanism.legs[0]
    truth = mechanism.with_parameters({"arm": 0.02 * rng.standard_normal(len(leg.parameters))})
    for one in (mechanism, truth):
        found = pincal.forward(one, readings)
        assert found.converged.all()
        matrices = one.platform.transforms(found.poses).as_matrix()
        wanted = reference(name).poses(one.legs[0].nominal, readings)
        np.testing.assert_allclose(matrices, wanted, atol=1e-12)


@pytest.mark.parametrize("name", ARMS)
def test_derivatives_are_pinocchios(name: str) -> None:
    """Closure by parameters, joints and pose equals central differences through Pinocchio alone.

    c is the tip less the platform, and the rotation vector between them times the arm's size.
    """
    mechanism, rng = loaded(name), np.random.default_rng(2)
    leg, arm = mechanism.legs[0], reference(name)
    phi = 0.02 * rng.standard_normal(len(leg.parameters))
    closure = LegClosure(leg, mechanism.platform, phi)
    joints = pincal.sample_configurations(mechanism, 3, 2).readings
    platform = mechanism.platform.displaced(arm.poses(phi, joints), np.zeros((3, 6)))
    found = closure.evaluate(joints, platform)
    np.testing.assert_allclose(found.gap, 0.0, atol=1e-12 * max(1.0, closure.size))

    def gap(tips: Array, frames: Array) -> Array:
        turns = tips[:, :3, :3] @ frames[:, :3, :3].transpose(0, 2, 1)
        turned = closure.size * np.array([pin.log3(turn) for turn in turns])
        return np.concatenate((tips[:, :3, 3] - frames[:, :3, 3], turned), axis=1)

    def shifted(twist: Array) -> Array:
        moved = platform.copy()
        moved[:, :3, 3] += twist[:3]
        moved[:, :3, :3] = pin.exp3(twist[3:]) @ moved[:, :3, :3]
        return moved

    check_derivative(lambda v: gap(arm.poses(v, joints), platform), found.parameter, phi)
    check_derivative(
        lambda v: gap(arm.poses(phi, joints + v), platform), found.active, np.zeros(len(leg.moving))
    )
    tips = arm.poses(phi, joints)
    check_derivative(lambda v: gap(tips, shifted(v)), found.pose, np.zeros(6))
