"""A file whose numbers are cut to few digits is the machine that it was with all of them."""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml
from command_line import done, run
from marks import quick
from neighbours import joint, urdf, written
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import pincal
from pincal import sample_configurations

Text = Callable[[float], str]
READINGS = np.array([[0.06, -0.04, 0.05], [-0.05, 0.03, 0.08]])


def in_digits(count: int) -> Text:
    """Return what writes numbers with so many significant digits."""
    return lambda value: f"{float(value) + 0.0:.{count}g}"


def full(value: float) -> str:
    """Return a number with all digits."""
    return repr(float(value) + 0.0)


def frames_between(placed: np.ndarray, text: Text) -> dict[str, str]:
    """Return xyz and rpy of a placement, shape (4, 4), as text."""
    rpy = Rotation.from_matrix(placed[:3, :3]).as_euler("xyz")
    return {
        "xyz": " ".join(text(value) for value in placed[:3, 3]),
        "rpy": " ".join(text(value) for value in rpy),
    }


def machine(folder: Path, legs: list[list[np.ndarray]], text: Text, closes: str) -> Path:
    """Write a machine of three legs as URDF and YAML: the first carries the platform.

    Args:
        folder: Where to.
        legs: Of each leg its motor, its joints and its end on the platform, poses of frames in the
            base as drawn, shape (4, 4); joints turn about z.
        text: How numbers are written.
        closes: ``"3d"`` if ends meet in points, ``"6d"`` in frames.
    """
    joints: list[str] = []
    loops = []
    for number, frames in enumerate(legs, start=1):
        names = [f"{stem}{number}" for stem in ("mot", "mid", "end")[: len(frames)]]
        parents = ["base", *(f"link_{name}" for name in names)]
        children = parents[1:]
        if number == 1:
            children[-1] = "platform"
        for (before, after), parent, child, name in zip(
            pairwise([np.eye(4), *frames]), parents, children, names, strict=False
        ):
            placed = frames_between(np.linalg.inv(before) @ after, text)
            still = number > 1 and closes == "3d" and name.startswith("end")
            kind = "fixed" if still else "continuous"
            joints.append(joint(name, parent, child, kind=kind, limit="", **placed))
        if number > 1:
            on_platform = frames_between(np.linalg.inv(legs[0][-1]) @ frames[-1], text)
            joints.append(
                joint(f"at{number}", "platform", f"at_{number}", kind="fixed", **on_platform)
            )
            loops.append([children[-1], f"at_{number}"])
    loops_text = yaml.safe_dump(
        {"closed_loop": loops, "type": [closes] * 2, "name_mot": ["mot1", "mot2", "mot3"]}
    )
    return written(folder, urdf("machine", joints, "base"), loops_text)


def planar_legs(tilt: float = 0.0) -> list[list[np.ndarray]]:
    """Return the frames of a 3-RRR in the plane of x and z, the motor of leg 2 tilted, [rad]."""
    up = np.eye(4)
    up[:3, :3] = Rotation.from_euler("x", np.pi / 2).as_matrix()
    legs = []
    for azimuth in np.radians([200.0, 325.0, 85.0]):
        base, end = 0.27 * np.exp(1j * azimuth), 0.03 + 0.02j + 0.11 * np.exp(1j * azimuth)
        reach = end - base
        half = np.arccos(abs(reach) / 2 / 0.16)
        first = np.angle(reach) + half
        spots = [base, base + 0.16 * np.exp(1j * first), end]
        angles = [first, np.angle(reach) - half, np.angle(reach) - half]
        frames = []
        for spot, angle in zip(spots, angles, strict=True):
            frame = np.eye(4)
            frame[:3, :3] = Rotation.from_euler("z", angle).as_matrix()
            frame[:2, 3] = spot.real, spot.imag
            frames.append(up @ frame)
        legs.append(frames)
    legs[1][0][:3, :3] = legs[1][0][:3, :3] @ Rotation.from_euler("x", tilt).as_matrix()
    return legs


def spherical_legs() -> list[list[np.ndarray]]:
    """Return the frames of a spherical 3-RRR: all axes go through one point."""
    legs = []
    for azimuth in (0.3, 2.5, 4.4):
        turns = Rotation.from_euler("ZY", [[azimuth, 0.25], [azimuth + 0.5, 1.0], [azimuth, 1.6]])
        frames = []
        for turn, radius in zip(turns.as_matrix(), (0.05, 0.07, 0.09), strict=True):
            frame = np.eye(4)
            frame[:3, :3], frame[:3, 3] = turn, radius * turn[:, 2]
            frames.append(frame)
        legs.append(frames)
    return legs


def platform_frames(file: Path, readings: np.ndarray) -> np.ndarray:
    """Return where the platform of a file goes from home, by Pinocchio and SciPy, (N, 4, 4)."""
    model = pin.buildModelFromUrdf(str(file))
    data = model.createData()
    loops = yaml.safe_load(file.with_name("robot.yaml").read_text())
    motors = [model.joints[model.getJointId(name)].idx_v for name in loops["name_mot"]]
    others = [i for i in range(model.nv) if i not in motors]

    def frame(angles: np.ndarray, name: str) -> np.ndarray:
        q = pin.integrate(model, pin.neutral(model), angles)
        pin.framesForwardKinematics(model, data, q)
        return data.oMf[model.getFrameId(name, pin.FrameType.BODY)].homogeneous.copy()

    def gaps(passive: np.ndarray, read: np.ndarray) -> np.ndarray:
        angles = np.zeros(model.nv)
        angles[motors], angles[others] = read, passive
        gap = []
        for first, second in loops["closed_loop"]:
            one, other = frame(angles, first), frame(angles, second)
            gap += [one[:3, 3] - other[:3, 3]]
            if loops["type"][0] == "6d":
                gap.append(Rotation.from_matrix(one[:3, :3].T @ other[:3, :3]).as_rotvec())
        return np.concatenate(gap)

    found = []
    for read in readings:
        passive = np.zeros(len(others))
        for share in (0.25, 0.5, 0.75, 1.0):
            solved = least_squares(
                gaps, passive, args=(share * read,), xtol=None, ftol=None, gtol=1e-15
            )
            passive = solved.x
        assert np.abs(solved.fun).max() < 1e-9
        angles = np.zeros(model.nv)
        angles[motors], angles[others] = read, passive
        home = frame(np.zeros(model.nv), "platform")
        found.append(np.linalg.inv(home) @ frame(angles, "platform"))
    return np.stack(found)


def imported(file: Path) -> pincal.Mechanism:
    """Return the mechanism of a file, through the command."""
    done("import", file, "-o", file.parent / "m")
    return pincal.load_mechanism(file.parent / "m")


@pytest.mark.parametrize("digits", quick(1, [5, 6, 8]))
@pytest.mark.parametrize("kind", ["planar", "spherical"])
def test_few_digits_are_the_same_machine(kind: str, digits: int, tmp_path: Path) -> None:
    """Platform, joints, parameters, poses of readings are those of the file with all digits.

    Within what the digits leave open; the poses by Pinocchio.
    """
    legs, closes = (planar_legs(), "3d") if kind == "planar" else (spherical_legs(), "6d")
    exact = machine(tmp_path / "exact", legs, full, closes)
    rounded = machine(tmp_path / "rounded", legs, in_digits(digits), closes)
    true, mechanism = imported(exact), imported(rounded)
    assert mechanism.platform.kind == true.platform.kind
    for one, other in zip(mechanism.legs, true.legs, strict=True):
        assert one.parameter_names == other.parameter_names
        assert np.abs(one.home - other.home).max() < 40 * 10.0**-digits
    solution = pincal.forward(mechanism, READINGS)
    assert solution.converged.all()
    expected = platform_frames(exact, READINGS)
    matrices = mechanism.platform.transforms(solution.poses).as_matrix()
    home = mechanism.platform.home_pose.as_matrix()[0]
    moved = np.linalg.inv(home) @ matrices
    turned = np.linalg.norm(expected[:, :3, :3] - np.eye(3), axis=(1, 2))
    shifted = np.linalg.norm(expected[:, :3, 3], axis=1)
    within = 100 * 10.0**-digits
    np.testing.assert_allclose(
        np.linalg.norm(moved[:, :3, :3] - np.eye(3), axis=(1, 2)), turned, atol=within
    )
    np.testing.assert_allclose(np.linalg.norm(moved[:, :3, 3], axis=1), shifted, atol=within)


@pytest.mark.slow
def test_a_rounded_machine_has_configurations(tmp_path: Path) -> None:
    """Configurations of a spherical machine in six digits count: it closes there as at home."""
    mechanism = imported(machine(tmp_path / "m6", spherical_legs(), in_digits(6), "6d"))
    plan = sample_configurations(mechanism, 20)
    solution = pincal.forward(mechanism, plan.readings)
    assert solution.converged.all()
    assert solution.gap.max() < 1e-5


@pytest.mark.slow
def test_commands_serve_a_rounded_machine(tmp_path: Path) -> None:
    """A spherical machine in six digits is checked, and its forward kinematics ends."""
    file = machine(tmp_path / "m6", spherical_legs(), in_digits(6), "6d")
    mechanism = imported(file)
    checked = done("check", file.parent / "m")
    assert "parameters observable from full poses" in checked.out
    names = ",".join(f"{name} [rad]" for name in mechanism.reading_names)
    (tmp_path / "r.csv").write_text(f"{names}\n0.06,-0.04,0.05\n")
    done("forward", file.parent / "m", tmp_path / "r.csv", "-o", tmp_path / "p.csv")


def test_axes_that_are_tilted_by_more_than_digits_stay_tilted(tmp_path: Path) -> None:
    """A 3-RRR with an axis tilted by 0.01 rad is no planar machine, in five digits neither."""
    outcome = run(
        "import",
        machine(tmp_path / "m", planar_legs(0.01), in_digits(5), "3d"),
        "-o",
        tmp_path / "out",
    )
    assert "planar platform" not in outcome.out


def test_right_angles_of_three_digits_are_right(tmp_path: Path) -> None:
    """A plane that is turned by 1.57 is the one across which its other axes are."""
    file = machine(tmp_path / "m", planar_legs(), full, "3d")
    text = file.read_text()
    right = re.search(r"1\.57079632679\d*", text)
    assert right is not None
    file.write_text(text.replace(right[0], "1.57", 1))
    assert imported(file).platform.kind == "planar"
