"""Outliers, noise of rows and repeats, priors, fixed parameters and ties."""

from __future__ import annotations

from dataclasses import replace

import cramer_rao
import numpy as np
import pytest
from cramer_rao import drawn
from marks import quick, slow_or_fuzz
from measured import (
    EXACT,
    NOISE,
    error,
    evaluations,
    machine,
    put,
    seen_from_elsewhere,
    shaken,
    workspace,
)
from scipy.stats import chi2

import pincal
from pincal.estimation.system import cauchy, outlying, robust_scale

METHODS = ["per-leg", "all-legs"]


def spoiled(data: pincal.Measurements, seed: int, sigma: float) -> tuple:
    """Return data in which a tenth of the rows have a coordinate 100 σ off, and these rows."""
    rng = np.random.default_rng(seed)
    rows = rng.choice(len(data), len(data) // 10, replace=False)
    poses = data.poses.copy()
    columns = rng.integers(poses.shape[1], size=len(rows))
    poses[rows, columns] += 100 * sigma * rng.choice([-1, 1], len(rows))
    return replace(data, poses=poses), set(rows.tolist())


@pytest.mark.slow
@pytest.mark.parametrize("row", [6, 28])
def test_a_decimal_slip_is_named_in_an_unknown_frame(row: int) -> None:
    """A reading ten times too large, 80 times the median off nominal: named, and left out."""
    mechanism, _, data = machine("3RRR", 30, NOISE)
    data = seen_from_elsewhere(mechanism, data)
    place = row, row % 3
    slipped = put(data, "readings", place, 10.0 * data.readings[place])
    setup = pincal.Setup(unknown_frame=True)
    kept = pincal.calibrate(mechanism, slipped, noise=NOISE, setup=setup)
    assert [one.row for one in kept.outliers] == [row]
    result = pincal.calibrate(mechanism, slipped, noise=NOISE, setup=setup, loss="reject")
    assert [one.row for one in result.outliers] == [row]
    assert result.excess == 1.0


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_gross_outliers_are_listed_and_do_little_harm(method: str) -> None:
    """10 % of rows 100 σ off: error within 1.3 times the clean fits', all listed, few others.

    Root mean square over 4 machines in standard errors of the clean fits. Legs alone see
    single coordinates only as far as they take part in their closure.
    """
    clean_errors, errors, missed, false, good = [], [], 0, 0, 0
    for seed in range(4):
        mechanism, truth, data = machine("3RRR", 60, seed=seed)
        true = np.concatenate([leg.nominal for leg in truth.legs])
        bad, rows = spoiled(data, seed, 1e-4)
        options = {"method": method, "poses": "all", "noise": NOISE}
        clean = pincal.calibrate(mechanism, data, **options)  # type: ignore[arg-type]
        result = pincal.calibrate(mechanism, bad, loss="reject", **options)  # type: ignore[arg-type]
        std = np.concatenate([leg.std for leg in clean.legs])
        for own, one in ((clean_errors, clean), (errors, result)):
            own.append((np.concatenate([leg.identified for leg in one.legs]) - true) / std)
        listed = {one.row for one in result.outliers}
        missed += len(rows - listed)
        false += len(listed - rows)
        good += len(data) - len(rows)
    ratio = np.sqrt(np.mean(np.square(errors)) / np.mean(np.square(clean_errors)))
    assert ratio <= 1.3
    assert missed == 0
    assert false <= 0.02 * good


def test_a_search_with_many_outliers_converges(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sixth of the rows is 3 mm off: they are left out, and the search does not crawl.

    Weights follow the rows. By those of its end a good step seems to rise, so it is judged by
    those of its beginning (3,000 evaluations and no end, where tens are enough).
    """
    robot = pincal.load_mechanism("3RRR")
    noise, draw = pincal.Noise(5e-5, 2e-4, 5e-5), np.random.default_rng(0)
    spread = np.array([0.06, 0.06, 0.3]) * draw.uniform(-1.0, 1.0, (60, 3))
    plan = pincal.Plan(robot.platform.home + spread)
    data = pincal.simulate(robot, pincal.disturb(robot, 1e-3, 1), plan, noise, 2).measurements
    data = put(data, "poses", np.s_[::6, 0], data.poses[::6, 0] + 3e-3)
    evaluated = evaluations(monkeypatch)
    result = pincal.calibrate(robot, data, noise=noise, loss="reject")
    assert len(evaluated) < 300
    assert [outlier.row for outlier in sorted(result.outliers, key=lambda o: o.row)] == [
        *range(0, 60, 6)
    ]
    assert "undetermined-held" not in {finding.code for finding in result.findings}


def test_rejected_rows_really_leave_the_fit() -> None:
    """The result equals that of the other rows alone, bit by bit of ten digits."""
    mechanism, _, data = machine("3RRR", 60)
    bad, rows = spoiled(data, 0, 1e-4)
    result = pincal.calibrate(mechanism, bad, noise=NOISE, loss="reject")
    assert {one.row for one in result.outliers} == rows
    assert all(one.weight == 0.0 for one in result.outliers)
    kept = np.setdiff1d(np.arange(len(data)), list(rows))
    alone = pincal.calibrate(mechanism, bad.rows(kept), noise=NOISE)
    for one, two in zip(result.legs, alone.legs, strict=True):
        np.testing.assert_allclose(one.identified, two.identified, atol=1e-10)
        np.testing.assert_allclose(one.std, two.std, rtol=1e-6)
        assert one.n_residuals == two.n_residuals
    assert result.degrees_of_freedom == alone.degrees_of_freedom


@pytest.mark.slow
def test_a_wrong_reading_is_named() -> None:
    """A reading 100 σ off: the row, the leg and how far, with the scale of the noise unknown."""
    mechanism, _, data = machine("6UPS", 60)
    data = put(data, "readings", np.s_[7, 2], data.readings[7, 2] + (5e-3))
    for noise in (NOISE, None):
        result = pincal.calibrate(mechanism, data, noise=noise, loss="reject")
        worst = result.outliers[0]
        assert worst.row == 7
        if noise:
            assert "leg_3" in worst.quantity
        assert worst.sigma > 10


def test_weights_are_those_of_the_books() -> None:
    """On one residual r: Cauchy's weights as published, by their constant."""
    r = np.array([0.0, 0.5, 1.0, 2.0, 4.6, 100.0])
    weights = cauchy(r**2, np.ones(len(r), dtype=int))
    np.testing.assert_allclose(weights, 1.0 / (1.0 + (r / 2.385) ** 2), atol=1e-4)


@pytest.mark.parametrize("equations", [1, 3])
def test_the_scale_is_that_of_the_rows_in_the_middle(equations: int) -> None:
    """Of normal residuals their standard deviation; a tenth of gross errors, empty rows: as well.

    Of one equation it is the median absolute deviation by its known factor, 1.4826.
    """
    x = 0.3 * np.random.default_rng(1).standard_normal((100_001, equations))
    squares, count = (x**2).sum(axis=1), np.full(len(x), equations)
    found = robust_scale(squares, count, 1.0)
    assert found == pytest.approx(0.3, rel=0.01)
    if equations == 1:
        assert found == pytest.approx(1.4826 * np.median(np.abs(x)), rel=1e-4)
    assert robust_scale(squares, count, 0.25) == pytest.approx(2 * found)
    empty = np.r_[squares, np.zeros(50_000)], np.r_[count, np.zeros(50_000, dtype=int)]
    assert robust_scale(*empty, 1.0) == found
    assert robust_scale(np.zeros(3), np.zeros(3, dtype=int), 1.0) == 1.0
    squares[::10] = 1e6
    assert found < robust_scale(squares, count, 1.0) < 1.25 * found


def test_without_a_loss_outliers_are_warned_of() -> None:
    """The plain fit keeps them, says which rows do not fit, and what to do."""
    mechanism, _, data = machine("3RRR", 60)
    data = put(data, "poses", np.s_[4, 0], data.poses[4, 0] + 0.01)
    result, estimated = (pincal.calibrate(mechanism, data, noise=noise) for noise in (NOISE, None))
    assert result.outliers[0].row == 4
    assert result.outliers[0].weight == 1.0
    for found in (result, estimated):  # also by the scale found; the pose gives way a little
        assert found.outliers[0].quantity == "measured x"
        assert found.noise
        assert 0.006 < found.outliers[0].off * found.noise.position < 0.0101
    assert any("data row 5" in text and "--loss reject" in text for text in result.warnings)


@pytest.mark.fuzz
def test_standard_errors_of_robust_fits_equal_the_spread() -> None:
    """Over 100 data sets with a tenth of outliers, within 10 %."""
    mechanism, _truth, clean = machine("5R", 60, EXACT)
    found, std = [], []
    for seed in range(100):
        data, _ = spoiled(shaken(mechanism, clean, NOISE, seed), seed, 1e-4)
        result = pincal.calibrate(mechanism, data, noise=NOISE, loss="reject")
        found.append(np.concatenate([leg.identified for leg in result.legs]))
        std.append(np.concatenate([leg.std for leg in result.legs]))
    ratio = np.mean(std, axis=0) / np.std(found, axis=0)
    assert abs(ratio.mean() - 1) < 0.10


def test_noise_of_repeated_rows_is_found() -> None:
    """Ten poses measured five times each tell the noise within a fifth; a ``pose`` column too."""
    mechanism, _truth, clean = machine("3RRR", 10, EXACT)
    rows = np.repeat(np.arange(len(clean)), 5)
    many = clean.rows(rows)
    rng = np.random.default_rng(0)
    shake = np.array([1e-4, 1e-4, 3e-4]) * rng.standard_normal(many.poses.shape)
    same = replace(many, poses=many.poses + shake)
    result = pincal.calibrate(mechanism, same, poses="all")
    assert result.noise_source == "repeats"
    assert result.noise is not None
    assert result.noise.position == pytest.approx(1e-4, rel=0.2)
    assert result.noise.orientation == pytest.approx(3e-4, rel=0.2)
    assert result.noise.reading < 1e-15
    readings = many.readings + 5e-5 * rng.standard_normal(many.readings.shape)
    named = replace(same, readings=readings, places=tuple(f"p{i}" for i in rows))
    result = pincal.calibrate(mechanism, named)
    assert result.noise is not None
    assert result.noise.reading == pytest.approx(5e-5, rel=0.2)
    assert 0.5 < result.reduced_chi2 < 1.6
    few = pincal.calibrate(mechanism, same.rows(np.r_[0:2, 5:50:1]), poses="all")
    assert few.noise_source == "repeats"
    none = pincal.calibrate(mechanism, machine("3RRR", 30)[2])
    assert none.noise_source == "estimated"


def test_rows_with_their_own_noise_count_by_it() -> None:
    """Rows ten times as noisy, and said so, leave the estimate as good as without them."""
    mechanism, _truth, data = machine("3RRR", 60)
    worse = np.arange(len(data)) % 2 == 0
    rng = np.random.default_rng(1)
    poses = data.poses + np.where(worse[:, None], 1e-3, 0.0) * rng.standard_normal(data.poses.shape)
    sigma = np.where(worse[:, None], 1e-3, 1e-4) * np.ones((1, 3))
    readings = np.full(data.readings.shape, 5e-5)
    told = replace(data, poses=poses, sigma_poses=sigma, sigma_readings=readings)
    for method in METHODS:
        result = pincal.calibrate(mechanism, told, method=method, poses="all")  # type: ignore[arg-type]
        half = pincal.calibrate(
            mechanism,
            data.rows(~worse),
            method=method,
            poses="all",
            noise=NOISE,  # type: ignore[arg-type]
        )
        assert result.noise_source == "rows"
        for one, two in zip(result.legs, half.legs, strict=True):
            assert (one.std <= two.std * 1.001).all()
        assert 0.6 < result.reduced_chi2 < 1.5


@pytest.mark.parametrize("method", METHODS)
def test_fixed_parameters_stay(method: str) -> None:
    """Of every leg or of one; the others are those of a mechanism in which they are constants."""
    mechanism, truth, data = machine("3RRR", noise=EXACT)
    truth = truth.with_parameters({"leg_2": {"k": 1.0}})
    plan = pincal.Plan(data.poses)
    data = pincal.simulate(mechanism, truth, plan, EXACT).measurements
    options = {"method": method, "noise": NOISE, "poses": "all"}
    result = pincal.calibrate(mechanism, data, fixed=("leg_2.k",), **options)  # type: ignore[arg-type]
    parameter = {p.name: p for p in result.leg("leg_2").parameters}["k"]
    assert (parameter.identified, parameter.std) == (1.0, 0.0)
    assert error(result, truth) < 1e-9


@pytest.mark.parametrize("method", quick(1, METHODS))
def test_ties_are_one_value(method: str) -> None:
    """A length shared by all legs comes back as one, better known; χ² says when legs differ."""
    mechanism = pincal.load_mechanism("3RRR")
    truth = pincal.disturb(mechanism, 2e-3, 1)
    same = truth.with_parameters({leg.name: {"ob": 0.867} for leg in mechanism.legs})
    plan = pincal.Plan(workspace("3RRR", 40))
    options = {"method": method, "noise": NOISE, "poses": "all"}
    data = pincal.simulate(mechanism, same, plan, NOISE, 0).measurements
    result = pincal.calibrate(mechanism, data, tied=("ob",), **options)  # type: ignore[arg-type]
    assert len({leg.parameters[4].identified for leg in result.legs}) == 1
    assert result.promises
    free = pincal.calibrate(mechanism, data, **options)  # type: ignore[arg-type]
    assert result.legs[0].std[4] < free.legs[0].std[4]
    unlike = same.with_parameters({"leg_2": {"ob": 0.873}})
    other = pincal.simulate(mechanism, unlike, plan, NOISE, 0).measurements
    result = pincal.calibrate(mechanism, other, tied=("ob",), **options)  # type: ignore[arg-type]
    assert "chi2-too-large" in {remark.code for remark in result.contradictions}


@pytest.mark.parametrize("method", METHODS)
def test_priors_are_measurements(method: str) -> None:
    """A tight prior holds a parameter, a loose one changes nothing; between, information adds."""
    mechanism, _, data = machine("3RRR", 40)
    options = {"method": method, "noise": NOISE, "poses": "all"}
    free = pincal.calibrate(mechanism, data, **options)  # type: ignore[arg-type]
    tight = pincal.calibrate(mechanism, data, priors={"leg_1.L": 1e-9}, **options)  # type: ignore[arg-type]
    loose = pincal.calibrate(mechanism, data, priors={"L": 1e300}, **options)  # type: ignore[arg-type]
    assert tight.leg("leg_1").parameters[1].identified == pytest.approx(1.5, abs=1e-9)
    for one, two in zip(free.legs, loose.legs, strict=True):
        np.testing.assert_allclose(one.identified, two.identified, atol=1e-9)
    sigma = free.legs[0].std[1]
    both = pincal.calibrate(mechanism, data, priors={"leg_1.L": sigma}, **options)  # type: ignore[arg-type]
    assert both.legs[0].std[1] == pytest.approx(sigma / np.sqrt(2), rel=0.01)
    tightest = pincal.calibrate(mechanism, data, priors={"k": 1e-9}, **options)  # type: ignore[arg-type]
    assert tightest.converged
    middle = (free.legs[0].identified[1] + 1.5) / 2
    assert both.legs[0].identified[1] == pytest.approx(middle, abs=0.05 * sigma)


def test_priors_determine_what_measurements_do_not() -> None:
    """At one orientation azimuth and radius of the platform point are lost; a prior gives them."""
    mechanism = pincal.load_mechanism("3RRR")
    poses = np.zeros((40, 3))
    poses[:, :2] = np.random.default_rng(0).uniform(-0.3, 0.3, (40, 2))
    data = pincal.simulate(mechanism, mechanism, pincal.Plan(poses), EXACT).measurements
    with pytest.raises(pincal.ObservabilityError, match="move together"):
        pincal.calibrate(mechanism, data, noise=NOISE, strict=True)
    result = pincal.calibrate(mechanism, data, noise=NOISE, priors={"ob": 1e-3, "beta_b": 1e-3})
    assert result.converged
    assert result.legs[0].std[4] == pytest.approx(1e-3, rel=1e-3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"fixed": ("m",)}, "no parameter 'm'; expected one of l, L, .* 'leg_1.l'"),
        ({"tied": ("leg_1.l",)}, "cannot be tied"),
        ({"tied": ("l",), "fixed": ("l",)}, "both fixed and tied"),
        ({"tied": ("gamma",)}, "nominal values differ from leg to leg"),
        ({"fixed": ("l", "L", "OA", "beta", "ob", "beta_b", "k", "gamma")}, "every parameter is"),
        ({"priors": {"l": 0.0}}, "expected a standard deviation above 0"),
        ({"loss": "none at all"}, "unknown loss"),
        ({"method": "best"}, "unknown method"),
        ({"priors": {"l": 1e-18}}, "the prior of 'l' is 1e-18; expected a standard deviation"),
    ],
)
def test_wrong_choices_are_named(options: dict, message: str) -> None:
    """Parameters, losses and methods that do not exist, or exclude each other."""
    mechanism, _, data = machine("3RRR", 20)
    with pytest.raises(pincal.MeasurementError, match=message):
        pincal.calibrate(mechanism, data, **options)


def test_the_probability_of_a_listed_row() -> None:
    """Of 20,000 good rows one in a thousand is listed, whatever its number of equations."""
    for k in (1, 4):
        squares = chi2.rvs(k, size=20_000, random_state=0)
        assert outlying(squares, np.full(20_000, k)).mean() == pytest.approx(1e-3, rel=0.5)


@pytest.mark.parametrize("method", METHODS)
def test_one_wrong_row_is_the_verdict(method: str) -> None:
    """One coordinate of 72 rows 3 mm off at 20 µm: that row is named, and nothing else blamed."""
    noise = pincal.Noise(2e-5, 2e-5, 1e-5)
    mechanism, _, data = machine("3RRR", 72, noise=noise)
    poses = data.poses.copy()
    poses[7, 0] += 3e-3
    bad = replace(data, poses=poses)
    options = {"method": method, "poses": "all", "noise": noise}
    result = pincal.calibrate(mechanism, bad, **options)  # type: ignore[arg-type]
    first, *others = result.findings
    assert (first.code, first.rows) == ("wrong-rows", (7,))
    assert not {one.code for one in others} & {"chi2-too-large", "outliers", "many-outliers"}
    assert {one.row for one in result.outliers} == {7}
    assert not result.promises
    assert any("data row 8 does not fit the others" in text for text in result.warnings)
    kept = np.arange(72) != 7
    left = pincal.calibrate(mechanism, data.rows(kept), **options)  # type: ignore[arg-type]
    assert first.values["without"] == pytest.approx(left.reduced_chi2, rel=0.05)


def test_a_model_that_lacks_something_is_not_laid_on_rows() -> None:
    """Readings that are eccentric in every row: χ², no wrong rows."""
    noise = pincal.Noise(2e-5, 2e-5, 1e-5)
    mechanism, _, data = machine("3RRR", 72, noise=noise)
    readings = data.readings + 2e-3 * np.sin(2.0 * data.readings)
    result = pincal.calibrate(mechanism, replace(data, readings=readings), noise=noise)
    codes = {one.code for one in result.findings}
    assert "chi2-too-large" in codes
    assert "wrong-rows" not in codes


@pytest.mark.slow
def test_good_rows_are_judged_at_the_noise_in_question() -> None:
    """Rejection with noise not given on sound data of which the first guess is far off."""
    one = cramer_rao.machine("3RRR", 60)
    result = pincal.calibrate(one.nominal, drawn(one, cramer_rao.NOISE, 1), loss="reject")
    assert result.noise
    assert result.noise.position == pytest.approx(1e-4, rel=0.4)
    assert not result.outliers


@pytest.mark.slow
def test_few_rejected_rows_contradict_nothing() -> None:
    """Three of sixty rows 30 σ off: χ² and tests are of the rows that fit."""
    one, data = cramer_rao.machine("5R", 60), []
    for seed in range(8):
        clean = drawn(one, cramer_rao.NOISE, seed)
        data.append(put(clean, "poses", [5, 25, 45], clean.poses[[5, 25, 45]] + 3e-3))
    found = [
        pincal.calibrate(one.nominal, each, noise=cramer_rao.NOISE, loss="reject") for each in data
    ]
    assert all({5, 25, 45} <= {out.row for out in each.outliers} for each in found)
    assert sum(not each.promises for each in found) <= 1


@pytest.mark.slow
def test_groups_of_noise_that_differ_cost_degrees_of_freedom() -> None:
    """Readings about as noisy as positions are a group of their own: fewer freedoms than of χ²."""
    one, readings, freedoms = cramer_rao.machine("3RRR", 60), [], []
    for seed in range(8):
        result = pincal.calibrate(one.nominal, drawn(one, pincal.Noise(1e-4, 2e-5, 1e-4), seed))
        assert result.noise
        assert result.noise_freedoms
        readings.append(result.noise.reading)
        freedoms.append(result.noise_freedoms / result.degrees_of_freedom)
    assert np.median(readings) == pytest.approx(1e-4, rel=0.2)
    assert np.median(freedoms) < 0.5
    assert max(freedoms) < 0.8


@pytest.mark.slow
def test_rejection_is_as_good_as_knowing_the_gross_errors() -> None:
    """100 sets of the 5R, a fifth of the rows off by 30 σ: errors and coverage of the others' fit.

    Errors are over their standard errors. A gross error that happens to be small stays in the fit.
    """
    one, squares, covered = cramer_rao.machine("5R", 60), [], []
    for seed in range(100):
        rng, data = np.random.default_rng(seed + 10**6), drawn(one, cramer_rao.NOISE, seed)
        wrong = rng.permutation(len(data))[: len(data) // 5]
        moved = 3e-3 * rng.standard_normal((len(wrong), 2))
        sound = data.rows(np.setdiff1d(np.arange(len(data)), wrong))
        data = put(data, "poses", wrong, data.poses[wrong] + moved)
        rejecting = pincal.calibrate(one.nominal, data, noise=cramer_rao.NOISE, loss="reject")
        for result in (rejecting, pincal.calibrate(one.nominal, sound, noise=cramer_rao.NOISE)):
            value, std, low, high = cramer_rao.values_of(result)
            squares.append((((value - one.parameters) / std) ** 2).mean())
            covered.append(((low <= one.parameters) & (one.parameters <= high)).mean())
    error, least = np.sqrt(np.mean(np.reshape(squares, (-1, 2)), axis=0))
    assert error == pytest.approx(least, rel=0.05)
    of_rejecting, of_sound = np.mean(np.reshape(covered, (-1, 2)), axis=0)
    assert of_rejecting == pytest.approx(of_sound, abs=0.01)


@pytest.mark.parametrize("seed", range(3))
def test_rows_to_verify_with_are_no_outliers(seed: int) -> None:
    """Rows that no fit follows are judged by validation: none is called one that does not fit."""
    noise = pincal.Noise(2e-5, 5e-5, 5e-6)
    mechanism, _, data = machine("3RRR", 36, noise=noise, seed=seed)
    sets = tuple("verify" if row % 5 == 2 else "all" for row in range(36))
    result = pincal.calibrate(mechanism, replace(data, sets=sets), noise=noise)
    assert not result.outliers
    assert result.promises
    moved = mechanism.platform.twists_between(data.poses, result.poses)
    assert np.abs(moved / [2e-5, 2e-5, 5e-5]).max() < 5.0  # of the identified machine, not as drawn


def test_wrong_rows_hide_nothing_that_is_found_without_them() -> None:
    """A drift beside two gross rows: both are said, and no sound row is named."""
    noise = pincal.Noise(2e-5, 2e-5, 1e-5)
    mechanism, _, data = machine("3RRR", 60, noise=noise)
    poses = data.poses.copy()
    poses[[11, 32], 0] += 3e-3
    readings = data.readings + np.linspace(-1e-4, 1e-4, 60)[:, None]
    bad = replace(data, poses=poses, readings=readings)
    result = pincal.calibrate(mechanism, bad, noise=noise)
    codes = [one.code for one in result.findings]
    named = {row for one in result.findings if one.code == "wrong-rows" for row in one.rows}
    assert named <= {11, 32}
    assert set(codes) & {"model-lacks", "step", "chi2-too-large"}


SLIPS = [
    ("3RRR", "readings", 2, True, False),
    ("3RRR", "poses", 1, False, True),
    ("delta", "poses", 0, False, False),
]


@pytest.mark.parametrize(
    ("kind", "field", "column", "full", "target"),
    slow_or_fuzz(SLIPS, [("6UPS", "readings", 4, False, True), ("6UPS", "poses", 0, True, True)]),
)
def test_one_slip_of_the_decimal_in_an_unknown_frame_is_named(
    kind: str, field: str, column: int, full: bool, target: bool
) -> None:
    """Ten times too large: the row is rejected, or the verdict of a fit of all rows."""
    mechanism, _, data = machine(kind, 40)
    offset = (0.03, -0.02, 0.0 if kind == "3RRR" else 0.05) if target else (0.0, 0.0, 0.0)
    data = seen_from_elsewhere(mechanism, data, offset)
    if not full:
        turned = slice(mechanism.platform.lengths, None)
        data = put(data, "poses", (slice(None), turned), np.nan)
    setup = pincal.Setup(unknown_frame=True, targets={"platform": pincal.Target(unknown=target)})
    wrong = put(data, field, (30, column), 10.0 * getattr(data, field)[30, column])
    result = pincal.calibrate(mechanism, wrong, setup=setup, loss="reject", noise=NOISE)
    assert result.converged
    assert [one.row for one in result.outliers] == [30]
    judged = pincal.calibrate(mechanism, wrong, setup=setup, noise=NOISE)
    assert judged.findings[0].code == "wrong-rows"
    assert judged.findings[0].rows == (30,)
