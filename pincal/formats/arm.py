"""A serial arm is a mechanism of one leg: all its joints are read, and its tip is the platform.

Each joint's placement on its parent link, and the tool's on the last one, has six small
displacements as parameters; with base and tool unknown that is one set more than there are joints.
Which of them are not observable is found when measurements are planned or made.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pincal.errors import MechanismError
from pincal.formats.tree import FREE, Edge, Tree
from pincal.formats.urdf_tree import read_urdf
from pincal.kinematics.closure import LegClosure
from pincal.model.checks import must_be
from pincal.model.consistency import identifiers
from pincal.model.leg import Joint, Leg
from pincal.model.mechanism import Mechanism
from pincal.model.placement import Coordinate, Placement
from pincal.model.platform import Platform
from pincal.model.sensor import Sensor

_AXES = ("x", "y", "z", "rx", "ry", "rz")
TOOL = "tool"


def load_arm(path: str | Path, tip: str, base: str | None = None) -> Mechanism:
    """Return a serial arm from any URDF: see ``Mechanism.from_urdf``."""
    path = Path(must_be(path, (str, Path), "a URDF file", MechanismError))
    return replace(serial_arm(read_urdf(path), tip, base), name=re.sub(r"\W", "_", path.stem))


def serial_arm(tree: Tree, tip: str, base: str | None = None) -> Mechanism:
    """Return the serial arm between two links of a tree; loops are left out.

    Raises:
        MechanismError: no such link, no chain of joints from base to tip, or a joint in it that an
            arm cannot have.
    """
    link = tree.link(tip, "the tip")
    foot = tree.root if base is None else tree.link(base, "the base")
    carrying = {edge.child: edge for edge in tree.edges}
    edges: list[Edge] = []
    while link != foot and link in carrying:
        edges.insert(0, carrying[link])
        link = carrying[link].parent
    if link != foot:
        raise MechanismError(f"{tree.source}: no chain of joints leads from {base!r} to {tip!r}")
    names = [edge.joint.name for edge in edges]
    for i, name in enumerate(names):
        stem = name.removesuffix(f"_{FREE[0]}")
        if names[i : i + len(FREE)] == [f"{stem}_{end}" for end in FREE]:
            floor = edges[i + len(FREE) - 1].child
            raise MechanismError(
                f"{tree.source}: joint {stem!r} lets link {floor!r} float, and an arm stands on a "
                f"base; import it with --base {floor}"
            )
    tree.check_joints(names)
    path, joints = Path(tree.source), tuple(edge.joint for edge in edges)
    try:
        return arm(re.sub(r"\W", "_", tree.name), joints, f"Serial arm to {tip} of {path.name}.")
    except MechanismError as error:
        remarks = [tree.remarks[name] for name in names if name in tree.remarks]
        raise MechanismError("; ".join([f"{path}: {error}", *remarks[:1]])) from error


def arm(name: str, joints: tuple[Joint, ...], description: str = "") -> Mechanism:
    """Return a serial arm of joints, six small displacements at each that moves and at the tool.

    Args:
        name: Of the mechanism.
        joints: Base first, fixed ones included; parameters that they have are kept.
        description: Of the mechanism.

    Raises:
        MechanismError: no joint moves; names that are alike.
    """
    moving = [joint for joint in joints if joint.kind != "fixed"]
    if not moving:
        raise MechanismError(f"{name}: no joint moves")
    if joints[-1].kind != "fixed":
        joints = (*joints, Joint("tip", "fixed"))
    joints = tuple(replace(joint, home=_home(joint)) for joint in joints)
    placed, parameters = displaced_joints(joints, _stems(moving), TOOL, _AXES)
    leg = Leg(
        name="arm",
        joints=placed,
        sensors=tuple(Sensor(joint.name) for joint in moving),
        parameters=tuple(parameters.items()),
        point=Joint(identifiers((*(joint.name for joint in placed), TOOL))[-1], "fixed"),
        tip="tip",
        closes="frame",
    )
    free = Platform("spatial", (0.0,) * 6)
    home = free.from_matrices(LegClosure(leg, free).frame(leg.home[None]))[0]
    return Mechanism(name, Platform("spatial", tuple(home.tolist())), (leg,), description)


def displaced_joints(
    joints: Sequence[Joint], stems: Sequence[str], end: str, axes: Sequence[str]
) -> tuple[tuple[Joint, ...], dict[str, float]]:
    """Return joints with small displacements at each that moves and at the last, and these.

    Args:
        joints: Base first; the last is fixed.
        stems: What the names of the moving joints' displacements begin with.
        end: What those of the last joint's begin with.
        axes: Of the displacements.
    """
    parameters: dict[str, float] = {}
    placed, moving_stems = [], iter(stems)
    for joint in joints:
        if joint.kind != "fixed" or joint is joints[-1]:
            stem = end if joint is joints[-1] else next(moving_stems)
            placement, names = displaced(joint.placement, stem, axes)
            joint, parameters = replace(joint, placement=placement), parameters | names
        placed.append(joint)
    return tuple(placed), parameters


def displaced(
    placement: Placement, stem: str, axes: Sequence[str]
) -> tuple[Placement, dict[str, float]]:
    """Return a placement with small displacements along axes, and their names, each zero."""
    names = [f"{stem}_{axis}" for axis in axes]
    steps = [Coordinate(axis, (name,)) for axis, name in zip(axes, names, strict=True)]
    shifts = zip("xyz", placement.xyz, strict=True)
    steps += [Coordinate(axis, (value,)) for axis, value in shifts if value]
    return Placement(tuple(steps), placement.xyz, placement.rpy), dict.fromkeys(names, 0.0)


def _stems(joints: Sequence[Joint]) -> Sequence[str]:
    """Return what the names of each joint's parameters begin with, no two alike."""
    names = identifiers((TOOL, *(joint.name for joint in joints)))[1:]
    stems = [name.removesuffix("_joint") for name in names]
    return names if len({TOOL, *stems}) <= len(stems) else stems


def _home(joint: Joint) -> float:
    """Return a joint's position at home: zero, or the middle of limits that bar it."""
    if joint.kind == "fixed" or joint.lower <= 0.0 <= joint.upper:
        return 0.0
    return float(np.mean([joint.lower, joint.upper]))
