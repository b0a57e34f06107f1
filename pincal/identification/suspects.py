"""What goes wrong when machines are measured: suspects, each with the measurements put right.

Frames and orders are of the poses or columns as a whole; a sign or a unit may be wrong in
the readings of single legs. Whether a suspect explains anything is judged elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

from pincal.model.mechanism import Mechanism
from pincal.model.orientation import WAYS, columns_of, rotation_of

Array = NDArray[np.float64]
_DEGREE = np.pi / 180
_SHIFTS = (1, -1, 2, -2)  # rows by which logs of poses and readings are out of step
_STAYS = 0.005  # of a leg's size: by less than this, a column is not said to fit another leg
_STAYS_OF_STROKE = 0.02  # nor by less than this of the stroke that was measured
_UNITS = "Correct the units in the headers"
_FRAME = "Give the poses in the right-handed frame of the base"
#: Factors that put right a length or an angle under a wrong header, in words.
_FACTORS = {
    "m": {"in mm under a metre header": 1e-3, "in metres under a mm header": 1e3},
    "rad": {
        "in degrees under a radian header": _DEGREE,
        "in radians under a degree header": 1 / _DEGREE,
    },
}
_REFLECTIONS = {
    "x has the other sign": np.diag([-1.0, 1.0, 1.0]),
    "y has the other sign": np.diag([1.0, -1.0, 1.0]),
    "z has the other sign": np.diag([1.0, 1.0, -1.0]),
    "x and y are exchanged": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
}


@dataclass(frozen=True)
class Suspect:
    """One thing that might have gone wrong."""

    words: str
    """Follows 'if'; ``{readings}`` stands for the readings, of some legs or all."""
    remedy: str
    """What to do about it."""
    poses: Array
    """Poses put right, shape (N, dof), [m] and [rad]."""
    readings: Array
    """Readings put right, shape (N, n_readings), [rad] or [m]."""
    by_leg: bool = False
    """Whether it may concern the readings of some legs only."""
    least: float = 0.0
    """Gap as given, over the leg's size, below which it is out of the question: lengths a
    thousand times too large miss by far, and shrinking them makes any gap small."""


def single_faults(mechanism: Mechanism, poses: Array, readings: Array) -> Iterator[Suspect]:
    """Yield signs, orders, units, frames and directions of orientation, one wrong at a time."""
    yield Suspect(
        "{readings} have the other sign",
        "Change their sign, or the sensor's 'direction' in mechanism.yaml",
        poses,
        -readings,
        by_leg=True,
    )
    yield from _of_one_leg(mechanism, poses, readings)
    yield from (suspect for faults, suspect in _units(mechanism, poses, readings) if faults == 1)
    yield from mirrored(mechanism, poses, readings)
    yield from _signs_of_angles(mechanism, poses, readings)
    platform = mechanism.platform
    if "rad" not in platform.units:
        return
    matrices = platform.transforms(poses).as_matrix()
    turns = matrices[:, :3, :3].transpose(0, 2, 1)
    back = -(turns @ matrices[:, :3, 3:])[:, :, 0]
    yield Suspect(
        "the orientations turn the other way (that of the base seen from the platform)",
        "Give the orientation of the platform in the base frame",
        _poses(mechanism, matrices[:, :3, 3], turns),
        readings,
    )
    yield Suspect(
        "the poses are those of the base in the platform's frame",
        "Give the poses of the platform in the base frame",
        _poses(mechanism, back, turns),
        readings,
    )


def _of_one_leg(mechanism: Mechanism, poses: Array, readings: Array) -> Iterator[Suspect]:
    """Yield one reading's sign, and two columns exchanged, of legs with several sensors."""
    names = mechanism.reading_names
    for own in mechanism.reading_columns:
        columns = range(own.start, own.stop)
        for one in columns if len(columns) > 1 else ():
            signs = np.ones(len(names))
            signs[one] = -1.0
            yield Suspect(
                f"{names[one]} has the other sign",
                "Change its sign, or the sensor's 'direction' in mechanism.yaml",
                poses,
                readings * signs,
            )
        for one, other in combinations(columns, 2):
            order = np.arange(len(names))
            order[[one, other]] = other, one
            yield Suspect(
                f"{names[one]} and {names[other]} are exchanged",
                "Correct the order of columns",
                poses,
                readings[:, order],
            )


def several_units(mechanism: Mechanism, poses: Array, readings: Array) -> Iterator[Suspect]:
    """Yield units that are wrong in several kinds of columns at once."""
    yield from (suspect for faults, suspect in _units(mechanism, poses, readings) if faults > 1)


def mirrored(mechanism: Mechanism, poses: Array, readings: Array) -> Iterator[Suspect]:
    """Yield left-handed frames: r → Q r, R → Q R Qᵀ for a reflection Q; and Q r with R as it is."""
    matrices = mechanism.platform.transforms(poses).as_matrix()
    positions, turns = matrices[:, :3, 3], matrices[:, :3, :3]
    lengths = mechanism.platform.units.count("m")
    for words, Q in _REFLECTIONS.items():
        if lengths < 3 and Q[2, 2] < 0.0:
            continue
        yield Suspect(
            f"{words}, as in a left-handed frame",
            _FRAME,
            _poses(mechanism, positions @ Q.T, Q @ turns @ Q.T),
            readings,
        )
        if "rad" in mechanism.platform.units:
            yield Suspect(
                f"{words} and the orientations are right",
                _FRAME,
                _poses(mechanism, positions @ Q.T, turns),
                readings,
            )


def _signs_of_angles(mechanism: Mechanism, poses: Array, readings: Array) -> Iterator[Suspect]:
    """Yield the sign of one of the columns by which a spatial platform's orientation was given."""
    if mechanism.platform.kind != "spatial":
        return
    matrices = mechanism.platform.transforms(poses).as_matrix()
    turns = Rotation.from_matrix(matrices[:, :3, :3])
    for way, (names, unit) in WAYS.items():
        for column, name in enumerate(names if unit == "rad" else ()):
            angles = columns_of(way, turns)
            angles[:, column] *= -1.0
            right = rotation_of(way, angles).as_matrix()
            yield Suspect(
                f"{name} has the other sign",
                "Change the sign of that angle",
                _poses(mechanism, matrices[:, :3, 3], right),
                readings,
            )


def shifted(poses: Array, readings: Array, rows: NDArray[np.intp]) -> Iterator[Suspect]:
    """Yield readings that stand some rows before or after the poses they belong to.

    Args:
        poses: Of all rows, shape (N, dof), [m] and [rad].
        readings: Of all rows, shape (N, n_readings), [rad] or [m].
        rows: Of them, those with complete poses to judge by.
    """
    for shift in _SHIFTS:
        there = rows + shift
        inside = (there >= 0) & (there < len(readings))
        right = np.full((len(rows), readings.shape[1]), np.nan)
        right[inside] = readings[there[inside]]
        count = f"{abs(shift)} row" + ("s" if abs(shift) > 1 else "")
        yield Suspect(
            f"the readings stand {count} {'below' if shift > 0 else 'above'} the poses they belong "
            "to",
            "Bring the logs of poses and readings into step",
            poses[rows],
            right,
        )


def exchanged(
    mechanism: Mechanism, poses: Array, readings: Array, gaps: Array, strokes: Array
) -> list[Suspect]:
    """Return the order of columns in which the legs fit best, if it is another than given.

    Args:
        mechanism: The mechanism.
        poses: Measured poses, shape (N, dof).
        readings: Measured readings, one a leg, shape (N, n_legs).
        gaps: Gap of leg i with the readings of column j over the leg's size, shape
            (n_legs, n_legs).
        strokes: By how much readings move each leg's end, over the leg's size, shape (n_legs,).
    """
    stays = np.minimum(_STAYS, _STAYS_OF_STROKE * np.nan_to_num(strokes))
    cost = np.clip(np.nan_to_num(gaps, nan=1.0), None, 1.0) - np.diag(stays)
    legs, columns = linear_sum_assignment(cost)
    moved = [(i, j) for i, j in zip(legs, columns, strict=True) if i != j]
    if not moved:
        return []
    names = mechanism.leg_names
    words = " and ".join(f"column {names[j]} fits {names[i]}" for i, j in moved)
    right = readings[:, columns]
    return [Suspect(f"legs are exchanged: {words}", "Correct the order of columns", poses, right)]


def _units(mechanism: Mechanism, poses: Array, readings: Array) -> Iterator[tuple[int, Suspect]]:
    """Yield what units may be wrong together, and in how many kinds of columns."""
    coordinates = np.array(mechanism.platform.units)
    columns = np.array(mechanism.reading_units)
    kinds = [
        (name, unit, on_readings)
        for name, unit, on_readings in (
            ("the positions", "m", False),
            ("the orientations", "rad", False),
            ("{readings}", "m", True),
            ("{readings}", "rad", True),
        )
        if unit in (columns if on_readings else coordinates)
    ]
    for choice in product(*([None, *_FACTORS[unit].items()] for _, unit, _ in kinds)):
        wrong = [(kind, factor) for kind, factor in zip(kinds, choice, strict=True) if factor]
        scales = np.ones(len(coordinates)), np.ones(len(columns))
        for (_, unit, on_readings), (_, factor) in wrong:
            scales[on_readings][(columns if on_readings else coordinates) == unit] = factor
        words = " and ".join(f"{name} are {how}" for (name, _, _), (how, _) in wrong)
        only_readings = all(on_readings for (_, _, on_readings), _ in wrong)
        shrinks = any(unit == "m" and factor < 1.0 for (_, unit, _), (_, factor) in wrong)
        yield (
            len(wrong),
            Suspect(
                words,
                _UNITS,
                poses * scales[0],
                readings * scales[1],
                by_leg=only_readings,
                least=1.0 if shrinks else 0.0,
            ),
        )


def _poses(mechanism: Mechanism, positions: Array, turns: Array) -> Array:
    """Return the coordinates of positions (N, 3) and rotation matrices (N, 3, 3)."""
    matrices = np.tile(np.eye(4), (len(positions), 1, 1))
    matrices[:, :3, 3], matrices[:, :3, :3] = positions, turns
    return mechanism.platform.from_matrices(matrices)
