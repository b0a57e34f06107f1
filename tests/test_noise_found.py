"""Noise that was not given is found: what residuals at it show is the noise itself."""

from __future__ import annotations

import numpy as np
import pytest

import pincal
from pincal.calibration import fits


@pytest.mark.parametrize("seed", [0, 3, 14])
def test_noise_is_found_in_a_few_rounds(
    monkeypatch: pytest.MonkeyPatch, selections: dict[str, pincal.Selection], seed: int
) -> None:
    """The search for variances ends where they say themselves, and does not go round in a circle.

    Exact readings of these machines look slightly noisy; a guess of how much that is far too large
    says that they are exact.
    """
    rounds = []
    last = fits.estimated_noise

    def counted(moments: object, noise: pincal.Noise, *more: object) -> pincal.Noise:
        rounds.append((noise, last(moments, noise, *more)))
        return rounds[-1][1]

    monkeypatch.setattr(fits, "estimated_noise", counted)
    nominal = pincal.load_mechanism("3RRR")
    truth = pincal.disturb(nominal, 1e-3, seed=seed)
    noise = pincal.Noise(1e-4, 1e-4, 0.0)
    plan = selections["3RRR"].plan
    result = pincal.calibrate(
        nominal, pincal.simulate(truth, truth, plan, noise, seed).measurements
    )
    assert result.converged
    before, after = (list(vars(noise).values()) for noise in rounds[-1])
    np.testing.assert_allclose(after, before, rtol=fits.BY.alike)
    assert len(rounds) <= 20  # 31 to 100 in a circle
