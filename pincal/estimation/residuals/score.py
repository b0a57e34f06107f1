"""What a model lacks, seen in its residuals: score tests of terms, and steps from one row on.

An error b(n) of one measured quantity appears in the white rows as w = L⁻¹Nᵀ s b, s how the
conditions follow that quantity. With M the projection on what parameters do not take up, the part
of the residuals that lies in M w is, if the model lacks nothing, a share of χ² like any other: an F
test without a new fit (C. R. Rao's score test). Priors are rows too, in which no error appears.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from pincal.estimation.fit import Fit
from pincal.estimation.linear import left_over
from pincal.estimation.observability.indices import RANK_TOLERANCE
from pincal.estimation.residuals.redundancy import ResidualForm
from pincal.kinematics.batches import over_rows
from pincal.types import Array, Index


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
class Error:
    """The error of a measured quantity that is 1 in each row, as white rows see it."""

    white: Array
    """w, shape (n_used, m)."""
    taken: Array
    """Qᵀ w of each row, shape (n_used, n_free)."""
    along: Array
    """wᵀ M r of each row, shape (n_used,)."""

    def __add__(self, second: Error) -> Error:
        """Return both errors at once."""
        return Error(
            self.white + second.white, self.taken + second.taken, self.along + second.along
        )


@dataclass(frozen=True)
class Residuals:
    """White residuals and derivatives of rows that count, flat; parameters projected out."""

    used: Index
    left: Array
    """M r, shape (n_used, m)."""
    Q: Array
    """Shape (n_used, m, n_free)."""
    prior: Array
    """Rows of Q that are the priors', shape (k, n_free)."""
    beside: Array
    """M r of the priors, shape (k,): they are measurements, too."""
    chi2: float
    degrees_of_freedom: int

    @classmethod
    def of(cls, fit: Fit) -> Residuals:
        """Return those of a fit."""
        used, Q, r = np.flatnonzero(fit.good), fit.Q, fit.last.residuals[fit.good]
        held, rows = fit.unknowns.prior_rows(fit.system.values(fit.last.state))
        prior = fit.orthonormal(rows)
        projected, projected_prior = left_over(Q, r, prior, held)
        chi2 = float((projected**2).sum() + (projected_prior**2).sum())
        return cls(used, projected, Q, prior, projected_prior, chi2, fit.degrees_of_freedom)

    def error(self, w: Array) -> Error:
        """Return an error of white rows of shape (n_used, m)."""
        along = np.einsum("nm,nm->n", w, self.left)
        return Error(w, (w[:, None] @ self.Q)[:, 0], along)

    def chance(self, inside: Array | float, rank: int) -> Array:
        """Return the probability of a part of χ² of some rank, or of a larger one."""
        free = self.degrees_of_freedom - rank
        ratio = inside / rank / (np.maximum(self.chi2 - inside, 1e-300) / free)
        return np.asarray(fdtrc(rank, free, ratio))

    def form(self, *errors: tuple[Error, Array], common: bool = False) -> ResidualForm:
        """Return what residuals say of errors with amplitudes as large as each other.

        White rows and courses are never multiplied out: W_n = w_n b_nᵀ, so WᵀW = Σ |w_n|² b_n b_nᵀ.

        Args:
            errors: Each with its courses b, by which it is larger or less, shape (n_used, f).
            common: Whether amplitudes are the same in all of them, not each one's own.
        """
        W = np.stack([error.white for error, _ in errors], axis=1)
        squares = W @ W.transpose(0, 2, 1)
        B = np.concatenate([b for _, b in errors], axis=1)
        owner = np.repeat(np.arange(len(errors)), [b.shape[1] for _, b in errors])
        gram = np.concatenate([b.T @ (squares[:, k, owner] * B) for k, (_, b) in enumerate(errors)])
        hidden = np.concatenate([error.taken.T @ b for error, b in errors], axis=1)
        inside = np.concatenate([error.along @ b for error, b in errors])
        if common:
            k = len(errors)
            gram = gram.reshape(k, -1, k, gram.shape[1] // k).sum(axis=(0, 2))
            hidden, inside = (
                hidden.reshape(len(hidden), k, -1).sum(axis=1),
                inside.reshape(k, -1).sum(axis=0),
            )
        values = np.asarray(np.linalg.eigvalsh(gram - hidden.T @ hidden), np.float64)
        return ResidualForm(values, float(inside @ inside), float(np.trace(gram)))

    def amplitudes(self, W: Array) -> Amplitudes:
        """Return the amplitudes that residuals ask for along the white rows of terms.

        Args:
            W: Of each term, shape (n_used, m, f).
        """
        lengths = np.linalg.norm(W, axis=(0, 1))
        lengths = np.where(lengths > 0.0, lengths, 1.0)
        U, s, V = np.linalg.svd(self._seen(W / lengths), full_matrices=False)
        resolved = s > RANK_TOLERANCE
        rank = int(resolved.sum())
        if not 0 < rank < self.degrees_of_freedom:
            none = np.full(W.shape[2], np.inf)
            return Amplitudes(np.zeros(W.shape[2]), none, 0.0, 0, 0.0, 1.0)
        along = U[:, resolved].T @ self._whole
        inside = float(along @ along)
        noise = max(self.chi2 - inside, 1e-300) / (self.degrees_of_freedom - rank)
        by_direction = V[resolved].T / s[resolved] / lengths[:, None]
        taken = (V[~resolved] ** 2).sum(axis=0) > RANK_TOLERANCE  # along what geometry takes up
        std = np.where(taken, np.inf, np.sqrt(noise * (by_direction**2).sum(axis=1)))
        p_value = float(self.chance(inside, rank))
        return Amplitudes(-by_direction @ along, std, inside / rank / noise, rank, inside, p_value)

    def size(self, error: Error, course: Array) -> float:
        """Return how large an error of some course is, shape (n_used,)."""
        taken = course @ error.taken
        information = float(course**2 @ (error.white**2).sum(axis=1) - taken @ taken)
        return float(course @ error.along) / information if information > 0.0 else 0.0

    def step(self, error: Error) -> tuple[float, int, float]:
        """Return the probability of the clearest step anywhere, its first row and its size."""
        squares = (error.white**2).sum(axis=1)[:, None, None]
        change = self._change(squares, error.taken[:, :, None], error.along[:, None])
        return change.p_value, change.row, float(change.size[0])

    def change(self, W: Array) -> Change:
        """Return the clearest step of several errors at once, from one row on.

        Args:
            W: White rows of the unit errors, shape (n_used, m, f).
        """
        transposed = W.transpose(0, 2, 1)
        taken = self.Q.transpose(0, 2, 1) @ W
        return self._change(transposed @ W, taken, (transposed @ self.left[:, :, None])[:, :, 0])

    def _change(self, gram: Array, taken_up: Array, along: Array) -> Change:
        """Return the clearest step by WᵀW, QᵀW and Wᵀ M r of each row."""
        f = gram.shape[2]
        none = Change(1.0, 0, np.zeros(f), 0.0)
        if len(gram) < 2 or self.degrees_of_freedom <= f:
            return none
        after, squares, taken = (
            np.cumsum(rows[::-1], axis=0)[::-1][1:] for rows in (along, gram, taken_up)
        )
        lengths = squares - taken.transpose(0, 2, 1) @ taken
        least = RANK_TOLERANCE * max(float(np.trace(squares[0])), 1e-300)
        known = np.linalg.eigvalsh(lengths)[:, 0] > least
        known[:1] = known[-1:] = False  # a row of its own is an outlier
        if not known.any():
            return none
        places = np.flatnonzero(known)
        sizes = np.linalg.solve(lengths[known], after[known][:, :, None])[:, :, 0]
        inside = np.einsum("nf,nf->n", sizes, after[known])
        best = int(np.argmax(inside))
        chance = min(1.0, float(self.chance(float(inside[best]), f)) * len(places))
        row = int(self.used[places[best] + 1])
        return Change(chance, row, sizes[best], float(inside[best]))

    def without(self, W: Array) -> Residuals:
        """Return the residuals with errors of white rows W taken up, shape (n_used, m, f)."""
        lengths = np.linalg.norm(W, axis=(0, 1))
        U, s, _ = np.linalg.svd(
            self._seen(W / np.where(lengths > 0.0, lengths, 1.0)), full_matrices=False
        )
        U = U[:, s > RANK_TOLERANCE]  # that parameters do not take up
        projected, size = self._whole - U @ (U.T @ self._whole), self.left.size
        rows, prior_rows = projected[:size].reshape(self.left.shape), projected[size:]
        Q = np.concatenate((self.Q, U[:size].reshape(*self.left.shape, -1)), axis=2)
        prior = np.concatenate((self.prior, U[size:]), axis=1)
        free = self.degrees_of_freedom - U.shape[1]
        chi2 = float((projected**2).sum())
        return Residuals(self.used, rows, Q, prior, prior_rows, chi2, free)

    @property
    def _whole(self) -> Array:
        """What is left of rows and of priors, flat."""
        return np.concatenate((self.left.ravel(), self.beside))

    def _seen(self, W: Array) -> Array:
        """Return what parameters leave of white rows W, of priors too, in as many rows, flat."""
        taken = over_rows(self.Q, W)
        rows = (W - self.Q @ taken).reshape(-1, W.shape[2])
        return np.concatenate((rows, -self.prior @ taken))
