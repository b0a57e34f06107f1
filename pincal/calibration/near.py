"""Where a search for all legs at once begins if most of its rows were fitted before."""

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
    """Where all legs at once were identified from other rows, or from the same ones before."""

    state: State
    fits: Fits | None = None
    """The fits that ended there, whose gauge may be the same; None if they are not at hand."""

    @classmethod
    def of(cls, fits: Fits, rows: Mask) -> Near:
        """Return where fits of all legs at once ended, at some of their rows, shape (N,)."""
        return cls(fits.fits[0].fit.last.state.rows(np.flatnonzero(rows)), fits)

    def gauge(self, problem: Problem, unknowns: Unknowns) -> Gauge | None:
        """Return the fits' gauge if it is a problem's too: the same is free, measured and known."""
        if self.fits is None or self.fits.unknowns is None:
            return None
        whole, free = self.fits.fits[0].fit.problem, self.fits.unknowns
        same = (
            free.labels == unknowns.labels
            and np.array_equal(free.map, unknowns.map)
            and np.array_equal(free.priors, unknowns.priors, equal_nan=True)
            and _said(whole) == _said(problem)
        )
        return self.fits.gauge if same else None


def _said(problem: Problem) -> tuple[list[bool], dict[str, bool]]:
    """Return what is measured in some row, and which influences are known in some."""
    known = {name: bool(np.isfinite(own).any()) for name, own in problem.influences.items()}
    return [bool(own.any()) for own in problem.observation.measured.T], known
