"""Models that grow by one term each time, fitted, and what they predict of rows held out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pincal.calibration.calibration import Calibration
from pincal.calibration.checks.missed import misses_of, per_row
from pincal.calibration.checks.unseen import predictions
from pincal.calibration.fits import Fits, fitted
from pincal.calibration.terms.candidates import extended
from pincal.calibration.terms.kinds import ORDER, Kind
from pincal.calibration.terms.screen import Candidate, screen
from pincal.errors import MeasurementError, PincalError

Array = NDArray[np.float64]
TROUBLE = (PincalError, np.linalg.LinAlgError)
"""What rows that do not determine a model raise."""


@dataclass(frozen=True)
class Rules:
    """When terms are tried, and how many."""

    level: float = 0.01
    """Probability by chance, of all tests of a screen, below which a term is tried."""
    most: int = 8
    """Terms one after the other."""
    pinned: float = 1e-12
    """How well a parameter that is as drawn is known, [m], [rad] or [1]."""


RULES = Rules()


@dataclass(frozen=True)
class Step:
    """A model and its fit."""

    added: tuple[tuple[str, Kind], ...]
    chance: float
    """Of the last term, when it was added: by the screen, the number of tests taken in."""
    calibration: Calibration
    found: Fits

    @property
    def parameters(self) -> int:
        """Free parameters: not those that are as drawn."""
        unknowns = [robust.fit.unknowns for robust in self.found.fits]
        return sum(one.map.shape[1] - int((one.priors <= RULES.pinned).sum()) for one in unknowns)

    @property
    def equations(self) -> int:
        """Residuals that the fits follow."""
        fits = [robust.fit for robust in self.found.fits]
        return int(sum(one.last.equations[one.weights > 0.0].sum() for one in fits))

    @property
    def chi2(self) -> float:
        """Of all residuals, at the noise of the geometry's fit."""
        return float(sum(robust.fit.chi2 for robust in self.found.fits))


def grown(
    calibration: Calibration,
    screened: Sequence[Candidate],
    pairs: Sequence[tuple[str, Kind]],
    most: int = RULES.most,
) -> list[Step]:
    """Return models that grow by the likeliest term each time, until none is likely.

    Args:
        calibration: Of the geometry, its noise as it is.
        screened: The screen of its residuals.
        pairs: Readings, and kinds of term that they may lack.
        most: How many at most.
    """
    steps: list[Step] = []
    added: tuple[tuple[str, Kind], ...] = ()
    while len(steps) < most:
        likely = [one for one in screened if one.corrected < RULES.level and one.kind.name != ORDER]
        if not likely:
            break
        added = (*added, (likely[0].reading, likely[0].kind))
        more = replace(extended(calibration, added), start=None)
        try:
            found = _identified(more)
        except TROUBLE:  # what the rows do not determine
            break
        steps.append(Step(added, likely[0].corrected, more, found))
        screened = screen(found, pairs)
    return steps


def held_out(
    unseen: Calibration,
    seen: Sequence[Calibration],
    pairs: Sequence[tuple[str, Kind]],
    most: int,
) -> list[tuple[Array, Array]]:
    """Return ``squares`` and misses (see ``per_row``) of rows held out, by each model.

    Args:
        unseen: The rows held out.
        seen: Calibrations of the others: of the machine as drawn, and of its geometry.
        pairs: Readings, and kinds of term that they may lack.
        most: How many terms at most.

    Raises:
        PincalError, LinAlgError: these rows do not determine the geometry.
    """
    steps = [Step((), 1.0, one, _identified(one)) for one in seen]
    steps += grown(seen[1], screen(steps[1].found, pairs), pairs, most)
    parts = []
    for one in steps:
        there = replace(unseen, mechanism=one.calibration.mechanism)
        try:
            misses = per_row(misses_of(there, one.found), len(there.measurements))
            parts.append((squares(one.found, there), misses))
        except TROUBLE:
            if len(parts) < len(seen):
                raise
            break  # as a path that ended
    return parts


def _identified(calibration: Calibration) -> Fits:
    """Return fits that converged.

    Raises:
        PincalError, LinAlgError: rows that do not determine the model, or a search without end.
    """
    found = fitted(calibration)
    if not all(robust.fit.converged for robust in found.fits):
        raise MeasurementError("the search does not converge")
    return found


def squares(seen: Fits, unseen: Calibration) -> Array:
    """Return squared white residuals at rows not seen, and how many they are, shape (N, 2)."""
    total = np.zeros((len(unseen.measurements), 2))
    for one, linear in predictions(seen, unseen):
        legs = [unseen.mechanism.leg_names.index(leg.name) for leg in one.problem.legs]
        rows = np.flatnonzero(unseen.used[:, legs].any(axis=1))
        if seen.latent:
            rows = np.arange(len(total))
        total[rows, 0] += linear.squares
        total[rows, 1] += linear.equations
    return total
