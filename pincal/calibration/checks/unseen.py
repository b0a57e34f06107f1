"""Rows that fits have not seen: residuals and derivatives there.

Held-out rows are predicted like those of the fit, whitened by their noise; of them more is
expected by what the fit does not know: r has the covariance 1 + J C Jᵀ.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.calibration.calibration import Calibration
from pincal.calibration.fits import Fits
from pincal.estimation.fit import Fit
from pincal.estimation.linear import Linear
from pincal.estimation.pose_search import solve_poses
from pincal.estimation.start import placed, poses_at_rest

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Predicted:
    """Residuals of a fit at rows that it has not seen."""

    statistic: float
    """Σ rᵀ (1 + J C Jᵀ)⁻¹ r."""
    squares: float
    """Σ rᵀ r."""
    unknown: float
    """Σ tr(J C Jᵀ): growth of the squares by what the fit does not know."""
    equations: int

    @classmethod
    def of(cls, one: Fit, linear: Linear) -> Predicted:
        """Return how a fit does at rows, noise of unit variance."""
        scale = one.noise_scale**2
        J, r = linear.jacobian, linear.value
        spread = J @ (one.covariance / scale) @ J.transpose(0, 2, 1)
        weighed = np.linalg.solve(np.eye(J.shape[1]) + spread, r[:, :, None])[:, :, 0]
        return cls(
            float((r * weighed).sum()),
            float((r**2).sum()),
            float(np.einsum("nkk->", spread)),
            int(linear.equations.sum()),
        )


def predictions(found: Fits, unseen: Calibration) -> list[tuple[Fit, Linear]]:
    """Return fits with their residuals and derivatives at rows that they have not seen."""
    fits = [robust.fit for robust in found.fits]
    if found.latent:
        (one,) = fits
        problem = unseen.latent_problem
        external = one.last.state.external
        state = placed(problem, unseen.measurements, one.parameters, external)
        linear = problem.linearise(poses_at_rest(problem, state))
        return [(one, solve_poses(problem, linear)[0])]
    names = list(unseen.mechanism.leg_names)
    given = unseen.given_poses(found.external)
    pairs = []
    for one in fits:
        group = [names.index(leg.name) for leg in one.problem.legs]
        problem, _ = unseen.measured_problem(group, *given)
        pairs.append((one, problem.linearise(problem.start(one.parameters))))
    return pairs
