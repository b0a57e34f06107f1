"""A real arm of seven joints seen by a laser tracker. Skipped where the data are absent.

The data (public, of ctu-vras/multirobot-calibration) are looked for beside the project, or where
``PINCAL_DATA`` says.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import pincal
from pincal.kinematics.arm import arm

DATA = Path(os.environ.get("PINCAL_DATA", Path(__file__).parents[2] / "shared" / "data"))
FILE = DATA / "motoman_left" / "measurements.csv"
pytestmark = pytest.mark.skipif(not FILE.is_file(), reason=f"no {FILE}")
NAMES = ("E", "S", "L", "U", "R", "B", "T")
#: Nominal Denavit-Hartenberg table, Rz(θ + q) Tz(d) Tx(a) Rx(α): a [m], d [m], α, θ [rad].
TABLE = [
    (0.0, -0.263, np.radians(-15.0), -np.pi / 2),
    (0.15, 1.4159, -np.pi / 2, 0.0),
    (0.614, 0.0, np.pi, -np.pi / 2),
    (0.2, 0.0, -np.pi / 2, 0.0),
    (0.0, -0.64, np.pi / 2, 0.0),
    (0.03, 0.0, np.pi / 2, -np.pi / 2),
    (0.0, 0.2, 0.0, 0.0),
    (0.05, 0.25, 0.0, 0.0),
]
NOISE = pincal.Noise(5e-5, 1e-4, 0.0)
SETUP = pincal.Setup(unknown_frame=True)


def _link(a: float, d: float, alpha: float, theta: float) -> np.ndarray:
    """Return one row's transform, shape (4, 4)."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("ZX", [theta, alpha]).as_matrix()
    matrix[:3, 3] = a * np.cos(theta), a * np.sin(theta), d
    return matrix


def _placement(matrix: np.ndarray) -> pincal.Placement:
    x, y, z = matrix[:3, 3].tolist()
    roll, pitch, yaw = Rotation.from_matrix(matrix[:3, :3]).as_euler("xyz").tolist()
    return pincal.Placement(xyz=(x, y, z), rpy=(roll, pitch, yaw))


@pytest.fixture(scope="module")
def mechanism() -> pincal.Mechanism:
    """The arm of the nominal table; each joint turns about z before its row."""
    joints, before = [], np.eye(4)
    for name, row in zip(NAMES, TABLE, strict=False):
        joints.append(
            pincal.Joint(f"q_{name}", "revolute", _placement(before), lower=-np.inf, upper=np.inf)
        )
        before = _link(*row)
    joints.append(pincal.Joint("reflector", "fixed", _placement(before @ _link(*TABLE[7]))))
    return arm("motoman", tuple(joints))


@pytest.fixture(scope="module")
def data() -> pincal.Measurements:
    """Positions of the reflector in the tracker's frame, and readings, of 208 rows."""
    table = np.genfromtxt(FILE, delimiter=",", names=True, deletechars="", encoding="utf-8")
    columns = {name: table[name] for name in table.dtype.names or ()}

    def starting(start: str) -> np.ndarray:
        return next(values for name, values in columns.items() if name.startswith(start))

    readings = np.column_stack([starting(f"q_{name}") for name in NAMES])
    poses = np.full((len(readings), 6), np.nan)
    poses[:, :3] = np.column_stack([starting(axis) for axis in "xyz"])
    return pincal.Measurements(poses=poses, readings=readings)


def test_nominal_table(mechanism: pincal.Mechanism) -> None:
    """The arm's forward kinematics are the product of the table's transforms."""
    readings = np.random.default_rng(0).uniform(-2.0, 2.0, (5, 7))
    poses = pincal.forward(mechanism, readings).poses
    for pose, q in zip(mechanism.platform.transforms(poses).as_matrix(), readings, strict=True):
        wanted = np.eye(4)
        for (a, d, alpha, theta), turn in zip(TABLE, [*q, 0.0], strict=True):
            wanted = wanted @ _link(a, d, alpha, theta + turn)
        np.testing.assert_allclose(pose, wanted, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_held_out_rows(mechanism: pincal.Mechanism, data: pincal.Measurements, seed: int) -> None:
    """Identified from 70 % of the rows, the others are predicted to 0.085 mm (root mean square).

    An independent fit of the Denavit-Hartenberg quantities found 0.078 mm; registration alone
    leaves 0.380 mm. The first joint stood still: four directions are held and named, and one more
    that is told to ± 0.26 rad only.
    """
    order = np.random.default_rng(seed).permutation(len(data))
    cut = int(0.7 * len(data))
    fit, unseen = (data.rows(np.sort(rows)) for rows in (order[:cut], order[cut:]))
    result = pincal.calibrate(
        mechanism,
        fit,
        method="latent",
        noise=NOISE,
        setup=SETUP,
        rough=True,
        hold_undetermined=True,
    )
    assert result.converged
    frame = np.array([one.identified for one in result.external])
    points = pincal.forward(result.identified, unseen.readings).poses[:, :3]
    off = Rotation.from_rotvec(frame[3:]).apply(points) + frame[:3] - unseen.poses[:, :3]
    rms = float(np.sqrt((off**2).sum(axis=1).mean()))
    print(f"seed {seed}: {1e3 * rms:.4f} mm held out")
    assert rms <= 0.085e-3
    assert result.legs[0].rank == 27
    assert any("14 parameters are redundant" in text for text in result.gauge)
    (held,) = result.undetermined
    *lost, weak = held.split("; ")
    assert len(lost) == 4
    assert any("q_S_ry of arm" in one for one in lost)
    assert weak == "q_T_rx of arm, tool_rz of arm are hardly told apart"  # ± 0.26 rad if not held


def test_the_joint_that_stood_still_is_refused(
    mechanism: pincal.Mechanism, data: pincal.Measurements
) -> None:
    """Without leave to hold them, directions that the rows do not tell are refused by name."""
    assert np.ptp(data.readings[:, 0]) == 0.0
    with pytest.raises(pincal.ObservabilityError, match=r"q_S_x.*hold-undetermined"):
        pincal.calibrate(mechanism, data, method="latent", noise=NOISE, setup=SETUP, rough=True)
