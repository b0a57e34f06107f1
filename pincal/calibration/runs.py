"""Runs of an experiment compared: do they say the same, within their own standard errors?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pincal.calibration.covariance import exceeded
from pincal.errors import MeasurementError
from pincal.estimation.system import UNLIKELY
from pincal.finding import Finding
from pincal.model.measurements import Measurements
from pincal.types import Array
from pincal.words.numbers import amount, chance
from pincal.words.sentences import finding, sentences

if TYPE_CHECKING:
    from pincal.calibration.result import CalibrationResult


@dataclass(frozen=True, repr=False)
class RunComparison:
    """Spread of parameters over runs against predicted standard errors."""

    runs: tuple[str, ...]
    names: tuple[str, ...]
    """``leg.parameter``, length n."""
    units: tuple[str, ...]
    """SI unit of each, ``"m"``, ``"rad"`` or ``"1"``."""
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

    def __repr__(self) -> str:
        return (
            f"RunComparison({len(self.runs)} runs, ratio {self.ratio:.2f}, {chance(self.p_value)})"
        )

    @property
    def worst(self) -> tuple[int, ...]:
        """The three parameters that spread most for their standard errors, the first most."""
        known = np.where(self.predicted > 0.0, self.predicted, np.inf)
        return tuple(np.argsort(-self.spread / known, kind="stable")[:3].tolist())

    def __str__(self) -> str:
        first = self.worst[0]
        unit = self.units[first]
        spread, predicted = amount(self.spread[first], unit), amount(self.predicted[first], unit)
        lines = [
            f"{len(self.runs)} runs: {', '.join(self.runs)}",
            f"parameters spread {self.ratio:.2f} times as much as their standard errors say "
            f"({chance(self.p_value)})",
            f"{self.names[first]} most: spread {spread}, predicted {predicted}",
        ]
        return "\n".join([*lines, *(f"warning: {text}" for text in sentences(self.findings))])

    @property
    def agree(self) -> bool:
        """Whether noise alone explains the spread, at 0.1 %."""
        return self.p_value >= UNLIKELY

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What to know first."""
        if self.agree:
            return ()
        worst = [self.names[i] for i in self.worst]
        return (finding("runs-differ", parameters=worst, ratio=self.ratio, p_value=self.p_value),)


def run_names(data: Measurements) -> tuple[str, ...]:
    """Return the names of the runs of measurements, in their order.

    Raises:
        MeasurementError: no runs, or only one.
    """
    names = tuple(dict.fromkeys(data.runs or ()))
    if len(names) < 2:
        raise MeasurementError("runs are compared by a column 'run' with at least two runs in it")
    return names


def runs_compared(names: tuple[str, ...], results: Sequence[CalibrationResult]) -> RunComparison:
    """Return how well runs agree that were calibrated each alone, all of them converged.

    Args:
        names: The runs.
        results: Their results.
    """
    parameters = [parameter for leg in results[0].legs for parameter in leg.parameters]
    values = np.array(
        [np.concatenate([leg.identified for leg in result.legs]) for result in results]
    )
    C = np.array([result.covariance for result in results])
    freedoms = sum(result.noise_freedoms or np.inf for result in results)
    scale = np.sqrt(np.einsum("rii->ri", C).mean(axis=0))
    scale[scale == 0.0] = 1.0
    weights = np.linalg.pinv(C / np.outer(scale, scale), rcond=1e-12, hermitian=True)
    relative = values / scale
    mean = np.linalg.pinv(weights.sum(axis=0), rcond=1e-12, hermitian=True) @ np.einsum(
        "rij,rj->i", weights, relative
    )
    deviations = relative - mean
    statistic = float(np.einsum("ri,rij,rj->", deviations, weights, deviations))
    rank = int(np.linalg.matrix_rank(weights.sum(axis=0), hermitian=True))
    dof = rank * (len(names) - 1)
    return RunComparison(
        runs=names,
        names=tuple(parameter.id for parameter in parameters),
        units=tuple(parameter.unit for parameter in parameters),
        values=values,
        spread=values.std(axis=0, ddof=1),
        predicted=np.sqrt(np.einsum("rii->ri", C).mean(axis=0)),
        ratio=float(np.sqrt(statistic / dof)),
        p_value=exceeded(statistic / dof, dof, freedoms),
    )
