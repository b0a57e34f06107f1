"""``pincal import``: files of other tools, printers' firmwares and simulators."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import typer

from pincal.cli.app import Force, command, output_option, remark, stdout, warn, wrote
from pincal.errors import FileError, MeasurementError, MechanismError
from pincal.files.measurement_writing import write_plan
from pincal.files.measurements import read_poses
from pincal.files.mechanism_folders import (
    MECHANISM_FILES,
    load_mechanism,
    save_mechanism,
    write_mechanism,
)
from pincal.files.output import writing
from pincal.formats.arm import serial_arm
from pincal.formats.closed import closed_mechanism, closing_in_words, slack_of
from pincal.formats.figaroh import read_figaroh
from pincal.formats.klipper import read_klipper
from pincal.formats.mjcf import read_mjcf
from pincal.formats.reprap import read_reprap
from pincal.formats.urdf_tree import XACRO, loops_beside, read_loops, read_urdf
from pincal.kinematics.closure import largest_size
from pincal.kinematics.inverse import inverse
from pincal.model.measurements import Measurements
from pincal.model.mechanism import Mechanism

PROBING = "probing.csv"
TREES = ("urdf", "mjcf")
_LARGE = 20.0  # [m]
#: Whose file it is.
Neighbour = Literal["urdf", "mjcf", "klipper", "reprap", "marlin", "figaroh"]
SUFFIXES: dict[str, Neighbour] = {
    ".cfg": "klipper",
    ".conf": "klipper",
    ".g": "reprap",
    ".gcode": "reprap",
    ".urdf": "urdf",
    ".xml": "mjcf",
    ".mjcf": "mjcf",
}
#: What a file is that must become another one before it is read.
_OTHER = {
    ".sdf": "SDF, which is not read; import the URDF that it was made from, or make one (sdf2urdf "
    "of sdformat_tools)",
    ".xacro": f"a file of macros, which xacro expands to URDF: {XACRO}",
}


@dataclass(frozen=True)
class ImportOptions:
    """What the file does not say itself."""

    form: Annotated[
        Neighbour | None,
        typer.Option(
            "--format",
            help="Whose file it is, if its ending (.urdf, .xml, .cfg, .g, .csv) is other.",
        ),
    ] = None
    loops: Annotated[
        Path | None,
        typer.Option(
            metavar="YAML",
            help="What closes the loops of a URDF (closed_loop, type, name_mot); FILE with the "
            "ending .yaml, or robot.yaml beside it, if not given.",
        ),
    ] = None
    platform: Annotated[
        str | None,
        typer.Option(
            metavar="LINK",
            help="Link whose frame is the platform's; the one where the legs meet, if not given.",
        ),
    ] = None
    tip: Annotated[
        str | None,
        typer.Option(metavar="LINK", help="Of a serial arm: the link whose frame is measured."),
    ] = None
    base: Annotated[
        str | None,
        typer.Option(
            metavar="LINK", help="Of a serial arm: the link at its foot, if not the root."
        ),
    ] = None
    probed: Annotated[
        Path | None,
        typer.Option(
            metavar="POINTS.csv",
            help="x, y, z of the nozzle, as the printer's firmware believed, where it touched "
            "the bed.",
        ),
    ] = None
    mech: Annotated[
        str | None, typer.Option(metavar="MECH", help="Mechanism that a table belongs to.")
    ] = None


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
    how: ImportOptions,
    force: Force = False,
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
        known = sorted(one.name for one in file.iterdir() if one.suffix.lower() in SUFFIXES)
        raise FileError(
            f"{file} is a folder; name the file to read"
            f"{f', such as {file / known[0]}' if known else ''}"
        )
    whose = how.form or _whose(file)
    for_trees = {"--loops": how.loops, "--platform": how.platform, "--tip": how.tip}
    for_trees["--base"] = how.base
    if whose in TREES:
        if how.mech is not None or how.probed is not None:
            raise MechanismError(f"--mech and --probed have nothing to do with {file}")
        _import_tree(file, output, whose, how, force=force)
        return
    if said := [name for name, value in for_trees.items() if value is not None]:
        raise MechanismError(f"{said[0]} goes with URDF or MJCF, not with {file}")
    if whose == "figaroh":
        _import_table(file, output, how, force=force)
        return
    if how.mech is not None:
        raise MechanismError(f"{file} describes its own mechanism; leave out --mech {how.mech}")
    _import_printer(file, output, whose, how, force=force)


def _whose(file: Path) -> Neighbour:
    """Return whose file it is by its ending, a table of FIGAROH's if that says nothing.

    Raises:
        FileError: an ending of files that must become others first.
    """
    suffix = file.suffix.lower()
    if suffix in _OTHER:
        raise FileError(f"{file} is {_OTHER[suffix]}")
    return SUFFIXES.get(suffix, "figaroh")


def _import_printer(
    file: Path, output: Path, whose: Neighbour, how: ImportOptions, *, force: bool
) -> None:
    """Write the mechanism of a delta printer to a folder, with the points that it probed."""
    probed = how.probed
    if whose == "klipper":
        config = read_klipper(file)
        printer, remarks = config.printer, config.remarks
        heights, readings = config.heights, config.readings
    else:
        firmware = how.form if how.form == "reprap" or how.form == "marlin" else None
        printer, remarks = read_reprap(file, firmware), ()
        heights, readings = np.empty(0), np.empty((0, 3))
    name = re.sub(r"\W+", "_", output.absolute().name) or "printer"
    mechanism = printer.mechanism(name, f"Linear delta of {file.name}.")
    if probed is not None:
        heights, readings = _as_probed(mechanism, probed)
    with writing(output, force=force, folder=(*MECHANISM_FILES, PROBING)) as scratch:
        write_mechanism(mechanism, scratch)
        if len(heights):
            write_plan(_on_bed(heights, readings), scratch / PROBING, mechanism)
    stdout.print(printer.firmware_lines, markup=False)
    for text in remarks:
        warn(text)
    wrote(output)
    if len(heights):
        remark(f"{len(heights)} probed points in {output / PROBING}")


def _import_table(file: Path, output: Path, how: ImportOptions, *, force: bool) -> None:
    """Write another tool's measurements as those of a mechanism.

    Raises:
        MeasurementError: no mechanism, or points that belong to no table.
    """
    if how.mech is None:
        raise MeasurementError(f"{file} is a table; say whose measurements they are: --mech MECH")
    if how.probed is not None:
        raise MeasurementError("--probed goes with a printer's configuration, not with a table")
    mechanism = load_mechanism(how.mech)
    data, remarks = read_figaroh(file, mechanism)
    write_plan(data, output, mechanism, force=force)
    for text in remarks:
        warn(text)
    wrote(output)


def _as_probed(mechanism: Mechanism, points: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return heights, zero, and readings at points where the nozzle touched the bed.

    Raises:
        MeasurementError: points that the printer cannot reach.
    """
    solution = inverse(mechanism, read_poses(points, mechanism).poses)
    lost = np.flatnonzero(~solution.reached.all(axis=1))
    if len(lost):
        raise MeasurementError(
            f"{points}: point {lost[0] + 1} is {solution.reason(int(lost[0]))}, so the firmware "
            "cannot have believed it to be there"
        )
    return np.zeros(len(solution.readings)), solution.readings


def _on_bed(heights: np.ndarray, readings: np.ndarray) -> Measurements:
    """Return measurements of z alone."""
    poses = np.full((len(heights), 3), np.nan)
    poses[:, 2] = heights
    return Measurements(poses=poses, readings=readings)


def _import_tree(file: Path, output: Path, whose: str, how: ImportOptions, *, force: bool) -> None:
    """Write the mechanism of a URDF or MJCF file to a folder, and say what it is.

    Raises:
        FileError: a file cannot be read or written.
        MechanismError: the file does not say what it should.
    """
    loops, platform, tip, base = how.loops, how.platform, how.tip, how.base
    if tip is None and base is not None:
        raise MechanismError("--base goes with --tip; loops are closed from the root link on")
    if tip is not None and (platform or loops):
        raise MechanismError("--tip is for serial arms, --platform and --loops for closed loops")
    if whose == "mjcf" and loops is not None:
        raise MechanismError("--loops goes with URDF; MJCF holds its loops in <equality>")
    remarks: tuple[str, ...] = ()
    if tip is not None:
        tree = read_urdf(file) if whose == "urdf" else read_mjcf(file)
        found = serial_arm(tree, tip, base)
    else:
        yaml = None if whose == "mjcf" else loops or loops_beside(file)
        tree = read_mjcf(file) if yaml is None else read_loops(file, yaml)
        tree = replace(tree, slack=slack_of(file.read_text("utf-8")))
        found, more = closed_mechanism(tree, platform)
        if yaml is not None:
            stdout.print(f"loops closed by {yaml}", markup=False, soft_wrap=True)
        words, moved = closing_in_words(tree, found)
        if moved:
            remarks += (words,)
        else:
            stdout.print(words, markup=False, soft_wrap=True)
        remarks += more
    absent = {edge.joint.name for edge in tree.edges}
    absent -= {joint.name for leg in found.legs for joint in leg.joints}
    remarks += tuple(said for name, said in tree.remarks.items() if name not in absent)
    remarks += _huge(found)
    name = re.sub(r"\W+", "_", output.absolute().name).strip("_") or found.name
    save_mechanism(replace(found, name=name), output, force=force)
    _say(found)
    for text in remarks:
        warn(text)
    wrote(output)


def _huge(mechanism: Mechanism) -> tuple[str, ...]:
    """Return what to say of a mechanism larger than machines are."""
    size = largest_size(mechanism.legs)
    if size <= _LARGE:
        return ()
    return (f"the longest leg is {size:.4g} m: metres are expected; is this millimetres?",)


def _say(mechanism: Mechanism) -> None:
    """Print what was understood: platform, legs, drives, parameters."""
    platform = mechanism.platform
    home = ", ".join(
        f"{name} {round(value, 9) + 0.0:.6g} {unit}"
        for name, value, unit in zip(
            platform.coordinates, platform.home, platform.units, strict=True
        )
    )
    stdout.print(f"{platform.kind} platform, at home {home}", markup=False, soft_wrap=True)
    for leg in mechanism.legs:
        driven = {sensor.joint for sensor in leg.sensors}
        joints = ", ".join(f"{j.name}{'*' * (j.name in driven)}" for j in leg.moving)
        stdout.print(
            f"{leg.name}: {joints}; closes a {leg.closes}; {len(leg.parameters)} parameters",
            markup=False,
            soft_wrap=True,
        )
    stdout.print("* driven: its position is read")
