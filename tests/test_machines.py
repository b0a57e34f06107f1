"""Machines with closed loops: Pinocchio closes them, noise is propagated, commands work."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_line import done
from machines import MACHINES, configurations, pinocchio_gap, standardised

import pincal

QUICK = ("hybrid", "ankle")


@pytest.mark.parametrize(
    "name",
    [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in MACHINES],
)
def test_pinocchio_closes_every_loop(name: str) -> None:
    """At poses of readings all ends meet that Pinocchio places by URDFs of the legs, to 1e-9."""
    mechanism = MACHINES[name]()
    assert pinocchio_gap(mechanism, configurations(mechanism, 10)) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("name", ["four_bar"])
def test_errors_are_as_large_as_their_standard_errors(name: str) -> None:
    """Errors of 20 sets, whitened by the covariance, are of unit variance: χ² within 4 σ."""
    mechanism = MACHINES[name]()
    squares = np.concatenate(standardised(mechanism, configurations(mechanism, 24), 20))
    assert abs(squares.mean() - 1.0) < 4.0 * np.sqrt(2.0 / squares.size)


def test_legs_bend_as_at_home() -> None:
    """Rods of a Quattro that swing past a right angle are of other branches with home's sign."""
    mechanism, rng = MACHINES["quattro"](), np.random.default_rng(0)
    reach = np.array([0.4, 0.4, 0.4, 1.0])
    poses = mechanism.platform.home + rng.uniform(-reach, reach, (1000, 4))
    solution = pincal.inverse(mechanism, poses)
    assert solution.reached.any(axis=0).all()
    for joints in solution.joints.values():
        assert np.nanmax(np.abs(joints[:, 2])) < np.pi / 2


def test_legs_without_a_drive_are_measured_with_noise() -> None:
    """They read nothing: poses 4 mm off are no readings that do not follow, and explain nothing."""
    mechanism, noise = MACHINES["four_bar"](), pincal.Noise(4e-3, 4e-3, 1e-4)
    plan = pincal.sample_configurations(mechanism, 24)
    data = pincal.simulate(mechanism, mechanism, plan, noise).measurements
    result = pincal.calibrate(mechanism, data, noise=noise)
    assert result.promises
    assert not result.findings


@pytest.mark.slow
@pytest.mark.parametrize("name", ["four_bar", "tricept", "quattro"])
def test_each_command_takes_machines_with_closed_loops(name: str, tmp_path: Path) -> None:
    """Poses are chosen, simulated, calibrated, reported, viewed, deployed by one command each."""
    MACHINES[name]().save(tmp_path / name)
    plan, measured, result = (tmp_path / part for part in ("plan.csv", "measured.csv", "result"))
    done("select", tmp_path / name, "-o", plan, "--count", 12, "--starts", 1)
    done("simulate", tmp_path / name, plan, "-o", measured, "--noise-reading", 1e-5)
    done("calibrate", tmp_path / name, measured, "--folds", 2, "-o", result)
    assert (result / "report.html").stat().st_size > 10_000
    done("view", tmp_path / name, result, "-o", tmp_path / "view.html")
    done("deploy", result, "-o", tmp_path / "controller")
    assert "T = pose(" in (tmp_path / "controller" / "commanding.md").read_text()
