"""Files in the conventions of neighbours, written by hand: URDF trees, robot.yaml, MJCF."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation
from yaml import safe_load

import pincal
from pincal.files.urdf import leg_links, leg_urdf, read_urdf

LIMIT = '<limit effort="1" velocity="20"/>'


def joint(
    name: str,
    parent: str,
    child: str,
    xyz: str = "0 0 0",
    kind: str = "revolute",
    *,
    axis: str = "0 0 1",
    rpy: str = "0 0 0",
    limit: str = LIMIT,
) -> str:
    """Return a <joint> of a URDF."""
    limit = "" if kind == "fixed" else limit
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="{xyz}" rpy="{rpy}"/>'
        f'<parent link="{parent}"/><child link="{child}"/><axis xyz="{axis}"/>{limit}</joint>'
    )


def urdf(name: str, joints: list[str], root: str) -> str:
    """Return a URDF of joints, its links in their order."""
    links = [root, *(one.split('<child link="')[1].split('"')[0] for one in joints)]
    every = "\n".join([*(f'<link name="{link}"/>' for link in links), *joints])
    return f'<?xml version="1.0"?>\n<robot name="{name}">\n{every}\n</robot>\n'


def written(folder: Path, robot: str, yaml: str) -> Path:
    """Write robot.urdf and robot.yaml, and return the former."""
    folder.mkdir(exist_ok=True)
    (folder / "robot.yaml").write_text(yaml)
    (folder / "robot.urdf").write_text(robot)
    return folder / "robot.urdf"


FIVE_BAR = [
    joint("mot1", "base", "a1", "-0.1 0 0"),
    joint("free1", "a1", "a2", "-0.1 0.2 0"),
    joint("mot2", "base", "b1", "0.1 0 0"),
    joint("free2", "b1", "b2", "0.1 0.2 0"),
    joint("closedloop1_A", "a2", "ca", "0.2 0.2 0", "fixed"),
    joint("closedloop1_B", "b2", "cb", "-0.2 0.2 0", "fixed"),
]
FIVE_BAR_YAML = """\
closed_loop: [['closedloop1_A', 'closedloop1_B']]
type: ['3d']
name_mot: ['mot1', 'mot2']
rotor_inertia: [0.1, 0.1]
"""


def five_bar(folder: Path) -> Path:
    """Write a five-bar whose loop is closed by a point."""
    return written(folder, urdf("fivebar", FIVE_BAR, "base"), FIVE_BAR_YAML)


def five_bar_angles(points: np.ndarray) -> np.ndarray:
    """Return the drives' angles of FIVE_BAR at points, shape (N, 2), by the cosine law."""
    found = []
    for foot, knee, tip in ((-0.1, -0.1 + 0.2j, 0.2 + 0.2j), (0.1, 0.1 + 0.2j, -0.2 + 0.2j)):
        reach = points[:, 0] + 1j * points[:, 1] - foot
        a, b = abs(knee), abs(tip)
        bend = np.arccos((np.abs(reach) ** 2 - a**2 - b**2) / (2 * a * b))
        side = np.sign((np.conj(knee) * tip).imag)
        link = np.angle(reach) - np.angle(a + b * np.exp(1j * side * bend))
        found.append(link - np.angle(knee))
    return np.stack(found, axis=1)


def hexapod_points(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return base and platform points of a hexapod, the first platform point in its origin."""
    rng = np.random.default_rng(seed)
    turns = np.radians([10, 50, 130, 170, 250, 290])
    base = np.column_stack((np.cos(turns), np.sin(turns), np.zeros(6)))
    top = 0.5 * np.column_stack((np.cos(turns + 0.3), np.sin(turns + 0.3), np.zeros(6)))
    base, top = base + rng.normal(0, 0.02, (6, 3)), top + rng.normal(0, 0.02, (6, 3))
    return base, top - top[0]


def hexapod(folder: Path) -> Path:
    """Write a 6-UPS as a tree: leg 1 carries the platform, the others close a point on it.

    U and S are joints that the YAML file replaces. Slides are at zero where legs are 0.8 m long.
    """
    base, top = hexapod_points()
    joints, pairs, names, kinds = [], [], [], []
    for i, (A, B) in enumerate(zip(base, top, strict=True)):
        text = " ".join(map(repr, A.tolist()))
        leg = f"leg{i}"
        joints += [
            joint(f"{leg}_u", "base", f"{leg}_arm", text),
            joint(
                f"{leg}_mot",
                f"{leg}_arm",
                f"{leg}_rod",
                "0 0 0.8",
                "prismatic",
                limit='<limit lower="-0.3" upper="0.8" effort="1" velocity="1"/>',
            ),
        ]
        names.append(f"{leg}_u")
        kinds.append("UJOINT_XY")
        if i == 0:
            joints.append(joint(f"{leg}_ball", f"{leg}_rod", "top"))
            names.append(f"{leg}_ball")
            kinds.append("SPHERICAL")
        else:
            end = " ".join(map(repr, B.tolist()))
            joints += [
                joint(f"{leg}_A", f"{leg}_rod", f"{leg}_end", kind="fixed"),
                joint(f"{leg}_B", "top", f"{leg}_point", end, "fixed"),
            ]
            pairs.append([f"{leg}_A", f"{leg}_B"])
    yaml = f"closed_loop: {pairs}\ntype: {['3D'] * 5}\nname_mot: ['mot']\n"
    yaml += f"joint_name: {names}\njoint_type: {kinds}\n"
    yaml += f"home: {{{', '.join(f'leg{i}_mot: 0.0' for i in range(6))}}}\n"  # upright: wide open
    return written(folder, urdf("hexapod", joints, "base"), yaml)


ARM = [
    joint("shoulder_pan_joint", "base_link", "shoulder", "0 0 0.128"),
    joint("shoulder_lift_joint", "shoulder", "upper_arm", "0 0.176 0", axis="0 1 0"),
    joint("elbow_joint", "upper_arm", "forearm", "0 -0.128 0.612", axis="0 1 0"),
    joint("wrist_1_joint", "forearm", "wrist_1", "0 0 0.572", axis="0 1 0", rpy="0 1.5708 0"),
    joint("wrist_2_joint", "wrist_1", "wrist_2", "0 0.115 0"),
    joint("wrist_3_joint", "wrist_2", "wrist_3", "0 0 0.116", axis="0 1 0"),
    joint("flange", "wrist_3", "tool0", "0 0.092 0", "fixed", rpy="0 0 1.5707963"),
]

MJCF = """\
<mujoco model="two_legs">
  <compiler angle="degree" eulerseq="xYz"/>
  <default>
    <joint damping="1" axis="0 0 1"/>
    <default class="lift"><joint type="slide" axis="0 1 2" range="-0.4 0.4"/></default>
  </default>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <frame pos="0.1 0.2 0.3" euler="10 20 30">
      <body name="a" pos="0.1 0 0" axisangle="1 1 0 30">
        <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
        <joint name="a1" pos="0.05 0.02 0.01" range="-90 90"/>
        <joint name="a2" class="lift" pos="0.01 0 0.03"/>
        <body name="b" pos="0.3 0.1 0" xyaxes="0 1 0 -1 0.2 0.1" childclass="lift">
          <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
          <joint name="b1" ref="0.1"/>
          <body name="c" pos="0.2 0 0.1" zaxis="1 0 1">
            <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
            <joint name="c1" type="hinge" axis="1 2 3" pos="0 0.1 0" ref="20"/>
            <site name="end" pos="0.1 0.2 0.3" quat="1 2 3 4"/>
          </body>
        </body>
      </body>
    </frame>
  </worldbody>
</mujoco>
"""


def skeleton(leg: pincal.Leg, joints: np.ndarray) -> np.ndarray:
    """Return where Pinocchio has the moving joints of a leg's URDF and its tip, (n + 1, 3), [m]."""
    model = pin.buildModelFromXML(leg_urdf(leg))
    data, indices = model.createData(), [model.getJointId(joint.name) for joint in leg.moving]
    q = np.zeros(model.nq)
    for index, value in zip(indices, joints, strict=True):
        begin, width = model.joints[index].idx_q, model.joints[index].nq
        q[begin : begin + width] = value if width == 1 else (np.cos(value), np.sin(value))
    pin.framesForwardKinematics(model, data, q)
    tip = data.oMf[model.getFrameId(leg_links(leg)[-1])].translation
    return np.array([*(data.oMi[index].translation for index in indices), tip])


def vector(*numbers: float) -> str:
    """Return numbers with all digits, as attributes of XML have them."""
    return " ".join(repr(float(number)) for number in numbers)


def four_bar(folder: Path) -> Path:
    """Write a four-bar that is closed as drawn; its coupler is the platform."""
    crank, knee = 0.3 * np.exp(0.7j), 0.4 + 0.65j
    place = lambda w: vector(w.real, w.imag, 0.0)  # noqa: E731
    joints = [
        joint("crank", "base", "l1"),
        joint("knee", "l1", "coupler", place(crank)),
        joint("end", "coupler", "coupler_end", place(knee - crank), "fixed"),
        joint("foot", "base", "l3", "0.9 0 0"),
        joint("follower_end", "l3", "l3_end", place(knee - 0.9), "fixed"),
    ]
    yaml = "closed_loop: [[end, follower_end]]\nname_mot: [crank]\ntype: [3d]\n"
    return written(folder, urdf("four_bar", joints, "base"), yaml)


def geared_five_bar(folder: Path) -> Path:
    """Write a five-bar of one drive: the right crank is geared to the left one."""
    gear = '<mimic joint="mot1" multiplier="-1.5" offset="0.1"/><axis'
    joints = [one.replace("<axis", gear) if '"mot2"' in one else one for one in FIVE_BAR]
    yaml = FIVE_BAR_YAML.replace("'mot1', 'mot2'", "'mot1'").replace("[0.1, 0.1]", "[0.1]")
    return written(folder, urdf("geared", joints, "base"), f"{yaml}platform: b2\n")


def coupled_five_bar(folder: Path) -> Path:
    """Write a five-bar whose left shoulder is turned by a crank over a rod: a loop within a leg."""
    joints = [one.replace('"mot1"', '"shoulder"') for one in FIVE_BAR]
    joints += [
        joint("mot1", "base", "k1", "-0.1 -0.3 0"),
        joint("pin", "k1", "k2", "0.08 0.02 0"),
        joint("rod_end", "k2", "k3", "0 0.31 0", "fixed"),
        joint("horn", "a1", "h1", "0.08 0.03 0", "fixed"),
    ]
    loops = "[[closedloop1_A, closedloop1_B], [rod_end, horn]]"
    yaml = f"closed_loop: {loops}\ntype: [3d, 3d]\nname_mot: [mot1, mot2]\nplatform: b2\n"
    return written(folder, urdf("coupled", joints, "base"), yaml)


def delta_rods() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return a delta's feet and arms at zero, (3, 3), and its rods' ends, (3, 2, 3) each."""
    feet, arms, knees, points = [], [], [], []
    for turn in 2 * np.pi * np.arange(3) / 3:
        out, side = np.array([np.cos(turn), np.sin(turn), 0.0]), [-np.sin(turn), np.cos(turn), 0.0]
        feet.append(0.2 * out)
        arms.append(0.12 * out - [0.0, 0.0, 0.09])
        knees.append([h * np.array(side) for h in (0.04, -0.045)])
        points.append([0.05 * out + h * np.array(side) for h in (0.04, -0.045)])
    return tuple(map(np.array, (feet, arms, knees, points)))  # type: ignore[return-value]


def six_rod_delta(folder: Path) -> Path:
    """Write a delta of six rods with a ball at either end; the first rod carries the platform."""
    joints, balls, loops = [], [], []
    for i, (foot, arm, knees, points) in enumerate(zip(*delta_rods(), strict=True)):
        axis = vector(-foot[1] / 0.2, foot[0] / 0.2, 0.0)
        joints.append(joint(f"leg{i}_mot", "base", f"arm{i}", vector(*foot), axis=axis))
        for j, (knee, point) in enumerate(zip(knees, points, strict=True)):
            rod = point - np.array([0.0, 0.0, 0.4]) - foot - arm - knee
            name = f"leg{i}_{'ab'[j]}"
            joints.append(joint(f"{name}_ball", f"arm{i}", f"{name}_rod", vector(*arm + knee)))
            joints.append(joint(f"{name}_end", f"{name}_rod", f"{name}_tip", vector(*rod), "fixed"))
            balls.append(f"{name}_ball")
            if not i + j:
                joints.append(joint("ball", f"{name}_tip", "plate"))
                joints.append(joint("plate_top", "plate", "top", vector(*-point), "fixed"))
                balls.append("ball")
            else:
                joints.append(
                    joint(f"point{i}{j}", "top", f"point{i}{j}_link", vector(*point), "fixed")
                )
                loops.append([f"{name}_end", f"point{i}{j}"])
    yaml = (
        f"closed_loop: {loops}\ntype: {['3d'] * 5}\nname_mot: [mot]\njoint_name: {balls}\n"
        f"joint_type: {['SPHERICAL'] * len(balls)}\nplatform: top\n"
    )
    return written(folder, urdf("delta", joints, "base"), yaml)


ANKLE = [([0.0, 0.03, -0.1], [-0.05, 0.02, 0.0], [-0.05, 0.05, 0.0])]
ANKLE += [([0.0, -0.03, -0.18], [-0.05, -0.02, 0.0], [-0.05, -0.05, 0.0])]
"""Of an ankle: motors on the shin, their horns, and where rods meet the foot, 0.35 m below."""


def ankle(folder: Path) -> Path:
    """Write a humanoid's ankle: a foot on a universal joint, and two rods with balls to motors."""
    joints = [
        joint("pitch", "shin", "cross", "0 0 -0.35", axis="0 1 0"),
        joint("roll", "cross", "foot", axis="1 0 0"),
    ]
    for i, (motor, horn, heel) in enumerate(ANKLE):
        rod = np.array(heel) - [0.0, 0.0, 0.35] - motor - horn
        joints += [
            joint(f"mot{i}", "shin", f"horn{i}", vector(*motor), axis="0 1 0"),
            joint(f"ball{i}", f"horn{i}", f"rod{i}", vector(*horn)),
            joint(f"rod_end{i}", f"rod{i}", f"tip{i}", vector(*rod), "fixed"),
            joint(f"heel{i}", "foot", f"heel{i}_link", vector(*heel), "fixed"),
        ]
    yaml = (
        "closed_loop: [[rod_end0, heel0], [rod_end1, heel1]]\ntype: [3d, 3d]\nname_mot: [mot]\n"
        "joint_name: [ball0, ball1]\njoint_type: [SPHERICAL, SPHERICAL]\nplatform: foot\n"
    )
    return written(folder, urdf("ankle", joints, "shin"), yaml)


def as_sdf(urdf: Path, seed: int) -> Path:
    """Write a URDF with a robot.yaml as SDF with random frames, and return the SDF.

    Poses are given in links, joints or frames drawn at random, from where the URDF has all links.
    Loops are balls, which join two links that other joints carry already.
    """
    rng, tree = np.random.default_rng(seed), read_urdf(urdf)
    yaml = safe_load((urdf.parent / "robot.yaml").read_text())
    balls = dict(zip(yaml.get("joint_name", ()), yaml.get("joint_type", ()), strict=True))
    T_link = {link: tree.pose_at_zero(link) for link in tree.links}

    def drawn() -> np.ndarray:
        frame = np.eye(4)
        frame[:3, :3], frame[:3, 3] = Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)
        return frame

    base = drawn()
    T = {"__model__": np.eye(4), **{link: base @ T_link[link] for link in T_link}}

    def pose(at: np.ndarray, known: Sequence[str]) -> str:
        frame = str(rng.choice(known))
        in_frame = np.linalg.inv(T[frame]) @ at
        turn = Rotation.from_matrix(in_frame[:3, :3]).as_euler("xyz")
        return f'<pose relative_to="{frame}">{vector(*in_frame[:3, 3], *turn)}</pose>'

    frames = []
    for i in range(3):
        place, known = drawn(), ["__model__", *(f"frame_{k}" for k in range(i))]
        frames.append(f'<frame name="frame_{i}">{pose(place, known)}</frame>')
        T[f"frame_{i}"] = place
    placed = ["__model__", "frame_0", "frame_1", "frame_2"]
    links = []
    for link in tree.links:
        links.append(f'<link name="{link}">{pose(T[link], placed)}</link>')
        placed.append(link)
    joints = []

    def add(name: str, kind: str, parent: str, child: str, at: np.ndarray, rest: str = "") -> None:
        ends = f"<parent>{parent}</parent><child>{child}</child>"
        joints.append(f'<joint name="{name}" type="{kind}">{pose(at, placed)}{ends}{rest}</joint>')

    for edge in tree.edges:
        joint, at = edge.joint, T[edge.child]
        if joint.name in balls:
            add(joint.name, "ball", edge.parent, edge.child, at)
        elif joint.kind == "fixed":
            add(joint.name, "fixed", edge.parent, edge.child, at)
        else:
            frame, way = str(rng.choice(placed)), T[edge.child][:3, :3] @ joint.axis
            axis = f'<xyz expressed_in="{frame}">{vector(*(T[frame][:3, :3].T @ way))}</xyz>'
            turn = np.eye(4)  # a joint's own frame may be turned anyhow, not moved
            turn[:3, :3] = Rotation.random(rng=rng).as_matrix()
            add(joint.name, joint.kind, edge.parent, edge.child, at @ turn, f"<axis>{axis}</axis>")
    child = {edge.joint.name: edge.child for edge in tree.edges}
    for i, (a, b) in enumerate(yaml["closed_loop"]):
        add(f"loop_{i}", "ball", child[a], child[b], T[child[a]])
    motors = [j for j in child if any(part in j for part in yaml["name_mot"])]
    plugin = "".join(f"<joint_name>{name}</joint_name>" for name in motors)
    plugin = f'<plugin filename="joint-position-controller" name="p">{plugin}</plugin>'
    parts = [*frames, *rng.permutation(links + joints), plugin]
    file = urdf.with_suffix(".sdf")
    text = f'<sdf version="1.9"><model name="m" canonical_link="{tree.root}">{"".join(parts)}'
    file.write_text(text + "</model></sdf>")
    return file
