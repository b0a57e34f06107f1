"""The residual block of legs: their closures at measured readings, or joint residuals.

The closure residual is Nᵀ c at a pose and a reading, passive joints chosen to minimise |c|: for a
planar dyad, the platform point's distance from the elbow less L. It exists out of reach and stays
finite near type-1 singularities. The joint residual is predicted less measured reading (3-RRR
paper, Eq. 24) and exists within reach only. Legs that differ only in where they begin are
evaluated in one call: a call costs more than the kinematics of some hundred rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from pincal.errors import MeasurementError
from pincal.estimation.unknowns import BlockRows, State
from pincal.kinematics.batches import block_diagonal, repeated, stacked
from pincal.kinematics.closing import close, grouped, sensor_law
from pincal.kinematics.closure import LegClosure
from pincal.kinematics.derivatives import Demand, demands
from pincal.kinematics.nearest_closure import nearest_closure
from pincal.model.leg import Leg
from pincal.model.platform import Platform
from pincal.types import Array, Index, Mask

Residual = Literal["closure", "joint"]


@dataclass(frozen=True)
class LegBlock:
    """Residuals of some legs at N rows of measured readings."""

    legs: tuple[Leg, ...]
    """The nominal legs."""
    platform: Platform
    known: tuple[Array, ...]
    """Readings [rad] or [m] of each leg, then its influences, (N, n_active [+ n_influences])."""
    kind: Residual
    data_rows: Index
    """Rows of the measurements, counted from 0, shape (N,)."""
    used: Mask
    """Which row serves which leg, shape (N, n_legs)."""
    sigma: Array
    """Standard deviations of the readings of all legs, shape (N, n_readings), [rad] or [m]."""
    pose_roots: Array | None = None
    """If poses are taken as measured: roots of their covariance, as twists in base axes, shape
    (N, dof, dof). Poses are unknowns otherwise."""

    @cached_property
    def widths(self) -> list[int]:
        """Number of equations of each leg at a pose."""
        if self.kind == "joint":
            return [len(leg.sensors) for leg in self.legs]
        return [self.platform.equations(leg) for leg in self.legs]

    @cached_property
    def leg_rows(self) -> list[slice]:
        """Equations of each leg among those of all at a pose."""
        return slices(self.widths)

    @cached_property
    def columns(self) -> list[slice]:
        """Parameters of each leg among the unknowns."""
        return slices([len(leg.parameters) for leg in self.legs])

    @cached_property
    def reading_columns(self) -> list[slice]:
        """Readings of each leg among those of all."""
        return slices([len(leg.sensors) for leg in self.legs])

    @property
    def n_rows(self) -> int:
        """Number of equations of all legs at a pose."""
        return self.leg_rows[-1].stop

    @property
    def n_parameters(self) -> int:
        """Number of parameters of all legs."""
        return self.columns[-1].stop

    @property
    def n_readings(self) -> int:
        """Number of readings of all legs."""
        return self.reading_columns[-1].stop

    @cached_property
    def active(self) -> Mask:
        """Equations that rows serve, shape (N, n_rows)."""
        return np.repeat(self.used, self.widths, axis=1)

    @property
    def readings(self) -> Array:
        """Readings of all legs, shape (N, n_readings), [rad] or [m]."""
        pairs = zip(self.legs, self.known, strict=True)
        return np.concatenate([known[:, : len(leg.sensors)] for leg, known in pairs], axis=1)

    @property
    def influences(self) -> dict[str, Array]:
        """Influence quantities of all legs by column, each of shape (N,)."""
        return {
            name: values
            for leg, known in zip(self.legs, self.known, strict=True)
            for name, values in zip(leg.influences, known[:, len(leg.sensors) :].T, strict=False)
        }

    @cached_property
    def quantities(self) -> dict[str, str]:
        """Names of what the columns of the noise belong to, each with its unit, m or rad."""
        names = {
            f"reading of {name}" if len(leg.sensors) == 1 else f"reading {name}": unit
            for leg in self.legs
            for name, unit in zip(leg.reading_names, leg.reading_units, strict=True)
        }
        if self.pose_roots is None:
            return names
        platform = zip(self.platform.freedoms, self.platform.units, strict=True)
        return names | {f"measured {name}": unit for name, unit in platform}

    def at(self, rows: Index) -> LegBlock:
        """Return the block at some of its rows."""
        return replace(
            self,
            known=tuple(known[rows] for known in self.known),
            data_rows=self.data_rows[rows],
            used=self.used[rows],
            sigma=self.sigma[rows],
            pose_roots=None if self.pose_roots is None else self.pose_roots[rows],
        )

    def corrected(self, shift: Array) -> LegBlock:
        """Return the block at other readings, by a shift of shape (N, n_readings)."""
        corrected = [known.copy() for known in self.known]
        for known, columns in zip(corrected, self.reading_columns, strict=True):
            known[:, : columns.stop - columns.start] += shift[:, columns]
        return replace(self, known=tuple(corrected))

    def evaluate(self, state: State) -> BlockRows:
        """Return the residuals of the legs at a state; zero where a row does not serve a leg.

        Raises:
            MeasurementError: joint residual, and a pose out of reach.
            MechanismError: a homed sensor, and a home pose out of reach.
        """
        of_legs, joints = (self._predicted if self.kind == "joint" else self._closed)(state)
        value = np.concatenate([demand.value for demand in of_legs], axis=1)
        by_pose = np.concatenate([demand.pose for demand in of_legs], axis=1)
        by_pose = np.where(self.active[:, :, None], by_pose, 0.0)
        by_parameter = block_diagonal([demand.parameter for demand in of_legs])
        return BlockRows(
            np.where(self.active, value, 0.0),
            by_pose[:, :, : None if self.pose_roots is None else 0],
            np.where(self.active[:, :, None], by_parameter, 0.0),
            self.noise_root(of_legs),
            tuple(of_legs),
            tuple(joints),
        )

    def noise_root(self, of_legs: Sequence[Demand]) -> Array:
        """Return S of what the legs demand, shape (N, n_rows, n_readings [+ dof])."""
        pairs = zip(of_legs, self.reading_columns, strict=True)
        by_reading = [demand.reading * self.sigma[:, None, columns] for demand, columns in pairs]
        noise = block_diagonal(by_reading)
        if self.pose_roots is not None:
            by_pose = np.concatenate([demand.pose for demand in of_legs], axis=1)
            noise = np.concatenate((noise, by_pose @ self.pose_roots), axis=2)
        return np.where(self.active[:, :, None], noise, 0.0)

    @cached_property
    def _alike(self) -> list[list[int]]:
        """Places of legs that are evaluated in one call."""
        forms = [LegClosure(leg, self.platform).form for leg in self.legs]
        return grouped(forms, len(self.used))

    def _closures(self, parameters: Array) -> list[LegClosure]:
        """Return the legs at parameters of all of them, shape (n_params,)."""
        pairs = zip(self.legs, self.columns, strict=True)
        return [LegClosure(leg, self.platform, parameters[columns]) for leg, columns in pairs]

    def _closed(self, state: State) -> tuple[list[Demand], list[Array]]:
        """Return what the legs demand where they close best, and their joints there."""
        closures, matrices = self._closures(state.parameters), state.matrices
        joints, of_legs = dict[int, Array](), dict[int, Demand]()
        for places in self._alike:
            legs, known = [closures[i] for i in places], stacked([self.known[i] for i in places])
            near = stacked([state.joints[i] for i in places]) if state.joints else None
            closed, nearest = nearest_closure(legs, repeated(matrices, len(legs)), known, near)
            by_leg = nearest.reshape(len(legs), len(matrices), nearest.shape[1])
            joints |= zip(places, by_leg, strict=True)
            of_legs |= zip(places, demands(legs, closed, known), strict=True)
        every = range(len(closures))
        return [of_legs[i] for i in every], [joints[i] for i in every]

    def _predicted(self, state: State) -> tuple[list[Demand], list[Array]]:
        """Return predicted less measured readings of the legs, and their joints."""
        of_legs, joints = [], []
        for closure, known in zip(self._closures(state.parameters), self.known, strict=True):
            leg = closure.leg
            measured, influences = np.split(known, [len(leg.sensors)], axis=1)
            closed = close((closure,), state.matrices, influences)
            if not closed.reached.all():
                row = int(self.data_rows[np.argmin(closed.reached)])
                raise MeasurementError(
                    f"{leg.name} does not reach measured pose {row + 1} with the parameters being "
                    "tried, so its joint residual does not exist there; use the closure residual "
                    "(--residual closure), which does"
                )
            reading = sensor_law(closure).reading(closed.joints[:, leg.active], influences)
            predicted = np.hstack((reading, influences))
            (rows,) = demands((closure,), closed.closure, predicted)
            of_legs.append(replace(rows.as_joint(), value=reading - measured))
            joints.append(closed.joints)
        return of_legs, joints


def slices(sizes: Sequence[int]) -> list[slice]:
    """Return slices of such sizes, one behind the other."""
    ends = np.cumsum(sizes).tolist()
    return [slice(end - size, end) for size, end in zip(sizes, ends, strict=True)]
