"""Promises are withdrawn where the model is contradicted; false alarms are as rare as stated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from cramer_rao import Machine, drawn, machine, off, values_of
from marks import quick, slow_or_fuzz, some_slow
from measured import validated
from numpy.typing import NDArray
from resized import scaled
from scipy.spatial.transform import Rotation
from scipy.stats import kstest

import pincal
from pincal.estimation.system import suspected

Array = NDArray[np.float64]
NOISE = pincal.Noise(2e-5, 5e-5, 2e-5)


def test_what_is_promised_does_not_depend_on_which_row_comes_first() -> None:
    """A second target that is not seen in the first rows counts as much as one in the last rows."""
    mechanism, offset = pincal.load_mechanism("6UPS"), np.array((0.2, 0.0, 0.1))
    targets = {"platform": pincal.Target(), "ball": pincal.Target(tuple(offset))}
    setup = pincal.Setup(unknown_frame=True, targets=targets)
    plan = pincal.Plan(pincal.sample_workspace("6UPS", 24, seed=0))
    truth = pincal.disturb(mechanism, 1e-3, seed=1)
    data = pincal.simulate(mechanism, truth, plan, NOISE, seed=1).measurements
    T = mechanism.platform.matrices(data.poses)
    ball = T[:, :3, 3] + T[:, :3, :3] @ offset
    ball[:3] = np.nan
    seen = {f"ball_{axis}": column for axis, column in zip("xyz", ball.T, strict=True)}
    data = replace(data, poses=np.where(np.arange(6) < 3, data.poses, np.nan), extra=seen)
    rows = (data, data.rows(np.roll(np.arange(24), -3)))
    limits = [
        pincal.calibrate(mechanism, part, noise=NOISE, setup=setup).expected_error(plan).limit[0]
        for part in rows
    ]
    assert limits[0] == pytest.approx(limits[1], rel=1e-6)


def waves(one: Machine) -> Array:
    """Return an eccentric disc's error of the readings."""
    psi = one.readings(one.parameters, np.zeros((len(one.positions), one.dof)))
    return np.asarray(3e-4 * np.sin(3.0 * psi))


def drift(one: Machine) -> Array:
    """Return readings that drift over the rows."""
    return np.linspace(-3e-4, 3e-4, len(one.positions))[:, None] * np.ones((1, 3))


def slip(one: Machine) -> Array:
    """Return an encoder of leg 2 that slips halfway."""
    found = np.zeros((len(one.positions), 3))
    found[len(found) // 2 :, 1] = 5e-4
    return found


def growth(one: Machine) -> Array:
    """Return readings of a machine whose lengths grow by 0.05 % over the rows."""
    still = np.zeros((len(one.positions), one.dof))
    longer = np.array([p.unit == "m" for p in one.nominal.parameters]) * 5e-4
    more = one.readings(one.parameters * (1.0 + longer), still)
    time = np.linspace(-0.5, 0.5, len(still))[:, None]
    return time * (more - one.readings(one.parameters, still))


FAULTS = (waves, drift, slip, growth)


@pytest.mark.parametrize(
    ("fault", "noise"), some_slow(product(FAULTS, [NOISE, None]), *product(FAULTS, [None]))
)
def test_no_limit_is_promised_where_the_model_lacks_something(
    fault: Callable[[Machine], Array], noise: pincal.Noise | None
) -> None:
    """Expected error, result and JSON agree, and no error is below what was seen."""
    one = machine("3RRR", 60)
    result = pincal.calibrate(one.nominal, drawn(one, NOISE, 0, fault(one)), noise=noise)
    assert result.contradictions
    assert not result.promises
    expected = result.expected_error()
    assert np.isinf(expected.limit).all()
    assert expected.position >= 0.99 * result.misses[0]
    if fault is slip:
        (found,) = (one for one in result.contradictions if one.code == "step")
        assert (found.values["what"], found.values["name"]) == ("reading", "leg_2")
        assert abs(found.rows[0] - len(result.measurements) // 2) <= 2
        assert found.values["size"] == pytest.approx(5e-4, rel=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("noise", some_slow([None, NOISE], None))
def test_what_residuals_cannot_show_is_promised_with(noise: pincal.Noise | None) -> None:
    """Clearance of ± 0.1 mrad, hidden in noise of 20 µm: limits hold at 100 other poses.

    By closed forms, the clearance with it. Limits of the parameters alone are broken.
    """

    def clearance(one: Machine) -> Array:
        still = np.zeros((len(one.positions), one.dof))
        return 1e-4 * np.sign(np.sin(2.0 * one.readings(one.parameters, still)))

    one, platform = machine("3RRR", 60), pincal.load_mechanism("3RRR").platform
    poses, promised = pincal.sample_workspace(one.nominal, 100, 7), 0
    for seed in range(6):
        data = drawn(one, NOISE, seed, clearance(one))
        result = pincal.calibrate(one.nominal, data, noise=noise)
        inside = poses[result.expected_error(poses).within]
        matrices = platform.matrices(inside)
        turns = Rotation.from_matrix(matrices[:, :3, :3])
        there = replace(one, positions=matrices[:, :2, 3], rotations=turns)
        missed = np.sqrt((off(there, values_of(result)[0], clearance(there)) ** 2).mean())
        limit = result.expected_error(inside).limit[0]
        promised += np.isfinite(limit)
        assert missed < limit
    assert promised >= 3


@pytest.mark.slow
@pytest.mark.parametrize("noise", some_slow([None, NOISE], None))
def test_unpromised_errors_are_those_of_rows_not_seen(noise: pincal.Noise | None) -> None:
    """Eccentric drives, 20 poses: as far as 20 fits miss the row that each has not seen."""
    one = machine("3RRR", 20)
    result = pincal.calibrate(one.nominal, drawn(one, NOISE, 0, 3.0 * waves(one)), noise=noise)
    assert not result.promises
    of_fits = result.validated(folds=20, by="turn").validation
    assert of_fits is not None
    columns = ((of_fits.position, NOISE.position, 2), (of_fits.orientation, NOISE.orientation, 1))
    for missed, column in zip(result.misses, columns, strict=True):
        (_, verification), sigma, axes = column
        known = 0.0 if noise is None else axes * sigma**2
        assert missed == pytest.approx(np.sqrt(verification**2 - known), rel=0.05)
    assert result.expected_error().position == pytest.approx(result.misses[0])


@pytest.mark.slow
def test_sound_data_are_promised() -> None:
    """Nothing contradicts sound data, noise given or not: 20 data sets, one false alarm allowed."""
    one, alarms = machine("3RRR", 60), 0
    for seed in range(20):
        result = pincal.calibrate(
            one.nominal, drawn(one, NOISE, seed, 0.0), noise=NOISE if seed % 2 else None
        )
        alarms += not result.promises
        assert not result.promises or np.isfinite(result.expected_error().limit).all()
    assert alarms <= 1


def test_standard_errors_grow_with_residuals() -> None:
    """Noise said half as large as it is: standard errors are those of the truth, and so is JSON."""
    one = machine("3RRR", 60)
    data = drawn(one, NOISE, 0, 0.0)
    half = pincal.Noise(*(0.5 * value for value in vars(NOISE).values()))
    low, right = (pincal.calibrate(one.nominal, data, noise=noise) for noise in (half, NOISE))
    assert low.excess == pytest.approx(2.0 * np.sqrt(right.reduced_chi2), rel=1e-6)
    np.testing.assert_allclose(
        values_of(low)[1], np.sqrt(right.reduced_chi2) * values_of(right)[1], rtol=1e-3
    )
    assert not low.promises


def test_noise_in_another_proportion_is_seen() -> None:
    """(1, 1) said and (1.4, 0.4) true leaves χ² at one; the proportion is tested."""
    one = machine("3RRR", 60)
    said = pincal.Noise(1e-4, 1e-4, 0.0)
    data = drawn(one, pincal.Noise(1.4e-4, 0.4e-4, 0.0), 0, 0.0)
    result = pincal.calibrate(one.nominal, data, noise=said)
    codes = {one.code for one in result.contradictions}
    assert codes & {"noise-in-other-proportion", "chi2-too-large"}


def codes_of(one: Machine, noise: pincal.Noise, given: pincal.Noise, seed: int) -> set[str]:
    """Return the codes of what is found in data with noise, another being given."""
    result = pincal.calibrate(one.nominal, drawn(one, noise, seed), noise=given)
    contradicted = {"contradicted"} if result.contradictions else set[str]()
    return contradicted | {remark.code for remark in result.findings}


@pytest.mark.parametrize("kind", quick(2, ["5R", "3RRR", "6UPS"]))
def test_readings_called_exact_are_not_passed_over(kind: str) -> None:
    """Where ten poses do not contradict noise of the readings, they say so; more poses do test it.

    Nothing is said where the noise is given, or where 72 poses agree with exact readings.
    """
    ten, exact = machine(kind, 10), replace(NOISE, reading=0.0)
    for seed in range(6):
        assert codes_of(ten, NOISE, exact, seed) & {"contradicted", "readings-exact"}
        assert "readings-exact" not in codes_of(ten, NOISE, NOISE, seed)
    many = machine(kind, 72)
    assert codes_of(many, NOISE, exact, 0) & {"noise-in-other-proportion", "chi2-too-large"}
    assert not codes_of(many, exact, exact, 0) & {"readings-exact", "noise-in-other-proportion"}


def test_the_noise_named_for_exact_readings_widens_an_interval_by_a_quarter() -> None:
    """Noise that is named moves a parameter by 0.75 of its standard error, by differences."""
    one, exact, h = machine("5R", 10), replace(NOISE, reading=0.0), 1e-7
    data = drawn(one, exact, 0)

    def moved(more: Array) -> Array:
        shifted = replace(data, readings=data.readings + more)
        return values_of(pincal.calibrate(one.nominal, shifted, noise=exact))[0]

    steps = h * np.eye(data.readings.size).reshape(-1, *data.readings.shape)
    by_readings = np.array([(moved(step) - moved(-step)) / (2.0 * h) for step in steps])
    result = pincal.calibrate(one.nominal, data, noise=exact)
    (remark,) = (remark for remark in result.findings if remark.code == "readings-exact")
    added = remark.values["reading"] * np.linalg.norm(by_readings, axis=0) / values_of(result)[1]
    assert np.hypot(1.0, added.max()) == pytest.approx(1.25, rel=1e-3)


def test_noise_of_readings_called_exact_is_seen_in_thirty_rows() -> None:
    """A 5R's χ² may be that of its noise: the score of the readings is tested as well."""
    one, exact = machine("5R", 30), pincal.Noise(2e-5, 5e-5, 0.0)
    data = drawn(one, replace(exact, reading=2e-5), 0)
    (lack,) = pincal.calibrate(one.nominal, data, noise=exact).contradictions
    assert lack.code == "noise-in-other-proportion"
    assert lack.values["reading"] == pytest.approx(2e-5, rel=0.5)


@pytest.mark.parametrize("count", [100, 10_000])
def test_rows_are_suspected_together(count: int) -> None:
    """One set of good rows in a hundred has any that is suspected: 300 sets, to three errors."""
    rng = np.random.default_rng(0)
    squares = rng.chisquare(3, (300, count))
    equations = np.full(count, 3)
    share = np.mean([suspected(one, equations).any() for one in squares])
    assert share <= 0.01 + 3 * np.sqrt(0.01 / 300)
    squares[0, 7] = 60.0
    assert np.flatnonzero(suspected(squares[0], equations)).tolist() == [7]


@pytest.mark.parametrize("seed", [12, 15])
def test_what_all_motors_have_is_seen_in_all_of_them(seed: int) -> None:
    """Harmonics of 0.2 mrad that no reading shows alone (p above 0.0005) withdraw the promise."""
    one = machine("3RRR", 60)
    result = pincal.calibrate(
        one.nominal, drawn(one, NOISE, seed, waves(one) * 2.0 / 3.0), noise=NOISE
    )
    (found,) = (one for one in result.findings if one.code == "model-lacks")
    assert found.values["quantity"] == "readings"
    assert found.values["term"] == "angle"


@pytest.mark.parametrize("noise", slow_or_fuzz([None], [NOISE]))
def test_held_out_p_values_are_uniform(noise: pincal.Noise | None) -> None:
    """24 sound data sets: Kolmogorov–Smirnov above 0.01, noise estimated or given.

    Of fits to noise alone, in a line of algebra: tests/test_trust.py, 20,000 draws.
    """
    one = machine("3RRR", 60)
    p = [
        validated(one.nominal, drawn(one, NOISE, seed, 0.0), noise=noise, folds=2).p_value
        for seed in range(24)
    ]
    assert kstest(p, "uniform").pvalue > 0.01


def test_rows_to_verify_are_not_followed() -> None:
    """Rows of the set verify change nothing in the fit, and are what validation predicts.

    A wrong one that is the only one is named.
    """
    one = machine("3RRR", 60)
    data = drawn(one, NOISE, 0, 0.0)
    last = np.arange(len(data)) >= len(data) - 8
    marked = replace(data, sets=tuple("verify" if one else "all" for one in last))
    with_them = pincal.calibrate(one.nominal, marked, noise=NOISE)
    without = pincal.calibrate(one.nominal, data.rows(~last), noise=NOISE)
    assert with_them.degrees_of_freedom == without.degrees_of_freedom
    np.testing.assert_allclose(values_of(with_them)[0], values_of(without)[0], atol=1e-9)
    found = validated(one.nominal, marked, noise=NOISE)
    assert (found.folds, found.rows) == (1, 8)
    assert found.p_value > 1e-3
    moved = marked.readings.copy()
    moved[last] += 1e-3
    wrong = validated(one.nominal, replace(marked, readings=moved), noise=NOISE)
    assert wrong.findings
    only = replace(marked, readings=moved).rows(np.append(np.flatnonzero(~last), len(data) - 1))
    (alone,) = validated(one.nominal, only, noise=NOISE).findings
    assert (alone.code, alone.rows) == ("wrong-verification", (len(only) - 1,))
    assert alone.values["total"] == 1


def test_legs_alone_that_share_poses_have_fewer_freedoms() -> None:
    """A 6-UPS, each leg by all poses: χ² varies more than its degrees of freedom say."""
    one = machine("6UPS", 40)
    noise = pincal.Noise(1e-4, 1e-4, 5e-5)
    rng = np.random.default_rng(0)
    twists = 1e-4 * rng.standard_normal((len(one.positions), 6))
    readings = one.readings(one.parameters, 0.0 * twists)
    readings = readings + 5e-5 * rng.standard_normal(readings.shape)
    data = pincal.Measurements(poses=one.coordinates(twists), readings=readings)
    result = pincal.calibrate(one.nominal, data, noise=noise, method="per-leg", poses="all")
    assert 2.0 < result.degrees_of_freedom / result.chi2_freedoms < 6.0


@pytest.mark.parametrize("factor", [1e-3, 1e2])
def test_size_changes_nothing(factor: float) -> None:
    """A 3-RRR of another size, noise not given: the same findings, the same numbers in σ."""
    one = machine("3RRR", 40)
    nominal, _ = scaled(one.nominal, factor)
    by = np.array([factor if p.unit == "m" else 1.0 for p in one.nominal.parameters])
    other = replace(
        one, nominal=nominal, parameters=one.parameters * by, positions=one.positions * factor
    )
    results = []
    for at, size in ((one, 1.0), (other, factor)):
        noise = pincal.Noise(1e-4 * size, 1e-4, 0.0)
        results.append(pincal.calibrate(at.nominal, drawn(at, noise, 0, 0.0)))
    first, again = (values_of(result) for result in results)
    np.testing.assert_allclose(again[1] / by, first[1], rtol=1e-5)
    assert np.abs((again[0] / by - first[0]) / first[1]).max() < 1e-4
    assert [f.code for f in results[0].findings] == [f.code for f in results[1].findings]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["5R", "3RRR"])
def test_nothing_is_read_in_rounding_errors(name: str) -> None:
    """Of data without noise only that is said: no step, no eccentric disc, no outlier, no limit."""
    mechanism = pincal.load_mechanism(name)
    plan = pincal.sample_workspace(mechanism, 30, seed=1)
    exact = pincal.Noise(0.0, 0.0, 0.0)
    for seed in range(2):
        truth = pincal.disturb(mechanism, 1e-3, seed=seed)
        data = pincal.simulate(mechanism, truth, plan, exact).measurements
        result = pincal.calibrate(mechanism, data)
        assert [one.code for one in result.findings] == ["no-noise"]
        assert seed or result.validated(folds=2).findings == result.findings
        assert not result.promises
