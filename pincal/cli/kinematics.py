"""``pincal inverse`` and ``forward``: poses to readings and back."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from scipy.spatial import KDTree

from pincal.cli.app import (
    Force,
    Mech,
    answer,
    command,
    output_option,
    remark,
    working,
    wrote,
)
from pincal.errors import MeasurementError
from pincal.files.measurement_writing import write_poses, write_readings
from pincal.files.measurements import read_poses, read_readings
from pincal.files.mechanism_folders import load_mechanism
from pincal.files.output import refuse_existing
from pincal.kinematics.forward import forward as solve_forward
from pincal.kinematics.inverse import inverse as solve_inverse
from pincal.model.measurements import Plan
from pincal.words.wording import LISTED
from pincal.workspace.criteria import Margins
from pincal.workspace.sampling import sample_workspace


@command(answers=True)
def inverse(
    mech: Mech,
    poses: Annotated[Path, typer.Argument(metavar="POSES.csv", help="Poses: x [m], y [m], …")],
    output: Annotated[Path, output_option("READINGS.csv", "Readings, one column a leg.")],
    force: Force = False,
) -> None:
    """Write the sensor readings of poses.

    Nothing is written if a pose is out of reach.
    """
    mechanism = load_mechanism(mech)
    refuse_existing(output, force=force)
    plan = read_poses(poses, mechanism)
    solution = solve_inverse(mechanism, plan.poses)
    reached = solution.reached.all(axis=1)
    lost = np.flatnonzero(~reached).tolist()
    _refuse_lost(poses, [(plan.place(row), solution.reason(row)) for row in lost], "pose")
    write_readings(output, mechanism, solution.readings, force=force)
    wrote(output)
    read = mechanism.reading_names, mechanism.reading_units
    readings = _columns(*read, solution.readings)
    answer({"mechanism": mechanism.name, "readings": readings})


@command(answers=True)
def forward(
    mech: Mech,
    readings: Annotated[Path, typer.Argument(metavar="READINGS.csv", help="leg_1 [rad], …")],
    output: Annotated[Path, output_option("POSES.csv", "Poses of the platform.")],
    force: Force = False,
) -> None:
    """Write the poses of sensor readings.

    Poses are those in the assembly mode of home. Readings of more legs than freedoms
    give the pose of least gaps, and how far they contradict each other is said.
    The search starts from the nearest of many sampled poses. Nothing is written if some
    readings have no pose.
    """
    mechanism = load_mechanism(mech)
    refuse_existing(output, force=force)
    values = read_readings(readings, mechanism)
    with working("sampling the workspace for start poses"):
        samples = sample_workspace(mechanism, 3000, least=Margins(0.05, 0.02))
    tree = KDTree(solve_inverse(mechanism, samples).readings)
    solution = solve_forward(
        mechanism, values, samples[np.minimum(tree.query(values)[1], len(samples) - 1)]
    )
    lost = np.flatnonzero(~solution.converged).tolist()
    _refuse_lost(readings, [(f"row {row + 1}", solution.reasons[row]) for row in lost], "reading")
    write_poses(output, mechanism, Plan(solution.poses), force=force)
    if mechanism.redundant:
        row, leg = np.unravel_index(np.argmax(solution.gap), solution.gap.shape)
        remark(
            f"readings fit together within {solution.gap[row, leg]:.2g} m "
            f"(row {row + 1}, {mechanism.leg_names[leg]})"
        )
    wrote(output)
    platform = mechanism.platform
    answer(
        {
            "mechanism": mechanism.name,
            "poses": _columns(platform.coordinates, platform.units, solution.poses),
            "gaps": _columns(mechanism.leg_names, ["m"] * len(mechanism.legs), solution.gap),
        }
    )


def _columns(
    names: Sequence[str], units: Sequence[str], values: NDArray[np.float64]
) -> dict[str, Any]:
    """Return columns by name, with their units, for JSON."""
    columns = zip(names, units, values.T, strict=True)
    return {name: {"unit": unit, "values": column} for name, unit, column in columns}


def _refuse_lost(path: Path, lost: list[tuple[str, str]], what: str) -> None:
    """Raise if some rows have no solution."""
    if lost:
        named = "; ".join(f"{place}: {reason}" for place, reason in lost[:LISTED])
        more = f"; and {len(lost) - LISTED} more" if len(lost) > LISTED else ""
        raise MeasurementError(
            f"{path}: {len(lost)} {what}(s) without a solution, nothing written. {named}{more}. "
            "Correct or remove these rows"
        )
