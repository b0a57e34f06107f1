"""How far residuals of a fit are to be expected: the noise, less what the fit takes up of it.

With white rows ρ of noise of variance V and the estimate δz = −B Σ s Jᵀ ρ (``Spread``), what is
left is r = ρ − J B Σ s Jᵀ ρ. Of least squares cov r = 1 − H, H = J (JᵀJ)⁻¹ Jᵀ = Q Qᵀ of J = Q R: a
residual has the variance σ² (1 − h), h its leverage. What is left of a measured quantity's own
noise is its redundancy number (W. Baarda, A testing procedure for use in geodetic networks, 1968).
Conditions follow from white rows, e = −S ν = S Wᵀ r, so that unknown poses take their part, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc, ndtr

from pincal.estimation.fit import Fit
from pincal.estimation.linear import Linear
from pincal.estimation.observability.indices import NEGLIGIBLE, RANK_TOLERANCE
from pincal.estimation.problem import Problem
from pincal.estimation.residuals.losses import UNLIKELY
from pincal.kinematics.batches import least_squares, product
from pincal.model.checks import ROUNDING
from pincal.types import Array


@dataclass(frozen=True)
class LegResiduals:
    """Residuals of one leg, k at a pose."""

    value: Array
    """Shape (N, k)."""
    sigma: Array
    """Their modelled standard deviations, shape (N, k)."""
    unit: str
    """m of closures, that of the readings otherwise."""
    quantity: str
    """``"closure"`` or ``"reading"``."""
    follows: Array
    """Derivatives by the conditions at each pose, shape (N, k, n_conditions)."""


def leg_residuals(problem: Problem, linear: Linear, index: int) -> LegResiduals:
    """Return what a leg misses at each pose.

    Poses as measured: its closure, or joint residual, there. Poses that were estimated: predicted
    less measured reading; of exact readings, which are missed by nothing, the closure at the pose
    that was measured (to first order), where it was.
    """
    demand = linear.demands[index]
    columns = problem.leg_block.reading_columns[index]
    unit = " or ".join(dict.fromkeys(problem.legs[index].reading_units))
    by_reading = demand.reading * problem.leg_block.sigma[:, None, columns]
    rows, (count, k) = problem.leg_block.leg_rows[index], demand.value.shape
    follows = np.zeros((count, k, linear.conditions.shape[1]))
    follows[:, :, rows] = np.eye(k)
    if problem.leg_block.pose_roots is not None:
        noise = np.concatenate((by_reading, demand.pose @ problem.leg_block.pose_roots), axis=2)
        unit_and_kind = ("m", "closure") if problem.weighted else (unit, "reading")
        return LegResiduals(demand.value, np.linalg.norm(noise, axis=2), *unit_and_kind, follows)
    if problem.leg_block.sigma[:, columns].any() and k == 1:
        sigma = problem.leg_block.sigma[:, columns]  # of as many readings as there are
        follows = np.repeat(follows, sigma.shape[1], axis=1)
        follows[:, :, rows] = -least_squares(demand.reading, np.ones((count, 1, 1)))
        value = demand.as_joint().value
        return LegResiduals(value, sigma, unit, "reading", follows)
    n_legs = problem.leg_block.n_rows
    h, B = linear.conditions[:, n_legs:], linear.by_pose[:, n_legs:]
    complete = problem.observation.measured.sum(axis=1) >= problem.platform.dof
    pose_by_measured = np.where(complete[:, None, None], np.linalg.pinv(B, rcond=1e-9), 0.0)
    moved = demand.pose @ pose_by_measured  # from what was measured to the estimated pose
    noise = np.concatenate((by_reading, moved @ problem.observation.noise.roots), axis=2)
    value = demand.value - (moved @ h[:, :, None])[:, :, 0]
    follows[:, :, n_legs:] = -moved
    return LegResiduals(value, np.linalg.norm(noise, axis=2), "m", "closure", follows)


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
        """Return what a fit leaves of quantities.

        Args:
            fit: The fit.
            follows: c, derivatives of the quantities by the conditions, shape (N, q, k).
        """
        system, linear, spread = fit.system, fit.last, fit.spread
        by_free, parts = system.unknowns.map @ spread.root, []
        for poses in linear.parts():
            J, c, S = (
                system.derivatives(linear, poses) @ by_free,
                follows[poses],
                linear.white.noise,
            )
            noise = through = product(c, S[poses])
            if system.problem.weighted:
                W = linear.white.by_noise[poses]
                noise = through = c = product(noise, W.transpose(0, 2, 1))
            else:
                c = c * system.unit
                through = product(noise, S[poses].transpose(0, 2, 1)) / system.unit
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
    ends = np.cumsum([rows.shape[1] for rows in parts]).tolist()
    columns = [slice(end - rows.shape[1], end) for rows, end in zip(parts, ends, strict=True)]
    return legs, np.concatenate(parts, axis=1), columns


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


_HALVINGS = int(np.ceil(-np.log2(ROUNDING)))  # of the interval in which a saddle point lies


@dataclass(frozen=True)
class ResidualForm:
    """What residuals say of errors: how much of them could be seen, and what is."""

    weights: Array
    """Eigenvalues of Wᵀ M W, shape (f,), the largest last."""
    inside: float
    """|Wᵀ M r|²."""
    length: float
    """Tr WᵀW: what there would be to see if parameters took up nothing."""

    @property
    def seen(self) -> bool:
        """Whether parameters leave anything of these errors."""
        return bool(self.weights[-1] > NEGLIGIBLE**2 * self.length > 0.0)


def of_forms(forms: Sequence[ResidualForm], chi2: float, degrees_of_freedom: int) -> Array:
    """Return the probability of so much along errors, or more, of each form; 1 if nothing is seen.

    Args:
        forms: Of different errors.
        chi2: Of all residuals.
        degrees_of_freedom: Of them.
    """
    probabilities = np.ones(len(forms))
    known = [
        i for i, form in enumerate(forms) if form.seen and len(form.weights) < degrees_of_freedom
    ]
    if not known or not chi2 > 0.0:
        return probabilities
    weights = np.zeros((len(known), max(len(forms[i].weights) for i in known)))
    for row, i in zip(weights, known, strict=True):
        eigenvalues = forms[i].weights
        row[: len(eigenvalues)] = eigenvalues.clip(0.0) / eigenvalues[-1]
    shares = np.array([forms[i].inside / forms[i].weights[-1] for i in known]) / chi2
    probabilities[known] = above(weights, shares.clip(0.0, 1.0), degrees_of_freedom)
    return probabilities


def above(weights: Array, shares: Array, degrees_of_freedom: int) -> Array:
    """Return the probability that a weighted sum of squares is above a share of all squares.

    Σ λᵢ zᵢ² > t Σ zⱼ² of independent normal numbers z, i to k and j to all degrees of freedom.

    Args:
        weights: λ, 0 to 1 with a 1 among them, shape (M, k).
        shares: t, 0 to 1, shape (M,).
        degrees_of_freedom: More than k.
    """
    n_other = degrees_of_freedom - weights.shape[1]
    single = (weights > RANK_TOLERANCE).sum(axis=1) == 1
    t = np.clip(shares, RANK_TOLERANCE, 1.0 - RANK_TOLERANCE)[:, None]
    c = np.concatenate((weights - t, -t), axis=1)
    count = np.append(np.ones(weights.shape[1]), n_other)
    low, high = -0.5 / t, 0.5 / (1.0 - t)
    for _ in range(_HALVINGS):
        saddle = 0.5 * (low + high)
        rising = (count * c / (1.0 - 2.0 * saddle * c)).sum(axis=1, keepdims=True) > 0.0
        low, high = np.where(rising, low, saddle), np.where(rising, saddle, high)
    saddle = 0.5 * (low + high)
    factors = 1.0 - 2.0 * saddle * c
    K = -0.5 * (count * np.log(factors)).sum(axis=1)
    bend = 2.0 * (count * (c / factors) ** 2).sum(axis=1)
    w, v = np.sign(saddle[:, 0]) * np.sqrt((-2.0 * K).clip(0.0)), saddle[:, 0] * np.sqrt(bend)
    flat = np.abs(w) < UNLIKELY  # so near to the mean it is a half
    w, v = np.where(flat, 1.0, w), np.where(flat, 1.0, v)
    tail = np.where(flat, 0.5, ndtr(-(w + np.log(v / w) / w)))
    free = degrees_of_freedom - 1
    exact = fdtrc(1, free, free * t[:, 0] / (1.0 - t[:, 0]))  # of one square
    return np.where(single, exact, tail)


def together(p_values: Array, weights: Array) -> float:
    """Return the probability that tests, which need not be independent, find so much by chance.

    By Cauchy's distribution: the mean of 1/p but for what all tests are when nothing is there
    (Y. Liu, J. Xie, J. Am. Stat. Assoc. 115, 2020). Tests that agree strengthen each other.

    Args:
        p_values: Of some tests, shape (k,).
        weights: Of these tests; of all that were made they sum to 1, shape (k,).
    """
    p = np.clip(p_values, 1e-300, 1.0 - weights)
    mean = float((weights / np.tan(np.pi * p)).sum())
    return float(0.5 - np.arctan(mean) / np.pi) if mean < 1e9 else 1.0 / (np.pi * mean)
