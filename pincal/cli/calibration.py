"""``pincal calibrate`` and ``pincal demo``: the main job."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from pincal.cli.app import Force, Mech, Seed, app, output_option, stderr, stdout, working, wrote
from pincal.cli.experiment import select, simulate
from pincal.cli.setups import SetupFile, UnknownFrame, UnknownTarget, setup_from
from pincal.cli.workspace import workspace
from pincal.errors import FileError, MeasurementError, PincalError
from pincal.experiment.angles import ANGLES
from pincal.experiment.simulation import accuracy
from pincal.identification.calibrate import calibrate as identify
from pincal.identification.result import CalibrationResult
from pincal.identification.runs import compare_runs
from pincal.identification.validation import FOLDS, validate
from pincal.model.files import load_mechanism
from pincal.model.measurement_files import read_measurements, read_poses
from pincal.model.measurements import Measurements, Noise
from pincal.model.mechanism import Mechanism
from pincal.model.output import refuse_existing
from pincal.show.calibration import calibration_summary, calibration_tables
from pincal.show.tables import accuracy_table


class Method(StrEnum):
    """Which unknowns are identified at once."""

    per_leg = "per-leg"
    together = "together"
    latent = "latent"


class Residual(StrEnum):
    """What is minimised."""

    closure = "closure"
    joint = "joint"


class Poses(StrEnum):
    """Which poses serve a leg."""

    own = "own"
    all = "all"


class Robust(StrEnum):
    """What becomes of rows that do not fit the others."""

    none = "none"
    huber = "huber"
    cauchy = "cauchy"
    tukey = "tukey"
    reject = "reject"


@app.command()
def calibrate(
    mech: Mech,
    measurements: Annotated[
        Path, typer.Argument(metavar="MEASUREMENTS.csv", help="Measured poses and readings.")
    ],
    output: Annotated[Path, output_option("RESULT", "Folder for result and calibrated mechanism.")],
    method: Annotated[
        Method,
        typer.Option(help="Each leg alone, all legs at once, or these with all poses unknown."),
    ] = Method.per_leg,
    residual: Annotated[
        Residual, typer.Option(help="Whitened loop closure, or readings as in the papers.")
    ] = Residual.closure,
    poses: Annotated[
        Poses, typer.Option(help="For each leg the poses of its set, or every pose.")
    ] = Poses.own,
    noise_position: Annotated[
        float | None, typer.Option(help="Standard deviation of measured positions [m].")
    ] = None,
    noise_orientation: Annotated[
        float | None, typer.Option(help="Standard deviation of measured angles [rad].")
    ] = None,
    noise_reading: Annotated[
        float | None, typer.Option(help="Standard deviation of readings [rad or m].")
    ] = None,
    setup: SetupFile = None,
    unknown_frame: UnknownFrame = False,
    unknown_target: UnknownTarget = False,
    robust: Annotated[
        Robust, typer.Option(help="Rows that do not fit count less, or are rejected.")
    ] = Robust.none,
    fix: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Hold a parameter: l of every leg, leg_1.l of one."),
    ] = None,
    tie: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="One value for all legs; tested whether it holds."),
    ] = None,
    prior: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=SIGMA", help="A nominal value known to SIGMA [m, rad or 1]."),
    ] = None,
    rough: Annotated[
        bool,
        typer.Option("--rough", help="The nominal mechanism is known roughly: fewer checks."),
    ] = False,
    folds: Annotated[
        int, typer.Option(min=0, help="Held-out validation; 0 leaves it out.")
    ] = FOLDS,
    force: Force = False,
) -> None:
    """Identify the parameters from measurements.

    --method latent takes rows in which part of the pose, or all of it, was not measured (empty
    cells or no columns). Without noise options, repeated rows tell the noise; else equal noise is
    assumed and its scale estimated from the residuals. RESULT holds result.json, residuals.csv
    and the calibrated mechanism; every command takes it as MECH. The exit code is 1, and no
    mechanism is written, if the fit does not converge.
    """
    mechanism = load_mechanism(mech)
    refuse_existing(output, force=force, folder=True)
    how = setup_from(setup, unknown_frame=unknown_frame, unknown_target=unknown_target)
    data = read_measurements(measurements, mechanism, how, partial=method is Method.latent)
    options: dict[str, Any] = {
        "method": method.value,
        "residual": residual.value,
        "poses": poses.value,
        "noise": _noise(mechanism, data, noise_position, noise_orientation, noise_reading),
        "setup": how,
        "loss": robust.value,
        "fixed": fix or (),
        "tied": tie or (),
        "priors": _priors(prior or ()),
        "rough": rough,
    }
    with working("identifying parameters") as tell:
        result = identify(mechanism, data, progress=tell, **options)
        result, said = _trusted(mechanism, data, result, folds, options, tell)
        tell("sampling the workspace for the platform's errors")
        summary = [*calibration_summary(data, result), *said]
    result.save(output, force=force)
    for table in calibration_tables(result):
        stdout.print(table)
    for line in summary:
        stdout.print(line, markup=False)
    for text in result.warnings:
        stderr.print(f"warning: {text}", style="yellow", markup=False)
    wrote(output)
    if not result.converged:
        raise typer.Exit(1)


def _trusted(
    mechanism: Mechanism,
    data: Measurements,
    result: CalibrationResult,
    folds: int,
    options: dict[str, Any],
    tell: Callable[[str], None],
) -> tuple[CalibrationResult, list[str]]:
    """Return the result with validation and runs where the rows allow, and why not elsewhere."""
    if not result.converged:
        return result, []
    said = []
    try:
        if folds:
            result = replace(
                result, validation=validate(mechanism, data, folds=folds, progress=tell, **options)
            )
    except PincalError as error:
        said.append(f"no held-out validation: {error}")
    try:
        if data.runs is not None:
            tell("comparing the runs")
            result = replace(result, runs=compare_runs(mechanism, data, **options))
    except PincalError as error:
        said.append(f"runs not compared: {error}")
    found = [one.warnings for one in (result.validation, result.runs) if one is not None]
    return replace(result, warnings=(*result.warnings, *(w for own in found for w in own))), said


def _priors(said: Sequence[str]) -> dict[str, float]:
    """Return priors by name.

    Raises:
        MeasurementError: not a name and a number.
    """
    priors = {}
    for text in said:
        name, _, value = text.partition("=")
        try:
            priors[name.strip()] = float(value)
        except ValueError:
            raise MeasurementError(
                f"--prior {text!r}: expected a name and a standard deviation, such as l=0.0005 [m]"
            ) from None
    return priors


def _noise(
    mechanism: Mechanism,
    data: Measurements,
    position: float | None,
    orientation: float | None,
    reading: float | None,
) -> Noise | None:
    """Return the noise given, or None if none was.

    Raises:
        MeasurementError: given in part.
    """
    if position is None and orientation is None and reading is None:
        return None
    angles = np.array([unit == "rad" for unit in mechanism.platform.units])
    turned = bool(np.isfinite(data.poses[:, angles]).any()) or bool(set(data.extra) & set(ANGLES))
    placed = bool(np.isfinite(data.poses[:, ~angles]).any()) or bool(set(data.extra) - set(ANGLES))
    wanted = [
        name
        for name, value, measured in (
            ("--noise-position", position, placed),
            ("--noise-orientation", orientation, turned),
        )
        if measured and value is None
    ]
    if wanted:
        raise MeasurementError(
            f"give {' and '.join(wanted)} with the other noise options, or none of them (the scale "
            "is then estimated)"
        )
    return Noise(position or 0.0, orientation or 0.0, reading or 0.0)


@app.command()
def demo(
    mech: Annotated[str, typer.Argument(metavar="[MECH]", help="Mechanism.")] = "3RRR",
    output: Annotated[
        Path | None, output_option("FOLDER", "Folder for all files; else a temporary one.")
    ] = None,
    seed: Seed = 0,
    force: Force = False,
) -> None:
    """See it all at work on a simulated machine.

    Samples the workspace, chooses poses, simulates measurements of a disturbed mechanism,
    calibrates, and compares the platform's errors before and after.
    """
    mechanism = load_mechanism(mech)
    if output is None:
        folder = Path(tempfile.mkdtemp(prefix="pincal-demo-"))
    else:
        folder = Path(output)
        if not folder.is_dir():
            refuse_existing(folder, force=False).mkdir()
        elif any(folder.iterdir()) and not force:
            raise FileError(f"{folder} is not empty; choose another, or say --force to write there")
    candidates, plan = folder / "candidates.csv", folder / "plan.csv"
    truth, measured, result = folder / "truth", folder / "measurements.csv", folder / "result"

    _step(f"pincal workspace {mech} --count 30000 --seed {seed} -o {candidates}")
    workspace(mech, candidates, count=30_000, seed=seed, force=force)
    _step(f"pincal select {mech} --count 24 --candidates {candidates} --seed {seed} -o {plan}")
    select(mech, plan, 24, candidates, seed=seed, force=force)
    _step(
        f"pincal simulate {mech} {plan} --disturb 0.002 --seed {seed} --truth {truth} -o {measured}"
    )
    simulate(mech, plan, measured, 0.002, seed=seed, truth=truth, force=force)
    noise = "--noise-position 1e-4 --noise-orientation 1e-4"
    _step(f"pincal calibrate {mech} {measured} {noise} -o {result}")
    calibrate(mech, measured, result, noise_position=1e-4, noise_orientation=1e-4, force=force)
    _step("true machine driven by the nominal and by the calibrated model")
    poses = read_poses(candidates, mechanism).poses
    true_mechanism = load_mechanism(truth)
    with working("driving the true machine over the workspace"):
        before = accuracy(mechanism, true_mechanism, poses)
        after = accuracy(load_mechanism(result / "mechanism"), true_mechanism, poses)
    stdout.print(accuracy_table(before, after, "rad" in mechanism.platform.units))
    stdout.print(f"All files are in {folder}", markup=False, soft_wrap=True)


def _step(text: str) -> None:
    stdout.print(f"\n$ {text}", style="bold", markup=False, soft_wrap=True)
