"""Charts of residuals after the fit, each over its standard deviation there, σ√(1−h) of leverage h.

Over rows, workspace, time and images. Every function draws into axes and returns them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from pincal.calibration.fits import Fits, Near, fitted
from pincal.calibration.result import CalibrationResult
from pincal.errors import MeasurementError
from pincal.estimation.blocks.state import State
from pincal.estimation.residuals.redundancy import Remainders, every_residual
from pincal.model.setup import Camera
from pincal.show.pictures.parts import (
    NORMAL,
    axis_name,
    label,
    legend_beside,
    levels,
    marks,
    room,
    wrapped,
)
from pincal.show.result_tables import CONTROLLED, Series, noisy_series, observed_series
from pincal.show.style import INK, OUTLIER
from pincal.types import Array, Index
from pincal.words.numbers import STORED, per_si
from pincal.words.wording import clean

#: Between which levels residuals lie if noise alone makes them.
LEVEL = "95 of 100"
ROW = "data row"
_REJECTED = 12  # rows that a title names
_NAMED = 6  # outliers that are named
_TENTHS = 10  # parts of a run
_GAP = 0.08  # between images, of the widest
_ARROW = 0.07  # length of a typical large arrow, of the widest image
_LARGE = 0.9  # share of arrows that are shorter


def residuals(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw residuals after the calibration in standard deviations, against the row.

    Those of the legs or, if their readings are exact, of the platform as measured. A residual's
    standard deviation is that of its noise less what the fit takes up of it, σ√(1−h) of its
    leverage h: one that shares what is missed with others is judged as hard as any. Dashed
    lines: between which 95 of 100 are. Outliers are ringed; rows that were rejected are named.
    """
    for index, series in enumerate(noisy_series(result)):
        style, noisy = marks(index, of_leg=series.of_leg), series.sigma > 0.0
        points = series.rows[noisy] + 1, series.standardised[noisy]
        axes.plot(*points, **style, ls="", ms=3, label=label(series.name))
    levels(axes, NORMAL, LEVEL)
    axes.set(xlabel=ROW, ylabel=_residual(result))
    _mark_outliers(axes, result)
    _name_undrawn(axes, result)
    return legend_beside(axes)


def _mark_outliers(axes: Axes, result: CalibrationResult) -> None:
    """Ring outliers, cross rejected rows at the upper edge, and name the worst."""
    worst = np.full(len(result.measurements), np.nan)
    for series in noisy_series(result):
        larger = ~(np.abs(worst[series.rows]) >= np.abs(series.standardised))
        worst[series.rows[larger]] = series.standardised[larger]
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
    worst, positions = _worst_of_rows(result), per_si("m", STORED) * result.poses[:, :2]
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


def time(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw the means of residuals over the run, in their standard errors, by tenths of the rows.

    Standard errors are those after the fit, which has taken up its part of what all rows of a
    tenth share; so it is made once more, from where it ended. What drifts leaves ±1.96. Over
    the column ``time`` if measurements have one.
    """
    rows = np.arange(len(result.measurements), dtype=np.float64)
    column = dict(result.measurements.influences or {}).get("time")
    times = rows + 1.0 if column is None else np.asarray(column, dtype=np.float64)
    kinds = _residual_kinds(result)
    for index, series in enumerate(noisy_series(result)):
        noisy = np.flatnonzero(series.sigma > 0.0)
        order = noisy[np.argsort(times[series.rows[noisy]], kind="stable")]
        parts = [part for part in np.array_split(order, _TENTHS) if len(part)]
        means = [kinds[series.of_leg, series.name].mean(series, part) for part in parts]
        middles = [times[series.rows[part]].mean() for part in parts]
        style = marks(index, of_leg=series.of_leg)
        axes.plot(middles, means, **style, ms=4, lw=1, label=label(series.name))
    axes.axhspan(-NORMAL, NORMAL, color="0.92", zorder=0, label=LEVEL)
    axes.axhline(0.0, color="0.5", lw=0.8)
    axes.set_xlabel(ROW if column is None else "time, in the unit of its column")
    axes.set_ylabel(wrapped("mean residual / its standard error", room(axes)[1]))
    _name_undrawn(axes, result)
    return legend_beside(axes)


class CameraResiduals(NamedTuple):
    """What a camera saw, and how far that is off."""

    camera: Camera
    points: Array
    """Points as seen, from the upper left corner, shape (N, 2), [px]."""
    misses: Array
    """Predicted less seen, shape (N, 2), [px]."""
    size: Array
    """The larger of the two, standardised, shape (N,); NaN where nothing checks either."""


def camera_residuals(result: CalibrationResult) -> list[CameraResiduals]:
    """Return what each camera of a result saw; empty if none measured."""
    by_name = {series.name: series for series in observed_series(result)}
    every_camera = []
    for camera in result.options.setup.instruments:
        if not isinstance(camera, Camera):
            continue
        pairs = camera.image.points.values()
        parts = [
            _point_residuals(camera, by_name[u], by_name[v], result.measurements.extra, (u, v))
            for u, v in pairs
            if u in by_name and v in by_name
        ]
        if parts:
            columns = (np.concatenate(column) for column in zip(*parts, strict=True))
            every_camera.append(CameraResiduals(camera, *columns))
    return every_camera


def _point_residuals(
    camera: Camera, right: Series, down: Series, extra: Any, pair: tuple[str, str]
) -> tuple[Array, Array, Array]:
    """Return places, errors and sizes of a point where both of its columns were measured."""
    rows, first, second = np.intersect1d(right.rows, down.rows, return_indices=True)
    points = camera.image.at(*(np.asarray(extra[column])[rows] for column in pair))
    misses = camera.image.scale * np.stack((right.after[first], down.after[second]), axis=1)
    return points, misses, np.fmax(*np.abs((right.standardised[first], down.standardised[second])))


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
    sizes = np.array([view.camera.image.size for view in cameras], dtype=np.float64)
    widest, highest = sizes.max(axis=0)
    gap = _GAP * widest
    step = np.array([widest + gap, highest + 2 * gap])
    width, height = room(axes)
    columns = _image_columns(len(cameras), step[0] / step[1], width / height)
    lengths = np.concatenate([np.linalg.norm(view.misses, axis=1) for view in cameras])
    magnified = _round_below(_ARROW * widest / max(float(np.quantile(lengths, _LARGE)), 1e-12))
    for index, (view, size) in enumerate(zip(cameras, sizes, strict=True)):
        corner = step * (index % columns, index // columns)
        axes.add_patch(Rectangle(tuple(corner), *size, fill=False, ec="0.6", lw=0.8))
        rms = float(np.sqrt((view.misses**2).sum(axis=1).mean()))
        title = f"{clean(view.camera.name)}: {len(view.points)} points, {rms:.2g} px"
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
    pixels = _round_below(_ARROW * widest / magnified)
    axes.plot((0.0, magnified * pixels), (low, low), color=INK[0], lw=1.5, solid_capstyle="butt")
    key = f"  {pixels:g} px of residual, predicted less seen"
    axes.text(magnified * pixels, low, key, size=8, va="center")
    bar = axes.figure.colorbar(arrows, ax=axes, extend="max", shrink=0.8)
    bar.set_label(wrapped(f"larger {_residual(result)} of the point", 0.8 * height))
    axes.set(xlim=(-0.02 * widest, columns * step[0] - gap + 0.02 * widest), aspect="equal")
    axes.set_ylim(low + 0.5 * gap, -gap)
    axes.set_axis_off()
    _name_undrawn(axes, result)
    return axes


def _image_columns(count: int, image: float, axes: float) -> int:
    """Return how many images are side by side so that they are largest, of the shapes' ratios."""

    def size(columns: int) -> float:
        return min(axes / (columns * image), 1.0 / -(-count // columns))

    return max(range(1, count + 1), key=size)


def _round_below(value: float) -> float:
    """Return the largest of 1, 2, 5, 10, … that is not above a value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(k for k in (1.0, 2.0, 5.0) if k * power <= value * (1 + 1e-9)))


def _worst_of_rows(result: CalibrationResult) -> Array:
    """Return the largest standardised residual of each row, NaN where none is noisy."""
    worst = np.full(len(result.measurements), np.nan)
    for series in noisy_series(result):
        np.fmax.at(worst, series.rows, np.abs(series.standardised))
    return worst


def _residual(result: CalibrationResult) -> str:
    """Return what a residual is divided by: σ√(1−h), or σ where old files hold no leverages."""
    known = all(series.redundancy is not None for series in noisy_series(result))
    return "residual / (σ√(1−h))" if known else "residual / σ"


def _name_undrawn(axes: Axes, result: CalibrationResult) -> None:
    """Say which rows were rejected, and how many residuals nothing checks: neither is drawn."""
    worst, lines = _worst_of_rows(result), []
    outliers = (outlier.row for outlier in result.outliers)
    if rows := sorted({row for row in outliers if not np.isfinite(worst[row])}):
        names = ", ".join(str(row + 1) for row in rows[:_REJECTED])
        dots = " …" if len(rows) > _REJECTED else ""
        lines.append(f"rejected, not drawn: rows {names}{dots}")
    unchecked = sum(
        int((~np.isfinite(series.standardised) & (series.sigma > 0.0)).sum())
        for series in noisy_series(result)
    )
    if unchecked:
        lines.append(f"{unchecked} not drawn: the fit follows them")
    if lines:
        axes.set_title("\n".join(lines), fontsize=8)


class _ResidualKind(NamedTuple):
    """What a fit leaves of the residuals of a leg, or of a measured quantity."""

    projection: Remainders
    rows: Index
    """Rows of the measurements, ascending, shape (N,)."""
    scale: float
    """Factor on the noise, where it was estimated."""

    def mean(self, series: Series, part: Index) -> float:
        """Return a sum of residuals over its standard deviation; NaN if nothing checks it.

        Args:
            series: The residuals.
            part: Places of those that are summed.
        """
        factors = np.zeros(self.projection.noise.shape[:2])
        first = np.searchsorted(series.rows, series.rows[part])  # of the row's equations
        places = np.searchsorted(self.rows, series.rows[part]), part - first
        factors[places] = 1.0 / series.sigma[part]
        variance = self.scale**2 * self.projection.of_sum(factors)
        if variance < CONTROLLED * len(part):
            return float("nan")
        return float((series.after[part] / series.sigma[part]).sum() / np.sqrt(variance))


def _residual_kinds(result: CalibrationResult) -> dict[tuple[bool, str], _ResidualKind]:
    """Return what the fit leaves, by whether it is of a leg, and its name."""
    kinds = {}
    for fit in _refit(result).fits:
        problem = fit.problem
        _, follows, columns = every_residual(fit)
        projection = Remainders.of(fit, follows)
        named = [
            ((True, leg.name), column) for leg, column in zip(problem.legs, columns, strict=False)
        ]
        if problem.latent:
            places = range(columns[-1].start, columns[-1].stop)
            names = zip(problem.observation.names, places, strict=True)
            named += [((False, name), slice(place, place + 1)) for name, place in names]
        for key, column in named:
            kinds[key] = _ResidualKind(projection.part(column), fit.rows, fit.noise_scale)
    return kinds


def _refit(result: CalibrationResult) -> Fits:
    """Return the fits of a result, begun where they ended."""
    calibration, poses, near = result.calibration, result.estimated_poses, None
    if poses is not None:
        values = np.concatenate([leg.identified for leg in result.legs])
        matrices = result.nominal.platform.matrices(poses)
        external = result.outside or calibration.observation.external.start
        near = Near(State(values, matrices, external=external))
    return fitted(calibration, near=near)
