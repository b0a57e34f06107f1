"""An axis of a grid, as people write it: ``x [mm]=-500:500:10``, ``phi=0,0.4,0.6``."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from pincal.errors import WorkspaceError
from pincal.model.checks import ALIKE
from pincal.model.orientation import WAYS, rotation_of
from pincal.model.platform import Platform
from pincal.symmetry.elements import SAME, Element
from pincal.types import Array
from pincal.words.units import UNITS

_AXIS = re.compile(r"^\s*(\w+)\s*(?:\[\s*([^\[\]]*?)\s*\])?\s*=\s*(.+?)\s*$")


MOST = 10_000_000
"""Values of an axis, or poses, beyond which they are refused."""
_MOST_ORIENTATIONS = 1_000_000
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
        """Return values from low to high; of an angle's full turn the first end only."""
        fault = None
        if not np.isfinite([low, high, step]).all():
            fault = "limits and step must be finite numbers"
        elif high < low:
            fault = f"limits reversed, {low:g} to {high:g}; write the lower one first"
        elif step <= 0.0:
            fault = f"the step is {step:g}; expected more than 0"
        elif (high - low) / step > MOST:
            fault = f"more than {MOST:,} values; a larger step"
        if fault:
            raise WorkspaceError(f"axis {name!r}: {fault}")
        count = int(np.floor((high - low) / step + ALIKE)) + 1
        last = low + (count - 1) * step
        if abs(high - last) <= ALIKE * step:
            last = high
        values = np.linspace(low, last, count)
        if name in TURNING and count > 1 and np.isclose(last - low, 2 * np.pi, rtol=1e-9):
            values = values[:-1]
        return cls(name, values)

    @classmethod
    def parse(cls, text: str | Axis) -> Axis:
        """Return an axis, perhaps of ``NAME [UNIT]=LOW:HIGH:STEP`` or ``NAME [UNIT]=VALUE,…``.

        Raises:
            WorkspaceError: no axis, an unknown name or unit, or values that are no range.
        """
        if isinstance(text, Axis):
            return text
        match = _AXIS.match(text)
        if not match:
            raise WorkspaceError(
                f"{text!r} is not an axis; expected for example 'x [mm]=-500:500:10' "
                "(low:high:step) or 'phi=0,0.4'"
            )
        name, unit, values = match.groups()
        dimension = DIMENSIONS.get(name)
        if dimension and unit is not None and UNITS.get(unit, ("", 0.0))[0] != dimension:
            fitting = ", ".join(u for u, (kind, _) in UNITS.items() if kind == dimension)
            raise WorkspaceError(f"axis {name!r} has unit [{unit}]; expected one of {fitting}")
        factor, separator = UNITS.get(unit, ("", 1.0))[1], ":" if ":" in values else ","
        try:
            numbers = [float(value) * factor for value in values.split(separator)]
        except ValueError:
            numbers = []
        if separator == ":" and len(numbers) == 3:
            return cls.spaced(name, *numbers)
        if separator == ":" or not numbers:
            raise WorkspaceError(
                f"axis {name!r}: {values!r} is not LOW:HIGH:STEP nor VALUE,VALUE,…"
            )
        return cls(name, np.unique(numbers))


_SPATIAL = "; or ".join(", ".join(columns) for columns, unit in WAYS.values() if unit == "rad")


@dataclass(frozen=True, eq=False, repr=False)
class Orientations:
    """Distinct orientations ``R_base_platform``."""

    quaternions: Array
    """Unit quaternions, scalar last and not negative, shape (O, 4)."""

    def __repr__(self) -> str:
        largest = np.degrees(self.rotations.magnitude().max(initial=0.0))
        return f"Orientations: {len(self)}, turned by {largest:.4g}° at most"

    def __len__(self) -> int:
        return len(self.quaternions)

    @property
    def rotations(self) -> Rotation:
        """The orientations, length O."""
        return Rotation.from_quat(self.quaternions)

    @classmethod
    def from_rotations(cls, rotations: Rotation) -> Orientations:
        """Return the distinct ones of some orientations."""
        quaternions = np.atleast_2d(rotations.as_quat(canonical=True))
        rounded = quaternions.round(9) + 0.0
        leading = np.argmax(rounded[:, ::-1] != 0.0, axis=1)  # half a turn is written in two ways
        rounded *= np.sign(rounded[np.arange(len(rounded)), 3 - leading])[:, None]
        _, first = np.unique(rounded + 0.0, axis=0, return_index=True)
        return cls(quaternions[np.sort(first)])

    @classmethod
    def home(cls, platform: Platform) -> Orientations:
        """Return the orientation of the home pose alone."""
        return cls.from_rotations(platform.home_pose.rotation)

    @classmethod
    def everywhere(cls, platform: Platform) -> Orientations:
        """Return orientations all round: every 5° in a plane, every 30° in space."""
        if platform.turns == 1:
            return cls.of(platform, _round("phi", 5.0))
        if platform.turns == 3:
            tilt = Axis.spaced("tilt", 0.0, np.pi, np.radians(30.0))
            return cls.of(platform, tilt, _round("azimuth", 30.0), _round("torsion", 30.0))
        return cls.home(platform)

    @classmethod
    def of(cls, platform: Platform, *axes: str | Axis) -> Orientations:
        """Return the orientations of a grid, in one of the ways to write them.

        Axes that are not given stay at 0, but an azimuth beside a tilt goes round in steps of 10°.

        Raises:
            WorkspaceError: axes that the platform does not have, or of two ways at once.
        """
        values = {axis.name: axis.values for axis in map(Axis.parse, axes)}
        if len(values) != len(axes):
            raise WorkspaceError("an axis of orientation is given twice")
        if platform.turns == 1 and set(values) == {"phi"}:
            axis = np.eye(3)[platform.twist_rows[-1] - 3]
            return cls.from_rotations(Rotation.from_rotvec(np.outer(values["phi"], axis)))
        ways = {way: set(names) for way, (names, unit) in WAYS.items() if unit == "rad"}
        way = next((way for way, names in ways.items() if names >= set(values)), None)
        if platform.turns < 3 or way is None:
            takes = {0: "none", 1: "phi", 3: _SPATIAL}[platform.turns]
            raise WorkspaceError(
                f"orientations by {', '.join(values)}: a {platform.kind!r} platform takes {takes}"
            )
        if "tilt" in values and "azimuth" not in values:
            values["azimuth"] = _round("azimuth", 10.0).values
        lists = [values.get(name, np.zeros(1)) for name in WAYS[way][0]]
        if math.prod(map(len, lists)) > _MOST_ORIENTATIONS:
            raise WorkspaceError("more than 1,000,000 orientations; take larger steps")
        grid = np.stack(np.meshgrid(*lists, indexing="ij"), axis=-1).reshape(-1, 3)
        return cls.from_rotations(rotation_of(way, grid))

    def maps(self, element: Element, slack: float = 0.0) -> bool:
        """Return whether an element carries the set onto itself, but for slack: R → Q R Pᵀ."""
        side = -1.0 if element.reflection else 1.0
        before, after = (Rotation.from_matrix(side * Q) for Q in element.turns)
        images = (before * self.rotations * after.inv()).as_quat(canonical=True)
        return bool(
            np.isfinite(self._tree.query(images, distance_upper_bound=SAME + slack)[0]).all()
        )

    @cached_property
    def _tree(self) -> KDTree:
        upright = self.quaternions[:, 3] <= SAME  # half a turn is written in two ways
        return KDTree(np.concatenate((self.quaternions, -self.quaternions[upright])))


def _round(name: str, degrees: float) -> Axis:
    """Return an axis once round, in steps of some degrees."""
    return Axis.spaced(name, -np.pi, np.pi, np.radians(degrees))
