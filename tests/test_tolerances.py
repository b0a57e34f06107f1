"""Tolerances: how far machines may be from their drawing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pincal

NOISE = pincal.Noise(1e-4, 1e-4, 2e-5)
SIZES = {"m": 5e-4, "rad": 2e-3, "1": 1e-3}


def drawn(kind: str, count: int, seed: int) -> tuple[pincal.Mechanism, pincal.Measurements]:
    """Return a machine that differs from its drawing by so much, and measurements of it."""
    drawing = pincal.load_mechanism(kind)
    truth = pincal.disturb(drawing, {p.id: SIZES[p.unit] for p in drawing.parameters}, seed)
    poses = pincal.sample_workspace(drawing, count, seed=seed)
    return truth, pincal.simulate(kind, truth, pincal.Plan(poses), NOISE, seed=seed).measurements


@pytest.mark.slow
def test_few_poses_are_predicted_better() -> None:
    """Twelve poses at a millimetre: tolerances, even twice as wide, beat free parameters."""
    poor = pincal.Noise(1e-3, 1e-3, 0.0)
    errors = []
    for seed in range(3):
        truth, data = drawn("3RRR", 12, seed)
        poses = np.random.default_rng(seed).standard_normal(data.poses.shape) * 1e-3
        data = replace(data, poses=data.poses + poses)
        goals = pincal.sample_workspace(truth, 50, seed=9)
        for times in (np.inf, 1.0, 2.0):
            sizes = {unit: times * size for unit, size in SIZES.items() if times < np.inf}
            result = pincal.calibrate("3RRR", data, noise=poor, tolerance=sizes)
            wanted = pincal.inverse(result.identified, goals).readings
            reached = pincal.forward(truth, wanted).poses
            errors.append(np.nanmean(np.linalg.norm((reached - goals)[:, :2], axis=1)))
    free, right, wide = np.reshape(errors, (3, 3)).mean(axis=0)
    assert right < 0.7 * free
    assert wide < 0.7 * free


def test_a_single_pose_is_said_to_be_few() -> None:
    """With tolerances, of which a pose corrects little."""
    _, data = drawn("3RRR", 24, seed=2)
    pose = data.rows(np.arange(1))
    result = pincal.calibrate("3RRR", pose, noise=NOISE, tolerance={"m": 1e-3, "rad": 1e-3})
    assert "few-poses" in {one.code for one in result.findings}


@pytest.mark.parametrize("word", ["all", "auto"])
def test_what_cannot_be_is_refused(word: str) -> None:
    """Sizes are numbers with units."""
    _, data = drawn("5R", 24, seed=1)
    with pytest.raises(pincal.MeasurementError, match=f"'{word}' is not understood"):
        pincal.calibrate("5R", data, tolerance=word)
