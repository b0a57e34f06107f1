"""What a screen of terms sees does not depend on whether the machine is fitted with the term."""

from __future__ import annotations

import importlib
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import done
from measured import workspace
from scipy.stats import norm

import pincal
from pincal.calibration.calibrate import prepared, started
from pincal.calibration.fits import Fits, fitted
from pincal.calibration.terms.candidates import with_terms
from pincal.calibration.terms.kinds import Kind, every_pair
from pincal.calibration.terms.screen import Candidate, inseparable, screen, screened, trials
from pincal.kinematics.batches import over_rows

NOISE = pincal.Noise(2e-5, 2e-5, 2e-5)
TRUE = ("leg_1", Kind.of("temperature"))
AMPLITUDE = 5e-5
SIZES = (6e-5, 7.5e-5)  # as clear as each other


@pytest.fixture
def benchmark_of_terms(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return the benchmark of the screen, whose directory is on no path."""
    monkeypatch.syspath_prepend("benchmarks")
    return importlib.import_module("terms")


def test_a_term_adds_its_white_rows_to_residuals() -> None:
    """What is said of residuals plus rows is said of a machine that is measured with the term."""
    mechanism = pincal.load_mechanism("5R")
    draw = np.random.default_rng(3)
    poses = pincal.sample_workspace(mechanism, 40, seed=3)
    influences = {"temperature": draw.uniform(15.0, 30.0, len(poses))}
    plain = pincal.disturb(mechanism, 1e-3, seed=3)
    rows = pincal.Measurements(
        poses=poses, readings=pincal.inverse(mechanism, poses).readings, influences=influences
    )
    warm, ids = with_terms(plain, rows, [TRUE])

    def fit_of(truth: pincal.Mechanism) -> Fits:
        plan = pincal.Plan(poses, influences=influences)
        data = pincal.simulate(mechanism, truth, plan, NOISE, seed=3).measurements
        return fitted(started(prepared(mechanism, data, noise=NOISE)))

    every = [pair for pair in every_pair(mechanism, rows) if pair[1].name != "period"]  # searched
    found = screen(fit_of(warm.with_parameters({ids[TRUE][0]: AMPLITUDE})), every)
    ((residuals, terms),) = trials(fit_of(plain), every)
    rows_of_term = next(one.rows for one in terms if (one.reading, one.kind) == TRUE)
    more = rows_of_term - residuals.Q @ over_rows(residuals.Q, rows_of_term)
    left = residuals.left - AMPLITUDE * more[:, :, 0]  # residuals: predicted less read
    moved = replace(residuals, left=left, chi2=float((left**2).sum()))
    by_place = {(one.reading, one.kind): one for one in screened([(moved, terms)])}
    for one in found:
        expected = by_place[one.reading, one.kind].F
        np.testing.assert_allclose(one.F, expected, rtol=1e-3, atol=1e-3)


def test_equal_terms_of_two_legs_are_told_apart() -> None:
    """They take off as much, but what one leaves, the other takes off."""
    mechanism = pincal.load_mechanism("3RRR")
    draw = np.random.default_rng(5)
    poses = pincal.sample_workspace(mechanism, 60, seed=5)
    rows = pincal.Measurements(
        poses=poses,
        readings=pincal.inverse(mechanism, poses).readings,
        influences={"temperature": draw.uniform(15.0, 30.0, len(poses))},
    )
    both = [(leg, Kind.of("temperature")) for leg in ("leg_1", "leg_2")]
    warm, ids = with_terms(pincal.disturb(mechanism, 1e-3, seed=5), rows, both)
    plan = pincal.Plan(poses, influences=rows.influences)

    truth = warm.with_parameters({ids[one][0]: size for one, size in zip(both, SIZES, strict=True)})
    data = pincal.simulate(mechanism, truth, plan, NOISE, seed=5).measurements
    found = fitted(started(prepared(mechanism, data, noise=NOISE)))
    first, second = (one for one in screen(found, every_pair(mechanism, data)) if one.pair in both)
    assert inseparable(first, [second], found.fits[0].chi2) == [second]
    assert second.corrected < 1e-6
    assert second.pair not in first.or_else


@pytest.mark.parametrize("size", [1.0, 3.0])
def test_the_judge_is_as_good_as_two_orthogonal_terms_allow(
    benchmark_of_terms: Any, size: float
) -> None:
    """Of one term it is always right, of two with |s + z1| > |z2|: Φ(s/√2)² + Φ(-s/√2)²."""
    z = np.random.default_rng(0).standard_normal((100_000, 2)) + np.array([size, 0.0])
    right = benchmark_of_terms.likelihoods(z**2, np.array([1, 1]), size).argmax(axis=1) == 0
    expected = norm.cdf(size / np.sqrt(2.0)) ** 2 + norm.cdf(-size / np.sqrt(2.0)) ** 2
    spread = np.sqrt(expected * (1.0 - expected) / len(z))
    assert abs(right.mean() - expected) < 4.0 * spread


@pytest.mark.parametrize("rank", [1, 2, 5])
def test_the_judge_weighs_ranks_as_noise_does(benchmark_of_terms: Any, rank: int) -> None:
    """The mean of likelihood over noise is one, whatever the number of amplitudes."""
    size = 1.0
    noise = np.random.default_rng(0).chisquare(rank, 100_000)
    odds = benchmark_of_terms.likelihoods(noise, np.full(len(noise), rank), size)
    odds = odds * np.exp(-(size**2) / 2.0)
    assert abs(odds.mean() - 1.0) < 4.0 * odds.std() / np.sqrt(len(odds))


def test_what_takes_off_as_much_is_named_with_the_first() -> None:
    """Of its kind elsewhere, or another curve of the same reading; amplitudes cost two each."""
    chi2 = 200.0

    def one(reading: str, kind: str, inside: float, rank: int = 2) -> Candidate:
        none = np.zeros(rank)
        answer = (none, none, 1.0, rank, inside, 0.0)
        return Candidate(*answer, reading, Kind.of(kind), "rad", (), inside / chi2)

    first = one("leg_1", "polynomial", 60.0)
    near = [one("leg_2", "polynomial", 52.0), one("leg_1", "harmonics", 56.0, rank=4)]
    far = [
        one("leg_2", "polynomial", 50.0),
        one("leg_2", "harmonics", 59.0),
        one("leg_1", "backlash", 59.0),
        one("leg_1", "harmonics", 54.0, rank=4),
        one("leg_1", "harmonics:3", 0.0, rank=0),
    ]
    assert inseparable(first, [*far, *near], chi2) == near


def waved(
    name: str, seed: int, size: float, period: float, read: np.ndarray | None = None
) -> pincal.Measurements:
    """Return measurements of a machine whose second reading is off by a sine of itself.

    Readings are these, shape (N, n_readings), but for the noise; those of 60 poses if not given.
    """
    mechanism, draw = pincal.load_mechanism(name), np.random.default_rng(seed)
    if read is None:
        poses = workspace(name, 100)[draw.permutation(100)[:60]]
        read = pincal.inverse(mechanism, poses).readings
    off = size * np.sin(2.0 * np.pi * (read[:, 1] / period + draw.uniform()))
    off = np.stack([0.0 * off, off, 0.0 * off], axis=1)
    poses = pincal.forward(mechanism, read + off).poses
    truth = pincal.disturb(mechanism, 1e-3, seed=seed)
    data = pincal.simulate(mechanism, truth, poses, NOISE, seed=seed).measurements
    return replace(data, readings=data.readings - off)


def test_a_screws_pitch_is_found_with_its_uncertainty() -> None:
    """What is first has amplitude and period of the sine that was added, by standard errors.

    The period's is that of a frequency (D. C. Rife, R. Boorstyn 1974), but for what parameters and
    poses take up: not less, and not twice.
    """
    pitch, size, data = 5e-3, 1e-4, waved("linear_delta", 1, 1e-4, 5e-3)
    mechanism = pincal.load_mechanism("linear_delta")
    fits = fitted(started(prepared(mechanism, data, noise=NOISE)))
    first = screen(fits, every_pair(mechanism, data))[0]
    assert (first.reading, first.kind.name) == ("leg_2", "period")
    assert abs(first.kind.numbers[0] - pitch) < 4.0 * first.spread
    amplitude, std = float(np.hypot(*first.values)), float(first.std.max())
    assert abs(amplitude - size) < 4.0 * std < 0.5 * size
    travel = data.readings[:, 1].std()  # of a frequency: σ √2 / (A 2π √N std x)
    bound = pitch**2 * NOISE.reading * np.sqrt(2.0 / len(data)) / (size * 2.0 * np.pi * travel)
    assert bound < first.spread < 2.0 * bound


@pytest.mark.slow
def test_the_term_of_a_screws_pitch_pays_and_is_kept(tmp_path: Path) -> None:
    """Explain's command calibrates with the term; the machine saved reaches what was measured."""
    data = waved("linear_delta", 1, 1e-4, 5e-3)
    data.to_csv(tmp_path / "d.csv", pincal.load_mechanism("linear_delta"))
    noise = ["--noise-position", "20um", "--noise-reading", "20um"]
    out = done("explain", "linear_delta", tmp_path / "d.csv", *noise, "--folds", 2).out
    assert "leg_2 follows period:" in out
    assert "the pitch of a screw" in out
    words = shlex.split(next(line for line in out.splitlines() if "pincal calibrate" in line))
    done(*words[1:-1], tmp_path / "r", "--no-report", "--folds", 0)
    saved, held_out = (
        pincal.load_mechanism(tmp_path / "r"),
        waved("linear_delta", 1, 1e-4, 5e-3),
    )
    reached = pincal.forward(saved, held_out.readings, held_out.poses).poses
    without = pincal.forward(saved.without_terms, held_out.readings, held_out.poses).poses
    off, off_without = (np.std(poses - held_out.poses) for poses in (reached, without))
    assert off < 0.7 * off_without


def test_periods_that_rows_cannot_separate_are_said() -> None:
    """Where a reading is a multiple of 3 mm, 5 mm and 7.5 mm are one: 1/5 + 1/7.5 = 1/3."""
    mechanism, draw = pincal.load_mechanism("linear_delta"), np.random.default_rng(0)
    home = pincal.inverse(mechanism, np.array([mechanism.platform.home])).readings
    readings = np.round(home / 3e-3 + draw.uniform(-30.0, 30.0, (60, 3))) * 3e-3
    data = waved("linear_delta", 0, 1e-4, 5e-3, readings)
    fits = fitted(started(prepared(mechanism, data, noise=NOISE)))
    first = screen(fits, [("leg_2", Kind.of("period"))])[0]
    periods = np.array([kind.numbers[0] for _, kind in (first.pair, *first.or_else)])
    for alias in (5e-3, 7.5e-3):
        assert np.abs(periods / alias - 1.0).min() < 1e-2


@pytest.mark.slow
@pytest.mark.parametrize(("name", "period"), [("linear_delta", 5e-3), ("3RRR", 2.0 * np.pi / 50.0)])
def test_periods_are_named_where_they_are_and_nowhere_else(name: str, period: float) -> None:
    """Of a screw, and of a gear 1 : 50: five standard deviations of the noise are seen always."""
    mechanism = pincal.load_mechanism(name)

    def first(size: float, seed: int) -> Candidate:
        data = waved(name, seed, size, period)
        fits = fitted(started(prepared(mechanism, data, noise=NOISE)))
        return screen(fits, every_pair(mechanism, data))[0]

    for seed in range(2):
        named = first(5.0 * NOISE.reading, seed)
        assert (named.reading, named.kind.name) == ("leg_2", "period")
        assert abs(named.kind.numbers[0] - period) < 4.0 * named.spread < 0.1 * period
        assert first(0.0, seed).corrected > 0.01
