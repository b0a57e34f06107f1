"""Covariance of all parameters from several fits: legs identified alone share the poses' noise.

Each fit's estimate follows the noise by its influence K; two legs that use the same pose have the
cross covariance Σ K_i K_iᵀ over the columns of its noise. If a frame was moved so that the
parameters are nearest to nominal, they all follow that, too.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pincal.calibration.fits import Fits
from pincal.estimation.observability.gauge import Gauge
from pincal.estimation.residuals.robust import Robust
from pincal.estimation.unknowns import Unknowns
from pincal.kinematics.batches import over_rows
from pincal.model.leg import Leg
from pincal.model.measuring.uncertainty import Systematic
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]


def all_legs(mechanism: Mechanism, fits: Sequence[Robust]) -> Array:
    """Return the covariance of all legs' parameters in the mechanism's order, shape (n, n)."""
    n = len(mechanism.parameters)
    covariance = np.zeros((n, n))
    parts = []
    for robust in fits:
        one = robust.fit
        places = _places(mechanism, one.problem.legs)
        covariance[np.ix_(places, places)] = one.covariance[: len(places), : len(places)]
        last = one.problem.reading_columns[-1].stop
        columns = [*range(last, last + mechanism.platform.dof), -1]  # the pose's noise, an outlier
        by_pose = one.influence[:, : len(places), columns]
        parts.append((places, robust.rows, by_pose))
    for index, (places, rows, K) in enumerate(parts):
        for others, their_rows, L in parts[:index]:
            shared, mine, theirs = np.intersect1d(rows, their_rows, return_indices=True)
            if len(shared):
                cross = np.einsum("npd,nqd->pq", K[mine], L[theirs])
                covariance[np.ix_(places, others)] = cross
                covariance[np.ix_(others, places)] = cross.T
    return covariance


def _places(mechanism: Mechanism, legs: Sequence[Leg]) -> NDArray[np.intp]:
    """Return the places of some legs' parameters among those of all."""
    sizes = [len(leg.parameters) for leg in mechanism.legs]
    ends = dict(zip(mechanism.leg_names, np.cumsum(sizes).tolist(), strict=True))
    return np.concatenate(
        [np.arange(ends[leg.name] - len(leg.parameters), ends[leg.name]) for leg in legs]
    )


def chi2_freedoms(fits: Sequence[Robust]) -> float:
    """Return the degrees of freedom of a χ² with the mean and variance of the fits' sum.

    Residuals M W ν of two fits that share poses are correlated by the poses' noise, A = W Wᵀ: of
    their χ², 2 tr(M₁ A M₂ Aᵀ) is the covariance. Of fits that share nothing, that of them all.
    """
    parts, total = [], 0
    for robust in fits:
        one = robust.fit
        used = np.flatnonzero(one.good)
        last = one.problem.reading_columns[-1].stop
        W = one.last.white.by_noise[used, :, last : last + one.problem.platform.dof]
        parts.append((robust.rows[used], one.Q, W))
        total += one.degrees_of_freedom
    shared = 0.0
    for index, (rows, Q, W) in enumerate(parts):
        for others, P, V in parts[:index]:
            _, mine, theirs = np.intersect1d(rows, others, return_indices=True)
            A = W[mine] @ V[theirs].transpose(0, 2, 1)
            AP = A @ P[theirs]
            QA = A.transpose(0, 2, 1) @ Q[mine]
            both = over_rows(Q[mine], AP)
            shared += (A**2).sum() - (AP**2).sum() - (QA**2).sum() + (both**2).sum()
    return total**2 / (total + 2.0 * shared) if total else 0.0


def moved_along_gauge(covariance: Array, gauge: Gauge, unknowns: Unknowns) -> tuple[Array, Array]:
    """Return covariances of parameters that were moved along gauge directions, and of the frames.

    Args:
        covariance: Of the legs' parameters with the frames as they were, shape (n, n).
        gauge: The gauge freedoms.
        unknowns: Of the legs and the external unknowns.
    """
    n = len(covariance)
    P = _nearest(gauge, unknowns, n)
    moved = P @ covariance @ P.T
    return moved[:n, :n], moved[n:, n:]


def _nearest(gauge: Gauge, unknowns: Unknowns, n: int) -> Array:
    """Return what moves n parameters nearest to nominal, the frames following, (n + n_ext, n)."""
    T = unknowns.map
    along = T @ gauge.directions.T
    amounts = np.linalg.solve(
        gauge.constraints @ gauge.directions.T, gauge.constraints @ np.linalg.pinv(T)[:, :n]
    )
    follows = along @ amounts
    return np.concatenate((np.eye(n) - follows[:n], -follows[n:]))


def systematic(found: Fits) -> Array:
    """Return how all parameters, then frames, follow what is off in all rows, shape (n, q).

    Columns are for one standard uncertainty each (see ``Observation.systematic``); none where
    nothing is uncertain so.
    """
    calibration, mechanism = found.calibration, found.calibration.mechanism
    seen, n = calibration.observation, len(mechanism.parameters)
    if calibration.options.setup.systematic == Systematic():
        return np.zeros((n + len(seen.external), 0))
    if found.latent:
        fit = found.fits[0].fit
        own = seen.systematic(fit.last.state.matrices, fit.last.state.external)
        errors = np.zeros((*fit.last.stack.value.shape, own.shape[2]))
        errors[:, errors.shape[1] - own.shape[1] :] = own
        return fit.spread.response(errors)
    external = found.external or seen.external.start
    poses, _ = calibration.given_poses(found.external)
    matrices = mechanism.platform.matrices(poses)
    own = seen.systematic(matrices, external)
    rows = [seen.names.index(name) for name in mechanism.platform.freedoms]
    by_twist = seen.evaluate(matrices, external).pose[:, rows]
    twists = -np.linalg.solve(by_twist, own[:, rows])  # where what is measured takes the poses
    follows = np.zeros((n, own.shape[2]))
    for robust in found.fits:
        one = robust.fit
        places = _places(mechanism, one.problem.legs)
        moved = [demand.pose @ twists[robust.rows] for demand in one.last.stack.demands]
        errors = np.zeros((*one.last.stack.value.shape, own.shape[2]))
        for leg, error, used in zip(one.problem.leg_rows, moved, one.problem.used.T, strict=True):
            errors[used, leg] = error[used]
        follows[places] = one.spread.response(errors)[: len(places)]
    if found.gauge is None or found.unknowns is None:
        return follows
    return _nearest(found.gauge, found.unknowns, n) @ follows


def covariances(found: Fits) -> tuple[Array, Array | None]:
    """Return the covariance of all legs' parameters, and of the external unknowns' steps."""
    mechanism = found.calibration.mechanism
    n = len(mechanism.parameters)
    if found.latent:
        full = found.fits[0].fit.covariance
        return full[:n, :n], full[n:, n:]
    covariance = all_legs(mechanism, found.fits)
    if found.gauge is None or found.unknowns is None:
        return covariance, None
    return moved_along_gauge(covariance, found.gauge, found.unknowns)
