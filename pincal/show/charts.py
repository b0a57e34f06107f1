"""Charts of a calibration: what a metrologist asks, each question drawn into axes once.

``Plots`` is the registry, and ``result.plot``: the command ``pincal plot`` draws these by name, the
report takes some of them. Residuals after the fit are drawn over their standard deviations there,
σ√(1−h) of leverage h.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from pincal.calibration.leg_result import IdentifiedParameter
from pincal.calibration.result import CalibrationResult
from pincal.design.platform_error import without_frames
from pincal.errors import MeasurementError, WorkspaceError
from pincal.kinematics.configurations import home_of, legs_at
from pincal.model.measurements import Plan
from pincal.model.setup import Image, image_of
from pincal.show.pictures.parts import (
    NORMAL,
    axis_name,
    draw_map,
    height_name,
    label,
    legend_beside,
    levels,
    marks,
    room,
    wrapped,
)
from pincal.show.pictures.picture import draw_scene
from pincal.show.series import noisy_series, observed_series
from pincal.show.style import EVERY, IDENTIFIED, INK, NOMINAL, OUTLIER
from pincal.show.view.scene import rounded_down, scene
from pincal.show.workspace_errors import bed, error_maps, moved_apart
from pincal.types import Array
from pincal.words.numbers import SMALL, STORED, per_si
from pincal.words.wording import clean
from pincal.workspace.criteria import in_workspace
from pincal.workspace.sampling import sample_configurations

_SAMPLES = 300  # of the workspace
_CELLS = 31  # of a bed, along each side
_BAR = 0.125  # height of a bar with its name, [inch]
_LEGEND = 0.35  # height of a legend of two lines, [inch]
#: Between which levels residuals lie if noise alone makes them.
_LEVEL = "95 %"
_NAMED = 6  # outliers that are named
_GAP = 0.08  # between images, of the widest
_ARROW = 0.07  # length of a typical large arrow, of the widest image
_LARGE = 0.9  # share of arrows that are shorter
_EXPECTED = f"expected error of position [{SMALL['m']}]"


def residuals(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw residuals after the calibration in standard deviations, against the row.

    Those of the legs or, if their readings are exact, of the platform as measured; dashed lines:
    between which 95 % are. Outliers are ringed; rows that were rejected are named.
    """
    for index, series in enumerate(noisy_series(result)):
        style, noisy = marks(index, of_leg=series.of_leg), series.sigma > 0.0
        points = series.rows[noisy] + 1, series.standardised[noisy]
        axes.plot(*points, **style, ls="", ms=3, label=label(series.name))
    levels(axes, NORMAL, _LEVEL)
    axes.set(xlabel="data row", ylabel=_residual(result))
    _mark_outliers(axes, result)
    _name_undrawn(axes, result)
    return legend_beside(axes)


def _mark_outliers(axes: Axes, result: CalibrationResult) -> None:
    """Ring outliers, cross rejected rows at the upper edge, and name the worst."""
    worst = _worst_of_rows(result)
    ring: dict[str, Any] = {"marker": "o", "ms": 8, "mfc": "none", "mew": 1.2}
    cross: dict[str, Any] = {"marker": "X", "ms": 6, "clip_on": False}
    for rank, outlier in enumerate(result.outliers):
        row, value = outlier.row + 1, float(worst[outlier.row])
        place, coordinates, style = (row, value), axes.transData, ring
        if not np.isfinite(value):
            place, coordinates, style = (row, 1.0), axes.get_xaxis_transform(), cross
        axes.plot(*place, color=OUTLIER, transform=coordinates, **style)
        if rank < _NAMED:
            offset: dict[str, Any] = {"xytext": (6, 2), "textcoords": "offset points"}
            axes.annotate(str(row), place, xycoords=coordinates, **offset, size=7)


def workspace(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw each row's largest residual where it was measured, x and y; outliers are ringed."""
    worst = np.abs(_worst_of_rows(result))
    positions = per_si("m", STORED) * result.poses[:, :2]
    known = np.isfinite(worst) & np.isfinite(positions).all(axis=1)
    x, y = positions[known].T
    points = axes.scatter(x, y, c=worst[known], s=26, cmap="cividis_r", vmin=0.0, vmax=4.0, lw=0)
    bar = axes.figure.colorbar(points, ax=axes, extend="max")
    bar.set_label(wrapped(f"largest {_residual(result)} of the row", room(axes)[1]))
    if rows := [outlier.row for outlier in result.outliers if outlier.row < len(positions)]:
        axes.plot(*positions[rows].T, "o", ms=9, mfc="none", mec=OUTLIER, mew=1.3, label="outlier")
        axes.legend()
    _name_undrawn(axes, result)
    axes.set(xlabel=axis_name("x"), ylabel=axis_name("y"), aspect="equal")
    return axes


class CameraResiduals(NamedTuple):
    """What a camera saw, and how far that is off."""

    name: str
    image: Image
    points: Array
    """Points as seen, from the upper left corner, shape (N, 2), [px]."""
    misses: Array
    """Predicted less seen, shape (N, 2), [px]."""
    size: Array
    """The larger of the two, standardised, shape (N,); NaN where nothing checks either."""


def camera_residuals(result: CalibrationResult) -> list[CameraResiduals]:
    """Return what each camera of a result saw, points of which both columns were measured."""
    by_name = {series.name: series for series in observed_series(result)}
    every_camera = []
    for camera in result.options.setup.instruments:
        if (image := image_of(camera)) is None:
            continue
        parts = []
        for pair in image.points.values():
            if not set(pair) <= set(by_name):
                continue
            right, down = (by_name[column] for column in pair)
            rows, i, j = np.intersect1d(right.rows, down.rows, return_indices=True)
            columns = (np.asarray(result.measurements.extra[column])[rows] for column in pair)
            misses = image.scale * np.stack((right.after[i], down.after[j]), axis=1)
            sizes = np.fmax(np.abs(right.standardised[i]), np.abs(down.standardised[j]))
            parts.append((image.at(*columns), misses, sizes))
        if parts:
            every_camera.append(
                CameraResiduals(camera.name, image, *map(np.concatenate, zip(*parts, strict=True)))
            )
    return every_camera


def images(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw residuals as arrows over the images of cameras, magnified, with their scale.

    Of instruments with an ``image`` (``pincal.Image``), side by side: from each point as seen
    towards where it is predicted, coloured by the residual over its standard deviation.

    Raises:
        MeasurementError: no camera measured.
    """
    if not (cameras := camera_residuals(result)):
        raise MeasurementError(
            f"{result.nominal.name}: no camera measured it: no instrument of the setup has an "
            "image; expected one with a pincal.Image as its 'image'"
        )
    sizes = np.array([view.image.size for view in cameras], dtype=np.float64)
    widest, highest = sizes.max(axis=0)
    gap = _GAP * widest
    step = np.array([widest + gap, highest + 2 * gap])
    columns = min(len(cameras), 2)
    lengths = np.concatenate([np.linalg.norm(view.misses, axis=1) for view in cameras])
    magnified = rounded_down(_ARROW * widest / max(float(np.quantile(lengths, _LARGE)), 1e-12))
    for index, (view, size) in enumerate(zip(cameras, sizes, strict=True)):
        corner = step * (index % columns, index // columns)
        axes.add_patch(Rectangle(tuple(corner), *size, fill=False, ec="0.6", lw=0.8))
        rms = float(np.sqrt((view.misses**2).sum(axis=1).mean()))
        title = f"{clean(view.name)}: {len(view.points)} points, {rms:.2g} px"
        axes.text(float(corner[0]), float(corner[1]) - 0.2 * gap, title, size=8, va="bottom")
        arrows = axes.quiver(
            *(corner + view.points).T,
            *(magnified * view.misses).T,
            np.where(np.isfinite(view.size), view.size, 0.0),
            cmap="cividis_r",
            clim=(0.0, 4.0),
            angles="xy",
            scale_units="xy",
            scale=1.0,
            width=0.0025,
        )
    low = -(-len(cameras) // columns) * step[1] - gap
    pixels = rounded_down(_ARROW * widest / magnified)
    axes.plot((0.0, magnified * pixels), (low, low), color=INK[0], lw=1.5, solid_capstyle="butt")
    key = f"  {pixels:g} px of residual, predicted less seen"
    axes.text(magnified * pixels, low, key, size=8, va="center")
    bar = axes.figure.colorbar(arrows, ax=axes, extend="max", shrink=0.8)
    bar.set_label(wrapped(f"larger {_residual(result)} of the point", 0.8 * room(axes)[1]))
    axes.set(xlim=(-0.02 * widest, columns * step[0] - gap + 0.02 * widest), aspect="equal")
    axes.set_ylim(low + 0.5 * gap, -gap)
    axes.set_axis_off()
    _name_undrawn(axes, result)
    return axes


def _worst_of_rows(result: CalibrationResult) -> Array:
    """Return the largest standardised residual of each row, signed, NaN where none is noisy."""
    series = noisy_series(result)
    rows = np.concatenate([residuals.rows for residuals in series])
    values = np.concatenate([residuals.standardised for residuals in series])
    order = np.argsort(np.where(np.isfinite(values), np.abs(values), -1.0), kind="stable")
    worst = np.full(len(result.measurements), np.nan)
    worst[rows[order]] = values[order]
    return worst


def _residual(result: CalibrationResult) -> str:
    """Return what a residual is divided by: σ√(1−h), or σ where old files hold no leverages."""
    known = all(series.redundancy is not None for series in noisy_series(result))
    return "residual / (σ√(1−h))" if known else "residual / σ"


def _name_undrawn(axes: Axes, result: CalibrationResult) -> None:
    """Say how many residuals nothing checks: they are not drawn."""
    unchecked = sum(
        int((~np.isfinite(series.standardised) & (series.sigma > 0.0)).sum())
        for series in noisy_series(result)
    )
    if unchecked:
        axes.set_title(f"{unchecked} not drawn: the fit follows them", fontsize=8)


def expected_errors(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw the expected error of the calibrated platform's position over x and y.

    The other coordinates are as at home; in space, z is in the middle of the workspace.

    Raises:
        MeasurementError: residuals are so large that no accuracy can be promised.
        WorkspaceError: no workspace was found with the default margins.
    """
    maps = error_maps(result)
    image = draw_map(axes, (maps.x, maps.y), per_si("m") * maps.after[..., 0])
    axes.figure.colorbar(image, ax=axes, label=wrapped(_EXPECTED, room(axes)[1]))
    axes.set(xlabel=axis_name("x"), ylabel=axis_name("y"), title=height_name(maps.height))
    return axes


def changes(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw what each parameter's change moves the platform by, over the workspace, and its ±.

    Root mean square of the position; bars end where the change does, thin lines are its 95 %.

    Raises:
        WorkspaceError: no workspace was found.
    """
    columns = legs_at(result.identified, sample_configurations(result.nominal, _SAMPLES))
    moved = without_frames(result.identified, columns.poses, columns.gain, result.frames_moved)
    gain = per_si("m") * moved[:, : result.nominal.platform.lengths]
    per_unit = np.sqrt((gain**2).sum(axis=1).mean(axis=0))  # of each parameter
    parameters = [p for leg in result.legs for p in leg.parameters]
    sizes = [
        (factor * abs(p.change), factor * p.half, p.id)
        for p, factor in zip(parameters, per_unit.tolist(), strict=True)
        if 0.0 < p.std < np.inf
    ]
    bars = sorted(sizes)[-int((room(axes)[1] - _LEGEND) / _BAR) :]
    changes, halves = np.array([bar[:2] for bar in bars]).T
    places, colours = np.arange(len(bars)), np.where(changes > halves, IDENTIFIED, NOMINAL).tolist()
    axes.barh(places, changes, color=colours, height=0.7)
    ends = np.minimum(halves, changes), halves
    axes.errorbar(changes, places, xerr=ends, fmt="none", ecolor=EVERY, elinewidth=0.8, capsize=2)
    axes.set_yticks(places, [label(name) for *_, name in bars], fontsize=7)
    axes.set_xlabel(f"moves the platform by [{SMALL['m']}]")
    keys = ((IDENTIFIED, "changed by more than its ±"), (NOMINAL, "by less"))
    handles = [Patch(color=colour, label=text) for colour, text in keys]
    axes.legend(handles=handles, loc="lower right")
    axes.set_xlim(left=0.0)
    legend = _LEGEND * (len(bars) + 1.0) / (room(axes)[1] - _LEGEND)  # in bars
    axes.set_ylim(-0.7 - legend, len(bars) - 0.4)
    if len(sizes) > len(bars):
        axes.set_title(f"the {len(bars)} largest of {len(sizes)}", fontsize=8)
    return axes


def bed_heights(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw by how much the nominal model misses z over the bed of a printer.

    At home's height, at which printers probe. Where frames were fixed by choice, less what motions
    of these explain.

    Raises:
        WorkspaceError: a machine without x, y and z, or no workspace at that height.
    """
    machine, platform = result.begun, result.nominal.platform
    if platform.coordinates[:3] != ("x", "y", "z"):
        raise WorkspaceError(f"{machine.name}: a bed needs a platform that moves in x, y and z")
    if machine.by_readings:
        raise WorkspaceError(f"{machine.name}: its poses follow from readings, so no bed is drawn")
    samples = sample_configurations(result.nominal, 1000).poses
    x, y, poses = bed(machine, samples, _CELLS)
    inside = in_workspace(result.nominal, poses)
    if not inside.any():
        raise WorkspaceError(f"{machine.name}: no workspace at the height of home")
    heights = np.full(len(poses), np.nan)
    heights[inside] = per_si("m") * moved_apart(result, machine, Plan(poses[inside]))[:, 2]
    largest = float(np.nanmax(np.abs(heights)))
    image = draw_map(axes, (x, y), heights.reshape(_CELLS, _CELLS), (-largest, largest))
    image.set_cmap("RdBu_r")
    name = wrapped(f"z, true less commanded [{SMALL['m']}]", room(axes)[1])
    axes.figure.colorbar(image, ax=axes, label=name)
    axes.set(xlabel=axis_name("x"), ylabel=axis_name("y"))
    return axes


#: Changes over ± from which a colour is used, with what it says.
LEVELS = (
    (0.0, NOMINAL, "changed by less than its ±"),
    (1.0, "#7352e8", "by 1 to 5 times its ±"),
    (5.0, IDENTIFIED, "by more than 5 times its ±"),
)


def colour_of(p: IdentifiedParameter) -> str:
    """Return the colour of a parameter by its change over half its 95 % interval."""
    if not np.isfinite(p.half) or p.half <= 0.0:
        return INK[0]
    return [colour for least, colour, _ in LEVELS if abs(p.change) >= least * p.half][-1]


def dimensioned(axes: Axes, result: CalibrationResult, leg: str = "") -> Axes:
    """Draw the nominal mechanism, dimensions of a leg in the colours of their changes."""
    mechanism = result.nominal
    name = leg or mechanism.leg_names[0]
    colours = {p.name: colour_of(p) for p in result.leg(name).parameters}
    return draw_scene(axes, scene(mechanism, home_of(mechanism)), 0, name, colours)


def _chart(
    draw: Callable[[Axes, CalibrationResult], Axes], width: float = 6.4, height: float = 3.6
) -> Callable[..., Axes]:
    """Return a method of ``Plots`` that draws a chart into axes.

    Args:
        draw: The chart.
        width: Of the figure that is made where no axes are given, [inch].
        height: Of the same.
    """

    def method(self: Plots, ax: Axes | None = None) -> Axes:
        return draw(ax or Figure((width, height), layout="compressed").subplots(), self.result)

    method.__name__, method.__doc__ = draw.__name__, draw.__doc__
    return method


@dataclass(frozen=True)
class Plots:
    """Charts of a result, as ``result.plot``: each returns its axes, those given or new ones."""

    result: CalibrationResult

    residuals = _chart(residuals)
    workspace = _chart(workspace, 5.0, 4.2)
    images = _chart(images)
    parameters = _chart(changes, 6.4, 4.6)
    error_map = _chart(expected_errors, 5.0, 4.2)
    bed = _chart(bed_heights, 5.0, 4.2)

    def drawing(self, ax: Axes | None = None, leg: str = "") -> Axes:
        """Draw a leg with its dimensions, lines in the colours of changes over their ±.

        Args:
            ax: Where to draw.
            leg: Name of the leg, the first if not given.

        Raises:
            MechanismError: no such leg.
        """
        axes = ax or Figure((6.4, 5.0), layout="compressed").subplots()
        return dimensioned(axes, self.result, leg)
