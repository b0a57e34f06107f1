"""Workspaces as sets of positions: reached in one orientation, in some, or in all of a set.

A reachable workspace needs any orientation, a total-orientation or dexterous one every orientation;
a position is decided at the first orientation that settles it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from pincal.blas import one_thread
from pincal.errors import WorkspaceError
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.files.table import write_table
from pincal.kinematics.singularity import margins
from pincal.model import Mechanism
from pincal.model.checks import ROUNDING, choice_of, must_be
from pincal.symmetry.detect import symmetry_group
from pincal.symmetry.elements import Element, applied
from pincal.types import Array, Mask
from pincal.words.numbers import measured
from pincal.workspace.criteria import (
    Margins,
    Orientations,
    as_margins,
    criteria_of,
    refuse_readings,
)
from pincal.workspace.grid import Carrier, Grid, edges, lowest

KINDS = ("reachable", "constant-orientation", "total-orientation", "dexterous")
BLOCK = 1 << 17  # pairs of position and orientation in memory at a time
_NEARLY, _CELL = 1e-4, 0.1  # [m] or [rad], and over a step: tolerance of a symmetry
_FIRST = 16  # orientations in the first round of closing legs; each round has 8 times as many


class PositionTest:
    """Test of positions: whether they are reached in any, or in every, orientation of a set."""

    def __init__(
        self, mechanism: Mechanism, orientations: Orientations, every: bool, least: Margins
    ) -> None:
        self.mechanism, self.orientations = mechanism, orientations
        self.every, self.least = every, least
        self._criteria = criteria_of(mechanism, least)
        self.in_closed_form = self._criteria.in_closed_form
        """Whether closed forms decide, so that no leg needs to be closed."""

    @cached_property
    def _turns(self) -> tuple[Array, list[Array]]:
        """Orientations as matrices, (O, 3, 3), decisive ones first, and turned platform points."""
        rotations = self.orientations.rotations
        home = self.mechanism.platform.home_pose.rotation[0]
        far = (home.inv() * rotations).magnitude()
        # if every orientation must be reached, those far from home fail first
        R = rotations.as_matrix()[np.argsort(-far if self.every else far, kind="stable")]
        return R, [(R @ reach.point).T for reach in self._criteria.reaches]

    def __call__(self, positions: Array) -> Mask:
        """Return the mask, shape (N,), of the positions, shape (N, 3), that count.

        Closed forms decide, then legs are closed. Memory grows with positions times orientations.
        """
        R, arms = self._turns
        alive, possible = np.arange(len(positions)), np.ones((len(positions), len(R)), dtype=bool)
        for reach, arm in zip(self._criteria.reaches, arms, strict=True):
            possible = possible & reach.holds_each(positions[alive], arm)
            held = np.asarray(possible.all(axis=1) if self.every else possible.any(axis=1))
            alive, possible = alive[held], possible[held]
        if not self.in_closed_form:
            alive = alive[self._by_closing(positions[alive], possible)]
        inside = np.zeros(len(positions), dtype=bool)
        inside[alive] = True
        return inside

    def _by_closing(self, positions: Array, possible: Mask) -> Mask:
        """Return the mask of the positions that count, (P,), by closing legs at possible pairs."""
        R, _ = self._turns
        decided = np.zeros(len(positions), dtype=bool)  # failed if ``every``, otherwise reached
        begin, width = 0, _FIRST
        while begin < len(R) and not decided.all():
            columns = slice(begin, begin + width)
            open_rows = np.flatnonzero(~decided)
            row, column = np.nonzero(possible[open_rows, columns])
            row, column = open_rows[row], column + begin
            matrices = np.broadcast_to(np.eye(4), (len(row), 4, 4)).copy()
            matrices[:, :3, 3], matrices[:, :3, :3] = positions[row], R[column]
            decided[row[self._criteria(matrices) != self.every]] = True
            begin, width = begin + width, 8 * width
        return decided != self.every


def usable(
    group: tuple[Element, ...], grid: Grid, test: PositionTest, slack: float = 0.0
) -> dict[Element, Carrier]:
    """Return a group's elements that map grid, orientations and criteria onto themselves.

    Each has its map of indices of positions. An element that permutes the legs oddly reverses the
    sign of the type-2 margin, and is left out unless the image of home has a positive margin.
    """
    mechanism, turns = test.mechanism, test.orientations.rotations.as_matrix()
    home, elements = np.array([mechanism.platform.home]), {}
    for element in group:
        move = element.positions(turns, slack)
        carrier = None if move is None else grid.carrier(move, slack)
        if carrier is None or not test.orientations.maps(element, slack):
            continue
        if mechanism.cables and (load := mechanism.load):  # tensions depend on the load
            down, centre = np.array(load.gravity), np.array([load.centre])
            moved = element.matrix @ down - down, applied(element.platform, centre) - centre
            if max(np.abs(shift).max() for shift in moved) > ROUNDING:
                continue
        if test.least.least_type2(mechanism) > -np.inf:
            with np.errstate(invalid="ignore"):
                image = margins(mechanism, element.poses(mechanism.platform, home))
                if not image.type2[0] > 0.0:
                    continue
        elements[element] = carrier
    return elements


@dataclass(frozen=True, repr=False, eq=False)
class Workspace:
    """Positions of a grid that are in a workspace (they count).

    Example:
        >>> import pincal
        >>> grid = pincal.Grid.of("x=-1:1:0.2", "y=0.4:2:0.2")
        >>> workspace = pincal.compute_workspace("5R", "total-orientation", grid)
        >>> workspace.positions.shape[1], workspace.kind
        (3, 'total-orientation')
    """

    kind: str
    test: PositionTest
    asked: Grid
    """Grid of the tested positions."""
    inside: Mask
    """Mask of the grid's positions that count, shape (n_asked,); not writable."""
    elements: tuple[Element, ...]
    """Elements of the mechanism's group that were used, the identity first."""
    unused: tuple[Element, ...]
    """Elements not used: they map positions or orientations elsewhere."""
    computed: int
    """Number of positions that were computed; the others follow by symmetry."""

    @property
    def count(self) -> int:
        """Number of positions that count."""
        return int(np.count_nonzero(self.inside))

    @property
    def positions(self) -> Array:
        """Positions that count, shape (count, 3), base frame, [m]."""
        return self.asked.at(np.flatnonzero(self.inside))

    @cached_property
    def cut(self) -> bool:
        """Whether positions at the edge of the grid count, so that there may be more outside."""
        cells = self.inside.reshape(self.asked.shape)
        for place, axis in enumerate(self.asked.axes):
            round_centre = axis.name == "radius" and axis.values[0] <= axis.step  # no edge inside
            ends = cells.take([-1] if round_centre else [0, -1], place)
            if len(axis.values) > 1 and not axis.full_turn and ends.any():
                return True
        return False

    @cached_property
    def measure(self) -> float:
        """Volume [m³], area [m²], or length [m], by the number of the grid's dimensions."""
        counts = np.count_nonzero(self.inside.reshape(self.asked.shape[0], -1), axis=1)
        return float(counts @ self.asked.measures)

    @cached_property
    def uncertainty(self) -> float:
        """Largest error of ``measure``: half a cell along the whole border on the grid."""
        places = np.unravel_index(edges(self.asked, self.inside).ravel(), self.asked.shape)
        measures = self.asked.measures
        return float(max(measures[places[0]].sum() / 4, measures[-1]))  # at least a missed cell

    def save(self, path: str | Path, *, force: bool = False) -> None:
        """Write the positions that count to a CSV file: x [m], y [m] and, in space, z [m]."""
        names = "xyz"[: self.test.mechanism.platform.lengths]
        columns = zip(names, self.positions.T, strict=False)
        write_table(path, {f"{name} [m]": map(float, v) for name, v in columns}, force=force)

    @property
    def size(self) -> str:
        """The measure with its significant digits and unit; a single position has no unit."""
        unit = ("", "m", "m²", "m³")[self.asked.dimension]
        return f"{measured(self.measure, self.uncertainty)} {unit}"

    def __repr__(self) -> str:
        return (
            f"{self.kind} workspace of {self.test.mechanism.name}: {self.size}, "
            f"{self.count:,} of {self.asked.size:,} positions"
        )


@one_thread()
def compute_workspace(
    mechanism: GivenMechanism,
    kind: str,
    grid: Grid,
    orientations: Orientations | None = None,
    least: Margins | None = None,
    progress: Callable[[int], None] = lambda _: None,
) -> Workspace:
    """Return the positions that a platform reaches in one orientation, some, or all of a set.

    Each position is tested by itself, so an aspect across a singularity is included where margins
    allow it.

    Args:
        mechanism: The mechanism.
        kind: ``reachable`` (in any orientation), ``constant-orientation`` (in the one given),
            ``total-orientation`` (in all given ones) or ``dexterous`` (in all that exist).
        grid: Grid of the positions to test.
        orientations: Orientations to test; by default home's for a constant orientation, and the
            full range (5° apart in a plane, 30° in space) if reachable or dexterous.
        least: Margins from singularities.
        progress: Function that is called with the number of positions done.

    Raises:
        WorkspaceError: the kind is unknown, or orientations are missing where they are needed.
    """
    mechanism = as_mechanism(mechanism)
    orientations = _orientations(mechanism, kind, orientations)
    _check_grid(mechanism, must_be(grid, Grid, "grid", WorkspaceError))
    must_be(progress, Callable, "progress", WorkspaceError)
    refuse_readings(mechanism)
    least = as_margins(least)
    group = symmetry_group(mechanism, ROUNDING).elements
    test = PositionTest(mechanism, orientations, kind != "reachable", least)
    elements, exact = usable(group, grid, test), True
    slack = min([_NEARLY, *(_CELL * axis.step for axis in grid.axes if axis.step)])
    near = symmetry_group(mechanism, slack / mechanism.size).elements
    nearly = usable(near, grid, test, slack)
    if len(nearly) > len(elements):
        group, elements, exact = near, nearly, False
    unused = tuple(e for e in group if e not in elements)
    size, computed = max(1, BLOCK // len(orientations)), np.zeros(grid.size, dtype=bool)
    inside = np.zeros(grid.size, dtype=bool)
    for begin in range(0, grid.size, size):
        index = np.arange(begin, min(begin + size, grid.size))
        first = lowest(elements.values(), index)  # computed in an earlier part, or in this one
        domain = index[first == index]
        inside[domain], computed[domain] = test(grid.at(domain)), True
        inside[index] = inside[first]
        progress(int(index[-1]) + 1)
    while not exact:  # a symmetry that nearly holds may move the border: compute it there
        border = np.unique(edges(grid, inside))
        border = border[~computed[border]]
        for part in np.split(border, range(size, len(border), size)):
            inside[part], computed[part] = test(grid.at(part)), True
        exact = not len(border)
    inside.setflags(write=False)
    used, count = tuple(elements), int(np.count_nonzero(computed))
    return Workspace(kind, test, grid, inside, used, unused, count)


def _orientations(
    mechanism: Mechanism, kind: str, orientations: Orientations | None
) -> Orientations:
    """Return the orientations to test for a kind of workspace, checked."""
    platform = mechanism.platform
    choice_of(kind, KINDS, "kind of workspace", WorkspaceError)
    if orientations is not None:
        must_be(orientations, Orientations, "orientations", WorkspaceError)
        if kind == "constant-orientation" and len(orientations) != 1:
            raise WorkspaceError(
                f"a constant-orientation workspace has one orientation; got {len(orientations)}. "
                "If a tilt is given without an azimuth, the azimuth goes all round: give it too"
            )
        if kind == "dexterous" and platform.turns:
            raise WorkspaceError(
                "a dexterous workspace needs every orientation that exists; for chosen "
                "orientations compute a total-orientation workspace"
            )
        return orientations
    if kind == "total-orientation" and platform.turns:
        raise WorkspaceError(
            "a total-orientation workspace needs the orientations to reach, such as "
            + ("'phi [deg]=-20:20:5'" if platform.turns == 1 else "'tilt [deg]=0:30:5'")
        )
    if kind == "constant-orientation":
        return Orientations.home(platform)
    return Orientations.everywhere(platform)


def _check_grid(mechanism: Mechanism, grid: Grid) -> None:
    """Raise WorkspaceError if positions leave the platform's plane, or the unit seems wrong."""
    ends = grid.at(np.array([0, grid.size - 1]))
    if mechanism.platform.lengths < 3 and ends[:, 2].any():
        raise WorkspaceError(f"axis 'z': the platform of {mechanism.name!r} moves in a plane")
    across = 2 * max(leg.reach for leg in mechanism.legs)
    for axis in grid.axes:
        if axis.name != "bearing" and axis.step > across:
            raise WorkspaceError(
                f"axis {axis.name!r} has steps of {axis.step:g} m, more than the legs of "
                f"{mechanism.name!r} reach across ({across:.3g} m); is it in another unit, "
                f"such as '{axis.name} [mm]=…'?"
            )
