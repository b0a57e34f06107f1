"""What a calibration adds to a scene, as numbers: misses, errors, what stays open, instruments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.show.view.bodies import Body

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Misses:
    """From the measured to the predicted point of each row, after the calibration."""

    measured: Array
    """Of the platform, shape (n, 3), base frame, [m]."""
    shifts: Array
    """Predicted less measured, shape (n, 3), [m]."""
    outlying: NDArray[np.bool_]
    """Which rows are outliers, shape (n,)."""
    magnify: float
    """With which shifts are drawn."""


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors of the platform's position over the workspace, before and after, on one scale."""

    positions: Array
    """Shape (N, 3), base frame, [m]."""
    before: Array
    """Of the nominal model, shape (N,), [m]."""
    after: Array
    """To expect of the identified one, shape (N,), [m]."""

    @property
    def limits(self) -> tuple[float, float]:
        """Ends of the scale, which is one of decades, [m]."""
        both = np.concatenate((self.before, self.after))
        low, high = np.quantile(both[both > 0.0], (0.01, 0.99)).tolist()
        return low, max(high, low * 1.01)

    def shares(self, errors: Array) -> Array:
        """Return where on the scale errors are, from 0 to 1, shape (N,)."""
        low, high = np.log(self.limits)
        with np.errstate(divide="ignore"):
            return np.clip((np.log(errors) - low) / (high - low), 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class Weakest:
    """The nominal machine moved along the direction that the measurements determine least."""

    body: Body
    """At one end of that motion, the same readings commanded."""
    magnify: float
    """How many standard errors away that is."""
    named: str
    """What moves most along it."""


@dataclass(frozen=True, eq=False)
class Instrument:
    """A tracker that is known to stand somewhere."""

    at: Array
    """Shape (3,), base frame, [m]."""
    T_base_frame: Array
    """The frame of the measurements, shape (4, 4), [m]."""


@dataclass(frozen=True, eq=False)
class Station:
    """A frame that the measurements were made in, or an instrument that says where it stands."""

    name: str
    T_base_station: Array
    """Shape (4, 4), [m]; a camera looks along z."""
    sees: tuple[float, float] | None = None
    """Half width and half height of what a camera sees at a distance of 1; None if it is none."""


@dataclass(frozen=True, eq=False)
class Found:
    """All of it; None where there is none."""

    misses: Misses | None = None
    errors: Errors | None = None
    weakest: Weakest | None = None
    instrument: Instrument | None = None
    stations: tuple[Station, ...] = ()
