"""Commands on mechanisms: list and check them, convert poses and readings, deploy kinematics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

import pincal
from pincal import Mechanism, Plan
from pincal.cli.app import command, fail, remark, stdout, warn, working, wrote
from pincal.cli.options import Force, Mech, TableOptions, output_option
from pincal.estimation.observability.identifiable import identifiability
from pincal.files.columns import columns_of, reading_columns, reason_column
from pincal.files.measurements import read_poses, read_readings
from pincal.files.mechanism_folders import bundled
from pincal.files.output import refuse_existing
from pincal.files.table import write_table
from pincal.kinematics.configurations import beyond_limits, joints_at, leg_demands
from pincal.kinematics.influences import own_influences
from pincal.model.consistency import home_gap
from pincal.show.deployment import GridOptions
from pincal.show.tables import nominal_table, symmetry_table
from pincal.types import Mask
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

    Prints how each element permutes the legs, how well readings follow (equivariance, on
    sampled poses), and why other elements are no symmetry.
    """
    mechanism = pincal.load_mechanism(mech)
    detected = pincal.symmetry_group(mechanism, tolerance)
    with working("checking readings on sampled poses"):
        deviation = detected.equivariance(pincal.sample_workspace(mechanism, 300))
    stdout.print(symmetry_table(detected, deviation))


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
    units = options.written_in(mechanism)
    plan = read_poses(poses, mechanism)
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


def first_of(lines: Sequence[str], between: str = "; ") -> str:
    """Return the first lines, and how many more there are."""
    end = f"{between}and {len(lines) - LISTED} more" if len(lines) > LISTED else ""
    return between.join(lines[:LISTED]) + end


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
