"""``pincal doctor``: what is wrong with measurements, and the command that works."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from pincal.calibration.calibration import Calibration
from pincal.calibration.doctor import Remedy, remedies
from pincal.calibration.options import Options
from pincal.cli.app import Force, Mech, answer, command, stdout, typed, working, wrote
from pincal.cli.calibration import GivenNoise
from pincal.cli.options import SetupOptions
from pincal.files.measurement_writing import write_measurements
from pincal.files.measurements import read_measurements
from pincal.files.mechanism_folders import load_mechanism
from pincal.files.output import refuse_existing
from pincal.show.remedies import advice, remedy_table, tried


@dataclass(frozen=True)
class DoctorOptions(SetupOptions, GivenNoise):
    """What is known of the measurements."""


@command(answers=True)
def doctor(
    mech: Mech,
    measurements: Annotated[
        Path, typer.Argument(metavar="MEASUREMENTS.csv", help="Measured poses and readings.")
    ],
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
    nothing contradicts it. The exit code is 1 if none does.
    """
    mechanism = load_mechanism(mech)
    if output is not None:
        refuse_existing(output, force=force)
    setup = how.read()
    data = read_measurements(measurements, mechanism, setup, partial=True)
    options = Options(noise=how.of(mechanism, data), setup=setup)
    found: list[Remedy] = []
    with working("trying what may be wrong") as progress:
        for one in remedies(Calibration(mechanism, data, options)):
            found.append(one)
            progress(tried(one))
    last = found[-1]
    stdout.print(remedy_table(found))
    for text in advice(found):
        stdout.print(text, markup=False, soft_wrap=True)
    line = ""
    if last.works:
        name = str(output or "MENDED.csv") if last.mends else str(measurements)
        line = _line(mech, name, how, last)
        if output is not None and last.mends:
            write_measurements(output, mechanism, last.calibration.measurements, force=force)
            wrote(output)
        elif last.mends:
            stdout.print("the measurements put right are written by -o MENDED.csv")
        stdout.print(f"this works:\n  {line}", markup=False, soft_wrap=True)
    else:
        stdout.print("nothing of this makes the measurements fit the mechanism")
    answer(
        {
            "works": last.works,
            "command": line or None,
            "tried": [
                {
                    "what": tried(one),
                    "codes": [f.code for f in one.findings],
                    "works": one.works,
                    "reduced_chi2": one.result.reduced_chi2 if one.result else None,
                    "trouble": one.trouble or None,
                }
                for one in found
            ],
        }
    )
    if not last.works:
        raise typer.Exit(1)


def _line(mech: str, measurements: str, how: DoctorOptions, works: Remedy) -> str:
    """Return the command by which to calibrate."""
    said = ["pincal", "calibrate", mech, measurements]
    words = shlex.split(typed())
    for name in ("--noise-position", "--noise-orientation", "--noise-reading", "--setup"):
        given = [words[i + 1] for i, word in enumerate(words[:-1]) if word == name]
        given += [word.partition("=")[2] for word in words if word.startswith(f"{name}=")]
        said += [name, given[-1]] if given else []
    options = works.calibration.options
    said += ["--unknown-frame"] if options.setup.unknown_frame and _by_option(how) else []
    said += ["--unknown-target"] if how.unknown_target else []
    said += ["--rough"] if options.rough else []
    said += ["--robust", str(options.loss)] if options.loss != "none" else []
    return shlex.join([*said, "-o", "RESULT"])


def _by_option(how: DoctorOptions) -> bool:
    """Return whether the file of the setup does not say that the frame is unknown."""
    return how.setup is None or how.unknown_frame or not how.read().unknown_frame
