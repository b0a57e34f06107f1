"""Noise that was not given is found: what residuals at it show is the noise itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from measured import workspace

import pincal
from pincal.calibration import fits
from pincal.estimation.components import Assumptions, Moments


@pytest.mark.parametrize("seed", [0, 3, 14])
def test_noise_is_found_in_a_few_rounds(
    monkeypatch: pytest.MonkeyPatch, selections: dict[str, pincal.Selection], seed: int
) -> None:
    """The search for variances ends where they say themselves, and does not go round in a circle.

    Exact readings of these machines look slightly noisy; a guess of how much that is far too large
    says that they are exact.
    """
    rounds = []
    last = Assumptions.estimate

    def counted(assumed: Assumptions, moments: Moments, noise: pincal.Noise) -> pincal.Noise:
        rounds.append((noise, last(assumed, moments, noise)))
        return rounds[-1][1]

    monkeypatch.setattr(Assumptions, "estimate", counted)
    nominal = pincal.load_mechanism("3RRR")
    truth = pincal.disturb(nominal, 1e-3, seed=seed)
    noise = pincal.Noise(1e-4, 1e-4, 0.0)
    plan = selections["3RRR"].plan
    result = pincal.calibrate(
        nominal, pincal.simulate(truth, truth, plan, noise, seed).measurements
    )
    assert result.converged
    before, after = (list(vars(noise).values()) for noise in rounds[-1])
    np.testing.assert_allclose(after, before, rtol=fits.SETTLED)
    assert len(rounds) <= 20  # 31 to 100 in a circle


@pytest.mark.parametrize("name", ["3RRR", "5R"])
def test_noise_that_stays_is_not_fitted_again(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """After the fit that finds it, one or two at what was found, whose χ² is all there is."""
    count, robust_fit = [], fits.robust_fit
    monkeypatch.setattr(fits, "robust_fit", lambda *a, **k: count.append(1) or robust_fit(*a, **k))
    nominal = pincal.load_mechanism(name)
    truth, poses = pincal.disturb(nominal, 1e-3, seed=1), workspace(name, 72, 3)
    noise = pincal.Noise(1e-4, 1e-4, 5e-5)
    data = pincal.simulate(nominal, truth, pincal.Plan(poses), noise, 2).measurements
    result = pincal.calibrate(nominal, data)
    assert len(count) <= 3  # 11, as what was scaled was compared with what was not
    assert result.reduced_chi2 == pytest.approx(1.0, abs=5e-3)


def test_few_rows_leave_no_group_without_noise() -> None:
    """Fifteen rows to which orientations look exact do not make them so.

    1e-4 rad are true; 3e-8 rad are a least noise where the estimate is zero.
    """
    nominal = pincal.load_mechanism("3RRR")
    plan = pincal.sample_configurations(nominal, 55, seed=137)
    truth, noise = pincal.disturb(nominal, 1e-3, seed=1137), pincal.Noise(1e-4, 1e-4, 0.0)
    data = pincal.simulate(nominal, truth, plan, noise, seed=137).measurements
    result = pincal.calibrate(nominal, data.rows(np.arange(15)))
    assert result.noise.orientation > 1e-2 * result.noise.position / nominal.size


def test_what_a_model_lacks_is_no_noise_of_sensors(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drives eccentric by ten times the noise: other poses are missed no farther than with noise.

    Not by more than 3 % of 300 held-out rows; 19 % if readings are taken for as noisy as they look,
    since poses near singularities then weigh little.
    """
    monkeypatch.syspath_prepend("benchmarks")
    study, nominal = pytest.importorskip("unknown_noise"), pincal.load_mechanism("5R")
    truth = study.eccentric(nominal, 10.0 * study.NOISE.position, 83)
    plan = pincal.Plan(pincal.sample_workspace(nominal, 360, 1005))
    data = pincal.simulate(nominal, truth, plan, study.NOISE, seed=5).measurements
    seen, verification = data.rows(np.arange(60)), data.rows(np.arange(60, 360))
    missed = []
    for noise in (study.NOISE, None):
        identified = pincal.calibrate(nominal, seen, noise=noise).identified
        poses = pincal.forward(identified, verification.readings, verification.poses).poses
        missed.append(np.sqrt(np.mean((poses - verification.poses)[:, :2] ** 2)))
    assert missed[1] <= 1.03 * missed[0]


@pytest.mark.parametrize("tracker", [1e-4, 2e-5])
def test_sensors_noisier_than_a_tracker_are_no_misfit(tracker: float) -> None:
    """A hexapod whose readings move it farther than it is measured fits, and its noise is right."""
    nominal = pincal.load_mechanism("6UPS")
    truth = pincal.disturb(nominal, 1e-3, seed=5)
    plan = pincal.sample_configurations(nominal, 60, seed=5)
    noise = pincal.Noise(tracker, tracker, 5e-5)
    data = pincal.simulate(nominal, truth, plan, noise, seed=5).measurements
    result = pincal.calibrate(nominal, data)
    assert {finding.code for finding in result.findings} == {"noise-estimated"}
    for estimate, true in zip(vars(result.noise).values(), (tracker, tracker, 5e-5), strict=False):
        assert estimate == pytest.approx(true, rel=0.25)


def test_exact_readings_of_eight_drives_leave_no_direction_open() -> None:
    """Noise of more readings than freedoms is far below that of poses, and not zero.

    What readings alone determine shows no noise of poses: it is no degree of freedom, of which
    240 less six of frames are known at most. Over all 264 equations the noise is 6 % too small.
    """
    nominal = pincal.load_mechanism("8cable")
    plan = pincal.Plan(pincal.sample_workspace(nominal, 40))
    truth = pincal.disturb(nominal, 1e-3, seed=1)
    data = pincal.simulate(nominal, truth, plan, pincal.Noise(1e-4, 1e-4, 0.0), 1).measurements
    result = pincal.calibrate(nominal, data, folds=0)
    assert result.converged
    assert 0.0 < result.noise.reading < 1e-5
    assert result.noise.position == pytest.approx(1e-4, rel=0.1)
    assert result.degrees_of_freedom <= 6 * len(data) - 6


def test_noise_that_is_given_row_by_row_is_in_proportion() -> None:
    """Columns of σ that are right contradict nothing, as the same noise for all rows does not."""
    mechanism, noise = pincal.load_mechanism("6UPS"), pincal.Noise(1e-4, 1e-4, 3e-4)
    plan = pincal.sample_configurations(mechanism, 40, 0)
    truth = pincal.disturb(mechanism, 1e-3, 1)
    data = pincal.simulate(mechanism, truth, plan, noise, 0).measurements
    poses, readings = np.full(data.poses.shape, 1e-4), np.full(data.readings.shape, 3e-4)
    by_row = replace(data, sigma_poses=poses, sigma_readings=readings)
    result = pincal.calibrate(mechanism, by_row)
    assert result.noise_source == "rows"
    assert [remark.code for remark in result.findings] == []
    exchanged = replace(data, sigma_poses=readings, sigma_readings=poses)
    codes = {remark.code for remark in pincal.calibrate(mechanism, exchanged).findings}
    assert codes & {"noise-in-other-proportion", "chi2-too-large"}
