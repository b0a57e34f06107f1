"""URDF in: a leg is read strictly, as one serial chain; an arm as a path in a tree."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from lxml import etree
from numpy.typing import NDArray

from pincal.errors import MechanismError
from pincal.files.input import plain_number, why_no_number
from pincal.files.xml import read_xml
from pincal.model.checks import LARGEST
from pincal.model.joint import Joint, JointKind
from pincal.model.placement import Placement

Array = NDArray[np.float64]
Triple = tuple[float, float, float]

_KINDS: dict[str, JointKind] = {
    "revolute": "revolute",
    "continuous": "revolute",
    "prismatic": "prismatic",
    "fixed": "fixed",
}


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
        link = link_of(element, "child", path)
        chain.append(_weighed(read_joint(element, path), robot, link, path))
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
    return tuple(
        _weighed(read_joint(element, path), robot, link_of(element, "child", path), path)
        for element in reversed(found)
    )


def _weighed(joint: Joint, robot: etree._Element, link: str, path: Path) -> Joint:
    """Return a joint with the mass of the link behind it, if its URDF says one.

    Raises:
        MechanismError: a negative mass, or a number that is none.
    """
    inertial = next(
        (one.find("inertial") for one in robot.findall("link") if one.get("name") == link), None
    )
    element = None if inertial is None else inertial.find("mass")
    if inertial is None or element is None:
        return joint
    where = f"{path}, line {element.sourceline}"
    mass = _number(element.get("value", "0"), where)
    if mass < 0.0:
        raise MechanismError(f"{where}: link {link!r} has the mass {mass:g}; expected 0 or more")
    centre = _triple(inertial.find("origin"), "xyz", where, (0.0, 0.0, 0.0))
    return replace(joint, mass=mass, centre=centre if mass else (0.0, 0.0, 0.0))


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


def more_than_a_turn(path: Path) -> tuple[str, ...]:
    """Return the origins of a URDF whose rpy exceeds a full turn, with file and line: degrees?

    Raises:
        FileError: the file is missing or cannot be read.
        MechanismError: not well-formed, or a number that is none.
    """
    found = []
    for element in read_xml(path, "robot").iterfind("joint/origin"):
        where = f"{path}, line {element.sourceline}"
        rpy = _triple(element, "rpy", where, (0.0, 0.0, 0.0))
        if np.abs(rpy).max() > 2 * np.pi:
            found.append(f"{where}: rpy={element.get('rpy')!r}")
    return tuple(found)


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
        raise MechanismError(f"{where}: {why_no_number(text)}")
    return value
