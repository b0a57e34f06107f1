"""How far a calibration may be trusted: errors at rows it has not seen, spread over runs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
UNLIKELY = 1e-3  # probability at which fit and held-out rows part, rows drift, runs differ


@dataclass(frozen=True)
class Validation:
    """Errors at rows that a fit has seen, and at rows that it has not."""

    folds: int
    rows: int
    """Rows that were held out, each once."""
    fit: float
    """Root mean square residual of the fit in standard deviations of the noise."""
    held_out: float
    """The same at rows that were held out."""
    expected: float
    """Of held-out rows, by the fit's own residuals and what the fits did not know."""
    p_value: float
    """Probability of such a growth, or a larger one, if the model is right."""
    position: tuple[float, float] | None
    """Root mean square misfit of the platform's position, [m], in the fit and held out; where
    poses were measured in full."""
    orientation: tuple[float, float] | None
    """The same of its orientation, [rad]."""
    drift: tuple[str, ...]
    """Legs whose residuals follow the order of the rows, in words."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to know first."""
        found = list(self.drift)
        if self.p_value < UNLIKELY:
            found.append(
                f"held-out rows miss by {self.held_out:.2f} standard deviations where "
                f"{self.expected:.2f} are expected (p = {self.p_value:.1g}): the model follows its "
                "rows more closely than the machine. Measure more poses, or fix parameters"
            )
        return tuple(found)


@dataclass(frozen=True)
class RunConsistency:
    """Spread of parameters over runs against predicted standard errors."""

    runs: tuple[str, ...]
    names: tuple[str, ...]
    """``leg.parameter``, length n."""
    values: Array
    """Identified in each run, shape (n_runs, n)."""
    spread: Array
    """Standard deviation over the runs, shape (n,)."""
    predicted: Array
    """Root mean square standard error of a run, shape (n,)."""
    ratio: float
    """Root mean square of the deviations in predicted standard errors, all directions alike;
    near 1 if runs differ by their noise only."""
    p_value: float
    """Probability of such a spread, or a larger one, by noise alone."""

    @property
    def consistent(self) -> bool:
        """Whether noise alone explains the spread, at 0.1 %."""
        return self.p_value >= UNLIKELY

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to know first."""
        if self.consistent:
            return ()
        off = np.argsort(-self.spread / np.where(self.predicted > 0.0, self.predicted, np.inf))[:3]
        worst = ", ".join(self.names[i] for i in off)
        return (
            f"parameters differ between runs {self.ratio:.1f} times as much as their standard "
            f"errors say (p = {self.p_value:.1g}), {worst} most: something changed between runs, "
            "or the noise is larger than given",
        )
