"""The search among poses that a mechanism reaches: for one leg, for orbits, for all legs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pincal.design.certificate import continuous_design
from pincal.design.criteria import Criterion, Parts, triangles
from pincal.design.exchange import best_choice
from pincal.design.information import leg_rows
from pincal.design.orbits import distinct, orbit_of, representatives
from pincal.errors import MeasurementError, ObservabilityError
from pincal.estimation.observability.indices import identifiability
from pincal.files.measurements import as_noise
from pincal.kinematics.closure import LegClosure
from pincal.kinematics.derivatives import leg_demands_at
from pincal.kinematics.inverse import reached
from pincal.model.checks import count_of, generator_of
from pincal.model.measurements import Noise
from pincal.model.mechanism import Mechanism
from pincal.symmetry.elements import IDENTITY, Element
from pincal.types import Array


@dataclass(frozen=True)
class SelectionOptions:
    """Options of ``select_poses`` and ``select_configurations``."""

    noise: Noise | None = None
    """Standard deviations of the measurements to come; only their ratios matter."""
    seed: int | np.random.Generator = 0
    """Seed or generator of the random starts."""
    starts: int = 5
    """Number of starts of the exchange; the best result is taken."""
    progress: Callable[[str], None] | None = None
    """Function that is called with what is being done."""

    def __post_init__(self) -> None:
        as_noise(self.noise)
        count_of(self.starts, "starts", MeasurementError, 1)
        generator_of(self.seed, MeasurementError)

    def say(self, text: str) -> None:
        """Pass on what is being done."""
        if self.progress is not None:
            self.progress(text)


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
        poses, platform = self.poses, self.mechanism.platform
        if len(elements) > 1:
            images = representatives(elements, platform.matrices(poses))
            poses = poses[distinct(platform, platform.from_matrices(images))]
        rows = self.rows(poses, legs, elements)
        r, n = (sum(part.shape[axis] for part in rows) for axis in (1, 2))
        if self.count * r < n:
            subject = legs[0] if len(legs) == 1 else self.mechanism.name
            raise ObservabilityError(
                f"{self.count} poses give {self.count * r} equations for the {n} parameters of "
                f"{subject}; choose at least {-(-n // r)}, better two or three times as many"
            )
        lost = []
        for leg, factor in zip(legs, triangles(rows), strict=True):
            ids = [f"{leg}.{name}" for name in self.mechanism.leg(leg).parameter_names]
            rank = identifiability(factor, ids)
            lost += [] if rank.complete else [rank.describe()]
        if lost:
            raise ObservabilityError(
                f"the candidate poses leave parameters undetermined: {'; '.join(lost)}. "
                "Add poses that determine each of them, or make one of them a constant"
            )
        chosen, efficiency = best_choice(rows, self.count, self.rng, self.options.starts)
        return poses[chosen], efficiency

    def efficiency(self, leg: str, element: Element, chosen: Array) -> float:
        """Return the efficiency of carried poses for a leg, among carried candidates.

        Args:
            leg: The leg.
            element: Element that carries candidates to the leg's.
            chosen: Poses that were chosen, coordinates of shape (count, dof).
        """
        offered, taken = (
            self.rows(element.poses(self.mechanism.platform, poses), (leg,))
            for poses in (self.poses, chosen)
        )
        return continuous_design(offered).efficiency(Criterion().value(taken), len(chosen))

    def rows(
        self, poses: Array, legs: Sequence[str], elements: Sequence[Element] = (IDENTITY,)
    ) -> Parts:
        """Return whitened rows of legs at poses, or at all poses of their orbits.

        They are zero at an image that is an earlier one of its pose, which is measured once.

        Args:
            poses: Poses that all legs reach, coordinates of shape (M, dof).
            legs: Leg of each part, as often as it is to count.
            elements: Elements of the group that makes orbits, the identity first.
        """
        platform, rows = self.mechanism.platform, {}
        orbits = list(zip(*orbit_of(elements, platform.matrices(poses)), strict=True))
        for leg in dict.fromkeys(legs):
            closure, images = LegClosure(self.mechanism.leg(leg), platform), []
            for image, first in orbits:
                (demand,) = leg_demands_at((closure,), (image,))
                images.append(leg_rows(demand, self.mechanism, self.noise))
                finite = np.isfinite(images[-1]).all(axis=(1, 2))
                images[-1][~(first & finite)] = 0.0
            rows[leg] = np.concatenate(images, axis=1)
        return tuple(rows[leg] for leg in legs)
