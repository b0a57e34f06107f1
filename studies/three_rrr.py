"""Symmetrical observability on the 3-RRR: one leg's poses mapped to all (3-RRR paper)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pincal.design.select import Protocol, Selection
from pincal.files.mechanism_folders import load_mechanism
from pincal.identification.residuals import Residual
from pincal.identification.task import Method
from pincal.model.mechanism import Mechanism
from pincal.show.plots import draw_mechanism, draw_observability, draw_poses
from pincal.show.workspace_plots import articular_figure, draw_workspace
from pincal.symmetry.detect import symmetry_group
from pincal.workspace.articular import articular_space, articular_symmetry
from pincal.workspace.orientations import Orientations
from pincal.workspace.positions import Grid
from pincal.workspace.region import Workspace, compute_workspace
from pincal.workspace.sampling import sample_workspace

from .study import Claim, Study
from .three_rrr_errors import NOISE, cramer_rao, draw_maps, measure_accuracies
from .trials import Way, choose, paired, times_figure

Array = NDArray[np.float64]
PAPER = "Symmetrical observability of kinematic parameters in symmetrical-parallel mechanisms"
PAPERS = "symmetric, own 24 (the paper's)"
COMMON = "24 common (traditional)"
TURNS = (0.0, 0.4, 0.6)
CHOICES: dict[str, tuple[Protocol, int]] = {
    "symmetric, 24 a leg": ("symmetric", 24),
    "independent, 24 a leg": ("independent", 24),
    "24 common": ("common", 24),
    "72 common": ("common", 72),
    "24 orbits": ("orbits", 24),
    "8 orbits": ("orbits", 8),
}


def run(seed: int, quick: bool, progress: Callable[[str], None]) -> Study:
    """Return the study of the 3-RRR."""
    mechanism = load_mechanism("3RRR")
    study = Study("3RRR", "3-RRR: symmetrical observability", PAPER, "pincal study 3RRR")
    progress("workspace and articular-variables space")
    poses = sample_workspace(mechanism, 2_000 if quick else 30_000, seed)
    planes, reached = _spaces(study, mechanism, poses, quick)
    progress("choosing poses")
    selections, seconds = _selections(study, mechanism, poses, seed, quick)
    ways = _ways(selections)
    bounds = cramer_rao(study, mechanism, ways)
    machines = 3 if quick else 100
    progress(f"{machines} machines calibrated in each of {len(ways)} ways")
    after = measure_accuracies(study, mechanism, ways, poses, seed, machines, quick)
    progress("mapping errors")
    draw_maps(study, mechanism, ways[0], planes, seed)
    _times(study, seconds)
    _against(study, mechanism, reached, selections, bounds, after)
    return study


def _spaces(
    study: Study, mechanism: Mechanism, poses: Array, quick: bool
) -> tuple[dict[float, Workspace], str]:
    """Check the symmetry of the workspace and of the readings (Figs. 5, 7)."""
    step = 0.04 if quick else 0.01
    grid = Grid.of(
        f"radius={step / 2}:0.8:{step}", "bearing [deg]=0:359:" + ("4" if quick else "1")
    )
    platform, group = mechanism.platform, symmetry_group(mechanism)
    planes = {
        turn: compute_workspace(
            mechanism, "constant-orientation", grid, Orientations.of(platform, f"phi={turn}")
        )
        for turn in TURNS
    }
    study.heading("Workspace and articular-variables space (Figs. 5, 7)")
    found = "; ".join(str(b) for b in group.breaks)
    study.say(
        f"""{len(poses):,} poses, spread evenly over the workspace that is connected to home, with
        margins of 0.23 (type 1) and 0.2 (type 2) from singularities. The group of the geometry
        with its working mode is {", ".join(str(e) for e in group.elements)}. The three
        reflections of Eq. 18 map the geometry but not the working mode: {found}."""
    )
    carried, rows = [], []
    for turn, plane in planes.items():
        inside = [plane.test(plane.positions @ e.matrix.T).mean() for e in group.elements]
        rows.append(f"φ = {turn:g} rad")
        carried.append((plane.count, plane.measure, plane.uncertainty, float(min(inside))))
    study.table(
        "fig_5_workspaces",
        "Constant orientation workspaces, and which share of them rotations keep inside.",
        {
            "orientation": rows,
            "cells": [c[0] for c in carried],
            "area [m²]": [c[1] for c in carried],
            "± [m²]": [c[2] for c in carried],
            "kept by rotations": [c[3] for c in carried],
        },
    )
    figure = Figure(figsize=(13, 4.6), layout="constrained")
    for axes, (turn, plane) in zip(figure.subplots(1, 3), planes.items(), strict=True):
        draw_workspace(axes, plane, plain=True)
        draw_mechanism(axes, mechanism, np.array([0.0, 0.0, turn]))
        axes.set_title(f"φ = {turn:g} rad, {plane.measure:.3f} m²")
    study.figure(
        "fig_5_workspaces", "Fig. 5: the 3-RRR over its constant orientation workspaces", figure
    )
    checks = articular_symmetry(mechanism, poses[: len(poses) // 15])
    study.table(
        "fig_7_articular_symmetry",
        """Readings permuted as the rotations permute legs: their forward kinematics, started aside,
        must end in the workspace, at the carried pose.""",
        {
            "element": [str(c.element) for c in checks],
            "readings": [c.asked for c in checks],
            "solved": [c.solved for c in checks],
            "in the workspace": [c.inside for c in checks],
            "off at most [m, rad]": [f"{c.off:.0e}" for c in checks],
        },
    )
    spaces = {"overall": articular_space(mechanism, poses)}
    for turn, plane in planes.items():
        at = np.column_stack((plane.positions[:, :2], np.full(plane.count, turn)))
        spaces[f"φ = {turn:g} rad"] = articular_space(mechanism, at)
    study.figure(
        "fig_7_articular_space",
        "Fig. 7: articular-variables space as a cloud, and seen along ψ₁ = ψ₂ = ψ₃",
        articular_figure(mechanism, spaces),
    )
    least = min(check.inside for check in checks)
    return planes, f"{least} of {checks[0].asked} permuted readings reached"


def _selections(
    study: Study, mechanism: Mechanism, poses: Array, seed: int, quick: bool
) -> tuple[dict[str, Selection], dict[str, float]]:
    """Choose poses (Figs. 8, 9), and return selections and the time each took, [s]."""
    selections, seconds = choose(mechanism, poses, CHOICES, NOISE, seed, quick)
    study.heading("Chosen poses and observability (Figs. 8, 9)")
    study.say(
        """Chosen by the active calibration algorithm, rows weighted by the noise they carry.
        Efficiency is against the continuous D-optimal bound of the same protocol, so it does not
        rank protocols. O₁ is of the
        identification matrix of a leg in readings: Eq. 13 divides by the number of
        parameters, the literature since Borm and Menq by the root of the number of poses."""
    )
    study.table(
        "fig_9_observability",
        "Selections: poses measured, poses that serve a leg, indices of legs 1 to 3.",
        {
            "selection": list(selections),
            "measured": [len(s.plan.poses) for s in selections.values()],
            "serve a leg": [s.legs[0].poses for s in selections.values()],
            "efficiency": [s.efficiency for s in selections.values()],
            "O₁, Eq. 13": [
                ", ".join(f"{leg.indices.O1_per_parameter:.4f}" for leg in s.legs)
                for s in selections.values()
            ],
            "O₁ / √m": [
                ", ".join(f"{leg.indices.O1:.4f}" for leg in s.legs) for s in selections.values()
            ],
        },
    )
    first = selections["symmetric, 24 a leg"]
    spread = [np.ptp([leg.r_diagonal for leg in first.legs], axis=0).max()]
    names = mechanism.legs[0].parameter_names
    study.table(
        "fig_9_parameters",
        f"""|R_ii| of each parameter of the symmetric selection. Between legs they differ by at most
        {spread[0]:.0e}.""",
        {"parameter": list(names)}
        | {leg.leg: [float(v) for v in leg.r_diagonal] for leg in first.legs},
    )
    figure = Figure(figsize=(13, 4.6), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    for axes, name in ((left, "symmetric, 24 a leg"), (middle, "24 common"), (right, "8 orbits")):
        draw_mechanism(axes, mechanism)
        draw_poses(axes, mechanism, selections[name].plan)
        axes.legend(fontsize=7, loc="upper left")
        axes.set_title(name)
        axes.set_xlim(-1.2, 1.2)
        axes.set_ylim(-1.2, 1.2)
    study.figure(
        "fig_8_poses", "Fig. 8: chosen poses; strokes show the platform's orientation", figure
    )
    figure = Figure(figsize=(8, 4), layout="constrained")
    draw_observability(figure.subplots(), mechanism, first)
    study.figure("fig_9_observability", "Fig. 9: observability by parameter and leg", figure)
    return selections, seconds


def _ways(selections: dict[str, Selection]) -> list[Way]:
    """Return the ways to compare: the paper's two first, then what it lacks."""
    plans = {name: one.plan for name, one in selections.items()}
    own = "symmetric, 24 a leg"
    joint: tuple[Literal["all"], Method, Residual] = ("all", "together", "closure")
    return [
        Way(PAPERS, plans[own]),
        Way(COMMON, plans["24 common"], "all", "together"),
        Way("symmetric, all 72 for every leg", plans[own], "all"),
        Way("72 common", plans["72 common"], "all"),
        Way("24 orbits (72 poses)", plans["24 orbits"], "all"),
        Way("8 orbits (24 poses)", plans["8 orbits"], "all"),
        Way("72 common, whitened, together", plans["72 common"], *joint),
        Way("24 orbits, whitened, together", plans["24 orbits"], *joint),
        Way("24 common, whitened, together", plans["24 common"], *joint),
        Way("8 orbits, whitened, together", plans["8 orbits"], *joint),
    ]


def _times(study: Study, seconds: dict[str, float]) -> None:
    """Draw the time of selection."""
    study.heading("Cost of choosing")
    ratio = seconds["symmetric, 24 a leg"] / seconds["independent, 24 a leg"]
    title = f"symmetric over independent: {ratio:.2f} (one leg of three: 0.33)"
    caption = "Time to choose poses, certificate included"
    study.figure("selection_times", caption, times_figure(seconds, title))


def _against(
    study: Study,
    mechanism: Mechanism,
    reached: str,
    selections: dict[str, Selection],
    gains: dict[str, tuple[float, float]],
    after: dict[str, Array],
) -> None:
    """Say what agrees with the paper."""
    symmetric = selections["symmetric, 24 a leg"]
    group = symmetry_group(mechanism)
    index = [leg.indices.O1_per_parameter for leg in symmetric.legs]
    every = reached.split(" of ")[0] == reached.split(" of ")[1].split(" ")[0]
    claims = [
        Claim(
            "symmetry of the structure (Eq. 18)",
            "three rotations, three reflections",
            ", ".join(str(e) for e in group.elements),
            "; ".join(str(b) for b in group.breaks) or "holds",
        ),
        Claim(
            "symmetry of the articular-variables space (conjecture, Fig. 7)",
            "rotations by 2π/3 about ψ₁ = ψ₂ = ψ₃",
            reached,
            "holds" if every else "does not hold",
        ),
        Claim(
            "equal observability of the legs (Fig. 9)",
            "equal",
            f"O₁ (Eq. 13) {index[0]:.4f}, differing by {np.ptp(index):.0e}",
            "holds" if np.ptp(index) < 1e-9 * index[0] else "does not hold",
        ),
    ]
    for what, place in (("position", 0), ("orientation", 1)):
        ratio, half, words = paired(after[PAPERS][:, place], after[COMMON][:, place])
        claims.append(
            Claim(
                f"symmetric protocol (72 poses) against 24 common poses, {what} (Fig. 10)",
                "better",
                f"error of the common ones {ratio:.2f} ± {half:.2f} times as large",
                words,
            )
        )
    for name in list(after)[3:]:
        alone, together = gains[name]
        claims.append(
            Claim(
                name,
                "(not considered)",
                f"gain {alone:.2f} by parameters, {together:.2f} by axes, over the paper's",
                _against_papers(after, name),
            )
        )
    study.claims(claims)


def _against_papers(after: dict[str, Array], name: str) -> str:
    """Return how a way's position errors compare with the paper's, machine by machine."""
    ratio, half, words = paired(after[name][:, 0], after[PAPERS][:, 0])
    return f"position {words}: the paper's error is {ratio:.2f} ± {half:.2f} times as large"
