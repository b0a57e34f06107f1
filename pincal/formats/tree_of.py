"""A mechanism as a tree with loops, as it is written for neighbours.

The platform hangs on the base by its own freedoms, all passive, and each leg ends in a loop with
it: so legs of any number of joints, and platforms of any kind, come out alike, and come in again.
A serial arm has no loop, and its tip is the platform.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np
import yaml
from lxml import etree

from pincal.errors import MechanismError
from pincal.files.urdf_writing import ends_element, joint_element, xml_text
from pincal.formats.tree import FREE, Edge, Loop, Spot, Tree, at_home, turns
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
        closing, platform = assembled(mechanism.legs, mechanism.platform.form)
        mechanism = replace(mechanism, legs=closing, platform=platform)
    names = [joint.name for leg in mechanism.legs for joint in leg.joints]
    shared = len(set(names)) != len(names) or PLATFORM in names
    legs = tuple(_named(leg) if shared else leg for leg in mechanism.legs)
    edges: tuple[Edge, ...] = ()
    loops: list[Loop] = []
    serial = _is_serial(legs)
    if not serial:
        edges += _floating(mechanism)
    for leg in legs:
        links = [BASE, *(f"{leg.name}_link_{index + 1}" for index in range(len(leg.joints)))]
        links[-1] = PLATFORM if serial else links[-1]
        edges += tuple(map(Edge, leg.joints, links[:-1], links[1:]))
        if not serial:
            point = f"{leg.name}_{leg.point.name}" if shared else leg.point.name
            edges += (Edge(_point(leg, mechanism, point), PLATFORM, f"{leg.name}_end"),)
            loops.append(Loop(leg.name, Spot(links[-1]), Spot(f"{leg.name}_end"), leg.closes))
    tree = Tree(
        name=mechanism.name,
        source=mechanism.name,
        root=BASE,
        edges=edges,
        loops=tuple(loops),
        active=tuple(sensor.joint for leg in legs for sensor in leg.sensors),
        platform=PLATFORM,
        homed=True,
    )
    return tree, unwritten(mechanism)


def _is_serial(legs: tuple[Leg, ...]) -> bool:
    """Return whether there is but one leg, an arm, and its tip is the platform."""
    arm = len(legs) == 1 and legs[0].closes == "frame" and not legs[0].passive
    return arm and np.array_equal(legs[0].point.placement.origin(), np.eye(4))


def _named(leg: Leg) -> Leg:
    """Return a leg whose joints' names begin with its own."""
    joints = tuple(replace(joint, name=f"{leg.name}_{joint.name}") for joint in leg.joints)
    sensors = tuple(replace(sensor, joint=f"{leg.name}_{sensor.joint}") for sensor in leg.sensors)
    return replace(leg, joints=joints, sensors=sensors)


def _floating(mechanism: Mechanism) -> tuple[Edge, ...]:
    """Return the platform's freedoms as joints, at home."""
    platform = mechanism.platform
    freedoms = "".join("XYZxyz"[row] for row in platform.twist_rows)
    edges = turns(Joint(PLATFORM, "fixed"), BASE, PLATFORM, freedoms)
    T_base_platform = platform.home_pose.as_matrix()[0]
    x, y, z = turns_in_series(T_base_platform[None, :3, :3])[0]
    values = dict(zip(FREE, (*T_base_platform[:3, 3], x, y, z), strict=True))
    reach = sum(LegClosure(leg, platform).reach for leg in mechanism.legs)
    limited = tuple(
        replace(edge, joint=replace(edge.joint, lower=-reach, upper=reach))
        if edge.joint.kind == "prismatic"
        else edge
        for edge in edges
    )
    return at_home(limited, {f"{PLATFORM}_{key}": float(value) for key, value in values.items()})


def _point(leg: Leg, mechanism: Mechanism, name: str) -> Joint:
    """Return a platform point; in the plane at the height of the leg's tip."""
    placement = Placement((), leg.point.placement.xyz, leg.point.placement.rpy)
    if mechanism.platform.space == 2:
        closure = LegClosure(leg, mechanism.platform)
        tip = _height(leg) if leg.closes == "point" else closure.frame(leg.home[None])[0, 2, 3]
        placement = replace(placement, xyz=(*placement.xyz[:2], float(tip)))
    return Joint(name, "fixed", placement)


def _height(leg: Leg) -> float:
    """Return the height of a planar leg's tip, which no joint changes, [m]."""
    T_base_link = np.eye(4)
    for joint in leg.joints:
        T_base_link = T_base_link @ joint.placement.origin()
    return float(T_base_link[2, 3])


def unwritten(mechanism: Mechanism) -> tuple[str, ...]:
    """Return what neighbours' files have no place for."""
    converting = [
        leg.name
        for leg in mechanism.legs
        for sensor in leg.sensors
        if not sensor.reads_position(leg.nominal_by_name)
    ]
    grown = [leg.name for leg in mechanism.legs if leg.terms]
    lost = [
        f"the file holds one machine, at the reference of its influences: lengths and angles of "
        f"{', '.join(grown)} that follow these (terms) are as they are there"
    ] * bool(grown)
    if not converting:
        return tuple(lost)
    has_terms = any(sensor.terms for leg in mechanism.legs for sensor in leg.sensors)
    laws = "gains, offsets, zeros and terms" if has_terms else "gains, offsets and zeros"
    return (
        f"the file holds joint positions, not readings: {laws} of the sensors of "
        f"{', '.join(dict.fromkeys(converting))} have no place in it",
        *lost,
    )


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
                ends_element(element, free[0].parent, edge.child)
            continue
        joint_element(robot, edge.joint, edge.parent, edge.child)
    return xml_text(robot)


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
