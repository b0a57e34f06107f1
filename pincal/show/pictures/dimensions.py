"""The parameters of a leg as dimensions of a drawing: lengths, angles, and what the sensors read.

Each named coordinate of a placement is one: a displacement is a length from where it begins to
where it ends, a turn is an angle about where it happens.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import FancyArrowPatch
from matplotlib.text import Annotation
from scipy.spatial.transform import Rotation

from pincal.kinematics.closing import sensor_law
from pincal.kinematics.closure import LegClosure
from pincal.model.checks import EXACT
from pincal.model.home import link_placements
from pincal.model.leg import Joint
from pincal.model.placement import Coordinate, Step
from pincal.model.sensor import Sensor
from pincal.show.style import DIMENSION, PICTURE
from pincal.types import Array
from pincal.words.wording import clean

_ARC = np.linspace(0.0, 1.0, 41)


@dataclass(frozen=True, eq=False)
class Dimension:
    """A length or an angle in a drawing."""

    names: tuple[str, ...]
    """Of the parameter; of a reading that of its gain, if it has one."""
    kind: Literal["length", "angle", "reading", "offset", "zero"]
    """``"zero"``: lengths and angles of one place that have no extent."""
    line: Array
    """Points along it, from where it is measured, shape (n, 3), base frame, [m]."""
    corner: Array | None = None
    """Of an angle, shape (3,), [m]."""
    beside: bool = False
    """Whether the line lies on a link, so that it is better drawn beside that."""
    part: Literal["base", "leg", "platform"] = "leg"
    """What it is a dimension of."""

    @property
    def extent(self) -> float:
        """How far the line goes, [m]: nothing where the parameter is zero."""
        return float(np.linalg.norm(np.diff(self.line, axis=0), axis=1).sum())


def dimensions_of(
    closure: LegClosure, joints: Array, T_base_platform: Array, size: float
) -> list[Dimension]:
    """Return the dimensions of a leg.

    Args:
        closure: The leg at its nominal parameters.
        joints: Positions of its moving joints, shape (n_joints,), [rad] or [m].
        T_base_platform: The pose, shape (4, 4).
        size: Radius of the smallest arc, [m].

    Raises:
        MechanismError: a homed sensor, and a home pose out of the leg's reach.
    """
    leg, law = closure.leg, sensor_law(closure)
    values = leg.nominal_by_name
    links = link_placements(leg, np.asarray(joints)[None])[0]
    dimensions: list[Dimension] = []
    for index, joint in enumerate(leg.joints):
        parent = links[index - 1] if index else np.eye(4)
        joint_dimensions = _placed(joint, values, parent, size, shifted=index > 0)
        dimensions += [
            replace(dimension, part="leg" if index else "base") for dimension in joint_dimensions
        ]
        for place, sensor in enumerate(leg.sensors):
            if sensor.joint == joint.name:
                position = float(joints[leg.active[place]])
                start = float(law.start[place])
                drive = _Drive(joint, parent @ joint.placement.origin(), links[:, :3, 3], size)
                dimensions += _read(sensor, drive, start - sensor.law(values)[1], start, position)
    joint_dimensions = _placed(leg.point, values, T_base_platform, size, shifted=False)
    dimensions += [replace(dimension, part="platform") for dimension in joint_dimensions]
    return dimensions


def _placed(
    joint: Joint, values: dict[str, float], T: Array, size: float, *, shifted: bool
) -> Iterator[Dimension]:
    """Yield the dimensions of a joint's placement on its parent link, that at T, (4, 4)."""
    for coordinate in joint.placement.coordinates:
        yield from _of_coordinate(coordinate, values, T, size, shifted)
        T = T @ coordinate.displacement(values)


def _of_coordinate(
    coordinate: Coordinate, values: dict[str, float], T: Array, size: float, shifted: bool
) -> Iterator[Dimension]:
    """Yield the dimensions of a coordinate's values that are parameters."""
    reach = sum(abs(step.amount(values)) for step in coordinate.steps if step.axis in "xyz")
    radius = size if reach < size else max(size, 0.3 * reach)
    done: set[str] = set()
    frames = [T]
    for step in coordinate.steps:
        frames.append(frames[-1] @ step.matrix(values))
    for step, (before, after) in zip(coordinate.steps, pairwise(frames), strict=True):
        if not isinstance(step.value, str) or step.value in done:
            continue
        done.add(step.value)
        if step.axis in "xyz":
            yield Dimension(
                (step.value,), "length", np.stack((before[:3, 3], after[:3, 3])), beside=shifted
            )
        else:
            yield _angle(step.value, step, values, before, radius * (1.0 + 0.35 * len(done)))


def _angle(name: str, step: Step, values: dict[str, float], T: Array, radius: float) -> Dimension:
    """Return the angle of a turn, from the axis that it turns first to where that goes."""
    axis, zero = T[:3, "xyz".index(step.axis[-1])], {"rx": 1, "ry": 2, "rz": 0}[step.axis]
    arc = _turned(T[:3, zero], axis, step.amount(values) * _ARC)
    return Dimension((name,), "angle", T[:3, 3] + radius * arc, T[:3, 3])


def _turned(vector: Array, axis: Array, angles: Array) -> Array:
    """Return a vector (3,) turned about a unit axis by angles (n,), shape (n, 3)."""
    turns = Rotation.from_rotvec(np.multiply.outer(angles, axis))
    return np.asarray(turns.apply(vector))


@dataclass(frozen=True, eq=False)
class _Drive:
    """An active joint in a drawing."""

    joint: Joint
    frame: Array
    """Where it is at its zero, ``T_base_joint``, shape (4, 4)."""
    places: Array
    """Of the joints and the tip, shape (n, 3), [m]."""
    size: float
    """Radius of the smallest arc, [m]."""

    def line(self, position: float, low: float, high: float, radius: float) -> Dimension:
        """Return a nameless dimension from one position of the joint to another.

        Args:
            position: Where the joint is now, [rad] or [m].
            low: Where the dimension begins.
            high: Where it ends.
            radius: Of an arc, in those of the smallest.
        """
        origin, axis = self.frame[:3, 3], self.frame[:3, :3] @ np.array(self.joint.axis)
        if self.joint.kind == "prismatic":
            ends = origin + np.array([[low], [high]]) * axis
            return Dimension((), "reading", ends, beside=True)
        arms = self.places - origin
        distant = arms[np.linalg.norm(np.cross(arms, axis), axis=1) > EXACT * self.size]
        link = distant[0] - axis * (distant[0] @ axis) if len(distant) else self.frame[:3, 0]
        arc = _turned(link / np.linalg.norm(link), axis, low - position + (high - low) * _ARC)
        return Dimension((), "reading", origin + radius * self.size * arc, origin)


def _read(
    sensor: Sensor, drive: _Drive, zero: float, start: float, position: float
) -> list[Dimension]:
    """Return what a sensor reads, and its offset if that is a parameter.

    Args:
        sensor: The sensor.
        drive: Its joint.
        zero: Position from which the joint is counted, [rad] or [m].
        start: Position at which the sensor reads zero.
        position: Where the joint is.
    """
    names = (sensor.gain,) if isinstance(sensor.gain, str) else ()
    dimensions = [replace(drive.line(position, start, position, 1.7), names=names)]
    if isinstance(sensor.offset, str):
        offset = replace(drive.line(position, zero, start, 1.2), names=(sensor.offset,))
        dimensions.append(replace(offset, kind="offset"))
    return dimensions


#: Before a parameter's name in the id of its line.
MARK = "dimension-"
_TOGETHER = 3  # names of one place that are written out
_GREEK = re.compile(
    "alpha|beta|gamma|delta|epsilon|zeta|eta|theta|kappa|lambda|mu|nu|xi|pi|rho|sigma|tau|phi|chi"
    "|psi|omega"
)


def symbol(name: str, leg: str = "") -> str:
    """Return a parameter's name as a symbol of mathematics: ``beta_b`` as β with an index.

    Args:
        name: Of the parameter.
        leg: Name of its leg, of which a number at the end becomes an index.
    """
    if not re.fullmatch(r"[A-Za-z0-9]+(_[A-Za-z0-9]+)*", name):
        return clean(name).replace("\\", "\\\\").replace("$", r"\$")
    first, *index = name.split("_")
    first = f"\\{first}" if _GREEK.fullmatch(first) else rf"\mathit{{{first}}}"
    number = re.search(r"\d+$", leg)
    index += [number[0]] if number else []
    return f"${first}_{{{','.join(index)}}}$" if index else f"${first}$"


def draw_dimensions(
    axes: Axes,
    dimensions: Sequence[tuple[str, Dimension]],
    V: Array,
    busy: Array,
    colours: Mapping[str, str] | None = None,
) -> None:
    """Draw dimensions over what axes show; their limits must be set.

    Args:
        axes: Where to draw.
        dimensions: Dimensions, each with the name of its leg where that is to be an index.
        V: What points right, up and towards the viewer, shape (3, 3), rows in the base frame.
        busy: Points that names should not hide, shape (n, 3), base frame, [m].
        colours: Of lines, by the names of parameters; all alike if not given.
    """
    line_colours = [_colour(dimension, colours or {}) for _, dimension in dimensions]
    point = point_of(axes)
    height = PICTURE.name * point
    hidden = busy[np.isfinite(busy).all(axis=1)] @ V[:2].T
    middle = hidden.mean(axis=0)
    lines = [
        _drawn(axes, dimension, V, (height, colour), middle)
        if dimension.kind != "zero"
        else _marked(axes, dimension, V, colours or {})
        for (_, dimension), colour in zip(dimensions, line_colours, strict=True)
    ]
    visible = np.concatenate([hidden, *map(_sampled, lines)])
    boxes = [text_box(text, point) for text in axes.texts if isinstance(text, Annotation)]
    for (leg, dimension), line in zip(dimensions, lines, strict=True):
        names = [symbol(name, leg) for name in dimension.names]
        names = [names[0], "…", names[-1]] if len(names) > _TOGETHER else names
        text = ", ".join(names)
        if dimension.kind == "reading":
            text = rf"$\psi$ ({text})" if text else r"$\psi$"
        text += " = 0" * (dimension.kind == "zero")
        half = 0.5 * height * np.array((PICTURE.letter * (_letters(text) + 0.8), 1.4))
        place = _free(line, half, visible, boxes)
        room = half + 0.3 * height  # names that touch read as one
        boxes.append(np.stack((place - room, place + room)))
        axes.text(
            float(place[0]),
            float(place[1]),
            text,
            size=PICTURE.name,
            color=DIMENSION,
            ha="center",
            va="center",
            parse_math=True,
            zorder=9,
            bbox={"fc": "white", "ec": "none", "alpha": 0.75, "pad": 0.6},
        )


def point_of(axes: Axes) -> float:
    """Return what a point of the paper is in a picture, [m]; legend and values take some room."""
    (low_x, high_x), (low, high) = axes.get_xlim(), axes.get_ylim()
    paper = 72.0 * np.array((PICTURE.width, PICTURE.heights[1]))
    return PICTURE.room * float(np.max(np.array((high_x - low_x, high - low)) / paper))


def _letters(text: str) -> int:
    """Return how many letters a text with symbols shows."""
    return len(re.sub(r"[${}_]", "", re.sub(r"\\mathit|\\[a-z]+", "x", text).replace("x{", "")))


def text_box(name: Annotation, point: float) -> Array:
    """Return the least and largest of where a name beside a point is, shape (2, 2), [m]."""
    height = float(name.get_fontsize()) * point
    half = 0.5 * height * np.array((PICTURE.letter * len(name.get_text()), 1.2))
    shift = {"left": 1.0, "right": -1.0, "bottom": 1.0, "top": -1.0, "center": 0.0}
    sides = name.get_horizontalalignment(), name.get_verticalalignment()
    aligned = np.array([shift[side] for side in sides])
    middle = np.array(list(name.xy)) + point * np.array(name.get_position()) + half * aligned
    return np.stack((middle - half, middle + half))


def _colour(dimension: Dimension, colours: Mapping[str, str]) -> str:
    """Return the colour of a dimension, that of its first parameter that has one."""
    return next((colours[name] for name in dimension.names if name in colours), DIMENSION)


def _drawn(
    axes: Axes, dimension: Dimension, V: Array, look: tuple[float, str], middle: Array
) -> Array:
    """Draw a dimension without its name; return its line as drawn, shape (n, 2).

    Args:
        axes: Where to draw.
        dimension: The dimension.
        V: What points right, up and towards the viewer, shape (3, 3).
        look: Height of names, [m], and the line's colour.
        middle: Of the mechanism, from which lines beside links are away, shape (2,), [m].
    """
    height, colour = look
    line = dimension.line @ V[:2].T
    thin: list[tuple[Array, str]] = []
    if dimension.beside:
        across = _across(line[-1] - line[0])
        across *= 1.0 if across @ (line.mean(axis=0) - middle) >= 0.0 else -1.0
        thin += [(np.stack((end, end + 1.7 * height * across)), "-") for end in line]
        line = line + 1.3 * height * across
    if dimension.corner is not None:
        corner = dimension.corner @ V[:2].T
        sides = (line[0], line[-1])
        thin += [(np.stack((corner, corner + 1.15 * (end - corner))), "--") for end in sides]
    for part, dashes in thin:
        axes.plot(*part.T, dashes, lw=0.5, color=colour, zorder=8)
    (drawn,) = axes.plot(*line.T, lw=0.8 if colour == DIMENSION else 1.4, color=colour, zorder=8)
    if colour != DIMENSION and dimension.names:
        drawn.set_gid(MARK + dimension.names[0])  # found by linked pages
    if np.linalg.norm(np.diff(line, axis=0), axis=1).sum() > 0.3 * height:
        _arrow(axes, line[-1], line[-2], look)
        if dimension.corner is None:
            _arrow(axes, line[0], line[1], look)
    return line


def _marked(axes: Axes, dimension: Dimension, V: Array, colours: Mapping[str, str]) -> Array:
    """Draw where parameters are that are zero, one mark in the other; return it as a line."""
    line = dimension.line @ V[:2].T
    for rank, name in enumerate(dimension.names):
        colour, size = colours.get(name, DIMENSION), 4.0 + 2.5 * (len(dimension.names) - 1 - rank)
        (mark,) = axes.plot(*line[0], "D", ms=size, color=colour, mec="white", mew=0.6, zorder=8)
        if name in colours:
            mark.set_gid(MARK + name)  # found by linked pages
    return line


def _arrow(axes: Axes, end: Array, before: Array, look: tuple[float, str]) -> None:
    """Draw the head of an arrow at a line's end, in the look of ``_drawn``."""
    height, colour = look
    backward = before - end
    tail = end + backward * min(1.0, height / max(float(np.linalg.norm(backward)), 1e-300))
    head = FancyArrowPatch(
        tuple(tail), tuple(end), arrowstyle="-|>", mutation_scale=6.0, lw=0.6, shrinkA=0, shrinkB=0
    )
    head.set(color=colour, zorder=8)
    axes.add_patch(head)


def _across(along: Array) -> Array:
    """Return the unit vector to the left of one in the plane; upwards of none."""
    size = float(np.linalg.norm(along))
    return np.array([-along[1], along[0]]) / size if size > 0.0 else np.array([0.0, 1.0])


def _sampled(line: Array) -> Array:
    """Return points all along a line, shape (m, 2)."""
    places = np.linspace(0.0, len(line) - 1.0, 40)
    first = np.minimum(places.astype(int), len(line) - 2)
    part = (places - first)[:, None]
    return np.asarray((1.0 - part) * line[first] + part * line[first + 1])


def _free(line: Array, half: Array, visible: Array, boxes: Sequence[Array]) -> Array:
    """Return where a name hides the least, near a line: its middle, shape (2,)."""
    places = _sampled(line)
    best, least = places[0], np.inf
    thick = 0.3 * half[1]  # links are no lines
    for rank, (along, distance) in enumerate(
        (a, b) for a in PICTURE.along for b in PICTURE.name_distances
    ):
        index = int(along * (len(places) - 1))
        ahead = places[min(index + 1, len(places) - 1)] - places[max(index - 1, 0)]
        across = _across(ahead)
        reach = float(np.abs(across) @ half)
        place = places[index] + distance * reach * 1.1 * across
        hidden = (np.abs(visible - place) < half + thick).all(axis=1).sum()
        overlaps = sum(
            bool((place - half < box[1]).all() and (box[0] < place + half).all()) for box in boxes
        )
        cost = float(hidden) + 300.0 * overlaps + 0.4 * rank
        if cost < least:
            best, least = place, cost
    return best
