"""Orbits of legs and of poses under symmetry, with no pose counted twice.

An element g that carries leg i onto leg j takes the rows of i at a pose x to the rows of j at the
carried pose, up to a constant change M of parameters: C_j(g x) M = C_i(x). Determinants therefore
rank poses equally for both legs, whatever the offset of a sensor, whose columns M mixes.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from pincal.design.forecast import leg_rows
from pincal.errors import SymmetryError
from pincal.files.measurements import as_noise
from pincal.kinematics.closure import nominal_legs
from pincal.kinematics.derivatives import leg_demands_at
from pincal.kinematics.singularity import margins
from pincal.model import EVERY_LEG, Mechanism, Noise, Plan, Platform, Poses
from pincal.model.checks import ALIKE
from pincal.symmetry.detect import SymmetryGroup, symmetry_group
from pincal.symmetry.elements import Element
from pincal.types import Array, Index, Mask


def distinct(platform: Platform, poses: Poses, readings: Array | None = None) -> Index:
    """Return the indices, in order, of the configurations that are no copies of earlier ones.

    Different coordinates of the same pose, such as angles a whole turn apart, are copies. Readings,
    shape (N, n_readings), are given where poses do not determine them.
    """
    originals = _originals(platform, poses, readings)
    return np.flatnonzero(originals == np.arange(len(originals)))


def _originals(platform: Platform, poses: Poses, readings: Array | None = None) -> Index:
    """Return the index of the first copy of each configuration (itself if unique), shape (N,).

    Positions, rotation matrices and readings are compared, scaled by their extents; copies of a
    copy are copies.
    """
    matrices = platform.matrices(poses)
    parts = [matrices[:, :3, 3], matrices[:, :3, :3].reshape(-1, 9)]
    parts += [] if readings is None else list(readings.T[:, :, None])
    for place, part in enumerate(parts):
        size = np.abs(part).max(initial=0.0)
        parts[place] = part / max(np.ptp(part, axis=0).max(), ALIKE * size) if size else part
    places = np.concatenate(parts, axis=1).round(7) + 0.0  # most copies are then equal
    places, row = np.unique(places, axis=0, return_inverse=True)
    pairs = KDTree(places, leafsize=30).query_pairs(ALIKE, p=np.inf, output_type="ndarray")
    adjacency = coo_array((np.ones(len(pairs)), pairs.T), (len(places), len(places)))
    group = connected_components(adjacency, directed=False)[1][row]
    _, first, number = np.unique(group, return_index=True, return_inverse=True)
    return np.asarray(first[number])


_MAPPED = 10.0  # residual of mapped rows that is allowed, over the group's tolerance


@lru_cache(maxsize=64)
def selection_group(mechanism: Mechanism) -> SymmetryGroup:
    """Return the elements that can map poses, whatever the sensors are.

    Elements that take home across a type-2 singularity are left out: the machine cannot go there.
    """
    group = symmetry_group(mechanism)
    platform = mechanism.platform
    home = np.array([platform.home])
    images = np.concatenate([element.poses(platform, home) for element in group.elements])
    with np.errstate(invalid="ignore"):
        across = margins(mechanism, images).type2 < 0.0
    drivable = group.part([i for i, crosses in enumerate(across) if not crosses])
    if len(mechanism.legs) > 1 and len(drivable.leg_orbits) == len(mechanism.legs):
        group.carriers()  # raises an error that says what breaks the symmetry
        drivable.carriers()
    return drivable


def carried_legs(
    group: SymmetryGroup, poses: Array, noise: Noise | None = None
) -> dict[str, tuple[str, Element, bool]]:
    """Return for each leg its reference leg, the element from there, and whether it is as good.

    The reference leg's choice is equally good for a leg if whitened rows map, and not only the
    parameters; this is tested at poses that all legs reach, coordinates of shape (N, dof).

    Raises:
        SymmetryError: legs of one orbit have different parameters.
        MeasurementError: a residual has no noise.
    """
    mechanism, noise = group.mechanism, as_noise(noise)
    matrices = mechanism.platform.matrices(poses)
    nominal = dict(zip(mechanism.leg_names, nominal_legs(mechanism), strict=True))
    carried: dict[str, tuple[str, Element, bool]] = {}
    for legs in group.leg_orbits:
        carriers = group.carriers(legs[0])
        placed = [element.matrices(matrices) for element in carriers]
        by_reading, whitened = [], []
        for demand in leg_demands_at([nominal[name] for name in legs], placed):
            n = demand.parameter.shape[2]
            by_reading.append(demand.jacobian.reshape(-1, n))
            whitened.append(leg_rows(demand, mechanism, noise).reshape(-1, n))
        for place, (name, element) in enumerate(zip(legs, carriers, strict=True)):
            if not maps(by_reading[0], by_reading[place], group.tolerance):
                raise SymmetryError(
                    f"{element} carries {legs[0]} onto {name}, but not the parameters of one to "
                    "the other's: their columns span different spaces. Give both the same set "
                    "of parameters, or choose poses for each leg alone (--protocol independent)"
                )
            carried[name] = legs[0], element, maps(whitened[0], whitened[place], group.tolerance)
    return {name: carried[name] for name in mechanism.leg_names}


def maps(first: Array, second: Array, tolerance: float = 1e-6) -> bool:
    """Return whether ``second`` is ``first`` times a constant matrix, both of shape (N, n)."""
    if first.shape != second.shape:
        return False
    scale = np.linalg.norm(first, axis=0)
    scale[scale == 0.0] = 1.0
    M = np.linalg.lstsq(first / scale, second, rcond=1e-12)[0]
    misfit = np.linalg.norm(second - (first / scale) @ M, axis=0)
    return bool((misfit <= _MAPPED * tolerance * np.linalg.norm(second, axis=0)).all())


def smallest(group: SymmetryGroup) -> tuple[Element, ...]:
    """Return the elements of the smallest subgroup with the same orbits of legs."""
    sufficient = [part for part in group.subgroups() if part.leg_orbits == group.leg_orbits]
    return min(
        sufficient, key=lambda part: (len(part.elements), sum(e.reflection for e in part.elements))
    ).elements


def orbit_of(elements: Sequence[Element], matrices: Array) -> tuple[Array, Mask]:
    """Return the orbits of poses, shape (M, 4, 4), under a group whose first element is 1.

    These are the images, shape (E, M, 4, 4), and a mask, (E, M), of the images that differ from all
    earlier images of the same pose: a pose on a mirror has a smaller orbit.
    """
    images = np.stack([element.matrices(matrices) for element in elements])
    size = float(np.ptp(images[..., :3, 3], axis=(0, 1)).max())
    within = ALIKE * np.array((1.0, 1.0, 1.0, size or 1.0))
    first = np.ones(images.shape[:2], dtype=bool)
    for later in range(1, len(images)):
        for earlier in images[:later]:
            differ = np.abs(images[later] - earlier) > within
            first[later] &= differ.any(axis=(1, 2))
    return images, first


def representatives(images: Array) -> Array:
    """Return the image of each pose that is farthest along a fixed line, shape (M, 4, 4).

    All poses of an orbit have the same representative. Images are from ``orbit_of``.
    """
    line = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 4))
    farthest = np.einsum("emij,ij->em", images[:, :, :3], line).argmax(axis=0)
    return np.asarray(images[farthest, np.arange(len(farthest))])


def merged(mechanism: Mechanism, poses: Array, legs: Sequence[str]) -> Plan:
    """Return a plan of poses chosen for single legs; a pose chosen twice is one row for both."""
    served: dict[int, list[str]] = {}
    for row, leg in zip(_originals(mechanism.platform, poses).tolist(), legs, strict=True):
        served.setdefault(row, []).append(leg)
    every = len(mechanism.legs)
    sets = (EVERY_LEG if len(names) == every > 1 else "+".join(names) for names in served.values())
    return Plan(poses[list(served)], tuple(sets))
