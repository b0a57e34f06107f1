"""What calibration leaves of the five-bar's errors, and what it costs (Tables 2, 3, Figs. 5, 6)."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pincal.design.simulate import platform_errors
from pincal.model.measurements import Noise
from pincal.model.mechanism import Mechanism
from pincal.show.style import COLOURS, HATCHES
from pincal.studies.study import Cell, Study
from pincal.studies.trials import (
    Way,
    root_mean_square,
    times_figure,
    values,
)
from pincal.workspace.inscribed import Inscribed

Array = NDArray[np.float64]
NOISE = Noise(position=1e-4, reading=1e-4)
INSIDE = 0.95  # of the circle, in which postures are chosen


def parameters(
    study: Study,
    mechanism: Mechanism,
    truth: Mechanism,
    ways: list[Way],
    errors: dict[str, Array],
) -> dict[str, tuple[float, float]]:
    """Compare the errors of the parameters (Table 2, Fig. 5), and return their means."""
    before = values(mechanism) - values(truth)
    means = {name: root_mean_square(found) for name, found in errors.items()}
    bounds = {way.name: np.sqrt(np.diagonal(way.bound(mechanism, truth, NOISE))) for way in ways}
    draws = len(errors[ways[0].name])
    study.heading("Parameters before and after (Tables 2, 3, Fig. 5)")
    study.say(
        f"""Real parameters as in Table 2, noise 1e-4 on positions [m] and readings [rad], {draws}
        draws of the noise. The error is the root mean square over all twelve parameters, in m, rad
        and 1 alike, and over draws; ± is its standard error. The bound is Cramér and Rao's for
        the postures that the legs use: no unbiased estimator is better. Before calibration the
        error is {np.sqrt((before**2).mean()):.2e}."""
    )
    columns: dict[str, list[Cell]] = {
        "way": [way.name for way in ways],
        "measured postures": [len(way.plan.poses) for way in ways],
        "rows a leg": [
            int(way.plan.serves("leg_1").sum()) if way.poses == "own" else len(way.plan.poses)
            for way in ways
        ],
        "error [m, rad, 1]": [means[way.name][0] for way in ways],
        "± [m, rad, 1]": [means[way.name][1] for way in ways],
        "Cramér-Rao bound [m, rad, 1]": [
            float(np.sqrt((bounds[w.name] ** 2).mean())) for w in ways
        ],
    }
    study.table("table_3_parameter_errors", "Error of the parameters by way.", columns)
    names = [f"{n} ({leg.name})" for leg in mechanism.legs for n in leg.parameter_names]
    single: dict[str, list[Cell]] = {
        "parameter": list(names),
        "nominal": values(mechanism).tolist(),
        "real": values(truth).tolist(),
        "before": np.abs(before).tolist(),
    }
    for way in ways:
        single[way.name] = np.sqrt((errors[way.name] ** 2).mean(axis=0)).tolist()
    study.table(
        "table_2_parameters", "Each parameter: error before, and after by way, SI units.", single
    )
    study.figure(
        "fig_5_parameter_errors",
        f"Fig. 5: errors of the parameters before and after calibration, root mean square "
        f"of {draws} draws; dashes: Cramér-Rao bound",
        bars_by_parameter(names, before, ways, errors, bounds),
    )
    return means


def bars_by_parameter(
    names: list[str],
    before: Array,
    ways: list[Way],
    errors: dict[str, Array],
    bounds: dict[str, Array],
) -> Figure:
    """Return Fig. 5: bars by parameter, on a logarithmic scale."""
    shown = [ways[0], ways[1], ways[7]]
    figure = Figure(figsize=(12, 4.6), layout="constrained")
    axes = figure.subplots()
    place, width = np.arange(len(names)), 0.2
    axes.bar(place - 1.5 * width, np.abs(before), width, color="0.75", label="before")
    for index, way in enumerate(shown):
        at = place + (index - 0.5) * width
        height = np.sqrt((errors[way.name] ** 2).mean(axis=0))
        axes.bar(
            at,
            height,
            width,
            color=COLOURS[index],
            hatch=HATCHES[index],
            edgecolor="white",
            label=way.name,
        )
        axes.hlines(bounds[way.name], at - width / 2, at + width / 2, color="black", ls="--", lw=1)
    axes.set_yscale("log")
    axes.set_ylim(1e-4, 3e-2)
    axes.set_xticks(place, [name.replace(" (", "\n(") for name in names], fontsize=8)
    axes.set_ylabel("|identified − real| [m], [rad], [1]")
    axes.legend(fontsize=8, ncols=4, loc="upper left")
    return figure


def maps(
    study: Study,
    mechanism: Mechanism,
    truth: Mechanism,
    circle: Inscribed,
    found: dict[str, list[Mechanism]],
    quick: bool,
) -> None:
    """Map the position error over the circle (Fig. 6)."""
    r = circle.radius
    n = 25 if quick else 61
    side = np.linspace(-r, r, n)
    x, y = np.meshgrid(side, side)
    inside = np.hypot(x, y) <= INSIDE * r
    poses = np.stack((x[inside], y[inside] + circle.centre[1]), axis=1)
    kept = 5 if quick else 40
    maps, table = {}, {}
    first = np.linalg.norm(platform_errors(mechanism, truth, poses), axis=1)
    table["before"] = first
    for name, identified in found.items():
        squares = [
            (platform_errors(model, truth, poses) ** 2).sum(axis=1) for model in identified[:kept]
        ]
        maps[name] = table[name] = np.sqrt(np.mean(squares, axis=0))
    study.heading("Position error over the circle (Fig. 6)")
    study.table(
        "fig_6_position_errors",
        f"""Position error of the end-effector over {100 * INSIDE:.0f} % of the circle's radius,
        root
        mean square of {kept} draws (before: of the one machine); the largest is over the
        circle.""",
        {
            "way": list(table),
            "root mean square [mm]": [1e3 * float(np.sqrt((m**2).mean())) for m in table.values()],
            "largest [mm]": [1e3 * float(m.max()) for m in table.values()],
        },
    )
    shown = {name: maps[name] for name in list(found)[:2] + list(found)[7:8]}
    figure = Figure(figsize=(13, 4.2), layout="constrained")
    top = 1e3 * max(float(m.max()) for m in shown.values())
    bottom = 1e3 * min(float(m.min()) for m in shown.values())
    panels = figure.subplots(1, len(shown), sharey=True)
    for axes, (name, errors) in zip(panels, shown.items(), strict=True):
        picture = np.full(x.shape, np.nan)
        picture[inside] = 1e3 * errors
        image = axes.pcolormesh(
            side, side + circle.centre[1], picture, norm=LogNorm(bottom, top), cmap="viridis"
        )
        axes.set_title(name)
        axes.set_aspect("equal")
        axes.set_xlabel("x [m]")
    panels[0].set_ylabel("y [m]")
    figure.colorbar(image, ax=panels, label="position error, root mean square [mm]")
    study.figure(
        "fig_6_error_maps",
        "Fig. 6: local position error after calibration over the maximal inscribed "
        "workspace, less 5 %",
        figure,
    )


def costs(study: Study, mechanism: Mechanism, ways: list[Way], seconds: dict[str, float]) -> None:
    """Compare what measuring and computing cost (Table 3)."""
    legs = len(mechanism.legs)
    n = [len(leg.parameters) for leg in mechanism.legs]
    alone = [way.method == "per-leg" for way in ways]
    study.heading("Costs (Table 3)")
    study.table(
        "table_3_costs",
        """Measured values: two coordinates and all sensors at each posture. The regressor is what a
        step of the search inverts; its cost is counted as the cube of its size.""",
        {
            "way": [way.name for way in ways],
            "postures": [len(way.plan.poses) for way in ways],
            "measured values": [len(way.plan.poses) * (2 + legs) for way in ways],
            "regressors": [
                f"{legs} of {n[0]}×{n[0]}" if a else f"1 of {sum(n)}×{sum(n)}" for a in alone
            ],
            "cost of inversion": [sum(k**3 for k in n) if a else sum(n) ** 3 for a in alone],
        },
    )
    study.figure(
        "table_3_times",
        "Table 3: time to choose postures, and to simulate and identify once",
        times_figure(seconds),
    )
