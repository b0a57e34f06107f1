"""Figures of a report. Legs differ in colour and in marker or hatch."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pincal.kinematics.configurations import home_of, joints_at
from pincal.kinematics.readers import skeleton
from pincal.model.measurements import EVERY_LEG, Plan
from pincal.model.mechanism import Mechanism
from pincal.show.pictures.svg import SvgFigure, on_page
from pincal.show.plots import (
    by_set,
    draw_bars,
    draw_changes,
    draw_mechanism,
    draw_poses,
    draw_set,
    name_places,
    shown_label,
)
from pincal.show.report.findings import Findings
from pincal.show.results import noisy_series, whose
from pincal.show.style import WIDTH
from pincal.show.workspace_errors import WorkspaceErrors
from pincal.words.numbers import SMALL, shown_in

Array = NDArray[np.float64]


@on_page("figure-poses")
def poses_figure(found: Findings) -> tuple[Figure, str]:
    """Return the measured poses, with the mechanism in the plane (3-RRR paper, Figs. 4, 8)."""
    mechanism = found.result.nominal
    sets = found.data.sets or ("",) * len(found.data)
    plan = Plan(found.poses, tuple(one or EVERY_LEG for one in sets))
    if mechanism.platform.space == 2:
        drawn = Figure(figsize=(WIDTH, 3.4), layout="constrained")
        left, axes = drawn.subplots(1, 2)
        draw_mechanism(left, mechanism)
        over = found.errors.poses if found.errors is not None and found.errors.sampled else None
        draw_poses(axes, mechanism, plan, over)
        _remove_legend(axes)
        what = "over its workspace (grey), and the mechanism at home"
        what += "; strokes show the orientation" if found.turns else ""
    else:
        drawn = Figure(figsize=(WIDTH, 3.0), layout="constrained")
        for axes, pair in zip(drawn.subplots(1, 3), ((0, 1), (0, 2), (1, 2)), strict=True):
            _projection(axes, mechanism, plan, pair)
        what = "seen from above, from the front and from the side; grey: the mechanism at home"
    drawn.legend(
        *axes.get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False
    )
    return drawn, f"The {len(plan.poses)} measured poses of the platform, {what}."


def _projection(axes: Axes, mechanism: Mechanism, plan: Plan, pair: tuple[int, int]) -> None:
    """Draw poses as they are seen along an axis, and the legs at home."""
    across = list(pair)
    home = joints_at(mechanism, home_of(mechanism))
    for leg in mechanism.legs:
        if np.isfinite(home.joints[leg.name]).all():
            points = skeleton(leg, home.joints[leg.name][0])[:, across]
            axes.plot(*points.T, "-", color="0.75", lw=1.5, zorder=1)
    for index, name, own in by_set(mechanism, plan):
        draw_set(axes, index, name, own[:, across])
    axes.set(xlabel=f"{'xyz'[pair[0]]} [m]", ylabel=f"{'xyz'[pair[1]]} [m]")
    axes.set_aspect("equal", adjustable="datalim")


@on_page("figure-changes")
def changes_figure(found: Findings) -> tuple[Figure, str]:
    """Return the change of each parameter with its interval."""
    drawn = Figure(figsize=(WIDTH, 3.2), layout="constrained")
    _legend_outside(draw_changes(drawn.subplots(), found.result))
    return drawn, (
        "Change of each parameter from nominal, with its 95 % interval. Where the interval "
        "holds zero, the measurements do not distinguish the nominal value from the identified "
        "one."
    )


def platform_figure(found: Findings) -> SvgFigure | None:
    """Return bars of the platform's errors and of the residuals, before and after (Fig. 10)."""
    return None if found.errors is None else _bars(found, found.errors)


@on_page("figure-rms")
def _bars(found: Findings, errors: WorkspaceErrors) -> tuple[Figure, str]:
    parts: list[tuple[str, dict[str, Array]]] = []
    caption = "Root mean square errors before and after: "
    if found.result.explained:
        both = 1e3 * np.array([errors.mean_before(), errors.mean_after()])
        titles = ("platform: position [mm]", "orientation [mrad]")[: 1 + found.turns]
        parts = [(title, {errors.where: own}) for title, own in zip(titles, both.T, strict=False)]
        caption += f"the platform's {errors.where} (after: as expected), and "
    residuals: dict[str, dict[str, Array]] = {}
    for one in noisy_series(found.result):
        sizes = np.array([shown_in(value, one.unit) for value in one.rms[:2]])
        residuals.setdefault(SMALL[one.unit], {})[one.name] = sizes
    parts += [(f"residuals [{unit}]", bars) for unit, bars in residuals.items()]
    drawn = Figure(figsize=(WIDTH, 2.9), layout="constrained")
    widths = [1.4 + 0.6 * len(bars) for _, bars in parts]
    panels = np.atleast_1d(drawn.subplots(1, len(parts), width_ratios=widths))
    for axes, (title, bars) in zip(panels, parts, strict=True):
        series = {
            name: {label: float(own[place]) for label, own in bars.items()}
            for place, name in enumerate(("before", "after"))
        }
        draw_bars(axes, series).set_title(title)
        _remove_legend(axes)
        turned = len(bars) > 4
        for bar in axes.containers:
            axes.bar_label(bar, fmt="%.2g", fontsize=6.5, rotation=90 * turned, padding=2)
        if turned:
            axes.tick_params(axis="x", labelrotation=45)
        axes.margins(y=0.18)
    drawn.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return drawn, f"{caption}the residuals of each {whose(noisy_series(found.result))}."


@on_page("figure-observability")
def observability_figure(found: Findings) -> tuple[Figure, str]:
    """Return |R_ii| of each parameter and leg at the poses used (3-RRR paper, Fig. 9)."""
    mechanism = found.result.nominal
    read = {"m"} if mechanism.by_readings else set(mechanism.reading_units)
    unit = read.pop() if len(read) == 1 else "reading"
    units = {name: leg.units[name] for leg in mechanism.legs for name in leg.parameter_names}
    what = "the leg's end" if mechanism.by_readings else "the readings"
    drawn = Figure(figsize=(WIDTH, 2.8), layout="constrained")
    axes = draw_bars(drawn.subplots(), found.observability)
    names = list(dict.fromkeys(name for own in found.observability.values() for name in own))
    per = [unit if units[name] == "1" else f"{unit}/{units[name]}" for name in names]
    name_places(axes, names, per)
    axes.set_ylabel("|R_ii|")
    _legend_outside(axes)
    return drawn, (
        f"Observability of each parameter at the poses used: what it moves {what} by, all "
        "poses together, less what the parameters to its left can explain. Compare legs "
        "with it; parameters differ in their units."
    )


def _legend_outside(axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    names = [shown_label(label) for label in labels]
    axes.legend(handles, names, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)


def _remove_legend(axes: Axes) -> None:
    if (legend := axes.get_legend()) is not None:
        legend.remove()
