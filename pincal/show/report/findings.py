"""What a report shows of a calibration, computed once: numbers, no words and no pictures."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MeasurementError
from pincal.estimation.observability import r_diagonal
from pincal.estimation.observation import Observation
from pincal.identification.calibrate import calibration_task
from pincal.identification.measured import given_poses
from pincal.identification.result import CalibrationResult
from pincal.kinematics.derivatives import leg_demand
from pincal.model.measurements import Measurements, Plan
from pincal.model.setup import Setup
from pincal.show.results import turns
from pincal.show.workspace_errors import (
    ErrorMaps,
    WorkspaceErrors,
    error_maps,
    workspace_errors,
)

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Findings:
    """A calibration, what it was made from, and what follows from it."""

    result: CalibrationResult
    data: Measurements
    poses: Array
    """Poses of all rows in the base frame, shape (N, dof)."""
    errors: WorkspaceErrors | None
    """None if the fit did not converge."""

    @property
    def turns(self) -> bool:
        """Whether the platform has an orientation."""
        return turns(self.result)

    @cached_property
    def observability(self) -> dict[str, dict[str, float]]:
        """|R_ii| of each identified parameter at the poses used, by leg.

        Of what it moves the readings by, [rad/unit] or [m/unit]; where poses do not determine
        readings, of what it moves the leg's end by, [m/unit].
        """
        found, machine = {}, self.result.identified
        for leg, own in zip(self.result.legs, machine.reading_columns, strict=True):
            free = [i for i, p in enumerate(leg.parameters) if p.std > 0.0]
            rows = np.unique(leg.rows)
            readings = self.data.readings[rows][:, own] if machine.by_readings else None
            demand = leg_demand(machine, leg.name, self.poses[rows], readings=readings)
            demand = demand if machine.by_readings else demand.as_joint()
            C = demand.parameter.reshape(-1, len(leg.parameters))
            C = C[np.isfinite(C).all(axis=1)][:, free]
            names = [leg.parameters[i].name for i in free]
            found[leg.name] = dict(zip(names, r_diagonal(C).tolist(), strict=True))
        return found

    @cached_property
    def maps(self) -> ErrorMaps | None:
        """Errors over the workspace; None where none was found."""
        return None if self.errors is None else error_maps(self.result, self.errors)


def findings(result: CalibrationResult, data: Measurements, setup: Setup | None) -> Findings:
    """Return what follows from a calibration.

    Args:
        result: The calibration.
        data: What it was made from.
        setup: What the measured numbers mean, as it was given to ``calibrate``.

    Raises:
        MeasurementError: measurements or a setup that are not those of the calibration.
    """
    mechanism = result.nominal
    expected = ((len(data), mechanism.platform.dof), (len(data), len(mechanism.reading_names)))
    last = max((int(leg.rows.max(initial=-1)) for leg in result.legs), default=-1)
    if (data.poses.shape, data.readings.shape) != expected or last >= len(data):
        raise MeasurementError(
            f"{len(data)} rows, poses {data.poses.shape} and readings {data.readings.shape} are "
            f"not what {mechanism.name!r} was calibrated with; give the measurements that "
            "'calibrate' was given"
        )
    poses = _base_poses(result, data, setup or Setup())
    measured = Plan(poses, readings=data.readings if mechanism.by_readings else None)
    errors = workspace_errors(result, measured) if result.converged else None
    return Findings(result, data, poses, errors)


def _base_poses(result: CalibrationResult, data: Measurements, setup: Setup) -> Array:
    """Return the poses of all rows in the base frame, shape (N, dof).

    Raises:
        MeasurementError: a setup that is not that of the calibration.
    """
    if result.estimated_poses is not None:
        if len(result.estimated_poses) != len(data):
            raise MeasurementError(
                f"{len(data)} rows, but the calibration estimated {len(result.estimated_poses)} "
                "poses; give the measurements that 'calibrate' was given"
            )
        return result.estimated_poses
    observation, external = None, None
    if not setup.plain:
        observation = Observation(result.nominal, data, setup)
    outside = () if observation is None else observation.external.names
    if tuple(outside) != tuple(p.name for p in result.external):
        raise MeasurementError(
            f"the calibration has the external unknowns "
            f"{', '.join(p.name for p in result.external) or 'none'}, the setup "
            f"{', '.join(outside) or 'none'}; give the setup that 'calibrate' was given"
        )
    if observation is not None:
        unknowns = observation.external
        values = np.array([p.identified for p in result.external])
        start = unknowns.start
        external = unknowns.moved(start, values - unknowns.coordinates(start))
    task = calibration_task(result.nominal, data, setup=setup)
    return given_poses(task, observation, external)[0]
