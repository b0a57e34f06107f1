"""How far parameters are from their nominal values, by what the measurements say of them all.

Deviations of some groups are drawn from N(0, τ²), a τ for each group: variance components. With the
white rows at an optimum, c + R z, and deviations d + T z, twice the log evidence of the τ, z
integrated out, is, but for a constant,

    −(least of |c + R z|² + |D⁻¹(d + T z)|²) − log det(RᵀR + TᵀD⁻²T) + log det⁺ TᵀD⁻²T

D diagonal with the τ, det⁺ the product of what is not zero (D. A. Harville 1977). Unknowns without
a prior of any kind are integrated over all values, as restricted maximum likelihood has it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.estimation.fit import Fit
from pincal.estimation.observability.indices import RANK_TOLERANCE

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Evidence:
    """White rows at an optimum, and deviations of groups from nominal values."""

    triangle: Array
    """R of the rows beside their residuals, other priors included, shape (n + 1, n + 1)."""
    deviations: Array
    """T: how deviations follow the unknowns, shape (k, n)."""
    offsets: Array
    """d: deviations at the optimum, shape (k,)."""
    groups: NDArray[np.intp]
    """The group of each, from 0, shape (k,)."""

    @classmethod
    def of(cls, one: Fit, groups: dict[str, int]) -> Evidence:
        """Return what a fit says of groups of its parameters.

        Args:
            one: The fit; priors of these parameters do not count.
            groups: By ids of parameters.
        """
        labels, unknowns = one.unknowns.labels, one.unknowns
        own = [place for place, id_ in enumerate(labels) if id_ in groups]
        priors = unknowns.priors.copy()
        priors[own] = np.inf
        system = one.system.with_priors(priors)
        values = system.values(one.last.state)
        return cls(
            system.triangle(one.last, one.weights) / one.noise_scale,
            unknowns.map[own],
            (values - unknowns.nominal)[own],
            np.array([groups[labels[place]] for place in own], dtype=np.intp),
        )

    def counts(self, groups: int) -> Array:
        """Return how many deviations of each group are independent, shape (groups,)."""
        own = [self.deviations[self.groups == group] for group in range(groups)]
        return np.array([_rank(one) if len(one) else 0 for one in own], dtype=float)

    def deviance(self, sizes: Array) -> float:
        """Return minus twice the log evidence of sizes τ of the groups, but for a constant."""
        n, weights = len(self.triangle) - 1, 1.0 / sizes[self.groups]
        own = weights[:, None] * np.column_stack((self.deviations, self.offsets))
        R = np.linalg.qr(np.concatenate((self.triangle, own)), mode="r")
        every = np.abs(np.diagonal(R))
        alone = np.linalg.svd(own[:, :n], compute_uv=False)[: _rank(self.deviations)]
        return float(every[n] ** 2 + 2.0 * np.log(every[:n]).sum() - 2.0 * np.log(alone).sum())


@dataclass(frozen=True)
class FoundTolerance:
    """By how much parameters of one unit differ from the drawing."""

    unit: str
    """``"m"``, ``"rad"`` or ``"1"``."""
    size: float
    """Standard deviation of the parameters, [unit]; infinite where measurements do not say it."""
    low: float
    high: float
    """Ends of its 95 % interval; 0 where the drawing may be exact, infinite without an end."""
    count: int
    """Parameters of this unit without a prior of their own."""


@dataclass(frozen=True)
class Sizes:
    """Standard deviations of groups by the evidence."""

    most: Array
    """The likeliest that are not zero: the evidence times each of them is largest (Y. Chung et al.,
    Psychometrika 2013), but not beyond the intervals, shape (k,)."""
    ends: Array
    """Of the intervals that hold 95 %, shape (k, 2): 0 where none is as likely, infinite where they
    have no upper end."""


def likeliest(
    parts: Sequence[Evidence], start: Array, within: tuple[Array, Array], rise: float
) -> Sizes:
    """Return the sizes of groups, and the ends of their intervals by the likelihood's profile.

    The deviance of k deviations is a little more than χ² distributed: 1 + 1 / 3k times, exactly so
    where they are seen without noise (M. S. Bartlett 1937).

    Args:
        parts: Independent evidence.
        start: Where the search starts, shape (k,).
        within: Smallest and largest sizes that mean something, shape (k,) each.
        rise: Of the deviance, to the ends of intervals, were it χ² distributed.
    """
    from scipy.optimize import brentq, minimize  # slow to load: when needed

    low, high = (np.log(one) for one in within)
    counts = np.sum([one.counts(len(start)) for one in parts], axis=0)

    def least(begin: Array, held: int | None = None, penalty: float = 0.0) -> tuple[Array, float]:
        """Return where the deviance is least, one logarithm held, and its value there."""
        free = np.arange(len(begin)) != held

        def cost(values: Array) -> float:
            logs = begin.copy()
            logs[free] = values
            own = sum(one.deviance(np.exp(logs)) for one in parts)
            return own - 2.0 * penalty * float(values.sum())

        logs = begin.copy()
        if not free.any():
            return logs, cost(logs[free])
        bounds = np.column_stack((low, high))[free]
        found = minimize(cost, logs[free], method="L-BFGS-B", bounds=bounds)
        logs[free] = found.x
        return logs, float(found.fun)

    most, _ = least(np.clip(np.log(start), low, high), penalty=1.0)
    best, bottom = least(most)
    ends = np.empty((len(best), 2))
    for place, middle in enumerate(best):

        def above(value: float, place: int = place) -> float:
            there = best.copy()
            there[place] = value
            return least(there, place)[1] - bottom - rise * (1.0 + 1.0 / (3.0 * counts[place]))

        for side, (end, open_end) in enumerate(((low[place], 0.0), (high[place], np.inf))):
            closed = end != middle and above(end) > 0.0
            between = sorted((float(end), float(middle)))
            ends[place, side] = np.exp(brentq(above, *between)) if closed else open_end
    return Sizes(np.clip(np.exp(most), *ends.T), ends)


def _rank(T: Array) -> int:
    """Return the rank of rows that a choice of free unknowns made, with its rounding errors."""
    return int(np.linalg.matrix_rank(T, rtol=RANK_TOLERANCE))
