"""A five-bar and a linear delta by closed forms: readings of a true machine at any points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from cramer_rao import Machine
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import pincal

Array = NDArray[np.float64]


def _five_bar(robot: pincal.Mechanism, true: Array, points: Array) -> Array:
    machine = Machine(robot, true, points, Rotation.identity(len(points)))
    return machine.readings(true, np.zeros((len(points), 2)))


def _delta(robot: pincal.Mechanism, true: Array, points: Array) -> Array:
    """Return ways of the carriages from their ends."""
    readings = []
    for index, leg in enumerate(robot.legs):
        n = len(leg.parameter_names)
        p = dict(zip(leg.parameter_names, true[n * index : n * (index + 1)], strict=True))
        tower = p["radius"] * np.array([np.cos(p["angle"]), np.sin(p["angle"])])
        level = ((points[:, :2] - tower) ** 2).sum(axis=1)
        top = p["endstop"] + np.sqrt(p["arm"] ** 2 - p["radius"] ** 2)
        readings.append(top - points[:, 2] - np.sqrt(p["arm"] ** 2 - level))
    return np.stack(readings, axis=1)


READINGS: dict[str, Callable[[pincal.Mechanism, Array, Array], Array]] = {
    "5R": _five_bar,
    "linear_delta": _delta,
}


def disturbed(kind: str, seed: int) -> tuple[pincal.Mechanism, Array]:
    """Return a nominal machine and true parameters, a millimetre or milliradian off."""
    robot, rng = pincal.load_mechanism(kind), np.random.default_rng(seed)
    return robot, robot.parameters.values + 1e-3 * rng.standard_normal(len(robot.parameters))


def machine(kind: str, seed: int) -> tuple[pincal.Mechanism, Array, Array, Array]:
    """Return nominal machine, true parameters, points that it goes to, and readings there."""
    robot, true = disturbed(kind, seed)
    points = pincal.sample_workspace(robot, 60, seed=seed)
    readings = READINGS[kind](robot, true, points)
    ok = np.isfinite(readings).all(axis=1)
    return robot, true, points[ok], readings[ok]


def shape_error(machine: pincal.Mechanism, readings: Array, points: Array) -> float:
    """Return the RMS error of where readings take a machine, frames aligned (W. Kabsch 1976)."""
    solution = pincal.forward(machine, readings)
    ok = solution.converged
    reached, wanted = solution.poses[ok], points[ok]
    reached, wanted = reached - reached.mean(axis=0), wanted - wanted.mean(axis=0)
    U, _, Vt = np.linalg.svd(wanted.T @ reached)
    sign = np.ones(len(U))
    sign[-1] = np.linalg.det(U @ Vt)
    missed = wanted - reached @ ((U * sign) @ Vt).T
    return float(np.sqrt((missed**2).sum(axis=1).mean()))
