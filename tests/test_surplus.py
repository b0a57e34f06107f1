"""Legs with fewer joints than their closure has rows: the 3-RPS."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from marks import quick
from measured import EXACT
from numpy.typing import NDArray
from scipy.stats import ortho_group

import pincal
from pincal import forecast
from pincal.files.columns import write_plan
from pincal.files.measurements import read_poses

Array = NDArray[np.float64]
NOISE = pincal.Noise(1e-4, 1e-4, 0.0)


@pytest.fixture(scope="module")
def mechanism() -> pincal.Mechanism:
    """The bundled 3-RPS."""
    return pincal.load_mechanism("3RPS")


@pytest.fixture(scope="module")
def plan(mechanism: pincal.Mechanism) -> pincal.Plan:
    """Configurations of it."""
    return pincal.sample_configurations(mechanism, 60, seed=3)


def ends(mechanism: pincal.Mechanism, poses: Array) -> list[tuple[Array, Array, Array]]:
    """Return, leg by leg, base point, platform points in the base frame, and hinge axis."""
    T = mechanism.platform.transforms(poses).as_matrix()
    found = []
    for leg in mechanism.legs:
        p = leg.nominal_by_name

        def point(radius: float, polar: float, azimuth: float) -> Array:
            across = radius * np.sin(polar)
            along = radius * np.cos(polar)
            return np.array([across * np.cos(azimuth), across * np.sin(azimuth), along])

        A = point(p["OA"], p["alpha"], p["beta"])
        b = point(p["ob"], p["alpha_b"], p["beta_b"])
        axis = np.array([-np.sin(p["psi"]), np.cos(p["psi"]), 0.0])
        found.append((A, T[:, :3, 3] + T[:, :3, :3] @ b, axis))
    return found


@pytest.mark.parametrize("seed", quick(3, range(10)))
def test_poses_and_readings_satisfy_the_closed_form(
    mechanism: pincal.Mechanism, plan: pincal.Plan, seed: int
) -> None:
    """|t − A| = k ψ + γ and (t − A) · a = 0 within 1e-11 m on random geometries, and back."""
    machine = pincal.disturb(mechanism, 0.02, seed=seed)
    sensors = {leg.name: {"k": 1.01, "gamma": 0.002} for leg in machine.legs}  # within the limits
    machine = machine.with_parameters(sensors)
    solution = pincal.forward(machine, plan.readings)
    assert solution.converged.mean() > 0.8
    poses, readings = solution.poses[solution.converged], plan.readings[solution.converged]
    for index, (leg, (A, t, axis)) in enumerate(
        zip(machine.legs, ends(machine, poses), strict=True)
    ):
        p = leg.nominal_by_name
        length = p["k"] * readings[:, index] + p["gamma"]
        np.testing.assert_allclose(np.linalg.norm(t - A, axis=1), length, atol=1e-11)
        np.testing.assert_allclose((t - A) @ axis, 0.0, atol=1e-11)
    back = pincal.inverse(machine, poses)
    assert back.reached.all()
    np.testing.assert_allclose(back.readings, readings, atol=1e-11)


def test_poses_off_the_surface_are_out_of_reach(
    mechanism: pincal.Mechanism, plan: pincal.Plan
) -> None:
    """A pose moved along a freedom that the platform lacks is reached by no leg pair."""
    poses = plan.poses.copy()
    poses[:, 5] += 0.01  # torsion
    solution = pincal.inverse(mechanism, poses)
    assert not solution.reached.all(axis=1).any()
    assert "out of reach" in solution.reason(0)


def test_group_and_equations(mechanism: pincal.Mechanism) -> None:
    """The group is that which generates it; two equations a leg fix the pose."""
    assert pincal.symmetry_group(mechanism).name == "D6"
    assert (mechanism.constraints, mechanism.redundant, mechanism.by_readings) == (6, False, True)


@pytest.mark.parametrize("method", ["per-leg", "all-legs"])
def test_clean_data_recover_all_parameters(
    mechanism: pincal.Mechanism, plan: pincal.Plan, method: str
) -> None:
    """Every method gives the truth within 1e-9, from both equations of every leg."""
    truth = pincal.disturb(mechanism, 1e-3, seed=1)
    data = pincal.simulate(mechanism, truth, plan, pincal.Noise(0, 0, 0)).measurements
    result = pincal.calibrate(mechanism, data, method=method, noise=NOISE, poses="all", strict=True)
    for leg in truth.legs:
        np.testing.assert_allclose(result.identified.leg(leg.name).nominal, leg.nominal, atol=1e-9)
    assert result.degrees_of_freedom == 6 * len(data) - 27


def test_surplus_equations_add_information(mechanism: pincal.Mechanism, plan: pincal.Plan) -> None:
    """Fewer poses than parameters of a leg suffice, since each gives two equations."""
    few = pincal.Plan(plan.poses[:6], readings=plan.readings[:6])
    truth = pincal.disturb(mechanism, 1e-3, seed=2)
    data = pincal.simulate(mechanism, truth, few, pincal.Noise(0, 0, 0)).measurements
    result = pincal.calibrate(mechanism, data, noise=NOISE, poses="all", strict=True)
    np.testing.assert_allclose(result.identified.legs[0].nominal, truth.legs[0].nominal, atol=1e-7)


@pytest.mark.slow
def test_standard_errors_are_the_spread(mechanism: pincal.Mechanism) -> None:
    """Each parameter's within 3 % at eight poses, and equal to the bound that the forecast gives.

    Errors are the columns of a random orthogonal matrix, so that no chance is in the spread (see
    tests/test_linear_delta.py), and so small that eight poses tell all parameters. Searches begin
    at the true machine: from elsewhere they take ten times as long to the same end.
    """
    truth, noise = pincal.disturb(mechanism, 1e-3, seed=1), pincal.Noise(3e-6, 3e-6, 0.0)
    plan = pincal.sample_configurations(mechanism, 8, seed=3)
    exact = pincal.simulate(mechanism, truth, plan, EXACT).measurements
    size, errors, std = exact.poses.size, [], []
    for draw in np.sqrt(size) * ortho_group.rvs(size, random_state=0):
        twists = 3e-6 * draw.reshape(exact.poses.shape)
        data = replace(exact, poses=mechanism.platform.moved(exact.poses, twists))
        result = pincal.calibrate(truth, data, noise=noise, strict=True)
        identified = np.concatenate([leg.identified for leg in result.legs])
        errors.append(identified - np.concatenate([leg.nominal for leg in truth.legs]))
        std.append(np.concatenate([leg.std for leg in result.legs]))
    spread = np.sqrt(np.mean(np.square(errors), axis=0))
    np.testing.assert_allclose(spread / np.mean(std, axis=0), 1.0, atol=0.03)
    np.testing.assert_allclose(forecast(truth, plan, noise).std, np.mean(std, axis=0), rtol=0.05)


def test_files_keep_readings(
    mechanism: pincal.Mechanism, plan: pincal.Plan, tmp_path: Path
) -> None:
    """A plan of such a mechanism is written and read with its readings, bit for bit."""
    path = tmp_path / "plan.csv"
    write_plan(plan, path, mechanism)
    read = read_poses(path, mechanism)
    np.testing.assert_array_equal(read.readings, plan.readings)
    np.testing.assert_array_equal(read.poses, plan.poses)
    mechanism.save(tmp_path / "m")
    assert pincal.load_mechanism(tmp_path / "m") == mechanism


@pytest.mark.slow
def test_chosen_configurations_beat_random_ones(mechanism: pincal.Mechanism) -> None:
    """The choice has more information than 15 random ones of the same size, none of it twice."""
    offered = pincal.sample_configurations(mechanism, 400, seed=5)
    chosen = pincal.select_configurations(mechanism, offered, 12, noise=NOISE, starts=3)
    assert 0.9 < chosen.efficiency <= 1.0
    assert len(np.unique(chosen.plan.poses, axis=0)) == 12

    def size(plan: pincal.Plan) -> float:
        return float(np.linalg.slogdet(forecast(mechanism, plan, NOISE).covariance)[1])

    rng, best = np.random.default_rng(0), size(chosen.plan)
    for _ in range(15):
        rows = rng.choice(400, 12, replace=False)
        some = pincal.Plan(offered.poses[rows], readings=offered.readings[rows])
        assert best < size(some)
