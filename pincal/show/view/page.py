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

from pincal.design.simulate import platform_errors
from pincal.errors import MechanismError
from pincal.show.style import DARK, IDENTIFIED, PAPER
from pincal.show.view.bodies import GREY, Body, Shape
from pincal.show.view.scene import Layer, Scene, moved
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
#: Links and shadows on dark ground.
SOLIDS_DARK = {GREY: "#8b929b", "#d9dce0": "#0b0d10"}
#: Turns three.js' cylinders, which lie along y, to lie along z.
_UPRIGHT = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


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
    names = list(dict.fromkeys(scene.sets))
    bounds, ground = _bounds(scene), scene.ground()
    corners = np.array(list(product(*bounds.T)))
    data = {
        "source": source,
        "notices": list(notices),
        "name": scene.mechanism.name,
        "description": scene.mechanism.description,
        "planar": scene.planar,
        "towards": scene.axes[2].tolist(),
        "bounds": bounds.tolist(),
        "half": (np.ptp(corners @ scene.axes[:2].T, axis=0) / 2).tolist(),
        "grid": ground.name,
        "commands": [base64.b64encode(command).decode() for command in _commands(scene)],
        "bodies": [
            {
                "name": root,
                "paths": [f"meshcat/{root}/{path}" for path in body.parts],
                "matrices": _columns(body),
                "problems": list(body.problems),
            }
            for root, body in _bodies(scene).items()
        ],
        "sets": [{"name": name, "colour": scene.colour(name)} for name in names],
        "set": [names.index(name) for name in scene.sets],
        "rows": _rows(scene),
        "legs": [
            {
                "name": leg.name,
                "colour": scene.colour(leg.name),
                "foot": list(leg.joints[0].placement.xyz),
            }
            for leg in scene.mechanism.legs
        ],
        "layers": _panel(scene),
        "sliders": _sliders(scene),
        "level": scene.level,
        "axis": scene.body.axis,
        "dark": DARK | SOLIDS_DARK,
        "paper": PAPER,
    }
    text = json.dumps(data, ensure_ascii=False, separators=(",", ":"))
    return rendered(
        "view.html",
        title=scene.mechanism.name,
        meshcat=(Path(meshcat.viewer_assets_path()) / "dist" / "main.min.js").read_text("utf-8"),
        data=clean(text).replace("<", "\\u003c"),
        served=served,
    )


def answer(scene: Scene, row: int, shift: Array) -> str:
    """Return what a page draws and writes off its poses, as JSON: see ``moved``."""
    try:
        moved_scene = moved(scene, row, shift)
    except MechanismError as error:
        return json.dumps({"problem": str(error)})
    bodies = _bodies(moved_scene).values()
    return json.dumps(
        {
            "problem": "",
            "matrices": [_columns(drawn) for drawn in bodies],
            "problems": [drawn.problems[0] for drawn in bodies],
            "values": [row["values"][0] for row in _rows(moved_scene)],
        }
    )


def _bodies(scene: Scene) -> dict[str, Body]:
    """Return the machines of a scene."""
    identified = {"identified": scene.magnified} if scene.magnified else {}
    return {"mechanism": scene.body, **identified}


def _bounds(scene: Scene) -> Array:
    """Return least and largest coordinates of what is looked at first, shape (2, 3), [m].

    The scene, and what of its layers stands no further from it than it is large.
    """
    bounds = scene.bounds()
    points = np.concatenate([bounds, *(layer.points.reshape(-1, 3) for layer in scene.layers)])
    away = np.linalg.norm(points - np.clip(points, *bounds), axis=1)
    near = points[away <= scene.size]
    return np.stack((near.min(axis=0), near.max(axis=0)))


def _columns(body: Body) -> str:
    """Return where parts are as columns of 3, N x n_parts x 4 x 3 doubles, in base 64."""
    columns = np.ascontiguousarray(body.placements[:, :, :3].swapaxes(2, 3), dtype="<f8")
    return base64.b64encode(columns.tobytes()).decode()


def _sliders(scene: Scene) -> list[dict[str, Any]]:
    """Return what moves the mechanism off its poses: coordinates, or readings of an arm.

    ``axis`` is the base's that a coordinate shifts along, -1 of all else.
    """
    mechanism, platform = scene.mechanism, scene.mechanism.platform
    names, units = mechanism.reading_names, mechanism.reading_units
    axes = [-1] * len(names)
    if not mechanism.by_readings:
        names, units = platform.freedoms, platform.units
        axes = [row if row < 3 else -1 for row in platform.twist_rows]
    return [
        {
            "name": name,
            "unit": POSES[unit],
            "scale": per_si(unit, POSES),
            "most": _SLIDER_RANGE[unit] * (scene.size if unit == "m" else 1.0),
            "axis": axis,
        }
        for name, unit, axis in zip(names, units, axes, strict=True)
    ]


def _rows(scene: Scene) -> list[dict[str, Any]]:
    """Return the table under the slider: what each row is, and its value at each pose."""
    mechanism, platform = scene.mechanism, scene.mechanism.platform
    read = mechanism.reading_names, mechanism.reading_units
    groups = [("pose", platform.coordinates, platform.units, POSES, scene.plan.poses)]
    nominal = "readings, as given" if mechanism.by_readings else "readings of the nominal model"
    groups.append((nominal, *read, POSES, scene.body.readings))
    if scene.plan.readings is not None and not mechanism.by_readings:
        groups.append(("readings, as measured", *read, POSES, scene.plan.readings))
    if scene.identified:
        errors = platform_errors(mechanism, scene.identified, scene.plan)
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


def _panel(scene: Scene) -> list[dict[str, Any]]:
    """Return what can be shown or hidden: path, name, whether it is shown first, its colour."""
    lines: list[tuple[str, str, bool, str]] = [("mechanism", "mechanism", True, "")]
    if scene.identified:
        name = f"identified, errors × {scene.magnify:g}"
        lines.append(("identified", name, True, IDENTIFIED))
    lines += [("sets", "poses, as dots", True, ""), ("ghosts", "poses, as ghosts", False, "")]
    lines += [(layer.path, layer.name, True, layer.colour) for layer in scene.layers]
    lines += [("mechanism/base/axes", "base frame", True, ""), ("grid", "grid", True, "")]
    return [
        {"path": f"meshcat/{path}", "name": name, "shown": shown, "colour": colour}
        for path, name, shown, colour in lines
    ]


class _Recorder:
    """Takes the place of meshcat's window; keeps commands, packed as for its viewer."""

    def __init__(self) -> None:
        self.commands: list[bytes] = []

    def send(self, command: Any) -> None:
        self.commands.append(umsgpack.packb(command.lower()))


class _Dots(g.PointsMaterial):  # type: ignore[misc]
    """Points of a size in pixels, near and far."""

    def lower(self, object_data: Any) -> dict[str, Any]:
        lowered = super().lower(object_data)
        return {**lowered, "sizeAttenuation": False, "vertexColors": False}


def _commands(scene: Scene) -> list[bytes]:
    """Return what draws a scene in meshcat's viewer, at no pose yet.

    Paths below ``/meshcat``: ``mechanism`` and ``identified`` with their parts (``Body.parts``);
    ``sets/1`` and ``ghosts/1`` for the first set and so on; those of layers.
    """
    recorder = _Recorder()
    draw = meshcat.Visualizer(window=recorder)
    for path in ("/Grid", "/Axes"):
        draw[path].set_property("visible", False)
    _draw_body(draw["mechanism"], scene.body)
    if scene.magnified:
        _draw_body(draw["identified"], scene.magnified, IDENTIFIED, opacity=0.45)
    for number, (name, colour, positions, lines) in enumerate(scene.by_set(), 1):
        _draw_layer(draw, Layer(f"sets/{number}", name, positions, colour, 7))
        _draw_layer(draw, Layer(f"ghosts/{number}", name, lines, colour), opacity=0.45)
    for layer in (scene.ground(), *scene.layers):
        _draw_layer(draw, layer)
    return recorder.commands


def _draw_layer(draw: Any, layer: Layer, opacity: float = 1.0) -> None:
    """Draw dots or lines."""
    geometry, colour = g.PointsGeometry(layer.points.reshape(-1, 3).T), int(layer.colour[1:], 16)
    if layer.points.ndim == 2:
        drawn = g.Points(geometry, _Dots(size=layer.pixels, color=colour))
    else:
        drawn = g.LineSegments(geometry, g.LineBasicMaterial(colour, opacity=opacity))
    draw[layer.path].set_object(drawn)


def _draw_body(draw: Any, body: Body, colour: str = "", opacity: float = 1.0) -> None:
    """Draw the shapes of a body's parts, in their own colours or, but its base, in one."""
    for path, shapes in body.parts.items():
        if colour and path.startswith("base/"):
            continue
        for number, shape in enumerate(shapes, 1):
            material = g.MeshLambertMaterial(int((colour or shape.colour)[1:], 16), opacity=opacity)
            node = draw[f"{path}/shape {number}"]
            node.set_object(_geometry(shape), material)
            cylinder = shape.kind == "cylinder"
            node.set_transform(shape.T_link_shape @ (_UPRIGHT if cylinder else np.eye(4)))


def _geometry(shape: Shape) -> Any:
    """Return a shape for meshcat; each triangle has corners of its own, so that edges are sharp."""
    if shape.kind == "box":
        return g.Box(shape.size)
    if shape.kind == "cylinder":
        radius, length = shape.size
        return g.Cylinder(length, radius)
    if shape.points is None:
        return g.Sphere(*shape.size)
    faces = ConvexHull(shape.points).simplices if shape.faces is None else shape.faces
    corners = shape.points[faces].reshape(-1, 3)
    return g.TriangularMeshGeometry(corners, np.arange(len(corners)).reshape(-1, 3))
