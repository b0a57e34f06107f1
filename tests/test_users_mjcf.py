"""A user's MJCF with calibrated numbers: read again, and solved by MuJoCo itself."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_line import done, run
from machines import MACHINES
from marks import some_slow
from neighbours import delta_rods, vector
from scipy.spatial.transform import Rotation
from test_neighbours import LOOPED, struts

import pincal
from pincal.formats.mjcf import mjcf
from pincal.formats.users_mjcf import calibrated_mjcf

mujoco = pytest.importorskip("mujoco")

NUMBERS = re.compile(r"[-+]?\d+\.?\d*(?:e[-+]?\d+)?")


def five_bar(equality: str) -> str:
    """Return a five-bar in MJCF, as drawn in test_neighbours."""
    return LOOPED.replace("EQUALITY", equality).replace("<joint", '<geom size="0.01"/><joint')


def upright_five_bar() -> str:
    """Return a five-bar in x and z, whose axes are those of a class, drawn in degrees."""
    text = five_bar('<connect body1="a2" body2="b2" anchor="0.2 0 0.2"/>')
    text = re.sub(r'pos="(\S+) 0.2 0"', r'pos="\1 0 0.2"', text).replace('angle="radian"', "")
    return text.replace("<worldbody>", '<default><joint axis="0 -1 0"/></default><worldbody>')


def delta(equality: str, *, carried: bool) -> str:
    """Return a delta of six rods with balls, in MJCF; the first rod may carry the platform."""
    geom, loops, arms = '<geom size="0.01"/>', "", ""
    down = np.array([0.0, 0.0, -0.4])
    for i, (foot, arm, knees, points) in enumerate(zip(*delta_rods(), strict=True)):
        rods = ""
        for j, (knee, point) in enumerate(zip(knees, points, strict=True)):
            rod = point + down - foot - arm - knee
            name, inner = f"rod{i}{j}", ""
            if carried and not i + j:
                inner = f'<body name="top" pos="{vector(*rod)}"><joint type="ball" name="ball"/>'
                inner += (
                    f'{geom}<body name="plate" pos="{vector(*-point)}">{geom}SITES</body></body>'
                )
            else:
                ends = {"at": vector(*rod), "first": name, "second": "plate"}
                loops += equality.format(number=f"{i}{j}", **ends)
            rods += (
                f'<body name="{name}" pos="{vector(*arm + knee)}"><joint type="ball" name="s{i}{j}"'
                f'/>{geom}<site name="e{i}{j}" pos="{vector(*rod)}"/>{inner}</body>'
            )
        axis = vector(-foot[1] / 0.2, foot[0] / 0.2, 0.0)
        arms += (
            f'<body name="arm{i}" pos="{vector(*foot)}"><joint name="m{i}" axis="{axis}" '
            f'range="-60 60"/>{geom}{rods}</body>'
        )
    sites = "".join(
        f'<site name="p{i}{j}" pos="{vector(*point)}"/>'
        for i, pair in enumerate(delta_rods()[3])
        for j, point in enumerate(pair)
    )
    free = f'<body name="plate" pos="{vector(*down)}"><freejoint/>{geom}{sites}</body>'
    drives = "".join(f'<motor joint="m{i}"/>' for i in range(3))
    return (
        f'<mujoco model="delta"><!-- drawn by hand -->\n<worldbody>\n{arms}'
        f"{'' if carried else free}</worldbody>\n<equality>{loops}</equality>\n"
        f"<actuator>{drives}</actuator></mujoco>"
    ).replace("SITES", sites)


def welded(weld: str) -> str:
    """Return two planar legs of three joints, the plate of one welded to the other's last link."""
    text = five_bar(f"<weld {weld}/>").replace(
        '<site name="sa" pos="0.2 0.2 0"/>',
        '<body name="plate" pos="0.2 0.2 0"><geom size="0.01"/><joint name="m3"/></body>',
    )
    text = text.replace("<actuator>", '<actuator><motor joint="m3"/>')
    turned = '<body name="b3" pos="-0.2 0.2 0" euler="0 0 0.3"><geom size="0.01"/><joint/></body>'
    return text.replace('<site name="sb" pos="-0.2 0.2 0"/>', turned)


RELATIVE = f'relpose="0 0 0 {np.cos(0.15)} 0 0 {np.sin(0.15)}"'
BODIES = '<connect body1="{first}" body2="{second}" anchor="{at}"/>\n'
SITES = '<connect site1="e{number}" site2="p{number}"/>\n'
FILES: dict[str, Callable[[], str]] = {
    "five-bar, sites": lambda: five_bar('<connect site1="sa" site2="sb"/>'),
    "five-bar, bodies": lambda: five_bar('<connect body1="a2" body2="b2" anchor="0.2 0.2 0"/>'),
    "five-bar, swapped": lambda: five_bar(
        '<weld site1="sa" site2="sb" active="false"/><connect body1="b2" body2="a2" '
        'anchor="-0.2 0.2 0" solref="0.01 1"/>'
    ),
    "five-bar in x, z": upright_five_bar,
    "delta, bodies": lambda: delta(BODIES, carried=False),
    "delta, sites": lambda: delta(SITES, carried=False),
    "delta, bodies, carried": lambda: delta(BODIES, carried=True),
    "delta, sites, carried": lambda: delta(SITES, carried=True),
    "weld as drawn": lambda: welded('body1="plate" body2="b3"'),
    "weld of a pose": lambda: welded(f'body1="plate" body2="b3" {RELATIVE}'),
    **{
        name: lambda name=name: mjcf(MACHINES[name]())  # type: ignore[misc]
        for name in ("four_bar", "ankle", "tricept", "hexapod", "quattro", "upu")
    },
}


def imported(file: Path, folder: Path, *options: str) -> pincal.Mechanism:
    """Return the mechanism of a file, imported on the command line."""
    done("import", file, *options, "-o", folder)
    return pincal.load_mechanism(folder)


def solved(file: Path, drives: list[str], readings: np.ndarray, link: str) -> np.ndarray:
    """Return poses of a body at readings, (N, 4, 4), where MuJoCo's equalities hold.

    Without a body, the position of the last equality.
    """
    model = mujoco.MjModel.from_xml_path(str(file))
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    data, poses = mujoco.MjData(model), []
    held = [model.joint(name).dofadr[0] for name in drives]
    free = np.setdiff1d(np.arange(model.nv), held)
    for row in readings:
        mujoco.mj_resetData(model, data)
        if model.nkey:
            mujoco.mj_resetDataKeyframe(model, data, 0)
        for name, value in zip(drives, row, strict=True):
            address = model.joint(name).qposadr[0]
            data.qpos[address] = model.qpos0[address] + value
        for _ in range(30):
            mujoco.mj_fwdPosition(model, data)
            gaps = data.efc_pos[: data.ne].copy()
            J, step = data.efc_J.reshape(-1, model.nv)[: data.ne], np.zeros(model.nv)
            step[free] = np.linalg.lstsq(J[:, free], -gaps, rcond=1e-9)[0]
            mujoco.mj_integratePos(model, data.qpos, step, 1.0)
        assert np.abs(gaps).max() < 1e-9
        T = np.eye(4)
        if link:
            T[:3, :3], T[:3, 3] = data.body(link).xmat.reshape(3, 3), data.body(link).xpos
        elif model.eq_objtype[-1] == mujoco.mjtObj.mjOBJ_SITE:
            T[:3, 3] = data.site_xpos[model.eq_obj1id[-1]]
        else:
            body = model.eq_obj1id[-1]
            T[:3, 3] = data.xpos[body] + data.xmat[body].reshape(3, 3) @ model.eq_data[-1, :3]
        poses.append(T)
    return np.array(poses)


@pytest.mark.parametrize("name", some_slow(FILES, "delta, bodies"))
def test_calibrated_loops_go_into_the_users_mjcf(name: str, tmp_path: Path) -> None:
    """Read again, the file is the calibrated machine, and only numbers of it have changed."""
    file = tmp_path / "robot.xml"
    file.write_text(FILES[name]())
    options = ("--platform", "plate") if "delta" in name or "weld" in name else ()
    mechanism = imported(file, tmp_path / "nominal", *options)
    assert calibrated_mjcf(file, mechanism) == file.read_bytes()
    true = pincal.disturb(mechanism, 1e-3, seed=0)
    true.save(tmp_path / "true")
    done("export", tmp_path / "true", "--original", file, "-o", tmp_path / "new.xml")
    again = imported(tmp_path / "new.xml", tmp_path / "again", *options)
    rng = np.random.default_rng(1)
    home = np.hstack([leg.home[leg.active] for leg in mechanism.legs])
    readings = home + rng.uniform(-0.05, 0.05, (6, len(home)))
    expected, nominal, found = (pincal.forward(m, readings) for m in (true, mechanism, again))
    assert expected.converged.all()
    T, T_nominal, T_found = map(
        mechanism.platform.matrices, (expected.poses, nominal.poses, found.poses)
    )
    assert np.abs(T - T_nominal).max() > 1e-4
    np.testing.assert_allclose(T_found, T, atol=1e-9)
    drives = [sensor.joint for leg in mechanism.legs for sensor in leg.sensors]
    link = "" if "five" in name else "platform" if name in MACHINES else "plate"
    theirs = solved(tmp_path / "new.xml", drives, readings, link)
    if "five" in name:  # the point lies in the drawing's plane, wherever that is
        T, theirs = T[1:, :3, 3] - T[:1, :3, 3], theirs[1:, :3, 3] - theirs[:1, :3, 3]
        T, theirs = T @ T.T, theirs @ theirs.T
    np.testing.assert_allclose(theirs, T, atol=1e-9)


ARM = """<mujoco model="arm">
  <compiler SETTINGS/> <!-- <body name="none"> -->
  <default><joint axis="0 0 2"/><default class="lift"><joint type="slide" range="-0.4 0.4"/>
  </default></default>
  <worldbody><geom size="1"/>
    <body name="a" pos=" 0.1 0.0  0.3" axisangle="1 1 0 0.5">
      <geom size="0.1"/>
      <joint name="a1" pos="0.05 0.02 0.01"/><joint name='a2' axis='1 2 0' ref="0.3" pos="0.1 0 0"/>
      <body childclass="lift" euler="0.3 0.4 -0.2"><geom size="0.1"/>
        <joint axis="0 1 2" pos="0.01 0 0.03"/><site pos="1 2 3"/>
        <body name="c" pos="0.2 0 0.1" zaxis="1 0 1" >
          <geom size="0.1"/>
          <joint name="c1" type="hinge" axis="1 2 3" pos="0 0.1 0"/>
          <site name="end" pos="0.1 0.2 0.3" ORIENTED/>
          <body name="hand" pos="0 0 .1" ORIENTED><geom size="1"/>
            <joint name="c2" type="hinge"/></body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
ORIENTED = {
    "": "",
    "quat": 'quat="1 2 3 4"',
    "euler": 'euler="0.3 -0.2 0.5"',
    "axisangle": "axisangle='0 1 0 90'",
    "xyaxes": 'xyaxes="0 1 0 -1 0.2 0.1"',
    "zaxis": 'zaxis="1 0 1"',
}


@pytest.mark.parametrize("tip", ["end", "hand"])
@pytest.mark.parametrize(
    ("settings", "notation"),
    [
        *(('angle="radian" eulerseq="xYz"', notation) for notation in ORIENTED),
        *((f'eulerseq="{axes}"', "euler") for axes in ("ZYX", "zyz", "zYz")),
    ],
)
def test_calibrated_arms_go_into_the_users_mjcf(
    settings: str, notation: str, tip: str, tmp_path: Path
) -> None:
    """MuJoCo has the tip where the calibrated arm has it, in whatever notation a file is written.

    What is no number stays, but for attributes that were not there; zaxis becomes quat, and euler
    whose sequence turns about one axis twice.
    """
    text = ARM.replace(" ORIENTED", f" {ORIENTED[notation]}".rstrip()).replace("SETTINGS", settings)
    file, new = tmp_path / "arm.xml", tmp_path / "new.xml"
    file.write_text(text)
    arm = imported(file, tmp_path / "nominal", "--tip", tip)
    assert calibrated_mjcf(file, arm) == file.read_bytes()
    true = pincal.disturb(arm, 1e-2, seed=0)
    true.save(tmp_path / "true")
    done("export", tmp_path / "true", "--original", file, "-o", new)
    readings = np.random.default_rng(0).uniform(-0.3, 0.3, (10, len(arm.reading_names)))
    poses = [pincal.forward(m, readings).poses for m in (arm, true)]
    T_nominal, T = map(arm.platform.matrices, poses)
    theirs = []
    for path in (file, new):
        model = mujoco.MjModel.from_xml_path(str(path))
        data = mujoco.MjData(model)
        for row in readings:
            data.qpos[:] = model.qpos0
            data.qpos[: len(row)] += row
            mujoco.mj_forward(model, data)
            place = data.site(tip) if tip == "end" else data.body(tip)
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = place.xmat.reshape(3, 3), place.xpos
            theirs.append(pose)
    np.testing.assert_allclose(theirs, np.concatenate((T_nominal, T)), atol=1e-9)
    assert np.abs(T - T_nominal).max() > 1e-3
    turned = r"zaxis|\beuler(?==)" if "zYz" in settings else "zaxis"
    added = re.compile(r"\s(?:pos|axis|quat)=[\"'][^\"']*[\"']")
    kept, changed = (
        added.sub("", re.sub(turned, "quat", part.read_text())) for part in (file, new)
    )
    assert NUMBERS.sub("0", kept).split() == NUMBERS.sub("0", changed).split()


def hanging(text: str) -> str:
    """Return struts with balls as if drawn upright, a keyframe turning them to where they close."""
    bodies = re.findall(r'zaxis="([^"]*)"', text)
    turns = [Rotation.align_vectors(np.array(v.split(), float), (0, 0, 1))[0] for v in bodies]
    text = re.sub(r' zaxis="[^"]*"', "", text)
    quats = " ".join(f"{vector(*turn.as_quat(scalar_first=True))} 0" for turn in turns)
    key = f'<keyframe><key qpos="0 0 1 1 0 0 0 {quats}"/></keyframe></mujoco>'
    return text.replace("</mujoco>", key)


def oblique(text: str) -> str:
    """Return struts whose bodies are not turned: slides go along the struts, askew in them."""
    strut = re.compile(r' zaxis="([^"]*)"(.*?)pos="[^"]*"(.*?type="slide")')
    return strut.sub(r'\2pos="\1"\3 axis="\1"', text)


@pytest.mark.parametrize("drawn", [str, hanging, oblique])
def test_struts_with_balls_go_into_the_users_mjcf(
    drawn: Callable[[str], str], tmp_path: Path
) -> None:
    """However struts are drawn, their spin alone is held, and they reach all that lengths allow."""
    file = struts(tmp_path)
    file.write_text(drawn(file.read_text()))
    mechanism = imported(file, tmp_path / "nominal")
    assert [len(leg.parameters) for leg in mechanism.legs] == [7] * 6
    assert calibrated_mjcf(file, mechanism) == file.read_bytes()
    true = pincal.disturb(mechanism, 1e-3, seed=0)
    true.save(tmp_path / "true")
    done("export", tmp_path / "true", "--original", file, "-o", tmp_path / "new.xml")
    again = imported(tmp_path / "new.xml", tmp_path / "again")
    twists = np.random.default_rng(0).normal(0.0, 0.6, (300, 6)) * (0.3, 0.3, 0.3, 1, 1, 1)
    T = mechanism.platform.transforms(np.tile(mechanism.platform.home, (300, 1))).as_matrix()
    poses = mechanism.platform.from_matrices(mechanism.platform.displaced(T, twists))
    found = [pincal.inverse(m, poses) for m in (true, again)]
    assert all(solution.reached.all() for solution in found)
    np.testing.assert_allclose(*(solution.readings for solution in found), atol=1e-9)


def test_a_leg_may_have_no_joint_but_its_drive(tmp_path: Path) -> None:
    """The platform of a five-bar is a site on a rod, which hangs on a drive alone."""
    file = tmp_path / "robot.xml"
    text = five_bar('<connect body1="a2" body2="b2" anchor="0.2 0.2 0"/>')
    file.write_text(
        text.replace('<site name="sa" pos="0.2 0.2 0"/>', '<site name="pen" pos="0.2 0.3 0"/>')
    )
    bar = imported(file, tmp_path / "bar", "--platform", "pen")
    true = pincal.disturb(bar, 1e-3, seed=0)
    true.save(tmp_path / "true")
    done("export", tmp_path / "true", "--original", file, "-o", tmp_path / "new.xml")
    again = imported(tmp_path / "new.xml", tmp_path / "again", "--platform", "pen")
    readings = np.random.default_rng(0).uniform(-0.1, 0.1, (10, 2))
    poses = [pincal.forward(machine, readings).poses for machine in (true, again)]
    np.testing.assert_allclose(*map(bar.platform.matrices, poses), atol=1e-9)


def test_what_numbers_cannot_hold_is_refused(tmp_path: Path) -> None:
    """A body in a frame, another machine's file, a loop that is drawn open: one message each."""
    file, out = tmp_path / "robot.xml", ("-o", tmp_path / "new.xml")
    text = five_bar('<connect body1="a2" body2="b2" anchor="0.2 0.2 0"/>')
    file.write_text(text)
    true = pincal.disturb(imported(file, tmp_path / "bar"), 1e-3, seed=0)
    true.save(tmp_path / "true")
    export = ("export", tmp_path / "true", "--original", file, *out)
    framed = text.replace('<body name="b1" pos="0.1 0 0">', '<frame pos="0.1 0 0"><body name="b1">')
    head, tail = framed.rsplit("</body>", 2)[0], "</body></frame></body></worldbody>"
    file.write_text(head + tail + framed[framed.index("<equality>") :].replace("</worldbody>", ""))
    outcome = run(*export)
    assert (outcome.code, (tmp_path / "new.xml").exists()) == (2, False)
    assert "mj_saveLastXML" in outcome.trouble
    file.write_text(text.replace("f1", "elbow"))
    assert "give the MJCF from which it was made" in run(*export).trouble
    file.write_text(
        text.replace("</mujoco>", '<keyframe><key qpos=".1 0 0 0"/></keyframe></mujoco>')
    )
    keyed = pincal.disturb(imported(file, tmp_path / "bar_2"), 1e-3, seed=0)
    keyed.save(tmp_path / "true_2")  # a keyframe is no drawing
    done("export", tmp_path / "true_2", *export[2:], "--force")
    again = imported(tmp_path / "new.xml", tmp_path / "again_2")
    home = pincal.inverse(keyed, [keyed.platform.home]).readings
    readings = home + np.array([[0.1, -0.05], [0.0, 0.1]])
    poses = (pincal.forward(machine, readings).poses for machine in (keyed, again))
    np.testing.assert_allclose(*poses, atol=1e-9)
    file.write_text(welded(f'body1="plate" body2="b3" anchor="0.1 0 0" {RELATIVE}'))
    bar = imported(file, tmp_path / "bar_3", "--platform", "plate")
    pincal.disturb(bar, 1e-3, seed=0).save(tmp_path / "true_3")
    assert "as it is drawn open" in run("export", tmp_path / "true_3", *export[2:]).trouble
