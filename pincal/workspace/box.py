"""Boxes and grids that hold every position which all legs can reach."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from pincal.errors import WorkspaceError
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.model.mechanism import Mechanism
from pincal.symmetry.detect import symmetry_group
from pincal.symmetry.elements import SAME, Element
from pincal.types import Array
from pincal.workspace.axes import Axis
from pincal.workspace.positions import Grid, Samples
from pincal.workspace.region import Workspace

_ACROSS = {2: 200, 3: 60}  # steps of a grid in the plane, in space, across the box
_CLOSER = 0.8  # of the extent, below which another look is worth while
_AROUND = {2: 360, 3: 72}  # bearings of a polar grid, at least


def reach_box(mechanism: Mechanism) -> tuple[Array, Array]:
    """Return lower and upper corner, coordinates of the platform, of what all legs can reach.

    Raises:
        WorkspaceError: no pose is within reach of all legs.
    """
    low, high = _reach(mechanism)
    least, most = np.array(mechanism.platform.bounds).T
    lengths = mechanism.platform.units.count("m")
    least[:lengths], most[:lengths] = low[:lengths], high[:lengths]
    return least, most


def default_grid(mechanism: GivenMechanism, given: Iterable[str | Axis] = ()) -> Grid:
    """Return a grid of positions within reach; polar if the mechanism has rotations.

    Args:
        mechanism: The mechanism.
        given: Axes that are not to be as they would be; ``x`` or ``y`` make the grid square.

    Raises:
        WorkspaceError: axes that are wrong, or that the platform does not have.
    """
    mechanism = as_mechanism(mechanism)
    axes = [Axis.parse(axis) if isinstance(axis, str) else axis for axis in given]
    names = {axis.name for axis in axes}
    spatial = mechanism.platform.units.count("m") == 3
    if "z" in names and not spatial:
        raise WorkspaceError(f"axis 'z': the platform of {mechanism.name!r} moves in a plane")
    low, high = _reach(mechanism)
    n = 3 if spatial else 2
    step = float((high - low)[:n].max()) / _ACROSS[n]
    turns = len(_around_z(mechanism, rotations=True))
    if names & {"radius", "bearing"} or (turns > 1 and not names & {"x", "y"}):
        around = 2 * turns * -(-_AROUND[n] // (2 * turns))
        radius = _radius(mechanism)
        rings = np.arange(step / 2, radius, step)
        turn = Axis.spaced("bearing", -np.pi, np.pi, 2 * np.pi / around)
        defaults = {"radius": Axis("radius", rings), "bearing": turn}
    else:
        defaults = {name: _across(name, low[i], high[i], step) for i, name in enumerate("xy")}
    if spatial:
        defaults["z"] = _across("z", low[2], high[2], step)
    missing = [axis for name, axis in defaults.items() if name not in names]
    return Grid.of(*axes, *missing)


def closer_grid(found: Workspace, given: Iterable[str]) -> Grid | None:
    """Return a grid of as many values around what counts, or None if that is no closer.

    Args:
        found: A workspace on a grid.
        given: Names of axes that stay as they are.
    """
    grid, stay = found.asked, set(given)
    if not isinstance(grid, Grid) or not found.count:
        return None
    cells = found.inside.reshape(grid.shape)
    axes, closer = [], False
    for place, axis in enumerate(grid.axes):
        across = tuple(dimension for dimension in range(cells.ndim) if dimension != place)
        occupied = axis.values[cells.any(axis=across)]
        if axis.name in stay or axis.full_turn or len(axis.values) < 2:
            axes.append(axis)
            continue
        low, high = float(occupied[0]) - 2 * axis.step, float(occupied[-1]) + 2 * axis.step
        if axis.name == "radius" and low <= axis.step:
            step = high / len(axis.values)
            axes.append(
                Axis("radius", step * (np.arange(len(axis.values), dtype=np.float64) + 0.5))
            )
        else:
            axes.append(Axis(axis.name, np.linspace(low, high, len(axis.values))))
        closer |= high - low < _CLOSER * float(np.ptp(axis.values))
    return Grid(tuple(axes)) if closer else None


def default_samples(mechanism: GivenMechanism, count: int, seed: int = 0) -> Samples:
    """Return random positions within reach, in orbits of the mechanism's group."""
    mechanism = as_mechanism(mechanism)
    low, high = _reach(mechanism)
    spatial = mechanism.platform.units.count("m") == 3
    height = (float(low[2]), float(high[2])) if spatial else (0.0, 0.0)
    return Samples(count, _radius(mechanism), height, seed, _around_z(mechanism))


def _around_z(mechanism: Mechanism, *, rotations: bool = False) -> tuple[Element, ...]:
    """Return the elements that turn positions about the base's z axis, the identity first.

    Args:
        mechanism: The mechanism.
        rotations: Leave out reflections.
    """
    group = symmetry_group(mechanism, readings=False).elements
    return tuple(
        element
        for element in group
        if not element.base.t.any()
        and element.matrix[2, 2] > 1.0 - SAME
        and not (rotations and element.reflection)
    )


def _across(name: str, low: float, high: float, step: float) -> Axis:
    """Return an axis from end to end, in steps of about the size wanted."""
    return Axis(name, np.linspace(low, high, round((high - low) / step) + 1))


def _reach(mechanism: Mechanism) -> tuple[Array, Array]:
    """Return the corners of a box that holds what all legs reach, shape (3,) each, [m]."""
    low, high = np.full(3, -np.inf), np.full(3, np.inf)
    for leg in mechanism.legs:
        base = np.array(leg.joints[0].placement.xyz)
        low, high = np.maximum(low, base - leg.reach), np.minimum(high, base + leg.reach)
    if (low >= high)[: mechanism.platform.units.count("m")].any():
        raise WorkspaceError(f"no pose of {mechanism.name!r} is within reach of all its legs")
    return low, high


def _radius(mechanism: Mechanism) -> float:
    """Return the largest distance from the axis that every leg can reach, [m]."""
    bases = np.array([leg.joints[0].placement.xyz for leg in mechanism.legs])
    reaches = [leg.reach for leg in mechanism.legs]
    return float((np.hypot(bases[:, 0], bases[:, 1]) + reaches).min())
