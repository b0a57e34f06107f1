"""The residual block of legs: their closures at measured readings.

The residual is Nᵀ c at a pose and a reading, passive joints chosen to minimise |c|: for a planar
dyad, the platform point's distance from the elbow less L. It exists out of reach and stays finite
near type-1 singularities. Legs that differ only in where they begin are evaluated in one call: a
call costs more than the kinematics of some hundred rows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pincal.estimation.unknowns import BlockRows, State
from pincal.kinematics.batches import block_diagonal
from pincal.kinematics.closure import LegClosure
from pincal.kinematics.derivatives import leg_demands_at
from pincal.model.leg import Leg
from pincal.model.platform import Platform
from pincal.types import Array, Index, Mask


@dataclass(frozen=True)
class LegBlock:
    """Residuals of some legs at N rows of measured readings."""

    legs: tuple[Leg, ...]
    """The nominal legs."""
    platform: Platform
    readings: Array
    """Of all legs, shape (N, n_readings), [rad] or [m]."""
    influences: Mapping[str, Array]
    """Influence quantities on which terms of the legs depend, each of shape (N,)."""
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

    @cached_property
    def known(self) -> list[Array]:
        """Readings of each leg, then its influences, shape (N, n_active [+ n_influences])."""
        return [
            np.column_stack([self.readings[:, columns], *(self.influences[name] for name in names)])
            for columns, names in zip(
                self.reading_columns, (leg.influences for leg in self.legs), strict=True
            )
        ]

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
            readings=self.readings[rows],
            influences={name: values[rows] for name, values in self.influences.items()},
            data_rows=self.data_rows[rows],
            used=self.used[rows],
            sigma=self.sigma[rows],
            pose_roots=None if self.pose_roots is None else self.pose_roots[rows],
        )

    def evaluate(self, state: State) -> BlockRows:
        """Return the residuals of the legs where they close best; zero in rows that serve none."""
        pairs = zip(self.legs, self.columns, strict=True)
        closures = [LegClosure(leg, self.platform, state.parameters[c]) for leg, c in pairs]
        placed, serves = [state.matrices] * len(closures), self.active[:, :, None]
        of_legs = leg_demands_at(closures, placed, self.known, near=state.joints)
        by_pose = np.where(serves, np.concatenate([d.pose for d in of_legs], axis=1), 0.0)
        value = np.concatenate([d.value for d in of_legs], axis=1)
        return BlockRows(
            np.where(self.active, value, 0.0),
            by_pose,
            np.where(serves, block_diagonal([d.parameter for d in of_legs]), 0.0),
            block_diagonal([d.reading for d in of_legs]),
            tuple(demand.joints for demand in of_legs),
        )


def slices(sizes: Sequence[int]) -> list[slice]:
    """Return slices of such sizes, one behind the other."""
    ends = np.cumsum(sizes).tolist()
    return [slice(end - size, end) for size, end in zip(sizes, ends, strict=True)]
