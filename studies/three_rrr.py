"""Symmetrical observability on the 3-RRR: one leg's poses mapped to all (3-RRR paper)."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

import pincal

from . import drawing
from .study import Study, at_most, by_rows
from .three_rrr_errors import NOISE, asymmetry, cramer_rao, draw_maps, measure_accuracies
from .trials import Protocol, Way, choose, paired

Array = NDArray[np.float64]
PAPERS = "symmetric, own 24 (the paper's)"
COMMON = "24 common (traditional)"
TURNS = (0.0, 0.4, 0.6)
CHOICES: dict[str, tuple[Protocol, int]] = {
    "symmetric, 24 a leg": ("symmetric", 24),
    "symmetric, unweighted": ("symmetric", 24),
    "independent, 24 a leg": ("independent", 24),
    "24 common": ("common", 24),
    "72 common": ("common", 72),
    "24 orbits": ("orbits", 24),
    "8 orbits": ("orbits", 8),
}


def run(study: Study) -> None:
    """Compare ways to choose poses for the 3-RRR."""
    drawing.parameters(study, "Figs. 2, 6")
    study.progress("workspace and articular-variables space")
    poses = pincal.sample_workspace(study.mechanism, 2_000 if study.quick else 30_000, study.seed)
    planes, reached = _spaces(study, poses)
    study.progress("choosing poses")
    selections, seconds = _selections(study, poses)
    ways = _ways(selections)
    bounds = cramer_rao(study, ways)
    machines = 2 if study.quick else 100
    study.progress(f"{machines} machines calibrated in each of {len(ways)} ways")
    after = measure_accuracies(study, ways, poses, machines)
    study.progress("mapping errors")
    draw_maps(study, ways[0], planes)
    asymmetry(study, selections["symmetric, 24 a leg"].plan, 4 if study.quick else 200)
    study.heading("Cost of choosing")
    ratio = seconds["symmetric, 24 a leg"] / seconds["independent, 24 a leg"]
    title = f"symmetric over independent: {ratio:.2f} (one leg of three: 0.33)"
    caption = "Time to choose poses, certificate included"
    study.figure("selection_times", caption, drawing.times(seconds, title))
    _against(study, reached, selections["symmetric, 24 a leg"], bounds, after)


def _spaces(study: Study, poses: Array) -> tuple[dict[float, pincal.Workspace], str]:
    """Check the symmetry of the workspace and of the readings (Figs. 5, 7)."""
    mechanism = study.mechanism
    step = 0.04 if study.quick else 0.01
    bearing = "bearing [deg]=0:359:" + ("4" if study.quick else "1")
    grid = pincal.Grid.of(f"radius={step / 2}:0.8:{step}", bearing)
    group = pincal.symmetry_group(mechanism)
    planes = {}
    for turn in TURNS:
        kept = pincal.Orientations.of(mechanism.platform, f"phi={turn}")
        planes[turn] = pincal.compute_workspace(mechanism, "constant-orientation", grid, kept)
    study.heading("Workspace and articular-variables space (Figs. 5, 7)")
    found = str(group).replace("\n  no", ". No")
    study.say(
        f"""{len(poses):,} poses, spread evenly over the workspace that is connected to home, with
        margins of 0.23 (type 1) and 0.2 (type 2) from singularities. The three reflections of Eq.
        18 map the geometry but not the working mode. Group {found}."""
    )
    study.table(
        "fig_5_workspaces",
        "Constant orientation workspaces, and which share of them rotations keep inside.",
        {
            "orientation": [f"φ = {turn:g} rad" for turn in planes],
            "cells": [plane.count for plane in planes.values()],
            "area [m²]": [plane.measure for plane in planes.values()],
            "± [m²]": [plane.uncertainty for plane in planes.values()],
            "kept by rotations": [
                min(float(p.test(p.positions @ e.matrix.T).mean()) for e in group.elements)
                for p in planes.values()
            ],
        },
        ["cells"],
    )
    figure, panels = drawing.panels(3, 13, 4.6)
    for axes, (turn, plane) in zip(panels, planes.items(), strict=True):
        drawing.draw_mechanism(axes, mechanism, (0.0, 0.0, turn))
        drawing.draw_workspace(axes, plane).set(zorder=2.5, alpha=0.7)  # seen over the platform
        axes.set_title(f"φ = {turn:g} rad, {plane.measure:.3f} m²")
    study.figure(
        "fig_5_workspaces", "Fig. 5: the 3-RRR over its constant orientation workspaces", figure
    )
    study.say(
        """The articular-variables space Q = IK(W) is as symmetric as the workspace W. The paper
        conjectures it; it follows from Eq. 5, IK(λ x) = P_λ IK(x), which holds to rounding errors:
        P_λ Q = P_λ IK(W) = IK(λ W) = IK(W) = Q."""
    )
    checked = poses[: len(poses) // 15]
    distances = articular_distances(mechanism, checked)
    reached = [int((off < 1e-9).sum()) for off in distances.values()]
    study.table(
        "fig_7_articular_symmetry",
        """A check without Eq. 5: forward kinematics of permuted readings must end at the carried
        pose.""",
        {
            "element": list(distances),
            "readings": [len(checked) for _ in distances],
            "solved": [int(np.isfinite(off).sum()) for off in distances.values()],
            "at the carried pose": reached,
            "off at most [m, rad]": [at_most(np.nanmax(off)) for off in distances.values()],
        },
        ["solved"],
    )
    spaces = {"overall": pincal.inverse(mechanism, poses).readings}
    for turn, plane in planes.items():
        at = np.column_stack((plane.positions[:, :2], np.full(plane.count, turn)))
        spaces[f"φ = {turn:g} rad"] = pincal.inverse(mechanism, at).readings
    study.figure(
        "fig_7_articular_space",
        "Fig. 7: articular-variables space as a cloud, and seen along ψ₁ = ψ₂ = ψ₃",
        drawing.readings_of_three_legs(spaces),
    )
    return planes, f"{min(reached)} of {len(checked)} permuted readings reached"


def articular_distances(mechanism: pincal.Mechanism, poses: Array) -> dict[str, Array]:
    """Return how far permuted readings end from the carried poses, by the element's name.

    Readings of poses, shape (N, dof), are permuted as the element permutes legs; their forward
    kinematics is started aside. Distances, shape (N,), are [m] and [rad] together, NaN where it
    does not converge.
    """
    platform, group = mechanism.platform, pincal.symmetry_group(mechanism)
    readings = pincal.inverse(mechanism, poses).readings
    spread = np.ptp(platform.twists_between(poses[:1].repeat(len(poses), 0), poses), axis=0)
    aside = 1e-2 * spread * np.random.default_rng(0).normal(size=poses.shape)
    distances = {}
    for element, permutation in list(zip(group.elements, group.permutations, strict=True))[1:]:
        permuted = np.empty_like(readings)
        permuted[:, list(permutation)] = readings
        carried = element.poses(platform, poses)
        solution = pincal.forward(mechanism, permuted, platform.moved(carried, aside))
        off = np.full(len(poses), np.nan)
        ok = solution.converged
        off[ok] = np.linalg.norm(platform.twists_between(carried[ok], solution.poses[ok]), axis=1)
        distances[str(element)] = off
    return distances


def _selections(study: Study, poses: Array) -> tuple[dict[str, pincal.Selection], dict[str, float]]:
    """Choose poses (Figs. 8, 9), and return selections and the time each took, [s]."""
    selections, seconds = choose(study, poses, CHOICES, NOISE)
    study.heading("Chosen poses and observability (Figs. 8, 9)")
    study.say(
        """Chosen by the active calibration algorithm, rows weighted by their noise. Efficiency is
        against the continuous D-optimal bound of the same protocol, so it does not rank protocols.
        O₁ is of a leg in readings: Eq. 13 divides by the number of parameters, the literature since
        Borm and Menq by the root of the number of poses."""
    )
    study.table(
        "fig_9_observability",
        "Selections: poses measured, poses that serve a leg, O₁ of legs 1 to 3.",
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
        ["O₁ / √m"],
    )
    first = selections["symmetric, 24 a leg"]
    spread = [np.ptp([leg.r_diagonal for leg in first.legs], axis=0).max()]
    names = study.mechanism.legs[0].parameter_names
    study.table(
        "fig_9_parameters",
        f"""|R_ii| of each parameter of the symmetric selection. Between legs they differ by at most
        {at_most(spread[0])}.""",
        {"parameter": list(names)}
        | {leg.leg: [float(v) for v in leg.r_diagonal] for leg in first.legs},
        ["parameter", *(leg.leg for leg in first.legs)],
    )
    figure, panels = drawing.panels(3, 13, 4.6)
    for axes, name in zip(panels, ("symmetric, 24 a leg", "24 common", "8 orbits"), strict=True):
        drawing.draw_mechanism(axes, study.mechanism, (0.0, 0.0, 0.0))
        drawing.draw_poses(axes, study.mechanism, selections[name].plan)
        axes.set(title=name, xlim=(-1.2, 1.2), ylim=(-1.2, 1.2))
    drawing.legend(figure)
    study.figure(
        "fig_8_poses", "Fig. 8: chosen poses; strokes show the platform's orientation", figure
    )
    caption = "Fig. 9: observability by parameter and leg"
    study.figure("fig_9_observability", caption, drawing.observability(first, study.mechanism))
    return selections, seconds


def _ways(selections: dict[str, pincal.Selection]) -> list[Way]:
    """Return the ways to compare: the paper's two first, then what it lacks."""
    plans = {name: one.plan for name, one in selections.items()}
    own = "symmetric, 24 a leg"
    joint: tuple[Literal["all"], Literal["all-legs"], Literal["closure"]]
    joint = ("all", "all-legs", "closure")
    return [
        Way(PAPERS, plans[own]),
        Way(COMMON, plans["24 common"], "all", "all-legs"),
        Way("symmetric, all 72 for every leg", plans[own], "all"),
        Way("72 common", plans["72 common"], "all"),
        Way("24 orbits (72 poses)", plans["24 orbits"], "all"),
        Way("8 orbits (24 poses)", plans["8 orbits"], "all"),
        Way("72 common, whitened, together", plans["72 common"], *joint),
        Way("24 orbits, whitened, together", plans["24 orbits"], *joint),
        Way("24 common, whitened, together", plans["24 common"], *joint),
        Way("8 orbits, whitened, together", plans["8 orbits"], *joint),
        Way("symmetric by unweighted O₁, own 24", plans["symmetric, unweighted"]),
    ]


def _equation_10(mechanism: pincal.Mechanism, chosen: pincal.Selection) -> tuple[float, float]:
    """Return by which part |R_ii| of leg κ and of leg 1 at mapped poses differ: λ_κ, and λ_κ⁻¹."""

    def diagonal(leg: str, poses: Array) -> Array:
        C = pincal.identification_jacobian(mechanism, leg, poses)
        return np.abs(np.diagonal(np.linalg.qr(C, mode="r")))

    carriers = pincal.symmetry_group(mechanism).carriers()
    off = np.zeros((2, len(carriers)))
    poses = chosen.plan.poses[chosen.plan.serves(mechanism.leg_names[0])]
    for index, (leg, element) in enumerate(zip(mechanism.leg_names, carriers, strict=True)):
        own = diagonal(leg, poses)
        for row, by in enumerate((element, element.inverse())):
            mapped = diagonal(mechanism.leg_names[0], by.poses(mechanism.platform, poses))
            off[row, index] = np.abs(mapped / own - 1.0).max()
    return float(off[0].max()), float(off[1].max())


def _printed(mechanism: pincal.Mechanism) -> list[tuple[str, str, str, str]]:
    """Return what Eqs. 14 and 17 and the abstract say of the 3-RRR, and what holds."""
    platform, count = mechanism.platform, len(mechanism.legs)
    pose, turn = np.array([[0.1, 0.2, 0.3]]), 2 * np.pi / count
    phi = {
        name: pincal.Element(turn, reflection=mirror).poses(platform, pose)[0, 2]
        for name, mirror in (("rotations", False), ("mirrors", True))
    }
    leg = dict(mechanism.legs[0].parameters)

    def ray(length: float, angle: float) -> Array:
        return length * np.array([np.cos(angle), np.sin(angle)])

    A, ob, home = ray(leg["OA"], leg["beta"]), ray(leg["ob"], leg["beta_b"]), np.pi / 3
    remainder = ray(leg["l"], home + 0.2) - ob  # the driving link turned by 0.2 rad, at home's pose
    size = np.hypot(*remainder)
    cosine = (A @ A - size**2 - leg["L"] ** 2) / (2 * size * leg["L"])
    distal = ray(leg["L"], np.arctan2(*remainder[::-1]) - np.arccos(cosine))
    closed = abs(np.hypot(*A) - np.hypot(*(remainder + distal)))
    gap = float(np.hypot(*(A + remainder + distal)))
    return [
        (
            "Eq. 14: R_κ = λ_κ(R₁), P_κ = P₁",
            "orientations as for leg 1",
            f"φ = 0.3 rad becomes {phi['rotations']:.1f} by rotations, {phi['mirrors']:.1f} by "
            "mirrors",
            "holds for rotations, with the direction of λ_κ opposite to Eq. 10; mirrors carry "
            "orientations too",
        ),
        (
            "Eq. 17: the loop by norms",
            "‖r − A‖ = ‖AC + CB − oB‖",
            f"holds within {at_most(closed)} m at home with the driving link turned by 0.2 rad, "
            f"where the loop is open by {gap:.2f} m",
            "does not suffice: the loop closes as a vector, ‖r + oB − A − AC‖ = L",
        ),
        (
            "cost of the design 1/n_legs (abstract, Section 4.1)",
            f"1/{count} of legs chosen independently",
            f"poses of 1 leg of {count} are chosen",
            "holds for the search; common poses and orbits need one search, too",
        ),
    ]


def _against(
    study: Study,
    reached: str,
    symmetric: pincal.Selection,
    gains: dict[str, tuple[float, float]],
    after: dict[str, Array],
) -> None:
    """Say what agrees with the paper."""
    group = pincal.symmetry_group(study.mechanism)
    index = [leg.indices.O1_per_parameter for leg in symmetric.legs]
    every = reached.split(" of ")[0] == reached.split(" of ")[1].split(" ")[0]
    claims = [
        (
            "symmetry of the structure (Eq. 18)",
            "three rotations, three reflections",
            ", ".join(str(e) for e in group.elements),
            "holds" if group.elements[-1].reflection else "reflections break the working mode",
        ),
        (
            "symmetry of the articular-variables space (conjecture, Fig. 7)",
            "rotations by 2π/3 about ψ₁ = ψ₂ = ψ₃",
            reached,
            "holds" if every else "does not hold",
        ),
        (
            "equal observability of the legs (Fig. 9)",
            "equal",
            f"O₁ (Eq. 13) {index[0]:.4f}, differing by at most {at_most(np.ptp(index))}",
            "holds" if np.ptp(index) < 1e-9 * index[0] else "does not hold",
        ),
    ]
    printed, inverse = _equation_10(study.mechanism, symmetric)
    claims.append(
        (
            "equal R_ii at mapped poses (Eq. 10)",
            "leg 1 at λ_κ(R) as leg κ at R",
            f"off by {100 * printed:.2g} % at most with λ_κ, by {at_most(inverse)} with λ_κ⁻¹",
            "holds with the inverse: λ_κ carries leg 1 onto leg κ, so that leg κ's poses go back",
        )
    )
    claims += _printed(study.mechanism)
    for place, what in enumerate(("position", "orientation")):
        times, verdict = paired(after[PAPERS][:, place], after[COMMON][:, place])
        claims.append(
            (
                f"symmetric protocol (72 poses) against 24 common poses, {what} (Fig. 10)",
                "better",
                f"error of the common ones {times}",
                verdict,
            )
        )
    ways = [
        (name, *gains[name], *paired(after[name][:, 0], after[PAPERS][:, 0]))
        for name in list(after)[3:]
    ]
    best = max(ways, key=lambda way: way[2])
    headers = ("way", "gain", "gain by axes", "the paper's position error", "verdict")
    study.heading("Other ways")
    study.table(
        "other_ways",
        f"""Gains over the paper's way, and its position error beside theirs. The best is
        {best[0]}: the paper's error is {best[3]}.""",
        by_rows(headers, ways),
        headers,
    )
    study.claims(*claims)
