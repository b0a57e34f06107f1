"""Arms of example-robot-data, and the same arms computed by Pinocchio alone."""

from __future__ import annotations

from functools import cache
from importlib.metadata import files
from pathlib import Path

import numpy as np
import pinocchio as pin

import pincal

#: File, link at the foot (the root if empty), link at the end.
ARMS = {
    "ur3": ("ur3_robot.urdf", "", "ee_link"),
    "ur5": ("ur5_robot.urdf", "base_link", "tool0"),
    "ur10": ("ur10_robot.urdf", "base_link", "ee_link"),
    "panda": ("panda.urdf", "panda_link0", "panda_link8"),
    "xarm7": ("xarm7.urdf", "link_base", "link_eef"),
    "kinova": ("kinova.urdf", "j2s6s200_link_base", "j2s6s200_end_effector"),
    "z1": ("z1.urdf", "link00", "gripperStator"),
    "so100": ("so100.urdf", "base", "gripper"),
    "so101": ("so101.urdf", "base_link", "gripper_frame_link"),
    "talos arm": ("talos_left_arm.urdf", "", "wrist_left_ft_link"),
    "talos torso and arm": ("talos_reduced.urdf", "base_link", "arm_left_7_link"),
    "baxter left": ("baxter.urdf", "torso", "left_hand_link"),
    "baxter right": ("baxter.urdf", "torso", "right_hand_link"),
    "tiago": ("tiago_no_hand.urdf", "base_link", "arm_tool_link"),
    "tiago pro": ("tiago_pro.urdf", "torso_lift_link", "arm_left_tool_link"),
    "pr2 left": ("pr2.urdf", "base_link", "l_gripper_palm_link"),
    "pr2 right": ("pr2.urdf", "torso_lift_link", "r_gripper_palm_link"),
    "romeo": ("romeo.urdf", "torso", "l_gripper"),
    "icub": ("icub.urdf", "chest", "l_gripper"),
    "human": ("human.urdf", "middle_pelvis", "left_hand"),
    "anymal-kinova": ("anymal-kinova.urdf", "", "j2s6s200_end_effector"),
    "b1-z1": ("b1-z1.urdf", "", "gripperStator"),
    "alex": ("alex_nub_hands.urdf", "Torso", "leftNub"),
    "g1": ("g1_29dof_rev_1_0.urdf", "torso_link", "left_rubber_hand"),
    "centauro": ("centauro.urdf", "pelvis", "ball1"),
    "humanoid": ("simple_humanoid.urdf", "torso", "l_wrist"),
}


@cache
def urdf(file: str) -> Path:
    """Return where a URDF of example-robot-data is."""
    every = files("example-robot-data") or []
    return next(Path(str(one.locate())) for one in every if one.name == file)


@cache
def loaded(name: str) -> pincal.Mechanism:
    """Return an arm of the table."""
    file, base, tip = ARMS[name]
    return pincal.Mechanism.from_urdf(urdf(file), tip, base or None)


def robot(text: str) -> str:
    """Return a URDF of links l0, l1, ... named in joints that are given as ``kind axis xyz``."""
    lines = [line.split("|") for line in text.strip().splitlines()]
    links = "".join(f'<link name="l{i}"/>' for i in range(len(lines) + 1))
    joints = "".join(
        f'<joint name="{name.strip()}" type="{kind.strip()}"><parent link="l{i}"/>'
        f'<child link="l{i + 1}"/><origin xyz="{xyz.strip()}"/><axis xyz="{axis.strip()}"/>'
        '<limit lower="-1.5" upper="1.5" effort="1" velocity="1"/></joint>'
        for i, (name, kind, axis, xyz) in enumerate(lines)
    )
    return f'<robot name="made">{links}{joints}</robot>'


class Reference:
    """An arm by Pinocchio alone: placements of its URDF displaced, frame after frame.

    Before each joint that moves and before the tool stands Trans(x, y, z) Rx Ry Rz, in the frame
    of the parent link. Pinocchio folds fixed joints into placements, so that a displacement is
    carried to where the folded placement begins.
    """

    def __init__(self, path: Path, tip: str, base: str, joints: tuple[str, ...]) -> None:
        """Read the URDF; ``joints`` are those that move, base first."""
        self.model = pin.buildModelFromUrdf(str(path))
        self.base = self.model.getFrameId(base or self.model.frames[1].name, pin.FrameType.BODY)
        self.tip = self.model.getFrameId(tip, pin.FrameType.BODY)
        self.ids = [self.model.getJointId(name) for name in joints]
        self.home = [placement.copy() for placement in self.model.jointPlacements]
        self.end = self.model.frames[self.tip].placement.copy()
        frames = self.model.frames
        joint_frames = [frames[self.model.getFrameId(n, pin.FrameType.JOINT)] for n in joints]
        self.before = [frames[frame.parentFrame].placement for frame in joint_frames]
        hung = frames[frames[self.tip].parentFrame]  # the joint on which the tip link hangs
        fixed = hung.type == pin.FrameType.FIXED_JOINT
        self.before_tool = frames[hung.parentFrame].placement if fixed else self.end
        self.data = self.model.createData()

    def poses(self, parameters: np.ndarray, joints: np.ndarray) -> np.ndarray:
        """Return ``T_base_tip``, shape (N, 4, 4), displaced by six numbers a joint and tool."""
        moves = [_displacement(six) for six in np.reshape(parameters, (-1, 6))]
        for joint, where, move in zip(self.ids, self.before, moves, strict=False):
            self.model.jointPlacements[joint] = where * move * where.inverse() * self.home[joint]
        where = self.before_tool
        end = where * moves[-1] * where.inverse() * self.end
        out = np.empty((len(joints), 4, 4))
        for row, values in zip(out, joints, strict=True):
            q = pin.neutral(self.model)
            for joint, value in zip(self.ids, values, strict=True):
                one = self.model.joints[joint]
                q[one.idx_q : one.idx_q + one.nq] = (
                    value if one.nq == 1 else (np.cos(value), np.sin(value))
                )
            pin.framesForwardKinematics(self.model, self.data, q)
            carrier = self.data.oMi[self.model.frames[self.tip].parentJoint]
            row[:] = (self.data.oMf[self.base].inverse() * carrier * end).homogeneous
        return out


def _displacement(six: np.ndarray) -> pin.SE3:
    turn = np.eye(3)
    for axis, angle in zip("xyz", six[3:], strict=True):
        turn = turn @ pin.utils.rotate(axis, float(angle))
    return pin.SE3(turn, np.asarray(six[:3]))


@cache
def reference(name: str) -> Reference:
    """Return an arm of the table by Pinocchio alone."""
    file, base, tip = ARMS[name]
    return Reference(urdf(file), tip, base, loaded(name).reading_names)
