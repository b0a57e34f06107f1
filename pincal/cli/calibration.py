"""``pincal calibrate``, ``explain`` and ``doctor``: calibration by measurements, and diagnosis."""

import shlex
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from pincal import MeasurementError, Measurements, Mechanism, Noise, Options, Setup, load_mechanism
from pincal.calibration.calibrate import Remedy, cures_among, explained, prepared, remedies, run
from pincal.calibration.calibration import Calibration
from pincal.calibration.options import AUTO, By
from pincal.calibration.result_files import REPORT, RESULT_FILES
from pincal.cli.app import command, fail, remark, retyped, say, stdout, typed, warn, working, wrote
from pincal.cli.options import FORCE, Force, Measured, Mech, SetupOptions, output_option
from pincal.errors import MisfitError
from pincal.files.columns import columns_of
from pincal.files.further_tables import with_pairs
from pincal.files.measurements import read_measurements, read_poses
from pincal.files.mechanism_folders import mechanism_files
from pincal.files.output import refuse_existing
from pincal.files.table import TextTable, write_table
from pincal.model import ORIGIN
from pincal.option import option, option_of
from pincal.show import answers, tables
from pincal.show.explanation import advice, explanation_lines, remedy_table, tried
from pincal.show.report import report


@dataclass(frozen=True)
class InputOptions(SetupOptions):
    """Options on the measurements: setup, noise, columns."""

    noise_position: float | None = option(None, option_of(Noise, "position"))
    noise_orientation: float | None = option(None, option_of(Noise, "orientation"))
    noise_reading: float | None = option(None, option_of(Noise, "reading"))
    noise_pixel: float | None = option(None, option_of(Noise, "pixel"))
    pairs: Path | None = option(
        None,
        "Table of distances between rows, by calliper: row a, row b, distance [mm].",
        metavar="PAIRS.csv",
    )

    columns: tuple[str, ...] = option(
        (),
        "Rename a column of another program: 'Actuator 1=leg_1', '…=leg_1 [mm]'.",
        metavar="HEADER=NAME",
    )

    def read_setup(self) -> Setup:
        """Return the setup with the renamed columns of the command line."""
        setup, pairs = super().read_setup(), [text.rpartition("=") for text in self.columns]
        headers = {header.strip(): name.strip() for header, _, name in pairs}
        return replace(setup, headers={**setup.headers, **headers})

    def table(self, path: Path) -> Path | TextTable:
        """Return the path of measurements, or their table with the distances of ``--pairs``."""
        return path if self.pairs is None else with_pairs(path, self.pairs)

    def calibration(self, mech: str, path: Path, options: Options) -> Calibration:
        """Return the calibration that the options ask for, by measurements in a file."""
        options = replace(options, setup=self.read_setup())
        calibration = prepared(mech, self.table(path), options)
        data = calibration.measurements
        noise = self.noise_of(calibration.mechanism, data, options.setup)
        return replace(calibration, options=replace(calibration.options, noise=noise))

    def noise_of(self, mechanism: Mechanism, data: Measurements, setup: Setup) -> Noise | None:
        """Return the noise of the options, None without any; a tracker has its own noise."""
        sigmas = {"m": self.noise_position, "rad": self.noise_orientation, "": self.noise_reading}
        sigmas |= {"px": self.noise_pixel}
        if set(sigmas.values()) == {None}:
            return None
        platform = mechanism.platform
        columns = zip(platform.coordinates, platform.units, data.poses.T, strict=True)
        units = {name: unit for name, unit, values in columns if np.isfinite(values).any()}
        others = dict.fromkeys(setup.pixels, "px")
        known = setup.pixels & data.sigma_extra.keys()
        units |= {name: others.get(name, "m") for name in data.extra.keys() - known}
        tracked = {*platform.coordinates[: platform.lengths], *setup.points(platform)}
        measured = {units[name] for name in units if setup.tracker is None or name not in tracked}
        if any(sigmas[unit] is None for unit in measured):
            names = {"m": "position", "rad": "orientation", "px": "pixel"}
            raise MeasurementError(
                f"give {' and '.join(f'--noise-{names[unit]}' for unit in sorted(measured))} "
                "with the other noise options, or none of them (the noise is then estimated)"
            )
        position, orientation, reading, pixel = (sigma or 0.0 for sigma in sigmas.values())
        return Noise(position, orientation, reading, pixel or Noise.pixel)  # 0 px is impossible


@dataclass(frozen=True)
class CalibrateOptions:
    """Options on checks and output of a calibration."""

    by: By = option("region", "Rows that are held out together: regions, rows in turn, or runs.")
    workspace: Path | None = option(
        None, "Poses over which errors are stated [default: the whole workspace].", metavar="CSV"
    )
    verbose: bool = option(False, "Print all tables and findings.")
    report: bool = option(True, "Do not draw report.html.")
    force: bool = option(False, FORCE)


@command
def calibrate(
    mech: Mech,
    measurements: Measured,
    output: Annotated[Path, output_option("RESULT", "Folder for result and calibrated mechanism.")],
    options: Options,
    known: InputOptions,
    running: CalibrateOptions,
) -> None:
    """Identify the parameters from measurements.

    All legs are identified together; each pose is an unknown that may be measured in full, in part
    or not at all (empty cells, no columns). Noise that is not given is estimated from repeated
    rows, or else from the residuals. RESULT holds report.html, result.json, residuals.csv and the
    calibrated mechanism; every command takes it as MECH. Exit codes: 1 if the fit does not converge
    (no mechanism is written), or if χ² or held-out rows contradict it; 3 if only the report failed.
    """
    if options.poses != "own" and options.method != "per-leg":
        remark("--poses applies to --method per-leg only; all legs together use every pose")
    calibration = known.calibration(mech, measurements, options)
    refuse_existing(output, force=running.force, folder=RESULT_FILES)
    over = running.workspace
    poses = None if over is None else read_poses(over, calibration.mechanism)
    with working("identifying parameters") as progress:
        calibration = replace(calibration, options=replace(calibration.options, progress=progress))
        try:
            result, _, notes = run(calibration, options.folds, running.by)
        except MisfitError as error:
            raise MisfitError(f"{error}. Run {retyped('doctor')}") from error
        result.save(output, force=running.force)
        files = [*mechanism_files(mech), measurements]
        files += filter(None, [known.setup_file, known.pairs])
        errors, undrawn = None, ""
        try:
            progress("sampling the workspace for the platform's errors")
            origin: dict[str, Any] = {"command": typed(), "files": files}
            page = report(result, **origin, workspace=poses)
            page.notes, errors = notes, page.errors
            page.steps = answers.next_steps(result, errors, retyped, shlex.quote(str(output)))
            if running.report:
                progress("drawing the report")
                page.save(output / REPORT)
        except Exception as error:  # no fault of the report may lose the result
            undrawn = f"{type(error).__name__}: {error}"
    line, style = answers.verdict(result, errors)
    stdout.print(line, style=style)
    warn(*answers.warnings(result))
    shown = answers.summary(result, errors, notes)
    if running.verbose:
        shown += [*result.tables(), *answers.supporting_lines(result)]
    for part in shown:
        stdout.print(part)
    wrote(output)
    steps = answers.next_steps(result, errors, retyped, shlex.quote(str(output)))
    say(answers.next_line(steps))
    if undrawn:
        fail(3, f"exit code 3: the report could not be drawn ({undrawn}); the result is written")
    if not result.converged:
        fail(1)
    if result.excess > 1.0:
        fail(1, "exit code 1, since χ² contradicts the noise")
    if result.validation and result.validation.findings:
        fail(1, f"exit code 1, since {result.validation.kind} rows contradict the result")


@command
def explain(mech: Mech, measurements: Measured, options: Options, known: InputOptions) -> None:
    """Find errors that geometry does not explain.

    Each reading is tested for harmonics of its angle, an unknown period, polynomials, backlash,
    gravity (in space), pulleys of cables and every other column of numbers; lengths for such
    columns, one by one and all together; links for gravity. Models are compared on held-out poses.
    --terms chooses the kinds to try.
    """
    if options.folds < 2:
        raise MeasurementError("--folds: expected 2 or more: models are compared on held-out rows")
    with working("identifying parameters") as progress:
        options = replace(options, terms=options.terms or (AUTO,), progress=progress)
        explanation = explained(known.calibration(mech, measurements, options))
    warn(*answers.warnings(explanation.result))
    stdout.print(tables.screen_table(explanation))
    stdout.print(tables.models_table(explanation))
    say(*explanation_lines(explanation))
    if explanation.terms:
        added = (word for term in explanation.terms for word in ("--terms", term))
        say(f"  {retyped('calibrate', *added)}")


@command
def doctor(
    mech: Mech,
    measurements: Measured,
    known: InputOptions,
    output: Annotated[
        Path | None, output_option("CORRECTED.csv", "File for the corrected measurements.")
    ] = None,
    force: Force = False,
) -> None:
    """Find out why measurements do not fit.

    Units, signs, column order, zeros, frames, shifted logs and bad rows are corrected one at a
    time, the likeliest first, each tested by a full calibration, until one converges and nothing
    contradicts it. Other numeric columns are copied to CORRECTED.csv. The exit code is 1 if nothing
    works, or if several corrections work equally well.
    """
    mechanism, setup = load_mechanism(mech), known.read_setup()
    if output is not None:
        refuse_existing(output, force=force)
    table = known.table(measurements)
    data = read_measurements(table, mechanism, setup, partial=True, influences=None)
    options = Options(noise=known.noise_of(mechanism, data, setup), setup=setup)
    tries: list[Remedy] = []
    with working("trying what may be wrong") as progress:
        for remedy in remedies(prepared(mechanism, data, options)):
            tries.append(remedy)
            progress(tried(remedy))
    cures = cures_among(tries)
    stdout.print(remedy_table(tries))
    say(*advice(tries))
    if len(cures) == 1:
        _say_cure(cures[0], known, measurements, output, force=force)
        return
    short = [(count, least) for _, count, _, least in tries[0].calibration.short_legs()]
    if cures:
        stdout.print(
            f"{len(cures)} of these work equally well, and the measurements cannot decide between "
            "them: inspect the machine, and correct the cause"
        )
    elif short:
        lacking, advised = (max(n * least - count for count, least in short) for n in (1, 2))
        say(
            f"too few rows: measure {lacking} more at least, better {advised}",
            f"next: pincal select {shlex.quote(mech)} -o PLAN.csv",
        )
    else:
        stdout.print("none of these makes the measurements fit the mechanism")
        if any(remedy.result and remedy.result.converged for remedy in tries):
            stdout.print(f"the mechanism may lack a term: {retyped('explain')} looks for it")
    fail(1)


def _say_cure(
    cure: Remedy, known: InputOptions, measurements: Path, output: Path | None, *, force: bool
) -> None:
    lines, corrected = list[str](), None
    if any(fault.code != "unknown-frame" for fault in cure.findings):  # options cannot correct it
        corrected = (measurements, output or Path("CORRECTED.csv"))
        if output is None:
            lines.append(f"{typed()} -o CORRECTED.csv")
        else:
            data, setup = cure.calibration.measurements, cure.calibration.options.setup
            way = data.written or "tilt-torsion"
            columns = columns_of(cure.calibration.mechanism, data, way, setup)
            write_table(output, columns, force=force)
            wrote(output)
    elif output:
        remark(f"options suffice: {output} is not written, use {measurements}")
    options, as_typed = cure.calibration.options, known.read_setup()
    words = ["--unknown-frame"] * (options.setup.unknown_frame and not as_typed.unknown_frame)
    unknown_target = options.setup.targets[ORIGIN].unknown
    words += ["--unknown-target"] * (unknown_target and not as_typed.targets[ORIGIN].unknown)
    words += ["--rough"] * options.rough
    words += ["--loss", str(options.loss)] if options.loss != "none" else []
    lines.append(retyped("calibrate", *words, measured=corrected))
    say("this works:", *(f"  {line}" for line in lines))
