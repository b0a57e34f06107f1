"""``pincal calibrate``, ``explain`` and ``doctor``: what measurements say of a mechanism."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from pincal.calibration.calibrate import prepared, run
from pincal.calibration.calibration import Calibration
from pincal.calibration.doctor import Remedy, remedies
from pincal.calibration.options import AUTO, FOLDS, By, Options
from pincal.calibration.result import CalibrationResult
from pincal.calibration.result_files import REPORT, RESULT_FILES, as_json
from pincal.calibration.terms.explain import explained
from pincal.cli.app import answer, command, remark, say, stdout, typed, warn, working, wrote
from pincal.cli.options import (
    FORCE,
    CountOptions,
    Force,
    Measured,
    Mech,
    NoiseOptions,
    SetupOptions,
    UnitOptions,
    output_option,
)
from pincal.errors import MeasurementError, MisfitError
from pincal.files.level import tilt_column
from pincal.files.measurement_writing import columns_of
from pincal.files.measurements import (
    measured_columns,
    read_measurements,
    table_for,
    unknown_columns,
)
from pincal.files.mechanism_folders import mechanism_files
from pincal.files.output import refuse_existing
from pincal.files.table import TextTable, write_table
from pincal.model.mechanism import Mechanism
from pincal.model.option import option
from pincal.model.setup import ORIGIN
from pincal.model.units import COUNTS, scale_of
from pincal.show.explanation import (
    advice,
    explanation_lines,
    models_table,
    remedy_table,
    screen_table,
    tried,
)
from pincal.show.report import report
from pincal.show.result_tables import calibration_tables, warnings
from pincal.show.summary import calibration_summary, verdict_lines, weak_lines
from pincal.show.workspace_answers import WorkspaceErrors
from pincal.words.numbers import counted, reading_in


@dataclass(frozen=True)
class InputOptions(CountOptions, SetupOptions, NoiseOptions):
    """What is known of the measurements."""

    def calibration(self, mech: str, path: Path, options: Options) -> Calibration:
        """Return the calibration to be done, by measurements in a file.

        Raises:
            PincalError: a file that cannot be read, or options that do not fit it.
        """
        mechanism = self.load(mech)
        priors = options.priors_of(mechanism.parameters)
        folds = options.folds or FOLDS  # of a choice of terms, also without held-out validation
        options = replace(options, setup=self.read_setup(), priors=priors, folds=folds)
        calibration = prepared(mechanism, path, options)
        noise = self.noise_of(mechanism, calibration.measurements, options.setup)
        return replace(calibration, options=replace(options, noise=noise))


@dataclass(frozen=True)
class CalibrateOptions(UnitOptions):
    """What is checked, written and printed of a calibration."""

    by: By = option("region", "What is held out together: regions, rows in turn, or runs.")
    verbose: bool = option(False, "Print all tables, and all that was found.")
    accept: bool = option(False, "Exit code 0 even if residuals are larger than the noise given.")
    report: bool = option(True, "Draw no report.html.")
    force: bool = option(False, FORCE)


@command(answers=True)
def calibrate(
    mech: Mech,
    measurements: Measured,
    output: Annotated[Path, output_option("RESULT", "Folder for result and calibrated mechanism.")],
    options: Options,
    known: InputOptions,
    running: CalibrateOptions,
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
    if options.poses != "own" and options.method != "per-leg":
        remark("--poses is for --method per-leg; all legs at once use every pose")
    calibration = known.calibration(mech, measurements, options)
    units = running.written_in(calibration.mechanism)
    refuse_existing(output, force=running.force, folder=RESULT_FILES)
    with working("identifying parameters") as progress:
        calibration = replace(calibration, options=replace(calibration.options, progress=progress))
        try:
            result, notes = run(calibration, options.folds, running.by)
        except MisfitError:
            remark(
                f"pincal doctor {mech} {measurements} tries what may be wrong, and says what works"
            )
            raise
        result.save(output, force=running.force)
        files = [*mechanism_files(mech), measurements]
        files += [known.setup_file] if known.setup_file else []
        errors, undrawn = None, ""
        try:
            progress("sampling the workspace for the platform's errors")
            page = report(
                result, command=typed(), files=files, notes=notes, units=running.units or ""
            )
            errors = page.facts.errors
            if running.report:
                progress("drawing the report")
                page.save(output / REPORT)
        except Exception as error:  # whatever it is, the result is written and stays
            undrawn = f"{type(error).__name__}: {error}"
    with reading_in(units.printed):
        for text in warnings(result):
            warn(text)
        _print_result(
            result, errors, notes, verbose=running.verbose, drawn=running.report and not undrawn
        )
    wrote(output)
    answer(lambda: as_json(result))
    if undrawn:
        warn(f"exit code 3, since the report could not be drawn ({undrawn}); the result is written")
        raise typer.Exit(3)
    if not result.converged:
        raise typer.Exit(1)
    if result.excess > 1.0 and not running.accept:
        warn("exit code 1, since χ² contradicts the noise; --accept takes the result as it is")
        raise typer.Exit(1)


def _print_result(
    result: CalibrationResult,
    errors: WorkspaceErrors | None,
    notes: Sequence[str],
    *,
    verbose: bool,
    drawn: bool,
) -> None:
    """Print a result, its accuracy first; with all tables if it is to be verbose."""
    verdict = verdict_lines(result, errors)
    summary = [line for line in calibration_summary(result, errors) if line not in verdict]
    if not verbose:
        weak = weak_lines(result.weak, result.nominal) if result.converged else []
        summary = [line for line in summary[1:] if line not in weak]
        if weak:
            count = len(result.weak)
            pairs = counted(count, "pair of parameters is", "pairs of parameters are")
            summary.append(f"{pairs} weakly determined")
        place = "report.html in the result's folder, or --verbose" if drawn else "--verbose"
        notes = [*notes, f"parameters and residuals: {place}"]
    tables = calibration_tables(result) if verbose else []
    for part in (*verdict, *tables, *summary, *notes):
        stdout.print(part)


@command(answers=True)
def explain(mech: Mech, measurements: Measured, options: Options, known: InputOptions) -> None:
    """Say what geometry does not explain, and which terms pay.

    Every reading is tried with harmonics of its angle, polynomials, backlash, gravity (where the
    mechanism says what weighs on it), and every other column of numbers; lengths with such columns,
    each alone and all as one, and links with gravity. Models are compared on poses that their fits
    have not seen. --terms says which kinds to try.
    """
    if options.folds < 2:
        raise MeasurementError("--folds: expected 2 or more: models are compared on held-out rows")
    with working("identifying parameters") as progress:
        terms = options.terms or (AUTO,)
        options = replace(options, terms=terms, progress=progress)
        explanation = explained(known.calibration(mech, measurements, options))
    for text in warnings(explanation.result):
        warn(text)
    stdout.print(screen_table(explanation))
    stdout.print(models_table(explanation))
    say(*explanation_lines(explanation))
    line = _command_with_terms(explanation.terms)
    if line:
        say(f"  {line}")
    choice = explanation.choice
    answer(
        {
            "verdict": explanation.verdict,
            "terms": list(explanation.terms),
            "command": line or None,
            "candidates": screen_table(explanation).records(),
            "models": models_table(explanation).records(),
            "slips": [asdict(slip) | {"size": slip.size.tolist()} for slip in choice.slips],
            "noise_at_least": [asdict(bound) for bound in choice.bounds],
            "folds_left_out": [fold + 1 for fold, _ in choice.lost],
        }
    )


def _command_with_terms(terms: tuple[str, ...]) -> str:
    """Return the command that calibrates with terms, empty if there are none."""
    if not terms:
        return ""
    words = shlex.split(typed())
    words[words.index("explain")] = "calibrate"
    while "--terms" in words:  # those that were tried
        place = words.index("--terms")
        del words[place : place + 2]
    words = [word for word in words if not word.startswith("--terms=")]
    added = [word for term in terms for word in ("--terms", term)]
    return shlex.join([*words, *added, "-o", "RESULT"])


@command(answers=True)
def doctor(
    mech: Mech,
    measurements: Measured,
    known: InputOptions,
    output: Annotated[
        Path | None, output_option("MENDED.csv", "File for the measurements put right.")
    ] = None,
    force: Force = False,
) -> None:
    """Say why measurements do not fit, and what works.

    Units, signs, orders, zeros, frames, shifted logs and bad rows are put right one by one, in the
    order of how likely they are, and each is tried by a whole calibration, until one converges and
    nothing contradicts it, rows held out included. Columns without a meaning are copied to
    MENDED.csv. The exit code is 1 if none does, or several alike.
    """
    mechanism, setup = known.load(mech), known.read_setup()
    columns = setup.columns(mechanism)
    table = table_for(measurements, mechanism, columns, None)
    table = table.where_measured(measured_columns(mechanism, columns))
    if output is not None:
        refuse_existing(output, force=force)
    data = read_measurements(table, mechanism, setup, partial=True)
    options = Options(noise=known.noise_of(mechanism, data, setup), setup=setup)
    calibration = prepared(mechanism, data, options)
    tries: list[Remedy] = []
    with working("trying what may be wrong") as progress:
        for remedy in remedies(calibration):
            tries.append(remedy)
            progress(tried(remedy))
    working_remedies = [remedy for remedy in tries if remedy.works]
    stdout.print(remedy_table(tries))
    say(*advice(tries))
    lines: list[str] = []
    if len(working_remedies) == 1:
        (remedy,) = working_remedies
        counts = _counts(mechanism, table, remedy)
        mended = measurements
        if remedy.mends and not counts:
            mended = output or Path("MENDED.csv")
            if output is None:
                lines.append(f"{typed()} -o MENDED.csv")
            else:
                _write_mended(output, table, calibration, remedy, force=force)
        elif output is not None:
            remark(f"options are enough: {output} is not written, take {measurements}")
        lines.append(_calibrate_line(mech, str(mended), known, remedy, counts))
        say("this works:", *(f"  {line}" for line in lines))
    elif working_remedies:
        stdout.print(
            f"{len(working_remedies)} of these work alike, and the measurements do not say which "
            "is true: look at the machine, and mend the source"
        )
    else:
        _say_that_nothing_works(mech, measurements, known, tries)
    answer({"commands": lines, "tried": [_remedy_answer(remedy) for remedy in tries]})
    if len(working_remedies) != 1:
        raise typer.Exit(1)


def _write_mended(
    output: Path, table: TextTable, calibration: Calibration, remedy: Remedy, *, force: bool
) -> None:
    """Write the measurements that a remedy put right, and the columns that mean nothing here."""
    mechanism, setup = calibration.mechanism, calibration.options.setup
    data, known_columns = remedy.calibration.measurements, setup.columns(mechanism)
    written = dict(columns_of(mechanism, data, data.written or "tilt-torsion", setup))
    known_columns = known_columns | tilt_column(mechanism, known_columns)
    for name, cells in unknown_columns(table, mechanism, known_columns).items():
        unit = table.units[name]
        written[f"{name} [{unit}]" if unit else name] = cells
    write_table(output, written, force=force)
    wrote(output)


def _say_that_nothing_works(
    mech: str, measurements: Path, known: InputOptions, tries: Sequence[Remedy]
) -> None:
    """Say what to try where no remedy makes the measurements fit."""
    stdout.print("nothing of this makes the measurements fit the mechanism")
    converged = [remedy for remedy in tries if remedy.result and remedy.result.converged]
    if converged:
        line = f"pincal explain {mech} {measurements}"
        stdout.print(f"the mechanism may lack a term: {line} looks for it")
    near = [remedy for remedy in converged if not remedy.mends]
    if near and near[0].result and near[0].result.excess == 1.0:
        line = _calibrate_line(mech, str(measurements), known, near[0])
        say("this converges, and promises nothing:", f"  {line}")


def _remedy_answer(remedy: Remedy) -> dict[str, Any]:
    """Return what became of a remedy, for JSON."""
    return {
        "what": tried(remedy),
        "codes": [finding.code for finding in remedy.findings],
        "works": remedy.works,
        "reduced_chi2": remedy.result.reduced_chi2 if remedy.result else None,
        "trouble": remedy.trouble or None,
    }


def _counts(mechanism: Mechanism, table: TextTable, remedy: Remedy) -> list[str]:
    """Return ``--counts`` that put readings in counts right; empty if other readings are wrong."""
    wrong = [finding for finding in remedy.findings if finding.code == "scale-of-readings"]
    factors = {name: factor for finding in wrong for name, factor, _ in finding.values["factors"]}
    if not factors or any(table.units.get(name) != COUNTS for name in factors):
        return []
    units = dict(zip(mechanism.reading_names, mechanism.reading_units, strict=True))
    scales = {
        name: scale_of(counts * factors.get(name, 1.0), units[name])
        for name, counts in mechanism.counts.items()
    }
    if set(scales) == set(units) and len(set(scales.values())) == 1:
        return list(set(scales.values()))
    return [f"{name}={scale}" for name, scale in scales.items()]


def _calibrate_line(
    mech: str,
    measurements: str,
    known: InputOptions,
    remedy: Remedy,
    counts: Sequence[str] = (),
) -> str:
    """Return the command by which to calibrate after a remedy."""
    options = remedy.calibration.options
    values: dict[str, Any] = {"setup": known.setup_file}
    values |= {noise.name: getattr(known, noise.name) for noise in fields(NoiseOptions)}
    words = ["pincal", "calibrate", mech, measurements]
    for name, value in values.items():
        words += [] if value is None else [f"--{name.replace('_', '-')}", str(value)]
    for scale in counts or known.counts:
        words += ["--counts", scale]
    unknown_target = options.setup.targets[ORIGIN].unknown
    said_by_file = known.read_setup().targets[ORIGIN].unknown and not known.unknown_target
    words += ["--unknown-frame"] if options.setup.unknown_frame else []
    words += ["--unknown-target"] if unknown_target and not said_by_file else []
    words += ["--rough"] if options.rough else []
    words += ["--loss", str(options.loss)] if options.loss != "none" else []
    return shlex.join([*words, "-o", "RESULT"])
