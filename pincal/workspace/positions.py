"""Positions at which a workspace is asked: a grid, or samples, that symmetry maps onto itself.

Neither is ever held whole: positions are made from their numbers. An element of the
mechanism's group that maps the set onto itself makes one position of each orbit enough;
the lowest number of an orbit represents it, so that these form a fundamental domain.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pincal.errors import WorkspaceError
from pincal.kinematics.closed_forms import Turned
from pincal.model.checks import ALIKE
from pincal.model.mechanism import Mechanism
from pincal.symmetry.elements import IDENTITY, SAME, Element, Isometry
from pincal.types import Array, Mask
from pincal.workspace.axes import MOST, Axis, Orientations
from pincal.workspace.criteria import Criteria, Margins, criteria_of

Indices = NDArray[np.int64]
#: Takes numbers of positions to those of their images.
Carrier: TypeAlias = Callable[[Indices], Indices]
POSITION_AXES = ("x", "y", "radius", "bearing", "z")
BLOCK = 1 << 17
"""Positions, or pairs of position and orientation, in memory at a time."""


class Positions(Protocol):
    """A numbered set of positions in the base frame."""

    @property
    def size(self) -> int:
        """Number of positions."""

    @property
    def dimension(self) -> int:
        """1, 2 or 3: whether a length, area or volume is measured."""

    def at(self, index: Indices) -> Array:
        """Return positions by number, shape (N, 3), [m]."""

    def measures(self, index: Indices) -> Array:
        """Return the length, area or volume that each position represents, shape (N,)."""

    def carrier(self, move: Isometry) -> Carrier | None:
        """Return what an isometry does to the numbers, or None if the set does not map."""


@dataclass(frozen=True, eq=False, repr=False)
class Grid:
    """Grid of positions: ``x, y`` or ``radius, bearing``, and ``z``."""

    axes: tuple[Axis, ...]

    def __post_init__(self) -> None:
        names = [axis.name for axis in self.axes]
        if names[:2] not in (["x", "y"], ["radius", "bearing"]) or names[2:] not in ([], ["z"]):
            raise WorkspaceError(
                "a grid of positions has the axes x, y (or radius, bearing) and, in space, z, "
                f"each once; got {', '.join(names) or 'none'}"
            )
        for axis in self.axes:
            steps = np.diff(axis.values)
            if len(steps) and np.ptp(steps) > ALIKE * axis.step:
                raise WorkspaceError(
                    f"axis {axis.name!r} of positions is not evenly spaced; each value is "
                    "a cell of one step"
                )
            if axis.name == "bearing" and axis.step * len(axis.values) > 2 * np.pi * (1 + ALIKE):
                raise WorkspaceError(
                    "axis 'bearing' goes round more than once, or its step does not divide the "
                    "full turn; expected for example 'bearing [deg]=0:360:5'"
                )
        if self.size > MOST.positions:
            raise WorkspaceError(
                f"a grid of {self.size:.3g} positions; at most {MOST.positions:.0e}"
            )

    def __repr__(self) -> str:
        """Return the grid in a line."""
        axes = ", ".join(repr(axis).removeprefix("Axis: ") for axis in self.axes)
        return f"Grid: {self.size:,} positions; {axes}"

    @classmethod
    def of(cls, *axes: str | Axis) -> Grid:
        """Return a grid from axes or their texts, in any order: ``"x=-1:1:0.1"``."""
        parsed = [Axis.parse(axis) if isinstance(axis, str) else axis for axis in axes]
        if unknown := [axis.name for axis in parsed if axis.name not in POSITION_AXES]:
            raise WorkspaceError(f"axis {unknown[0]!r} is not one of positions: {POSITION_AXES}")
        return cls(tuple(sorted(parsed, key=lambda axis: POSITION_AXES.index(axis.name))))

    @property
    def polar(self) -> bool:
        """Whether the first axes are radius and bearing."""
        return self.axes[0].name == "radius"

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values of each axis."""
        return tuple(len(axis.values) for axis in self.axes)

    @property
    def size(self) -> int:
        """Number of positions."""
        return math.prod(self.shape)

    @property
    def dimension(self) -> int:
        """Number of axes with more than one value."""
        return sum(n > 1 for n in self.shape)

    def at(self, index: Indices) -> Array:
        """Return positions by number, shape (N, 3), [m]."""
        return self.cartesian(
            [a.values[i] for a, i in zip(self.axes, self.split(index), strict=True)]
        )

    def cartesian(self, coordinates: Sequence[Array]) -> Array:
        """Return positions from values along the axes, shape (N, 3), [m]."""
        first, second, *rest = coordinates
        if self.polar:
            first, second = first * np.cos(second), first * np.sin(second)
        third = rest[0] if rest else np.zeros_like(first)
        return np.stack((first, second, third), axis=-1)

    def measures(self, index: Indices) -> Array:
        """Return the length, area or volume of cells: axes with one value do not count."""
        result = np.ones(len(index))
        for axis, i in zip(self.axes, self.split(index), strict=True):
            if len(axis.values) > 1:
                if axis.name == "radius":  # r dr, exact for the ring
                    inner = np.maximum(axis.values[i] - axis.step / 2, 0.0)
                    result *= ((axis.values[i] + axis.step / 2) ** 2 - inner**2) / 2
                else:
                    result *= axis.step
        if self.polar and len(self.axes[0].values) == 1:
            result *= self.axes[0].values[0]
        return result

    def carrier(self, move: Isometry) -> Carrier | None:
        """Return what an isometry does to the numbers, or None if the grid does not map."""
        Q, t = move.Q, move.t
        values = [axis.values for axis in self.axes]
        if len(values) < 3:
            values.append(np.zeros(1))
        if self.polar:
            across = (Q[:2, 2], Q[2, :2], t[:2] / max(1.0, float(values[0][-1])))
            if max(np.abs(part).max() for part in across) > SAME:
                return None
            side = np.sign(np.linalg.det(Q[:2, :2]))
            turned = np.arctan2(Q[1, 0], Q[0, 0]) + side * values[1]
            source = [0, 1, 2]
            images: list[Array] = [values[0], turned, Q[2, 2] * values[2] + t[2]]
        else:
            whole = Q.round()
            if np.abs(Q - whole).max() > SAME:  # only quarter turns and such
                return None
            # values that come to lie on each axis, in their own order
            source = [int(np.argmax(np.abs(row))) for row in whole]
            images = [whole[i, k] * values[k] + t[i] for i, k in enumerate(source)]
        if len(self.axes) < 3:
            if source[2] != 2 or abs(images[2][0]) > SAME * max(1.0, np.abs(values[0]).max()):
                return None
            source, images = source[:2], images[:2]
        maps = [_match(axis, image) for axis, image in zip(self.axes, images, strict=True)]
        if any(m is None for m in maps):
            return None

        def carry(index: Indices) -> Indices:
            split = self.split(index)
            moved = tuple(m[split[k]] for m, k in zip(maps, source, strict=True) if m is not None)
            return np.ravel_multi_index(moved, self.shape).astype(np.int64)

        return carry

    def split(self, index: Indices) -> tuple[Indices, ...]:
        """Return the place of positions on each axis."""
        return np.unravel_index(index, self.shape)


def _match(axis: Axis, images: Array) -> Indices | None:
    """Return which values of an axis equal its images, or None if they are not the same set."""
    values, period = axis.values, 2 * np.pi if axis.name == "bearing" else np.inf
    if len(images) != len(values):
        return None
    if np.isfinite(period):
        images = values[0] + (images - values[0] + SAME) % period - SAME
    index = np.searchsorted(values, images - SAME * max(1.0, float(np.abs(values).max())))
    index = np.minimum(index, len(values) - 1)
    size = float(np.ptp(values)) or 1.0
    return index if np.abs(values[index] - images).max() <= 4 * SAME * max(1.0, size) else None


@dataclass(frozen=True, repr=False)
class Samples:
    """Random positions, evenly in a cylinder about z; whole orbits of a group at a time."""

    count: int
    """Number of positions asked for; as many whole orbits as hold it."""
    radius: float
    """Of the cylinder, [m]."""
    height: tuple[float, float] = (0.0, 0.0)
    """Lower and upper end of the cylinder, [m]; equal in a plane."""
    seed: int = 0
    elements: tuple[Element, ...] = (IDENTITY,)
    """Group in whose orbits positions come."""

    def __post_init__(self) -> None:
        finite = np.isfinite([self.radius, *self.height]).all()
        ordered = self.radius > 0.0 and self.height[0] <= self.height[1]
        if not (1 <= self.count <= MOST.values and finite and ordered and self.elements):
            raise WorkspaceError(
                f"{self.count} samples in a cylinder of radius {self.radius:g}, height "
                f"{self.height[0]:g} to {self.height[1]:g}: expected 1 to {MOST.values:,}, a "
                "positive radius, and the lower end first"
            )

    def __repr__(self) -> str:
        """Return the samples in a line."""
        low, high = self.height
        return (
            f"Samples: {self.size:,} positions in a cylinder of radius {self.radius:.6g} m, height "
            f"{low:.6g} to {high:.6g} m, seed {self.seed}"
        )

    @property
    def size(self) -> int:
        """Number of positions."""
        order = len(self.elements)
        return -(-self.count // order) * order

    @property
    def dimension(self) -> int:
        """2 in a plane, 3 in space."""
        return 2 if self.height[0] == self.height[1] else 3

    def at(self, index: Indices) -> Array:
        """Return positions by number, shape (N, 3), [m]."""
        points = self._first[index // len(self.elements)]
        which = index % len(self.elements)
        matrices = np.stack([element.matrix for element in self.elements])
        shifts = np.stack([element.base.t for element in self.elements])
        return np.einsum("nij,nj->ni", matrices[which], points) + shifts[which]

    def measures(self, index: Indices) -> Array:
        """Return the share of the cylinder's area or volume, [m²] or [m³], shape (N,)."""
        whole = np.pi * self.radius**2 * ((self.height[1] - self.height[0]) or 1.0)
        return np.full(len(index), whole / self.size)

    def carrier(self, move: Isometry) -> Carrier | None:
        """Return what an isometry does to the numbers, or None if it is not of the group."""
        table = []
        for element in self.elements:
            target = move.after(element.base)
            same = [i for i, e in enumerate(self.elements) if e.base.equals(target)]
            if not same:
                return None
            table.append(same[0])
        images = np.array(table, dtype=np.int64)

        def carry(index: Indices) -> Indices:
            within = index % len(images)
            return index - within + images[within]

        return carry

    @cached_property
    def _first(self) -> Array:
        """First position of each orbit, shape (n_orbits, 3)."""
        rng = np.random.default_rng(self.seed)
        r, bearing, h = rng.uniform(size=(3, self.size // len(self.elements)))
        low, high = self.height
        r, bearing = self.radius * np.sqrt(r), 2 * np.pi * bearing
        return np.stack((r * np.cos(bearing), r * np.sin(bearing), low + (high - low) * h), axis=1)


def representatives(
    positions: Positions, moves: Sequence[Isometry]
) -> Callable[[Indices], Indices]:
    """Return what takes numbers of positions to the lowest numbers of their orbits.

    Args:
        positions: The positions.
        moves: Isometries that map them onto themselves; of what they generate, all are used.
    """
    moves = list(moves)
    for first in moves:
        for second in tuple(moves):
            product = first.after(second)
            if not any(product.equals(move) for move in moves):
                moves.append(product)
    found = [positions.carrier(move) for move in moves]
    carriers = [carrier for carrier in found if carrier]

    def lowest(index: Indices) -> Indices:
        result = index
        for carrier in carriers:
            result = np.minimum(result, carrier(index))
        return result

    return lowest


_FIRST = 16  # orientations after which closed loops ask who is decided, then 8 times as many


@dataclass(frozen=True)
class PositionTest:
    """Decides which positions are reached in any, or in every, orientation of a set."""

    mechanism: Mechanism
    orientations: Orientations
    every: bool
    least: Margins

    @cached_property
    def _criteria(self) -> Criteria:
        return criteria_of(self.mechanism, self.least)

    def __reduce__(self) -> tuple[type[PositionTest], tuple[object, ...]]:
        """Pickle what is given, not what is cached: it goes to other processes often."""
        return PositionTest, (self.mechanism, self.orientations, self.every, self.least)

    @property
    def in_closed_form(self) -> bool:
        """Whether no loop needs to be closed to decide."""
        return self._criteria.in_closed_form

    def __call__(self, positions: Array) -> Mask:
        """Return which positions, shape (N, 3), count."""
        size = max(1, BLOCK // len(self.orientations))
        inside = np.empty(len(positions), dtype=bool)
        decide = self._all if self.every else self._any
        for begin in range(0, len(positions), size):
            rows = slice(begin, begin + size)
            inside[rows] = decide(positions[rows])
        return inside

    @cached_property
    def _turns(self) -> tuple[Array, list[Turned]]:
        """Orientations as matrices, shape (O, 3, 3), and each leg's point turned by them.

        Those that are likely to decide come first: the far ones if every one must be reached.
        """
        rotations = self.orientations.rotations
        home = self.mechanism.platform.home_pose.rotation[0]
        far = (home.inv() * rotations).magnitude()
        R = rotations.as_matrix()[np.argsort(-far if self.every else far, kind="stable")]
        return R, [reach.turned(R) for reach in self._criteria.reaches]

    def _all(self, positions: Array) -> Mask:
        """Return which positions are reached in every orientation; a leg that fails ends it."""
        R, arms = self._turns
        alive = np.arange(len(positions))
        for reach, arm in zip(self._criteria.reaches, arms, strict=True):
            alive = alive[reach.holds_all(positions[alive], arm)]
        inside = np.zeros(len(positions), dtype=bool)
        if not self.in_closed_form:
            possible = np.ones((len(alive), len(R)), dtype=bool)
            alive = alive[self._by_closing(positions[alive], possible)]
        inside[alive] = True
        return inside

    def _any(self, positions: Array) -> Mask:
        """Return which positions are reached in some orientation."""
        R, arms = self._turns
        possible = np.ones((len(positions), len(R)), dtype=bool)
        for reach, arm in zip(self._criteria.reaches, arms, strict=True):
            rows = np.flatnonzero(possible.any(axis=1))
            possible[rows] &= reach.holds_each(positions[rows], arm)
        if self.in_closed_form:
            return np.asarray(possible.any(axis=1))
        return self._by_closing(positions, possible)

    def _by_closing(self, positions: Array, possible: Mask) -> Mask:
        """Return which positions count, by closing the legs at possible pairs, shape (P,)."""
        R, _ = self._turns
        decided = np.zeros(len(positions), dtype=bool)  # failed if every, else reached
        begin, width = 0, _FIRST
        while begin < len(R) and not decided.all():
            columns = slice(begin, begin + width)
            open_rows = np.flatnonzero(~decided)
            row, column = np.nonzero(possible[open_rows, columns])
            row, column = open_rows[row], column + begin
            matrices = np.broadcast_to(np.eye(4), (len(row), 4, 4)).copy()
            matrices[:, :3, 3], matrices[:, :3, :3] = positions[row], R[column]
            deciding = self._criteria(matrices) != self.every
            decided[row[deciding]] = True
            begin, width = begin + width, 8 * width
        return decided != self.every
