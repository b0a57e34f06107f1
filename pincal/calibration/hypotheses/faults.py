"""What goes wrong when machines are measured: hypotheses, each with the measurements put right.

One table for all mechanisms. Frames and orders concern the poses or columns as a whole; a sign, a
unit or a motor's zero may be wrong in the readings of single legs. Which of them explain
measurements is decided by one rule, in ``ranking``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import combinations, product

import numpy as np
from scipy.spatial.transform import Rotation

from pincal.calibration.hypotheses.judging import QUESTIONED, Case, Hypothesis, LegFit, judge
from pincal.model.measurements import Measurements
from pincal.model.mechanism import Mechanism
from pincal.model.orientation import WAYS, columns_of, rotation_of
from pincal.types import Array

Right = Callable[[Mechanism, Measurements], Measurements]
#: For each unit of a header: what the numbers may be in, and the factor that puts them right.
UNITS = {
    "m": {"mm": 1e-3, "m": 1e3},
    "rad": {"deg": np.pi / 180, "rad": 180 / np.pi},
}
REFLECTIONS = {
    "x": np.diag([-1.0, 1.0, 1.0]),
    "y": np.diag([1.0, -1.0, 1.0]),
    "z": np.diag([1.0, 1.0, -1.0]),
    "xy": np.eye(3)[[1, 0, 2]],
    "xz": np.eye(3)[[2, 1, 0]],
    "yz": np.eye(3)[[0, 2, 1]],
}
_SHIFTS = (1, -1, 2, -2)  # rows by which logs of poses and readings are out of step
_ROUND = 0.03  # share by which readings may miss a whole multiple of what they should be
_SCALES = (2.0, 4.0, 10.0, 100.0, 0.5, 0.25, 0.1, 0.01)  # tried where poses do not say it


def single_faults(case: Case) -> Iterator[Hypothesis]:
    """Yield signs, orders, units, frames and shifts, one wrong at a time."""
    turning = case.oriented and "rad" in case.mechanism.platform.units
    yield Hypothesis("sign-of-readings", _readings_times(-1.0), by_leg=True)
    yield from _columns_of_a_leg(case.mechanism)
    yield from (hypothesis for hypothesis in units(case) if hypothesis.faults == 1)
    yield from _mirrored(case.mechanism, turning)
    if turning:
        yield from _angles(case)
        inverted = _posed(lambda r, R: (r, R.transpose(0, 2, 1)))
        yield Hypothesis("orientation-inverted", inverted)
        yield Hypothesis("pose-inverted", _posed(_inverted))
    yield from _exchanged(case)
    for shift in _SHIFTS:
        yield Hypothesis("rows-shifted", _shifted(shift), {"shift": shift})


def units(case: Case) -> Iterator[Hypothesis]:
    """Yield what units may be wrong, in one kind of columns or in several together."""
    mechanism = case.mechanism
    coordinates, columns = np.array(mechanism.platform.units), np.array(mechanism.reading_units)
    kinds = [("positions", "m", coordinates)]
    kinds += [("orientations", "rad", coordinates)] if case.oriented else []
    kinds += [("readings", "m", columns), ("readings", "rad", columns)]
    kinds = [kind for kind in kinds if kind[1] in kind[2]]
    for choice in product(*([None, *UNITS[unit].items()] for _, unit, _ in kinds)):
        wrong = [(kind, written) for kind, written in zip(kinds, choice, strict=True) if written]
        scales = np.ones(len(coordinates)), np.ones(len(columns))
        for (name, unit, units_of_columns), (_, factor) in wrong:
            scales[name == "readings"][units_of_columns == unit] = factor
        if wrong:
            yield Hypothesis(
                "unit",
                _scaled(*scales),
                {"units": tuple((name, unit, written) for (name, unit, _), (written, _) in wrong)},
                by_leg=all(name == "readings" for (name, _, _), _ in wrong),
                faults=len(wrong),
            )


def zeros(offsets: Array) -> Hypothesis:
    """Return that readings are off by constants, shape (n_readings,), [rad] or [m]."""

    def right(_: Mechanism, data: Measurements) -> Measurements:
        return replace(data, readings=data.readings - offsets)

    values = {"offsets": tuple(offsets.tolist())}
    return Hypothesis("reading-offset", right, values, by_leg=True)


def zeros_by_poses(case: Case, matrices: Array) -> Array:
    """Return by which constants readings differ from the nominal ones, shape (n_readings,).

    Medians; angles without whole turns.
    """
    differences = case.readings - case.nominal_readings(matrices)
    offsets = np.zeros(differences.shape[1])
    for column, unit in enumerate(case.mechanism.reading_units):
        known = differences[np.isfinite(differences[:, column]), column]
        if unit == "rad" and len(known):
            middle = np.angle(np.exp(1j * known).mean())
            known = middle + np.angle(np.exp(1j * (known - middle)))
        offsets[column] = np.median(known) if len(known) else 0.0
    return offsets


def scales(case: Case, matrices: Array | None) -> Iterator[Hypothesis]:
    """Yield that readings have another scale than their header says, such as counts.

    Args:
        case: The measurements.
        matrices: The nominal machine's poses that say by how much; usual scales are tried if None.
    """
    if case.mechanism.by_readings:
        return
    count = len(case.mechanism.reading_names)
    by_poses = [] if matrices is None else [_factors(case, matrices)]
    for factors in by_poses or [np.full(count, scale) for scale in _SCALES]:
        values = {"factors": tuple(factors.tolist())}
        right = _readings_times(1.0 / factors)
        yield Hypothesis("scale-of-readings", right, values, by_leg=True)


def _factors(case: Case, matrices: Array) -> Array:
    """Return how many times too large readings are, shape (n_readings,).

    By least absolute values; whole numbers, or parts of one, where it is nearly that: edges that
    are counted once or four times, a gear that is left out. 1 where none say, and where it is a
    unit or a sign: hypotheses of their own.
    """
    nominal = case.nominal_readings(matrices)
    factors = np.ones(nominal.shape[1])
    for column, unit in enumerate(case.mechanism.reading_units):
        measured, expected = case.readings[:, column], nominal[:, column]
        known = np.isfinite(measured * expected) & (expected != 0.0)
        if not known.any():
            continue
        ratios, weights = measured[known] / expected[known], np.abs(expected[known])
        order = np.argsort(ratios)
        sums = np.cumsum(weights[order])
        factor = float(ratios[order][np.searchsorted(sums, sums[-1] / 2)])
        if factor > 0.0 and not any(
            _nearly(factor, 1.0 / right_factor) for right_factor in UNITS[unit].values()
        ):
            whole_number = round(factor) if factor > 1.0 else 1.0 / round(1.0 / factor)
            factors[column] = whole_number if _nearly(factor, whole_number) else factor
    return factors


def _nearly(factor: float, reference: float) -> bool:
    return abs(factor / reference - 1.0) < _ROUND


def _posed(move: Callable[[Array, Array], tuple[Array, Array]]) -> Right:
    """Return what moves positions (N, 3) and orientations (N, 3, 3), where they were measured."""

    def right(mechanism: Mechanism, data: Measurements) -> Measurements:
        platform, measured = mechanism.platform, np.isfinite(data.poses)
        matrices = platform.matrices(np.where(measured, data.poses, platform.home)).copy()
        r, R = move(matrices[:, :3, 3], matrices[:, :3, :3])
        matrices[:, :3, 3], matrices[:, :3, :3] = r, R
        return replace(data, poses=np.where(measured, platform.from_matrices(matrices), np.nan))

    return right


def _inverted(r: Array, R: Array) -> tuple[Array, Array]:
    """Return poses of the base seen from the platform."""
    turns = R.transpose(0, 2, 1)
    return -(turns @ r[:, :, None])[:, :, 0], turns


def _scaled(poses: Array, readings: Array) -> Right:
    """Return what multiplies coordinates (dof,) and readings (n_readings,)."""
    return lambda _, data: replace(
        data, poses=data.poses * poses, readings=data.readings * readings
    )


def _readings_times(factors: Array | float) -> Right:
    return lambda _, data: replace(data, readings=data.readings * factors)


def _ordered(order: list[int]) -> Right:
    """Return what puts columns of readings in an order."""
    return lambda _, data: replace(data, readings=data.readings[:, order])


def _shifted(shift: int) -> Right:
    """Return what takes the readings that stand some rows below, or above, the poses."""

    def right(_: Mechanism, data: Measurements) -> Measurements:
        rows = np.arange(len(data)) + shift
        inside = (rows >= 0) & (rows < len(data))
        readings = np.full(data.readings.shape, np.nan)
        readings[inside] = data.readings[rows[inside]]
        return replace(data, readings=readings)

    return right


def of_legs(hypothesis: Hypothesis, legs: list[int]) -> Hypothesis:
    """Return a hypothesis as of the readings of some legs only."""

    def right(mechanism: Mechanism, data: Measurements) -> Measurements:
        changed, readings = hypothesis.right(mechanism, data), data.readings.copy()
        for columns in (mechanism.reading_columns[i] for i in legs):
            readings[:, columns] = changed.readings[:, columns]
        return replace(changed, readings=readings)

    return replace(hypothesis, right=right)


def _swapped(count: int, i: int, j: int) -> list[int]:
    """Return the order 0 … count - 1 with two of them exchanged."""
    return [{i: j, j: i}.get(k, k) for k in range(count)]


def _columns_of_a_leg(mechanism: Mechanism) -> Iterator[Hypothesis]:
    """Yield one reading's sign, and two columns exchanged, of legs with several sensors."""
    names = mechanism.reading_names
    for columns in (range(c.start, c.stop) for c in mechanism.reading_columns):
        for i in columns if len(columns) > 1 else ():
            signs = np.where(np.arange(len(names)) == i, -1.0, 1.0)
            yield Hypothesis("sign-of-column", _readings_times(signs), {"column": names[i]})
        for i, j in combinations(columns, 2):
            right, values = _ordered(_swapped(len(names), i, j)), {"columns": (names[i], names[j])}
            yield Hypothesis("columns-exchanged", right, values)


def _mirrored(mechanism: Mechanism, turning: bool) -> Iterator[Hypothesis]:
    """Yield left-handed frames: r → Q r, R → Q R Qᵀ for a reflection Q; and Q r with R as it is."""
    for axis, Q in REFLECTIONS.items():
        if mechanism.platform.space == 3 or Q[2, 2] == 1.0:
            for turned in (True, False) if turning else (True,):
                values = {"axis": axis, "orientations_right": not turned}
                yield Hypothesis("left-handed-frame", _reflected(Q, turned), values)


def _reflected(Q: Array, turned: bool) -> Right:
    return _posed(lambda r, R: (r @ Q.T, Q @ R @ Q.T if turned else R))


def _angles(case: Case) -> Iterator[Hypothesis]:
    """Yield signs and orders of the columns by which a spatial platform's orientation was given."""
    written = (case.data.written,) if case.data.written else tuple(WAYS)
    for way in written if case.mechanism.platform.turns == 3 else ():
        names, unit = WAYS[way]
        n = len(names)
        for i in range(n) if unit == "rad" else ():
            signs = np.where(np.arange(n) == i, -1.0, 1.0)
            yield Hypothesis(
                "sign-of-angle", _turned(way, [*range(n)], signs), {"column": names[i]}
            )
        swaps = [_swapped(n, i, j) for i, j in combinations(range(n), 2)]
        for order in [*swaps, [*range(1, n), 0], [n - 1, *range(n - 1)]]:
            moved = [(name, names[k]) for name, k in zip(names, order, strict=True)]
            values = {"order": tuple((name, column) for name, column in moved if name != column)}
            yield Hypothesis("angles-exchanged", _turned(way, order, np.ones(n)), values)


def _turned(way: str, order: list[int], signs: Array) -> Right:
    """Return what takes the columns of orientations in another order, and with other signs."""

    def move(r: Array, R: Array) -> tuple[Array, Array]:
        columns = columns_of(way, Rotation.from_matrix(R))
        return r, rotation_of(way, columns[:, order] * signs).as_matrix()

    return _posed(move)


def _exchanged(case: Case) -> Iterator[Hypothesis]:
    """Yield the order of columns in which the legs fit best, if it is another than given.

    In an unknown frame, where legs cannot be judged one by one, all exchanges of two, and all legs
    one further or in reverse.
    """
    names = case.mechanism.leg_names
    n = len(names)
    if len(case.mechanism.reading_names) != n or n < 2:
        return
    every = list(range(n))
    if case.alone:
        orders = [_best_order(case)]
    else:
        turned = [every[k:] + every[:k] for k in ((1, n - 1) if n > 2 else ())]
        swaps = [_swapped(n, i, j) for i, j in combinations(every, 2)]
        orders = [*swaps, *turned, *([every[::-1]] if n > 3 else [])]
    for order in orders:
        moved = tuple((names[i], names[j]) for i, j in enumerate(order) if i != j)
        if moved:
            yield Hypothesis("legs-exchanged", _ordered(order), {"order": moved})


def _best_order(case: Case) -> list[int]:
    """Return the column that each leg fits best, each to one leg; legs stay where they may."""
    from scipy.optimize import linear_sum_assignment  # slow to load: when needed

    n = len(case.mechanism.legs)
    every = np.arange(n)

    def cost(fit: LegFit) -> float:
        return float(np.clip(fit.near, QUESTIONED * fit.stroke, 1.0)) if fit.rows > 1 else 1.0

    costs = -1e-9 * np.eye(n)
    orders = [np.roll(every, -k).tolist() for k in range(n)]
    turned = [Hypothesis("legs-exchanged", _ordered(order)) for order in orders]
    for order, judged in zip(orders, judge(case, turned), strict=True):
        costs[every, order] += np.nan_to_num([cost(fit) for fit in judged.fits], nan=1.0)
    return [int(j) for j in linear_sum_assignment(costs)[1]]
