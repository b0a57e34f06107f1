"""An axis of a grid, as people write it: ``x [mm]=-500:500:10``, ``phi=0,0.4,0.6``."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.errors import WorkspaceError
from pincal.model.checks import ALIKE
from pincal.model.units import UNITS

Array = NDArray[np.float64]
_AXIS = re.compile(r"^\s*(\w+)\s*(?:\[\s*([^\[\]]*?)\s*\])?\s*=\s*(.+?)\s*$")
#: Values of one axis, samples or poses.


@dataclass(frozen=True)
class Most:
    """What is refused as too many."""

    values: int = 10_000_000
    """Of an axis, samples, poses."""
    orientations: int = 1_000_000
    positions: int = 1_000_000_000
    """Of a grid, a byte each."""


MOST = Most()
#: Units of all axes that a grid may have.
DIMENSIONS = {
    **dict.fromkeys(("x", "y", "z", "radius"), "m"),
    **dict.fromkeys(("bearing", "phi", "azimuth", "tilt", "torsion"), "rad"),
    **dict.fromkeys(("rx", "ry", "rz", "yaw", "pitch", "roll"), "rad"),
}
#: Angles that come back to where they were after a full turn.
TURNING = ("bearing", "phi", "azimuth", "torsion", "yaw", "roll")


@dataclass(frozen=True, eq=False, repr=False)
class Axis:
    """Values of one coordinate."""

    name: str
    """``x``, ``y``, ``z``; ``radius`` and ``bearing`` of a polar grid; or of an orientation."""
    values: Array
    """Increasing, shape (n,), [m] or [rad]."""

    def __post_init__(self) -> None:
        if self.name not in DIMENSIONS:
            raise WorkspaceError(f"unknown axis {self.name!r}; expected {', '.join(DIMENSIONS)}")
        values = np.array(self.values, dtype=np.float64)
        if not values.size or values.ndim != 1 or not np.isfinite(values).all():
            raise WorkspaceError(f"axis {self.name!r} is empty or has values that are not finite")
        if (np.diff(values) <= 0).any():
            raise WorkspaceError(f"axis {self.name!r}: the values must increase")
        if self.name == "radius" and values[0] < 0.0:
            raise WorkspaceError("axis 'radius' has negative values")
        values.setflags(write=False)
        object.__setattr__(self, "values", values)

    def __repr__(self) -> str:
        """Return the axis in a line."""
        first, last, unit = self.values[0], self.values[-1], DIMENSIONS[self.name]
        return f"Axis: {self.name} from {first:.6g} to {last:.6g} {unit}, {len(self.values)} values"

    @property
    def step(self) -> float:
        """Mean distance of neighbouring values; 0 if there is one value."""
        return float(np.ptp(self.values) / max(len(self.values) - 1, 1))

    @property
    def full_turn(self) -> bool:
        """Whether the values go once round, evenly."""
        turn = self.step * len(self.values)
        return self.name in TURNING and bool(np.isclose(turn, 2 * np.pi, rtol=1e-9))

    @classmethod
    def spaced(cls, name: str, low: float, high: float, step: float) -> Axis:
        """Return values from low to high; of an angle's full turn the first end only.

        Raises:
            WorkspaceError: limits reversed or not finite, or a step that does not fit.
        """
        if not np.isfinite([low, high, step]).all():
            raise WorkspaceError(f"axis {name!r}: limits and step must be finite numbers")
        if high < low:
            raise WorkspaceError(
                f"axis {name!r}: limits reversed, {low:g} to {high:g}; write the lower one first"
            )
        if step <= 0.0:
            raise WorkspaceError(f"axis {name!r}: the step is {step:g}; expected more than 0")
        if (high - low) / step > MOST.values:
            raise WorkspaceError(
                f"axis {name!r} has more than {MOST.values:,} values; a larger step"
            )
        count = int(np.floor((high - low) / step + ALIKE)) + 1
        last = low + (count - 1) * step
        if abs(high - last) <= ALIKE * step:
            last = high
        values = np.linspace(low, last, count)
        if name in TURNING and count > 1 and np.isclose(last - low, 2 * np.pi, rtol=1e-9):
            values = values[:-1]
        return cls(name, values)

    @classmethod
    def parse(cls, text: str) -> Axis:
        """Return an axis from ``NAME [UNIT]=LOW:HIGH:STEP`` or ``NAME [UNIT]=VALUE,VALUE,…``.

        Without a unit lengths are in [m] and angles in [rad].

        Raises:
            WorkspaceError: a text that is not an axis, an unknown name, a wrong unit, limits
                reversed, a step that is not positive.
        """
        match = _AXIS.match(text)
        if not match:
            raise WorkspaceError(
                f"{text!r} is not an axis; expected for example 'x [mm]=-500:500:10' "
                "(low:high:step) or 'phi=0,0.4'"
            )
        name, unit, values = match.groups()
        dimension = DIMENSIONS.get(name)
        if dimension is None:
            raise WorkspaceError(f"unknown axis {name!r}; expected {', '.join(DIMENSIONS)}")
        if unit is not None and UNITS.get(unit, ("", 0.0))[0] != dimension:
            fitting = ", ".join(u for u, (kind, _) in UNITS.items() if kind == dimension)
            raise WorkspaceError(f"axis {name!r} has unit [{unit}]; expected one of {fitting}")
        factor = UNITS[unit][1] if unit else 1.0
        try:
            if ":" in values:
                low, high, step = (float(v) * factor for v in values.split(":"))
            else:
                listed = np.array(sorted({float(v) * factor for v in values.split(",")}))
                return cls(name, listed)
        except ValueError as error:
            if isinstance(error, WorkspaceError):
                raise
            raise WorkspaceError(
                f"axis {name!r}: {values!r} is not LOW:HIGH:STEP nor VALUE,VALUE,…"
            ) from error
        return cls.spaced(name, low, high, step)
