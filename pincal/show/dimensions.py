"""The parameters of a leg as dimensions of a drawing: lengths, angles, and what the sensors read.

Each named coordinate of a placement is one: a displacement is a length from where it begins to
where it ends, a turn is an angle about where it happens. Names stand beside their lines, where they
hide least.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import FancyArrowPatch
from matplotlib.path import Path
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from pincal.kinematics.closing import sensor_law
from pincal.kinematics.closure import LegClosure
from pincal.model.checks import EXACT
from pincal.model.joint import Joint
from pincal.model.sensor import Sensor
from pincal.show.style import DIMENSION
from pincal.types import Array
from pincal.words.wording import clean

_ARC = np.linspace(0.0, 1.0, 41)
_GREEK = re.compile(
    "alpha|beta|gamma|delta|epsilon|zeta|eta|theta|kappa|lambda|mu|nu|xi|pi|rho|sigma|tau|phi|chi"
    "|psi|omega"
)


@dataclass(frozen=True, eq=False)
class Dimension:
    """A length or an angle in a drawing."""

    name: str
    """Of the parameter; of a reading that of its gain, or empty if that is none."""
    kind: Literal["length", "angle", "reading", "offset"]
    line: Array
    """Points along it, from where it is measured, shape (n, 3), base frame, [m]."""
    corner: Array | None = None
    """Of an angle, shape (3,), [m]."""
    beside: bool = False
    """Whether the line lies on a link, so that it is better drawn beside that."""

    @property
    def extent(self) -> float:
        """How far the line goes, [m]: nothing where the parameter is zero."""
        return float(np.linalg.norm(np.diff(self.line, axis=0), axis=1).sum())


def dimensions_of(
    closure: LegClosure, joints: Array, T_base_platform: Array, size: float
) -> list[Dimension]:
    """Return the dimensions of a leg at its nominal parameters, smallest arcs of a size, [m].

    Joints are positions of moving ones, shape (n_joints,), [rad] or [m]; the pose has shape (4, 4).

    Raises:
        MechanismError: a homed sensor, and a home pose out of the leg's reach.
    """
    leg, law = closure.leg, sensor_law(closure)
    values = leg.nominal_by_name
    links = leg.link_placements(np.asarray(joints)[None])[0]
    dimensions: list[Dimension] = []
    for joint, carrier in zip(leg.joints, leg.carriers, strict=True):
        parent = links[carrier] if carrier >= 0 else np.eye(4)
        dimensions += _placed(joint, values, parent, size, shifted=carrier >= 0)
        for place, sensor in enumerate(leg.sensors):
            if sensor.joint == joint.name:
                start = float(law.start[place])
                positions = start - sensor.law(values)[1], start, float(joints[leg.active[place]])
                frame = parent @ joint.placement.origin()
                dimensions += _read(sensor, joint, frame, links[:, :3, 3], positions, size)
    for point in leg.points:
        dimensions += _placed(point, values, T_base_platform, size, shifted=False)
    return dimensions


def _placed(
    joint: Joint, values: dict[str, float], T: Array, size: float, *, shifted: bool
) -> Iterator[Dimension]:
    """Yield the dimensions of a joint's placement on its parent link, that at T, (4, 4).

    An angle goes from the axis that its turn moves first to where that comes to be.
    """
    for coordinate in joint.placement.coordinates:
        reach = sum(abs(step.amount(values)) for step in coordinate.steps if step.axis in "xyz")
        radius, names, after = max(size, 0.3 * reach), set(), T
        for step in coordinate.steps:
            before, after = after, after @ step.matrix(values)
            if not isinstance(step.value, str) or step.value in names:
                continue
            names.add(step.value)
            origin = before[:3, 3]
            if step.axis in "xyz":
                ends = np.stack((origin, after[:3, 3]))
                yield Dimension(step.value, "length", ends, beside=shifted)
                continue
            axis = before[:3, "xyz".index(step.axis[-1])]
            first = before[:3, {"rx": 1, "ry": 2, "rz": 0}[step.axis]]
            arc = _turned(first, axis, step.amount(values) * _ARC)
            line = origin + radius * (1.0 + 0.35 * len(names)) * arc
            yield Dimension(step.value, "angle", line, origin)
        T = T @ coordinate.displacement(values)


def _read(
    sensor: Sensor,
    joint: Joint,
    frame: Array,
    places: Array,
    positions: tuple[float, float, float],
    size: float,
) -> Iterator[Dimension]:
    """Yield what a sensor reads, and its offset if that is a parameter.

    The frame is the joint's at its zero; places, shape (n, 3), are of joints and tip; the joint
    counts from the first position, the sensor from the second, up to the third.
    """
    zero, start, position = positions
    origin, axis = frame[:3, 3], frame[:3, :3] @ np.array(joint.axis)
    arms = places - origin
    distant = arms[np.linalg.norm(np.cross(arms, axis), axis=1) > EXACT * size]
    link = distant[0] - axis * (distant[0] @ axis) if len(distant) else frame[:3, 0]

    def line(low: float, high: float, radius: float) -> tuple[Array, Array | None, bool]:
        if joint.kind == "prismatic":
            return origin + np.array([[low], [high]]) * axis, None, True
        arc = _turned(link / np.linalg.norm(link), axis, low - position + (high - low) * _ARC)
        return origin + radius * size * arc, origin, False

    gain = sensor.gain if isinstance(sensor.gain, str) else ""
    yield Dimension(gain, "reading", *line(start, position, 1.7))
    if isinstance(sensor.offset, str):
        yield Dimension(sensor.offset, "offset", *line(zero, start, 1.2))


def _turned(vector: Array, axis: Array, angles: Array) -> Array:
    """Return a vector (3,) turned about a unit axis by angles (n,), shape (n, 3)."""
    return np.asarray(Rotation.from_rotvec(np.multiply.outer(angles, axis)).apply(vector))


def symbol(name: str) -> str:
    """Return a parameter's name as a symbol of mathematics: ``beta_b`` as β with an index."""
    if not re.fullmatch(r"[A-Za-z0-9]+(_[A-Za-z0-9]+)*", name):
        return clean(name).replace("\\", "\\\\").replace("$", r"\$")
    first, *index = name.split("_")
    first = f"\\{first}" if _GREEK.fullmatch(first) else rf"\mathit{{{first}}}"
    return f"${first}_{{{','.join(index)}}}$" if index else f"${first}$"


_NAME_HEIGHT = 8.5  # of a parameter's name, [point]
_ALONG = (0.5, 0.35, 0.65, 0.2, 0.8, 0.05, 0.95)  # where a name is tried, by a dimension's length
_NAME_DISTANCES = (1.0, -1.0, 1.8, -1.8, 2.8, -2.8, 4.0, -4.0)  # from it, in heights of the name
#: Of a name over another, outside the axes, nearer to another's line; in hidden points of lines.
_OVERLAP, _OUTSIDE, _ASTRAY = 300.0, 100.0, 8.0


class Names:
    """Names in axes whose limits are set, each where it hides least."""

    def __init__(self, axes: Axes, links: Array) -> None:
        """Begin with links that names should not hide, shape (n, 2, 2), right and up, [m]."""
        low, high = np.array((axes.get_xlim(), axes.get_ylim())).T
        figure: Any = axes.get_figure(root=True)
        paper = 72.0 * figure.get_size_inches() * axes.get_position().size
        self.axes = axes
        self._limits = low[1], high[1]
        self.point = float(np.max((high - low) / paper))
        """What a point of the paper is in the picture, [m]; legend and values take some room."""
        self.middle = links.mean(axis=(0, 1)) if len(links) else (low + high) / 2
        self._boxes = np.zeros((0, 2, 2))
        self._hidden = np.zeros((0, 2))
        for segment in links:
            self.keep_off(segment)

    def keep_off(self, line: Array) -> Array:
        """Let no name hide a line, shape (n, 2), if it can be helped; return 40 points of it."""
        places = np.linspace(0.0, len(line) - 1.0, 40)
        points = np.stack([np.interp(places, np.arange(len(line)), c) for c in line.T], axis=1)
        self._hidden = np.concatenate((self._hidden, points))
        return points

    def half(self, text: str, size: float) -> Array:
        """Return half the width and height of a name of a size in points, shape (2,), [m]."""
        shown = re.sub(r"[${}_]", "", re.sub(r"\\mathit|\\[a-z]+", "x", text).replace("x{", ""))
        return 0.5 * size * self.point * np.array((0.58 * (len(shown) + 0.8), 1.4))

    def write(
        self, text: str, places: Array, size: float, cost: Array | float = 0.0, **style: Any
    ) -> None:
        """Write a name at the first of some places, shape (n, 2), that hides and costs least."""
        half = self.half(text, size)
        low, high = places - half, places + half
        inside = np.abs(self._hidden - places[:, None]) < half + 0.3 * half[1]  # links are thick
        boxes = self._boxes
        over = (low[:, None] < boxes[:, 1]) & (boxes[:, 0] < high[:, None])
        cost = cost + inside.all(axis=2).sum(axis=1) + _OVERLAP * over.all(axis=2).sum(axis=1)
        bottom, top = self._limits  # what is beside them is in the picture all the same
        outside = (low[:, 1] < bottom) | (high[:, 1] > top)
        cost = cost + _OUTSIDE * outside + 0.4 * np.arange(len(places))
        best = int(np.argmin(cost))
        room = 0.3 * size * self.point  # names that touch read as one
        self._boxes = np.concatenate((boxes, [[low[best] - room, high[best] + room]]))
        x, y = places[best].tolist()
        self.axes.text(x, y, text, size=size, ha="center", va="center", zorder=9, **style)


def draw_dimensions(names: Names, dimensions: Sequence[Dimension], V: Array) -> None:
    """Draw dimensions as seen along V (see ``paint``), then their names beside their lines."""
    lines = [_draw_line(names, dimension, V) for dimension in dimensions]
    for dimension, line in zip(dimensions, lines, strict=True):
        text = symbol(dimension.name) if dimension.name else ""
        if dimension.kind == "reading":
            text = rf"$\psi$ ({text})" if text else r"$\psi$"
        half, places = names.half(text, _NAME_HEIGHT), []
        for distance, along in product(_NAME_DISTANCES, _ALONG):  # on its line first
            index = int(along * (len(line) - 1))
            across = _across(line[min(index + 1, len(line) - 1)] - line[max(index - 1, 0)])
            places.append(line[index] + 1.1 * distance * float(np.abs(across) @ half) * across)
        rest = np.vstack([[np.inf, np.inf], *(other for other in lines if other is not line)])
        astray = cdist(places, rest).min(axis=1) < 1.2 * cdist(places, line).min(axis=1)
        ground = {"fc": "white", "ec": "none", "alpha": 0.75, "pad": 0.6}
        style = {"color": DIMENSION, "parse_math": True, "bbox": ground}
        names.write(text, np.array(places), _NAME_HEIGHT, _ASTRAY * astray, **style)


def _draw_line(names: Names, dimension: Dimension, V: Array) -> Array:
    """Draw a dimension without its name; return points of its line as drawn, shape (n, 2)."""
    axes, height = names.axes, _NAME_HEIGHT * names.point
    line, thin, heads = dimension.line @ V[:2].T, [], "<|-|>"
    if dimension.beside:
        across = _across(line[-1] - line[0])
        across *= 1.0 if across @ (line.mean(axis=0) - names.middle) >= 0.0 else -1.0
        thin += [(end, end + 1.7 * height * across, "-") for end in line]
        line = line + 1.3 * height * across
    if dimension.corner is not None:
        corner, heads = dimension.corner @ V[:2].T, "-|>"
        thin += [(corner, corner + 1.15 * (end - corner), "--") for end in (line[0], line[-1])]
    for begin, end, dashes in thin:
        axes.plot(*np.stack((begin, end)).T, dashes, lw=0.5, color=DIMENSION, zorder=8)
    if np.linalg.norm(np.diff(line, axis=0), axis=1).sum() < 0.3 * height:
        heads = "-"
    arrow = FancyArrowPatch(path=Path(line), arrowstyle=heads, mutation_scale=6.0, lw=0.8)
    arrow.set(color=DIMENSION, fill=heads != "-", zorder=8)
    axes.add_patch(arrow)
    return names.keep_off(line)


def _across(along: Array) -> Array:
    """Return the unit vector to the left of one in the plane; upwards of none."""
    size = float(np.linalg.norm(along))
    return np.array([-along[1], along[0]]) / size if size > 0.0 else np.array([0.0, 1.0])
