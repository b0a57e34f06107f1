"""What a report shows of a calibration, computed once: numbers, no words and no pictures."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pincal.calibration.result import CalibrationResult
from pincal.estimation.observability.indices import r_diagonal
from pincal.kinematics.derivatives import leg_demand
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
    errors: WorkspaceErrors | None
    """None if the fit did not converge."""

    @cached_property
    def poses(self) -> Array:
        """Poses of all rows in the base frame, shape (N, dof)."""
        return self.result.poses

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
            read = self.result.measurements.readings
            readings = read[rows][:, own] if machine.by_readings else None
            demand = leg_demand(machine, leg.name, self.poses[rows], readings=readings)
            demand = demand if machine.by_readings else demand.as_joint()
            C = demand.parameter.reshape(-1, len(leg.parameters))
            C = C[np.isfinite(C).all(axis=1)][:, free]
            names = [leg.parameters[i].name for i in free]
            found[leg.name] = dict(zip(names, r_diagonal(C).tolist(), strict=True))
        return found

    @cached_property
    def maps(self) -> ErrorMaps | None:
        """Errors over the workspace; None where none was found, or none can be promised."""
        return None if self.errors is None else error_maps(self.result, self.errors)


def findings(result: CalibrationResult) -> Findings:
    """Return what follows from a calibration."""
    return Findings(result, workspace_errors(result) if result.converged else None)
