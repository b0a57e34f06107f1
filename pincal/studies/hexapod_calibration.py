"""The hexapod calibrated by the symmetric protocol, which its paper leaves as future work."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pincal.experiment.selection import Protocol
from pincal.experiment.simulation import disturb
from pincal.model.measurements import Noise
from pincal.model.mechanism import Mechanism
from pincal.show.plots import draw_observability
from pincal.studies.study import Study
from pincal.studies.trials import Way, choose, platform_rms, times_figure, values

Array = NDArray[np.float64]
NOISE = Noise(position=2e-5, orientation=2e-5, reading=5e-6)
SIGMA = 1e-3
CHOICES: dict[str, tuple[Protocol, int]] = {
    "symmetric, 24 a leg": ("symmetric", 24),
    "independent, 24 a leg": ("independent", 24),
    "24 common": ("common", 24),
    "4 orbits": ("orbits", 4),
}


def calibration(
    study: Study, mechanism: Mechanism, poses: Array, seed: int, quick: bool
) -> dict[str, tuple[float, float]]:
    """Calibrate by the symmetric protocol: what the paper leaves as future work."""
    machines = 2 if quick else 20
    selections, seconds = choose(mechanism, poses, CHOICES, NOISE, seed, quick)
    plans = {name: one.plan for name, one in selections.items()}
    ways = [
        Way("symmetric, own 24", plans["symmetric, 24 a leg"]),
        Way(
            "symmetric, all 144 for every leg",
            plans["symmetric, 24 a leg"],
            "all",
            residual="closure",
        ),
        Way("24 common", plans["24 common"], "all", residual="closure"),
        Way("4 orbits (24 poses)", plans["4 orbits"], "all", residual="closure"),
        Way("4 orbits, together", plans["4 orbits"], "all", "together", "closure"),
    ]
    some = poses[: 50 if quick else 200]
    found: dict[str, list[tuple[float, float, float]]] = {
        name: [] for name in ("before", *(way.name for way in ways))
    }
    for machine in range(seed, seed + machines):
        truth = disturb(mechanism, SIGMA, machine)
        found["before"].append(_errors(mechanism, truth, some))
        for way in ways:
            identified = way.run(mechanism, truth, NOISE, machine).identified
            found[way.name].append(_errors(identified, truth, some))
    medians = {name: np.median(rows, axis=0) for name, rows in found.items()}
    bounds = {
        way.name: float(np.sqrt(np.diagonal(way.bound(mechanism, NOISE)).mean())) for way in ways
    }
    study.heading("Calibration by the symmetric protocol")
    study.say(
        f"""48 parameters, disturbed by σ = {SIGMA:g}; poses measured with
        {1e6 * NOISE.position:.0f} µm and
        {1e6 * NOISE.orientation:.0f} µrad, legs with {1e6 * NOISE.reading:.0f} µm. Medians of
        {machines}
        machines; errors of the platform over {len(some)} poses of the workspace."""
    )
    study.table(
        "calibration",
        "Errors before and after, and the Cramér-Rao bound of the parameters (root mean squares).",
        {
            "way": list(found),
            "measured poses": [0, *(len(way.plan.poses) for way in ways)],
            "parameters": [float(m[2]) for m in medians.values()],
            "bound": ["", *(f"{bounds[way.name]:.3g}" for way in ways)],
            "position [mm]": [float(1e3 * m[0]) for m in medians.values()],
            "orientation [mrad]": [float(1e3 * m[1]) for m in medians.values()],
        },
    )
    first = selections["symmetric, 24 a leg"]
    spread = np.ptp([leg.r_diagonal for leg in first.legs], axis=0).max()
    study.table(
        "selection",
        f"""Selections. |R_ii| of the symmetric one differs between legs by at most
        {spread:.0e}.""",
        {
            "selection": list(selections),
            "poses": [len(s.plan.poses) for s in selections.values()],
            "efficiency": [s.efficiency for s in selections.values()],
        },
    )
    figure = Figure(figsize=(8, 4), layout="constrained")
    draw_observability(figure.subplots(), mechanism, first)
    study.figure("observability", "Observability by parameter and leg, symmetric selection", figure)
    study.figure("selection_times", "Time to choose poses", times_figure(seconds))
    return {name: (float(m[0]), float(m[1])) for name, m in medians.items()}


def _errors(model: Mechanism, truth: Mechanism, poses: Array) -> tuple[float, float, float]:
    """Return root mean squares: position [m], orientation [rad], parameters."""
    parameters = values(model) - values(truth)
    return (*platform_rms(model, truth, poses), float(np.sqrt((parameters**2).mean())))
