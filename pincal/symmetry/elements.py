"""Symmetry elements, pairs of isometries of base and platform, and groups of them.

An element takes a pose T = T_base_platform to G_base T G_platform⁻¹. If base and platform are drawn
about the axis of symmetry, both isometries are the same rotation about z or reflection through it
(3-RRR paper, Eq. 5). Elements that were found separately, each within a tolerance, need not form a
group: a table of their nearest products decides which do, and averaging over the group makes their
isometries exact (K. Grove, H. Karcher, E. Ruh, Math. Annalen 211, 1974).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from pincal.errors import SymmetryError
from pincal.model import Platform, Poses
from pincal.model.checks import EXACT, ROUNDING, array_of, count_of, finite_rows, number_of
from pincal.types import Array, Index

SAME = EXACT  # largest difference by rounding, of angles [rad] and of positions over their extent
_NEAREST = 0.25  # largest distance |Q − Q'| of a product from the element that it stands for
_ROUNDS = 8  # rounds of averaging; each squares the error
_NAMED = 1e-6  # tolerance within which mirrors contain the main axis


def isometry(Q: Array, t: Array | float = 0.0) -> Array:
    """Return the matrix of x → Q x + t, shape (4, 4), of an orthogonal Q (3, 3)."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = Q, t
    return matrix + 0.0  # no negative zeros


def applied(G: Array, points: Array) -> Array:
    """Return the images of points, shape (N, 3), [m], under an isometry, shape (4, 4)."""
    return points @ G[:3, :3].T + G[:3, 3]


def same(first: Array, second: Array, within: float = SAME) -> bool:
    """Return whether two isometries are equal within a tolerance relative to their size."""
    difference, size = np.abs(first - second), max(1.0, float(np.abs(first[:3, 3]).max()))
    return bool(difference[:3, :3].max() <= within and difference[:3, 3].max() <= within * size)


class Element:
    """Pair of isometries, of base and platform, under which a mechanism may be unchanged.

    ``Element(angle)``, [rad], is a rotation about z, or a reflection through a plane that contains
    z, of both: a rotation takes an azimuth β to β + angle, a reflection to angle − β, so the mirror
    plane is at angle / 2. ``Element.of`` takes any other isometries.
    """

    base: Array
    """Isometry of the base, in the base frame, shape (4, 4)."""
    platform: Array
    """Isometry of the platform, in the platform frame, shape (4, 4)."""
    reflection: bool
    """Whether the isometries are reflections."""

    def __init__(self, angle: float, reflection: bool = False) -> None:
        angle = number_of(angle, "the angle of an element", SymmetryError)
        cos, sin, side = np.cos(angle), np.sin(angle), -1.0 if reflection else 1.0
        turn = np.array([[cos, -side * sin, 0.0], [sin, side * cos, 0.0], [0.0, 0.0, 1.0]])
        self.base = self.platform = isometry(turn)
        self.reflection = reflection

    @classmethod
    def of(cls, base: Array, platform: Array) -> Element:
        """Return the element of two isometries, (4, 4), in the form of an angle if possible.

        Raises:
            SymmetryError: only one isometry is a reflection, which would carry poses to no poses.
        """
        bodies = array_of((base, platform), (2, 4, 4), "both isometries", SymmetryError)
        base, platform = finite_rows(bodies.reshape(8, 4), "row", SymmetryError).reshape(2, 4, 4)
        reflection = bool(np.linalg.det(base[:3, :3]) < 0.0)
        if reflection != (np.linalg.det(platform[:3, :3]) < 0.0):
            raise SymmetryError(
                "only one of the two isometries is a reflection; expected both, of base and "
                "platform, or none"
            )
        element = cls(float(np.arctan2(base[1, 0], base[0, 0])), reflection)
        if not all(same(element.base, G, ROUNDING) for G in (base, platform)):
            element.base, element.platform = base + 0.0, platform + 0.0
        return element

    @staticmethod
    def mirror(azimuth: float) -> Element:
        """Return the reflection through the plane that contains z at an azimuth, [rad]."""
        return Element(wrapped(2 * number_of(azimuth, "azimuth", SymmetryError)), reflection=True)

    @property
    def matrix(self) -> Array:
        """Orthogonal matrix Q of the base's isometry, shape (3, 3)."""
        return self.base[:3, :3]

    @property
    def bodies(self) -> Array:
        """Both isometries, of base and platform, shape (2, 4, 4)."""
        return np.stack((self.base, self.platform))

    @property
    def turns(self) -> Array:
        """Orthogonal matrices of both isometries, shape (2, 3, 3)."""
        return self.bodies[:, :3, :3]

    def after(self, first: Element) -> Element:
        """Return the composition of ``first`` and then this element."""
        return Element.of(*(self.bodies @ first.bodies))

    def inverse(self) -> Element:
        """Return the element that undoes this one."""
        return Element.of(*(isometry(G[:3, :3].T, -G[:3, :3].T @ G[:3, 3]) for G in self.bodies))

    def equals(self, second: Element) -> bool:
        """Return whether two elements are equal up to rounding errors."""
        return same(self.base, second.base) and same(self.platform, second.platform)

    @property
    def is_identity(self) -> bool:
        """Whether the element is the identity up to rounding errors."""
        return self.equals(IDENTITY)

    def matrices(self, matrices: Array) -> Array:
        """Return the images G_base T G_platform⁻¹ of poses T_base_platform, shape (N, 4, 4)."""
        return np.asarray(self.base @ matrices @ self.inverse().platform)

    def poses(self, platform: Platform, poses: Poses) -> Array:
        """Return the images of poses as coordinates, shape (N, dof)."""
        return platform.from_matrices(self.matrices(platform.matrices(poses)))

    def positions(self, rotations: Array, slack: float = 0.0) -> Array | None:
        """Return the isometry of the platform's positions in some orientations, (N, 3, 3), or None.

        Positions go to Q r + t − R' s, with s the shift of the platform's isometry. It is an
        isometry if R' s is the same in all orientations within ``slack``, [m].
        """
        Q, shift = self.matrix, self.platform[:3, 3]
        if not shift.any():
            return self.base
        shifts = Q @ rotations @ (self.platform[:3, :3].T @ shift)
        if np.abs(shifts - shifts[0]).max() > SAME * np.linalg.norm(shift) + slack:
            return None
        return isometry(Q, self.base[:3, 3] - shifts[0])

    def __str__(self) -> str:
        Q = self.matrix
        if self.is_identity:
            return "identity"
        if np.abs(Q + np.eye(3)).max() <= SAME:
            return "inversion"
        turn = Rotation.from_matrix(-Q if self.reflection else Q).as_rotvec()
        amount = float(np.linalg.norm(turn))
        axis = turn / amount if amount else turn
        nonzero = axis[np.abs(axis) > SAME]
        axis = axis * np.sign(nonzero[-1:].sum() or 1.0)  # its last component is positive
        triple = "(" + ", ".join(f"{v + 0.0:.4g}" for v in axis.round(9)) + ")"
        upright, level = abs(abs(axis[2]) - 1.0) <= SAME, abs(axis[2]) <= SAME
        if self.reflection and abs(amount - np.pi) <= SAME:  # the axis is the mirror's normal
            azimuth = _degrees(np.arctan2(-axis[0], axis[1]), 180.0)
            across = f"across {'z' if upright else triple}"
            return f"mirror at azimuth {azimuth}" if level else f"mirror {across}"
        kind, around = "rotation", f"about {triple}"
        if self.reflection:  # −1 times a turn by α is a rotoreflection by α + 180°
            kind, amount = "rotoreflection", amount + np.pi
        elif level:
            around = f"about azimuth {_degrees(np.arctan2(axis[1], axis[0]), 180)}"
        turned = _degrees(amount * (1.0 if turn @ axis >= 0.0 else -1.0), 360.0)
        return f"{kind} by {turned}" if upright else f"{kind} by {turned} {around}"

    __repr__ = __str__


def _degrees(angle: float, period: float) -> str:
    value = float(f"{round(float(np.degrees(angle)), 9) % period:.4g}") % period
    return f"{value:.4g}°"


IDENTITY = Element(0.0)


def wrapped(angle: float) -> float:
    """Return an angle in (-pi, pi], [rad]."""
    return float(np.pi - (np.pi - angle) % (2 * np.pi))


def cyclic(n: int) -> tuple[Element, ...]:
    """Return C_n, the n rotations about z, the identity first."""
    n = count_of(n, "the order of rotation", SymmetryError)
    return tuple(Element(wrapped(2 * np.pi * k / n)) for k in range(n))


def dihedral(n: int, azimuth: float = 0.0) -> tuple[Element, ...]:
    """Return D_2n: n rotations about z, then n reflections through planes that contain z.

    Args:
        n: Number of rotations, and of mirrors.
        azimuth: Azimuth of the first mirror plane, [rad]; the others follow in steps of π / n.
    """
    azimuth = number_of(azimuth, "azimuth", SymmetryError)
    return cyclic(n) + tuple(Element.mirror(azimuth + np.pi * k / n) for k in range(n))


def product_table(elements: Sequence[Element], labels: Sequence[Sequence[int]] = ()) -> Index:
    """Return the index of each product, the row's element after the column's; −1 if none is near.

    ``labels`` are permutations, such as of the legs, that tell nearly equal elements apart.
    """
    turns = np.array([e.turns for e in elements])
    products = turns[:, None] @ turns
    distances = np.linalg.norm(products[:, :, None] - turns, axis=(4, 5)).max(axis=3)
    if len(labels):
        images = np.array(labels)
        composed = images[:, images]
        distances[(composed[:, :, None] != images).any(axis=3)] = np.inf
    return np.where(distances.min(axis=2) <= _NEAREST, distances.argmin(axis=2), -1)


def distinct(elements: Sequence[Element], labels: Sequence[object]) -> list[int]:
    """Return the indices of distinct elements, the first of each; labels keep equal ones apart."""
    turns, chosen = np.array([e.turns for e in elements]), list[int]()
    for index, label in enumerate(labels):
        labelled = turns[[i for i in chosen if labels[i] == label]]
        distances = np.linalg.norm(labelled - turns[index], axis=(2, 3)).max(axis=1)
        if not (distances <= _NEAREST).any():
            chosen.append(index)
    return chosen


def generated(table: Index, seeds: Iterable[int]) -> frozenset[int] | None:
    """Return the indices that the elements of ``seeds`` generate; None if a product is missing."""
    members = list(dict.fromkeys((0, *seeds)))
    for a in members:
        for b in tuple(members):
            for product in (int(table[a, b]), int(table[b, a])):
                if product < 0:
                    return None
                if product not in members:
                    members.append(product)
    return frozenset(members)


def subgroups(table: Index) -> list[frozenset[int]]:
    """Return all closed subsets, the smallest first, as joins of those of single generators."""
    single = [generated(table, [a]) for a in range(len(table))]
    closed = {subset for subset in single if subset is not None}
    fresh = set(closed)
    while fresh:
        joined = {generated(table, a | b) for a in fresh for b in single if b and not b <= a}
        fresh = {subset for subset in joined if subset is not None} - closed
        closed |= fresh
    return sorted(closed, key=lambda subset: (len(subset), sorted(subset)))


def largest_closed(table: Index) -> list[int]:
    """Return the sorted indices of the largest closed subset; the identity has index 0."""
    return sorted(generated(table, range(len(table))) or subgroups(table)[-1])


def exact(elements: Sequence[Element], centres: tuple[Array, Array], size: float) -> list[Element]:
    """Return nearly closed elements, the identity first, as a group exact to rounding errors.

    Centres, (3,), are near fixed points of the isometries of base and platform; the size is [m].
    """
    table, parts = product_table(elements), []
    bodies = np.stack([element.bodies for element in elements], axis=1)
    for isometries, centre in zip(bodies, centres, strict=True):
        turns = isometries[:, :3, :3]
        for _ in range(_ROUNDS):  # Q(g) is the average of Q(gh) Q(h)ᵀ over h
            U, _, Vt = np.linalg.svd(np.einsum("ghij,hkj->gik", turns[table], turns))
            turns = U @ Vt
        turns[0] = np.eye(3)
        for _ in range(2):  # t follows from a fixed point
            centre = np.mean([applied(G, centre) for G in isometries], axis=0)
        centre = centre - (turns @ centre).mean(axis=0)  # without the part that no element moves
        if np.linalg.norm(centre) <= SAME * size:
            centre = np.zeros(3)
        if max(np.abs(turns[:, :2, 2]).max(), np.abs(turns[:, 2, :2]).max()) <= SAME:
            # up to rounding about z: z is kept, or reversed, exactly
            turns[:, :2, 2] = turns[:, 2, :2] = 0.0
            turns[:, 2, 2] = np.sign(turns[:, 2, 2])
        parts.append([isometry(Q, centre - Q @ centre) for Q in turns])
    return [Element.of(base, platform) for base, platform in zip(*parts, strict=True)]


def group_name(elements: Sequence[Element]) -> str:
    """Return the name of a group: C_n of n rotations about an axis, D_2n with n mirrors too.

    Any other group is named by its numbers of rotations, the identity included, and reflections.
    """
    rotations = np.array([e.matrix for e in elements if not e.reflection])
    mirrored = np.array([-e.matrix for e in elements if e.reflection]).reshape(-1, 3, 3)
    angles = Rotation.from_matrix(rotations).magnitude()
    order = round(2 * np.pi / min([angle for angle in angles if angle > SAME], default=2 * np.pi))
    if order == len(rotations):
        if not len(mirrored):
            return f"C{order}"
        # mirrors are −1 times half turns about their normals, perpendicular to the main axis
        normals = Rotation.from_matrix(mirrored).as_rotvec() / np.pi
        axes = Rotation.from_matrix(rotations).as_rotvec()
        through = np.abs(np.linalg.norm(normals, axis=1) - 1.0).max() <= _NAMED
        if through and np.abs(normals @ axes.T).max() <= _NAMED:
            return f"D{2 * order}"
    return f"{len(rotations)} rotations" + f" and {len(mirrored)} reflections" * bool(len(mirrored))


def place_of(element: Element) -> tuple[bool, bool, float]:
    """Return the sorting key of elements: rotations before reflections, about z before others."""
    angle = float(np.arctan2(element.matrix[1, 0], element.matrix[0, 0])) % (2 * np.pi)
    tilted = not element.is_identity and abs(element.matrix[2, 2] - 1.0) > 1e-6
    return element.reflection, tilted, round(angle, 6) % round(2 * np.pi, 6)
