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
from pincal.kinematics.closure import Closure, LegClosure
from pincal.kinematics.derivatives import Demand, demand
from pincal.kinematics.inverse import close, sensor_law
from pincal.kinematics.starts import start
from pincal.model.leg import Leg
from pincal.model.platform import Platform

Array = NDArray[np.float64]
Residual = Literal["closure", "joint"]
_STEPS = 60
_SMALL = 1e-8  # step, of the leg's size, and [rad]: of its square, e is off at most


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
            readings: Measured readings, shape (N,), [rad] or [m].
            kind: ``"closure"`` or ``"joint"``.
            rows: Rows of the measurements, counted from 0, for messages, shape (N,).
        """
        self.leg = leg
        self.platform = platform
        self.readings = readings
        self._kind = kind
        self._rows = np.arange(len(readings)) if rows is None else rows

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
        closed, joints = self.closed(closure, matrices, joints)
        return demand(closure, closed, self.readings), joints

    def closed(
        self,
        closure: LegClosure,
        matrices: Array,
        joints: Array | None = None,
        steps: int = _STEPS,
    ) -> tuple[Closure, Array]:
        """Return the leg at poses and readings, passive joints closing it best, and the joints.

        Args:
            closure: The leg at its parameter values.
            matrices: Poses ``T_base_platform``, shape (N, 4, 4).
            joints: Where the search for passive joints starts, shape (N, n_joints).
            steps: Most Gauss-Newton steps.
        """
        joints = start(closure, matrices)[0] if joints is None else joints.copy()
        active = self.leg.active
        joints[:, active] = sensor_law(closure).position(self.readings)
        passive = [i for i in range(joints.shape[1]) if i != active]
        for _ in range(steps):
            closed = closure.evaluate(joints, matrices)
            step = closed.passive_step()
            joints[:, passive] += step
            if np.abs(step).max(initial=0.0) <= _SMALL * max(1.0, closure.size):
                break
        return closed, joints

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
        difference = (predicted - self.readings)[:, None]
        return Demand(difference, rows.parameter, rows.pose, rows.reading), closed.joints
