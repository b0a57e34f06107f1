"""Plots of results, mechanisms and poses, drawn into matplotlib axes, for paper and screen.

Legs differ in colour and in marker or hatch, so that plots read in black and white and in
colour-blindness.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from numpy.typing import NDArray

from pincal.calibration.result import CalibrationResult
from pincal.errors import MeasurementError, WorkspaceError
from pincal.kinematics.inverse import inverse
from pincal.kinematics.readers import skeleton
from pincal.model.measuring.measurements import EVERY_LEG, VERIFY, Plan
from pincal.model.mechanism import Mechanism
from pincal.show.pictures import charts
from pincal.show.results import noisy_series, parameters
from pincal.show.style import EVERY, IDENTIFIED, NOMINAL, PAGE, Look, look
from pincal.show.workspace_errors import error_maps
from pincal.words.numbers import SMALL, STORED, amount, per_si

Array = NDArray[np.float64]
#: Names along an axis of a figure across a page.
_MANY = 30
#: Light enough for black lines; brighter is more, in black and white too.
_LIGHT = ListedColormap(colormaps["cividis"](np.linspace(0.35, 1.0, 128)))


def before_after(index: int) -> Look:
    """Return the look of what nominal parameters give (0), and identified ones (1)."""
    return (Look(NOMINAL, "o", "//"), Look(IDENTIFIED, "s", ""))[index]


@dataclass(frozen=True)
class Plots:
    """Plots of a result, as ``result.plot``: each returns its axes, those given or new ones."""

    result: CalibrationResult

    def residuals(self, ax: Axes | None = None) -> Axes:
        """Draw residuals after the calibration in standard deviations, against the row.

        Those of the legs or, if their readings are exact, of the platform as measured. Dashed
        lines: where 95 of 100 are expected by the noise.
        """
        axes = _axes_of(ax, 6.4, 3.6)
        for index, one in enumerate(noisy_series(self.result)):
            noisy = one.sigma > 0.0
            rows, values = one.rows[noisy] + 1, one.after[noisy] / one.sigma[noisy]
            own = look(index)
            axes.plot(rows, values, own.marker, color=own.colour, ms=3, label=label(one.name))
        _levels(axes, 1.96)
        axes.set(xlabel="data row", ylabel="residual [σ]")
        outside(axes)
        return axes

    def parameters(self, ax: Axes | None = None) -> Axes:
        """Draw the change of each parameter from nominal over its 95 % half width.

        Bars longer than 1 are changes that the measurements show; fixed ones have none.
        """
        values: dict[str, dict[str, float]] = {leg.name: {} for leg in self.result.legs}
        for leg, p in parameters(self.result):
            if p.high > p.low:
                values[leg.name][p.name] = p.change / p.half
        axes = draw_bars(_axes_of(ax, 6.4, 3.6), values)
        _levels(axes, 1.0)
        axes.set_ylabel("change / half width of 95 % interval")
        return axes

    def error_map(self, ax: Axes | None = None) -> Axes:
        """Draw the expected error of the calibrated platform's position over x and y.

        The other coordinates are as at home; in space, z is in the middle of the workspace.

        Raises:
            MeasurementError: residuals are so large that no accuracy can be promised.
            WorkspaceError: no workspace was found with the default margins.
        """
        name = self.result.nominal.name
        if not self.result.explained:
            raise MeasurementError(
                f"{name}: residuals are {self.result.excess:.3g} times as large as the noise given "
                "makes them, so no accuracy can be promised and none is drawn"
            )
        if (maps := error_maps(self.result)) is None:
            raise WorkspaceError(f"{name}: no workspace was found to draw errors over")
        axes, middle = _axes_of(ax, 5.0, 4.2), len(maps.heights) // 2
        image = draw_map(axes, (maps.x, maps.y), per_si("m") * maps.after[middle, ..., 0])
        axes.figure.colorbar(image, ax=axes, label=f"expected error of position [{SMALL['m']}]")
        height = maps.heights[middle]
        axes.set(xlabel=along("x"), ylabel=along("y"), title=height_said(height))
        return axes

    def correlation(self, ax: Axes | None = None) -> Axes:
        """Draw the correlations of all parameters that were identified."""
        axes, covariance = _axes_of(ax, 5.4, 4.8), self.result.covariance
        std = np.sqrt(np.diagonal(covariance))
        free = np.flatnonzero(np.isfinite(std) & (std > 0.0))
        rho = covariance[np.ix_(free, free)] / np.outer(std[free], std[free])
        image = axes.imshow(rho, vmin=-1.0, vmax=1.0, cmap="RdBu_r")
        axes.figure.colorbar(image, ax=axes, label="correlation")
        ids = [p.id for _, p in parameters(self.result)]
        places, names = list(range(len(free))), [ids[i] for i in free]
        if len(free) > _MANY:  # legs alone: letters stay as large as they are read
            begin = [i for i in places if i == 0 or _owner(names[i]) != _owner(names[i - 1])]
            places, names = begin, [_owner(names[i]) for i in begin]
        axes.set_xticks(places, names, rotation=90, fontsize=7)
        axes.set_yticks(places, names, fontsize=7)
        return axes

    def workspace(self, ax: Axes | None = None) -> Axes:
        """Draw each row's largest residual where it was measured; outliers are ringed."""
        return charts.over_workspace(_axes_of(ax, 5.0, 4.2), self.result)

    def time(self, ax: Axes | None = None) -> Axes:
        """Draw means of residuals over the run, by tenths of the rows: what drifts leaves ±2."""
        return charts.over_time(_axes_of(ax, 6.4, 3.6), self.result)

    def singular(self, ax: Axes | None = None) -> Axes:
        """Draw singular values of the identification Jacobian, and name the weakest direction."""
        return charts.singular_values(_axes_of(ax, 6.4, 3.6), self.result)

    def poses(self, ax: Axes | None = None) -> Axes:
        """Draw the expected error after the first n rows, and the bound of any n of them.

        Raises:
            MeasurementError: noise differs between rows, or parameters are undetermined.
            WorkspaceError: no workspace was found.
        """
        return charts.by_poses(_axes_of(ax, 6.4, 3.6), self.result)

    def platform(self, ax: Axes | None = None) -> Axes:
        """Draw by how much each parameter's change moves the platform over the workspace.

        Raises:
            WorkspaceError: no workspace was found.
        """
        return charts.at_platform(_axes_of(ax, 6.4, 4.6), self.result)

    def runs(self, ax: Axes | None = None) -> Axes:
        """Draw the parameters of each run less their mean, in standard errors.

        Raises:
            MeasurementError: runs were not compared.
        """
        return charts.runs_compared(_axes_of(ax, 6.4, 4.0), self.result)

    def bed(self, ax: Axes | None = None) -> Axes:
        """Draw by how much the nominal model misses z over the bed of a printer.

        Raises:
            WorkspaceError: a machine without x, y and z, or no workspace at home's height.
        """
        x, y, heights = charts.bed_heights(self.result)
        axes, off = _axes_of(ax, 5.0, 4.2), per_si("m") * heights
        most = float(np.nanmax(np.abs(off)))
        image = draw_map(axes, (x, y), off, (-most, most))
        image.set_cmap("RdBu_r")
        axes.figure.colorbar(image, ax=axes, label=f"z, true less commanded [{SMALL['m']}]")
        axes.set(xlabel=along("x"), ylabel=along("y"))
        return axes

    def drawing(self, ax: Axes | None = None, leg: str = "") -> Axes:
        """Draw a leg with its dimensions, lines in the colours of changes over their ±.

        Without axes a page of A4 (``axes.figure``), with the values of all legs like it beneath.

        Args:
            ax: Where to draw.
            leg: Name of the leg, the first if not given.

        Raises:
            MechanismError: no such leg.
        """
        from pincal.show.pictures.sheet import draw_dimensioned, sheet

        if ax is None:
            drawn: Axes = sheet(self.result, leg).axes[0]
            return drawn
        name = self.result.nominal.leg(leg or self.result.nominal.leg_names[0]).name
        return draw_dimensioned(ax, self.result, name)


def _axes_of(ax: Axes | None, width: float, height: float) -> Axes:
    """Return axes to draw into, of a new figure if none are given, [inch]."""
    return ax or Figure(figsize=(width, height), layout="constrained").subplots()


def _owner(identity: str) -> str:
    """Return whose a parameter is, of its id."""
    return identity.rpartition(".")[0]


def _levels(axes: Axes, size: float) -> None:
    for level in (-size, 0.0, size):
        axes.axhline(level, color="0.5", lw=0.8, ls="--" if level else "-", zorder=0)


def draw_map(
    axes: Axes,
    over: tuple[Array, Array],
    values: Array,
    limits: tuple[float, float] | None = None,
    *,
    decades: bool = False,
) -> AxesImage:
    """Draw values over x and y, shape (n_y, n_x), with lines of equal value; return the image.

    Args:
        axes: Where to draw.
        over: Coordinates x and y, shapes (n_x,) and (n_y,), [m].
        values: NaN where there is none.
        limits: Of the colours; those of the values if not given.
        decades: Whether colours follow the logarithm, so that small and large are both seen.
    """
    (x, y), known = (per_si("m", STORED) * one for one in over), values[np.isfinite(values)]
    half = [(own[1] - own[0]) / 2 for own in (x, y)]
    extent = (x[0] - half[0], x[-1] + half[0], y[0] - half[1], y[-1] + half[1])
    low, high = limits or (known.min(), known.max())
    norm = (LogNorm if decades and low > 0.0 else Normalize)(low, high)
    image = axes.imshow(values, origin="lower", extent=extent, norm=norm, cmap=_LIGHT)
    levels = np.quantile(known, (0.25, 0.5, 0.75)) if known.size else np.zeros(3)
    if (np.diff(levels) > 1e-6 * levels[-1]).all():
        masked = np.ma.masked_invalid(values)
        lines = axes.contour(x, y, masked, levels, colors="black", linewidths=0.7)
        axes.clabel(lines, fmt="%.2g", fontsize=7)
    return image


def draw_mechanism(axes: Axes, mechanism: Mechanism) -> None:
    """Draw a planar mechanism at home, seen from above."""
    solution = inverse(mechanism, np.array([mechanism.platform.home]))
    corners = []
    for index, leg in enumerate(mechanism.legs):
        if not solution.reached[0, index]:
            continue
        points = per_si("m", STORED) * skeleton(leg, solution.joints[leg.name][0])[:, :2]
        colour, base = look(index).colour, points[0]
        axes.plot(*points.T, "-", color=colour, lw=2.5, zorder=2)
        axes.plot(*base, "s", color=colour, ms=9, zorder=3)
        axes.plot(*points[1:].T, "o", color="white", mec=colour, ms=6, zorder=3)
        axes.annotate(leg.name, tuple(base), xytext=(6, -14), textcoords="offset points", size=8)
        corners.append(points[-1])
    if len({tuple(c.round(9)) for c in corners}) > 2:
        axes.fill(*np.array(corners).T, color="0.5", alpha=0.4, zorder=1)
    axes.margins(0.18)
    axes.set(xlabel=along("x"), ylabel=along("y"), aspect="equal")


def draw_poses(
    axes: Axes, mechanism: Mechanism, plan: Plan, seen: tuple[int, int] = (0, 1)
) -> None:
    """Draw poses of a plan by set, unfilled if no fit follows them; strokes show orientations.

    Args:
        axes: Where to draw.
        mechanism: The mechanism.
        plan: The poses, and the sets they belong to.
        seen: Coordinates that point right and up.
    """
    turns = "phi" in mechanism.platform.coordinates
    scale = per_si("m", STORED)
    size = 0.05 * scale * float(np.ptp(plan.poses[:, :2], axis=0).max())
    sets = np.array(plan.serving)
    names = dict.fromkeys((*mechanism.leg_names, EVERY_LEG, *plan.serving))
    for index, name in enumerate(names):
        colour, marker, _ = look(index)
        colour = EVERY if name in (EVERY_LEG, VERIFY) else colour
        if not (own := plan.poses[sets == name]).size:
            continue
        said = {EVERY_LEG: "every leg", VERIFY: "verify (not fitted)"}.get(name, f"set {name}")
        many, at = len(own) > PAGE.many, scale * own[:, seen]
        unfilled: dict[str, Any] = (
            {"mfc": "none", "color": colour} if name == VERIFY else {"color": colour}
        )
        axes.plot(*at.T, marker, **unfilled, ms=4, label=said, zorder=2, rasterized=many)
        if turns:
            end = at + size * np.stack((np.cos(own[:, 2]), np.sin(own[:, 2])), axis=1)
            strokes = list(np.stack((at, end), axis=1))
            axes.add_collection(LineCollection(strokes, colors=colour, lw=0.8, zorder=2))
    axes.set(xlabel=along("xyz"[seen[0]]), ylabel=along("xyz"[seen[1]]))


def along(axis: str) -> str:
    """Return what names an axis of the base frame, with its unit."""
    return f"{axis} [{STORED['m']}]"


def height_said(height: float | None) -> str:
    """Return at which z something is drawn, [m]; nothing where there is no z."""
    return "" if height is None else f"z = {amount(height, 'm', 3, STORED)}"


def draw_bars(
    axes: Axes,
    values: Mapping[str, Mapping[str, float]],
    looks: Callable[[int], Look] = look,
) -> Axes:
    """Draw bars of several series side by side, by series, then by name.

    Args:
        axes: Where to draw.
        values: By series, then by name.
        looks: Look of a series by its number; those of legs if not given.
    """
    names = list(dict.fromkeys(name for series in values.values() for name in series))
    width = 0.8 / len(values)
    for index, (series, own) in enumerate(values.items()):
        places = np.array([names.index(name) for name in own])
        shift = (index - (len(values) - 1) / 2) * width
        colour, _, hatch = looks(index)
        own_look: dict[str, Any] = {"color": colour, "hatch": hatch, "edgecolor": "white"}
        axes.bar(places + shift, list(own.values()), width, label=label(series), **own_look)
    name_places(axes, names)
    outside(axes)
    return axes


def outside(axes: Axes) -> None:
    """Put the legend beside the axes, where it hides nothing."""
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=8)


def name_places(axes: Axes, names: Sequence[str], units: Sequence[str] = ()) -> None:
    """Write names below places 0, 1, … of an axis, upright where they are many."""
    axes.set_xticks(range(len(names)), _named(names, units))
    if _upright(names):
        axes.tick_params(axis="x", labelrotation=90, labelsize=7)


def height_of_names(names: Sequence[str], units: Sequence[str] = ()) -> float:
    """Return how much room ``name_places`` takes below an axis, [inch]."""
    if not _upright(names):
        return PAGE.margins["bottom"]
    return 0.2 + 0.7 * PAGE.letter * max(map(len, _named(names, units)))


def _upright(names: Sequence[str]) -> bool:
    return len(names) > 2 * PAGE.width  # less than half an inch for each


def _named(names: Sequence[str], units: Sequence[str]) -> list[str]:
    between = " " if _upright(names) else "\n"
    labels = [f"{name}{between}[{unit}]" for name, unit in zip(names, units, strict=False)]
    return labels or list(names)


def label(name: str) -> str:
    """Return a name as a label that matplotlib does not leave out of legends."""
    return f" {name}" if name.startswith("_") else name
