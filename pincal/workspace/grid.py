"""Grids of positions at which a workspace is computed, and their axes, ``x [mm]=-500:500:10``.

Positions are computed from their indices, never stored all. The lowest index of an orbit under the
mechanism's group represents the orbit; these positions form a fundamental domain.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from pincal.errors import WorkspaceError
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.model import Mechanism
from pincal.model.checks import ALIKE, must_be
from pincal.symmetry.detect import symmetry_group
from pincal.symmetry.elements import SAME
from pincal.types import Array, Mask
from pincal.words.numbers import UNITS

Indices = NDArray[np.int64]
Carrier: TypeAlias = Callable[[Indices], Indices]  # from positions' indices to their images'
_AXIS = re.compile(r"^\s*(\w+)\s*(?:\[\s*([^\[\]]*?)\s*\])?\s*=\s*(.+?)\s*$")
MOST = 10_000_000  # largest number of values of an axis, or of poses
#: Units of all axes of positions and orientations.
DIMENSIONS = {
    **dict.fromkeys(("x", "y", "z", "radius"), "m"),
    **dict.fromkeys(("bearing", "phi", "azimuth", "tilt", "torsion"), "rad"),
    **dict.fromkeys(("rx", "ry", "rz", "yaw", "pitch", "roll"), "rad"),
}
#: Angles that are periodic by a full turn.
TURNING = ("bearing", "phi", "azimuth", "torsion", "yaw", "roll")
POSITION_AXES = ("x", "y", "radius", "bearing", "z")
_MOST = 1_000_000_000  # largest number of positions, a byte each
_ACROSS = {2: 200, 3: 60}  # steps of a default grid across the box, in the plane and in space
_CLOSER = 0.8  # part of a grid's extent below which a closer grid is worth while
_AROUND = {2: 360, 3: 72}  # least number of bearings of a polar grid, in the plane and in space


@dataclass(frozen=True, eq=False, repr=False)
class Axis:
    """Increasing values of one coordinate."""

    name: str
    """``x``, ``y``, ``z``; ``radius``, ``bearing`` of a polar grid; or an orientation angle."""
    values: Array
    """Values, increasing, shape (n,), [m] or [rad]."""

    def __post_init__(self) -> None:
        if self.name not in DIMENSIONS:
            raise WorkspaceError(f"unknown axis {self.name!r}; expected {', '.join(DIMENSIONS)}")
        values = np.array(self.values, dtype=np.float64)
        if not values.size or values.ndim != 1 or not np.isfinite(values).all():
            raise WorkspaceError(f"axis {self.name!r} is empty or has values that are not finite")
        if (np.diff(values) <= 0).any():
            raise WorkspaceError(f"axis {self.name!r}: the values must increase")
        if self.name == "radius" and values[0] < 0.0:
            raise WorkspaceError("axis 'radius' has negative values")
        values.setflags(write=False)
        object.__setattr__(self, "values", values)

    def __repr__(self) -> str:
        first, last, unit = self.values[0], self.values[-1], DIMENSIONS[self.name]
        return f"Axis: {self.name} from {first:.6g} to {last:.6g} {unit}, {len(self.values)} values"

    @property
    def step(self) -> float:
        """Mean distance of neighbouring values; 0 for a single value."""
        return float(np.ptp(self.values) / max(len(self.values) - 1, 1))

    @property
    def full_turn(self) -> bool:
        """Whether the values are evenly spaced over a full turn."""
        turn = self.step * len(self.values)
        return self.name in TURNING and bool(np.isclose(turn, 2 * np.pi, rtol=1e-9))

    @classmethod
    def spaced(cls, name: str, low: float, high: float, step: float) -> Axis:
        """Return the axis from low to high in steps; a full turn leaves out its last value."""
        fault = None
        if not np.isfinite([low, high, step]).all():
            fault = "limits and step must be finite numbers"
        elif high < low:
            fault = f"limits reversed, {low:g} to {high:g}; write the lower one first"
        elif step <= 0.0:
            fault = f"the step is {step:g}; expected more than 0"
        elif (high - low) / step > MOST:
            fault = f"more than {MOST:,} values; take a larger step"
        if fault:
            raise WorkspaceError(f"axis {name!r}: {fault}")
        count = int(np.floor((high - low) / step + ALIKE)) + 1
        last = low + (count - 1) * step
        if abs(high - last) <= ALIKE * step:
            last = high
        values = np.linspace(low, last, count)
        if name in TURNING and count > 1 and np.isclose(last - low, 2 * np.pi, rtol=1e-9):
            values = values[:-1]
        return cls(name, values)

    @classmethod
    def parse(cls, text: str | Axis) -> Axis:
        """Return an axis, or that of ``NAME [UNIT]=LOW:HIGH:STEP`` or ``NAME [UNIT]=VALUE,…``."""
        if isinstance(text, Axis):
            return text
        match = _AXIS.match(must_be(text, str, "an axis", WorkspaceError))
        if not match:
            raise WorkspaceError(
                f"{text!r} is not an axis; expected for example 'x [mm]=-500:500:10' "
                "(low:high:step) or 'phi=0,0.4'"
            )
        name, unit, values = match.groups()
        dimension = DIMENSIONS.get(name)
        if dimension and unit is not None and UNITS.get(unit, ("", 0.0))[0] != dimension:
            fitting = ", ".join(u for u, (kind, _) in UNITS.items() if kind == dimension)
            raise WorkspaceError(f"axis {name!r} has unit [{unit}]; expected one of {fitting}")
        factor, separator = UNITS.get(unit, ("", 1.0))[1], ":" if ":" in values else ","
        try:
            numbers = [float(value) * factor for value in values.split(separator)]
        except ValueError:
            numbers = []
        if separator == ":" and len(numbers) == 3:
            return cls.spaced(name, *numbers)
        if separator == ":" or not numbers:
            raise WorkspaceError(
                f"axis {name!r}: {values!r} is not LOW:HIGH:STEP nor VALUE,VALUE,…"
            )
        return cls(name, np.unique(numbers))


@dataclass(frozen=True, eq=False, repr=False)
class Grid:
    """Grid of positions: ``x, y`` or ``radius, bearing``, and ``z``."""

    axes: tuple[Axis, ...]

    def __post_init__(self) -> None:
        axes = must_be(self.axes, Iterable, "axes of a grid", WorkspaceError)
        names = [must_be(axis, Axis, "an axis", WorkspaceError).name for axis in axes]
        if names[:2] not in (["x", "y"], ["radius", "bearing"]) or names[2:] not in ([], ["z"]):
            raise WorkspaceError(
                "a grid of positions has the axes x, y (or radius, bearing) and, in space, z, "
                f"each once; got {', '.join(names) or 'none'}"
            )
        for axis in self.axes:
            steps = np.diff(axis.values)
            if len(steps) and np.ptp(steps) > ALIKE * axis.step:
                raise WorkspaceError(
                    f"axis {axis.name!r} of positions is not evenly spaced; expected one step, "
                    "since each value stands for a cell of one step"
                )
            if axis.name == "bearing" and axis.step * len(axis.values) > 2 * np.pi * (1 + ALIKE):
                raise WorkspaceError(
                    "axis 'bearing' goes round more than once, or its step does not divide the "
                    "full turn; expected for example 'bearing [deg]=0:360:5'"
                )
        if self.size > _MOST:
            raise WorkspaceError(f"a grid of {self.size:.3g} positions; at most {_MOST:.0e}")

    def __repr__(self) -> str:
        axes = ", ".join(repr(axis).removeprefix("Axis: ") for axis in self.axes)
        return f"Grid: {self.size:,} positions; {axes}"

    @classmethod
    def of(cls, *axes: str | Axis) -> Grid:
        """Return a grid of axes in any order, also given as texts: ``"x=-1:1:0.1"``."""
        parsed = [Axis.parse(axis) for axis in axes]
        if unknown := [axis.name for axis in parsed if axis.name not in POSITION_AXES]:
            raise WorkspaceError(f"axis {unknown[0]!r}: expected one of {', '.join(POSITION_AXES)}")
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
        """Return the positions of some indices, shape (N, 3), [m]."""
        places = zip(self.axes, np.unravel_index(index, self.shape), strict=True)
        return self.cartesian([axis.values[i] for axis, i in places])

    def cartesian(self, coordinates: Sequence[Array]) -> Array:
        """Return the positions of values along the axes, shape (N, 3), [m]."""
        first, second, *heights = coordinates
        if self.polar:
            first, second = first * np.cos(second), first * np.sin(second)
        third = heights[0] if heights else np.zeros_like(first)
        return np.stack((first, second, third), axis=-1)

    @property
    def measures(self) -> Array:
        """Length, area or volume of a cell at each value of the first axis, shape (n,)."""
        first, size = self.axes[0], math.prod(axis.step or 1.0 for axis in self.axes)
        if not self.polar:
            return np.full(len(first.values), size)
        beyond = np.maximum(first.step / 2 - first.values, 0.0)  # at the centre
        return size * (first.values + beyond**2 / (2 * first.step or 1.0))

    def carrier(self, move: Array, slack: float = 0.0) -> Carrier | None:
        """Return the map of indices under an isometry, (4, 4); None if it does not keep the grid.

        ``slack``, less than half a step, [m] along axes and [rad] between them, is tolerated.
        """
        Q, t = move[:3, :3], move[:3, 3]
        if self.polar:  # radii stay, bearings are turned or mirrored
            across = (Q[:2, 2], Q[2, :2], t[:2] / max(1.0, float(self.axes[0].values[-1])))
            if max(np.abs(part).max() for part in across) > SAME + slack:
                return None
            t = np.array([0.0, np.arctan2(Q[1, 0], Q[0, 0]), t[2]])
            Q = np.diag([1.0, np.linalg.det(Q[:2, :2]), Q[2, 2]])
        signs = Q.round()
        if np.abs(Q - signs).max() > SAME + slack:  # only signed permutations of x, y, z fit
            return None
        axes, shape = (*self.axes, Axis("z", np.zeros(1)))[:3], (*self.shape, 1)[:3]
        sources, maps = np.abs(signs).argmax(axis=1).tolist(), list[Indices]()
        for place, (axis, source) in enumerate(zip(axes, sources, strict=True)):
            values, images = axis.values, signs[place, source] * axes[source].values + t[place]
            if axis.name == "bearing":
                past = SAME + slack
                images = values[0] + (images - values[0] + past) % (2 * np.pi) - past
            steps = np.rint((images - values[0]) / (axis.step or 1.0))
            maps.append(steps.clip(0, len(values) - 1).astype(np.int64))
            within = (4 * SAME + slack) * max(1.0, float(np.ptp(values)))
            if len(images) != len(values) or np.abs(values[maps[-1]] - images).max() > within:
                return None

        def carry(index: Indices) -> Indices:
            split = np.unravel_index(index, shape)
            moved = tuple(m[split[k]] for m, k in zip(maps, sources, strict=True))
            return np.ravel_multi_index(moved, shape).astype(np.int64)

        return carry


def lowest(carriers: Iterable[Carrier], index: Indices) -> Indices:
    """Return the lowest index in each position's orbit under a group that maps the grid."""
    return np.min([index, *(carrier(index) for carrier in carriers)], axis=0)


def edges(grid: Grid, inside: Mask) -> Indices:
    """Return index pairs of neighbours of which exactly one is inside, shape (M, 2)."""
    cells, pairs = inside.reshape(grid.shape), []
    for place, n in enumerate(grid.shape):
        differ = cells != np.roll(cells, -1, axis=place)
        if not (grid.axes[place].full_turn and n > 2):  # first and last are no neighbours
            differ[(slice(None),) * place + (-1,)] = False
        first = np.flatnonzero(differ)
        split = list(np.unravel_index(first, grid.shape))
        split[place] = (split[place] + 1) % n
        pairs.append(np.stack((first, np.ravel_multi_index(tuple(split), grid.shape)), axis=1))
    return np.concatenate(pairs)


def default_grid(mechanism: GivenMechanism, fixed: Iterable[str | Axis] = ()) -> Grid:
    """Return a grid within reach that has the ``fixed`` axes; polar for rotational symmetry."""
    mechanism = as_mechanism(mechanism)
    axes, n = [Axis.parse(axis) for axis in fixed], mechanism.platform.lengths
    names = {axis.name for axis in axes}
    low, high = reach_box(mechanism)
    step = float((high - low)[:n].max()) / _ACROSS[n]
    defaults = [
        Axis(name, np.linspace(start, end, round((end - start) / step) + 1))
        for name, start, end in zip("xyz"[:n], low, high, strict=False)
    ]
    turns = sum(  # rotations about the base's z axis
        not element.reflection
        and not element.base[:3, 3].any()
        and element.matrix[2, 2] > 1.0 - SAME
        for element in symmetry_group(mechanism).elements
    )
    if names & {"radius", "bearing"} or (turns > 1 and not names & {"x", "y"}):
        around = 2 * turns * -(-_AROUND[n] // (2 * turns))
        ends = [np.hypot(*leg.joints[0].placement.xyz[:2]) + leg.reach for leg in mechanism.legs]
        rings = Axis("radius", np.arange(step / 2, min(ends), step))
        defaults[:2] = rings, Axis.spaced("bearing", -np.pi, np.pi, 2 * np.pi / around)
    return Grid.of(*axes, *(axis for axis in defaults if axis.name not in names))


def closer_grid(grid: Grid, inside: Mask, fixed: Iterable[str]) -> Grid | None:
    """Return a closer grid around inside positions, but for ``fixed`` axes; None if not closer."""
    if not inside.any():
        return None
    stay, cells, axes, closer = set(fixed), inside.reshape(grid.shape), list(grid.axes), False
    for place, axis in enumerate(grid.axes):
        if axis.name in stay or axis.full_turn or len(axis.values) < 2:
            continue
        across = tuple(dimension for dimension in range(cells.ndim) if dimension != place)
        occupied = axis.values[cells.any(axis=across)]
        low, high = float(occupied[0]) - 2 * axis.step, float(occupied[-1]) + 2 * axis.step
        if axis.name == "radius" and low <= axis.step:
            step = high / len(axis.values)
            axes[place] = Axis("radius", step * np.arange(0.5, len(axis.values)))
        else:
            axes[place] = Axis(axis.name, np.linspace(low, high, len(axis.values)))
        closer |= high - low < _CLOSER * float(np.ptp(axis.values))
    return Grid(tuple(axes)) if closer else None


def reach_box(mechanism: Mechanism) -> tuple[Array, Array]:
    """Return the corners of a box around all positions in reach of all legs, (3,) each, [m]."""
    low, high = np.full(3, -np.inf), np.full(3, np.inf)
    for leg in mechanism.legs:
        base = np.array(leg.joints[0].placement.xyz)
        low, high = np.maximum(low, base - leg.reach), np.minimum(high, base + leg.reach)
    if (low >= high)[: mechanism.platform.lengths].any():
        raise WorkspaceError(f"no pose of {mechanism.name!r} is within reach of all its legs")
    return low, high
