"""Writing of URDF: a leg as a tree of joints, a platform as points on a link."""

from collections.abc import Iterable

import numpy as np
from lxml import etree

from pincal.model import Joint, Leg


def leg_urdf(leg: Leg) -> str:
    """Return a leg's URDF: its joints, and the masses of their links."""
    robot, links = etree.Element("robot", name=leg.name), leg_links(leg)
    etree.SubElement(robot, "link", name=links[0])
    for index, joint in enumerate(leg.joints):
        link = etree.SubElement(robot, "link", name=links[index + 1])
        if joint.mass:
            inertial = etree.SubElement(link, "inertial")
            etree.SubElement(inertial, "origin", xyz=numbers_text(joint.centre), rpy="0 0 0")
            etree.SubElement(inertial, "mass", value=numbers_text([joint.mass]))
            moments = dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), "0")
            etree.SubElement(inertial, "inertia", moments)  # only weight matters
        joint_element(robot, joint, links[leg.carriers[index] + 1], links[index + 1])
    return xml_text(robot)


def leg_links(leg: Leg) -> list[str]:
    """Return the names of a leg's links, base first, tip last, different from those of joints."""
    ends = [*(f"{joint.name}_link" for joint in leg.joints[:-1]), "tip"]
    joints = {joint.name for joint in leg.joints}
    names = [f"{leg.name}_{end}" for end in ("base", *ends)]
    return [f"{name}_" if name in joints else name for name in names]


def platform_urdf(name: str, legs: tuple[Leg, ...]) -> str:
    """Return a platform's URDF: one fixed frame for each platform point."""
    robot = etree.Element("robot", name=f"{name}_platform")
    points, root = {point.name: point for leg in legs for point in leg.points}, "platform"
    links = {name: f"{name}_link" for name in points}
    while root in (*points, *links.values()):
        root += "_"
    etree.SubElement(robot, "link", name=root)
    for point in points.values():
        etree.SubElement(robot, "link", name=links[point.name])
        joint_element(robot, point, root, links[point.name])
    return xml_text(robot)


def joint_element(robot: etree._Element, joint: Joint, parent: str, child: str) -> None:
    """Add a joint with all digits of its origin, axis and limits."""
    continuous = joint.kind == "revolute" and not np.isfinite(joint.lower)
    kind = "continuous" if continuous else joint.kind
    element = etree.SubElement(robot, "joint", name=joint.name, type=kind)
    etree.SubElement(element, "parent", link=parent)
    etree.SubElement(element, "child", link=child)
    origin = {"xyz": numbers_text(joint.placement.xyz), "rpy": numbers_text(joint.placement.rpy)}
    etree.SubElement(element, "origin", origin)
    if joint.kind == "fixed":
        return
    etree.SubElement(element, "axis", xyz=numbers_text(joint.axis))
    if not continuous:
        limits = {"lower": numbers_text([joint.lower]), "upper": numbers_text([joint.upper])}
        etree.SubElement(element, "limit", {"effort": "0", "velocity": "0", **limits})
    if joint.follows:
        name, ratio, offset = joint.follows
        law = {"multiplier": numbers_text([ratio]), "offset": numbers_text([offset])}
        etree.SubElement(element, "mimic", {"joint": name, **law})


def numbers_text(values: Iterable[float]) -> str:
    """Return numbers with all their digits, without negative zeros."""
    return " ".join(repr(float(value) + 0.0) for value in values)


def xml_text(root: etree._Element) -> str:
    """Return an XML file's text, indented."""
    etree.indent(root, space="  ")
    return str(etree.tostring(root, encoding="unicode")) + "\n"
