"""A scene as meshcat's drawing commands.

meshcat's own ``Visualizer`` draws; where it has its window, a recorder keeps what would be sent
to a server, so that no process is started and the commands can be put into a page.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from pincal.show.style import (
    CARRIED,
    DIMENSION,
    DOMAIN,
    GROUND,
    IDENTIFIED,
    NOMINAL,
    OUTLIER,
    shades,
)
from pincal.show.view.bodies import Body
from pincal.show.view.found import Found
from pincal.show.view.marks import arrows, frustum, stand
from pincal.show.view.scene import Scene, frame_axes, ground
from pincal.show.view.solids import Shape

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)  # of pyzmq, when meshcat asks for it
    import meshcat
    import meshcat.geometry as g
import umsgpack

Array = NDArray[np.float64]
_I = np.eye(4)
_WHITE = 0xFFFFFF
_DEPTH = 0.3  # of what a camera sees, of the scene's size
#: Turns three.js' cylinders, which lie along y, to lie along z.
_UPRIGHT = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


class _Recorder:
    """Takes the place of meshcat's window; keeps commands, packed as for its viewer."""

    def __init__(self) -> None:
        self.commands: list[bytes] = []

    def send(self, command: Any) -> None:
        self.commands.append(umsgpack.packb(command.lower()))


class _Dots(g.PointsMaterial):  # type: ignore[misc]
    """Points of a size in pixels, near and far, of one colour or, if that is white, their own."""

    def lower(self, object_data: Any) -> dict[str, Any]:
        lowered = super().lower(object_data)
        return {**lowered, "sizeAttenuation": False, "vertexColors": self.color == _WHITE}


def commands(scene: Scene) -> list[bytes]:
    """Return what draws a scene in meshcat's viewer, at no pose yet.

    Paths below ``/meshcat``: ``mechanism`` and ``identified`` with their parts (``bodies.Part``);
    ``sets/1`` and ``ghosts/1`` for the first set and so on; ``cloud``, ``base axes``, ``grid``;
    of a calibration ``misses``, ``outlying``, ``errors/before``, ``errors/after``, ``weakest`` with
    its parts, ``instrument``, ``stations/1`` and so on.
    """
    recorder = _Recorder()
    draw = meshcat.Visualizer(window=recorder)
    for path in ("/Grid", "/Axes"):
        draw[path].set_property("visible", False)
    _lines(draw["grid"], ground(scene), GROUND)
    axes = frame_axes(scene)
    _axes(draw["base axes"], axes)
    _body(draw["mechanism"], scene.body)
    _axes(draw["mechanism/platform/body/axes"], axes)
    if scene.identified:
        _body(draw["identified"], scene.identified.body, IDENTIFIED, opacity=0.45)
    if scene.cloud:
        _dots(draw["cloud/domain"], scene.cloud.positions[scene.cloud.domain], DOMAIN, 2)
        _dots(draw["cloud/carried"], scene.cloud.positions[~scene.cloud.domain], CARRIED, 2)
    for number, (_, colour, positions, lines) in enumerate(scene.by_set(), 1):
        _dots(draw[f"sets/{number}"], positions, colour, 7)
        _lines(draw[f"ghosts/{number}"], lines, colour, opacity=0.45)
    if scene.found:
        _found(draw, scene.found, scene)
    return recorder.commands


def _found(draw: Any, found: Found, scene: Scene) -> None:
    """Draw what a calibration found."""
    size = float(np.linalg.norm(np.ptp(scene.bounds(), axis=0)))
    if found.misses:
        both = (
            ("misses", ~found.misses.outlying, IDENTIFIED),
            ("outlying", found.misses.outlying, OUTLIER),
        )
        for path, own, colour in both:
            if own.any():
                corners = arrows(found.misses, own, size)
                draw[path].set_object(_facets(corners), _matt(colour))
                lift = 0.1 * size if scene.planar else 0.0  # seen from above, over the platform
                draw[path].set_transform(np.array([*_I[:2], [0.0, 0.0, 1.0, lift], _I[3]]))
    if found.errors:
        for name in ("before", "after"):
            colours = shades(found.errors.shares(getattr(found.errors, name)))
            _dots(draw[f"errors/{name}"], found.errors.positions, colours, 4)
    if found.weakest:
        _body(draw["weakest"], found.weakest.body, NOMINAL, opacity=0.6)
    if found.instrument:
        place = np.eye(4)
        place[:3, 3] = found.instrument.at
        for number, shape in enumerate(stand(size, scene.planar), 1):
            node = draw[f"instrument/shape {number}"]
            node.set_object(_geometry(shape), _matt(shape.colour))
            turned = shape.T_link_shape @ (_UPRIGHT if shape.kind == "cylinder" else _I)
            node.set_transform(place @ turned)
        _axes(draw["instrument/frame"], frame_axes(scene))
        draw["instrument/frame"].set_transform(found.instrument.T_base_frame)
    for number, station in enumerate(found.stations, 1):
        node = draw[f"stations/{number}"]
        node.set_transform(station.T_base_station)
        _axes(node["frame"], frame_axes(scene))
        if station.sees:
            _lines(node["sees"], frustum(station.sees, _DEPTH * size), DIMENSION)


def viewer_script() -> str:
    """Return meshcat's viewer, three.js and all."""
    return (Path(meshcat.viewer_assets_path()) / "dist" / "main.min.js").read_text("utf-8")


def _body(draw: Any, body: Body, colour: str = "", opacity: float = 1.0) -> None:
    """Draw the shapes of a body's parts, in their own colours or in one."""
    for part in body.parts:
        for number, shape in enumerate(part.shapes, 1):
            material = _matt(colour or shape.colour, opacity)
            if opacity < 1.0:
                material.side = 0  # its backs are not seen through it, which are drawn apart
            node = draw[f"{part.path}/shape {number}"]
            node.set_object(_geometry(shape), material)
            node.set_transform(shape.T_link_shape @ (_UPRIGHT if shape.kind == "cylinder" else _I))


def _geometry(shape: Shape) -> Any:
    if shape.points is not None and shape.faces is not None:
        return _facets(shape.points[shape.faces])
    if shape.points is not None:
        return _hull(shape.points)
    if shape.kind == "box":
        return g.Box(shape.size)
    if shape.kind == "cylinder":
        radius, length = shape.size
        return g.Cylinder(length, radius)
    return g.Sphere(*shape.size)


def _hull(points: Array) -> Any:
    """Return the hull of points, each triangle with corners of its own: edges are sharp."""
    hull = ConvexHull(points)
    corners = points[hull.simplices]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum("ij,ij->i", normals, hull.equations[:, :3]) < 0.0
    corners[inward] = corners[inward][:, ::-1]
    return _facets(corners)


def _facets(corners: Array) -> Any:
    """Return triangles (n, 3, 3) with corners of their own."""
    flat = corners.reshape(-1, 3)
    return g.TriangularMeshGeometry(flat, np.arange(len(flat)).reshape(-1, 3))


def _axes(draw: Any, shapes: tuple[Shape, ...]) -> None:
    """Draw the axes of a frame."""
    for name, shape in zip("xyz", shapes, strict=True):
        draw[name].set_object(_geometry(shape), _matt(shape.colour))
        draw[name].set_transform(shape.T_link_shape @ _UPRIGHT)


def _dots(draw: Any, positions: Array, colours: str | Array, pixels: float) -> None:
    """Draw positions (N, 3) in one colour or in one for each, (N, 3)."""
    colour = int(colours[1:], 16) if isinstance(colours, str) else _WHITE
    geometry = g.PointsGeometry(positions.T, None if isinstance(colours, str) else colours.T)
    draw.set_object(g.Points(geometry, _Dots(size=pixels, color=colour)))


def _lines(draw: Any, segments: Array, colour: str, opacity: float = 1.0) -> None:
    """Draw segments (n, 2, 3)."""
    material = g.LineBasicMaterial(int(colour[1:], 16), opacity=opacity)
    draw.set_object(g.LineSegments(g.PointsGeometry(segments.reshape(-1, 3).T), material))


def _matt(colour: str, opacity: float = 1.0) -> Any:
    return g.MeshLambertMaterial(int(colour[1:], 16), opacity=opacity)
