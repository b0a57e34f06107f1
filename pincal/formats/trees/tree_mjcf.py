"""A tree with loops as MJCF: a body for each link, sites that meet, actuators, home as keyframe.

All hangs on one body of the world, because Pinocchio's parser reads no second one. Masses are
there because MuJoCo asks for them, and mean nothing.
"""

from __future__ import annotations

import numpy as np
from lxml import etree
from scipy.spatial.transform import Rotation

from pincal.formats.trees.tree import Edge, Tree
from pincal.model.placement import Placement

_TURNS = ("x", "y", "z")


def mjcf(tree: Tree) -> str:
    """Return the MJCF file of a tree."""
    root = etree.Element("mujoco", model=tree.name)
    etree.SubElement(root, "compiler", angle="radian", autolimits="true")
    world = etree.SubElement(root, "worldbody")
    bodies = {tree.root: etree.SubElement(world, "body", name=tree.root)}
    size = _size(tree)
    home: list[float] = []
    _children(tree, tree.root, bodies, home, size)
    _loops(tree, root, bodies)
    actuators = etree.SubElement(root, "actuator")
    for name in tree.active:
        etree.SubElement(actuators, "position", name=name, joint=name)
    frames = etree.SubElement(root, "keyframe")
    etree.SubElement(frames, "key", name="home", qpos=_text(home))
    etree.indent(root, space="  ")
    return str(etree.tostring(root, encoding="unicode")) + "\n"


def _children(
    tree: Tree, link: str, bodies: dict[str, etree._Element], home: list[float], size: float
) -> None:
    """Enter the bodies on a link, and their joints' home positions in the same order."""
    for edge in tree.edges:
        if edge.parent != link:
            continue
        three = _ball(tree, edge)
        child = three[-1].child if three else edge.child
        placement = edge.joint.placement
        body = etree.SubElement(bodies[link], "body", {"name": child, **_pose(placement)})
        etree.SubElement(body, "inertial", pos="0 0 0", mass="0.1", diaginertia="0.001 0.001 0.001")
        if three:
            angles = [one.joint.home for one in three]
            x, y, z, w = Rotation.from_euler("XYZ", angles).as_quat()
            etree.SubElement(body, "joint", name=_stem(edge), type="ball")
            home += [w, x, y, z]
        elif edge.joint.kind != "fixed":
            _joint(body, edge)
            home.append(edge.joint.home)
        if any(abs(value) > 1e-9 for value in placement.xyz) and not three:
            shape = {"fromto": f"0 0 0 {_text(placement.xyz)}", "size": f"{size:.6g}"}
            looks = {"type": "capsule", "contype": "0", "conaffinity": "0", "mass": "0"}
            etree.SubElement(bodies[link], "geom", {**shape, **looks})
        bodies[child] = body
        _children(tree, child, bodies, home, size)


def _ball(tree: Tree, edge: Edge) -> tuple[Edge, ...]:
    """Return the three turns that begin with an edge and are one ball joint; none if not so."""
    place = tree.edges.index(edge)
    three = tree.edges[place : place + 3]
    names = [f"{_stem(edge)}_{axis}" for axis in _TURNS]
    return three if [one.joint.name for one in three] == names else ()


def _stem(edge: Edge) -> str:
    return edge.joint.name.removesuffix("_x")


def _joint(body: etree._Element, edge: Edge) -> None:
    joint = edge.joint
    kind = "slide" if joint.kind == "prismatic" else "hinge"
    limits = {}
    if np.isfinite([joint.lower, joint.upper]).all():
        limits = {"range": _text((joint.lower, joint.upper))}
    etree.SubElement(
        body, "joint", {"name": joint.name, "type": kind, "axis": _text(joint.axis), **limits}
    )


def _loops(tree: Tree, root: etree._Element, bodies: dict[str, etree._Element]) -> None:
    """Enter a site at either end of each loop, and that they meet."""
    if not tree.loops:
        return
    equality = etree.SubElement(root, "equality")
    for loop in tree.loops:
        tag = "connect" if loop.closes == "point" else "weld"
        ends = {}
        for key, spot in (("site1", loop.first), ("site2", loop.second)):
            ends[key] = f"{loop.name}_{key}"
            pose = _pose(spot.placement)
            site = etree.Element("site", {"name": ends[key], **pose})
            bodies[spot.link].insert(1, site)
        etree.SubElement(equality, tag, {"name": loop.name, **ends})


def _pose(placement: Placement) -> dict[str, str]:
    pose = {}
    if any(placement.xyz):
        pose["pos"] = _text(placement.xyz)
    if any(placement.rpy):
        x, y, z, w = Rotation.from_matrix(placement.origin()[:3, :3]).as_quat()
        pose["quat"] = _text((w, x, y, z))
    return pose


def _size(tree: Tree) -> float:
    """Return a radius for rods, [m]."""
    lengths = [float(np.linalg.norm(edge.joint.placement.xyz)) for edge in tree.edges]
    return 0.02 * (max(lengths) or 1.0)


def _text(values: tuple[float, ...] | list[float]) -> str:
    return " ".join(repr(float(value) + 0.0) for value in values)
