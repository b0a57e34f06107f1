"""Joints that give way under weight: what their terms save at poses that no fit has seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arms import loaded
from scipy.spatial.transform import Rotation

import pincal
from pincal import Load
from pincal.calibration.terms.candidates import with_terms
from pincal.calibration.terms.kinds import Kind

COMPLIANCE = 1e-6
"""Of joints 2 and 3, [rad/(N m)]."""
NOISE = pincal.Noise(2e-5, 0.0, 0.0)
COUNT = 40
TARGET = (0.05, 0.1, 0.02)
"""Of the reflector in the platform's frame, [m]."""


def points(arm: pincal.Mechanism, poses: np.ndarray) -> np.ndarray:
    """Return where the reflector is, shape (N, 3), [m]."""
    matrices = arm.platform.matrices(poses)
    return matrices[:, :3, 3] + matrices[:, :3, :3] @ np.array(TARGET)


@pytest.fixture(scope="module")
def rows() -> tuple[pincal.Mechanism, pincal.Measurements, pincal.Measurements]:
    """A UR10 with 10 kg, 40 positions of a machine that gives way, and 200 exact ones of it."""
    arm = replace(loaded("ur10"), load=Load(10.0, (0.0, 0.0, 0.1)))
    plan = pincal.sample_configurations(arm, COUNT + 200, seed=1)
    rough = pincal.Measurements(plan.poses, readings=plan.readings)
    pairs = [(name, Kind("gravity")) for name in arm.reading_names[1:3]]
    truth, ids = with_terms(pincal.disturb(arm, 1e-3, seed=2), rough, pairs)
    per = {
        term.parameter: term.basis.per
        for leg in truth.legs
        for s in leg.sensors
        for term in s.terms
    }
    names = [name for own in ids.values() for name in own]
    truth = truth.with_parameters({one: COMPLIANCE * per[one.partition(".")[2]] for one in names})
    exact = pincal.simulate(arm, truth, plan, pincal.Noise(0.0, 0.0, 0.0)).measurements
    seen = exact.rows(np.arange(len(exact)) < COUNT)
    poses = seen.poses.copy()
    poses[:, :3] = points(arm, poses)
    poses[:, :3] += NOISE.position * np.random.default_rng(3).standard_normal((len(seen), 3))
    poses[:, 3:] = np.nan
    return arm, replace(seen, poses=poses), exact.rows(np.arange(len(exact)) >= COUNT)


@pytest.mark.slow
def test_terms_reach_the_noise_where_geometry_misses_it(
    rows: tuple[pincal.Mechanism, pincal.Measurements, pincal.Measurements],
) -> None:
    """Root mean square distance at 200 poses: the noise with terms, three times that without."""
    arm, data, held_out = rows
    off = {}
    names = [f"{name}=gravity" for name in arm.reading_names[1:3]]
    for terms in ((), tuple(names)):
        found = pincal.calibrate(
            arm,
            data,
            noise=NOISE,
            setup=pincal.Setup(unknown_frame=True, targets={"platform": pincal.Target(TARGET)}),
            terms=terms,
        )
        assert found.converged
        there = points(
            arm, pincal.forward(found.identified, held_out.readings, held_out.poses).poses
        )
        frame = np.array([one.identified for one in found.external])
        missed = (
            Rotation.from_rotvec(frame[3:]).apply(there) + frame[:3] - points(arm, held_out.poses)
        )
        off[bool(terms)] = float(np.sqrt((missed**2).sum(axis=1).mean()))
    noise = np.sqrt(3.0) * NOISE.position
    print(off, noise)
    assert off[True] < noise
    assert off[False] > 3.0 * off[True]
