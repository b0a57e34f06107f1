"""A user's MJCF with the geometry of a calibrated mechanism; its bytes stay but for numbers.

Calibration displaces joints, tips and the platform in space, from nominal to calibrated legs whose
loops are closed. Bodies follow their last joint's anchor and keep their orientation; the platform's
follows the platform. Anchors, axes, sites and equalities get new numbers in their bodies. If MuJoCo
takes a loop's second place from the drawing, the machine is drawn closed with its drives at zero,
and passive joints count from there. What MuJoCo compiles of the new file must be what was meant.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import lazy_loader
import numpy as np
from lxml import etree
from scipy.spatial.transform import Rotation

from pincal.errors import MechanismError
from pincal.files.text import read_xml
from pincal.files.tree import Edge, Tree, route
from pincal.formats.arm import undisplaced
from pincal.formats.closed import Drawing, drawing_of, slack_of
from pincal.formats.limbs import onto_normal
from pincal.formats.mjcf import compiled, names_of, pose_of, read_mjcf
from pincal.formats.users_urdf import plain_bytes, with_numbers, with_tags
from pincal.kinematics.assembly import assembled
from pincal.model import Joint, Leg, Mechanism, Platform, placement_of
from pincal.model.checks import ALIKE, EXACT, ROUNDING
from pincal.types import Array

if TYPE_CHECKING:
    import mujoco
else:
    mujoco = lazy_loader.load("mujoco")

_GEOMETRY = ("body_pos", "body_quat", "jnt_pos", "jnt_axis", "site_pos", "site_quat", "eq_data")
_AS_DRAWN = re.compile(rb"<connect\b[^>]*\sanchor\b|<weld\b(?![^>]*\s(?:site1|relpose)\b)")
#: New numbers by element (its kind and MuJoCo's index) and attribute.
Numbers = dict[tuple[str, int], dict[str, Array]]
#: Pairs of poses or displacements, (4, 4) each, by name.
Pairs = dict[str, tuple[Array, Array]]


class _Closed(NamedTuple):
    """Legs whose loops are closed."""

    frames: Pairs
    """Frames before and after the motion of each joint."""
    platform: Array
    """Pose of the platform, shape (4, 4)."""
    positions: dict[str, float]
    """Positions of the joints that move, by name, [rad] or [m]."""


def calibrated_mjcf(original: str | Path, mechanism: Mechanism) -> bytes:
    """Return the bytes of an MJCF file with the geometry of a calibrated mechanism."""
    path = Path(original)
    text, model, tree = plain_bytes(path), compiled(path), read_mjcf(path)
    tree = replace(tree, slack=slack_of(text))
    redrawn = bool(_AS_DRAWN.search(text)) or mechanism.legs[0].is_arm
    displaced, written = _Displaced(_drawing(tree, mechanism), mechanism, redrawn), _Written(model)
    written.bodies(displaced.edges, displaced.places())
    if not mechanism.legs[0].is_arm:
        written.loops(displaced.loops())
    changed = _patched(path, model, written.numbers)
    read = compiled(path, changed)
    for wanted, got in ((getattr(model, name), getattr(read, name)) for name in _GEOMETRY):
        if wanted.shape == got.shape and wanted.shape[1] == 4:  # q and -q are one orientation
            got *= np.sign((got * wanted).sum(axis=1, keepdims=True))
        if wanted.shape != got.shape or np.abs(wanted - got)[:, :10].max(initial=0.0) > EXACT:
            raise MechanismError(
                f"{path}: numbers of its own elements cannot hold the geometry (<frame>, "
                "<replicate>, <include>, <attach>, fromto): import and calibrate a plain copy, as "
                "mujoco.mj_saveLastXML writes it"
            )
    return changed


def _drawing(tree: Tree, mechanism: Mechanism) -> Drawing:
    """Return the legs of a tree that were imported as the mechanism, with their links."""
    edges = {edge.joint.name: edge for edge in tree.edges}
    ends = [joint.name for joint in mechanism.legs[0].joints if joint.name in edges]
    if mechanism.legs[0].is_arm and ends:
        rooted, tip = replace(tree, root=edges[ends[0]].parent), edges[ends[-1]].child
        return Drawing(rooted, tip, "spatial", [], None, np.eye(3), frozenset(), [])
    marks = _marks([undisplaced(leg) for leg in mechanism.legs])
    drives = {leg.moving[index].name for leg in mechanism.legs for index in leg.active}
    links = (None, *tree.links) if drives <= edges.keys() else ()  # else none has such legs
    for base, platform in product(links, repeat=2):
        with suppress(MechanismError):
            drawing = drawing_of(tree, platform, base)
            if _marks(drawing.legs) == marks:
                return drawing
    raise MechanismError(
        f"{tree.source} has no legs as {mechanism.name!r} has; give the MJCF from which it was made"
    )


def _marks(legs: Sequence[Leg]) -> list[str]:
    """Return the names of legs' joints, and the points of the platform."""
    points = (np.round(point.placement.xyz, 6) + 0.0 for leg in legs for point in leg.points)
    return [*(joint.name for leg in legs for joint in leg.joints), *map(str, points)]


def _closed(legs: Sequence[Leg], drawing: Drawing, held: Collection[str]) -> _Closed:
    """Return closed legs: near home, or with some joints held at zero and the others near it."""

    def plain(joint: Joint) -> Joint:
        placement, home = placement_of(joint.placement.origin()), joint.home * (not held)
        placed = replace(joint, placement=placement, home=home)
        return placed.fixed_at(0.0) if joint.name in held else placed

    bare: Sequence[Leg] = [
        replace(
            leg,
            joints=tuple(map(plain, leg.joints)),
            point=plain(leg.point),
            ends=tuple(end.moved(plain) for end in leg.ends),
            sensors=(),
            parameters=(),
            terms=(),
            settled=True,
        )
        for leg in legs
    ]
    pose = bare[0].link_placements(bare[0].home[None])[0, -1]
    if any(leg.moving for leg in bare):
        bare, platform = assembled(bare, Platform.at_origin(drawing.kind), drawing.tree.slack)
        pose = platform.home_pose.as_matrix()[0]
    frames, positions = Pairs(), dict[str, float]()
    for leg in bare:
        after = [*leg.link_placements(leg.home[None])[0], np.eye(4)]
        for joint, carrier, frame in zip(leg.joints, leg.carriers, after, strict=False):
            frames[joint.name] = after[carrier] @ joint.placement.origin(), frame
        positions |= {joint.name: float(joint.position(leg.homes)) for joint in leg.articulated}
    return _Closed(frames, pose, positions)


class _Displaced:
    """Links of a file where the loops of its nominal legs close, and how calibration moves them.

    Redrawn, joints are zero in the closed legs; otherwise all joints keep their positions.
    """

    def __init__(self, drawing: Drawing, mechanism: Mechanism, redrawn: bool) -> None:
        self.drawing, self.redrawn, self.legs = drawing, redrawn, mechanism.legs
        self.tree, self.edges = drawing.tree, {edge.child: edge for edge in drawing.tree.edges}
        self.names = {joint.name for leg in self.legs for joint in leg.articulated}
        driven = self.names & self.tree.geared.union(self.tree.active) if redrawn else set[str]()
        held = self.names if self.legs[0].is_arm else driven
        self.nominal = _closed(list(map(undisplaced, self.legs)), drawing, held)
        self.true = _closed(self.legs, drawing, held)
        top = drawing.platform  # becomes the first link of the platform's body
        while top in self.edges and not self.edges[top].moves:
            top = self.edges[top].parent
        carried = top in self.edges and self.edges[top].joint.name in self.names
        self.loose = None if carried else top  # only loops and its own freedoms place it
        T_link_base = np.eye(4)
        if drawing.normal is not None:
            T_link_base[:3, :3] = onto_normal(drawing.normal)
        self.poses = self._posed(T_link_base)
        T = self.poses[self.tree.root] @ T_link_base
        self.platform = _between(T, self.nominal.platform, self.true.platform)
        self.shifts = self._shifted(T)
        self._guide(top)
        given = dict.fromkeys((drawing.platform, self.loose), self.platform)
        given[self.tree.root] = np.eye(4)
        self.given = {link: shift for link, shift in given.items() if link}
        self.moved = dict.fromkeys(self.poses, np.eye(4)) | self.given

    def _posed(self, T_link_base: Array) -> dict[str, Array]:
        """Return the poses of the links, (4, 4): the platform's body is where its pose is known."""
        tree, drawing, nominal = self.tree, self.drawing, self.nominal
        positions = {edge.joint.name: edge.joint.home for edge in tree.edges} | nominal.positions
        of_legs = map(abs, nominal.positions.values())
        if self.redrawn and max(of_legs, default=0.0) > max(ALIKE, tree.slack):
            raise MechanismError(
                f"{tree.source}: a connect or weld takes its second place from the drawing, but "
                "there not all loops close with the drives at zero; let it join two sites"
            )
        poses = {edge.parent: np.eye(4) for edge in tree.edges if edge.parent not in self.edges}
        for link, edge in self.edges.items():
            q = np.array([0.0 if self.redrawn else positions[edge.joint.name]])
            T_parent_link = edge.joint.placement.origin() @ edge.joint.motion(q)[0]
            poses[link] = poses[edge.parent] @ T_parent_link
            if link == self.loose and drawing.platform and tree.root in poses and not self.redrawn:
                below = np.linalg.inv(tree.pose_at_zero(link)) @ tree.pose_at_zero(drawing.platform)
                below[:3, :3] = below[:3, :3] @ drawing.turn
                T_platform = poses[tree.root] @ T_link_base @ nominal.platform
                poses[link] = T_platform @ np.linalg.inv(below)
        return poses

    def _shifted(self, T: Array) -> Pairs:
        """Return displacements in space by joint, at its parent and at its child."""
        shifts, names = Pairs(), {edge.joint.name for edge in self.tree.edges}
        ends = (end for leg in self.legs for end in leg.every_end)
        for name in self.names.union(*(end.frames for end in ends)):
            pairs = zip(self.nominal.frames[name], self.true.frames[name], strict=True)
            before, after = (_between(T, *pair) for pair in pairs)
            if name in self.drawing.backward:
                before, after = after, before
            shifts[name] = (after, after) if self.redrawn else (before, after)
        for name in names - shifts.keys():
            ball = re.sub(r"_[xyz]$", "", name)
            if ball in shifts and ball not in names:  # at an end of a leg
                shifts[name] = shifts[ball]
            elif name == f"{ball}_x" and f"{ball}_y" in shifts:  # idle
                shifts[name] = (shifts[f"{ball}_y"][0],) * 2
        return shifts

    def _guide(self, top: str | None) -> None:
        """Let the platform's own freedoms, which are in no leg, go with the platform."""
        way = route(self.tree.edges, self.tree.root, top) if top else []
        freedoms = [edge.joint.name for edge, forward in way if forward and edge.moves]
        if freedoms and not self.shifts.keys() & set(freedoms):
            self.shifts[freedoms[0]] = self.platform if self.redrawn else np.eye(4), self.platform

    def places(self) -> Pairs:
        """Return by link a joint's place on its parent, and the link's in the frame after it."""
        places = Pairs()
        for link, edge in self.edges.items():
            parent, T_parent = self.moved[edge.parent], self.poses[edge.parent]
            T_link = self.poses[link]
            before, after = self.shifts.get(edge.joint.name, (parent, parent))
            if link not in self.given:  # it follows the anchor, and keeps its orientation
                shift = after @ np.linalg.inv(before) @ parent
                shift[:3, 3] = (after[:3, :3] - shift[:3, :3]) @ T_link[:3, 3] + after[:3, 3]
                self.moved[link] = shift
            drawn = T_parent @ edge.joint.placement.origin()
            at_parent = np.linalg.inv(parent @ T_parent) @ before @ drawn
            places[link] = at_parent, np.linalg.inv(after @ T_link) @ self.moved[link] @ T_link
        return places

    def loops(self) -> Pairs:
        """Return the places of each loop on its parent and on its child, after ``places``."""
        loops = Pairs()
        for loop in self.tree.loops:
            name, ends = loop.joint.name, (loop.parent, loop.child)
            keys = [f"{name}_x", f"{name}_z", name, f"{name}_at"]
            keys += [self.edges[link].joint.name for link in ends if link in self.edges]
            shift = self.moved[loop.parent]
            if loop.closes == "point":
                shift = next((self.shifts[key][1] for key in keys if key in self.shifts), shift)
            drawn = loop.joint.placement.origin(), loop.at_child.origin()
            pairs = list(zip(ends, drawn, strict=True))
            miss = np.subtract(*(self.poses[link] @ place for link, place in pairs))
            miss = miss[:, 3:] if loop.closes == "point" else miss
            apart = np.abs(np.subtract(*(self.moved[link] for link in ends))).max() > ROUNDING
            if apart and np.abs(miss).max() > max(ALIKE, self.tree.slack) * self.legs[0].size:
                raise MechanismError(
                    f"{self.tree.source}: how {loop.parent!r} and {loop.child!r} lie where loop "
                    f"{name!r} closes is not known, as it is drawn open; draw it closed"
                )
            first, second = (
                np.linalg.inv(self.moved[link] @ self.poses[link]) @ shift @ self.poses[link] @ T
                for link, T in pairs
            )
            if loop.closes == "point":
                first[:3, :3], second[:3, :3] = (place[:3, :3] for place in drawn)
            loops[name] = first, second
        return loops


def _between(T: Array, old: Array, new: Array) -> Array:
    """Return the displacement in space of a pose that is given in a frame T, shape (4, 4)."""
    return np.asarray(T @ new @ np.linalg.inv(T @ old))


def _quaternion(T: Array, near: Array) -> Array:
    """Return the quaternion of a pose, scalar first, with the sign of another."""
    quat = Rotation.from_matrix(T[:3, :3]).as_quat(scalar_first=True)
    return np.asarray(quat * np.sign(quat @ near))


class _Written:
    """MuJoCo's model, into which places are written, and the numbers that change."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model, self.numbers = model, Numbers()

    def change(self, element: tuple[str, int], key: str, old: Array, value: Array) -> None:
        """Write an attribute's value over the old one, if they differ."""
        if np.abs(old - value).max() > ROUNDING:
            self.numbers.setdefault(element, {})[key] = value
            old[:] = value

    def place(self, kind: str, index: int, T: Array) -> None:
        """Write the pose of a body or site."""
        quat = getattr(self.model, f"{kind}_quat")[index]
        self.change((kind, index), "pos", getattr(self.model, f"{kind}_pos")[index], T[:3, 3])
        self.change((kind, index), "quat", quat, _quaternion(T, quat))

    def bodies(self, edges: Mapping[str, Edge], places: Pairs) -> None:
        """Write bodies, their joints and named sites."""
        model, (links, joints) = self.model, names_of(self.model)
        for body in range(1, model.nbody):
            chain = [links[body]]
            while (parent := edges[chain[0]].parent) != links[model.body_parentid[body]]:
                chain.insert(0, parent)
            T, frames = np.eye(4), dict[str, Array]()
            for link in chain:
                frames[edges[link].joint.name] = T @ places[link][0]
                T = T @ places[link][0] @ places[link][1]
            self.place("body", body, T)
            axes = {edges[link].joint.name: edges[link].joint.axis for link in chain}
            for i in np.flatnonzero(model.jnt_bodyid == body).tolist():
                if model.jnt_type[i] != mujoco.mjtJoint.mjJNT_FREE:
                    axes_of_joint = re.compile(f"{re.escape(joints[i])}(_[xyz])?")
                    series = list(filter(axes_of_joint.fullmatch, frames))
                    local = np.linalg.inv(T) @ [frames[key] for key in series]
                    self.joint(i, joints[i], local, axes.get(joints[i]))
        for i in range(model.nsite):
            site = model.site(i).name
            if site and (site := site + "_site" * (site in links)) in places:
                self.place("site", i, np.matmul(*places[site]))

    def joint(self, i: int, name: str, frames: Array, axis: Sequence[float] | None) -> None:
        """Write a joint by the frames, (n, 4, 4), of its axes in its body; a ball has three."""
        if (miss := np.ptp(frames[:, :3, 3], axis=0).max()) > EXACT:
            raise MechanismError(
                f"the axes of ball joint {name!r} were calibrated {1e3 * miss:.3g} mm apart, "
                "which a ball of MJCF cannot hold; hold them at zero (--fixed)"
            )
        if self.model.jnt_type[i] != mujoco.mjtJoint.mjJNT_SLIDE:
            self.change(("joint", i), "pos", self.model.jnt_pos[i], frames[0, :3, 3])
        if axis is not None:
            self.change(("joint", i), "axis", self.model.jnt_axis[i], frames[0, :3, :3] @ axis)

    def loops(self, loops: Pairs) -> None:
        """Write equalities, or the sites that they join."""
        model = self.model
        for i in range(model.neq):
            name, data = model.eq(i).name or f"loop_{i + 1}", model.eq_data[i]
            if name not in loops:
                continue
            first, second = loops[name]
            if model.eq_objtype[i] == mujoco.mjtObj.mjOBJ_SITE:
                self.place("site", int(model.eq_obj1id[i]), first)
                self.place("site", int(model.eq_obj2id[i]), second)
            elif model.eq_type[i] == mujoco.mjtEq.mjEQ_CONNECT:
                data[3:6] = second[:3, 3]
                self.change(("loop", i), "anchor", data[:3], first[:3, 3])
            else:
                relative = first @ np.linalg.inv(second) @ pose_of(data[:3])
                value = np.append(relative[:3, 3], _quaternion(relative, data[6:10]))
                self.change(("loop", i), "relpose", data[3:10], value)


def _patched(path: Path, model: mujoco.MjModel, numbers: Numbers) -> bytes:
    """Return a file's bytes with new numbers of its elements, counted as MuJoCo counts them."""
    root, settings = read_xml(path, "mujoco"), {"angle": "degree", "eulerseq": "xyz"}
    for element in root.iterfind(".//compiler"):
        settings |= {key: str(element.get(key, value)) for key, value in settings.items()}
    loops, bodies = map(root.iterfind, (".//equality/*", ".//worldbody//body"))
    keys: dict[Any, tuple[str, int]] = {loop: ("loop", i) for i, loop in enumerate(loops)}
    keys |= {body: ("body", i) for i, body in enumerate(bodies, 1)}
    for kind, carriers in (("joint", model.jnt_bodyid), ("site", model.site_bodyid)):
        counts = Counter[int]()
        for element in root.iterfind(f".//worldbody//{kind}"):
            body = keys.get(next(element.iterancestors("body"), None), ("body", 0))[1]
            keys[element] = kind, int(np.searchsorted(carriers, body)) + counts[body]
            counts[body] += 1
    new = {element: numbers.get(key, {}) for element, key in keys.items()}
    return with_tags(
        path, root, lambda part, tag: _changed(tag, part.attrib, new.get(part, {}), settings)
    )


def _changed(
    tag: bytes,
    attributes: etree._Attrib,
    numbers: Mapping[str, Array],
    settings: Mapping[str, str],
) -> bytes:
    """Return a start tag with new numbers; an orientation keeps its notation if that holds any."""
    unit = 1.0 if settings["angle"] == "radian" else 180.0 / np.pi
    for key, value in numbers.items():
        if key == "relpose" and key not in attributes:
            continue  # the drawing has it
        if key == "quat":
            turn = Rotation.from_quat(value, scalar_first=True)
            axes = settings["eulerseq"]  # capitals turn about fixed axes, in reverse
            order = sorted(range(3), key=lambda i: -i if axes[i].isupper() else i + 1)
            first, second, third = (axes[i].upper() for i in order)
            if "euler" in attributes and first != second != third:
                angles = turn.as_euler(first + second + third)
                key, value = "euler", unit * angles[np.argsort(order)]
            elif "axisangle" in attributes:
                vector = turn.as_rotvec()
                angle = np.linalg.norm(vector)
                key, value = "axisangle", np.append(vector / angle, unit * angle)
            elif "xyaxes" in attributes:
                key, value = "xyaxes", turn.as_matrix()[:, :2].T.ravel()
            if key == "quat":
                tag = re.sub(rb"(\s)(zaxis|euler)(?=\s*=)", rb"\1quat", tag)
        tag = with_numbers(tag, key, value)
    return tag
