"""Cables over pulleys that swivel: kinematics, derivatives, files and calibration against a form.

The form is plain geometry in the plane of the pulley: the angle of the tangent from where the
target is seen, arc and free length. Nothing of it is pincal's.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import done
from differences import assert_derivative, differentiated
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import pincal

Array = NDArray[np.float64]
RADIUS = 0.03
NOISE = pincal.Noise(1e-4, 1e-4, 1e-4)


def cable_length(point: Array, anchor: Array, radius: float, axis: Array) -> Array:
    """Return arc and free length to points (N, 3) of a cable that comes to its pulley along axis.

    The middle of the pulley is beside the anchor, towards the point.
    """
    arm = point - anchor
    up = arm @ axis
    out = np.linalg.norm(arm - np.multiply.outer(up, axis), axis=1) - radius
    far = np.hypot(out, up)
    seen = np.arctan2(up, out)  # of the point, from the middle, above the level
    tangent = np.pi - seen - np.arccos(radius / far)  # from the anchor round to where it leaves
    return np.sqrt(far**2 - radius**2) + radius * tangent


def readings(
    leg: pincal.Leg, parameters: Array, matrices: Array, home: Array, axis: Array
) -> Array:
    """Return k (L − L at home) at poses, shape (N,), of parameters in the leg's order."""
    p = dict(zip(leg.parameter_names, parameters.tolist(), strict=True))
    A, b = (np.array([p[f"{letter}_{i}"] for i in "xyz"]) for letter in "Ab")
    poses = np.concatenate((home, matrices))
    length = cable_length(poses[:, :3, 3] + poses[:, :3, :3] @ b, A, p["r"], axis)
    return p["k"] * (length[1:] - length[0])


def near_home(mechanism: pincal.Mechanism, count: int, seed: int = 0, far: float = 0.3) -> Array:
    """Return random poses, shape (N, 6), so far from home along each axis at most, [m]."""
    rng = np.random.default_rng(seed)
    poses = np.tile(mechanism.platform.home, (count, 1))
    poses[:, :3] += rng.uniform(-far, far, (count, 3))
    poses[:, 3:] = rng.uniform((-3.0, 0.0, -0.1), (3.0, 0.2, 0.1), (count, 3))
    return poses


@pytest.fixture(scope="module")
def box() -> pincal.Mechanism:
    """An eight-cable box with pulleys."""
    return pincal.new_mechanism("cable-8", pulley_radius=RADIUS)


def over_pulleys(axis: Array) -> pincal.Mechanism:
    """Return the bundled robot with pulleys that swivel about an axis."""
    robot = pincal.load_mechanism("8cable")
    legs = tuple(pincal.over_pulley(leg, RADIUS, axis=tuple(axis.tolist())) for leg in robot.legs)
    return replace(robot, legs=legs)


@pytest.mark.parametrize("axis", [(0.0, 0.0, 1.0), (0.48, -0.36, 0.8)])
def test_readings_and_derivatives_are_those_of_the_form(axis: tuple[float, ...]) -> None:
    """Readings within 1e-12 m, every derivative within central differences' error."""
    robot, along = over_pulleys(np.array(axis)), np.array(axis)
    poses = near_home(robot, 30)
    matrices = robot.platform.matrices(poses)
    home = robot.platform.home_pose.as_matrix()
    solution = pincal.inverse(robot, poses)
    for i, leg in enumerate(robot.legs):
        expected = readings(leg, leg.nominal, matrices, home, along)
        np.testing.assert_allclose(solution.readings[:, i], expected, rtol=0.0, atol=1e-12)
    C = pincal.identification_jacobian(robot, leg.name, poses)
    assert_derivative(C, lambda h: readings(leg, leg.nominal + h, matrices, home, along))
    found = pincal.forward(robot, solution.readings, poses + 1e-3)
    assert found.converged.all()
    assert np.abs(robot.platform.matrices(found.poses) - matrices).max() < 1e-9


def test_cables_that_hang_beside_their_pulleys_stay_on_their_side(box: pincal.Mechanism) -> None:
    """Exact readings are explained within 1e-9 m: no leg is sought beyond its singularity."""
    leg, rng = box.legs[0], np.random.default_rng(0)
    A, b = (np.array([leg.nominal_by_name[f"{name}_{i}"] for i in "xyz"]) for name in "Ab")
    inward = np.arctan2(-A[1], -A[0]) + rng.uniform(-1.2, 1.2, 60)
    beside = rng.uniform(2.5, 6.0, 60) * RADIUS
    down = rng.uniform(0.8, 2.0, 60)
    points = A + np.column_stack((beside * np.cos(inward), beside * np.sin(inward), -down))
    poses = np.vstack((near_home(box, 40), np.column_stack((points - b, np.zeros((60, 3))))))
    readings = pincal.inverse(box, poses).readings
    assert np.isfinite(readings).all()
    noise = pincal.Noise(1e-5, 1e-5, 1e-5)
    result = pincal.calibrate(box, pincal.Measurements(poses, readings=readings), noise=noise)
    assert max(leg.rms_after for leg in result.legs) < 1e-9


def test_pulleys_are_saved_and_carried(box: pincal.Mechanism, tmp_path: Path) -> None:
    """The folder gives the same legs back; a pulley carried by a mirror reads as the form says."""
    assert pincal.load_mechanism(box.save(tmp_path / "box")).legs == box.legs
    text = (tmp_path / "box" / "cable_1.urdf").read_text()
    assert '<mimic joint="swivel_y" multiplier="0.03" offset="0.0"/>' in text
    mirror = (pincal.Element(0.0), pincal.Element.mirror(0.3))
    made = pincal.generate("two", box.legs[0], mirror, box.platform)
    poses = near_home(made, 20)
    matrices, home = made.platform.matrices(poses), made.platform.home_pose.as_matrix()
    expected = [readings(x, x.nominal, matrices, home, np.eye(3)[2]) for x in made.legs]
    np.testing.assert_allclose(pincal.inverse(made, poses).readings, np.transpose(expected))
    group = pincal.symmetry_group(made)
    assert [str(element) for element in group.elements] == ["identity", f"{mirror[1]}"]


def test_unusual_cables_have_no_pulley() -> None:
    """A leg with a drive that is no cable is refused by name."""
    with pytest.raises(pincal.MechanismError, match=r"leg_1 cannot run over a pulley"):
        pincal.over_pulley(pincal.load_mechanism("delta").legs[0], RADIUS)


def bound(truth: pincal.Mechanism, poses: Array) -> Array:
    """Return the Cramér–Rao bound of all parameters' standard errors, (n,), by differences."""
    matrices, home = truth.platform.matrices(poses), truth.platform.home_pose.as_matrix()
    up, blocks = np.eye(3)[2], []
    for leg in truth.legs:
        by_parameter = differentiated(
            lambda h, leg=leg: readings(leg, leg.nominal + h, matrices, home, up),
            len(leg.parameters),
        )

        def moved(twist: Array, leg: pincal.Leg = leg) -> Array:
            T = matrices.copy()
            T[:, :3, 3] += twist[:3]
            T[:, :3, :3] = Rotation.from_rotvec(twist[3:]).as_matrix() @ T[:, :3, :3]
            return readings(leg, leg.nominal, T, home, up)

        blocks.append((by_parameter, differentiated(moved, 6)))
    sizes = [by_parameter.shape[1] for by_parameter, _ in blocks]
    J, X = np.zeros((len(poses), len(blocks), sum(sizes))), np.stack([x for _, x in blocks], axis=1)
    for i, (by_parameter, _) in enumerate(blocks):
        J[:, i, sum(sizes[:i]) : sum(sizes[: i + 1])] = by_parameter
    W = NOISE.reading**2 * np.eye(len(blocks)) + NOISE.position**2 * X @ X.transpose(0, 2, 1)
    fisher = (J.transpose(0, 2, 1) @ np.linalg.solve(W, J)).sum(axis=0)
    return np.sqrt(np.diag(np.linalg.inv(fisher)))


@pytest.mark.slow
def test_recovery_reaches_the_bound(box: pincal.Mechanism) -> None:
    """Standard errors are the Cramér–Rao bound within 5 %, and errors agree with them."""
    truth = pincal.disturb(box, 0.003, seed=1)
    poses = near_home(box, 40, seed=2)
    limits = bound(truth, poses)
    scaled = []
    for seed in range(5):
        data = pincal.simulate(box, truth, pincal.Plan(poses), NOISE, seed=seed).measurements
        result = pincal.calibrate(box, data, noise=NOISE)
        found = np.concatenate([leg.nominal for leg in result.identified.legs])
        true = np.concatenate([leg.nominal for leg in truth.legs])
        errors = np.concatenate([leg.std for leg in result.legs])
        np.testing.assert_allclose(errors, limits, rtol=0.05)
        scaled.append((found - true) / limits)
    assert 0.9 < np.sqrt(np.mean(np.square(scaled))) < 1.1


@pytest.mark.slow
def test_pulleys_that_the_model_lacks_are_named(tmp_path: Path) -> None:
    """Data of pulleys, a model without: 'explain' names them, the term has them within 4 sigma."""
    plain = pincal.new_mechanism("cable-8")
    truth = pincal.new_mechanism("cable-8", pulley_radius=RADIUS)
    plan = pincal.Plan(near_home(plain, 60, far=0.9))
    data = pincal.simulate(truth, truth, plan, NOISE).measurements
    data.to_csv(tmp_path / "data.csv", plain)
    plain.save(tmp_path / "plain")
    noise = (
        "--noise-position",
        "0.1mm",
        "--noise-orientation",
        "0.1mrad",
        "--noise-reading",
        "0.1mm",
    )
    files = (tmp_path / "plain", tmp_path / "data.csv", *noise)
    said = done("explain", *files, "--folds", 2).out
    assert "each reading follows pulley: the cable runs over a pulley" in said
    assert "--terms pulley" in said
    found = pincal.calibrate(plain, data, noise=NOISE, terms=("pulley",)).identified
    radii = [leg.nominal_by_name["r"] for leg in found.legs]
    names = [name for leg in truth.legs for name in leg.parameter_names]
    limits = bound(truth, plan.poses)[[place for place, name in enumerate(names) if name == "r"]]
    assert limits.max() < 4e-3
    assert (np.abs(np.array(radii) - RADIUS) < 4.0 * limits).all()
