"""Sets of orientations over which a workspace asks: one, a range, or all of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from pincal.errors import WorkspaceError
from pincal.model.orientation import WAYS, rotation_of
from pincal.model.platform import Platform
from pincal.symmetry.elements import SAME, Element
from pincal.workspace.axes import MOST, Axis

Array = NDArray[np.float64]
_PLANE_STEP = np.radians(5.0)
_SPACE_STEP = np.radians(30.0)
_SPATIAL = "; or ".join(", ".join(columns) for columns, unit in WAYS.values() if unit == "rad")


@dataclass(frozen=True, eq=False, repr=False)
class Orientations:
    """Distinct orientations ``R_base_platform``."""

    quaternions: Array
    """Unit quaternions, scalar last and not negative, shape (O, 4)."""

    def __repr__(self) -> str:
        """Return the set in a line."""
        most = np.degrees(self.rotations.magnitude().max(initial=0.0))
        return f"Orientations: {len(self)}, turned by {most:.4g}° at most"

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
            return cls.of(platform, _round("phi", _PLANE_STEP))
        if platform.turns == 3:
            tilt = Axis.spaced("tilt", 0.0, np.pi, _SPACE_STEP)
            around = [_round(name, _SPACE_STEP) for name in ("azimuth", "torsion")]
            return cls.of(platform, tilt, *around)
        return cls.home(platform)

    @classmethod
    def of(cls, platform: Platform, *axes: str | Axis) -> Orientations:
        """Return the orientations of a grid, in one of the ways to write them.

        Axes that are not given stay at 0, but an azimuth beside a tilt goes round in steps
        of 10°.

        Raises:
            WorkspaceError: axes that the platform does not have, or of two ways at once.
        """
        parsed = [Axis.parse(axis) if isinstance(axis, str) else axis for axis in axes]
        values = {axis.name: axis.values for axis in parsed}
        if len(values) != len(parsed):
            raise WorkspaceError("an axis of orientation is given twice")
        if platform.turns == 1 and set(values) == {"phi"}:
            axis = np.eye(3)[platform.twist_rows[-1] - 3]
            return cls.from_rotations(Rotation.from_rotvec(np.outer(values["phi"], axis)))
        ways = {w: c for w, (c, unit) in WAYS.items() if unit == "rad" and set(values) <= set(c)}
        if platform.turns < 3 or not ways:
            wanted = {0: "none", 1: "phi", 3: _SPATIAL}[platform.turns]
            raise WorkspaceError(
                f"orientations by {', '.join(values)}: a {platform.kind!r} platform takes {wanted}"
            )
        way, columns = next(iter(ways.items()))
        if "tilt" in values and "azimuth" not in values:
            values["azimuth"] = _round("azimuth", np.radians(10.0)).values
        lists = [values.get(name, np.zeros(1)) for name in columns]
        if math.prod(len(v) for v in lists) > MOST.orientations:
            raise WorkspaceError(f"more than {MOST.orientations:,} orientations; take larger steps")
        grid = np.stack(np.meshgrid(*lists, indexing="ij"), axis=-1).reshape(-1, 3)
        return cls.from_rotations(rotation_of(way, grid))

    def maps(self, element: Element) -> bool:
        """Return whether an element carries the set onto itself: R → Q R Pᵀ."""
        side = -1.0 if element.reflection else 1.0
        before, after = (
            Rotation.from_matrix(side * by.Q) for by in (element.base, element.platform)
        )
        every = self.rotations
        some = every[:: max(1, len(self) // 64)]
        return all(self._has(before * part * after.inv()) for part in (some, every))

    def _has(self, rotations: Rotation) -> bool:
        images = rotations.as_quat(canonical=True)
        away, _ = self._tree.query(images, distance_upper_bound=SAME)
        return bool(np.isfinite(away).all())

    @cached_property
    def _tree(self) -> KDTree:
        upright = self.quaternions[:, 3] <= SAME  # half a turn is written in two ways
        return KDTree(np.concatenate((self.quaternions, -self.quaternions[upright])))


def _round(name: str, step: float) -> Axis:
    """Return an axis once round."""
    return Axis.spaced(name, -np.pi, np.pi, step)
