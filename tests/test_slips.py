"""Slips of frames, targets and encoders: which row, how far, where to; and noise that is there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import loaded
from command_line import done
from marks import quick
from measured import workspace

import pincal
from pincal.calibration.calibrate import prepared, started
from pincal.calibration.fits import fitted
from pincal.estimation.observability.courses import Score, slips

NOISE = pincal.Noise(2e-5, 2e-5, 2e-5)
SIZE = np.array([2e-4, -6e-5, 1e-4])
ROW, COUNT = 30, 60
After = Callable[[pincal.Mechanism, pincal.Measurements, np.ndarray], pincal.Measurements]


def _of_target(
    machine: pincal.Mechanism, data: pincal.Measurements, course: np.ndarray
) -> pincal.Measurements:
    turns = machine.platform.matrices(data.poses)[:, :3, :3]
    return _moved(machine, data, course[:, None] * (turns @ SIZE))


def _of_frame(
    machine: pincal.Mechanism, data: pincal.Measurements, course: np.ndarray
) -> pincal.Measurements:
    return _moved(machine, data, course[:, None] * SIZE)


def _moved(
    machine: pincal.Mechanism, data: pincal.Measurements, by: np.ndarray
) -> pincal.Measurements:
    poses, space = data.poses.copy(), machine.platform.space
    poses[:, :space] += by[:, :space]
    return replace(data, poses=poses)


def _of_reading(
    _: pincal.Mechanism, data: pincal.Measurements, course: np.ndarray
) -> pincal.Measurements:
    readings = data.readings.copy()
    readings[:, 1] += 5e-4 * course
    return replace(data, readings=readings)


def measured(
    name: str, seed: int = 1, gain: float = 1.0
) -> tuple[pincal.Mechanism, pincal.Measurements]:
    """Return a mechanism, its readings geared, and measurements of a machine like it."""
    plain = pincal.load_mechanism(name)
    if gain != 1.0:
        plain = plain.with_parameters({f"{leg.name}.k": gain for leg in plain.legs})
    truth = pincal.disturb(plain, 1e-3, seed=seed)
    poses = workspace(name, COUNT)
    return plain, pincal.simulate(plain, truth, poses, NOISE, seed=seed).measurements


def slipped(plain: pincal.Mechanism, data: pincal.Measurements) -> list[Score]:
    """Return the slips of a calibration's residuals."""
    (one,) = fitted(started(prepared(plain, data, noise=NOISE))).fits
    return slips(one)


@pytest.mark.parametrize("name", quick(1, ["3RRR", "6UPS", "delta"]))
@pytest.mark.parametrize(
    ("what", "after"), [("target", _of_target), ("frame", _of_frame), ("reading", _of_reading)]
)
def test_a_slip_is_named_with_its_row_and_direction(name: str, what: str, after: After) -> None:
    plain, data = measured(name)
    (found,) = slipped(plain, after(plain, data, np.arange(COUNT) >= ROW))
    alike = {kind for kind, _ in found.or_else}
    assert what in {found.what, *alike}
    assert found.term == "step"
    assert abs(found.row - ROW) <= 1
    wanted = np.array([5e-4]) if what == "reading" else SIZE[: len(found.size)]
    if found.what == what:
        np.testing.assert_allclose(found.size, wanted, atol=5e-5)
    assert found.p_value < 1e-6


@pytest.mark.parametrize("after", [_of_frame, _of_reading])
def test_a_drift_is_no_slip(after: After) -> None:
    plain, data = measured("3RRR")
    found = slipped(plain, after(plain, data, np.linspace(0.0, 1.0, COUNT)))[0]
    assert found.term == "order"
    known = np.array([5e-4]) if after is _of_reading else SIZE[:2]
    np.testing.assert_allclose(np.linalg.norm(found.size), np.linalg.norm(known), rtol=0.4)


def test_two_slips_are_both_named() -> None:
    plain, data = measured("3RRR")
    data = _of_frame(plain, data, np.arange(COUNT) >= 20)
    found = slipped(plain, _of_reading(plain, data, np.arange(COUNT) >= 45))
    assert len(found) == 2
    assert sorted(one.row for one in found) == pytest.approx([20, 45], abs=1)
    assert {one.what for one in found} >= {"reading"}


@pytest.mark.slow
def test_sound_machines_have_no_slips() -> None:
    """At most three in a hundred, where one is expected."""
    assert sum(bool(slipped(*measured("3RRR", seed))) for seed in range(10, 110)) <= 3


@pytest.mark.slow
def test_a_reflector_that_slipped_on_an_arm_is_named() -> None:
    """Readings exact, frame and target unknown, positions only: as a laser tracker measures."""
    arm = loaded("ur5")
    draw = np.random.default_rng(0)
    readings = draw.uniform(-1.2, 1.2, (60, 6))
    truth = pincal.disturb(arm, 1e-3, seed=1)
    plan = pincal.Plan(pincal.forward(arm, readings).poses, readings=readings)
    noise = pincal.Noise(5e-5, 1e-4, 0.0)
    data = pincal.simulate(arm, truth, plan, noise, seed=1).measurements
    slip = np.array([-5e-3, 2e-3, 1e-3])
    turns = arm.platform.matrices(data.poses)[:, :3, :3]
    poses = data.poses + np.pad((np.arange(60) >= ROW)[:, None] * (turns @ slip), ((0, 0), (0, 3)))
    poses[:, 3:] = np.nan
    data = replace(data, poses=poses)
    setup = pincal.Setup(unknown_frame=True, targets={"platform": pincal.Target(unknown=True)})
    given = {"noise": noise, "setup": setup}
    asked = started(prepared(arm, data, **given))
    (one,) = fitted(asked).fits
    found = slips(one)[0]
    assert (found.what, found.row) == ("target", ROW)
    np.testing.assert_allclose(found.size, slip, atol=2e-4)
    result = pincal.calibrate(arm, data, **given)
    assert not result.promises


def test_explain_says_slips_in_words(tmp_path: Path) -> None:
    plain, data = measured("3RRR")
    data = _of_frame(plain, data, np.arange(COUNT) >= ROW)
    data.to_csv(tmp_path / "d.csv", plain)
    noise = ("--noise-position", "20um", "--noise-orientation", 2e-5, "--noise-reading", 1e-5)
    more = ("--folds", 2, "--terms", "backlash")
    out = done("explain", "3RRR", tmp_path / "d.csv", *noise, *more).out
    assert f"from data row {ROW + 1} on the frame of the measurements" in out
    assert "in the axes of the measurements): look for a tracker, a tripod or a base" in out
    assert "fix that first" in out


def test_one_row_is_no_slip() -> None:
    """The last row six deviations off is an outlier: no slip is said."""
    plain, data = measured("3RRR")
    poses = data.poses.copy()
    poses[-1, 0] += 1.2e-4
    fit = fitted(prepared(plain, replace(data, poses=poses), noise=NOISE)).fits[0]
    assert not slips(fit)


def test_a_frame_that_moved_askew_is_named_by_calibrate() -> None:
    """Its coordinates step together: a step of one of them leaves the others' rows alike."""
    arm, draw = loaded("ur5"), np.random.default_rng(1)
    readings = draw.uniform(-1.2, 1.2, (40, 6))
    plan = pincal.Plan(pincal.forward(arm, readings).poses, readings=readings)
    truth, noise = pincal.disturb(arm, 1e-3, seed=1), pincal.Noise(5e-5, 1e-4, 0.0)
    data = pincal.simulate(arm, truth, plan, noise, seed=1).measurements
    setup = pincal.Setup(unknown_frame=True, targets={"platform": pincal.Target(unknown=True)})
    for size in (1e-4, 2e-4):  # a drift of one coordinate was named, or that rows are alike
        slip = (np.arange(40) >= 20)[:, None] * np.array([size, size, -0.6 * size])
        poses = np.pad(data.poses[:, :3] + slip, ((0, 0), (0, 3)), constant_values=np.nan)
        result = pincal.calibrate(arm, replace(data, poses=poses), setup=setup)
        (step,) = (remark for remark in result.findings if remark.code == "step")
        assert (step.values["what"], step.rows) == ("frame", (20,))
