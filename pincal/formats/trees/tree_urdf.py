"""A tree with loops as a URDF and the YAML file that closes its loops (see ``loops_yaml``)."""

from __future__ import annotations

import numpy as np
import yaml
from lxml import etree

from pincal.formats.trees.tree import FREE, Edge, Tree


def loops_urdf(tree: Tree) -> str:
    """Return the URDF of a tree; six freedoms of a platform are one floating joint."""
    robot = etree.Element("robot", name=tree.name)
    free = _free(tree)
    for link in tree.links:
        if link not in {edge.child for edge in free[:-1]}:
            etree.SubElement(robot, "link", name=link)
    for edge in tree.edges:
        if edge in free:
            if edge is free[-1]:
                element = etree.SubElement(robot, "joint", name=edge.child, type="floating")
                _ends(element, free[0].parent, edge.child)
            continue
        _joint(robot, edge)
    etree.indent(robot, space="  ")
    return str(etree.tostring(robot, encoding="unicode")) + "\n"


def loops_yaml(tree: Tree) -> str:
    """Return the YAML file that closes the loops of a tree."""
    free = {edge.joint.name for edge in _free(tree)}
    moving = [edge.joint for edge in tree.edges if edge.joint.kind != "fixed"]
    data = {
        "closed_loop": [[loop.first.link, loop.second.link] for loop in tree.loops],
        "type": ["3d" if loop.closes == "point" else "6d" for loop in tree.loops],
        "name_mot": list(tree.active),
        "joint_name": [],
        "joint_type": [],
        "platform": tree.platform,
        "home": {joint.name: joint.home for joint in moving if joint.name not in free},
    }
    head = "# Loops of the URDF beside it. Keys of example-parallel-robots; platform and home are\n"
    head += "# pincal's, and may be left out where the loops close with all joints at zero.\n"
    return head + yaml.safe_dump(data, sort_keys=False, width=100, default_flow_style=None)


def _free(tree: Tree) -> tuple[Edge, ...]:
    """Return the joints of a platform with six freedoms, none for another."""
    free = tree.edges[:6]
    names = [f"{tree.platform}_{end}" for end in FREE]
    return free if [edge.joint.name for edge in free] == names else ()


def _joint(robot: etree._Element, edge: Edge) -> None:
    joint = edge.joint
    continuous = joint.kind == "revolute" and not np.isfinite(joint.lower)
    kind = "continuous" if continuous else joint.kind
    element = etree.SubElement(robot, "joint", name=joint.name, type=kind)
    _ends(element, edge.parent, edge.child)
    placement = joint.placement
    etree.SubElement(element, "origin", xyz=_text(placement.xyz), rpy=_text(placement.rpy))
    if joint.kind == "fixed":
        return
    etree.SubElement(element, "axis", xyz=_text(joint.axis))
    if not continuous:
        limits = {"lower": repr(float(joint.lower)), "upper": repr(float(joint.upper))}
        etree.SubElement(element, "limit", {"effort": "0", "velocity": "0", **limits})


def _ends(element: etree._Element, parent: str, child: str) -> None:
    etree.SubElement(element, "parent", link=parent)
    etree.SubElement(element, "child", link=child)


def _text(values: tuple[float, float, float]) -> str:
    return " ".join(repr(float(value) + 0.0) for value in values)
