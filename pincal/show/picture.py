"""``pincal.picture``: a view's scene as a flat picture, for static pages.

Planar mechanisms are seen from above, others from the side, in parallel projection. Shapes with
dark outlines are painted from the farthest to the nearest.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull
from scipy.spatial.transform import RigidTransform

from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.kinematics.configurations import home_of
from pincal.model import EVERY_LEG, Plan
from pincal.model.checks import counted
from pincal.show import style
from pincal.show.view.bodies import Shape
from pincal.show.view.scene import Scene, scene
from pincal.types import Array
from pincal.words.wording import clean


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture of a scene: the mechanism at the first pose, all poses as dots."""

    scene: Scene

    def draw(self, axes: Axes) -> Axes:
        """Draw into axes, preferably inside ``pincal.show.style.drawing()``."""
        scene = self.scene
        V, (low, high) = scene.axes, self._extent
        ground = scene.ground()
        lines = list(ground.points @ V[:2].T)
        axes.add_collection(LineCollection(lines, colors=ground.colour, lw=0.5, zorder=0))
        legend = [Line2D([], [], color=ground.colour, lw=0.8, label=ground.name)]
        if len(scene.plan.poses) > 1:
            legend += _dots(axes, scene)
        paint(axes, scene.body.shapes, V)
        if scene.magnified:
            paint(axes, scene.magnified.shapes, V, style.IDENTIFIED)
            legend.append(_dot(style.IDENTIFIED, f"identified, errors × {scene.magnify:g}"))
        legend.append(_dot(style.ACTIVE, "driven"))
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        axes.set_axis_off()
        _name_axes_and_legs(axes, scene)
        longest = max(len(str(handle.get_label())) for handle in legend)
        below: dict[str, Any] = {"loc": "upper center", "bbox_to_anchor": (0.5, 0.0)}
        columns = int(np.clip(_LINE / longest, 1, 3))
        axes.legend(handles=legend, ncols=columns, frameon=False, **below)
        return axes

    @property
    def _extent(self) -> Array:
        """Lower and upper limits of the picture, right and up, shape (2, 2), [m]."""
        scene = self.scene
        tips = scene.body.platform[0] @ np.vstack((scene.body.axis * np.eye(3), np.ones(3)))
        points = np.concatenate((scene.points(), tips[:3].T)) @ scene.axes[:2].T
        low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
        margin = 0.1 * float(np.max(high - low))
        return np.stack((low - margin, high + margin))

    def figure(self) -> Figure:
        """Return the picture as a new figure."""
        width, height = np.ptp(self._extent, axis=0)
        inches = _LEGEND + np.clip(_WIDTH * height / width, *_HEIGHTS)
        with style.drawing():
            figure = Figure(figsize=(_WIDTH, float(inches)), layout="constrained")
            self.draw(figure.subplots())
        return figure

    def save(self, path: str | Path, *, force: bool = False) -> Path:
        """Write the picture as .svg, .png or .pdf, whole or not at all, and return its path.

        The same picture gives the same bytes.

        Raises:
            FileError: the name ends otherwise, or the file exists and ``force`` is not set, or
                the file cannot be written.
        """
        return style.save_figure(self.figure(), path, force=force)

    def _repr_png_(self) -> bytes:
        return style.figure_bytes(self.figure(), "png")


def picture(
    mechanism: GivenMechanism,
    poses: Plan | ArrayLike | RigidTransform | None = None,
    *,
    identified: GivenMechanism | None = None,
    magnify: float | None = None,
) -> Picture:
    """Return a picture of a mechanism: ``save(path)``, ``figure()``, ``draw(axes)``.

    It shows the scene of ``view`` without a browser: planar mechanisms from above, others from the
    side.

    Args:
        mechanism: The mechanism, at its nominal parameters.
        poses: Poses as for ``view``; home if not given. The mechanism is drawn at the first pose,
            all are dots, coloured by set.
        identified: The calibrated mechanism, drawn over the nominal one.
        magnify: Factor on the differences between identified and nominal parameters; if not given,
            one that makes errors visible and lets the mechanism assemble at every pose.

    Raises:
        MechanismError: poses have a wrong shape or are not finite; ``identified`` is another
            mechanism.
        MeasurementError: there are no poses, too many or incomplete ones; or ``magnify`` <= 0.
    """
    mechanism = as_mechanism(mechanism)
    poses = home_of(mechanism) if poses is None else poses
    return Picture(scene(mechanism, poses, identified, magnify))


_WIDTH, _HEIGHTS = 5.2, (1.8, 6.0)  # width of a picture, least and largest height, [inch]
_LEGEND = 0.5  # height for the legend below, [inch]
_LETTERS = 28  # most letters of a name
_LETTERING: dict[str, Any] = {
    "size": 7.5,
    "zorder": 9,
    "bbox": {"boxstyle": "square,pad=0.1", "color": style.PAPER, "alpha": 0.6},
}
_LINE = 75  # letters in a line of the legend


def _dots(axes: Axes, scene: Scene) -> list[Line2D]:
    """Draw the positions of all poses as dots, by set, and return their legend."""
    legend = []
    for layer, marker in zip(scene.dots(), cycle(style.MARKERS), strict=False):
        points, name = layer.points @ scene.axes[:2].T, layer.name
        axes.plot(*points.T, marker, ms=3, color=layer.colour, zorder=8)
        owner = f" for {shortened(name)}" if name not in ("", EVERY_LEG) else ""
        legend.append(_dot(layer.colour, f"{counted(len(points), 'pose')}{owner}", marker))
    return legend


def _dot(colour: str, label: str, marker: str = "o") -> Line2D:
    return Line2D([], [], marker=marker, ls="", ms=5, color=colour, label=label)


def shortened(name: str) -> str:
    """Return a name of at most ``_LETTERS`` letters; longer ones lose their middle."""
    return clean(name if len(name) <= _LETTERS else f"{name[: _LETTERS - 9]}…{name[-8:]}")


def _name_axes_and_legs(axes: Axes, scene: Scene) -> None:
    """Name the base's axes beyond their ends, and legs beside their feet, outwards."""
    V = scene.axes[:2]
    ends = scene.body.axis * V.T
    feet = np.array([leg.joints[0].placement.xyz for leg in scene.mechanism.legs]) @ V.T
    named = [(letter, end, end, 9.0) for letter, end in zip("xyz", ends, strict=True)]
    named = named[: scene.mechanism.platform.space]  # in the plane z points to the viewer
    for leg, foot in zip(scene.mechanism.legs, feet, strict=True):
        named.append((shortened(leg.name), foot, foot - feet.mean(axis=0), 14.0))
    for text, place, outward, far in named:
        right, up = far * outward / (np.linalg.norm(outward) or 1.0)
        sides: dict[str, Any] = {
            "ha": "left" if right > 0.5 * far else "right" if right < -0.5 * far else "center",
            "va": "bottom" if up > 0.5 * far else "top" if up < -0.5 * far else "center",
        }
        axes.annotate(text, place, (right, up), textcoords="offset points", **sides, **_LETTERING)


_DARK, _EDGE = 0.55, 0.5  # an outline's brightness over its shape's, and its width, [point]
_SHORT = 1e-4  # length of a rod over its radius below which it is not drawn
_TURNS = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)
_CIRCLE = np.stack((np.cos(_TURNS), np.sin(_TURNS)), axis=1)
_CORNERS = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), axis=-1).reshape(-1, 3)


def paint(axes: Axes, shapes: list[tuple[Shape, Array]], V: Array, colour: str = "") -> None:
    """Paint shapes at their ``T_base_part``, [m]; a given ``colour`` is translucent.

    The rows of V, shape (3, 3), point right, up and towards the viewer, in the base frame.
    """
    polygons = []
    for shape, place in shapes:
        points = _points(shape, place @ shape.T_link_shape, V)
        if len(points):  # sorted by the nearest point; plates by a farther one: parts stand on them
            depth = float(np.quantile(points @ V[2], 0.25 if shape.kind == "mesh" else 1.0))
            flat = points @ V[:2].T
            hull = flat[ConvexHull(flat).vertices]
            hull = np.roll(hull, -int(np.lexsort(hull.round(9).T)[0]), axis=0)  # the lowest first
            polygons.append((round(depth, 9), hull, colour or shape.colour))
    polygons.sort(key=lambda polygon: polygon[0])
    fills = np.array([to_rgb(fill) for *_, fill in polygons]).reshape(-1, 3)
    painted = PolyCollection(
        [outline for _, outline, _ in polygons],
        facecolors=fills,
        edgecolors=_DARK * fills,
        lw=_EDGE,
        joinstyle="round",
        alpha=0.45 if colour else None,
    )
    axes.add_collection(painted)


def _points(shape: Shape, T: Array, V: Array) -> Array:
    """Return points whose hull is a shape's outline, (n, 3), [m]; none for a rod too short."""
    if shape.kind == "sphere":
        return T[:3, 3] + shape.size[0] * np.concatenate((_CIRCLE @ V[:2], V[2:]))
    points = shape.points if shape.points is not None else _CORNERS
    if shape.kind == "box":
        points = _CORNERS * shape.size
    elif shape.kind == "cylinder":
        radius, length = shape.size
        if length * np.linalg.norm(T[:3, 2]) < _SHORT * radius:  # T scales a rod along its joint
            return np.zeros((0, 3))
        ends = [np.insert(radius * _CIRCLE, 2, end, axis=1) for end in (-length / 2, length / 2)]
        points = np.concatenate(ends)
    return np.asarray(points @ T[:3, :3].T + T[:3, 3])
