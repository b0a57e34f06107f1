"""Corrections as ``pincal export`` writes them: tables over poses, code of sensors' laws."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from shlex import quote
from typing import Annotated

import numpy as np
import typer

from pincal.cli.app import remark, stdout, warn, working, wrote
from pincal.cli.commands.kinematics import leave_if_lost, say_reference, some
from pincal.cli.commands.mechanisms import warn_of_turns
from pincal.cli.options import TableOptions
from pincal.errors import MechanismError
from pincal.files.output import writing
from pincal.files.tables.measurements import read_poses
from pincal.files.tables.table import write_table
from pincal.files.tables.units import Units
from pincal.formats.corrections.code import LANGUAGES, code_of
from pincal.formats.corrections.poses import corrected, correction_columns, corrections
from pincal.kinematics.influences.columns import own_influences
from pincal.kinematics.legs.closure import nominal_legs
from pincal.model.measuring.measurements import Plan
from pincal.model.mechanism import Mechanism
from pincal.words.numbers import amount, counted, listed, reading_in
from pincal.words.terms import AT_REFERENCE, NO_CORRECTION, NOT_IN_LAWS, OFFERS, WITH_COLUMNS
from pincal.workspace.sampling import grid_poses, has_grid

#: What is written of corrections, by the file's ending.
CORRECTIONS = {".csv": "table", ".py": "python", ".h": "c"}
_ROWS = 1000  # of a grid over the workspace, about


@dataclass(frozen=True)
class CorrectionOptions(TableOptions):
    """Where corrections are wanted, and in which units."""

    poses: Annotated[
        Path | None,
        typer.Option(
            metavar="POSES.csv",
            help="Where a table corrects, with the columns that terms depend on. A grid over the "
            "workspace if not given.",
        ),
    ] = None


def offer(mech: str, mechanism: Mechanism, *, firmware: bool = False) -> None:
    """Say which commands make up for what a file has no place for; firmwares have gains."""
    units = " --units mm" * firmware
    named = _columns(mechanism)
    if mechanism.amplitudes:
        poses = " --poses POSES.csv" if named or not has_grid(mechanism) else ""
        columns = WITH_COLUMNS.format(columns=some(named, ", ")) if named else ""
        remark(OFFERS["table"].format(mech=quote(mech), more=units + poses, columns=columns))
    of_sensors = any(sensor.terms for leg in mechanism.legs for sensor in leg.sensors)
    if of_sensors or not (firmware or mechanism.reads_positions):
        remark(OFFERS["code"].format(mech=quote(mech), more=units))


def write_corrections(
    mechanism: Mechanism, output: Path, how: CorrectionOptions, *, force: bool
) -> None:
    """Write corrections over poses.

    Raises:
        FileError: the poses cannot be read.
        MeasurementError: a column or cell of the poses that is missing or wrong.
        MechanismError: nothing is to be corrected at these poses.
        WorkspaceError: poses are not given, and a grid would be too coarse.
    """
    if not mechanism.amplitudes:
        raise MechanismError(NO_CORRECTION.format(name=mechanism.name))
    units = how.written_in(mechanism)
    plan = None if how.poses is None else read_poses(how.poses, mechanism)
    given = {} if plan is None else own_influences(mechanism, plan.influences)
    if not (given or mechanism.loaded or mechanism.at_reference.amplitudes):
        said = AT_REFERENCE.format(name=mechanism.name, columns=some(_columns(mechanism), ", "))
        raise MechanismError(said)
    if plan is None:
        with working("sampling the workspace for a grid of poses"):
            plan = Plan(grid_poses(mechanism, _ROWS))
    found = corrections(mechanism, plan)
    columns = correction_columns(mechanism, found, plan.written or "tilt-torsion")
    counts = {**units.counts, **corrected(units.counts)}
    write_table(output, columns, units=replace(units, counts=counts), force=force)
    say_reference(mechanism, given)
    known = np.abs(found.readings[np.isfinite(found.readings).all(axis=1)])
    sizes: dict[str, float] = {}
    for unit, largest in zip(mechanism.reading_units, known.max(axis=0, initial=0.0), strict=True):
        sizes[unit] = max(sizes.get(unit, 0.0), float(largest))
    with reading_in(units.printed):
        most = listed(amount(size, unit) for unit, size in sizes.items())
    stdout.print(f"{counted(len(known), 'pose')}: at most {most} to add to a reading")
    wrote(output)
    places = [plan.place(row) for row in range(len(plan))]
    leave_if_lost(how.poses or output, places, list(found.reasons), "pose")


def _columns(mechanism: Mechanism) -> list[str]:
    """Return the columns that terms follow and that nothing but a row says."""
    return [name for name in mechanism.influences if name not in mechanism.loaded]


def write_code(
    mechanism: Mechanism, output: Path, whose: str, units: Units, *, force: bool
) -> None:
    """Write the laws of sensors as code.

    Raises:
        MechanismError: readings are joint positions.
    """
    text = code_of(mechanism, LANGUAGES[whose], units)
    with writing(output, force=force) as scratch:
        scratch.write_text(text, encoding="utf-8")
    for closure in nominal_legs(mechanism):
        warn_of_turns(closure)
    if deformed := [f"{leg.name}.{name}" for leg in mechanism.legs for name in leg.deformed]:
        warn(NOT_IN_LAWS.format(parameters=some(deformed, ", ")))
    wrote(output)
