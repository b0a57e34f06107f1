"""Ratios of the latent-pose estimator: linear in poses, and against SciPy's sparse solver.

Both solve the same problem from the same start, with the same residuals and derivatives.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import numpy as np
import pytest
from scipy.optimize import OptimizeResult, least_squares
from scipy.sparse import coo_matrix, csr_matrix

import pincal
from pincal.identification.calibrate import calibration_task
from pincal.identification.latent import LatentPoses
from pincal.identification.latent_fit import latent_problem

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from conftest import in_turn

NOISE = pincal.Noise(1e-4, 1e-4, 5e-5)


def measured(count: int) -> tuple[pincal.Mechanism, pincal.Measurements]:
    """Return a hexapod and measurements of a disturbed one at random poses."""
    mechanism = pincal.load_mechanism("6UPS")
    truth = pincal.disturb(mechanism, 2e-3, 1)
    poses = pincal.sample_workspace(mechanism, count, 0)
    readings = pincal.inverse(truth, poses).readings
    rng, reached = np.random.default_rng(0), np.isfinite(readings).all(axis=1)
    twists = 1e-4 * rng.standard_normal(poses.shape)
    readings = readings + NOISE.reading * rng.standard_normal(readings.shape)
    return mechanism, pincal.Measurements(
        mechanism.platform.moved(poses, twists)[reached], readings=readings[reached]
    )


def calibrated(mechanism: pincal.Mechanism, data: pincal.Measurements) -> pincal.CalibrationResult:
    """Return the calibration with latent poses."""
    return pincal.calibrate(mechanism, data, method="latent", noise=NOISE)


def by_scipy(problem: LatentPoses, parameters: np.ndarray) -> OptimizeResult:
    """Return SciPy's solution: all poses among its unknowns, the Jacobian sparse."""
    start = problem.start(parameters)
    n, (count, dof) = len(parameters), (len(start.matrices), 6)
    platform = problem.residuals[0].platform
    rows, _ = problem.rows(start)
    k = rows.value.shape[1]
    line = np.arange(count * k).reshape(count, k)
    at = [
        (
            np.repeat(line[:, i], columns.stop - columns.start),
            np.tile(np.arange(columns.start, columns.stop), count),
        )
        for i, columns in enumerate(problem.columns)
    ]
    at.append(
        (
            np.repeat(line.ravel(), dof),
            (n + np.arange(count)[:, None, None] * dof + np.arange(dof)).repeat(k, axis=1).ravel(),
        )
    )
    where = tuple(np.concatenate(part) for part in zip(*at, strict=True))

    def state(values: np.ndarray) -> object:
        moved = platform.displaced(start.matrices, values[n:].reshape(count, dof))
        return problem.rows(replace(start, parameters=values[:n], matrices=moved))[0]

    def residual(values: np.ndarray) -> np.ndarray:
        return state(values).value.ravel()  # type: ignore[attr-defined]

    def jacobian(values: np.ndarray) -> csr_matrix:
        found = state(values)
        legs = [
            found.parameter[:, i, columns].ravel()  # type: ignore[attr-defined]
            for i, columns in enumerate(problem.columns)
        ]
        entries = np.concatenate([*legs, found.pose.ravel()])  # type: ignore[attr-defined]
        return coo_matrix((entries, where), shape=(count * k, len(values))).tocsr()

    first = np.concatenate((start.parameters, np.zeros(count * dof)))
    tight = dict.fromkeys(("ftol", "xtol", "gtol"), 1e-10)
    return least_squares(residual, first, jac=jacobian, x_scale="jac", tr_solver="lsmr", **tight)


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
    task = calibration_task(mechanism, data, method="latent", noise=NOISE)
    begin = perf_counter()
    problem, unknowns = latent_problem(task)
    other = by_scipy(problem, unknowns.start)
    theirs = perf_counter() - begin
    identified = np.concatenate([leg.identified for leg in result.legs])
    std = np.concatenate([leg.std for leg in result.legs])
    off = np.abs((other.x[: len(identified)] - identified) / std).max()
    print(f"\nSciPy: {other.message} after {other.nfev} evaluations, {off:.2g} standard errors off")
    ratios(
        "latent poses, 6-UPS, 10,000 poses: SciPy least_squares (sparse) over pincal",
        theirs / own,
        "≥ 5",
    )
