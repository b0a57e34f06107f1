"""What a model lacks, seen in its residuals: score tests of terms, and steps from one row on.

An error b(n) of one measured quantity appears in the white rows as w = L⁻¹Nᵀ s b, s how the
conditions follow that quantity. With M the projection on what parameters do not take up, the part
of the residuals that lies in M w is, if the model lacks nothing, a share of χ² like any other: an F
test without a new fit (C. R. Rao's score test).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from pincal.estimation.fit import Fit
from pincal.estimation.linear import Orthonormal
from pincal.estimation.observability.indices import RANK_TOLERANCE
from pincal.estimation.residuals.chances import Form
from pincal.kinematics.batches import over_rows

Array = NDArray[np.float64]


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
class Residuals:
    """White residuals and derivatives of rows that count, flat; parameters projected out."""

    used: NDArray[np.intp]
    left: Array
    """M r, shape (n_used, m)."""
    Q: Array
    """Shape (n_used, m, n_free)."""
    chi2: float
    degrees_of_freedom: int

    @classmethod
    def of(cls, one: Fit) -> Residuals:
        """Return those of a fit."""
        used = np.flatnonzero(one.good)
        r, J = one.last.value[used], one.last.jacobian[used] @ one.unknowns.map
        _, prior = one.unknowns.prior_rows(one.unknowns.start)
        Q = Orthonormal.of(J, prior)(J)
        left = r - Q @ np.einsum("nmi,nm->i", Q, r)
        return cls(used, left, Q, float((left**2).sum()), one.degrees_of_freedom)

    def chance(self, inside: Array | float, rank: int) -> Array:
        """Return the probability of a part of χ² of some rank, or of a larger one."""
        free = self.degrees_of_freedom - rank
        ratio = inside / rank / (np.maximum(self.chi2 - inside, 1e-300) / free)
        return np.asarray(fdtrc(rank, free, ratio))

    def form(self, W: Array) -> Form:
        """Return what residuals say of errors with amplitudes as large as each other.

        Args:
            W: White rows of the unit errors, shape (n_used, m, f).
        """
        flat, Q = W.reshape(-1, W.shape[2]), self.Q.reshape(-1, self.Q.shape[2])
        length = float((flat**2).sum())
        flat = flat - Q @ (Q.T @ flat)
        inside = float(((flat.T @ self.left.ravel()) ** 2).sum())
        return Form(np.asarray(np.linalg.eigvalsh(flat.T @ flat), np.float64), inside, length)

    def amplitudes(self, W: Array) -> Amplitudes:
        """Return the amplitudes that residuals ask for along the white rows of terms.

        Args:
            W: Of each term, shape (n_used, m, f).
        """
        lengths = np.linalg.norm(W, axis=(0, 1))
        lengths = np.where(lengths > 0.0, lengths, 1.0)
        flat = (W - self.Q @ over_rows(self.Q, W)).reshape(-1, W.shape[2]) / lengths
        U, s, V = np.linalg.svd(flat, full_matrices=False)
        kept = s > RANK_TOLERANCE
        rank = int(kept.sum())
        if not 0 < rank < self.degrees_of_freedom:
            none = np.full(W.shape[2], np.inf)
            return Amplitudes(np.zeros(W.shape[2]), none, 0.0, 0, 0.0, 1.0)
        along = U[:, kept].T @ self.left.ravel()
        inside = float(along @ along)
        rest = max(self.chi2 - inside, 1e-300) / (self.degrees_of_freedom - rank)
        back = V[kept].T / s[kept] / lengths[:, None]
        taken = (V[~kept] ** 2).sum(axis=0) > RANK_TOLERANCE  # along what geometry takes up
        std = np.where(taken, np.inf, np.sqrt(rest * (back**2).sum(axis=1)))
        p_value = float(self.chance(inside, rank))
        return Amplitudes(-back @ along, std, inside / rank / rest, rank, inside, p_value)

    def along(self, W: Array) -> Array:
        """Return orthonormal directions of terms that parameters do not take up.

        Args:
            W: White rows of the terms, shape (n_used, m, f).

        Returns:
            Shape (n_used m, rank).
        """
        flat, Q = W.reshape(-1, W.shape[2]), self.Q.reshape(-1, self.Q.shape[2])
        lengths = np.linalg.norm(flat, axis=0)
        flat = flat / np.where(lengths > 0.0, lengths, 1.0)
        U, s, _ = np.linalg.svd(flat - Q @ (Q.T @ flat), full_matrices=False)
        return np.asarray(U[:, s > RANK_TOLERANCE], np.float64)

    def size(self, w: Array) -> float:
        """Return how large an error is that has these white rows if it is 1, shape (n_used, m)."""
        taken = np.einsum("nmi,nm->i", self.Q, w)
        length = float((w**2).sum() - (taken**2).sum())
        return float((w * self.left).sum() / length) if length > 0.0 else 0.0

    def step(self, w: Array) -> tuple[float, int, float]:
        """Return the probability of the clearest step anywhere, its first row and its size."""
        found = self.change(w[:, :, None])
        return found.p_value, found.row, float(found.size[0])

    def change(self, W: Array) -> Change:
        """Return the clearest step of several errors at once, from one row on.

        Args:
            W: White rows of the unit errors, shape (n_used, m, f).
        """
        f = W.shape[2]
        none = Change(1.0, 0, np.zeros(f), 0.0)
        if len(W) < 2 or self.degrees_of_freedom <= f:
            return none
        own = np.einsum("nmf,nmg->nfg", W, W)
        by = np.einsum("nmi,nmf->nif", self.Q, W)
        along = np.einsum("nmf,nm->nf", W, self.left)
        after, squares, taken = (np.cumsum(one[::-1], axis=0)[::-1][1:] for one in (along, own, by))
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
        U, Q = self.along(W), self.Q.reshape(-1, self.Q.shape[2])
        left = self.left - (U @ (U.T @ self.left.ravel())).reshape(self.left.shape)
        every = np.concatenate((Q, U), axis=1).reshape(*self.left.shape, -1)
        free = self.degrees_of_freedom - U.shape[1]
        return Residuals(self.used, left, every, float((left**2).sum()), free)
