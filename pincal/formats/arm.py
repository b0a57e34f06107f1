"""Serial arms as mechanisms of one leg: all joints have sensors, and the tip is the platform.

Each joint's placement on its parent link, and the tool's on the last link, has six small
displacements as parameters; with base and tool unknown that is one set more than there are joints.
Planning and calibration find out which of them are not observable.
"""

import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from pincal.errors import MechanismError, located
from pincal.files.tree import Step, Tree, coupled, route, turns
from pincal.formats.closings import read_closed
from pincal.kinematics.closure import LegClosure
from pincal.model import Joint, Leg, Mechanism, Placement, Platform, Sensor, placement_of
from pincal.model.checks import check_kinds, listed
from pincal.model.consistency import identifiers
from pincal.model.placement import Coordinate
from pincal.model.platform import TWIST
from pincal.types import Array

_TOOL = "tool"
#: End of the name of a joint that turns back what a ball's frame was turned.
TURNED = "~"
#: Suffixes of the six joints of a floating link, in order (see ``turns``).
_FREE = ("px", "py", "pz", "x", "y", "z")


def load_arm(path: str | Path, tip: str, base: str | None = None) -> Mechanism:
    """Return a serial arm from any URDF: see ``Mechanism.from_urdf``."""
    check_kinds(locals(), load_arm, MechanismError)
    path = Path(path)
    return replace(serial_arm(read_closed(path), tip, base), name=re.sub(r"\W", "_", path.stem))


def serial_arm(tree: Tree, tip: str, base: str | None = None) -> Mechanism:
    """Return the serial arm between two links of a tree, without loops.

    A joint that follows a joint outside the arm gets its own sensor.
    """
    tree = coupled(tree)
    foot = tree.root if base is None else tree.link(base, "the base")
    steps = route(tree.edges, foot, tree.link(tip, "the tip"))
    if not all(forward for _, forward in steps):
        raise MechanismError(f"{tree.source}: no chain of joints leads from {foot!r} to {tip!r}")
    names = [edge.joint.name for edge, _ in steps]
    for i, name in enumerate(names):
        stem = name.removesuffix(f"_{_FREE[0]}")
        if names[i : i + len(_FREE)] == [f"{stem}_{end}" for end in _FREE]:
            floor = steps[i + len(_FREE) - 1][0].child
            raise MechanismError(
                f"{tree.source}: joint {stem!r} lets link {floor!r} float, but an arm needs a "
                f"fixed base; import it with --base {floor}"
            )
    tree.check_joints(names)
    text = f"Serial arm to {tip} of {Path(tree.source).name}."
    with located(tree.source, MechanismError):
        way = coupled(replace(tree, edges=tuple(edge for edge, _ in steps)))
        joints = tuple(edge.joint for edge in way.edges)
        return arm(re.sub(r"\W", "_", tree.name), joints, text)


def left_open(tree: Tree, mechanism: Mechanism) -> tuple[str, ...]:
    """Return a sentence on loops of a file that hold joints of a serial arm, if there are any."""
    joints = {joint.name for joint in mechanism.legs[0].moving}
    ways = {loop.joint.name: route(tree.edges, loop.parent, loop.child) for loop in tree.loops}
    held = [name for name, way in ways.items() if joints & {edge.joint.name for edge, _ in way}]
    text = f"{listed(held)}: loops of the arm's joints are left open; all of these are read"
    return (text,) * bool(held)


def arm(name: str, joints: tuple[Joint, ...], description: str = "") -> Mechanism:
    """Return a serial arm of joints, base first, with six displacements at each and at the tool."""
    articulated = [joint for joint in joints if joint.kind != "fixed"]
    moving = [joint.name for joint in articulated if joint.follows is None]
    if not moving:
        raise MechanismError(f"{name}: no joint moves")
    stems = plain = identifiers((_TOOL, *(joint.name for joint in articulated)))[1:]
    bare = tuple(stem.removesuffix("_joint") for stem in plain)
    if len({_TOOL, *bare}) > len(bare):
        stems = bare
    point = identifiers((*(joint.name for joint in joints), "tip", _TOOL))[-1]
    at_home = [  # zero, or the middle of limits that exclude zero
        replace(j, home=0.0 if j.lower <= 0.0 <= j.upper else (j.lower + j.upper) / 2.0)
        for j in joints
    ]
    tip = () if joints[-1].kind == "fixed" else (Joint("tip", "fixed"),)
    leg = Leg(
        name="arm",
        joints=(*at_home, *tip),
        sensors=tuple(map(Sensor, moving)),
        parameters=(),
        point=Joint(point, "fixed"),
        closes="frame",
    )
    leg, free = displaced(leg, (*stems, _TOOL), TWIST), Platform.at_origin("spatial")
    home = free.from_matrices(LegClosure(leg, free).frame(leg.home[None]))[0]
    return Mechanism(name, Platform("spatial", tuple(home.tolist())), (leg,), description)


def displaced(
    leg: Leg, stems: Sequence[str], axes: Sequence[str], held: Collection[str] = ()
) -> Leg:
    """Return a leg with small displacements as parameters, at each joint that moves and the tip.

    A platform point that it closes is displaced too, along axes only. Parameter names begin with
    the stems, one for each moving joint and one for the tip; names in ``held`` get no parameter.
    Further ends are displaced like the tip and its point, or the frame of the leg that they meet.
    """
    stem_of = _stems(leg, stems)
    parameters: list[tuple[str, float]] = []

    def moved(joint: Joint, stem: str, axes: Sequence[str]) -> Joint:
        names = {name: axis for axis in axes if (name := f"{stem}_{axis}") not in held}
        if not names:
            return joint
        parameters.extend(dict.fromkeys(names, 0.0).items())
        xyz, rpy = joint.placement.xyz, joint.placement.rpy
        steps = [Coordinate(axis, (name,)) for name, axis in names.items()]
        steps += [Coordinate(axis, (v,)) for axis, v in zip("xyz", xyz, strict=True) if v]
        return replace(joint, placement=Placement(tuple(steps), xyz, rpy))

    joints = tuple(
        moved(joint, stem_of[joint.name], axes) if joint.name in stem_of else joint
        for joint in leg.joints
    )
    along = [axis for axis in axes if axis in "xyz"]
    ends = [
        end.moved(partial(moved, stem="point" + f"_{place}" * (place > 1), axes=along))
        if end.closes == "point"
        else end
        for place, end in enumerate(leg.every_end, 1)
    ]
    point, further = ends[0].point or leg.point, tuple(ends[1:])
    return replace(leg, joints=joints, point=point, ends=further, parameters=tuple(parameters))


def undisplaced(leg: Leg) -> Leg:
    """Return a leg with zeros for all parameters of its placements."""
    placed = (joint.placement.parameter_units for joint in (*leg.joints, *leg.points))
    return leg.with_parameters({name: 0.0 for units in placed for name in units})


def _stems(leg: Leg, stems: Sequence[str]) -> dict[str, str]:
    """Return the stems of displacements' names by joint; those of further ends are numbered."""
    names = (*(joint.name for joint in leg.articulated), leg.joints[-1].name)
    stem_of = dict(zip(names, stems, strict=True))
    for place, end in enumerate(leg.ends, 2):
        for name, stem in zip(end.frames, ("tip", "hook"), strict=False):
            stem_of.setdefault(name, f"{stem}_{place}")
    return stem_of


def joints_along(tree: Tree, steps: Sequence[Step], normal: Array | None = None) -> list[Joint]:
    """Return the joints along a route from the root.

    A joint that is passed backwards moves in reverse. A loop that closes a point becomes a ball
    joint, or, in a plane, a revolute joint about its ``normal``, which is in the root's frame.
    """
    joints: list[Joint] = []
    for edge, forward in steps:
        joint, name = edge.joint, edge.joint.name
        if forward and edge in tree.edges:
            joints.append(joint)
            continue
        near, far = (joint.placement, edge.at_child)[:: 1 if forward else -1]
        T_far_joint = np.asarray(np.linalg.inv(far.origin()))
        if not edge.moves:
            name = f"{name}_back" if edge in tree.edges else name
            joints += _offset(name, near.origin() @ T_far_joint)
            continue
        if edge.closes == "frame":
            x, y, z = joint.axis
            joints.append(replace(joint, placement=Placement(), axis=(-x, -y, -z)))
        else:
            joints += _offset(f"{name}_at", near.origin())
            if normal is None:
                joints += [turn.joint for turn in turns(Joint(name, "fixed"), "", "", "xyz")]
            else:
                T_root_ball = tree.pose_at_zero(edge.parent if forward else edge.child)
                x, y, z = map(float, (T_root_ball @ near.origin())[:3, :3].T @ normal)
                turn = Joint(f"{name}_z", "revolute", Placement(), (x, y, z), -np.inf, np.inf)
                joints.append(turn)
        joints += _offset(f"{name}_back", T_far_joint)
    for i in reversed(range(len(joints) - 1)):
        if joints[i].name.endswith(TURNED):  # the next joint is displaced along the spin
            turned = joints[i].placement.origin() @ joints[i + 1].placement.origin()
            joints[i : i + 2] = [replace(joints[i + 1], placement=placement_of(turned))]
    return joints


def _offset(name: str, matrix: Array) -> Iterator[Joint]:
    """Yield a fixed joint with a displacement, shape (4, 4), or nothing for the identity."""
    if not np.array_equal(matrix, np.eye(4)):
        yield Joint(name, "fixed", placement_of(matrix))
