"""How far residuals of a fit are to be expected: the noise, less what the fit takes up of it.

With white rows ρ of noise of variance V and the estimate δz = −B Σ s Jᵀ ρ (``spread.py``), what is
left is r = ρ − J B Σ s Jᵀ ρ. Of least squares cov r = 1 − H, H = J (JᵀJ)⁻¹ Jᵀ = Q Qᵀ of J = Q R: a
residual has the variance σ² (1 − h), h its leverage. What is left of a measured quantity's own
noise is its redundancy number (W. Baarda, A testing procedure for use in geodetic networks, 1968).
Conditions follow from white rows, e = −S ν = S Wᵀ r, so that unknown poses take their part, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.estimation.fit import Fit
from pincal.estimation.residuals.leg_residuals import LegResiduals, leg_residuals
from pincal.kinematics.batches import product

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Left:
    """What a fit leaves of q quantities at each of N poses, c e of the conditions there."""

    noise: Array
    """By the noise alone: c L or c S, shape (N, q, s)."""
    taken: Array
    """What they follow of the estimate, c J R⁻¹, shape (N, q, n)."""
    given: Array
    """What their noise gives to the estimate, R δz, shape (N, q, n)."""
    estimate: Array
    """Covariance of R δz, shape (n, n): 1 of least squares."""

    @classmethod
    def of(cls, fit: Fit, follows: Array) -> Left:
        """Return what a fit leaves of quantities.

        Args:
            fit: The fit.
            follows: c, derivatives of the quantities by the conditions, shape (N, q, k).
        """
        system, linear, spread = fit.system, fit.last, fit.spread
        into, parts = system.unknowns.map @ spread.root, []
        for poses in linear.parts():
            J, c, S = system.derivatives(linear, poses) @ into, follows[poses], linear.white.noise
            noise = through = product(c, S[poses])
            if system.problem.weighted:
                W = linear.white.by_noise[poses]
                noise = through = c = product(noise, W.transpose(0, 2, 1))
            else:
                c = c * system.unit
                through = product(noise, S[poses].transpose(0, 2, 1)) / system.unit
            given = spread.slopes[poses, None, None] * product(through, J)
            parts.append((noise, product(c, J), given))
        noise, taken, given = (np.concatenate(one) for one in zip(*parts, strict=True))
        return cls(noise, taken, given, spread.meat_in_root)

    @property
    def variances(self) -> Array:
        """Of each, shape (N, q), in squares of its unit, the noise as modelled."""
        alone = (self.noise**2).sum(axis=2)
        mixed = (self.taken * self.given).sum(axis=2)
        return np.asarray(alone - 2.0 * mixed + (self.taken @ self.estimate * self.taken).sum(2))

    def part(self, columns: slice) -> Left:
        """Return what is left of some of the quantities."""
        noise, taken, given = (one[:, columns] for one in (self.noise, self.taken, self.given))
        return Left(noise, taken, given, self.estimate)

    def of_sum(self, factors: Array) -> float:
        """Return the variance of a sum of the quantities times factors, shape (N, q)."""
        noise = np.einsum("nq,nqs->ns", factors, self.noise)
        taken, given = (np.einsum("nq,nqk->k", factors, one) for one in (self.taken, self.given))
        return float((noise**2).sum() - 2.0 * taken @ given + taken @ self.estimate @ taken)


def every_residual(fit: Fit) -> tuple[list[LegResiduals], Array, list[slice]]:
    """Return the residuals of legs and what they and those of all that was measured follow.

    Returns:
        Residuals of each leg; derivatives by the conditions of these and, behind them, of what was
        measured of the platform, shape (N, q, k); and the columns of each leg, then of that.
    """
    problem, linear = fit.problem, fit.last
    legs = [leg_residuals(problem, linear, index) for index in range(len(problem.legs))]
    n_legs, (count, k) = problem.leg_rows[-1].stop, linear.stack.value.shape
    seen = np.broadcast_to(np.eye(k)[n_legs:], (count, k - n_legs, k))
    parts = [*(leg.follows for leg in legs), seen]
    ends = np.cumsum([one.shape[1] for one in parts]).tolist()
    columns = [slice(end - one.shape[1], end) for one, end in zip(parts, ends, strict=True)]
    return legs, np.concatenate(parts, axis=1), columns


def redundancy(fit: Fit) -> tuple[list[LegResiduals], list[Array]]:
    """Return the residuals of legs, and variances after a fit over those of the noise, 1 − h.

    Of each leg, then of what was measured of the platform, shape (N, q); zero where there is no
    noise.
    """
    legs, follows, columns = every_residual(fit)
    left = Left.of(fit, follows).variances
    measured = columns[-1].stop - columns[-1].start
    sigmas = [*(leg.sigma for leg in legs), fit.problem.sigma_observed[:, :measured]]
    return legs, [
        np.maximum(left[:, own], 0.0) / np.where(sigma > 0.0, sigma, np.inf) ** 2
        for own, sigma in zip(columns, sigmas, strict=True)
    ]
