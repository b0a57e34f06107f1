"""Covariance of all parameters from several fits: legs identified alone share the poses' noise.

Each fit's estimate follows the noise of the measured poses by its influence, K_i = C J_iᵀ X_i at
pose i; two legs that use the same pose have the cross covariance Σ K_i K_iᵀ. If a frame was moved
so that the parameters are nearest to nominal, they all follow that, too.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pincal.identification.estimate import Estimate
from pincal.identification.fit import Fit, inverse_gram
from pincal.identification.gauge import Gauge
from pincal.identification.robust import Robust
from pincal.identification.task import Task
from pincal.identification.unknowns import Unknowns
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]


def all_legs(mechanism: Mechanism, fits: Sequence[Robust]) -> Array:
    """Return the covariance of all legs' parameters in the mechanism's order, shape (n, n)."""
    sizes = [len(leg.parameters) for leg in mechanism.legs]
    ends = dict(zip(mechanism.leg_names, np.cumsum(sizes).tolist(), strict=True))
    n = sum(sizes)
    covariance = np.zeros((n, n))
    parts = []
    for robust in fits:
        one = robust.fit
        places = np.concatenate(
            [
                np.arange(ends[leg.name] - len(leg.parameters), ends[leg.name])
                for leg in one.problem.legs
            ]
        )
        covariance[np.ix_(places, places)] = one.covariance[: len(places), : len(places)]
        parts.append((places, robust.rows, _influence(one)))
    for index, (places, rows, K) in enumerate(parts):
        for others, their_rows, L in parts[:index]:
            shared, mine, theirs = np.intersect1d(rows, their_rows, return_indices=True)
            if len(shared) and K is not None and L is not None:
                cross = np.einsum("npd,nqd->pq", K[mine], L[theirs])
                covariance[np.ix_(places, others)] = cross
                covariance[np.ix_(others, places)] = cross.T
    return covariance


def _influence(one: Fit) -> Array | None:
    """Return how parameters follow the noise of the poses, in its roots, shape (N, n, dof)."""
    linear, T = one.last, one.unknowns.map
    if linear.pose_noise is None:
        return None
    _, jacobian = linear.minimised
    X = linear.pose_noise if linear.root is None else linear.root @ linear.pose_noise
    J = jacobian @ T * np.sqrt(one.weights)[:, None, None]
    X = X * np.sqrt(one.weights)[:, None, None]
    _, prior = one.unknowns.prior_rows(one.unknowns.start)
    rows = np.concatenate((J.reshape(-1, T.shape[1]), prior))
    bread = T @ inverse_gram(rows)
    size = 1.0 if one.known else float(np.sqrt(one.chi2 / one.degrees_of_freedom))
    return np.asarray(size * (bread @ (J.transpose(0, 2, 1) @ X)))


def nearest_to_nominal(covariance: Array, gauge: Gauge, unknowns: Unknowns) -> tuple[Array, Array]:
    """Return covariances of parameters that were moved along gauge directions, and of the frames.

    Args:
        covariance: Of the legs' parameters with the frames as they were, shape (n, n).
        gauge: The gauge freedoms.
        unknowns: Of the legs and the external unknowns.
    """
    n, T = len(covariance), unknowns.map
    along = T @ gauge.directions.T
    amounts = np.linalg.solve(
        gauge.constraints @ gauge.directions.T, gauge.constraints @ np.linalg.pinv(T)[:, :n]
    )
    follows = along @ amounts
    P = np.eye(n) - follows[:n]
    return P @ covariance @ P.T, follows[n:] @ covariance @ follows[n:].T


def covariances(task: Task, estimate: Estimate) -> tuple[Array, Array | None]:
    """Return the covariance of all legs' parameters, and of the external unknowns' steps."""
    n = sum(len(leg.parameters) for leg in task.mechanism.legs)
    if estimate.latent is not None:
        full = estimate.fits[0].fit.covariance
        return full[:n, :n], full[n:, n:]
    covariance = all_legs(task.mechanism, estimate.fits)
    if estimate.gauge is None or estimate.unknowns is None:
        return covariance, None
    return nearest_to_nominal(covariance, estimate.gauge, estimate.unknowns)
