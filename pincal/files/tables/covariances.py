"""Columns of covariances within a row: ``cov_x_y [mm2]``, ``cov_x_phi [mm mrad]``."""

from __future__ import annotations

import re
from collections.abc import Mapping
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MeasurementError
from pincal.files.tables.table import Table
from pincal.model.units import UNITS

Array = NDArray[np.float64]
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
