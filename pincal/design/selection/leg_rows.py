"""Rows of legs at poses and in their orbits: what candidates say of the legs' parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.design.information import leg_rows
from pincal.design.selection.candidates import Held, Rows, Some
from pincal.design.selection.criteria import Parts
from pincal.design.selection.orbits import orbit_of, repeated
from pincal.kinematics.batches import CHUNK, chunks
from pincal.kinematics.derivatives import leg_demand_at
from pincal.model.measuring.measurements import Noise
from pincal.model.mechanism import Mechanism
from pincal.symmetry.elements import IDENTITY, Element
from pincal.workspace.chunks import run

Array = NDArray[np.float64]
Index = NDArray[np.intp]
_TASK = 1 << 16  # candidates whose rows are evaluated in one go
HELD = 1 << 26  # numbers that are held in memory


@dataclass(frozen=True)
class LegRows:
    """Whitened rows of legs at poses, or at all poses of their orbits."""

    mechanism: Mechanism
    poses: Array
    """Coordinates, shape (M, dof), all finite, or matrices, shape (M, 4, 4)."""
    legs: tuple[str, ...]
    """Of each part, as often as it is to count."""
    noise: Noise
    elements: tuple[Element, ...] = (IDENTITY,)
    """Of a group, the identity first."""

    @property
    def total(self) -> int:
        """See ``Rows``."""
        return len(self.poses)

    @property
    def shapes(self) -> tuple[tuple[int, int], ...]:
        """Of a candidate's rows, (r, n) of each part."""
        equations, times = self.mechanism.platform.equations, len(self.elements)
        legs = map(self.mechanism.leg, self.legs)
        return tuple((equations(leg) * times, len(leg.parameters)) for leg in legs)

    def matrices(self, places: Some) -> Array:
        """Return poses as matrices, shape (s, 4, 4)."""
        some = self.poses[places]
        return some if some.ndim == 3 else self.mechanism.platform.form.matrices(some)

    def __call__(self, places: Some) -> Parts:
        """See ``Rows``; an image that is an earlier one of its pose is measured once."""
        images, own = orbit_of(self.elements, self.matrices(places))
        rows = {}
        for leg in dict.fromkeys(self.legs):
            parts = [self._of(leg, matrices) for matrices in images]
            for part, counts in zip(parts, own, strict=True):
                if not counts.all():
                    part[~counts] = 0.0
            rows[leg] = np.concatenate(parts, axis=1) if len(parts) > 1 else parts[0]
        return tuple(rows[leg] for leg in self.legs)

    def _of(self, leg: str, matrices: Array) -> Array:
        demand = leg_demand_at(self.mechanism, leg, matrices)
        return leg_rows(demand, self.mechanism, self.noise)

    def admitted(self, places: Index) -> Index:
        """Return those of some of which no earlier one is the same pose, or one of its orbit."""
        images, _ = orbit_of(self.elements, self.matrices(places))
        return places[~repeated(images)]


def held(rows: LegRows, jobs: int = 1, scheduler: str | None = None) -> Rows:
    """Return rows in memory if they are few enough, evaluated on cores or a cluster.

    Args:
        rows: The rows.
        jobs: Processes on this machine; -1 for one a core.
        scheduler: Address of a Dask scheduler to run there.

    Raises:
        WorkspaceError: see ``run``.
    """
    if sum(r * n for r, n in rows.shapes) * rows.total > HELD:
        return rows
    parts = tuple(np.empty((rows.total, *shape)) for shape in rows.shapes)
    if jobs == 1 and scheduler is None:
        for some in chunks(rows.total, CHUNK):
            for part, own in zip(parts, rows(some), strict=True):
                part[some] = own
        return Held(parts)
    ends = [(some.start, some.stop) for some in chunks(rows.total, _TASK)]
    for (begin, end), found in run(_Task(rows), ends, jobs, scheduler):
        values, place = np.frombuffer(found), 0
        for part in parts:
            own = part[begin:end]
            own[:] = values[place : (place := place + own.size)].reshape(own.shape)
    return Held(parts)


@dataclass(frozen=True)
class _Task:
    """What a worker does."""

    rows: LegRows

    def __call__(self, begin: int, end: int) -> bytes:
        return b"".join(one.tobytes() for one in self.rows(slice(begin, end)))
