"""How far targets are missed at held-out rows: terms and arms included."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest
from arms import loaded
from measured import validated, workspace
from scipy.spatial.transform import Rotation

import pincal
from pincal.calibration.calibrate import prepared, run
from pincal.calibration.calibration import Calibration
from pincal.calibration.promise import misses_of
from pincal.calibration.terms.candidates import with_terms
from pincal.calibration.terms.kinds import parse_terms
from pincal.show.misses import errors_at


def planar(noise: pincal.Noise, verified: int = 0, **options: bool) -> pincal.CalibrationResult:
    """Return a calibration of a 3-RRR, its errors at held-out rows included."""
    sets = ("all",) * (40 - verified) + ("verify",) * verified
    truth, plan = pincal.disturb("3RRR", 5e-3, seed=1), pincal.Plan(workspace("3RRR", 40), sets)
    data = pincal.simulate("3RRR", truth, plan, noise, seed=1).measurements
    return pincal.calibrate("3RRR", data, noise=noise, **options).validated()


@pytest.mark.slow
def test_held_out_poses_are_missed_within_their_limit() -> None:
    """Parameters drawn from their covariance and noise, 1,200 times: 95 % below, within 5 %."""
    noise, rng = pincal.Noise(2e-4, 1e-3, 3e-4), np.random.default_rng(0)
    result = planar(noise, verified=6)
    poses, drawn, factor = result.poses[-6:], [], np.linalg.cholesky(result.covariance)
    readings = pincal.inverse(result.identified, poses).readings
    ids, values = result.nominal.parameters.ids, result.identified.parameters.values
    for _ in range(120):
        moved = values + factor @ rng.standard_normal(len(values))
        machine = result.identified.with_parameters(dict(zip(ids, moved.tolist(), strict=True)))
        read = np.tile(readings, (10, 1))
        read += noise.reading * rng.standard_normal(read.shape)
        off = pincal.forward(machine, read, np.tile(poses, (10, 1))).poses - np.tile(poses, (10, 1))
        off += np.array([2e-4, 2e-4, 1e-3]) * rng.standard_normal(off.shape)
        drawn.append((off**2).reshape(10, -1, 3).mean(axis=1))
    squares = np.concatenate(drawn)
    simulated = np.quantile([squares[:, :2].sum(axis=1), squares[:, 2]], 0.95, axis=1) ** 0.5
    limits = [target.limit for target in result.validation.targets]
    np.testing.assert_allclose(limits, simulated, rtol=0.05)


def test_poses_of_one_leg_each_are_missed_within_their_limit() -> None:
    """Each row serves one leg, and is predicted by all: four sets, none over its 95 % limit."""
    noise, sets = pincal.Noise(2e-4, 1e-4), ("leg_1", "leg_2", "leg_3") * 16
    plan = pincal.Plan(workspace("3RRR", 48), sets)
    for seed in range(4):
        truth = pincal.disturb("3RRR", 2e-3, seed=seed)
        data = pincal.simulate("3RRR", truth, plan, noise, seed=seed).measurements
        result = pincal.calibrate("3RRR", data, noise=noise, method="per-leg").validated(3)
        for target in result.validation.targets:
            assert 0.2 * target.limit < target.rms < target.limit


@pytest.mark.slow
def test_an_unknown_frame_is_fitted_to_the_nominal_machine() -> None:
    """Positions of the nominal machine are off by what a rigid alignment leaves, to first order.

    Without knowing the frame they are off no farther than in it.
    """
    known, unknown = planar(pincal.Noise()), planar(pincal.Noise(), unknown_frame=True)
    poses = known.poses
    read = pincal.inverse(known.nominal, poses).readings
    ends = np.stack((poses, pincal.forward(unknown.identified, read, poses).poses))
    ends = (ends - ends.mean(axis=1, keepdims=True)) * [1.0, 1.0, 0.0]  # x and y, in the plane
    _, off = Rotation.align_vectors(*ends)
    before, farther = (errors_at(each, poses).before[:, 0] for each in (unknown, known))
    assert np.linalg.norm(before) == pytest.approx(off, rel=0.02)
    assert np.linalg.norm(before) < np.linalg.norm(farther)


@pytest.mark.slow
def test_positions_of_an_arm_are_missed_in_mm() -> None:
    """Positions alone, in an unknown frame: by the noise, mean and root mean square of a ball's."""
    arm = loaded("ur5")
    draw = np.random.default_rng(0)
    readings = draw.uniform(-1.2, 1.2, (200, 6))
    plan = pincal.Plan(pincal.forward(arm, readings).poses, readings=readings)
    noise = pincal.Noise(1e-4, 1e-4, 0.0)
    data = pincal.simulate(arm, pincal.disturb(arm, 1e-3, seed=1), plan, noise, seed=1).measurements
    poses = data.poses.copy()
    poses[:, 3:] = np.nan
    target = pincal.Target(unknown=True)
    setup = pincal.Setup(unknown_frame=True, targets={"platform": target})
    found = validated(
        arm,
        replace(data, poses=poses),
        noise=noise,
        setup=setup,
        folds=2,
        by="turn",
    )
    (one,) = found.targets
    assert one.rms == pytest.approx(1e-4 * np.sqrt(3.0), rel=0.25)
    assert found.position == (pytest.approx(one.fit), pytest.approx(one.rms))


def test_what_terms_depend_on_counts_where_platforms_are_missed() -> None:
    """A warm machine without noise misses nothing; taken as cold it does."""
    plain = pincal.load_mechanism("3RRR")
    poses = workspace("3RRR", 12)
    warm = {"temperature": np.linspace(15.0, 30.0, 12)}
    nominal = pincal.Measurements(
        poses=poses, readings=pincal.inverse(plain, poses).readings, influences=warm
    )
    machine, _ = with_terms(plain, nominal, parse_terms(["temperature"], plain))
    machine = machine.with_parameters({"leg_1.temperature": 2e-3, "leg_3.temperature": -1e-3})
    data = pincal.simulate(
        machine, machine, pincal.Plan(poses, influences=warm), pincal.Noise(0.0, 0.0, 0.0)
    ).measurements
    calibration, start = Calibration(machine, data), machine.parameters.values
    outside = calibration.observation.external.start
    missed = misses_of(calibration, start, outside)["platform", "m"]
    assert missed.max() < 1e-11
    data = replace(data, influences={"temperature": np.full(12, 20.0)})
    assert misses_of(Calibration(machine, data), start, outside)["platform", "m"].max() > 1e-4


def test_held_out_rows_go_on_from_the_fit() -> None:
    """With the fits at hand the answers are those of fits made again, to 1e-9."""
    places = [[x, y] for x in (-0.3, 0.0, 0.3) for y in (1.0, 1.1, 1.2, 1.3)]
    truth, noise = pincal.disturb("5R", 1e-3, seed=1), pincal.Noise(1e-4)
    data = pincal.simulate("5R", truth, pincal.Plan(np.array(places)), noise, seed=1).measurements
    on = run(prepared("5R", data, noise=noise), folds=3)[0].validation
    again = pincal.calibrate("5R", data, noise=noise).validated(3).validation
    assert again is not None
    assert on is not None
    numbers = [
        [value for value in asdict(one).values() if isinstance(value, float)] for one in (again, on)
    ]
    np.testing.assert_allclose(*numbers, rtol=1e-9)
