"""A mechanism as a tree with loops, as it is written for neighbours.

The platform hangs on the base by its own freedoms, all passive, and each leg ends in a loop with
it: so legs of any number of joints, and platforms of any kind, come out alike, and come in again.
A serial arm has no loop, and its tip is the platform.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import yaml
from lxml import etree

from pincal.errors import MechanismError
from pincal.files.urdf import ends_element, joint_element, xml_text
from pincal.formats.tree import FREE, Edge, Tree, turns
from pincal.kinematics.assembly import assembled
from pincal.kinematics.closure import LegClosure
from pincal.model.leg import Joint, Leg
from pincal.model.mechanism import Mechanism
from pincal.model.orientation import turns_in_series
from pincal.model.placement import Placement

BASE, PLATFORM = "base", "platform"


def tree_of(mechanism: Mechanism) -> tuple[Tree, tuple[str, ...]]:
    """Return the tree of a mechanism at nominal parameters, and sentences on what it cannot hold.

    Joints keep their names if all legs' differ; else they are ``leg_joint``. Home closes the loops
    if it can.
    """
    with suppress(MechanismError):
        legs, platform = assembled(mechanism.legs, mechanism.platform)
        mechanism = replace(mechanism, legs=legs, platform=platform)
    names = [joint.name for leg in mechanism.legs for joint in leg.joints]
    shared = len(set(names)) != len(names) or PLATFORM in names
    only, loops, active = mechanism.legs[0], [], []
    serial = len(mechanism.legs) == 1 and only.is_arm and only.point.placement == Placement()
    edges = [] if serial else _floating(mechanism)
    for leg in mechanism.legs:
        stem = f"{leg.name}_" * shared
        joints = [replace(joint, name=stem + joint.name) for joint in leg.joints]
        active += [stem + sensor.joint for sensor in leg.sensors]
        links = [BASE, *(f"{leg.name}_link_{index + 1}" for index in range(len(joints)))]
        links[-1] = PLATFORM if serial else links[-1]
        edges += map(Edge, joints, links[:-1], links[1:])
        if not serial:
            point = Joint(stem + leg.point.name, "fixed", _point(leg, mechanism))
            edges.append(Edge(point, PLATFORM, f"{leg.name}_end"))
            end = Joint(leg.name, "fixed")
            loops.append(Edge(end, links[-1], f"{leg.name}_end", closes=leg.closes))
    tree = Tree(
        name=mechanism.name,
        source=mechanism.name,
        root=BASE,
        edges=tuple(edges),
        loops=tuple(loops),
        active=tuple(active),
        platform=PLATFORM,
        homed=True,
    )
    return tree, unwritten(mechanism)


def _floating(mechanism: Mechanism) -> list[Edge]:
    """Return the platform's freedoms as joints, at home."""
    platform = mechanism.platform
    freedoms = "".join("XYZxyz"[row] for row in platform.twist_rows)
    edges = list(turns(Joint(PLATFORM, "fixed"), BASE, PLATFORM, freedoms))
    T_base_platform = platform.home_pose.as_matrix()[0]
    home = (*T_base_platform[:3, 3], *turns_in_series(T_base_platform[None, :3, :3])[0])
    reach = sum(LegClosure(leg, platform).reach for leg in mechanism.legs)
    for i, (edge, row) in enumerate(zip(edges, platform.twist_rows, strict=True)):
        joint = replace(edge.joint, home=float(home[row]))
        if joint.kind == "prismatic":
            joint = replace(joint, lower=-reach, upper=reach)
        edges[i] = replace(edge, joint=joint)
    return edges


def _point(leg: Leg, mechanism: Mechanism) -> Placement:
    """Return where a platform point is; in the plane at the height of the leg's tip."""
    placement = Placement((), leg.point.placement.xyz, leg.point.placement.rpy)
    if mechanism.platform.space == 2:
        tip = leg.link_placements(leg.home[None])[0, -1]
        placement = replace(placement, xyz=(*placement.xyz[:2], float(tip[2, 3])))
    return placement


def unwritten(mechanism: Mechanism) -> tuple[str, ...]:
    """Return what neighbours' files have no place for."""
    remarks = []
    converting = [
        leg.name
        for leg in mechanism.legs
        if not all(sensor.reads_position(leg.nominal_by_name) for sensor in leg.sensors)
    ]
    if converting:
        remarks.append(
            "the file holds joint positions, not readings: gains, offsets, zeros and terms of the "
            f"sensors of {', '.join(converting)} have no place in it"
        )
    if grown := [leg.name for leg in mechanism.legs if leg.terms]:
        remarks.append(
            "the file holds one machine, at the reference of its influences: lengths and angles of "
            f"{', '.join(grown)} that follow these (terms) are as they are there"
        )
    return tuple(remarks)


def loops_urdf(tree: Tree) -> str:
    """Return the URDF of a tree; six freedoms of a platform are one floating joint."""
    robot = etree.Element("robot", name=tree.name)
    free = _free(tree)
    between = {edge.child for edge in free[:-1]}
    for link in tree.links:
        if link not in between:
            etree.SubElement(robot, "link", name=link)
    if free:
        element = etree.SubElement(robot, "joint", name=free[-1].child, type="floating")
        ends_element(element, free[0].parent, free[-1].child)
    for edge in tree.edges[len(free) :]:
        joint_element(robot, edge.joint, edge.parent, edge.child)
    return xml_text(robot)


def loops_yaml(tree: Tree) -> str:
    """Return the YAML file that closes the loops of a tree."""
    free = {edge.joint.name for edge in _free(tree)}
    moving = [edge.joint for edge in tree.edges if edge.joint.kind != "fixed"]
    data = {
        "closed_loop": [[loop.parent, loop.child] for loop in tree.loops],
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
