"""Held-out rows, what residuals follow, and runs held out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import done
from marks import slow_or_fuzz, some_slow
from measured import (
    EXACT,
    NOISE,
    machine,
    put,
    seen_from_elsewhere,
    targets,
    validated,
    workspace,
)
from scipy.signal import lfilter
from scipy.stats import chi2, f

import pincal
from pincal import Options
from pincal.calibration.calibration import Calibration
from pincal.calibration.fits import fitted
from pincal.calibration.options import folds_of
from pincal.calibration.validation import least_of_folds
from pincal.words.findings import finding

FRAME = pincal.Setup(unknown_frame=True)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("known", "method"), [(True, "all-legs"), (True, "per-leg"), (False, "all-legs")]
)
def test_held_out_rows_miss_as_expected(method: str, known: bool) -> None:
    """With the right model held-out residuals are those of the fit grown by what it lacks."""
    ratios = []
    for seed in range(4):
        mechanism, _, data = machine("3RRR", 60, seed=seed)
        found = validated(
            mechanism, data, method=method, poses="all", noise=NOISE if known else None
        )
        ratios.append(found.held_out / found.expected)
        assert found.findings == ()
        assert found.rows == len(data)
        assert found.position is not None
        assert found.position[1] > found.position[0]
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.06)


@pytest.mark.slow
@pytest.mark.parametrize("known", [True, False])
def test_few_rows_to_verify_with_are_not_judged_too_sharply(*, known: bool) -> None:
    """Of 40 sound sets of 15 rows, and 5 that no fit has seen, one has p < 0.01 at most.

    A right judgement passes with 94 %, one that finds p < 0.01 in a tenth of the sets with 8 %.
    """
    mechanism, noise = pincal.load_mechanism("3RRR"), pincal.Noise(1e-4, 1e-4, 1e-5)
    chances, poses = [], workspace("3RRR", 40 * 20)
    for seed in range(40):
        truth, plan = pincal.disturb(mechanism, None, seed), pincal.Plan(poses[seed::40])
        data = pincal.simulate(mechanism, truth, plan, noise, seed).measurements
        data = replace(data, sets=("",) * (len(data) - 5) + ("verify",) * 5)
        found = validated(mechanism, data, noise=noise if known else None)
        chances.append(found.p_value)
    assert (np.array(chances) < 0.01).sum() <= 1
    assert 0.3 < np.mean(chances) < 0.7


def test_what_rows_hold_is_theirs_wherever_the_search_begins() -> None:
    """Directions that few rows leave undetermined are held as a fit of these rows alone does."""
    mechanism, _, data = machine("delta", 30)
    options = Options(noise=NOISE)
    few = Calibration(mechanism, data.rows(np.arange(8)), options)
    some = np.arange(8) != 3
    part = few.rows(some)
    near, alone = fitted(part, fitted(few), some).held, fitted(part).held
    assert near is not None
    assert alone is not None
    assert near.directions.shape[1] > 0
    np.testing.assert_allclose(
        near.directions @ near.directions.T, alone.directions @ alone.directions.T
    )


def test_folds_that_cannot_be_aligned_say_so() -> None:
    """Where a fold lacks what shows the frame, it is not taken from the other rows."""
    mechanism, _, data = machine("3RRR", 36)
    thirds = tuple("abc"[row * 3 // 36] for row in range(36))
    moved = seen_from_elsewhere(mechanism, replace(data, runs=thirds))
    poses = moved.poses.copy()
    poses[12:, :2] = np.nan  # positions in the first run only
    partly = replace(moved, poses=poses)
    with pytest.raises(pincal.MeasurementError, match="cannot be aligned"):
        validated(mechanism, partly, setup=FRAME, noise=NOISE, folds=3, by="run")


@pytest.mark.slow
def test_held_out_rows_of_an_unknown_frame() -> None:
    """Frames are those of the fit: errors are as expected there too."""
    mechanism, _, data = machine("3RRR", 60)
    moved = seen_from_elsewhere(mechanism, data)
    # regions are few and far: what is expected of them spreads more
    found = validated(mechanism, moved, noise=NOISE, setup=FRAME, folds=3, by="turn")
    assert found.held_out == pytest.approx(found.expected, rel=0.15)
    assert found.position is not None
    assert found.position[1] == pytest.approx(1.6e-4, rel=0.3)


@pytest.mark.slow
def test_a_model_that_lacks_something_is_found_out() -> None:
    """Ten places measured ten times each, every place 1 mm off in its own way: repeats hide it.

    The fit bends to its ten places; places that it has not seen show it.
    """
    mechanism, _, data = machine("3RRR", 10, pincal.Noise(1e-5, 1e-5, 0.0))
    rng = np.random.default_rng(0)
    data = put(
        data, "poses", np.s_[:], data.poses[:] + (1e-3 * rng.standard_normal(data.poses.shape))
    )
    rows = np.repeat(np.arange(len(data)), 10)
    many = replace(data.rows(rows), places=tuple(f"p{i}" for i in rows))
    many = put(
        many, "poses", np.s_[:], many.poses[:] + (1e-4 * rng.standard_normal(many.poses.shape))
    )
    found = validated(mechanism, many, folds=10, poses="all")
    assert found.held_out > 1.5 * found.expected
    assert found.p_value < 1e-3
    assert "held-out-worse" in {one.code for one in found.findings}


@pytest.mark.slow
def test_drift_is_found() -> None:
    """A tracker that moves by 0.6 mm over the rows: residuals follow their order, by leg."""
    mechanism, _, data = machine("3RRR", 80)
    found = []
    for drift in (0.0, 3e-4):
        x = data.poses[:, 0] + np.linspace(-drift, drift, len(data))
        moving = put(data, "poses", np.s_[:, 0], x)
        result = pincal.calibrate(mechanism, moving, noise=NOISE).validated(folds=2)
        found.append([one for one in result.findings if one.code in {"model-lacks", "step"}])
    assert not found[0]
    (drifts,) = found[1]
    assert drifts.code == "step" or drifts.values["term"] == "order"


@pytest.mark.parametrize("kind", slow_or_fuzz(["5R"], ["6UPS"]))
def test_rows_off_as_those_before_are_no_step(kind: str) -> None:
    """Positions with a correlation of 0.8 from row to row: a step is named once in ten at most.

    Steps of three standard deviations in white noise are named in nine of ten.
    """
    noise, named = pincal.Noise(1e-4, 1e-4), {"alike": 0, "step": 0}
    mechanism, _, exact = machine(kind, 36, pincal.Noise(1e-9, 1e-9), sigma=1e-3)
    for seed in range(10):
        rng = np.random.default_rng(seed)
        white = 1e-4 * rng.standard_normal(exact.poses.shape)
        alike = lfilter([0.6], [1.0, -0.8], white, axis=0)
        stepped = white.copy()
        stepped[rng.integers(6, 30) :, 0] += 3e-4
        for name, errors in (("alike", alike), ("step", stepped)):
            data = put(exact, "poses", np.s_[:], exact.poses + errors)
            findings = pincal.calibrate(mechanism, data, noise=noise).findings
            timed = [f.code == "step" or f.values.get("term") == "order" for f in findings]
            named[name] += any(timed)
    assert named["alike"] <= 1
    assert named["step"] >= 9


@pytest.mark.slow
def test_a_misfit_of_all_poses_is_no_step() -> None:
    """Cables over pulleys of 30 mm, which no model here knows: χ² says so, no course of time does.

    A cable leaves its pulley, which turns about the vertical, along a tangent.
    """
    mechanism, truth, data = machine("8cable", 40, pincal.Noise(1e-4, 1e-4, 5e-5), sigma=1e-3)
    poses = np.concatenate((data.poses, [mechanism.platform.home]))
    matrices, radius, longer = mechanism.platform.matrices(poses), 0.03, []
    for leg in truth.legs:
        anchor, point = np.array(leg.joints[0].placement.xyz), np.array(leg.point.placement.xyz)
        ray = matrices[:, :3, :3] @ point + matrices[:, :3, 3] - anchor
        level, height = np.hypot(ray[:, 0], ray[:, 1]), ray[:, 2]
        away = np.hypot(level - radius, height)
        wrapped = np.pi - np.arctan2(height, level - radius) - np.arccos(radius / away)
        cable = np.sqrt(away**2 - radius**2) + radius * wrapped
        longer.append(cable - np.hypot(level, height))
    change = np.transpose(longer)
    rolled = put(data, "readings", np.s_[:], data.readings + change[:-1] - change[-1])
    result = pincal.calibrate(mechanism, rolled, noise=pincal.Noise(1e-4, 1e-4, 5e-5))
    causes = {remark.code: remark.values.get("term") for remark in result.findings}
    assert "chi2-too-large" in causes
    assert not {"step", "rows-alike"} & set(causes)
    assert causes.get("model-lacks") in (None, "pose", "angle")


def test_folds_keep_repeats_together_and_deal_sets_alike() -> None:
    """Rows of one pose are never on both sides; too many folds are refused."""
    mechanism, _, data = machine("3RRR", 12)
    places = tuple(f"p{i // 3}" for i in range(len(data)))
    folds = folds_of(replace(data, places=places), 2)
    assert all(len({folds[i] for i in range(3 * p, 3 * p + 3)}) == 1 for p in range(4))
    sets = tuple("leg_1" if i < 6 else "leg_2" for i in range(len(data)))
    folds = folds_of(replace(data, sets=sets), 3)
    assert sorted(folds[:6].tolist()) == sorted(folds[6:12].tolist()) == [0, 0, 1, 1, 2, 2]
    for count in (1, 13):
        with pytest.raises(pincal.MeasurementError, match="at least two folds"):
            validated(mechanism, data, folds=count)


@pytest.mark.slow
def test_what_changes_between_runs_shows_when_they_are_held_out() -> None:
    """A leg moved by 1 mm before the second of three runs; without it nothing is found."""
    mechanism, truth, clean = machine("3RRR", 40, EXACT)
    bent = truth.with_parameters({"leg_2": {"OA": truth.leg("leg_2").nominal[2] + 1e-3}})
    for second, codes in ((truth, []), (bent, ["held-out-worse"])):
        parts = [
            pincal.simulate(mechanism, true, pincal.Plan(clean.poses), NOISE, run).measurements
            for run, true in enumerate((truth, second, truth))
        ]
        validation = validated(mechanism, joined(parts), noise=NOISE, by="run")
        assert validation.folds == 3
        assert [remark.code for remark in validation.findings][-1:] == codes


def joined(parts: list[pincal.Measurements]) -> pincal.Measurements:
    """Return measurements of several runs as one."""
    return pincal.Measurements(
        np.concatenate([p.poses for p in parts]),
        readings=np.concatenate([p.readings for p in parts]),
        runs=tuple(f"run {i}" for i, p in enumerate(parts) for _ in range(len(p))),
    )


@pytest.mark.slow
def test_standard_errors_in_an_unknown_frame() -> None:
    """Parameters and frame over 40 data sets: their spread is as large as is said.

    A single spread is known to 11 %, the mean of all to 3 %. Errors of the platform are told from
    the covariance (tests/test_calibrate.py), which is that of the bound (tests/test_statistics.py).
    """
    _, mechanism, clean = machine("3RRR", 40, EXACT)
    found, said = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        shake = 1e-4 * rng.standard_normal(clean.poses.shape)
        data = replace(clean, poses=mechanism.platform.moved(clean.poses, shake))
        moved = seen_from_elsewhere(mechanism, data)
        result = pincal.calibrate(mechanism, moved, setup=FRAME, noise=pincal.Noise(1e-4, 1e-4))
        parameters = [*(p for leg in result.legs for p in leg.parameters), *result.external]
        found.append([p.identified for p in parameters])
        said.append([p.std for p in parameters])
    ratios = np.mean(said, axis=0) / np.std(found, axis=0)
    assert abs(ratios.mean() - 1) < 0.1
    assert (np.abs(ratios - 1) < 0.4).all()


@pytest.mark.slow
def test_the_command_holds_runs_out(tmp_path: Path) -> None:
    """``--by run`` leaves out each run in turn: what is said equals ``validate`` from Python.

    Fits end within 1e-3 standard errors of the optimum, about which χ² is flat: within 1e-6.
    """
    mechanism, truth, clean = machine("5R", 40, EXACT)
    plan = pincal.Plan(clean.poses)
    parts = [pincal.simulate(mechanism, truth, plan, NOISE, run).measurements for run in range(3)]
    data = joined(parts)
    data.to_csv(tmp_path / "m.csv", mechanism)
    done("calibrate", "--no-report", "5R", tmp_path / "m.csv", "--by", "run", "-o", tmp_path / "r")
    found = pincal.load_result(tmp_path / "r").validation
    expected = validated(mechanism, data, by="run")
    assert found.folds == expected.folds == 3
    assert found.held_out == pytest.approx(expected.held_out, rel=1e-6)
    result = pincal.calibrate(mechanism, data).validated(by="run")
    assert result.validation.held_out == pytest.approx(found.held_out, rel=1e-6)
    assert len(set(result.contradictions)) == len(result.contradictions)


@pytest.mark.slow
def test_held_out_rows_follow_the_same_start(tmp_path: Path) -> None:
    """Zeros of motors that are far off are found for validation as for calibration.

    A result that was loaded starts there too, with the noise as it was.
    """
    mechanism, _, data = machine("3RRR", 60)
    away = replace(data, readings=data.readings + np.array([0.7, 0.2, -1.6]))
    found, usual = (validated(mechanism, one, noise=NOISE) for one in (away, data))
    assert found.held_out == pytest.approx(usual.held_out, rel=0.05)
    result = pincal.calibrate(mechanism, away, noise=NOISE)
    result.save(tmp_path / "r")
    loaded = pincal.load_result(tmp_path / "r").calibration
    np.testing.assert_array_equal(loaded.start, result.calibration.start)
    np.testing.assert_array_equal(loaded.noise.poses.sigma, result.calibration.noise.poses.sigma)
    assert loaded.noise.source == result.calibration.noise.source


def test_a_wrong_row_does_not_hide_in_what_is_expected() -> None:
    """One row 20 mm off spoils the fit of all; held-out rows are then worse than is expected."""
    nominal, noise = pincal.load_mechanism("3RRR"), pincal.Noise(2e-4, 1e-4)
    truth, plan = pincal.disturb(nominal, 1e-3, seed=1), pincal.Plan(workspace("3RRR", 48, 1))
    data = pincal.simulate(nominal, truth, plan, noise, seed=1).measurements
    data = replace(data, poses=data.poses + 0.02 * (np.arange(144).reshape(48, 3) == 30))
    (worse,) = pincal.calibrate(nominal, data, noise=noise).validated().validation.findings
    assert worse.code == "held-out-worse"
    assert worse.values["held_out"] > 3.0 * worse.values["expected"]


def test_what_is_held_out_is_said_once() -> None:
    """A finding of validation contradicts once, whether or not it is among the result's."""
    mechanism, _, data = machine("3RRR", 60)
    result = pincal.calibrate(mechanism, data, noise=NOISE)
    validation = validated(mechanism, data, noise=NOISE)
    worse = finding("held-out-worse", held_out=3.0, expected=1.0, p_value=1e-9)
    validation = replace(validation, findings=(worse,))
    both = replace(result, validation=validation, findings=(*result.findings, worse))
    assert [one.code for one in both.contradictions] == ["held-out-worse"]


def test_noise_given_too_small_is_no_matter_of_held_out_rows() -> None:
    """Residuals that contradict the noise are not said to be worse where they are not."""
    mechanism, _, data = machine("3RRR", 60)
    small = pincal.Noise(*(value / 15.0 for value in vars(NOISE).values()))
    found = validated(mechanism, data, noise=small, rough=True)
    assert found.held_out > 5.0
    assert "held-out-worse" not in [one.code for one in found.findings]


@pytest.mark.slow
@pytest.mark.parametrize("several", some_slow([False, True], True))
def test_held_out_points_are_missed_in_mm(several: bool) -> None:
    """Of positions alone, or of two targets: what the true machine's noise and errors make.

    The true machine misses points by their noise and by what noise of readings moves it.
    """
    mechanism, truth, data = machine("3RRR", 60, NOISE)
    setup, poses = pincal.Setup(), data.poses.copy()
    if several:
        offset = (0.3, 0.1, 0.0)
        there = pincal.forward(truth, data.readings).poses
        data = replace(data, extra=targets(mechanism, there, {"ball": offset}, NOISE.position))
        known = {"platform": pincal.Target(), "ball": pincal.Target(offset)}
        setup = pincal.Setup(targets=known)
    poses[:, 2] = np.nan
    data = replace(data, poses=poses)
    result = pincal.calibrate(mechanism, data, noise=NOISE, setup=setup).validated()
    assert result.validation is not None
    assert result.validation.position is not None
    fit, held = result.validation.position
    seen = result.calibration.observation
    there = mechanism.platform.matrices(pincal.forward(truth, data.readings).poses)
    off, _, _ = seen.residuals(there, seen.external.start)
    exact = off[seen.measured.any(axis=1)]
    least = float(np.sqrt((exact**2).sum(axis=1).mean() / (1 + several)))
    assert 0.7 * least < fit < held < 4.0 * least
    (own, *others) = result.validation.targets
    assert [own.target, *(one.target for one in others)] == ["platform", "ball"][: 1 + several]
    assert own.poses == len(data)
    assert own.rms < own.largest


@pytest.mark.parametrize("known", [True, False])
def test_the_least_of_folds_is_as_probable_as_of_fits_to_noise(*, known: bool) -> None:
    """Least squares of 20,000 draws, with each fold and without it: small chances to a tenth."""
    mechanism, _, data = machine("3RRR", 40)
    fits = fitted(Calibration(mechanism, data, Options(noise=NOISE))).fits
    one, groups = fits[0], folds_of(data, 5, "region")
    J = one.last.jacobian @ one.unknowns.map
    rows = np.repeat(groups, J.shape[1])
    J, z = J.reshape(len(rows), -1), np.random.default_rng(1).standard_normal((20_000, len(rows)))

    def left(kept: np.ndarray) -> np.ndarray:
        Q = np.linalg.qr(J[kept])[0]
        return np.asarray((z[:, kept] ** 2).sum(axis=1) - ((z[:, kept] @ Q) ** 2).sum(axis=1))

    total, chances = left(rows >= 0), []
    for fold in range(5):
        seen, count = left(rows != fold), int((rows == fold).sum())
        dof = len(rows) - J.shape[1] - count
        ratio = (total - seen) / count / (seen / dof)
        chances.append(chi2.sf(total - seen, count) if known else f.sf(ratio, count, dof))
    drawn = np.min(chances, axis=0)
    for least in (0.003, 0.01, 0.03):
        share = (drawn <= least).mean()
        error = np.sqrt(share * (1.0 - share) / 20_000)
        assert least_of_folds([least] * 5) == pytest.approx(share, rel=0.1, abs=3.0 * error)
