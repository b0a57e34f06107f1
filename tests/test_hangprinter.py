"""A real cable robot whose poses were mostly not measured. Skipped where the data are absent.

The data (a public set of a Hangprinter) are looked for beside the project, or where
``PINCAL_DATA`` says.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from command_line import done

import pincal

DATA = Path(os.environ.get("PINCAL_DATA", Path(__file__).parents[2] / "shared" / "data"))
FILE = DATA / "hangprinter" / "measurements.csv"
pytestmark = pytest.mark.skipif(not FILE.is_file(), reason=f"no {FILE}")
HELD = pincal.Noise(0.0, 0.0, 1e-3)
#: A plausible start, and lengths of the lines at the origin, measured by hand [m].
START = {
    "line_A": (0.0, -1.6, -0.12),
    "line_B": (1.5, 0.9, -0.12),
    "line_C": (-1.3, 0.9, -0.12),
    "line_D": (0.0, 0.0, 2.35),
}
BY_HAND = [1.597, 1.795, 1.5825, 2.355]


@pytest.fixture(scope="module")
def mechanism() -> pincal.Mechanism:
    """The cable robot with the anchors of the plausible start."""
    robot = pincal.load_mechanism("4cable")
    anchors = {line: dict(zip(("A_x", "A_y", "A_z"), p, strict=True)) for line, p in START.items()}
    return robot.with_parameters(anchors)


@pytest.fixture(scope="module")
def data(mechanism: pincal.Mechanism) -> pincal.Measurements:
    """44 rows of four lengths, 9 of them with a position."""
    return pincal.Measurements.from_csv(FILE, mechanism, partial=True)


def rms(result: pincal.CalibrationResult) -> float:
    """Return the root mean square residual of all lengths, [m]."""
    residuals = np.concatenate([leg.residuals for leg in result.legs])
    assert len(residuals) == 176
    return float(np.sqrt((residuals**2).mean()))


def test_the_anchors_are_found(mechanism: pincal.Mechanism, data: pincal.Measurements) -> None:
    """Positions held: 0.623 mm over 176 lengths; anchors as measured by hand; gains below one.

    An independent fit found 0.623 mm and distances of 1582.1, 1790.5, 1595.4, 2352.2 mm.
    """
    result = pincal.calibrate(mechanism, data, noise=HELD)
    assert result.converged
    assert rms(result) <= 0.63e-3
    far = [np.linalg.norm(leg.identified[:3]) for leg in result.legs]
    np.testing.assert_allclose(far, [1.5821, 1.7905, 1.5954, 2.3522], atol=5e-4)
    assert np.abs(np.array(far) - BY_HAND).max() <= 15e-3
    gains = [leg.identified[3] for leg in result.legs]
    assert all(0.98 < gain < 0.995 for gain in gains)
    assert result.estimated_poses is not None
    assert np.isfinite(result.estimated_poses).all()
    np.testing.assert_allclose(result.estimated_poses[:9], data.poses[:9], atol=1e-5)
    assert result.observed[0].n_residuals == 9


def test_positions_with_noise(mechanism: pincal.Mechanism, data: pincal.Measurements) -> None:
    """Measured positions freed at 1 mm: 0.465 mm, as the independent fit found."""
    noise = pincal.Noise(1e-3, 0.0, 1e-3)
    result = pincal.calibrate(mechanism, data, noise=noise)
    assert rms(result) == pytest.approx(0.465e-3, abs=2e-6)


@pytest.mark.slow
def test_gains_are_needed(mechanism: pincal.Mechanism, data: pincal.Measurements) -> None:
    """Without them 1.80 mm is left, and χ² says that the model lacks something."""
    result = pincal.calibrate(mechanism, data, noise=HELD, fixed=("k",))
    assert rms(result) == pytest.approx(1.80e-3, abs=0.02e-3)
    assert any("χ²" in text for text in result.warnings)


@pytest.mark.slow
def test_rough_starts_reach_the_optimum(
    mechanism: pincal.Mechanism, data: pincal.Measurements
) -> None:
    """From 25 starts with every anchor coordinate up to 500 mm off, most reach 0.623 mm."""
    rng, reached = np.random.default_rng(0), 0
    for _ in range(25):
        start = mechanism.with_parameters(
            {
                leg.name: leg.nominal + np.r_[rng.uniform(-0.5, 0.5, 3), 0.0]
                for leg in mechanism.legs
            }
        )
        result = pincal.calibrate(start, data, noise=HELD, rough=True)
        reached += result.converged and rms(result) <= 0.63e-3
    assert reached >= 23


@pytest.mark.slow
def test_the_command_finds_the_poses(tmp_path: Path) -> None:
    """From the bundled robot and the file as it is: result, mechanism and all 44 poses."""
    noise = ("--noise-position", 1e-3, "--noise-reading", 1e-3)
    out = tmp_path / "result"
    done("calibrate", "--no-report", "4cable", FILE, *noise, "--rough", "-o", out)
    assert pincal.load_result(out).validation is not None
    found = pincal.load_mechanism(str(out))
    poses = pincal.Measurements.from_csv(FILE, found, partial=True)
    assert len(poses) == 44
    assert len(pincal.Plan.from_csv(out / "poses.csv", found).poses) == 44
