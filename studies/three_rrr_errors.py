"""What calibration can reach, and reaches, on the 3-RRR (Figs. 10, 11)."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

import pincal

from . import drawing
from .study import Cell, Study, by_rows
from .trials import Method, Way, machines, platform_rms, position_errors

Array = NDArray[np.float64]
NOISE = pincal.Noise(position=1e-4, orientation=1e-4)  # Eq. 23
SIGMA = 2e-3  # of the parameters' errors


def cramer_rao(study: Study, ways: list[Way]) -> dict[str, tuple[float, float]]:
    """Compare the Cramér-Rao bounds of ways; return their gains over the first way."""
    mechanism, kinds, own = study.mechanism, {}, {}
    for way in ways:
        method: Method = "all-legs" if way.residual == "closure" else "per-leg"
        covariance = way.bound(mechanism, mechanism, NOISE, method)
        single = float(np.exp(np.log(np.diagonal(covariance)).mean() / 2))
        kinds[way.name] = (single, _axes([covariance]))
        sizes = np.cumsum([len(leg.parameters) for leg in mechanism.legs])[:-1]
        legs = np.split(np.arange(len(covariance)), sizes)
        own[way.name] = _axes([covariance[np.ix_(leg, leg)] for leg in legs])
    first = kinds[ways[0].name]
    gains = {name: (first[0] / one, first[1] / two) for name, (one, two) in kinds.items()}
    columns: dict[str, list[Cell]] = {
        "way": list(kinds),
        "measured poses": [len(way.plan.poses) for way in ways],
        "bound, parameters [m, rad, 1]": [one for one, _ in kinds.values()],
        "gain": [one for one, _ in gains.values()],
        "bound, axes [m, rad, 1]": [two for _, two in kinds.values()],
        "gain by axes, each leg's own": [own[ways[0].name] / one for one in own.values()],
        "gain by axes, full": [two for _, two in gains.values()],
    }
    study.heading("What the poses can give")
    caption = """Cramér-Rao bound at the nominal mechanism: of estimators that identify leg by leg,
    and, where whitened together, of the data. Gains over the paper's, in the last table, are of the
    geometric mean over all 24 parameters (m, rad and 1 alike), and of the principal axes of their
    ellipsoid, det^(1/2n), as D-optimality has it, with the noise of a pose that the legs share."""
    study.table("cramer_rao_bounds", caption, columns, list(columns))
    return gains


def _axes(covariances: list[Array]) -> float:
    """Return the geometric mean of the principal axes of the ellipsoids of some covariances."""
    logs = sum(float(np.linalg.slogdet(one)[1]) for one in covariances)
    return float(np.exp(logs / (2 * sum(len(one) for one in covariances))))


def asymmetry(study: Study, plan: pincal.Plan, count: int) -> None:
    """Say how fast the symmetric design loses its equal observability on machines as they are."""
    mechanism = study.mechanism

    def observed(machine: pincal.Mechanism) -> tuple[Array, Array]:
        index, diagonals = [], []
        for leg in machine.leg_names:
            C = pincal.identification_jacobian(machine, leg, plan.poses[plan.serves(leg)])
            C = C[np.isfinite(C).all(axis=1)]  # at the edge, a pose may be out of reach
            index.append(pincal.indices(C).O1)
            diagonals.append(np.abs(np.diagonal(np.linalg.qr(C, mode="r"))))
        return np.array(index), np.array(diagonals)

    nominal, rows = observed(mechanism), []
    for sigma in (5e-4, 1e-3, SIGMA, 5e-3):
        changes = []
        for truth, _ in machines(mechanism, sigma, study.seed, count):
            found = observed(truth)
            both = (np.abs(a / b - 1.0).max() for a, b in zip(found, nominal, strict=True))
            changes.append([100.0 * float(one) for one in both])
        middle, most = np.median(changes, axis=0), np.max(changes, axis=0)
        rows.append((sigma, middle[0], most[0], middle[1], most[1]))
    study.heading("How fast a nominal design loses with asymmetry")
    headers = (
        "σ [m, rad, 1]",
        *(f"{w} [%]" for w in ("O₁", "O₁, worst", "R_ii", "R_ii, worst")),
    )
    study.table(
        "asymmetry",
        f"""The nominal mechanism's symmetric selection on {count} machines disturbed by σ: largest
        change of any leg's O₁, and of any |R_ii|, median of the machines and worst. The paper calls
        the change of the Jacobian negligible.""",
        by_rows(headers, rows),
    )


def measure_accuracies(study: Study, ways: list[Way], poses: Array, count: int) -> dict[str, Array]:
    """Compare the platform's errors before and after (Fig. 10), by machine."""
    mechanism = study.mechanism
    some = poses[:: len(poses) // (100 if study.quick else 1000)]
    rows: dict[str, list[tuple[float, float]]] = {
        name: [] for name in ("before", *(way.name for way in ways))
    }
    lost = 0
    trials = machines(mechanism, SIGMA, study.seed, count)
    for truth, noise in trials:
        rows["before"].append(platform_rms(mechanism, truth, some))
        for way in ways:
            identified, converged = way.run(mechanism, truth, NOISE, noise)
            lost += not converged
            rows[way.name].append(platform_rms(identified, truth, some))
    after = {name: np.array(values) for name, values in rows.items()}
    truth, noise = trials[0]
    one = ways[0].run(mechanism, truth, NOISE, noise)[0]
    whole = [platform_rms(model, truth, poses) for model in (mechanism, one)]
    study.heading("Accuracy of the platform (Fig. 10)")
    study.say(
        f"""{count} machines, parameters disturbed by σ = {SIGMA:g} m, rad and 1, noise of Eq. 23;
        {lost} calibrations did not converge. Root mean squares over {len(some):,} poses, medians of
        the machines. The first machine, over all {len(poses):,} poses: {1e3 * whole[0][0]:.3g} mm
        and {1e3 * whole[0][1]:.3g} mrad before, {1e3 * whole[1][0]:.3g} mm and
        {1e3 * whole[1][1]:.3g} mrad after the paper's procedure."""
    )
    columns: dict[str, list[Cell]] = {"way": list(after)}
    for place, what, unit in ((0, "position", "mm"), (1, "orientation", "mrad")):
        for name, level in (("", 50), (", a quarter below", 25), (", a quarter above", 75)):
            columns[f"{what}{name} [{unit}]"] = [
                float(1e3 * np.percentile(v[:, place], level)) for v in after.values()
            ]
    caption = "Errors of the platform, which the figure shows."
    study.table("fig_10_accuracy", caption, columns, list(columns))
    figure, panels = drawing.panels(2, 12, 4.6)
    for place, unit in enumerate(("position [mm]", "orientation [mrad]")):
        axes = panels[place]
        for index, (name, found) in enumerate(after.items()):
            low, middle, high = 1e3 * np.percentile(found[:, place], [25, 50, 75])
            axes.barh(name, middle, color=drawing.AFTER if index else drawing.BEFORE)
            ends = [[middle - low], [high - middle]]
            axes.errorbar(middle, name, xerr=ends, color="black", capsize=3)
            axes.annotate(f" {middle:.3g}", (high, index), va="center", size=8)
        axes.set(xscale="log", xlabel=f"{unit}, root mean square")
        axes.margins(x=0.15)
        axes.invert_yaxis()
    panels[1].set_yticklabels([])
    study.figure(
        "fig_10_accuracy",
        "Fig. 10: error of the platform over the workspace, median of machines and middle half",
        figure,
    )
    return after


def draw_maps(study: Study, way: Way, planes: dict[float, pincal.Workspace]) -> None:
    """Map the position error of one machine before and after (Fig. 11)."""
    mechanism = study.mechanism
    truth, noise = machines(mechanism, SIGMA, study.seed, 1)[0]
    identified = way.run(mechanism, truth, NOISE, noise)[0]
    study.heading("Where the errors are (Fig. 11)")
    figure = Figure(figsize=(13, 7.6), layout="constrained")
    panels = figure.subplots(2, len(planes), sharex=True, sharey=True)
    for row, (name, model) in zip(
        panels, (("before", mechanism), ("after", identified)), strict=True
    ):
        found = {}
        for turn, plane in planes.items():
            poses = np.column_stack((plane.positions[:, :2], np.full(plane.count, turn)))
            found[turn] = poses, 1e3 * position_errors(model, truth, poses)
        ends = np.concatenate([errors for _, errors in found.values()])
        norm = LogNorm(np.nanpercentile(ends, 1), np.nanmax(ends))
        for axes, (turn, (poses, errors)) in zip(row, found.items(), strict=True):
            look = {"norm": norm, "cmap": "cividis", "s": 4, "lw": 0, "rasterized": True}
            image = axes.scatter(*poses[:, :2].T, c=errors, **look)
            drawing.from_above(axes, f"{name}, φ = {turn:g} rad")
        figure.colorbar(image, ax=row, label="position error [mm]")
    study.figure(
        "fig_11_error_maps",
        "Fig. 11: position error of the first machine at constant orientations, before and after "
        "(colours from the first percentile)",
        figure,
    )
