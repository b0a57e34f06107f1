"""How far residuals of a fit are to be expected: the noise, less what the fit takes up of it.

With white rows ρ of noise of variance V and the estimate δz = −B Σ s Jᵀ ρ (``Spread``), what is
left is r = ρ − J B Σ s Jᵀ ρ. Of least squares cov r = 1 − H, H = J (JᵀJ)⁻¹ Jᵀ = Q Qᵀ of J = Q R: a
residual has the variance σ² (1 − h), h its leverage. What is left of a measured quantity's own
noise is its redundancy number (W. Baarda, A testing procedure for use in geodetic networks, 1968).
Conditions follow from white rows, e = −S ν = S Wᵀ r, so that unknown poses take their part, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pincal.estimation.blocks.legs import slices
from pincal.estimation.fit import Fit
from pincal.estimation.problem import Linear, Problem
from pincal.kinematics.batches import least_squares, product
from pincal.types import Array


@dataclass(frozen=True)
class LegResiduals:
    """Residuals of one leg, k at a pose, c e of the conditions e there."""

    value: Array
    """Shape (N, k)."""
    sigma: Array
    """Their modelled standard deviations, shape (N, k)."""
    unit: str
    """m of closures, that of the readings otherwise."""
    quantity: str
    """``"closure"`` or ``"reading"``."""
    follows: Array
    """c, derivatives by the conditions at each pose, shape (N, k, n_conditions)."""


def leg_residuals(problem: Problem, linear: Linear, index: int) -> LegResiduals:
    """Return what a leg misses at each pose.

    Poses as measured: its closure, or joint residual, there. Poses that were estimated: predicted
    less measured reading; of exact readings, which are missed by nothing, the closure at the pose
    that was measured (to first order), where it was.
    """
    block, demand = problem.leg_block, linear.demands[index]
    rows, sigma = block.leg_rows[index], block.sigma[:, block.reading_columns[index]]
    count, k = demand.value.shape
    follows = np.zeros((count, k, linear.conditions.shape[1]))
    follows[:, :, rows] = np.eye(k)
    quantity = "closure" if problem.weighted else "reading"
    if problem.latent and sigma.any() and k == 1:
        quantity = "reading"
        follows = np.repeat(follows, sigma.shape[1], axis=1)  # as many as there are readings
        follows[:, :, rows] = -least_squares(demand.reading, np.ones((count, 1, 1)))
    else:
        if problem.latent:
            B = linear.by_pose[:, block.n_rows :]
            whole = problem.observation.measured.sum(axis=1) >= problem.platform.dof
            by_measured = np.where(whole[:, None, None], np.linalg.pinv(B, rcond=1e-9), 0.0)
            follows[:, :, block.n_rows :] = -demand.pose @ by_measured  # to the measured pose
        sigma = np.linalg.norm(follows @ linear.noise_root, axis=2)
    units = " or ".join(dict.fromkeys(problem.legs[index].reading_units))
    value = (follows @ linear.conditions[:, :, None])[:, :, 0]
    return LegResiduals(value, sigma, "m" if quantity == "closure" else units, quantity, follows)


@dataclass(frozen=True)
class Remainders:
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
    def of(cls, fit: Fit, follows: Array) -> Remainders:
        """Return what a fit leaves of quantities, c their derivatives by the conditions, (N, q, k)."""
        system, linear, spread = fit.system, fit.last, fit.spread
        by_free, rows, parts = system.unknowns.map @ spread.root, system.rows(linear), []
        for poses in linear.parts():
            J, W = system.derivatives(linear, poses) @ by_free, rows.by_noise[poses]
            c = product(follows[poses], rows.back[poses])  # by the rows
            noise = product(c, W)
            through = product(noise, W.transpose(0, 2, 1))
            gained = spread.slopes[poses, None, None] * product(through, J)
            parts.append((noise, product(c, J), gained))
        noise, taken, gained = (np.concatenate(chunk) for chunk in zip(*parts, strict=True))
        return cls(noise, taken, gained, spread.meat_in_root)

    @property
    def variances(self) -> Array:
        """Of each, shape (N, q), in squares of its unit, the noise as modelled."""
        variance = (self.noise**2).sum(axis=2)
        mixed = (self.taken * self.given).sum(axis=2)
        return np.asarray(variance - 2.0 * mixed + (self.taken @ self.estimate * self.taken).sum(2))

    def part(self, columns: slice) -> Remainders:
        """Return what is left of some of the quantities."""
        noise, taken, gained = (rows[:, columns] for rows in (self.noise, self.taken, self.given))
        return Remainders(noise, taken, gained, self.estimate)

    def of_sum(self, factors: Array) -> float:
        """Return the variance of a sum of the quantities times factors, shape (N, q)."""
        noise = np.einsum("nq,nqs->ns", factors, self.noise)
        taken, gained = (np.einsum("nq,nqk->k", factors, rows) for rows in (self.taken, self.given))
        return float((noise**2).sum() - 2.0 * taken @ gained + taken @ self.estimate @ taken)


def every_residual(fit: Fit) -> tuple[list[LegResiduals], Array, list[slice]]:
    """Return the residuals of legs and what they and those of all that was measured follow.

    Returns:
        Residuals of each leg; derivatives by the conditions of these and, behind them, of what was
        measured of the platform, shape (N, q, k); and the columns of each leg, then of that.
    """
    problem, linear = fit.problem, fit.last
    legs = [leg_residuals(problem, linear, index) for index in range(len(problem.legs))]
    n_legs, (count, k) = problem.leg_block.n_rows, linear.conditions.shape
    observed = np.broadcast_to(np.eye(k)[n_legs:], (count, k - n_legs, k))
    parts = [*(leg.follows for leg in legs), observed]
    return legs, np.concatenate(parts, axis=1), slices([rows.shape[1] for rows in parts])


def redundancy(fit: Fit) -> tuple[list[LegResiduals], list[Array]]:
    """Return the residuals of legs, and variances after a fit over those of the noise, 1 − h.

    Of each leg, then of what was measured of the platform, shape (N, q); zero where there is no
    noise.
    """
    legs, follows, columns = every_residual(fit)
    variances = Remainders.of(fit, follows).variances
    measured = columns[-1].stop - columns[-1].start
    sigmas = [*(leg.sigma for leg in legs), fit.problem.observation.sigma[:, :measured]]
    return legs, [
        np.maximum(variances[:, place], 0.0) / np.where(sigma > 0.0, sigma, np.inf) ** 2
        for place, sigma in zip(columns, sigmas, strict=True)
    ]
