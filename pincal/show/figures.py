"""Figures of a report: charts across a page with a caption, by the names that its template calls.

Legs differ in colour and in marker or hatch. A figure is None where there is nothing to show.
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
from pincal.show import charts, residual_charts
from pincal.show.answers import ReportFacts
from pincal.show.pictures.figure import draw_scene
from pincal.show.pictures.files import SvgFigure, svg_figure
from pincal.show.pictures.parts import (
    NORMAL,
    axis_name,
    before_after,
    draw_bars,
    draw_map,
    draw_poses,
    draw_strokes,
    height_name,
    name_places,
    page_figure,
    wrapped,
)
from pincal.show.result_tables import noisy_series, whose
from pincal.show.style import IDENTIFIED, PAGE
from pincal.show.view.scene import scene
from pincal.show.workspace_answers import ErrorMaps
from pincal.types import Array
from pincal.words.numbers import SMALL, STORED, per_si, shown_in

#: A figure and its caption, or none where there is nothing to show.
Captioned = tuple[Figure, str] | None
_QUANTITIES = ((0, "position", "m"), (1, "orientation", "rad"))
_LETTER = 0.07  # height of a letter of a name that stands upright, [inch]
_LEVEL_NAMES = 3  # bars, at most, whose names are not turned


def figure(name: str, facts: ReportFacts) -> SvgFigure | None:
    """Return a figure of a report by its name in ``FIGURES``."""
    return svg_figure(f"figure-{name}", lambda: FIGURES[name](facts))


def _chart(
    draw: Callable[[Axes, CalibrationResult], Axes], facts: ReportFacts, caption: str, height: float
) -> Captioned:
    """Return a chart across the page."""
    drawn = page_figure(height)
    draw(drawn.subplots(), facts.result)
    return drawn, caption


def _images(facts: ReportFacts) -> Captioned:
    """Return residuals over the images of cameras."""
    if not (cameras := residual_charts.camera_residuals(facts.result)):
        return None
    caption = (
        "What cameras saw: arrows from each point as seen towards where it is predicted, magnified "
        "alike in all images. Where arrows of a region point one way, the lens is other than its "
        "model."
    )
    height = PAGE.width / (0.6 + min(len(cameras), 2))
    return _chart(residual_charts.images, facts, caption, height)


def _poses(facts: ReportFacts) -> Captioned:
    """Return the measured poses, with the mechanism in the plane (3-RRR paper, Figs. 4, 8)."""
    mechanism = facts.result.nominal
    sets = facts.result.measurements.sets or ("",) * len(facts.poses)
    plan = Plan(facts.poses, tuple(name or EVERY_LEG for name in sets))
    if plane := mechanism.platform.space == 2:
        drawn = page_figure(3.4)
        side, axes = drawn.subplots(1, 2)
        draw_scene(side, scene(mechanism, home_of(mechanism)), 0, colours={})
        if facts.errors is not None and facts.errors.sampled:
            sampled = per_si("m", STORED) * facts.errors.poses[:, :2]
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
        description += "; strokes show the orientation" if facts.turns else ""
    return drawn, f"The {len(plan.poses)} measured poses of the platform, {description}."


def _drawing(facts: ReportFacts) -> Captioned:
    """Return the first leg with its dimensions, in the colours of their changes."""
    result = facts.result
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


def _platform(facts: ReportFacts) -> Captioned:
    """Return bars of the platform's errors and of the residuals, before and after (Fig. 10)."""
    if (errors := facts.errors) is None:
        return None
    panels: dict[str, dict[str, Array]] = {}
    promised = ""
    if facts.result.explained:
        promised = f"the platform's {errors.where} (after: as expected), and "
        sizes = np.array([errors.mean_before(), errors.mean_after()]).T
        for column, quantity, unit in _QUANTITIES[: 1 + facts.turns]:
            bar = {wrapped(errors.where, 0.0): per_si(unit) * sizes[column]}
            panels[f"{quantity}\n[{SMALL[unit]}]"] = bar
    series = noisy_series(facts.result)
    for residuals in series:
        rms = np.array([shown_in(value, residuals.unit) for value in residuals.rms[:2]])
        panels.setdefault(f"residuals\n[{SMALL[residuals.unit]}]", {})[residuals.name] = rms
    longest = max(len(name) for bars in panels.values() for name in bars)
    drawn = page_figure(max(3.4, 2.2 + longest * _LETTER))  # names may stand upright
    widths = [1.4 + 0.6 * len(bars) for bars in panels.values()]
    every_axes = np.atleast_1d(drawn.subplots(1, len(panels), width_ratios=widths))
    for axes, (title, bars) in zip(every_axes, panels.items(), strict=True):
        values = {
            name: {label: sizes[i] for label, sizes in bars.items()}
            for i, name in enumerate(("before", "after"))
        }
        draw_bars(axes, values, before_after)
        axes.set_title(title)
        axes.get_legend().remove()
        turned = len(bars) > _LEVEL_NAMES
        for bar in axes.containers:
            axes.bar_label(bar, fmt="%.2g", fontsize=7, rotation=90 * turned, padding=2)
        if turned:
            axes.tick_params(axis="x", labelrotation=45)
        axes.margins(y=0.18)
    _legend_below(drawn, *every_axes[0].get_legend_handles_labels())
    return drawn, (
        f"Root mean square errors before and after: {promised}the residuals of each "
        f"{whose(series)}."
    )


def _observability(facts: ReportFacts) -> Captioned:
    """Return |R_ii| of each parameter and leg at the poses used (3-RRR paper, Fig. 9)."""
    mechanism = facts.result.nominal
    units = {name: leg.units[name] for leg in mechanism.legs for name in leg.parameter_names}
    names = list(dict.fromkeys(name for values in facts.observability.values() for name in values))
    read = {"m"} if mechanism.by_readings else set(mechanism.reading_units)
    unit = read.pop() if len(read) == 1 else "reading"
    drawn = page_figure(3.4)
    axes = draw_bars(drawn.subplots(), facts.observability)
    name_places(axes, names, [unit if units[n] == "1" else f"{unit}/{units[n]}" for n in names])
    axes.set_ylabel("|Rᵢᵢ|")
    moved = "the leg's end" if mechanism.by_readings else "the readings"
    return drawn, (
        f"Observability of each parameter at the poses used: what it moves {moved} by, all poses "
        "together, less what the parameters to its left can explain. Compare legs with it; "
        "parameters differ in their units."
    )


def _maps(facts: ReportFacts) -> Captioned:
    """Return the platform's errors over x and y, before and after (3-RRR paper, Figs. 6, 11).

    A row of panels for each map in space, one panel for each height; in the plane two side by side.
    """
    if (maps := facts.maps) is None or not (rows := _map_rows(maps, turns=facts.turns)):
        return None
    spatial = len(maps.heights) > 1
    columns = len(maps.heights) if spatial else min(2, len(rows))
    lines = -(-len(rows) * len(maps.heights) // columns)
    panel = 0.8 * PAGE.width / columns * float(np.ptp(maps.y) / np.ptp(maps.x))
    drawn = page_figure(lines * (panel + 0.4) + 0.4)
    panels = drawn.subplots(lines, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for axes in panels[len(rows) * len(maps.heights) :]:
        axes.set_axis_off()
    for unit in dict.fromkeys(unit for _, unit, _ in rows):
        values_of_unit = np.concatenate(
            [values.ravel() for _, row_unit, values in rows if row_unit == unit]
        )
        limits = float(np.nanmin(values_of_unit)), float(np.nanmax(values_of_unit))
        places = [i for i, row in enumerate(rows) if row[1] == unit]
        for i in places:
            title, _, values = rows[i]
            for k, (error, height) in enumerate(zip(values, maps.heights, strict=True)):
                axes = panels[i * len(maps.heights) + k]
                draw_map(axes, (maps.x, maps.y), error, limits, decades=True)
                axes.set_title("\n".join(filter(None, (title * (k == 0), height_name(height)))))
        neighbours = panels[places[0] * len(maps.heights) : (places[-1] + 1) * len(maps.heights)]
        bar = drawn.colorbar(axes.images[0], ax=list(neighbours), label=SMALL[unit])
        bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        bar.ax.yaxis.set_minor_locator(NullLocator())
    drawn.supxlabel(axis_name("x"), size=8)
    drawn.supylabel(axis_name("y"), size=8)
    region = "the workspace at home orientation" if facts.turns else "the workspace"
    return drawn, (
        f"Error of the platform over {region}: how far the nominal model is off, and what is to be "
        "expected of the calibrated one (standard error). One scale of decades for both; white: "
        "not in the workspace."
    )


def _map_rows(maps: ErrorMaps, *, turns: bool) -> list[tuple[str, str, Array]]:
    """Return title, SI unit and errors, as they are read, of each map that is not empty."""
    return [
        (f"{quantity} {name}", unit, per_si(unit) * values[..., column])
        for column, quantity, unit in _QUANTITIES[: 1 + turns]
        for name, values in (("before", maps.before), ("after, expected", maps.after))
        if np.isfinite(values[..., column]).any()  # nominal zeros of motors may lead nowhere
    ]


def _histogram(facts: ReportFacts) -> Captioned:
    """Return the distribution of residuals in standard deviations, against the normal one.

    None if all that was measured is exact.
    """
    white = np.concatenate([series.standardised for series in noisy_series(facts.result)])
    if not len(white := white[np.isfinite(white)]):
        return None
    drawn = page_figure(2.6)
    axes = drawn.subplots()
    limit = min(max(4.0, float(np.ceil(np.abs(white).max()))), 8.0)
    bins = np.linspace(-limit, limit, int(4 * limit) + 1).tolist()
    style: dict[str, Any] = {"color": IDENTIFIED, "edgecolor": "white"}
    axes.hist(
        white.clip(-limit, limit), bins, density=True, label=f"{len(white)} residuals", **style
    )
    z = np.linspace(-limit, limit, 200)
    density = np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi)
    axes.plot(z, density, "k--", lw=1.2, label="normal distribution")
    axes.set(xlabel="residual [standard deviations]", ylabel="density")
    axes.legend(frameon=False)
    percent = 100 * float((np.abs(white) > NORMAL).mean())
    return drawn, (
        "Distribution of the residuals after the calibration, each over its own standard "
        "deviation: the noise, less what the fit takes up of it. "
        f"{percent:.0f} % are larger than 1.96; expected are 5 %."
    )


def _legend_below(drawn: Figure, handles: Iterable[Any], names: Iterable[str]) -> None:
    """Put one legend below all panels of a figure."""
    drawn.legend(list(handles), list(names), loc="outside lower center", ncols=4, frameon=False)


_CHANGES = (
    "Change of each parameter from nominal over half its 95 % interval. Bars between the dashed "
    "lines: the measurements do not distinguish the nominal value from the identified one."
)
_RESIDUALS = (
    "Residuals after the calibration against the row of the measurements, each over its standard "
    "deviation: the noise less what the fit takes up of it, σ√(1−h). Between the dashed lines 95 "
    "of 100 are expected. Rings: rows that do not fit the others; crosses at the upper edge: rows "
    "that were rejected."
)
#: By what a report calls them.
FIGURES: dict[str, Callable[[ReportFacts], Captioned]] = {
    "poses": _poses,
    "images": _images,
    "changes": lambda facts: _chart(charts.changes, facts, _CHANGES, 3.4),
    "drawing": _drawing,
    "residuals": lambda facts: _chart(residual_charts.residuals, facts, _RESIDUALS, 3.4),
    "histogram": _histogram,
    "rms": _platform,
    "maps": _maps,
    "observability": _observability,
}
