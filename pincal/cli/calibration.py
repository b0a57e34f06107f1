"""``pincal calibrate``: the main job."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from pincal.cli.app import (
    Force,
    Mech,
    answer,
    command,
    output_option,
    stdout,
    typed,
    warn,
    working,
    wrote,
)
from pincal.cli.setups import SetupFile, UnknownFrame, UnknownTarget, setup_from
from pincal.errors import MeasurementError, PincalError
from pincal.files.measurements import read_measurements
from pincal.files.mechanism_folders import load_mechanism, mechanism_files
from pincal.files.output import refuse_existing
from pincal.identification.calibrate import calibrate as identify
from pincal.identification.result import CalibrationResult
from pincal.identification.result_files import as_json
from pincal.identification.runs import compare_runs
from pincal.identification.validation import FOLDS, validate
from pincal.model.measurements import Measurements, Noise
from pincal.model.mechanism import Mechanism
from pincal.model.orientation import SINGLE_ANGLES
from pincal.show.report.report import report
from pincal.show.result_tables import calibration_tables
from pincal.show.results import warnings
from pincal.show.summary import calibration_summary


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


@command(answers=True)
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
    hold_undetermined: Annotated[
        bool,
        typer.Option(
            "--hold-undetermined",
            help="Hold what the measurements do not tell as near to nominal as can be.",
        ),
    ] = False,
    folds: Annotated[
        int, typer.Option(min=0, help="Held-out validation; 0 leaves it out.")
    ] = FOLDS,
    force: Force = False,
) -> None:
    """Identify the parameters from measurements.

    --method latent takes rows in which part of the pose, or all of it, was not measured (empty
    cells or no columns). Without noise options, repeated rows tell the noise; else equal noise is
    assumed and its scale estimated from the residuals. RESULT holds report.html to read,
    result.json, residuals.csv and the calibrated mechanism; every command takes it as MECH. The
    exit code is 1, and no mechanism is written, if the fit does not converge.
    """
    if folds == 1:
        raise MeasurementError("--folds 1: expected 2 or more, or 0 for no held-out validation")
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
        "hold_undetermined": hold_undetermined,
    }
    with working("identifying parameters") as tell:
        result = identify(mechanism, data, progress=tell, **options)
        result, said = _trusted(mechanism, data, result, folds, options, tell)
        tell("sampling the workspace for the platform's errors")
        files = [*mechanism_files(mech), measurements, *([] if setup is None else [setup])]
        page = report(result, data, setup=how, command=typed(), files=files, notes=said)
        tell("drawing the report")
        result.save(output, force=force, report=page)
    for table in calibration_tables(result):
        stdout.print(table)
    for line in (*calibration_summary(data, result, page.found.errors), *said):
        stdout.print(line, markup=False)
    for text in warnings(result):
        warn(text)
    wrote(output)
    answer(as_json(result))
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
    said = [] if folds else ["no rows were held out (--folds 0)"]
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
        MeasurementError: not a name and a number, or a name said twice.
    """
    priors: dict[str, float] = {}
    for text in said:
        name, _, value = (part.strip() for part in text.partition("="))
        if name in priors:
            raise MeasurementError(f"--prior {name} is said twice; leave out one of them")
        try:
            priors[name] = float(value)
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
    single, told = set(data.extra) & set(SINGLE_ANGLES), np.isfinite(data.poses)
    turned = bool(told[:, angles].any() or single)
    placed = bool(told[:, ~angles].any() or set(data.extra) - single)
    needed = {"--noise-position": position} if placed else {}
    needed |= {"--noise-orientation": orientation} if turned else {}
    if None in needed.values():
        raise MeasurementError(
            f"give {' and '.join(needed)} with the other noise options, or none of them (the scale "
            "is then estimated)"
        )
    return Noise(position or 0.0, orientation or 0.0, reading or 0.0)
