"""Weakly determined parameters: pairs whose errors go together, and by how much.

What it would help to know one of them follows from the covariance: conditioned on its value, the
other one's standard error falls. Where frames are not measured, a value adds something only as
far as no motion of the frames can bring it about.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from pincal.estimation.observability.indices import NEGLIGIBLE, RANK_TOLERANCE

Array = NDArray[np.float64]
_WEAKLY = 3.0  # times better that one would be known with the other: correlation 0.943


@dataclass(frozen=True)
class WeakPair:
    """Two parameters whose errors mostly compensate each other."""

    first: str
    """Its id, such as ``"leg_1.l"``."""
    second: str
    correlation: float
    std: tuple[float, float]
    """Standard errors of the two."""
    known: tuple[float, float]
    """Standard error of each if the other one were known exactly: if both are of one leg, the
    other one of every leg."""

    @property
    def gain(self) -> float:
        """By how many times knowing one betters the other, at most."""
        ratios = zip(self.std, self.known, strict=True)
        return max(std / known if known > 0.0 else np.inf for std, known in ratios)


def weak_pairs(
    ids: Sequence[str], covariance: Array, gauge: Array | None = None
) -> tuple[WeakPair, ...]:
    """Return the pairs that are weakly determined, the weakest first.

    Args:
        ids: Id of each parameter, its owner's name first: ``leg_1.l``.
        covariance: Shape (n, n). Parameters whose variance is zero, or not finite, and pairs that
            are tied, are left out.
        gauge: Directions that only move frames, columns of shape (n, n_gauge).
    """
    std = np.sqrt(np.diagonal(covariance))
    finite = np.isfinite(std) & (std > 0.0)
    covariance = np.where(np.outer(finite, finite), covariance, 0.0)
    scale = np.where(finite, std, 1.0)
    rho = np.clip(covariance / np.outer(scale, scale), -1.0, 1.0)
    directions = np.zeros((len(std), 0)) if gauge is None else gauge
    directions = directions[:, directions.any(axis=0)]  # the others move no parameter

    names = [one.partition(".") for one in ids]

    def known(place: int, other: int) -> float:
        whole = names[place][0] == names[other][0]
        rows = [i for i, one in enumerate(names) if whole and one[2] == names[other][2]]
        return _known(covariance, directions, place, [i for i in rows or [other] if finite[i]])

    pairs = [
        WeakPair(
            ids[i],
            ids[j],
            float(rho[i, j]),
            (float(std[i]), float(std[j])),
            (known(i, j), known(j, i)),
        )
        for i, j in np.argwhere(np.triu(np.abs(rho) > sqrt(1.0 - _WEAKLY**-2), 1)).tolist()
    ]
    weak = [pair for pair in pairs if _WEAKLY <= pair.gain < 1.0 / NEGLIGIBLE]  # else tied
    return tuple(sorted(weak, key=lambda pair: -pair.gain))


def _known(covariance: Array, gauge: Array, place: int, others: Sequence[int]) -> float:
    """Return the standard error of one parameter if others were known, frames still unknown."""
    moved = gauge[list(others)] / np.linalg.norm(gauge, axis=0)
    axes, size, _ = np.linalg.svd(moved)
    fixed = axes[:, int((size > RANK_TOLERANCE).sum()) :].T  # combinations that no frame can move
    across = fixed @ covariance[list(others)]
    inner = across[:, list(others)] @ fixed.T
    gained = across[:, place] @ np.linalg.pinv(inner, hermitian=True) @ across[:, place]
    return float(np.sqrt(max(covariance[place, place] - gained, 0.0)))
