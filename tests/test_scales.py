"""Noise that was assumed equal and is not: told, with scales that are those of the measurements."""

from __future__ import annotations

import re

import numpy as np
import pytest
from measured import machine
from pincal.identification.latent import LatentLinear
from pincal.identification.scales import redundancies

import pincal


def warned(noise: pincal.Noise, seed: int) -> list[str]:
    """Return what a latent fit of a 3-RRR says about unequal noise, none given."""
    mechanism, _, data = machine("3RRR", 60, noise, seed)
    result = pincal.calibrate(mechanism, data)
    return [text for text in result.warnings if "equal noise was assumed" in text]


@pytest.mark.parametrize("noise", [pincal.Noise(2e-5, 5e-5), pincal.Noise(3e-4, 1e-4)])
def test_unequal_noise_is_told_with_its_scales(noise: pincal.Noise) -> None:
    """What is advised to give is what the measurements were made with, within 15 %."""
    found = []
    for seed in range(3):
        (text,) = warned(noise, seed)
        match = re.search(r"--noise-position (\S+) --noise-orientation (\S+) fit", text)
        assert match
        found.append([float(value) for value in match.groups()])
    scales = np.array(found) / [noise.position, noise.orientation]
    np.testing.assert_allclose(scales.mean(axis=0), 1.0, atol=0.15)


def test_equal_noise_is_not_doubted() -> None:
    """Of six sets of measurements with equal noise nothing is said."""
    assert not any(warned(pincal.Noise(1e-4, 1e-4), seed) for seed in range(6))


def test_redundancies_are_those_of_the_whole_hat_matrix() -> None:
    """Poses and unknowns together: 1 less the diagonal of A (AᵀA)⁻¹ Aᵀ, built in full."""
    rng = np.random.default_rng(0)
    rows, dof, n = (5, 6), 3, 4
    B, A = rng.standard_normal((*rows, dof)), rng.standard_normal((*rows, n))
    T = rng.standard_normal((n, 3))
    full = np.zeros((30, 5 * dof + 3))
    for pose in range(5):
        full[6 * pose : 6 * pose + 6, dof * pose : dof * pose + dof] = B[pose]
    full[:, 5 * dof :] = (A @ T).reshape(30, 3)
    expected = 1.0 - np.diag(full @ np.linalg.pinv(full))
    linear = LatentLinear.__new__(LatentLinear)
    object.__setattr__(linear, "rows", type("Rows", (), {"pose": B, "parameter": A}))
    np.testing.assert_allclose(redundancies(linear, T).ravel(), expected, atol=1e-12)
