"""Two ways to begin: ``pincal new`` with a machine's dimensions, and ``demo``, a simulation."""

from __future__ import annotations

import shlex
import tempfile
from dataclasses import asdict, make_dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

import pincal
from pincal import FileError
from pincal.architectures.catalogue import ARCHITECTURES, architecture_of
from pincal.cli.app import app, command, run_step, say, stdout, working, wrote
from pincal.cli.options import Force, Seed, named_after, output_option
from pincal.files.output import refuse_existing
from pincal.option import Option, option
from pincal.words.numbers import amount


def _dimension_options() -> type[Any]:
    """Return a dataclass with all dimensions of all architectures as options."""
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
    output: Annotated[Path, output_option("MECH", "Folder of the mechanism.")],
    dimensions: DimensionOptions,  # type: ignore[valid-type]
    force: Force = False,
) -> None:
    """Create a mechanism from its dimensions.

    Writes a mechanism folder. Dimensions that are not given are scaled from the given ones; all are
    printed. Then plan, measure, fill in the sheet, and run 'pincal calibrate MECH SHEET -o RESULT'.
    """
    design = architecture_of(architecture)
    sizes = {name: value for name, value in asdict(dimensions).items() if value is not None}
    values = design.complete(sizes)
    mechanism = pincal.new_mechanism(design.name, name=named_after(output), **values)
    mechanism.save(output, force=force)
    stdout.print(mechanism.description)
    wrote(output)
    box = design.box(values)
    words = ["pincal", "select", str(output), *["--box", box][: 2 * bool(box)], "--verify", "6"]
    say(f"next: {shlex.join([*words, '--sheet', 'sheet.xlsx', '-o', 'plan.csv'])}")


_NOISE = 5e-5  # standard deviation of positions over the machine's size


@app.command("demo")
def demo(
    mech: Annotated[str, typer.Argument(metavar="MECH", help="Mechanism.")] = "3RRR",
    output: Annotated[
        Path | None, output_option("FOLDER", "Folder for all files [default: a temporary one].")
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
    if mechanism.redundant:  # more readings than freedoms cannot all be exact
        noise += ["--noise-reading", f"{position:g}"]
    forced = ["--force"] * force
    drawn = ["--seed", seed, *forced]
    run_step("workspace", mech, "--count", 30000, *drawn, "-o", candidates)
    run_step("select", mech, "--count", 24, "--candidates", candidates, *drawn, "-o", plan)
    run_step("simulate", mech, plan, *noise, *drawn, "--truth", truth, "-o", measured)
    results = {"each leg alone": output / "per_leg", "all together": output / "result"}
    for method, folder in zip(("per-leg", "all-legs"), results.values(), strict=True):
        run_step("calibrate", mech, measured, *noise, "--method", method, "-o", folder, *forced)
    stdout.print("\nErrors of the true machine when each model drives it:", style="bold")
    models: dict[str, str | Path] = {"nominal": mech, **results}
    poses = pincal.Plan.from_csv(candidates, mechanism)
    with working("driving the true machine over the workspace"):
        errors = {name: pincal.accuracy(model, truth, poses) for name, model in models.items()}
    for name, error in errors.items():
        worst = amount(error.worst_position, "m")
        stdout.print(f"{name}: {amount(error.position, 'm')} root mean square, {worst} at most")
    say(f"All files are in {output}; open {output / 'result' / 'report.html'}")
