"""A planar machine, seen by a tracker that is not level: positions are turned into their plane."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import done, run
from frames import frame_of
from measured import machine
from scipy.spatial.transform import Rotation

import pincal

NOISE = pincal.Noise(2e-5, 1e-4, 1e-5)
FREE = pincal.Setup(unknown_frame=True)


def seen(tilt: float, path: Path, kind: str = "3RRR", **columns: Any) -> pincal.Mechanism:
    """Write positions of a planar machine as a tracker tilted by an angle [deg] sees them."""
    mechanism, truth, data = machine(kind, 36, NOISE)
    R = Rotation.from_euler("ZXZ", [40, tilt, 15], degrees=True).as_matrix()
    flat = np.column_stack((data.poses[:, :2], np.zeros(len(data))))
    noise = NOISE.position * np.random.default_rng(0).standard_normal(flat.shape)
    frame = frame_of(data, mechanism)
    frame[["x [m]", "y [m]", "z [m]"]] = flat @ R.T + [1.5, -0.7, 0.3] + noise
    frame = frame.drop(columns="phi [rad]", errors="ignore").assign(**columns)
    frame.to_csv(path, index=False)
    return truth


@pytest.mark.parametrize("kind", ["3RRR", "5R"])
def test_a_tilted_plane_is_turned_flat(kind: str, tmp_path: Path) -> None:
    """Distances between positions are those of the machine; without z they are up to 2 mm short."""
    seen(3.0, tmp_path / "m.csv", kind)
    _, _, data = machine(kind, 36, NOISE)
    found = pincal.Measurements.from_csv(tmp_path / "m.csv", kind, FREE, partial=True)
    apart = [np.linalg.norm(one[:, None] - one, axis=2) for one in
             (data.poses[:, :2], found.poses[:, :2])]  # fmt: skip
    assert np.abs(apart[1] - apart[0]).max() < 8 * NOISE.position
    rows = [line.split(",") for line in (tmp_path / "m.csv").read_text().splitlines()]
    kept = [i for i, head in enumerate(rows[0]) if not head.startswith("z ")]
    text = "\n".join(",".join(row[i] for i in kept) for row in rows)
    (tmp_path / "flat.csv").write_text(text)
    short = pincal.Measurements.from_csv(tmp_path / "flat.csv", kind, FREE, partial=True)
    apart += [np.linalg.norm(short.poses[:, None, :2] - short.poses[:, :2], axis=2)]
    assert np.abs(apart[2] - apart[0]).max() > 5e-4


@pytest.mark.slow
def test_the_calibrated_machine_has_the_right_size(tmp_path: Path) -> None:
    """Lengths within 5 standard errors, by the command that the refusal names; it is said."""
    truth = seen(20.0, tmp_path / "m.csv")
    outcome = run("calibrate", "--no-report", "3RRR", tmp_path / "m.csv", "-o", tmp_path / "r")
    assert outcome.code == 2
    assert "a plane that is tilted by 20° to x-y" in outcome.trouble
    assert "--unknown-frame" in outcome.trouble
    said = ("--unknown-frame", "--folds", 0, "-o", tmp_path / "r")
    outcome = done("calibrate", "--no-report", "3RRR", tmp_path / "m.csv", *said)
    assert "they were turned into x-y" in outcome.err
    result = pincal.load_result(tmp_path / "r")
    for leg in truth.legs:
        found = result[f"{leg.name}.l"]
        assert abs(found.identified - leg.nominal_by_name["l"]) < 5.0 * found.std


def test_what_is_level_stays_as_it_is(tmp_path: Path) -> None:
    """A tilt that shortens less than the noise changes no digit, in a known frame too."""
    seen(0.0, tmp_path / "m.csv")
    read = [
        pincal.Measurements.from_csv(tmp_path / "m.csv", "3RRR", setup, partial=True).poses
        for setup in (FREE, None)
    ]
    assert np.array_equal(*read, equal_nan=True)


def test_an_orientation_beside_a_tilted_plane_is_refused(tmp_path: Path) -> None:
    """It is not known of which plane it is."""
    seen(3.0, tmp_path / "m.csv", **{"phi [rad]": 0.1})
    with pytest.raises(pincal.MeasurementError, match="cannot be turned with them"):
        pincal.Measurements.from_csv(tmp_path / "m.csv", "3RRR", FREE)
