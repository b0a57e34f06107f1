"""Plots of mechanisms, selected poses, observability and results, for paper and screen.

Every function draws into matplotlib axes and returns them. Legs differ in colour and in
marker or hatch, so that plots read in black and white and in colour-blindness.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from numpy.typing import NDArray

from pincal.calibration.result import CalibrationResult
from pincal.design.select import Selection
from pincal.errors import MeasurementError, WorkspaceError
from pincal.kinematics.inverse import inverse
from pincal.kinematics.readers import skeleton
from pincal.model.measurements import EVERY_LEG, Plan
from pincal.model.mechanism import Mechanism
from pincal.show.results import noisy_series
from pincal.show.results import parameters as parameters_of
from pincal.show.style import MANY, look
from pincal.show.workspace_errors import error_maps
from pincal.words.numbers import SMALL

Array = NDArray[np.float64]
_MANY_NAMES = 14  # that do not fit side by side
#: Light enough for black lines; brighter is more, in black and white too.
_LIGHT = ListedColormap(colormaps["cividis"](np.linspace(0.35, 1.0, 128)))


@dataclass(frozen=True)
class Plots:
    """Plots of a result, as ``result.plot``: each draws into axes, or new ones."""

    result: CalibrationResult

    def residuals(self, ax: Axes | None = None) -> Axes:
        """Draw residuals in standard deviations, against the row."""
        return residuals(self.result, ax)

    def parameters(self, ax: Axes | None = None) -> Axes:
        """Draw the change of each parameter over its 95 % half width."""
        return parameters(self.result, ax)

    def error_map(self, ax: Axes | None = None) -> Axes:
        """Draw the expected error of position over the workspace."""
        return error_map(self.result, ax)

    def correlation(self, ax: Axes | None = None) -> Axes:
        """Draw the correlations of all identified parameters."""
        return correlation(self.result, ax)


def axes_of(ax: Axes | None, width: float = 6.4, height: float = 3.6) -> Axes:
    """Return axes to draw into, of a new figure if none are given, [inch]."""
    if ax is not None:
        return ax
    return Figure(figsize=(width, height), layout="constrained").subplots()


def residuals(result: CalibrationResult, ax: Axes | None = None) -> Axes:
    """Draw residuals after the calibration in standard deviations, against the row.

    Those of the legs or, if their readings are exact, of the platform as measured. Dashed lines:
    where 95 of 100 are expected by the noise.
    """
    axes = axes_of(ax)
    for index, one in enumerate(noisy_series(result)):
        noisy = one.sigma > 0.0
        rows, values = one.rows[noisy] + 1, one.after[noisy] / one.sigma[noisy]
        colour, marker, _ = look(index)
        axes.plot(rows, values, marker, color=colour, ms=3, label=shown_label(one.name))
    for level in (-1.96, 0.0, 1.96):
        axes.axhline(level, color="0.5", lw=0.8, ls="--" if level else "-", zorder=0)
    axes.set(xlabel="data row", ylabel="residual [σ]")
    axes.legend(fontsize=8)
    return axes


def parameters(result: CalibrationResult, ax: Axes | None = None) -> Axes:
    """Draw the change of each parameter from nominal over its 95 % half width, fixed ones not.

    Bars longer than 1 are changes that the measurements show.
    """
    axes = axes_of(ax)
    values: dict[str, dict[str, float]] = {leg.name: {} for leg in result.legs}
    for leg, p in parameters_of(result):
        if p.high > p.low:
            values[leg.name][p.name] = 2 * (p.identified - p.nominal) / (p.high - p.low)
    draw_bars(axes, values)
    for level in (-1.0, 0.0, 1.0):
        axes.axhline(level, color="0.5", lw=0.8, ls="--" if level else "-", zorder=0)
    axes.set_ylabel("change / half width of 95 % interval")
    return axes


def error_map(result: CalibrationResult, ax: Axes | None = None) -> Axes:
    """Draw the expected error of the calibrated platform's position over x and y [mm].

    The other coordinates are as at home; in space, z is in the middle of the workspace.

    Raises:
        MeasurementError: residuals are so large that no accuracy can be promised.
        WorkspaceError: no workspace was found with the default margins.
    """
    if not result.explained:
        raise MeasurementError(
            f"{result.nominal.name}: residuals are {result.excess:.3g} times as large as the noise "
            "given makes them, so no accuracy can be promised and none is drawn"
        )
    maps = error_maps(result)
    if maps is None:
        raise WorkspaceError(f"{result.nominal.name}: no workspace was found to draw errors over")
    axes = axes_of(ax, 5.0, 4.2)
    middle = len(maps.heights) // 2
    image = draw_map(axes, (maps.x, maps.y), 1e3 * maps.after[middle, ..., 0])
    axes.figure.colorbar(image, ax=axes, label="expected error of position [mm]")
    height = maps.heights[middle]
    axes.set(xlabel="x [m]", ylabel="y [m]", title="" if height is None else f"z = {height:.3g} m")
    return axes


def correlation(result: CalibrationResult, ax: Axes | None = None) -> Axes:
    """Draw the correlations of all parameters that were identified."""
    std = np.sqrt(np.diagonal(result.covariance))
    free = np.flatnonzero(np.isfinite(std) & (std > 0.0))
    axes = axes_of(ax, 5.4, 4.8)
    rho = result.covariance[np.ix_(free, free)] / np.outer(std[free], std[free])
    image = axes.imshow(rho, vmin=-1.0, vmax=1.0, cmap="RdBu_r")
    axes.figure.colorbar(image, ax=axes, label="correlation")
    ids = [p.id for _, p in parameters_of(result)]
    size = float(np.clip(300 / max(len(free), 1), 2, 8))
    places, names = range(len(free)), [ids[i] for i in free]
    axes.set_xticks(places, names, rotation=90, fontsize=size)
    axes.set_yticks(places, names, fontsize=size)
    return axes


def draw_map(
    axes: Axes, over: tuple[Array, Array], values: Array, limits: tuple[float, float] | None = None
) -> AxesImage:
    """Draw values over x and y, shape (n_y, n_x), with lines of equal value; return the image.

    Args:
        axes: Where to draw.
        over: Coordinates x and y, shapes (n_x,) and (n_y,), [m].
        values: NaN where there is none.
        limits: Of the colours; those of the values if not given.
    """
    x, y = over
    half = [(own[1] - own[0]) / 2 for own in over]
    extent = (x[0] - half[0], x[-1] + half[0], y[0] - half[1], y[-1] + half[1])
    low, high = limits or (float(np.nanmin(values)), float(np.nanmax(values)))
    image = axes.imshow(values, origin="lower", extent=extent, vmin=low, vmax=high, cmap=_LIGHT)
    known = values[np.isfinite(values)]
    levels = np.quantile(known, (0.25, 0.5, 0.75)) if known.size else np.zeros(3)
    if (np.diff(levels) > 1e-6 * levels[-1]).all():
        masked = np.ma.masked_invalid(values)
        lines = axes.contour(x, y, masked, levels, colors="black", linewidths=0.7)
        axes.clabel(lines, fmt="%.2g", fontsize=6.5)
    return image


def draw_mechanism(axes: Axes, mechanism: Mechanism, pose: Array | None = None) -> Axes:
    """Draw a planar mechanism at a pose, shape (dof,), seen from above; home if not given.

    Raises:
        MechanismError: the pose has a wrong shape.
    """
    platform = mechanism.platform
    poses = np.array([platform.home]) if pose is None else np.asarray(pose, float)[None]
    solution = inverse(mechanism, poses)
    corners = []
    for index, leg in enumerate(mechanism.legs):
        if not solution.reached[0, index]:
            continue
        points = skeleton(leg, solution.joints[leg.name][0])
        colour = look(index).colour
        axes.plot(points[:, 0], points[:, 1], "-", color=colour, lw=2.5, zorder=2)
        axes.plot(*points[0, :2], "s", color=colour, ms=9, zorder=3)
        axes.plot(*points[1:, :2].T, "o", color="white", mec=colour, ms=6, zorder=3)
        base = (float(points[0, 0]), float(points[0, 1]))
        axes.annotate(leg.name, base, xytext=(6, -14), textcoords="offset points", size=8)
        corners.append(points[-1, :2])
    if len({tuple(c.round(9)) for c in corners}) > 2:
        axes.fill(*np.array(corners).T, color="0.5", alpha=0.4, zorder=1)
    axes.margins(0.18)
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    return axes


def draw_poses(
    axes: Axes, mechanism: Mechanism, plan: Plan, candidates: Array | None = None
) -> Axes:
    """Draw poses of a plan by set, over candidates; a stroke shows the orientation."""
    if candidates is not None:
        axes.plot(*candidates[:, :2].T, ",", color="0.8", zorder=0)
    size = 0.05 * float(np.ptp(plan.poses[:, :2], axis=0).max())
    for index, name, own in by_set(mechanism, plan):
        draw_set(axes, index, name, own[:, :2])
        if "phi" in mechanism.platform.coordinates:
            end = own[:, :2] + size * np.stack((np.cos(own[:, 2]), np.sin(own[:, 2])), axis=1)
            strokes = list(np.stack((own[:, :2], end), axis=1))
            colour = look(index).colour
            axes.add_collection(LineCollection(strokes, colors=colour, lw=0.8, zorder=2))
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.legend(fontsize=8, framealpha=0.9, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return axes


def by_set(mechanism: Mechanism, plan: Plan) -> list[tuple[int, str, Array]]:
    """Return the poses of each set that has some, with its number for looks and its name."""
    sets = plan.sets or (EVERY_LEG,) * len(plan.poses)
    names = enumerate((*mechanism.leg_names, EVERY_LEG))
    found = [(i, name, plan.poses[[s == name for s in sets]]) for i, name in names]
    return [one for one in found if len(one[2])]


def draw_set(axes: Axes, index: int, name: str, places: Array) -> None:
    """Draw the poses of a set, shape (n, 2), with its label."""
    colour, marker, _ = look(index)
    label = "every leg" if name == EVERY_LEG else f"set {name}"
    many = len(places) > MANY
    axes.plot(*places.T, marker, color=colour, ms=4, label=label, zorder=2, rasterized=many)


def draw_observability(axes: Axes, mechanism: Mechanism, selection: Selection) -> Axes:
    """Draw |R_ii| of each parameter and leg (3-RRR paper, Fig. 9)."""
    values = {
        leg.leg: dict(
            zip(mechanism.leg(leg.leg).parameter_names, leg.r_diagonal.tolist(), strict=True)
        )
        for leg in selection.legs
    }
    draw_bars(axes, values).set_ylabel("observability |R_ii| [rad/unit]")
    return axes


def draw_bars(axes: Axes, values: Mapping[str, Mapping[str, float]]) -> Axes:
    """Draw bars of several series side by side, by series, then by name."""
    names = list(dict.fromkeys(name for series in values.values() for name in series))
    width = 0.8 / len(values)
    for index, (label, series) in enumerate(values.items()):
        places = np.array([names.index(name) for name in series])
        colour, _, hatch = look(index)
        axes.bar(
            places + (index - (len(values) - 1) / 2) * width,
            list(series.values()),
            width,
            label=shown_label(label),
            color=colour,
            hatch=hatch,
            edgecolor="white",
        )
    name_places(axes, names)
    axes.legend(fontsize=8)
    return axes


def name_places(axes: Axes, names: Sequence[str], units: Sequence[str] = ()) -> None:
    """Write names below places 0, 1, … of an axis, upright where they are many."""
    many = len(names) > _MANY_NAMES
    between = " " if many else "\n"
    labels = [f"{name}{between}[{unit}]" for name, unit in zip(names, units, strict=False)]
    axes.set_xticks(range(len(names)), labels or list(names))
    if many:
        axes.tick_params(axis="x", labelrotation=90, labelsize=6)


def shown_label(name: str) -> str:
    """Return a name as a label that matplotlib does not leave out of legends."""
    return f" {name}" if name.startswith("_") else name


def draw_changes(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw the change of each parameter from nominal with its 95 % interval, in 1e-3 of SI.

    Fixed ones are left out.
    """
    units = {p.name: p.unit for _, p in parameters_of(result) if p.given != "fixed"}
    names = list(units)
    step = min(0.2, 0.8 / len(result.legs))
    for index, leg in enumerate(result.legs):
        free = [p for p in leg.parameters if p.given != "fixed"]
        change = 1e3 * np.array([p.identified - p.nominal for p in free])
        half = 1e3 * np.array([(p.high - p.low) / 2 for p in free])
        shift = (index - (len(result.legs) - 1) / 2) * step
        colour, marker, _ = look(index)
        axes.errorbar(
            np.array([names.index(p.name) for p in free]) + shift,
            change,
            half,
            fmt=marker,
            color=colour,
            label=shown_label(leg.name),
            ms=4,
            capsize=3,
            lw=1,
        )
    axes.axhline(0.0, color="0.5", lw=0.8)
    name_places(axes, names, [SMALL[units[name]] or "10⁻³" for name in names])
    axes.set_ylabel("identified − nominal, ± 95 %")
    axes.legend(fontsize=8)
    return axes
