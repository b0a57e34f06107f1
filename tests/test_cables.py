"""Homed sensors and more legs than freedoms: the four-cable robot against its closed form."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import done
from differences import assert_derivative
from marks import some_slow
from measured import workspace
from moved import equivariance
from numpy.typing import NDArray
from scipy.optimize import least_squares

import pincal
from pincal.files.columns import reading_columns
from pincal.files.table import write_table
from pincal.workspace.criteria import in_workspace

Array = NDArray[np.float64]
EXACT = pincal.Noise(0.0, 0.0, 0.0)
LINES = ("line_A", "line_B", "line_C", "line_D")


@pytest.fixture(scope="module")
def cables() -> pincal.Mechanism:
    return pincal.load_mechanism("4cable")


@pytest.fixture(scope="module")
def poses(cables: pincal.Mechanism) -> Array:
    return workspace("4cable", 1000)


def disturbed(cables: pincal.Mechanism, rng: np.random.Generator, size: float) -> pincal.Mechanism:
    """Return a robot with other anchors and gains."""
    values = {leg.name: leg.nominal + rng.uniform(-size, size, 4) for leg in cables.legs}
    return cables.with_parameters(values)


def lengths_read(poses: Array, p: Array) -> Array:
    """Return k (‖p − A‖ − ‖A‖) for p = (A_x, A_y, A_z, k), shape (N,)."""
    return p[3] * (np.linalg.norm(poses - p[:3], axis=1) - np.linalg.norm(p[:3]))


def homed(kind: str) -> pincal.Mechanism:
    """Return a bundled mechanism whose readings are zero at its home pose."""
    mechanism = pincal.load_mechanism(kind)
    legs = []
    for leg in mechanism.legs:
        leg = leg.with_parameters({"gamma": 0.0} if "gamma" in leg.parameter_names else {})
        legs.append(replace(leg, sensors=(replace(leg.sensors[0], zero="home"),)))
    return replace(mechanism, legs=tuple(legs))


# Homed sensors


@pytest.mark.slow
def test_readings_are_changes_of_length(cables: pincal.Mechanism) -> None:
    """On 100 random geometries readings are k (‖p − A‖ − ‖A‖) within 1e-12 m."""
    rng = np.random.default_rng(0)
    for _ in range(100):
        robot = disturbed(cables, rng, 0.3)
        poses = rng.uniform(-0.9, 0.9, (50, 3))
        expected = [lengths_read(poses, leg.nominal) for leg in robot.legs]
        readings = pincal.inverse(robot, poses).readings
        np.testing.assert_allclose(readings, np.transpose(expected), rtol=0.0, atol=1e-12)


@pytest.mark.slow
def test_jacobian_holds_the_change_of_home(cables: pincal.Mechanism) -> None:
    """Within 1e-7 of central differences of the closed form, relative, on 100 random geometries."""
    rng = np.random.default_rng(1)
    for _ in range(100):
        robot = disturbed(cables, rng, 0.3)
        poses = rng.uniform(-0.9, 0.9, (50, 3))
        for leg in robot.legs:
            C = pincal.identification_jacobian(robot, leg.name, poses)
            assert_derivative(C, lambda h, p=leg.nominal, at=poses: lengths_read(at, p + h))


@pytest.mark.parametrize("kind", some_slow(["3RRR", "5R", "6UPS"], "6UPS"))
def test_any_leg_can_be_homed(kind: str) -> None:
    """At home the reading is the sensor's constant; the Jacobian follows finite differences."""
    mechanism = pincal.disturb(homed(kind), 0.01, seed=2)
    home = np.array([mechanism.platform.home])
    poses = home + np.random.default_rng(3).uniform(-0.1, 0.1, (40, mechanism.platform.dof))
    at_home = pincal.inverse(mechanism, home).readings[0]
    for index, leg in enumerate(mechanism.legs):
        gain, offset = leg.sensors[0].constants(leg.nominal_by_name)
        constant = offset if leg.sensors[0].form == "reading" else -offset / gain
        assert at_home[index] == pytest.approx(constant, abs=1e-12)

        def readings(h: Array, index: int = index, leg: pincal.Leg = leg) -> Array:
            moved = mechanism.with_parameters({leg.name: leg.nominal + h})
            return pincal.inverse(moved, poses).readings[:, index]

        C = pincal.identification_jacobian(mechanism, leg.name, poses)
        assert_derivative(C, readings, precision=1e-13)


def test_clean_measurements_give_the_parameters(cables: pincal.Mechanism, poses: Array) -> None:
    """Anchors and gains come back from full positions within 1e-9, each leg alone."""
    truth = disturbed(cables, np.random.default_rng(4), 0.02)
    data = pincal.simulate(cables, truth, pincal.Plan(poses[:30]), EXACT).measurements
    noise = pincal.Noise(1e-4, 0.0, 1e-4)
    result = pincal.calibrate(cables, data, noise=noise, method="per-leg")
    for leg in truth.legs:
        found = result.identified.leg(leg.name).nominal
        np.testing.assert_allclose(found, leg.nominal, rtol=0.0, atol=1e-9)


def test_home_out_of_reach_leaves_no_readings() -> None:
    """A dyad too short for home raises, naming the leg and its values; nothing is made up."""
    mechanism = homed("3RRR")
    short = mechanism.with_parameters({"leg_2": {"l": 0.4, "L": 0.4}})
    near = np.array([[0.9, -0.5, 0.0]])
    with pytest.raises(pincal.MechanismError, match=r"leg_2: .*home pose.*l = 0\.4"):
        pincal.inverse(short, near)
    with pytest.raises(pincal.MechanismError, match=r"leg_2: .*home pose"):
        pincal.forward(short, np.zeros((1, 3)))


@pytest.mark.parametrize("kind", ["4cable", "3RRR"])
def test_homed_mechanisms_are_saved_whole(kind: str, tmp_path: Path) -> None:
    """Saved and loaded, a homed mechanism gives the same readings."""
    mechanism = pincal.disturb(homed(kind), 0.01, seed=5)
    loaded = pincal.load_mechanism(mechanism.save(tmp_path / "saved"))
    assert [leg.sensors for leg in loaded.legs] == [leg.sensors for leg in mechanism.legs]
    poses = np.array([mechanism.platform.home]) + 0.1
    readings = [pincal.inverse(one, poses).readings for one in (mechanism, loaded)]
    np.testing.assert_allclose(*readings, rtol=0.0, atol=1e-14)


# Symmetry


def test_the_group_of_the_cables_is_that_of_their_anchors(
    cables: pincal.Mechanism, poses: Array
) -> None:
    """Thirds of a turn and three mirrors; line D stays; readings and workspace follow."""
    group = pincal.symmetry_group(cables)
    assert sorted(group.permutations) == [
        (0, 1, 2, 3), (0, 2, 1, 3), (1, 0, 2, 3), (1, 2, 0, 3), (2, 0, 1, 3), (2, 1, 0, 3),
    ]  # fmt: skip
    assert not group.breaks
    assert equivariance(group, poses) < 1e-12
    for element in group.elements:
        assert in_workspace(cables, element.poses(cables.platform, poses)).all()
    with pytest.raises(pincal.SymmetryError, match=r"onto line_D\. Choose"):
        group.carriers()


@pytest.mark.parametrize("change", [{"upper": 1.0}, {"lower": -1.0}])
def test_directions_that_a_line_bars_break_its_symmetry(
    cables: pincal.Mechanism, change: dict[str, float]
) -> None:
    """Line D barred to one side keeps what leaves that side; its universal joint tells."""
    high = cables.legs[3]
    first = replace(high.joints[0], **change)
    barred = replace(high, joints=(first, *high.joints[1:]))
    group = pincal.symmetry_group(replace(cables, legs=(*cables.legs[:3], barred)))
    assert [str(e) for e in group.elements] == ["identity", "mirror at azimuth 90°"]
    assert all("line_D" in legs.values() for legs in group.breaks.values())


@pytest.mark.parametrize("kind", ["3RRR", "6UPS"])
def test_homed_legs_are_as_symmetric_as_others(kind: str) -> None:
    """All legs homed keep the group, and their readings follow it."""
    mechanism, plain = homed(kind), pincal.symmetry_group(pincal.load_mechanism(kind))
    group = pincal.symmetry_group(mechanism)
    assert group.permutations == plain.permutations
    shift = np.random.default_rng(6).uniform(-0.05, 0.05, (20, mechanism.platform.dof))
    assert equivariance(group, np.array(mechanism.platform.home) + np.abs(shift)) < 1e-12


# More legs than freedoms


def test_forward_undoes_inverse(cables: pincal.Mechanism, poses: Array) -> None:
    """Exact readings of four lines give the poses within 1e-10 and leave no gap."""
    guess = poses + np.random.default_rng(7).uniform(-0.02, 0.02, poses.shape)
    solution = pincal.forward(cables, pincal.inverse(cables, poses).readings, guess)
    assert solution.converged.all()
    assert np.abs(solution.poses - poses).max() < 1e-10
    assert solution.gap.shape == (len(poses), 4)
    assert solution.gap.max() < 1e-12


def test_lines_do_not_turn_over_on_the_way(cables: pincal.Mechanism, poses: Array) -> None:
    """From home, however far, the poses are found: a line has no working mode to leave."""
    solution = pincal.forward(cables, pincal.inverse(cables, poses).readings)
    assert solution.converged.all()
    assert np.abs(solution.poses - poses).max() < 1e-10


def test_readings_that_contradict_give_the_pose_of_least_gaps(
    cables: pincal.Mechanism, poses: Array
) -> None:
    """The pose is the minimum of Σ (‖p − A‖ − ℓ)² as SciPy finds it, and the gaps are its rest."""
    anchors = np.array([leg.nominal[:3] for leg in cables.legs])
    exact = pincal.inverse(cables, poses[:50]).readings
    readings = exact + 0.02 * np.random.default_rng(8).standard_normal(exact.shape)
    solution = pincal.forward(cables, readings, poses[:50])
    assert solution.converged.all()
    lengths = readings + np.linalg.norm(anchors, axis=1)
    for pose, found, gap, length in zip(poses, solution.poses, solution.gap, lengths, strict=False):

        def rest(p: Array, length: Array = length) -> Array:
            return np.linalg.norm(p - anchors, axis=1) - length

        best = least_squares(rest, pose, xtol=1e-15, ftol=1e-15, gtol=1e-15)
        np.testing.assert_allclose(found, best.x, rtol=0.0, atol=1e-7)
        np.testing.assert_allclose(gap, np.abs(rest(found)), rtol=0.0, atol=1e-12)


def test_a_redundant_machine_is_measured_where_it_was_to_go(
    cables: pincal.Mechanism, poses: Array
) -> None:
    """Simulated poses are the planned ones and readings those of the true geometry there."""
    truth = disturbed(cables, np.random.default_rng(9), 0.02)
    simulation = pincal.simulate(cables, truth, pincal.Plan(poses[:20]), EXACT)
    assert not simulation.unreachable
    np.testing.assert_array_equal(simulation.measurements.poses, poses[:20])
    expected = np.transpose([lengths_read(poses[:20], leg.nominal) for leg in truth.legs])
    np.testing.assert_allclose(simulation.measurements.readings, expected, rtol=0.0, atol=1e-12)
    noise = pincal.Noise(1e-3, 0.0, 1e-3)
    noisy = pincal.simulate(cables, truth, pincal.Plan(poses), noise).measurements
    assert (noisy.poses - poses).std() == pytest.approx(1e-3, rel=0.1)
    result = pincal.calibrate(cables, noisy, noise=noise)
    before, after = (
        pincal.accuracy(model, truth, poses[:200]).position for model in (cables, result.identified)
    )
    assert result.converged
    assert after < 0.02 * before


def test_the_command_line_tells_symmetry_and_contradiction(
    cables: pincal.Mechanism, poses: Array, tmp_path: Path
) -> None:
    """'symmetry' finds D6; 'forward' says within what readings fit, and in which row least."""
    told = done("symmetry", "4cable").out
    assert "D6" in told
    assert "mirror at azimuth 150°" in told
    readings = pincal.inverse(cables, poses[:5]).readings
    readings[2, 3] += 0.05
    write_table(tmp_path / "readings.csv", reading_columns(cables, readings))
    said = done("forward", "4cable", tmp_path / "readings.csv", "-o", tmp_path / "poses.csv").err
    found = pincal.Plan.from_csv(tmp_path / "poses.csv", cables).poses
    assert "(row 3, line_" in said
    np.testing.assert_allclose(np.delete(found, 2, 0), np.delete(poses[:5], 2, 0), atol=1e-9)
