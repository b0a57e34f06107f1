"""Workspaces as sets of positions: reached in one orientation, in some, or in all of a set.

Reachable asks for any orientation, total orientation and dexterous for every one; the
constant orientation workspace has a single one. A position is done with at the
first orientation that decides it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from pincal.blas import on_one_thread
from pincal.errors import WorkspaceError
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.files.table import write_table
from pincal.kinematics.singularity import margins
from pincal.model.checks import ROUNDING, described
from pincal.model.mechanism import Mechanism
from pincal.symmetry.detect import symmetry_group
from pincal.symmetry.elements import IDENTITY, Element, Isometry
from pincal.types import Array, Mask
from pincal.words.numbers import measured
from pincal.workspace.axes import Orientations
from pincal.workspace.chunks import run
from pincal.workspace.criteria import Margins, as_margins, refuse_readings
from pincal.workspace.positions import (
    BLOCK,
    Carrier,
    Grid,
    Indices,
    Positions,
    PositionTest,
    Samples,
    representatives,
)


def keep_side(
    mechanism: Mechanism, group: tuple[Element, ...], least: Margins
) -> tuple[Element, ...]:
    """Return the elements that keep home on its side of type-2 singularities.

    An element that permutes legs oddly turns the determinant's sign over, which the margin
    looks at, unless home is where it was.
    """
    platform = mechanism.platform
    if least.least_type2(mechanism) == -np.inf:
        return group
    home = np.array([platform.home])
    images = np.concatenate([element.poses(platform, home) for element in group])
    with np.errstate(invalid="ignore"):
        same = margins(mechanism, images).type2 > 0.0
    return tuple(element for element, ok in zip(group, same, strict=True) if ok)


def usable(
    group: tuple[Element, ...], positions: Positions, asked: Orientations
) -> tuple[Element, ...]:
    """Return the elements of a group that map positions and orientations onto themselves.

    Raises:
        WorkspaceError: they are no group, so that orbits would not be what they stand for.
    """
    turns = asked.rotations.as_matrix()
    found = []
    for element in group:
        move = element.positions(turns)
        if move is not None and asked.maps(element) and positions.carrier(move):
            found.append(element)
    for first, second in product(found, found):
        if not any(first.after(second).equals(one) for one in found):
            raise WorkspaceError(
                f"the elements that map these positions onto themselves are no group: {first} "
                f"after {second} is missing. Compute all positions (symmetry=False, --no-symmetry)"
            )
    return tuple(found)


def moves_of(elements: tuple[Element, ...], asked: Orientations) -> tuple[Isometry, ...]:
    """Return what elements do to positions in all of some orientations."""
    turns = asked.rotations.as_matrix()
    return tuple(move for element in elements if (move := element.positions(turns)) is not None)


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


KINDS = ("reachable", "constant-orientation", "total-orientation", "dexterous")
_CHUNK = 1 << 22  # poses handed out at a time, where legs have a closed form


@dataclass(frozen=True)
class _Task:
    """Chunk of positions, by their numbers, to packed bits."""

    test: PositionTest
    positions: Positions
    moves: tuple[Isometry, ...]

    def __reduce__(self) -> tuple[type[_Task], tuple[object, ...]]:
        return _Task, (self.test, self.positions, self.moves)

    @cached_property
    def lowest(self) -> Carrier:
        return representatives(self.positions, self.moves)

    def __call__(self, begin: int, end: int) -> bytes:
        index = np.arange(begin, end)
        own = index[self.lowest(index) == index]
        inside = np.zeros(end - begin, dtype=bool)
        inside[own - begin] = self.test(self.positions.at(own))
        return np.packbits(inside).tobytes()


@dataclass(frozen=True, repr=False, eq=False)
class Workspace:
    """Positions that count, of a grid or of samples.

    Example:
        >>> import pincal
        >>> grid = pincal.Grid.of("x=-1:1:0.2", "y=0.4:2:0.2")
        >>> workspace = pincal.compute_workspace("5R", "total-orientation", grid)
        >>> workspace.positions.shape[1], workspace.kind
        (3, 'total-orientation')
    """

    kind: str
    test: PositionTest
    asked: Positions
    """The positions asked, that ``inside`` is about."""
    inside: Mask
    """Which positions count, by number, shape (n_asked,); not writable."""
    elements: tuple[Element, ...]
    """Elements of the mechanism's group that were used, the identity first."""
    unused: tuple[Element, ...]
    """Elements that do not map positions or orientations onto themselves, or were not wanted."""
    computed: int
    """Number of positions that were computed; the others follow by symmetry."""

    @property
    def count(self) -> int:
        """Number of positions that count."""
        return int(np.count_nonzero(self.inside))

    @property
    def positions(self) -> Array:
        """Positions that count, shape (count, 3), base frame, [m]; all at once."""
        return self.asked.at(np.flatnonzero(self.inside))

    def representative(self, index: Indices) -> Mask:
        """Return which positions, by number, are of the fundamental domain that was computed."""
        moves = moves_of(self.elements, self.test.orientations)
        return representatives(self.asked, moves)(index) == index

    @cached_property
    def cut(self) -> bool:
        """Whether positions that count lie at the edge of the grid: there may be more outside."""
        return isinstance(self.asked, Grid) and len(at_edge(self.asked, self.inside)) > 0

    @cached_property
    def apart(self) -> int:
        """Number of positions on a grid that count but do not hang together with home's there.

        They may belong to another aspect, or hang together by way of other heights and
        orientations. 0 of samples.
        """
        if not isinstance(self.asked, Grid) or not self.inside.any():
            return 0
        home = self.test.mechanism.platform.home_pose.translation[0]
        return self.count - int(np.count_nonzero(part_around(self.asked, self.inside, home)))

    @cached_property
    def measure(self) -> float:
        """Area [m²] or volume [m³]; a length [m] on a line."""
        parts = (
            self.asked.measures(begin + np.flatnonzero(self.inside[begin:end])).sum()
            for begin, end in _chunks(len(self.inside), BLOCK)
        )
        return float(sum(parts))

    @property
    def unit(self) -> str:
        """Unit of ``measure``; empty for a single position."""
        return ("", "m", "m²", "m³")[self.asked.dimension]

    @cached_property
    def uncertainty(self) -> float:
        """By how much ``measure`` may be off.

        On a grid at most, half a cell along the whole edge, of what lies on the grid (see
        ``cut``); with samples the half width of the 95 % interval.
        """
        if isinstance(self.asked, Grid):
            along = self.asked.measures(edges(self.asked, self.inside).ravel()).sum() / 4
            one = self.asked.measures(np.array([self.asked.size - 1]))[0]  # may have been missed
            return float(max(along, one))
        orbits = (
            len(self.inside) / len(self.asked.elements) if isinstance(self.asked, Samples) else 1
        )
        share = self.count / len(self.inside)
        whole = float(self.asked.measures(np.zeros(1, np.int64))[0] * len(self.inside))
        return 1.96 * whole * float(np.sqrt(share * (1 - share) / orbits))

    def poses(self) -> Array:
        """Return the poses of a constant orientation workspace, coordinates of shape (count, dof).

        Raises:
            WorkspaceError: the workspace asked for more than one orientation.
        """
        rotations = self.test.orientations.rotations
        if len(rotations) != 1:
            raise WorkspaceError(f"positions in {len(rotations)} orientations are no poses")
        matrices = np.broadcast_to(np.eye(4), (self.count, 4, 4)).copy()
        matrices[:, :3, :3], matrices[:, :3, 3] = rotations.as_matrix()[0], self.positions
        return self.test.mechanism.platform.from_matrices(matrices)

    def save(self, path: str | Path, *, force: bool = False) -> None:
        """Write the positions that count to a CSV file: x [m], y [m] and, in space, z [m].

        Raises:
            FileError: the file exists and ``force`` is not set, or cannot be written.
        """
        names = ("x", "y", "z")[: self.test.mechanism.platform.units.count("m")]
        columns = {f"{name} [m]": self._column(place) for place, name in enumerate(names)}
        write_table(path, columns, force=force)

    def _column(self, place: int) -> Iterator[float]:
        """Yield one coordinate of the positions that count, a bounded number at a time."""
        for begin, end in _chunks(len(self.inside), BLOCK):
            index = begin + np.flatnonzero(self.inside[begin:end])
            yield from self.asked.at(index)[:, place].tolist()

    def __str__(self) -> str:
        """Return a short page: the workspace, and what it was asked of."""
        lines = [repr(self), f"  orientations asked: {len(self.test.orientations)}"]
        lines.append(f"  positions computed: {self.computed:,}, the others by symmetry")
        if self.cut:
            lines.append("  it reaches the edge of the grid: there may be more outside")
        if self.apart:
            lines.append(f"  not connected with home on this grid: {self.apart:,} positions")
        return "\n".join(lines)

    @property
    def size(self) -> str:
        """Its measure to the digits that are known, with the unit."""
        return f"{measured(self.measure, self.uncertainty)} {self.unit}"

    def __repr__(self) -> str:
        """Return the workspace in a line."""
        return (
            f"{self.kind} workspace of {self.test.mechanism.name}: {self.size}, "
            f"{self.count:,} of {self.asked.size:,} positions"
        )


@dataclass(frozen=True)
class Computing:
    """How a workspace is computed."""

    symmetry: bool = True
    """Compute a fundamental domain of the mechanism's group only, as far as the group maps
    positions and orientations onto themselves."""
    connected: bool = False
    """Keep only what hangs together, on this grid, with the position that counts and is nearest
    to home."""
    jobs: int = 1
    """Processes; -1 for one a core."""
    scheduler: str | None = None
    """Address of a Dask scheduler to run on."""
    progress: Callable[[int], None] | None = None
    """Called with the number of positions done."""


@on_one_thread
def compute_workspace(
    mechanism: GivenMechanism,
    kind: str,
    positions: Positions,
    orientations: Orientations | None = None,
    least: Margins | None = None,
    **options: Any,
) -> Workspace:
    """Return the positions that a platform reaches in one orientation, some, or all of a set.

    Positions count one by one, those of an aspect across a singularity too where margins allow
    for it: see ``connected`` and ``Workspace.apart``.

    Args:
        mechanism: The mechanism.
        kind: ``reachable`` (in any orientation), ``constant-orientation`` (in the one given),
            ``total-orientation`` (in every one given) or ``dexterous`` (in every one there is).
        positions: Where to ask.
        orientations: Orientations asked; if not given, home's for a constant orientation, and
            all round (5° apart in a plane, 30° in space) if reachable or dexterous.
        least: Margins from singularities.
        **options: ``symmetry``, ``connected``, ``jobs``, ``scheduler``, ``progress``: see
            ``Computing``.

    Raises:
        WorkspaceError: an unknown kind, no orientations where they are needed, or work that
            cannot be run as asked.
    """
    how, mechanism = Computing(**options), as_mechanism(mechanism)
    asked = _asked(mechanism, kind, orientations)
    if not hasattr(positions, "at"):
        raise WorkspaceError(f"positions: expected a Grid or Samples; got {described(positions)}")
    _check_positions(mechanism, positions)
    if how.connected and not isinstance(positions, Grid):
        raise WorkspaceError("samples have no neighbours; ask on a grid what is connected")
    refuse_readings(mechanism)
    every = kind != "reachable"
    least = as_margins(least)
    group = symmetry_group(mechanism, ROUNDING, readings=False).elements
    elements: tuple[Element, ...] = (IDENTITY,)
    if how.symmetry:
        elements = usable(keep_side(mechanism, group, least), positions, asked)
    unused = tuple(e for e in group if e not in elements)
    moves = moves_of(elements, asked)
    task = _Task(PositionTest(mechanism, asked, every, least), positions, moves)
    task.test(positions.at(np.zeros(1, np.int64)))  # errors in the mechanism show here, not there
    most = _CHUNK if task.test.in_closed_form else BLOCK
    size = max(1, min(BLOCK, most // len(asked)))
    inside, computed = np.zeros(positions.size, dtype=bool), 0
    for done, (chunk, bits) in enumerate(
        run(task, list(_chunks(positions.size, size)), how.jobs, how.scheduler), 1
    ):
        packed = np.frombuffer(bits, dtype=np.uint8)
        inside[slice(*chunk)] = np.unpackbits(packed, count=chunk[1] - chunk[0])
        if how.progress:
            how.progress(min(done * size, positions.size))
    for begin, end in _chunks(positions.size, BLOCK):
        index = np.arange(begin, end)
        lowest = task.lowest(index)
        computed += int(np.count_nonzero(lowest == index))
        inside[begin:end] = inside[lowest]
    if how.connected and isinstance(positions, Grid) and inside.any():
        inside = part_around(positions, inside, mechanism.platform.home_pose.translation[0])
    inside.setflags(write=False)
    return Workspace(kind, task.test, positions, inside, elements, unused, computed)


def _asked(mechanism: Mechanism, kind: str, given: Orientations | None) -> Orientations:
    """Return the orientations that a kind of workspace asks."""
    platform = mechanism.platform
    if kind not in KINDS:
        raise WorkspaceError(f"unknown kind of workspace {kind!r}; expected {', '.join(KINDS)}")
    if given is not None:
        if kind == "constant-orientation" and len(given) != 1:
            raise WorkspaceError(
                f"a constant-orientation workspace has one orientation; got {len(given)}. An "
                "azimuth that is not given beside a tilt goes all round: give it too"
            )
        if kind == "dexterous" and platform.turns:
            raise WorkspaceError(
                "a dexterous workspace asks for every orientation there is; of a choice of "
                "orientations it is a total-orientation workspace"
            )
        return given
    if kind == "total-orientation" and platform.turns:
        raise WorkspaceError(
            "a total-orientation workspace needs the orientations to reach, such as "
            + ("'phi [deg]=-20:20:5'" if platform.turns == 1 else "'tilt [deg]=0:30:5'")
        )
    if kind == "constant-orientation":
        return Orientations.home(platform)
    return Orientations.everywhere(platform)


def _check_positions(mechanism: Mechanism, positions: Positions) -> None:
    """Raise if positions leave the plane of the platform, or are of another scale."""
    ends = positions.at(np.array([0, positions.size - 1]))
    if mechanism.platform.units.count("m") < 3 and ends[:, 2].any():
        raise WorkspaceError(f"axis 'z': the platform of {mechanism.name!r} moves in a plane")
    if isinstance(positions, Grid):
        across = 2 * max(leg.reach for leg in mechanism.legs)
        for axis in positions.axes:
            if axis.name != "bearing" and axis.step > across:
                raise WorkspaceError(
                    f"axis {axis.name!r} has steps of {axis.step:g} m, more than the legs of "
                    f"{mechanism.name!r} reach across ({across:.3g} m); is it in another unit, "
                    f"such as '{axis.name} [mm]=…'?"
                )


def _chunks(size: int, step: int) -> Iterator[tuple[int, int]]:
    for begin in range(0, size, step):
        yield begin, min(begin + step, size)
