"""Poses, readings and measurements that belong to a mechanism, read from tables.

What people hand over is an object, or the name, file or DataFrame that it is read from.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from pincal.errors import MeasurementError
from pincal.files.level import levelled, tilt_column
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.files.table import TextTable, is_dataframe, read_table
from pincal.files.text import plain_number
from pincal.files.yaml import read_setup
from pincal.model.checks import array_of, must_be
from pincal.model.measurements import EVERY_LEG, VERIFY, Measurements, Noise, Plan
from pincal.model.mechanism import Mechanism
from pincal.model.orientation import SINGLE_ANGLES, WAYS, columns_of, rotation_of
from pincal.model.setup import Setup
from pincal.model.units import COUNTS, UNITS
from pincal.types import Array
from pincal.words.wording import NAMED

_SQUARE = re.compile(r"(.+?)\s*(?:\^|\*\*)?\s*[2²]")
_log = logging.getLogger(__name__)


def as_noise(noise: Noise | None) -> Noise:
    """Return the noise that is given; without one, the default."""
    if noise is None:
        return Noise()
    return must_be(noise, (Noise,), "noise, pincal.Noise(…)", MeasurementError)


def read_poses(source: Any, mechanism: GivenMechanism, *, partial: bool = False) -> Plan:
    """Return a plan that is given as such, as poses, by a CSV file, or as a DataFrame.

    Args:
        source: A ``Plan``; poses, coordinates of shape (N, dof) or a ``RigidTransform``; a path;
            or a pandas DataFrame: see ``Plan.from_csv``.
        mechanism: The mechanism.
        partial: Whether columns or cells of the pose may be missing in a table.

    Raises:
        FileError: the file is missing or cannot be read.
        MeasurementError: something else, or a column or cell that is wrong.
    """
    mechanism = as_mechanism(mechanism)
    platform = mechanism.platform
    if isinstance(source, Plan):
        return source
    if isinstance(source, RigidTransform):
        return Plan(platform.coordinates_of(source))
    if not (isinstance(source, str | Path) or is_dataframe(source)):
        kind = "poses, a plan or its file"
        return Plan(array_of(source, ("N", platform.dof), kind, MeasurementError))
    table = _table(source, mechanism, _known(mechanism, {}))
    commanded = mechanism.by_readings and any(name in table for name in mechanism.reading_names)
    return Plan(
        _poses(table, mechanism, partial=partial),
        _sets(table, mechanism),
        table.array(_reading_units(mechanism)) if commanded else None,
        places=_names(table, "pose"),
        influences=_influences(table, mechanism),
        lines=table.file_lines,
        written=_way(table, mechanism),
    )


def read_readings(source: Any, mechanism: GivenMechanism) -> tuple[Array, dict[str, Array]]:
    """Return the readings of a CSV file, shape (N, n_readings), and columns that terms depend on.

    Raises:
        FileError: the file is missing or cannot be read.
        MeasurementError: a column or cell that is missing or wrong; the message says where.
    """
    mechanism = as_mechanism(mechanism)
    table = _table(source, mechanism, _known(mechanism, {}))
    return table.array(_reading_units(mechanism)), _influences(table, mechanism)


def read_measurements(
    source: Any,
    mechanism: GivenMechanism,
    setup: Setup | str | Path | None = None,
    *,
    partial: bool = False,
    influences: Collection[str] | None = (),
) -> Measurements:
    """Return measurements that are given as such, by a CSV file, or as a DataFrame.

    Args:
        source: ``Measurements``, a path, or a pandas DataFrame: see ``Measurements.from_csv``.
        mechanism: The mechanism.
        setup: What else was measured than the platform's pose.
        partial: Whether columns or cells of the pose may be missing.
        influences: Further columns to read, on which no term depends yet; None for all columns of
            numbers that differ.

    Raises:
        FileError: the file is missing or cannot be read.
        MeasurementError: something else, numbers of another mechanism, or a column or cell that
            is wrong.
    """
    mechanism, setup = as_mechanism(mechanism), read_setup(setup or Setup())
    platform = mechanism.platform
    if isinstance(source, Measurements):
        for name, count in (("poses", platform.dof), ("readings", len(mechanism.reading_names))):
            purpose = f"{name} of {mechanism.name!r}"
            array_of(getattr(source, name), ("N", count), purpose, MeasurementError)
        return source
    if not (is_dataframe(source) or isinstance(source, TextTable)):
        kinds = (Measurements, str, Path)
        must_be(source, kinds, "measurements, their CSV file or DataFrame", MeasurementError)
    further = setup.columns(mechanism)
    level = tilt_column(mechanism, further)
    known = _known(mechanism, further | level)
    table = _table(source, mechanism, known, influences)
    turns = {name for names, _ in WAYS.values() for name in names}
    table = table.where_measured(
        {*platform.coordinates, *turns, *further, *mechanism.reading_names}
    )
    _check_columns(table, mechanism, setup, further)
    way = _way(table, mechanism)
    if platform.turns == 3 and partial and way is None:
        further |= dict.fromkeys(filter(table.units.__contains__, SINGLE_ANGLES), "rad")
    poses = _poses(table, mechanism, partial=partial)
    if level and "z" in table:
        poses = levelled(table, setup, poses)
    freedoms = dict(zip(platform.freedoms, platform.units, strict=True))
    unknown = _unknown(table, known)
    extra, sigma_extra = _further_columns(table, further, partial=partial)
    if not partial and not np.isfinite(np.column_stack((poses, *extra.values()))).any():
        raise MeasurementError(f"{table.path}: nothing of the platform is measured")
    return Measurements(
        poses=poses,
        sets=_sets(table, mechanism),
        readings=table.array(_reading_units(mechanism), blank=partial),
        sigma_poses=_sigmas(table, freedoms, partial=partial),
        sigma_readings=_sigmas(table, _reading_units(mechanism)),
        extra=extra,
        sigma_extra=sigma_extra,
        covariances=_covariances(table, freedoms | further),
        influences=_influences(table, mechanism) | _further_influences(table, unknown, influences),
        runs=_names(table, "run"),
        places=_names(table, "pose"),
        lines=table.file_lines,
        written=way,
    )


def _further_columns(
    table: TextTable, units: Mapping[str, str], *, partial: bool
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return what was measured besides poses and readings, by column, and its uncertainties."""
    wanted = [name for name in units if name in table or not partial]
    uncertain = {name: unit for name, unit in units.items() if f"sigma_{name}" in table}
    return (
        {name: table.numbers(name, units[name], blank=True) for name in wanted},
        {name: _sigma(table, name, unit, blank=partial) for name, unit in uncertain.items()},
    )


def _table(
    source: Any,
    mechanism: Mechanism,
    known: Mapping[str, str],
    wanted_influences: Collection[str] | None = (),
) -> TextTable:
    """Return a table; headers such as ``x (mm)``, ``X [mm]``, ``x_mm`` are read as ``x [mm]``.

    That is logged, as are columns that are not known (see ``_known``), but for influences that are
    wanted (None: any column is).
    """
    counts = {name: mechanism.counts.get(name) for name in mechanism.reading_names}
    counts |= {f"sigma_{name}": per_unit for name, per_unit in counts.items()}
    table = replace(read_table(source), counts=counts)
    if meant := _headers_meant(table, known):
        read_as = [f"{column!r} as '{name} [{unit}]'" for column, (name, unit) in meant.items()]
        _log.info("%s: columns read: %s", table.path, ", ".join(read_as))
        table = table.renamed(meant)
    if wanted_influences is not None:
        unused = [name for name in _unknown(table, known) if name not in wanted_influences]
        if unused:
            shown = [name if name.isprintable() else ascii(name) for name in unused[:NAMED]]
            shown += [f"and {len(unused) - NAMED} more"] * (len(unused) > NAMED)
            _log.info("%s: columns not used: %s", table.path, ", ".join(shown))
    return table


def _unknown(table: TextTable, known: Collection[str]) -> list[str]:
    """Return the columns of a table without a meaning, but for those that sheets plan by."""
    sheet = ("cov_", "planned_")
    return [n for n in table.units if n not in known and n != "row" and not n.startswith(sheet)]


def product_unit(first: str, second: str) -> str:
    """Return how the product of two SI units is written."""
    return f"{first}2" if first == second else f"{first} {second}"


def _known(mechanism: Mechanism, further: Mapping[str, str]) -> dict[str, str]:
    """Return the columns that mean something, with their units; empty for names."""
    platform = mechanism.platform
    units = dict(zip(platform.freedoms, platform.units, strict=True))
    units |= dict(zip(platform.coordinates, platform.units, strict=True))
    units |= {name: unit for names, unit in WAYS.values() for name in names}
    units |= {**_reading_units(mechanism), **further}
    units |= {f"sigma_{name}": unit for name, unit in units.items()}
    named = ("set", "run", "pose", *mechanism.influences, *mechanism.followed)
    return {**dict.fromkeys(named, ""), **units}


def _reading_units(mechanism: Mechanism) -> dict[str, str]:
    """Return the unit of each reading, by its column."""
    return dict(zip(mechanism.reading_names, mechanism.reading_units, strict=True))


def _headers_meant(table: TextTable, units: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """Return name and unit of columns whose headers say them in other case, or otherwise."""
    meant: dict[str, tuple[str, str]] = {}
    for column, bracketed in table.units.items():
        behind = {
            name: unit
            for name, dimension in units.items()
            if name not in table and (unit := _unit_behind(column, name, dimension)) is not None
        }
        if column in units or not behind:
            continue
        name = next(iter(behind))
        unit = bracketed or behind[name]
        if not unit or len(behind) > 1 or name in dict(meant.values()):
            header = f"{column} [{bracketed}]" if bracketed else column
            unit = unit or units[name]
            raise MeasurementError(
                f"{table.path}: column {header!r} is not understood; write "
                f"{f'{name} [{unit}]' if unit else name!r}"
            )
        meant[column] = name, unit
    return meant


def _unit_behind(column: str, name: str, dimension: str) -> str | None:
    """Return the unit behind a name as in ``x (mm)``, ``x_mm``, ``x/mm``.

    It is empty where there is nothing or another unit in brackets, None if the column is another.
    """
    rest = column[len(name) :]
    if not column.lower().startswith(name.lower()):
        return None
    unit = rest.strip(" _/-(){}<>")
    if (unit == COUNTS or UNITS.get(unit, ("",))[0] == dimension) and unit != rest:
        return unit
    return "" if not rest or rest.strip().startswith("(") else None


def _check_columns(
    table: TextTable, mechanism: Mechanism, setup: Setup, further: Mapping[str, str]
) -> None:
    """Raise if a column is missing that terms or the setup need, or one needs another setup."""
    of_tracker = [name for name in ("range", "elevation") if name not in further]
    of_tracker = [name for name in of_tracker if f"sigma_{name}" in table]
    if of_tracker:
        raise MeasurementError(
            f"{table.path}: column 'sigma_{of_tracker[0]}': how well a tracker measures is said "
            "for all rows, with where it is in the frame of the measurements: 'tracker: {at: [0, "
            "0, 0], range: 5.0e-6, azimuth: 1.0e-5, elevation: 1.0e-5}' in the setup (--setup)"
        )
    needed = {
        name: "on which terms of sensors depend; add it, or leave these terms out of the mechanism"
        for name in mechanism.influences
        if name not in mechanism.followed
    }
    for name, owner in setup.required.items():
        needed[name] = f"{owner}; expected '{name} [{further[name]}]'"
    for name, purpose in needed.items():
        if name not in table:
            raise MeasurementError(f"{table.path}: no column {name!r}, {purpose}")


def _way(table: TextTable, mechanism: Mechanism) -> str | None:
    """Return the way in which a table gives orientations in space in full, if it does."""
    if mechanism.platform.turns < 3:
        return None
    ways = [way for way, (names, _) in WAYS.items() if all(name in table for name in names)]
    if len(ways) > 1:
        columns = " and ".join(", ".join(WAYS[way][0]) for way in ways)
        raise MeasurementError(
            f"{table.path}: the orientation is said in {len(ways)} ways, {columns}; leave one of "
            "them"
        )
    return ways[0] if ways else None


def _poses(table: TextTable, mechanism: Mechanism, *, partial: bool) -> Array:
    """Return the coordinates of poses; a spatial platform's orientation in any of the ways.

    If they may be partial, NaN where a column is missing or a cell empty.
    """
    platform, way = mechanism.platform, _way(table, mechanism)
    units = dict(zip(platform.coordinates, platform.units, strict=True))
    if way not in (None, "tilt-torsion"):
        units = {name: units[name] for name in platform.coordinates[: platform.lengths]}
    missing = [name for name in units if name not in table]
    if not partial and missing and len(missing) < len(units):
        raise MeasurementError(
            f"{table.path}: no column {missing[0]!r}; expected '{missing[0]} "
            f"[{units[missing[0]]}]'; poses that were measured in part calibrate all legs together "
            f"only (without --method per-leg). The file has {', '.join(table.units)}"
        )
    poses = table.array(units, blank=partial, optional=partial)
    if way in (None, "tilt-torsion"):
        return poses
    names, unit = WAYS[str(way)]
    values = table.array(dict.fromkeys(names, unit), blank=partial)
    known = np.isfinite(values).all(axis=1)
    turns = np.full((len(values), 3), np.nan)
    try:
        turns[known] = columns_of("tilt-torsion", rotation_of(str(way), values[known]))
    except MeasurementError as error:
        raise MeasurementError(f"{table.path}: {error}") from error
    return np.hstack((poses, turns))


def _names(table: TextTable, column: str) -> tuple[str, ...] | None:
    """Return a column of names, or None where there is none."""
    if column not in table:
        return None
    names = tuple(cell.strip() for cell in table.text[column])
    for row, name in enumerate(names):
        if not name.isprintable():
            raise MeasurementError(
                f"{table.where(row)}: {column} {name!r} has characters that cannot be "
                "printed; name it otherwise"
            )
        if column == "run" and not name:
            raise MeasurementError(f"{table.where(row)}: no run; name it in every row")
    return names


def _sets(table: TextTable, mechanism: Mechanism) -> tuple[str, ...] | None:
    """Return the legs for which poses were chosen, or None where that is not said."""
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


def _influences(table: TextTable, mechanism: Mechanism) -> dict[str, Array]:
    """Return the columns on which terms depend, numbers as they stand."""
    names = (*mechanism.influences, *sorted(mechanism.followed - set(mechanism.influences)))
    return {name: table.plain(name, blank=True) for name in names if name in table}


def _further_influences(
    table: TextTable, columns: Iterable[str], wanted: Collection[str] | None
) -> dict[str, Array]:
    """Return further columns of a table, those that are wanted, or all of numbers that differ."""
    if wanted is not None:
        if missing := [name for name in wanted if name not in table]:
            raise MeasurementError(
                f"{table.path}: no column {missing[0]!r}, on which terms are to depend. The file "
                f"has {', '.join(table.units)}"
            )
        return {name: table.plain(name, blank=True) for name in wanted}
    numbers = {}
    for name in columns:
        values = np.array([plain_number(cell) for cell in table.text[name]])
        known = np.isfinite(values)
        if known.all() and np.ptp(values) > 0.0:
            numbers[name] = values
        elif known.any() and not known.all():
            where = table.where(int(np.argmin(known)))
            _log.info("%s: no number, so no term is tried with column %r", where, name)
    return numbers


def _sigmas(table: TextTable, units: Mapping[str, str], *, partial: bool = False) -> Array | None:
    """Return the ``sigma_…`` columns, shape (N, n), or None where there are none.

    If they may be partial, those that are missing are NaN.
    """
    if not any(f"sigma_{name}" in table for name in units):
        return None
    unknown = np.full(len(table.lines), np.nan)
    columns = [
        unknown
        if partial and f"sigma_{name}" not in table
        else _sigma(table, name, unit, blank=partial)
        for name, unit in units.items()
    ]
    return np.column_stack(columns)


def _sigma(table: TextTable, name: str, unit: str, *, blank: bool = False) -> Array:
    """Return the standard deviations of a quantity, shape (N,)."""
    values = table.numbers(f"sigma_{name}", unit, blank=blank)
    if (values < 0.0).any():
        raise MeasurementError(
            f"{table.where(int(np.argmax(values < 0.0)))}: 'sigma_{name}' is "
            "negative; a standard deviation is 0 or more"
        )
    return values


def _covariances(table: TextTable, units: Mapping[str, str]) -> dict[str, Array]:
    """Return the covariances that a table has of quantities, by pair such as ``"x,y"``, in SI."""
    pairs = {f"cov_{a}_{b}": (a, b) for a, b in combinations(units, 2)}
    pairs |= {f"cov_{b}_{a}": (a, b) for a, b in combinations(units, 2)}
    covariances: dict[str, Array] = {}
    for header in (name for name in table.units if name.startswith("cov_")):
        if header not in pairs:
            raise MeasurementError(
                f"{table.path}: column {header!r} is no covariance of two quantities measured of "
                f"the platform ({', '.join(units)}); rename it, or leave it out"
            )
        first, second = pairs[header]
        if f"{first},{second}" in covariances:
            raise MeasurementError(
                f"{table.path}: the covariance of {first} and {second} is said twice; leave one "
                "of the columns"
            )
        unit, needed = table.units[header], (units[first], units[second])
        factor = _product_factor(unit or "", needed)
        if factor is None:
            has = "no unit" if unit is None else f"unit [{unit}]"
            raise MeasurementError(
                f"{table.path}: column {header!r} has {has}; expected "
                f"'{header} [{product_unit(*needed)}]', the product of both, or [mm2], [mm mrad], "
                "[mrad2]"
            )
        covariances[f"{first},{second}"] = table.plain(header, blank=True) * factor
    return covariances


def _product_factor(unit: str, needed: tuple[str, str]) -> float | None:
    """Return the factor to SI of a product of two units, None if it is another."""
    square = _SQUARE.fullmatch(unit.strip())
    parts = [square[1]] * 2 if square else re.split(r"\s*[·*⋅ ]\s*", unit.strip())
    if sorted(UNITS.get(part, (part,))[0] for part in parts) != sorted(needed):
        return None
    return UNITS[parts[0]][1] * UNITS[parts[1]][1]
