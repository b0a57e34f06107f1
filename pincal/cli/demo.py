"""``pincal demo``: all of it on a simulated machine."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated

import typer

from pincal.cli.app import app, run_step, say, stdout, working
from pincal.cli.options import Force, Seed, output_option
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
        output = Path(tempfile.mkdtemp(prefix="pincal-demo-"))
    elif not output.is_dir():
        refuse_existing(output, force=False).mkdir()
    elif any(output.iterdir()) and not force:
        raise FileError(f"{output} is not empty; choose another, or say --force to write there")
    candidates, plan = output / "candidates.csv", output / "plan.csv"
    truth, measured = output / "truth", output / "measurements.csv"
    position = float(f"{_NOISE * largest_size(mechanism.legs):.0e}")
    noise: list[object] = ["--noise-position", f"{position:g}", "--noise-orientation", "1e-4"]
    if mechanism.redundant:  # readings that are too many cannot be exact
        noise += ["--noise-reading", f"{position:g}"]
    forced = ["--force"] * force
    drawn = ["--seed", seed, *forced]
    run_step("workspace", mech, "--count", 30000, *drawn, "-o", candidates)
    run_step("select", mech, "--count", 24, "--candidates", candidates, *drawn, "-o", plan)
    run_step("simulate", mech, plan, *noise, *drawn, "--truth", truth, "-o", measured)
    results = {"each leg alone": output / "per_leg", "all together": output / "result"}
    for method, folder in zip(("per-leg", "all-legs"), results.values(), strict=True):
        run_step("calibrate", mech, measured, *noise, "--method", method, "-o", folder, *forced)
    stdout.print(
        "\nThe true machine, driven by the nominal and by the calibrated models:", style="bold"
    )
    poses, true_mechanism = read_poses(candidates, mechanism).poses, load_mechanism(truth)
    models = {"nominal": mechanism}
    models |= {name: load_mechanism(folder) for name, folder in results.items()}
    with working("driving the true machine over the workspace"):
        errors = {name: accuracy(model, true_mechanism, poses) for name, model in models.items()}
    stdout.print(accuracy_table(errors, "rad" in mechanism.platform.units))
    say(f"All files are in {output}; open {output / 'result' / 'report.html'}")
