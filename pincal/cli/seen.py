"""What is looked at: a mechanism, poses, a workspace and a result, as files hold them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from pincal.calibration.result import CalibrationResult
from pincal.calibration.result_files import load_result, read_result
from pincal.cli.app import remark, warn
from pincal.errors import FileError, MeasurementError
from pincal.files.mechanism_folders import is_folder, load_mechanism
from pincal.files.tables.measurements import read_measurements, read_poses
from pincal.files.tables.table_reading import read_table
from pincal.kinematics.forward import forward
from pincal.model.measuring.measurements import Plan
from pincal.model.mechanism import Mechanism
from pincal.show.results import warnings
from pincal.show.view.scene import MAGNIFY

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SeenOptions:
    """What is to be shown."""

    files: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="POSES.csv|RESULT",
            help="Poses, a plan or measurements; the folder of a calibration.",
        ),
    ] = None
    workspace: Annotated[
        Path | None,
        typer.Option(
            "--workspace", metavar="CSV", help="Cloud of positions, from 'pincal workspace'."
        ),
    ] = None
    magnify: Annotated[
        float | None,
        typer.Option(help=f"Factor on a RESULT's differences from nominal [default: {MAGNIFY:g}]."),
    ] = None

    def of(self, mech: str) -> Seen:
        """Return what the files hold.

        Raises:
            BadParameter: more than one file of a kind; a factor without a result.
            PincalError: a file that cannot be read, or does not belong to the mechanism.
        """
        given, workspace, magnify = self.files or [], self.workspace, self.magnify
        folders = [path for path in given if is_folder(path)]
        tables = [path for path in given if not is_folder(path)]
        for several in (folders, tables):
            if len(several) > 1:
                raise typer.BadParameter(
                    f"{' and '.join(map(str, several))}: expected one POSES.csv and one RESULT at "
                    "most"
                )
        if magnify is not None and not folders:
            raise typer.BadParameter("--magnify is for the errors of a RESULT, and none is given")
        mechanism = load_mechanism(mech)
        identified = _identified(folders[0]) if folders else None
        return Seen(
            mechanism,
            _plan(tables, folders, mechanism),
            None if workspace is None else _positions(workspace, mechanism),
            identified,
            MAGNIFY if magnify is None else magnify,
            ", ".join(path.name for path in (*tables, *folders)),
            *(_result(folders[0]) if folders else ((), None)),
        )


@dataclass(frozen=True)
class Seen:
    """What is to be shown, as read from files."""

    mechanism: Mechanism
    plan: Plan | None
    workspace: Array | None
    identified: Mechanism | None
    magnify: float
    source: str
    """Names of the files."""
    notices: tuple[str, ...] = ()
    """Warnings of the RESULT."""
    result: CalibrationResult | None = None


def _plan(tables: list[Path], folders: list[Path], mechanism: Mechanism) -> Plan | None:
    """Return the poses of a table; where it lacks some, those that the result estimated.

    Raises:
        MeasurementError: no row holds a whole pose, and there is no result with estimates of it.
    """
    estimates = [folder / "poses.csv" for folder in folders if (folder / "poses.csv").is_file()]
    if not tables:
        return read_poses(estimates[0], mechanism) if estimates else None
    (table,) = tables
    plan = _rows(table, mechanism)
    if mechanism.by_readings and plan.readings is not None:
        # they say where the mechanism is, in its own base frame
        solution = forward(mechanism, plan.readings)
        if not solution.converged.any():
            raise MeasurementError(
                f"{table}: {solution.reasons[0]} at {plan.place(0)}, and at all others"
            )
        rows = np.flatnonzero(solution.converged)
        sets = None if plan.sets is None else tuple(plan.sets[row] for row in rows)
        return Plan(solution.poses[rows], sets, plan.readings[rows])
    whole = np.isfinite(plan.poses).all(axis=1).astype(bool)
    if whole.all():
        return plan
    if estimates:
        poses = read_poses(estimates[0], mechanism).poses
        if len(poses) != len(whole):
            raise MeasurementError(
                f"{table} has {len(whole)} rows, {estimates[0]} has {len(poses)}; expected the "
                "measurements of this calibration"
            )
        remark(f"poses as estimated by the calibration: {estimates[0]}")
        return Plan(poses, plan.sets, plan.readings)
    advice = (
        "What was not measured, 'pincal calibrate -o RESULT' estimates for all rows; "
        "RESULT beside the measurements, or RESULT/poses.csv, shows it"
    )
    if not whole.any():
        try:
            read_poses(table, mechanism)
        except MeasurementError as error:
            raise MeasurementError(f"{error}. {advice}") from error
    warn(
        f"{table}: {len(whole) - whole.sum()} of {len(whole)} rows hold no whole pose, the first "
        f"is in {plan.place(int(np.argmin(whole)))}; only the others are drawn. {advice}"
    )
    sets = None if plan.sets is None else tuple(np.array(plan.sets)[whole].tolist())
    return Plan(plan.poses[whole], sets, None if plan.readings is None else plan.readings[whole])


def _rows(table: Path, mechanism: Mechanism) -> Plan:
    """Return a plan or, where the table has all readings, measurements; NaN where there is none."""
    if mechanism.by_readings or not set(mechanism.reading_names) <= set(read_table(table).units):
        return read_poses(table, mechanism, partial=True)
    return read_measurements(table, mechanism, partial=True)


def _identified(folder: Path) -> Mechanism:
    """Return the calibrated mechanism of a result folder."""
    if not (folder / "result.json").is_file():
        raise FileError(f"{folder} is no folder of 'pincal calibrate': it has no result.json")
    if not read_result(folder).get("calibrated_mechanism"):
        raise MeasurementError(
            f"{folder}: the fit did not converge, so there is no calibrated mechanism to show"
        )
    return load_mechanism(folder)


def _result(folder: Path) -> tuple[tuple[str, ...], CalibrationResult]:
    """Return a result's warnings, and itself."""
    result = load_result(folder)
    return tuple(warnings(result)), result


def _positions(path: Path, mechanism: Mechanism) -> Array:
    """Return the positions in a CSV of 'pincal workspace', shape (M, 2) or (M, 3), [m]."""
    table = read_table(path)
    names = mechanism.platform.coordinates[: mechanism.platform.units.count("m")]
    return np.column_stack([table.numbers(name, "m") for name in names])
