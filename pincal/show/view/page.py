"""A scene as a self-contained HTML page: meshcat's viewer, the scene, and a panel.

``view.js`` builds the drawing with the viewer's three.js. All text from users' files goes through
JSON and becomes text nodes. The page's security policy forbids requests to any host but the one
that served it.
"""

import base64
import json
from collections.abc import Sequence
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import numpy as np

from pincal.design.simulate import platform_errors
from pincal.errors import MechanismError
from pincal.kinematics.singularity import tensions
from pincal.show.style import IDENTIFIED, PAPER
from pincal.show.view.bodies import Body
from pincal.show.view.scene import Layer, Scene, moved
from pincal.types import Array
from pincal.words.numbers import POSES, SMALL, per_si
from pincal.words.wording import clean, rendered

#: Range of sliders to each side, over the scene's size, and [rad].
_SLIDER_RANGE = {"m": 0.25, "rad": 0.5}
_SEEN_THROUGH = 0.45  # opacity of the identified machine


def page(scene: Scene, notices: Sequence[str] = (), *, served: bool = False) -> str:
    """Return the page of a scene.

    The viewer's tree has below ``meshcat``: ``mechanism`` and ``identified`` with their parts
    (``Body.parts``); ``sets/1`` for the first set and so on; and the layers.

    Notices are shown first. A page that is ``served`` can ask for the scene at other poses
    (``answer``).
    """
    dots = scene.dots()
    names = [layer.name for layer in dots]
    points = [scene.points(), *(layer.points.reshape(-1, 3) for layer in scene.layers)]
    every, ground = np.concatenate(points), scene.ground()
    distances = np.linalg.norm(every - np.clip(every, *scene.bounds()), axis=1)
    near = every[distances <= scene.size] @ scene.axes.T  # the view is not fitted to farther points
    low, high = near.min(axis=0), near.max(axis=0)
    data = {
        "notices": list(notices),
        "name": scene.mechanism.name,
        "description": scene.mechanism.description,
        "towards": scene.axes[2].tolist(),
        "centre": ((low + high) / 2 @ scene.axes).tolist(),
        "half": ((high - low) / 2).tolist(),
        "grid": ground.name,
        "still": [_still(layer) for layer in (ground, *scene.layers, *dots)],
        "bodies": [
            {
                "name": root,
                "paths": [f"meshcat/{root}/{path}" for path in body.parts],
                "shapes": _shapes(body, "" if root == "mechanism" else IDENTIFIED),
                "opacity": 1.0 if root == "mechanism" else _SEEN_THROUGH,
                "matrices": _columns(body),
                "problems": list(body.problems),
            }
            for root, body in _bodies(scene).items()
        ],
        "sets": [{"name": layer.name, "colour": layer.colour} for layer in dots],
        "set": [names.index(name) for name in scene.sets],
        "misses": _or_null(1e3 * scene.misses) if scene.misses is not None else None,
        "rows": _rows(scene),
        "legs": [
            {
                "name": leg.name,
                "colour": scene.colour(leg.name),
                "foot": list(leg.joints[0].placement.xyz),
            }
            for leg in scene.mechanism.legs
        ],
        "panel": _panel(scene),
        "sliders": _sliders(scene),
        "axis": scene.body.axis,
        "paper": PAPER,
    }
    text = json.dumps(data, ensure_ascii=False, separators=(",", ":"))
    viewer = distribution("meshcat").locate_file("meshcat/viewer/dist/main.min.js")
    return rendered(
        "view.html",
        title=scene.mechanism.name,
        meshcat=Path(str(viewer)).read_text("utf-8"),
        data=clean(text).replace("<", "\\u003c"),
        served=served,
    )


def answer(scene: Scene, row: int, shift: Array) -> str:
    """Return the drawing and the values at a moved pose, as JSON for a page: see ``moved``."""
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
    identified = {"identified": scene.magnified} if scene.magnified else {}
    return {"mechanism": scene.body, **identified}


def _packed(values: Array) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f8").tobytes()).decode()


def _columns(body: Body) -> str:
    """Return the placements of parts by columns of 3, packed N x n_parts x 4 x 3 doubles."""
    return _packed(body.placements[:, :, :3].swapaxes(2, 3))


def _shapes(body: Body, colour: str) -> list[list[dict[str, Any]]]:
    """Return the shapes of a body's parts; a given colour leaves out the parts of the base."""
    return [
        [
            {
                "kind": shape.kind,
                "size": shape.size,
                "T": shape.T_link_shape.T.ravel().tolist(),
                "colour": colour or shape.colour,
                "points": "" if shape.points is None else _packed(shape.points),
                "faces": [] if shape.faces is None else shape.faces.ravel().tolist(),
            }
            for shape in shapes
            if not (colour and path.startswith("base/"))
        ]
        for path, shapes in body.parts.items()
    ]


def _still(layer: Layer) -> dict[str, Any]:
    return {
        "path": f"meshcat/{layer.path}",
        "points": _packed(layer.points),
        "colour": layer.colour,
        "pixels": layer.pixels if layer.points.ndim == 2 else 0,
    }


def _sliders(scene: Scene) -> list[dict[str, Any]]:
    """Return the sliders that move the mechanism: coordinates, or readings of an arm.

    ``axis`` is the base's axis along which a coordinate shifts, -1 for all other sliders.
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
    """Return the rows of the table under the slider, with their values at each pose."""
    mechanism, platform = scene.mechanism, scene.mechanism.platform
    read = mechanism.reading_names, mechanism.reading_units
    groups = [("pose", platform.coordinates, platform.units, POSES, scene.plan.poses)]
    nominal = "readings, as given" if mechanism.by_readings else "readings of the nominal model"
    groups.append((nominal, *read, POSES, scene.body.readings))
    if mechanism.cables:
        pulls = tensions(mechanism, scene.plan.poses)
        head = "least tension of cables [N]; — where they cannot hold it"
        groups.append((head, mechanism.leg_names, ("1",) * len(mechanism.legs), POSES, pulls))
    if scene.plan.readings is not None and not mechanism.by_readings:
        groups.append(("readings, as measured", *read, POSES, scene.plan.readings))
    if scene.identified:
        errors = platform_errors(mechanism, scene.identified, scene.plan)
        groups.append(
            ("error, driven by the nominal model", platform.freedoms, platform.units, SMALL, errors)
        )
    return [
        {
            "head": head,
            "name": name,
            "unit": shown[unit],
            "digits": 3 if shown is SMALL else 2,
            "values": _or_null(values),
        }
        for head, names, units, shown, every in groups
        for name, unit, values in zip(
            names, units, (every * [per_si(u, shown) for u in units]).round(4).T, strict=True
        )
    ]


def _or_null(values: Array) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]


def _panel(scene: Scene) -> list[dict[str, Any]]:
    """Return the entries that can be shown or hidden; only one scale but 1 is shown at a time."""
    lines: list[tuple[str, str, str, float]] = [("mechanism", "mechanism", "", 1.0)]
    if scene.identified:
        name = f"identified, errors × {scene.magnify:,g}"
        lines.append(("identified", name, IDENTIFIED, scene.magnify))
    lines.append(("sets", "poses, as dots", "", 1.0))
    lines += [(layer.path, layer.name, layer.colour, layer.scale) for layer in scene.layers]
    lines += [("mechanism/base/axes", "base frame", "", 1.0), ("grid", "grid", "", 1.0)]
    return [
        {"path": f"meshcat/{path}", "name": name, "colour": colour, "scale": scale}
        for path, name, colour, scale in lines
    ]
