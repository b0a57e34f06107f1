"""Decides of a position whether it is reached in any, or in every, orientation of a set.

A position is done with at the first orientation that decides it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pincal.kinematics.reach import Turned
from pincal.model.mechanism import Mechanism
from pincal.workspace.criteria import Criteria, Margins, criteria_of
from pincal.workspace.orientations import Orientations
from pincal.workspace.positions import BLOCK

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
_FIRST = 16  # orientations after which closed loops ask who is decided, then 8 times as many


@dataclass(frozen=True)
class PositionTest:
    """Decides which positions are reached in any, or in every, orientation of a set."""

    mechanism: Mechanism
    orientations: Orientations
    every: bool
    least: Margins

    @cached_property
    def _criteria(self) -> Criteria:
        return criteria_of(self.mechanism, self.least)

    def __reduce__(self) -> tuple[type[PositionTest], tuple[object, ...]]:
        """Pickle what is given, not what is cached: it goes to other processes often."""
        return PositionTest, (self.mechanism, self.orientations, self.every, self.least)

    @property
    def in_closed_form(self) -> bool:
        """Whether no loop needs to be closed to decide."""
        return self._criteria.in_closed_form

    def __call__(self, positions: Array) -> Mask:
        """Return which positions, shape (N, 3), count."""
        size = max(1, BLOCK // len(self.orientations))
        inside = np.empty(len(positions), dtype=bool)
        decide = self._all if self.every else self._any
        for begin in range(0, len(positions), size):
            rows = slice(begin, begin + size)
            inside[rows] = decide(positions[rows])
        return inside

    @cached_property
    def _turns(self) -> tuple[Array, list[Turned]]:
        """Orientations as matrices, shape (O, 3, 3), and each leg's point turned by them.

        Those that are likely to decide come first: the far ones if every one must be reached.
        """
        rotations = self.orientations.rotations
        home = self.mechanism.platform.home_pose.rotation[0]
        far = (home.inv() * rotations).magnitude()
        R = rotations.as_matrix()[np.argsort(-far if self.every else far, kind="stable")]
        return R, [reach.turned(R) for reach in self._criteria.reaches]

    def _all(self, positions: Array) -> Mask:
        """Return which positions are reached in every orientation; a leg that fails ends it."""
        R, arms = self._turns
        alive = np.arange(len(positions))
        for reach, arm in zip(self._criteria.reaches, arms, strict=True):
            alive = alive[reach.holds_all(positions[alive], arm)]
        inside = np.zeros(len(positions), dtype=bool)
        if not self.in_closed_form:
            possible = np.ones((len(alive), len(R)), dtype=bool)
            alive = alive[self._by_closing(positions[alive], possible)]
        inside[alive] = True
        return inside

    def _any(self, positions: Array) -> Mask:
        """Return which positions are reached in some orientation."""
        R, arms = self._turns
        possible = np.ones((len(positions), len(R)), dtype=bool)
        for reach, arm in zip(self._criteria.reaches, arms, strict=True):
            rows = np.flatnonzero(possible.any(axis=1))
            possible[rows] &= reach.holds_each(positions[rows], arm)
        if self.in_closed_form:
            return np.asarray(possible.any(axis=1))
        return self._by_closing(positions, possible)

    def _by_closing(self, positions: Array, possible: Mask) -> Mask:
        """Return which positions count, by closing the legs at possible pairs, shape (P,)."""
        R, _ = self._turns
        decided = np.zeros(len(positions), dtype=bool)  # failed if every, else reached
        begin, width = 0, _FIRST
        while begin < len(R) and not decided.all():
            columns = slice(begin, begin + width)
            open_rows = np.flatnonzero(~decided)
            row, column = np.nonzero(possible[open_rows, columns])
            row, column = open_rows[row], column + begin
            matrices = np.broadcast_to(np.eye(4), (len(row), 4, 4)).copy()
            matrices[:, :3, 3], matrices[:, :3, :3] = positions[row], R[column]
            deciding = self._criteria(matrices) != self.every
            decided[row[deciding]] = True
            begin, width = begin + width, 8 * width
        return decided != self.every
