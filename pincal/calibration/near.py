"""An optimum that is known to be near: where the search for all legs at once may begin."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pincal.estimation.linear import State
from pincal.estimation.observability.gauge import Gauge
from pincal.estimation.problem import Problem
from pincal.estimation.unknowns import Unknowns

if TYPE_CHECKING:
    from pincal.calibration.fits import Fits

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Near:
    """An optimum of all legs at once that is known to be near."""

    state: State
    fits: Fits | None = None
    """Of which it is, if these are at hand."""

    @classmethod
    def of(cls, fits: Fits, rows: Mask) -> Near:
        """Return where fits of all legs at once ended, at some of their rows, shape (N,)."""
        return cls(fits.fits[0].fit.last.state.rows(np.flatnonzero(rows)), fits)

    def gauge(self, problem: Problem, unknowns: Unknowns) -> Gauge | None:
        """Return the fits' gauge if it is a problem's too, as the same is measured there."""
        if self.fits is None or self.fits.unknowns is None:
            return None
        whole = self.fits.fits[0].fit.problem.observation.measured.any(axis=0)
        measured = np.array_equal(whole, problem.observation.measured.any(axis=0))
        same = self.fits.unknowns.labels == unknowns.labels
        return self.fits.gauge if measured and same else None
