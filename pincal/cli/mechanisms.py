"""Commands on mechanisms: list, check, convert poses and readings, deploy, new, and a demo."""

import shlex
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, make_dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

import pincal
from pincal import FileError, Mechanism, Plan
from pincal.architectures.catalogue import ARCHITECTURES, architecture_of
from pincal.cli.app import app, command, fail, remark, run_step, say, stdout, warn, working, wrote
from pincal.cli.options import Force, Mech, Seed, TableOptions, named_after, output_option
from pincal.estimation.observability.identifiable import identifiability
from pincal.files.columns import columns_of, reading_columns, reason_column
from pincal.files.measurements import read_poses, read_readings
from pincal.files.mechanism_folders import bundled
from pincal.files.output import refuse_existing
from pincal.files.table import write_table
from pincal.kinematics.configurations import beyond_limits, joints_at, leg_demands
from pincal.kinematics.influences import own_influences
from pincal.model.consistency import home_gap
from pincal.option import Option, option
from pincal.show.deployment import GridOptions
from pincal.show.tables import nominal_table, symmetry_table
from pincal.types import Mask
from pincal.words.numbers import amount
from pincal.words.wording import LISTED


@command
def mechanisms() -> None:
    """List the bundled mechanisms."""
    for name, folder in bundled().items():
        mechanism = pincal.load_mechanism(folder)
        coordinates = ", ".join(mechanism.platform.coordinates)
        stdout.print(f"{name:12s} {len(mechanism.legs)} legs, {coordinates}")
        stdout.print(f"{'':12s} {mechanism.description}")


@command
def check(mech: Mech) -> None:
    """Check a mechanism.

    Prints whether loops close at home, which parameters are observable, and the symmetry.
    """
    mechanism = pincal.load_mechanism(mech)
    stdout.print(nominal_table(mechanism))
    for leg in mechanism.legs:
        gap = max(home_gap(leg, mechanism.platform))
        words = f"closes at home within {gap:.2g} m"
        if gap > 1e-2 * leg.size:
            words = f"home is rough: it closes only within {gap:.2g} m, but tells how the leg bends"
        stdout.print(f"{leg.name}: {words}")
    if cables := mechanism.cables:
        pulls, limits = pincal.tensions(mechanism, [mechanism.platform.home])[0], cables
        words = f"hold home with {pulls.min():.4g} to {pulls.max():.4g} N at least"
        if np.isnan(pulls).any():
            words = f"cannot hold home with {limits.least:g} to {limits.most:g} N, and the load"
        stdout.print(f"cables: {words}")
    with working("sampling the workspace"):
        plan = pincal.sample_configurations(mechanism, 500)
    for leg, demand in zip(mechanism.legs, leg_demands(mechanism.at_reference, plan), strict=True):
        names = leg.at_reference.parameter_names
        by_reading = demand.value.shape[1] == len(leg.sensors)
        jacobian = (demand.jacobian if by_reading else demand.parameter).reshape(-1, len(names))
        rank = identifiability(jacobian, [f"{leg.name}.{name}" for name in names])
        words = "" if rank.complete else f": {rank.describe()}"
        if influenced := [name for name in leg.parameter_names if name not in names]:
            words += f"; {', '.join(influenced)} by columns {', '.join(leg.influences)}"
        stdout.print(
            f"{leg.name}: {rank.rank} of {rank.n_params} parameters observable from full poses "
            f"(condition {rank.condition:.3g}){words}"
        )
    if len(mechanism.legs) > 1:
        stdout.print(f"symmetry: {pincal.symmetry_group(mechanism)}")


@command
def symmetry(
    mech: Mech,
    tolerance: Annotated[
        float | None,
        typer.Option(
            min=0,
            help="Largest deviation, relative to the machine's size or [rad] [default: 1e-6, or "
            "the rounding of parameters that were written with few digits].",
        ),
    ] = None,
) -> None:
    """Find the symmetry group of a mechanism.

    Prints how each element permutes the legs, and why other elements are no symmetry.
    """
    mechanism = pincal.load_mechanism(mech)
    stdout.print(symmetry_table(pincal.symmetry_group(mechanism, tolerance)))


@command
def inverse(
    mech: Mech,
    poses: Annotated[Path, typer.Argument(metavar="POSES.csv", help="Poses: x [m], y [m], …")],
    output: Annotated[Path, output_option("READINGS.csv", "Readings, one column a leg.")],
    options: TableOptions,
    as_measured: Annotated[
        bool,
        typer.Option(
            "--as-measured",
            help="Poses are those of the measured point in the frame of the measurements (the "
            "tracker's); MECH must be a result.",
        ),
    ] = False,
    force: Force = False,
) -> None:
    """Write the sensor readings of poses.

    Rows of poses out of reach stay empty, with the reason in the column 'reason'; the exit code is
    then 1. Readings of poses outside joint limits are written with a warning. For an arm, the
    solution nearest to readings beside the poses is taken, if there are any.

    For a controller that takes poses and knows another machine, 'pincal forward CONTROLLER
    READINGS.csv' gives the poses to command instead.
    """
    mechanism = pincal.load_mechanism(mech)
    units, plan = options.written_in(mechanism), read_poses(poses, mechanism)
    if as_measured:
        plan = replace(plan, poses=pincal.load_result(mech).in_base(plan.poses))
    refuse_existing(output, force=force)
    influences = own_influences(mechanism, plan.influences)
    near = None if plan.readings is None else joints_at(mechanism.without_terms, plan).joints
    solution = pincal.inverse(mechanism, plan.poses, influences, near)
    reasons = list(map(solution.reason, range(len(plan))))
    values = np.where(solution.reached.all(axis=1, keepdims=True), solution.readings, np.nan)
    columns = reading_columns(mechanism, values) | dict(influences) | reason_column(reasons)
    write_table(output, columns, units=units, force=force)
    say_reference(mechanism, influences)
    wrote(output)
    places = list(map(plan.place, range(len(plan))))
    outside: list[list[str]] = [[] for _ in places]
    for leg in mechanism.legs:
        for row, joint in np.argwhere(beyond_limits(leg, solution.joints[leg.name])):
            outside[row].append(f"{leg.name} {leg.moving[joint].name}")
    pairs = zip(places, outside, strict=True)
    if beyond := [f"{place}: {', '.join(joints)}" for place, joints in pairs if joints]:
        warn(
            f"{poses}: {len(beyond)} of {len(places)} poses are outside the limits of joints; "
            f"their readings are written nevertheless. {first_of(beyond)}"
        )
    fail_if_lost(poses, places, reasons, "pose")


@command
def forward(
    mech: Mech,
    readings: Annotated[Path, typer.Argument(metavar="READINGS.csv", help="leg_1 [rad], …")],
    output: Annotated[Path, output_option("POSES.csv", "Poses of the platform.")],
    options: TableOptions,
    force: Force = False,
) -> None:
    """Write the poses of sensor readings.

    Poses are in the assembly mode of home. Readings of more legs than degrees of freedom give the
    least-squares pose and a note on how far they contradict each other. Rows without readings or
    without a pose stay empty, with the reason in the column 'reason'; the exit code is then 1.
    """
    mechanism = pincal.load_mechanism(mech)
    units = options.written_in(mechanism)
    values, influences = read_readings(readings, mechanism)
    refuse_existing(output, force=force)
    known: Mask = np.isfinite(values).all(axis=1).astype(bool)
    influences = {k: v[known] for k, v in own_influences(mechanism, influences).items()}
    solution = pincal.forward(mechanism, values[known], influences=influences)
    say_reference(mechanism, influences)
    poses = np.full((len(values), mechanism.platform.dof), np.nan)
    poses[known], why = solution.poses, iter(solution.reasons)
    reasons = [next(why) if has_readings else "no readings" for has_readings in known.tolist()]
    columns = columns_of(mechanism, Plan(poses)) | reason_column(reasons)
    write_table(output, columns, units=units, force=force)
    if mechanism.redundant and solution.converged.any():
        row, leg = np.unravel_index(np.nanargmax(solution.gap), solution.gap.shape)
        remark(
            f"readings fit together within {solution.gap[row, leg]:.2g} m "
            f"(row {np.flatnonzero(known)[row] + 1}, {mechanism.leg_names[leg]})"
        )
    wrote(output)
    places = [f"row {row + 1}" for row in range(len(values))]
    fail_if_lost(readings, places, reasons, "reading")


def say_reference(mechanism: Mechanism, influences: Mapping[str, object]) -> None:
    """Print which influences were not given."""
    known = {*influences, *mechanism.loaded}
    if missing := [name for name in mechanism.influences if name not in known]:
        remark(f"{', '.join(missing)} not given: the machine is taken at their reference")


def first_of(lines: Sequence[str]) -> str:
    """Return the first lines, and how many more there are."""
    more = [f"and {len(lines) - LISTED} more"] * (len(lines) > LISTED)
    return "; ".join([*lines[:LISTED], *more])


def fail_if_lost(path: Path, places: Sequence[str], reasons: Sequence[str], kind: str) -> None:
    """End with exit code 1 and the reasons if some rows have no solution."""
    lost = [f"{place}: {reason}" for place, reason in zip(places, reasons, strict=True) if reason]
    if lost:
        fail(
            1,
            f"{path}: {len(lost)} of {len(places)} {kind}s have no solution; their rows are "
            f"empty, with the reason. {first_of(lost)}",
        )


@command
def deploy(
    machine: Annotated[
        str, typer.Argument(metavar="RESULT", help="Folder of a calibration; or a mechanism.")
    ],
    output: Annotated[Path, output_option("FOLDER", "Kinematics, data sheet and how to use them.")],
    correction: GridOptions,
    tables: TableOptions,
    force: Force = False,
) -> None:
    """Write kinematics for a controller.

    FOLDER gets inverse and forward kinematics as one Python file and one C99 header without
    dependencies, in the frames of the measurements; joint centres and lengths with standard errors;
    HAL lines for LinuxCNC if the machine is a hexapod or a delta; and commanding.md, which says how
    to use these files.

    If the controller's geometry cannot be changed, --grid 4096 adds the pose to command for each
    wanted pose (corrections.csv, and a function in both files), and prints the remaining error.

    For URDF, MJCF and printers see 'pincal export'.
    """
    pincal.deploy(machine, output, force=force, units=tables.units or "", **asdict(correction))
    wrote(output)


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
    elif output.absolute() == Path(mech).absolute():
        raise FileError(f"{output} would hide the mechanism of that name; name another folder")
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
        words = (mech, measured, *noise, "--method", method, "-o", folder, *forced)
        run_step("calibrate", *words, allowed=1)  # a leg alone may fail on held-out rows
    stdout.print("\nErrors of the true machine when each model drives it:", style="bold")
    models: dict[str, str | Path] = {"nominal": mech, **results}
    poses = pincal.Plan.from_csv(candidates, mechanism)
    with working("driving the true machine over the workspace"):
        errors = {name: pincal.accuracy(model, truth, poses) for name, model in models.items()}
    for name, error in errors.items():
        worst = amount(error.worst_position, "m")
        stdout.print(f"{name}: {amount(error.position, 'm')} root mean square, {worst} at most")
    say(f"All files are in {output}; open {output / 'result' / 'report.html'}")
