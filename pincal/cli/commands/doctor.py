"""``pincal doctor``: what is wrong with measurements, and the command that works."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated

import typer

from pincal.calibration.calibrate import prepared
from pincal.calibration.doctor import Remedy, remedies
from pincal.calibration.options import Options
from pincal.cli.app import (
    Force,
    Measured,
    Mech,
    answer,
    command,
    remark,
    stdout,
    typed,
    working,
    wrote,
)
from pincal.cli.commands.calibration import GivenNoise
from pincal.cli.options import CountOptions, SetupOptions
from pincal.files.level import tilt_column
from pincal.files.measurement_writing import Columns, columns_of
from pincal.files.measurements import (
    measured_columns,
    read_measurements,
    table_for,
    unknown_columns,
)
from pincal.files.output import refuse_existing
from pincal.files.table import TextTable, write_table
from pincal.model.mechanism import Mechanism
from pincal.model.setup import ORIGIN, Setup
from pincal.model.units import COUNTS, scale_of
from pincal.show.explanation import advice, remedy_table, tried


@dataclass(frozen=True)
class DoctorOptions(CountOptions, SetupOptions, GivenNoise):
    """What is known of the measurements."""


@command(answers=True)
def doctor(
    mech: Mech,
    measurements: Measured,
    how: DoctorOptions,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="MENDED.csv", help="File for the measurements put right."
        ),
    ] = None,
    force: Force = False,
) -> None:
    """Say why measurements do not fit, and what works.

    Units, signs, orders, zeros, frames, shifted logs and bad rows are put right one by one, in the
    order of how likely they are, and each is tried by a whole calibration, until one converges and
    nothing contradicts it, rows held out included. Columns without a meaning are copied to
    MENDED.csv. The exit code is 1 if none does, or several alike.
    """
    mechanism = how.load(mech)
    setup = how.read()
    more = setup.columns(mechanism)
    table = table_for(measurements, mechanism, more, None)
    table = table.where_measured(measured_columns(mechanism, more))
    if output is not None:
        refuse_existing(output, force=force)
    data = read_measurements(table, mechanism, setup, partial=True)
    options = Options(noise=how.of(mechanism, data, setup), setup=setup)
    found: list[Remedy] = []
    with working("trying what may be wrong") as progress:
        for one in remedies(prepared(mechanism, data, options)):
            found.append(one)
            progress(tried(one))
    works = [one for one in found if one.works]
    stdout.print(remedy_table(found))
    for text in advice(found):
        stdout.print(text, markup=False, soft_wrap=True)
    lines: list[str] = []
    if len(works) == 1:
        (one,) = works
        counts = _counts(mechanism, table, one)
        mends = one.mends and not counts
        if mends and output is None:
            lines.append(f"{typed()} -o MENDED.csv")
        elif output is not None and mends:
            mended = one.calibration.measurements
            columns = columns_of(mechanism, mended, mended.written or "tilt-torsion", setup)
            write_table(output, columns | _others(table, mechanism, setup), force=force)
            wrote(output)
        elif output is not None:
            remark(f"options are enough: {output} is not written, take {measurements}")
        name = str(output or "MENDED.csv") if mends else str(measurements)
        lines.append(_line(mech, name, how, one, counts))
        stdout.print("this works:")
        for line in lines:
            stdout.print(f"  {line}", markup=False, soft_wrap=True)
    elif works:
        stdout.print(
            f"{len(works)} of these work alike, and the measurements do not say which is true: "
            "look at the machine, and mend the source"
        )
    else:
        stdout.print("nothing of this makes the measurements fit the mechanism")
        if any(one.result and one.result.converged for one in found):
            line = f"pincal explain {mech} {measurements}"
            stdout.print(f"the mechanism may lack a term: {line} looks for it", markup=False)
        near = [one for one in found if one.result and one.result.converged and not one.mends]
        if near and near[0].result and near[0].result.excess == 1.0:
            line = _line(mech, str(measurements), how, near[0])
            stdout.print("this converges, and promises nothing:")
            stdout.print(f"  {line}", markup=False, soft_wrap=True)
    tries = [
        {
            "what": tried(one),
            "codes": [f.code for f in one.findings],
            "works": one.works,
            "reduced_chi2": one.result.reduced_chi2 if one.result else None,
            "trouble": one.trouble or None,
        }
        for one in found
    ]
    answer({"commands": lines, "tried": tries})
    if len(works) != 1:
        raise typer.Exit(1)


def _others(table: TextTable, mechanism: Mechanism, setup: Setup) -> Columns:
    """Return the columns that mean nothing to pincal, header to cells."""
    more = setup.columns(mechanism)
    others = unknown_columns(table, mechanism, more | tilt_column(mechanism, more))
    units = {name: f" [{unit}]" if (unit := table.units[name]) else "" for name in others}
    return {f"{name}{units[name]}": cells for name, cells in others.items()}


def _counts(mechanism: Mechanism, table: TextTable, works: Remedy) -> list[str]:
    """Return ``--counts`` that put readings in counts right; empty if other readings are wrong."""
    wrong = [one for one in works.findings if one.code == "scale-of-readings"]
    factors = {name: by for one in wrong for name, by, _ in one.values["factors"]}
    if any(table.units.get(name) != COUNTS for name in factors):
        return []
    units = dict(zip(mechanism.reading_names, mechanism.reading_units, strict=True))
    scales = {name: by * factors.get(name, 1.0) for name, by in mechanism.counts.items()}
    found = {name: scale_of(by, units[name]) for name, by in scales.items() if factors}
    alike = set(found) == set(units) and len(set(found.values())) == 1
    return list(set(found.values())) if alike else [f"{name}={by}" for name, by in found.items()]


def _line(
    mech: str, measurements: str, how: DoctorOptions, works: Remedy, counts: Sequence[str] = ()
) -> str:
    """Return the command by which to calibrate."""
    said = ["pincal", "calibrate", mech, measurements]
    for field in ("setup", *(one.name for one in fields(GivenNoise))):
        value = getattr(how, field)
        said += [] if value is None else [f"--{field.replace('_', '-')}", str(value)]
    for one in counts or how.counts or ():
        said += ["--counts", one]
    options = works.calibration.options
    said += ["--unknown-frame"] if options.setup.unknown_frame else []
    target_freed = options.setup.targets[ORIGIN].unknown and not how.read().targets[ORIGIN].unknown
    said += ["--unknown-target"] if how.unknown_target or target_freed else []
    said += ["--rough"] if options.rough else []
    said += ["--robust", str(options.loss)] if options.loss != "none" else []
    return shlex.join([*said, "-o", "RESULT"])
