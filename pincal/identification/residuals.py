"""Residuals of one leg at poses and readings: closure (default) and joint.

The closure residual is Nᵀ c at a pose and a reading, passive joints chosen to minimise |c|:
for a planar dyad, the platform point's distance from the elbow less L. It exists out of reach
and stays tame near type-1 singularities. The joint residual is predicted less measured
reading (3-RRR paper, Eq. 24) and exists within reach only.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MeasurementError
from pincal.kinematics.closure import LegClosure
from pincal.kinematics.derivatives import Demand, demand
from pincal.kinematics.held import held
from pincal.kinematics.inverse import close, sensor_law
from pincal.model.leg import Leg
from pincal.model.platform import Platform

Array = NDArray[np.float64]
Residual = Literal["closure", "joint"]


class LegResidual:
    """Residual of one leg and its derivatives, at any parameter values and poses."""

    def __init__(
        self,
        leg: Leg,
        platform: Platform,
        readings: Array,
        kind: Residual = "closure",
        rows: NDArray[np.intp] | None = None,
    ) -> None:
        """Hold the readings of a leg.

        Args:
            leg: The nominal leg.
            platform: The platform.
            readings: Measured readings, shape (N, n_active), [rad] or [m].
            kind: ``"closure"`` or ``"joint"``.
            rows: Rows of the measurements, counted from 0, for messages, shape (N,).
        """
        self.leg = leg
        self.platform = platform
        self.readings = readings
        self._kind = kind
        self._rows = np.arange(len(readings)) if rows is None else rows

    @property
    def width(self) -> int:
        """Number of residuals at a pose."""
        if self._kind == "joint":
            return len(self.leg.sensors)
        return len(self.platform.closing(self.leg.closes)) - len(self.leg.passive)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the residuals at a pose, to follow 'closure of'."""
        if self.width == 1:
            return (self.leg.name,)
        if self._kind == "joint":
            return self.leg.reading_names
        if self.leg.passive:
            return tuple(f"{self.leg.name}, equation {i + 1}" for i in range(self.width))
        twists = ("x", "y", "z", "rx", "ry", "rz")
        rows = self.platform.closing(self.leg.closes)
        return tuple(f"{self.leg.name} in {twists[row]}" for row in rows)

    def part(self, rows: NDArray[np.intp]) -> LegResidual:
        """Return the residual at some of its rows."""
        return LegResidual(
            self.leg, self.platform, self.readings[rows], self._kind, self._rows[rows]
        )

    def __call__(
        self, parameters: Array, matrices: Array, joints: Array | None = None
    ) -> tuple[Demand, Array]:
        """Return residual and derivatives, and the joint positions there.

        Args:
            parameters: Parameter values, shape (n_params,).
            matrices: Poses ``T_base_platform``, shape (N, 4, 4).
            joints: Where the search for passive joints starts, shape (N, n_joints).

        Raises:
            MeasurementError: joint residual, and a pose out of reach.
            MechanismError: a homed sensor, and a home pose out of reach.
        """
        closure = LegClosure(self.leg, self.platform, parameters)
        if self._kind == "joint":
            return self._joint(closure, matrices)
        closed, joints = held(closure, matrices, self.readings, joints)
        return demand(closure, closed, self.readings), joints

    def _joint(self, closure: LegClosure, matrices: Array) -> tuple[Demand, Array]:
        closed = close(closure, matrices)
        if not closed.reached.all():
            row = int(self._rows[np.argmin(closed.reached)])
            raise MeasurementError(
                f"{self.leg.name} does not reach measured pose {row + 1} with the parameters being "
                "tried, so its joint residual does not exist there; use the closure residual "
                "(--residual closure), which does"
            )
        predicted = sensor_law(closure).reading(closed.joints[:, self.leg.active])
        rows = demand(closure, closed.closure, predicted).as_joint()
        difference = predicted - self.readings
        return Demand(difference, rows.parameter, rows.pose, rows.reading), closed.joints
