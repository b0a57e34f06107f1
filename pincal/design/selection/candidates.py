"""Rows of candidates: held in memory, or evaluated where they are asked for."""

from __future__ import annotations

from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pincal.design.selection.criteria import Parts
from pincal.kinematics.batches import chunks

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Some: TypeAlias = Index | slice
"""Places of candidates."""
_AT_ONCE = 8192  # candidates looked at: their products stay near the processor


class Rows(Protocol):
    """Rows of M candidates, by their places; NaN where one is out of reach."""

    @property
    def total(self) -> int:
        """M."""

    def __call__(self, places: Some) -> Parts:
        """Return the rows of some, of each part of the parameters, shape (s, r, n)."""


class Held:
    """Rows in memory."""

    def __init__(self, parts: Parts) -> None:
        self.parts = parts
        self.total = len(parts[0])

    def __call__(self, places: Some) -> Parts:
        """See ``Rows``."""
        return tuple(one[places] for one in self.parts)


def squares(rows: Rows, places: Index, turns: Parts) -> Array:
    """Return Σ |Aⱼ T|² over all parts of each candidate, shape (s,): in parts that memory holds.

    Args:
        rows: The rows.
        places: Candidates.
        turns: T of each part, shape (n, k).
    """
    found, whole = np.zeros(len(places)), len(places) == rows.total
    for some in chunks(len(places), _AT_ONCE):
        for one, turn in zip(rows(some if whole else places[some]), turns, strict=True):
            for row in one.transpose(1, 2, 0):
                turned = turn.T @ row  # one number of all candidates beside the other in memory
                found[some] += np.einsum("km,km->m", turned, turned)
    return found


def most_of(values: Array, count: int) -> Index:
    """Return where the largest values are, in order of their places."""
    count = min(count, len(values))
    return np.sort(np.argpartition(-values, count - 1)[:count]) if count else np.arange(0)
