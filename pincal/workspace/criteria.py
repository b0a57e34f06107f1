"""Criteria of poses: orientations, reach in the working mode, joint limits, margins.

Closed forms, shells and half-spaces, decide first; the legs are closed only for poses that remain.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from pincal.errors import WorkspaceError
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.kinematics.batches import chunks
from pincal.kinematics.closed_forms import closed_form
from pincal.kinematics.closing import ClosedLegs, by_leg, close, close_legs, in_home_modes, started
from pincal.kinematics.closure import nominal_legs
from pincal.kinematics.configurations import beyond_limits
from pincal.kinematics.derivatives import nearest_closure
from pincal.kinematics.singularity import (
    can_hold,
    drive_margins,
    home_determinant,
    margins,
    platform_margin,
    rods_margin,
)
from pincal.model import WAYS, Mechanism, Platform, Poses
from pincal.model.checks import EXACT, ROUNDING, must_be, number_of, wrapped
from pincal.model.consistency import home_gap
from pincal.model.platform import rotation_of
from pincal.option import option
from pincal.symmetry.elements import SAME, Element
from pincal.types import Array, Mask
from pincal.workspace.grid import Axis

_FAR = 0.23  # default margin from type-1 singularities
_MOST_ORIENTATIONS = 1_000_000
_SETTLED = 1e-2  # largest change of joints, [rad] or [m], where Newton's method starts well
_GRIP = 1e-6  # least type-1 margin: nearer, rounding errors choose the working mode
_SPATIAL = "; or ".join(", ".join(columns) for columns, unit in WAYS.values() if unit == "rad")


@dataclass(frozen=True, eq=False, repr=False)
class Orientations:
    """Distinct orientations ``R_base_platform``."""

    quaternions: Array
    """Unit quaternions, scalar last and >= 0, shape (O, 4)."""

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
        """Return the distinct orientations among some rotations."""
        quaternions = np.atleast_2d(rotations.as_quat(canonical=True))
        rounded = quaternions.round(9) + 0.0
        leading = np.argmax(rounded[:, ::-1] != 0.0, axis=1)  # a half turn has two quaternions
        rounded *= np.sign(rounded[np.arange(len(rounded)), 3 - leading])[:, None]
        _, first = np.unique(rounded + 0.0, axis=0, return_index=True)
        return cls(quaternions[np.sort(first)])

    @classmethod
    def home(cls, platform: Platform) -> Orientations:
        """Return the orientation of the home pose alone."""
        return cls.from_rotations(platform.home_pose.rotation)

    @classmethod
    def everywhere(cls, platform: Platform) -> Orientations:
        """Return orientations over the full range: every 5° in a plane, every 30° in space."""
        if platform.turns == 1:
            return cls.of(platform, _round("phi", 5.0))
        if platform.turns == 3:
            tilt = Axis.spaced("tilt", 0.0, np.pi, np.radians(30.0))
            return cls.of(platform, tilt, _round("azimuth", 30.0), _round("torsion", 30.0))
        return cls.home(platform)

    @classmethod
    def of(cls, platform: Platform, *axes: str | Axis) -> Orientations:
        """Return the orientations of a grid of axes, all of one way to write orientations.

        Axes that are not given are 0, but an azimuth beside a tilt goes round in steps of 10°.

        Raises:
            WorkspaceError: the platform does not have the axes, or they are of different ways.
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
        """Return whether an element, R → Q R Pᵀ, carries the set onto itself within ``slack``."""
        side = -1.0 if element.reflection else 1.0
        before, after = (Rotation.from_matrix(side * Q) for Q in element.turns)
        images = (before * self.rotations * after.inv()).as_quat(canonical=True)
        return bool(
            np.isfinite(self._tree.query(images, distance_upper_bound=SAME + slack)[0]).all()
        )

    @cached_property
    def _tree(self) -> KDTree:
        upright = self.quaternions[:, 3] <= SAME  # a half turn has two quaternions
        return KDTree(np.concatenate((self.quaternions, -self.quaternions[upright])))


def _round(name: str, degrees: float) -> Axis:
    """Return an axis of a full turn in steps of some degrees."""
    return Axis.spaced(name, -np.pi, np.pi, np.radians(degrees))


@dataclass(frozen=True)
class Margins:
    """Least distances from singularities that a pose must keep, dimensionless; and tension."""

    type1: float | None = option(
        None,
        "Least distance from type-1 singularities, a dyad's elbow sine [default: 0.23, or half of "
        "home's where that is nearer].",
        name="margin_type1",
    )
    type2: float | None = option(
        None,
        "Least distance from type-2 singularities [default: 0.2, at most half of home's].",
        name="margin_type2",
    )
    """Least determinant of the legs' unit constraint lines, positive at home; it is far smaller for
    hexapods than for planar mechanisms. Minus infinity allows poses on both sides."""

    tension: float | None = option(
        None,
        "Least tension at which every cable can be kept [N; default: the mechanism's].",
        name="margin_tension",
    )

    def __post_init__(self) -> None:
        for name, value in (("type-1", self.type1), ("type-2", self.type2)):
            margin = (
                0.0 if value is None else number_of(value, f"the {name} margin", WorkspaceError)
            )
            if not 0.0 <= margin < 1.0 and (name, margin) != ("type-2", -np.inf):
                raise WorkspaceError(f"the {name} margin is {margin:g}; expected 0 to 1")

    @classmethod
    def none(cls) -> Margins:
        """Return margins that only ask for reach in the working mode and within joint limits."""
        return cls(0.0, -np.inf)

    def least_type1(self, mechanism: Mechanism) -> float:
        """Return the type-1 margin for a mechanism."""
        if self.type1 is not None:
            return self.type1
        at_home = float(margins(mechanism, [mechanism.platform.home]).type1.min())
        return 0.5 * at_home if at_home < _FAR else _FAR

    def least_type2(self, mechanism: Mechanism) -> float:
        """Return the type-2 margin for a mechanism."""
        if self.type2 is not None:
            return self.type2
        return min(0.2, 0.5 * abs(home_determinant(mechanism)))


def _check_stiff(mechanism: Mechanism) -> None:
    """Raise WorkspaceError if the legs hold the platform nowhere, or not at home."""
    rows, dof = mechanism.constraints, mechanism.platform.dof
    if rows < dof and not mechanism.by_readings:
        raise WorkspaceError(
            f"the legs of {mechanism.name!r} have {rows} equations, too few for the {dof} "
            "freedoms of its platform: they hold it nowhere. Add legs, or sensors on further "
            "joints, or ask for reach alone (--no-margins)"
        )
    if abs(home_determinant(mechanism)) < EXACT:
        raise WorkspaceError(
            f"the home pose of {mechanism.name!r} is at a type-2 singularity, so the side of the "
            "workspace is not known; move home, or count poses on both sides (--no-margins)"
        )


class Criteria:
    """Test of poses: whether a mechanism reaches them within limits and margins (they count)."""

    def __init__(self, mechanism: Mechanism, least: Margins | None = None) -> None:
        self.mechanism = mechanism
        self.least = as_margins(least)
        if self.least.tension is not None and mechanism.cables is None:
            raise WorkspaceError(f"{mechanism.name!r} has no 'cables' in its mechanism.yaml")
        self.type1 = self.least.least_type1(mechanism)
        """Margin from type-1 singularities."""
        self._type2 = self.least.least_type2(mechanism)
        if self._type2 > -np.inf:
            _check_stiff(mechanism)
        self._legs = nominal_legs(mechanism)
        forms = [form for leg in self._legs if (form := closed_form(leg))]
        self.reaches = tuple(form.reach(self.type1) for form in forms)
        self._searched = [leg for leg in self._legs if not closed_form(leg)][:-1]
        self._pulls = mechanism.cables is not None and self._type2 > -np.inf
        exact = len(forms) == len(self._legs) and all(reach.exact for reach in self.reaches)
        self._exact = exact and not self._pulls
        self.in_closed_form = self._type2 == -np.inf and self._exact
        """Whether the closed forms alone decide every pose."""

    def __call__(self, matrices: Array) -> Mask:
        """Return the mask, shape (N,), of the poses T_base_platform, (N, 4, 4), that count."""
        inside = np.ones(len(matrices), dtype=bool)
        for reach in self.reaches:
            inside &= reach.holds(matrices)
        rows = np.arange(0) if self.in_closed_form else np.flatnonzero(inside)
        for part in (rows[chunk] for chunk in chunks(len(rows))):  # poses that closed forms allow
            margin = rods_margin(self.mechanism, matrices[part]) if self._exact else None
            if margin is not None:
                inside[part] = margin >= self._type2 - ROUNDING
                continue
            inside[part] = False
            for leg in self._searched:  # poses out of a leg's reach need no further search
                part = part[close((leg,), matrices[part]).reached]
            inside[part] = self._counted(close_legs(self._legs, matrices[part]))
        return inside

    def at_readings(self, poses: Array, readings: Array) -> Mask:
        """Return the mask of configurations that count: poses (N, dof), readings (N, n_readings).

        Closures may be as open as they are at home, where digits cut in a file can open them.
        """
        platform, closed = self.mechanism.platform, []
        matrices = platform.matrices(poses)
        for place, leg in enumerate(self._legs):
            known = self.mechanism.known(place, readings, None)
            start = started((leg,), matrices, known)
            closure, joints = nearest_closure((leg,), matrices, known, start)
            tolerance = 10.0 * max(home_gap(leg.leg, platform)) + EXACT * leg.size
            near = (np.abs(closure.gap).max(axis=1) <= tolerance) & in_home_modes((leg,), closure)
            near &= np.abs(wrapped(start - joints)).max(axis=1) <= _SETTLED  # led there from home
            closed.append(([place], ClosedLegs(joints[:, : len(leg.leg.moving)], near, closure)))
        return self._counted(closed)

    def _counted(self, closed: Sequence[tuple[list[int], ClosedLegs]]) -> Mask:
        """Return the mask of the poses that count, from the legs closed at them."""
        with np.errstate(invalid="ignore"):
            inside = np.all(by_leg(closed, lambda legs: legs.reached), axis=0)
            joints = by_leg(closed, lambda legs: legs.joints)
            for leg, positions in zip(self._legs, joints, strict=True):
                inside &= ~beyond_limits(leg.leg, positions).any(axis=1)
            inside &= (drive_margins(closed) >= max(self.type1 - ROUNDING, _GRIP)).all(axis=1)
            if self._type2 > -np.inf:
                lines = by_leg(closed, lambda legs: legs.closure.constraint_by_pose)
                inside &= platform_margin(self.mechanism, lines) >= self._type2 - ROUNDING
            if self._pulls and inside.any():
                drives = by_leg(closed, lambda legs: legs.closure.drive)
                by_length = [(b / d)[inside] for b, d in zip(lines, drives, strict=True)]
                matrices = closed[0][1].closure.matrices[: len(inside)][inside]
                inside[inside] = can_hold(self.mechanism, matrices, by_length, self.least.tension)
        return inside


def as_margins(least: Margins | None) -> Margins:
    """Return the margins, or the default ones for None."""
    return must_be(Margins() if least is None else least, Margins, "margins", WorkspaceError)


@lru_cache(maxsize=16)
def criteria_of(mechanism: Mechanism, least: Margins) -> Criteria:
    """Return the criteria of a mechanism, cached."""
    return Criteria(mechanism, least)


def refuse_readings(mechanism: Mechanism) -> None:
    """Raise WorkspaceError if poses do not determine readings: no position can then be tested."""
    if mechanism.by_readings:
        raise WorkspaceError(
            f"poses of {mechanism.name!r} follow from readings and fill no region of positions and "
            "orientations that could be tested; 'pincal workspace' without --kind samples them"
        )


def in_workspace(mechanism: GivenMechanism, poses: Poses, least: Margins | None = None) -> Mask:
    """Return the mask, shape (N,), of the poses that are in the workspace."""
    mechanism = as_mechanism(mechanism)
    return criteria_of(mechanism, as_margins(least))(mechanism.platform.matrices(poses))
