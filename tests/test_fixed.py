"""Parameters held by name or by pattern; with all of them held, frame and target are found."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import done
from scipy.spatial.transform import RigidTransform, Rotation

import pincal

NOISE = pincal.Noise(1e-5, 1e-5, 1e-6)
JOINTS = (("0 0 .3", "0 0 1"), ("0 .1 0", "0 1 0"), ("0.4 0 0", "0 1 0"), ("0.3 0 0", "1 0 0"),
          ("0 .1 0", "0 1 0"), ("0 0 .1", "0 0 1"))  # fmt: skip


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> pincal.Mechanism:
    """Return an arm with six joints."""
    links = "".join(f'<link name="l{i}"/>' for i in range(7))
    joints = "".join(
        f'<joint name="j{i}" type="revolute"><parent link="l{i}"/><child link="l{i + 1}"/>'
        f'<origin xyz="{xyz}"/><axis xyz="{axis}"/>'
        '<limit lower="-2" upper="2" effort="1" velocity="1"/></joint>'
        for i, (xyz, axis) in enumerate(JOINTS)
    )
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    path.write_text(f'<robot name="arm">{links}{joints}</robot>')
    return pincal.Mechanism.from_urdf(path, "l6")


def measured(arm: pincal.Mechanism, frame: RigidTransform, target: RigidTransform, path: Path):
    """Write what a tracker in another frame measures of a target on the tool, 30 rows."""
    rng = np.random.default_rng(1)
    readings = rng.uniform(-1.2, 1.2, (30, 6))
    tool = arm.platform.transforms(pincal.forward(arm, readings).poses)
    seen = frame * tool * target
    position = seen.translation + rng.normal(0.0, 1e-5, (30, 3))
    turned = Rotation.from_rotvec(rng.normal(0.0, 1e-5, (30, 3))) * seen.rotation
    columns = ["x [m]", "y [m]", "z [m]", "rx [rad]", "ry [rad]", "rz [rad]"]
    columns += [f"{name} [rad]" for name in arm.reading_names]
    table = np.hstack((position, turned.as_rotvec(), readings))
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="")
    return path


def test_with_all_parameters_held_frame_and_target_are_found(
    arm: pincal.Mechanism, tmp_path: Path
) -> None:
    """Hand-eye calibration alone: both within 5 standard errors, no parameter moves."""
    frame = RigidTransform.from_components([0.1, 0.3, 1.4], Rotation.from_rotvec([2.0, -0.4, 0.3]))
    target = RigidTransform.from_components(
        [0.02, -0.03, 0.06], Rotation.from_rotvec([0.05, 0.1, 1.2])
    )
    path = measured(arm, frame, target, tmp_path / "eye.csv")
    unknown: Any = {"unknown_frame": True, "unknown_target": True}  # as options, or of the setup
    result = pincal.calibrate(arm, path, noise=NOISE, fixed="*", folds=0, **unknown)
    setup = pincal.Setup(unknown_frame=True, targets={"platform": pincal.Target(unknown=True)})
    again = pincal.calibrate(arm, path, setup=setup, noise=NOISE, fixed="*", folds=0)
    assert [u.identified for u in again.external] == [u.identified for u in result.external]
    assert result.converged
    np.testing.assert_array_equal(result.identified.parameters.values, arm.parameters.values)
    expected = np.concatenate(
        [np.concatenate((T.translation, T.rotation.as_rotvec())) for T in (frame, target)]
    )
    assert len(result.external) == 12
    for found, value in zip(result.external, expected, strict=True):
        assert abs(found.identified - value) < 5.0 * found.std < 2e-4, found.id


@pytest.mark.slow
def test_hand_eye_calibration_alone_has_a_verdict_and_a_report(
    arm: pincal.Mechanism, tmp_path: Path
) -> None:
    """By the command: no error of the machine is claimed, neither 0 nor any other."""
    path = measured(arm, RigidTransform.identity(), RigidTransform.identity(), tmp_path / "eye.csv")
    arm.save(tmp_path / "arm")
    options = ("--unknown-frame", "--unknown-target", "--fixed", "*", "-o", tmp_path / "eye")
    outcome = done("calibrate", tmp_path / "arm", path, *options)
    assert "only frames were identified" in outcome.out.lower()
    assert "≤" not in outcome.out.splitlines()[0]
    assert "\n calibrated " not in outcome.out  # the row of the machine's error
    assert (tmp_path / "eye" / "report.html").exists()


@pytest.mark.parametrize(
    ("pattern", "held", "method"),
    [
        ("leg_1.*", lambda leg, _: leg == "leg_1", "all-legs"),
        ("leg_1.*", lambda leg, _: leg == "leg_1", "per-leg"),
        ("beta*", lambda _, name: name.startswith("beta"), "all-legs"),
        ("leg_[23].l", lambda leg, name: leg != "leg_1" and name == "l", "all-legs"),
    ],
)
def test_patterns_hold_what_they_match(pattern: str, held: object, method: Any) -> None:
    """They are at their nominal values, and said to be fixed; all others are identified."""
    mechanism = pincal.load_mechanism("3RRR")
    truth = pincal.disturb(mechanism, 1e-4, seed=3)
    poses = pincal.sample_workspace(mechanism, 30, seed=3)
    data = pincal.simulate(mechanism, truth, poses, NOISE, seed=4).measurements
    noise = replace(NOISE, position=1e-4)
    options: Any = {"fixed": pattern, "method": method, "folds": 0, "rough": True}
    result = pincal.calibrate(mechanism, data, noise=noise, **options)
    for parameter in result.parameters:
        fixed = held(parameter.owner, parameter.name)  # type: ignore[operator]
        assert (parameter.given == "fixed") == fixed, parameter.id
        assert (parameter.identified == parameter.nominal) == fixed, parameter.id


def test_a_pattern_that_matches_nothing_is_refused() -> None:
    """The message names it and what there is; all held in known frames leaves nothing to find."""
    data = pincal.simulate("5R", "5R", pincal.sample_workspace("5R", 12, seed=0), NOISE, seed=0)
    with pytest.raises(pincal.MeasurementError, match=r"no parameter 'leg_7\.\*'; expected one of"):
        pincal.calibrate("5R", data.measurements, noise=NOISE, fixed="leg_7.*")
    with pytest.raises(pincal.MeasurementError, match="every parameter is fixed"):
        pincal.calibrate("5R", data.measurements, noise=NOISE, fixed="*")
    with pytest.raises(pincal.MeasurementError, match="cannot be tied"):
        pincal.calibrate("5R", data.measurements, noise=NOISE, tied="A_*")
