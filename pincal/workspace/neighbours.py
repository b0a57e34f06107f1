"""Neighbours on a grid: where positions that count meet others, and which hang together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pincal.workspace.positions import BLOCK, Grid, Indices

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def edges(grid: Grid, inside: Mask) -> Indices:
    """Return pairs of neighbours of which one counts, by number, shape (M, 2)."""
    cells = inside.reshape(grid.shape)
    found = []
    for place, n in enumerate(grid.shape):
        first, second = [slice(None)] * cells.ndim, [slice(None)] * cells.ndim
        first[place], second[place] = slice(0, n - 1), slice(1, n)
        differ = np.argwhere(cells[tuple(first)] != cells[tuple(second)])
        found.append(_pairs(grid, differ, differ + np.eye(cells.ndim, dtype=np.int64)[place]))
        if _closed(grid, place):
            wrap = np.argwhere(cells.take([0], place) != cells.take([n - 1], place))
            last = wrap.copy()
            last[:, place] = n - 1
            found.append(_pairs(grid, last, wrap))
    return np.concatenate(found)


def at_edge(grid: Grid, inside: Mask) -> Array:
    """Return where positions that count end the grid, half a step outside, shape (M, 3), [m]."""
    cells = inside.reshape(grid.shape)
    found = [np.empty((0, 3))]
    for place, axis in enumerate(grid.axes):
        n = len(axis.values)
        if n < 2 or axis.full_turn:
            continue
        for end, sign in ((0, -1.0), (n - 1, 1.0)):
            if axis.name == "radius" and sign < 0 and axis.values[0] <= axis.step:
                continue  # the centre is no edge
            where = np.argwhere(cells.take([end], place))
            where[:, place] = end
            coordinates = [a.values[i] for a, i in zip(grid.axes, where.T, strict=True)]
            coordinates[place] = coordinates[place] + sign * axis.step / 2
            found.append(grid.cartesian(coordinates))
    return np.concatenate(found)


def part_around(grid: Grid, inside: Mask, home: Array) -> Mask:
    """Return the positions that count and hang together with the one nearest to home, (N,).

    Args:
        grid: The grid.
        inside: Which positions count, shape (N,).
        home: Shape (3,), [m].
    """
    from scipy.ndimage import binary_propagation  # slow to import, and needed here only

    whole = inside.reshape(grid.shape)
    box = tuple(_extent(grid, whole, place) for place in range(whole.ndim))
    cells = whole[box]
    part = np.zeros(cells.shape, dtype=bool)
    first = np.unravel_index(_nearest(grid, inside, home), grid.shape)
    part[tuple(i - side.start for i, side in zip(first, box, strict=True))] = True
    around = [place for place in range(cells.ndim) if _closed(grid, place)]
    while True:
        part = binary_propagation(part, mask=cells)
        grown = False
        for place in around:  # first and last value are neighbours
            ends = part.take([0, -1], place).any(axis=place, keepdims=True)
            for end in (0, -1):
                where = [slice(None)] * cells.ndim
                where[place] = slice(end, None) if end else slice(0, 1)
                more = ends & cells[tuple(where)] & ~part[tuple(where)]
                part[tuple(where)] |= more
                grown |= bool(more.any())
        if not grown:
            break
    result = np.zeros(grid.shape, dtype=bool)
    result[box] = part
    return result.ravel()


def _extent(grid: Grid, cells: Mask, place: int) -> slice:
    """Return the values of an axis between which cells count; all of one that closes."""
    if _closed(grid, place):
        return slice(0, cells.shape[place])
    others = tuple(axis for axis in range(cells.ndim) if axis != place)
    some = np.flatnonzero(cells.any(axis=others))
    return slice(int(some[0]), int(some[-1]) + 1)


def _nearest(grid: Grid, inside: Mask, home: Array) -> int:
    """Return the number of the position that counts and is nearest to home."""
    best, least = 0, np.inf
    for begin in range(0, len(inside), BLOCK):
        index = begin + np.flatnonzero(inside[begin : begin + BLOCK])
        if len(index):
            away = np.linalg.norm(grid.at(index) - home, axis=1)
            place = int(np.argmin(away))
            if away[place] < least:
                best, least = int(index[place]), float(away[place])
    return best


def _closed(grid: Grid, place: int) -> bool:
    """Return whether the first and last value of an axis are neighbours."""
    axis = grid.axes[place]
    return axis.name == "bearing" and axis.full_turn and len(axis.values) > 2


def _pairs(grid: Grid, first: Indices, second: Indices) -> Indices:
    """Return places on the axes as pairs of numbers, shape (M, 2)."""
    ends = [np.ravel_multi_index(tuple(end.T), grid.shape) for end in (first, second)]
    return np.stack(ends, axis=1).astype(np.int64)
