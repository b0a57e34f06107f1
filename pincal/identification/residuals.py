"""Residuals of one leg at measured poses: closure (default) and joint.

The closure residual is Nᵀ c at the measured pose and reading, passive joints chosen to
minimise |c|: for a planar dyad, the platform point's distance from the elbow less L. It
exists out of reach and stays tame near type-1 singularities. The joint residual is
predicted less measured reading (3-RRR paper, Eq. 24) and exists within reach only.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MeasurementError
from pincal.kinematics.closure import LegClosure
from pincal.kinematics.derivatives import Demand, demand
from pincal.kinematics.inverse import close, sensor_law
from pincal.kinematics.starts import start
from pincal.model.leg import Leg
from pincal.model.platform import Platform

Array = NDArray[np.float64]
Residual = Literal["closure", "joint"]
_STEPS = 60
_SMALL = 1e-11  # of the leg's size, and [rad]


class LegResidual:
    """Residual of one leg and its derivatives, at any parameter values."""

    def __init__(
        self,
        leg: Leg,
        platform: Platform,
        matrices: Array,
        readings: Array,
        kind: Residual,
        rows: NDArray[np.intp] | None = None,
    ) -> None:
        """Hold the measurements of a leg.

        Args:
            leg: The nominal leg.
            platform: The platform.
            matrices: Measured poses ``T_base_platform``, shape (N, 4, 4).
            readings: Measured readings, shape (N,), [rad] or [m].
            kind: ``"closure"`` or ``"joint"``.
            rows: Rows of the measurements, counted from 0, for messages, shape (N,).
        """
        self.leg = leg
        self.kind = kind
        self._platform = platform
        self._matrices = matrices
        self._readings = readings
        self._rows = np.arange(len(readings)) if rows is None else rows
        self._joints: Array | None = None  # passive joints of the last call are the next start

    def __call__(self, parameters: Array) -> Demand:
        """Return residual and derivatives at parameter values, shape (n_params,).

        Raises:
            MeasurementError: joint residual, and a pose out of reach.
            MechanismError: a homed sensor, and a home pose out of reach.
        """
        closure = LegClosure(self.leg, self._platform, parameters)
        return self._closure(closure) if self.kind == "closure" else self._joint(closure)

    def _closure(self, closure: LegClosure) -> Demand:
        if self._joints is None:
            self._joints = start(closure, self._matrices)[0]
        joints, active = self._joints, self.leg.active
        joints[:, active] = sensor_law(closure).position(self._readings)
        passive = [i for i in range(joints.shape[1]) if i != active]
        for _ in range(_STEPS):
            closed = closure.evaluate(joints, self._matrices)
            step = closed.passive_step()
            joints[:, passive] += step
            if np.abs(step).max(initial=0.0) <= _SMALL * max(1.0, closure.size):
                break
        return demand(closure, closed, self._readings)

    def _joint(self, closure: LegClosure) -> Demand:
        closed = close(closure, self._matrices)
        if not closed.reached.all():
            row = int(self._rows[np.argmin(closed.reached)])
            raise MeasurementError(
                f"{self.leg.name} does not reach measured pose {row + 1} with the parameters being "
                "tried, so its joint residual does not exist there; use the closure residual "
                "(--residual closure), which does"
            )
        predicted = sensor_law(closure).reading(closed.joints[:, self.leg.active])
        rows = demand(closure, closed.closure, predicted).as_joint()
        difference = (predicted - self._readings)[:, None]
        return Demand(difference, rows.parameter, rows.pose, rows.reading)
