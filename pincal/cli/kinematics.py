"""``pincal inverse`` and ``forward``: poses to readings and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from pincal.cli.app import command, fail, remark, warn, wrote
from pincal.cli.options import Force, Mech, TableOptions, output_option
from pincal.files.measurement_writing import columns_of, reading_columns, reason_column
from pincal.files.measurements import read_poses, read_readings
from pincal.files.output import refuse_existing
from pincal.files.table import write_table
from pincal.kinematics.forward import forward as solve_forward
from pincal.kinematics.influences import own_influences
from pincal.kinematics.inverse import inverse as solve_inverse
from pincal.kinematics.inverse import outside_limits
from pincal.model.measurements import Plan
from pincal.model.mechanism import Mechanism
from pincal.words.wording import LISTED


@command()
def inverse(
    mech: Mech,
    poses: Annotated[Path, typer.Argument(metavar="POSES.csv", help="Poses: x [m], y [m], …")],
    output: Annotated[Path, output_option("READINGS.csv", "Readings, one column a leg.")],
    options: TableOptions,
    force: Force = False,
) -> None:
    """Write the sensor readings of poses.

    Rows of poses that are out of reach stay empty, with the reason in the column 'reason'; the exit
    code is then 1. Of poses outside the limits of joints readings are written, with a warning.
    """
    mechanism = options.load(mech)
    units = options.written_in(mechanism)
    plan = read_poses(poses, mechanism)
    refuse_existing(output, force=force)
    influences = own_influences(mechanism, plan.influences)
    solution = solve_inverse(mechanism, plan.poses, influences)
    reasons = list(map(solution.reason, range(len(plan))))
    values = np.where(solution.reached.all(axis=1, keepdims=True), solution.readings, np.nan)
    columns = reading_columns(mechanism, values) | dict(influences) | reason_column(reasons)
    write_table(output, columns, units=units, force=force)
    say_reference(mechanism, influences)
    wrote(output)
    places = list(map(plan.place, range(len(plan))))
    limits = zip(places, outside_limits(mechanism, solution), strict=True)
    if beyond := [f"{place}: {', '.join(joints)}" for place, joints in limits if joints]:
        warn(
            f"{poses}: {len(beyond)} of {len(places)} poses are outside the limits of joints; "
            f"their readings are written all the same. {first_of(beyond)}"
        )
    fail_if_lost(poses, places, reasons, "pose")


@command()
def forward(
    mech: Mech,
    readings: Annotated[Path, typer.Argument(metavar="READINGS.csv", help="leg_1 [rad], …")],
    output: Annotated[Path, output_option("POSES.csv", "Poses of the platform.")],
    options: TableOptions,
    force: Force = False,
) -> None:
    """Write the poses of sensor readings.

    Poses are those in the assembly mode of home. Readings of more legs than freedoms
    give the pose of least gaps, and how far they contradict each other is said.
    Rows of readings that have no pose stay empty, with the reason in the column 'reason'; the exit
    code is then 1.
    """
    mechanism = options.load(mech)
    units = options.written_in(mechanism)
    values, influences = read_readings(readings, mechanism)
    refuse_existing(output, force=force)
    influences = own_influences(mechanism, influences)
    solution = solve_forward(mechanism, values, influences=influences)
    say_reference(mechanism, influences)
    columns = columns_of(mechanism, Plan(solution.poses)) | reason_column(solution.reasons)
    write_table(output, columns, units=units, force=force)
    if mechanism.redundant and solution.converged.any():
        row, leg = np.unravel_index(np.nanargmax(solution.gap), solution.gap.shape)
        remark(
            f"readings fit together within {solution.gap[row, leg]:.2g} m "
            f"(row {row + 1}, {mechanism.leg_names[leg]})"
        )
    wrote(output)
    places = [f"row {row + 1}" for row in range(len(values))]
    fail_if_lost(readings, places, solution.reasons, "reading")


def say_reference(mechanism: Mechanism, influences: Mapping[str, object]) -> None:
    """Say which influences were not given."""
    known = {*influences, *mechanism.loaded}
    if missing := [name for name in mechanism.influences if name not in known]:
        remark(f"{', '.join(missing)} not given: the machine is taken at their reference")


def first_of(lines: Sequence[str], between: str = "; ") -> str:
    """Return the first lines, and how many more there are."""
    end = f"{between}and {len(lines) - LISTED} more" if len(lines) > LISTED else ""
    return between.join(lines[:LISTED]) + end


def fail_if_lost(path: Path, places: Sequence[str], reasons: Sequence[str], kind: str) -> None:
    """End with exit code 1, and say why, if some rows have no solution."""
    lost = [f"{place}: {reason}" for place, reason in zip(places, reasons, strict=True) if reason]
    if lost:
        fail(
            1,
            f"{path}: {len(lost)} of {len(places)} {kind}s without a solution; their rows are "
            f"empty, with the reason. {first_of(lost)}",
        )
