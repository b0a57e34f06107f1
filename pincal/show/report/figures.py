"""Figures of a report. Legs differ in colour and in marker or hatch."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, NullLocator

from pincal.calibration.leg_result import IdentifiedParameter
from pincal.kinematics.configurations import home_of, joints_at
from pincal.kinematics.readers import skeleton
from pincal.model.measurements import EVERY_LEG, Plan
from pincal.show.pictures.charts import over_images, seen_in
from pincal.show.pictures.files import SvgFigure, on_page
from pincal.show.pictures.parts import (
    Drawn,
    before_after,
    draw_bars,
    draw_map,
    draw_mechanism,
    draw_poses,
    draw_strokes,
    height_of_names,
    label,
    name_places,
    page_figure,
    wrapped,
)
from pincal.show.pictures.sheet import LEVELS, draw_dimensioned, kinds_of_legs
from pincal.show.report.answers import Findings
from pincal.show.report.residual_figures import histogram_figure, residuals_figure
from pincal.show.result_tables import noisy_series, parameters, whose
from pincal.show.style import PAGE, look
from pincal.types import Array
from pincal.words import plots as words
from pincal.words.numbers import SMALL, STORED, per_si, shown_in


@on_page("figure-images")
def images_figure(found: Findings) -> tuple[Figure, str] | None:
    """Return residuals over the images of cameras; None if none measured."""
    if not (every := seen_in(found.result)):
        return None
    drawn = Figure(
        figsize=(PAGE.width, PAGE.width / (0.6 + min(len(every), 2))), layout="compressed"
    )
    over_images(drawn.subplots(), found.result)
    return drawn, words.IMAGES


def _beside(names: Iterable[str]) -> float:
    """Return the width of a legend beside the panels, [inch]."""
    return PAGE.margins["right"] + 0.45 + PAGE.letter * max(map(len, names))


@on_page("figure-poses")
def poses_figure(found: Findings) -> Drawn:
    """Return the measured poses, with the mechanism in the plane (3-RRR paper, Figs. 4, 8)."""
    mechanism = found.result.nominal
    sets = found.result.measurements.sets or ("",) * len(found.poses)
    plan = Plan(found.poses, tuple(one or EVERY_LEG for one in sets))
    below = PAGE.margins["bottom"] + PAGE.line * -(-len(set(sets)) // 4)
    if mechanism.platform.space == 2:
        drawn = page_figure(3.4, bottom=below)
        left, axes = drawn.subplots(1, 2)
        draw_mechanism(left, mechanism)
        if found.errors is not None and found.errors.sampled:
            sampled = per_si("m", STORED) * found.errors.poses[:, :2]
            dot = np.array((7e-3 * float(np.ptp(sampled[:, 0])), 0.0))
            draw_strokes(axes, sampled, sampled + dot, colors="0.75", lw=1.3, zorder=0)
        draw_poses(axes, mechanism, plan)
        axes.set_aspect("equal")
    else:
        drawn = page_figure(3.0, bottom=below)
        home = joints_at(mechanism, home_of(mechanism)).joints
        for axes, seen in zip(drawn.subplots(1, 3), ((0, 1), (0, 2), (1, 2)), strict=True):
            for leg in mechanism.legs:
                if np.isfinite(home[leg.name]).all():
                    points = per_si("m", STORED) * skeleton(leg, home[leg.name][0])[:, seen]
                    axes.plot(*points.T, "-", color="0.75", lw=1.5, zorder=1)
            draw_poses(axes, mechanism, plan, seen)
            axes.set_aspect("equal", adjustable="datalim")
    named = axes.get_legend_handles_labels()
    drawn.legend(*named, loc="lower center", ncols=4, frameon=False)
    plane = mechanism.platform.space == 2
    return drawn, words.poses(len(plan.poses), plane=plane, turns=found.turns)


def _bars(p: IdentifiedParameter) -> tuple[float, ...]:
    """Return how far a bar goes down and up; none where an interval has no end."""
    return tuple(one if np.isfinite(one) else 0.0 for one in p.ends)


@on_page("figure-changes")
def changes_figure(found: Findings) -> Drawn:
    """Return the change of each parameter with its interval; no fixed ones."""
    legs = found.result.legs
    units = {p.name: p.unit for _, p in parameters(found.result) if p.given != "fixed"}
    names, per = list(units), [SMALL[unit] or "10⁻³" for unit in units.values()]
    below = height_of_names(names, per)
    drawn = page_figure(2.7 + below, bottom=below, right=_beside([leg.name for leg in legs]))
    axes = drawn.subplots()
    step = min(0.2, 0.8 / len(legs))
    for index, leg in enumerate(legs):
        free = [p for p in leg.parameters if p.given != "fixed"]
        shift = (index - (len(legs) - 1) / 2) * step
        scale = np.array([per_si(p.unit) if SMALL[p.unit] else 1e3 for p in free])
        colour, marker, _ = look(index)
        axes.errorbar(
            np.array([names.index(p.name) for p in free]) + shift,
            scale * [p.change for p in free],
            scale * np.array([_bars(p) for p in free]).reshape(-1, 2).T,
            fmt=marker,
            color=colour,
            label=label(leg.name),
            ms=4,
            capsize=3,
            lw=1,
        )
    axes.axhline(0.0, color="0.5", lw=0.8)
    name_places(axes, names, per)
    axes.set_ylabel(words.IDENTIFIED_LESS_NOMINAL)
    _legend_outside(axes)
    return drawn, words.CHANGES


@on_page("figure-drawing")
def drawing_figure(found: Findings) -> Drawn:
    """Return the first leg with its dimensions, in the colours of their changes."""
    result = found.result
    leg = result.legs[0].name
    drawn = page_figure(4.6, left=0.1, bottom=0.3, top=0.05)
    axes = draw_dimensioned(drawn.subplots(), result, leg)
    if not axes.lines:  # nothing is drawn that can be seen: out of reach at home
        return None
    keys = [Line2D([], [], color=colour, lw=3, label=said) for _, colour, said in LEVELS]
    drawn.legend(handles=keys, loc="lower center", ncols=3, frameon=False)
    return drawn, words.dimensions(leg, several=len(kinds_of_legs(result)[0]) > 1)


@on_page("figure-rms")
def platform_figure(found: Findings) -> Drawn:
    """Return bars of the platform's errors and of the residuals, before and after (Fig. 10)."""
    if (errors := found.errors) is None:
        return None
    parts: dict[str, dict[str, Array]] = {}
    where = ""
    if found.result.explained:
        both = np.array([errors.mean_before(), errors.mean_after()]).T
        heads = zip(words.PLATFORM, ("m", "rad"), strict=True)
        for own, (head, unit) in zip(both, list(heads)[: 1 + found.turns], strict=False):
            parts[f"{head}\n[{SMALL[unit]}]"] = {wrapped(errors.where, 0.0): per_si(unit) * own}
        where = errors.where
    series = noisy_series(found.result)
    for one in series:
        sizes = np.array([shown_in(value, one.unit) for value in one.rms[:2]])
        parts.setdefault(f"residuals\n[{SMALL[one.unit]}]", {})[one.name] = sizes
    turned = [name for bars in parts.values() if len(bars) > 3 for name in bars]
    lines = 1 + wrapped(where, 0.0).count("\n")
    below = 0.3 + PAGE.line * lines + 0.7 * PAGE.letter * max(map(len, turned), default=0)
    drawn = page_figure(2.5 + below, bottom=below, left=0.4, top=0.4)
    widths = [1.4 + 0.6 * len(bars) for bars in parts.values()]
    panels = np.atleast_1d(drawn.subplots(1, len(parts), width_ratios=widths))
    for axes, (title, bars) in zip(panels, parts.items(), strict=True):
        when = enumerate(words.BEFORE_AFTER)
        draw_bars(
            axes, {k: {name: own[i] for name, own in bars.items()} for i, k in when}, before_after
        )
        axes.set_title(title)
        axes.get_legend().remove()
        many = len(bars) > 3
        for bar in axes.containers:
            axes.bar_label(bar, fmt="%.2g", fontsize=7, rotation=90 * many, padding=2)
        if many:
            axes.tick_params(axis="x", labelrotation=45)
        axes.margins(y=0.18)
    drawn.legend(*panels[0].get_legend_handles_labels(), loc="lower center", ncols=2)
    return drawn, words.errors(where, whose(series))


@on_page("figure-observability")
def observability_figure(found: Findings) -> Drawn:
    """Return |R_ii| of each parameter and leg at the poses used (3-RRR paper, Fig. 9)."""
    mechanism = found.result.nominal
    read = {"m"} if mechanism.by_readings else set(mechanism.reading_units)
    unit = read.pop() if len(read) == 1 else "reading"
    units = {name: leg.units[name] for leg in mechanism.legs for name in leg.parameter_names}
    names = list(dict.fromkeys(name for own in found.observability.values() for name in own))
    per = [unit if units[name] == "1" else f"{unit}/{units[name]}" for name in names]
    below = height_of_names(names, per)
    drawn = page_figure(2.3 + below, bottom=below, right=_beside(list(found.observability)))
    axes = draw_bars(drawn.subplots(), found.observability)
    name_places(axes, names, per)
    axes.set_ylabel(words.OBSERVABILITY)
    _legend_outside(axes)
    return drawn, words.observability(by_readings=mechanism.by_readings)


def _legend_outside(axes: Axes) -> None:
    handles, names = axes.get_legend_handles_labels()
    axes.legend(
        handles, map(label, names), loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False
    )


@on_page("figure-maps")
def maps_figure(found: Findings) -> Drawn:
    """Return the platform's errors over x and y, before and after (3-RRR paper, Figs. 6, 11)."""
    if (maps := found.maps) is None:
        return None
    quantities = ((0, "position", "m"), (1, "orientation", "rad"))[: 1 + found.turns]
    rows = [
        (f"{what} {when}", SMALL[unit], per_si(unit) * values[..., column])
        for column, what, unit in quantities
        for when, values in zip(
            (words.BEFORE_AFTER[0], words.AFTER_EXPECTED), (maps.before, maps.after), strict=True
        )
        if np.isfinite(values[..., column]).any()  # nominal zeros of motors may lead nowhere
    ]
    if not rows:
        return None
    spatial = len(maps.heights) > 1
    across = len(maps.heights) if spatial else min(2, len(rows))
    down = -(-len(rows) * len(maps.heights) // across)
    width = 0.8 * (PAGE.width - 1.4) / (1.3 * across - 0.3)  # the bar of colours takes a fifth
    panel = width * float(np.ptp(maps.y) / np.ptp(maps.x))
    drawn = page_figure(0.9 + down * (panel + 0.5) - 0.5, left=0.8, right=0.6, top=0.45)
    drawn.subplots_adjust(hspace=0.5 / panel)
    panels = iter(drawn.subplots(down, across, sharex=True, sharey=True).ravel())
    units = [unit for _, unit, _ in rows]
    paired = not spatial and all(units.count(unit) == 2 for unit in units)  # side by side
    beside: list[Axes] = []  # of the same bar of colours
    for title, unit, values in rows:
        own = [next(panels) for _ in maps.heights]
        beside = [*beside, *own]
        alike = np.concatenate([own.ravel() for _, other, own in rows if other == unit])
        limits = float(np.nanmin(alike)), float(np.nanmax(alike))
        for axes, error, level in zip(own, values, maps.heights, strict=True):
            draw_map(axes, (maps.x, maps.y), error, limits, decades=True)
            axes.set_title(words.height(level))
        own[0].set_title("\n".join((title, own[0].get_title())) if spatial else title)
        if paired and len(beside) < 2:
            continue
        bar = drawn.colorbar(own[0].images[0], ax=beside, label=unit)
        beside = []
        bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        bar.ax.yaxis.set_minor_locator(NullLocator())
    for axes in panels:
        axes.set_axis_off()
    drawn.supxlabel(words.along("x"), size=8)
    drawn.supylabel(words.along("y"), size=8)
    return drawn, words.maps(turns=found.turns)


#: By what a report calls them.
FIGURES: dict[str, Callable[[Findings], SvgFigure | None]] = {
    "poses": poses_figure,
    "images": images_figure,
    "changes": changes_figure,
    "drawing": drawing_figure,
    "residuals": residuals_figure,
    "histogram": histogram_figure,
    "rms": platform_figure,
    "maps": maps_figure,
    "observability": observability_figure,
}
