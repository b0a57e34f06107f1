"""Orbits of legs and of poses: what one leg's choice gives the others, no pose counted twice.

An element that carries leg i onto leg j takes the rows of i at a pose to those of j at the carried
pose, but for one constant change of parameters: C_j(g x) M = C_i(x). Determinants then rank poses
alike, under any offset of a sensor, whose columns M mixes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import gcd

import numpy as np
from scipy.spatial import KDTree

from pincal.design.information import leg_rows
from pincal.errors import SymmetryError
from pincal.files.measurements import as_noise
from pincal.kinematics.batches import chunks
from pincal.kinematics.closure import nominal_legs
from pincal.kinematics.derivatives import Demand, leg_demands_at
from pincal.kinematics.singularity import margins
from pincal.model.checks import ALIKE
from pincal.model.measurements import EVERY_LEG, Noise, Plan
from pincal.model.mechanism import Mechanism
from pincal.model.platform import Platform, Poses
from pincal.symmetry.detect import SymmetryGroup, symmetry_group
from pincal.symmetry.elements import Element
from pincal.types import Array, Index, Mask


def places_of(platform: Platform, poses: Poses, readings: Array | None = None) -> Array:
    """Return positions, rotation matrices and readings over their extents, shape (N, 12 or more).

    Coordinates that say the same pose, such as angles a whole turn apart, have the same place.

    Args:
        platform: The platform.
        poses: Coordinates, shape (N, dof), [m] and [rad], or transforms.
        readings: Shape (N, n_readings), where poses do not determine them, [rad] or [m].

    Raises:
        MechanismError: a pose of a wrong shape, or not finite.
    """
    matrices = platform.matrices(poses)
    parts = [matrices[:, :3, 3], matrices[:, :3, :3].reshape(-1, 9)]
    parts += [] if readings is None else list(readings.T[:, :, None])
    sizes = [np.abs(part).max(initial=0.0) for part in parts]
    extents = [
        max(np.ptp(part, axis=0).max(), ALIKE * size) if size > 0.0 else 1.0
        for part, size in zip(parts, sizes, strict=True)
    ]
    return np.concatenate([p / e for p, e in zip(parts, extents, strict=True)], axis=1)


def distinct(platform: Platform, poses: Poses, readings: Array | None = None) -> Index:
    """Return the configurations that are no copies of earlier ones, as indices in order.

    Args:
        platform: The platform.
        poses: Coordinates, shape (N, dof), [m] and [rad], or transforms.
        readings: Shape (N, n_readings), where poses do not determine them, [rad] or [m].

    Raises:
        MechanismError: a pose of a wrong shape, or not finite.
    """
    places = places_of(platform, poses, readings)
    originals = np.sort(np.unique(places, axis=0, return_index=True)[1])
    while len(originals) > 1:  # of a pair of nearest neighbours the later one goes
        tree, index = KDTree(places[originals]), np.arange(len(originals))
        distance, neighbour = tree.query(tree.data, k=2, p=np.inf, distance_upper_bound=2 * ALIKE)
        nearest = np.where(neighbour[:, 0] == index, 1, 0)
        copies = (distance[index, nearest] <= ALIKE) & (neighbour[index, nearest] < index)
        if not copies.any():
            break
        originals = originals[~copies]
    return originals


_MAPPED = 1e-5  # part of rows that a change of parameters may leave: a group found within 1e-6


@dataclass(frozen=True)
class LegOrbit:
    """Legs that a group carries onto each other."""

    legs: tuple[str, ...]
    """Names of the legs, the reference leg first."""
    carriers: tuple[Element, ...]
    """Elements that carry the reference leg onto each."""
    equivalent: tuple[bool, ...]
    """Whether whitened rows of each map too, so that the reference leg's choice is as good."""


@lru_cache(maxsize=64)
def selection_group(mechanism: Mechanism) -> SymmetryGroup:
    """Return the elements by which poses can be mapped: sensors do not matter to them.

    Those that take home across a type-2 singularity are left out: it cannot be driven there.

    Raises:
        SymmetryError: the elements carry no leg onto another one.
    """
    group = symmetry_group(mechanism, readings=False)
    platform = mechanism.platform
    home = np.array([platform.home])
    images = np.concatenate([element.poses(platform, home) for element in group.elements])
    with np.errstate(invalid="ignore"):
        across = margins(mechanism, images).type2 < 0.0
    drivable = group.part([i for i, crosses in enumerate(across) if not crosses])
    if len(mechanism.legs) > 1 and len(drivable.leg_orbits) == len(mechanism.legs):
        group.carriers()  # says what breaks it
        drivable.carriers()
    return drivable


def orbits_of_legs(
    group: SymmetryGroup, poses: Array, noise: Noise | None = None
) -> tuple[LegOrbit, ...]:
    """Return the orbits of legs whose parameters map too.

    Args:
        group: The group.
        poses: Some poses that all legs reach, coordinates of shape (N, dof).
        noise: By which rows are whitened; the default if not given.

    Raises:
        SymmetryError: legs of one orbit have other parameters.
        MeasurementError: a residual has no noise.
    """
    orbits, mechanism = [], group.mechanism
    matrices, noise = mechanism.platform.matrices(poses), as_noise(noise)
    nominal = dict(zip(mechanism.leg_names, nominal_legs(mechanism), strict=True))
    for legs in group.leg_orbits:
        carriers, whitened_map = group.carriers(legs[0]), [True]
        closures = [nominal[name] for name in legs]
        demands = leg_demands_at(closures, [element.matrices(matrices) for element in carriers])
        (rows, white), *images = (_rows(demand, mechanism, noise) for demand in demands)
        for name, element, image in zip(legs[1:], carriers[1:], images, strict=True):
            if not maps(rows, image[0]):
                raise SymmetryError(
                    f"{element} carries {legs[0]} onto {name}, but not the parameters of one to "
                    "those of the other: their columns span other spaces. Give both the same set "
                    "of parameters, or choose poses for each leg alone (--protocol independent)"
                )
            whitened_map.append(maps(white, image[1]))
        orbits.append(LegOrbit(legs, carriers, tuple(whitened_map)))
    return tuple(orbits)


def maps(first: Array, second: Array) -> bool:
    """Return whether rows, shape (N, n), are others times one constant matrix."""
    if first.shape != second.shape:
        return False
    scale = np.linalg.norm(first, axis=0)
    scale[scale == 0.0] = 1.0
    M = np.linalg.lstsq(first / scale, second, rcond=1e-12)[0]
    misfit = np.linalg.norm(second - (first / scale) @ M, axis=0)
    return bool((misfit <= _MAPPED * np.linalg.norm(second, axis=0)).all())


def _rows(demand: Demand, mechanism: Mechanism, noise: Noise) -> tuple[Array, Array]:
    """Return rows of a leg by readings, and whitened ones, shape (N k, n) each."""
    by_reading, white = demand.as_joint().parameter, leg_rows(demand, mechanism, noise)
    n = white.shape[2]
    return by_reading.reshape(-1, n), white.reshape(-1, n)


def smallest(group: SymmetryGroup) -> tuple[Element, ...]:
    """Return the elements of the smallest subgroup with the same orbits of legs."""
    sufficient = [part for part in group.subgroups() if part.leg_orbits == group.leg_orbits]
    return min(
        sufficient, key=lambda part: (len(part.elements), sum(e.reflection for e in part.elements))
    ).elements


def multiplicities(orbits: Sequence[LegOrbit]) -> list[int]:
    """Return how often each orbit's reference leg counts, so that every leg counts alike."""
    sizes = [len(orbit.legs) for orbit in orbits]
    return [size // gcd(*sizes) for size in sizes]


def orbit_of(elements: Sequence[Element], matrices: Array) -> tuple[Array, Mask]:
    """Return the orbits of poses, and which images count.

    Args:
        elements: Of a group, the identity first.
        matrices: Poses ``T_base_platform``, shape (M, 4, 4).

    Returns:
        Images, shape (E, M, 4, 4); and which are not an earlier one of the same pose, (E, M): a
        pose on a mirror has a smaller orbit.
    """
    if len(elements) == 1:
        return matrices[None], np.ones((1, len(matrices)), dtype=bool)
    images = np.empty((len(elements), 4, 4, len(matrices))).transpose(0, 3, 1, 2)
    for image, element in zip(images, elements, strict=True):
        image[:] = element.matrices(matrices)
    size = float(np.ptp(images[..., :3, 3], axis=(0, 1)).max())
    within = ALIKE * np.array((1.0, 1.0, 1.0, size or 1.0))
    first = np.ones(images.shape[:2], dtype=bool)
    for later in range(1, len(images)):
        for earlier in range(later):
            first[later] &= ~_coincide(images[later], images[earlier], within)
    return images, first


def _coincide(first: Array, second: Array, within: Array) -> Mask:
    """Return which poses, shape (M, 4, 4), agree within something by column, shape (M,)."""
    agree = np.abs(first[:, 0, 3] - second[:, 0, 3]) <= within[3]
    rows = np.flatnonzero(agree)
    agree[rows] = (np.abs(first[rows, :3] - second[rows, :3]) <= within).all(axis=(1, 2))
    return agree


def representatives(elements: Sequence[Element], matrices: Array) -> Array:
    """Return of each pose's orbit the image that is farthest along a line, shape (M, 4, 4).

    Poses of one orbit have the same representative.

    Args:
        elements: Elements of a group, the identity first.
        matrices: Poses ``T_base_platform``, shape (M, 4, 4).
    """
    line, chosen = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 4)), np.empty(matrices.shape)
    for chunk in chunks(len(matrices)):
        images = np.stack([element.matrices(matrices[chunk]) for element in elements])
        along = np.einsum("emij,ij->em", images[:, :, :3], line)
        chosen[chunk] = images[along.argmax(axis=0), np.arange(along.shape[1])]
    return chosen


def merged(mechanism: Mechanism, poses: Array, legs: Sequence[str]) -> Plan:
    """Return a plan that holds no pose twice: one that two legs want serves both.

    Args:
        mechanism: The mechanism.
        poses: Coordinates, shape (N, dof).
        legs: For which leg each was chosen, length N.
    """
    places = places_of(mechanism.platform, poses)
    earlier: dict[int, list[int]] = {}
    for pair in KDTree(places).query_pairs(ALIKE, p=np.inf):
        earlier.setdefault(max(pair), []).append(min(pair))
    legs_of_row: dict[int, list[str]] = {}  # by the first row of each pose
    for row, leg in enumerate(legs):
        copies = [copy for copy in sorted(earlier.get(row, ())) if copy in legs_of_row]
        legs_of_row.setdefault(copies[0] if copies else row, []).append(leg)
    every = len(mechanism.legs)
    served = legs_of_row.values()
    sets = tuple(EVERY_LEG if len(names) == every > 1 else "+".join(names) for names in served)
    return Plan(poses[list(legs_of_row)], sets)
