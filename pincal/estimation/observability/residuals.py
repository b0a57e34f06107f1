"""Expected residuals of a fit, and tests of them for errors that a model lacks.

White rows ρ leave the residuals r = M ρ, M = 1 − H, H = J (JᵀJ)⁻¹ Jᵀ = Q Qᵀ with J = Q R: a
residual has the variance σ² (1 − h), where h is its leverage. The share of a measured quantity's
noise that remains is its redundancy number (W. Baarda, A testing procedure for use in geodetic
networks, 1968).
Conditions follow from white rows, e = −S ν = S Wᵀ r, which includes the effect of unknown poses.

An error b(n) of a measured quantity appears in the white rows as W = L⁻¹Nᵀ s b, where s is the
derivative of the conditions by that quantity. Its amplitudes to first order are −(Wᵀ M W)⁻¹ Wᵀ M r.
If the model lacks nothing, the part of χ² along M W is like any other: an F test without a new fit
(C. R. Rao's score test). It needs only sums over rows of WᵀW, QᵀW and Wᵀ M r:
Wᵀ M W = WᵀW − (QᵀW)ᵀ QᵀW.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np
from scipy.special import fdtrc

from pincal.estimation.fit import Fit
from pincal.estimation.observability.identifiable import NEGLIGIBLE, RANK_TOLERANCE
from pincal.estimation.problem import Linear, Problem
from pincal.kinematics.batches import least_squares, over_rows, product
from pincal.types import Array, Index

_MUCH = 0.25  # correlated χ² that remains, over the χ² of a step, above which it is no step
TAKEN = 1e-4  # share of an error's square outside the Jacobian's range, below which it is absorbed
_ALIKE = 1.75  # standard errors above which a correlation from row to row is significant


class LegResiduals(NamedTuple):
    """Residuals of one leg: k linear combinations c e of the conditions e at each pose."""

    value: Array
    """Residuals, shape (N, k)."""
    sigma: Array
    """Modelled standard deviations of the residuals, shape (N, k)."""
    unit: str
    """Unit: m for closures, else that of the readings."""
    quantity: str
    """``"closure"`` or ``"reading"``."""
    follows: Array
    """c, derivatives by the conditions at each pose, shape (N, k, n_conditions)."""


def leg_residuals(problem: Problem, linear: Linear, index: int) -> LegResiduals:
    """Return the residuals of a leg at each pose.

    Where poses are taken as measured, they are the leg's closures. Where poses are estimated, they
    are predicted minus measured readings; if readings are exact, the closures at the measured poses
    to first order.
    """
    block, count = problem.leg_block, len(linear.conditions)
    rows, readings = block.leg_rows[index], block.reading_columns[index]
    sigma, k, quantity = block.sigma[:, readings], block.widths[index], "closure"
    follows = np.zeros((count, k, linear.conditions.shape[1]))
    follows[:, :, rows] = np.eye(k)
    if problem.latent and sigma.any() and k == 1:
        quantity = "reading"
        follows = np.repeat(follows, sigma.shape[1], axis=1)  # one for each reading
        by_reading = linear.by_measured[:, rows, readings]
        follows[:, :, rows] = -least_squares(by_reading, np.ones((count, 1, 1)))
    else:
        if problem.latent:
            B = linear.by_pose[:, block.n_rows :]
            complete = problem.observation.measured.sum(axis=1) >= problem.platform.dof
            by_measured = np.where(complete[:, None, None], np.linalg.pinv(B, rcond=1e-9), 0.0)
            follows[:, :, block.n_rows :] = -linear.by_pose[:, rows] @ by_measured  # to that pose
        sigma = np.linalg.norm(follows @ linear.noise_root, axis=2)
    units = " or ".join(dict.fromkeys(problem.legs[index].reading_units))
    value = (follows @ linear.conditions[:, :, None])[:, :, 0]
    return LegResiduals(value, sigma, "m" if quantity == "closure" else units, quantity, follows)


def remaining_variances(fit: Fit, follows: Array) -> Array:
    """Return the variances, (N, q), of quantities c e after a fit, in their units squared.

    The estimate takes its own variance from that of rows of the fit, and adds it to that of others.
    ``follows`` is c, shape (N, q, k).
    """
    c = product(follows, fit.last.white.back)  # by the rows
    taken = product(c, fit.last.jacobian @ fit.root)
    sign = np.where(fit.good, -1.0, 1.0)[:, None]
    return np.asarray((c**2).sum(axis=2) + sign * (taken**2).sum(axis=2))


def redundancy(fit: Fit) -> tuple[list[LegResiduals], list[Array]]:
    """Return the residuals of legs, and redundancy numbers 1 − h, shape (N, q) each.

    Redundancy numbers are of each leg, then of the measurements of the platform; zero without
    noise.
    """
    problem, linear = fit.problem, fit.last
    legs = [leg_residuals(problem, linear, index) for index in range(len(problem.legs))]
    measured = np.eye(linear.conditions.shape[1])[problem.leg_block.n_rows :]
    observed = np.broadcast_to(measured, (len(linear.conditions), *measured.shape))
    parts = [(leg.follows, leg.sigma) for leg in legs]
    parts.append((observed, problem.observation.sigma[:, : observed.shape[1]]))
    return legs, [
        np.maximum(remaining_variances(fit, follows), 0.0)
        / np.where(sigma > 0.0, sigma, np.inf) ** 2
        for follows, sigma in parts
    ]


@dataclass(frozen=True)
class Amplitudes:
    """Amplitudes of f errors by the residuals of a fit, to first order."""

    values: Array
    """Amplitudes, shape (f,)."""
    std: Array
    """Standard errors, shape (f,); infinite where parameters absorb the error."""
    F: float
    """Mean square along the errors over the mean square of the remaining residuals."""
    rank: int
    """Degrees of freedom: directions that parameters do not absorb."""
    inside: float
    """χ² along the errors."""
    p_value: float
    """Probability of such an F or a larger one by chance."""


@dataclass(frozen=True)
class Residuals:
    """White residuals of good rows, and the range of their Jacobian."""

    used: Index
    """Indices of the good rows among the rows of the fit, shape (n_used,)."""
    left: Array
    """M r, shape (n_used, m)."""
    Q: Array
    """Orthonormal basis of the Jacobian's range, shape (n_used, m, n_free)."""
    chi2: float
    degrees_of_freedom: int

    @classmethod
    def of(cls, fit: Fit) -> Self:
        """Return the residuals of a fit."""
        left = fit.last.residuals[fit.good] - fit.Q @ fit.normal.c
        return cls(np.flatnonzero(fit.good), left, fit.Q, fit.normal.left, fit.degrees_of_freedom)

    def amplitudes(self, W: Array, least: float = NEGLIGIBLE**2) -> Amplitudes:
        """Return the amplitudes of errors with white rows W, shape (n_used, m, f).

        Combinations of which parameters absorb all but a share ``least`` of the square are omitted.
        """
        C, along, hidden = self._resolved(W, least)
        f, rank = C.shape
        if not 0 < rank < self.degrees_of_freedom:
            return Amplitudes(np.zeros(f), np.full(f, np.inf), 0.0, 0, 0.0, 1.0)
        inside, free = float(along @ along), self.degrees_of_freedom - rank
        noise = max(self.chi2 - inside, 1e-300) / free
        std = np.where(hidden, np.inf, np.sqrt(noise * (C**2).sum(axis=1)))
        F = inside / rank / noise
        return Amplitudes(-C @ along, std, F, rank, inside, float(fdtrc(rank, free, F)))

    def without(self, W: Array) -> Self:
        """Return the residuals after fitting errors with white rows W, shape (n_used, m, f)."""
        C, along, _ = self._resolved(W)
        U = W @ C - self.Q @ (over_rows(self.Q, W) @ C)
        return replace(
            self,
            left=self.left - U @ along,
            Q=np.concatenate((self.Q, U), axis=2),
            chi2=self.chi2 - float(along @ along),
            degrees_of_freedom=self.degrees_of_freedom - len(along),
        )

    def alike_after(self, W: Array, errors: Array) -> float:
        """Return the correlation of errors from row to row after fitting other errors W.

        Both are white rows, (n_used, m, f). It is 0 if not significant, or small beside W's χ².
        """
        remaining, lengths = self.without(W), np.sqrt((errors**2).sum(axis=1))
        along = np.einsum("nmf,nm->nf", errors, remaining.left)
        along /= np.where(lengths > 0.0, lengths, np.inf)
        lagged = float((along[1:] * along[:-1]).sum())
        correlation = lagged / max(float((along**2).sum()), 1e-300)
        clear = correlation * np.sqrt(along.size) > _ALIKE
        return correlation if clear and lagged > _MUCH * (self.chi2 - remaining.chi2) else 0.0

    def _resolved(self, W: Array, least: float = NEGLIGIBLE**2) -> tuple[Array, Array, Array]:
        """Return combinations C of errors, their χ components, and which errors are absorbed.

        C, shape (f, rank), makes M W C orthonormal; the components are (M W C)ᵀ r, shape (rank,);
        the mask, shape (f,), is of errors that parameters absorb at least in part.
        """
        gram, taken = over_rows(W, W), over_rows(self.Q, W)
        information, squares = gram - taken.T @ taken, np.diagonal(gram)
        along = over_rows(W, self.left[:, :, None])[:, 0]
        lengths = np.sqrt(np.where(squares > 0.0, squares, 1.0))
        s, V = np.linalg.eigh(information / np.outer(lengths, lengths))
        resolved = s > least
        C = V[:, resolved] / np.sqrt(s[resolved]) / lengths[:, None]
        hidden = (V[:, ~resolved] ** 2).sum(axis=1) > RANK_TOLERANCE
        return C, C.T @ along, hidden

    def step(self, W: Array) -> tuple[int, Array, Amplitudes]:
        """Return the first row after the most significant step of errors, and its amplitudes.

        The row is an index in the fit. Also return the white rows of the step, (n_used, m, f). The
        p-value is of such a step at any row.
        """
        turned = W.transpose(0, 2, 1)
        along = (turned @ self.left[:, :, None])[:, :, 0]
        after, squares, taken = (
            np.cumsum(rows[::-1], axis=0)[::-1][1:]
            for rows in (along, turned @ W, self.Q.transpose(0, 2, 1) @ W)
        )
        information = squares - taken.transpose(0, 2, 1) @ taken
        least = TAKEN * np.trace(squares, axis1=1, axis2=2)
        known = np.linalg.eigvalsh(information)[:, 0] > np.maximum(least, 1e-300)
        known[:1] = known[-1:] = False  # a step of a single row is an outlier
        places = np.flatnonzero(known)
        if not len(places):
            return 0, W, self.amplitudes(0.0 * W)
        sizes = np.linalg.solve(information[known], after[known][:, :, None])[:, :, 0]
        best = int(np.argmax(np.einsum("nf,nf->n", sizes, after[known])))
        row = int(self.used[places[best] + 1])
        after = W * (self.used >= row)[:, None, None]
        answer = self.amplitudes(after)
        return row, after, replace(answer, p_value=min(1.0, answer.p_value * len(places)))


def together(p_values: Array, weights: Array) -> float:
    """Return the combined p-value of tests that need not be independent.

    It is Cauchy's combination test (Y. Liu, J. Xie, J. Am. Stat. Assoc. 115, 2020), in which tests
    that agree strengthen each other. The weights of all tests that were made sum to 1; these may
    be some of them.
    """
    p = np.clip(p_values, 1e-300, 1.0 - weights)
    mean = float((weights / np.tan(np.pi * p)).sum())
    return float(0.5 - np.arctan(mean) / np.pi) if mean < 1e9 else 1.0 / (np.pi * mean)
