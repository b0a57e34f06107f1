"""Poses, readings and measurements of a mechanism, read from tables.

Functions accept the object itself, or a file to read it from.
"""

import logging
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from pincal.errors import MeasurementError, located
from pincal.files.columns import known_columns, reading_units, table_of, unknown_columns
from pincal.files.further_tables import read_corners, related_columns, with_pairs
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.files.table import TextTable, read_table, renamed
from pincal.files.text import plain_number
from pincal.model import EVERY_LEG, TO, VERIFY, WAYS, Measurements, Mechanism, Noise, Plan, Setup
from pincal.model.checks import array_of, listed, must_be
from pincal.model.platform import columns_of, in_part, rotation_of
from pincal.types import Array
from pincal.words.numbers import amount

_log = logging.getLogger(__name__)
_TURNS = {name for names, _ in WAYS.values() for name in names}


def as_noise(noise: Noise | None) -> Noise:
    """Return the given noise, or the default noise for None."""
    if noise is None:
        return Noise()
    return must_be(noise, (Noise,), "noise, pincal.Noise(…)", MeasurementError)


def read_poses(
    source: Any, mechanism: GivenMechanism, *, partial: bool = False, setup: Setup | None = None
) -> Plan:
    """Return a plan given as a plan, as poses, or as a table: see ``Plan.from_csv``.

    Poses are coordinates of shape (N, dof), or a ``RigidTransform``. A setup says which columns
    have names of points that are touched.
    """
    mechanism = as_mechanism(mechanism)
    platform = mechanism.platform
    if isinstance(source, Plan):
        return source
    if isinstance(source, RigidTransform):
        return Plan(platform.coordinates_of(source))
    if not isinstance(source, str | Path):
        kind = "poses, a plan or its file"
        return Plan(array_of(source, ("N", platform.dof), kind, MeasurementError))
    table, related = related_columns(read_table(source))
    contacts = [*(setup or Setup()).contacts, *(name for name, unit in related.items() if not unit)]
    known = known_columns(mechanism, dict.fromkeys(contacts, "") | related)
    table = table_of(table, mechanism, known)
    commanded = mechanism.by_readings and any(name in table for name in mechanism.reading_names)
    return Plan(
        _poses(table, mechanism, partial=partial),
        _sets(table, mechanism),
        table.array(reading_units(mechanism)) if commanded else None,
        places=_names(table, "pose"),
        influences=_influences(table, mechanism),
        contacts=_contacts(table, contacts),
        lines=table.file_lines,
        written=_way(table, mechanism),
    )


def read_readings(source: Any, mechanism: GivenMechanism) -> tuple[Array, dict[str, Array]]:
    """Return the readings of a table, shape (N, n_readings), and the columns that terms depend on.

    Rows without readings, which 'pincal inverse' writes for poses out of reach, are NaN.
    """
    mechanism = as_mechanism(mechanism)
    table = table_of(source, mechanism, known_columns(mechanism, {}))
    readings = table.array(reading_units(mechanism), blank=True)
    if (missing := np.isnan(readings)).any(axis=1).sum() > missing.all(axis=1).sum():
        table.array(reading_units(mechanism))  # names an empty cell
    return readings, _influences(table, mechanism)


def read_measurements(
    source: Any,
    mechanism: GivenMechanism,
    setup: Setup | str | Path | None = None,
    *,
    partial: bool = False,
    influences: Collection[str] | None = (),
    pairs: Any = None,
) -> Measurements:
    """Return measurements given as such or as a table: see ``Measurements.from_csv``.

    ``influences`` are further columns to read, on which no term depends yet; None reads all
    columns of varying numbers. ``pairs`` is a table of distances: see ``with_pairs``.
    """
    mechanism, setup = as_mechanism(mechanism), setup or Setup()
    setup = setup if isinstance(setup, Setup) else Setup.from_yaml(setup)
    platform = mechanism.platform
    if isinstance(source, Measurements):
        owner, count = f"of {mechanism.name!r}", len(mechanism.reading_names)
        array_of(source.poses, ("N", platform.dof), f"poses {owner}", MeasurementError)
        array_of(source.readings, ("N", count), f"readings {owner}", MeasurementError)
        return source
    every_row, setup, named = _related(source, setup, pairs)
    further = setup.columns(mechanism)
    level = {"z": "m"} if platform.space == 2 and "z" not in further else {}
    known = known_columns(mechanism, further | level | dict.fromkeys(named, ""))
    every_row = table_of(every_row, mechanism, known, influences)
    columns = (*platform.coordinates, *_TURNS, *further, *mechanism.reading_names)
    table = every_row.where_measured(columns)
    pixels, sigma_pixels = read_corners(setup, every_row, table.lines)
    _check_columns(table, mechanism, setup, further)
    poses = _poses(table, mechanism, partial=partial)
    if level and "z" in table:
        poses = _levelled(table, setup, poses)
    freedoms = dict(zip(platform.freedoms, platform.units, strict=True))
    unknown = unknown_columns(table, known)
    extra, sigma_extra = _quantities(table, further, pixels, partial=partial or bool(named))
    if not partial and not np.isfinite(np.column_stack((poses, *(extra | pixels).values()))).any():
        raise MeasurementError(f"{table.path}: nothing of the platform is measured")
    readings = table.array(reading_units(mechanism), blank=partial)
    if readings.shape[1] and not np.isfinite(readings).any():
        empty = listed(mechanism.reading_names)
        raise MeasurementError(f"{table.path}: no row has a reading; fill in the columns {empty}")
    data = Measurements(
        poses=poses,
        sets=_sets(table, mechanism),
        readings=readings,
        sigma_poses=_sigmas(table, freedoms, partial=partial),
        sigma_readings=_sigmas(table, reading_units(mechanism)),
        extra=extra | pixels,
        sigma_extra=sigma_extra | sigma_pixels,
        contacts=_contacts(table, named),
        influences=_influences(table, mechanism) | _further_influences(table, unknown, influences),
        runs=_names(table, "run"),
        places=_names(table, "pose"),
        lines=table.file_lines,
        written=_way(table, mechanism),
    )
    return data.rows(np.arange(len(data)))  # drops relations to rows that were skipped


def _related(source: Any, setup: Setup, pairs: Any) -> tuple[TextTable, Setup, tuple[str, ...]]:
    """Return a table, its setup with distances between rows, and the columns that hold names.

    These columns name the point that a row touches, or the other row of a distance.
    """
    kinds, expected = (str, Path, TextTable), "Measurements or a CSV file"
    must_be(source, kinds, "measurements", MeasurementError, expected)
    table = read_table(source) if pairs is None else with_pairs(source, pairs)
    table, related = related_columns(renamed(table, setup.headers))
    setup = setup.of_rows({name: table.text[name] for name, unit in related.items() if not unit})
    return table, setup, (*setup.contacts, *(name for name in related if name.endswith(TO)))


def _check_columns(
    table: TextTable, mechanism: Mechanism, setup: Setup, further: Mapping[str, str]
) -> None:
    """Raise if a column is missing that terms or the setup need."""
    needed = {
        name: "on which terms of sensors depend; add it, or leave these terms out of the mechanism"
        for name in mechanism.influences
        if name not in mechanism.followed
    }
    for name, owner in setup.required.items():
        unit = f" [{further[name]}]" if name in further else ""
        needed[name] = f"{owner}; expected '{name}{unit}'"
    for name, purpose in needed.items():
        if name not in table:
            raise MeasurementError(f"{table.path}: no column {name!r}, {purpose}")


def _way(table: TextTable, mechanism: Mechanism) -> str | None:
    """Return the one of ``WAYS`` in which a table gives orientations in space, or None."""
    if mechanism.platform.turns < 3:
        return None
    ways = [way for way, (names, _) in WAYS.items() if all(name in table for name in names)]
    if len(ways) > 1:
        columns = " and ".join(", ".join(WAYS[way][0]) for way in ways)
        raise MeasurementError(
            f"{table.path}: the orientation is given in {len(ways)} ways, {columns}; keep one of "
            "them"
        )
    for names, _ in () if ways else WAYS.values():
        if has := [name for name in names if name in table]:
            lacking = next(name for name in names if name not in table)
            raise MeasurementError(
                f"{table.path}: no column {lacking!r} beside {has[0]!r}; an orientation in space "
                f"is measured in full ({', '.join(names)}) or not at all"
            )
    return ways[0] if ways else None


def _poses(table: TextTable, mechanism: Mechanism, *, partial: bool) -> Array:
    """Return poses, whose orientations are in any of ``WAYS``; NaN for missing cells if partial."""
    platform, way = mechanism.platform, _way(table, mechanism)
    units = dict(zip(platform.coordinates, platform.units, strict=True))
    if way not in (None, "tilt-torsion"):
        units = {name: units[name] for name in platform.coordinates[: platform.lengths]}
    missing = [name for name in units if name not in table]
    if not partial and missing and len(missing) < len(units):
        raise MeasurementError(
            f"{table.path}: no column {missing[0]!r}; expected '{missing[0]} "
            f"[{units[missing[0]]}]'; only 'pincal calibrate' by all legs at once takes poses "
            f"that are measured in part. The file has {', '.join(table.units)}"
        )
    poses = table.array(units, blank=partial, optional=partial)
    if way is None:
        return poses
    names, unit = WAYS[way]
    values = table.array(dict.fromkeys(names, unit), blank=partial)
    known = np.isfinite(values).all(axis=1)
    if (part := np.isfinite(values).any(axis=1) & ~known).any():
        raise MeasurementError(f"{table.where(int(np.argmax(part)))}: {in_part(names)}")
    if way == "tilt-torsion":
        return poses
    turns = np.full((len(values), 3), np.nan)
    with located(table.path, MeasurementError):
        turns[known] = columns_of("tilt-torsion", rotation_of(way, values[known]))
    return np.hstack((poses, turns))


def _levelled(table: TextTable, setup: Setup, poses: Array) -> Array:
    """Return poses of a planar machine, (N, dof), after turning their plane into x-y.

    A tracker that is not level measures a tilted plane: x and y alone are too short across the
    tilt, and no residual shows it. A shortening that is less than the noise does not matter.
    """
    points = np.column_stack((poses[:, :2], table.numbers("z", "m", blank=True)))
    known = np.isfinite(points).all(axis=1)
    if known.sum() < 4:
        return poses
    middle = points[known].mean(axis=0)
    arms = points - middle
    _, s, axes = np.linalg.svd(arms[known], full_matrices=False)
    normal = axes[2] * np.copysign(1.0, axes[2, 2])
    across, cosine = s[2] / np.sqrt(known.sum()), min(float(normal[2]), 1.0)
    shortened = float(np.ptp(arms[known] @ axes[0])) * (1.0 - cosine)
    if not shortened > across or s[1] < 10.0 * s[2]:  # a line lies in many planes
        return poses
    tilted = (
        f"{table.path}: positions lie in a plane that is tilted by "
        f"{np.degrees(np.arccos(cosine)):.2g}° to x-y (they miss it by {amount(across, 'm', 2)}): "
        f"x and y alone are too short by up to {amount(shortened, 'm', 2)}"
    )
    lacking = (~known & np.isfinite(poses[:, :2]).any(axis=1)).any()
    others = np.isfinite(poses[:, 2:]).any() or len(setup.targets) > 1 or setup.distances
    if lacking or others or not setup.unknown_frame:
        remedy = (
            "Give each its z; orientations, further targets, distances cannot be turned with them: "
            "leave them out, or turn all yourself"
            if setup.unknown_frame
            else "Turn them into x-y, or calibrate with --unknown-frame"
        )
        raise MeasurementError(f"{tilted}. {remedy}")
    _log.info("%s; they were turned into x-y", tilted)
    turned = Rotation.align_vectors((0.0, 0.0, 1.0), normal)[0].apply(arms) + middle
    return np.column_stack((turned[:, :2], poses[:, 2:]))


def _names(table: TextTable, column: str) -> tuple[str, ...] | None:
    """Return a column of names, or None if the table does not have it."""
    if column not in table:
        return None
    for row, name in enumerate(table.text[column]):
        if not name.isprintable():
            raise MeasurementError(
                f"{table.where(row)}: {column} {name!r} has characters that cannot be "
                "printed; rename it"
            )
        if column == "run" and not name:
            raise MeasurementError(f"{table.where(row)}: no run; give each row the name of its run")
    return tuple(table.text[column])


def _contacts(table: TextTable, columns: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Return the columns of names, of contacts and distances, that a table has."""
    return {name: _names(table, name) or () for name in columns if name in table}


def _sets(table: TextTable, mechanism: Mechanism) -> tuple[str, ...] | None:
    """Return the column ``set``, legs for which poses were chosen, or None if there is none."""
    known, sets = {*mechanism.leg_names, EVERY_LEG, ""}, _names(table, "set")
    for row, name in enumerate(sets or ()):
        if name not in (*known, VERIFY) and not known.issuperset(name.split("+")):
            raise MeasurementError(
                f"{table.where(row)}: set {name!r} is no leg of {mechanism.name!r}; "
                f"expected {', '.join(mechanism.leg_names)}, {EVERY_LEG} or {VERIFY}"
            )
    return sets


def _influences(table: TextTable, mechanism: Mechanism) -> dict[str, Array]:
    """Return the columns on which terms depend, numbers without units."""
    names = (*mechanism.influences, *sorted(mechanism.followed - set(mechanism.influences)))
    return {name: table.plain(name, blank=True) for name in names if name in table}


def _further_influences(
    table: TextTable, columns: Iterable[str], names: Collection[str] | None
) -> dict[str, Array]:
    """Return further columns of a table: the named ones, or for None all of varying numbers."""
    if names is not None:
        if missing := [name for name in names if name not in table]:
            raise MeasurementError(
                f"{table.path}: no column {missing[0]!r} for terms to depend on. The file "
                f"has {', '.join(table.units)}"
            )
        return {name: table.plain(name, blank=True) for name in names}
    numbers = {}
    for name in columns:
        values = np.array([plain_number(cell) for cell in table.text[name]])
        known = np.isfinite(values)
        if known.all() and np.ptp(values) > 0.0:
            numbers[name] = values
        elif known.any() and not known.all():
            cell = table.where(int(np.argmin(known)))
            _log.info("%s: not a number, so no term is tried with column %r", cell, name)
    return numbers


def _quantities(
    table: TextTable, units: Mapping[str, str], pixels: Collection[str], *, partial: bool
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return further measured quantities and their standard deviations, by column.

    Columns of pixels may be missing, as they may be in a table of corners; so may all if partial.
    """
    read = [name for name in units if name in table or not (partial or name in pixels)]
    values = {name: table.numbers(name, units[name], blank=True) for name in read}
    has_sigma = {name: unit for name, unit in units.items() if f"sigma_{name}" in table}
    sigmas = _sigmas(table, has_sigma, partial=partial)
    return values, {} if sigmas is None else dict(zip(has_sigma, sigmas.T, strict=True))


def _sigmas(table: TextTable, units: Mapping[str, str], *, partial: bool = False) -> Array | None:
    """Return the ``sigma_…`` columns, (N, n), NaN for missing ones; None if all are missing."""
    headers = {f"sigma_{name}": unit for name, unit in units.items()}
    if not any(header in table for header in headers):
        return None
    values = table.array(headers, blank=partial, optional=partial)
    for row, place in np.argwhere(values < 0.0)[:1]:
        raise MeasurementError(
            f"{table.where(row)}: {[*headers][place]!r} is negative; a standard deviation is 0 or "
            "more"
        )
    return values
