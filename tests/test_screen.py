"""What a screen of terms sees does not depend on whether the machine is fitted with the term."""

from __future__ import annotations

import importlib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
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

    every = every_pair(mechanism, rows)
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
