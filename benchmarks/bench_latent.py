"""Ratios of calibration with all poses unknown: linear in poses, and against SciPy's sparse solver.

SciPy gets the same rows, from the same start, with closed forms of readings and their derivatives.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares
from scipy.sparse import coo_matrix, csr_matrix
from scipy.spatial.transform import Rotation

import pincal

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from conftest import in_turn
from cramer_rao import values_of

Array = NDArray[np.float64]
NOISE = pincal.Noise(1e-4, 1e-4, 5e-5)


def measured(count: int) -> tuple[pincal.Mechanism, pincal.Measurements]:
    """Return a hexapod and measurements of a disturbed one at random poses."""
    mechanism = pincal.load_mechanism("6UPS")
    truth, plan = pincal.disturb(mechanism, 2e-3, 1), pincal.sample_configurations(mechanism, count)
    return mechanism, pincal.simulate(mechanism, truth, plan, NOISE).measurements


def calibrated(mechanism: pincal.Mechanism, data: pincal.Measurements) -> pincal.CalibrationResult:
    """Return the calibration with all poses unknown."""
    return pincal.calibrate(mechanism, data, noise=NOISE)


def _spherical(radius: float, polar: float, azimuth: float) -> tuple[Array, Array]:
    """Return a point in spherical coordinates, (3,), and its derivatives by these, (3, 3)."""
    (s, c), (sa, ca) = (np.sin(polar), np.cos(polar)), (np.sin(azimuth), np.cos(azimuth))
    unit = np.array([s * ca, s * sa, c])
    polars, azimuths = np.array([c * ca, c * sa, -s]), np.array([-s * sa, s * ca, 0.0])
    return radius * unit, np.stack((unit, radius * polars, radius * azimuths), axis=1)


@dataclass(frozen=True)
class Hexapod:
    """A 6-UPS in closed form: eight parameters a leg, then a twist for each measured pose."""

    positions: Array
    """Measured, shape (N, 3), [m]."""
    rotations: Rotation
    """Measured, length N."""
    readings: Array
    """Shape (N, 6), [m]."""

    def __call__(self, values: Array) -> tuple[Array, csr_matrix]:
        """Return residuals in standard deviations, readings first, and the sparse Jacobian."""
        N = len(self.positions)
        parameters, twists = values[:48].reshape(6, 8), values[48:].reshape(N, 6)
        points = self.positions + twists[:, :3]
        turns = Rotation.from_rotvec(twists[:, 3:])
        R = (turns * self.rotations).as_matrix()
        left = _left(twists[:, 3:])
        off, own, of_pose = np.empty((N, 6)), np.empty((N, 6, 8)), np.empty((N, 6, 6))
        for leg, p in enumerate(parameters):
            A, dA = _spherical(*p[:3])
            b, db = _spherical(*p[3:6])
            arm = R @ b
            line = points + arm - A
            length = np.linalg.norm(line, axis=1)
            u, k = line / length[:, None], p[6]
            reading = (length - p[7]) / k
            off[:, leg] = reading - self.readings[:, leg]
            own[:, leg, :3] = -u @ dA / k
            own[:, leg, 3:6] = np.einsum("ni,nij,jk->nk", u, R, db) / k
            own[:, leg, 6] = -reading / k
            own[:, leg, 7] = -1.0 / k
            of_pose[:, leg, :3] = u / k
            of_pose[:, leg, 3:] = np.einsum("ni,nij->nj", np.cross(arm, u), left) / k
        value = np.concatenate((off.ravel() / NOISE.reading, twists.ravel() / NOISE.position))
        row = np.arange(6 * N).reshape(N, 6, 1)
        columns = 8 * np.arange(6)[:, None] + np.arange(8)
        poses = 48 + 6 * np.arange(N)[:, None, None] + np.arange(6)
        parts = [
            (own / NOISE.reading, row, columns),
            (of_pose / NOISE.reading, row, poses),
            (np.full(6 * N, 1.0 / NOISE.position), 6 * N + row.ravel(), 48 + row.ravel()),
        ]
        entries, rows, cols = (
            np.concatenate([np.broadcast_to(part[i], part[0].shape).ravel() for part in parts])
            for i in range(3)
        )
        return value, coo_matrix((entries, (rows, cols)), shape=(12 * N, 48 + 6 * N)).tocsr()


def _left(v: Array) -> Array:
    """Return the left Jacobians of small rotation vectors, to third order, shape (N, 3, 3)."""
    cross = np.cross(v[:, None, :], np.eye(3)).transpose(0, 2, 1)
    return np.eye(3) + cross / 2 + cross @ cross / 6


def by_scipy(mechanism: pincal.Mechanism, data: pincal.Measurements) -> OptimizeResult:
    """Return SciPy's solution: all poses among its unknowns, the Jacobian sparse."""
    matrices = mechanism.platform.transforms(data.poses).as_matrix()
    rotations = Rotation.from_matrix(matrices[:, :3, :3])
    problem = Hexapod(matrices[:, :3, 3], rotations, data.readings)
    nominal = np.concatenate([leg.nominal for leg in mechanism.legs])
    first = np.concatenate((nominal, np.zeros(6 * len(data))))
    tight = dict.fromkeys(("ftol", "xtol", "gtol"), 1e-10)
    return least_squares(
        lambda values: problem(values)[0],
        first,
        jac=lambda values: problem(values)[1],
        x_scale="jac",
        tr_solver="lsmr",
        **tight,
    )


@pytest.mark.parametrize("many", [10_000])
def test_time_is_linear_in_poses(many: int, ratios: Callable[[str, float, str], None]) -> None:
    """Ten times the poses, all of them unknown: how many times the time."""
    small, large = measured(many // 10), measured(many)
    one, ten = in_turn(lambda: calibrated(*small), lambda: calibrated(*large), runs=3)
    ratios("latent poses, 6-UPS: time at 10,000 poses over time at 1,000", ten / one, "≤ 12")


@pytest.mark.parametrize("many", [10_000])
def test_against_a_sparse_solver(many: int, ratios: Callable[[str, float, str], None]) -> None:
    """SciPy's least_squares with a sparse Jacobian, to within a tenth of a standard error."""
    mechanism, data = measured(many)
    begin = perf_counter()
    result = calibrated(mechanism, data)
    own = perf_counter() - begin
    begin = perf_counter()
    other = by_scipy(mechanism, data)
    theirs = perf_counter() - begin
    values, std, *_ = values_of(result)
    off = np.abs((other.x[: len(values)] - values) / std).max()
    print(f"\nSciPy: {other.message} after {other.nfev} evaluations, {off:.2g} standard errors off")
    assert off < 0.1
    ratios(
        "latent poses, 6-UPS, 10,000 poses: SciPy least_squares (sparse; closed forms of this "
        "machine, no tests of residuals) over pincal",
        theirs / own,
        "≥ 5",
    )
