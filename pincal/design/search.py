"""The search among candidates: for one leg, for orbits of poses, or for all legs together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from pincal.design.certificate import continuous_design
from pincal.design.criteria import Candidates, Determinant, Parts, RowArrays, triangles
from pincal.design.exchange import best_choice
from pincal.design.information import leg_rows
from pincal.design.orbits import distinct, orbit_of, representatives
from pincal.errors import MeasurementError, ObservabilityError
from pincal.estimation.observability.indices import identifiability
from pincal.files.measurements import as_noise
from pincal.kinematics.batches import chunks
from pincal.kinematics.closure import LegClosure
from pincal.kinematics.derivatives import leg_demands_at
from pincal.kinematics.inverse import reached
from pincal.model.checks import count_of, generator_of
from pincal.model.measurements import Noise
from pincal.model.mechanism import Mechanism
from pincal.symmetry.elements import IDENTITY, Element
from pincal.types import Array, Index
from pincal.workspace.chunks import check_jobs, run

_TASK = 1 << 14  # candidates whose rows are evaluated in one go
IN_MEMORY = 1 << 26  # most numbers in memory; more are evaluated anew whenever they are asked for


@dataclass(frozen=True)
class SelectionOptions:
    """Options of ``select_poses`` and ``select_configurations``."""

    noise: Noise | None = None
    """Standard deviations of the measurements to come; only their ratios matter."""
    seed: int | np.random.Generator = 0
    """Seed or generator of the random starts."""
    starts: int = 5
    """Number of starts of the exchange; the best result is taken."""
    jobs: int = 1
    """Processes on this machine that evaluate candidates; -1 for one a core."""
    scheduler: str | None = None
    """Address of a Dask scheduler to evaluate them on."""
    progress: Callable[[str], None] | None = None
    """Function that is called with what is being done."""

    def __post_init__(self) -> None:
        as_noise(self.noise)
        count_of(self.starts, "starts", MeasurementError, 1)
        check_jobs(self.jobs)
        generator_of(self.seed, MeasurementError)

    def say(self, text: str) -> None:
        """Pass on what is being done."""
        if self.progress is not None:
            self.progress(text)


@dataclass(frozen=True)
class LegRows:
    """Whitened rows of legs at poses, or at all poses of their orbits: see ``Candidates``."""

    mechanism: Mechanism
    poses: Array
    """Poses that all legs reach, coordinates of shape (M, dof)."""
    legs: tuple[str, ...]
    """Leg of each part, as often as it is to count."""
    noise: Noise
    elements: tuple[Element, ...] = (IDENTITY,)
    """Elements of the group that makes orbits, the identity first."""

    def __len__(self) -> int:
        """Return the number of candidates."""
        return len(self.poses)

    @property
    def shapes(self) -> tuple[tuple[int, int], ...]:
        """Shape (r, n) of a candidate's rows, of each part."""
        equations, times = self.mechanism.platform.equations, len(self.elements)
        legs = map(self.mechanism.leg, self.legs)
        return tuple((equations(leg) * times, len(leg.parameters)) for leg in legs)

    def __getitem__(self, places: Index | slice) -> Parts:
        """Return the rows of some candidates, shape (s, r, n) for each part.

        They are zero at an image that is an earlier one of its pose, which is measured once.
        """
        matrices = self.mechanism.platform.matrices(self.poses[places])
        rows = {}
        for leg in dict.fromkeys(self.legs):
            closure, images = LegClosure(self.mechanism.leg(leg), self.mechanism.platform), []
            for image, first in zip(*orbit_of(self.elements, matrices), strict=True):
                (demand,) = leg_demands_at((closure,), (image,))
                images.append(leg_rows(demand, self.mechanism, self.noise))
                finite = np.isfinite(images[-1]).all(axis=(1, 2))
                images[-1][~(first & finite)] = 0.0
            rows[leg] = np.concatenate(images, axis=1)
        return tuple(rows[leg] for leg in self.legs)


def in_memory(rows: LegRows, jobs: int = 1, scheduler: str | None = None) -> Candidates:
    """Return rows in memory if they are few enough, evaluated on cores or a cluster.

    Args:
        rows: The rows.
        jobs: Processes on this machine; -1 for one a core.
        scheduler: Address of a Dask scheduler to run there.

    Raises:
        WorkspaceError: see ``run``.
    """
    if sum(r * n for r, n in rows.shapes) * len(rows) > IN_MEMORY:
        return rows
    parts = tuple(np.empty((len(rows), *shape)) for shape in rows.shapes)
    ends = [(chunk.start, chunk.stop) for chunk in chunks(len(rows), _TASK)]
    for (begin, end), numbers in run(partial(_row_bytes, rows), ends, jobs, scheduler):
        values, place = np.frombuffer(numbers), 0
        for part in parts:
            block = part[begin:end]
            block[:] = values[place : (place := place + block.size)].reshape(block.shape)
    return RowArrays(parts)


def _row_bytes(rows: LegRows, begin: int, end: int) -> bytes:
    return b"".join(part.tobytes() for part in rows[begin:end])


class Search:
    """Candidates that a mechanism reaches, and the best of them."""

    def __init__(
        self, mechanism: Mechanism, candidates: Array, count: int, options: SelectionOptions
    ) -> None:
        """Hold the candidates that all legs reach, each once.

        Args:
            mechanism: The mechanism.
            candidates: Coordinates, shape (M, dof), [m] and [rad].
            count: Number of poses, or of orbits, to choose.
            options: How to search.

        Raises:
            MechanismError: poses of a wrong shape, or not finite.
            ObservabilityError: fewer candidates in reach than are to be chosen.
        """
        self.mechanism, self.count, self.options = mechanism, count, options
        self.noise, self.rng = as_noise(options.noise), np.random.default_rng(options.seed)
        platform = mechanism.platform
        coordinates = platform.checked(platform.coordinates_of(candidates))
        poses = coordinates[reached(mechanism, coordinates).all(axis=1)]
        self.in_reach, self.unreachable = len(poses), len(coordinates) - len(poses)
        if len(poses) < max(count, 1):
            raise ObservabilityError(
                f"{mechanism.name} reaches {len(poses)} of {len(coordinates)} candidate poses; "
                f"{count} are to be chosen"
            )
        self.poses = poses[distinct(platform, poses)]

    def choose(
        self, legs: Sequence[str], elements: Sequence[Element] = (IDENTITY,)
    ) -> tuple[Array, float]:
        """Return the best poses for legs, shape (count, dof), and their efficiency.

        Args:
            legs: Legs that the poses are for, as often as each is to count.
            elements: Group whose orbits of the poses are measured.

        Raises:
            ObservabilityError: too few poses or candidates, or some parameter undetermined.
        """
        poses, mechanism = self.poses, self.mechanism
        if len(elements) > 1:
            platform = mechanism.platform
            images = representatives(elements, platform.matrices(poses))
            poses = poses[distinct(platform, platform.from_matrices(images))]
        rows = LegRows(mechanism, poses, tuple(legs), self.noise, tuple(elements))
        r, n = (sum(shape[axis] for shape in rows.shapes) for axis in (0, 1))
        if self.count * r < n:
            subject = legs[0] if len(legs) == 1 else mechanism.name
            raise ObservabilityError(
                f"{self.count} poses give {self.count * r} equations for the {n} parameters of "
                f"{subject}; choose at least {-(-n // r)}, better two or three times as many"
            )
        candidates = self._in_memory(rows)
        factors = triangles(candidates)
        self._check_determined(legs, factors)
        chosen, efficiency = best_choice(
            candidates, self.count, self.rng, self.options.starts, factors=factors
        )
        return poses[chosen], efficiency

    def efficiency(self, leg: str, element: Element, chosen: Array) -> float:
        """Return the efficiency of carried poses for a leg, among carried candidates.

        Args:
            leg: The leg.
            element: Element that carries candidates to the leg's.
            chosen: Poses that were chosen, coordinates of shape (count, dof).
        """
        offered, chosen_rows = (
            LegRows(
                self.mechanism, element.poses(self.mechanism.platform, poses), (leg,), self.noise
            )
            for poses in (self.poses, chosen)
        )
        value = Determinant().value(chosen_rows[:])
        return continuous_design(self._in_memory(offered)).efficiency(value, len(chosen))

    def _in_memory(self, rows: LegRows) -> Candidates:
        return in_memory(rows, self.options.jobs, self.options.scheduler)

    def _check_determined(self, legs: Sequence[str], factors: Parts) -> None:
        """Raise if all candidates together leave parameters undetermined.

        Raises:
            ObservabilityError: they do; it says which.
        """
        lost = []
        for leg, factor in zip(legs, factors, strict=True):
            ids = [f"{leg}.{name}" for name in self.mechanism.leg(leg).parameter_names]
            rank = identifiability(factor, ids)
            lost += [] if rank.complete else [rank.describe()]
        if lost:
            raise ObservabilityError(
                f"the candidate poses leave parameters undetermined: {'; '.join(lost)}. "
                "Add poses that determine each of them, or make one of them a constant"
            )
