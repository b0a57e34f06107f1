"""Noise that was assumed equal in position [m] and orientation [rad], and is not: its two scales.

Each scale by the squares of its own residuals over their redundancy, the part of each that the fit
does not take up (Förstner 1979; one step, from equal scales).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f as f_law

from pincal.identification.estimate import Estimate
from pincal.identification.latent import LatentLinear
from pincal.identification.task import Task

Array = NDArray[np.float64]
_CHANCE = 1e-4  # probability of such a ratio of scales, if they are equal
_LEAST = 3.0  # redundancy from which a scale is estimated
_SETTLED = 1e-12  # of the largest singular value


def unequal_noise(task: Task, estimate: Estimate) -> tuple[str, ...]:
    """Return a warning if the noise was assumed, and residuals tell two scales of it apart."""
    latent, one = estimate.latent, estimate.fits[0].fit
    if task.noise.known or latent is None or task.loss != "none":
        return ()
    if not (one.converged and isinstance(one.last, LatentLinear)):
        return ()
    redundancy = redundancies(one.last, one.unknowns.map)
    columns = np.arange(len(latent.observation.units)) - len(latent.observation.units)
    units = np.array(latent.observation.units)
    noise, scales, freedoms = task.noise.noise, [], []
    for unit in ("m", "rad"):
        own = columns[units == unit]
        told = latent.observation.measured[:, own]
        freedoms.append(float(redundancy[:, own][told].sum()))
        squares = float((one.last.rows.value[:, own][told] ** 2).sum())
        scales.append(np.sqrt(squares / max(freedoms[-1], 1e-300)))
    if min(freedoms) < _LEAST or not min(scales) > 0.0:
        return ()
    ratio = (scales[0] / scales[1]) ** 2
    if 2.0 * min(f_law.cdf(ratio, *freedoms), f_law.sf(ratio, *freedoms)) > _CHANCE:
        return ()
    position, orientation = noise.position * scales[0], noise.orientation * scales[1]
    scale = np.sqrt(one.chi2 / max(one.degrees_of_freedom, 1))
    return (
        f"equal noise was assumed in position [m] and orientation [rad], but misfits are "
        f"{scales[0] / scale:.2f} and {scales[1] / scale:.2f} times as large as it makes them: "
        f"give it (--noise-position {position:.2g} --noise-orientation {orientation:.2g} fit the "
        "residuals)",
    )


def redundancies(linear: LatentLinear, T: Array) -> Array:
    """Return the part of each residual that poses and unknowns do not take up, shape (N, k).

    1 less the diagonal of the hat matrix: poses first, then the unknowns in rows free of poses.

    Args:
        linear: Residuals at the optimum.
        T: Of all unknowns by the free ones, shape (n, n_free).
    """
    Q = np.linalg.qr(linear.rows.pose)[0]
    J = linear.rows.parameter @ T
    free = J - Q @ (Q.transpose(0, 2, 1) @ J)
    U, s, _ = np.linalg.svd(free.reshape(-1, J.shape[2]), full_matrices=False)
    U = U[:, s > _SETTLED * s[0]].reshape(*J.shape[:2], -1)
    return np.asarray(1.0 - (Q**2).sum(axis=2) - (U**2).sum(axis=2))
