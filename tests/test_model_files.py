"""Random URDF and MJCF files: what is imported moves as Pinocchio and MuJoCo move it.

Files have odd names, rounded numbers, frames, includes, defaults, references, quaternions with
zeros, joints off the path, couplings, and elements that place nothing. A file is imported right or
refused with a reason that is listed; none is imported wrong.
"""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from command_line import done, run
from marks import quick

import pincal
from pincal import MechanismError, load_mechanism
from pincal.files.mechanism_folders import save_mechanism
from pincal.formats.arm import serial_arm
from pincal.formats.mjcf import read_mjcf

NAMES = ("Revolute 1", "joint.{}", "arm-joint-{}", "gelenk_ä{}", "{}_joint", "x", "roll", "J{}/a")
QUARTER_TURNS = (0.0, np.pi / 2, -np.pi / 2, np.pi)


class Numbers:
    """Numbers as files have them: rounded to a few digits, often zero, often quarter turns."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.digits = int(self.rng.integers(4, 18))

    def chance(self, probability: float = 0.5) -> bool:
        """Return whether something of a probability is so."""
        return bool(self.rng.random() < probability)

    def text(self, values: object) -> str:
        """Return numbers with the file's digits."""
        return " ".join(f"{float(v):.{self.digits}g}" for v in np.atleast_1d(values))  # type: ignore[arg-type]

    def triple(self) -> str:
        """Return a position, some of it zero."""
        values = self.rng.uniform(-0.5, 0.5, 3) * (self.rng.random(3) < 0.7)
        return self.text(values)

    def angles(self) -> str:
        """Return three angles, often quarter turns."""
        if self.chance():
            return self.text(self.rng.choice(QUARTER_TURNS, 3))
        return self.text(self.rng.uniform(-3, 3, 3))

    def quaternion(self) -> str:
        """Return a quaternion of any length, some of it zero."""
        values = self.rng.normal(size=4) * (self.rng.random(4) < 0.6)
        return self.text(values if values.any() else (0, 1, 0, 0))

    def axis(self) -> str:
        """Return an axis, often one of a frame, of any length."""
        if self.chance(0.7):
            return self.text(self.rng.choice((-1.0, 1.0)) * np.eye(3)[self.rng.integers(3)])
        return self.text(self.rng.normal(size=3))

    def name(self, index: int) -> str:
        """Return a joint's name, often one that is no identifier."""
        pattern = str(self.rng.choice(NAMES)) if self.chance() else "joint_{}"
        return pattern.format(index) if "{}" in pattern else f"{pattern}{index * (index > 1) or ''}"


def random_urdf(seed: int) -> tuple[str, list[str]]:
    """Return a URDF whose tip is link 'tool', and the names of the joints that move it."""
    numbers = Numbers(seed)
    version = 'version="1.1"' if numbers.chance() else ""
    links, joints, moving = ["base"], [], []

    def add(name: str, kind: str, parent: str, child: str, rest: str = "") -> None:
        turn = f'rpy="{numbers.angles()}"'
        if version and numbers.chance(0.4):
            turn = f'quat_xyzw="{numbers.quaternion()}"'
        place = f'<origin xyz="{numbers.triple()}" {turn * numbers.chance(0.8)}/>'
        axis = f'<axis xyz="{numbers.axis()}"/>' if numbers.chance(0.9) else ""
        joints.append(
            f'<joint name="{name}" type="{kind}">{place * numbers.chance(0.9)}'
            f'<parent link="{parent}"/><child link="{child}"/>{axis}{rest}</joint>'
        )
        links.append(child)

    limits = ('lower="-3" upper="3" ', "", 'lower="-1e16" upper="1e16" ', 'lower="0" upper="0" ')
    count = int(numbers.rng.integers(1, 7))
    for i in range(1, count + 1):
        link = f"link {i}"
        kind = str(numbers.rng.choice(["revolute", "continuous", "prismatic", "fixed"]))
        limit = str(numbers.rng.choice(limits, p=[0.7, 0.1, 0.1, 0.1]))
        kind, limit = ("revolute", limits[0]) if i == count and not moving else (kind, limit)
        name = numbers.name(i)
        rest = f'<limit {limit}effort="1" velocity="1"/>' if kind != "continuous" else ""
        rest += '<dynamics damping="1"/>' * numbers.chance(0.2)
        rest += '<calibration rising="0.1"/>' * numbers.chance(0.1)
        add(name, kind, links[-1] if i > 1 else "base", link, rest)
        if kind != "fixed" and (limit != limits[3] or kind == "continuous"):
            moving.append(name)
    last = links[-1]
    add("mount", "fixed", last, "tool")
    if numbers.chance():
        finger = '<limit lower="0" upper="0.1" effort="1" velocity="1"/>'
        add("finger_a", "prismatic", "tool", "fa", finger)
        add("finger_b", "prismatic", "tool", "fb", f'<mimic joint="finger_a"/>{finger}')
        add("trailer", "floating", last, "loose")
    text = "".join(f'<link name="{link}"/>' for link in links) + "".join(joints)
    text += '<transmission name="t"/><gazebo/>' * numbers.chance(0.3)
    return f'<?xml version="1.0"?><robot name="r" {version}>{text}</robot>', moving


def random_mjcf(seed: int, folder: Path) -> Path:
    """Write an MJCF file whose tip is site or body 'tool', with an included one beside it."""
    numbers = Numbers(seed)
    rng = numbers.rng
    degrees = numbers.chance()

    def place() -> str:
        angles = rng.uniform(-3, 3, 3)
        if degrees:
            angles = np.degrees(rng.choice(QUARTER_TURNS, 3))
        turn = rng.choice(["quat", "euler", "axisangle", "xyaxes", "zaxis", ""])
        said = {
            "quat": f'quat="{numbers.quaternion()}"',
            "euler": f'euler="{numbers.text(angles)}"',
            "axisangle": f'axisangle="{numbers.axis()} {numbers.text(rng.uniform(-3, 3))}"',
            "xyaxes": f'xyaxes="{numbers.text(rng.normal(size=6))}"',
            "zaxis": f'zaxis="{numbers.axis()}"',
            "": "",
        }[str(turn)]
        return f'pos="{numbers.triple()}" {said}'

    def joint(index: int) -> str:
        kind = str(rng.choice(["hinge", "hinge", "slide"]))
        ranges = f'range="{"-90 90" if degrees else "-1.5 1.5"}"' * numbers.chance()
        ref = f'ref="{numbers.text(rng.uniform(-0.4, 0.4))}"' * numbers.chance(0.3)
        at = f'pos="{numbers.triple()}"' * numbers.chance()
        axis = f'axis="{numbers.axis()}"' * numbers.chance(0.7)
        of = 'class="lift"' * numbers.chance(0.2) or f'type="{kind}"'
        text = f'<joint name="{numbers.name(index)}" {of} {axis} {at} {ranges} {ref}/>'
        return f"<frame {place()}>{text}</frame>" if numbers.chance(0.2) else text

    count, inner = int(rng.integers(1, 5)), ""
    inner = f'<body name="hand" {place()}><site name="tool" {place()}/>'
    inner += '<body name="f"><joint name="f1" type="slide" range="0 1"/><geom size=".01"/></body>'
    inner += '<body name="g"><joint name="f2" type="slide" range="0 1"/><geom size=".01"/></body>'
    inner += "</body>"
    index, shape = 1, '<geom type="mesh" mesh="m"/>'
    for i in range(count, 0, -1):
        joints = ""
        for _ in range(int(rng.integers(1, 3))):
            joints += joint(index)
            index += 1
        own = 'childclass="turned"' * numbers.chance(0.2)
        body = f'<body name="b{i}" {place()} {own}>{joints}{shape}{inner}</body>'
        inner = f"<frame {place()}>{body}</frame>" if numbers.chance(0.3) else body
    sequence = "".join(rng.choice(list("xyzXYZ"), 3))
    (folder / "defaults.xml").write_text(
        "<mujocoinclude><default><default class='lift'><joint type='slide' axis='0 1 2'/></default>"
        "<default class='turned'><joint axis='1 1 0'/></default></default></mujocoinclude>"
    )
    file = folder / "robot.xml"
    file.write_text(
        f'<mujoco model="m"><compiler angle="{"degree" if degrees else "radian"}" '
        f'eulerseq="{sequence}"/><include file="defaults.xml"/>'
        '<asset><mesh name="m" file="absent.stl"/></asset>'
        f'<worldbody><body name="other"><freejoint/><geom size=".1"/></body>{inner}</worldbody>'
        '<equality><joint joint1="f1" joint2="f2"/></equality></mujoco>'
    )
    return file


def moved(arm: pincal.Mechanism, folder: Path, q: np.ndarray) -> np.ndarray:
    """Return the tip of an arm that was saved and loaded, shape (N, 4, 4)."""
    again = load_mechanism(save_mechanism(arm, folder))
    return again.platform.transforms(pincal.forward(again, q).poses).as_matrix()


def check_urdf(seed: int, folder: Path) -> None:
    """Compare one URDF with Pinocchio; raise if pincal refuses it."""
    text, moving = random_urdf(seed)
    file = folder / "robot.urdf"
    file.write_text(text, encoding="utf-8")
    arm = pincal.Mechanism.from_urdf(file, "tool")
    joints = [joint.name for joint in arm.legs[0].moving]
    assert joints == moving
    model = pin.buildModelFromUrdf(str(file))
    data = model.createData()
    q = np.random.default_rng(seed).uniform(-1, 1, (3, len(moving)))
    found = moved(arm, folder / "arm", q)
    for row, T in zip(q, found, strict=True):
        full = pin.neutral(model)
        for name, value in zip(moving, row, strict=True):
            entry = model.joints[model.getJointId(name)]
            turn = (np.cos(value), np.sin(value))
            full[entry.idx_q : entry.idx_q + entry.nq] = value if entry.nq == 1 else turn
        pin.framesForwardKinematics(model, data, full)
        expected = data.oMf[model.getFrameId("tool")].homogeneous
        np.testing.assert_allclose(T, expected, atol=1e-9)


def check_mjcf(seed: int, folder: Path) -> None:
    """Compare one MJCF file with MuJoCo; raise if pincal refuses it."""
    file = random_mjcf(seed, folder)
    arm = serial_arm(read_mjcf(file), "tool")
    spec = mujoco.MjSpec.from_file(str(file))
    for mesh in spec.meshes:
        mesh.make_sphere(1)
        mesh.file = ""
    model = spec.compile()
    names = [joint.name for joint in arm.legs[0].moving]
    above = model.site("tool").bodyid[0]
    ways = set()
    while above:
        ways.add(int(above))
        above = model.body_parentid[above]
    assert names == [model.joint(i).name for i in range(model.njnt) if model.jnt_bodyid[i] in ways]
    data = mujoco.MjData(model)
    q = np.random.default_rng(seed).uniform(-1, 1, (3, len(names)))
    found = moved(arm, folder / "arm", q)
    for row, T in zip(q, found, strict=True):
        data.qpos[:] = model.qpos0
        for name, value in zip(names, row, strict=True):
            data.qpos[model.joint(name).qposadr[0]] += value
        mujoco.mj_kinematics(model, data)
        site = data.site("tool")
        np.testing.assert_allclose(T[:3, 3], site.xpos, atol=1e-9)
        np.testing.assert_allclose(T[:3, :3], site.xmat.reshape(3, 3), atol=1e-9)


CHECKS = {"urdf": check_urdf, "mjcf": check_mjcf}


def refusals(form: str, seeds: range, folder: Path) -> Counter[str]:
    """Return how many files are refused, by reason; the others are imported right."""
    reasons: Counter[str] = Counter()
    for seed in seeds:
        place = folder / str(seed)
        place.mkdir()
        try:
            CHECKS[form](seed, place)
        except MechanismError as error:
            reasons[str(error)] += 1
        except AssertionError as error:
            raise AssertionError(f"seed {seed}: {error}") from error
    return reasons


@pytest.mark.filterwarnings("ignore:Inertia matrix")
@pytest.mark.parametrize("form", CHECKS)
@pytest.mark.parametrize("seeds", quick(1, [range(25), range(25, 60)]))
def test_random_files_move_as_their_own_readers_move_them(
    seeds: range, form: str, tmp_path: Path
) -> None:
    """Of 60 random files each is imported as Pinocchio or MuJoCo has it, to 1e-9, none refused."""
    assert refusals(form, seeds, tmp_path) == Counter()


@pytest.mark.filterwarnings("ignore:Inertia matrix")
@pytest.mark.fuzz
@pytest.mark.parametrize("form", CHECKS)
def test_many_random_files_move_as_their_own_readers_move_them(form: str, tmp_path: Path) -> None:
    """Of 2,000 random files each is imported as Pinocchio or MuJoCo has it, none refused."""
    assert refusals(form, range(60, 2060), tmp_path) == Counter()


PLACED = """<?xml version="1.0"?><robot name="r" version="1.1"><link name="base"/><link name="l1"/>
<link name="tool"/><joint name="Revolute 1" type="revolute"><parent link="base"/><child link="l1"/>
<origin xyz="0 0 0.2" quat_xyzw="1 0 0 1"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="x" type="revolute"><parent link="l1"/><child link="tool"/><origin xyz="0.3 0 0"/>
<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
OFF = """<link name="off"/><joint name="m" type="continuous"><origin xyz="0 0 0"/>
<parent link="l1"/><child link="off"/>"""
#: Elements and attributes of a joint in URDF's schema, with what becomes of them.
SCHEMA = (
    ('<dynamics damping="1" friction="1"/>', ""),
    ('<safety_controller k_velocity="1" soft_lower_limit="0" soft_upper_limit="1"/>', ""),
    ('<calibration reference_position="0.1"/>', "warning: "),
    ('<calibration rising="0.1" falling="0.2"/>', "warning: "),
    ('<mimic joint="x" multiplier="2" offset="1"/>', ""),
    ('<origin xyz="1 0 0"/>', "two <origin>"),
    ('<frame xyz="1 0 0"/>', "a <frame>"),
)


@pytest.mark.parametrize(("element", "words"), SCHEMA)
def test_elements_of_a_joint_are_read_harmless_or_refused(
    element: str, words: str, tmp_path: Path
) -> None:
    """Nothing in a <joint> is ignored in silence but what places nothing; off the path all is."""
    file = tmp_path / "arm.urdf"
    file.write_text(PLACED.replace("<limit", f"{element}<limit", 1))
    outcome = run("import", file, "--tip", "tool", "-o", tmp_path / "arm")
    assert (outcome.code == 0) == (not words or words.startswith("warning"))
    assert words in " ".join(outcome.err.split())
    parted = PLACED.replace("</robot>", f"{OFF}{element}</joint></robot>")
    file.write_text(parted)
    outcome = done("import", file, "--tip", "tool", "-o", tmp_path / "beside")
    assert "warning" not in outcome.err


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('name="Revolute 1"', 'name="Revolute 1" pose="1 0 0"', "'pose' of its <joint>"),
        ("<origin xyz=", '<origin scale="2" xyz=', "'scale' of its <origin>"),
        ('<axis xyz="0 0 1"', '<axis rpy="1 0 0" xyz="0 0 1"', "'rpy' of its <axis>"),
        ("</joint>", '<mimic joint="Revolute 1" ratio="2"/></joint>', "'ratio' of its <mimic>"),
        ('version="1.1"', "", "version"),
        ("quat_xyzw=", 'rpy="0 0 0" quat_xyzw=', "without rpy"),
        ("1 0 0 1", "0 0 0 0", "not all zero"),
        ("</robot>", "<my_joint/></robot>", "may place links"),
        ("</robot>", "<include/></robot>", "may place links"),
        ("</robot>", "<sdf/></robot>", "<sdf> is not read"),
        ("<robot ", '<robot scale="0.001" ', "'scale' of the <robot> is not read"),
        ('"l1"/>', '"l1"><origin/></link>', "<origin> of a <link> is not read"),
        ("</robot>", "<drake:proximity/></robot>", "<drake:proximity> is not read"),
        ("<limit", '<limit drake:acceleration="2"', ""),
        ("</robot>", "<xacro:arm/></robot>", "is a macro"),
    ],
)
def test_attributes_are_read_or_refused_by_name(
    old: str, new: str, words: str, tmp_path: Path
) -> None:
    """What might place a link and is not read is refused, or said, with its name and line."""
    file = tmp_path / "arm.urdf"
    assert old in PLACED
    file.write_text(PLACED.replace(old, new, 1))
    outcome = run("import", file, "--tip", "tool", "-o", tmp_path / "arm")
    assert words in " ".join(outcome.err.split())
    assert outcome.code == (0 if not words or "is not read" in words else 2)


def test_joints_go_out_under_their_own_names(tmp_path: Path) -> None:
    """Names that are no identifiers head columns as such, and a calibrated URDF is as it was."""
    file = tmp_path / "arm.urdf"
    file.write_text(PLACED)
    done("import", file, "--tip", "tool", "-o", tmp_path / "arm")
    arm = load_mechanism(tmp_path / "arm")
    assert arm.reading_names == ("Revolute_1", "joint_x")
    export = ("export", tmp_path / "arm", "--original", file, "-o", tmp_path / "out.urdf")
    done(*export)
    assert (tmp_path / "out.urdf").read_text() == PLACED
    true = arm.with_parameters({"arm": {"Revolute_1_rx": 0.05, "Revolute_1_x": 0.02}})
    save_mechanism(true, tmp_path / "arm", force=True)
    done(*export, "--force")
    again = pincal.Mechanism.from_urdf(tmp_path / "out.urdf", "tool")
    q = np.array([[0.3, -0.2]])
    np.testing.assert_allclose(
        pincal.forward(again, q).poses, pincal.forward(true, q).poses, atol=1e-12
    )
    assert "quat_xyzw" in (tmp_path / "out.urdf").read_text()


@pytest.mark.parametrize(
    ("axis", "quaternion"),
    [("inf 0 1", "1 0 0 0"), ("0 0 1", "inf 2 3 4"), ("0 0 1", "1e300 1e300 0 0")],
)
def test_mjcf_without_a_direction_is_refused(axis: str, quaternion: str, tmp_path: Path) -> None:
    """Axes and quaternions that MuJoCo compiles to no direction."""
    file = tmp_path / "arm.xml"
    file.write_text(
        f"""<mujoco><worldbody><body name="a"><joint name="j" axis="{axis}"/><geom size="1"/>
        <body name="b"><joint name="k"/><geom size="1"/><site name="tip" quat="{quaternion}"/>
        </body></body></worldbody></mujoco>"""
    )
    with pytest.raises(MechanismError, match="not finite or too large"):
        read_mjcf(file)


def test_a_site_named_as_a_body_or_a_joint_is_another_link(tmp_path: Path) -> None:
    """MuJoCo's own forward kinematics place all; which of two was read is said."""
    (tmp_path / "cup.xml").write_text(
        """<mujoco><worldbody><body name="arm" pos="0.1 0 0.3"><joint name="a" axis="0 1 0"/>
        <geom size="0.01"/><body name="cup" pos="0.2 0 0"><joint name="b" axis="0 0 1"/>
        <geom size="0.01"/><site name="cup" pos="0 0.05 0.1"/><site name="b"/></body></body>
        </worldbody></mujoco>"""
    )
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "cup.xml"))
    data = mujoco.MjData(model)
    data.qpos[:] = (0.3, -0.4)
    mujoco.mj_kinematics(model, data)
    ways = {"cup": data.body("cup"), "cup_site": data.site("cup"), "b": data.site("b")}
    for tip, frame in ways.items():
        outcome = done("import", tmp_path / "cup.xml", "--tip", tip, "-o", tmp_path / tip)
        assert "'cup' is a body here; the site of that name is 'cup_site'" in outcome.err
        pose = pincal.forward(load_mechanism(tmp_path / tip), data.qpos[None]).poses[0]
        np.testing.assert_allclose(pose[:3], frame.xpos, atol=1e-12)


FINGERS = """<robot name="f"><link name="a"/><link name="b"/><link name="c"/><link name="d"/>
<joint name="hand" type="revolute"><parent link="a"/><child link="d"/><axis xyz="1 0 0"/>
<limit lower="0" upper="1" effort="1" velocity="1"/></joint>
<joint name="j1" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
<origin xyz="0 0.2 0"/><limit lower="-1" upper="0" effort="1" velocity="1"/>
<mimic joint="hand" multiplier="0.5"/></joint>
<joint name="j2" type="revolute"><parent link="b"/><child link="c"/><axis xyz="0 1 0"/>
<origin xyz="0.3 0 0.1"/><limit lower="-1" upper="1" effort="1" velocity="1"/>
<mimic joint="hand" multiplier="-1" offset="0.1"/></joint></robot>"""


def test_joints_that_follow_one_off_the_way_follow_the_first(tmp_path: Path) -> None:
    """A finger's joints follow the hand's: the first is read; Pinocchio places the tip.

    The limits of all three leave no place to the hand, and are no reason to refuse the finger.
    """
    (tmp_path / "f.urdf").write_text(FINGERS)
    outcome = done("import", tmp_path / "f.urdf", "--tip", "c", "-o", tmp_path / "f")
    assert "arm: j1*, j2 (follows j1); closes a frame" in outcome.out
    arm, model = load_mechanism(tmp_path / "f"), pin.buildModelFromXML(FINGERS)
    hand, data = np.array([-0.4, -1.6]), model.createData()
    poses = pincal.forward(arm, 0.5 * hand[:, None]).poses
    for value, T in zip(hand, arm.platform.transforms(poses).as_matrix(), strict=True):
        q = {"hand": value, "j1": 0.5 * value, "j2": 0.1 - value}
        pin.framesForwardKinematics(model, data, np.array([q[name] for name in model.names[1:]]))
        expected = data.oMf[model.getFrameId("c")].homogeneous
        np.testing.assert_allclose(T, expected, atol=1e-12)


@pytest.mark.parametrize(("effort", "moves"), [("0", True), ("1", False)])
def test_a_limit_of_zeros_throughout_says_nothing(effort: str, moves: bool, tmp_path: Path) -> None:
    """CAD exporters write such ones where nobody set any; equal limits of a motor fix a joint."""
    zeros = f'<limit lower="0" upper="0" effort="{effort}" velocity="0"/>'
    text = re.sub("<mimic[^>]*>", "", FINGERS)
    (tmp_path / "f.urdf").write_text(re.sub(r'<limit lower="-1" upper="0"[^>]*>', zeros, text))
    arm = pincal.Mechanism.from_urdf(tmp_path / "f.urdf", "c")
    assert [joint.name for joint in arm.legs[0].moving] == ["j1", "j2"][1 - moves :]
    assert np.isinf(arm.legs[0].moving[0].upper) == moves


def test_an_arm_that_floats_stands_on_the_base_that_is_named(tmp_path: Path) -> None:
    """A floating joint at the root is refused with the --base that leaves it out, which works."""
    file = tmp_path / "arm.urdf"
    floating = '<link name="world"/><joint name="fl" type="floating"><parent link="world"/>'
    file.write_text(PLACED.replace("</robot>", f'{floating}<child link="base"/></joint></robot>'))
    outcome = run("import", file, "--tip", "tool", "-o", tmp_path / "arm")
    assert "import it with --base base" in outcome.trouble
    done("import", file, "--tip", "tool", "--base", "base", "-o", tmp_path / "arm")


LOOPED = """<mujoco><worldbody><body name="mo" mocap="true"><geom size=".1"/></body><body name="l1">
<joint name="a" axis="0 1 0"/><geom size=".1"/><body name="l2" pos="0 0 .4"><joint name="b"
axis="0 1 0"/><geom size=".1"/><site name="tool" pos=".4 0 0"/></body></body><body name="rod">
<joint name="c" axis="0 1 0"/><geom size=".1"/></body></worldbody>
<equality>%s</equality></mujoco>"""


@pytest.mark.parametrize(
    ("loop", "open_loops"),
    [
        ('<connect name="k" body1="rod" body2="l2" anchor="0 0 .2"/>', "k"),
        ('<weld name="w" body1="l1" body2="rod"/>', "w"),
        ('<weld name="hand" body1="l2" body2="mo"/>', ""),
        ('<connect name="k" active="false" body1="rod" body2="l2" anchor="0 0 .2"/>', ""),
    ],
)
def test_loops_of_an_arm_are_left_open_and_named(
    loop: str, open_loops: str, tmp_path: Path
) -> None:
    """What holds joints of an arm is said; what is dragged by hand, or asleep, holds none."""
    (tmp_path / "arm.xml").write_text(LOOPED % loop)
    outcome = done("import", tmp_path / "arm.xml", "--tip", "tool", "-o", tmp_path / "arm")
    assert ("left open" in outcome.err) == bool(open_loops)
    assert f"{open_loops}: loops" in outcome.err or not open_loops


def test_a_file_of_macros_says_what_expands_it(tmp_path: Path) -> None:
    """A xacro file is called what it is."""
    (tmp_path / "a.urdf.xacro").write_text("<robot/>")
    outcome = run("import", tmp_path / "a.urdf.xacro", "--tip", "a", "-o", tmp_path / "out")
    assert "xacro FILE" in outcome.trouble


M666 = "M665 L250.00 R124.68 H267.88 B80.00 X0.03 Y-0.01 Z-0.02\nM666 X-0.30 Y0.00 Z-0.50\n"


@pytest.mark.parametrize(("form", "first"), [(None, None), ("marlin", 268.18), ("reprap", 267.58)])
def test_corrections_of_endstops_are_those_of_the_firmware(
    form: str | None, first: float | None, tmp_path: Path
) -> None:
    """RepRapFirmware adds M666 to the height, Marlin takes it off; which is not guessed."""
    file = tmp_path / "delta.g"
    file.write_text(M666)
    how = () if form is None else ("--format", form)
    outcome = run("import", file, *how, "-o", tmp_path / "delta")
    assert outcome.code == (2 if first is None else 0)
    if first is None:
        assert "--format reprap or --format marlin" in " ".join(outcome.trouble.split())
    else:
        assert f"endstop {first:.4f} mm" in outcome.out
