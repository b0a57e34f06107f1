"""Links of a mechanism as the meshes (STL, DAE, OBJ) of the URDF that it was read from."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
import yourdfpy
from yourdfpy.urdf import filename_handler_magic

from pincal.errors import FileError
from pincal.files.text import read_xml
from pincal.kinematics.collision import check_mesh
from pincal.model import Mechanism
from pincal.show.view.bodies import Body, Shape

METAL = "#aab1ba"
#: Most triangles of a link, roughly; numbers of cells along it in which vertices are merged.
MOST_FACES, _CELLS = 3000, (60, 45, 32, 22, 15)


def with_meshes(body: Body, mechanism: Mechanism, urdf: str | Path) -> Body:
    """Return a body whose links have the meshes of a URDF's visuals, if there are any.

    Links are found by the names of joints; ``package://`` is sought in folders above the file.

    Raises:
        FileError: the URDF or a mesh is missing or cannot be read, or no mesh is on a moving link
            of the mechanism.
        MechanismError: the URDF is not well formed.
    """
    path = Path(urdf)
    read_xml(path, "robot")  # yourdfpy repairs what is broken
    robot = yourdfpy.URDF.load(path, load_meshes=False, build_scene_graph=False).robot
    shapes = {
        link.name: tuple(_mesh(path, v) for v in link.visuals if v.geometry.mesh is not None)
        for link in robot.links
    }
    joints, paths = {joint.name: joint for joint in robot.joints}, list(body.parts)
    parts, has_mesh = dict(body.parts), False
    for number, (leg, chain) in enumerate(zip(mechanism.legs, body.chains, strict=True), 1):
        pairs = zip(chain, leg.joints, strict=True)
        links = [(paths[place], joint.name, "child") for place, joint in pairs]
        for part, name, end in [(f"leg {number}/base", leg.joints[0].name, "parent"), *links]:
            meshes = shapes.get(getattr(joints.get(name), end, ""), ())
            parts[part] = meshes or parts[part]
            has_mesh = has_mesh or bool(meshes and end == "child")
    if not has_mesh:
        raise FileError(
            f"{urdf}: no joint of {mechanism.name!r} moves a link with a mesh; expected the URDF "
            "that the mechanism was read from"
        )
    hub, *_, x, y, z = parts["platform/body"]
    parts["platform/body"] = (hub, x, y, z)  # the last link is the platform
    return replace(body, parts=parts)


def _mesh(path: Path, visual: Any) -> Shape:
    """Return the mesh of a visual, in its link's frame."""
    source = visual.geometry.mesh
    file = filename_handler_magic(source.filename, str(path.resolve()))  # packages above it, too
    if not Path(file).is_file():
        raise FileError(
            f"{path}: its mesh {source.filename} is not found beside it, nor in a folder above it"
        )
    try:
        mesh: Any = trimesh.load(file, force="mesh", process=False)
    except Exception as error:  # readers of meshes raise errors of any type
        raise FileError(f"{file}: a mesh that cannot be read: {error}") from error
    check_mesh(file, np.asarray(getattr(mesh, "vertices", ())), len(getattr(mesh, "faces", ())))
    mesh.process()  # merges vertices that triangles share
    mesh.apply_scale(np.ones(3) if source.scale is None else np.broadcast_to(source.scale, 3))
    coarsen(mesh)
    T = np.eye(4) if visual.origin is None else np.asarray(visual.origin, dtype=np.float64)
    return Shape("mesh", (), T, METAL, np.asarray(mesh.vertices), np.asarray(mesh.faces))


def coarsen(mesh: Any) -> None:
    """Merge vertices in each cell of coarser and coarser grids until few triangles are left."""
    for cells in _CELLS:
        if len(mesh.faces) <= MOST_FACES:
            break
        cell = mesh.extents.max() / cells
        mesh.apply_scale(1.0 / cell)
        mesh.merge_vertices(digits_vertex=0)
        mesh.update_faces(mesh.nondegenerate_faces() & mesh.unique_faces())
        mesh.apply_scale(cell)
