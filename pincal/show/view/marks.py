"""Signs in a scene that are no machine: arrows of misses, an instrument on its stand, a camera."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pincal.show.style import DIMENSION
from pincal.show.view.found import Misses
from pincal.show.view.solids import PALE, Shape, across, rod

Array = NDArray[np.float64]
_LONGEST = 0.5  # of the scene's size: longer arrows are cut
_THIN = 0.0016  # half an arrow's width, of that size
_HEAD = 0.3  # of an arrow's length
_WIDE, _SLIM = 3.0, 14.0  # half width and length at most of a head, of the shaft's half width


def cut(misses: Misses, size: float) -> NDArray[np.bool_]:
    """Return which arrows are drawn shorter than they are, shape (n,)."""
    lengths = misses.magnify * np.linalg.norm(misses.shifts, axis=1)
    return np.asarray(lengths > _LONGEST * size)


def tips(misses: Misses, size: float) -> Array:
    """Return where arrows end as they are drawn, shape (n, 3), [m]."""
    lengths = misses.magnify * np.linalg.norm(misses.shifts, axis=1)
    shorter = np.minimum(1.0, _LONGEST * size / np.maximum(lengths, 1e-300))
    return misses.measured + (misses.magnify * shorter)[:, None] * misses.shifts


def arrows(misses: Misses, rows: NDArray[np.bool_], size: float) -> Array:
    """Return the triangles of arrows, shape (m, 3, 3), [m].

    Args:
        misses: From where to where.
        rows: Which are drawn.
        size: Of the scene, [m].
    """
    parts = []
    for begin, shift in zip(misses.measured[rows], misses.shifts[rows], strict=True):
        length = float(np.linalg.norm(shift))
        drawn = min(misses.magnify * length, _LONGEST * size)
        if drawn > 0.0:
            parts.append(_arrow(begin, shift / length, drawn, min(_THIN * size, 0.08 * drawn)))
    return np.concatenate(parts) if parts else np.zeros((0, 3, 3))


def _arrow(begin: Array, along: Array, length: float, half: float) -> Array:
    """Return the triangles of an arrow: a square shaft and a pyramid, shape (14, 3, 3)."""
    first, second = across(along)
    ring = np.array([first, second, -first, -second])
    tip = begin + length * along
    neck = tip - min(_HEAD * length, _SLIM * half) * along
    low, high, wide = begin + half * ring, neck + half * ring, neck + _WIDE * half * ring
    faces = []
    for one in range(4):
        two = (one + 1) % 4
        faces += [
            (low[one], low[two], high[two]),
            (low[one], high[two], high[one]),
            (wide[one], wide[two], tip),
        ]
    faces += [(wide[0], wide[2], wide[1]), (wide[0], wide[3], wide[2])]
    return np.array(faces)


def stand(size: float, planar: bool) -> tuple[Shape, ...]:
    """Return an instrument whose axes meet at the origin: a head and, in space, three legs.

    Args:
        size: Of the scene, [m].
        planar: Whether all is seen from above.
    """
    radius = 0.018 * size
    head = Shape("sphere", (radius,), np.eye(4), DIMENSION)
    if planar:
        return (head,)
    turns = np.radians([90.0, 210.0, 330.0])
    ends = np.column_stack((2.2 * np.cos(turns), 2.2 * np.sin(turns), np.full(3, -5.0))) * radius
    return (head, *(rod(np.zeros(3), end, 0.16 * radius, PALE) for end in ends))


def frustum(sees: tuple[float, float], depth: float) -> Array:
    """Return what a camera sees up to a depth, as segments in its frame, shape (9, 2, 3), [m].

    Four edges from where it stands, the rectangle of its picture there, and a mark on the side
    of the picture's top, which is towards −y.

    Args:
        sees: Half width and half height of that rectangle at a depth of 1.
        depth: [m].
    """
    x, y = sees
    corners = depth * np.array([[-x, -y, 1.0], [x, -y, 1.0], [x, y, 1.0], [-x, y, 1.0]])
    edges = [(np.zeros(3), corner) for corner in corners]
    edges += [(corners[one], corners[one - 1]) for one in range(4)]
    edges.append((depth * np.array([0.0, -y, 1.0]), depth * np.array([0.0, -1.4 * y, 1.0])))
    return np.array(edges)
