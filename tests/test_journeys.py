"""Journeys of new users, with README and docs only: from nothing to a pose that is commanded.

Each counts what it takes: commands, and messages on the way.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import Outcome, run
from frames import frame_of
from marks import quick
from measured import workspace
from neighbours import joint, urdf, written
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from sheets import sheet

import pincal
from pincal import Joint, Placement

Array = NDArray[np.float64]
NOISE = pincal.Noise(2e-5, 1e-4, 1e-5)


@dataclass
class Journey:
    """What was typed, and what a user had to read: refusals and warnings."""

    commands: int = 0
    messages: list[str] = field(default_factory=list)

    def types(self, *arguments: object) -> Outcome:
        """Type a command; rows are not held out, which takes its time and changes no answer."""
        outcome = run(
            *arguments, *(("--folds", 0, "--no-report") if arguments[0] == "calibrate" else ())
        )
        self.commands += 1
        said = ("warning: ", "pincal: ")
        lines = [line for line in outcome.err.splitlines() if line.startswith(said)]
        self.messages += [line for line in lines if "no noise was given" not in line]
        return outcome


def measured(mechanism: pincal.Mechanism, poses: Array) -> tuple[pincal.Mechanism, Any]:
    """Return a machine with errors of 1 mm and 1 mrad, and what is measured of it at poses."""
    truth = pincal.disturb(mechanism, 1e-3, seed=3)
    return truth, pincal.simulate(mechanism, truth, pincal.Plan(poses), NOISE, seed=3).measurements


def elsewhere(platform: pincal.Platform, poses: Array, turn: tuple[float, float, float]) -> Array:
    """Return the matrices of poses as a tracker that stands elsewhere sees them, (N, 4, 4)."""
    frame = np.eye(4)
    frame[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    frame[:3, 3] = 1.5, -0.7, 0.3 * (platform.space == 3)
    return frame @ platform.transforms(poses).as_matrix()


def in_mm_and_degrees(frame: Any) -> Any:
    """Return a table as instruments write it: mm and degrees, to their digits."""
    for column in list(frame.columns):
        for si, unit, factor in (("[m]", "[mm]", 1e3), ("[rad]", "[deg]", 180 / pi)):
            if column.endswith(si):
                frame[column.replace(si, unit)] = (frame.pop(column) * factor).round(5)
    return frame


def by_tracker(mechanism: pincal.Mechanism, poses: Array, path: Path) -> pincal.Mechanism:
    """Write what a tracker that stands elsewhere sees of a planar machine; return the machine."""
    truth, data = measured(mechanism, poses)
    platform = mechanism.platform
    seen = platform.from_matrices(elsewhere(platform, data.poses, (0.0, 0.0, 2.1)))
    frame = frame_of(replace(data, poses=seen), mechanism)
    in_mm_and_degrees(frame).to_csv(path, index=False)
    return truth


def gets_there(truth: pincal.Mechanism, command: Array, goals: Array, tolerance: float) -> bool:
    """Return whether a machine that is commanded goes to goals, but for where its frames lie.

    Distances between the positions reached are those between the goals, within a tolerance [m].
    """
    reached = pincal.forward(truth, command, goals).poses
    lengths = truth.platform.lengths
    both = [poses[:, None, :lengths] - poses[None, :, :lengths] for poses in (reached, goals)]
    gaps = [np.linalg.norm(one, axis=2) for one in both]
    return bool(np.abs(gaps[0] - gaps[1]).max() < tolerance)


def own_3rrr() -> pincal.Mechanism:
    """The 3-RRR of docs/mechanism_files.md in Python, after examples/04: home roughly known."""
    values = {"OA": 0.4, "beta": -5 * pi / 6, "l": 0.22, "L": 0.2, "ob": 0.1, "beta_b": -5 * pi / 6}
    values["gamma"] = 0.0
    leg = pincal.Leg(
        name="leg_1",
        joints=(
            Joint("shoulder", "revolute", Placement.of(values, polar=("OA", "beta")), home=1.2),
            Joint("elbow", "revolute", Placement.of(values, x="l"), home=-1.5),
            Joint("tip", "fixed", Placement.of(values, x="L")),
        ),
        point=Joint("b_1", "fixed", Placement.of(values, polar=("ob", "beta_b"))),
        sensors=(pincal.Sensor("shoulder", offset="gamma"),),
        parameters=tuple(values.items()),
    )
    platform = pincal.Platform("planar", home=(0.0, 0.0, 0.0))
    return pincal.generate("my_3RRR", leg, pincal.cyclic(3), platform, "Mine.")


def cad_3rrr(folder: Path) -> Path:
    """Write a 3-RRR as a CAD exporter does: a tree drawn at home, two loops cut open."""
    turns = np.exp(2j * pi * np.arange(3) / 3 - 5j * pi / 6)
    joints, pairs, crank, rod = [], [], 0.22, 0.2

    def text(z: complex) -> str:
        return f"{z.real:.6f} {z.imag:.6f} 0"

    for k, (base, top) in enumerate(zip(0.4 * turns, 0.1 * turns, strict=True), 1):
        reach = abs(top - base)
        bend = np.arccos((crank**2 + reach**2 - rod**2) / (2 * crank * reach))
        elbow = base + crank * np.exp(1j * (np.angle(top - base) + bend))
        joints += [joint(f"motor_{k}", "base", f"crank_{k}", text(base))]
        joints += [joint(f"elbow_{k}", f"crank_{k}", f"rod_{k}", text(elbow - base))]
        if k == 1:
            joints += [joint("wrist_1", "rod_1", "platform", text(top - elbow))]
            continue
        ends = (f"rod_{k}", f"end_{k}", top - elbow), ("platform", f"eye_{k}", top - 0.1 * turns[0])
        pairs.append([f"wrist_{k}_A", f"wrist_{k}_B"])
        joints += [
            joint(name, parent, child, text(at), "fixed")
            for name, (parent, child, at) in zip(pairs[-1], ends, strict=True)
        ]
    loops = f"closed_loop: {pairs}\ntype: ['3d', '3d']\nname_mot: [motor]\nplatform: platform\n"
    return written(folder, urdf("rrr", joints, "base"), loops)


PLANAR = np.array(
    [[0.02, 0.03, 0.1], [-0.03, 0.01, -0.1], [0.01, -0.04, 0.2], [-0.02, -0.02, -0.15]]
)
AROUND = np.array(
    [
        [r * np.cos(a), r * np.sin(a), 0.25 * np.sin(3 * a + r)]
        for r in (0.02, 0.05, 0.07)
        for a in np.arange(8) * pi / 4 + 10 * r
    ]
)


def test_own_machine_in_python_seen_by_a_tracker_that_stands_elsewhere(tmp_path: Path) -> None:
    """Three calls: define, calibrate, command; a message says what to add to the second."""
    robot = own_3rrr()
    truth = by_tracker(robot, AROUND, tmp_path / "tracker.csv")
    with pytest.raises(pincal.MeasurementError, match=r"in Python Setup\(unknown_frame=True\)"):
        pincal.calibrate(robot, tmp_path / "tracker.csv")
    setup = pincal.Setup(unknown_frame=True)
    result = pincal.calibrate(robot, tmp_path / "tracker.csv", setup=setup)
    assert result.promises
    assert str(result["tracker.x"]).startswith("tracker.x: 150")
    command = pincal.inverse(result, PLANAR).readings
    assert gets_there(truth, command, PLANAR, 1e-4)
    assert not gets_there(truth, pincal.inverse(robot, PLANAR).readings, PLANAR, 1e-4)


@pytest.mark.slow
def test_cad_urdf_seen_by_a_tracker_that_stands_elsewhere(tmp_path: Path) -> None:
    """Four commands and one message, which is what to add; the CAD file gets its numbers."""
    own, robot, csv = Journey(), tmp_path / "bar", tmp_path / "tracker.csv"
    cad, result = cad_3rrr(tmp_path / "cad"), tmp_path / "result"
    assert own.types("import", cad, "-o", robot).code == 0
    mechanism = pincal.load_mechanism(robot)
    home = np.array(mechanism.platform.home)
    truth = by_tracker(mechanism, home + AROUND, csv)
    assert own.types("calibrate", robot, csv, "-o", result).code == 2
    assert "--unknown-frame" in own.messages[-1]
    assert own.types("calibrate", robot, csv, "--unknown-frame", "-o", result).code == 0
    goals, command = tmp_path / "goals.csv", tmp_path / "command.csv"
    pincal.Plan(home + PLANAR).to_csv(goals, mechanism)
    assert own.types("inverse", result, goals, "--units", "deg", "-o", command).code == 0
    assert (own.commands, len(own.messages)) == (4, 1)
    readings = np.radians(np.loadtxt(command, delimiter=",", skiprows=1))
    assert command.read_text().startswith("leg_1 [deg],")
    assert gets_there(truth, readings, home + PLANAR, 1e-4)
    done = own.types("export", result, "--original", cad, "-o", tmp_path / "cad" / "new.urdf")
    assert done.code == 0


@pytest.mark.slow
def test_stewart_platform_with_positions_of_one_reflector(tmp_path: Path) -> None:
    """Three commands; frame and reflector are said to be unknown, each by a message's option."""
    own, csv, result = Journey(), tmp_path / "reflector.csv", tmp_path / "result"
    mechanism = pincal.load_mechanism("6UPS")
    truth, data = measured(mechanism, workspace("6UPS", 24))
    seen = elsewhere(mechanism.platform, data.poses, (0.2, -0.1, 2.1))
    reflector = (seen @ [0.05, 0.03, 0.08, 1.0])[:, :3]
    frame = frame_of(data, mechanism)
    names = ["x [m]", "y [m]", "z [m]"]
    frame[names] = reflector
    frame = frame[[*names, *(f"{name} [m]" for name in mechanism.reading_names)]]
    in_mm_and_degrees(frame).to_csv(csv, index=False)
    assert own.types("calibrate", "6UPS", csv, "-o", result).code == 2
    assert "--unknown-frame" in own.messages[-1]
    assert "--unknown-target" in own.messages[-1]
    unknown = ("--unknown-frame", "--unknown-target")
    assert own.types("calibrate", "6UPS", csv, *unknown, "-o", result).code == 0
    (tmp_path / "goals.csv").write_text(
        "x [mm],y [mm],z [mm],yaw [deg],pitch [deg],roll [deg]\n"
        "10,20,1850,2,0,1\n-50,30,1800,0,2,0\n40,-60,1870,-2,1,0\n"
    )
    command = tmp_path / "command.csv"
    assert own.types("inverse", result, tmp_path / "goals.csv", "-o", command).code == 0
    assert (own.commands, len(own.messages)) == (3, 1)
    goals = pincal.Plan.from_csv(tmp_path / "goals.csv", mechanism).poses
    readings = np.loadtxt(command, delimiter=",", skiprows=1)
    assert gets_there(truth, readings, goals, 5e-4)


def excel(mechanism: pincal.Mechanism, data: Any) -> list[list[str | float]]:
    """Return cells as people in Europe head them, with a column of numbers and one of notes."""
    head: list[str | float] = ["Nr", "X (mm)", "Y (mm)", "Z (mm)"]
    head += [*(f"{name} (°)" for name in mechanism.reading_names), "Bemerkung"]
    rows = zip((1e3 * data.poses).tolist(), np.degrees(data.readings).tolist(), strict=True)
    found: list[list[str | float]] = [head]
    for number, (pose, readings) in enumerate(rows, 1):
        values = [round(value, 4) for value in (*pose, *readings)]
        found.append([str(number), *values, "Tür offen" if number == 4 else ""])
    return found


@pytest.mark.parametrize("kind", quick(1, ["csv", "xlsx"]))
def test_european_excel(kind: str, tmp_path: Path) -> None:
    """Two commands, no message: semicolons and decimal commas, or the workbook itself."""
    own, result, path = Journey(), tmp_path / "result", tmp_path / f"messung.{kind}"
    mechanism = pincal.load_mechanism("delta")
    truth, data = measured(mechanism, workspace("delta", 40))
    cells = excel(mechanism, data)
    if kind == "csv":
        texts = [[str(one).replace(".", ",") for one in row] for row in cells]
        lines = "".join(";".join(row) + "\r\n" for row in texts)
        path.write_bytes(lines.encode("cp1252"))
    else:
        sheet(path, cells)
    assert own.types("calibrate", "delta", path, "-o", result).code == 0
    goals = tmp_path / "ziele.csv"
    goals.write_text("x [mm];y [mm];z [mm]\r\n10,5;20;-600\r\n-50;0,5;-550\r\n")
    command = tmp_path / "befehl.csv"
    assert own.types("inverse", result, goals, "-o", command).code == 0
    assert (own.commands, own.messages) == (2, [])
    poses = pincal.Plan.from_csv(goals, mechanism).poses
    readings = np.loadtxt(command, delimiter=",", skiprows=1)
    assert gets_there(truth, readings, poses, 2e-4)


def test_notebook(tmp_path: Path) -> None:
    """Whatever stands last in a cell shows itself in a line or a page."""
    robot = pincal.load_mechanism("5R")
    selection = pincal.select_poses(robot, workspace("5R", 500), 12)
    truth, data = measured(robot, selection.plan.poses)
    in_mm_and_degrees(frame_of(data, robot)).to_csv(tmp_path / "m.csv", index=False)
    result = pincal.calibrate(robot, tmp_path / "m.csv").validated()
    assert result.promises
    assert str(result["leg_1.l"]).startswith("leg_1.l: 7")
    last = [robot, selection, selection.plan, data, result, result.validation, result.identified]
    last += [result.expected_error(), result.leg("leg_1"), pincal.inverse(result, [[0.0, 0.5]])]
    for one in last:
        assert len(repr(one).splitlines()) == 1 or hasattr(one, "_repr_html_") or str(one)
        assert len(repr(one)) < 200
        assert "array(" not in repr(one)
        assert " object at 0x" not in repr(one)
    assert "<table" in result._repr_html_()
    goals = np.array([[0.0, 0.5], [0.1, 0.6], [-0.2, 0.4]])
    assert gets_there(truth, pincal.inverse(result, goals).readings, goals, 2e-4)


def test_a_calibration_that_did_not_converge_commands_nothing() -> None:
    """A result stands for its calibrated mechanism, if it has one."""
    robot = pincal.load_mechanism("5R")
    _, data = measured(robot, workspace("5R", 20))
    result = replace(pincal.calibrate(robot, data, noise=NOISE), converged=False)
    with pytest.raises(pincal.MechanismError, match="did not converge"):
        pincal.inverse(result, [[0.0, 0.5]])
