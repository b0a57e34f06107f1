"""A leg drawn apart: base, links and platform moved along the leg, so that dimensions have room.

Lines of dashes join what belongs together; the other legs are left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from pincal.show.pictures.dimension_lines import draw_dimensions
from pincal.show.pictures.dimensions import Dimension
from pincal.show.pictures.figure import dimensions_at, name_axes
from pincal.show.pictures.painting import paint
from pincal.show.style import GROUND, NOMINAL, PICTURE
from pincal.show.view.bodies import Shape
from pincal.show.view.scene import Scene, axes_of_view, frame_axes

Array = NDArray[np.float64]
_LINES = 3.0  # of names that stand outside of what is drawn
#: How far apart neighbours are moved, of the distance from foot to platform point.
GAP = 0.22


def shifts(scene: Scene, leg: str) -> dict[str, Array]:
    """Return by how much base, leg and platform are moved, shape (3,) each, [m]."""
    foot, point = _ends(scene, leg)
    gap = GAP * (point - foot)
    return {"base": np.zeros(3), "leg": gap, "platform": 2.0 * gap}


def _ends(scene: Scene, leg: str) -> tuple[Array, Array]:
    """Return where a leg stands and its platform point, shape (3,) each, base frame, [m]."""
    own = scene.mechanism.leg(leg)
    T = scene.body.placements[0, scene.body.part("platform/body")]
    point = T[:3, :3] @ np.array(own.point.placement.xyz) + T[:3, 3]
    return np.array(own.joints[0].placement.xyz), np.asarray(point)


def draw_leg(axes: Axes, scene: Scene, leg: str, colours: Mapping[str, str]) -> Axes:
    """Draw one leg of a mechanism apart, with its dimensions; base and platform are faint.

    Args:
        axes: Where to draw.
        scene: The mechanism at a pose, its first.
        leg: Name of the leg.
        colours: Of dimensions, by the names of parameters.
    """
    V, apart = axes_of_view(scene.planar), shifts(scene, leg)
    found = [
        (index, _moved(one, apart)) for index, one in dimensions_at(scene, 0, [leg], zeros=True)
    ]
    faint, own = _shapes(scene, leg, apart)
    frames = [(shape, np.eye(4)) for shape in frame_axes(scene)]
    corners = [_corners(shape, place) for shape, place in (*faint, *own, *frames)]
    seen = np.concatenate((*corners, *(one.line for _, one in found))) @ V[:2].T
    low, high = seen.min(axis=0), seen.max(axis=0)
    box = axes.get_window_extent()
    across = float(np.max((high - low) / (box.width, box.height))) * axes.figure.dpi / 72.0
    margin = 0.05 * float(np.max(high - low)) + _LINES * PICTURE.name * across
    edge = PICTURE.edge * float(np.linalg.norm(high - low))
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
    axes.set_aspect("equal")
    axes.set_axis_off()
    paint(axes, faint, V, edge, GROUND)
    paint(axes, [*frames, *own], V, edge)
    name_axes(axes, frame_axes(scene), V)
    busy = _joined(axes, scene, leg, apart, V)
    if found:
        draw_dimensions(axes, found, V, busy, colours)
    return axes


def _moved(one: Dimension, apart: Mapping[str, Array]) -> Dimension:
    shift = apart[one.part]
    corner = None if one.corner is None else one.corner + shift
    return replace(one, line=one.line + shift, corner=corner)


def _shapes(
    scene: Scene, leg: str, apart: Mapping[str, Array]
) -> tuple[list[tuple[Shape, Array]], list[tuple[Shape, Array]]]:
    """Return base and platform, and the leg's links, with ``T_base_part`` as drawn."""
    faint: list[tuple[Shape, Array]] = []
    own: list[tuple[Shape, Array]] = []
    prefix = f"leg {scene.mechanism.leg_names.index(leg) + 1}/"
    for part, place in zip(scene.body.parts, scene.body.placements[0], strict=True):
        owner = part.path.split("/")[0]
        mine = part.path.startswith(prefix)
        if not np.isfinite(place).all() or (owner.startswith("leg ") and not mine):
            continue
        foot = part.path == f"{prefix}base"
        moved = place.copy()
        moved[:3, 3] += apart["base" if foot else "leg" if mine else owner]
        (own if mine else faint).extend((shape, moved) for shape in part.shapes)
    return faint, own


def _corners(shape: Shape, place: Array) -> Array:
    """Return points of a shape that tell its extent, shape (n, 3), base frame, [m]."""
    T = place @ shape.T_link_shape
    if shape.points is not None:
        return np.asarray(shape.points @ T[:3, :3].T + T[:3, 3])
    half = shape.size[1] / 2 if shape.kind == "cylinder" else 0.0
    return T[:3, 3] + np.array([[-half], [half]]) * T[:3, 2]


def _joined(axes: Axes, scene: Scene, leg: str, apart: Mapping[str, Array], V: Array) -> Array:
    """Draw lines where parts were joined; return points of links that names should not hide."""
    number = scene.mechanism.leg_names.index(leg)
    at = scene.body.placements[0, list(scene.body.chains[number]), :3, 3]
    foot, point = _ends(scene, leg)
    path = np.concatenate((at, point[None])) + apart["leg"]
    for ends in ((foot, foot + apart["leg"]), (point + apart["leg"], point + apart["platform"])):
        axes.plot(*(np.array(ends) @ V[:2].T).T, ls=(0, (4, 3)), lw=0.7, color=NOMINAL, zorder=7)
    share = np.linspace(0.0, 1.0, 60)[:, None, None]
    return np.asarray(((1.0 - share) * path[:-1] + share * path[1:]).reshape(-1, 3))
