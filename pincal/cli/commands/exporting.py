"""``pincal export``: a mechanism for other programs, and corrections of what they cannot hold."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from shlex import quote
from typing import Annotated

import numpy as np
import typer

from pincal.calibration.result_files import read_result
from pincal.cli.app import Force, Mech, command, output_option, remark, stdout, warn, working, wrote
from pincal.cli.commands.importing import SUFFIXES, TREES
from pincal.cli.commands.kinematics import leave_if_lost, say_reference, some
from pincal.cli.commands.mechanisms import warn_of_turns
from pincal.cli.options import TableOptions
from pincal.errors import MechanismError
from pincal.files.measurements import read_poses
from pincal.files.output import writing, writing_together
from pincal.files.table import write_table
from pincal.files.text import LARGEST_FILE, read_bytes
from pincal.formats.calibrated_urdf import calibrated_urdf
from pincal.formats.correction_poses import corrected, correction_columns, corrections
from pincal.formats.corrections import LANGUAGES, code_of
from pincal.formats.delta_printer import delta_printer
from pincal.formats.klipper import write_klipper
from pincal.formats.mjcf import mjcf
from pincal.formats.reprap import write_reprap
from pincal.formats.tree_of import loops_urdf, loops_yaml, tree_of, unwritten
from pincal.kinematics.closure import nominal_legs
from pincal.kinematics.influences import own_influences
from pincal.model.measurements import Plan
from pincal.model.mechanism import Mechanism
from pincal.model.units import Units
from pincal.words.numbers import amount, counted, listed, reading_in
from pincal.words.parameters import AT_REFERENCE, NO_CORRECTION, NOT_IN_LAWS, OFFERS, WITH_COLUMNS
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


_NO_NUMBER = re.compile(r"(?<![\w.-])[-+]?(?:nan|inf)(?![\w.-])", re.IGNORECASE)


class Form(StrEnum):
    """What is written."""

    urdf = "urdf"
    mjcf = "mjcf"
    klipper = "klipper"
    reprap = "reprap"
    table = "table"
    python = "python"
    c = "c"


@dataclass(frozen=True)
class OriginalOptions:
    """The URDF into which is written."""

    original: Annotated[
        Path | None,
        typer.Option(
            metavar="URDF",
            help="Your own URDF: its joints get the calibrated origins, all else stays.",
        ),
    ] = None
    leg: Annotated[
        str | None,
        typer.Option(metavar="LEG", help="Whose URDF it is, if it is not named so."),
    ] = None


@command("export")
def export(
    mech: Mech,
    output: Annotated[
        Path,
        output_option(
            "FILE", "URDF, MJCF, printer.cfg section, M665 and M666, or corrections (CSV, code)."
        ),
    ],
    own: OriginalOptions,
    how: CorrectionOptions,
    form: Annotated[
        Form | None,
        typer.Option(
            "--format",
            help="What to write, if FILE's ending (.urdf, .xml, .cfg, .g; .csv, .py, .h) is other.",
        ),
    ] = None,
    force: Force = False,
) -> None:
    """Write URDF, MJCF, printer configurations, or corrections.

    With --original FILE is a copy of that URDF in which only the origins of calibrated joints are
    other. Without it URDF (.urdf, with a .yaml beside it that closes the loops) and MJCF (.xml)
    hold the kinematics of the whole mechanism.

    Of a delta printer FILE gets a section of Klipper's printer.cfg (.cfg), or M665 and M666 of
    RepRapFirmware (.g). What a file has no place for is said. MECH may be a result of 'pincal
    calibrate', whose legs as URDFs are in its own folder 'mechanism'.

    Terms of sensors, lengths and angles have no place in these. Corrections make up for them: over
    poses as a table (.csv: what to add to readings, or which pose to command instead), or the
    sensors' laws as code (.py, .h: readings of joint positions, and back).
    """
    whose = form or (SUFFIXES | CORRECTIONS).get(output.suffix.lower())
    if whose is None:
        raise MechanismError(
            f"{output.name!r} does not say what to write; give it the ending .urdf, .xml (MJCF), "
            ".cfg (Klipper), .g (RepRapFirmware), .csv (table of corrections), .py or .h (code), "
            "or say --format"
        )
    if whose not in TREES and (own.original is not None or own.leg is not None):
        raise MechanismError(f"--original and --leg go with URDF, not with {whose}")
    if whose != "table" and how.poses is not None:
        raise MechanismError(f"--poses goes with a table of corrections (.csv), not with {whose}")
    if whose not in CORRECTIONS.values() and (how.units or how.counts):
        raise MechanismError(f"--units and --counts go with corrections, not with {whose}")
    mechanism = how.load(mech)
    if whose == "table":
        write_corrections(mechanism, output, how, force=force)
    elif whose in CORRECTIONS.values():
        write_code(mechanism, output, whose, how.written_in(mechanism), force=force)
    elif whose in TREES:
        _export_tree(mechanism, output, whose, original=own.original, leg=own.leg, force=force)
        offer(mech, mechanism)
    else:
        _export_printer(mech, mechanism, output, whose, force=force)
        offer(mech, mechanism, firmware=True)


def _export_printer(
    mech: str, mechanism: Mechanism, output: Path, whose: str, *, force: bool
) -> None:
    """Write a delta printer's configuration.

    Raises:
        MechanismError: no linear delta, or readings that do not count down from endstops.
    """
    found = delta_printer(mechanism)
    text = _finite(write_klipper(found) if whose == "klipper" else write_reprap(found), mech)
    with writing(output, force=force) as scratch:
        scratch.write_text(text, encoding="utf-8")
    stdout.print(text.rstrip(), markup=False, soft_wrap=True)
    for one in (*found.remarks, *_weak(Path(mech))):
        warn(one)
    wrote(output)


def _weak(folder: Path) -> list[str]:
    """Return which lengths of a printer a calibration determined weakly."""
    if not (folder / "result.json").is_file():
        return []
    found = read_result(folder)
    ends = [pair[end] for pair in found.get("weakly_determined", ()) for end in ("first", "second")]
    names = sorted({end.partition(".")[2] for end in ends})
    if not names:
        return []
    return [
        f"{' and '.join(names)} are weakly determined by these measurements: what moves along with "
        "the other may be far from its true value (the calibration says by how much). If one of "
        f"them is known, say so and calibrate again: --prior {names[0]}=SIGMA"
    ]


def _export_tree(
    mechanism: Mechanism,
    output: Path,
    whose: str,
    *,
    original: Path | None,
    leg: str | None,
    force: bool,
) -> None:
    """Write a mechanism as URDF or MJCF, or into a copy of the user's URDF.

    Raises:
        FileError: a file cannot be read or written.
        MechanismError: a joint that the user's URDF has no place for.
    """
    if original is not None:
        if whose != "urdf":
            raise MechanismError("--original goes with URDF, not with MJCF")
        data = calibrated_urdf(original, mechanism, leg)
        before = read_bytes(original, LARGEST_FILE["XML"], MechanismError)
        if not _NO_NUMBER.search(before.decode(errors="replace")):
            _finite(data.decode(errors="replace"), mechanism.name)
        with writing(output, force=force) as scratch:
            scratch.write_bytes(data)
        for line in unwritten(mechanism):
            warn(line)
        remark(f"{_changed(before, data)} lines are other than in {original}")
        wrote(output)
        return
    if leg is not None:
        raise MechanismError("--leg goes with --original; the whole mechanism is written")
    tree, remarks = tree_of(mechanism)
    files = {output: mjcf(tree) if whose == "mjcf" else loops_urdf(tree)}
    if whose == "urdf" and tree.loops:
        files[output.with_suffix(".yaml")] = loops_yaml(tree)
    for text in files.values():
        _finite(text, mechanism.name)
    with writing_together([(path, ()) for path in files], force=force) as made:
        for path, text in zip(made, files.values(), strict=True):
            path.write_text(text, encoding="utf-8")
    for line in remarks:
        warn(line)
    for path in files:
        wrote(path)


def _finite(text: str, name: str) -> str:
    """Return what is to be written.

    Raises:
        MechanismError: numbers in it that no program can read.
    """
    if found := _NO_NUMBER.search(text):
        raise MechanismError(
            f"{name}: {found.group()} would be written for a number, in "
            f"line {text[: found.start()].count(chr(10)) + 1}; its parameters or frames are far "
            "too large"
        )
    return text


def _changed(before: bytes, after: bytes) -> int:
    """Return how many lines of a file are not as they were."""
    kept = set(before.splitlines())
    return sum(line not in kept for line in after.splitlines())
