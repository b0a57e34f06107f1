"""Which columns of a table mean what to a mechanism, however their headers are spelt."""

from __future__ import annotations

import logging
import re
from collections.abc import Collection, Mapping
from dataclasses import replace
from itertools import permutations
from math import prod
from typing import Any

from pincal.errors import MeasurementError
from pincal.files.table import TextTable, read_table
from pincal.model.mechanism import Mechanism
from pincal.model.orientation import WAYS
from pincal.model.units import COUNTS, UNITS
from pincal.types import Array
from pincal.words.wording import NAMED

_SQUARE = re.compile(r"(.+?)\s*(?:\^|\*\*)?\s*[2²]$")
_log = logging.getLogger(__name__)


def table_of(
    source: Any,
    mechanism: Mechanism,
    known: Mapping[str, str],
    wanted_influences: Collection[str] | None = (),
) -> TextTable:
    """Return a table; headers such as ``x (mm)``, ``X [mm]``, ``x_mm`` are read as ``x [mm]``.

    That is logged, as are columns that are not known, but for influences that are wanted (None: any
    column is).
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
            shown = [name if name.isprintable() else ascii(name) for name in unused[:NAMED]]
            shown += [f"and {len(unused) - NAMED} more"] * (len(unused) > NAMED)
            _log.info("%s: columns not used: %s", table.path, ", ".join(shown))
    return table


def unknown_columns(table: TextTable, known: Collection[str]) -> list[str]:
    """Return the columns of a table without a meaning, but for those that sheets plan by."""
    sheet = ("cov_", "planned_")
    return [n for n in table.units if n not in known and n != "row" and not n.startswith(sheet)]


def known_columns(mechanism: Mechanism, further: Mapping[str, str]) -> dict[str, str]:
    """Return the columns that mean something, with their units; empty for names."""
    platform = mechanism.platform
    units = dict(zip(platform.freedoms, platform.units, strict=True))
    units |= dict(zip(platform.coordinates, platform.units, strict=True))
    units |= {name: unit for names, unit in WAYS.values() for name in names}
    units |= {**reading_units(mechanism), **further}
    units |= {f"sigma_{name}": unit for name, unit in units.items()}
    named = ("set", "run", "pose", *mechanism.influences, *mechanism.followed)
    return {**dict.fromkeys(named, ""), **units}


def reading_units(mechanism: Mechanism) -> dict[str, str]:
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

    It is empty where there is nothing or another unit in brackets, None if the column is another.
    """
    if not column.lower().startswith(name.lower()):
        return None
    rest = column[len(name) :]
    unit = rest.strip(" _/-(){}<>")
    if (unit == COUNTS or UNITS.get(unit, ("",))[0] == dimension) and unit != rest:
        return unit
    return "" if not rest or rest.strip().startswith("(") else None


def covariances_of(table: TextTable, units: Mapping[str, str]) -> dict[str, Array]:
    """Return the covariances that a table has of quantities, by pair such as ``"x,y"``, in SI."""
    pairs = {f"cov_{a}_{b}": (a, b) for a, b in permutations(units, 2)}
    covariances: dict[str, Array] = {}
    for header in (name for name in table.units if name.startswith("cov_")):
        if header not in pairs:
            raise MeasurementError(
                f"{table.path}: column {header!r} is no covariance of two quantities measured of "
                f"the platform ({', '.join(units)}); rename it, or leave it out"
            )
        first, second = sorted(pairs[header], key=list(units).index)
        if f"{first},{second}" in covariances:
            raise MeasurementError(
                f"{table.path}: the covariance of {first} and {second} is said twice; leave one "
                "of the columns"
            )
        unit, needed = table.units[header], (units[first], units[second])
        product = _SQUARE.sub(r"\1 \1", (unit or "").strip())
        parts = [UNITS.get(part, (part, 1.0)) for part in re.split(r"\s*[·*⋅ ]\s*", product)]
        if sorted(dimension for dimension, _ in parts) != sorted(needed):
            has = "no unit" if unit is None else f"unit [{unit}]"
            raise MeasurementError(
                f"{table.path}: column {header!r} has {has}; expected "
                f"'{header} [{product_unit(*needed)}]', the product of both, or [mm2], [mm mrad], "
                "[mrad2]"
            )
        factor = prod(factor for _, factor in parts)
        covariances[f"{first},{second}"] = table.plain(header, blank=True) * factor
    return covariances


def product_unit(first: str, second: str) -> str:
    """Return how the product of two SI units is written."""
    return f"{first}2" if first == second else f"{first} {second}"
