"""``pincal calibrate`` and ``pincal demo``: the main job."""

from __future__ import annotations

import tempfile
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from pincal.cli.app import Force, Mech, Seed, app, output_option, stderr, stdout, working, wrote
from pincal.cli.experiment import select, simulate
from pincal.cli.workspace import workspace
from pincal.errors import FileError, MeasurementError, WorkspaceError
from pincal.experiment.simulation import accuracy
from pincal.identification.calibrate import calibrate as identify
from pincal.identification.expected import expected_error
from pincal.identification.result import CalibrationResult
from pincal.model.files import load_mechanism
from pincal.model.measurement_files import read_measurements, read_poses
from pincal.model.measurements import Measurements, Noise
from pincal.model.mechanism import Mechanism
from pincal.model.output import refuse_existing
from pincal.show.tables import accuracy_table, legs_table, result_table
from pincal.workspace.sampling import sample_workspace


class Method(StrEnum):
    """Which parameters are identified at once."""

    per_leg = "per-leg"
    together = "together"


class Residual(StrEnum):
    """What is minimised."""

    closure = "closure"
    joint = "joint"


class Poses(StrEnum):
    """Which poses serve a leg."""

    own = "own"
    all = "all"


@app.command()
def calibrate(
    mech: Mech,
    measurements: Annotated[
        Path, typer.Argument(metavar="MEASUREMENTS.csv", help="Measured poses and readings.")
    ],
    output: Annotated[Path, output_option("RESULT", "Folder for result and calibrated mechanism.")],
    method: Annotated[Method, typer.Option(help="Each leg alone, or all legs at once.")] = (
        Method.per_leg
    ),
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
    force: Force = False,
) -> None:
    """Identify the parameters from measurements.

    Without noise options, equal noise of positions [m] and orientations [rad] is assumed
    and its scale estimated from the residuals. RESULT holds result.json, residuals.csv and
    the calibrated mechanism; every command takes it as MECH. The exit code is 1, and no
    mechanism is written, if the fit does not converge.
    """
    mechanism = load_mechanism(mech)
    refuse_existing(output, force=force, folder=True)
    noise = _noise(mechanism, noise_position, noise_orientation, noise_reading)
    data = read_measurements(measurements, mechanism)
    with working("identifying parameters") as tell:
        result = identify(
            mechanism,
            data,
            method=method.value,
            residual=residual.value,
            poses=poses.value,
            noise=noise,
            progress=tell,
        )
        tell("sampling the workspace for the platform's errors")
        summary = _summary(mechanism, data, result)
    result.save(output, force=force)
    stdout.print(result_table(result))
    stdout.print(legs_table(result))
    for line in summary:
        stdout.print(line, markup=False)
    for text in result.warnings:
        stderr.print(f"warning: {text}", style="yellow", markup=False)
    wrote(output)
    if not result.converged:
        raise typer.Exit(1)


def _summary(mechanism: Mechanism, data: Measurements, result: CalibrationResult) -> list[str]:
    """Return what a calibration means, in sentences."""
    lines = [result.message]
    if result.noise_source == "estimated" and result.noise:
        lines.append(
            f"noise estimated from the residuals: {1e3 * result.noise.position:.3g} mm in position"
            + (
                f", {1e3 * result.noise.orientation:.3g} mrad in orientation"
                if "rad" in mechanism.platform.units
                else ""
            )
        )
    else:
        lines.append(
            f"reduced χ² {result.reduced_chi2:.3g} on {result.degrees_of_freedom} degrees of "
            "freedom; near 1 the residuals are as large as the noise given makes them"
        )
    if result.converged:
        try:
            poses = sample_workspace(mechanism, 1000)
        except WorkspaceError:  # no workspace with the default margins: judge at the measurements
            poses = data.poses
        moved = accuracy(mechanism, result.identified, poses)
        left = expected_error(result, poses)
        turns = "rad" in mechanism.platform.units
        lines.append(
            "platform, root mean square over the workspace: the nominal model was off by "
            + _size(moved.position, moved.orientation, turns)
            + ", the calibrated one should be within "
            + _size(left.position, left.orientation, turns)
            + " (by the parameters' uncertainties; ± of single parameters may be larger where they "
            "compensate each other)"
        )
    unused = len(data) - min(leg.n_residuals for leg in result.legs)
    if unused:
        lines.append(
            f"{unused} of {len(data)} measured poses serve other legs only; --poses all lets every "
            "leg use every pose"
        )
    return lines


def _size(position: float, orientation: float, turns: bool) -> str:
    return f"{1e3 * position:.3g} mm" + (f" and {1e3 * orientation:.3g} mrad" if turns else "")


def _noise(
    mechanism: Mechanism,
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
    turns = "rad" in mechanism.platform.units
    if position is None or (turns and orientation is None):
        raise MeasurementError(
            "give --noise-position" + (" and --noise-orientation" if turns else "") + " with the "
            "other noise options, or none of them (the scale is then estimated)"
        )
    return Noise(position, orientation or 0.0, reading or 0.0)


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
