"""Fits that failed: what would explain that the measurements are not such as the model makes.

Measurements are asked before a fit whether they are plausible; but not if the nominal mechanism is
known but roughly, nor in a frame that only the fit finds.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pincal.errors import MeasurementError, PincalError
from pincal.identification.latent_fit import latent_problem
from pincal.identification.measured import given_poses
from pincal.identification.plausibility import suspected
from pincal.identification.result import CalibrationResult
from pincal.identification.task import Task
from pincal.model.setup import ORIGIN

_FAR = 10.0  # times what rows usually miss the nominal mechanism by
_FEW = 0.1  # of the rows: more are no slips


def check_cause(task: Task, error: PincalError) -> None:
    """Raise if something explains why a fit found no answer.

    Raises:
        MeasurementError: naming it.
    """
    words = _suspected(task)
    if words:
        raise MeasurementError(words) from error


def causes(task: Task, result: CalibrationResult) -> tuple[str, ...]:
    """Return what would explain residuals that the noise given does not, in words."""
    if result.promises and result.corrects:
        return ()
    words = _suspected(task)
    return (*([words] if words else []), *_slips(result))


def _suspected(task: Task) -> str:
    """Return what would explain that measurements do not fit; poses in the nominal machine's frame.

    Empty if nothing does, or poses were not measured in full.
    """
    data = task.data
    if task.setup.plain:
        return suspected(task.mechanism, data)
    if not np.isfinite(data.poses).all() or set(task.setup.targets) != {ORIGIN}:
        return ""
    try:
        problem, _ = latent_problem(task)
    except PincalError:
        return ""
    first = problem.first
    poses, _ = given_poses(task, problem.observation, None if first is None else first.external)
    return suspected(task.mechanism, replace(data, poses=poses))


def _slips(result: CalibrationResult) -> list[str]:
    """Return in words which few rows miss the nominal mechanism much farther than the others."""
    farthest: dict[int, float] = {}
    for leg in result.legs:
        size = np.abs(leg.residuals_before)
        usual = float(np.median(size)) if len(size) else 0.0
        for row in np.flatnonzero(size > _FAR * usual) if usual > 0.0 else ():
            times = float(size[row] / usual)
            farthest[int(leg.rows[row])] = max(times, farthest.get(int(leg.rows[row]), 0.0))
    rows = {int(row) for leg in result.legs for row in leg.rows}
    if not 0 < len(farthest) <= max(1.0, _FEW * len(rows)):
        return []
    worst = max(farthest, key=lambda row: farthest[row])
    more = f", and {len(farthest) - 1} more rows so" if len(farthest) > 1 else ""
    return [
        f"data row {worst + 1} misses the nominal mechanism {farthest[worst]:.3g} times as far as "
        f"rows usually do{more}: look for a slip there first, or leave such rows out "
        "(--robust reject)"
    ]
