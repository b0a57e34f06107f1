"""Reading of MJCF as a tree with loops, couplings and drives; and writing of mechanisms as MJCF.

MuJoCo's own compiler resolves defaults, includes, frames, replicas and every notation of an
orientation. The compiled model has the kinematics that simulation uses (``body_pos``, ``jnt_axis``,
``qpos0``, ``eq_data``). Joints are zero where the file draws them, so a ``ref`` is not added.
Source: MuJoCo's documentation, "Computation" and ``mjmodel.h``.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from html import unescape
from pathlib import Path
from typing import TYPE_CHECKING

import lazy_loader
import numpy as np
from lxml import etree
from scipy.spatial.transform import RigidTransform, Rotation

from pincal.errors import MechanismError
from pincal.files.text import read_xml
from pincal.files.tree import Edge, Tree, at_home, root_of, turns, with_ranges
from pincal.files.urdf import numbers_text, xml_text
from pincal.kinematics.assembly import assembled
from pincal.model import Closing, Follows, Joint, Leg, Mechanism, Placement, Platform, placement_of
from pincal.model.checks import LARGEST
from pincal.model.joint import JointKind
from pincal.model.platform import turns_in_series
from pincal.types import Array

if TYPE_CHECKING:
    import mujoco
else:
    mujoco = lazy_loader.load("mujoco")


_NOISE = re.compile(r"(?:XML )?Error: |Element name '', id \d+, ")
_STILL = np.array([1.0, 0.0, 0.0, 0.0])
_TETRAHEDRON = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
_PLATFORM = "platform"


def read_mjcf(path: Path) -> Tree:
    """Return the tree of an MJCF file, with its loops and drives."""
    title, model = read_xml(path, "mujoco").get("model"), compiled(path)
    links, joints = names_of(model)
    edges = [edge for body in range(1, model.nbody) for edge in _edges(model, body, links, joints)]
    carriers, remarks = {edge.child: edge.joint.name for edge in edges}, dict[str, str]()
    for i, body in enumerate(model.site_bodyid):  # a named site is a link fixed to its body
        name, placement = model.site(i).name, pose_of(model.site_pos[i], model.site_quat[i])
        site = name + "_site" * (name in links)
        if name and site not in links:
            joint = Joint(site + "_fixed" * (site in joints), "fixed", placement_of(placement))
            edges.append(Edge(joint, links[body], site))
        if name in carriers and not (links[body] == name and np.allclose(placement, np.eye(4))):
            remarks[carriers[name]] = f"{name!r} is a body here; the site of that name is {site!r}"
    of_joint = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    driven = model.actuator_trnid[np.isin(model.actuator_trntype, of_joint), 0]
    follows, refused = _coupled(model, joints, path)
    edges = [replace(e, joint=replace(e.joint, follows=follows.get(e.joint.name))) for e in edges]
    tree = Tree(
        name=title or path.stem,
        source=str(path),
        root=root_of(edges, links, str(path)),
        edges=at_home(tuple(edges), _home(model, joints)),
        loops=tuple(_loops(model, links)),
        active=tuple(dict.fromkeys(joints[i] for i in driven)),
        refused=refused,
        remarks=remarks,
    )
    return with_ranges(tree)


def compiled(path: Path, text: bytes | None = None) -> mujoco.MjModel:
    """Return MuJoCo's model of a file, or of a text in its place, without meshes and pictures."""
    try:
        handler = mujoco.get_mju_user_warning()
    except ModuleNotFoundError as error:
        raise MechanismError(
            "MJCF is read by MuJoCo, which is not installed: python -m pip install 'pincal[mujoco]'"
        ) from error
    mujoco.set_mju_user_warning(lambda _: None)  # it writes a log into the working folder
    try:
        with warnings.catch_warnings(action="ignore"):  # masses do not matter here
            spec = _spec(path, text)
            _drop_shapes(spec)
            model = spec.compile()
        model.names.decode()  # names are texts
    except (ValueError, RuntimeError) as error:
        fault = " ".join(_NOISE.sub("", str(error)).split())[:240]
        raise MechanismError(f"{path}: MuJoCo cannot read it: {fault}") from error
    finally:
        mujoco.set_mju_user_warning(handler)
    places = (model.body_pos, model.jnt_pos, model.jnt_axis, model.site_pos, model.eq_data)
    turns_of_places = np.linalg.norm(np.concatenate((model.body_quat, model.site_quat)), axis=1)
    small = all((np.abs(numbers) <= LARGEST).all() for numbers in places)
    if not (small and (turns_of_places > 0.0).all()):
        raise MechanismError(f"{path}: a position or axis has a number not finite or too large")
    return model


def _spec(path: Path, text: bytes | None) -> mujoco.MjSpec:
    if text is None:
        return mujoco.MjSpec.from_file(str(path))
    files, parts = dict[str, bytes](), [text]
    while parts:
        plain = re.sub(rb"<!--.*?-->", b"", parts.pop(), flags=re.DOTALL).decode("utf-8", "replace")
        for name in re.findall(r"<include\s[^>]*?file\s*=\s*[\"']([^\"']+)", plain):
            if (file := unescape(name)) not in files:
                files[file] = (path.parent / file).read_bytes()
                parts.append(files[file])
    return mujoco.MjSpec.from_string(text.decode("utf-8", "replace"), include=files)


def _drop_shapes(spec: mujoco.MjSpec) -> None:
    """Replace files of shapes by small ones; keep all bodies, and their frames as drawn."""
    for mesh in spec.meshes:
        mesh.file, mesh.uservert = "", _TETRAHEDRON
    for texture in spec.textures:
        texture.file, texture.builtin = "", mujoco.mjtBuiltin.mjBUILTIN_FLAT
        texture.cubefiles = [""] * len(texture.cubefiles)
        texture.width = texture.height = 1
    for field in spec.hfields:
        field.file, field.nrow, field.ncol, field.userdata = "", 2, 2, [0.0, 1.0, 1.0, 0.0]
    for skin in list(spec.skins):
        spec.delete(skin)
    spec.compiler.boundmass = spec.compiler.boundinertia = 1.0
    spec.compiler.balanceinertia = True
    spec.compiler.fusestatic = spec.compiler.alignfree = False


def names_of(model: mujoco.MjModel) -> tuple[list[str], list[str]]:
    """Return the names of bodies and of joints; those without a name are numbered."""
    links = [model.body(i).name or f"body_{i}" for i in range(model.nbody)]
    bodies = enumerate(model.jnt_bodyid)
    return links, [model.joint(i).name or f"{links[b]}_joint_{i}" for i, b in bodies]


def pose_of(position: Array, quaternion: Array = _STILL) -> Array:
    """Return the pose, shape (4, 4), of a position [m] and a quaternion, scalar first."""
    turn = Rotation.from_quat(quaternion, scalar_first=True)
    return RigidTransform.from_components(position, turn).as_matrix()


def _edges(model: mujoco.MjModel, body: int, links: list[str], joints: list[str]) -> Iterator[Edge]:
    """Yield edges of a body's joints in series, each in a frame at its anchor."""
    link, name = links[model.body_parentid[body]], links[body]
    T_link_body = pose_of(model.body_pos[body], model.body_quat[body])
    anchor = np.zeros(3)
    first, count = model.body_jntadr[body], model.body_jntnum[body]
    for i in range(first, first + count):
        kind = model.jnt_type[i]
        place = model.jnt_pos[i] * (kind != mujoco.mjtJoint.mjJNT_FREE)
        T_link_body[:3, 3] += T_link_body[:3, :3] @ (place - anchor)
        last = i == first + count - 1 and not place.any()
        child = name if last else f"{name}_after_{joints[i]}"
        joint = Joint(joints[i], "fixed", placement_of(T_link_body))
        if kind == mujoco.mjtJoint.mjJNT_BALL:
            yield from turns(joint, link, child, "xyz")
        elif kind == mujoco.mjtJoint.mjJNT_FREE:
            yield from turns(joint, link, child, "XYZxyz")
        else:
            x, y, z = map(float, model.jnt_axis[i])
            turning = kind == mujoco.mjtJoint.mjJNT_HINGE
            limits = np.array([-np.inf, np.inf])
            if model.jnt_limited[i]:
                limits = model.jnt_range[i] - model.qpos0[model.jnt_qposadr[i]]
            lower, upper = limits.tolist()
            moves: JointKind = "revolute" if turning else "prismatic"
            joint = replace(joint, kind=moves, axis=(x, y, z), lower=lower, upper=upper)
            yield Edge(joint, link, child)
        link, anchor, T_link_body = child, place, np.eye(4)
    if link != name:
        T_link_body[:3, 3] -= T_link_body[:3, :3] @ anchor
        yield Edge(Joint(f"{name}_fixed", "fixed", placement_of(T_link_body)), link, name)


def _home(model: mujoco.MjModel, joints: list[str]) -> dict[str, float]:
    """Return the joint positions of the first keyframe, by name, zero where the file draws them."""
    home: dict[str, float] = {}
    for i in range(model.njnt if model.nkey else 0):
        kind, address = model.jnt_type[i], model.jnt_qposadr[i]
        qpos = model.key_qpos[0, address : address + 4]
        if kind == mujoco.mjtJoint.mjJNT_BALL:
            angles = turns_in_series(pose_of(np.zeros(3), qpos)[None, :3, :3])[0]
            home |= {f"{joints[i]}_{axis}": float(a) for axis, a in zip("xyz", angles, strict=True)}
        elif kind != mujoco.mjtJoint.mjJNT_FREE:  # loops determine the pose of a free body
            home[joints[i]] = float(qpos[0] - model.qpos0[address])
    return home


def _loops(model: mujoco.MjModel, links: list[str]) -> Iterator[Edge]:
    """Yield the edges that connect and weld close.

    For bodies, ``eq_data`` has both anchors: for connect the first body's, then the second's; for
    weld the second's, then its pose in the first body.
    """
    for i, data in enumerate(model.eq_data):
        connects = model.eq_type[i] == mujoco.mjtEq.mjEQ_CONNECT
        welds = model.eq_type[i] == mujoco.mjtEq.mjEQ_WELD
        if not (connects or welds) or not model.eq_active0[i]:
            continue
        ends = [int(model.eq_obj1id[i]), int(model.eq_obj2id[i])]
        if model.eq_objtype[i] == mujoco.mjtObj.mjOBJ_SITE:
            poses = [pose_of(model.site_pos[end], model.site_quat[end]) for end in ends]
            ends = [int(model.site_bodyid[end]) for end in ends]
        elif connects:
            poses = [pose_of(data[:3]), pose_of(data[3:6])]
        else:
            poses = [pose_of(data[3:6], data[6:10]), pose_of(data[:3])]
        if (model.body_mocapid[ends] >= 0).any():
            continue  # a mocap body is moved by the user, and no part of the machine
        first, second = map(placement_of, poses)
        joint = Joint(model.eq(i).name or f"loop_{i + 1}", "fixed", first)
        closes: Closing = "point" if connects else "frame"
        yield Edge(joint, links[ends[0]], links[ends[1]], second, closes)


def _coupled(
    model: mujoco.MjModel, joints: list[str], path: Path
) -> tuple[dict[str, Follows], dict[str, str]]:
    """Return the joints that others follow, and errors for joints coupled otherwise, by name.

    Positions are zero where the file draws them, as the coefficients of a coupling assume. A
    tendon through space couples all joints.
    """
    coupled, follows = list[int](), dict[str, Follows]()
    for i in np.flatnonzero(model.eq_active0):
        if model.eq_type[i] == mujoco.mjtEq.mjEQ_JOINT:
            follower, leader = model.eq_obj1id[i], model.eq_obj2id[i]
            offset, ratio, *curved = map(float, model.eq_data[i, :5])
            if leader < 0 or ratio == 0.0 or any(curved):
                coupled.append(follower)
            else:
                follows[joints[follower]] = Follows(joints[leader], ratio, offset)
        elif model.eq_type[i] == mujoco.mjtEq.mjEQ_TENDON:
            for tendon in {model.eq_obj1id[i], model.eq_obj2id[i]} - {-1}:
                first = model.tendon_adr[tendon]
                along = slice(first, first + model.tendon_num[tendon])
                fixed = (model.wrap_type[along] == mujoco.mjtWrap.mjWRAP_JOINT).all()
                coupled += model.wrap_objid[along].tolist() if fixed else range(model.njnt)
    return follows, {
        joints[i]: f"{path}: an <equality> couples joint {joints[i]!r} to others, but not by a "
        "ratio to one of them"
        for i in coupled
    }


def mjcf(mechanism: Mechanism) -> str:
    """Return a mechanism at nominal parameters as MJCF; the keyframe closes the loops if possible.

    The platform is connected to the base by its freedoms as passive joints, and each leg closes a
    loop with it; so legs and platforms of any kind are written alike and can be read again. A
    serial arm has no loop, and its tip is the platform. Joints keep their names if all are unique;
    otherwise they are ``leg_joint``.
    """
    with suppress(MechanismError):
        legs, platform = assembled(mechanism.legs, mechanism.platform)
        mechanism = replace(mechanism, legs=legs, platform=platform)
    first, placed = mechanism.legs[0], [joint for leg in mechanism.legs for joint in leg.joints]
    serial = len(mechanism.legs) == 1 and first.is_arm and first.point.placement == Placement()
    freedoms = [] if serial else _freedoms(mechanism.platform)
    names = [joint.name for joint in placed]
    shared = len(set(names)) != len(names) or _PLATFORM in names
    thickness = 0.01 * mechanism.size
    root = etree.Element("mujoco", model=mechanism.name)
    etree.SubElement(root, "compiler", angle="radian", autolimits="true")
    base = etree.SubElement(etree.SubElement(root, "worldbody"), "body", name="base")
    equality, actuators = (etree.SubElement(root, tag) for tag in ("equality", "actuator"))
    carried = [base, *_chain(base, "on_platform", freedoms, thickness)][-1]
    for leg in mechanism.legs:
        stem = f"{leg.name}_" * shared
        joints = [replace(joint, name=stem + joint.name) for joint in leg.joints]
        bodies = _chain(base, f"{leg.name}_link", joints, thickness, leg.carriers)
        _drive(leg, stem, equality, actuators)
        if serial:
            carried = bodies[-1]
        else:
            _close(leg, mechanism.platform, bodies, carried, equality)
    carried.set("name", _PLATFORM)
    of_legs = (joint.position(leg.homes) for leg in mechanism.legs for joint in leg.articulated)
    home = numbers_text((*(joint.home for joint in freedoms), *of_legs))
    etree.SubElement(etree.SubElement(root, "keyframe"), "key", name="home", qpos=home)
    return xml_text(root)


def _drive(leg: Leg, stem: str, equality: etree._Element, actuators: etree._Element) -> None:
    """Add actuators of a leg's active joints, and equalities of joints that follow others."""
    for name in (stem + sensor.joint for sensor in leg.sensors):
        etree.SubElement(actuators, "position", name=name, joint=name)
    for joint in (joint for joint in leg.joints if joint.follows):
        leader, ratio, offset = joint.leader
        pair = {"joint1": stem + joint.name, "joint2": stem + leader}
        coefficients = numbers_text((offset, ratio, 0.0, 0.0, 0.0))
        etree.SubElement(equality, "joint", {**pair, "polycoef": coefficients})


def _close(
    leg: Leg,
    platform: Platform,
    bodies: Sequence[etree._Element],
    carried: etree._Element,
    equality: etree._Element,
) -> None:
    """Add sites where a leg's ends meet the platform's body or its own, and their equalities."""
    for place, end in enumerate(leg.every_end, 1):
        name = leg.name + f"_{place}" * (place > 1)
        sites = {"site1": f"{name}_tip", "site2": f"{name}_end"}
        etree.SubElement(bodies[leg.index(end.tip)], "site", name=sites["site1"])
        met, pose = carried, dict[str, str]()
        if isinstance(end.meets, str):
            met = bodies[leg.index(end.meets)]
        else:
            x, y, z = end.meets.placement.xyz
            if platform.space == 2:  # in the plane, points are at the height of the tip
                z = float(leg.link_placements(leg.home[None])[0, leg.index(end.tip), 2, 3])
            pose = _written_pose(Placement((), (x, y, z), end.meets.placement.rpy))
        etree.SubElement(met, "site", {"name": sites["site2"], **pose})
        tag = "weld" if end.closes == "frame" or "rz" in end.closes else "connect"
        etree.SubElement(equality, tag, {"name": name, **sites})


def _freedoms(platform: Platform) -> list[Joint]:
    T = platform.home_pose.as_matrix()[0]
    home = (*T[:3, 3], *turns_in_series(T[None, :3, :3])[0])
    letters = "".join("XYZxyz"[row] for row in platform.twist_rows)
    edges = turns(Joint(_PLATFORM, "fixed"), "", "", letters)
    rows = zip(edges, platform.twist_rows, strict=True)
    return [replace(edge.joint, home=float(home[row])) for edge, row in rows]


def _chain(
    base: etree._Element,
    name: str,
    joints: Sequence[Joint],
    thickness: float,
    carriers: Sequence[int] | None = None,
) -> list[etree._Element]:
    """Add a body for each joint, and a rod to it, on the body before or of the joint's carrier."""
    bodies: list[etree._Element] = []
    for index, joint in enumerate(joints):
        carrier = index - 1 if carriers is None else carriers[index]
        parent, placement = bodies[carrier] if carrier >= 0 else base, joint.placement
        pose = {"name": f"{name}_{index + 1}", **_written_pose(placement)}
        body = etree.SubElement(parent, "body", pose)
        etree.SubElement(body, "inertial", pos="0 0 0", mass="0.1", diaginertia="0.001 0.001 0.001")
        if joint.kind != "fixed":
            kind = "slide" if joint.kind == "prismatic" else "hinge"
            attributes = {"name": joint.name, "type": kind, "axis": numbers_text(joint.axis)}
            if np.isfinite([joint.lower, joint.upper]).all():
                attributes["range"] = numbers_text((joint.lower, joint.upper))
            etree.SubElement(body, "joint", attributes)
        if any(abs(value) > 1e-9 for value in placement.xyz):
            shape = {"fromto": f"0 0 0 {numbers_text(placement.xyz)}", "size": f"{thickness:.6g}"}
            looks = {"type": "capsule", "contype": "0", "conaffinity": "0", "mass": "0"}
            etree.SubElement(parent, "geom", {**shape, **looks})
        bodies.append(body)
    return bodies


def _written_pose(placement: Placement) -> dict[str, str]:
    pose = {}
    if any(placement.xyz):
        pose["pos"] = numbers_text(placement.xyz)
    if any(placement.rpy):
        turn = Rotation.from_matrix(placement.origin()[:3, :3])
        pose["quat"] = numbers_text(turn.as_quat(scalar_first=True))
    return pose


def unwritten(mechanism: Mechanism) -> tuple[str, ...]:
    """Return a sentence on sensors and terms that other programs' files cannot hold, if any."""
    legs = [
        leg.name
        for leg in mechanism.legs
        if leg.terms or not all(s.reads_position(leg.nominal_by_name) for s in leg.sensors)
    ]
    remark = (
        "the file holds joint positions of one machine, not readings: it cannot hold gains, "
        f"offsets, zeros and terms of {', '.join(legs)}"
    )
    return (remark,) * bool(legs)
