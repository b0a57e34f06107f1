"""What calibration can reach, and reaches, on the 3-RRR (Figs. 10, 11)."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pincal.design.simulate import platform_errors
from pincal.identification.task import Method
from pincal.model.measurements import Noise
from pincal.model.mechanism import Mechanism
from pincal.show.style import COLOURS, HATCHES
from pincal.studies.study import Cell, Study
from pincal.studies.trials import Way, machines, platform_rms
from pincal.workspace.region import Workspace

Array = NDArray[np.float64]
NOISE = Noise(position=1e-4, orientation=1e-4)  # Eq. 23
SIGMA = 2e-3  # of the parameters' errors


def cramer_rao(
    study: Study, mechanism: Mechanism, ways: list[Way]
) -> dict[str, tuple[float, float]]:
    """Compare the Cramér-Rao bounds of ways; return their gains over the first way."""
    kinds = {}
    for way in ways:
        method: Method = "together" if way.residual == "closure" else "per-leg"
        covariance = way.bound(mechanism, mechanism, NOISE, method)
        single = float(np.exp(np.log(np.diagonal(covariance)).mean() / 2))
        axes = float(np.exp(np.linalg.slogdet(covariance)[1] / (2 * len(covariance))))
        kinds[way.name] = (single, axes)
    first = kinds[ways[0].name]
    gains = {name: (first[0] / one, first[1] / two) for name, (one, two) in kinds.items()}
    study.heading("What the poses can give")
    study.table(
        "cramer_rao_bounds",
        """Cramér-Rao bound at the nominal mechanism: of estimators that identify leg by leg, and,
        where whitened together, of the data. Geometric mean over all 24 parameters (m, rad and 1
        alike), and over the principal axes of their ellipsoid, det^(1/2n), which D-optimality looks
        at. Gains are over the paper's.""",
        {
            "way": list(kinds),
            "measured poses": [len(way.plan.poses) for way in ways],
            "bound, parameters [m, rad, 1]": [one for one, _ in kinds.values()],
            "gain": [one for one, _ in gains.values()],
            "bound, axes [m, rad, 1]": [two for _, two in kinds.values()],
            "gain by axes": [two for _, two in gains.values()],
        },
    )
    return gains


def measure_accuracies(
    study: Study,
    mechanism: Mechanism,
    ways: list[Way],
    poses: Array,
    seed: int,
    count: int,
    quick: bool,
) -> dict[str, Array]:
    """Compare the platform's errors before and after (Fig. 10), by machine."""
    some = poses[:: len(poses) // (100 if quick else 1000)]
    rows: dict[str, list[tuple[float, float]]] = {
        name: [] for name in ("before", *(way.name for way in ways))
    }
    lost = 0
    trials = machines(mechanism, SIGMA, seed, count)
    for truth, noise in trials:
        rows["before"].append(platform_rms(mechanism, truth, some))
        for way in ways:
            result = way.run(mechanism, truth, NOISE, noise)
            lost += not result.converged
            rows[way.name].append(platform_rms(result.identified, truth, some))
    after = {name: np.array(values) for name, values in rows.items()}
    truth, noise = trials[0]
    one = ways[0].run(mechanism, truth, NOISE, noise).identified
    whole = [platform_rms(model, truth, poses) for model in (mechanism, one)]
    study.heading("Accuracy of the platform (Fig. 10)")
    study.say(
        f"""{count} machines, parameters disturbed by σ = {SIGMA:g} m, rad and 1, noise of Eq.
        23. Root
        mean square over {len(some):,} of the poses, as median of the machines with the middle half.
        {lost} calibrations did not converge. For the first machine, over all {len(poses):,}
        poses: {1e3 * whole[0][0]:.3g} mm and {1e3 * whole[0][1]:.3g} mrad before,
        {1e3 * whole[1][0]:.3g} mm and {1e3 * whole[1][1]:.3g} mrad after the paper's procedure."""
    )
    columns: dict[str, list[Cell]] = {"way": list(after)}
    for place, what, unit in ((0, "position", "mm"), (1, "orientation", "mrad")):
        for name, level in (("", 50), (", a quarter below", 25), (", a quarter above", 75)):
            columns[f"{what}{name} [{unit}]"] = [
                float(1e3 * np.percentile(v[:, place], level)) for v in after.values()
            ]
    study.table("fig_10_accuracy", "Errors of the platform before and after calibration.", columns)
    figure = Figure(figsize=(12, 4.6), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    for axes, place, unit in (
        (panels[0], 0, "position [mm]"),
        (panels[1], 1, "orientation [mrad]"),
    ):
        for index, (name, found) in enumerate(after.items()):
            low, middle, high = 1e3 * np.percentile(found[:, place], [25, 50, 75])
            colour = "0.75" if name == "before" else COLOURS[(index - 1) % len(COLOURS)]
            axes.barh(name, middle, color=colour, hatch=HATCHES[index % len(HATCHES)], ec="white")
            axes.errorbar(
                middle, name, xerr=[[middle - low], [high - middle]], color="black", capsize=3
            )
            axes.annotate(f" {middle:.3g}", (high, index), va="center", size=8)
        axes.set_xscale("log")
        axes.set_xlabel(f"{unit}, root mean square")
        axes.margins(x=0.15)
    panels[0].invert_yaxis()
    study.figure(
        "fig_10_accuracy",
        "Fig. 10: error of the platform over the workspace, median of machines and middle half",
        figure,
    )
    return after


def draw_maps(
    study: Study, mechanism: Mechanism, way: Way, planes: dict[float, Workspace], seed: int
) -> None:
    """Map the position error of one machine before and after (Fig. 11)."""
    truth, noise = machines(mechanism, SIGMA, seed, 1)[0]
    identified = way.run(mechanism, truth, NOISE, noise).identified
    figure = Figure(figsize=(13, 7.6), layout="constrained")
    panels = figure.subplots(2, len(planes), sharex=True, sharey=True)
    for row, (name, model) in zip(
        panels, (("before", mechanism), ("after", identified)), strict=True
    ):
        found = {}
        for turn, plane in planes.items():
            poses = np.column_stack((plane.positions[:, :2], np.full(plane.count, turn)))
            errors = platform_errors(model, truth, poses)[:, :2]
            found[turn] = poses, 1e3 * np.linalg.norm(errors, axis=1)
        ends = np.concatenate([errors for _, errors in found.values()])
        norm = LogNorm(np.nanpercentile(ends, 1), np.nanmax(ends))
        for axes, (turn, (poses, errors)) in zip(row, found.items(), strict=True):
            image = axes.scatter(
                poses[:, 0], poses[:, 1], c=errors, norm=norm, s=4, lw=0, rasterized=True
            )
            axes.set_title(f"{name}, φ = {turn:g} rad")
            axes.set_aspect("equal")
            axes.set_xlabel("x [m]")
        figure.colorbar(image, ax=row, label="position error [mm]")
        row[0].set_ylabel("y [m]")
    study.heading("Where the errors are (Fig. 11)")
    study.figure(
        "fig_11_error_maps",
        "Fig. 11: position error of the first machine at constant orientations, before and after "
        "(colours from the first percentile)",
        figure,
    )
