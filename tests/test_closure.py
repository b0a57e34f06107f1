"""Loop closure and its derivatives, for planar and spatial chains of any kind."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from closed_forms import poses_near_home
from differences import assert_derivative
from numpy.typing import NDArray

import pincal
from pincal.kinematics.batches import left_null, product, solve
from pincal.kinematics.closing import close, sensor_law
from pincal.kinematics.closure import LegClosure
from pincal.kinematics.derivatives import demands, nearest_closure
from pincal.kinematics.forest import Elementary, Forest, placements_in

Array = NDArray[np.float64]


@pytest.mark.parametrize("name", ["5R", "3RRR", "3PRR", "6UPS", "3RPS", "delta"])
def test_passive_joints_come_nearest_out_of_reach(name: str) -> None:
    """Poses and readings half a machine apart: |c| is stationary, and no start finds a nearer one.

    Gauss-Newton steps overshoot there (of the delta 44 in 100 end nowhere).
    """
    mechanism, rng = pincal.load_mechanism(name), np.random.default_rng(0)
    leg, platform = mechanism.legs[0], mechanism.platform
    home = np.tile(platform.home, (60, 1))
    poses = platform.moved(home, 0.5 * rng.standard_normal(home.shape))
    at_home = pincal.inverse(mechanism, [platform.home]).readings[:1, : len(leg.sensors)]
    readings = at_home + 0.5 * rng.standard_normal((60, len(leg.sensors)))
    matrices, closure = platform.transforms(poses).as_matrix(), LegClosure(leg, platform)
    found, joints = nearest_closure((closure,), matrices, readings)
    gaps = np.linalg.norm(found.gap, axis=1)
    assert gaps.max() > 0.2 * leg.size
    slopes = np.einsum("nmp,nm->np", found.passive, found.gap)
    np.testing.assert_allclose(slopes, 0.0, atol=1e-7 * leg.size**2)
    for _ in range(20):
        other = joints.copy()
        other[:, leg.passive] = rng.uniform(-np.pi, np.pi, other[:, leg.passive].shape)
        again, _ = nearest_closure((closure,), matrices, readings, other)
        nearer = np.linalg.norm(again.gap, axis=1) < gaps - 1e-6 * leg.size
        assert nearer.mean() <= 0.05, name


@pytest.mark.parametrize("angle", [0.03, 0.01, 0.003])
def test_passive_joints_come_nearest_beside_a_gimbal_lock(angle: float) -> None:
    """A strut's end misses a point by millimetres: |c| is | |AB| - L |, and no joint turns wildly.

    The universal joint's second axis is an angle from where its first one turns nothing.
    """
    mechanism, rng = pincal.load_mechanism("6UPS"), np.random.default_rng(0)
    leg, closure = mechanism.legs[0], LegClosure(mechanism.legs[0], mechanism.platform)
    joints = np.tile(leg.home, (500, 1))
    joints[:, 0] = rng.uniform(-2.0, 2.0, 500)
    joints[:, 1] = np.pi / 2 - angle
    frames = leg.link_placements(joints)
    A, tip = frames[:, 0, :3, 3], frames[:, -1, :3, 3]
    B = tip + rng.normal(0.0, 3e-3 * leg.size, tip.shape)
    matrices = np.tile(np.eye(4), (500, 1, 1))
    matrices[:, :3, 3] = B - np.array(leg.point.placement.xyz)
    readings = pincal.inverse(mechanism, [mechanism.platform.home]).readings[:, :1].repeat(500, 0)
    nearest, ends = nearest_closure((closure,), matrices, readings, joints)
    miss = np.abs(np.linalg.norm(B - A, axis=1) - np.linalg.norm(tip - A, axis=1))
    np.testing.assert_allclose(np.linalg.norm(nearest.gap, axis=1), miss, atol=1e-9 * leg.size)
    assert np.abs(ends - joints).max() < 2 * np.pi


@pytest.mark.parametrize("leg_index", [0, 1])
def test_closure_derivatives(mechanism: pincal.Mechanism, leg_index: int) -> None:
    """Every derivative of the closure equals central differences: parameters, joints, pose."""
    rng = np.random.default_rng(leg_index)
    leg, platform = mechanism.legs[leg_index], mechanism.platform
    phi = leg.nominal + 0.01 * rng.standard_normal(len(leg.nominal))
    poses = poses_near_home(mechanism, rng, 20)
    matrices = platform.transforms(poses).as_matrix()
    joints = leg.home + rng.uniform(-0.5, 0.5, (20, 2))
    closure = LegClosure(leg, platform, phi).evaluate(joints, matrices)

    def by_parameters(values: Array) -> Array:
        return LegClosure(leg, platform, phi + values).evaluate(joints, matrices).gap

    def by_joints(values: Array) -> Array:
        return LegClosure(leg, platform, phi).evaluate(joints + values, matrices).gap

    def by_pose(values: Array) -> Array:
        moved = platform.transforms(poses + values).as_matrix()
        return LegClosure(leg, platform, phi).evaluate(joints, moved).gap

    assert_derivative(closure.parameter, by_parameters)
    both = np.concatenate((closure.active, closure.passive), axis=2)
    assert_derivative(both, by_joints)
    assert_derivative(closure.pose, by_pose)


def test_demand_derivatives(mechanism: pincal.Mechanism) -> None:
    """The rows of a closed leg are derivatives of the projected closure, passive joints free."""
    rng = np.random.default_rng(2)
    platform = mechanism.platform
    poses = poses_near_home(mechanism, rng, 30) * 0.3 + 0.7 * np.array(platform.home)
    for index, leg in enumerate(mechanism.legs):
        closure = LegClosure(leg, platform)
        closed = close((closure,), platform.transforms(poses).as_matrix())
        psi = sensor_law(closure).reading(closed.joints[:, leg.active])
        (rows,) = demands((closure,), psi, closed.closure, closed.joints)
        np.testing.assert_allclose(rows.value, 0.0, atol=1e-14)
        by_pose = (
            -rows.pose[:, 0] / rows.reading[:, 0]
        )  # of the reading, by implicit differentiation

        def reading(values: Array, index: int = index) -> Array:
            return pincal.inverse(mechanism, poses + values).readings[:, index]

        assert_derivative(by_pose, reading, precision=1e-12)


def _random_chain(rng: np.random.Generator, length: int) -> list[Elementary]:
    kinds = ["x", "y", "z", "rx", "ry", "rz", "r", "t"]
    chain = []
    for kind in rng.choice(kinds, length):
        axis = rng.standard_normal(3)
        x, y, z = axis / np.linalg.norm(axis)
        placement = tuple(pin.SE3.Random().homogeneous.ravel().tolist())
        chain.append(Elementary(str(kind), placement, (x, y, z)))
    return chain


@pytest.mark.parametrize("count", [1, 5, 64, 100])
def test_forest_equals_one_chain_at_a_time(count: int) -> None:
    """Tips and tip velocities of a forest equal Pinocchio's on one copy, in space."""
    pin.seed(1)
    rng = np.random.default_rng(count)
    chain = _random_chain(rng, 7)
    end = pin.SE3.Random()
    tree = Forest(tuple(chain), tuple(end.homogeneous.ravel().tolist()))
    q = rng.uniform(-2, 2, (count, 7))
    motion = tree.motion(q[None], np.eye(7))
    tips, columns = motion.tips.T, motion.twists().transpose(0, 2, 1)

    model, parent = pin.Model(), 0
    for element in chain:
        parent = element.added_to(model, parent)
    frame = model.addFrame(pin.Frame("tip", parent, end, pin.FrameType.OP_FRAME))
    data = model.createData()
    for n in range(count):
        J = pin.computeFrameJacobian(model, data, q[n], frame, pin.LOCAL_WORLD_ALIGNED)
        pin.updateFramePlacement(model, data, frame)
        np.testing.assert_allclose(tips[n], data.oMf[frame].translation, atol=1e-12)
        np.testing.assert_allclose(columns[:, n], J, atol=1e-12)


@pytest.mark.parametrize("size", [1, 2, 7, 40])
def test_placements_of_joints_lie_one_after_the_other(size: int) -> None:
    """Read where they lie in Pinocchio's memory they are those that it gives one by one.

    A Pinocchio that keeps them in another way fails here: forests cannot be used with it.
    """
    model, parent = pin.Model(), 0
    for element in _random_chain(np.random.default_rng(size), size):
        parent = element.added_to(model, parent)
    data = model.createData()
    lie = placements_in(data.oMi)
    for _ in range(3):
        pin.computeJointJacobians(model, data, np.random.default_rng(0).standard_normal(size))
        for own, one in zip(lie, data.oMi, strict=True):
            np.testing.assert_array_equal(own, [*one.rotation.T.ravel(), *one.translation])
    placement = pin.SE3.Random()
    placements_in(model.jointPlacements)[size] = (
        *placement.rotation.T.ravel(),
        *placement.translation,
    )
    assert model.jointPlacements[size] == placement  # what is written there is Pinocchio's


@pytest.mark.parametrize(("m", "p"), [(2, 0), (2, 1), (3, 1), (3, 2), (6, 4), (6, 5)])
def test_left_null_space(m: int, p: int) -> None:
    """N is orthonormal and across every column."""
    A = np.random.default_rng(m).standard_normal((9, m, p))
    N = left_null(A)
    assert N.shape == (9, m, m - p)
    np.testing.assert_allclose(N.transpose(0, 2, 1) @ A, 0.0, atol=1e-14)
    identity = np.broadcast_to(np.eye(m - p), (9, m - p, m - p))
    np.testing.assert_allclose(N.transpose(0, 2, 1) @ N, identity, atol=1e-14)


@pytest.mark.parametrize("k", [0, 1, 2, 3, 5])
def test_small_linear_algebra(k: int) -> None:
    """Batched product and solve equal NumPy's; a singular matrix gives no finite answer."""
    rng = np.random.default_rng(k)
    A, B = rng.standard_normal((8, k, k)), rng.standard_normal((8, k, 2))
    np.testing.assert_allclose(product(A, B), A @ B, atol=1e-14)
    np.testing.assert_allclose(solve(A, B), np.linalg.solve(A, B), atol=1e-10)
    if k:
        A[3] = 0.0
        assert not np.isfinite(solve(A, B)[3]).any()
        A[1] = np.nan  # nor one that is not finite, and no warning
        assert np.flatnonzero(~np.isfinite(solve(A, B)).all(axis=(1, 2))).tolist() == [1, 3]


@pytest.mark.parametrize("keep", [(), ("A_x",), ("A_x", "A_y")])
def test_parameters_that_stand_still_may_be_any_number(keep: tuple[str, ...]) -> None:
    """None, one or two before the first moving joint: derivatives are those of differences."""
    whole = pincal.load_mechanism("5R")
    legs = []
    for leg in whole.legs:
        shoulder = leg.joints[0]
        coordinates = tuple(
            one
            if one.values[0] in keep
            else replace(one, values=(leg.nominal_by_name[one.values[0]],))
            for one in shoulder.placement.coordinates
        )
        placement = replace(shoulder.placement, coordinates=coordinates)
        parameters = tuple(p for p in leg.parameters if p[0] not in {"A_x", "A_y"} - set(keep))
        joints = (replace(shoulder, placement=placement), *leg.joints[1:])
        legs.append(replace(leg, joints=joints, parameters=parameters))
    machine = replace(whole, legs=tuple(legs))
    poses = np.array([[0.1, 1.0], [-0.2, 1.2]])
    np.testing.assert_allclose(
        pincal.inverse(machine, poses).readings, pincal.inverse(whole, poses).readings, atol=1e-12
    )
    names = list(machine.legs[0].parameter_names)
    all_names = list(whole.legs[0].parameter_names)
    own = pincal.identification_jacobian(machine, "leg_1", poses)
    expected = pincal.identification_jacobian(whole, "leg_1", poses)
    np.testing.assert_allclose(
        own, expected[..., [all_names.index(name) for name in names]], atol=1e-12
    )


def test_threads_do_not_mix() -> None:
    """Legs of one structure share a forest: three threads get what one gets."""
    machines = [pincal.disturb(pincal.load_mechanism("3RRR"), 1e-3, seed) for seed in range(3)]
    poses = pincal.sample_workspace("3RRR", 200, 0)
    expected = [pincal.inverse(one, poses).readings for one in machines]

    def again(which: int) -> bool:
        found = [pincal.inverse(machines[which], poses).readings for _ in range(20)]
        return all(np.array_equal(one, expected[which]) for one in found)

    with ThreadPoolExecutor(3) as pool:
        assert all(pool.map(again, range(3)))
