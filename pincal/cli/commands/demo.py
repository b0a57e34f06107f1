"""``pincal demo``: all of it on a simulated machine."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from pincal.cli.app import Force, Seed, app, output_option, remember, stdout, typed, working
from pincal.cli.commands.calibration import CalibrateOptions, calibrate
from pincal.cli.commands.selection import SelectOptions, select
from pincal.cli.commands.simulation import SimulateOptions, simulate
from pincal.cli.commands.workspace import WorkspaceOptions, workspace
from pincal.design.simulate import accuracy
from pincal.errors import FileError
from pincal.files.measurements import read_poses
from pincal.files.mechanism_folders import load_mechanism
from pincal.files.output import refuse_existing
from pincal.kinematics.closure import largest_size
from pincal.show.tables import accuracy_table

_NOISE = 5e-5  # of positions, of the machine's size


@app.command("demo")
def demo(
    mech: Annotated[str, typer.Argument(metavar="MECH", help="Mechanism.")] = "3RRR",
    output: Annotated[
        Path | None, output_option("FOLDER", "Folder for all files; else a temporary one.")
    ] = None,
    seed: Seed = 0,
    force: Force = False,
) -> None:
    """See it all at work on a simulated machine.

    Samples the workspace, chooses poses on one leg and maps them to all, simulates measurements of
    a disturbed mechanism, calibrates each leg alone, as the papers do, and all together, and
    compares the platform's errors before and after.
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
    alone = folder / "per_leg"

    _step("workspace", mech, "--count", "30000", "--seed", seed, "-o", candidates)
    workspace(mech, candidates, WorkspaceOptions(count=30_000, seed=seed), force)
    choice = ("--count", "24", "--candidates", candidates, "--seed", seed)
    _step("select", mech, *choice, "-o", plan)
    select(mech, plan, SelectOptions(count=24, candidates=candidates, seed=seed), force)
    position = float(f"{_NOISE * largest_size(mechanism.legs):.0e}")
    reading = position if mechanism.redundant else 0.0  # those that are too many cannot be exact
    noise: tuple[str, ...] = ("--noise-position", f"{position:g}", "--noise-orientation", "1e-4")
    noise += ("--noise-reading", f"{reading:g}") if reading else ()
    _step("simulate", mech, plan, *noise, "--seed", seed, "--truth", truth, "-o", measured)
    disturbed = SimulateOptions(position, 1e-4, reading, seed=seed, truth=truth)
    simulate(mech, plan, measured, disturbed, force)
    known = CalibrateOptions(noise_position=position, noise_orientation=1e-4, noise_reading=reading)
    _step("calibrate", mech, measured, *noise, "--per-leg", "-o", alone)
    calibrate(mech, measured, alone, replace(known, per_leg=True), force)
    _step("calibrate", mech, measured, *noise, "-o", result)
    calibrate(mech, measured, result, known, force)
    stdout.print(
        "\nThe true machine, driven by the nominal and by the calibrated models:", style="bold"
    )
    poses = read_poses(candidates, mechanism).poses
    true_mechanism = load_mechanism(truth)
    with working("driving the true machine over the workspace"):
        errors = {
            name: accuracy(model, true_mechanism, poses)
            for name, model in (
                ("nominal", mechanism),
                ("each leg alone", load_mechanism(alone / "mechanism")),
                ("all together", load_mechanism(result / "mechanism")),
            )
        }
    stdout.print(accuracy_table(errors, "rad" in mechanism.platform.units))
    report = result / "report.html"
    stdout.print(f"All files are in {folder}; open {report}", markup=False, soft_wrap=True)


def _step(*words: object) -> None:
    """Show a command as it would be typed."""
    remember([str(one) for one in words])
    _title(typed())


def _title(text: str) -> None:
    stdout.print(f"\n$ {text}", style="bold", markup=False, soft_wrap=True)
