"""``pincal calibrate``, ``explain`` and ``doctor``: what measurements say of a mechanism."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from pincal.calibration.calibrate import prepared, run
from pincal.calibration.calibration import Calibration
from pincal.calibration.hypotheses.doctor import Remedy, remedies
from pincal.calibration.options import AUTO, FOLDS, By, Options
from pincal.calibration.result_files import REPORT, RESULT_FILES, as_json
from pincal.calibration.terms.explain import explained
from pincal.cli.app import answer, command, fail, remark, say, stdout, typed, warn, working, wrote
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
from pincal.model.option import option
from pincal.model.setup import ORIGIN
from pincal.show.answers import (
    accuracy_table,
    next_steps,
    remarks,
    supporting_lines,
    verdict,
    warnings,
)
from pincal.show.explanation import advice, explanation_lines, remedy_table, tried
from pincal.show.report import report
from pincal.show.tables import calibration_tables, models_table, screen_table
from pincal.words.numbers import reading_in


@dataclass(frozen=True)
class InputOptions(CountOptions, SetupOptions, NoiseOptions):
    """What is known of the measurements."""

    def calibration(self, mech: str, path: Path, options: Options) -> Calibration:
        """Return the calibration to be done, by measurements in a file."""
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
            errors = page.errors
            if running.report:
                progress("drawing the report")
                page.save(output / REPORT)
        except Exception as error:  # whatever it is, the result is written and stays
            undrawn = f"{type(error).__name__}: {error}"
    with reading_in(units.printed):
        warn(*warnings(result))
        line, style = verdict(result, errors)
        stdout.print(line, style=style)
        if errors is not None:
            stdout.print(accuracy_table(result, errors))
            notes = [*remarks(result, errors), *notes]
        details = [*calibration_tables(result), *supporting_lines(result, errors)]
        for part in (*details, *notes) if running.verbose else notes:
            stdout.print(part)
    wrote(output)
    say(f"next: {'; '.join(next_steps(result, mech, str(measurements), str(output)))}")
    answer(lambda: as_json(result))
    if undrawn:
        fail(
            3,
            f"exit code 3, since the report could not be drawn ({undrawn}); the result is written",
        )
    if not result.converged:
        fail(1)
    if result.excess > 1.0 and not running.accept:
        fail(1, "exit code 1, since χ² contradicts the noise; --accept takes the result as it is")


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
    warn(*warnings(explanation.result))
    tables = screen_table(explanation), models_table(explanation)
    for table in tables:
        stdout.print(table)
    say(*explanation_lines(explanation))
    line = ""
    if explanation.terms:
        added = (word for term in explanation.terms for word in ("--terms", term))
        line = _retyped("calibrate", *added)
        say(f"  {line}")
    answer(
        {
            "verdict": explanation.verdict,
            "terms": explanation.terms,
            "command": line or None,
            "candidates": tables[0].records(),
            "models": tables[1].records(),
            "slips": explanation.slips,
            "folds_left_out": [fold + 1 for fold, _ in explanation.lost],
        }
    )


def _retyped(command_name: str, *added: str, files: Mapping[Path, Path] | None = None) -> str:
    """Return what was typed as another command with further options, and with other files."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    for option_name in ("--terms", "-o"):  # those that were tried, and another output
        parser.add_argument(option_name, *["--output"] * (option_name == "-o"), action="append")
    for flag in ("--force", "--json", "--quiet"):
        parser.add_argument(flag, action="store_true")
    _, words = parser.parse_known_args(shlex.split(typed())[2:])
    words = [str((files or {}).get(Path(word), word)) for word in words]
    return shlex.join(["pincal", command_name, *words, *added, "-o", "RESULT"])


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
    tries: list[Remedy] = []
    with working("trying what may be wrong") as progress:
        for remedy in remedies(prepared(mechanism, data, options)):
            tries.append(remedy)
            progress(tried(remedy))
    cures = [remedy for remedy in tries if remedy.works]
    stdout.print(remedy_table(tries))
    say(*advice(tries))
    lines: list[str] = []
    if len(cures) == 1:
        mended = measurements
        if not cures[0].mends:
            if output is not None:
                remark(f"options are enough: {output} is not written, take {measurements}")
        elif output is None:
            mended = Path("MENDED.csv")
            lines.append(f"{typed()} -o MENDED.csv")
        else:
            mended = output
            _write_mended(output, table, cures[0].calibration, force=force)
        lines.append(_calibrate_line(cures[0], known, {measurements: mended}))
        say("this works:", *(f"  {line}" for line in lines))
    elif cures:
        stdout.print(
            f"{len(cures)} of these work alike, and the measurements do not say which "
            "is true: look at the machine, and mend the source"
        )
    else:
        stdout.print("nothing of this makes the measurements fit the mechanism")
        _say_what_converged(mech, measurements, known, tries)
    answer({"commands": lines, "tried": list(map(_remedy_answer, tries))})
    if len(cures) != 1:
        fail(1)


def _say_what_converged(
    mech: str, measurements: Path, known: InputOptions, tries: Sequence[Remedy]
) -> None:
    """Say what to try where no remedy makes the measurements fit, but a fit converged."""
    converged = [remedy for remedy in tries if remedy.result and remedy.result.converged]
    if converged:
        line = f"pincal explain {mech} {measurements}"
        stdout.print(f"the mechanism may lack a term: {line} looks for it")
    near = [remedy for remedy in converged if not remedy.mends]
    if near and near[0].result and near[0].result.excess == 1.0:
        say("this converges, and promises nothing:", f"  {_calibrate_line(near[0], known)}")


def _remedy_answer(remedy: Remedy) -> dict[str, Any]:
    """Return what became of a remedy, for JSON."""
    return {
        "what": tried(remedy),
        "codes": [finding.code for finding in remedy.findings],
        "works": remedy.works,
        "reduced_chi2": remedy.result.reduced_chi2 if remedy.result else None,
        "trouble": remedy.trouble or None,
    }


def _write_mended(output: Path, table: TextTable, calibration: Calibration, *, force: bool) -> None:
    """Write measurements that were put right, and the columns that mean nothing here."""
    mechanism, setup = calibration.mechanism, calibration.options.setup
    data, known_columns = calibration.measurements, setup.columns(mechanism)
    written = dict(columns_of(mechanism, data, data.written or "tilt-torsion", setup))
    known_columns = known_columns | tilt_column(mechanism, known_columns)
    for name, cells in unknown_columns(table, mechanism, known_columns).items():
        unit = table.units[name]
        written[f"{name} [{unit}]" if unit else name] = cells
    write_table(output, written, force=force)
    wrote(output)


def _calibrate_line(
    remedy: Remedy, known: InputOptions, files: Mapping[Path, Path] | None = None
) -> str:
    """Return the command by which to calibrate after a remedy."""
    options, as_typed = remedy.calibration.options, known.read_setup()
    words = ["--unknown-frame"] * (options.setup.unknown_frame and not known.unknown_frame)
    unknown_target = options.setup.targets[ORIGIN].unknown
    words += ["--unknown-target"] * (unknown_target and not as_typed.targets[ORIGIN].unknown)
    words += ["--rough"] * options.rough
    words += ["--loss", str(options.loss)] if options.loss != "none" else []
    return _retyped("calibrate", *words, files=files)
