"""Errors that go together within a row, and those that are the same in all rows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cramer_rao
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import pincal

Array = NDArray[np.float64]
TRACKER = pincal.Tracker((3.0, -2.0, 0.5), range=2e-6, azimuth=2e-5, elevation=2e-5)


def polar_covariance(points: Array, tracker: pincal.Tracker) -> Array:
    """Return covariances of points measured by range and angles, by differences, (N, 3, 3)."""

    def cartesian(polar: Array) -> Array:
        r, a, e = polar.T
        ray = np.column_stack((np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)))
        return r[:, None] * ray

    x, y, z = (points - tracker.at).T
    polar = np.column_stack(
        (np.sqrt(x**2 + y**2 + z**2), np.arctan2(y, x), np.arctan2(z, np.hypot(x, y)))
    )
    J = np.stack(
        [(cartesian(polar + d) - cartesian(polar - d)) / 2e-6 for d in 1e-6 * np.eye(3)], axis=2
    )
    root = J * [tracker.range, tracker.azimuth, tracker.elevation]
    return root @ root.transpose(0, 2, 1)


def correlated(
    one: cramer_rao.Machine, covariance: Array, sigma: float, seed: int
) -> pincal.Measurements:
    """Return measurements whose poses err by covariances (N, dof, dof), readings by sigma."""
    rng = np.random.default_rng(seed)
    root = np.linalg.cholesky(covariance)
    still = np.zeros((len(covariance), one.dof))
    twists = (root @ rng.standard_normal((*still.shape, 1)))[:, :, 0]
    readings = one.readings(one.parameters, still)
    readings = readings + sigma * rng.standard_normal(readings.shape)
    return pincal.Measurements(
        poses=one.coordinates(twists),
        readings=readings,
        sigma_poses=np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)),
        sigma_readings=np.full(readings.shape, sigma),
    )


def pairs(names: tuple[str, ...], covariance: Array) -> dict[str, Array]:
    """Return the columns of covariances (N, dof, dof)."""
    return {
        f"{a},{b}": covariance[:, i, j]
        for i, a in enumerate(names)
        for j, b in enumerate(names)
        if i < j
    }


def planar(count: int = 24) -> tuple[cramer_rao.Machine, Array]:
    """Return a 3-RRR, and covariances of x, y and phi that differ from row to row."""
    one = cramer_rao.machine("3RRR", count)
    rng = np.random.default_rng(3)
    root = 1e-4 * (np.eye(3) + 0.8 * rng.standard_normal((len(one.positions), 3, 3)))
    return one, root @ root.transpose(0, 2, 1)


def by_scipy(one: cramer_rao.Machine, data: pincal.Measurements, covariance: Array) -> Array:
    """Return the parameters of least squares over all parameters and poses, closed forms."""
    n, dof, sigma = len(one.parameters), one.dof, data.sigma_readings
    whitener = np.linalg.inv(np.linalg.cholesky(covariance))
    start = one.nominal.platform.matrices(data.poses)
    seen = replace(
        one,
        positions=start[:, : one.positions.shape[1], 3],
        rotations=Rotation.from_matrix(start[:, :3, :3]),
    )

    def residuals(z: Array) -> Array:
        twists = z[n:].reshape(-1, dof)
        off = (seen.readings(z[:n], twists) - data.readings) / sigma
        return np.concatenate((off.ravel(), (whitener @ twists[:, :, None]).ravel()))

    first = np.concatenate((one.parameters, np.zeros(dof * len(data))))
    found = least_squares(residuals, first, x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    return found.x[:n]


def test_covariances_weigh_as_least_squares_over_all_poses_does() -> None:
    """Parameters of a 3-RRR with correlated x, y, phi: SciPy's, with closed forms."""
    one, covariance = planar()
    data = correlated(one, covariance, 5e-5, 0)
    plain = pincal.calibrate(one.nominal, data)
    data = replace(data, covariances=pairs(("x", "y", "phi"), covariance))
    result = pincal.calibrate(one.nominal, data)
    values, std, *_ = cramer_rao.values_of(result)
    wanted = by_scipy(one, data, covariance)
    assert np.abs((values - wanted) / std).max() < 1e-2
    assert np.abs((cramer_rao.values_of(plain)[0] - wanted) / std).max() > 0.1


def test_the_standard_errors_are_those_of_the_bound() -> None:
    """Covariance of the estimate: the inverse of the dense information, by differences."""
    one, covariance = planar()
    data = correlated(one, covariance, 5e-5, 0)
    data = replace(data, covariances=pairs(("x", "y", "phi"), covariance))
    truth = one.nominal.with_parameters(
        {
            leg.name: values
            for leg, values in zip(one.nominal.legs, np.split(one.parameters, 3), strict=True)
        }
    )
    exact = replace(
        data,
        poses=one.coordinates(np.zeros((len(data), 3))),
        readings=one.readings(one.parameters, np.zeros((len(data), 3))),
    )
    result = pincal.calibrate(truth, exact, loss="none")
    std = np.sqrt(np.diagonal(result.covariance))
    assert std == pytest.approx(bound(one, covariance, 5e-5), rel=1e-4)


def bound(one: cramer_rao.Machine, covariance: Array, sigma: float) -> Array:
    """Return the least standard errors, poses eliminated pose by pose, by differences."""
    n, dof, h = len(one.parameters), one.dof, 1e-6
    still = np.zeros((len(covariance), dof))

    def slope(step: Array, twist: Array) -> Array:
        ends = [one.readings(one.parameters + s * step, still + s * twist) for s in (1, -1)]
        return (ends[0] - ends[1]) / (2 * h)

    A = np.stack([slope(step, 0 * still[0]) for step in h * np.eye(n)], axis=2)
    B = np.stack([slope(np.zeros(n), step) for step in h * np.eye(dof)], axis=2)
    V = sigma**2 * np.eye(A.shape[1]) + B @ covariance @ B.transpose(0, 2, 1)
    return np.sqrt(
        np.diagonal(np.linalg.inv((A.transpose(0, 2, 1) @ np.linalg.solve(V, A)).sum(0)))
    )


@pytest.mark.parametrize("method", ["all-legs", "per-leg"])
def test_a_tracker_s_range_and_angles_are_covariances(method: str) -> None:
    """Of x and y: the same result as with the covariances that differences give."""
    one = cramer_rao.machine("3RRR", 24)
    points = np.column_stack((one.positions, np.zeros(len(one.positions))))
    covariance = np.zeros((len(points), 3, 3))
    covariance[:, :2, :2] = polar_covariance(points, TRACKER)[:, :2, :2]
    covariance[:, 2, 2] = 1e-8
    data = correlated(one, covariance, 5e-5, 1)
    said = replace(data, covariances=pairs(("x", "y", "phi"), covariance))
    sigma = np.column_stack((np.full((len(points), 2), np.nan), np.full(len(points), 1e-4)))
    polar = {name: np.full(len(points), getattr(TRACKER, name)) for name in ("range", "azimuth")}
    read = replace(data, sigma_poses=sigma, sigma_extra=polar)
    place = replace(TRACKER, range=0.0, azimuth=0.0)
    setup = pincal.Setup(tracker=place)
    a = pincal.calibrate(one.nominal, said, method=method)
    b = pincal.calibrate(one.nominal, read, setup=setup, method=method)
    first, second = cramer_rao.values_of(a), cramer_rao.values_of(b)
    assert np.abs(first[:2] - second[:2]).max() < 1e-3 * first[1].min()


def test_positions_of_a_stewart_platform_by_a_tracker() -> None:
    """Standard errors at the bound: range and angles are taken for what they are."""
    one = cramer_rao.machine("6UPS", 40)
    covariance = np.zeros((len(one.positions), 6, 6))
    covariance[:, :3, :3] = polar_covariance(one.positions, TRACKER)
    covariance[:, 3:, 3:] = 1e-10 * np.eye(3)
    data = correlated(one, covariance, 1e-5, 0)
    turns = np.column_stack((np.full((len(data), 3), np.nan), np.full((len(data), 3), 1e-5)))
    data = replace(data, sigma_poses=turns)
    result = pincal.calibrate(one.nominal, data, setup=pincal.Setup(tracker=TRACKER))
    values, std, *_ = cramer_rao.values_of(result)
    least = bound(one, covariance, 1e-5)
    assert std == pytest.approx(least, rel=0.02)
    off = (values - one.parameters) / least
    assert np.sqrt((off**2).mean()) < 1.5
