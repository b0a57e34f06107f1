"""A scene drawn by matplotlib: ground, workspace, ghosts, the mechanism, names, a legend."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Annotation

from pincal.kinematics.closure import nominal_legs
from pincal.kinematics.configurations import joints_at
from pincal.model.checks import EXACT
from pincal.model.measurements import EVERY_LEG
from pincal.show.pictures.dimensions import (
    Dimension,
    dimensions_of,
    draw_dimensions,
    point_of,
    symbol,
    text_box,
)
from pincal.show.pictures.files import drawing
from pincal.show.pictures.parts import paint, placed
from pincal.show.style import (
    ACTIVE,
    CARRIED,
    DIMENSION,
    DOMAIN,
    GROUND,
    IDENTIFIED,
    MARKERS,
    NOMINAL,
    PASSIVE,
    PICTURE,
)
from pincal.show.view.bodies import Shape
from pincal.show.view.scene import (
    Instrument,
    Scene,
    axes_of_view,
    frame_axes,
    grid_step,
    ground,
    stand,
)
from pincal.types import Array
from pincal.words.numbers import amount, counted, minus
from pincal.words.wording import clean


def scene_figure(scene: Scene, row: int, dimensions: Sequence[str] = ()) -> Figure:
    """Return a figure of a scene, the mechanism at one of its poses; all else as of a picture."""
    with drawing():
        width, height = np.ptp(_extent(scene, row, dimensions_at(scene, row, dimensions)), axis=0)
        inches = PICTURE.legend + np.clip(PICTURE.width * height / width, *PICTURE.heights)
        figure = Figure(figsize=(PICTURE.width, float(inches)), layout="constrained")
        draw_scene(figure.subplots(), scene, row, dimensions)
    return figure


def _extent(scene: Scene, row: int, dimensions: Sequence[tuple[str, Dimension]] = ()) -> Array:
    """Return the least and largest of what is seen, right and up, shape (2, 2), [m]."""
    V = axes_of_view(scene.planar)
    tips = np.array([2 * axis.T_link_shape[:3, 3] for axis in frame_axes(scene)])
    T_base_platform = scene.body.placements[row, scene.body.part("platform/body")]
    tips = tips @ T_base_platform[:3, :3].T + T_base_platform[:3, 3]
    points = np.concatenate(
        (scene.points(), tips, *(dimension.line for _, dimension in dimensions))
    )
    if scene.overlay and scene.overlay.instrument:
        ends = np.array(
            [scene.overlay.instrument.position, scene.overlay.instrument.T_base_frame[:3, 3]]
        )
        points = np.concatenate((points, ends))
    low, high = np.nanmin(points @ V[:2].T, axis=0), np.nanmax(points @ V[:2].T, axis=0)
    margin = 0.06 * float(np.max(high - low))
    return np.stack((low - margin, high + margin))


def draw_scene(axes: Axes, scene: Scene, row: int, dimensions: Sequence[str] = ()) -> Axes:
    """Draw a scene, the mechanism at one of its poses; all else as of a picture."""
    V = axes_of_view(scene.planar)
    placed_dimensions = dimensions_at(scene, row, dimensions)
    low, high = _extent(scene, row, placed_dimensions)
    edge = PICTURE.edge * float(np.linalg.norm(high - low))
    axes.add_collection(
        LineCollection(list(ground(scene) @ V[:2].T), colors=GROUND, lw=0.5, zorder=0)
    )
    legend = [Line2D([], [], color=GROUND, lw=0.8, label=f"grid {1e3 * grid_step(scene):.6g} mm")]
    if scene.cloud:
        colours = np.where(scene.cloud.domain, DOMAIN, CARRIED)
        across, upward = (scene.cloud.positions @ V[:2].T).T
        axes.scatter(across, upward, s=1.5, c=colours.tolist(), lw=0, zorder=0.3, rasterized=True)
    if len(scene.plan.poses) > 1:
        legend += _ghosts(axes, scene, V)
    frame = frame_axes(scene)
    shapes = [(shape, np.eye(4)) for shape in frame]
    T_base_platform = scene.body.placements[row, scene.body.part("platform/body")]
    shapes += [(shape, T_base_platform) for shape in frame]
    paint(axes, [*shapes, *placed(scene.body, row)], V, edge)
    if scene.overlay and scene.overlay.instrument:
        legend.append(_instrument(axes, scene, scene.overlay.instrument, V, edge))
    if scene.identified:
        paint(axes, placed(scene.identified.body, row), V, edge, IDENTIFIED)
        label = f"identified, errors × {scene.identified.magnify:g}"
        legend.append(_dot(IDENTIFIED, label))
    legend.append(_dot(ACTIVE, "active joint"))
    if any(leg.passive for leg in scene.mechanism.legs):
        legend.append(_dot(PASSIVE, "passive joint"))
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    name_axes(axes, frame, V)
    _name_legs(axes, scene, V, (low + high) / 2, point_of(axes))
    axes.set_axis_off()
    axes.legend(
        handles=legend,
        loc="upper center",
        bbox_to_anchor=(0.5, 0.0),
        ncols=int(
            np.clip(PICTURE.line / max(len(str(handle.get_label())) for handle in legend), 1, 3)
        ),
        frameon=False,
        handlelength=1.2,
        columnspacing=1.4,
    )
    if placed_dimensions:
        _dimension(axes, scene, row, dimensions, placed_dimensions, V)
    return axes


def _instrument(axes: Axes, scene: Scene, instrument: Instrument, V: Array, edge: float) -> Line2D:
    """Draw a tracker where it stands, with its frame, and return its line of the legend."""
    size = float(np.linalg.norm(np.ptp(scene.bounds(), axis=0)))
    place = np.eye(4)
    place[:3, 3] = instrument.position
    shapes = [(shape, place) for shape in stand(size, scene.planar)]
    shapes += [(shape, instrument.T_base_frame) for shape in frame_axes(scene)]
    paint(axes, shapes, V, edge)
    return _dot(DIMENSION, "tracker, and its frame")


def dimensions_at(
    scene: Scene, row: int, legs: Sequence[str], *, zeros: bool = False
) -> list[tuple[str, Dimension]]:
    """Return the parameters of legs as dimensions, each with its leg where they are several.

    Those that are zero only if asked for, of one place together.
    """
    mechanism, poses = scene.mechanism, scene.plan.poses[[row]]
    if not legs:
        return []
    joints = joints_at(mechanism, poses).joints
    if not np.isfinite(joints[legs[0]]).all():  # nothing is drawn there, as is said
        return []
    T_base_platform = mechanism.platform.matrices(poses)[0]
    size = PICTURE.arc * float(np.linalg.norm(np.ptp(_extent(scene, row), axis=0)))
    placed_dimensions = []
    for name in legs:
        closure = nominal_legs(mechanism)[mechanism.leg_names.index(name)]
        leg_dimensions = dimensions_of(closure, joints[name][0], T_base_platform, size)
        index = name if len(legs) > 1 else ""
        placed_dimensions += [
            (index, dimension) for dimension in leg_dimensions if dimension.extent > EXACT * size
        ]
        if zeros:
            placed_dimensions += [
                (index, dimension) for dimension in _together(leg_dimensions, EXACT * size)
            ]
    return placed_dimensions


def _together(dimensions: Sequence[Dimension], least: float) -> list[Dimension]:
    """Return parameters without extent, those that are of one part and place as one."""
    places: dict[tuple[str, bytes], Dimension] = {}
    for dimension in dimensions:
        if dimension.extent <= least and dimension.names and dimension.kind in ("length", "angle"):
            place = dimension.line[:1] if dimension.corner is None else dimension.corner[None]
            key = (dimension.part, (place / least).round(-3).tobytes())
            before = places.get(key)
            names = (*before.names, *dimension.names) if before else dimension.names
            places[key] = Dimension(names, "zero", np.repeat(place, 2, axis=0), part=dimension.part)
    return list(places.values())


def _dimension(
    axes: Axes,
    scene: Scene,
    row: int,
    legs: Sequence[str],
    dimensions: Sequence[tuple[str, Dimension]],
    V: Array,
) -> None:
    """Draw dimensions of legs, values above: of those that are zero alone."""
    mechanism, values, longest = scene.mechanism, [], 1
    for name in legs:
        index = name if len(legs) > 1 else ""
        leg = mechanism.leg(name)
        for key, value in leg.nominal_by_name.items():
            label = clean(mechanism.label(name, key)).replace("$", r"\$")
            text = f" = {_drawn(value, leg.units[key])}" + f" ({label})" * bool(label)
            values.append(symbol(key, index) + text)
            longest = max(longest, len(key + index + text))
    links = scene.body.skeletons()[row]
    along = np.linspace(0.0, 1.0, 60)[:, None, None]
    busy = ((1.0 - along) * links[:, 0] + along * links[:, 1]).reshape(-1, 3)
    draw_dimensions(axes, dimensions, V, busy)
    columns = int(np.clip(PICTURE.title / longest, 1, PICTURE.values))
    lines = [",  ".join(values[i : i + columns]) for i in range(0, len(values), columns)]
    axes.set_title("\n".join(lines), size=7.5, pad=14.0, parse_math=True)


def _drawn(value: float, unit: str) -> str:
    """Return a dimension as drawings give it, in mm or degrees."""
    text = f"{np.degrees(value):.5g}°" if unit == "rad" else amount(value, unit, 6)
    return minus(text)


def _dot(colour: str, label: str, marker: str = "o") -> Line2D:
    """Return a legend's line: a dot and its meaning."""
    return Line2D([], [], marker=marker, ls="", ms=5, color=colour, label=label)


def _short(name: str) -> str:
    """Return a name, its middle left out where there is no room for it."""
    limit = PICTURE.letters
    return clean(name if len(name) <= limit else f"{name[: limit - 9]}…{name[-8:]}")


def _ghosts(axes: Axes, scene: Scene, V: Array) -> list[Line2D]:
    """Draw all poses as lines from joint to joint, by set, and return their legend."""
    faint = float(np.clip(8 / len(scene.plan.poses), 0.12, 0.5))
    legend = []
    for (name, colour, points, lines), marker in zip(scene.by_set(), cycle(MARKERS), strict=False):
        ghosts = list(lines @ V[:2].T)
        axes.add_collection(LineCollection(ghosts, colors=colour, lw=0.7, alpha=faint, zorder=0.5))
        axes.plot(*(points @ V[:2].T).T, marker, ms=3, color=colour, zorder=0.6)
        owner = f" for {_short(name)}" if name not in ("", EVERY_LEG) else ""
        legend.append(_dot(colour, f"{counted(len(points), 'pose')}{owner}", marker))
    return legend


def name_axes(axes: Axes, frame: Sequence[Shape], V: Array) -> None:
    """Write the letters of the base frame's axes beyond their ends; none of one that is end on."""
    for letter, shape in zip("xyz", frame, strict=True):
        length = float(shape.size[1])
        end = 2 * V[:2] @ shape.T_link_shape[:3, 3]
        if np.linalg.norm(end) > 0.3 * length:
            offset = 4.5 * end / np.linalg.norm(end)
            style: dict[str, Any] = {"ha": "center", "va": "center", "size": 7, "zorder": 9}
            axes.annotate(
                letter, tuple(end.tolist()), tuple(offset), textcoords="offset points", **style
            )


def _name_legs(axes: Axes, scene: Scene, V: Array, middle: Array, point: float) -> None:
    """Write the legs' names at their feet, away from the mechanism and clear of each other.

    Args:
        axes: Where to write, after the letters of the axes.
        scene: What is drawn.
        V: What points right, up and towards the viewer, shape (3, 3).
        middle: Of what is drawn, right and up, [m].
        point: Of the paper, [m].
    """
    feet = np.array([leg.joints[0].placement.xyz for leg in scene.mechanism.legs]) @ V[:2].T
    outward = feet - middle
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-12)
    taken = [text_box(text, point) for text in axes.texts if isinstance(text, Annotation)]
    for leg, foot, way in zip(scene.mechanism.legs, feet, outward, strict=True):
        for far, turn in PICTURE.leg_name_places:
            cos, sin = np.cos(np.radians(turn)), np.sin(np.radians(turn))
            right, upward = (np.array([[cos, -sin], [sin, cos]]) @ way).tolist()
            name = axes.annotate(
                _short(leg.name),
                (float(foot[0]), float(foot[1])),
                xytext=(far * right, far * upward),
                textcoords="offset points",
                ha="center" if abs(right) < 0.4 else "left" if right > 0 else "right",
                va="center" if abs(upward) < 0.4 else "bottom" if upward > 0 else "top",
                size=8,
            )
            area = text_box(name, point)
            if not any((area[0] < box[1]).all() and (box[0] < area[1]).all() for box in taken):
                break
            if (far, turn) != PICTURE.leg_name_places[-1]:
                name.remove()
        taken.append(area)


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
    mechanism_leg = scene.mechanism.leg(leg)
    T = scene.body.placements[0, scene.body.part("platform/body")]
    point = T[:3, :3] @ np.array(mechanism_leg.point.placement.xyz) + T[:3, 3]
    return np.array(mechanism_leg.joints[0].placement.xyz), np.asarray(point)


def draw_leg(axes: Axes, scene: Scene, leg: str, colours: Mapping[str, str]) -> Axes:
    """Draw one leg of a mechanism apart, with its dimensions; base and platform are faint.

    Args:
        axes: Where to draw.
        scene: The mechanism at a pose, its first.
        leg: Name of the leg.
        colours: Of dimensions, by the names of parameters.
    """
    V, leg_shifts = axes_of_view(scene.planar), shifts(scene, leg)
    placed_dimensions = [
        (index, _moved(dimension, leg_shifts))
        for index, dimension in dimensions_at(scene, 0, [leg], zeros=True)
    ]
    faint, leg_shapes = _shapes(scene, leg, leg_shifts)
    frames = [(shape, np.eye(4)) for shape in frame_axes(scene)]
    corners = [_corners(shape, place) for shape, place in (*faint, *leg_shapes, *frames)]
    visible = (
        np.concatenate((*corners, *(dimension.line for _, dimension in placed_dimensions)))
        @ V[:2].T
    )
    low, high = visible.min(axis=0), visible.max(axis=0)
    box = axes.get_window_extent()
    across = float(np.max((high - low) / (box.width, box.height))) * axes.figure.dpi / 72.0
    margin = 0.05 * float(np.max(high - low)) + _LINES * PICTURE.name * across
    edge = PICTURE.edge * float(np.linalg.norm(high - low))
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
    axes.set_aspect("equal")
    axes.set_axis_off()
    paint(axes, faint, V, edge, GROUND)
    paint(axes, [*frames, *leg_shapes], V, edge)
    name_axes(axes, frame_axes(scene), V)
    busy = _joined(axes, scene, leg, leg_shifts, V)
    if placed_dimensions:
        draw_dimensions(axes, placed_dimensions, V, busy, colours)
    return axes


def _moved(dimension: Dimension, leg_shifts: Mapping[str, Array]) -> Dimension:
    shift = leg_shifts[dimension.part]
    corner = None if dimension.corner is None else dimension.corner + shift
    return replace(dimension, line=dimension.line + shift, corner=corner)


def _shapes(
    scene: Scene, leg: str, leg_shifts: Mapping[str, Array]
) -> tuple[list[tuple[Shape, Array]], list[tuple[Shape, Array]]]:
    """Return base and platform, and the leg's links, with ``T_base_part`` as drawn."""
    faint: list[tuple[Shape, Array]] = []
    leg_shapes: list[tuple[Shape, Array]] = []
    prefix = f"leg {scene.mechanism.leg_names.index(leg) + 1}/"
    for part, place in zip(scene.body.parts, scene.body.placements[0], strict=True):
        owner = part.path.split("/")[0]
        mine = part.path.startswith(prefix)
        if not np.isfinite(place).all() or (owner.startswith("leg ") and not mine):
            continue
        foot = part.path == f"{prefix}base"
        moved = place.copy()
        moved[:3, 3] += leg_shifts["base" if foot else "leg" if mine else owner]
        (leg_shapes if mine else faint).extend((shape, moved) for shape in part.shapes)
    return faint, leg_shapes


def _corners(shape: Shape, place: Array) -> Array:
    """Return points of a shape that tell its extent, shape (n, 3), base frame, [m]."""
    T = place @ shape.T_link_shape
    if shape.points is not None:
        return np.asarray(shape.points @ T[:3, :3].T + T[:3, 3])
    half = shape.size[1] / 2 if shape.kind == "cylinder" else 0.0
    return T[:3, 3] + np.array([[-half], [half]]) * T[:3, 2]


def _joined(axes: Axes, scene: Scene, leg: str, leg_shifts: Mapping[str, Array], V: Array) -> Array:
    """Draw lines where parts were joined; return points of links that names should not hide."""
    number = scene.mechanism.leg_names.index(leg)
    joints = scene.body.placements[0, list(scene.body.chains[number]), :3, 3]
    foot, point = _ends(scene, leg)
    path = np.concatenate((joints, point[None])) + leg_shifts["leg"]
    for ends in (
        (foot, foot + leg_shifts["leg"]),
        (point + leg_shifts["leg"], point + leg_shifts["platform"]),
    ):
        axes.plot(*(np.array(ends) @ V[:2].T).T, ls=(0, (4, 3)), lw=0.7, color=NOMINAL, zorder=7)
    share = np.linspace(0.0, 1.0, 60)[:, None, None]
    return np.asarray(((1.0 - share) * path[:-1] + share * path[1:]).reshape(-1, 3))
