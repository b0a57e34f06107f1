"""Two ways to begin: ``pincal new``, one's own data sheet, and ``demo``, a simulated machine."""

from __future__ import annotations

import tempfile
from dataclasses import asdict, make_dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

import pincal
from pincal import FileError, Noise, Plan
from pincal.architectures.catalogue import ARCHITECTURES, architecture_of
from pincal.cli.app import app, command, remark, run_step, say, stdout, working, wrote
from pincal.cli.options import Force, Seed, named_after, output_option
from pincal.design.order import in_rounds, with_verification
from pincal.files.columns import columns_of, sheet_columns
from pincal.files.mechanism_folders import MECHANISM_FILES, write_mechanism
from pincal.files.output import refuse_existing, writing
from pincal.files.table import write_table
from pincal.option import Option, option
from pincal.show.tables import selection_table
from pincal.words.numbers import WRITTEN, amount
from pincal.workspace.criteria import in_workspace

#: Files in the folder beside the mechanism, and what they are.
DESCRIPTIONS = {
    "picture.svg": "a picture with dimensions",
    "plan.csv": "poses to measure",
    "sheet.csv": "the sheet to fill in",
}
FOLDER = (*MECHANISM_FILES, *DESCRIPTIONS)
_CANDIDATES, _VERIFY, _SEED = 1000, 6, 0
_READ = 1e-4  # standard deviation of readings, where there are more than freedoms [m or rad]


def _dimension_options() -> type[Any]:
    """Return all dimensions of all architectures as a group of options."""
    meanings: dict[tuple[str, str], list[str]] = {}
    for architecture in ARCHITECTURES.values():
        for dimension in architecture.dimensions:
            choices = f" ({' or '.join(dimension.choices)})" * bool(dimension.choices)
            meanings.setdefault((dimension.name, dimension.unit), []).append(
                f"{architecture.name}: {dimension.label}{choices}"
            )
    fields = []
    for (name, unit), texts in meanings.items():
        declared = Option(f"{'; '.join(texts)}.", None if unit else "TEXT", unit, needs_unit=True)
        fields.append((name, (float if unit else str) | None, option(None, declared)))
    return make_dataclass("DimensionOptions", fields, frozen=True)


DimensionOptions = _dimension_options()


@command
def new(
    architecture: Annotated[
        str, typer.Argument(metavar="ARCHITECTURE", help=f"{', '.join(ARCHITECTURES)}.")
    ],
    output: Annotated[Path, output_option("MECH", "Folder of the mechanism, plan and sheet.")],
    dimensions: DimensionOptions,  # type: ignore[valid-type]
    count: Annotated[int, typer.Option(min=1, help="Poses for the calibration.")] = 24,
    force: Force = False,
) -> None:
    """Create a mechanism from its dimensions.

    Writes a mechanism folder, and into it a picture with dimensions (picture.svg), poses to measure
    (plan.csv; six more to check the calibration), and a sheet to fill in (sheet.csv). Dimensions
    that are not given are scaled from those that are; all are printed.

    Then measure, fill in the sheet, and type 'pincal calibrate MECH MECH/sheet.csv -o RESULT'.
    """
    refuse_existing(output, force=force, folder=FOLDER)
    design = architecture_of(architecture)
    sizes = {name: value for name, value in asdict(dimensions).items() if value is not None}
    values = design.complete(sizes)
    mechanism = pincal.new_mechanism(design.name, name=named_after(output), **values)
    noise = Noise(reading=_READ if mechanism.redundant else 0.0)
    with working("choosing poses"):
        if design.region is None:  # all that its readings reach, or where it works
            candidates = pincal.sample_configurations(mechanism, _CANDIDATES, _SEED)
        else:
            low, high = design.region(values)
            size = 4 * _CANDIDATES, len(low)
            poses = np.random.default_rng(_SEED).uniform(low, high, size)
            candidates = Plan(poses[in_workspace(mechanism, poses)][:_CANDIDATES])
        chosen = pincal.select_configurations(mechanism, candidates, count, noise=noise, seed=_SEED)
        plan = with_verification(mechanism, chosen.plan, candidates, _VERIFY, _SEED)
        plan = in_rounds(mechanism, plan, seed=_SEED)
    with writing(output, force=force, folder=FOLDER) as scratch:
        write_mechanism(mechanism, scratch)
        drawn = any(parameter.nominal for parameter in mechanism.parameters)
        image = pincal.picture(mechanism, dimensions=mechanism.leg_names[0] if drawn else "")
        image.save(scratch / "picture.svg")
        write_table(scratch / "plan.csv", columns_of(mechanism, plan), units=WRITTEN)
        if plan.readings is None:
            plan = replace(plan, readings=pincal.inverse(mechanism, plan.poses).readings)
        write_table(scratch / "sheet.csv", sheet_columns(mechanism, plan))
    stdout.print(mechanism.description)
    stdout.print(selection_table(chosen, mechanism.name))
    wrote(output)
    for file, description in DESCRIPTIONS.items():
        remark(f"  {file}: {description}")
    remark(f"then: pincal calibrate {output} {output / 'sheet.csv'} -o RESULT")


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
    """Run every step on a simulated machine.

    Samples the workspace, chooses poses on one leg and maps them to all, simulates measurements of
    a disturbed mechanism, calibrates each leg alone, as the papers do, and all together, and
    compares the platform's errors before and after.
    """
    mechanism = pincal.load_mechanism(mech)
    if output is None:
        output = Path(tempfile.mkdtemp(prefix="pincal-demo-"))
    elif not output.is_dir():
        refuse_existing(output, force=False).mkdir()
    elif any(output.iterdir()) and not force:
        raise FileError(f"{output} is not empty; choose another, or say --force to write there")
    candidates, plan = output / "candidates.csv", output / "plan.csv"
    truth, measured = output / "truth", output / "measurements.csv"
    position = float(f"{_NOISE * mechanism.size:.0e}")
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
    stdout.print("\nHow far the true machine misses, driven by each model:", style="bold")
    models: dict[str, str | Path] = {"nominal": mech, **results}
    poses = pincal.Plan.from_csv(candidates, mechanism)
    with working("driving the true machine over the workspace"):
        errors = {name: pincal.accuracy(model, truth, poses) for name, model in models.items()}
    for name, error in errors.items():
        worst = amount(error.worst_position, "m")
        stdout.print(f"{name}: {amount(error.position, 'm')} root mean square, {worst} at most")
    say(f"All files are in {output}; open {output / 'result' / 'report.html'}")
