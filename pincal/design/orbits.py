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
from pincal.files.read import as_noise
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

_LINES = 3  # along which places are looked at before they are looked at in full


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
    return places_at(platform.matrices(poses), readings)


def places_at(matrices: Array, readings: Array | None = None) -> Array:
    """Return where poses as matrices, shape (N, 4, 4), are: see ``places_of``."""
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
    alike = perhaps_alike(places)
    places, others = places[alike], np.flatnonzero(~alike)
    kept = np.sort(np.unique(places, axis=0, return_index=True)[1])
    while len(kept) > 1:  # of a pair of nearest neighbours the later one goes
        distance, other = KDTree(places[kept]).query(places[kept], k=2, p=np.inf)
        own = np.arange(len(kept))
        nearest = np.where(other[:, 0] == own, 1, 0)
        copies = (distance[own, nearest] <= ALIKE) & (other[own, nearest] < own)
        if not copies.any():
            break
        kept = kept[~copies]
    return np.sort(np.concatenate((others, np.flatnonzero(alike)[kept])))


def perhaps_alike(places: Array) -> Mask:
    """Return which places may be copies: they lie together along every line, shape (N,)."""
    alike = np.ones(len(places), dtype=bool)
    for line in np.random.default_rng(0).uniform(-1.0, 1.0, (_LINES, places.shape[1])):
        along = places[alike] @ line
        order = np.argsort(along)
        together = np.diff(along[order]) <= ALIKE * np.abs(line).sum()
        own = np.zeros(len(along), dtype=bool)
        own[order[:-1][together]] = own[order[1:][together]] = True
        alike[alike] = own
    return alike


_MAPPED = 1e-5  # part of rows that a change of parameters may leave: a group found within 1e-6


@dataclass(frozen=True)
class LegOrbit:
    """Legs that a group carries onto each other."""

    legs: tuple[str, ...]
    """The reference leg first."""
    carriers: tuple[Element, ...]
    """An element that carries the reference leg onto each."""
    alike: tuple[bool, ...]
    """Whether whitened rows of each map too: what is chosen for the reference leg is as good."""


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
    kept = group.part([i for i, crosses in enumerate(across) if not crosses])
    if len(mechanism.legs) > 1 and len(kept.leg_orbits) == len(mechanism.legs):
        group.carriers()  # says what breaks it
        kept.carriers()
    return kept


def leg_orbits(
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
    found, mechanism = [], group.mechanism
    matrices, noise = mechanism.platform.matrices(poses), as_noise(noise)
    nominal = dict(zip(mechanism.leg_names, nominal_legs(mechanism), strict=True))
    for legs in group.leg_orbits:
        carriers, alike, first = group.carriers(legs[0]), [True], legs[0]
        closures = [nominal[name] for name in legs]
        demands = leg_demands_at(closures, [element.matrices(matrices) for element in carriers])
        (own, white), *others = (_rows(demand, mechanism, noise) for demand in demands)
        for name, element, (its, its_white) in zip(legs[1:], carriers[1:], others, strict=True):
            if not maps(own, its):
                raise SymmetryError(
                    f"{element} carries {first} onto {name}, but not the parameters of one to "
                    "those of the other: their columns span other spaces. Give both the same set "
                    "of parameters, or choose poses for each leg on its own (--independent)"
                )
            alike.append(maps(white, its_white))
        found.append(LegOrbit(legs, carriers, tuple(alike)))
    return tuple(found)


def maps(first: Array, second: Array) -> bool:
    """Return whether rows, shape (N, n), are others times one constant matrix."""
    if first.shape != second.shape:
        return False
    scale = np.linalg.norm(first, axis=0)
    scale[scale == 0.0] = 1.0
    M = np.linalg.lstsq(first / scale, second, rcond=1e-12)[0]
    off = np.linalg.norm(second - (first / scale) @ M, axis=0)
    return bool((off <= _MAPPED * np.linalg.norm(second, axis=0)).all())


def _rows(demand: Demand, mechanism: Mechanism, noise: Noise) -> tuple[Array, Array]:
    """Return rows of a leg by readings, and whitened ones, shape (N k, n) each."""
    both = demand.as_joint().parameter, leg_rows(demand, mechanism, noise)
    by_reading, white = (rows.reshape(-1, rows.shape[2]) for rows in both)
    return by_reading, white


def smallest(group: SymmetryGroup) -> tuple[Element, ...]:
    """Return the elements of the smallest subgroup with the same orbits of legs."""
    same = [part for part in group.subgroups() if part.leg_orbits == group.leg_orbits]
    return min(
        same, key=lambda part: (len(part.elements), sum(e.reflection for e in part.elements))
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
    found = np.empty((len(elements), 4, 4, len(matrices))).transpose(0, 3, 1, 2)
    for images, element in zip(found, elements, strict=True):
        images[:] = element.matrices(matrices)
    size = float(np.ptp(found[..., :3, 3], axis=(0, 1)).max())
    within = ALIKE * np.array((1.0, 1.0, 1.0, size or 1.0))
    own = np.ones(found.shape[:2], dtype=bool)
    for later in range(1, len(found)):  # some element leaves a pose where it is, or none does
        own[later] = ~_together(found[later], found[0], within)
    fixed = np.flatnonzero(~own.all(axis=0))
    for later in range(2, len(found) if len(fixed) else 0):
        for earlier in range(1, later):
            own[later, fixed] &= ~_together(found[later, fixed], found[earlier, fixed], within)
    return found, own


def _together(first: Array, second: Array, within: Array) -> Mask:
    """Return which poses, shape (M, 4, 4), are the same within something by column, shape (M,)."""
    same = np.abs(first[:, 0, 3] - second[:, 0, 3]) <= within[3]
    some = np.flatnonzero(same)
    same[some] = (np.abs(first[some, :3] - second[some, :3]) <= within).all(axis=(1, 2))
    return same


def repeated(images: Array) -> Mask:
    """Return which poses are an image of an earlier one, shape (M,), of images (E, M, 4, 4)."""
    places = _places(images)
    count, poses, width = places.shape
    alike = perhaps_alike(places.reshape(-1, width)).reshape(count, poses)
    found, first = np.zeros(poses, dtype=bool), np.flatnonzero(alike[0])
    if not len(first):
        return found
    tree = KDTree(places[0, first])
    for image, where in zip(places, alike, strict=True):
        rows = np.flatnonzero(where)
        near = tree.query_ball_point(image[rows], ALIKE, p=np.inf)
        found[rows] |= [
            first[min(some)] < row if some else False for some, row in zip(near, rows, strict=True)
        ]
    return found


def _places(images: Array) -> Array:
    """Return where images, shape (E, M, 4, 4), are, shape (E, M, k): see ``places_of``."""
    places = places_at(images.reshape(-1, 4, 4))
    return places.reshape(*images.shape[:2], -1)


def merged(mechanism: Mechanism, poses: Array, legs: Sequence[str]) -> Plan:
    """Return a plan that holds no pose twice: one that two legs want serves both.

    Args:
        mechanism: The mechanism.
        poses: Coordinates, shape (N, dof).
        legs: For which leg each was chosen, length N.
    """
    places = places_of(mechanism.platform, poses)
    alike: dict[int, list[int]] = {}
    for first, second in KDTree(places).query_pairs(ALIKE, p=np.inf):
        alike.setdefault(max(first, second), []).append(min(first, second))
    wanted: dict[int, list[str]] = {}  # by the row that is kept
    for row, leg in enumerate(legs):
        same = [other for other in sorted(alike.get(row, ())) if other in wanted]
        wanted.setdefault(same[0] if same else row, []).append(leg)
    every = len(mechanism.legs)
    sets = tuple(EVERY_LEG if len(one) == every > 1 else "+".join(one) for one in wanted.values())
    return Plan(poses[list(wanted)], sets)
