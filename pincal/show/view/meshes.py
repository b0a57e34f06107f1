"""Meshes of one's own URDF (STL, DAE, OBJ) in place of the simple shapes of an arm's links.

A link of the URDF hangs behind the joint of its parent, by the joint's name; the leg's links are
the same frames. What has too many triangles is made coarser, so that pages stay small.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pincal.errors import FileError
from pincal.files.xml import read_xml
from pincal.model.mechanism import Mechanism
from pincal.show.view.bodies import Body
from pincal.show.view.solids import Shape

Array = NDArray[np.float64]
METAL, JOINT = "#aab1ba", "#595959"
#: Triangles of a link, at most about; cells along it into which corners are gathered.
MOST, _CELLS = 3000, (60, 45, 32, 22, 15)


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
    parts, found = list(body.parts), 0
    for number, (leg, chain) in enumerate(zip(mechanism.legs, body.chains, strict=True), 1):
        for place, joint in zip(chain, leg.joints, strict=True):
            if own := links.get(joint.name):
                parts[place] = replace(parts[place], shapes=own)
                found += 1
        first = leg.joints[0].name
        if own := links.get(f"before {first}"):
            place = body.part(f"leg {number}/base")
            parts[place] = replace(parts[place], shapes=own)
    if not found:
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
    found = {joint.name: shapes.get(joint.child, ()) for joint in robot.joints}
    return found | {f"before {joint.name}": shapes.get(joint.parent, ()) for joint in robot.joints}


def _mesh(path: Path, visual: Any) -> Shape:
    """Return a visual as triangles, in its link's frame."""
    import trimesh  # as yourdfpy needs it

    own = visual.geometry.mesh
    file = _found(path, own.filename)
    try:
        mesh: Any = trimesh.load(file, force="mesh")
    except Exception as error:  # whatever readers of meshes raise
        raise FileError(f"{file}: a mesh that cannot be read: {error}") from error
    scale = np.ones(3) if own.scale is None else np.broadcast_to(own.scale, 3)
    corners, faces = coarser(np.asarray(mesh.vertices) * scale, np.asarray(mesh.faces))
    T = np.eye(4) if visual.origin is None else np.asarray(visual.origin, dtype=np.float64)
    return Shape("mesh", (), T, METAL, corners, faces)


def _found(path: Path, name: str) -> Path:
    """Return the file of a mesh: beside the URDF, or in a package in a folder above it."""
    bare = name.removeprefix("file://")
    if "://" not in bare:
        there = [path.parent / bare]
    else:
        rest = Path(bare.partition("://")[2])
        short = Path(*rest.parts[1:])
        there = [folder / one for folder in path.resolve().parents for one in (rest, short)]
    for one in there:
        if one.is_file():
            return one
    raise FileError(f"{path}: its mesh {name} is not found beside it, nor in a folder above it")


def coarser(corners: Array, faces: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    """Return a mesh of fewer triangles: corners in one cell of a grid become their mean.

    Args:
        corners: Shape (n, 3), [m].
        faces: Corners of triangles, shape (m, 3).
    """
    size = float(np.ptp(corners, axis=0).max()) if len(corners) else 0.0
    for cells in _CELLS:
        if len(faces) <= MOST or not size:
            break
        cell = np.floor((corners - corners.min(axis=0)) / size * cells).astype(np.int64)
        _, group = np.unique(cell, axis=0, return_inverse=True)
        group = group.ravel()
        means = np.zeros((group.max() + 1, 3))
        np.add.at(means, group, corners)
        means /= np.bincount(group)[:, None]
        moved = group[faces]
        whole = (np.diff(np.sort(moved, axis=1), axis=1) > 0).all(axis=1)
        kept = moved[whole]
        _, first = np.unique(np.sort(kept, axis=1), axis=0, return_index=True)
        if len(first) <= MOST or cells == _CELLS[-1]:
            return means, kept[np.sort(first)]
    return corners, faces
