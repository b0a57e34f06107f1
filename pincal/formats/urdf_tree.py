"""A URDF as a tree of links and joints; what no leg could have is refused where a leg needs it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from lxml import etree
from scipy.spatial.transform import Rotation

from pincal.errors import MechanismError
from pincal.files.text import read_xml
from pincal.files.urdf import link_of, read_joint, weighed
from pincal.formats.tree import Edge, Tree, root_of, turns, with_ranges
from pincal.model.leg import Joint
from pincal.model.placement import placement_of

XACRO = "python -m pip install xacro; xacro FILE.urdf.xacro > FILE.urdf"
#: Elements of a <robot> that place nothing, or are read.
_KNOWN = ("link", "joint", "material", "transmission", "gazebo", "sensor", "ros2_control")


def read_urdf(path: Path, replaced: Mapping[str, str] | None = None) -> Tree:
    """Return the tree of a URDF; joints that no leg can have are in ``Tree.refused``.

    Args:
        path: The URDF.
        replaced: Axes about which joints turn in place of their own, by name; none to fix one.

    Raises:
        FileError: the file is missing or cannot be read.
        MechanismError: not well-formed, no tree, or an element that may place links.
    """
    robot = read_xml(path, "robot")
    remarks = _unknown_elements(robot, path)
    refused: dict[str, str] = {}
    edges: list[Edge] = []
    for element in robot.findall("joint"):
        name = str(element.get("name"))
        parent, child = link_of(element, "parent", path), link_of(element, "child", path)
        try:
            edges += _edges(element, robot, path, replaced or {})
        except MechanismError as error:
            refused[name] = str(error)
            edges.append(Edge(Joint(name, "revolute"), parent, child))
            continue
        if remark := _remarks(element, edges[-1].joint, f"{path}, line {element.sourceline}"):
            remarks[name] = remark
    links = tuple(str(link.get("name")) for link in robot.findall("link"))
    tree = Tree(
        name=str(robot.get("name") or path.stem),
        source=str(path),
        root=root_of(tuple(edges), links, str(path)),
        edges=tuple(edges),
        loops=(),
        active=(),
        refused=refused,
        remarks=remarks,
    )
    return with_ranges(tree)


def _unknown_elements(robot: etree._Element, path: Path) -> dict[str, str]:
    """Return what to say of elements of a <robot> that are not URDF's.

    Raises:
        MechanismError: a macro, an include, or another format's joint: these may place links.
    """
    remarks: dict[str, str] = {}
    for element in robot:
        if not isinstance(element.tag, str) or element.tag in _KNOWN:
            continue
        prefix = f"{element.prefix}:" if element.prefix else ""
        tag = f"{prefix}{etree.QName(element).localname}"
        named = f"{path}, line {element.sourceline}: <{tag}>"
        if prefix == "xacro:":
            raise MechanismError(f"{named} is a macro, which xacro expands: {XACRO}")
        if "include" in tag or "joint" in tag:
            raise MechanismError(f"{named} may place links, and is not URDF; write URDF without it")
        remarks[tag] = f"{named} is not read"
    return remarks


def _edges(
    element: etree._Element, robot: etree._Element, path: Path, replaced: Mapping[str, str]
) -> tuple[Edge, ...]:
    """Return the edges that a <joint> means.

    Raises:
        MechanismError: no leg can have it.
    """
    name, floating = str(element.get("name")), element.get("type") == "floating"
    parent, child = link_of(element, "parent", path), link_of(element, "child", path)
    axes = replaced.get(name, "XYZxyz" if floating else None)
    if axes is not None:
        placed = read_joint(element, path, "fixed")
        return turns(placed, parent, child, axes) if axes else (Edge(placed, parent, child),)
    joint = weighed(read_joint(element, path), robot, child, path)
    if joint.kind == "fixed" or joint.lower < joint.upper:
        return (Edge(joint, parent, child),)
    still = replace(joint, kind="fixed", axis=Joint.axis, lower=Joint.lower, upper=Joint.upper)
    if joint.lower == 0.0:
        return (Edge(still, parent, child),)
    motion = np.eye(4)
    if joint.kind == "revolute":
        motion[:3, :3] = Rotation.from_rotvec(joint.lower * np.array(joint.axis)).as_matrix()
    else:
        motion[:3, 3] = joint.lower * np.array(joint.axis)
    middle = f"{child}_before"
    moved = replace(still, name=f"{name}_at", placement=placement_of(motion))
    return (Edge(Joint(name, "fixed", joint.placement), parent, middle), Edge(moved, middle, child))


def _remarks(element: etree._Element, joint: Joint, place: str) -> str:
    """Return what to say of a joint that a leg has; nothing if it is an ordinary one."""
    name, remarks = element.get("name"), []
    if joint.kind == "fixed" and element.get("type") in ("revolute", "prismatic"):
        remarks.append(f"joint {name!r} has equal limits: it is fixed there")
    if element.find("calibration") is not None:
        remarks.append(
            f"<calibration> of joint {name!r} says where switches are, and is not read: readings "
            "count from the zero of the URDF"
        )
    rpy = element.find("origin[@rpy]")
    if rpy is not None and np.abs(joint.placement.rpy).max() > 2 * np.pi:
        remarks.append(
            f"rpy={rpy.get('rpy')!r} is more than a turn: radians are expected; is this degrees?"
        )
    return f"{place}: {'; '.join(remarks)}" if remarks else ""
