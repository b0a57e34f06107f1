"""Mechanism folders: what is saved loads equal, whole or not at all; bad input is named."""

from __future__ import annotations

import logging
import os
import re
import shutil
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yourdfpy
from command_line import unnamed
from measured import workspace
from neighbours import skeleton

import pincal
from pincal import FileError, MechanismError, PincalError
from pincal.files import mechanism_folders
from pincal.files.mechanism_folders import bundled
from pincal.files.urdf import leg_links, leg_urdf, platform_urdf
from pincal.kinematics.closure import LegClosure
from pincal.model.consistency import home_gap
from pincal.workspace.criteria import in_workspace

YAML, LEG, PLATFORM = "mechanism.yaml", "leg_1.urdf", "platform.urdf"
Edit = tuple[str, str, str]  # file, text in it, replacement (everywhere)


def contents(folder: Path) -> dict[str, bytes]:
    """Return the bytes of all files below a folder, by relative path."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def names(folder: Path) -> list[str]:
    """Return the names of what is in a folder."""
    return sorted(path.name for path in folder.iterdir())


def edit(folder: Path, *edits: Edit) -> None:
    """Replace texts in files of a folder; each text must be there."""
    for name, old, new in edits:
        text = (folder / name).read_text(encoding="utf-8")
        assert old in text, f"{old!r} is not in {name}: the test is out of date"
        (folder / name).write_text(text.replace(old, new), encoding="utf-8")


def mixed() -> pincal.Mechanism:
    """Return a mechanism with prismatic, continuous and turned fixed joints, and a constant."""
    values = {"a": 0.4, "turn": 0.3, "l": 0.7, "r": 0.2, "azimuth": 2.0, "gamma": 0.05}
    rail = pincal.Placement.of(values, rz="turn", x="a", y=-0.25)
    joints = (
        pincal.Joint(
            "rail", "prismatic", rail, axis=(0.6, 0.8, 0.0), lower=0.0, upper=0.5, home=0.2
        ),
        pincal.Joint(
            "bracket", "fixed", pincal.Placement(xyz=(0.1, 0.0, 0.0), rpy=(0.0, 0.0, -0.4))
        ),
        pincal.Joint("crank", "revolute", lower=-np.inf, upper=np.inf, home=0.5),
        pincal.Joint("end", "fixed", pincal.Placement.of(values, x="l")),
    )
    point = pincal.Joint("p", "fixed", pincal.Placement.of(values, polar=("r", "azimuth")))
    sensor = pincal.Sensor("rail", form="reading", gain=2.0, offset="gamma", direction=-1, zero=0.1)
    leg = pincal.Leg("leg_1", joints, (sensor,), tuple(values.items()), point)
    tip = LegClosure(leg, pincal.Platform("planar", (0.0, 0.0, 0.0))).tips(leg.home[None])[0]
    x, y, _ = (float(v) for v in tip - np.array(point.placement.xyz))
    return pincal.Mechanism("mixed: 1", pincal.Platform("planar", (x, y, 0.0)), (leg,), "å 'b' #")


MECHANISMS: dict[str, Callable[[], pincal.Mechanism]] = {
    "3RRR": lambda: pincal.load_mechanism("3RRR"),
    "5R": lambda: pincal.load_mechanism("5R"),
    "mixed": mixed,
    **{
        f"{kind}-seed{seed}": lambda kind=kind, seed=seed: pincal.disturb(
            pincal.load_mechanism(kind), 0.1 ** (seed + 1), seed
        )
        for kind in ("3RRR", "5R")
        for seed in range(1, 6)
    },
}


@pytest.fixture(params=MECHANISMS)
def sample(request: pytest.FixtureRequest) -> pincal.Mechanism:
    """Bundled, disturbed (by 1e-2 to 1e-6) and mixed mechanisms."""
    return MECHANISMS[request.param]()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Copy of the bundled 3RRR folder."""
    return Path(shutil.copytree(bundled()["3RRR"], tmp_path / "copy"))


def test_saved_mechanism_loads_equal(sample: pincal.Mechanism, tmp_path: Path) -> None:
    """What is saved loads equal, floats bit for bit."""
    assert pincal.load_mechanism(sample.save(tmp_path / "m")) == sample


def test_saving_twice_gives_the_same_bytes(sample: pincal.Mechanism, tmp_path: Path) -> None:
    """A mechanism, and the same one loaded from its folder, are written with the same bytes."""
    first = sample.save(tmp_path / "a")
    again = pincal.load_mechanism(first).save(tmp_path / "b")
    assert contents(first) == contents(again)
    assert set(contents(first)) == {YAML, PLATFORM} | {f"{n}.urdf" for n in sample.leg_names}


def test_bundled_folder_is_what_saving_writes(kind: str, tmp_path: Path) -> None:
    """A bundled folder holds the bytes that saving its mechanism gives."""
    saved = pincal.load_mechanism(kind).save(tmp_path / "m")
    assert contents(saved) == contents(bundled()[kind])


def test_existing_folder_is_refused(folder: Path) -> None:
    """Without force an existing folder is refused by name and stays as it was."""
    before = contents(folder)
    with pytest.raises(FileError, match="copy exists"):
        pincal.load_mechanism("5R").save(folder)
    assert contents(folder) == before
    assert names(folder.parent) == ["copy"]


def test_force_replaces_the_whole_mechanism(folder: Path) -> None:
    """With force nothing of the old mechanism is left but its backup, and no scratch beside it."""
    before = contents(folder)
    five = pincal.load_mechanism("5R")
    five.save(folder, force=True)
    assert pincal.load_mechanism(folder) == five
    assert sorted(contents(folder)) == ["leg_1.urdf", "leg_2.urdf", YAML, PLATFORM]
    assert names(folder.parent) == ["copy", "copy.bak"]
    assert contents(folder.with_name("copy.bak")) == before


def test_force_spares_a_folder_that_is_no_mechanism(tmp_path: Path) -> None:
    """Even with force a folder that pincal did not write is refused and stays as it was."""
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "thesis.tex").write_text("years of work")
    with pytest.raises(FileError, match="home"):
        pincal.load_mechanism("5R").save(tmp_path / "home", force=True)
    assert contents(tmp_path) == {"home/thesis.tex": b"years of work"}


def test_force_spares_a_file_in_the_folders_place(tmp_path: Path) -> None:
    """A file is not replaced by a folder: it is refused by name and stays as it was."""
    (tmp_path / "taken").write_text("keep")
    with pytest.raises(FileError, match="taken"):
        pincal.load_mechanism("5R").save(tmp_path / "taken", force=True)
    assert contents(tmp_path) == {"taken": b"keep"}


def test_missing_parent_is_refused(tmp_path: Path) -> None:
    """A folder below one that does not exist is refused by name and nothing is made."""
    with pytest.raises(FileError, match="absent"):
        pincal.load_mechanism("5R").save(tmp_path / "absent" / "m")
    assert names(tmp_path) == []


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
@pytest.mark.parametrize("force", [False, True])
def test_failed_saving_leaves_nothing(
    folder: Path, error: BaseException, force: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a failure in mid-saving there is no new folder, no scratch, and the old one stays."""
    before = contents(folder)

    def fail(*_: object) -> str:
        raise error

    monkeypatch.setattr(mechanism_folders, "platform_urdf", fail)  # written last
    target = folder if force else folder.parent / "new"
    expected = FileError if isinstance(error, OSError) else KeyboardInterrupt
    with pytest.raises(expected) as caught:
        pincal.load_mechanism("5R").save(target, force=force)
    assert expected is KeyboardInterrupt or f"{target}: No space left" in str(caught.value)
    assert names(folder.parent) == ["copy"]
    assert contents(folder) == before


def test_failed_exchange_keeps_the_old_folder(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If the new folder cannot take the old one's place, the old one stays as it was."""
    before, rename = contents(folder), os.rename

    def fail_into_place(source: Path, target: Path) -> None:
        if Path(target) == folder and "5R" in (Path(source) / YAML).read_text():
            raise OSError(5, "Input/output error")
        rename(source, target)

    monkeypatch.setattr(os, "rename", fail_into_place)
    with pytest.raises(FileError, match="copy"):
        pincal.load_mechanism("5R").save(folder, force=True)
    assert names(folder.parent) == ["copy"]
    assert contents(folder) == before


def test_readers_agree_on_the_tip(sample: pincal.Mechanism) -> None:
    """Pinocchio and yourdfpy put the tip within 1e-12 m of pincal at random joint positions."""
    rng = np.random.default_rng(0)
    for leg in sample.legs:
        closure = LegClosure(leg, sample.platform)
        for joints in rng.uniform(-np.pi, np.pi, (4, len(leg.moving))):
            own = closure.tips(joints[None])[0]
            robot = yourdfpy.URDF.load(BytesIO(leg_urdf(leg).encode()), load_meshes=False)
            robot.update_cfg({j.name: float(v) for j, v in zip(leg.moving, joints, strict=True)})
            for tip in (skeleton(leg, joints)[-1], robot.get_transform(leg_links(leg)[-1])[:3, 3]):
                np.testing.assert_allclose(tip, own, rtol=0.0, atol=1e-12)


def test_names_in_written_files_are_of_one_frame_each(sample: pincal.Mechanism) -> None:
    """Pinocchio finds every joint and link of a leg and of the platform by its name alone."""
    for text in (*map(leg_urdf, sample.legs), platform_urdf(sample.name, sample.legs)):
        model = pin.buildModelFromXML(text)
        names = [frame.name for frame in model.frames]
        assert [model.getFrameId(name) for name in names] == list(range(len(names)))


def test_written_legs_load_elsewhere(sample: pincal.Mechanism, tmp_path: Path) -> None:
    """The URDF files load in Pinocchio and yourdfpy, with all joints and links by name."""
    saved = sample.save(tmp_path / "m")
    for leg in sample.legs:
        path = str(saved / f"{leg.name}.urdf")
        model = pin.buildModelFromUrdf(path)
        assert list(model.names)[1:] == [joint.name for joint in leg.moving]
        robot = yourdfpy.URDF.load(path)
        assert robot.actuated_joint_names == [joint.name for joint in leg.moving]
        assert len(robot.robot.links) == len(leg.joints) + 1
        names = [*(joint.name for joint in leg.joints), *(link.name for link in robot.robot.links)]
        assert all(model.getFrameId(name) < model.nframes for name in names)  # each name one frame


def test_platform_loads_elsewhere_with_its_points(sample: pincal.Mechanism, tmp_path: Path) -> None:
    """The platform's URDF loads in yourdfpy and has each platform point where the leg has it."""
    robot = yourdfpy.URDF.load(str(sample.save(tmp_path / "m") / PLATFORM))
    for leg in sample.legs:
        origin = robot.get_transform(f"{leg.point.name}_link", "platform")
        np.testing.assert_allclose(origin, leg.point.placement.origin(), atol=1e-15)


def test_legs_share_no_platform_point_with_parameters() -> None:
    """Legs on one point, each with parameters of it, are refused by name."""
    five, values = pincal.load_mechanism("5R"), {"r": 0.1, "azimuth": 0.5}
    placement = pincal.Placement.of(values, polar=("r", "azimuth"))
    point = pincal.Joint("end_effector", "fixed", placement)
    legs = tuple(
        replace(leg, point=point, parameters=(*leg.parameters, *values.items()))
        for leg in five.legs
    )
    home = tuple(c - p for c, p in zip(five.platform.home, placement.xyz, strict=False))
    with pytest.raises(MechanismError, match=r"leg_1 and leg_2 share .* 'end_effector'"):
        replace(five, legs=legs, platform=pincal.Platform("point", home))


def test_leg_names_do_not_collide_with_the_platforms_file(folder: Path) -> None:
    """A leg called 'platform' is refused."""
    edit(folder, (YAML, "- name: leg_1", "- name: platform"))
    with pytest.raises(MechanismError, match="a leg is named 'platform'"):
        pincal.load_mechanism(folder)


AXIS = '<axis xyz="0.0 0.0 1.0"/>'
LIMITS = 'lower="-6.283185307179586" upper="6.283185307179586"'
LIMIT = f'<limit effort="0" velocity="0" {LIMITS}/>'
ELBOW = '<origin xyz="1.5 0.0 0.0" rpy="0.0 0.0 0.0"/>'
HOME = "home: {shoulder:"
SHOULDERS = (1.047197551197, 3.14159265359, -1.047197551197)


def more(text: str) -> Edit:
    """Return the edit that adds elements to the leg's URDF."""
    return LEG, "</robot>", f"{text}</robot>"


def joint(name: str, parent: str, child: str) -> str:
    """Return a fixed joint as URDF."""
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="fixed">{ends}</joint>'


#: What is wrong: the edits that make it so, the file or place named, and the offender named.
BAD: dict[str, tuple[list[Edit], list[str]]] = {
    # leg's URDF
    "urdf-not-xml": ([(LEG, "</robot>", "")], [LEG, "parse", "line"]),
    "urdf-empty-root": ([(LEG, "robot", "machine")], [LEG, "<robot>", "<machine>"]),
    "urdf-loop": ([more(joint("back", "leg_1_tip", "leg_1_base"))], [LEG, "0 root links"]),
    "urdf-two-parents": (
        [more('<link name="other"/>' + joint("again", "other", "leg_1_tip"))],
        [LEG, "'leg_1_tip'", "two joints"],
    ),
    "urdf-two-roots": ([more('<link name="alone"/>')], [LEG, "2 root links", "alone"]),
    "joint-floating": (
        [(LEG, 'type="revolute"', 'type="floating"')],
        [YAML, "leg_1", "'shoulder'", "shoulder_px, shoulder_py"],
    ),
    "joint-planar": (
        [(LEG, 'type="revolute"', 'type="planar"')],
        [LEG, "line", "'shoulder'", "'planar'"],
    ),
    "joint-without-type": ([(LEG, ' type="revolute"', "")], [LEG, "line", "'shoulder'", "type"]),
    "joint-without-name": ([(LEG, ' name="shoulder"', "")], [LEG, "line", "name"]),
    "joint-without-child": (
        [(LEG, '<child link="leg_1_elbow_link"/>', "")],
        [LEG, "line", "'elbow'", "child"],
    ),
    "joint-mimic": (
        [
            (LEG, '"elbow" type="revolute">', '"elbow" type="revolute"><mimic joint="knee"/>'),
            (YAML, ", elbow: -1.047197551197}", "}"),
        ],
        ["leg_1", "'elbow'", "follows 'knee'"],
    ),
    "joint-name-twice": (
        [
            (LEG, 'name="tip" type="fixed"', 'name="elbow" type="fixed"'),
            (YAML, "    tip:\n    - {x: L}\n", ""),
            (YAML, "    L: 1.5\n", ""),
        ],
        [LEG, "two joints are called 'elbow'"],
    ),
    "axis-zero": ([(LEG, AXIS, '<axis xyz="0 0 0"/>')], [LEG, "line", "'shoulder'", "axis"]),
    "axis-in-plane": ([(LEG, AXIS, '<axis xyz="1 0 0"/>')], [YAML, "leg_1", "'shoulder'", "plane"]),
    "limits-reversed": (
        [(LEG, LIMITS, 'lower="2" upper="1"')],
        [LEG, "line", "'shoulder'", "2 to 1", "lower"],
    ),
    "limits-nan": ([(LEG, LIMITS, 'lower="nan" upper="1"')], [LEG, "line", "'nan'", "finite"]),
    "origin-text": ([(LEG, "1.5 0.0 0.0", "1.5 zero 0.0")], [LEG, "line", "'zero'", "number"]),
    "origin-nan": ([(LEG, "1.5 0.0 0.0", "1.5 nan 0.0")], [LEG, "line", "'nan'", "finite"]),
    "origin-inf": ([(LEG, "1.5 0.0 0.0", "1.5 1e999 0")], [LEG, "line", "'1e999'", "finite"]),
    "origin-short": ([(LEG, "1.5 0.0 0.0", "1.5 0.5")], [LEG, "line", "'1.5 0.5'", "three"]),
    "origin-turned-up": (
        [(LEG, ELBOW, ELBOW.replace('rpy="0.0', 'rpy="0.5'))],
        [YAML, "leg_1", "'elbow'", "plane"],
    ),
    "nothing-moves": ([(LEG, 'type="revolute"', 'type="fixed"')], [LEG, "moves", "'leg_1_tip'"]),
    # names between the files
    "tip-unknown": ([(YAML, "  tip: leg_1_tip\n", "  tip: hand\n")], [LEG, "'hand'", "leg_1_base"]),
    "tip-before-the-chain": (
        [(YAML, "  tip: leg_1_tip\n", "  tip: leg_1_base\n")],
        [LEG, "moves", "'leg_1_base'"],
    ),
    "active-unknown": ([(YAML, "joint: shoulder", "joint: wrist")], [YAML, "leg_1", "'wrist'"]),
    "active-fixed": ([(YAML, "joint: shoulder", "joint: tip")], [YAML, "leg_1", "'tip'", "moving"]),
    "placement-unknown": (
        [(YAML, "    elbow:\n", "    knee:\n")],
        [YAML, "leg_1", "'knee'", "elbow"],
    ),
    "point-unknown": (
        [(YAML, "platform_point: b_1", "platform_point: b_9")],
        [YAML, "leg_1", "'b_9'", "b_2"],
    ),
    "home-lacks-joint": (
        [(YAML, HOME, "home: {shoulder: 1.0} #")],
        [YAML, "leg_1", "home", "elbow"],
    ),
    "home-of-unknown-joint": (
        [(YAML, HOME, "home: {wrist: 0.0, shoulder:")],
        [YAML, "leg_1", "'wrist'"],
    ),
    "frame-on-a-frame": (
        [
            (
                PLATFORM,
                '"platform"/>\n    <child link="b_2_link"',
                '"b_1_link"/>\n    <child link="b_2_link"',
            )
        ],
        ["b_2"],
    ),
    # mechanism.yaml
    "yaml-not-yaml": ([(YAML, "legs:\n", "legs: [\n")], [YAML, "parse", "line"]),
    "yaml-list": ([(YAML, "pincal: 1\n", "- 1\n"), (YAML, "name: 3RRR\n", "")], [YAML]),
    "yaml-version": ([(YAML, "pincal: 1", "pincal: 2")], [YAML, "pincal", "got 2"]),
    "key-unknown": ([(YAML, "description:", "remark:")], [YAML, "'remark'", "unknown"]),
    "zero-word": ([(YAML, "zero: 0.0", "zero: house")], [YAML, "sensors.0.zero", "'home'"]),
    "zero-infinite": ([(YAML, "zero: 0.0", "zero: .inf")], [YAML, "sensors.0.zero", "'home'"]),
    "key-misspelt": ([(YAML, "form: joint", "forms: joint")], [YAML, "sensors.0.forms", "'form'?"]),
    "key-missing": ([(YAML, "  tip: leg_1_tip\n", "")], [YAML, "tip", "missing"]),
    "key-twice": ([(YAML, "    k: 1.0\n", "    k: 1.0\n    k: 1.1\n")], [YAML, "k"]),
    "type-wrong": ([(YAML, "    l: 1.5\n", "    l: long\n")], [YAML, "parameters.l", "'long'"]),
    "type-boolean": ([(YAML, "    k: 1.0\n", "    k: true\n")], [YAML, "parameters.k", "True"]),
    "value-nan": ([(YAML, "    l: 1.5\n", "    l: .nan\n")], [YAML, "parameters.l", "finite"]),
    "value-inf": ([(YAML, "    l: 1.5\n", "    l: -.inf\n")], [YAML, "parameters.l", "finite"]),
    "value-huge": ([(YAML, "    l: 1.5\n", f"    l: 1{'0' * 400}\n")], [YAML, "parameters.l"]),
    "home-nan": (
        [(YAML, HOME, "home: {shoulder: .nan, elbow: 0.0} #")],
        [YAML, "home.shoulder", "finite"],
    ),
    "parameter-undeclared": ([(YAML, "    L: 1.5\n", "")], [YAML, "leg_1", "'L'", "parameters"]),
    "parameter-unused": (
        [(YAML, "    k: 1.0\n", "    k: 1.0\n    spare: 2.0\n")],
        [YAML, "leg_1", "'spare'"],
    ),
    "leg-name-twice": ([(YAML, "- name: leg_2", "- name: leg_1")], [YAML, "leg_1", "repeat"]),
    "gain-zero": ([(YAML, "    k: 1.0\n", "    k: 0.0\n")], [YAML, "leg_1", "gain", "zero"]),
    "direction-two": ([(YAML, "direction: 1", "direction: 2")], [YAML, "direction", "got 2"]),
    "placement-disagrees": (
        [(YAML, "    l: 1.5\n", "    l: 1.6\n")],
        [YAML, "leg_1", "'elbow'", "1.5", "1.6"],
    ),
    "coordinate-unknown": (
        [(YAML, "polar: [OA, beta]", "oval: [OA, beta]")],
        [YAML, "leg_1", "'shoulder'", "'oval'", "polar"],
    ),
    "coordinate-short": (
        [(YAML, "polar: [OA, beta]", "polar: [OA]")],
        [YAML, "leg_1", "'shoulder'", "'polar'", "2"],
    ),
    "coordinate-long": (
        [(YAML, "{x: l}", "{x: [l, L]}")],
        [YAML, "leg_1", "'elbow'", "'x'", "'L'"],
    ),
    "platform-unknown": (
        [(YAML, "kind: planar", "kind: hovering")],
        [YAML, "'hovering'", "planar"],
    ),
    "platform-home-short": (
        [(YAML, "{x: 0.0, y: 0.0, phi: 0.0}", "{x: 0.0, y: 0.0}")],
        [YAML, "home", "phi"],
    ),
    "path-up": ([(YAML, "urdf: leg_1.urdf", "urdf: ../leg_1.urdf")], [YAML, "'../leg_1.urdf'"]),
    "path-absolute": ([(YAML, "urdf: leg_1.urdf", "urdf: /etc/hosts")], [YAML, "'/etc/hosts'"]),
    "path-with-nul": ([(YAML, "urdf: leg_1.urdf", r'urdf: "leg\0.urdf"')], [YAML, "leg"]),
    "name-with-control": ([(YAML, "name: 3RRR", r'name: "3\x01RRR"')], [YAML, "name"]),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_mechanism_is_refused_by_name(case: str, folder: Path) -> None:
    """A fault raises MechanismError; its message names the place and the offender."""
    edits, named = BAD[case]
    edit(folder, *edits)
    with pytest.raises(MechanismError) as caught:
        pincal.load_mechanism(folder)
    message = str(caught.value)
    assert isinstance(caught.value, PincalError)
    assert str(folder) in message
    assert unnamed(named, message) == [], message


def test_a_leg_is_the_chain_to_its_tip(folder: Path) -> None:
    """Links beside the chain, and limits that are not said, change nothing of where it reaches."""
    poses = np.array([[0.1, 0.2, 0.1], [0.0, -0.1, 0.3]])
    expected = pincal.inverse(pincal.load_mechanism(folder), poses).readings
    edit(folder, more('<link name="twig"/>' + joint("twig", "leg_1_elbow_link", "twig")))
    edit(folder, (LEG, LIMIT, ""))
    readings = pincal.inverse(pincal.load_mechanism(folder), poses).readings
    np.testing.assert_array_equal(readings, expected)


@pytest.mark.parametrize("name", [YAML, LEG, PLATFORM])
def test_missing_file_is_named(name: str, folder: Path) -> None:
    """A file that is missing raises FileError with its path."""
    (folder / name).unlink()
    with pytest.raises(FileError) as caught:
        pincal.load_mechanism(folder)
    if name == YAML:
        assert f"'{folder}' is no mechanism folder: it has no {YAML}" in str(caught.value)
    else:
        assert f"{folder / name}: No such file" in str(caught.value)


def test_unknown_mechanism_names_the_bundled_ones(tmp_path: Path) -> None:
    """A name that is neither folder nor bundled lists these; a file brings how to import it."""
    with pytest.raises(FileError, match=r"'nowhere'.*3RRR, 4cable, 5R"):
        pincal.load_mechanism("nowhere")
    with pytest.raises(FileError, match="absent"):
        pincal.load_mechanism(tmp_path / "absent")
    (tmp_path / "robot.urdf").write_text("<robot name='r'/>")
    with pytest.raises(FileError, match=r"pincal import .*robot\.urdf -o MECH"):
        pincal.load_mechanism(tmp_path / "robot.urdf")


def test_nearly_the_name_of_a_bundled_one_is_asked_about() -> None:
    """Other case or a slip brings the question which one is meant; a wholly other name does not."""
    for name, meant in (("3rrr", "3RRR"), ("6ups", "6UPS"), ("linear-delta", "linear_delta")):
        with pytest.raises(FileError, match=f"did you mean '{meant}'"):
            pincal.load_mechanism(name)
    with pytest.raises(FileError) as caught:
        pincal.load_mechanism("nowhere")
    assert "did you mean" not in str(caught.value)


def test_overlong_name_is_a_file_error(tmp_path: Path) -> None:
    """A path longer than the file system takes raises FileError, for reading and writing."""
    path = tmp_path / ("m" * 300)
    with pytest.raises(FileError):
        pincal.load_mechanism(path)
    with pytest.raises(FileError):
        pincal.load_mechanism("5R").save(path)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        pytest.param(b"", "empty", id="empty"),
        pytest.param(b"\xff\xfename", "UTF-8", id="not-utf-8"),
        pytest.param(b"[" * 100_000, "parse", id="deep"),
        pytest.param(b"# padding\n" * 200_000, ": larger than 1 MiB", id="large"),
    ],
)
def test_file_that_is_no_yaml_is_refused(data: bytes, words: str, folder: Path) -> None:
    """A mechanism.yaml that is no such thing raises MechanismError that says what it is."""
    (folder / YAML).write_bytes(data)
    with pytest.raises(MechanismError) as caught:
        pincal.load_mechanism(folder)
    message = str(caught.value)
    assert message.startswith((f"{folder / YAML}: ", f"{folder / YAML}, line 1: "))
    assert words in message
    assert "_Mechanism" not in message  # a name from inside pincal tells people nothing
    assert message.count(str(folder)) == 1


def test_yaml_constructs_no_objects(folder: Path) -> None:
    """A YAML tag that would run a command is refused, and the command is not run."""
    trace = folder.parent / "executed"
    command = f"!!python/object/apply:os.system ['touch {trace}']"
    edit(folder, (YAML, "name: 3RRR", f"name: {command}"))
    with pytest.raises(MechanismError, match=r"mechanism\.yaml.*os\.system"):
        pincal.load_mechanism(folder)
    assert not trace.exists()


def memory_of_failure(folder: Path) -> int:
    """Return the peak of memory taken by loading a folder that is refused, [bytes]."""
    tracemalloc.start()
    try:
        with pytest.raises(MechanismError):
            pincal.load_mechanism(folder)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("key", ["name", "description", "home"])
def test_yaml_aliases_do_not_explode(key: str, folder: Path) -> None:
    """Aliases that stand for a million strings are refused without being written out."""
    lines = ["bomb:", "- &l0 [a, a, a, a, a, a, a, a, a, a]"]
    lines += [f"- &l{i} [{', '.join([f'*l{i - 1}'] * 10)}]" for i in range(1, 6)]
    value = {
        "name": "name: 3RRR",
        "description": "description:",
        "home": "{x: 0.0, y: 0.0, phi: 0.0}",
    }
    bomb = {"name": "name: *l5", "description": "description: *l5 #", "home": "*l5"}
    text = (folder / YAML).read_text().replace(value[key], bomb[key])
    (folder / YAML).write_text("\n".join(lines) + "\n" + text)
    assert memory_of_failure(folder) < 2e6


@pytest.mark.parametrize("place", ['xyz="1.5 0.0 0.0"', '<joint name="elbow" type="revolute">'])
def test_urdf_entities_do_not_explode(place: str, folder: Path) -> None:
    """Entities that stand for ten billion characters are refused without being written out."""
    entities = '<!ENTITY l0 "1.5">' + "".join(
        f'<!ENTITY l{i} "{f"&l{i - 1};" * 10}">' for i in range(1, 11)
    )
    bomb = place.replace("1.5", "&l10;") if "xyz" in place else f"{place}&l10;"
    edit(folder, (LEG, place, bomb), (LEG, "<robot", f"<!DOCTYPE robot [{entities}]><robot"))
    with pytest.raises(MechanismError, match=r"leg_1\.urdf.*parse"):
        pincal.load_mechanism(folder)
    assert memory_of_failure(folder) < 2e6


def test_urdf_entities_read_no_files(folder: Path) -> None:
    """An entity that stands for another file does not bring that file in."""
    (folder / "secret").write_text("1.5")
    entity = f'<!DOCTYPE robot [<!ENTITY e SYSTEM "file://{folder / "secret"}">]><robot'
    edit(folder, (LEG, "1.5 0.0 0.0", "&e; 0.0 0.0"), (LEG, "<robot", entity))
    with pytest.raises(MechanismError, match=r"leg_1\.urdf"):
        pincal.load_mechanism(folder)


def test_rough_home_says_only_on_which_side_a_leg_bends(folder: Path) -> None:
    """A home where a leg's tip misses its platform point gives the readings of the exact one."""
    exact = pincal.load_mechanism(folder)
    edit(folder, *((YAML, f"shoulder: {at},", f"shoulder: {at - 0.1},") for at in SHOULDERS))
    rough = pincal.load_mechanism(folder)
    assert rough != exact
    poses = pincal.sample_workspace(exact, 200)
    assert in_workspace(rough, poses).all()
    readings = pincal.inverse(rough, poses).readings
    np.testing.assert_allclose(readings, pincal.inverse(exact, poses).readings, atol=1e-12)


def test_home_within_disturbance_still_loads(tmp_path: Path) -> None:
    """A disturbed mechanism, whose home closes to its parameters' errors only, loads."""
    three = pincal.load_mechanism("3RRR")
    leg = three.legs[0].with_home(three.legs[0].home + 1e-3)
    near = replace(three, legs=(leg, *three.legs[1:]))
    assert pincal.load_mechanism(near.save(tmp_path / "m")) == near


WIDE = {
    "degrees": (HOME, "home: {shoulder: 60, elbow: -60} #", "is this degrees (1.0472 rad)?"),
    "wrong-side": (HOME, "home: {shoulder: 1.047, elbow: 1.047} #", "'home' of leg_1"),
    "platform": ("y: 0.0, phi: 0.0}", "y: 0.0, phi: 30.0}", "phi of the platform is 30"),
    "millimetres": ("home: {x: 0.0, y", "home: {x: 400, y", "or of the platform"),
}


@pytest.mark.parametrize("case", WIDE)
def test_home_that_leaves_a_leg_open_is_refused(case: str, folder: Path) -> None:
    """A gap at home beyond a tenth of the leg is refused; angles beyond a turn are asked about."""
    old, new, said = WIDE[case]
    edit(folder, (YAML, old, new))
    with pytest.raises(MechanismError, match="leg_1 does not close at home") as caught:
        pincal.load_mechanism(folder)
    assert said in str(caught.value)


def test_home_beyond_a_turn_that_closes_is_taken(folder: Path) -> None:
    """Positions of a turn more close the leg as well: nothing is asked about them."""
    exact = pincal.load_mechanism(folder)
    turns = ((YAML, f"shoulder: {at},", f"shoulder: {at + 2 * np.pi},") for at in SHOULDERS)
    edit(folder, *turns)
    turned = pincal.load_mechanism(folder)
    poses = pincal.sample_workspace(exact, 50)
    assert in_workspace(turned, poses).all()


@pytest.mark.parametrize("name", bundled())
def test_gap_at_home_is_that_of_the_closure(name: str) -> None:
    """The gap of the model's own chain is that of Pinocchio's closure, home bent by 0.01."""
    mechanism = pincal.load_mechanism(name)
    T = mechanism.platform.home_pose.as_matrix()
    for leg in mechanism.legs:
        bent = leg.with_home(leg.home + 0.01)
        c = LegClosure(bent, mechanism.platform).evaluate(bent.home[None], T).gap[0]
        n = len([row for row in mechanism.platform.closing(leg.every_end[0]) if row < 3])
        expected = max(np.linalg.norm(c[:n]), np.linalg.norm(c[n:]))
        assert max(home_gap(bent, mechanism.platform)) == pytest.approx(expected, rel=1e-9)


FAULTS = {
    "brace": ("phi: 0.0}", "phi: 0.0", [", line 9", "begins in line 8", "expected ',' or '}'"]),
    "tab": ("  kind: planar", "\tkind: planar", [", line 6", "not by tabs"]),
    "misspelt": ("  sensors:", "  sensor:", [", line 15", "legs.leg_1.sensor'", "'sensors'?"]),
    "misspelt-choice": ("offset: gamma", "ofset: gamma", [", line 16", "mean 'offset'?"]),
    "unlike": ("form: joint", "quark: joint", [", line 16", "expected joint, form, gain"]),
    "decimal-comma": ("    l: 1.5", "    l: 0,02", [", line 18", "one decimal point", "'0,02'"]),
    "unit": ("- {x: l}", "- {x: 0.02mm}", [", line 30", "elbow.0.x: '0.02mm'", "m or rad"]),
    "key-number": ("{shoulder:", "{shoulder: 0,5, q:", [", line 14", "decimals take a point"]),
    "missing": ("  tip: leg_1_tip\n", "", [", line 10", "'legs.leg_1.tip' is missing"]),
}


@pytest.mark.parametrize("case", FAULTS)
def test_fault_in_yaml_is_told_by_line_and_key(case: str, folder: Path) -> None:
    """The line is that of the fault, an unknown key comes before what is missing for it."""
    old, new, said = FAULTS[case]
    text = (folder / YAML).read_text()
    assert old in text
    (folder / YAML).write_text(text.replace(old, new, 1))
    with pytest.raises(MechanismError) as caught:
        pincal.load_mechanism(folder)
    message = str(caught.value)
    assert [part for part in said if part not in message] == [], message
    assert "Value error" not in message
    assert "more)" not in message or case == "unlike"


@pytest.mark.parametrize(
    "data", [b"", b"\n", b"\0" * 100, b"\xff\xfe", b"null", b"<robot>\0</robot>"]
)
def test_what_is_no_xml_is_refused(data: bytes, folder: Path) -> None:
    """Nothing, zeros and marks of other encodings in the place of a URDF are named with a line."""
    (folder / LEG).write_bytes(data)
    with pytest.raises(MechanismError, match=rf"{LEG}, line \d: the file does not parse: "):
        pincal.load_mechanism(folder)


def test_fault_in_xml_is_told_by_its_line(folder: Path) -> None:
    """A URDF that does not parse is named with the line, once."""
    (folder / LEG).write_text('<robot name="a">\n<link name="b">\n</robot>\n')
    with pytest.raises(MechanismError) as caught:
        pincal.load_mechanism(folder)
    message = str(caught.value)
    assert f"{LEG}, line 3: the file does not parse: Opening and ending tag mismatch" in message
    assert "<string>" not in message
    assert "column" not in message


@pytest.mark.parametrize("number", ["0,02", "0.02mm"])
def test_number_of_a_urdf_with_comma_or_unit_is_explained(number: str, folder: Path) -> None:
    """A decimal comma or a unit in a URDF is named with its line and what is expected."""
    edit(folder, (LEG, "1.5 0.0 0.0", f"{number} 0.0 0.0"))
    with pytest.raises(
        MechanismError, match=rf"line \d+: '{number}' is not a finite number: .*point.*m or rad"
    ):
        pincal.load_mechanism(folder)


def test_what_was_identified_is_read_whatever_its_home(folder: Path) -> None:
    """A result's mechanism keeps the nominal home, which need not close with its parameters."""
    edit(folder, (YAML, HOME, "home: {shoulder: 0.1, elbow: -1.0} #"))
    (folder.parent / "result.json").write_text("{}")
    folder.rename(folder.parent / "mechanism")
    assert pincal.load_mechanism(folder.parent).name == "3RRR"


def test_orientations_said_in_two_ways_are_refused(tmp_path: Path) -> None:
    """Columns of tilt and torsion beside a quaternion: which of them holds, nobody knows."""
    mechanism = pincal.load_mechanism("6UPS")
    header = "x [m],y [m],z [m],azimuth [rad],tilt [rad],torsion [rad],qw [1],qx [1],qy [1],qz [1]"
    path = tmp_path / "poses.csv"
    path.write_text(f"{header}\n0,0,1.7,0,0.3,0,1,0,0,0\n")
    with pytest.raises(
        pincal.MeasurementError, match=r"poses\.csv: the orientation is given in 2 ways"
    ):
        pincal.Plan.from_csv(path, mechanism)


def test_corrections_to_the_origin_of_the_urdf(tmp_path: Path) -> None:
    """Coordinates that are all zero: other values move the origin, and are saved and read back."""
    folder = pincal.load_mechanism("3RRR").save(tmp_path / "m")
    text = (folder / YAML).read_text()
    text = text.replace("    - {polar: [OA, beta]}", "    - {x: dx}\n    - {y: dy}")
    lines = [line for line in text.splitlines() if not line.startswith("    OA:")]
    lines = [re.sub("^    beta: .*", "    dx: 0.0\n    dy: 0.0", line) for line in lines]
    (folder / YAML).write_text("\n".join(lines))
    mechanism, usual = pincal.load_mechanism(folder), pincal.load_mechanism("3RRR")
    shift = np.array([0.003, -0.002])
    base = np.array(usual.legs[0].joints[0].placement.xyz[:2]) + shift
    own = {"OA": np.hypot(*base), "beta": np.arctan2(base[1], base[0])}
    usual = usual.with_parameters({"leg_1": own})
    moved = mechanism.with_parameters({"leg_1": dict(zip(("dx", "dy"), shift, strict=True))})
    again = pincal.load_mechanism(moved.save(tmp_path / "moved"))
    assert again == moved
    assert again.leg("leg_1").nominal_by_name["dx"] == 0.003
    poses = workspace("3RRR", 20)
    expected = pincal.inverse(usual, poses).readings
    assert np.allclose(pincal.inverse(again, poses).readings, expected, atol=1e-12)
    truth = pincal.disturb(mechanism, 1e-3, 1)  # twice moved
    assert np.isfinite(pincal.inverse(pincal.disturb(truth, 1e-3, 2), poses).readings).all()


def test_a_folder_that_hides_a_bundled_mechanism_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A folder of that name here is taken, and it is said that it is not the bundled one."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(logging.getLogger("pincal"), "propagate", True)
    with caplog.at_level(logging.INFO, "pincal"):
        pincal.load_mechanism("5R")
        assert caplog.text == ""
        pincal.load_mechanism("3RRR").save("5R")
        assert pincal.load_mechanism("5R").name == "3RRR"
    assert "not the bundled mechanism of that name" in caplog.text


def test_a_sensors_form_has_the_default_of_python(folder: Path) -> None:
    """Without ``form`` a sensor's reading gives the joint's position, as in ``Sensor``."""
    before = pincal.load_mechanism(folder)
    text = (folder / YAML).read_text()
    (folder / YAML).write_text(text.replace("form: joint, ", ""))
    assert "form: joint" not in (folder / YAML).read_text()
    assert pincal.load_mechanism(folder) == before
