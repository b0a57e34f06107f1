"""``pincal import`` and ``export``: files of other programs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from shlex import quote
from typing import Annotated, Literal

import numpy as np
import typer

import pincal
from pincal import Measurements, Mechanism
from pincal.cli.app import command, remark, say, stdout, warn, wrote
from pincal.cli.options import FORCE, Force, Mech, named_after, output_option, refuse_options
from pincal.errors import FileError, MeasurementError, MechanismError
from pincal.files.columns import write_plan
from pincal.files.measurements import read_poses
from pincal.files.mechanism_folders import MECHANISM_FILES, save_mechanism, write_mechanism
from pincal.files.output import writing
from pincal.files.text import LARGEST_FILE, check_name, read_bytes
from pincal.files.urdf import XACRO, leg_urdf
from pincal.formats import arm, closed, firmware, mjcf, users_mjcf, users_urdf
from pincal.formats.delta_printer import delta_printer
from pincal.option import option
from pincal.show.report import mechanism_lines

PROBING = "probing.csv"
_LARGE = 20.0  # size of a leg that is doubted, [m]
InputFormat = Literal["urdf", "sdf", "mjcf", "klipper", "reprap", "marlin"]
#: Formats by the ending of a file.
INPUTS: dict[str, InputFormat] = {
    ".cfg": "klipper",
    ".conf": "klipper",
    ".g": "reprap",
    ".gcode": "reprap",
    ".urdf": "urdf",
    ".sdf": "sdf",
    ".xml": "mjcf",
    ".mjcf": "mjcf",
}
_TREES = ("urdf", "sdf", "mjcf")  # formats of any mechanism; the others are printers'


@dataclass(frozen=True)
class ImportOptions:
    """Options on facts that the file does not contain."""

    format: InputFormat | None = option(
        None, "Format of FILE, if its ending (.urdf, .sdf, .xml, .cfg, .g) does not tell."
    )
    loops: Path | None = option(
        None,
        "File that closes or drives the loops of a URDF or SDF (closed_loop, type, name_mot) "
        "[default: beside a URDF, FILE with the ending .yaml or robot.yaml; else FILE itself].",
        metavar="YAML",
    )
    platform: str | None = option(
        None,
        "Link whose frame is the platform's [default: the link where the legs meet].",
        metavar="LINK",
    )
    tip: str | None = option(None, "Link of a serial arm whose frame is measured.", metavar="LINK")
    base: str | None = option(
        None, "Base link of the arm or of all legs, if not the root.", metavar="LINK"
    )
    probed: Path | None = option(
        None,
        "Positions x, y, z of the nozzle, by the printer's firmware, where it touched the bed.",
        metavar="POINTS.csv",
    )
    force: bool = option(False, FORCE)


@command
def import_(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="URDF, SDF, MJCF, printer.cfg or config.g.")
    ],
    output: Annotated[Path, output_option("OUT", "Mechanism folder.")],
    options: ImportOptions,
) -> None:
    """Read URDF, SDF, MJCF, printer.cfg, config.g.

    Converts a URDF whose loops a YAML file closes (as in example-parallel-robots), SDF with loops,
    or MJCF with connect, weld and actuators, into a mechanism folder: finds legs, platform and
    drives, and makes each joint's place on its link a set of parameters. With --tip: a serial arm.

    Converts a delta's printer.cfg of Klipper, or M665 and M666 of RepRapFirmware or Marlin, too.
    Heights saved by DELTA_CALIBRATE, or points given by --probed, are written to probing.csv;
    readings are the travels of the carriages down from their endstops. Calibrate with 'pincal
    calibrate OUT OUT/probing.csv'.
    """
    if file.is_dir():
        known = sorted(path for path in file.iterdir() if path.suffix.lower() in INPUTS)
        such_as = f", such as {known[0]}" if known else ""
        raise FileError(f"{file} is a folder; name the file to read{such_as}")
    check_name(str(file))
    suffix = file.suffix.lower()
    if options.format is None and suffix == ".xacro":
        raise FileError(f"{file} is a file of macros, which xacro expands to URDF: {XACRO}")
    form = options.format or INPUTS.get(suffix)
    if form is None:
        raise FileError(
            f"the format of {file} is not known; expected the ending {', '.join(INPUTS)}, or "
            "--format (a table of measurements needs no import: see 'pincal calibrate')"
        )
    foreign = ("probed",) if form in _TREES else ("loops", "platform", "tip", "base")
    refuse_options(options, (*foreign, *["loops"] * (form == "mjcf")), str(file))
    if options.tip is not None:
        refuse_options(options, ("platform", "loops"), "a serial arm (--tip)")
    read = _import_tree if form in _TREES else _import_printer
    warn(*read(file, output, form, options))
    wrote(output)


def _import_printer(
    file: Path, output: Path, form: InputFormat, options: ImportOptions
) -> Sequence[str]:
    """Write the mechanism of a delta printer to a folder, with its probed points."""
    if form == "klipper":
        printer, probing = firmware.read_klipper(file)
    else:
        named = form if options.format and (form == "reprap" or form == "marlin") else None
        printer = firmware.read_reprap(file, named)
        probing = Measurements(poses=np.empty((0, 3)), readings=np.empty((0, 3)))
    mechanism = printer.mechanism(named_after(output), f"Linear delta of {file.name}.")
    if options.probed is not None:
        solution = pincal.inverse(mechanism, read_poses(options.probed, mechanism).poses)
        poses = np.full((len(solution.readings), 3), (np.nan, np.nan, 0.0))  # z alone is known
        probing = Measurements(poses=poses, readings=solution.readings)
        if lost := np.flatnonzero(~solution.reached.all(axis=1)).tolist():
            raise MeasurementError(
                f"{options.probed}: point {lost[0] + 1} is {solution.reason(lost[0])} by the "
                "firmware's parameters; give points as the firmware computed them"
            )
    with writing(output, force=options.force, folder=(*MECHANISM_FILES, PROBING)) as scratch:
        write_mechanism(mechanism, scratch)
        if len(probing):
            write_plan(probing, scratch / PROBING, mechanism)
    stdout.print(printer.firmware_lines)
    if heights := int(np.isfinite(probing.poses[:, 2]).sum()):
        remark(f"{heights} probed points in {output / PROBING}")
    if distances := (len(probing) - heights) // 2:
        remark(f"{distances} distances of DELTA_ANALYZE, two rows each, in {output / PROBING}")
    return printer.remarks


def _import_tree(
    file: Path, output: Path, form: InputFormat, options: ImportOptions
) -> Sequence[str]:
    """Write the mechanism of a URDF, SDF or MJCF file to a folder, print it, and return remarks."""
    alone = form != "urdf" or options.tip is not None
    yaml = options.loops or (None if alone else users_urdf.loops_beside(file))
    tree = mjcf.read_mjcf(file) if form == "mjcf" else users_urdf.read_loops(file, yaml, form)
    if options.tip is not None:
        mechanism = arm.serial_arm(tree, options.tip, options.base)
        remarks = arm.left_open(tree, mechanism)
    else:
        data = read_bytes(file, LARGEST_FILE["XML"], MechanismError)
        tree = replace(tree, slack=closed.slack_of(data))
        mechanism, remarks = closed.closed_mechanism(tree, options.platform, options.base)
        if yaml is not None:
            say(f"loops closed by {yaml}")
    drawn = {edge.joint.name for edge in tree.edges}
    unused = drawn - {joint.name for leg in mechanism.legs for joint in leg.joints}
    remarks += tuple(text for name, text in tree.remarks.items() if name not in unused)
    if (size := mechanism.size) > _LARGE:
        remarks += (f"the longest leg is {size:.4g} m: metres are expected; is this millimetres?",)
    save_mechanism(replace(mechanism, name=named_after(output)), output, force=options.force)
    say(*mechanism_lines(mechanism))
    return remarks


@command
def export(
    mech: Mech,
    output: Annotated[
        Path,
        output_option(
            "FILE", "Format by ending: .urdf, .xml (MJCF), .cfg (Klipper), .g (M665 and M666)."
        ),
    ],
    original: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Your URDF or MJCF: only numbers of joints change."),
    ] = None,
    form: Annotated[
        InputFormat | None,
        typer.Option("--format", help="Format of FILE, if its ending does not tell (marlin)."),
    ] = None,
    force: Force = False,
) -> None:
    """Write URDF, MJCF or printer configurations.

    With --original, FILE is a copy of your URDF or MJCF in which only the numbers of calibrated
    joints, sites and equalities differ. Without it, MJCF (.xml) holds the kinematics of any
    mechanism, URDF (.urdf) only of arms.

    For a delta printer, FILE gets a section of Klipper's printer.cfg (.cfg), or M665 and M666 of
    RepRapFirmware (.g) or Marlin (.g, --format marlin). What the format cannot hold is reported.
    MECH may be a result of 'pincal calibrate'; URDFs of its legs are in its folder 'mechanism'.

    These formats cannot hold terms of sensors, lengths and angles. 'pincal inverse' applies them to
    the readings of your poses, and so do the kinematics that 'pincal deploy' writes.
    """
    form = form or INPUTS.get(output.suffix.lower())
    if form is None or form == "sdf":
        fault = "read, but not written" if form else "not known"
        raise MechanismError(
            f"the format of {output.name!r} is {fault}; give it the ending .urdf, .xml (MJCF), "
            ".cfg (Klipper) or .g (RepRapFirmware; Marlin: --format marlin)"
        )
    formats = {form, INPUTS.get(original.suffix.lower(), form)} if original else set[str]()
    if unsuitable := formats - {"urdf", "mjcf"}:
        raise MechanismError(f"leave out --original: not for the format {min(unsuitable)}")
    mechanism = pincal.load_mechanism(mech)
    data, remarks = _exported(mechanism, form, original)
    with writing(output, force=force) as scratch:
        scratch.write_bytes(data)
    warn(*remarks)
    wrote(output)
    if mechanism.amplitudes:
        remark(f"readings with terms: pincal inverse {quote(mech)} POSES.csv -o READINGS.csv")


def _exported(
    mechanism: Mechanism, form: InputFormat, original: Path | None
) -> tuple[bytes, Sequence[str]]:
    """Return the contents of a mechanism's file in a format, and remarks on what it lacks."""
    if original is not None:
        calibrated = {"urdf": users_urdf.calibrated_urdf, "mjcf": users_mjcf.calibrated_mjcf}
        data = calibrated[form](original, mechanism)
        lines = set(read_bytes(original, LARGEST_FILE["XML"], MechanismError).splitlines())
        changed = sum(line not in lines for line in data.splitlines())
        remark(f"{changed} lines differ from {original}")
        return data, mjcf.unwritten(mechanism)
    if form == "urdf" and not (len(mechanism.legs) == 1 and mechanism.legs[0].is_arm):
        raise MechanismError(
            f"{mechanism.name!r} has loops, which URDF cannot hold: write MJCF (.xml), or give "
            "your own URDF (--original); each leg's URDF is in its folder"
        )
    if form in _TREES:
        text = mjcf.mjcf(mechanism) if form == "mjcf" else leg_urdf(mechanism.legs[0])
        return text.encode(), mjcf.unwritten(mechanism)
    printer = delta_printer(mechanism)
    if form == "reprap" or form == "marlin":
        text = firmware.write_reprap(printer, form)
    else:
        text = firmware.write_klipper(printer)
    say(text.rstrip())
    return text.encode(), printer.remarks
