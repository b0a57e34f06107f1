"""Finite groups of elements: products, the largest closed subset, exact isometries, names.

Elements that were found one at a time, each within a tolerance, need not be a group. The products
of what they are meant to be decide which are; averaging over the group then makes their isometries
exact (K. Grove, H. Karcher, E. Ruh, Math. Annalen 211, 1974).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from pincal.symmetry.elements import SAME, Element, Isometry
from pincal.types import Array, Index

Table = Index
_NEAREST = 0.25  # how far a product may be from the element that it is meant to be, |Q − Q'|
_ROUNDS = 8  # of averaging: each squares the error
_NAMED = 1e-6  # within which mirrors go through the main axis


def product_table(elements: Sequence[Element], labels: Sequence[Sequence[int]] = ()) -> Table:
    """Return the index of each product, first the column's element, then the row's; −1 if none.

    Elements are perhaps not exact. Labels tell those apart that are near each other: indices, such
    as where they carry legs, of which those of a product are known.
    """
    turns = np.array([e.turns for e in elements])
    products = turns[:, None] @ turns
    distances = np.linalg.norm(products[:, :, None] - turns, axis=(4, 5)).max(axis=3)
    if len(labels):
        images = np.array(labels)
        composed = images[:, images]
        distances[(composed[:, :, None] != images).any(axis=3)] = np.inf
    best = distances.argmin(axis=2)
    return np.where(distances.min(axis=2) <= _NEAREST, best, -1)


def distinct(elements: Sequence[Element], labels: Sequence[object]) -> list[int]:
    """Return the indices of elements that are meant to be different, the first of each.

    They need not be exact. Labels are as in ``product_table``.
    """
    turns, chosen = np.array([e.turns for e in elements]), list[int]()
    for index, label in enumerate(labels):
        alike = turns[[i for i in chosen if labels[i] == label]]
        distances = np.linalg.norm(alike - turns[index], axis=(2, 3)).max(axis=1)
        if not (distances <= _NEAREST).any():
            chosen.append(index)
    return chosen


def generated(table: Table, seeds: Iterable[int]) -> frozenset[int] | None:
    """Return the indices that some elements generate, or None if a product is missing."""
    members = list(dict.fromkeys((0, *seeds)))
    for a in members:
        for b in tuple(members):
            for product in (int(table[a, b]), int(table[b, a])):
                if product < 0:
                    return None
                if product not in members:
                    members.append(product)
    return frozenset(members)


def subgroups(table: Table) -> list[frozenset[int]]:
    """Return all closed subsets, the smallest first: joins of what single elements generate."""
    single = [generated(table, [a]) for a in range(len(table))]
    closed = {subset for subset in single if subset is not None}
    fresh = set(closed)
    while fresh:
        joined = {generated(table, a | b) for a in fresh for b in single if b and not b <= a}
        fresh = {subset for subset in joined if subset is not None} - closed
        closed |= fresh
    return sorted(closed, key=lambda subset: (len(subset), sorted(subset)))


def largest_closed(table: Table) -> list[int]:
    """Return the indices of the largest closed subset, in order; the identity is index 0."""
    every = generated(table, range(len(table)))
    return sorted(every if every is not None else subgroups(table)[-1])


def exact(elements: Sequence[Element], centres: tuple[Array, Array], size: float) -> list[Element]:
    """Return the elements of a group with isometries that are a group to rounding errors.

    Args:
        elements: Of a group, each nearly right; the identity first.
        centres: A point near the fixed points of the base's isometries, and of the platform's.
        size: Scale of lengths, [m].
    """
    table = product_table(elements)
    bodies = [e.base for e in elements], [e.platform for e in elements]
    parts = (_exact_part(body, table, at, size) for body, at in zip(bodies, centres, strict=True))
    return [Element.of(base, platform) for base, platform in zip(*parts, strict=True)]


def _exact_part(
    isometries: Sequence[Isometry], table: Table, centre: Array, size: float
) -> list[Isometry]:
    """Return isometries of one body made exact: Q by averaging Q(gh) Q(h)ᵀ, t by a fixed point."""
    turns = np.array([isometry.Q for isometry in isometries])
    for _ in range(_ROUNDS):
        U, _, Vt = np.linalg.svd(np.einsum("ghij,hkj->gik", turns[table], turns))
        turns = U @ Vt
    turns[0] = np.eye(3)
    for _ in range(2):
        centre = np.mean([isometry(centre) for isometry in isometries], axis=0)
    centre = centre - (turns @ centre).mean(axis=0)  # less what no element moves
    if np.linalg.norm(centre) <= SAME * size:
        centre = np.zeros(3)
    if max(np.abs(turns[:, :2, 2]).max(), np.abs(turns[:, 2, :2]).max()) <= SAME:
        # about z to rounding: z stays, or turns over, exactly
        turns[:, :2, 2] = turns[:, 2, :2] = 0.0
        turns[:, 2, 2] = np.sign(turns[:, 2, 2])
    return [Isometry.of(Q, centre - Q @ centre) for Q in turns]


def group_name(elements: Sequence[Element]) -> str:
    """Return the name of a group: C_n of n rotations about an axis, D_2n with n mirrors through it.

    Of others, what they have: rotations, the identity among them, and reflections.
    """
    rotations = np.array([e.base.Q for e in elements if not e.reflection])
    mirrored = np.array([-e.base.Q for e in elements if e.reflection]).reshape(-1, 3, 3)
    angles = Rotation.from_matrix(rotations).magnitude()
    order = round(2 * np.pi / min([angle for angle in angles if angle > SAME], default=2 * np.pi))
    if order == len(rotations):
        if not len(mirrored):
            return f"C{order}"
        # mirrors are half turns times −1, about their normals, which lie across the main axis
        normals = Rotation.from_matrix(mirrored).as_rotvec() / np.pi
        axes = Rotation.from_matrix(rotations).as_rotvec()
        through = np.abs(np.linalg.norm(normals, axis=1) - 1.0).max() <= _NAMED
        if through and np.abs(normals @ axes.T).max() <= _NAMED:
            return f"D{2 * order}"
    return f"{len(rotations)} rotations" + f" and {len(mirrored)} reflections" * bool(len(mirrored))


def place_of(element: Element) -> tuple[bool, bool, float]:
    """Return what orders elements: rotations before reflections, about z before others."""
    angle = float(np.arctan2(element.matrix[1, 0], element.matrix[0, 0])) % (2 * np.pi)
    tilted = not element.is_identity and abs(element.matrix[2, 2] - 1.0) > 1e-6
    return element.reflection, tilted, round(angle, 6) % round(2 * np.pi, 6)
