"""``pincal import`` and ``export``: files of other tools, printers' firmwares and simulators."""

from __future__ import annotations

import re
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from pincal.calibration.result_files import read_result
from pincal.cli.app import Force, Mech, command, output_option, remark, stdout, warn, wrote
from pincal.cli.trees import TREES, export_tree, import_tree
from pincal.errors import MeasurementError, MechanismError
from pincal.files.measurement_writing import write_measurements
from pincal.files.measurements import read_poses
from pincal.files.mechanism_folders import load_mechanism, write_mechanism
from pincal.files.output import refuse_existing, writing
from pincal.formats.figaroh import read_figaroh
from pincal.formats.printers.delta import DeltaPrinter, delta_printer
from pincal.formats.printers.klipper import read_klipper, write_klipper
from pincal.formats.printers.reprap import read_reprap, write_reprap
from pincal.kinematics.inverse import inverse
from pincal.model.measurements import Measurements
from pincal.model.mechanism import Mechanism

PROBING = "probing.csv"
_SUFFIXES = {
    ".cfg": "klipper",
    ".conf": "klipper",
    ".g": "reprap",
    ".gcode": "reprap",
    ".urdf": "urdf",
    ".xml": "mjcf",
    ".mjcf": "mjcf",
}


class Form(StrEnum):
    """What is written."""

    urdf = "urdf"
    mjcf = "mjcf"
    klipper = "klipper"
    reprap = "reprap"


class Neighbour(StrEnum):
    """Whose file it is."""

    urdf = "urdf"
    mjcf = "mjcf"
    klipper = "klipper"
    reprap = "reprap"
    figaroh = "figaroh"


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
    form: Annotated[
        Neighbour | None,
        typer.Option(
            "--format",
            help="Whose file it is, if its ending (.urdf, .xml, .cfg, .g, .csv) is other.",
        ),
    ] = None,
    loops: Annotated[
        Path | None,
        typer.Option(
            metavar="YAML",
            help="What closes the loops of a URDF (closed_loop, type, name_mot); FILE with the "
            "ending .yaml, or robot.yaml beside it, if not given.",
        ),
    ] = None,
    platform: Annotated[
        str | None,
        typer.Option(
            metavar="LINK",
            help="Link whose frame is the platform's; the one where the legs meet, if not given.",
        ),
    ] = None,
    tip: Annotated[
        str | None,
        typer.Option(metavar="LINK", help="Of a serial arm: the link whose frame is measured."),
    ] = None,
    base: Annotated[
        str | None,
        typer.Option(
            metavar="LINK", help="Of a serial arm: the link it stands on, if not the root."
        ),
    ] = None,
    probed: Annotated[
        Path | None,
        typer.Option(
            metavar="POINTS.csv",
            help="x, y, z of the nozzle, as the printer's firmware believed, where it touched "
            "the bed.",
        ),
    ] = None,
    mech: Annotated[
        str | None, typer.Option(metavar="MECH", help="Mechanism that a table belongs to.")
    ] = None,
    force: Force = False,
) -> None:
    """Read URDF, MJCF, printer.cfg, config.g, FIGAROH tables.

    A URDF whose loops a YAML file closes (the convention of example-parallel-robots), or MJCF
    with connect and weld and actuators, becomes a mechanism folder: legs, platform and drives are
    told apart, and each joint's place on its link gets parameters. With --tip a serial arm.

    A delta's printer.cfg of Klipper, or M665 and M666 of RepRapFirmware, become a mechanism
    folder. Heights that DELTA_CALIBRATE saved, or points given by --probed, are written into it
    as probing.csv: readings are the ways of the carriages down from their endstops. Calibrate with
    'pincal calibrate OUT OUT/probing.csv --method latent'.
    """
    whose = form or Neighbour(_SUFFIXES.get(file.suffix.lower(), "figaroh"))
    of_trees = {"--loops": loops, "--platform": platform, "--tip": tip, "--base": base}
    if whose in TREES:
        if mech is not None or probed is not None:
            raise MechanismError(f"--mech and --probed have nothing to do with {file}")
        import_tree(
            file, output, whose, loops=loops, platform=platform, tip=tip, base=base, force=force
        )
        return
    if said := [name for name, value in of_trees.items() if value is not None]:
        raise MechanismError(f"{said[0]} goes with URDF or MJCF, not with {file}")
    if whose is Neighbour.figaroh:
        _import_table(file, mech, output, probed=probed, force=force)
        return
    if mech is not None:
        raise MechanismError(f"{file} describes its own mechanism; leave out --mech {mech}")
    refuse_existing(output, force=force, folder=True)
    if whose is Neighbour.klipper:
        config = read_klipper(file)
        printer, remarks = config.printer, config.remarks
        heights, readings = config.heights, config.readings
    else:
        printer, remarks = read_reprap(file), ()
        heights, readings = np.empty(0), np.empty((0, 3))
    name = re.sub(r"\W+", "_", output.absolute().name) or "printer"
    mechanism = printer.mechanism(name, f"Linear delta of {file.name}.")
    if probed is not None:
        heights, readings = _as_probed(mechanism, probed)
    with writing(output, force=force, folder=True) as scratch:
        write_mechanism(mechanism, scratch)
        if len(heights):
            write_measurements(scratch / PROBING, mechanism, _on_bed(heights, readings))
    stdout.print(_in_words(printer), markup=False)
    for text in remarks:
        warn(text)
    wrote(output)
    if len(heights):
        remark(f"{len(heights)} probed points in {output / PROBING}")


def _import_table(
    file: Path, mech: str | None, output: Path, *, probed: Path | None, force: bool
) -> None:
    """Write another tool's measurements as those of a mechanism.

    Raises:
        MeasurementError: no mechanism, or points that belong to no table.
    """
    if mech is None:
        raise MeasurementError(f"{file} is a table; say whose measurements they are: --mech MECH")
    if probed is not None:
        raise MeasurementError("--probed goes with a printer's configuration, not with a table")
    refuse_existing(output, force=force)
    mechanism = load_mechanism(mech)
    data, remarks = read_figaroh(file, mechanism)
    write_measurements(output, mechanism, data, force=force)
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


def _in_words(printer: DeltaPrinter) -> str:
    """Return a printer's parameters in the units of its firmware."""
    rows = zip(
        np.degrees(printer.angles) % 360.0,
        1e3 * np.array(printer.arms),
        1e3 * np.array(printer.endstops),
        strict=True,
    )
    lines = [f"delta radius {1e3 * printer.radius:.4f} mm"]
    lines += [
        f"tower {name}: angle {angle:.4f}°, arm {arm:.4f} mm, endstop {endstop:.4f} mm"
        for name, (angle, arm, endstop) in zip("abc", rows, strict=True)
    ]
    return "\n".join(lines)


@command("export")
def export(
    mech: Mech,
    output: Annotated[
        Path, output_option("FILE", "URDF, MJCF, printer.cfg section, or M665 and M666.")
    ],
    form: Annotated[
        Form | None,
        typer.Option(
            "--format", help="What to write, if FILE's ending (.urdf, .xml, .cfg, .g) is other."
        ),
    ] = None,
    original: Annotated[
        Path | None,
        typer.Option(
            metavar="URDF",
            help="Your own URDF: its joints get the calibrated origins, all else stays.",
        ),
    ] = None,
    leg: Annotated[
        str | None,
        typer.Option(metavar="LEG", help="Whose URDF it is, if it is not named so."),
    ] = None,
    force: Force = False,
) -> None:
    """Write URDF, MJCF, or a delta printer's configuration.

    With --original FILE is a copy of that URDF in which only the origins of calibrated joints are
    other. Without it URDF (.urdf, with a .yaml beside it that closes the loops) and MJCF (.xml)
    hold the kinematics of the whole mechanism.

    Of a delta printer FILE gets a section of Klipper's printer.cfg (.cfg), or M665 and M666 of
    RepRapFirmware (.g). What a file has no place for is said. MECH may be a result of 'pincal
    calibrate', whose legs as URDFs are in its own folder 'mechanism'.
    """
    whose = form or _SUFFIXES.get(output.suffix.lower())
    if whose is None:
        raise MechanismError(
            f"{output.name!r} does not say what to write; give it the ending .urdf, .xml (MJCF), "
            ".cfg (Klipper) or .g (RepRapFirmware), or say --format"
        )
    if whose in TREES:
        export_tree(load_mechanism(mech), output, whose, original=original, leg=leg, force=force)
        return
    if original is not None or leg is not None:
        raise MechanismError(f"--original and --leg go with URDF, not with {whose}")
    refuse_existing(output, force=force)
    found = delta_printer(load_mechanism(mech))
    text = write_klipper(found) if whose == "klipper" else write_reprap(found)
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
    pairs = found.get("weakly_determined", found.get("weakly_told_apart", []))  # until 0.1
    ends = [one[end] for one in pairs for end in ("first", "second")]  # [leg, name] until 0.1
    names = sorted({one.partition(".")[2] if isinstance(one, str) else one[1] for one in ends})
    if not names:
        return []
    return [
        f"{' and '.join(names)} are weakly determined by these measurements: what moves along with "
        "the other may be far from its true value (the calibration says by how much). If one of "
        f"them is known, say so and calibrate again: --prior {names[0]}=SIGMA"
    ]
