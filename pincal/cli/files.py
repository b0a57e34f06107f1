"""``pincal import`` and ``export``: files of other programs, and corrections these cannot hold."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from shlex import quote
from typing import Annotated, Literal

import numpy as np
import typer

from pincal.calibration.result_files import read_result
from pincal.cli.app import command, remark, say, stdout, warn, working, wrote
from pincal.cli.kinematics import first_of, leave_if_lost, say_reference
from pincal.cli.mechanisms import warn_of_turns
from pincal.cli.options import FORCE, Mech, TableOptions, output_option
from pincal.errors import FileError, MeasurementError, MechanismError
from pincal.files.measurement_writing import write_plan
from pincal.files.measurements import read_poses
from pincal.files.mechanism_folders import (
    MECHANISM_FILES,
    load_mechanism,
    save_mechanism,
    write_mechanism,
)
from pincal.files.output import writing, writing_together
from pincal.files.table import write_table
from pincal.files.text import LARGEST_FILE, read_bytes
from pincal.formats.arm import serial_arm
from pincal.formats.calibrated_urdf import calibrated_urdf
from pincal.formats.closed import closed_mechanism, closing_in_words, slack_of
from pincal.formats.corrections import (
    LANGUAGES,
    code_of,
    corrected,
    correction_columns,
    corrections,
)
from pincal.formats.delta_printer import delta_printer
from pincal.formats.figaroh import read_figaroh
from pincal.formats.firmware import read_klipper, read_reprap, write_klipper, write_reprap
from pincal.formats.mjcf import mjcf, read_mjcf
from pincal.formats.tree import Tree
from pincal.formats.tree_of import loops_urdf, loops_yaml, tree_of, unwritten
from pincal.formats.urdf_tree import XACRO, loops_beside, read_loops, read_urdf
from pincal.kinematics.closure import largest_size, nominal_legs
from pincal.kinematics.influences import own_influences
from pincal.kinematics.inverse import inverse
from pincal.model.measurements import Measurements, Plan
from pincal.model.mechanism import Mechanism
from pincal.model.option import option
from pincal.types import Array
from pincal.words.numbers import amount, counted, listed, reading_in
from pincal.words.terms import AT_REFERENCE, NO_CORRECTION, NOT_IN_LAWS, OFFERS, WITH_COLUMNS
from pincal.workspace.sampling import grid_poses, has_grid

PROBING = "probing.csv"
_LARGE = 20.0  # [m]
_TREES = ("urdf", "mjcf")
_CODE = ("python", "c")
InputFormat = Literal["urdf", "mjcf", "klipper", "reprap", "marlin", "figaroh"]
OutputFormat = Literal["urdf", "mjcf", "klipper", "reprap", "table", "python", "c"]
#: Formats by the ending of a file.
INPUTS: dict[str, InputFormat] = {
    ".cfg": "klipper",
    ".conf": "klipper",
    ".g": "reprap",
    ".gcode": "reprap",
    ".urdf": "urdf",
    ".xml": "mjcf",
    ".mjcf": "mjcf",
}
OUTPUTS: dict[str, OutputFormat] = {
    **{suffix: form for suffix, form in INPUTS.items() if form != "figaroh"},  # type: ignore[misc]
    ".csv": "table",
    ".py": "python",
    ".h": "c",
}
#: What a file is that must become another one before it is read.
_TO_CONVERT = {
    ".sdf": "SDF, which is not read; import the URDF that it was made from, or make one (sdf2urdf "
    "of sdformat_tools)",
    ".xacro": f"a file of macros, which xacro expands to URDF: {XACRO}",
}
_ROWS = 1000  # of a grid over the workspace, about
_NO_NUMBER = re.compile(r"(?<![\w.-])[-+]?(?:nan|inf)(?![\w.-])", re.IGNORECASE)


@dataclass(frozen=True)
class ImportOptions:
    """What the file does not say itself."""

    format: InputFormat | None = option(
        None, "Whose file it is, if its ending (.urdf, .xml, .cfg, .g, .csv) is other."
    )
    loops: Path | None = option(
        None,
        "What closes the loops of a URDF (closed_loop, type, name_mot); FILE with the ending "
        ".yaml, or robot.yaml beside it, if not given.",
        metavar="YAML",
    )
    platform: str | None = option(
        None,
        "Link whose frame is the platform's; the one where the legs meet, if not given.",
        metavar="LINK",
    )
    tip: str | None = option(
        None, "Of a serial arm: the link whose frame is measured.", metavar="LINK"
    )
    base: str | None = option(
        None, "Link at the foot of an arm or of all legs, if not the root.", metavar="LINK"
    )
    probed: Path | None = option(
        None,
        "x, y, z of the nozzle, as the printer's firmware believed, where it touched the bed.",
        metavar="POINTS.csv",
    )
    mech: str | None = option(None, "Mechanism that a table belongs to.", metavar="MECH")
    force: bool = option(False, FORCE)

    def typed(self, *names: str) -> list[str]:
        """Return which of some options were typed, as they are typed."""
        return [f"--{name}" for name in names if getattr(self, name) is not None]

    def check_tree(self, form: InputFormat) -> None:
        """Raise if options do not go together for URDF or MJCF.

        Raises:
            MechanismError: options of arms with those of loops, or loops that the file holds.
        """
        if self.tip is not None and (self.platform or self.loops):
            raise MechanismError(
                "--tip is for serial arms, --platform and --loops for closed loops"
            )
        if form == "mjcf" and self.loops is not None:
            raise MechanismError("--loops goes with URDF; MJCF holds its loops in <equality>")


@command("import")
def import_(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE", help="URDF, MJCF, printer.cfg, config.g, or a table of FIGAROH's."
        ),
    ],
    output: Annotated[
        Path, output_option("OUT", "Mechanism folder; of a table: measurements, CSV.")
    ],
    options: ImportOptions,
) -> None:
    """Read URDF, MJCF, printer.cfg, config.g, FIGAROH tables.

    A URDF whose loops a YAML file closes (the convention of example-parallel-robots), or MJCF
    with connect and weld and actuators, becomes a mechanism folder: legs, platform and drives are
    found, and each joint's place on its link gets parameters. With --tip a serial arm.

    A delta's printer.cfg of Klipper, or M665 and M666 of RepRapFirmware or Marlin, become a
    mechanism folder. Heights that DELTA_CALIBRATE saved, or points given by --probed, are written
    into it as probing.csv: readings are the ways of the carriages down from their endstops.
    Calibrate with 'pincal calibrate OUT OUT/probing.csv'.
    """
    if file.is_dir():
        known = sorted(path.name for path in file.iterdir() if path.suffix.lower() in INPUTS)
        raise FileError(
            f"{file} is a folder; name the file to read"
            f"{f', such as {file / known[0]}' if known else ''}"
        )
    suffix = file.suffix.lower()
    if options.format is None and suffix in _TO_CONVERT:
        raise FileError(f"{file} is {_TO_CONVERT[suffix]}")
    form = options.format or INPUTS.get(suffix, "figaroh")
    if form in _TREES:
        if options.typed("mech", "probed"):
            raise MechanismError(f"--mech and --probed have nothing to do with {file}")
        remarks = _import_tree(file, output, form, options)
    elif of_trees := options.typed("loops", "platform", "tip", "base"):
        raise MechanismError(f"{of_trees[0]} goes with URDF or MJCF, not with {file}")
    elif form == "figaroh":
        remarks = _import_table(file, output, options)
    else:
        remarks = _import_printer(file, output, form, options)
    for text in remarks:
        warn(text)
    wrote(output)


def _import_printer(
    file: Path, output: Path, form: InputFormat, options: ImportOptions
) -> tuple[str, ...]:
    """Write the mechanism of a delta printer to a folder, with the points that it probed."""
    if options.mech is not None:
        raise MechanismError(f"{file} describes its own mechanism; leave out --mech {options.mech}")
    if form == "klipper":
        printer, heights, readings = read_klipper(file)
    else:
        firmware = (
            options.format if options.format == "reprap" or options.format == "marlin" else None
        )
        printer = read_reprap(file, firmware)
        heights, readings = np.empty(0), np.empty((0, 3))
    name = re.sub(r"\W+", "_", output.absolute().name) or "printer"
    mechanism = printer.mechanism(name, f"Linear delta of {file.name}.")
    if options.probed is not None:
        readings = _readings_at(mechanism, options.probed)
        heights = np.zeros(len(readings))
    with writing(output, force=options.force, folder=(*MECHANISM_FILES, PROBING)) as scratch:
        write_mechanism(mechanism, scratch)
        if len(heights):
            poses = np.full((len(heights), 3), np.nan)
            poses[:, 2] = heights  # z alone was measured
            write_plan(Measurements(poses=poses, readings=readings), scratch / PROBING, mechanism)
    stdout.print(printer.firmware_lines)
    if len(heights):
        remark(f"{len(heights)} probed points in {output / PROBING}")
    return printer.remarks


def _import_table(file: Path, output: Path, options: ImportOptions) -> tuple[str, ...]:
    """Write another tool's measurements as those of a mechanism."""
    if options.mech is None:
        raise MeasurementError(f"{file} is a table; say whose measurements they are: --mech MECH")
    if options.probed is not None:
        raise MeasurementError("--probed goes with a printer's configuration, not with a table")
    mechanism = load_mechanism(options.mech)
    data, remarks = read_figaroh(file, mechanism)
    write_plan(data, output, mechanism, force=options.force)
    return tuple(remarks)


def _readings_at(mechanism: Mechanism, points: Path) -> Array:
    """Return readings at points where the nozzle touched the bed, shape (N, 3)."""
    solution = inverse(mechanism, read_poses(points, mechanism).poses)
    lost = np.flatnonzero(~solution.reached.all(axis=1))
    if len(lost):
        raise MeasurementError(
            f"{points}: point {lost[0] + 1} is {solution.reason(int(lost[0]))}, so the firmware "
            "cannot have believed it to be there"
        )
    return solution.readings


def _import_tree(
    file: Path, output: Path, form: InputFormat, options: ImportOptions
) -> tuple[str, ...]:
    """Write the mechanism of a URDF or MJCF file to a folder, and say what it is."""
    options.check_tree(form)
    remarks: tuple[str, ...] = ()
    if options.tip is not None:
        tree = read_urdf(file) if form == "urdf" else read_mjcf(file)
        mechanism = serial_arm(tree, options.tip, options.base)
    else:
        tree, mechanism, remarks = _closed(file, form, options)
    drawn = {edge.joint.name for edge in tree.edges}
    unused = drawn - {joint.name for leg in mechanism.legs for joint in leg.joints}
    remarks += tuple(text for name, text in tree.remarks.items() if name not in unused)
    size = largest_size(mechanism.legs)
    if size > _LARGE:
        remarks += (f"the longest leg is {size:.4g} m: metres are expected; is this millimetres?",)
    name = re.sub(r"\W+", "_", output.absolute().name).strip("_") or mechanism.name
    save_mechanism(replace(mechanism, name=name), output, force=options.force)
    _say_what_it_is(mechanism)
    return remarks


def _closed(
    file: Path, form: InputFormat, options: ImportOptions
) -> tuple[Tree, Mechanism, tuple[str, ...]]:
    """Return tree and mechanism of a file with loops, and remarks; say how loops are closed."""
    yaml = None if form == "mjcf" else options.loops or loops_beside(file)
    tree = read_mjcf(file) if yaml is None else read_loops(file, yaml)
    tree = replace(tree, slack=slack_of(file.read_text("utf-8")))
    mechanism, remarks = closed_mechanism(tree, options.platform, options.base)
    if yaml is not None:
        say(f"loops closed by {yaml}")
    closing, moved = closing_in_words(tree, mechanism)
    if moved:
        return tree, mechanism, (closing, *remarks)
    say(closing)
    return tree, mechanism, tuple(remarks)


def _say_what_it_is(mechanism: Mechanism) -> None:
    """Print what was understood: platform, legs, drives, parameters."""
    platform = mechanism.platform
    coordinates = zip(platform.coordinates, platform.home, platform.units, strict=True)
    home = ", ".join(
        f"{name} {round(value, 9) + 0.0:.6g} {unit}" for name, value, unit in coordinates
    )
    say(f"{platform.kind} platform, at home {home}")
    for leg in mechanism.legs:
        driven = {sensor.joint for sensor in leg.sensors}
        joints = ", ".join(f"{joint.name}{'*' * (joint.name in driven)}" for joint in leg.moving)
        say(f"{leg.name}: {joints}; closes a {leg.closes}; {len(leg.parameters)} parameters")
    stdout.print("* driven: its position is read")


@dataclass(frozen=True)
class ExportOptions(TableOptions):
    """What is written, and where corrections are wanted."""

    format: OutputFormat | None = option(
        None, "What to write, if FILE's ending (.urdf, .xml, .cfg, .g; .csv, .py, .h) is other."
    )
    original: Path | None = option(
        None,
        "Your own URDF: its joints get the calibrated origins, all else stays.",
        metavar="URDF",
    )
    leg: str | None = option(None, "Whose URDF it is, if it is not named so.", metavar="LEG")
    poses: Path | None = option(
        None,
        "Where a table corrects, with the columns that terms depend on. A grid over the workspace "
        "if not given.",
        metavar="POSES.csv",
    )
    force: bool = option(False, FORCE)

    def check(self, form: OutputFormat) -> None:
        """Raise if options do not go with a format.

        Raises:
            MechanismError: saying which.
        """
        if form not in _TREES and (self.original is not None or self.leg is not None):
            raise MechanismError(f"--original and --leg go with URDF, not with {form}")
        if form != "table" and self.poses is not None:
            raise MechanismError(
                f"--poses goes with a table of corrections (.csv), not with {form}"
            )
        if form != "table" and form not in _CODE and (self.units or self.counts):
            raise MechanismError(f"--units and --counts go with corrections, not with {form}")


@command("export")
def export(
    mech: Mech,
    output: Annotated[
        Path,
        output_option(
            "FILE", "URDF, MJCF, printer.cfg section, M665 and M666, or corrections (CSV, code)."
        ),
    ],
    options: ExportOptions,
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
    form = options.format or OUTPUTS.get(output.suffix.lower())
    if form is None:
        raise MechanismError(
            f"{output.name!r} does not say what to write; give it the ending .urdf, .xml (MJCF), "
            ".cfg (Klipper), .g (RepRapFirmware), .csv (table of corrections), .py or .h (code), "
            "or say --format"
        )
    options.check(form)
    mechanism = options.load(mech)
    if form == "table":
        _export_corrections(mechanism, output, options)
    elif form == "python" or form == "c":
        _export_code(mechanism, output, form, options)
    elif form in _TREES:
        _export_tree(mechanism, output, form, options)
        _offer_corrections(mech, mechanism)
    else:
        _export_printer(mech, mechanism, output, form, force=options.force)
        _offer_corrections(mech, mechanism, firmware=True)


def _offer_corrections(mech: str, mechanism: Mechanism, *, firmware: bool = False) -> None:
    """Say which commands make up for what a file has no place for; firmwares have gains."""
    units = " --units mm" * firmware
    named = _columns(mechanism)
    if mechanism.amplitudes:
        poses = " --poses POSES.csv" if named or not has_grid(mechanism) else ""
        columns = WITH_COLUMNS.format(columns=first_of(named, ", ")) if named else ""
        remark(OFFERS["table"].format(mech=quote(mech), more=units + poses, columns=columns))
    of_sensors = any(sensor.terms for leg in mechanism.legs for sensor in leg.sensors)
    if of_sensors or not (firmware or mechanism.reads_positions):
        remark(OFFERS["code"].format(mech=quote(mech), more=units))


def _columns(mechanism: Mechanism) -> list[str]:
    """Return the columns that terms follow and that nothing but a row says."""
    return [name for name in mechanism.influences if name not in mechanism.loaded]


def _export_corrections(mechanism: Mechanism, output: Path, options: ExportOptions) -> None:
    """Write corrections over poses."""
    if not mechanism.amplitudes:
        raise MechanismError(NO_CORRECTION.format(name=mechanism.name))
    units = options.written_in(mechanism)
    plan = None if options.poses is None else read_poses(options.poses, mechanism)
    influences = {} if plan is None else own_influences(mechanism, plan.influences)
    if not (influences or mechanism.loaded or mechanism.at_reference.amplitudes):
        columns = first_of(_columns(mechanism), ", ")
        raise MechanismError(AT_REFERENCE.format(name=mechanism.name, columns=columns))
    if plan is None:
        with working("sampling the workspace for a grid of poses"):
            plan = Plan(grid_poses(mechanism, _ROWS))
    table = corrections(mechanism, plan)
    written = correction_columns(mechanism, table, plan.written or "tilt-torsion")
    counts = {**units.counts, **corrected(units.counts)}
    write_table(output, written, units=replace(units, counts=counts), force=options.force)
    say_reference(mechanism, influences)
    reached = np.abs(table.readings[np.isfinite(table.readings).all(axis=1)])
    largest: dict[str, float] = {}
    for unit, size in zip(mechanism.reading_units, reached.max(axis=0, initial=0.0), strict=True):
        largest[unit] = max(largest.get(unit, 0.0), float(size))
    with reading_in(units.printed):
        limits = listed(amount(size, unit) for unit, size in largest.items())
    stdout.print(f"{counted(len(reached), 'pose')}: at most {limits} to add to a reading")
    wrote(output)
    places = [plan.place(row) for row in range(len(plan))]
    leave_if_lost(options.poses or output, places, list(table.reasons), "pose")


def _export_code(
    mechanism: Mechanism, output: Path, form: Literal["python", "c"], options: ExportOptions
) -> None:
    """Write the laws of sensors as code."""
    text = code_of(mechanism, LANGUAGES[form], options.written_in(mechanism))
    with writing(output, force=options.force) as scratch:
        scratch.write_text(text, encoding="utf-8")
    for closure in nominal_legs(mechanism):
        warn_of_turns(closure)
    if deformed := [f"{leg.name}.{name}" for leg in mechanism.legs for name in leg.deformed]:
        warn(NOT_IN_LAWS.format(parameters=first_of(deformed, ", ")))
    wrote(output)


def _export_printer(
    mech: str, mechanism: Mechanism, output: Path, form: str, *, force: bool
) -> None:
    """Write a delta printer's configuration."""
    printer = delta_printer(mechanism)
    text = _finite(write_klipper(printer) if form == "klipper" else write_reprap(printer), mech)
    with writing(output, force=force) as scratch:
        scratch.write_text(text, encoding="utf-8")
    say(text.rstrip())
    for warning in (*printer.remarks, *_weak(Path(mech))):
        warn(warning)
    wrote(output)


def _weak(folder: Path) -> list[str]:
    """Return which lengths of a printer a calibration determined weakly."""
    if not (folder / "result.json").is_file():
        return []
    pairs = read_result(folder).get("weakly_determined", ())
    ends = [pair[end] for pair in pairs for end in ("first", "second")]
    names = sorted({end.partition(".")[2] for end in ends})
    if not names:
        return []
    return [
        f"{' and '.join(names)} are weakly determined by these measurements: what moves along with "
        "the other may be far from its true value (the calibration says by how much). If one of "
        f"them is known, say so and calibrate again: --priors {names[0]}=SIGMA"
    ]


def _export_tree(mechanism: Mechanism, output: Path, form: str, options: ExportOptions) -> None:
    """Write a mechanism as URDF or MJCF, or into a copy of the user's URDF."""
    if options.original is not None:
        if form != "urdf":
            raise MechanismError("--original goes with URDF, not with MJCF")
        _export_into(options.original, mechanism, output, options)
        return
    if options.leg is not None:
        raise MechanismError("--leg goes with --original; the whole mechanism is written")
    tree, remarks = tree_of(mechanism)
    files = {output: mjcf(tree) if form == "mjcf" else loops_urdf(tree)}
    if form == "urdf" and tree.loops:
        files[output.with_suffix(".yaml")] = loops_yaml(tree)
    for text in files.values():
        _finite(text, mechanism.name)
    with writing_together([(path, ()) for path in files], force=options.force) as scratch:
        for path, text in zip(scratch, files.values(), strict=True):
            path.write_text(text, encoding="utf-8")
    for line in remarks:
        warn(line)
    for path in files:
        wrote(path)


def _export_into(
    original: Path, mechanism: Mechanism, output: Path, options: ExportOptions
) -> None:
    """Write a copy of the user's URDF with the origins of calibrated joints."""
    data = calibrated_urdf(original, mechanism, options.leg)
    before = read_bytes(original, LARGEST_FILE["XML"], MechanismError)
    if not _NO_NUMBER.search(before.decode(errors="replace")):
        _finite(data.decode(errors="replace"), mechanism.name)
    with writing(output, force=options.force) as scratch:
        scratch.write_bytes(data)
    for line in unwritten(mechanism):
        warn(line)
    lines = set(before.splitlines())
    changed = sum(line not in lines for line in data.splitlines())
    remark(f"{changed} lines are other than in {original}")
    wrote(output)


def _finite(text: str, name: str) -> str:
    """Return what is to be written."""
    if match := _NO_NUMBER.search(text):
        raise MechanismError(
            f"{name}: {match.group()} would be written for a number, in "
            f"line {text[: match.start()].count(chr(10)) + 1}; its parameters or frames are far "
            "too large"
        )
    return text
