"""Simulated measurements as they really come: unknown frames, targets, parts of poses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import pincal
from pincal import Options
from pincal.calibration.calibration import Calibration
from pincal.calibration.hypotheses.plausibility import implausible
from pincal.calibration.validation import Validation
from pincal.estimation.problem import Problem
from pincal.estimation.unknowns import State
from pincal.words.findings import sentences

NOISE = pincal.Noise(1e-4, 1e-4, 5e-5)
EXACT = pincal.Noise(0.0, 0.0, 0.0)


def put(
    data: pincal.Plan, field: str, place: object, values: np.ndarray | float
) -> pincal.Measurements:
    """Return measurements with other values at a place of one of their arrays."""
    array = getattr(data, field).copy()
    array[place] = values
    return replace(data, **{field: array})


def check_plausible(
    mechanism: pincal.Mechanism, data: pincal.Measurements, setup: pincal.Setup | None = None
) -> None:
    """Raise if measurements cannot come from a mechanism like the nominal one."""
    options = Options(setup=setup or pincal.Setup())
    if faults := implausible(Calibration(mechanism, data, options)):
        raise pincal.MeasurementError(sentences(faults)[0])


#: Poses that are sampled at least: few cost hardly less than these, the workspace's box the most.
_STOCK = 100
_sampled: dict[tuple[str, int], np.ndarray] = {}


def workspace(kind: str, count: int, seed: int = 0) -> np.ndarray:
    """Return what ``pincal.sample_workspace`` gives, sampled once for all tests of a process.

    Fewer poses are the first of more (tests/test_workspace.py).

    Args:
        kind: Name of a bundled mechanism whose poses are not sampled by readings.
        count: Number of poses.
        seed: Seed.

    Returns:
        Poses, shape (count, dof); a copy.
    """
    if count > len(_sampled.get((kind, seed), ())):
        mechanism = pincal.load_mechanism(kind)
        assert not mechanism.by_readings
        _sampled[kind, seed] = pincal.sample_workspace(mechanism, max(count, _STOCK), seed)
    return _sampled[kind, seed][:count].copy()


def leg_after_leg(count: int) -> tuple[pincal.Mechanism, pincal.Plan]:
    """Return a 3-RRR and poses for each leg, set after set."""
    mechanism = pincal.load_mechanism("3RRR")
    sets = tuple(leg for leg in mechanism.leg_names for _ in range(count))
    return mechanism, pincal.Plan(workspace("3RRR", 3 * count), sets)


def machine(
    kind: str, count: int = 40, noise: pincal.Noise = NOISE, seed: int = 0, sigma: float = 2e-3
) -> tuple[pincal.Mechanism, pincal.Mechanism, pincal.Measurements]:
    """Return a nominal and a true mechanism, and noisy measurements of all legs."""
    mechanism = pincal.load_mechanism(kind)
    truth = pincal.disturb(mechanism, sigma, 1)
    plan = pincal.Plan(workspace(kind, count))
    return mechanism, truth, pincal.simulate(mechanism, truth, plan, noise, seed).measurements


def shaken(
    mechanism: pincal.Mechanism, clean: pincal.Measurements, noise: pincal.Noise, seed: int
) -> pincal.Measurements:
    """Return measurements with noise on poses and readings: driving a machine once is enough."""
    rng = np.random.default_rng(seed)
    twists = noise.of_poses(mechanism) * rng.standard_normal(clean.poses.shape)
    readings = clean.readings + noise.reading * rng.standard_normal(clean.readings.shape)
    return replace(clean, poses=mechanism.platform.moved(clean.poses, twists), readings=readings)


def seen_from_elsewhere(
    mechanism: pincal.Mechanism,
    data: pincal.Measurements,
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0),
    turn: float = 0.0,
) -> pincal.Measurements:
    """Return poses as a tracker sees them that stands somewhere, of a target on the platform.

    Args:
        mechanism: The mechanism.
        data: Poses of the platform in the base frame.
        offset: Of the target in the platform frame, [m].
        turn: Of the target about the platform's z axis, [rad].
    """
    platform = mechanism.platform
    plane = platform.space == 2
    frame = np.eye(4)
    axis = [0.0, 0.0, 1.0] if plane else [0.3, -0.5, 1.0]
    frame[:3, :3] = Rotation.from_rotvec(axis).as_matrix()
    frame[:3, 3] = [1.0, 2.0, 0.0 if plane else 3.0]
    matrices = platform.transforms(data.poses).as_matrix()
    matrices[:, :3, 3] += matrices[:, :3, :3] @ np.array(offset)
    matrices[:, :3, :3] = matrices[:, :3, :3] @ Rotation.from_rotvec([0, 0, turn]).as_matrix()
    return replace(data, poses=platform.from_matrices(frame @ matrices))


def targets(
    mechanism: pincal.Mechanism,
    poses: np.ndarray,
    offsets: dict[str, tuple[float, float, float]],
    sigma: float = 0.0,
) -> dict[str, np.ndarray]:
    """Return columns of the positions of targets on the platform, in the base frame."""
    rng = np.random.default_rng(5)
    matrices = mechanism.platform.transforms(poses).as_matrix()
    columns = {}
    for name, offset in offsets.items():
        points = matrices[:, :3, 3] + matrices[:, :3, :3] @ np.array(offset)
        points = points + sigma * rng.standard_normal(points.shape)
        for axis, values in zip("xyz"[: mechanism.platform.space], points.T, strict=False):
            columns[f"{name}_{axis}"] = values
    return columns


def error(result: pincal.CalibrationResult, truth: pincal.Mechanism) -> float:
    """Return the largest error of an identified parameter."""
    pairs = zip(result.identified.legs, truth.legs, strict=True)
    return max(float(np.abs(a.nominal - b.nominal).max()) for a, b in pairs)


def evaluations(monkeypatch: pytest.MonkeyPatch) -> list[State]:
    """Return a list to which every evaluation of a problem's conditions adds its state."""
    states, evaluate = list[State](), Problem.evaluate
    monkeypatch.setattr(Problem, "evaluate", lambda self, x: states.append(x) or evaluate(self, x))
    return states


def platform_accuracy(
    model: pincal.Mechanism, truth: pincal.Mechanism, poses: np.ndarray
) -> tuple[float, float]:
    """Return root mean square errors in position [m] and orientation [rad], frames aligned.

    The motions of base and platform frame that explain most of the errors are left out: they
    are no errors where these frames were not measured.
    """
    platform = model.platform
    reached = pincal.forward(truth, pincal.inverse(model, poses).readings, poses).poses
    ok = np.isfinite(reached).all(axis=1)
    goal = platform.transforms(reached[ok]).as_matrix()
    wanted = platform.transforms(poses[ok]).as_matrix()
    rows = list(platform.twist_rows)
    linear = np.array([row < 3 for row in rows])
    for _ in range(4):
        twists = platform.twists_between(
            platform.from_matrices(wanted), platform.from_matrices(goal)
        )
        base, body = np.zeros((2, len(goal), 6, 6))
        base[:, :3, :3] = base[:, 3:, 3:] = np.eye(3)
        base[:, :3, 3:] = np.cross(np.eye(3), wanted[:, None, :3, 3]).transpose(0, 2, 1)
        body[:, :3, :3] = body[:, 3:, 3:] = wanted[:, :3, :3]
        motions = np.concatenate((base, body), axis=2)[:, rows].reshape(-1, 12)
        found = np.linalg.lstsq(motions, twists.ravel(), rcond=1e-9)[0]
        wanted = _motion(found[:6]) @ wanted @ _motion(found[6:])
    left = twists
    return (
        float(np.sqrt((left[:, linear] ** 2).sum(axis=1).mean())),
        float(np.sqrt((left[:, ~linear] ** 2).sum(axis=1).mean())),
    )


def _motion(twist: np.ndarray) -> np.ndarray:
    """Return a rigid motion as a homogeneous matrix, shape (4, 4)."""
    matrix = np.eye(4)
    matrix[:3, 3] = twist[:3]
    matrix[:3, :3] = Rotation.from_rotvec(twist[3:]).as_matrix()
    return matrix


def validated(
    mechanism: pincal.Mechanism,
    data: pincal.Measurements,
    *,
    folds: int = 5,
    by: Any = "region",
    **options: Any,
) -> Validation:
    """Return the held-out errors of a calibration."""
    validation = pincal.calibrate(mechanism, data, **options).validated(folds, by).validation
    assert validation is not None
    return validation


def computed_everywhere(workspace: pincal.Workspace) -> np.ndarray:
    """Return which positions of the grid count, each computed by itself, without symmetry."""
    parts = np.array_split(np.arange(workspace.asked.size), 50)
    return np.concatenate([workspace.test(workspace.asked.at(part)) for part in parts])
