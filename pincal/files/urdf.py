"""URDF in: joints, of which every element is read or refused, and legs that are one chain.

URDF out: a leg as a chain of joints with simple shapes, a platform as points on a link.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
from lxml import etree
from scipy.spatial.transform import Rotation

from pincal.errors import MechanismError
from pincal.files.text import plain_number, read_xml, why_no_number
from pincal.model.checks import LARGEST
from pincal.model.leg import Joint, JointKind, Leg
from pincal.model.placement import Placement, placement_of

Triple = tuple[float, float, float]
_COLOURS = {
    "orange": "0.85 0.37 0.01 1",
    "blue": "0.12 0.47 0.71 1",
    "grey": "0.35 0.35 0.35 1",
}

#: Elements of a joint, and their attributes that are read; others are refused.
_PLACING = {
    "joint": {"name", "type", "dont_collapse"},
    "origin": {"xyz", "rpy", "quat_xyzw"},
    "axis": {"xyz"},
    "parent": {"link"},
    "child": {"link"},
}
#: Elements of a joint whose attributes place nothing, but for limits, which are read.
_PLACING_NOTHING = {"limit", "mimic", "dynamics", "safety_controller", "calibration"}
_KINDS: dict[str, JointKind] = {
    "revolute": "revolute",
    "continuous": "revolute",
    "prismatic": "prismatic",
    "fixed": "fixed",
}


def read_chain(path: Path, tip: str) -> tuple[Joint, ...]:
    """Return the joints from a URDF's root link to its tip link, base first."""
    robot = read_xml(path, "robot")
    ahead, children = _joints_ahead(robot, path)
    links = sorted(str(link.get("name")) for link in robot.findall("link"))
    roots = [link for link in dict.fromkeys(links) if link not in children]
    if tip not in links:
        raise MechanismError(
            f"{path}: no link named {tip!r} for the tip; it has {', '.join(links) or 'no links'}"
        )
    if len(roots) != 1:
        raise MechanismError(
            f"{path}: {len(roots)} root links ({', '.join(roots) or 'loop'}); a leg must be one "
            "serial chain with one root"
        )
    link, chain = roots[0], []
    while link != tip:
        if link not in ahead:
            raise MechanismError(
                f"{path}: the chain from the root ends at {link!r}, not at {tip!r}"
            )
        element = ahead[link]
        link = link_of(element, "child", path)
        if element.get("type") in ("revolute", "prismatic") and element.find("limit") is None:
            raise MechanismError(
                f"{path}, line {element.sourceline}: joint {element.get('name')!r} needs a <limit>"
            )
        chain.append(weighed(read_joint(element, path), robot, link, path))
    if not any(joint.kind != "fixed" for joint in chain):
        raise MechanismError(f"{path}: no joint moves between the root link and {tip!r}")
    return tuple(chain)


def _joints_ahead(robot: etree._Element, path: Path) -> tuple[dict[str, etree._Element], set[str]]:
    """Return the joints by the links that carry them, one each, and the links that they carry."""
    ahead: dict[str, etree._Element] = {}
    children: set[str] = set()
    for element in robot.findall("joint"):
        parent, child = link_of(element, "parent", path), link_of(element, "child", path)
        if parent in ahead or child in children:
            raise MechanismError(
                f"{path}, line {element.sourceline}: link {parent!r} branches or closes a loop; a "
                "leg must be a serial chain, one joint from each link to the next"
            )
        ahead[parent] = element
        children.add(child)
    return ahead, children


def weighed(joint: Joint, robot: etree._Element, link: str, path: Path) -> Joint:
    """Return a joint with the mass of the link behind it, if its URDF says one."""
    links = (element for element in robot.findall("link") if element.get("name") == link)
    inertial = next((element.find("inertial") for element in links), None)
    element = None if inertial is None else inertial.find("mass")
    if inertial is None or element is None:
        return joint
    place = f"{path}, line {element.sourceline}"
    mass = _number(element.get("value", "0"), place)
    if mass < 0.0:
        raise MechanismError(f"{place}: link {link!r} has the mass {mass:g}; expected 0 or more")
    centre = _triple(inertial.find("origin"), "xyz", place, (0.0, 0.0, 0.0))
    return replace(joint, mass=mass, centre=centre if mass else (0.0, 0.0, 0.0))


def read_points(path: Path) -> dict[str, Joint]:
    """Return the fixed joints of a platform URDF by the names of joint and child link."""
    points: dict[str, Joint] = {}
    elements = read_xml(path, "robot").findall("joint")
    children = {link_of(element, "child", path) for element in elements}
    for element in elements:
        joint = read_joint(element, path)
        if joint.kind != "fixed":
            continue
        if link_of(element, "parent", path) in children:
            raise MechanismError(
                f"{path}, line {element.sourceline}: joint {joint.name!r} sits on another "
                "frame; fix each platform point to the platform's root link"
            )
        for name in {joint.name, link_of(element, "child", path)}:
            if name in points:
                raise MechanismError(
                    f"{path}, line {element.sourceline}: {name!r} names two points; give each "
                    "joint and link a name of its own"
                )
            points[name] = joint
    return points


def read_joint(element: etree._Element, path: Path, kind: str | None = None) -> Joint:
    """Return a <joint> of a URDF, read as its type or another kind; limits may be equal."""
    place = f"{path}, line {element.sourceline}"
    name, kind = element.get("name"), kind or element.get("type")
    if not name:
        raise MechanismError(f"{place}: a joint without a name")
    _check_parts(element, f"{place}: joint {name!r}")
    if kind not in _KINDS:
        raise MechanismError(
            f"{place}: joint {name!r} is of type {kind!r}; a leg may have {', '.join(_KINDS)}"
        )
    if element.find("mimic") is not None and kind != "fixed":
        raise MechanismError(f"{place}: joint {name!r} mimics another; a leg's joints are its own")
    placement = Placement(
        xyz=_triple(element.find("origin"), "xyz", place, (0.0, 0.0, 0.0)),
        rpy=_turn(element, place),
    )
    if kind == "fixed":
        return Joint(name, "fixed", placement)
    axis = np.array(_triple(element.find("axis"), "xyz", place, (1.0, 0.0, 0.0)))
    norm = float(np.linalg.norm(axis))
    if norm < 1e-9:
        raise MechanismError(f"{place}: joint {name!r} has an axis of length zero")
    x, y, z = (axis if abs(norm - 1.0) <= 1e-12 else axis / norm).tolist()
    lower, upper = (-np.inf, np.inf) if kind == "continuous" else _limits(element, name, place)
    return Joint(name, _KINDS[kind], placement, (x, y, z), lower, upper)


def _check_parts(element: etree._Element, place: str) -> None:
    """Raise if a <joint> holds an element or attribute that might place it and is not read."""
    parts = [element, *(part for part in element if isinstance(part.tag, str))]
    for part in parts:
        tag = str(part.tag)
        if tag in _PLACING_NOTHING and part is not element:
            continue
        if tag not in _PLACING or [part.tag for part in parts].count(tag) > 1:
            raise MechanismError(
                f"{place} has {'two' if tag in _PLACING else 'a'} <{tag}>; expected one each of "
                f"{', '.join(sorted((_PLACING.keys() | _PLACING_NOTHING) - {'joint'}))}"
            )
        if odd := sorted(set(map(str, part.attrib)) - _PLACING[tag]):
            raise MechanismError(
                f"{place}: {odd[0]!r} of its <{tag}> is no attribute of URDF, and might place it; "
                f"expected {', '.join(sorted(_PLACING[tag]))}"
            )


def _turn(element: etree._Element, place: str) -> Triple:
    """Return roll, pitch and yaw of a joint's origin, whichever way they are written."""
    origin = element.find("origin")
    text = None if origin is None else origin.get("quat_xyzw")
    if origin is None or text is None:
        return _triple(origin, "rpy", place, (0.0, 0.0, 0.0))
    robot = element.getparent()
    version = "1.0" if robot is None else robot.get("version", "1.0")
    if origin.get("rpy") is not None or version in ("1", "1.0"):
        raise MechanismError(
            f'{place}: quat_xyzw is URDF\'s from <robot version="1.1"> on, and without rpy beside '
            "it; programs differ in what they make of this file"
        )
    numbers = [_number(word, place) for word in text.split()]
    if len(numbers) != 4 or not any(numbers):
        raise MechanismError(f"{place}: quat_xyzw={text!r} should hold four numbers, not all zero")
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(numbers).as_matrix()
    return placement_of(matrix).rpy


def _limits(element: etree._Element, name: str, place: str) -> tuple[float, float]:
    """Return the ends of a joint's range; infinite ones where the file says none that counts."""
    limit = element.find("limit")
    if limit is None or (limit.get("lower") is None and limit.get("upper") is None):
        return -np.inf, np.inf
    lower, upper = (plain_number(limit.get(key, "0")) for key in ("lower", "upper"))
    if max(abs(lower), abs(upper)) > LARGEST:
        return -np.inf, np.inf
    for key, value in (("lower", lower), ("upper", upper)):
        if np.isnan(value):
            raise MechanismError(f"{place}: {why_no_number(limit.get(key, '0'))}")
    if lower > upper:
        raise MechanismError(
            f"{place}: joint {name!r} has limits {lower:g} to {upper:g}; lower must be below upper"
        )
    return lower, upper


def link_of(element: etree._Element, key: str, path: Path) -> str:
    """Return the parent or child link of a <joint>."""
    child = element.find(key)
    name = None if child is None else child.get("link")
    if not name:
        raise MechanismError(
            f"{path}, line {element.sourceline}: joint {element.get('name')!r} has no {key} link"
        )
    return name


def _triple(element: etree._Element | None, key: str, place: str, default: Triple) -> Triple:
    text = None if element is None else element.get(key)
    if text is None:
        return default
    numbers = [_number(word, place) for word in text.split()]
    if len(numbers) != 3:
        raise MechanismError(f"{place}: {key}={text!r} should hold three numbers")
    x, y, z = numbers
    return x, y, z


def _number(text: str, place: str) -> float:
    value = plain_number(text)
    if not abs(value) <= LARGEST:
        raise MechanismError(f"{place}: {why_no_number(text)}")
    return value


def leg_urdf(leg: Leg) -> str:
    """Return a leg's URDF: its joints, a box at its foot, and rods from each joint to the next."""
    robot = etree.Element("robot", name=leg.name)
    size = _size(leg)
    read = {sensor.joint for sensor in leg.sensors}
    links = leg_links(leg)
    link = etree.SubElement(robot, "link", name=links[0])
    foot = leg.joints[0].placement.xyz
    _visual(link, "grey", "box", size=(3 * size, 3 * size, size), xyz=foot)
    for index, joint in enumerate(leg.joints):
        if not np.allclose(joint.placement.xyz, 0.0) and index > 0:
            _rod(link, joint.placement.xyz, size)
        link = etree.SubElement(robot, "link", name=links[index + 1])
        if joint.mass:
            _inertial(link, joint)
        colour, along = "orange" if joint.name in read else "blue", _axis_rpy(joint.axis)
        if joint.kind == "revolute":
            _visual(link, colour, "cylinder", radius=size, length=3 * size, rpy=along)
        elif joint.kind == "prismatic":  # longer than what it carries is wide
            _visual(link, colour, "box", size=(2 * size, 2 * size, 4 * size), rpy=along)
        else:
            _visual(link, "blue", "sphere", radius=size)
        joint_element(robot, joint, links[index], links[index + 1])
    return xml_text(robot)


def leg_links(leg: Leg) -> list[str]:
    """Return the names of a leg's links as written, base first, tip last; no joint has one."""
    ends = [*(f"{joint.name}_link" for joint in leg.joints[:-1]), "tip"]
    joints = {joint.name for joint in leg.joints}
    names = [f"{leg.name}_{end}" for end in ("base", *ends)]
    return [f"{name}_" if name in joints else name for name in names]


def platform_urdf(name: str, legs: tuple[Leg, ...]) -> str:
    """Return a platform's URDF: one fixed frame for each platform point."""
    robot = etree.Element("robot", name=f"{name}_platform")
    size = max(_size(leg) for leg in legs)
    root = "platform"
    while any(leg.point.name == root for leg in legs):
        root += "_"
    platform = etree.SubElement(robot, "link", name=root)
    _visual(platform, "grey", "cylinder", radius=1.5 * size, length=size)
    points = {leg.point.name: leg.point for leg in legs}
    for point in points.values():
        if not np.allclose(point.placement.xyz, 0.0):
            _rod(platform, point.placement.xyz, size)
    for point in points.values():
        link = etree.SubElement(robot, "link", name=point.name)
        _visual(link, "grey", "sphere", radius=1.2 * size)
        joint_element(robot, point, root, point.name)
    return xml_text(robot)


def _size(leg: Leg) -> float:
    """Return a radius for joints that suits the longest link (a stroke is two), two digits, [m]."""
    lengths = [float(np.linalg.norm(joint.placement.xyz)) for joint in leg.joints[1:]]
    lengths += [abs(joint.home) / 2 for joint in leg.joints if joint.kind == "prismatic"]
    return float(f"{0.03 * (max(lengths) or 1.0):.1e}")


def _inertial(link: etree._Element, joint: Joint) -> None:
    """Add a link's mass and its centre; inertia does not count where nothing accelerates."""
    inertial = etree.SubElement(link, "inertial")
    etree.SubElement(inertial, "origin", xyz=numbers_text(joint.centre), rpy="0 0 0")
    etree.SubElement(inertial, "mass", value=numbers_text([joint.mass]))
    moments = dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), "0")
    etree.SubElement(inertial, "inertia", moments)


def joint_element(robot: etree._Element, joint: Joint, parent: str, child: str) -> None:
    """Add a joint, all digits of its origin, axis and limits."""
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


def _rod(link: etree._Element, end: Triple, size: float) -> None:
    """Add a cylinder from the link's origin to a point of it."""
    x, y, z = end
    length, rpy = float(np.linalg.norm(end)), _axis_rpy(end)
    middle = (x / 2, y / 2, z / 2)
    _visual(link, "grey", "cylinder", radius=size / 2, length=length, xyz=middle, rpy=rpy)


def _axis_rpy(axis: Triple) -> Triple:
    """Return the roll-pitch-yaw that turns z onto an axis."""
    x, y, z = axis
    return (0.0, float(np.arctan2(np.hypot(x, y), z)), float(np.arctan2(y, x)))


def _visual(
    link: etree._Element,
    colour: str,
    shape: str,
    *,
    xyz: Triple = Placement.xyz,
    rpy: Triple = Placement.rpy,
    **size: float | Triple,
) -> None:
    """Add a shape to a link; lengths in [m] and angles in [rad], rounded for reading."""
    visual = etree.SubElement(link, "visual")
    if any((*xyz, *rpy)):
        etree.SubElement(visual, "origin", xyz=_rounded(xyz), rpy=_rounded(rpy))
    texts = {key: _rounded(value) for key, value in size.items()}
    etree.SubElement(etree.SubElement(visual, "geometry"), shape, texts)
    material = etree.SubElement(visual, "material", name=colour)
    etree.SubElement(material, "color", rgba=_COLOURS[colour])


def _rounded(values: float | Triple) -> str:
    """Return twelve digits: the same on every processor, whose arctangents differ."""
    return " ".join(f"{np.round(v, 12) + 0.0:.12g}" for v in np.atleast_1d(values))


def numbers_text(values: Iterable[float]) -> str:
    """Return numbers with all their digits, none of them a negative zero."""
    return " ".join(repr(float(value) + 0.0) for value in values)


def xml_text(root: etree._Element) -> str:
    """Return an XML file's text, indented."""
    etree.indent(root, space="  ")
    return str(etree.tostring(root, encoding="unicode")) + "\n"
