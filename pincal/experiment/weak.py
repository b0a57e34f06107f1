"""Parameters that are told apart, but weakly: pairs whose errors go together, and by how much.

With standard errors σᵢ, σⱼ and correlation ρ, either would be known to σ √(1 − ρ²) if the other
one were known exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_WEAKLY = 3.0  # times better that one would be known with the other: correlation 0.943


@dataclass(frozen=True)
class WeakPair:
    """Two parameters whose errors mostly compensate each other."""

    first: tuple[str, str]
    """Leg and name."""
    second: tuple[str, str]
    correlation: float
    std: tuple[float, float]
    """Standard errors of the two."""

    @property
    def known(self) -> tuple[float, float]:
        """Standard error of each if the other one were known exactly."""
        share = sqrt(max((1.0 - self.correlation) * (1.0 + self.correlation), 0.0))
        return self.std[0] * share, self.std[1] * share


def weakly_told(names: Sequence[tuple[str, str]], covariance: Array) -> tuple[WeakPair, ...]:
    """Return the pairs that are weakly told apart, the weakest first.

    Args:
        names: Leg and name of each parameter.
        covariance: Shape (n, n). Parameters whose variance is zero, or not finite, are left out.
    """
    std = np.sqrt(np.diagonal(covariance))
    told = np.isfinite(std) & (std > 0.0)
    scale = np.where(told, std, 1.0)
    rho = np.clip(np.where(np.outer(told, told), covariance, 0.0) / np.outer(scale, scale), -1, 1)
    rows, columns = np.triu_indices(len(std), 1)
    strong = np.abs(rho[rows, columns]) > sqrt(1.0 - _WEAKLY**-2)
    order = np.argsort(-np.abs(rho[rows, columns][strong]), kind="stable")
    return tuple(
        WeakPair(names[i], names[j], float(rho[i, j]), (float(std[i]), float(std[j])))
        for i, j in zip(rows[strong][order], columns[strong][order], strict=True)
    )
