"""Repeated rows: what they say about the noise, and what equal ones do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cramer_rao import Machine, machine, values_of

import pincal
from pincal.calibration.promise import exceeded

NOISE = pincal.Noise(1e-4, 1e-4, 0.0)


def repeated(rows: np.ndarray) -> tuple[Machine, tuple[str, ...]]:
    """Return a true 3-RRR at some rows of 30 poses, and the poses' names."""
    one = machine("3RRR", 30)
    at = replace(one, positions=one.positions[rows], rotations=one.rotations[rows])
    return at, tuple(f"p{row}" for row in rows)


def measured(one: Machine, noise: pincal.Noise, seed: int) -> pincal.Measurements:
    """Return measurements with noise."""
    rng = np.random.default_rng(seed)
    twists = noise.position * rng.standard_normal((len(one.positions), one.dof))
    return pincal.Measurements(
        poses=one.coordinates(twists), readings=one.readings(one.parameters, 0.0 * twists)
    )


def covered(result: pincal.CalibrationResult, truth: np.ndarray) -> float:
    """Return the share of true values in their intervals."""
    _, _, low, high = values_of(result)
    return float(((low <= truth) & (truth <= high)).mean())


def test_equal_readings_say_nothing_about_their_noise() -> None:
    """24 poses thrice, readings equal to the last digit: exact, no row is suspected."""
    one, places = repeated(np.repeat(np.arange(24), 3))
    for seed in range(5):
        data = replace(measured(one, NOISE, seed), places=places)
        result = pincal.calibrate(one.nominal, data)
        assert result.noise is not None
        assert result.noise_source == "repeats"
        assert result.noise.reading == 0.0
        assert 0.01 < result.chi2_p_value < 0.99
        assert result.noise_freedoms is not None
        assert 40 <= result.noise_freedoms <= 200


@pytest.mark.slow
def test_few_repeats_leave_the_noise_to_the_residuals() -> None:
    """5 of 30 poses twice: coverage within three of its standard errors, 40 data sets."""
    one, places = repeated(
        np.concatenate((np.arange(len(machine("3RRR", 30).positions)), range(5)))
    )
    found = []
    for seed in range(40):
        data = replace(measured(one, NOISE, seed), places=places)
        result = pincal.calibrate(one.nominal, data)
        assert result.noise_source == "estimated"
        found.append(covered(result, one.parameters))
    assert np.mean(found) == pytest.approx(0.95, abs=3 * np.std(found) / np.sqrt(40) + 0.005)


def test_repeats_equal_at_the_resolution_count_once() -> None:
    """Poses rounded so that repeats are equal: the result is that of one of each."""
    one, places = repeated(np.repeat(np.arange(24), 3))
    fine = measured(one, pincal.Noise(1e-6, 1e-6, 0.0), 0)
    data = replace(fine, poses=np.round(fine.poses, 3), places=places)
    firsts = np.sort(
        np.unique(np.column_stack([data.poses, data.readings]), axis=0, return_index=True)[1]
    )
    result = pincal.calibrate(one.nominal, data)
    alone = pincal.calibrate(one.nominal, data.rows(firsts))
    assert result.degrees_of_freedom == alone.degrees_of_freedom
    np.testing.assert_allclose(values_of(result)[1], values_of(alone)[1], rtol=1e-3)
    unnamed = pincal.calibrate(one.nominal, replace(data, places=None))
    assert "data rows 1 and 2 are identical (and 47 more" in unnamed.warnings[0]
    assert unnamed.degrees_of_freedom == alone.degrees_of_freedom


def test_noise_of_few_degrees_of_freedom_widens_its_tests() -> None:
    """F is never more certain than χ², and is χ² where the noise is known."""
    assert exceeded(1.5, 60, 10.0) > exceeded(1.5, 60, 100.0) > exceeded(1.5, 60)
    assert exceeded(1.5, 60, 1e9) == pytest.approx(exceeded(1.5, 60), rel=1e-4)
