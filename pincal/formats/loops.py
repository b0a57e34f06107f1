"""The YAML file that closes the loops of a URDF.

It follows the convention of example-parallel-robots: ``closed_loop`` lists pairs of frames that
meet, ``type`` says of each whether their origins do ('3d') or the whole frames ('6d', as where
nothing is said), ``name_mot`` names the motors, whole or in part; ``joint_name`` and ``joint_type``
replace joints by others (SPHERICAL, FIXED, UJOINT_XY, UJOINT_YZ, UJOINT_ZX). Two keys are pincal's
own: ``platform``, a link, and ``home``, joint positions in the configuration that is drawn. Source:
github.com/Gepetto/example-parallel-robots, ``loader_tools.py``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence, Sized
from dataclasses import replace
from pathlib import Path

from pincal.errors import FileError, MechanismError
from pincal.files.text import read_xml
from pincal.files.tree import Edge, Tree, at_home
from pincal.files.urdf import read_urdf
from pincal.files.yaml import Entry, read_yaml
from pincal.model.checks import listed
from pincal.model.leg import Closing, Joint

_TURNED = {
    "SPHERICAL": "xyz",
    "FIXED": "",
    "UJOINT_XY": "xy",
    "UJOINT_YZ": "yz",
    "UJOINT_ZX": "zx",
}
#: Keys that the YAML file may have; others (rotor inertias and such) do not matter here.
_LOOP_KEYS = ("closed_loop", "type", "joint_name", "joint_type", "platform", "home")


def loops_beside(file: Path) -> Path:
    """Return the YAML file that belongs to a URDF."""
    places = (file.with_suffix(".yaml"), file.parent / "robot.yaml")
    for place in places:
        if place.is_file():
            return place
    raise FileError(
        f"no {' or '.join(dict.fromkeys(place.name for place in places))} beside {file} says what "
        "closes its loops; name one with --loops, or import a serial arm with --tip LINK"
    )


def read_loops(urdf: Path, loops: Path) -> Tree:
    """Return the tree of a URDF with the loops of a YAML file."""
    keys = read_yaml(loops, MechanismError).keys(("name_mot",), _LOOP_KEYS, others=True)
    lists = {key: keys[key].items() if key in keys else [] for key in (*_LOOP_KEYS[:4], "name_mot")}
    _check_sizes(lists, "joint_name", "joint_type", loops)
    if lists["type"]:
        _check_sizes(lists, "closed_loop", "type", loops)
    axes = [_TURNED[entry.choice(*_TURNED)] for entry in lists["joint_type"]]
    replaced = [entry.text() for entry in lists["joint_name"]]
    tree = read_urdf(urdf, dict(zip(replaced, axes, strict=True)))
    homed = keys["home"].pairs() if "home" in keys else {}
    home = {joint: entry.number() for joint, entry in homed.items()}
    drawn = [str(element.get("name")) for element in read_xml(urdf, "robot").findall("joint")]
    _check_known("joint_name", replaced, drawn, urdf, loops)
    _check_known("home", home, [edge.joint.name for edge in tree.edges], urdf, loops)
    platform = keys["platform"].text() if "platform" in keys else None
    if platform is not None:
        tree.link(platform, f"the platform of {loops}")
    edges = tuple(
        replace(edge, joint=replace(edge.joint, mass=0.0, centre=(0.0, 0.0, 0.0)))
        for edge in tree.edges  # frames of legs with loops are turned, centres of mass are not
    )
    motors = [entry.text() for entry in lists["name_mot"]]
    return replace(
        tree,
        edges=at_home(edges, home),
        loops=tuple(_closings(tree, lists["closed_loop"], lists["type"], loops)),
        active=_motors(motors, edges, f"{loops}: 'name_mot'", urdf),
        platform=platform,
        homed=bool(home),
    )


def _check_sizes(lists: Mapping[str, Sized], first: str, second: str, loops: Path) -> None:
    """Raise if two lists of the YAML file are not as long as each other."""
    if len(lists[first]) != len(lists[second]):
        raise MechanismError(
            f"{loops}: {len(lists[first])} entries of {first!r}, but {len(lists[second])} of "
            f"{second!r}; each needs one"
        )


def _check_known(
    key: str, names: Iterable[str], known: Sequence[str], urdf: Path, loops: Path
) -> None:
    """Raise if a key of the YAML file names a joint that the URDF does not have."""
    if unknown := [name for name in names if name not in known]:
        raise MechanismError(
            f"{loops}: {key!r} has {unknown[0]!r}, which is no joint of {urdf}; it has "
            f"{listed(known)}"
        )


def _closings(
    tree: Tree, pairs: Sequence[Entry], types: Sequence[Entry], loops: Path
) -> Iterator[Edge]:
    """Yield what closes the loops: pairs of links whose frames meet, or their origins alone."""
    kinds = [entry.choice("3d", "3D", "6d", "6D") for entry in types] or ["6d"] * len(pairs)
    for pair, kind in zip(pairs, kinds, strict=True):
        ends = [end.text() for end in pair.items(2, 2)]
        parent, child = (tree.link(end, f"'closed_loop' of {loops}") for end in ends)
        closes: Closing = "point" if kind.lower() == "3d" else "frame"
        yield Edge(Joint("_".join(ends), "fixed"), parent, child, closes=closes)


def _motors(named: Sequence[str], edges: Sequence[Edge], key: str, urdf: Path) -> tuple[str, ...]:
    """Return the joints that ``name_mot`` means: of that name, or else with it in their names."""
    moving = [edge.joint.name for edge in edges if edge.joint.kind != "fixed"]
    motors: list[str] = []
    for name in named:
        matching = [name] if name in moving else [joint for joint in moving if name in joint]
        if not matching:
            raise MechanismError(
                f"{key} has {name!r}, but no joint of {urdf} that moves has that in its name; it "
                f"has {listed(moving)}"
            )
        motors += matching
    return tuple(dict.fromkeys(motors))
