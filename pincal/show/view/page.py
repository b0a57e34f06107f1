"""A scene as one HTML page that needs nothing else: meshcat's viewer, the scene, a panel.

meshcat's own ``Visualizer`` draws; where it has its window, a recorder keeps what would be sent
to a server, so that no process is started and the commands can be put into a page. All text that
comes from people's files goes through JSON and becomes text nodes. The page's security policy
bars requests to any host but the one that served it.
"""

from __future__ import annotations

import base64
import json
import warnings
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull

from pincal.errors import MechanismError
from pincal.show.style import (
    CARRIED,
    DARK,
    DIMENSION,
    DOMAIN,
    ERRORS,
    GROUND,
    IDENTIFIED,
    NOMINAL,
    OUTLIER,
    PAPER,
    shades,
)
from pincal.show.view.bodies import GREY, Body, Shape
from pincal.show.view.scene import (
    Overlay,
    Scene,
    arrows,
    axes_of_view,
    cut,
    frame_axes,
    frustum,
    grid_step,
    ground,
    moved,
    set_colour,
    stand,
    tips,
)
from pincal.types import Array
from pincal.words.numbers import POSES, SMALL, per_si
from pincal.words.wording import clean, rendered

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)  # of pyzmq, when meshcat asks for it
    import meshcat
    import meshcat.geometry as g
import umsgpack

#: How far sliders go: of the scene's size, and [rad].
_SLIDER_RANGE = {"m": 0.25, "rad": 0.5}
#: The workspace in colours of errors.
BY_ERROR = {
    "before": "workspace by error, nominal (before)",
    "after": "workspace by error, identified, as expected",
}
#: Links and shadows on dark ground.
SOLIDS_DARK = {GREY: "#8b929b", "#d9dce0": "#0b0d10"}


def page(
    scene: Scene, source: str = "", notices: Sequence[str] = (), *, served: bool = False
) -> str:
    """Return the page of a scene.

    Args:
        scene: What to show.
        source: Where it comes from.
        notices: What to know first.
        served: Whether the page can ask for the scene off its poses (``answer``).
    """
    data = _data(scene, source) | {"notices": list(notices)}
    text = json.dumps(data, ensure_ascii=False, separators=(",", ":"))
    return rendered(
        "view.html",
        title=scene.mechanism.name,
        meshcat=viewer_script(),
        data=clean(text).replace("<", "\\u003c"),
        served=served,
    )


def answer(scene: Scene, row: int, shift: Array) -> str:
    """Return what a page draws and writes off its poses, as JSON: see ``moved``."""
    try:
        moved_scene = moved(scene, row, shift)
    except MechanismError as error:
        return json.dumps({"problem": str(error)})
    values = {(row["head"], row["name"]): row["values"][0] for row in _rows(moved_scene)}
    bodies = [moved_scene.body] + ([moved_scene.identified.body] if moved_scene.identified else [])
    return json.dumps(
        {
            "problem": "",
            "matrices": [_columns(drawn) for drawn in bodies],
            "problems": [drawn.problems[0] for drawn in bodies],
            "values": [values.get((row["head"], row["name"])) for row in _rows(scene)],
        }
    )


def _data(scene: Scene, source: str) -> dict[str, Any]:
    """Return all that the page's script needs, for JSON."""
    names = list(dict.fromkeys(scene.sets))
    bodies = {"mechanism": scene.body}
    if scene.identified:
        bodies["identified"] = scene.identified.body
    if scene.overlay and scene.overlay.weakest:
        bodies["weakest"] = scene.overlay.weakest.body
    V, bounds = axes_of_view(scene.planar), _bounds(scene)
    corners = np.array(list(product(*bounds.T)))
    return {
        "name": scene.mechanism.name,
        "description": scene.mechanism.description,
        "source": source,
        "planar": scene.planar,
        "towards": V[2].tolist(),
        "bounds": bounds.tolist(),
        "half": (np.ptp(corners @ V[:2].T, axis=0) / 2).tolist(),
        "grid": f"grid {1e3 * grid_step(scene):.6g} mm",
        "commands": [base64.b64encode(command).decode() for command in commands(scene)],
        "bodies": [_body(root, body) for root, body in bodies.items()],
        "sets": [{"name": name, "colour": set_colour(scene, name)} for name in names],
        "set": [names.index(name) for name in scene.sets],
        "rows": _rows(scene),
        "legs": [
            {
                "name": leg.name,
                "colour": set_colour(scene, leg.name),
                "foot": list(leg.joints[0].placement.xyz),
            }
            for leg in scene.mechanism.legs
        ],
        "layers": _layers(scene),
        "errors": _errors(scene),
        "sliders": _sliders(scene),
        "level": scene.level,
        "axis": frame_axes(scene)[0].size[1],
        "dark": DARK | SOLIDS_DARK,
        "paper": PAPER,
    }


def _bounds(scene: Scene) -> Array:
    """Return least and largest coordinates of what is looked at first, shape (2, 3), [m].

    The scene, the arrows of misses, and what stands no further from it than it is large.
    """
    bounds = scene.bounds()
    if not scene.overlay:
        return bounds
    size = float(np.linalg.norm(np.ptp(bounds, axis=0)))
    points = [bounds]
    if scene.overlay.misses:
        points.append(tips(scene.overlay.misses, size))
    stands = [station.T_base_station[:3, 3] for station in scene.overlay.stations]
    if scene.overlay.instrument:
        stands.append(scene.overlay.instrument.position)
    near = [p for p in stands if np.linalg.norm(p - np.clip(p, *bounds)) < size]
    every = np.concatenate([*points, np.reshape(near, (-1, 3))])
    return np.stack((every.min(axis=0), every.max(axis=0)))


def _body(root: str, body: Body) -> dict[str, Any]:
    """Return a body's paths, and its placements as columns of 3, N x n_parts x 4 x 3 doubles."""
    return {
        "name": root,
        "paths": [f"meshcat/{root}/{part.path}" for part in body.parts],
        "matrices": _columns(body),
        "problems": list(body.problems),
    }


def _columns(body: Body) -> str:
    """Return where parts are as columns of 3, N x n_parts x 4 x 3 doubles, in base 64."""
    columns = np.ascontiguousarray(body.placements[:, :, :3].swapaxes(2, 3), dtype="<f8")
    return base64.b64encode(columns.tobytes()).decode()


def _sliders(scene: Scene) -> list[dict[str, Any]]:
    """Return what moves the mechanism off its poses: coordinates, or readings of an arm.

    ``axis`` is the base's that a coordinate shifts along, -1 of all else.
    """
    mechanism, platform = scene.mechanism, scene.mechanism.platform
    size = float(np.linalg.norm(np.ptp(scene.bounds(), axis=0)))
    if mechanism.by_readings:
        moves = [
            (name, unit, -1)
            for name, unit in zip(mechanism.reading_names, mechanism.reading_units, strict=True)
        ]
    else:
        rows = [row if row < 3 else -1 for row in platform.twist_rows]
        moves = list(zip(platform.freedoms, platform.units, rows, strict=True))
    return [
        {
            "name": name,
            "unit": POSES[unit],
            "scale": per_si(unit, POSES),
            "most": _SLIDER_RANGE[unit] * (size if unit == "m" else 1.0),
            "axis": axis,
        }
        for name, unit, axis in moves
    ]


def _rows(scene: Scene) -> list[dict[str, Any]]:
    """Return the table under the slider: what each row is, and its value at each pose."""
    mechanism, platform = scene.mechanism, scene.mechanism.platform
    read = mechanism.reading_names, mechanism.reading_units
    groups = [("pose", platform.coordinates, platform.units, POSES, scene.plan.poses)]
    nominal = "readings, as given" if mechanism.by_readings else "readings of the nominal model"
    groups.append((nominal, *read, POSES, scene.readings))
    if scene.plan.readings is not None and not mechanism.by_readings:
        groups.append(("readings, as measured", *read, POSES, scene.plan.readings))
    if scene.identified:
        errors = scene.identified.errors
        groups.append(("identified goes off by", platform.freedoms, platform.units, SMALL, errors))
    return [
        {
            "head": head,
            "name": name,
            "unit": shown[unit],
            "digits": 3 if shown is SMALL else 2,
            "values": [float(v) if np.isfinite(v) else None for v in values],
        }
        for head, names, units, shown, every in groups
        for name, unit, values in zip(
            names, units, (every * [per_si(u, shown) for u in units]).round(4).T, strict=True
        )
    ]


def _layers(scene: Scene) -> list[dict[str, Any]]:
    """Return what can be shown or hidden: paths, names, and what to say about them."""
    layers: list[tuple[str, str, bool]] = [("mechanism", "mechanism", True)]
    if scene.identified:
        text = f"identified, errors × {scene.identified.magnify:g}"
        layers.append(("identified", text, True))
    layers += [("sets", "poses, as dots", True), ("ghosts", "poses, as ghosts", False)]
    if cloud := scene.cloud:
        group = "" if cloud.domain.all() else cloud.group
        layers.append(("cloud", _cloud_name(len(cloud.positions), cloud.total, group), True))
    if scene.overlay:
        layers += _overlay_layers(scene, scene.overlay)
    layers += [("base axes", "base frame", True), ("grid", "grid", True)]
    colours = {"identified": IDENTIFIED, "cloud": DOMAIN}
    colours |= {"misses": IDENTIFIED, "outlying": OUTLIER, "weakest": NOMINAL}
    return [
        {"path": f"meshcat/{path}", "name": name, "shown": shown, "colour": colours.get(path, "")}
        for path, name, shown in layers
    ]


def _cloud_name(drawn: int, total: int, group: str) -> str:
    """Return what a cloud of positions is.

    Args:
        drawn: How many positions are drawn.
        total: Of how many.
        group: Whose fundamental domain has the stronger colour; empty where there is none.
    """
    count = f"{drawn:,}" + (f" of {total:,}" if total > drawn else "")
    share = f"; strong colour: fundamental domain of {group}" if group else ""
    return f"workspace, {count} positions{share}"


def _overlay_layers(scene: Scene, overlay: Overlay) -> list[tuple[str, str, bool]]:
    """Return the layers of what a calibration found."""
    layers = []
    if misses := overlay.misses:
        size = float(np.linalg.norm(np.ptp(scene.bounds(), axis=0)))
        short = cut(misses, size)
        for path, name, visible in (
            ("misses", "measured → predicted", ~misses.outlying),
            ("outlying", "outliers", misses.outlying),
        ):
            if visible.any():
                shortened = int((visible & short).sum())
                text = f"{name}, errors × {misses.magnify:,.12g}"
                text += f", {shortened} longer than drawn" if shortened else ""
                layers.append((path, text, True))
    if overlay.errors:
        layers += [(f"errors/{when}", entry, False) for when, entry in BY_ERROR.items()]
    if weakest := overlay.weakest:
        text = f"weakest direction, ±{weakest.magnify:.3g} of its standard errors: {weakest.named}"
        layers.append(("weakest", text, False))
    stands = [("instrument", "tracker", overlay.instrument.position)] if overlay.instrument else []
    stands += [
        (f"stations/{number}", station.name, station.T_base_station[:3, 3])
        for number, station in enumerate(overlay.stations, 1)
    ]
    layers += [
        (p, f"{name}, {np.linalg.norm(position):.3g} m from the base frame", True)
        for p, name, position in stands
    ]
    return layers


def _errors(scene: Scene) -> dict[str, Any] | None:
    """Return the scale of errors over the workspace, None if there are none."""
    if not (scene.overlay and scene.overlay.errors):
        return None
    scale, unit = per_si("m", SMALL), SMALL["m"]
    ends = [f"{scale * limit:.2g} {unit}" for limit in scene.overlay.errors.limits]
    return {"colours": list(ERRORS), "ends": ends}


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
    _draw_body(draw["mechanism"], scene.body)
    _axes(draw["mechanism/platform/body/axes"], axes)
    if scene.identified:
        _draw_body(draw["identified"], scene.identified.body, IDENTIFIED, opacity=0.45)
    if scene.cloud:
        _dots(draw["cloud/domain"], scene.cloud.positions[scene.cloud.domain], DOMAIN, 2)
        _dots(draw["cloud/carried"], scene.cloud.positions[~scene.cloud.domain], CARRIED, 2)
    for number, (_, colour, positions, lines) in enumerate(scene.by_set(), 1):
        _dots(draw[f"sets/{number}"], positions, colour, 7)
        _lines(draw[f"ghosts/{number}"], lines, colour, opacity=0.45)
    if scene.overlay:
        _draw_overlay(draw, scene.overlay, scene)
    return recorder.commands


def _draw_overlay(draw: Any, overlay: Overlay, scene: Scene) -> None:
    """Draw what a calibration found."""
    size = float(np.linalg.norm(np.ptp(scene.bounds(), axis=0)))
    if overlay.misses:
        layers = (
            ("misses", ~overlay.misses.outlying, IDENTIFIED),
            ("outlying", overlay.misses.outlying, OUTLIER),
        )
        for path, shown, colour in layers:
            if shown.any():
                corners = arrows(overlay.misses, shown, size)
                draw[path].set_object(_facets(corners), _matt(colour))
                lift = 0.1 * size if scene.planar else 0.0  # seen from above, over the platform
                draw[path].set_transform(np.array([*_I[:2], [0.0, 0.0, 1.0, lift], _I[3]]))
    if overlay.errors:
        for name in ("before", "after"):
            colours = shades(overlay.errors.shares(getattr(overlay.errors, name)))
            _dots(draw[f"errors/{name}"], overlay.errors.positions, colours, 4)
    if overlay.weakest:
        _draw_body(draw["weakest"], overlay.weakest.body, NOMINAL, opacity=0.6)
    if overlay.instrument:
        place = np.eye(4)
        place[:3, 3] = overlay.instrument.position
        for number, shape in enumerate(stand(size, scene.planar), 1):
            node = draw[f"instrument/shape {number}"]
            node.set_object(_geometry(shape), _matt(shape.colour))
            turned = shape.T_link_shape @ (_UPRIGHT if shape.kind == "cylinder" else _I)
            node.set_transform(place @ turned)
        _axes(draw["instrument/frame"], frame_axes(scene))
        draw["instrument/frame"].set_transform(overlay.instrument.T_base_frame)
    for number, station in enumerate(overlay.stations, 1):
        node = draw[f"stations/{number}"]
        node.set_transform(station.T_base_station)
        _axes(node["frame"], frame_axes(scene))
        if station.sees:
            _lines(node["sees"], frustum(station.sees, _DEPTH * size), DIMENSION)


def viewer_script() -> str:
    """Return meshcat's viewer, three.js and all."""
    return (Path(meshcat.viewer_assets_path()) / "dist" / "main.min.js").read_text("utf-8")


def _draw_body(draw: Any, body: Body, colour: str = "", opacity: float = 1.0) -> None:
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
