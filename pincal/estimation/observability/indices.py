"""How well rows of an identification Jacobian determine the parameters.

Observability indices from singular values, the diagonal of R in C = Q R, and rank, with
the groups of parameters that are not identifiable one by one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from pincal.model.checks import ROUNDING
from pincal.words.wording import group_in_words

Array = NDArray[np.float64]
RANK_TOLERANCE = 1e-9
"""Of the largest singular value, columns of unit length, below which a direction is lost."""
NEGLIGIBLE = 1e-6
"""Of a direction, below which a parameter, or a motion, takes no part in it."""


@dataclass(frozen=True)
class Indices:
    """Observability indices of a set of poses (Sun and Hollerbach 2008), from singular values s."""

    O1: float
    """(s₁ … sₙ)^(1/n) / √m for m rows (Borm and Menq)."""
    O1_per_parameter: float
    """(s₁ … sₙ)^(1/n) / n, as the papers print it (3-RRR paper, Eq. 13)."""
    O2: float
    """sₙ / s₁."""
    O3: float
    """sₙ."""
    O4: float
    """sₙ² / s₁."""
    O5: float
    """1 / Σ 1/sᵢ."""


def indices(C: Array) -> Indices:
    """Return the observability indices of an identification Jacobian, shape (m, n).

    Singular values carry the units of the columns; compare sets of poses with them, not
    mechanisms.

    Args:
        C: Identification Jacobian, shape (m, n).

    Example:
        >>> import numpy as np, pincal
        >>> found = pincal.indices(np.diag([4.0, 1.0]))
        >>> round(float(found.O2), 6)  # least over greatest singular value
        0.25
    """
    m, n = C.shape
    s = np.linalg.svd(C, compute_uv=False)
    if m < n or s[-1] == 0.0:
        return Indices(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    mean = float(np.exp(np.log(s).mean()))
    return Indices(
        O1=mean / np.sqrt(m),
        O1_per_parameter=mean / n,
        O2=float(s[-1] / s[0]),
        O3=float(s[-1]),
        O4=float(s[-1] ** 2 / s[0]),
        O5=float(1.0 / (1.0 / s).sum()),
    )


def r_diagonal(C: Array) -> Array:
    """Return |R_ii| of C = Q R, shape (n,): the observability of each parameter (Eq. 9).

    A parameter's value says what it adds to those before it; zero is not observable.
    """
    R = np.linalg.qr(C, mode="r")
    diagonal = np.zeros(C.shape[1])
    found = np.abs(np.diagonal(R))
    diagonal[: len(found)] = found
    return diagonal


def scaled_axes(J: Array) -> tuple[Array, Array, Array]:
    """Return lengths of columns, singular values and right axes of J, columns of unit length.

    Shapes (n,), (min(m, n),) and (n, n), axes in rows; the length of a column of zeros counts as 1.

    Args:
        J: Shape (m, n).
    """
    lengths = np.linalg.norm(J, axis=0)
    lengths[lengths == 0.0] = 1.0
    _, s, axes = np.linalg.svd(np.linalg.qr(J / lengths, mode="r"), full_matrices=True)
    return lengths, s, axes


@dataclass(frozen=True)
class Identifiability:
    """Rank of an identification Jacobian, and the parameters that it does not determine."""

    rank: int
    n_params: int
    condition: float
    """Condition number, columns scaled to unit length; of what is determined where rank is lost."""
    groups: tuple[tuple[str, ...], ...]
    """Ids of parameters that move together, one group for each lost rank."""

    @property
    def complete(self) -> bool:
        """Whether every parameter is determined."""
        return self.rank == self.n_params

    def describe(self) -> str:
        """Return what is not determined: ``leg_2.l and leg_2.L move together``."""
        return "; ".join(map(group_in_words, self.groups))

    def __str__(self) -> str:
        start = f"rank {self.rank} of {self.n_params}, condition {self.condition:.3g}"
        return "\n".join((start, *map(group_in_words, self.groups)))


def identifiability(C: Array, names: Sequence[str]) -> Identifiability:
    """Return rank and undetermined combinations of an identification Jacobian.

    Args:
        C: Shape (m, n).
        names: Ids of the n parameters.
    """
    n = C.shape[1]
    if not n:
        return Identifiability(0, 0, 1.0, ())
    lengths = np.linalg.norm(C, axis=0)
    seen = lengths > ROUNDING * lengths.max(initial=0.0)
    scaled = np.where(seen, C / np.where(seen, lengths, 1.0), 0.0)
    if not len(C):
        return Identifiability(0, n, np.inf, tuple((name,) for name in names))
    s = np.linalg.svd(scaled, compute_uv=False)
    rank = int((s > RANK_TOLERANCE * s[0]).sum()) if s[0] > 0.0 else 0
    if rank == n:
        return Identifiability(rank, n, float(s[0] / s[-1]), ())
    _, R, order = qr(scaled, mode="economic", pivoting=True)
    kept, lost = order[:rank], order[rank:]
    weights = np.linalg.solve(R[:rank, :rank], R[:rank, rank:])  # lost columns from the kept
    members = [
        sorted({int(index), *kept[np.abs(column) > NEGLIGIBLE].tolist()})
        for column, index in zip(weights.T, lost, strict=True)
    ]
    members.sort(key=lambda group: (len(group), group))  # that of the pivots follows rounding
    groups = tuple(tuple(names[i] for i in group) for group in members)
    return Identifiability(rank, n, float(s[0] / s[rank - 1]) if rank else np.inf, groups)
