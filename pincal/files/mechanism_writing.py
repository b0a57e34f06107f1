"""A mechanism's folder as text: ``mechanism.yaml`` and the URDFs of legs and platform."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from lxml import etree

from pincal.files.schema import FORMAT, described
from pincal.model.leg import Joint, Leg
from pincal.model.mechanism import Mechanism
from pincal.model.placement import Coordinate, Placement
from pincal.model.platform import KINDS
from pincal.model.terms import Load, Term

Triple = tuple[float, float, float]
_ORANGE, _BLUE, _GREY = "0.85 0.37 0.01 1", "0.12 0.47 0.71 1", "0.35 0.35 0.35 1"


def leg_urdf(leg: Leg) -> str:
    """Return a leg's URDF: its joints, a box at its foot, and rods from each joint to the next."""
    robot = etree.Element("robot", name=leg.name)
    size = _size(leg)
    read = {sensor.joint for sensor in leg.sensors}
    links = _link_names(leg)
    link = _link_element(robot, links[0])
    foot = leg.joints[0].placement.xyz
    _visual(link, "box", size=(3 * size, 3 * size, size), xyz=foot, rgba=_GREY)
    for index, joint in enumerate(leg.joints):
        if not np.allclose(joint.placement.xyz, 0.0) and index > 0:
            _rod(link, joint.placement.xyz, size)
        link = _link_element(robot, links[index + 1])
        if joint.mass:
            _inertial(link, joint)
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


def _inertial(link: etree._Element, joint: Joint) -> None:
    """Add a link's mass and its centre; inertia does not count where nothing accelerates."""
    inertial = etree.SubElement(link, "inertial")
    etree.SubElement(inertial, "origin", xyz=_triple_text(joint.centre), rpy="0 0 0")
    etree.SubElement(inertial, "mass", value=_f(joint.mass))
    moments = dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), "0")
    etree.SubElement(inertial, "inertia", moments)


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
    centre = (end[0] / 2, end[1] / 2, end[2] / 2)
    rpy = _axis_rpy((end[0] / length, end[1] / length, end[2] / length))
    _visual(link, "cylinder", radius=size / 2, length=length, xyz=centre, rpy=rpy, rgba=_GREY)


def _axis_rpy(axis: Triple) -> Triple:
    """Return the roll-pitch-yaw that turns z onto a unit axis."""
    x, y, z = axis
    return (0.0, float(np.arctan2(np.hypot(x, y), z)), float(np.arctan2(y, x)))


def _visual(
    link: etree._Element,
    shape: str,
    *,
    rgba: str,
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
    colours = {_ORANGE: "orange", _BLUE: "blue", _GREY: "grey"}
    material = etree.SubElement(visual, "material", name=colours[rgba])
    etree.SubElement(material, "color", rgba=rgba)


def _rounded(values: float | Triple) -> str:
    """Return twelve digits: the same on every processor, whose arctangents differ."""
    return " ".join(f"{np.round(v, 12) + 0.0:.12g}" for v in np.atleast_1d(values))


def _f(value: float) -> str:
    return repr(float(value) + 0.0)


def _triple_text(values: Triple) -> str:
    return " ".join(_f(v) for v in values)


def _text(robot: etree._Element) -> str:
    etree.indent(robot, space="  ")
    return str(etree.tostring(robot, encoding="unicode")) + "\n"


YAML = "mechanism.yaml"
MECHANISM_FILES = (YAML, "platform.urdf")
"""Files by which pincal knows a mechanism folder of its own, and replaces them."""


def write_mechanism(mechanism: Mechanism, folder: Path) -> None:
    """Write a mechanism's files into a folder that exists."""
    (folder / YAML).write_text(_dump(mechanism), encoding="utf-8")
    for leg in mechanism.legs:
        (folder / f"{leg.name}.urdf").write_text(leg_urdf(leg), encoding="utf-8")
    platform = platform_urdf(mechanism.name, mechanism.legs)
    (folder / "platform.urdf").write_text(platform, encoding="utf-8")


def _dump(mechanism: Mechanism) -> str:
    platform = mechanism.platform
    data = {
        "pincal": FORMAT,
        "name": mechanism.name,
        **({"description": mechanism.description} if mechanism.description else {}),
        "platform": {
            "kind": platform.kind
            if platform.kind in KINDS
            else _Flow(name=platform.kind, freedoms=list(platform.form.freedoms)),
            "urdf": "platform.urdf",
            "home": _Flow(zip(platform.coordinates, platform.home, strict=True)),
        },
        "legs": [_dump_leg(leg) for leg in mechanism.legs],
        **({"labels": dict(mechanism.labels)} if mechanism.labels else {}),
        **({} if mechanism.load is None else {"load": _dump_load(mechanism.load)}),
    }
    header = "# A mechanism of pincal. Lengths in m, angles in rad. See docs/mechanism_files.md\n"
    return header + yaml.dump(data, Dumper=_Dumper, sort_keys=False, width=100)


def _dump_load(load: Load) -> dict[str, Any]:
    return {
        "mass": load.mass,
        "centre": list(load.centre),
        "gravity": list(load.gravity),
        **({"drawn": dict(load.drawn)} if load.drawn else {}),
    }


def _dump_leg(leg: Leg) -> dict[str, Any]:
    """Return a leg as plain data.

    Raises:
        MechanismError: a term that is code.
    """
    own = {
        name: _dump_terms((one for of, one in leg.terms if of == name), leg.name)
        for name in leg.deformed
    }
    return {
        "name": leg.name,
        "urdf": f"{leg.name}.urdf",
        "tip": leg.tip,
        "platform_point": leg.point.name,
        **({} if leg.closes == "point" else {"closes": leg.closes}),
        "home": _Flow((joint.name, joint.home) for joint in leg.moving),
        "sensors": [
            (dict if sensor.terms else _Flow)(
                joint=sensor.joint,
                form=sensor.form,
                gain=sensor.gain,
                offset=sensor.offset,
                direction=sensor.direction,
                zero=sensor.zero,
                **({} if (by := sensor.counts_per_unit) is None else {"counts_per_unit": by}),
                **({"terms": _dump_terms(sensor.terms, leg.name)} if sensor.terms else {}),
            )
            for sensor in leg.sensors
        ],
        "parameters": dict(leg.parameters),
        "placements": {
            joint.name: [_Flow({c.kind: _values(c)}) for c in joint.placement.coordinates]
            for joint in (*leg.joints, leg.point)
            if joint.placement.coordinates
        },
        **({"terms": own} if own else {}),
    }


def _dump_terms(terms: Iterable[Term], leg: str) -> dict[str, Any]:
    return {one.parameter: _Flow(described(one, leg)) for one in terms}


def _values(coordinate: Coordinate) -> Any:
    values = coordinate.values
    return values[0] if len(values) == 1 else list(values)


class _Flow(dict[str, Any]):
    """A mapping that YAML writes on one line."""


class _Dumper(yaml.CSafeDumper):
    """Writes ``_Flow`` mappings on one line, and NumPy's numbers as Python's."""


_Dumper.add_representer(
    _Flow,
    lambda dumper, data: dumper.represent_mapping("tag:yaml.org,2002:map", data, flow_style=True),
)
for _number in (np.floating, np.integer):
    _Dumper.add_multi_representer(_number, lambda dumper, own: dumper.represent_data(own.item()))
