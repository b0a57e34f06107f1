"""A mechanism as parts that move: shapes of its links, and where each is at every pose.

Parts are what the exported URDFs draw, and what rigid links cannot show: cylinder and piston or
cable of a prismatic joint, as long as the joint has moved, parallelograms, plates; in their place
meshes of one's own URDF (STL, DAE, OBJ). Names of joints say what kinematics do not: a ``line`` or
``cable`` pulls, and a rod behind a joint called ``elbow`` or ``sway`` of a platform that does not
turn is a parallelogram. Where a leg does not reach, its links are NaN.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from pincal.errors import FileError
from pincal.files.text import read_xml
from pincal.files.urdf_writing import leg_urdf, platform_urdf
from pincal.kinematics.configurations import as_plan, joints_at
from pincal.kinematics.readers import check_mesh
from pincal.model.home import link_placements
from pincal.model.leg import Leg
from pincal.model.measurements import Plan
from pincal.model.mechanism import Mechanism
from pincal.types import Array

GREY, PALE = "#595959", "#9aa0a6"
_FLAT = 1e-6  # of what is a plane's size


@dataclass(frozen=True, eq=False)
class Shape:
    """A box, cylinder (along z) or sphere on a link, the hull of points, or a mesh."""

    kind: str
    size: tuple[float, ...]
    """Edges of a box; radius and length of a cylinder; radius of a sphere; else none; [m]."""
    T_link_shape: Array
    """Shape (4, 4)."""
    colour: str
    """``"#rrggbb"``."""
    points: Array | None = None
    """Of a hull, or corners of a mesh, shape (n, 3), [m]."""
    faces: NDArray[np.int64] | None = None
    """Corners of a mesh's triangles, shape (m, 3)."""


def rod(begin: Array, end: Array, radius: float, colour: str) -> Shape:
    """Return a cylinder between two points, shape (3,) each, [m]."""
    along = end - begin
    length = float(np.linalg.norm(along))
    T = np.eye(4)
    T[:3, 2] = along / length
    T[:3, 0], T[:3, 1] = across(T[:3, 2])
    T[:3, 3] = (begin + end) / 2
    return Shape("cylinder", (radius, length), T, colour)


def across(axis: Array) -> tuple[Array, Array]:
    """Return two unit vectors that make a right-handed frame with a unit vector as its z."""
    first = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    first /= np.linalg.norm(first)
    return first, np.cross(axis, first)


def plate(points: Array, thickness: float, colour: str = GREY) -> tuple[Shape, ...]:
    """Return a plate through points, or a body where they are in no plane; none of a line.

    Args:
        points: Shape (n, 3), [m].
        thickness: [m].
        colour: ``"#rrggbb"``.
    """
    sizes, turned = _principal(points)
    if sizes[1] < _FLAT * sizes[0] or not sizes[0]:
        return ()
    shift = 0.5 * thickness * turned[2]
    corners = np.concatenate((points + shift, points - shift))
    return (Shape("hull", (), np.eye(4), colour, corners[ConvexHull(corners).vertices]),)


def base(feet: Array, home: Array, size: float) -> tuple[Shape, ...]:
    """Return what feet stand on: a plate where the machine is above them, else a frame.

    Args:
        feet: Shape (n, 3), [m].
        home: Of the platform, shape (3,), [m].
        size: Radius of joints, [m].
    """
    distinct = np.unique(feet.round(9), axis=0)
    if len(distinct) < 2:
        return ()
    sizes, turned = _principal(distinct)
    if sizes[1] < _FLAT * sizes[0]:
        along = distinct @ turned[0]
        ends = distinct[[int(np.argmin(along)), int(np.argmax(along))]]
        return (rod(ends[0], ends[1], 0.25 * size, PALE),)
    if sizes[2] > _FLAT * sizes[0]:
        return ()
    level = distinct.mean(axis=0)
    if (home - level) @ np.array([0, 0, 1.0]) > size and abs(turned[2, 2]) > 1 - _FLAT:
        lowered = distinct - np.array([0.0, 0.0, 0.9 * size])
        return plate(lowered, 0.6 * size, PALE)
    corners = distinct[ConvexHull(distinct @ turned[:2].T).vertices]
    pairs = zip(corners, np.roll(corners, -1, axis=0), strict=True)
    return tuple(rod(first, second, 0.25 * size, PALE) for first, second in pairs)


def _principal(points: Array) -> tuple[Array, Array]:
    """Return sizes along the principal axes, shape (3,), and these, shape (3, 3), as rows."""
    _, sizes, turned = np.linalg.svd(points - points.mean(axis=0))
    return np.concatenate((sizes, np.zeros(3)))[:3], turned


def pulls(leg: Leg) -> bool:
    """Return whether a leg is a cable."""
    return any(j.kind == "prismatic" and j.name in ("line", "cable") for j in leg.joints)


def parallelogram(leg: Leg) -> int | None:
    """Return the place, among all joints, of the one that carries a parallelogram's rods."""
    place = len(leg.joints) - 2
    hinge = leg.joints[place - 1] if place > 0 else None
    if hinge is None or not hinge.name.startswith(("elbow", "sway", "swing")):
        return None
    revolute = leg.joints[place].kind == hinge.kind == "revolute"
    return place if revolute and np.any(leg.joints[-1].placement.xyz) else None


def two_rods(leg: Leg, radius: float) -> tuple[Shape, ...]:
    """Return a parallelogram in a frame whose x is along its rods and whose y is along its hinges.

    Args:
        leg: The leg.
        radius: Of joints, [m].
    """
    length = float(np.linalg.norm(leg.joints[-1].placement.xyz))
    half, parts = 2.4 * radius, []
    for side in (-half, half):
        ends = np.array([[0.0, side, 0.0], [length, side, 0.0]])
        parts.append(rod(ends[0], ends[1], 0.35 * radius, GREY))
    for place in (0.0, length):
        ends = np.array([[place, -half, 0.0], [place, half, 0.0]])
        parts.append(rod(ends[0], ends[1], 0.4 * radius, GREY))
    return tuple(parts)


def parallel_frame(leg: Leg, links: Array, place: int) -> Array:
    """Return ``T_base_parallelogram``, shape (N, 4, 4): hinges stay parallel, so it shears.

    Args:
        leg: The leg.
        links: ``T_base_link`` of all joints, shape (N, n, 4, 4).
        place: Of the joint that carries the rods.
    """
    along = np.array(leg.joints[-1].placement.xyz)
    T = links[:, place].copy()
    T[:, :3, 0] = links[:, place, :3, :3] @ (along / np.linalg.norm(along))
    T[:, :3, 1] = links[:, place - 1, :3, :3] @ np.array(leg.joints[place - 1].axis)
    T[:, :3, 2] = np.cross(T[:, :3, 0], T[:, :3, 1])
    return T


@dataclass(frozen=True)
class Part:
    """What moves as one."""

    path: str
    """Place in the scene: ``leg 1/base``, ``leg 1/link 2``, ``leg 1/rod 3``, ``leg 1/cylinder 3``,
    ``leg 1/parallel 4``, ``platform/body``, ``platform/point 1``, ``base/frame``; legs, joints and
    points counted from 1."""
    shapes: tuple[Shape, ...]


@dataclass(frozen=True, eq=False)
class Body:
    """A mechanism at N poses."""

    parts: tuple[Part, ...]
    placements: Array
    """``T_base_part``, shape (N, n_parts, 4, 4), [m]; NaN where it is not to be drawn."""
    chains: tuple[tuple[int, ...], ...]
    """For each leg, its links' places among the parts, base first, without base link and rods."""
    problems: tuple[str, ...]
    """Why something is not drawn at a pose; empty strings where all is."""
    barrels: dict[str, float]
    """Lengths of cylinders around prismatic joints, by the path of the rod, [m]; 0 of none."""

    def part(self, path: str) -> int:
        """Return a part's place by its path."""
        return [part.path for part in self.parts].index(path)

    def skeletons(self) -> Array:
        """Return segments from joint to joint and tip to platform, shape (N, n, 2, 3), [m]."""
        positions = self.placements[:, :, :3, 3]
        platform = self.part("platform/body")
        pairs = np.array(
            [pair for c in self.chains for pair in zip(c, (*c[1:], platform), strict=True)]
        )
        return positions[:, pairs]


def body(
    mechanism: Mechanism, planned: Plan | Array, barrels: Mapping[str, float] | None = None
) -> Body:
    """Return a mechanism at poses, each leg in its working mode, or as readings say.

    Args:
        mechanism: The mechanism, at its nominal parameters.
        planned: Platform coordinates, shape (N, dof), [m] and [rad], or a plan.
        barrels: Lengths of cylinders, of a body at other poses; else they suit these.

    Raises:
        MechanismError: poses of a wrong shape, or not finite.
    """
    platform = mechanism.platform
    solution = joints_at(mechanism, planned)
    poses = as_plan(mechanism, planned).poses
    T_base_platform = platform.matrices(poses)
    parts: list[Part] = []
    placements: list[Array] = []
    chains = []
    lengths = dict(barrels or {})

    def add(path: str, shapes: tuple[Shape, ...], placement: Array) -> None:
        parts.append(Part(path, shapes))
        placements.append(np.broadcast_to(placement, (len(poses), 4, 4)))

    for number, leg in enumerate(mechanism.legs, 1):
        joints = solution.joints[leg.name]
        foot, *shapes = urdf_shapes(leg_urdf(leg))
        radius = foot[0].size[2]
        add(f"leg {number}/base", foot, np.eye(4))
        links = link_placements(leg, joints)
        chains.append(tuple(range(len(parts), len(parts) + len(shapes))))
        pair = parallelogram(leg) if mechanism.platform.kind == "translational" else None
        for place, link_shapes in enumerate(shapes):
            rigid = link_shapes[:1] if place == pair else link_shapes
            add(f"leg {number}/link {place + 1}", rigid, links[:, place])
        if pair is not None:
            frame = parallel_frame(leg, links, pair)
            add(f"leg {number}/parallel {pair + 1}", two_rods(leg, radius), frame)
        for path, shape, placement in _pistons(leg, number, (joints, links), radius, lengths):
            add(path, (shape,), placement)
    shapes = urdf_shapes(platform_urdf(mechanism.name, mechanism.legs))
    points = {leg.point.name: leg.point for leg in mechanism.legs}
    corners = np.array([point.placement.xyz for point in points.values()])
    size = shapes[0][0].size[1]
    solid = plate(corners, 0.7 * size)
    add("platform/body", (*shapes[0][:1], *solid) if solid else shapes[0], T_base_platform)
    for number, (point, link_shapes) in enumerate(zip(points.values(), shapes[1:], strict=True), 1):
        add(f"platform/point {number}", link_shapes, T_base_platform @ point.placement.origin())
    feet = np.array([leg.joints[0].placement.xyz for leg in mechanism.legs])
    home = platform.home_pose.as_matrix()[0, :3, 3]
    add("base/frame", base(feet, home, size), np.eye(4))
    problems = tuple(solution.reason(row) for row in range(len(poses)))
    T_base_part = np.stack(placements, axis=1)
    T_base_part[~np.isfinite(T_base_part).all(axis=(2, 3))] = np.nan
    return Body(tuple(parts), T_base_part, tuple(chains), problems, lengths)


def _pistons(
    leg: Leg, number: int, moved: tuple[Array, Array], radius: float, lengths: dict[str, float]
) -> Iterator[tuple[str, Shape, Array]]:
    """Yield path, shape and placements of the rods of prismatic joints, and of their cylinders.

    Args:
        leg: The leg.
        number: Of the leg, from 1.
        moved: Joint positions, shape (N, n_joints), and ``T_base_link``, shape (N, n, 4, 4).
        radius: Of joints, [m].
        lengths: Of cylinders by the paths of their rods, [m]; those that it lacks are added.
    """
    joints, links = moved
    cable = pulls(leg)
    for place, column in _strokes(leg):
        path = f"leg {number}/rod {place + 1}"
        strokes = joints[:, column]
        inside = lengths.setdefault(path, 0.0 if cable else _barrel(strokes))
        rod, barrel = _rod(leg.joints[place].axis, strokes, inside)
        thin = (0.16 if cable else 0.4) * radius
        yield path, Shape("cylinder", (thin, 1.0), _UPWARD, PISTON), links[:, place] @ rod
        if inside:
            outer = Shape("cylinder", (0.8 * radius, 1.0), _UPWARD, GREY)
            yield f"leg {number}/cylinder {place + 1}", outer, links[:, place] @ barrel


PISTON = "#b9bec5"
#: Length of a cylinder, of the shortest stroke.
BARREL = 0.62
_UPWARD = np.eye(4)
_UPWARD[2, 3] = 0.5  # a cylinder of length 1 that begins at the origin


def _strokes(leg: Leg) -> list[tuple[int, int]]:
    """Return the places of a leg's prismatic joints, among all joints and among the moving ones."""
    moving = [joint.name for joint in leg.moving]
    return [
        (place, moving.index(joint.name))
        for place, joint in enumerate(leg.joints)
        if joint.kind == "prismatic"
    ]


def _barrel(strokes: Array) -> float:
    """Return the length of a cylinder that suits strokes, shape (N,), [m]; 0 where none does."""
    shortest = float(np.nanmin(np.abs(strokes), initial=np.inf))
    longest = float(np.nanmax(np.abs(strokes), initial=0.0))
    return 0.0 if longest > 3.0 * shortest else BARREL * shortest


def _rod(axis: tuple[float, float, float], strokes: Array, inside: float) -> tuple[Array, Array]:
    """Return ``T_slider_rod`` and ``T_slider_cylinder``, from z = 0 to 1, shape (N, 4, 4) each.

    Together they reach back from the slider to where it is at zero.

    Args:
        axis: Of the joint.
        strokes: Shape (N,), [m].
        inside: Length of the cylinder, [m].
    """
    _, _, (_, across, normal) = np.linalg.svd([axis])
    frames = np.zeros((2, len(strokes), 4, 4))
    frames[:] = np.eye(4)
    frames[..., :3, 0], frames[..., :3, 1] = across, normal
    moved = np.where(np.abs(strokes) > 1e-9, strokes, np.nan)
    parts = (moved - inside * np.sign(moved), inside * np.sign(moved))
    frames[..., :3, 2] = -np.multiply.outer(np.array(parts), np.array(axis))
    frames[1, :, :3, 3] = frames[0, :, :3, 2]
    return frames[0], frames[1]


def urdf_shapes(text: str) -> list[tuple[Shape, ...]]:
    """Return the visuals of a URDF that pincal wrote, link by link in the URDF's order."""
    robot: Any = etree.fromstring(text.encode())
    return [tuple(map(_shape, link.iter("visual"))) for link in robot.iter("link")]


def _shape(visual: Any) -> Shape:
    """Return a visual element: a box, a cylinder or a sphere."""
    (geometry,) = visual.find("geometry")
    keys = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}
    size = [value for key in keys[geometry.tag] for value in _numbers(geometry.get(key))]
    origin = np.eye(4)
    if (placed := visual.find("origin")) is not None:
        origin[:3, :3] = Rotation.from_euler("xyz", _numbers(placed.get("rpy"))).as_matrix()
        origin[:3, 3] = _numbers(placed.get("xyz"))
    rgb = _numbers(visual.find("material/color").get("rgba"))[:3]
    colour = "#" + "".join(f"{round(255 * part):02x}" for part in rgb)
    return Shape(geometry.tag, tuple(size), origin, colour)


def _numbers(text: str) -> list[float]:
    return [float(word) for word in text.split()]


METAL, JOINT = "#aab1ba", "#595959"
#: Triangles of a link, at most about; cells along it into which corners are gathered.
MOST_FACES, _CELLS = 3000, (60, 45, 32, 22, 15)


def with_meshes(body: Body, mechanism: Mechanism, urdf: str | Path) -> Body:
    """Return a body whose links look as a URDF's visuals do, where it has them as meshes.

    Args:
        body: Of the mechanism.
        mechanism: Its legs' joints have the URDF's names.
        urdf: The file; ``package://`` is looked for in the folders above it.

    Raises:
        FileError: the URDF or a mesh is missing or cannot be read, or moves no link of the
            mechanism.
        MechanismError: not a well-formed URDF.
    """
    links = _links(Path(urdf))
    parts, count = list(body.parts), 0
    for number, (leg, chain) in enumerate(zip(mechanism.legs, body.chains, strict=True), 1):
        for place, joint in zip(chain, leg.joints, strict=True):
            if mesh_shapes := links.get(joint.name):
                parts[place] = replace(parts[place], shapes=mesh_shapes)
                count += 1
        first = leg.joints[0].name
        if mesh_shapes := links.get(f"before {first}"):
            place = body.part(f"leg {number}/base")
            parts[place] = replace(parts[place], shapes=mesh_shapes)
    if not count:
        raise FileError(
            f"{urdf}: no joint of {mechanism.name!r} moves a link with a mesh; expected the URDF "
            "that the mechanism was read from"
        )
    hidden = [body.part("platform/body")]
    for place in hidden:  # the last link is the platform
        parts[place] = replace(parts[place], shapes=parts[place].shapes[:1])
    return replace(body, parts=tuple(parts))


def _links(path: Path) -> dict[str, tuple[Shape, ...]]:
    """Return the meshes of links by the joint before them; ``before …`` of a joint's parent."""
    read_xml(path, "robot")  # yourdfpy repairs what is broken
    import yourdfpy  # slow to import, and needed here only

    robot = yourdfpy.URDF.load(path, load_meshes=False, build_scene_graph=False).robot
    shapes = {
        link.name: tuple(
            _mesh(path, visual) for visual in link.visuals if visual.geometry.mesh is not None
        )
        for link in robot.links
    }
    links = {joint.name: shapes.get(joint.child, ()) for joint in robot.joints}
    return links | {f"before {joint.name}": shapes.get(joint.parent, ()) for joint in robot.joints}


def _mesh(path: Path, visual: Any) -> Shape:
    """Return a visual as triangles, in its link's frame."""
    import trimesh  # as yourdfpy needs it

    source = visual.geometry.mesh
    file = _mesh_path(path, source.filename)
    try:
        mesh: Any = trimesh.load(file, force="mesh", process=False)
    except Exception as error:  # whatever readers of meshes raise
        raise FileError(f"{file}: a mesh that cannot be read: {error}") from error
    check_mesh(file, np.asarray(getattr(mesh, "vertices", ())), len(getattr(mesh, "faces", ())))
    mesh.process()  # corners that several triangles share become one
    scale = np.ones(3) if source.scale is None else np.broadcast_to(source.scale, 3)
    corners, faces = coarser(np.asarray(mesh.vertices) * scale, np.asarray(mesh.faces))
    T = np.eye(4) if visual.origin is None else np.asarray(visual.origin, dtype=np.float64)
    return Shape("mesh", (), T, METAL, corners, faces)


def _mesh_path(path: Path, name: str) -> Path:
    """Return the file of a mesh: beside the URDF, or in a package in a folder above it."""
    bare = name.removeprefix("file://")
    if "://" not in bare:
        candidates = [path.parent / bare]
    else:
        packaged = Path(bare.partition("://")[2])
        short = Path(*packaged.parts[1:])
        candidates = [
            folder / relative for folder in path.resolve().parents for relative in (packaged, short)
        ]
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    raise FileError(f"{path}: its mesh {name} is not found beside it, nor in a folder above it")


def coarser(corners: Array, faces: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    """Return a mesh of fewer triangles: corners in one cell of a grid become their mean.

    Args:
        corners: Shape (n, 3), [m].
        faces: Corners of triangles, shape (m, 3).
    """
    size = float(np.ptp(corners, axis=0).max()) if len(corners) else 0.0
    for cells in _CELLS:
        if len(faces) <= MOST_FACES or not size:
            break
        cell = np.floor((corners - corners.min(axis=0)) / size * cells).astype(np.int64)
        _, group = np.unique(cell, axis=0, return_inverse=True)
        group = group.ravel()
        means = np.zeros((group.max() + 1, 3))
        np.add.at(means, group, corners)
        means /= np.bincount(group)[:, None]
        moved = group[faces]
        proper = (np.diff(np.sort(moved, axis=1), axis=1) > 0).all(axis=1)
        faces_left = moved[proper]
        _, first = np.unique(np.sort(faces_left, axis=1), axis=0, return_index=True)
        if len(first) <= MOST_FACES or cells == _CELLS[-1]:
            return means, faces_left[np.sort(first)]
    return corners, faces
