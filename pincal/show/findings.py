"""What a report shows of a calibration, computed once: numbers, no words and no pictures."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pincal.calibration.result import CalibrationResult
from pincal.errors import MeasurementError
from pincal.estimation.observability import r_diagonal
from pincal.kinematics.derivatives import leg_demand
from pincal.model.measurements import Measurements, Plan
from pincal.show.workspace_errors import WorkspaceErrors, errors_at, workspace_errors
from pincal.workspace.criteria import in_workspace

Array = NDArray[np.float64]
_ACROSS = {2: 45, 3: 25}  # cells of a map by the dimension of space
_HEIGHTS = (0.25, 0.5, 0.75)  # of the workspace, where a spatial one is cut


@dataclass(frozen=True)
class ErrorMaps:
    """Errors over x and y, the other coordinates as at home; NaN outside of the workspace."""

    x: Array
    """Shape (n,), [m]."""
    y: Array
    """Shape (n,), [m]."""
    heights: tuple[float | None, ...]
    """z of each map, [m]; None in a plane."""
    before: Array
    """Position [m] and orientation [rad] of the nominal model, shape (n_heights, n, n, 2)."""
    after: Array
    """To expect of the identified one, of the same shape."""


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
        return "rad" in self.result.nominal.platform.units

    @cached_property
    def observability(self) -> dict[str, dict[str, float]]:
        """|R_ii| of each identified parameter at the poses used, by leg.

        Of what it moves the readings by, [rad/unit] or [m/unit]; where poses do not tell readings,
        of what it moves the leg's end by, [m/unit].
        """
        found, machine = {}, self.result.identified
        for leg, own in zip(self.result.legs, machine.reading_columns, strict=True):
            free = [i for i, p in enumerate(leg.parameters) if p.std > 0.0]
            rows = np.unique(leg.rows)
            readings = self.data.readings[rows][:, own] if machine.by_readings else None
            told = leg_demand(machine, leg.name, self.poses[rows], readings=readings)
            told = told if machine.by_readings else told.as_joint()
            C = told.parameter.reshape(-1, len(leg.parameters))
            C = C[np.isfinite(C).all(axis=1)][:, free]
            names = [leg.parameters[i].name for i in free]
            found[leg.name] = dict(zip(names, r_diagonal(C).tolist(), strict=True))
        return found

    @cached_property
    def maps(self) -> ErrorMaps | None:
        """Errors over the workspace; None where none was found."""
        if self.errors is None or not self.errors.sampled or self.result.nominal.by_readings:
            return None
        platform, samples = self.result.nominal.platform, self.errors.poses
        n = _ACROSS[platform.space]
        low, high = samples.min(axis=0), samples.max(axis=0)
        x, y = (np.linspace(low[i], high[i], n) for i in (0, 1))
        heights: tuple[float | None, ...] = (None,)
        if platform.space == 3:
            heights = tuple(float(z) for z in np.quantile(samples[:, 2], _HEIGHTS))
        poses = np.tile(platform.home, (len(heights), n, n, 1))
        poses[..., 0], poses[..., 1] = x, y[:, None]
        for place, height in enumerate(heights):
            if height is not None:
                poses[place, ..., 2] = height
        flat = poses.reshape(-1, platform.dof)
        inside = in_workspace(self.result.nominal, flat)
        if not inside.any():
            return None
        found = errors_at(self.result, flat[inside])
        both = np.full((2, len(flat), 2), np.nan)
        both[:, inside] = found.before, found.after
        before, after = both.reshape(2, len(heights), n, n, 2)
        return ErrorMaps(x, y, heights, before, after)


def findings(result: CalibrationResult, data: Measurements) -> Findings:
    """Return what follows from a calibration.

    Args:
        result: The calibration.
        data: What it was made from.

    Raises:
        MeasurementError: measurements that are not those of the calibration.
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
    poses = result.poses
    measured = Plan(poses, readings=data.readings if mechanism.by_readings else None)
    errors = workspace_errors(result, measured) if result.converged else None
    return Findings(result, data, poses, errors)
