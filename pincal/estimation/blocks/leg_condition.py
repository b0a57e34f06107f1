"""What a leg demands at a pose and a reading: its closure, or the joint residual of the papers.

The closure condition is Nᵀ c at a pose and a reading, passive joints chosen to minimise |c|:
for a planar dyad, the platform point's distance from the elbow less L. It exists out of reach
and stays finite near type-1 singularities. The joint residual is predicted less measured
reading (3-RRR paper, Eq. 24) and exists within reach only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from pincal.errors import MeasurementError
from pincal.kinematics.closing import close, sensor_law
from pincal.kinematics.closure import LegClosure
from pincal.kinematics.derivatives import Demand, demands
from pincal.model.leg import Leg
from pincal.model.platform import Platform
from pincal.types import Array, Index

Residual = Literal["closure", "joint"]
_TWISTS = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True)
class Met:
    """What a leg demands at a state, and where its joints are."""

    demand: Demand
    joints: Array
    """Positions, with deformations behind them if there are any, shape (N, n_joints …)."""


@dataclass(frozen=True)
class LegCondition:
    """The condition of one leg at measured readings, at any parameter values and poses."""

    leg: Leg
    """The nominal leg."""
    platform: Platform
    known: Array
    """Measured readings, [rad] or [m], then influences, shape (N, n_active [+ n_influences])."""
    kind: Residual
    rows: Index
    """Rows of the measurements, counted from 0, for messages, shape (N,)."""

    @property
    def width(self) -> int:
        """Number of equations at a pose."""
        if self.kind == "joint":
            return len(self.leg.sensors)
        return self.platform.equations(self.leg)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the equations at a pose."""
        if self.width == 1:
            return (self.leg.name,)
        if self.kind == "joint":
            return self.leg.reading_names
        if self.leg.passive:
            return tuple(f"{self.leg.name}, equation {i + 1}" for i in range(self.width))
        rows = self.platform.closing(self.leg.closes)
        return tuple(f"{self.leg.name} in {_TWISTS[row]}" for row in rows)

    @property
    def reading_unit(self) -> str:
        """Unit of the leg's readings: m, rad, or both."""
        return " or ".join(dict.fromkeys(self.leg.reading_units))

    @property
    def readings(self) -> Array:
        """Measured readings, shape (N, n_active), [rad] or [m]."""
        return self.known[:, : len(self.leg.sensors)]

    def corrected(self, shift: Array) -> LegCondition:
        """Return the condition at other readings, by a shift of shape (N, n_active)."""
        known = self.known.copy()
        known[:, : shift.shape[1]] += shift
        return replace(self, known=known)

    def part(self, chosen: Index) -> LegCondition:
        """Return the condition at some of its rows."""
        return LegCondition(
            self.leg, self.platform, self.known[chosen], self.kind, self.rows[chosen]
        )

    @property
    def form(self) -> tuple[object, ...]:
        """What conditions have in common that may be evaluated in one call."""
        if self.kind == "joint":
            return (self.leg,)
        return LegClosure(self.leg, self.platform).form

    def predicted(self, closure: LegClosure, matrices: Array) -> Met:
        """Return the joint residual of the leg.

        Args:
            closure: The leg at its parameter values.
            matrices: Poses ``T_base_platform``, shape (N, 4, 4).

        Raises:
            MeasurementError: a pose out of reach.
        """
        influences = self.known[:, len(self.leg.sensors) :]
        closed = close((closure,), matrices, influences)
        if not closed.reached.all():
            row = int(self.rows[np.argmin(closed.reached)])
            raise MeasurementError(
                f"{self.leg.name} does not reach measured pose {row + 1} with the parameters being "
                "tried, so its joint residual does not exist there; use the closure residual "
                "(--residual closure), which does"
            )
        reading = sensor_law(closure).reading(closed.joints[:, self.leg.active], influences)
        there = np.hstack((reading, influences))
        rows = demands((closure,), closed.closure, (there,))[0].as_joint()
        difference = reading - self.readings
        found = Demand(difference, rows.parameter, rows.pose, rows.reading)
        return Met(found, closed.joints)
