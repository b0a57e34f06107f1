"""Plots of mechanisms, selected poses, observability and results, for paper and screen.

Every function draws into matplotlib axes and returns them. Legs differ in colour and in
marker or hatch, so that plots read in black and white and in colour-blindness.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from numpy.typing import NDArray

from pincal.calibration.result import CalibrationResult
from pincal.design.select import Selection
from pincal.kinematics.inverse import inverse
from pincal.kinematics.readers import skeleton
from pincal.model.measurements import EVERY_LEG, Plan
from pincal.model.mechanism import Mechanism
from pincal.show.colours import COLOURS

Array = NDArray[np.float64]

MARKERS = ("o", "^", "s", "D", "v", "P", "X")
HATCHES = ("", "//", "..", "xx", "\\\\", "++", "oo")
_MANY_NAMES = 14  # that do not fit side by side


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
        colour = COLOURS[index % len(COLOURS)]
        axes.plot(points[:, 0], points[:, 1], "-", color=colour, lw=2.5, zorder=2)
        axes.plot(*points[0, :2], "s", color=colour, ms=9, zorder=3)
        axes.plot(*points[1:, :2].T, "o", color="white", mec=colour, ms=6, zorder=3)
        base = (float(points[0, 0]), float(points[0, 1]))
        axes.annotate(leg.name, base, xytext=(6, -14), textcoords="offset points", size=8)
        corners.append(points[-1, :2])
    if len({tuple(c.round(9)) for c in corners}) > 2:
        axes.fill(*np.array(corners).T, color="0.5", alpha=0.4, zorder=1)
    axes.margins(0.18)
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    return axes


def draw_poses(
    axes: Axes, mechanism: Mechanism, plan: Plan, candidates: Array | None = None
) -> Axes:
    """Draw poses of a plan by set, over candidates; a stroke shows the orientation."""
    if candidates is not None:
        axes.plot(*candidates[:, :2].T, ",", color="0.8", zorder=0)
    names = (*mechanism.leg_names, EVERY_LEG)
    sets = plan.sets or (EVERY_LEG,) * len(plan.poses)
    size = 0.05 * float(np.ptp(plan.poses[:, :2], axis=0).max())
    for index, name in enumerate(names):
        own = plan.poses[[s == name for s in sets]]
        if not len(own):
            continue
        colour, marker = COLOURS[index % len(COLOURS)], MARKERS[index % len(MARKERS)]
        label = f"set {name}" if name != EVERY_LEG else "every leg"
        axes.plot(*own[:, :2].T, marker, color=colour, ms=4, label=label, zorder=2)
        if "phi" in mechanism.platform.coordinates:
            end = own[:, :2] + size * np.stack((np.cos(own[:, 2]), np.sin(own[:, 2])), axis=1)
            strokes = list(np.stack((own[:, :2], end), axis=1))
            axes.add_collection(LineCollection(strokes, colors=colour, lw=0.8, zorder=2))
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.legend(fontsize=8, framealpha=0.9, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return axes


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
    """Draw bars of several series side by side, by series, then by what stands below them."""
    names = list(dict.fromkeys(name for series in values.values() for name in series))
    width = 0.8 / len(values)
    for index, (label, series) in enumerate(values.items()):
        places = np.array([names.index(name) for name in series])
        axes.bar(
            places + (index - (len(values) - 1) / 2) * width,
            list(series.values()),
            width,
            label=shown_label(label),
            color=COLOURS[index % len(COLOURS)],
            hatch=HATCHES[index % len(HATCHES)],
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
    shown = [p for leg in result.legs for p in leg.parameters if p.given != "fixed"]
    units = {p.name: p.unit for p in shown}
    names = list(units)
    step = min(0.2, 0.8 / len(result.legs))
    for index, leg in enumerate(result.legs):
        shift = (index - (len(result.legs) - 1) / 2) * step
        free = [p for p in leg.parameters if p.given != "fixed"]
        change = 1e3 * np.array([p.identified - p.nominal for p in free])
        half = 1e3 * np.array([(p.high - p.low) / 2 for p in free])
        axes.errorbar(
            np.array([names.index(p.name) for p in free]) + shift,
            change,
            half,
            fmt=MARKERS[index % len(MARKERS)],
            color=COLOURS[index % len(COLOURS)],
            label=shown_label(leg.name),
            ms=4,
            capsize=3,
            lw=1,
        )
    unit = {"m": "mm", "rad": "mrad", "1": "10⁻³"}
    axes.axhline(0.0, color="0.5", lw=0.8)
    name_places(axes, names, [unit[units[name]] for name in names])
    axes.set_ylabel("identified − nominal, ± 95 %")
    axes.legend(fontsize=8)
    return axes
