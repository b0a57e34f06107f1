"""Hypotheses on faults in measurements, each with a function that corrects the fault.

Frames and orders concern poses or columns as a whole; a sign, a unit or a motor's zero may be wrong
in the readings of single legs. ``plausibility`` decides which hypotheses explain measurements.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations, pairwise, product

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

from pincal.calibration.calibration import Calibration
from pincal.calibration.hypotheses.judging import QUESTIONED, Case, Hypothesis, case_of, judge
from pincal.finding import Finding
from pincal.model import WAYS, Measurements, Mechanism, Platform
from pincal.model.platform import columns_of, rotation_of
from pincal.types import Array

Right = Callable[[Measurements], Measurements]
#: By unit of a header: units in which the numbers may really be, and the factor that corrects them.
UNITS = {"m": {"mm": 1e-3, "m": 1e3, "in": 25.4}, "rad": {"deg": np.pi / 180, "rad": 180 / np.pi}}
REFLECTIONS = {
    "x": np.diag([-1.0, 1.0, 1.0]),
    "y": np.diag([1.0, -1.0, 1.0]),
    "z": np.diag([1.0, 1.0, -1.0]),
    "xy": np.eye(3)[[1, 0, 2]],
    "xz": np.eye(3)[[2, 1, 0]],
    "yz": np.eye(3)[[0, 2, 1]],
}
_SHIFTS = (1, -1, 2, -2)  # rows by which the logs of poses and readings may be shifted
_ZEROS = ("reading-offset", False)  # the fault for which a search may start at other zeros
_ROUND = 0.03  # relative tolerance on a whole factor between measured and nominal readings


def faults(case: Case) -> Iterator[Hypothesis]:
    """Yield hypotheses on signs, orders, frames, shifts and units, also several wrong units."""
    platform = case.mechanism.platform
    turning = case.oriented and "rad" in platform.units
    yield Hypothesis("sign-of-readings", _readings_times(-1.0), by_leg=True)
    yield from _columns_of_a_leg(case.mechanism)
    yield from _units(case)
    yield from _reflections(platform, (True, False) if turning else (True,))
    if turning:
        yield from _angles(case)
        inverted = _posed(platform, lambda r, R: (r, R.transpose(0, 2, 1)))
        yield Hypothesis("orientation-inverted", inverted)
        inverted = _posed(platform, lambda r, R: (-np.einsum("nji,nj->ni", R, r), R.mT))
        yield Hypothesis("pose-inverted", inverted)
    if len(case.mechanism.leg_names) == len(case.mechanism.reading_names):
        yield from _exchanged(case)
    for shift in _SHIFTS:  # readings are some rows below, or above, their poses

        def shifted(readings: Array, shift: int = shift) -> Array:
            moved = np.roll(readings, -shift, axis=0)
            moved[slice(-shift, None) if shift > 0 else slice(-shift)] = np.nan
            return moved

        yield Hypothesis("rows-shifted", _read(shifted), {"shift": shift})


def faults_of_a_row(case: Case) -> Iterator[Hypothesis]:
    """Yield hypotheses on a single row: a sign, a unit, swapped legs or columns."""
    mechanism, singly = case.mechanism, len(case.mechanism.legs) > 1
    concerning_readings = [Hypothesis("sign-of-readings", _readings_times(-1.0), by_leg=True)]
    concerning_readings += [hypothesis for hypothesis in _units(case) if hypothesis.faults == 1]
    for hypothesis in concerning_readings:
        yield hypothesis
        for leg in range(len(mechanism.legs)) if hypothesis.by_leg and singly else ():
            yield of_legs(hypothesis, mechanism, [leg])
    yield from _columns_of_a_leg(mechanism)
    yield from _reflections(mechanism.platform, (False,))
    if len(mechanism.leg_names) == len(mechanism.reading_names):
        for i, j in combinations(range(len(mechanism.legs)), 2):
            yield _legs_exchanged(mechanism, _swapped(len(mechanism.legs), i, j))


def _reflections(platform: Platform, turned: Sequence[bool]) -> Iterator[Hypothesis]:
    """Yield mirrored or exchanged axes: r → Q r with R → Q R Qᵀ or with R unchanged."""
    for axis, Q in REFLECTIONS.items():
        for orientations in turned if platform.space == 3 or Q[2, 2] == 1.0 else ():
            right = partial(_reflected, Q=Q, U=Q if orientations else np.eye(3))
            values = {"axis": axis, "orientations_right": not orientations}
            yield Hypothesis("left-handed-frame", _posed(platform, right), values)


def _units(case: Case) -> Iterator[Hypothesis]:
    """Yield wrong units, in one kind of columns or in several together."""
    mechanism = case.mechanism
    coordinates, columns = np.array(mechanism.platform.units), np.array(mechanism.reading_units)
    kinds = [("positions", "m", coordinates)]
    kinds += [("orientations", "rad", coordinates)] if case.oriented else []
    kinds += [("readings", "m", columns), ("readings", "rad", columns)]
    kinds = [kind for kind in kinds if kind[1] in kind[2]]
    for choice in product(*([None, *UNITS[unit].items()] for _, unit, _ in kinds)):
        wrong = [(kind, written) for kind, written in zip(kinds, choice, strict=True) if written]
        poses, readings = np.ones(len(coordinates)), np.ones(len(columns))
        for (name, unit, units_of_columns), (_, factor) in wrong:
            (readings if name == "readings" else poses)[units_of_columns == unit] = factor
        if wrong:
            yield Hypothesis(
                "unit",
                partial(_scaled, poses=poses, readings=readings),
                {"units": tuple((name, unit, written) for (name, unit, _), (written, _) in wrong)},
                by_leg=all(name == "readings" for (name, _, _), _ in wrong),
                faults=len(wrong),
            )


def zeros(offsets: Array) -> Hypothesis:
    """Return the hypothesis that readings have offsets, shape (n_readings,), [rad] or [m]."""
    return Hypothesis(
        "reading-offset",
        _read(partial(np.add, -offsets)),
        {"offsets": tuple(offsets.tolist())},
        by_leg=True,
    )


def zeros_by_poses(case: Case, nominal: Array) -> Array:
    """Return medians of readings minus nominal ones, both (N, n_readings), without whole turns."""
    differences = case.readings - nominal
    offsets = np.zeros(differences.shape[1])
    for column, unit in enumerate(case.mechanism.reading_units):
        known = differences[np.isfinite(differences[:, column]), column]
        if unit == "rad" and len(known):
            middle = np.angle(np.exp(1j * known).mean())
            known = middle + np.angle(np.exp(1j * (known - middle)))
        offsets[column] = np.median(known) if len(known) else 0.0
    return offsets


def scale(case: Case, nominal: Array) -> Hypothesis:
    """Return the hypothesis that readings are scaled from nominal ones, shape (N, n_readings).

    Factors near whole numbers are rounded, those that a wrong unit explains are 1.
    """

    def nearly(factor: float, reference: float) -> bool:
        return abs(factor / reference - 1.0) < _ROUND

    factors = np.ones(nominal.shape[1])
    for column, unit in enumerate(case.mechanism.reading_units):
        pairs = np.abs(np.stack((case.readings[:, column], nominal[:, column])))
        pairs = pairs[:, np.isfinite(pairs).all(axis=0)]
        measured, expected = np.median(pairs, axis=1) if pairs.size else (0.0, 0.0)
        if not (measured > 0.0 and expected > 0.0):
            continue
        factor = float(measured / expected)
        whole_number = round(factor) if factor > 1.0 else 1.0 / round(1.0 / factor)
        of_unit = any(nearly(factor * right, 1.0) for right in UNITS[unit].values())
        nearest = whole_number if nearly(factor, whole_number) else factor
        factors[column] = 1.0 if of_unit else nearest
    values = {"factors": tuple(factors.tolist())}
    return Hypothesis("scale-of-readings", _readings_times(1.0 / factors), values, by_leg=True)


def _posed(platform: Platform, move: Callable[[Array, Array], tuple[Array, Array]]) -> Right:
    """Return a correction that moves measured positions (N, 3) and orientations (N, 3, 3)."""

    def correct(data: Measurements) -> Measurements:
        measured = np.isfinite(data.poses)
        matrices = platform.matrices(np.where(measured, data.poses, platform.home)).copy()
        r, R = move(matrices[:, :3, 3], matrices[:, :3, :3])
        matrices[:, :3, 3], matrices[:, :3, :3] = r, R
        return replace(data, poses=np.where(measured, platform.from_matrices(matrices), np.nan))

    return correct


def _reflected(r: Array, R: Array, Q: Array, U: Array) -> tuple[Array, Array]:
    return r @ Q.T, U @ R @ U.T


def _scaled(data: Measurements, poses: Array, readings: Array) -> Measurements:
    return replace(data, poses=data.poses * poses, readings=data.readings * readings)


def _read(change: Callable[[Array], Array]) -> Right:
    return lambda data: replace(data, readings=change(data.readings))


def _readings_times(factors: Array | float) -> Right:
    return _read(partial(np.multiply, factors))


def _ordered(order: Sequence[int]) -> Right:
    return _read(partial(np.take, indices=order, axis=1))


def of_legs(hypothesis: Hypothesis, mechanism: Mechanism, legs: Sequence[int]) -> Hypothesis:
    """Return a hypothesis restricted to the readings of some legs."""

    def correct(data: Measurements) -> Measurements:
        changed, readings = hypothesis.correct(data), data.readings.copy()
        for columns in (mechanism.reading_columns[i] for i in legs):
            readings[:, columns] = changed.readings[:, columns]
        return replace(changed, readings=readings)

    return replace(hypothesis, correct=correct, legs=tuple(legs))


def _swapped(count: int, i: int, j: int) -> list[int]:
    return [{i: j, j: i}.get(k, k) for k in range(count)]


def _columns_of_a_leg(mechanism: Mechanism) -> Iterator[Hypothesis]:
    """Yield the sign of a column, exchanged and coupled ones, for legs with several sensors."""
    names = mechanism.reading_names
    n = len(names)
    for columns in (range(c.start, c.stop) for c in mechanism.reading_columns):
        for i in columns if len(columns) > 1 else ():
            right = _readings_times(1.0 - 2.0 * np.eye(n)[i])
            yield Hypothesis("sign-of-column", right, {"column": names[i]})
        for i, j in combinations(columns, 2):
            right, values = _ordered(_swapped(n, i, j)), {"columns": (names[i], names[j])}
            yield Hypothesis("columns-exchanged", right, values)
        for (i, j), sign in product(pairwise(columns), (1.0, -1.0)):
            mixing = np.eye(n) + sign * np.outer(np.eye(n)[j], np.eye(n)[i])
            right = _read(partial(np.einsum, "ij,nj->ni", mixing))
            pair = {"columns": (names[j], names[i]), "sign": sign}
            yield Hypothesis("columns-coupled", right, pair)


def _angles(case: Case) -> Iterator[Hypothesis]:
    """Yield signs, orders and another meaning of the columns of a spatial orientation."""
    platform = case.mechanism.platform
    written = case.calibration.measurements.written

    def turned(r: Array, R: Array, way: str, changes: Array, to: str = "") -> tuple[Array, Array]:
        columns = columns_of(way, Rotation.from_matrix(R)) @ changes.T
        return r, rotation_of(to or way, columns).as_matrix()

    for way in ((written,) if written else WAYS) if platform.turns == 3 else ():
        names, unit = WAYS[way]
        n = len(names)
        for i in range(n) if unit == "rad" else ():
            move = partial(turned, way=way, changes=np.diag(1.0 - 2.0 * np.eye(n)[i]))
            yield Hypothesis("sign-of-angle", _posed(platform, move), {"column": names[i]})
        swaps = [_swapped(n, i, j) for i, j in combinations(range(n), 2)]
        for order in [*swaps, [*range(1, n), 0], [n - 1, *range(n - 1)]]:
            move = partial(turned, way=way, changes=np.eye(n)[order])
            values = tuple((names[i], names[k]) for i, k in enumerate(order) if i != k)
            yield Hypothesis("angles-exchanged", _posed(platform, move), {"order": values})
        if way == "rotation-vector":
            move = partial(turned, way=way, changes=np.eye(n)[::-1], to="zyx")
            yield Hypothesis("vector-is-angles", _posed(platform, move))


def _exchanged(case: Case) -> Iterator[Hypothesis]:
    """Yield the order of legs that fits best if legs are judged alone, else likely orders."""
    n = len(case.mechanism.leg_names)
    every, turned = np.arange(n), [[*range(k, n), *range(k)] for k in range(n)]
    orders = [_swapped(n, i, j) for i, j in combinations(range(n), 2)]
    orders += [*turned, *(order[::-1] for order in turned)]
    if case.alone:  # assign columns to legs by least misfit; legs stay where that costs nothing
        costs = -1e-9 * np.eye(n)
        tried = [Hypothesis("legs-exchanged", _ordered(order)) for order in turned]
        for order, judged in zip(turned, judge(case, tried), strict=True):
            near = [
                judged.near(leg) if judged.row_counts[leg] > 1 else 1.0 for leg in every.tolist()
            ]
            least = np.where(judged.row_counts > 1, QUESTIONED * judged.stroke, 0.0)
            costs[every, order] += np.clip(np.nan_to_num(near, nan=1.0), least, 1.0)
        orders = [linear_sum_assignment(costs)[1].tolist()]
    for k, order in enumerate(orders):
        if order != every.tolist() and order not in orders[:k]:
            yield _legs_exchanged(case.mechanism, order)


def _legs_exchanged(mechanism: Mechanism, order: Sequence[int]) -> Hypothesis:
    names = mechanism.leg_names
    exchanged = tuple((names[i], names[j]) for i, j in enumerate(order) if i != j)
    return Hypothesis("legs-exchanged", _ordered(order), {"order": exchanged})


def with_zeros(calibration: Calibration, faults: Sequence[Finding]) -> Array | None:
    """Return parameters with estimated zeros of motors, where a fit starts, shape (n_params,).

    Zeros come from full poses for a machine that is roughly known, else from the only fault, if it
    is of zeros. Returns None for other faults, or if the zeros are not identified.
    """
    names, rough = calibration.mechanism.reading_names, calibration.options.rough
    offsets = np.zeros(len(names))
    if rough:
        case = case_of(calibration)
        nominal = case.as_measured.nominal_readings if case and case.alone else None
        if case is None or nominal is None:
            return None
        offsets = zeros_by_poses(case, nominal)
    elif [(fault.code, fault.values.get("unknown_frame")) for fault in faults] == [_ZEROS]:
        for name, off, _ in faults[0].values["offsets"]:
            offsets[names.index(name)] = off
    else:
        return None
    start, identified = _moved_zeros(calibration, offsets)
    moved = offsets[identified].any() if rough else identified[offsets != 0.0].all()
    return start if moved else None


def _moved_zeros(calibration: Calibration, offsets: Array) -> tuple[Array, Array]:
    """Return nominal parameters, (n_params,), with zeros moved by offsets, and a mask of those.

    Offsets and mask are (n_readings,). ψ = d k q + γ grows with γ; for q = d k ψ + γ, γ falls by
    d k times the offset. Zeros with priors, ties or terms, or of several sensors, stay at nominal.
    """
    unknowns, parameters = calibration.unknowns, calibration.mechanism.parameters
    free = unknowns.map != 0.0
    alone = free[:, free.sum(axis=0) == 1].sum(axis=1) == 1
    start, identified = parameters.values.copy(), np.zeros(len(offsets), dtype=bool)
    sensors = [(leg, sensor) for leg in calibration.mechanism.legs for sensor in leg.sensors]
    for i, (leg, sensor) in enumerate(sensors):
        shared = [other.offset for other in leg.sensors].count(sensor.offset) > 1
        if isinstance(sensor.offset, str) and not (shared or sensor.terms):
            place = parameters.ids.index(f"{leg.name}.{sensor.offset}")
            gain, _ = sensor.constants(leg.nominal_by_name)
            if alone[place] and np.isinf(unknowns.priors[place]):
                start[place] += offsets[i] * (1.0 if sensor.form == "reading" else -gain)
                identified[i] = True
    return start, identified
