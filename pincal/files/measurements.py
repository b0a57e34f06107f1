"""CSV files of poses, readings and measurements that belong to a mechanism, read."""

from __future__ import annotations

import logging
import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

from pincal.errors import MeasurementError, MechanismError
from pincal.files.level import levelled, tilt_column
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.files.table import Table, read_table
from pincal.files.text import plain_number
from pincal.model.checks import must_be
from pincal.model.measurements import EVERY_LEG, VERIFY, Measurements, Plan
from pincal.model.mechanism import Mechanism
from pincal.model.orientation import SINGLE_ANGLES, WAYS, columns_of, rotation_of
from pincal.model.setup import Setup
from pincal.model.units import COUNTS, UNITS
from pincal.types import Array
from pincal.words.wording import NAMED

_SQUARE = re.compile(r"(.+?)\s*(?:\^|\*\*)?\s*[2²]")


def covariance_headers(units: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """Return the headers that covariances of quantities may have, and their pairs.

    Args:
        units: Names of the quantities, and their dimensions.
    """
    pairs = [*combinations(units, 2)]
    return {
        f"cov_{a}_{b}": (first, second)
        for first, second in pairs
        for a, b in ((first, second), (second, first))
    }


def read_covariances(table: Table, units: Mapping[str, str]) -> dict[str, Array]:
    """Return the covariances that a table has, by pair such as ``"x,y"``, in SI units.

    Args:
        table: The table.
        units: Names of the quantities, and their dimensions.

    Raises:
        MeasurementError: a unit that is not the product of both, or a cell that is no number.
    """
    headers = covariance_headers(units)
    if other := [name for name in table.units if name.startswith("cov_") and name not in headers]:
        raise MeasurementError(
            f"{table.path}: column {other[0]!r} is no covariance of two quantities measured of the "
            f"platform ({', '.join(units)}); rename it, or leave it out"
        )
    found: dict[str, Array] = {}
    for header, (first, second) in headers.items():
        if header not in table:
            continue
        if (pair := f"{first},{second}") in found:
            raise MeasurementError(
                f"{table.path}: the covariance of {first} and {second} is said twice; leave one "
                "of the columns"
            )
        said, needed = table.units[header], (units[first], units[second])
        factor = None if said is None else _factor(said, needed)
        if factor is None:
            has = "no unit" if said is None else f"unit [{said}]"
            raise MeasurementError(
                f"{table.path}: column {header!r} has {has}; expected "
                f"'{header} [{product_unit(*needed)}]', the product of both, or [mm2], [mm mrad], "
                "[mrad2]"
            )
        found[pair] = table.plain(header, blank=True) * factor
    return found


def product_unit(first: str, second: str) -> str:
    """Return how the product of two SI units is written."""
    return f"{first}2" if first == second else f"{first} {second}"


def _factor(said: str, needed: tuple[str, str]) -> float | None:
    """Return the factor to SI of a product of two units, None if it is another."""
    square = _SQUARE.fullmatch(said.strip())
    parts = [square[1]] * 2 if square else re.split(r"\s*[·*⋅ ]\s*", said.strip())
    if len(parts) != 2 or not all(one in UNITS for one in parts):
        return None
    if sorted(UNITS[one][0] for one in parts) != sorted(needed):
        return None
    return UNITS[parts[0]][1] * UNITS[parts[1]][1]


Source = Any  # a path, or a pandas DataFrame
_log = logging.getLogger(__name__)


def table_for(
    path: Source,
    mechanism: Mechanism,
    more: Mapping[str, str] | None = None,
    further: Collection[str] | None = (),
) -> Table:
    """Return a table; headers such as ``x (mm)``, ``X [mm]``, ``x_mm`` are read as ``x [mm]``.

    That is logged, as are columns without a meaning, but for further ones; None for any. A header
    that is nearly a known one and says no unit is refused.
    """
    must_be(mechanism, Mechanism, "the mechanism", MechanismError)
    every = {name: mechanism.counts.get(name) for name in mechanism.reading_names}
    counts = every | {f"sigma_{name}": by for name, by in every.items()}
    read = read_table(path)
    table = replace(read, units=dict(read.units), text=dict(read.text), counts=counts)
    units = _known(mechanism, more or {})
    other: dict[str, str] = {}
    for column, own in table.units.items():
        meant = [name for name in units if name not in table and _nearly(column, name, units[name])]
        if column not in units and meant:
            name, said = meant[0], own or _said_in(column, meant[0], units[meant[0]])
            if said and len(meant) == 1 and meant[0] not in other.values():
                other[column] = name
                continue
            unit = own or _unit_in(column, meant[0], units[meant[0]])
            written = f"{column} [{own}]" if own else column
            raise MeasurementError(
                f"{table.path}: column {written!r} is not understood; write "
                f"{f'{name} [{unit}]' if unit else name!r}"
            )
    for column, name in other.items():
        table.units[name] = table.units.pop(column) or _said_in(column, name, units[name])
        table.text[name] = table.text.pop(column)
    if other:
        renamed = [
            f"{column!r} as '{name} [{table.units[name]}]'" for column, name in other.items()
        ]
        _log.info("%s: columns read: %s", table.path, ", ".join(renamed))
    unused = [
        name
        for name in unknown_columns(table, mechanism, more)
        if further is not None and name not in further
        if name != "row" and not name.startswith("planned_")  # of a measuring sheet
    ]
    if unused:
        names = [name if name.isprintable() else ascii(name) for name in unused[:NAMED]]
        names += [f"and {len(unused) - NAMED} more"] * (len(unused) > NAMED)
        _log.info("%s: columns not used: %s", table.path, ", ".join(names))
    return table


def unknown_columns(
    table: Table, mechanism: Mechanism, more: Mapping[str, str] | None = None
) -> dict[str, tuple[str, ...]]:
    """Return the columns of a table without a meaning, as they are: name to cells."""
    known = _known(mechanism, more or {})
    return {name: tuple(table.text[name]) for name in table.units if name not in known}


def _known(mechanism: Mechanism, more: Mapping[str, str]) -> dict[str, str]:
    """Return the columns that mean something, with their units; empty for names."""
    platform = mechanism.platform
    units = dict(zip(platform.freedoms, platform.units, strict=True))
    units |= dict(zip(platform.coordinates, platform.units, strict=True))
    units |= {name: unit for names, unit in WAYS.values() for name in names}
    units |= dict(zip(mechanism.reading_names, mechanism.reading_units, strict=True))
    units |= more
    units |= {f"sigma_{name}": unit for name, unit in units.items()}
    pairs = covariance_headers(dict.fromkeys((*platform.freedoms, *more), ""))
    named = ("set", "run", "pose", *pairs, *mechanism.influences, *mechanism.followed)
    return {**dict.fromkeys(named, ""), **units}


def _nearly(column: str, name: str, unit: str) -> bool:
    """Return whether a column is meant by name, but in other case, or with its unit otherwise."""
    bare = column.lower()
    return bare == name.lower() or (
        bare.startswith(name.lower()) and _unit_in(column, name, unit) is not None
    )


def _said_in(column: str, name: str, dimension: str) -> str:
    """Return the unit that a header says after a name, nothing if it says none of the dimension."""
    inner = column[len(name) :].strip(" _/-(){}<>")
    return inner if inner == COUNTS or UNITS.get(inner, ("",))[0] == dimension else ""


def _unit_in(column: str, name: str, dimension: str) -> str | None:
    """Return the unit that follows a name as in ``x (mm)``, ``x_mm``, ``x/mm``.

    That of the dimension where the brackets say another one, or nothing.
    """
    rest = column[len(name) :]
    inner = rest.strip(" _/-(){}<>")
    if (inner == COUNTS or UNITS.get(inner, ("",))[0] == dimension) and inner != rest:
        return inner
    return (dimension or "") if rest.strip().startswith("(") or not rest else None


def read_poses(path: Source, mechanism: GivenMechanism, *, partial: bool = False) -> Plan:
    """Return the poses of a CSV file or DataFrame: see ``Plan.from_csv``."""
    mechanism = as_mechanism(mechanism)
    table = table_for(path, mechanism)
    readings = None
    if mechanism.by_readings and any(name in table for name in mechanism.reading_names):
        readings = _readings(table, mechanism)
    poses = _poses(table, mechanism, partial=partial)
    return Plan(
        poses,
        _sets(table, mechanism),
        readings,
        places=_names(table, "pose"),
        influences=_influences(table, mechanism),
        lines=table.file_lines,
        written=_way(table) if mechanism.platform.turns == 3 else None,
    )


def read_readings(path: Source, mechanism: GivenMechanism) -> Array:
    """Return the readings of a CSV file, shape (N, n_readings), [rad] or [m].

    Raises:
        FileError: the file is missing or cannot be read.
        MeasurementError: a column or cell that is missing or wrong; the message says where.
    """
    mechanism = as_mechanism(mechanism)
    return _readings(table_for(path, mechanism), mechanism)


def read_influences(path: Source, mechanism: Mechanism) -> dict[str, Array]:
    """Return the columns on which terms depend, those that a file has.

    Raises:
        FileError: the file is missing or cannot be read.
        MeasurementError: a cell that is no number; the message says where.
    """
    return _influences(table_for(path, mechanism), mechanism)


def read_measurements(
    path: Source,
    mechanism: GivenMechanism,
    setup: Setup | None = None,
    *,
    partial: bool = False,
    influences: Collection[str] | None = (),
) -> Measurements:
    """Return the measurements of a CSV file or DataFrame: see ``Measurements.from_csv``.

    Influences are further columns to read, on which no term depends yet; None for all columns of
    numbers that differ.
    """
    mechanism = as_mechanism(mechanism)
    setup = Setup() if setup is None else must_be(setup, Setup, "the setup", MeasurementError)
    more = setup.columns(mechanism)
    polar = {f"sigma_{name}": unit for name, unit in setup.polar.items()}
    level = tilt_column(mechanism, more)
    table = table_for(path, mechanism, more | polar | level, influences)
    table = table.where_measured(measured_columns(mechanism, more))
    said = [name for name in ("range", "elevation") if name not in more]
    if not polar and (own := [name for name in said if f"sigma_{name}" in table]):
        raise MeasurementError(
            f"{table.path}: column 'sigma_{own[0]}' says how well a tracker measures; say where it "
            "is in the frame of the measurements: 'tracker: {at: [0, 0, 0]}' in the setup "
            "(--setup), or leave the column out"
        )
    for name in mechanism.influences:
        if name not in table and name not in mechanism.followed:
            raise MeasurementError(
                f"{table.path}: no column {name!r}, on which terms of sensors depend; add it, or "
                "leave these terms out of the mechanism"
            )
    for name, whose in setup.required.items():
        if name not in table:
            raise MeasurementError(
                f"{table.path}: no column {name!r}, {whose}; expected '{name} [{more[name]}]'"
            )
    platform = mechanism.platform
    if platform.turns == 3 and partial and _way(table) is None:
        more |= {name: "rad" for name in SINGLE_ANGLES if name in table}
    if not partial:
        _whole(table, mechanism)
    poses = _poses(table, mechanism, partial=partial)
    if level and "z" in table:
        poses = levelled(table, setup, poses)
    extra = {
        name: table.numbers(name, unit, blank=True)
        for name, unit in more.items()
        if name in table or not partial
    }
    by_row = more | setup.polar
    named = {f"sigma_{name}": name for name in by_row if f"sigma_{name}" in table}
    seen = dict(zip(platform.freedoms, platform.units, strict=True)) | more
    units = dict(zip(mechanism.reading_names, mechanism.reading_units, strict=True))
    readings = [table.numbers(name, unit, blank=partial) for name, unit in units.items()]
    data = Measurements(
        poses=poses,
        sets=_sets(table, mechanism),
        readings=np.column_stack(readings),
        sigma_poses=_sigmas(
            table, dict(zip(platform.freedoms, platform.units, strict=True)), some=partial
        ),
        sigma_readings=_sigmas(table, units),
        extra=extra,
        sigma_extra={
            name: _not_negative(table, column, by_row[name], blank=partial)
            for column, name in named.items()
        },
        covariances=read_covariances(table, seen),
        influences=_influences(table, mechanism)
        | _numbers(table, unknown_columns(table, mechanism, more | polar | level), influences),
        runs=_names(table, "run"),
        places=_names(table, "pose"),
        lines=table.file_lines,
        written=_way(table) if platform.turns == 3 else None,
    )
    measured = [data.poses, *(values[:, None] for values in extra.values())]
    if not any(np.isfinite(values).any() for values in measured) and not partial:
        raise MeasurementError(f"{table.path}: nothing of the platform is measured")
    return data


def measured_columns(mechanism: Mechanism, more: Iterable[str]) -> set[str]:
    """Return the columns that say what was measured or read, if a table has them.

    Args:
        mechanism: The mechanism.
        more: Columns of the setup.
    """
    turns = {name for names, _ in WAYS.values() for name in names}
    return {*mechanism.platform.coordinates, *turns, *more, *mechanism.reading_names}


def _way(table: Table) -> str | None:
    """Return the way in which a table gives orientations in full, if it does.

    Raises:
        MeasurementError: it does so in several ways, which may say different things.
    """
    ways = [way for way, (names, _) in WAYS.items() if all(name in table for name in names)]
    if len(ways) > 1:
        said = " and ".join(", ".join(WAYS[way][0]) for way in ways)
        raise MeasurementError(
            f"{table.path}: the orientation is said in {len(ways)} ways, {said}; leave one of them"
        )
    return ways[0] if ways else None


def _poses(table: Table, mechanism: Mechanism, *, partial: bool = False) -> Array:
    """Return the coordinates of poses; a spatial platform's orientation in any of the ways.

    If they may be partial, NaN where a column is missing or a cell empty.
    """
    platform = mechanism.platform
    way = _way(table) if platform.turns == 3 else None
    places = platform.coordinates[: platform.lengths]
    present = [name for name in places if name in table]
    if not partial and present and len(present) < len(places):
        raise MeasurementError(
            f"{table.path}: of {', '.join(places)} only {', '.join(present)}; add the others"
        )

    def numbers(name: str, unit: str) -> Array:
        if partial and name not in table:
            return np.full(len(table.lines), np.nan)
        return table.numbers(name, unit, blank=partial)

    units = dict(zip(platform.coordinates, platform.units, strict=True))
    if platform.turns < 3 or way in (None, "tilt-torsion"):
        return np.column_stack([numbers(name, unit) for name, unit in units.items()])
    names, unit = WAYS[way]
    values = np.column_stack([numbers(name, unit) for name in names])
    position = np.column_stack([numbers(name, "m") for name in places] or [values[:, :0]])
    given = np.isfinite(values).all(axis=1)
    turns = np.full((len(values), 3), np.nan)
    try:
        turns[given] = columns_of("tilt-torsion", rotation_of(way, values[given]))
    except MeasurementError as error:
        raise MeasurementError(f"{table.path}: {error}") from error
    return np.concatenate((position, turns), axis=1)


def _whole(table: Table, mechanism: Mechanism) -> None:
    """Raise if a table has some columns of the pose, but not all.

    Raises:
        MeasurementError: it was measured in part.
    """
    platform = mechanism.platform
    places = platform.lengths
    needed = platform.coordinates[: places if _way(table) else None]
    missing = [name for name in needed if name not in table]
    if missing and len(missing) < len(needed):
        unit = platform.units[platform.coordinates.index(missing[0])]
        raise MeasurementError(
            f"{table.path}: no column {missing[0]!r}; expected '{missing[0]} [{unit}]'; "
            "only all legs together (without --per-leg) are calibrated with poses that were "
            f"measured in part. The file has {', '.join(table.units)}"
        )


def _names(table: Table, column: str) -> tuple[str, ...] | None:
    """Return a column of names, or None where there is none."""
    if column not in table:
        return None
    names = tuple(cell.strip() for cell in table.text[column])
    for row, name in enumerate(names):
        if not name.isprintable():
            raise MeasurementError(
                f"{table.where(row)}: {column} {name[:40]!r} has characters that cannot be "
                "printed; name it otherwise"
            )
    if column == "run" and "" in names:
        raise MeasurementError(f"{table.where(names.index(''))}: no run; name it in every row")
    return names


def _readings(table: Table, mechanism: Mechanism) -> Array:
    units = zip(mechanism.reading_names, mechanism.reading_units, strict=True)
    return np.column_stack([table.numbers(name, unit) for name, unit in units])


def _influences(table: Table, mechanism: Mechanism) -> dict[str, Array]:
    """Return the columns on which terms depend, numbers as they stand."""
    names = (*mechanism.influences, *sorted(mechanism.followed - set(mechanism.influences)))
    return {name: table.plain(name, blank=True) for name in names if name in table}


def _numbers(
    table: Table, columns: Mapping[str, object], wanted: Collection[str] | None
) -> dict[str, Array]:
    """Return further columns of a table, those that are wanted, or all of numbers that differ.

    Raises:
        MeasurementError: a column that is wanted is missing, or a cell is no number.
    """
    if wanted is not None:
        if missing := [name for name in wanted if name not in table]:
            raise MeasurementError(
                f"{table.path}: no column {missing[0]!r}, on which terms are to depend. The file "
                f"has {', '.join(table.units)}"
            )
        return {name: table.plain(name, blank=True) for name in wanted}
    found = {}
    for name in columns:
        values = np.array([plain_number(cell) for cell in table.text[name]])
        known = np.isfinite(values)
        if name == "row" or name.startswith("planned_") or not known.any():
            continue
        if known.all() and np.ptp(values) > 0.0:
            found[name] = values
        elif not known.all():
            where = table.where(int(np.argmin(known)))
            _log.info("%s: no number, so no term is tried with column %r", where, name)
    return found


def _sets(table: Table, mechanism: Mechanism) -> tuple[str, ...] | None:
    if "set" not in table:
        return None
    known = {*mechanism.leg_names, EVERY_LEG, ""}
    sets = tuple(cell.strip() for cell in table.text["set"])
    for row, name in enumerate(sets):
        if name not in (*known, VERIFY) and not known.issuperset(name.split("+")):
            raise MeasurementError(
                f"{table.where(row)}: set {name!r} is no leg of {mechanism.name!r}; "
                f"expected {', '.join(mechanism.leg_names)}, {EVERY_LEG} or {VERIFY}"
            )
    return sets


def _sigmas(table: Table, units: dict[str, str], *, some: bool = False) -> Array | None:
    """Return the ``sigma_…`` columns, shape (N, n), or None where there are none.

    Where ``some`` are enough, those that are missing are NaN.
    """
    present = [name for name in units if f"sigma_{name}" in table]
    if not present:
        return None
    unknown = np.full(len(table.lines), np.nan)
    return np.column_stack(
        [
            unknown
            if some and name not in present
            else _not_negative(table, f"sigma_{name}", unit, blank=some)
            for name, unit in units.items()
        ]
    )


def _not_negative(table: Table, column: str, unit: str, *, blank: bool = False) -> Array:
    """Return a column of standard deviations, shape (N,)."""
    values = table.numbers(column, unit, blank=blank)
    if (values < 0.0).any():
        raise MeasurementError(
            f"{table.where(int(np.argmax(values < 0.0)))}: {column!r} is "
            "negative; a standard deviation is 0 or more"
        )
    return values
