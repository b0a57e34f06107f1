"""The search among candidates: for one leg, for its orbits, or for all legs together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.design.information import leg_whitener
from pincal.design.selection.accuracy_bound import accurate_design
from pincal.design.selection.certificate import continuous_design
from pincal.design.selection.criteria import MeanVariance, Parts
from pincal.design.selection.distinct import distinct
from pincal.design.selection.exchange import exchange
from pincal.design.selection.orbits import images
from pincal.errors import MeasurementError, ObservabilityError
from pincal.estimation.observability.indices import identifiability
from pincal.files.given import as_noise
from pincal.kinematics.derivatives import leg_demand
from pincal.kinematics.inverse import reached
from pincal.model.checks import count_of, generator_of
from pincal.model.measuring.measurements import Noise
from pincal.model.mechanism import Mechanism
from pincal.symmetry.elements import Element

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True)
class SelectionOptions:
    """Options of ``select_poses`` and ``select_configurations``."""

    noise: Noise | None = None
    """Standard deviations of the measurements to come; only their ratios matter."""
    seed: int | np.random.Generator = 0
    """Seed or generator of the random starts."""
    starts: int = 20
    """Starts of the exchange; the best is kept."""
    progress: Callable[[str], None] | None = None
    """Called with what is being done."""

    def __post_init__(self) -> None:
        as_noise(self.noise)
        count_of(self.starts, "starts", MeasurementError, 1)
        generator_of(self.seed, MeasurementError)

    def say(self, text: str) -> None:
        """Pass on what is being done."""
        if self.progress is not None:
            self.progress(text)


class Search:
    """Candidates of a mechanism, and the best of them."""

    def __init__(self, mechanism: Mechanism, candidates: Array, options: SelectionOptions) -> None:
        """Hold distinct candidates.

        Args:
            mechanism: The mechanism.
            candidates: Coordinates, shape (M, dof), [m] and [rad].
            options: How to search.

        Raises:
            MechanismError: poses of a wrong shape, or not finite.
        """
        transforms = mechanism.platform.transforms(candidates)
        kept = distinct(mechanism.platform, transforms)
        self.mechanism, self.options = mechanism, options
        self.rng = np.random.default_rng(options.seed)
        self.candidates = np.asarray(candidates, dtype=np.float64)[kept]
        transforms = transforms if len(kept) == len(transforms) else transforms[kept]
        self.reached = np.asarray(reached(mechanism, transforms).all(axis=1))
        self.usable, self.unreachable = len(self.candidates), 0

    def rows(self, leg: str, poses: Array) -> Array:
        """Return the whitened rows of a leg at poses, shape (N, k, n)."""
        demand = leg_demand(self.mechanism, leg, poses)
        whitener = leg_whitener(demand, self.mechanism, as_noise(self.options.noise))
        return whitener(demand.parameter)

    def own(self, leg: str, count: int) -> tuple[Index, float]:
        """Return the chosen candidates for one leg, and their efficiency."""
        self.options.say(f"choosing poses for {leg}")
        return self._choose((self.rows(leg, self.candidates),), count, [leg])

    def orbits(
        self, legs: Sequence[str], count: int, elements: Sequence[Element]
    ) -> tuple[Array, float]:
        """Return the poses of chosen orbits, each once, and the orbits' efficiency.

        Args:
            legs: A leg of each orbit of legs, as often as it is to count.
            count: Number of orbits.
            elements: Group that makes the orbits.
        """
        self.options.say("choosing orbits")
        found, own, repeated = images(self.mechanism.platform, elements, self.candidates)
        rows = {}
        for leg in dict.fromkeys(legs):
            images_of = [self.rows(leg, poses) for poses in found]
            for image, counts in zip(images_of, own, strict=True):
                image[~counts] = 0.0  # measured once
            rows[leg] = np.concatenate(images_of, axis=1)
        parts = tuple(rows[leg] for leg in legs)
        for one in parts:
            one[repeated] = np.nan
        chosen, efficiency = self._choose(parts, count, legs)
        kept = own[:, chosen]
        return found[:, chosen][kept], efficiency

    def efficiency(self, leg: str, poses: Array, chosen: Index) -> float:
        """Return the efficiency of a choice for a leg among candidates of its own.

        Args:
            leg: The leg.
            poses: Its candidates, coordinates of shape (M, dof).
            chosen: Which of them are chosen.
        """
        blocks = self.rows(leg, poses)
        design = continuous_design((blocks[np.isfinite(blocks).all(axis=(1, 2))],))
        own = blocks[chosen].reshape(-1, blocks.shape[2])
        log_det = float(np.linalg.slogdet(own.T @ own)[1])
        return design.efficiency(log_det, len(chosen), blocks.shape[2])

    def common(self, count: int) -> tuple[Index, float]:
        """Return the candidates chosen for all legs together, and their efficiency."""
        self.options.say("choosing common poses")
        legs = self.mechanism.leg_names
        return self._choose(tuple(self.rows(leg, self.candidates) for leg in legs), count, legs)

    def _choose(self, parts: Parts, count: int, legs: Sequence[str]) -> tuple[Index, float]:
        """Return the candidates chosen by their rows, and their efficiency.

        Args:
            parts: Rows of each leg, shape (M, r, n).
            count: How many.
            legs: The legs.

        Raises:
            ObservabilityError: too few poses or candidates, or some parameter undetermined.
        """
        where = legs[0] if len(legs) == 1 else self.mechanism.name
        n, r = (sum(one.shape[axis] for one in parts) for axis in (2, 1))
        whole = [np.isfinite(one).all(axis=(1, 2)) for one in parts]
        usable = np.flatnonzero(np.logical_and.reduce(whole) & self.reached)
        self.usable = min(self.usable, len(usable))
        self.unreachable = max(self.unreachable, len(self.candidates) - len(usable))
        if count * r < n:
            raise ObservabilityError(
                f"{count} poses give {count * r} equations for the {n} parameters of {where}; "
                f"choose at least {-(-n // r)}, better two or three times as many"
            )
        if len(usable) < count:
            raise ObservabilityError(
                f"{self.mechanism.name} reaches {len(usable)} of {len(self.candidates)} candidate "
                f"poses; {count} are to be chosen"
            )
        parts = tuple(one[usable] for one in parts)
        lost = []
        for leg, one in zip(legs, parts, strict=True):
            ids = [f"{leg}.{name}" for name in self.mechanism.leg(leg).parameter_names]
            found = identifiability(one.reshape(-1, one.shape[2]), ids)
            lost += [] if found.complete else [found.describe()]
        if lost:
            raise ObservabilityError(
                f"the candidate poses leave parameters undetermined: {'; '.join(lost)}. "
                "Add poses that determine each of them, or make one of them a constant"
            )
        chosen, efficiency = d_optimal(parts, count, self.rng, self.options.starts)
        return usable[chosen], efficiency


def accurate(
    blocks: Array, C: Array, count: int, rng: np.random.Generator, starts: int
) -> tuple[Index, float]:
    """Return a choice by which quantities Cᵀφ are known best, and its efficiency.

    Args:
        blocks: Rows that each candidate contributes, shape (M, r, n); together of rank n.
        C: Shape (n, q).
        count: Size of the choice, without repetition.
        rng: Source of the random starts.
        starts: Number of starts.
    """
    design = accurate_design(blocks, C)
    chosen, value = exchange((blocks,), count, design.weights, rng, starts, MeanVariance(C))
    return chosen, design.efficiency(float(np.exp(-value)), count)


def d_optimal(
    parts: Parts, count: int, rng: np.random.Generator, starts: int
) -> tuple[Index, float]:
    """Return a D-optimal choice, and its efficiency against the bound on any choice.

    Args:
        parts: Rows that each candidate contributes, of each part of the parameters, shape
            (M, r, n); together of rank n.
        count: Size of the choice, without repetition.
        rng: Source of the random starts.
        starts: Number of starts.
    """
    design = continuous_design(parts)
    chosen, log_det = exchange(parts, count, design.priority, rng, starts)
    return chosen, design.efficiency(log_det, count, sum(one.shape[2] for one in parts))
