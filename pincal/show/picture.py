"""``pincal.picture``: a view's scene as a flat picture, for pages that nothing moves on.

Mechanisms in a plane are seen from above, others from the side, in parallel projection.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import cycle
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform

from pincal.errors import MeasurementError
from pincal.model.measurements import EVERY_LEG, Plan
from pincal.model.mechanism import Mechanism
from pincal.show.looks import (
    ACTIVE,
    CARRIED,
    DOMAIN,
    GROUND,
    IDENTIFIED,
    PASSIVE,
    TOWARDS_VIEWER,
    frame_axes,
    grid_step,
    ground,
    set_colour,
)
from pincal.show.markup import clean
from pincal.show.painting import paint, placed
from pincal.show.picture_files import figure_bytes, save_figure
from pincal.show.plots import MARKERS
from pincal.show.scene import MAGNIFY, Scene, plan_of, scene
from pincal.show.svg import drawing

Array = NDArray[np.float64]
_WIDTH = 5.2  # of a figure, [inch]
_BELOW = 0.5  # for the legend, [inch]
_LEAST_HEIGHT, _MOST_HEIGHT = 1.8, 6.0
_LONGEST, _LINE = 28, 75  # letters of a name, and of a legend's line
_EDGE = 0.0025  # thickness of outlines, of the scene's diagonal


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture of a scene: the mechanism at one pose, all other poses as faint lines."""

    scene: Scene
    row: int = 0
    """Which pose the mechanism is drawn at."""

    def draw(self, axes: Axes) -> Axes:
        """Draw into axes; as its makers meant it, inside ``pincal.show.svg.drawing()``."""
        return _draw(axes, self.scene, self.row)

    def figure(self) -> Figure:
        """Return a figure of its own."""
        with drawing():
            low, high = _extent(self.scene, self.row)
            width, height = high - low
            inches = _BELOW + np.clip(_WIDTH * height / width, _LEAST_HEIGHT, _MOST_HEIGHT)
            figure = Figure(figsize=(_WIDTH, float(inches)), layout="constrained")
            self.draw(figure.subplots())
        return figure

    def save(self, path: str | Path, *, force: bool = False) -> Path:
        """Write the picture as .svg, .png or .pdf, whole or not at all, and return its path.

        The same picture gives the same bytes.

        Raises:
            FileError: the name ends otherwise, or the file exists and ``force`` is not set, or
                it cannot be written.
        """
        return save_figure(self.figure(), path, force=force)

    def _repr_png_(self) -> bytes:
        """Return the picture for notebooks."""
        return figure_bytes(self.figure(), "png")


def picture(
    mechanism: Mechanism,
    poses: Plan | ArrayLike | RigidTransform | None = None,
    *,
    row: int = 0,
    workspace: ArrayLike | None = None,
    identified: Mechanism | None = None,
    magnify: float = MAGNIFY,
) -> Picture:
    """Return a picture of a mechanism: ``save(path)``, ``figure()``, ``draw(axes)``.

    What ``view`` shows, without a browser: mechanisms in a plane from above, others from the
    side.

    Args:
        mechanism: The mechanism, at its nominal parameters.
        poses: As for ``view``; home if not given.
        row: Which of them the mechanism is drawn at; all others are faint lines, by set.
        workspace: As for ``view``.
        identified: The calibrated mechanism, drawn over the nominal one.
        magnify: Factor on what differs between its parameters and the nominal ones.

    Raises:
        MechanismError: poses of a wrong shape, or not finite; an identified mechanism that
            is not one of this mechanism.
        MeasurementError: no poses, too many or not whole, no such row; a workspace of a wrong
            shape; a factor that is not positive.
    """
    plan = plan_of(mechanism, [mechanism.platform.home] if poses is None else poses)
    if not 0 <= row < max(len(plan.poses), 1):
        raise MeasurementError(
            f"pose {row + 1} is not among the poses; expected 1 to {len(plan.poses)}"
        )
    cloud = None if workspace is None else np.asarray(workspace, np.float64)
    return Picture(scene(mechanism, plan, cloud, identified, magnify), row)


def _axes_of_view(planar: bool) -> Array:
    """Return what points right, up and towards the viewer, shape (3, 3), rows in the base frame."""
    if planar:
        return np.eye(3)
    towards = np.array(TOWARDS_VIEWER) / np.linalg.norm(TOWARDS_VIEWER)
    right = np.cross([0.0, 0.0, 1.0], towards)
    right /= np.linalg.norm(right)
    return np.stack((right, np.cross(towards, right), towards))


def _extent(scene: Scene, row: int) -> Array:
    """Return the least and largest of what is seen, right and up, shape (2, 2), [m]."""
    V = _axes_of_view(scene.planar)
    tips = np.array([2 * axis.T_link_shape[:3, 3] for axis in frame_axes(scene)])
    T_base_platform = scene.body.placements[row, scene.body.part("platform/body")]
    points = np.concatenate(
        (scene.points(), tips @ T_base_platform[:3, :3].T + T_base_platform[:3, 3])
    )
    low, high = np.nanmin(points @ V[:2].T, axis=0), np.nanmax(points @ V[:2].T, axis=0)
    margin = 0.06 * float(np.max(high - low))
    return np.stack((low - margin, high + margin))


def _draw(axes: Axes, scene: Scene, row: int) -> Axes:
    """Draw a scene, the mechanism at one of its poses."""
    V = _axes_of_view(scene.planar)
    low, high = _extent(scene, row)
    edge = _EDGE * float(np.linalg.norm(high - low))
    axes.add_collection(
        LineCollection(list(ground(scene) @ V[:2].T), colors=GROUND, lw=0.5, zorder=0)
    )
    legend = [Line2D([], [], color=GROUND, lw=0.8, label=f"grid {1e3 * grid_step(scene):.6g} mm")]
    if scene.cloud:
        colours = np.where(scene.cloud.domain, DOMAIN, CARRIED)
        at, up = (scene.cloud.positions @ V[:2].T).T
        axes.scatter(at, up, s=1.5, c=colours.tolist(), lw=0, zorder=0.3, rasterized=True)
    if len(scene.plan.poses) > 1:
        legend += _ghosts(axes, scene, V)
    frame = frame_axes(scene)
    shapes = [(shape, np.eye(4)) for shape in frame]
    T_base_platform = scene.body.placements[row, scene.body.part("platform/body")]
    shapes += [(shape, T_base_platform) for shape in frame]
    paint(axes, [*shapes, *placed(scene.body, row)], V, edge)
    if scene.identified:
        paint(axes, placed(scene.identified.body, row), V, edge, IDENTIFIED)
        label = f"identified, errors × {scene.identified.magnify:g}"
        legend.append(_dot(IDENTIFIED, label))
    legend += [_dot(ACTIVE, "active joint"), _dot(PASSIVE, "passive joint")]
    _name_legs(axes, scene, V, (low + high) / 2)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.set_axis_off()
    axes.legend(
        handles=legend,
        loc="upper center",
        bbox_to_anchor=(0.5, 0.0),
        ncols=int(np.clip(_LINE / max(len(str(one.get_label())) for one in legend), 1, 3)),
        frameon=False,
        handlelength=1.2,
        columnspacing=1.4,
    )
    return axes


def _dot(colour: str, label: str, marker: str = "o") -> Line2D:
    """Return a legend's line: a dot and its meaning."""
    return Line2D([], [], marker=marker, ls="", ms=5, color=colour, label=label)


def _short(name: str) -> str:
    """Return a name, its middle left out where there is no room for it."""
    return clean(name if len(name) <= _LONGEST else f"{name[: _LONGEST - 9]}…{name[-8:]}")


def _ghosts(axes: Axes, scene: Scene, V: Array) -> list[Line2D]:
    """Draw all poses as lines from joint to joint, by set, and return their legend."""
    skeletons = scene.body.skeletons() @ V[:2].T
    at = scene.body.placements[:, scene.body.part("platform/body"), :3, 3] @ V[:2].T
    faint = float(np.clip(8 / len(at), 0.12, 0.5))
    legend = []
    for name, marker in zip(dict.fromkeys(scene.sets), cycle(MARKERS), strict=False):
        own = np.array(scene.sets) == name
        colour = set_colour(scene, name)
        lines = skeletons[own].reshape(-1, 2, 2)
        lines = lines[np.isfinite(lines).all(axis=(1, 2))]
        axes.add_collection(
            LineCollection(list(lines), colors=colour, lw=0.7, alpha=faint, zorder=0.5)
        )
        axes.plot(*at[own].T, marker, ms=3, color=colour, zorder=0.6)
        whose = f" for {_short(name)}" if name not in ("", EVERY_LEG) else ""
        count = f"{own.sum()} pose{'s' if own.sum() > 1 else ''}"
        legend.append(_dot(colour, f"{count}{whose}", marker))
    return legend


def _name_legs(axes: Axes, scene: Scene, V: Array, middle: Array) -> None:
    """Write the legs' names at their feet, away from the mechanism."""
    feet = np.array([leg.joints[0].placement.xyz for leg in scene.mechanism.legs]) @ V[:2].T
    outward = feet - middle
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-12)
    for leg, foot, (right, up) in zip(scene.mechanism.legs, feet, outward.tolist(), strict=True):
        axes.annotate(
            _short(leg.name),
            (float(foot[0]), float(foot[1])),
            xytext=(13 * right, 13 * up),
            textcoords="offset points",
            ha="center" if abs(right) < 0.4 else "left" if right > 0 else "right",
            va="center" if abs(up) < 0.4 else "bottom" if up > 0 else "top",
            size=8,
        )
