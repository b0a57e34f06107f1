"""The 6-UPS hexapod: spatial poses, closed forms, the paper's figures, and the main job."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from differences import assert_derivative
from measured import workspace
from moved import equivariance
from scipy.spatial.transform import Rotation

import pincal
from pincal.estimation.observability.identifiable import r_diagonal
from pincal.kinematics import closing
from pincal.model.platform import WAYS, columns_of, rotation_of

EXACT = pincal.Noise(0.0, 0.0, 0.0)
#: Poses of Eqs. 35, 37 and 40: x, y, z [m], azimuth, tilt, torsion [rad].
POSES = np.array(
    [
        [0.5, 0.6, 1.9, 0.2, 0.3, 0.4],
        [-0.7696, 0.1330, 1.9, 2.2944, 0.3, 0.4],
        [0.2696, -0.7330, 1.9, 4.3888, 0.3, 0.4],
        [0.5, -0.6, 1.9, -0.2, 0.3, -0.4],
    ]
)
#: Leg lengths of Eqs. 36, 38 and 40 [m].
LENGTHS = np.array(
    [
        [2.0096, 2.0358, 2.0740, 2.1695, 2.1457, 1.9637],
        [2.1457, 1.9637, 2.0096, 2.0358, 2.0740, 2.1695],
        [2.0740, 2.1695, 2.1457, 1.9637, 2.0096, 2.0358],
        [1.9637, 2.1457, 2.1695, 2.0740, 2.0358, 2.0096],
    ]
)


@pytest.fixture(scope="module")
def hexapod() -> pincal.Mechanism:
    return pincal.load_mechanism("6UPS")


@pytest.fixture(scope="module")
def poses(hexapod: pincal.Mechanism) -> np.ndarray:
    return workspace("6UPS", 4000)


@pytest.fixture(scope="module")
def selection(hexapod: pincal.Mechanism, poses: np.ndarray) -> pincal.Selection:
    return pincal.select_poses(hexapod, poses, 24)


def lengths(mechanism: pincal.Mechanism, poses: np.ndarray) -> np.ndarray:
    """Return ‖r + R b − A‖ of each leg from its parameters, shape (N, n_legs)."""
    azimuth, tilt, torsion = poses[:, 3:].T[:, :, None]
    R = (
        Rotation.from_euler("z", azimuth)
        * Rotation.from_euler("y", tilt)
        * Rotation.from_euler("z", torsion - azimuth)
    ).as_matrix()

    def point(radius: float, polar: float, azimuth: float) -> np.ndarray:
        across = np.sin(polar)
        return radius * np.array(
            [across * np.cos(azimuth), across * np.sin(azimuth), np.cos(polar)]
        )

    columns = []
    for leg in mechanism.legs:
        p = leg.nominal_by_name
        A = point(p["OA"], p["alpha"], p["beta"])
        b = point(p["ob"], p["alpha_b"], p["beta_b"])
        columns.append(np.linalg.norm(poses[:, :3] + R @ b - A, axis=1))
    return np.stack(columns, axis=1)


def test_figures_of_the_paper(hexapod: pincal.Mechanism) -> None:
    """Orientation of Eq. 35 and leg lengths of Eqs. 36 to 41, to the printed digits."""
    R = hexapod.platform.transforms(POSES[:1]).as_matrix()[0, :3, :3]
    printed = [
        [0.87816, -0.380722, 0.289629],
        [0.380722, 0.922824, 0.0587108],
        [-0.289629, 0.0587108, 0.955336],
    ]
    np.testing.assert_allclose(R, printed, atol=6e-7)
    np.testing.assert_allclose(pincal.inverse(hexapod, POSES).readings, LENGTHS, atol=1e-4)


def test_tilted_matrices_are_turns_about_axes() -> None:
    """Rz(azimuth) Ry(tilt) Rz(torsion − azimuth), by SciPy's Euler angles, as rotations are."""
    azimuth, tilt, torsion = angles = np.random.default_rng(1).uniform(-4.0, 4.0, (3, 500))
    by_euler = Rotation.from_euler("ZYZ", np.stack((azimuth, tilt, torsion - azimuth), axis=1))
    found = rotation_of("tilt-torsion", angles.T).as_matrix()
    np.testing.assert_allclose(found, by_euler.as_matrix(), rtol=0.0, atol=3e-15)


@pytest.mark.parametrize("kind", ["planar", "translational", "spatial"])
def test_matrices_of_transforms_are_those_of_coordinates(kind: str) -> None:
    """Transforms pass as they are; memory runs along the poses; a single one is refused."""
    dof = {"planar": 3, "translational": 3, "spatial": 6}[kind]
    platform = pincal.Platform(kind, (0.0,) * dof)
    poses = np.random.default_rng(2).uniform(-1.0, 1.0, (20, dof))
    matrices, transforms = platform.matrices(poses), platform.transforms(poses)
    np.testing.assert_array_equal(platform.matrices(transforms), matrices)
    assert platform.matrices(transforms).strides == matrices.strides
    with pytest.raises(pincal.MechanismError, match="got a single one"):
        platform.matrices(transforms[0])


@pytest.mark.parametrize("kind", ["spatial", "translational"])
def test_coordinates_convert_to_and_fro(kind: str) -> None:
    """Transforms and back give the coordinates, and moving by a twist is undone by its opposite."""
    rng = np.random.default_rng(0)
    dof = {"spatial": 6, "translational": 3}[kind]
    platform = pincal.Platform(kind, (0.0,) * dof)
    coordinates = rng.uniform([-1, -1, -1, -3, 0.1, -3][:dof], [1, 1, 1, 3, 3, 3][:dof], (200, dof))
    back = platform.coordinates_of(platform.transforms(coordinates))
    np.testing.assert_allclose(back, coordinates, atol=1e-13)
    twists = 0.1 * rng.standard_normal((200, dof))
    moved = platform.moved(coordinates, twists)
    np.testing.assert_allclose(platform.twists_between(coordinates, moved), twists, atol=1e-13)


def test_upright_platform_has_no_azimuth() -> None:
    """At tilt 0 the azimuth is 0 and the torsion is the whole turn."""
    platform = pincal.Platform("spatial", (0.0,) * 6)
    given = np.array([[0, 0, 0, 1.1, 0.0, 0.4], [0, 0, 0, 0.0, 0.0, -3.0]])
    found = platform.coordinates_of(platform.transforms(given))
    np.testing.assert_allclose(found, [[0, 0, 0, 0, 0, 0.4], [0, 0, 0, 0, 0, -3.0]], atol=1e-13)


@pytest.mark.parametrize("way", list(WAYS))
def test_orientations_are_read_in_every_way(
    hexapod: pincal.Mechanism, poses: np.ndarray, way: str, tmp_path: Path
) -> None:
    """Poses written as tilt and torsion, rotation vector, quaternion or Z-Y-X angles read alike."""
    path = tmp_path / "poses.csv"
    pincal.Plan(poses).to_csv(path, hexapod, orientation=way)
    header = path.read_text().splitlines()[0]
    assert all(name in header for name in WAYS[way][0])
    read = pincal.Plan.from_csv(path, hexapod).poses
    assert np.abs(hexapod.platform.twists_between(poses, read)).max() < 1e-12
    rotation = hexapod.platform.transforms(poses).rotation
    again = rotation_of(way, columns_of(way, rotation))
    assert (rotation * again.inv()).magnitude().max() < 1e-12


def test_ways_of_orientation_are_what_they_say() -> None:
    """A quarter turn about z, and Z-Y-X angles against elementary rotations."""
    quarter = Rotation.from_euler("z", [[90]], degrees=True)
    assert columns_of("rotation-vector", quarter)[0] == pytest.approx([0, 0, np.pi / 2])
    assert columns_of("quaternion", quarter)[0] == pytest.approx([0.5**0.5, 0, 0, 0.5**0.5])
    assert columns_of("zyx", quarter)[0] == pytest.approx([np.pi / 2, 0, 0])
    yaw, pitch, roll = 0.3, -0.4, 0.5
    z, y, x = (Rotation.from_euler(a, v) for a, v in (("z", yaw), ("y", pitch), ("x", roll)))
    R = rotation_of("zyx", np.array([[yaw, pitch, roll]])).as_matrix()[0]
    np.testing.assert_allclose(R, (z * y * x).as_matrix(), atol=1e-15)
    gimbal = rotation_of("zyx", np.array([[0.3, np.pi / 2, 0.0]]))
    assert columns_of("zyx", gimbal)[0] == pytest.approx([0.3, np.pi / 2, 0.0])


def test_quaternion_of_wrong_length_is_refused(hexapod: pincal.Mechanism, tmp_path: Path) -> None:
    """A quaternion that is no rotation raises with file and row."""
    path = tmp_path / "poses.csv"
    path.write_text("x [m],y [m],z [m],qw [1],qx [1],qy [1],qz [1]\n0,0,1.8,1,1,0,0\n")
    with pytest.raises(pincal.MeasurementError, match=r"poses\.csv: row 1: the quaternion"):
        pincal.Plan.from_csv(path, hexapod)


def test_angles_for_a_rotation_vector_are_refused(
    hexapod: pincal.Mechanism, tmp_path: Path
) -> None:
    """No rotation vector is longer than half a turn; roll, pitch and yaw often are."""
    path = tmp_path / "poses.csv"
    path.write_text("x [m],y [m],z [m],rx [deg],ry [deg],rz [deg]\n0,0,1.8,20,-70,170\n")
    with pytest.raises(pincal.MeasurementError, match=r"row 1: the rotation vector's .*roll"):
        pincal.Plan.from_csv(path, hexapod)
    path.write_text("x [m],y [m],z [m],rx [deg],ry [deg],rz [deg]\n0,0,1.8,0,0,180.0001\n")
    assert len(pincal.Plan.from_csv(path, hexapod).poses) == 1


def random_hexapod(hexapod: pincal.Mechanism, rng: np.random.Generator) -> pincal.Mechanism:
    """Return a hexapod with other numbers in every leg."""
    values = {}
    for leg in hexapod.legs:
        p = {name: v + rng.uniform(-0.1, 0.1) for name, v in leg.nominal_by_name.items()}
        values[leg.name] = p
    return hexapod.with_parameters(values)


def test_inverse_kinematics_equals_the_distance(
    hexapod: pincal.Mechanism, poses: np.ndarray
) -> None:
    """Leg lengths are ‖r + R b − A‖ to 1e-12 on 20 random geometries, gains and offsets too."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        mechanism = random_hexapod(hexapod, rng)
        solution = pincal.inverse(mechanism, poses[:100])
        assert solution.reached.all()
        for index, leg in enumerate(mechanism.legs):
            p = leg.nominal_by_name
            length = p["k"] * solution.readings[:, index] + p["gamma"]
            np.testing.assert_allclose(length, solution.joints[leg.name][:, 2], atol=1e-12)
        joints = np.stack([solution.joints[leg.name][:, 2] for leg in mechanism.legs], axis=1)
        assert np.abs(joints - lengths(mechanism, poses[:100])).max() < 1e-12


@pytest.mark.slow
def test_identification_jacobian_equals_central_differences(
    hexapod: pincal.Mechanism, poses: np.ndarray
) -> None:
    """Within 1e-7 of central differences of the distance, relative, on 20 random geometries."""
    rng = np.random.default_rng(2)
    for _ in range(20):
        mechanism = random_hexapod(hexapod, rng)
        for leg in mechanism.legs:
            C = pincal.identification_jacobian(mechanism, leg.name, poses[:50])

            def read(
                h: np.ndarray, leg: pincal.Leg = leg, mechanism: pincal.Mechanism = mechanism
            ) -> np.ndarray:
                values = dict(zip(leg.parameter_names, leg.nominal + h, strict=True))
                moved = leg.with_parameters(values)
                p = moved.nominal_by_name
                one = replace(mechanism, legs=(moved,))
                return (lengths(one, poses[:50])[:, 0] - p["gamma"]) / p["k"]

            assert_derivative(C, read, precision=1e-13)


def test_sampled_starts_find_the_same_joints(
    hexapod: pincal.Mechanism, poses: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without the closed form, Newton's method from sampled tips gives the same leg lengths."""
    expected = pincal.inverse(hexapod, poses[:200])
    monkeypatch.setattr(closing, "closed_form", lambda _: None)
    found = pincal.inverse(hexapod, poses[:200])
    assert found.reached.all()
    np.testing.assert_allclose(found.readings, expected.readings, atol=1e-12)


def test_forward_undoes_inverse(hexapod: pincal.Mechanism, poses: np.ndarray) -> None:
    """From a guess 2 cm and 0.02 rad off, poses come back within 1e-10."""
    rng = np.random.default_rng(3)
    guess = hexapod.platform.moved(poses, rng.uniform(-0.02, 0.02, poses.shape))
    solution = pincal.forward(hexapod, pincal.inverse(hexapod, poses).readings, guess)
    assert solution.converged.all()
    assert np.abs(hexapod.platform.twists_between(poses, solution.poses)).max() < 1e-10


def test_the_group_of_the_hexapod_is_d6(hexapod: pincal.Mechanism, poses: np.ndarray) -> None:
    """Three rotations and three mirrors, every leg reached from leg 1, readings equivariant."""
    group = pincal.symmetry_group(hexapod)
    assert sorted(str(e) for e in group.elements) == sorted(
        ["identity", "rotation by 120°", "rotation by 240°"]
        + [f"mirror at azimuth {a}°" for a in (0, 60, 120)]
    )
    assert len(group.carriers()) == 6
    assert equivariance(group, poses[:500]) < 1e-12
    longer = hexapod.with_parameters({"leg_2": {"OA": 0.401}})
    assert len(pincal.symmetry_group(longer).elements) == 1  # no mirror leaves a leg in place


def test_mapped_poses_are_symmetrically_observable(
    hexapod: pincal.Mechanism, selection: pincal.Selection
) -> None:
    """|R_ii| of all six legs at mapped poses are equal to 1e-9; the choice is near the bound."""
    plan = selection.plan
    assert len(plan.poses) == 144
    assert selection.efficiency >= 0.955
    diagonals = [
        r_diagonal(pincal.identification_jacobian(hexapod, leg, plan.poses[plan.serves(leg)]))
        for leg in hexapod.leg_names
    ]
    for diagonal in diagonals:
        np.testing.assert_allclose(diagonal, diagonals[0], rtol=1e-9)


@pytest.mark.parametrize("method", ["per-leg", "all-legs"])
def test_clean_data_recover_all_48_parameters(
    hexapod: pincal.Mechanism, selection: pincal.Selection, method: str
) -> None:
    """6 legs of 8 parameters disturbed by 5e-3 come back to 1e-9."""
    truth = pincal.disturb(hexapod, 5e-3, seed=1)
    data = pincal.simulate(hexapod, truth, selection.plan, EXACT).measurements
    noise = pincal.Noise(1e-4, 1e-4, 1e-5)
    result = pincal.calibrate(hexapod, data, noise=noise, method=method)  # type: ignore[arg-type]
    assert result.converged
    for found, true in zip(result.legs, truth.legs, strict=True):
        assert np.abs(found.identified - true.nominal).max() < 1e-9
        assert found.rank == 8
