"""Writing of URDF: a leg as a tree of joints with simple shapes, a platform as points on a link."""

from collections.abc import Iterable

import numpy as np
from lxml import etree

from pincal.model import Joint, Leg, Placement

Triple = tuple[float, float, float]
_COLOURS = {"orange": "0.85 0.37 0.01 1", "blue": "0.12 0.47 0.71 1", "grey": "0.35 0.35 0.35 1"}


def leg_urdf(leg: Leg) -> str:
    """Return a leg's URDF: its joints, a box at its foot, and rods from each joint to the next."""
    robot = etree.Element("robot", name=leg.name)
    size = _size(leg)
    read = {sensor.joint for sensor in leg.sensors}
    links = leg_links(leg)
    elements = [etree.SubElement(robot, "link", name=links[0])]
    foot = (3 * size, 3 * size, size)
    _visual(elements[0], "grey", "box", size=foot, xyz=leg.joints[0].placement.xyz)
    for index, joint in enumerate(leg.joints):
        carrier = leg.carriers[index] + 1
        if not np.allclose(joint.placement.xyz, 0.0) and carrier > 0:
            _rod(elements[carrier], joint.placement.xyz, size)
        link = etree.SubElement(robot, "link", name=links[index + 1])
        if joint.mass:
            inertial = etree.SubElement(link, "inertial")
            etree.SubElement(inertial, "origin", xyz=numbers_text(joint.centre), rpy="0 0 0")
            etree.SubElement(inertial, "mass", value=numbers_text([joint.mass]))
            moments = dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), "0")
            etree.SubElement(inertial, "inertia", moments)  # only weight matters
        colour, axis = "orange" if joint.name in read else "blue", joint.axis
        if joint.kind == "revolute":
            _visual(link, colour, "cylinder", along=axis, radius=size, length=3 * size)
        elif joint.kind == "prismatic":
            _visual(link, colour, "box", along=axis, size=(2 * size, 2 * size, 4 * size))
        else:
            _visual(link, "blue", "sphere", radius=size)
        joint_element(robot, joint, links[carrier], links[index + 1])
        elements.append(link)
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
    size = max(_size(leg) for leg in legs)
    points, root = {point.name: point for leg in legs for point in leg.points}, "platform"
    links = {name: f"{name}_link" for name in points}
    while root in (*points, *links.values()):
        root += "_"
    platform = etree.SubElement(robot, "link", name=root)
    _visual(platform, "grey", "cylinder", radius=1.5 * size, length=size)
    for point in points.values():
        if not np.allclose(point.placement.xyz, 0.0):
            _rod(platform, point.placement.xyz, size)
    for point in points.values():
        link = etree.SubElement(robot, "link", name=links[point.name])
        _visual(link, "grey", "sphere", radius=1.2 * size)
        joint_element(robot, point, root, links[point.name])
    return xml_text(robot)


def _size(leg: Leg) -> float:
    """Return a radius for joints, 3 % of the longest link or half stroke, to two digits, [m]."""
    lengths = [float(np.linalg.norm(joint.placement.xyz)) for joint in leg.joints[1:]]
    lengths += [abs(joint.home) / 2 for joint in leg.joints if joint.kind == "prismatic"]
    return float(f"{0.03 * (max(lengths) or 1.0):.1e}")


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


def _rod(link: etree._Element, end: Triple, size: float) -> None:
    """Add a cylinder from the link's origin to a point of it."""
    (x, y, z), length = end, float(np.linalg.norm(end))
    middle = (x / 2, y / 2, z / 2)
    _visual(link, "grey", "cylinder", xyz=middle, along=end, radius=size / 2, length=length)


def _visual(
    link: etree._Element,
    colour: str,
    shape: str,
    *,
    xyz: Triple = Placement.xyz,
    along: Triple = (0.0, 0.0, 1.0),
    **size: float | Triple,
) -> None:
    """Add a shape to a link with its z axis along a vector; lengths in [m], twelve digits."""
    x, y, z = along
    rpy = (0.0, float(np.arctan2(np.hypot(x, y), z)), float(np.arctan2(y, x)))
    visual = etree.SubElement(link, "visual")
    if any((*xyz, *rpy)):
        etree.SubElement(visual, "origin", xyz=_rounded(xyz), rpy=_rounded(rpy))
    texts = {key: _rounded(value) for key, value in size.items()}
    etree.SubElement(etree.SubElement(visual, "geometry"), shape, texts)
    material = etree.SubElement(visual, "material", name=colour)
    etree.SubElement(material, "color", rgba=_COLOURS[colour])


def _rounded(values: float | Triple) -> str:
    """Return numbers with twelve digits, since the last ones of arctangents vary by processor."""
    return " ".join(f"{np.round(v, 12) + 0.0:.12g}" for v in np.atleast_1d(values))


def numbers_text(values: Iterable[float]) -> str:
    """Return numbers with all their digits, without negative zeros."""
    return " ".join(repr(float(value) + 0.0) for value in values)


def xml_text(root: etree._Element) -> str:
    """Return an XML file's text, indented."""
    etree.indent(root, space="  ")
    return str(etree.tostring(root, encoding="unicode")) + "\n"
