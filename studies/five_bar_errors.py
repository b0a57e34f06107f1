"""What calibration leaves of the five-bar's errors, and what it costs (Tables 2, 3, Figs. 5, 6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

import pincal

from . import drawing
from .inscribed import Circle
from .study import Cell, Study
from .trials import Way, position_errors, root_mean_square, values

Array = NDArray[np.float64]
NOISE = pincal.Noise(position=1e-4, reading=1e-4)
INSIDE = 0.95  # of the circle, in which postures are chosen


_SHOWN = (0, 1, 7)  # ways in figures: the paper's, the traditional one, the best


@dataclass(frozen=True)
class Outcome:
    """What a way to calibrate leaves of the errors of the parameters, in m, rad and 1."""

    way: Way
    identified: list[pincal.Mechanism]
    """By draw of the noise."""
    errors: Array
    """Identified less true parameters, shape (n_draws, n)."""
    bound: Array
    """Cramér and Rao's least standard deviation of each parameter, shape (n,)."""

    @classmethod
    def of(
        cls,
        way: Way,
        nominal: pincal.Mechanism,
        truth: pincal.Mechanism,
        identified: list[pincal.Mechanism],
    ) -> Outcome:
        """Return the outcome of a way whose calibrations were done."""
        errors = np.stack([values(one) for one in identified]) - values(truth)
        bound = np.sqrt(np.diagonal(way.bound(nominal, truth, NOISE)))
        return cls(way, identified, errors, bound)

    @property
    def mean(self) -> tuple[float, float]:
        """Root mean square over all parameters and draws, and its standard error."""
        return root_mean_square(self.errors)

    @property
    def single(self) -> list[float]:
        """Root mean square over draws, by parameter."""
        return np.sqrt((self.errors**2).mean(axis=0)).tolist()


def parameters(study: Study, truth: pincal.Mechanism, outcomes: list[Outcome]) -> None:
    """Compare the errors of the parameters (Table 2, Fig. 5)."""
    mechanism = study.mechanism
    before = values(mechanism) - values(truth)
    draws, ways = len(outcomes[0].errors), [one.way for one in outcomes]
    study.heading("Parameters before and after (Tables 2, 3, Fig. 5)")
    study.say(
        f"""Real parameters of Table 2, noise 1e-4 on positions [m] and readings [rad], {draws}
        draws of the noise. Errors are root mean squares over draws and all twelve parameters (m,
        rad and 1 alike), ± their standard error; the bound is Cramér and Rao's for the postures
        that the legs use. Before calibration the error is {np.sqrt((before**2).mean()):.2e}."""
    )
    columns: dict[str, list[Cell]] = {
        "way": [way.name for way in ways],
        "measured postures": [len(way.plan.poses) for way in ways],
        "rows a leg": [
            int(way.plan.serves("leg_1").sum()) if way.poses == "own" else len(way.plan.poses)
            for way in ways
        ],
        "error [m, rad, 1]": [one.mean[0] for one in outcomes],
        "± [m, rad, 1]": [one.mean[1] for one in outcomes],
        "Cramér-Rao bound [m, rad, 1]": [float(np.sqrt((one.bound**2).mean())) for one in outcomes],
    }
    caption = "Error of the parameters by way."
    study.table("table_3_parameter_errors", caption, columns, ["measured postures", "rows a leg"])
    names = [f"{n} ({leg.name})" for leg in mechanism.legs for n in leg.parameter_names]
    single: dict[str, list[Cell]] = {
        "parameter": list(names),
        "nominal": values(mechanism).tolist(),
        "real": values(truth).tolist(),
        "before": np.abs(before).tolist(),
    }
    single |= {one.way.name: [*one.single] for one in outcomes}
    caption = "Each parameter: error before, and after by way, SI units."
    study.table("table_2_parameters", caption, single, list(single))
    paper = outcomes[0]
    worse = [
        f"{name}: {old:.1e} before, {new:.1e} after"
        for name, old, new in zip(names, np.abs(before), paper.single, strict=True)
        if new > old
    ]
    study.say(
        f"""The paper's way makes worse what was right within the noise:
        {"; ".join(worse) or "no parameter"}."""
    )
    shown = [outcomes[index] for index in _SHOWN]
    units = np.array([leg.units[n] for leg in mechanism.legs for n in leg.parameter_names])
    kinds = list(dict.fromkeys(units.tolist()))
    figure = Figure(figsize=(12, 4.6), layout="constrained")
    widths = [int((units == unit).sum()) for unit in kinds]
    for axes, unit in zip(figure.subplots(1, len(kinds), width_ratios=widths), kinds, strict=True):
        kind = np.flatnonzero(units == unit)
        bars = {"before": np.abs(before)[kind].tolist()}
        bars |= {one.way.name: np.array(one.single)[kind].tolist() for one in shown}
        places = drawing.draw_bars(axes, [names[i].replace(" (", "\n(") for i in kind], bars)
        for place, one in zip(places[1:], shown, strict=True):
            bound = np.array(one.bound)[kind]
            axes.hlines(bound, place - 0.1, place + 0.1, color="black", ls="--", lw=1)
        axes.set(yscale="log", ylim=(1e-4, 3e-2), ylabel=f"|identified − real| [{unit}]")
    drawing.legend(figure)
    study.figure(
        "fig_5_parameter_errors",
        f"Fig. 5: errors of the parameters before and after calibration, root mean square "
        f"of {draws} draws; dashes: Cramér-Rao bound",
        figure,
    )


def maps(study: Study, truth: pincal.Mechanism, circle: Circle, outcomes: list[Outcome]) -> None:
    """Map the position error over the circle (Fig. 6)."""
    side = np.linspace(-circle.radius, circle.radius, 25 if study.quick else 61)
    x, y = np.meshgrid(side, side)
    inside = np.hypot(x, y) <= INSIDE * circle.radius
    poses = np.stack((x[inside], y[inside] + circle.centre[1]), axis=1)
    kept = 5 if study.quick else 40
    found = {"before": position_errors(study.mechanism, truth, poses)}
    for one in outcomes:
        squares = [position_errors(model, truth, poses) ** 2 for model in one.identified[:kept]]
        found[one.way.name] = np.sqrt(np.mean(squares, axis=0))
    study.heading("Position error over the circle (Fig. 6)")
    study.table(
        "fig_6_position_errors",
        f"""Position error of the end-effector over {100 * INSIDE:.0f} % of the circle's radius,
        root mean square of {kept} draws (before: of the one machine).""",
        {
            "way": list(found),
            "root mean square [mm]": [1e3 * float(np.sqrt((m**2).mean())) for m in found.values()],
            "largest [mm]": [1e3 * float(m.max()) for m in found.values()],
        },
        ["largest [mm]"],
    )
    shown = {outcomes[index].way.name: found[outcomes[index].way.name] for index in _SHOWN}
    ends = 1e3 * np.concatenate(list(shown.values()))
    norm = LogNorm(ends.min(), ends.max())
    figure, panels = drawing.panels(len(shown), 13, 4.2)
    for axes, (name, errors) in zip(panels, shown.items(), strict=True):
        picture = np.full(x.shape, np.nan)
        picture[inside] = 1e3 * errors
        image = axes.pcolormesh(side, side + circle.centre[1], picture, norm=norm, cmap="cividis")
        drawing.from_above(axes, name)
    figure.colorbar(image, ax=panels, label="position error, root mean square [mm]")
    study.figure(
        "fig_6_error_maps",
        "Fig. 6: local position error after calibration over the maximal inscribed "
        "workspace, less 5 %",
        figure,
    )


def costs(study: Study, ways: list[Way], seconds: dict[str, float]) -> None:
    """Compare what measuring and computing cost (Table 3)."""
    n = [len(leg.parameters) for leg in study.mechanism.legs]
    alone = [way.method == "per-leg" for way in ways]
    study.heading("Costs (Tables 1, 3)")
    legs, each = len(n), n[0]
    general: dict[str, list[Cell]] = {
        "way": ["traditional", "divide and conquer"],
        "regressor": ["CᵀC, N n × N n", "n of CᵀC, N × N"],
        "cost of inversion": ["∝ N³ n³", "∝ N³ n"],
        "here": [(each * legs) ** 3, each**3 * legs],
        "over divide and conquer": [f"n² = {legs**2}", "1"],
    }
    caption = f"""Table 1: inverting one CᵀC of N n × N n costs ∝ N³ n³, n of N × N cost ∝ N³ n;
    with n = {legs} legs of N = {each} parameters {(each * legs) ** 3} and {each**3 * legs}. A leg's
    equations have its own parameters alone: what divides by n² is not to invert zeros."""
    study.table("table_1_costs", caption, general, list(general))
    columns: dict[str, list[Cell]] = {
        "way": [way.name for way in ways],
        "postures": [len(way.plan.poses) for way in ways],
        "measured values": [len(way.plan.poses) * (2 + len(n)) for way in ways],
        "regressors": [
            f"{len(n)} of {n[0]}×{n[0]}" if a else f"1 of {sum(n)}×{sum(n)}" for a in alone
        ],
        "cost of inversion": [sum(k**3 for k in n) if a else sum(n) ** 3 for a in alone],
    }
    caption = """Table 3, by way: measured values are two coordinates and all sensors at each
    posture; the cost is the cube of what a step of the search inverts."""
    study.table("table_3_costs", caption, columns, list(columns))
    study.figure(
        "table_3_times",
        "Table 3: time to choose postures, and to simulate and identify once",
        drawing.times(seconds),
    )
