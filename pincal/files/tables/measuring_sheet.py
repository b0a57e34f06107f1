"""A measuring sheet: planned poses, empty columns to fill in, and what each column is.

Filled in, it is a table of measurements: ``pincal calibrate`` takes it as it is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MeasurementError
from pincal.files.tables.measurement_writing import columns_of
from pincal.files.tables.table import write_table
from pincal.model.measuring.measurements import Plan
from pincal.model.mechanism import Mechanism
from pincal.model.units import UNITS
from pincal.words.sheet import COUNTED, DRIVEN, FILL_IN, HEADS, MEASURED, PLANNED, READ, ROW, SET

Array = NDArray[np.float64]
_HANDY = {"m": "mm", "rad": "deg"}
_DECIMALS = 4  # of planned poses, in mm and degrees


@dataclass(frozen=True)
class SheetColumn:
    """A column of a measuring sheet."""

    head: str
    """Name and unit: ``x [mm]``."""
    what: str
    """What it is, for people."""
    values: tuple[float, ...] | tuple[str, ...]
    """One a row, in the unit of the head."""
    measured: bool = False
    """Whether it is empty, to be filled in."""


def sheet_columns(mechanism: Mechanism, plan: Plan) -> list[SheetColumn]:
    """Return the columns of a measuring sheet.

    Args:
        mechanism: The mechanism.
        plan: What to measure, with the readings there.

    Raises:
        MeasurementError: a plan without readings, or of another mechanism.
    """
    if plan.readings is None:
        raise MeasurementError(f"a sheet for {mechanism.name!r} needs the readings of its plan")
    poses = columns_of(mechanism, Plan(plan.poses), "zyx")
    both = columns_of(mechanism, Plan(plan.poses, readings=plan.readings), "zyx")
    read = {head: values for head, values in both.items() if head not in poses}
    blank = ("",) * len(plan)
    found = [SheetColumn("row", ROW, tuple(str(1 + row) for row in range(len(plan))))]
    if plan.sets is not None:
        found.append(SheetColumn("set", SET, plan.sets))
    for columns, text in ((poses, PLANNED), (read, DRIVEN)):
        for head, name, values in _handy(columns):
            found.append(SheetColumn(f"planned_{head}", text.format(name=name), values))
    for head, name, _ in _handy(poses):
        found.append(SheetColumn(head, MEASURED.format(name=name), blank, measured=True))
    sensors = [(leg, sensor) for leg in mechanism.legs for sensor in leg.sensors]
    for (head, _, _), (leg, sensor) in zip(_handy(read), sensors, strict=True):
        counted = COUNTED[sensor.homed]
        what = READ.format(joint=sensor.joint, leg=leg.name, counted=counted)
        found.append(SheetColumn(head, what, blank, measured=True))
    return found


def _handy(
    columns: dict[str, Array | tuple[str, ...]],
) -> Iterator[tuple[str, str, tuple[float, ...]]]:
    """Yield head, name and values of columns, in mm and degrees."""
    for head, values in columns.items():
        name, _, unit = head.removesuffix("]").partition(" [")
        shown = np.asarray(values, dtype=np.float64) / UNITS[_HANDY[unit]][1]
        yield f"{name} [{_HANDY[unit]}]", name, tuple((np.round(shown, _DECIMALS) + 0.0).tolist())


def write_sheet(
    sheet: str | Path, legend: str | Path, mechanism: Mechanism, plan: Plan, *, force: bool = False
) -> None:
    """Write a measuring sheet, and beside it a table of what its columns are, as CSV.

    Args:
        sheet: The sheet.
        legend: The table of columns.
        mechanism: The mechanism.
        plan: What to measure, with the readings there.
        force: Whether to replace files that exist.

    Raises:
        MeasurementError: a plan without readings, or of another mechanism.
        FileError: a file exists and ``force`` is not set, or cannot be written.
    """
    columns = sheet_columns(mechanism, plan)
    write_table(sheet, {one.head: one.values for one in columns}, force=force)
    rows = [(one.head, FILL_IN[one.measured], one.what) for one in columns]
    write_table(legend, dict(zip(HEADS, zip(*rows, strict=True), strict=True)), force=force)
