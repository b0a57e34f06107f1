"""A planar machine, seen by a tracker that is not level: such positions are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_line import run
from frames import frame_of
from measured import machine
from scipy.spatial.transform import Rotation

import pincal

NOISE = pincal.Noise(2e-5, 1e-4, 1e-5)
FREE = pincal.Setup(unknown_frame=True)


def seen(tilt: float, path: Path, kind: str = "3RRR") -> None:
    """Write positions of a planar machine as a tracker tilted by an angle [deg] sees them."""
    mechanism, _, data = machine(kind, 36, NOISE)
    R = Rotation.from_euler("ZXZ", [40, tilt, 15], degrees=True).as_matrix()
    flat = np.column_stack((data.poses[:, :2], np.zeros(len(data))))
    noise = NOISE.position * np.random.default_rng(0).standard_normal(flat.shape)
    frame = frame_of(data, mechanism)
    frame[["x [m]", "y [m]", "z [m]"]] = flat @ R.T + [1.5, -0.7, 0.3] + noise
    frame = frame.drop(columns="phi [rad]", errors="ignore")
    frame.to_csv(path, index=False)


@pytest.mark.parametrize("kind", ["3RRR", "5R"])
@pytest.mark.parametrize("setup", [FREE, None])
def test_a_tilted_plane_is_refused(kind: str, setup: pincal.Setup | None, tmp_path: Path) -> None:
    """Distances between x and y alone are up to 2 mm short, and no residual would show it."""
    seen(3.0, tmp_path / "m.csv", kind)
    with pytest.raises(pincal.MeasurementError, match=r"tilted by 3° to x-y .* Turn the positions"):
        pincal.Measurements.from_csv(tmp_path / "m.csv", kind, setup, partial=True)
    outcome = run("calibrate", "--no-report", kind, tmp_path / "m.csv", "-o", tmp_path / "r")
    assert outcome.code == 2
    assert not (tmp_path / "r").exists()


def test_what_is_level_is_read(tmp_path: Path) -> None:
    """A tilt that shortens less than the noise does not matter."""
    seen(0.0, tmp_path / "m.csv")
    _, _, data = machine("3RRR", 36, NOISE)
    read = pincal.Measurements.from_csv(tmp_path / "m.csv", "3RRR", FREE, partial=True)
    apart = [
        np.linalg.norm(poses[:, None, :2] - poses[:, :2], axis=2)
        for poses in (data.poses, read.poses)
    ]
    assert np.abs(apart[1] - apart[0]).max() < 8 * NOISE.position
