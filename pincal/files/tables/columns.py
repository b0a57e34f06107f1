"""Which columns of a table mean something for a mechanism, and which are nearly such ones."""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

from pincal.errors import MeasurementError, MechanismError
from pincal.files.tables.covariances import covariance_headers
from pincal.files.tables.table import Table
from pincal.files.tables.table_reading import read_table
from pincal.files.tables.units import COUNTS
from pincal.model.checks import must_be
from pincal.model.mechanism import Mechanism
from pincal.model.orientation import WAYS
from pincal.model.units import UNITS
from pincal.words.wording import NAMED

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
