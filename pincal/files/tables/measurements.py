"""CSV files of poses, readings and measurements that belong to a mechanism, read."""

from __future__ import annotations

import logging
from collections.abc import Collection, Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MeasurementError
from pincal.files.given_mechanism import GivenMechanism, as_mechanism
from pincal.files.input import plain_number
from pincal.files.tables.columns import Source, table_for, unknown_columns
from pincal.files.tables.covariances import read_covariances
from pincal.files.tables.level import levelled, tilt_column
from pincal.files.tables.table import Table
from pincal.model.checks import must_be
from pincal.model.measuring.measurements import EVERY_LEG, VERIFY, Measurements, Plan
from pincal.model.measuring.setup import Setup
from pincal.model.mechanism import Mechanism
from pincal.model.orientation import SINGLE_ANGLES, WAYS, columns_of, rotation_of

Array = NDArray[np.float64]
_log = logging.getLogger(__name__)


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
