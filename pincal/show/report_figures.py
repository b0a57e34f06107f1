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
from pincal.show.colours import COLOURS
from pincal.show.findings import Findings
from pincal.show.markup import Element
from pincal.show.plots import (
    MARKERS,
    draw_bars,
    draw_changes,
    draw_mechanism,
    draw_poses,
    name_places,
    shown_label,
)
from pincal.show.series import readings_exact, series_of
from pincal.show.svg import drawing, figure
from pincal.show.tables import SHOWN

Array = NDArray[np.float64]
WIDTH = 7.4  # [inch], that of A4 between its margins
_MANY = 1500  # points from which they are drawn as pixels


def poses_figure(found: Findings) -> Element:
    """Return the measured poses, with the mechanism in the plane (3-RRR paper, Figs. 4, 8)."""
    mechanism = found.result.nominal
    sets = found.data.sets or ("",) * len(found.data)
    plan = Plan(found.poses, tuple(one or EVERY_LEG for one in sets))
    with drawing():
        if mechanism.platform.space == 2:
            drawn = Figure(figsize=(WIDTH, 3.4), layout="constrained")
            left, axes = drawn.subplots(1, 2)
            draw_mechanism(left, mechanism)
            draw_poses(axes, mechanism, plan, _workspace(found))
            _legend_below(drawn, axes)
            what = "over its workspace (grey), and the mechanism at home"
            strokes = "; strokes show the orientation" if found.turns else ""
        else:
            drawn = Figure(figsize=(WIDTH, 3.0), layout="constrained")
            for axes, pair in zip(drawn.subplots(1, 3), ((0, 1), (0, 2), (1, 2)), strict=True):
                _projection(axes, mechanism, plan, pair)
            _legend_below(drawn, axes)
            what = "seen from above, from the front and from the side; grey: the mechanism at home"
            strokes = ""
        caption = f"The {len(plan.poses)} measured poses of the platform, {what}{strokes}."
        return figure(drawn, "figure-poses", caption, caption)


def _workspace(found: Findings) -> Array | None:
    return found.errors.poses if found.errors is not None and found.errors.sampled else None


def _projection(axes: Axes, mechanism: Mechanism, plan: Plan, pair: tuple[int, int]) -> None:
    """Draw poses as they are seen along an axis, and the legs at home."""
    legs, across = mechanism.leg_names, list(pair)
    home = joints_at(mechanism, home_of(mechanism))
    for leg in mechanism.legs:
        if np.isfinite(home.joints[leg.name]).all():
            points = skeleton(leg, home.joints[leg.name][0])[:, across]
            axes.plot(*points.T, "-", color="0.75", lw=1.5, zorder=1)
    sets = plan.sets or ()
    for index, name in enumerate(name for name in (*legs, EVERY_LEG) if name in sets):
        own = plan.poses[[s == name for s in sets]]
        if len(own):
            axes.plot(
                *own[:, across].T,
                MARKERS[index % len(MARKERS)],
                color=COLOURS[index % len(COLOURS)],
                ms=4,
                label="every leg" if name == EVERY_LEG else f"set {name}",
                zorder=2,
                rasterized=len(own) > _MANY,
            )
    axes.set(xlabel=f"{'xyz'[pair[0]]} [m]", ylabel=f"{'xyz'[pair[1]]} [m]")
    axes.set_aspect("equal", adjustable="datalim")


def changes_figure(found: Findings) -> Element:
    """Return the change of each parameter with its interval."""
    with drawing():
        drawn = Figure(figsize=(WIDTH, 3.2), layout="constrained")
        axes = drawn.subplots()
        draw_changes(axes, found.result)
        _legend_outside(axes)
        caption = (
            "Change of each parameter from nominal, with its 95 % interval. Where the interval "
            "holds zero, the nominal value cannot be told from the identified one."
        )
        return figure(drawn, "figure-changes", caption, caption)


def platform_figure(found: Findings) -> Element | None:
    """Return bars of the platform's errors and of the residuals, before and after (Fig. 10)."""
    if found.errors is None:
        return None
    parts = [("platform: position [mm]", {found.errors.where: _both(found, 0)})]
    if found.turns:
        parts.append(("orientation [mrad]", {found.errors.where: _both(found, 1)}))
    residuals: dict[str, dict[str, tuple[float, float]]] = {}
    for one in series_of(found.result):
        unit, factor = SHOWN[one.unit]
        before, after = (factor * float(np.sqrt(np.mean(v**2))) for v in (one.before, one.after))
        residuals.setdefault(unit, {})[one.name] = (before, after)
    parts += [(f"residuals [{unit}]", bars) for unit, bars in residuals.items()]
    with drawing():
        drawn = Figure(figsize=(WIDTH, 2.9), layout="constrained")
        widths = [1.4 + 0.6 * len(bars) for _, bars in parts]
        panels = np.atleast_1d(drawn.subplots(1, len(parts), width_ratios=widths))
        for axes, (title, bars) in zip(panels, parts, strict=True):
            series = {
                name: {label: both[place] for label, both in bars.items()}
                for place, name in enumerate(("before", "after"))
            }
            draw_bars(axes, series).set_title(title)
            axes.get_legend().remove()
            turned = len(bars) > 4
            for bar in axes.containers:
                axes.bar_label(bar, fmt="%.2g", fontsize=6.5, rotation=90 * turned, padding=2)
            if turned:
                axes.tick_params(axis="x", labelrotation=45)
            axes.margins(y=0.18)
        drawn.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
        caption = (
            "Root mean square errors before and after: the platform's "
            f"{found.errors.where} (after: as expected), and the residuals of each "
            f"{'measured quantity' if readings_exact(found.result) else 'leg'}."
        )
        return figure(drawn, "figure-rms", caption, caption)


def _both(found: Findings, column: int) -> tuple[float, float]:
    if found.errors is None:
        return np.nan, np.nan
    return 1e3 * found.errors.mean_before()[column], 1e3 * found.errors.mean_after()[column]


def observability_figure(found: Findings) -> Element:
    """Return |R_ii| of each parameter and leg at the poses used (3-RRR paper, Fig. 9)."""
    mechanism = found.result.nominal
    read = {"m"} if mechanism.by_readings else set(mechanism.reading_units)
    unit = read.pop() if len(read) == 1 else "reading"
    units = {name: leg.units[name] for leg in mechanism.legs for name in leg.parameter_names}
    what = "the leg's end" if mechanism.by_readings else "the readings"
    with drawing():
        drawn = Figure(figsize=(WIDTH, 2.8), layout="constrained")
        axes = drawn.subplots()
        draw_bars(axes, found.observability).set_ylabel("|R_ii|")
        names = list(dict.fromkeys(name for own in found.observability.values() for name in own))
        per = [unit if units[name] == "1" else f"{unit}/{units[name]}" for name in names]
        name_places(axes, names, per)
        _legend_outside(axes)
        caption = (
            f"Observability of each parameter at the poses used: what it moves {what} by, all "
            "poses together, beyond what the parameters to its left can explain. Compare legs "
            "with it; parameters differ in their units."
        )
        return figure(drawn, "figure-observability", caption, caption)


def _legend_below(drawn: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    if (own := axes.get_legend()) is not None:
        own.remove()
    drawn.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)


def _legend_outside(axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    axes.legend(
        handles,
        [shown_label(label) for label in labels],
        loc="upper left",
        bbox_to_anchor=(1.0, 1.0),
        frameon=False,
    )
