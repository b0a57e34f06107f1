"""Figures of a report: charts across a page with a caption, by the names that its template calls.

Legs differ in colour and in marker. A figure is None where there is nothing to show.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, NullLocator

from pincal.calibration.result import CalibrationResult
from pincal.kinematics.configurations import home_of, joints_at
from pincal.kinematics.readers import skeleton
from pincal.model.measurements import EVERY_LEG, Plan
from pincal.show import charts
from pincal.show.pictures.files import SvgFigure, svg_figure
from pincal.show.pictures.parts import (
    axis_name,
    draw_map,
    draw_poses,
    draw_strokes,
    height_name,
    page_figure,
)
from pincal.show.pictures.picture import draw_scene
from pincal.show.style import PAGE_INCHES
from pincal.show.view.scene import scene
from pincal.show.workspace_errors import WorkspaceErrors, error_maps
from pincal.words.numbers import SMALL, STORED, per_si

#: A figure and its caption, or none where there is nothing to show.
Captioned = tuple[Figure, str] | None


def figure(
    name: str, result: CalibrationResult, errors: WorkspaceErrors | None
) -> SvgFigure | None:
    """Return a figure of a report by its name in ``FIGURES``; None if there is nothing to show."""
    return svg_figure(f"figure-{name}", lambda: FIGURES[name](result, errors))


def _chart(
    draw: Callable[[Axes, CalibrationResult], Axes], caption: str, height: float = 3.4
) -> Callable[[CalibrationResult, WorkspaceErrors | None], Captioned]:
    """Return what draws a chart across the page."""

    def drawn(result: CalibrationResult, _errors: WorkspaceErrors | None) -> Captioned:
        page = page_figure(height)
        draw(page.subplots(), result)
        return page, caption

    return drawn


def _images(result: CalibrationResult, errors: WorkspaceErrors | None) -> Captioned:
    """Return residuals over the images of cameras."""
    if not (cameras := charts.camera_residuals(result)):
        return None
    caption = (
        "What cameras saw: arrows from each point as seen towards where it is predicted, magnified "
        "alike in all images. Where arrows of a region point one way, the lens is other than its "
        "model."
    )
    height = PAGE_INCHES / (0.6 + min(len(cameras), 2))
    return _chart(charts.images, caption, height)(result, errors)


def _poses(result: CalibrationResult, errors: WorkspaceErrors | None) -> Captioned:
    """Return the measured poses, with the mechanism in the plane (3-RRR paper, Figs. 4, 8)."""
    mechanism, poses = result.nominal, result.poses
    sets = result.measurements.sets or ("",) * len(poses)
    plan = Plan(poses, tuple(name or EVERY_LEG for name in sets))
    if plane := mechanism.platform.space == 2:
        drawn = page_figure(3.4)
        side, axes = drawn.subplots(1, 2)
        draw_scene(side, scene(mechanism, home_of(mechanism)), 0, colours={})
        if errors is not None and errors.sampled:
            sampled = per_si("m", STORED) * errors.poses[:, :2]
            dot = np.array((7e-3 * float(np.ptp(sampled[:, 0])), 0.0))
            draw_strokes(axes, sampled, sampled + dot, colors="0.75", lw=1.3, zorder=0)
        draw_poses(axes, mechanism, plan)
        axes.set_aspect("equal")
    else:
        drawn = page_figure(3.0)
        home = joints_at(mechanism, home_of(mechanism)).joints
        for axes, projection in zip(drawn.subplots(1, 3), ((0, 1), (0, 2), (1, 2)), strict=True):
            for leg in mechanism.legs:
                if np.isfinite(home[leg.name]).all():
                    points = per_si("m", STORED) * skeleton(leg, home[leg.name][0])[:, projection]
                    axes.plot(*points.T, "-", color="0.75", lw=1.5, zorder=1)
            draw_poses(axes, mechanism, plan, projection)
            axes.set_aspect("equal", adjustable="datalim")
    _legend_below(drawn, *axes.get_legend_handles_labels())
    description = "seen from above, from the front and from the side; grey: the mechanism at home"
    if plane:
        description = "over its workspace (grey), and the mechanism at home"
        description += "; strokes show the orientation" * ("rad" in mechanism.platform.units)
    return drawn, f"The {len(plan.poses)} measured poses of the platform, {description}."


def _changes(result: CalibrationResult, errors: WorkspaceErrors | None) -> Captioned:
    """Return what changes of parameters move the platform by, where some could change."""
    could_change = any(p.std > 0.0 for leg in result.legs for p in leg.parameters)
    if errors is None or not errors.sampled or not could_change:
        return None
    return _chart(charts.changes, _CHANGES, 4.6)(result, errors)


def _drawing(result: CalibrationResult, _errors: WorkspaceErrors | None) -> Captioned:
    """Return the first leg with its dimensions, in the colours of their changes."""
    leg = result.legs[0].name
    drawn = page_figure(4.6)
    axes = charts.dimensioned(drawn.subplots(), result, leg)
    if not axes.lines:  # nothing is drawn that can be seen: out of reach at home
        return None
    keys = [Line2D([], [], color=colour, lw=3, label=text) for _, colour, text in charts.LEVELS]
    _legend_below(drawn, keys, [str(key.get_label()) for key in keys])
    kinds = {tuple(p.name for p in leg_result.parameters) for leg_result in result.legs}
    alike_legs = ", those of the others alike" if len(kinds) < len(result.legs) else ""
    return drawn, (
        f"Where the parameters of {leg} are{alike_legs}: lines in the colours of their changes. "
        "Values stand in the table above; parameters that are zero have no line."
    )


def _maps(result: CalibrationResult, errors: WorkspaceErrors | None) -> Captioned:
    """Return the platform's errors over x and y, before and after (3-RRR paper, Figs. 6, 11)."""
    if errors is None:
        return None
    maps = error_maps(result, errors)
    rows = {
        name: {"before": maps.before[..., i], "after, expected": maps.after[..., i]}
        for i, name in enumerate(errors.units)
    }
    panel = 0.4 * PAGE_INCHES * float(np.ptp(maps.y) / np.ptp(maps.x))
    drawn = page_figure(len(rows) * (panel + 0.4) + 0.4)
    panels = drawn.subplots(len(rows), 2, sharex=True, sharey=True, squeeze=False)
    for (name, values), neighbours in zip(rows.items(), panels, strict=True):
        unit = errors.units[name]
        scaled = {title: per_si(unit) * error for title, error in values.items()}
        every = np.array(list(scaled.values()))
        limits = float(np.nanmin(every)), float(np.nanmax(every))
        for (title, error), axes in zip(scaled.items(), neighbours, strict=True):
            axes.set_title(f"{name} {title}")
            if np.isfinite(error).any():  # nominal zeros of motors may lead nowhere
                image = draw_map(axes, (maps.x, maps.y), error, limits, decades=True)
        bar = drawn.colorbar(image, ax=list(neighbours), label=SMALL[unit])
        bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        bar.ax.yaxis.set_minor_locator(NullLocator())
    drawn.supxlabel(axis_name("x"), size=8)
    drawn.supylabel(axis_name("y"), size=8)
    region = "the workspace" + " at home orientation" * (len(rows) > 1)
    height = "" if maps.height is None else f", {height_name(maps.height)}"
    return drawn, (
        f"Error of the platform over {region}{height}: how far the nominal model is off, and what "
        "is to be expected of the calibrated one (standard error). One scale of decades for both; "
        "white: not in the workspace."
    )


def _legend_below(drawn: Figure, handles: Iterable[Any], names: Iterable[str]) -> None:
    """Put one legend below all panels of a figure."""
    drawn.legend(list(handles), list(names), loc="outside lower center", ncols=4, frameon=False)


_CHANGES = (
    "By how much the change of each parameter moves the platform, root mean square over the "
    "workspace, and its 95 % interval. Grey: the measurements do not distinguish the nominal value "
    "from the identified one."
)
_RESIDUALS = (
    "Residuals after the calibration against the row of the measurements, each over its standard "
    "deviation: the noise less what the fit takes up of it, σ√(1−h). Between the dashed lines 95 "
    "of 100 are expected. Rings: rows that do not fit the others; crosses at the upper edge: rows "
    "that were rejected."
)
#: By what a report calls them.
FIGURES: dict[str, Callable[[CalibrationResult, WorkspaceErrors | None], Captioned]] = {
    "poses": _poses,
    "images": _images,
    "changes": _changes,
    "drawing": _drawing,
    "residuals": _chart(charts.residuals, _RESIDUALS),
    "maps": _maps,
}
