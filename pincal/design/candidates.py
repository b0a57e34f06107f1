"""The poses of a session that are still to choose: which one is next, and how many it will take.

The next row is the most informative one: M = diag(σ⁻²) + Σ Aⱼᵀ Aⱼ is the information of priors and
of the rows measured so far, with forecast rows Aⱼ of the nominal mechanism, so that measured values
do not influence the choice. The session is played ahead by the same rows, to where a calibration of
them without priors would promise the wanted accuracy.
"""

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from pincal.blas import one_thread
from pincal.design.forecast import forecast, information_rows, touching
from pincal.design.optimal import DETERMINANT, inverse_roots
from pincal.design.platform_error import (
    CONFIDENCE,
    SAMPLES,
    Seen,
    motions_of,
    moved_by_readings,
    outside_of,
    root_mean_squares,
    seen_of,
    seen_targets,
    sizes,
    unnoticed,
)
from pincal.errors import MeasurementError
from pincal.estimation.observability.gauge import unexplained
from pincal.kinematics.configurations import legs_at
from pincal.model import Mechanism, Noise, Plan, Setup
from pincal.types import Array, Index, Mask
from pincal.workspace.sampling import sample_configurations

COVERED = 0.95
"""Share of the workspace that the measured region, in which errors are stated, should cover."""
MANY = 100_000
"""Number of further poses that is as good as infinite."""
_FAR = 10.0  # standard deviation of unknowns without a prior, in sizes of the machine, or rad
_VAGUE = 30.0  # factor on priors with which they say nothing beside rows that determine all
_COURSE = 100  # most poses of a course


class Stated(NamedTuple):
    """What a calibration of some rows of a plan will state about the platform's error."""

    limit: float
    """95 % limit of its RMS in the measured region by parameters, [m]; infinite without a region.
    It is [rad] for a platform that only turns, here and below."""
    hidden: float
    """RMS motion there by errors of readings as large in residuals as their noise, [m]."""
    share: float
    """Share of the workspace in the measured region."""
    outside: Array
    """Uncertainty of each row of the plan over the largest one of these rows, shape (N,)."""


class Candidates:
    """The N rows of a plan as candidates of a session, with their information on n unknowns."""

    offered: Mask
    """Rows in reach that a fit uses, shape (N,)."""
    rows: Array
    """Whitened rows of the plan, zero where not offered, shape (N, k, n)."""
    beforehand: Array
    """Whitened rows of prior knowledge, shape (m, n)."""
    vague: Array
    """The same as if the drawing said nothing, shape (m, n)."""
    workspace: Plan
    """Configurations over which errors are stated."""
    course: list[int]
    """Rows of the plan in the order in which ``best`` chooses them, at most 100."""

    @one_thread()
    def __init__(
        self,
        mechanism: Mechanism,
        plan: Plan,
        noise: Noise,
        measured: Sequence[str] | None,
        setup: Setup,
        priors: Mapping[str, float],
    ) -> None:
        """Forecast the rows of a plan with the nominal mechanism.

        ``priors`` are standard deviations by parameter id; the rest is as for ``forecast``.
        """
        legs = legs_at(mechanism, touching(mechanism, plan, setup))
        information = information_rows(mechanism, legs, noise, measured, setup)
        unknowns, known = information.unknowns, information.priors
        self._verifying, self.offered = plan.verifying, legs.reached & ~plan.verifying
        self.rows = np.zeros((len(plan), *information.rows.shape[1:]))
        self.rows[legs.reached] = information.rows * self.offered[legs.reached, None, None]
        spread = np.full(len(unknowns), _FAR * max(mechanism.size, 1.0))
        places = [place for place, name in enumerate(unknowns) if name in priors]
        spread[places] = [priors[unknowns[place]] for place in places]
        self.beforehand = np.concatenate((np.diag(1.0 / spread), known))
        spread[places] *= _VAGUE
        self.vague = np.concatenate((np.diag(1.0 / spread), known))
        planned = forecast(mechanism, plan, noise, measured, setup)
        self._determining = planned.rank.rank - len(known)
        frames: Array | Seen | None = planned.frames
        if len(unknowns) > len(mechanism.parameters):
            observation, external = information.observation, information.external
            frames = seen_targets(observation, information.measured, external) or frames
        self.workspace, self._size = sample_configurations(mechanism, SAMPLES), mechanism.size
        sampled = legs_at(mechanism, self.workspace)
        held = np.isfinite(sampled.gain).all(axis=(1, 2))  # not at a type-2 singularity
        self._sampled, self._units = seen_of(
            mechanism, sampled.poses[held], sampled.gain[held], frames
        )
        shown = np.square(information.by_reading).sum(axis=2).mean() ** 0.5
        self._hidden = moved_by_readings(mechanism, sampled, frames)[held] / shown
        held = np.isfinite(legs.gain).all(axis=(1, 2))
        *moves, _ = motions_of(mechanism, legs.poses[held], legs.gain[held], frames)
        self._moves = [np.zeros((len(plan), *part.shape[1:])) for part in moves]
        for at_plan, part in zip(self._moves, moves, strict=True):
            at_plan[np.flatnonzero(legs.reached)[held]] = part
        self.stated = cache(self._stated)  # every further row is asked for again at the next one
        self.course = []
        while len(self.course) < _COURSE and self.fresh(self.course).any():
            self.course.append(self.best(self.course)[0])

    def information(self, measured: Sequence[int], beforehand: Array | None = None) -> Array:
        """Return the information M of measured rows of the plan, and of priors, shape (n, n)."""
        flat = self.rows[list(measured)].reshape(-1, self.rows.shape[2])
        rows = np.concatenate((self.beforehand if beforehand is None else beforehand, flat))
        return np.asarray(rows.T @ rows)

    @one_thread()
    def _stated(self, *measured: int) -> Stated:
        """Return what a calibration of measured rows will state.

        The mean square error is a sum of squares weighted by eigenvalues of V = Cᵀ M⁻¹ C; its
        quantile is taken from the χ² of equal mean, tr V, and variance, 2 tr V² (Satterthwaite
        1946).
        """
        root = inverse_roots(self.information(measured, self.vague)[None])[0]
        root = root[: self._sampled.shape[2]]  # of the parameters
        moves, rows = self._sampled @ root, list(measured)
        at_rows, at_plan = (
            self._uncertain(unexplained(self._units, twists, motions, self._size) @ root)
            for twists, motions in ([part[rows] for part in self._moves], self._moves)
        )
        largest = at_rows.max(axis=0, initial=0.0)
        inside = outside_of(self._uncertain(moves), largest) <= 1.0
        limit, hidden = np.inf, np.inf
        if inside.any():
            columns = [unit == self._units[0] for unit in self._units]
            C = moves[inside][:, columns].reshape(-1, moves.shape[2])
            V = C.T @ C / inside.sum()
            mean = float(np.trace(V))
            freedoms = mean**2 / float((V**2).sum())
            limit = float(np.sqrt(mean * chdtri(freedoms, 1.0 - CONFIDENCE) / freedoms))
            hidden = root_mean_squares(self._hidden[inside])[0]
        return Stated(limit, hidden, float(inside.mean()), outside_of(at_plan, largest))

    def _uncertain(self, moves: Array) -> Array:
        """Return the sizes of motions by parameters, (N, r, n), as an array (N, 2)."""
        return sizes(self._units, np.linalg.norm(moves, axis=2))

    def freedoms(self, measured: Sequence[int] | Index, more: int = 0) -> int:
        """Return how many more equations than unknowns a fit of measured and ``more`` rows has."""
        count = (~self._verifying[list(measured)]).sum() + more
        return int(count) * self.rows.shape[1] - self._determining

    def limit(self, measured: Sequence[int], surplus: float = 0.0, more: int = 0) -> float:
        """Return the 95 % limit of the error, [m], that measured rows will promise without priors.

        ``surplus`` is what is known of their χ², above its degrees of freedom: χ² limits errors
        that residuals cannot show, as in ``PlatformError``. The error falls with the square root of
        the number of rows if there are ``more`` of them.
        """
        if (freedoms := self.freedoms(measured, more)) <= 0 or not len(measured):
            return np.inf
        stated, times = self.stated(*measured), 1.0 + more / len(measured)
        scale = unnoticed(1.0 + surplus / freedoms, freedoms)
        hidden = stated.hidden * (scale**2 - 1.0) ** 0.5
        return float(np.hypot(scale * stated.limit / times**0.5, hidden))

    def limits(self, measured: Sequence[int]) -> list[float]:
        """Return the forecast limit after each of the rows, [m]."""
        return [self.limit(measured[: count + 1]) for count in range(len(measured))]

    def missing(self, measured: Sequence[int], accuracy: float, surplus: float) -> int:
        """Return how many further rows it takes until an accuracy, [m], is promised.

        They are those that a session will choose: of the course, then rows that widen too small a
        region. ``MANY`` are as good as infinitely many.
        """
        fresh = self.fresh(measured)
        ahead = [row for row in self.course if fresh[row]]

        def reached(count: int) -> bool:
            beyond = max(count - len(ahead), 0)
            return self.limit([*measured, *ahead[:count]], surplus, beyond) <= accuracy

        count = bisect_left(range(MANY), True, key=reached)
        rows = [*measured, *ahead[:count]]
        stated = self.stated(*rows)
        row = self.outermost(rows, stated.outside) if stated.share < COVERED else None
        if row is None or count > len(ahead):
            return count
        return count + 1 + self.missing([*rows, row], accuracy, surplus)

    def outermost(self, measured: Sequence[int], outside: Array) -> int | None:
        """Return the row farthest outside the measured region, (N,); None if none is outside."""
        outside = np.where(self.fresh(measured), outside, 0.0)
        return int(outside.argmax()) if outside.max() > 1.0 else None

    @one_thread()
    def best(self, measured: Sequence[int]) -> tuple[int, float]:
        """Return the row of the plan to measure next, and the relative decrease of errors by it.

        No other row decreases the errors more, in the geometric mean of all unknowns. Measured rows
        are only repeated when no other is left.

        Raises:
            MeasurementError: no row is offered.
        """
        fresh = self.fresh(measured)
        places = np.flatnonzero(fresh if fresh.any() else self.offered)
        if not len(places):
            raise MeasurementError(
                "no pose of the plan is left: all are out of reach, or were skipped; go back to "
                "one, or give another plan"
            )
        root = inverse_roots(self.information(measured)[None])
        gains = DETERMINANT.gain(self.rows[places], root)[0]
        falls = -np.expm1(-gains.max() / (2 * self.rows.shape[2]))
        return int(places[gains.argmax()]), float(falls)

    def fresh(self, measured: Sequence[int]) -> Mask:
        """Return a mask of the offered rows that were not measured, shape (N,)."""
        fresh = self.offered.copy()
        fresh[list(measured)] = False
        return fresh
