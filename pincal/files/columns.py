"""Columns of a mechanism's tables: their meaning, spellings that are read, and writing them."""

import logging
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np

from pincal.errors import MeasurementError
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.files.table import TextTable, read_table, write_table
from pincal.model import WAYS, Measurements, Mechanism, Plan, Setup
from pincal.model.checks import array_of, must_be
from pincal.model.platform import columns_of as angles_of
from pincal.types import Array
from pincal.words.numbers import COUNTS, SI, UNITS, Units
from pincal.words.wording import NAMED

Columns = dict[str, Array | tuple[str, ...]]
_NEAR = 0.66  # least likeness of an unknown column to a known one that is suggested, as tx to x
_log = logging.getLogger(__name__)


def table_of(
    source: Any,
    mechanism: Mechanism,
    known: Mapping[str, str],
    wanted_influences: Collection[str] | None = (),
) -> TextTable:
    """Read a table; headers such as ``x (mm)``, ``X [mm]``, ``x_mm`` are read as ``x [mm]``.

    Log columns read under other names, and unknown ones but for wanted influences (None: all).
    """
    counts = {name: mechanism.counts.get(name) for name in mechanism.reading_names}
    counts |= {f"sigma_{name}": per_unit for name, per_unit in counts.items()}
    table = replace(read_table(source), counts=counts)
    if meant := _headers_meant(table, known):
        read_as = [f"{column!r} as '{name} [{unit}]'" for column, (name, unit) in meant.items()]
        _log.info("%s: columns read: %s", table.path, ", ".join(read_as))
        names = {column: meant.get(column, (column, unit)) for column, unit in table.units.items()}
        text = {names[column][0]: cells for column, cells in table.text.items()}
        table = replace(table, units=dict(names.values()), text=text)
    if wanted_influences is not None:
        unused = [name for name in unknown_columns(table, known) if name not in wanted_influences]
        if unused:
            missing = [name for name in known if name not in table.units and "sigma" not in name]
            shown = ", ".join(_meant_perhaps(name, missing) for name in unused[:NAMED])
            count = f" and {len(unused) - NAMED} more" * (len(unused) > NAMED)
            _log.info("%s: columns not used: %s", table.path, shown + count)
    return table


def _meant_perhaps(name: str, missing: Sequence[str]) -> str:
    """Return a column's name, with a question whether it means a missing column of like name."""
    near = get_close_matches(name, missing, 1, _NEAR)
    return (name if name.isprintable() else ascii(name)) + "".join(f" (is it {n}?)" for n in near)


def unknown_columns(table: TextTable, known: Collection[str]) -> list[str]:
    """Return the columns of a table without a meaning, except planned values of a sheet."""
    return [
        name
        for name in table.units
        if name not in known and name != "row" and not name.startswith("planned_")
    ]


def known_columns(mechanism: Mechanism, further: Mapping[str, str]) -> dict[str, str]:
    """Return the columns that have a meaning, with their units; columns of names have none."""
    platform = mechanism.platform
    units = dict(zip(platform.freedoms, platform.units, strict=True))
    units |= dict(zip(platform.coordinates, platform.units, strict=True))
    units |= {name: unit for names, unit in WAYS.values() for name in names}
    units |= {**reading_units(mechanism), **further}
    units |= {f"sigma_{name}": unit for name, unit in units.items()}
    named = ("set", "run", "pose", "image", *mechanism.influences, *mechanism.followed)
    return {**dict.fromkeys(named, ""), **units}


def reading_units(mechanism: Mechanism) -> dict[str, str]:
    """Return the unit of each reading, by its column."""
    return dict(zip(mechanism.reading_names, mechanism.reading_units, strict=True))


def _headers_meant(table: TextTable, units: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """Return name and unit of columns whose headers differ in case or form from ``name [unit]``."""
    meant: dict[str, tuple[str, str]] = {}
    for column, bracketed in table.units.items():
        behind = {
            name: unit
            for name, dimension in units.items()
            if name not in table and (unit := _unit_behind(column, name, dimension)) is not None
        }
        if column in units or not behind:
            continue
        names = list(behind)
        unit = bracketed or behind[names[0]]
        if not unit or len(names) > 1 or names[0] in dict(meant.values()):
            header = f"{column} [{bracketed}]" if bracketed else column
            unit = unit or units[names[0]]
            raise MeasurementError(
                f"{table.path}: column {header!r} is not understood; write "
                f"{f'{names[0]} [{unit}]' if unit else names[0]!r}"
            )
        meant[column] = names[0], unit
    return meant


def _unit_behind(column: str, name: str, dimension: str) -> str | None:
    """Return the unit behind a name as in ``x (mm)``, ``x_mm``, ``x/mm``.

    It is empty if nothing or an unknown unit in brackets follows, None if the name is another.
    """
    if not column.lower().startswith(name.lower()):
        return None
    ending = column[len(name) :]
    unit = ending.strip(" _/-(){}<>")
    if (unit == COUNTS or UNITS.get(unit, ("",))[0] == dimension) and unit != ending:
        return unit
    return "" if not ending or ending.strip().startswith("(") else None


def write_plan(
    plan: Plan, path: str | Path, mechanism: GivenMechanism, *, force: bool = False, **ways: Any
) -> None:
    """Write a plan, or measurements, to a CSV file: see ``Plan.to_csv``."""
    write_table(path, columns_of(mechanism, plan, **ways), force=force)


def reason_column(reasons: Sequence[str]) -> Columns:
    """Return a column with the reasons of empty rows; no column if no row is empty."""
    return {"reason": tuple(reasons)} if any(reasons) else {}


def columns_of(
    mechanism: GivenMechanism,
    plan: Plan,
    orientation: str = "tilt-torsion",
    setup: Setup | None = None,
) -> Columns:
    """Return the columns of a plan or of measurements: header with SI unit to values.

    Orientations in space are written in one of ``WAYS``; the setup has units of further columns.
    """
    mechanism = as_mechanism(mechanism)
    must_be(plan, Plan, "poses or measurements to write", MeasurementError)
    measured = isinstance(plan, Measurements)
    columns: Columns = {} if plan.sets is None else {"set": plan.sets}
    for header, values in _pose_columns(mechanism, plan, orientation).items():
        if not measured or np.isfinite(values).any():  # quantities never measured have no column
            columns[header] = values
    if plan.readings is not None:
        columns |= reading_columns(mechanism, plan.readings)
    columns |= _measured_columns(mechanism, plan, setup) if isinstance(plan, Measurements) else {}
    columns |= {**plan.influences, **plan.contacts}
    return columns if plan.places is None else columns | {"pose": plan.places}


def _headed(units: Iterable[tuple[str, str]], values: Array, prefix: str = "") -> dict[str, Array]:
    """Return the columns of an array, shape (N, n), under the names and units of n quantities."""
    return dict(zip([f"{prefix}{name} [{unit}]" for name, unit in units], values.T, strict=True))


def _pose_columns(mechanism: Mechanism, plan: Plan, orientation: str) -> dict[str, Array]:
    platform = mechanism.platform
    if orientation not in WAYS:
        raise MeasurementError(f"orientation {orientation!r}; expected one of {', '.join(WAYS)}")
    array_of(plan.poses, ("N", platform.dof), f"poses of {mechanism.name!r}", MeasurementError)
    units = list(zip(platform.coordinates, platform.units, strict=True))
    if platform.turns < 3 or orientation == "tilt-torsion":
        return _headed(units, plan.poses)
    lengths, (angles, unit) = platform.lengths, WAYS[orientation]
    turns = angles_of(orientation, platform.transforms(plan.poses).rotation)
    columns = _headed(units[:lengths], plan.poses[:, :lengths])
    return columns | _headed([(name, unit) for name in angles], turns)


def reading_columns(mechanism: GivenMechanism, readings: Array, prefix: str = "") -> Columns:
    """Return the columns of readings, shape (N, n_readings): header with SI unit to values."""
    mechanism = as_mechanism(mechanism)
    names, units = mechanism.reading_names, mechanism.reading_units
    values = array_of(readings, ("N", len(names)), "readings", MeasurementError)
    return {**_headed(zip(names, units, strict=True), values, prefix)}


def _measured_columns(mechanism: Mechanism, data: Measurements, setup: Setup | None) -> Columns:
    """Return the columns of standard deviations, further quantities and runs."""
    freedoms = dict(zip(mechanism.platform.freedoms, mechanism.platform.units, strict=True))
    units = setup.columns(mechanism) if setup else {}
    columns: Columns = {}
    if data.sigma_poses is not None:
        columns |= _headed(freedoms.items(), data.sigma_poses, "sigma_")
    if data.sigma_readings is not None:
        columns |= reading_columns(mechanism, data.sigma_readings, "sigma_")
    for prefix, quantities in (("", data.extra), ("sigma_", data.sigma_extra)):
        for name, values in quantities.items():
            columns[f"{prefix}{name} [{units.get(name, 'm')}]"] = values
    return columns if data.runs is None else columns | {"run": data.runs}


def sheet_columns(
    mechanism: Mechanism,
    plan: Plan,
    measured: Collection[str] | None = None,
    setup: Setup | None = None,
    units: Units = SI,
) -> Columns:
    """Return the columns of a measuring sheet: planned values, and empty cells to fill in.

    ``measured`` names freedoms of the platform and columns of the setup, by default the pose. All
    columns are in ``units``, by default mm and degrees.

    Raises:
        MeasurementError: the plan has no readings.
    """
    if plan.readings is None:
        raise MeasurementError(f"a sheet for {mechanism.name!r} needs the readings of its plan")
    planned: dict[str, Any] = {**_pose_columns(mechanism, plan, "zyx")}
    read = reading_columns(mechanism, plan.readings)
    setup = (setup or Setup()).of_rows(plan.contacts)
    names = mechanism.platform.freedoms if measured is None else (*measured, *setup.between_rows)
    heads = [*_measured_heads(mechanism, tuple(planned), names, setup), *read]
    written = replace(units, names={"m": "mm", "rad": "deg", **units.names}, last=1e-7).written
    columns: dict[str, Any] = {"row": tuple(str(1 + row) for row in range(len(plan)))}
    columns |= {} if plan.sets is None else {"set": plan.sets}
    columns |= {f"planned_{head}": values for head, values in written(planned | read).items()}
    columns |= plan.contacts
    columns |= {} if plan.places is None else {"pose": plan.places}
    blank = written(dict.fromkeys(heads, np.zeros(len(plan))))
    return columns | dict.fromkeys(blank, ("",) * len(plan))


def _measured_heads(
    mechanism: Mechanism, poses: Sequence[str], names: Collection[str], setup: Setup
) -> list[str]:
    """Return the headers of measured quantities, without contacts; ``poses`` are pose headers."""
    platform = mechanism.platform
    lengths = poses[: platform.lengths]
    heads = [head for head in lengths if head.partition(" ")[0] in names]
    if not set(names).isdisjoint(platform.freedoms[platform.lengths :]):
        heads += poses[platform.lengths :]
    axes = {axis for axes in setup.contact_axes(platform).values() for axis in axes}
    touched, further = axes - {*setup.read_lengths}, setup.columns(mechanism).items()
    return heads + [f"{n} [{unit}]" for n, unit in further if n in names and n not in touched]
