"""Measurements whose errors go together within a row, or are the same in all, and their bound."""

from __future__ import annotations

from dataclasses import replace

import cramer_rao
import numpy as np
from numpy.typing import NDArray

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


def slopes(one: cramer_rao.Machine) -> tuple[Array, Array]:
    """Return readings by parameters (N, m, n) and by the platform's twist (N, m, dof)."""
    n, dof, h = len(one.parameters), one.dof, 1e-6
    still = np.zeros((len(one.positions), dof))

    def slope(step: Array, twist: Array) -> Array:
        ends = [one.readings(one.parameters + s * step, still + s * twist) for s in (1, -1)]
        return (ends[0] - ends[1]) / (2 * h)

    A = np.stack([slope(step, np.zeros(dof)) for step in h * np.eye(n)], axis=2)
    return A, np.stack([slope(np.zeros(n), step) for step in h * np.eye(dof)], axis=2)


def estimate(one: cramer_rao.Machine, covariance: Array, sigma: float) -> tuple[Array, Array]:
    """Return the efficient estimate's maps of readings and of twists, poses eliminated, (n, N, ·).

    By differences: what errors of readings (n, N, m) and of poses (n, N, dof) make of parameters.
    """
    A, B = slopes(one)
    V = sigma**2 * np.eye(A.shape[1]) + B @ covariance @ B.transpose(0, 2, 1)
    weighted = np.linalg.solve(V, A)
    F = (A.transpose(0, 2, 1) @ weighted).sum(axis=0)
    of_readings = np.einsum("pq,nmq->pnm", np.linalg.inv(F), weighted)
    return of_readings, -np.einsum("pnm,nmd->pnd", of_readings, B)


def bound(one: cramer_rao.Machine, covariance: Array, sigma: float) -> Array:
    """Return the least standard errors."""
    of_readings, of_poses = estimate(one, covariance, sigma)
    noise = sigma**2 * (of_readings**2).sum(axis=(1, 2))
    return np.sqrt(noise + np.einsum("pnd,nde,pne->p", of_poses, covariance, of_poses))


def error(
    one: cramer_rao.Machine, data: pincal.Measurements, covariance: Array, sigma: float
) -> Array:
    """Return the efficient estimate's error by the noise of some data, shape (n,)."""
    still = np.zeros((len(covariance), one.dof))
    readings = data.readings - one.readings(one.parameters, still)
    twists = one.nominal.platform.twists_between(one.coordinates(still), data.poses)
    of_readings, of_poses = estimate(one, covariance, sigma)
    return np.einsum("pnm,nm->p", of_readings, readings) + np.einsum("pnd,nd->p", of_poses, twists)


def scaled(data: pincal.Measurements, by: float) -> pincal.Measurements:
    """Return measurements by an instrument whose scale is off by so much."""
    poses = data.poses.copy()
    poses[:, :2] *= 1.0 + by
    return replace(data, poses=poses)
