"""``pincal calibrate``: the main job."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import typer

from pincal.calibration.calibrate import prepared, run
from pincal.calibration.calibration import Calibration
from pincal.calibration.options import AUTO, FOLDS, By, Intervals, Options, Poses
from pincal.calibration.result import CalibrationResult
from pincal.calibration.result_files import REPORT, RESULT_FILES, as_json
from pincal.calibration.terms.kinds import columns_said
from pincal.cli.app import (
    Force,
    Measured,
    Mech,
    answer,
    command,
    output_option,
    remark,
    stdout,
    typed,
    warn,
    working,
    wrote,
)
from pincal.cli.options import SetupOptions, TableOptions, in_si, with_unit
from pincal.errors import MeasurementError, MisfitError
from pincal.estimation.blocks.legs import Residual
from pincal.estimation.residuals.losses import LossName
from pincal.files.measurements import read_measurements
from pincal.files.mechanism_folders import mechanism_files
from pincal.files.output import refuse_existing
from pincal.files.text import plain_number
from pincal.model.measurements import Measurements, Noise
from pincal.model.mechanism import Mechanism
from pincal.model.orientation import SINGLE_ANGLES
from pincal.model.setup import Setup
from pincal.model.units import UNITS
from pincal.show.report import report
from pincal.show.result_tables import calibration_tables, warnings
from pincal.show.summary import calibration_summary, verdict_lines, weak_lines
from pincal.show.workspace_answers import WorkspaceErrors
from pincal.words.numbers import counted, reading_in
from pincal.words.table import Table


@dataclass(frozen=True)
class MethodOptions:
    """What is identified at once, and what is minimised."""

    per_leg: Annotated[
        bool,
        typer.Option("--per-leg", help="Each leg alone, poses as measured: the papers' way."),
    ] = False
    residual: Annotated[
        Residual, typer.Option(help="Whitened loop closure, or readings as in the papers.")
    ] = "closure"
    poses: Annotated[
        Poses | None,
        typer.Option(help="With --per-leg: for each leg the poses of its set (own), or all."),
    ] = None


@dataclass(frozen=True)
class GivenNoise:
    """How well was measured, where that is known."""

    noise_position: Annotated[
        float | None, with_unit("m", "Standard deviation of measured positions [m], or as 20um.")
    ] = None
    noise_orientation: Annotated[
        float | None, with_unit("rad", "Standard deviation of measured angles [rad], or as 5mrad.")
    ] = None
    noise_reading: Annotated[
        float | None, with_unit("m rad", "Standard deviation of readings [rad or m].")
    ] = None

    def of(self, mechanism: Mechanism, data: Measurements, setup: Setup) -> Noise | None:
        """Return the noise given, or None if none was.

        Raises:
            MeasurementError: given in part.
        """
        position, orientation = self.noise_position, self.noise_orientation
        if position is None and orientation is None and self.noise_reading is None:
            return None
        angles = np.array([unit == "rad" for unit in mechanism.platform.units])
        single, measured = set(data.extra) & set(SINGLE_ANGLES), np.isfinite(data.poses)
        turned = bool(measured[:, angles].any() or single)
        further = set(data.extra) - single
        placed = bool(measured[:, ~angles].any() or further)
        if setup.tracker is not None:  # says how well positions were measured
            placed = bool(further - set(setup.points(mechanism.platform)))
        needed = {"--noise-position": position} if placed else {}
        needed |= {"--noise-orientation": orientation} if turned else {}
        if None in needed.values():
            raise MeasurementError(
                f"give {' and '.join(needed)} with the other noise options, or none of them (the "
                "scale is then estimated)"
            )
        return Noise(position or 0.0, orientation or 0.0, self.noise_reading or 0.0)


@dataclass(frozen=True)
class CalibrateOptions(TableOptions, SetupOptions, GivenNoise, MethodOptions):
    """How to calibrate."""

    robust: Annotated[
        LossName, typer.Option(help="Rows that do not fit count less, or are rejected.")
    ] = "none"
    fix: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Hold a parameter: l of every leg, leg_1.l of one."),
    ] = None
    tie: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="One value for all legs; tested whether it holds."),
    ] = None
    prior: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=SIGMA", help="A nominal value known to SIGMA [m, rad or 1]."),
    ] = None
    terms: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[LEG=]KIND",
            help="What sensors lack: harmonics:1,2, polynomial, backlash, gravity, a column such "
            "as temperature; leg_1.l=temperature, growth=temperature: lengths that grow; auto: "
            "those that pay (see pincal explain).",
        ),
    ] = None
    tolerance: Annotated[
        str | None,
        typer.Option(
            metavar="0.5mm,5mrad",
            help="How far machines differ from the drawing: a prior for all parameters, by unit "
            "(a third number: gains); auto: as far as the measurements say.",
        ),
    ] = None
    rough: Annotated[
        bool,
        typer.Option("--rough", help="The nominal mechanism is known roughly: fewer checks."),
    ] = False
    hold_undetermined: Annotated[
        bool,
        typer.Option(
            "--hold-undetermined",
            help="Hold what the measurements do not determine as near to nominal as can be.",
        ),
    ] = False
    intervals: Annotated[
        Intervals,
        typer.Option(help="By standard errors, or by the profile of the cost: where curved."),
    ] = "wald"
    verbose: Annotated[
        bool, typer.Option("--verbose", help="Print all tables, and all that was found.")
    ] = False
    accept: Annotated[
        bool,
        typer.Option(
            "--accept", help="Exit code 0 even if residuals are larger than the noise given."
        ),
    ] = False
    no_report: Annotated[bool, typer.Option("--no-report", help="Draw no report.html.")] = False
    folds: Annotated[
        int,
        typer.Option(
            min=0, help="Held-out validation, and choice of terms; 0 leaves the validation out."
        ),
    ] = FOLDS
    by: Annotated[
        By, typer.Option(help="What is held out together: regions, rows in turn, or runs.")
    ] = "region"

    def calibration(self, mechanism: Mechanism, path: Path) -> Calibration:
        """Return the calibration to be done, by measurements in a file.

        Raises:
            PincalError: a file that cannot be read, or options that do not fit it.
        """
        setup = self.read()
        if self.poses is not None and not self.per_leg:
            remark("--poses is for --per-leg; all legs at once use every pose")
        terms = tuple(self.terms or ())
        data = read_measurements(
            path, mechanism, setup, partial=not self.per_leg, influences=columns_said(terms)
        )
        options = Options(
            method="per-leg" if self.per_leg else "all-legs",
            residual=self.residual,
            poses=self.poses or "own",
            noise=self.of(mechanism, data, setup),
            setup=setup,
            loss=self.robust,
            fixed=tuple(self.fix or ()),
            tied=tuple(self.tie or ()),
            priors=_priors(self.prior or (), mechanism),
            tolerance=_tolerance(self.tolerance or ""),
            terms=terms,
            rough=self.rough,
            hold_undetermined=self.hold_undetermined,
            folds=self.folds or FOLDS,
            intervals=self.intervals,
        )
        return prepared(mechanism, data, options)


@command(answers=True)
def calibrate(
    mech: Mech,
    measurements: Measured,
    output: Annotated[Path, output_option("RESULT", "Folder for result and calibrated mechanism.")],
    how: CalibrateOptions,
    force: Force = False,
) -> None:
    """Identify the parameters from measurements.

    All legs are identified at once, each pose an unknown of which any part, or none, was measured
    (empty cells or no columns). Without noise options, repeated rows give the noise; else it is
    estimated by group from the residuals. RESULT holds report.html to read,
    result.json, residuals.csv and the calibrated mechanism; every command takes it as MECH. The
    exit code is 1, and no mechanism is written, if the fit does not converge; 1 with all files
    written, if χ² contradicts the noise given, unless --accept; 3 if the result is written and its
    report cannot be drawn.
    """
    if how.folds == 1:
        raise MeasurementError("--folds 1: expected 2 or more, or 0 for no held-out validation")
    mechanism = how.load(mech)
    units = how.written_in(mechanism)
    calibration = how.calibration(mechanism, measurements)
    refuse_existing(output, force=force, folder=RESULT_FILES)
    with working("identifying parameters") as progress:
        options = replace(calibration.options, progress=progress)
        try:
            result, notes = run(replace(calibration, options=options), how.folds, how.by)
        except MisfitError:
            remark(
                f"pincal doctor {mech} {measurements} tries what may be wrong, and says what works"
            )
            raise
        result.save(output, force=force)
        files = [*mechanism_files(mech), measurements, *([how.setup] if how.setup else [])]
        errors, undrawn = None, ""
        try:
            progress("sampling the workspace for the platform's errors")
            page = report(result, command=typed(), files=files, notes=notes, units=how.units or "")
            errors = page.facts.errors
            if not how.no_report:
                progress("drawing the report")
                page.save(output / REPORT)
        except Exception as error:  # whatever it is, the result is written and stays
            undrawn = f"{type(error).__name__}: {error}"
    with reading_in(units.printed):
        for text in warnings(result):
            warn(text)
        tables = calibration_tables(result) if how.verbose else []
        _say(result, errors, notes, tables, drawn=not (how.no_report or undrawn))
    wrote(output)
    answer(lambda: as_json(result))
    if undrawn:
        warn(f"exit code 3, since the report could not be drawn ({undrawn}); the result is written")
        raise typer.Exit(3)
    if not result.converged:
        raise typer.Exit(1)
    if result.excess > 1.0 and not how.accept:
        warn("exit code 1, since χ² contradicts the noise; --accept takes the result as it is")
        raise typer.Exit(1)


def _say(
    result: CalibrationResult,
    errors: WorkspaceErrors | None,
    notes: list[str],
    tables: Sequence[Table],
    *,
    drawn: bool,
) -> None:
    """Print what was found, the accuracy first; with tables all of it."""
    first = verdict_lines(result, errors)
    more = [line for line in calibration_summary(result, errors) if line not in first]
    weak = weak_lines(result.weak, result.nominal) if result.converged else []
    if not tables:
        more = [line for line in more[1:] if line not in weak]
        count = len(result.weak)
        pairs = counted(count, "pair of parameters is", "pairs of parameters are")
        more += [f"{pairs} weakly determined"] * bool(weak)
    for line in first:
        stdout.print(line, markup=False)
    for table in tables:
        stdout.print(table)
    for line in (*more, *notes):
        stdout.print(line, markup=False)
    if not tables:
        where = "report.html in the result's folder, or --verbose" if drawn else "--verbose"
        stdout.print(f"parameters and residuals: {where}")


def _tolerance(said: str) -> dict[str, float] | Literal["auto"]:
    """Return standard deviations of parameters by unit, or that they are to be found.

    Raises:
        MeasurementError: a unit said twice, or no number with one.
    """
    if said.strip() == AUTO:
        return AUTO
    found: dict[str, float] = {}
    for text in filter(None, (one.strip() for one in said.split(","))):
        number = re.match(r"[-+\d.eE]*", text)
        unit = text[number.end() :].strip() if number else ""
        dimension = UNITS.get(unit or "1", ("", 0.0))[0]
        if dimension not in ("m", "rad", "1") or dimension in found:
            raise MeasurementError(
                f"--tolerance {said}: {text!r} is not understood; expected one number for lengths, "
                "one for angles, and one without a unit for gains, such as 0.5mm,5mrad,0.001"
            )
        if not unit and not found:
            raise MeasurementError(
                f"--tolerance {said}: {text!r} has no unit; say 0.5mm, 5mrad, and after them a "
                "number for gains"
            )
        found[dimension] = in_si(text, dimension) if unit else plain_number(text)
    return found


def _priors(said: Sequence[str], mechanism: Mechanism) -> dict[str, float]:
    """Return priors by name.

    Raises:
        MeasurementError: not a name and a number, or a name said twice.
    """
    priors: dict[str, float] = {}
    for text in said:
        name, _, value = (part.strip() for part in text.partition("="))
        if name in priors:
            raise MeasurementError(f"--prior {name} is said twice; leave out one of them")
        own = {one.unit for one in mechanism.parameters if name in (one.name, one.id)}
        try:
            priors[name] = in_si(value, " ".join((own or {"m", "rad"}) - {"1"}))
        except typer.BadParameter:
            raise MeasurementError(
                f"--prior {text!r}: expected a name and a standard deviation, such as l=0.0005 [m] "
                f"or l=0.5mm{f'; {name} is in {next(iter(own))}' if len(own) == 1 else ''}"
            ) from None
    return priors
