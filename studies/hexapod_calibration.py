"""The hexapod calibrated by the symmetric protocol, which its paper does not do."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import pincal

from . import drawing
from .study import Study, at_most
from .trials import (
    Protocol,
    Way,
    choose,
    machines,
    platform_rms,
    root_mean_square,
    values,
)

Array = NDArray[np.float64]
NOISE = pincal.Noise(position=2e-5, orientation=2e-5, reading=5e-6)
SIGMA = 1e-3
COMMON = "24 common"
CHOICES: dict[str, tuple[Protocol, int]] = {
    "symmetric, 24 a leg": ("symmetric", 24),
    "independent, 24 a leg": ("independent", 24),
    "24 common": ("common", 24),
    "4 orbits": ("orbits", 4),
}


def calibration(study: Study, poses: Array) -> dict[str, Array]:
    """Calibrate by the symmetric protocol; return errors by way and machine, shape (n, 3)."""
    mechanism, count = study.mechanism, 2 if study.quick else 20
    selections, seconds = choose(study, poses, CHOICES, NOISE)
    plans = {name: one.plan for name, one in selections.items()}
    own = plans["symmetric, 24 a leg"]
    ways = [
        Way("symmetric, own 24", own, residual="closure"),
        Way("symmetric, all 144 for every leg", own, "all", residual="closure"),
        Way(COMMON, plans["24 common"], "all", residual="closure"),
        Way("24 common, together", plans["24 common"], "all", "all-legs", "closure"),
        Way("4 orbits (24 poses)", plans["4 orbits"], "all", residual="closure"),
        Way("4 orbits, together", plans["4 orbits"], "all", "all-legs", "closure"),
    ]
    some = poses[: 50 if study.quick else 200]
    found: dict[str, list[tuple[float, float, float]]] = {
        name: [] for name in ("before", *(way.name for way in ways))
    }
    squares: dict[str, list[float]] = {way.name: [] for way in ways}
    lost = 0
    for truth, noise in machines(mechanism, SIGMA, study.seed, count):
        found["before"].append(_errors(mechanism, truth, some))
        for way in ways:
            identified, converged = way.run(mechanism, truth, NOISE, noise)
            lost += not converged
            found[way.name].append(_errors(identified, truth, some))
            bound = way.bound(mechanism, truth, NOISE, way.method)
            squares[way.name].append(float(np.diagonal(bound).mean()))
    errors = {name: np.array(rows) for name, rows in found.items()}
    means = {name: root_mean_square(rows[:, 2:]) for name, rows in errors.items()}
    study.heading("Calibration by the symmetric protocol")
    study.say(
        f"""48 parameters, disturbed by σ = {SIGMA:g} (m, rad and 1); poses measured with
        {1e6 * NOISE.position:.0f} µm and {1e6 * NOISE.orientation:.0f} µrad, legs with
        {1e6 * NOISE.reading:.0f} µm; {count} machines, of which {lost} calibrations did not
        converge. Root mean squares over machines and {len(some)} poses; the bound is Cramér and
        Rao's, leg by leg or of all legs together."""
    )
    study.table(
        "calibration",
        "Errors before and after; ± is the standard error.",
        {
            "way": list(errors),
            "measured poses": [0, *(len(way.plan.poses) for way in ways)],
            "parameters [m, rad, 1]": [means[name][0] for name in errors],
            "± [m, rad, 1]": [means[name][1] for name in errors],
            "bound [m, rad, 1]": ["", *(f"{np.sqrt(np.mean(s)):.4g}" for s in squares.values())],
            "position [mm]": [1e3 * root_mean_square(rows[:, :1])[0] for rows in errors.values()],
            "orientation [mrad]": [
                1e3 * root_mean_square(rows[:, 1:2])[0] for rows in errors.values()
            ],
        },
    )
    first = selections["symmetric, 24 a leg"]
    spread = np.ptp([leg.r_diagonal for leg in first.legs], axis=0).max()
    study.table(
        "selection",
        f"""Selections, efficiency against the bound of the same protocol. |R_ii| of the symmetric
        one differs between legs by at most {at_most(spread)}.""",
        {
            "selection": list(selections),
            "poses": [len(s.plan.poses) for s in selections.values()],
            "efficiency": [s.efficiency for s in selections.values()],
        },
    )
    caption = "Observability by parameter and leg, symmetric selection"
    study.figure("observability", caption, drawing.observability(first, mechanism))
    study.figure("selection_times", "Time to choose poses", drawing.times(seconds))
    return errors


def _errors(
    model: pincal.Mechanism, truth: pincal.Mechanism, poses: Array
) -> tuple[float, float, float]:
    """Return root mean squares: position [m], orientation [rad], parameters."""
    parameters = values(model) - values(truth)
    return (*platform_rms(model, truth, poses), float(np.sqrt((parameters**2).mean())))
