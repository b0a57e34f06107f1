"""Choosing poses to measure, for one leg and mapped to all, or for all legs at once.

- ``independent``: each leg its own poses (5R paper);
- ``symmetric``: leg 1's poses, carried to the other legs by the group (3-RRR paper, Eqs. 14, 22);
- ``orbits``: whole orbits of the group, so that each measured pose serves every leg;
- ``common``: poses that are best for the parameters of all legs together (the papers'
  traditional identification).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from pincal.design.certificate import continuous_design
from pincal.design.distinct import SAME, distinct, places_of
from pincal.design.exchange import exchange
from pincal.errors import MeasurementError, ObservabilityError
from pincal.estimation.observability import Indices, identifiability, indices, r_diagonal
from pincal.kinematics.configurations import block_diagonal
from pincal.kinematics.derivatives import Demand, leg_demand
from pincal.kinematics.inverse import reached
from pincal.model.measurements import EVERY_LEG, Noise, Plan
from pincal.model.mechanism import Mechanism
from pincal.symmetry.detect import symmetry_group
from pincal.symmetry.elements import Element

Array = NDArray[np.float64]
Protocol = Literal["independent", "symmetric", "orbits", "common"]


@dataclass(frozen=True)
class LegDesign:
    """What a selection gives one leg."""

    leg: str
    poses: int
    """Poses that serve the leg."""
    efficiency: float
    """(det/det of the continuous bound)^(1/n) of the search that chose them."""
    indices: Indices
    """Of the identification Jacobian in readings, not weighted."""
    r_diagonal: Array
    """|R_ii| of the same, shape (n_params,)."""
    condition: float


@dataclass(frozen=True)
class Selection:
    """Selected poses and how good they are."""

    plan: Plan
    protocol: Protocol
    legs: tuple[LegDesign, ...]
    candidates: int
    """Candidate poses that all legs reach."""
    unreachable: int
    """Candidate poses that were left out, not being reached."""

    @property
    def efficiency(self) -> float:
        """Smallest efficiency of all legs."""
        return min(leg.efficiency for leg in self.legs)


def noise_weighted(demand: Demand, mechanism: Mechanism, noise: Noise) -> Array:
    """Return parameter rows whitened by the noise of their residuals, shape (N, k, n).

    Raises:
        MeasurementError: a residual has no noise.
    """
    noisy = np.concatenate(
        (demand.pose * noise.of_poses(mechanism), demand.reading * noise.reading), axis=2
    )
    covariance = noisy @ noisy.transpose(0, 2, 1)
    if (np.einsum("nkk->nk", covariance) == 0.0).any():
        raise MeasurementError(
            "a residual has no noise at all; give a standard deviation above zero for position, "
            "orientation or reading (only their ratios matter to the choice)"
        )
    if covariance.shape[1] == 1:
        return np.asarray(demand.parameter / np.sqrt(covariance))
    reached = np.isfinite(covariance).all(axis=(1, 2))
    rows = np.full(demand.parameter.shape, np.nan)
    roots = np.linalg.cholesky(covariance[reached])
    rows[reached] = np.linalg.solve(roots, demand.parameter[reached])
    return rows


def select_poses(
    mechanism: Mechanism,
    candidates: Array,
    count: int = 24,
    protocol: Protocol = "symmetric",
    *,
    noise: Noise | None = None,
    seed: int | np.random.Generator = 0,
    starts: int = 20,
    progress: Callable[[str], None] | None = None,
) -> Selection:
    """Return poses chosen from candidates for D-optimality, with a certificate.

    Rows are weighted by the noise they carry, so that poses near type-1 singularities do
    not look better than they are.

    Args:
        mechanism: The mechanism.
        candidates: Poses to choose from, coordinates of shape (M, dof), [m] and [rad]; one that
            is there twice counts once, whatever its whole turns and its last digits.
        count: Poses for each leg; with ``orbits``, number of orbits; with ``common``, poses.
        protocol: See the module.
        noise: Standard deviations of the measurements to come; only their ratios matter.
        seed: Seed or generator of the random starts.
        starts: Starts of the exchange; the best is kept.
        progress: Called with what is being done.

    Raises:
        ObservabilityError: too few poses for the parameters, too few candidates in reach, or
            candidates that leave a parameter undetermined.
        SymmetryError: the mechanism lacks the symmetry that ``symmetric`` or ``orbits`` needs.
    """
    noise = noise or Noise()
    rng = np.random.default_rng(seed)
    tell = progress or (lambda _: None)
    transforms = mechanism.platform.transforms(candidates)
    kept = distinct(mechanism.platform, transforms)
    poses = np.asarray(candidates, dtype=np.float64)[kept]
    transforms = transforms if len(kept) == len(transforms) else transforms[kept]
    there = np.asarray(reached(mechanism, transforms).all(axis=1))
    search = _Search(mechanism, poses, there, noise, rng, starts, tell)
    names = mechanism.leg_names
    if protocol == "independent":
        parts = [search.own(name, count) for name in names]
        poses = np.concatenate([search.candidates[chosen] for chosen, _ in parts])
        sets = tuple(name for name in names for _ in range(count))
        efficiencies = [efficiency for _, efficiency in parts]
    elif protocol == "common":
        chosen, efficiency = search.common(count)
        poses, sets = search.candidates[chosen], (EVERY_LEG,) * count
        efficiencies = [efficiency] * len(names)
    else:
        carriers = symmetry_group(mechanism).carriers()
        if protocol == "symmetric":
            chosen, efficiency = search.own(names[0], count)
            sets = tuple(name for name in names for _ in range(count))
        else:
            chosen, efficiency = search.orbits(names[0], count, _closed(carriers))
            carriers = _closed(carriers)
            sets = (EVERY_LEG,) * (count * len(carriers))
        first = search.candidates[chosen]
        poses = np.concatenate([g.poses(mechanism.platform, first) for g in carriers])
        efficiencies = [efficiency] * len(names)
    plan = Plan(poses, sets)
    legs = tuple(
        _leg_design(mechanism, name, plan, efficiency)
        for name, efficiency in zip(names, efficiencies, strict=True)
    )
    return Selection(plan, protocol, legs, search.usable, search.unreachable)


class _Search:
    """Searches candidates for one leg, for its orbits, or for all legs together."""

    def __init__(
        self,
        mechanism: Mechanism,
        candidates: Array,
        reached: NDArray[np.bool_],
        noise: Noise,
        rng: np.random.Generator,
        starts: int,
        tell: Callable[[str], None],
    ) -> None:
        self.mechanism = mechanism
        self.candidates = candidates
        self.reached = reached
        self.noise = noise
        self.rng = rng
        self.starts = starts
        self.usable = len(candidates)
        self.unreachable = 0
        self.tell = tell

    def rows(self, leg: str, poses: Array) -> Array:
        """Return the weighted rows of a leg at poses, shape (N, k, n)."""
        return noise_weighted(leg_demand(self.mechanism, leg, poses), self.mechanism, self.noise)

    def own(self, leg: str, count: int) -> tuple[NDArray[np.intp], float]:
        """Return the chosen candidates for one leg, and their efficiency."""
        self.tell(f"choosing poses for {leg}")
        names = self.mechanism.leg(leg).parameter_names
        return self._choose(self.rows(leg, self.candidates), count, names, leg)

    def orbits(
        self, leg: str, count: int, elements: tuple[Element, ...]
    ) -> tuple[NDArray[np.intp], float]:
        """Return the candidates whose orbits are chosen, and the orbits' efficiency."""
        self.tell("choosing orbits")
        platform = self.mechanism.platform
        orbits = [g.poses(platform, self.candidates) for g in elements]
        blocks = np.concatenate([self.rows(leg, poses) for poses in orbits], axis=1)
        places = places_of(platform, np.concatenate(orbits)).reshape(len(orbits), len(blocks), 12)
        tree, own = KDTree(places[0]), np.arange(len(blocks))
        for image in places[1:]:  # of itself or of an earlier one: it would be measured twice
            distance, other = tree.query(image, p=np.inf)
            blocks[(distance <= SAME) & (other <= own)] = np.nan
        return self._choose(blocks, count, self.mechanism.leg(leg).parameter_names, leg)

    def common(self, count: int) -> tuple[NDArray[np.intp], float]:
        """Return the candidates chosen for all legs together, and their efficiency."""
        self.tell("choosing common poses")
        legs = self.mechanism.legs
        blocks = block_diagonal([self.rows(leg.name, self.candidates) for leg in legs])
        names = tuple(f"{leg.name}.{name}" for leg in legs for name in leg.parameter_names)
        return self._choose(blocks, count, names, self.mechanism.name)

    def _choose(
        self, blocks: Array, count: int, names: tuple[str, ...], where: str
    ) -> tuple[NDArray[np.intp], float]:
        n = len(names)
        usable = np.flatnonzero(np.isfinite(blocks).all(axis=(1, 2)) & self.reached)
        self.usable = min(self.usable, len(usable))
        self.unreachable = max(self.unreachable, len(self.candidates) - len(usable))
        if count * blocks.shape[1] < n:
            raise ObservabilityError(
                f"{count} poses give {count * blocks.shape[1]} equations for the {n} parameters of "
                f"{where}; choose at least {-(-n // blocks.shape[1])}, better two or three times "
                "as many"
            )
        if len(usable) < count:
            raise ObservabilityError(
                f"{self.mechanism.name} reaches {len(usable)} of {len(self.candidates)} candidate "
                f"poses; {count} are to be chosen"
            )
        blocks = blocks[usable]
        found = identifiability(blocks.reshape(-1, n), names)
        if not found.complete:
            raise ObservabilityError(
                f"the candidate poses leave parameters undetermined: {found.in_words(where)}. "
                "Add poses that tell them apart, or make one of them a constant"
            )
        design = continuous_design(blocks)
        chosen, log_det = exchange(blocks, count, design.weights, self.rng, self.starts)
        return usable[chosen], design.efficiency(log_det, count, n)


def _closed(elements: tuple[Element, ...]) -> tuple[Element, ...]:
    """Return the group that elements generate."""
    found = list(elements)
    for a in found:
        for b in elements:
            product = a.after(b)
            if not any(np.allclose(product.matrix, g.matrix, atol=1e-6) for g in found):
                found.append(product)
    return tuple(found)


def _leg_design(mechanism: Mechanism, leg: str, plan: Plan, efficiency: float) -> LegDesign:
    poses = plan.poses[plan.serves(leg)]
    rows = leg_demand(mechanism, leg, poses).as_joint()
    C = -rows.parameter.reshape(-1, rows.parameter.shape[2])
    names = mechanism.leg(leg).parameter_names
    condition = identifiability(C, names).condition
    return LegDesign(leg, len(poses), efficiency, indices(C), r_diagonal(C), condition)
