"""A tracker that was not aligned is noticed; machines that differ from their drawings are not."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from marks import quick, some_slow
from measured import workspace
from scipy.spatial.transform import Rotation

import pincal

NOISE = pincal.Noise(1e-4, 1e-4)
KINDS = ["3RRR", "3PRR", "6UPS"]


def calibrated(kind: str, seed: int, **moved: np.ndarray) -> pincal.CalibrationResult:
    """Return a calibration of a machine 2e-3 off; poses seen in another frame, or of another."""
    mechanism = pincal.load_mechanism(kind)
    truth = pincal.disturb(mechanism, 2e-3, seed)
    plan = pincal.Plan(workspace(kind, 40))
    data = pincal.simulate(mechanism, truth, plan, NOISE, seed).measurements
    matrices = mechanism.platform.transforms(data.poses).as_matrix()
    seen = moved.get("base", np.eye(4)) @ matrices @ moved.get("target", np.eye(4))
    data = replace(data, poses=mechanism.platform.from_matrices(seen))
    return pincal.calibrate(mechanism, data, noise=NOISE, poses="all")


def motion(kind: str) -> np.ndarray:
    """Return a motion by 10 mm and half a degree."""
    T = np.eye(4)
    turn = [0.0, 0.0, 1.0] if kind != "6UPS" else [0.6, 0.0, 0.8]
    T[:3, :3] = Rotation.from_rotvec(np.deg2rad(0.5) * np.array(turn)).as_matrix()
    T[:2, 3] = 8e-3, 6e-3
    return T


def frames(result: pincal.CalibrationResult) -> list[str]:
    """Return the warnings about frames."""
    return [text for text in result.warnings if "frame, by" in text]


@pytest.mark.parametrize(
    ("what", "kind"),
    some_slow(
        product(["base", "target"], KINDS),
        *((one, "3PRR") for one in ("base", "target")),
        ("base", "6UPS"),
    ),
)
def test_a_frame_that_was_taken_for_the_base_or_platform_is_named(kind: str, what: str) -> None:
    """10 mm and 0.5 degrees of the tracker or the target: which of them, and by how much."""
    for seed in range(2):
        (text,) = frames(calibrated(kind, seed, **{what: motion(kind)}))
        assert ("base's frame" in text) == (what == "base")
        assert ("--unknown-frame" in text) == (what == "base")
        shift, turn = (
            float(one.split()[0]) for one in text.split("frame, by ")[1].split(" and ")[:2]
        )
        assert shift == pytest.approx(10.0, rel=0.35)
        assert turn == pytest.approx(np.deg2rad(500.0), rel=0.35)


@pytest.mark.parametrize("kind", quick(1, ["5R", *KINDS]))
def test_machines_alone_raise_no_suspicion(kind: str) -> None:
    """Of six machines whose parameters differ each in its own way, none."""
    for seed in range(6):
        assert frames(calibrated(kind, seed)) == []


def test_an_unknown_frame_is_not_asked_for_twice() -> None:
    """Where the frame was said to be unknown, nothing is said about it."""
    mechanism = pincal.load_mechanism("3RRR")
    truth = pincal.disturb(mechanism, 2e-3, 1)
    plan = pincal.Plan(workspace("3RRR", 40))
    data = pincal.simulate(mechanism, truth, plan, NOISE, 1).measurements
    seen = motion("3RRR") @ mechanism.platform.transforms(data.poses).as_matrix()
    data = replace(data, poses=mechanism.platform.from_matrices(seen))
    setup = pincal.Setup(unknown_frame=True)
    result = pincal.calibrate(mechanism, data, noise=NOISE, poses="all", setup=setup)
    assert frames(result) == []
