"""What residuals of a fit are to be expected, and what they say of errors that a model lacks.

With white rows ρ and the estimate δz = −B Σ s Jᵀ ρ (``Spread``), what is left is r = ρ − J B Σ s
Jᵀ ρ. Of least squares cov r = M = 1 − H, H = J (JᵀJ)⁻¹ Jᵀ = Q Qᵀ of J = Q R: a residual has the
variance σ² (1 − h), h its leverage. What is left of a measured quantity's own
noise is its redundancy number (W. Baarda, A testing procedure for use in geodetic networks, 1968).
Conditions follow from white rows, e = −S ν = S Wᵀ r, so that unknown poses take their part, too.

An error b(n) of one measured quantity appears in the white rows as W = L⁻¹Nᵀ s b, s how the
conditions follow that quantity. Residuals ask for the amplitudes −(Wᵀ M W)⁻¹ Wᵀ M r, and the part
of χ² that lies along M W is, if the model lacks nothing, a share like any other: an F test without
a new fit (C. R. Rao's score test). Only sums over rows of WᵀW, QᵀW and Wᵀ M r are needed:
Wᵀ M W = WᵀW − (QᵀW)ᵀ QᵀW.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc, ndtr

from pincal.estimation.fit import Fit
from pincal.estimation.legs import slices
from pincal.estimation.observability.indices import NEGLIGIBLE, RANK_TOLERANCE
from pincal.estimation.problem import Linear, Problem
from pincal.estimation.system import UNLIKELY
from pincal.kinematics.batches import least_squares, over_rows, product
from pincal.model.checks import ROUNDING
from pincal.types import Array, Index


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
        """Return what a fit leaves of quantities; c is how they follow conditions, (N, q, k)."""
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


_HALVINGS = int(np.ceil(-np.log2(ROUNDING)))  # of the interval in which a saddle point lies


@dataclass(frozen=True)
class Amplitudes:
    """What residuals say of terms, to first order."""

    values: Array
    """Shape (f,)."""
    std: Array
    """Standard errors, shape (f,); infinite where parameters take the term up."""
    F: float
    """χ² along the terms by its degrees of freedom, over that of the rest."""
    rank: int
    """Degrees of freedom: directions that parameters do not take up."""
    inside: float
    """χ² along the terms."""
    p_value: float
    """Of so much, or more, by chance."""


@dataclass(frozen=True)
class Change:
    """The clearest step of some errors, from one row on."""

    p_value: float
    """Of such a step anywhere, by chance."""
    row: int
    """The first row after it, among those of the fit."""
    size: Array
    """How large the errors are after it, shape (f,)."""
    inside: float
    """χ² that it takes off."""


@dataclass(frozen=True)
class ErrorRows:
    """ErrorRows of measured quantities that are 1 in each row, as white rows see them."""

    white: Array
    """W, shape (n_used, m, f)."""
    taken: Array
    """Qᵀ W of each row, shape (n_used, n_free, f)."""
    along: Array
    """Wᵀ M r of each row, shape (n_used, f)."""

    def part(self, columns: Sequence[int]) -> ErrorRows:
        """Return some of the errors."""
        chosen = list(columns)
        return ErrorRows(self.white[:, :, chosen], self.taken[:, :, chosen], self.along[:, chosen])


@dataclass(frozen=True)
class ResidualForm:
    """What residuals say of errors with amplitudes as large as each other."""

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


@dataclass(frozen=True)
class Residuals:
    """White residuals of rows that count, and what parameters take up there."""

    used: Index
    """Rows that count, among those of the fit, shape (n_used,)."""
    left: Array
    """M r, shape (n_used, m)."""
    Q: Array
    """Orthonormal columns that parameters span, shape (n_used, m, n_free)."""
    chi2: float
    degrees_of_freedom: int

    @classmethod
    def of(cls, fit: Fit) -> Residuals:
        """Return those of a fit."""
        left = fit.last.residuals[fit.good] - fit.Q @ fit.normal.c
        rows = np.flatnonzero(fit.good)
        return cls(rows, left, fit.Q, fit.normal.left, fit.degrees_of_freedom)

    def errors(self, W: Array) -> ErrorRows:
        """Return errors by their white rows, shape (n_used, m, f)."""
        along = (W.transpose(0, 2, 1) @ self.left[:, :, None])[:, :, 0]
        return ErrorRows(W, self.Q.transpose(0, 2, 1) @ W, along)

    def chance(self, inside: float, rank: int) -> float:
        """Return the probability of a part of χ² of some rank, or of a larger one."""
        free = self.degrees_of_freedom - rank
        ratio = inside / rank / (max(self.chi2 - inside, 1e-300) / free)
        return float(fdtrc(rank, free, ratio))

    def form(
        self, errors: ErrorRows, courses: Sequence[Array], *, common: bool = False
    ) -> ResidualForm:
        """Return what residuals say of errors with amplitudes as large as each other.

        Each error is larger or less by its courses b, shape (n_used, f), with amplitudes of its own
        or common to all. White rows and courses are never multiplied out: W_n = w_n b_nᵀ, so WᵀW =
        Σ |w_n|² b_n b_nᵀ.
        """
        k, W = len(courses), errors.white
        squares, B = W.transpose(0, 2, 1) @ W, np.concatenate(courses, axis=1)
        owner = np.repeat(np.arange(k), [b.shape[1] for b in courses])
        gram = np.concatenate([b.T @ (squares[:, i, owner] * B) for i, b in enumerate(courses)])
        taken = np.hstack([errors.taken[:, :, i].T @ b for i, b in enumerate(courses)])
        along = np.hstack([errors.along[:, i] @ b for i, b in enumerate(courses)])
        if common:
            gram = gram.reshape(k, -1, k, len(gram) // k).sum(axis=(0, 2))
            taken = taken.reshape(len(taken), k, -1).sum(axis=1)
            along = along.reshape(k, -1).sum(axis=0)
        values = np.asarray(np.linalg.eigvalsh(gram - taken.T @ taken), np.float64)
        return ResidualForm(values, float(along @ along), float(np.trace(gram)))

    def chances(self, forms: Sequence[ResidualForm]) -> Array:
        """Return the probability of so much along errors, or more, of each form."""
        return of_forms(forms, self.chi2, self.degrees_of_freedom)

    def amplitudes(self, W: Array) -> Amplitudes:
        """Return the amplitudes of terms that residuals ask for, by white rows (n_used, m, f)."""
        C, along, hidden = self._resolved(W)
        f, rank = C.shape
        if not 0 < rank < self.degrees_of_freedom:
            return Amplitudes(np.zeros(f), np.full(f, np.inf), 0.0, 0, 0.0, 1.0)
        inside = float(along @ along)
        noise = max(self.chi2 - inside, 1e-300) / (self.degrees_of_freedom - rank)
        std = np.where(hidden, np.inf, np.sqrt(noise * (C**2).sum(axis=1)))
        p_value = self.chance(inside, rank)
        return Amplitudes(-C @ along, std, inside / rank / noise, rank, inside, p_value)

    def without(self, W: Array) -> Residuals:
        """Return the residuals with errors of white rows W taken up, shape (n_used, m, f)."""
        C, along, _ = self._resolved(W)
        U = W @ C - self.Q @ (over_rows(self.Q, W) @ C)
        return Residuals(
            self.used,
            self.left - U @ along,
            np.concatenate((self.Q, U), axis=2),
            self.chi2 - float(along @ along),
            self.degrees_of_freedom - len(along),
        )

    def _resolved(self, W: Array) -> tuple[Array, Array, Array]:
        """Return combinations C of errors, and what residuals say of them.

        C makes M W C orthonormal, shape (f, rank); then (M W C)ᵀ r, shape (rank,), and which errors
        parameters take up in part, shape (f,).
        """
        gram, taken = over_rows(W, W), over_rows(self.Q, W)
        lengths = np.sqrt(np.diagonal(gram))
        lengths = np.where(lengths > 0.0, lengths, 1.0)
        s, V = np.linalg.eigh((gram - taken.T @ taken) / np.outer(lengths, lengths))
        resolved = s > NEGLIGIBLE**2
        C = V[:, resolved] / np.sqrt(s[resolved]) / lengths[:, None]
        hidden = (V[:, ~resolved] ** 2).sum(axis=1) > RANK_TOLERANCE
        return C, C.T @ over_rows(W, self.left[:, :, None])[:, 0], hidden

    def size(self, error: ErrorRows, course: Array) -> float:
        """Return how large one error of some course is, shape (n_used,)."""
        taken = course @ error.taken[:, :, 0]
        squares = (error.white**2).sum(axis=(1, 2))
        information = float(course**2 @ squares - taken @ taken)
        return float(course @ error.along[:, 0]) / information if information > 0.0 else 0.0

    def step(self, errors: ErrorRows) -> Change:
        """Return the clearest step of f errors at once, from one row on."""
        f, gram = errors.white.shape[2], errors.white.transpose(0, 2, 1) @ errors.white
        none = Change(1.0, 0, np.zeros(f), 0.0)
        if len(gram) < 2 or self.degrees_of_freedom <= f:
            return none
        after, squares, taken = (
            np.cumsum(rows[::-1], axis=0)[::-1][1:] for rows in (errors.along, gram, errors.taken)
        )
        lengths = squares - taken.transpose(0, 2, 1) @ taken
        least = RANK_TOLERANCE * max(float(np.trace(squares[0])), 1e-300)
        known = np.linalg.eigvalsh(lengths)[:, 0] > least
        known[:1] = known[-1:] = False  # a row of its own is an outlier
        places = np.flatnonzero(known)
        if not len(places):
            return none
        sizes = np.linalg.solve(lengths[known], after[known][:, :, None])[:, :, 0]
        inside = np.einsum("nf,nf->n", sizes, after[known])
        best = int(np.argmax(inside))
        chance = min(1.0, self.chance(float(inside[best]), f) * len(places))
        row = int(self.used[places[best] + 1])
        return Change(chance, row, sizes[best], float(inside[best]))


def of_forms(forms: Sequence[ResidualForm], chi2: float, degrees_of_freedom: int) -> Array:
    """Return the probability of so much along errors, or more, of each form; 1 if nothing is seen.

    χ² and degrees of freedom are those of all residuals.
    """
    probabilities = np.ones(len(forms))
    seen = [form.seen and len(form.weights) < degrees_of_freedom for form in forms]
    known = np.flatnonzero(seen).tolist()
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

    Σ λᵢ zᵢ² > t Σ zⱼ² of independent normal numbers z, i to k and j to all degrees of freedom, by
    the saddle point (R. Lugannani and S. Rice 1980). Weights λ, shape (M, k), are 0 to 1 with a 1
    among them, shares t, shape (M,), are 0 to 1.
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
    (Y. Liu, J. Xie, J. Am. Stat. Assoc. 115, 2020). Tests that agree strengthen each other. Weights
    of all tests that were made sum to 1; these may be some of them.
    """
    p = np.clip(p_values, 1e-300, 1.0 - weights)
    mean = float((weights / np.tan(np.pi * p)).sum())
    return float(0.5 - np.arctan(mean) / np.pi) if mean < 1e9 else 1.0 / (np.pi * mean)
