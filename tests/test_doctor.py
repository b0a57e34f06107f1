"""The doctor: what went wrong is put right, and the command it prints calibrates."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from arms import loaded
from command_line import done, run
from frames import frame_of
from marks import slow_or_fuzz, some_slow
from measured import machine, seen_from_elsewhere
from numpy.typing import NDArray

import pincal
from pincal import Options
from pincal.calibration.calibrate import remedies
from pincal.calibration.calibration import Calibration
from pincal.files.table import read_table

Array = NDArray[np.float64]
NOISE = pincal.Noise(1e-4, 1e-4, 5e-5)
FRAME = "--unknown-frame"
BALL = ("ball_x [m]", "ball_y [m]", "ball_z [m]")
GIVEN = ("--noise-position", "1e-4", "--noise-orientation", "1e-4", "--noise-reading", "5e-5")


def turned(data: pincal.Measurements) -> pincal.Measurements:
    """Return measurements by a tracker that stands elsewhere, turned about z."""
    platform = pincal.load_mechanism("3RRR").platform
    matrices = platform.transforms(data.poses).as_matrix()
    F = np.eye(4)
    F[:2, :2] = [[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]]
    F[:2, 3] = 1.2, -0.4
    return replace(data, poses=platform.from_matrices(F @ matrices))


def factors(data: pincal.Measurements, column: int, factor: float) -> pincal.Measurements:
    """Return measurements of which one column of readings is multiplied."""
    readings = data.readings.copy()
    readings[:, column] *= factor
    return replace(data, readings=readings)


def far_rows(data: pincal.Measurements) -> pincal.Measurements:
    """Return measurements of which two rows are centimetres off."""
    poses = data.poses.copy()
    poses[7, 0] += 0.02
    poses[20, 1] -= 0.05
    return replace(data, poses=poses)


def swapped(data: pincal.Measurements) -> pincal.Measurements:
    """Return measurements of which the first two columns of readings are exchanged."""
    order = [1, 0, *range(2, data.readings.shape[1])]
    return replace(data, readings=data.readings[:, order])


Change = Callable[[pincal.Measurements], pincal.Measurements]
#: What went wrong, and what the command that works holds beside the noise.
WRONG: dict[str, tuple[Change, tuple[str, ...]]] = {
    "nothing": (lambda d: d, ()),
    "tracker elsewhere": (turned, ("--unknown-frame",)),
    "one sign": (lambda d: factors(d, 1, -1.0), ()),
    "degrees as radians": (lambda d: factors(d, 0, 180 / np.pi), ()),
    "legs exchanged": (lambda d: swapped(d), ()),
    "one row late": (lambda d: replace(d, poses=np.roll(d.poses, 1, axis=0)), ()),
    "two bad rows": (lambda d: far_rows(d), ("--loss", "reject")),
    "zeros": (lambda d: replace(d, readings=d.readings + np.array([0.7, 0.2, -1.6])), ()),
    "elsewhere and one sign": (
        lambda d: factors(turned(d), 0, -1.0),
        ("--unknown-frame",),
    ),
}


@pytest.mark.parametrize("wrong", some_slow(WRONG, *(set(WRONG) - {"legs exchanged"})))
def test_the_command_it_prints_works(wrong: str, tmp_path: Path) -> None:
    """It is run as printed, on the file that the doctor wrote, and finds lengths within 5 σ."""
    mechanism, truth, data = machine("3RRR", 40, NOISE)
    change, options = WRONG[wrong]
    given, mended, result = tmp_path / "m.csv", tmp_path / "mended.csv", tmp_path / "result"
    change(data).to_csv(given, mechanism)
    outcome = run("doctor", "3RRR", str(given), *GIVEN, "-o", str(mended))
    assert outcome.code == 0, outcome.err
    (line,) = re.findall(r"^  pincal (.*)$", outcome.out, re.MULTILINE)
    words = [str(result) if word == "RESULT" else word for word in shlex.split(line)]
    flags = ("--unknown", "--loss", "--rough", "reject")
    assert tuple(word for word in words if word.startswith(flags)) == options
    assert mended.exists() == (str(mended) in words)
    assert run(*words, "--no-report").code == 0
    found = pincal.load_result(result)
    for leg in truth.legs:
        for name in ("L", "l"):
            parameter = found[f"{leg.name}.{name}"]
            off = parameter.identified - leg.nominal_by_name[name]
            assert abs(off) < 5.0 * parameter.std < 0.02


@pytest.mark.fuzz
@pytest.mark.parametrize(
    ("kind", "given"),
    [(kind, given) for kind in ("5R", "3RRR", "6UPS") for given in (True, False)],
)
def test_nothing_makes_noise_a_calibration(kind: str, given: bool) -> None:
    """Readings drawn at random: nothing works, each refusal is kept."""
    mechanism, _, data = machine(kind, 30, NOISE)
    rng = np.random.default_rng(0)
    low, high = data.readings.min(axis=0), data.readings.max(axis=0)
    data = replace(data, readings=rng.uniform(low, high, data.readings.shape))
    options = Options(noise=NOISE if given else None)
    tried = list(remedies(Calibration(mechanism, data, options)))
    assert len(tried) > 2
    assert not any(one.works for one in tried)
    assert all(one.trouble for one in tried if one.result is None)


@pytest.mark.slow
def test_nothing_that_works_is_said(tmp_path: Path) -> None:
    """Exit code 1, no file, and what was refused."""
    mechanism, _, data = machine("5R", 30, NOISE)
    noise = np.random.default_rng(0).uniform(-1.0, 1.0, data.readings.shape)
    replace(data, readings=noise).to_csv(tmp_path / "m.csv", mechanism)
    outcome = run("doctor", "5R", str(tmp_path / "m.csv"), *GIVEN, "-o", str(tmp_path / "n.csv"))
    assert outcome.code == 1
    assert "none of these makes the measurements fit the mechanism" in outcome.out
    assert not (tmp_path / "n.csv").exists()


@pytest.mark.slow
def test_what_fits_alike_is_not_chosen_in_silence(tmp_path: Path) -> None:
    """A 5R mirrored, or its legs exchanged: both work, no file is written, exit code 1."""
    mechanism, _, data = machine("5R", 30, NOISE)
    swapped(data).to_csv(tmp_path / "m.csv", mechanism)
    outcome = run("doctor", "5R", str(tmp_path / "m.csv"), "-o", str(tmp_path / "n.csv"))
    assert outcome.code == 1
    assert "2 of these work equally well" in outcome.out
    assert not (tmp_path / "n.csv").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "frame"), [("5R", ""), ("5R", FRAME), ("delta", ""), ("3RRR", FRAME)]
)
def test_one_gross_row_is_left_out(kind: str, frame: str, tmp_path: Path) -> None:
    """Where the fit of all rows is refused or does not converge, too, the printed command works."""
    mechanism, _, data = machine(kind, 36, NOISE)
    poses = (seen_from_elsewhere(mechanism, data) if frame else data).poses.copy()
    poses[5, 0] *= 10.0
    replace(data, poses=poses).to_csv(tmp_path / "m.csv", mechanism)
    outcome = run("doctor", kind, str(tmp_path / "m.csv"), *frame.split())
    assert outcome.code == 0, outcome.out
    assert "--loss reject" in outcome.out


@pytest.mark.slow
def test_further_columns_of_numbers_are_copied_to_the_mended_file(tmp_path: Path) -> None:
    """A temperature stays in its rows, so that terms may follow it."""
    mechanism, _, data = machine("3RRR", 24, NOISE)
    frame = frame_of(factors(data, 0, -1.0), mechanism)
    frame.insert(0, "temperature [C]", np.arange(24.0))
    frame.to_csv(tmp_path / "m.csv", index=False)
    done("doctor", "3RRR", tmp_path / "m.csv", *GIVEN, "-o", tmp_path / "mended.csv")
    given, mended = (read_table(tmp_path / name) for name in ("m.csv", "mended.csv"))
    assert set(mended.units) == set(given.units)
    np.testing.assert_array_equal(mended.plain("temperature"), np.arange(24.0))


@pytest.mark.slow
def test_counts_of_another_scale_are_mended(tmp_path: Path) -> None:
    """Ten times the counts a turn: the mended file has the readings themselves."""
    mechanism, _, data = machine("3RRR", 24, NOISE)
    frame = frame_of(data, mechanism)
    for name in mechanism.reading_names:
        counts = frame.pop(f"{name} [rad]") * 409600 / (2 * np.pi)
        frame[f"{name} [counts]"] = counts.round().astype(int)
    frame.to_csv(tmp_path / "m.csv", index=False)
    legs = (
        replace(leg, sensors=(replace(leg.sensors[0], counts_per_unit=40960 / (2 * np.pi)),))
        for leg in mechanism.legs
    )
    folder = replace(mechanism, legs=tuple(legs)).save(tmp_path / "encoders")
    outcome = done("doctor", folder, tmp_path / "m.csv", *GIVEN, "-o", tmp_path / "mended.csv")
    assert "the readings are 10 times too large" in outcome.out
    assert "known roughly" not in outcome.out
    mended = pincal.Measurements.from_csv(tmp_path / "mended.csv", mechanism)
    assert np.abs(mended.readings - data.readings).max() < 2e-5


@pytest.mark.slow
def test_exchanged_columns_of_the_orientation_are_mended_as_they_were_written(
    tmp_path: Path,
) -> None:
    """Yaw below roll: both are named, and the mended file has Z-Y-X angles too."""
    mechanism, _, data = machine("6UPS", 24, NOISE)
    frame = frame_of(data, mechanism, orientation="zyx")
    names = {"yaw [rad]": "roll [rad]", "roll [rad]": "yaw [rad]"}
    frame.rename(columns=names).to_csv(tmp_path / "m.csv", index=False)
    outcome = done("doctor", "6UPS", tmp_path / "m.csv", *GIVEN, "-o", tmp_path / "mended.csv")
    assert "yaw and roll are swapped" in outcome.out
    mended = pincal.Measurements.from_csv(tmp_path / "mended.csv", mechanism)
    assert np.abs(mended.poses - data.poses).max() < 1e-9
    assert mended.written == "zyx"


@pytest.mark.parametrize(
    ("kind", "wrong"),
    [
        *slow_or_fuzz(
            [
                ("3RRR", lambda d: factors(d, 1, -1.0)),
                ("3RRR", lambda d: replace(d, readings=np.roll(d.readings, 1, axis=0))),
            ],
            [("3RRR", swapped), ("6UPS", lambda d: factors(d, 3, 1e3)), ("6UPS", swapped)],
        ),
    ],
)
def test_a_fault_is_mended_where_frame_and_target_are_unknown(kind: str, wrong: Change) -> None:
    """Nothing works as measured, and what works puts a fault right."""
    mechanism, _, data = machine(kind, 36, NOISE)
    offset = (0.03, -0.02, 0.0 if kind == "3RRR" else 0.05)
    bad = wrong(seen_from_elsewhere(mechanism, data, offset, 0.4))
    targets = {"platform": pincal.Target(unknown=True)}
    setup = pincal.Setup(unknown_frame=True, targets=targets)
    tried = list(remedies(Calibration(mechanism, bad, Options(noise=NOISE, setup=setup))))
    works = [remedy for remedy in tried if remedy.works]
    assert works
    assert all({fault.code for fault in remedy.findings} - {"unknown-frame"} for remedy in works)


@pytest.mark.slow
def test_frame_and_target_are_tried_together(tmp_path: Path) -> None:
    """Sound measurements of a target elsewhere by a tracker elsewhere: both options are printed."""
    mechanism, _, data = machine("3RRR", 20, NOISE)
    seen_from_elsewhere(mechanism, data, (0.03, -0.02, 0.0), 0.4).to_csv(
        tmp_path / "m.csv", mechanism
    )
    outcome = run("doctor", "3RRR", str(tmp_path / "m.csv"), *GIVEN)
    assert outcome.code == 0, outcome.out
    assert "--unknown-frame --unknown-target" in outcome.out


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["sign", "coupled"])
def test_a_fault_of_an_arm_that_bends_is_mended(fault: str, tmp_path: Path) -> None:
    """A column's sign, or a joint read without the one before it; reflectors named by a setup.

    Its links sag, so that residuals follow a pattern without the fault, too.
    """
    arm, draw = loaded("ur5"), np.random.default_rng(0)
    readings = draw.uniform(-1.2, 1.2, (40, 6))
    plan = pincal.Plan(pincal.forward(arm, readings).poses, readings=readings)
    setup = {"frame": "unknown", "targets": {"ball": {"offset": [0.0, 0.1, 0.05], "unknown": True}}}
    (tmp_path / "setup.yaml").write_text(yaml.safe_dump({"pincal_setup": 1, **setup}))
    truth, noise = pincal.disturb(arm, 1e-3, seed=1), pincal.Noise(5e-5, 1e-4, 0.0)
    poses = pincal.simulate(arm, truth, plan, noise, seed=1).measurements.poses
    T = arm.platform.matrices(poses)
    ball = T[:, :3, :3] @ (0.0, 0.1, 0.05) + T[:, :3, 3]
    sensed = readings + 1e-3 * np.sin(3.0 * readings) * np.eye(6)[1]
    if fault == "sign":
        sensed[:, 2] *= -1.0
    else:
        sensed[:, 2] -= sensed[:, 1]
    header = ",".join([*(f"{name} [rad]" for name in arm.reading_names), *BALL])
    table = np.column_stack((sensed, ball))
    np.savetxt(tmp_path / "m.csv", table, delimiter=",", header=header, comments="")
    arm.save(tmp_path / "arm")
    paths = (str(tmp_path / name) for name in ("arm", "m.csv", "setup.yaml"))
    given = shlex.split("{} {} --setup {}".format(*paths))
    refused = run("calibrate", *given, "-o", str(tmp_path / "result"))
    named = {"sign": "elbow_joint has the opposite sign", "coupled": "elbow_joint turns by its"}
    assert named[fault] in " ".join(refused.err.split())
    outcome = done("doctor", *given, "-o", str(tmp_path / "corrected.csv"))
    assert "this works:" in outcome.out
    assert "residuals follow a pattern" in " ".join(outcome.out.split())
    right = np.loadtxt(tmp_path / "corrected.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(right[:, :6], readings, atol=2e-3)
