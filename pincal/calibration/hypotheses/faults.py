"""What goes wrong when machines are measured: hypotheses, each with the measurements put right.

One table for all mechanisms. Frames and orders concern the poses or columns as a whole; a sign, a
unit or a motor's zero may be wrong in the readings of single legs. Which of them explain
measurements is decided by one rule, in ``ranking``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import combinations, product
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from pincal.calibration.calibration import Calibration
from pincal.calibration.hypotheses.sample import (
    RULE,
    LegFit,
    LegMeasurements,
    Sample,
    leg_fits,
    placed,
    sample_of,
)
from pincal.finding import Finding
from pincal.kinematics.inverse import inverse
from pincal.model.mechanism import Mechanism
from pincal.model.orientation import WAYS, columns_of, rotation_of
from pincal.types import Array, Index

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


@dataclass(frozen=True)
class Hypothesis:
    """One thing that may have gone wrong."""

    code: str
    """Kebab case; its sentence and remedy are in ``pincal.words.faults``."""
    right: Callable[[Sample], tuple[Array, Array]]
    """Returns poses (N, dof) and readings (N, n_readings) put right."""
    values: Mapping[str, Any] = field(default_factory=dict)
    """What is wrong: names and numbers of which its sentence is made."""
    by_leg: bool = False
    """Whether it may concern the readings of some legs only."""
    faults: int = 1
    """How many things went wrong."""

    def put_right(self, sample: Sample) -> tuple[Array, Array]:
        """Return poses and readings put right."""
        return self.right(sample)


def single_faults(sample: Sample) -> Iterator[Hypothesis]:
    """Yield signs, orders, units, frames and shifts, one wrong at a time."""
    mechanism = sample.mechanism
    yield Hypothesis("sign-of-readings", _scaled_readings(-1.0), by_leg=True)
    yield from _of_one_leg(mechanism)
    yield from (hypothesis for hypothesis in _units(sample) if hypothesis.faults == 1)
    yield from mirrored(sample)
    if sample.oriented and "rad" in mechanism.platform.units:
        yield from _angles(sample)
        yield Hypothesis("orientation-inverted", partial(_inverted, False))
        yield Hypothesis("pose-inverted", partial(_inverted, True))
    yield from _exchanged(sample)
    for shift in RULE.shifts:
        yield Hypothesis("rows-shifted", partial(_shifted, shift), {"shift": shift})


def several_units(sample: Sample) -> Iterator[Hypothesis]:
    """Yield units that are wrong in several kinds of columns at once."""
    yield from (hypothesis for hypothesis in _units(sample) if hypothesis.faults > 1)


def zeros(offsets: Array) -> Hypothesis:
    """Return that readings are off by constants, shape (n_readings,), [rad] or [m]."""
    return Hypothesis(
        "reading-offset",
        lambda one: (one.poses, one.readings - offsets),
        {"offsets": tuple(offsets.tolist())},
        by_leg=True,
    )


def scales(factors: Array) -> Hypothesis:
    """Return that readings are numbers times too large, factors of shape (n_readings,)."""
    return Hypothesis(
        "scale-of-readings",
        _scaled_readings(1.0 / factors),
        {"factors": tuple(factors.tolist())},
        by_leg=True,
    )


def factors_of(sample: Sample, matrices: Array) -> Array:
    """Return how many times too large readings are, shape (n_readings,).

    By least absolute values; whole numbers, or parts of one, where it is nearly that: edges that
    are counted once or four times, a gear that is left out. 1 where none say, and where it is a
    unit or a sign: hypotheses of their own.
    """
    nominal = inverse(sample.mechanism, sample.mechanism.platform.from_matrices(matrices)).readings
    found, units = np.ones(nominal.shape[1]), sample.mechanism.reading_units
    for column in range(len(found)):
        given, own = sample.readings[:, column], nominal[:, column]
        known = np.isfinite(given * own) & (own != 0.0)
        if not known.any():
            continue
        ratios, weights = given[known] / own[known], np.abs(own[known])
        order = np.argsort(ratios)
        sums = np.cumsum(weights[order])
        factor = float(ratios[order][np.searchsorted(sums, sums[-1] / 2)])
        if factor > 0.0 and not any(
            _nearly(factor, 1.0 / by) for by in UNITS[units[column]].values()
        ):
            whole = round(factor) if factor > 1.0 else 1.0 / round(1.0 / factor)
            found[column] = whole if _nearly(factor, whole) else factor
    return found


def _nearly(factor: float, other: float) -> bool:
    return abs(factor / other - 1.0) < RULE.round


def offsets_of(sample: Sample, matrices: Array) -> Array:
    """Return by which constants readings differ from the nominal ones, shape (n_readings,).

    Medians; angles without whole turns.
    """
    nominal = inverse(sample.mechanism, sample.mechanism.platform.from_matrices(matrices)).readings
    differences = sample.readings - nominal
    for column, unit in enumerate(sample.mechanism.reading_units):
        known = differences[np.isfinite(differences[:, column]), column]
        if unit == "rad" and len(known):
            middle = np.angle(np.exp(1j * known).mean())
            known = middle + np.angle(np.exp(1j * (known - middle)))
        differences[:, column] = np.median(known) if len(known) else 0.0
    return differences[0]


def _scaled_readings(factors: Array | float) -> Callable[[Sample], tuple[Array, Array]]:
    return lambda sample: (sample.poses, sample.readings * factors)


def _of_one_leg(mechanism: Mechanism) -> Iterator[Hypothesis]:
    """Yield one reading's sign, and two columns exchanged, of legs with several sensors."""
    names = mechanism.reading_names
    for reading_column in mechanism.reading_columns:
        columns = range(reading_column.start, reading_column.stop)
        for one in columns if len(columns) > 1 else ():
            signs = np.ones(len(names))
            signs[one] = -1.0
            yield Hypothesis("sign-of-column", _scaled_readings(signs), {"column": names[one]})
        for one, other in combinations(columns, 2):
            order = np.arange(len(names))
            order[[one, other]] = other, one
            values = {"columns": (names[one], names[other])}
            yield Hypothesis("columns-exchanged", partial(_ordered, order), values)


def _ordered(order: Index, sample: Sample) -> tuple[Array, Array]:
    return sample.poses, sample.readings[:, order]


def mirrored(sample: Sample) -> Iterator[Hypothesis]:
    """Yield left-handed frames: r → Q r, R → Q R Qᵀ for a reflection Q; and Q r with R as it is."""
    platform = sample.mechanism.platform
    for axis, Q in REFLECTIONS.items():
        if platform.space == 2 and Q[2, 2] < 1.0:
            continue
        for turned in (True, False) if sample.oriented and "rad" in platform.units else (True,):
            values = {"axis": axis, "orientations_right": not turned}
            yield Hypothesis("left-handed-frame", partial(_reflected, Q, turned), values)


def _reflected(Q: Array, turned: bool, sample: Sample) -> tuple[Array, Array]:
    matrices = sample.matrices()
    R = matrices[:, :3, :3]
    return sample.moved(matrices[:, :3, 3] @ Q.T, Q @ R @ Q.T if turned else R), sample.readings


def _inverted(whole: bool, sample: Sample) -> tuple[Array, Array]:
    """Return the orientations, or whole poses, of the base seen from the platform."""
    matrices = sample.matrices()
    turns, r = matrices[:, :3, :3].transpose(0, 2, 1), matrices[:, :3, 3]
    inverted = -(turns @ r[:, :, None])[:, :, 0]
    return sample.moved(inverted if whole else r, turns), sample.readings


def _angles(sample: Sample) -> Iterator[Hypothesis]:
    """Yield signs and orders of the columns by which a spatial platform's orientation was given."""
    for way in sample.ways if sample.mechanism.platform.turns == 3 else ():
        names, unit = WAYS[way]
        n = len(names)
        for one in range(n) if unit == "rad" else ():
            signs = np.where(np.arange(n) == one, -1.0, 1.0)
            right = partial(_turned, way, np.arange(n), signs)
            yield Hypothesis("sign-of-angle", right, {"column": names[one]})
        swaps = [[{i: j, j: i}.get(k, k) for k in range(n)] for i, j in combinations(range(n), 2)]
        for order in [*swaps, [*range(1, n), 0], [n - 1, *range(n - 1)]]:
            moved = [(name, names[k]) for name, k in zip(names, order, strict=True)]
            values = {"order": tuple((name, column) for name, column in moved if name != column)}
            right = partial(_turned, way, np.array(order), np.ones(n))
            yield Hypothesis("angles-exchanged", right, values)


def _turned(way: str, order: Index, signs: Array, sample: Sample) -> tuple[Array, Array]:
    matrices = sample.matrices()
    angles = columns_of(way, Rotation.from_matrix(matrices[:, :3, :3]))
    turns = rotation_of(way, angles[:, order] * signs).as_matrix()
    return sample.moved(matrices[:, :3, 3], turns), sample.readings


def _shifted(shift: int, sample: Sample) -> tuple[Array, Array]:
    """Return the readings that stand some rows below, or above, the poses."""
    shifted_rows = sample.rows + shift
    inside = (shifted_rows >= 0) & (shifted_rows < len(sample.log))
    right = np.full(sample.readings.shape, np.nan)
    right[inside] = sample.log[shifted_rows[inside]]
    return sample.poses, right


def _units(sample: Sample) -> Iterator[Hypothesis]:
    """Yield what units may be wrong, in one kind of columns or in several together."""
    mechanism = sample.mechanism
    coordinates, columns = np.array(mechanism.platform.units), np.array(mechanism.reading_units)
    kinds = [("positions", "m", coordinates)]
    kinds += [("orientations", "rad", coordinates)] if sample.oriented else []
    kinds += [("readings", "m", columns), ("readings", "rad", columns)]
    kinds = [kind for kind in kinds if kind[1] in kind[2]]
    for choice in product(*([None, *UNITS[unit].items()] for _, unit, _ in kinds)):
        wrong = [(kind, how) for kind, how in zip(kinds, choice, strict=True) if how]
        scales = np.ones(len(coordinates)), np.ones(len(columns))
        for (name, unit, units), (_, factor) in wrong:
            scales[name == "readings"][units == unit] = factor
        if wrong:
            yield Hypothesis(
                "unit",
                partial(_scaled, *scales),
                {"units": tuple((name, unit, given) for (name, unit, _), (given, _) in wrong)},
                by_leg=all(name == "readings" for (name, _, _), _ in wrong),
                faults=len(wrong),
            )


def _scaled(poses: Array, readings: Array, sample: Sample) -> tuple[Array, Array]:
    return sample.poses * poses, sample.readings * readings


def _exchanged(sample: Sample) -> Iterator[Hypothesis]:
    """Yield the order of columns in which the legs fit best, if it is another than given.

    In an unknown frame, where legs cannot be judged one by one, all exchanges of two, and all legs
    one further or in reverse.
    """
    mechanism = sample.mechanism
    n = len(mechanism.legs)
    if len(mechanism.reading_names) != n or n < 2:
        return
    if sample.free or not sample.oriented:
        every = list(range(n))
        turned = [every[k:] + every[:k] for k in ((1, n - 1) if n > 2 else ())]
        pairs = combinations(every, 2)
        swaps = [[{i: j, j: i}.get(k, k) for k in every] for i, j in pairs]
        orders = [*swaps, *turned, *([every[::-1]] if n > 3 else [])]
    else:
        orders = [_best_order(sample)]
    for order in orders:
        moved = [(mechanism.leg_names[i], mechanism.leg_names[j]) for i, j in enumerate(order)]
        moved = [(leg, column) for leg, column in moved if leg != column]
        if moved:
            values = {"order": tuple(moved)}
            yield Hypothesis("legs-exchanged", partial(_ordered, np.array(order)), values)


def _best_order(sample: Sample) -> list[int]:
    """Return the column that each leg fits best, each to one leg; legs stay where they may."""
    from scipy.optimize import linear_sum_assignment  # slow to load: when needed

    every, matrices = range(len(sample.mechanism.legs)), sample.matrices()
    matrices[:, :3, 3] -= matrices[:, :3, :3] @ sample.offset

    def cost(fit: LegFit) -> float:
        return float(np.clip(fit.near, RULE.questioned * fit.stroke, 1.0)) if fit.rows > 1 else 1.0

    rows = [LegMeasurements(i, matrices, sample.readings[:, [j]]) for i in every for j in every]
    costs = [cost(leg_fit) for leg_fit in leg_fits(sample.mechanism, rows)]
    table = np.reshape(costs, (len(every), len(every)))
    stays = 1e-9 * np.eye(len(every))
    return [int(j) for j in linear_sum_assignment(np.nan_to_num(table, nan=1.0) - stays)[1]]


def zeros_found(calibration: Calibration, found: Sequence[Finding]) -> Array | None:
    """Return where the search starts if zeros explain what does not fit, shape (n_params,).

    None if something else may explain it, or if a zero is not identified.

    Args:
        calibration: What is to be identified.
        found: Hypotheses that explain the measurements.
    """
    offsets = np.zeros(len(calibration.mechanism.reading_names))
    for one in found:
        if one.code != "reading-offset" or one.values["unknown_frame"]:
            return None
        for name, off, _ in one.values["offsets"]:
            offsets[calibration.mechanism.reading_names.index(name)] = off
    return _started(calibration, offsets) if len(found) == 1 else None


def zeros_measured(calibration: Calibration) -> Array | None:
    """Return where the search starts with the zeros that full poses show, shape (n_params,).

    None without full poses, or if no zero is identified.
    """
    mechanism = calibration.mechanism
    sample = sample_of(mechanism, calibration.measurements, calibration.options.setup)
    if sample is None or mechanism.by_readings or sample.free or not sample.oriented:
        return None
    (poses_and_rows,) = placed([sample])
    if poses_and_rows is None:
        return None
    offsets = offsets_of(sample, poses_and_rows[0])
    identified = [index for index, _ in _zeros(calibration)]
    return _started(
        calibration, np.where(np.isin(np.arange(len(offsets)), identified), offsets, 0.0)
    )


def _started(calibration: Calibration, offsets: Array) -> Array | None:
    """Return the nominal parameters with zeros of readings that are off, if all are identified."""
    start = np.concatenate([leg.nominal for leg in calibration.mechanism.legs])
    zeros = dict(_zeros(calibration))
    for index in np.flatnonzero(offsets).tolist():
        if index not in zeros:
            return None
        place, by_reading = zeros[index]
        start[place] += by_reading * offsets[index]
    return start if offsets.any() else None


def _zeros(calibration: Calibration) -> list[tuple[int, tuple[int, float]]]:
    """Return of each reading whose zero is identified: its parameter, and how that follows.

    ψ = d k q + γ grows with γ; q = d k ψ + γ falls by d k of it. Zeros with priors, ties or terms,
    or of several sensors, start at nominal.
    """
    unknowns = calibration.unknowns()
    free = unknowns.map != 0.0
    alone = free[:, free.sum(axis=0) == 1].sum(axis=1) == 1
    found, first, index = [], 0, 0
    for leg in calibration.mechanism.legs:
        offsets = [sensor.offset for sensor in leg.sensors]
        for sensor, name in zip(leg.sensors, offsets, strict=True):
            if isinstance(name, str) and offsets.count(name) == 1 and not sensor.terms:
                place = first + leg.parameter_names.index(name)
                gain, _ = sensor.constants(leg.nominal_by_name)
                if alone[place] and np.isinf(unknowns.priors[place]):
                    found.append((index, (place, 1.0 if sensor.form == "reading" else -gain)))
            index += 1
        first += len(leg.parameters)
    return found
