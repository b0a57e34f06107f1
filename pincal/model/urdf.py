"""URDF in and out: a leg is read strictly, as one serial chain, and written with simple visuals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from lxml import etree
from numpy.typing import NDArray

from pincal.errors import MechanismError
from pincal.model.input import LARGEST, plain_number
from pincal.model.leg import Joint, JointKind, Leg
from pincal.model.placement import Placement
from pincal.model.xml import read_xml

Array = NDArray[np.float64]
Triple = tuple[float, float, float]

_KINDS: dict[str, JointKind] = {
    "revolute": "revolute",
    "continuous": "revolute",
    "prismatic": "prismatic",
    "fixed": "fixed",
}
_ORANGE, _BLUE, _GREY = "0.85 0.37 0.01 1", "0.12 0.47 0.71 1", "0.35 0.35 0.35 1"


def read_chain(path: Path, tip: str) -> tuple[Joint, ...]:
    """Return the joints from a URDF's root link to its tip link, base first.

    Raises:
        FileError: the file is missing or cannot be read.
        MechanismError: not well-formed, no serial chain, or no such tip link.
    """
    robot = read_xml(path, "robot")
    joints = robot.findall("joint")
    by_parent: dict[str, etree._Element] = {}
    children = set()
    for element in joints:
        parent, child = link_of(element, "parent", path), link_of(element, "child", path)
        if parent in by_parent or child in children:
            raise MechanismError(
                f"{path}, line {element.sourceline}: link {parent!r} branches or closes a loop; a "
                "leg must be a serial chain, one joint from each link to the next"
            )
        by_parent[parent] = element
        children.add(child)
    links = {link.get("name") for link in robot.findall("link")}
    if tip not in links:
        raise MechanismError(
            f"{path}: no link named {tip!r} for the tip; it has "
            f"{', '.join(sorted(str(link) for link in links)) or 'no links'}"
        )
    roots = links - children
    if len(roots) != 1:
        raise MechanismError(
            f"{path}: {len(roots)} root links ({', '.join(sorted(map(str, roots))) or 'loop'}); a "
            "leg must be one serial chain with one root"
        )
    link, chain = str(roots.pop()), []
    while link != tip:
        if link not in by_parent:
            raise MechanismError(
                f"{path}: the chain from the root ends at {link!r}, not at {tip!r}"
            )
        element = by_parent[link]
        chain.append(read_joint(element, path))
        link = link_of(element, "child", path)
    if not any(joint.kind != "fixed" for joint in chain):
        raise MechanismError(f"{path}: no joint moves between the root link and {tip!r}")
    return tuple(chain)


def read_path(path: Path, tip: str, base: str | None = None) -> tuple[Joint, ...]:
    """Return the joints between two links of a URDF that may branch, base first.

    Args:
        path: The URDF.
        tip: Link at the end.
        base: Link at the foot; the root if not given.

    Raises:
        FileError: the file is missing or cannot be read.
        MechanismError: not well-formed, or no path from base to tip.
    """
    robot = read_xml(path, "robot")
    links = [str(link.get("name")) for link in robot.findall("link")]
    for name in (tip, *([] if base is None else [base])):
        if name not in links:
            raise MechanismError(f"{path}: no link named {name!r}; it has {', '.join(links)}")
    above: dict[str, etree._Element] = {}
    for element in robot.findall("joint"):
        child = link_of(element, "child", path)
        if child in above:
            raise MechanismError(
                f"{path}, line {element.sourceline}: link {child!r} hangs on two joints; a URDF "
                "is a tree"
            )
        above[child] = element
    link: str = tip
    found: list[etree._Element] = []
    while link in above and link != base and len(found) <= len(above):
        found.append(above[link])
        link = link_of(above[link], "parent", path)
    if (base is not None and link != base) or (link in above and base is None):
        raise MechanismError(f"{path}: no chain of joints leads from {base or 'a root'} to {tip!r}")
    return tuple(read_joint(element, path) for element in reversed(found))


def read_points(path: Path) -> dict[str, Joint]:
    """Return the fixed joints of a platform URDF by the names of joint and child link.

    Raises:
        FileError: the file is missing or cannot be read.
        MechanismError: not well-formed.
    """
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


def read_joint(element: etree._Element, path: Path) -> Joint:
    """Return a <joint> of a URDF.

    Raises:
        MechanismError: of a type that a leg cannot have, or a number that is none.
    """
    where = f"{path}, line {element.sourceline}"
    name, kind = element.get("name"), element.get("type")
    if not name:
        raise MechanismError(f"{where}: a joint without a name")
    if kind not in _KINDS:
        raise MechanismError(
            f"{where}: joint {name!r} is of type {kind!r}; a leg may have {', '.join(_KINDS)}"
        )
    if element.find("mimic") is not None:
        raise MechanismError(f"{where}: joint {name!r} mimics another; a leg's joints are its own")
    placement = Placement(
        xyz=_triple(element.find("origin"), "xyz", where, (0.0, 0.0, 0.0)),
        rpy=_triple(element.find("origin"), "rpy", where, (0.0, 0.0, 0.0)),
    )
    if kind == "fixed":
        return Joint(name, "fixed", placement)
    axis = np.array(_triple(element.find("axis"), "xyz", where, (1.0, 0.0, 0.0)))
    norm = float(np.linalg.norm(axis))
    if norm < 1e-9:
        raise MechanismError(f"{where}: joint {name!r} has an axis of length zero")
    if abs(norm - 1.0) > 1e-12:
        axis = axis / norm
    x, y, z = (float(v) for v in axis)
    turns = kind == "continuous" or (kind == "revolute" and _unlimited(element))
    lower, upper = (-np.inf, np.inf) if turns else _limits(element, name, where)
    return Joint(name, _KINDS[kind], placement, (x, y, z), lower, upper)


def _unlimited(element: etree._Element) -> bool:
    """Return whether a <limit> says no range, as CAD exporters write for joints that may turn."""
    limit = element.find("limit")
    return limit is not None and limit.get("lower") is None and limit.get("upper") is None


def _limits(element: etree._Element, name: str, where: str) -> tuple[float, float]:
    limit = element.find("limit")
    if limit is None:
        raise MechanismError(f"{where}: joint {name!r} needs a <limit> with lower and upper")
    lower, upper = (_number(limit.get(key, "0"), where) for key in ("lower", "upper"))
    if not lower < upper:
        raise MechanismError(
            f"{where}: joint {name!r} has limits {lower:g} to {upper:g}; lower must be below upper"
        )
    return lower, upper


def link_of(element: etree._Element, key: str, path: Path) -> str:
    """Return the parent or child link of a <joint>.

    Raises:
        MechanismError: there is none.
    """
    child = element.find(key)
    name = None if child is None else child.get("link")
    if not name:
        raise MechanismError(
            f"{path}, line {element.sourceline}: joint {element.get('name')!r} has no {key} link"
        )
    return name


def _triple(element: etree._Element | None, key: str, where: str, default: Triple) -> Triple:
    text = None if element is None else element.get(key)
    if text is None:
        return default
    numbers = [_number(word, where) for word in text.split()]
    if len(numbers) != 3:
        raise MechanismError(f"{where}: {key}={text!r} should hold three numbers")
    x, y, z = numbers
    return x, y, z


def _number(text: str, where: str) -> float:
    value = plain_number(text)
    if not abs(value) <= LARGEST:
        raise MechanismError(
            f"{where}: {text[:100]!r} is not a finite number, at most {LARGEST:g} in size"
        )
    return value


def leg_urdf(leg: Leg) -> str:
    """Return a leg's URDF: its joints, a box at its foot, and rods from each joint to the next."""
    robot = etree.Element("robot", name=leg.name)
    size = _size(leg)
    read = {sensor.joint for sensor in leg.sensors}
    links = _link_names(leg)
    link = _link_element(robot, links[0])
    foot = _triple_text(leg.joints[0].placement.xyz)
    _visual(link, "box", size=(3 * size, 3 * size, size), xyz=foot, rgba=_GREY)
    for index, joint in enumerate(leg.joints):
        if not np.allclose(joint.placement.xyz, 0.0) and index > 0:
            _rod(link, joint.placement.xyz, size)
        link = _link_element(robot, links[index + 1])
        if joint.kind == "revolute":
            colour = _ORANGE if joint.name in read else _BLUE
            roll = _axis_rpy(joint.axis)
            _visual(link, "cylinder", radius=size, length=3 * size, rpy=roll, rgba=colour)
        elif joint.kind == "prismatic":
            colour = _ORANGE if joint.name in read else _BLUE
            along = _axis_rpy(joint.axis)  # longer than what it carries is wide
            _visual(link, "box", size=(2 * size, 2 * size, 4 * size), rpy=along, rgba=colour)
        else:
            _visual(link, "sphere", radius=size, rgba=_BLUE)
        _joint_element(robot, joint, links[index], links[index + 1])
    return _text(robot)


def _link_names(leg: Leg) -> list[str]:
    """Return the names of a leg's links, base first, no two alike whatever its tip is called."""
    names = [f"{leg.name}_base", *(f"{leg.name}_{joint.name}_link" for joint in leg.joints[:-1])]
    return [*(f"{name}_" if name == leg.tip else name for name in names), leg.tip]


def platform_urdf(name: str, legs: tuple[Leg, ...]) -> str:
    """Return a platform's URDF: one fixed frame for each platform point."""
    robot = etree.Element("robot", name=f"{name}_platform")
    size = max(_size(leg) for leg in legs)
    root = "platform"
    while any(leg.point.name == root for leg in legs):
        root += "_"
    platform = _link_element(robot, root)
    _visual(platform, "cylinder", radius=1.5 * size, length=size, rgba=_GREY)
    points = {leg.point.name: leg.point for leg in legs}
    for point in points.values():
        if not np.allclose(point.placement.xyz, 0.0):
            _rod(platform, point.placement.xyz, size)
    for point in points.values():
        link = _link_element(robot, point.name)
        _visual(link, "sphere", radius=1.2 * size, rgba=_GREY)
        _joint_element(robot, point, root, point.name)
    return _text(robot)


def _size(leg: Leg) -> float:
    """Return a radius for joints that suits the longest link (a stroke is two), two digits, [m]."""
    lengths = [float(np.linalg.norm(joint.placement.xyz)) for joint in leg.joints[1:]]
    lengths += [abs(joint.home) / 2 for joint in leg.joints if joint.kind == "prismatic"]
    return float(f"{0.03 * (max(lengths) or 1.0):.1e}")


def _link_element(robot: etree._Element, name: str) -> etree._Element:
    return etree.SubElement(robot, "link", name=name)


def _joint_element(robot: etree._Element, joint: Joint, parent: str, child: str) -> None:
    continuous = joint.kind == "revolute" and not np.isfinite(joint.lower)
    kind = "continuous" if continuous else joint.kind
    element = etree.SubElement(robot, "joint", name=joint.name, type=kind)
    etree.SubElement(element, "parent", link=parent)
    etree.SubElement(element, "child", link=child)
    p = joint.placement
    etree.SubElement(element, "origin", xyz=_triple_text(p.xyz), rpy=_triple_text(p.rpy))
    if joint.kind == "fixed":
        return
    etree.SubElement(element, "axis", xyz=_triple_text(joint.axis))
    if not continuous:
        limits = {"lower": _f(joint.lower), "upper": _f(joint.upper)}
        etree.SubElement(element, "limit", {"effort": "0", "velocity": "0", **limits})


def _rod(link: etree._Element, end: Triple, size: float) -> None:
    """Add a cylinder from the link's origin to a point of it."""
    vector = np.array(end)
    length = float(np.linalg.norm(vector))
    centre = _triple_text((end[0] / 2, end[1] / 2, end[2] / 2))
    rpy = _axis_rpy((end[0] / length, end[1] / length, end[2] / length))
    _visual(link, "cylinder", radius=size / 2, length=length, xyz=centre, rpy=rpy, rgba=_GREY)


def _axis_rpy(axis: Triple) -> str:
    """Return the roll-pitch-yaw that turns z onto a unit axis."""
    x, y, z = axis
    return _triple_text((0.0, float(np.arctan2(np.hypot(x, y), z)), float(np.arctan2(y, x))))


def _visual(
    link: etree._Element,
    shape: str,
    *,
    rgba: str,
    xyz: str = "",
    rpy: str = "",
    **size: float | Triple,
) -> None:
    """Add a shape to a link; sizes in [m], rounded for reading."""
    visual = etree.SubElement(link, "visual")
    if xyz or rpy:
        etree.SubElement(visual, "origin", xyz=xyz or "0 0 0", rpy=rpy or "0 0 0")
    texts = {key: " ".join(f"{v:.9g}" for v in np.atleast_1d(value)) for key, value in size.items()}
    etree.SubElement(etree.SubElement(visual, "geometry"), shape, texts)
    colours = {_ORANGE: "orange", _BLUE: "blue", _GREY: "grey"}
    material = etree.SubElement(visual, "material", name=colours[rgba])
    etree.SubElement(material, "color", rgba=rgba)


def _f(value: float) -> str:
    return repr(float(value) + 0.0)


def _triple_text(values: Triple) -> str:
    return " ".join(_f(v) for v in values)


def _text(robot: etree._Element) -> str:
    etree.indent(robot, space="  ")
    return str(etree.tostring(robot, encoding="unicode")) + "\n"
