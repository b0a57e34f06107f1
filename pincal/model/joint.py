"""Joints of a leg, gears between them, and ends, where a leg meets the platform or itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from pincal.model.checks import one_line, triple
from pincal.model.placement import Placement, placement_of
from pincal.model.platform import TWIST
from pincal.types import Array

JointKind = Literal["revolute", "prismatic", "fixed"]
Closing = Literal["point", "frame"]


class Follows(NamedTuple):
    """Gear: the joint's position is ``ratio`` times another joint's position, plus ``offset``.

    >>> import pincal
    >>> pincal.Joint("elbow", "revolute", follows=pincal.Follows("shoulder", -2.0))
    Joint('elbow', revolute about (0, 0, 1), as 'shoulder' times -2)
    """

    joint: str
    """Name of the joint that is followed; it must move on its own."""
    ratio: float = 1.0
    offset: float = 0.0
    """Position of the follower while the followed joint is at zero, [rad] or [m]."""


@dataclass(frozen=True)
class Joint:
    """One joint of a leg: a placement on the parent link, then a motion about or along an axis."""

    name: str
    kind: JointKind
    placement: Placement = field(default_factory=Placement)
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Unit axis in the joint's own frame; a fixed joint ignores it."""
    lower: float = -2 * np.pi
    upper: float = 2 * np.pi
    """Limits of the position, [rad] or [m]."""
    home: float = 0.0
    """Position in the home configuration, [rad] or [m]; fixes the working mode."""
    mass: float = 0.0
    """Mass of the link that the joint carries, [kg]."""
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Centre of that mass, in the joint's own frame, [m]."""
    parent: str | None = None
    """Name of the joint whose link carries this joint: by default the joint before; "" the base."""
    follows: Follows | None = None
    """Gear to another joint, if the joint does not move on its own; ``home`` is then ignored."""
    ratio: str = ""
    """Name of the parameter that is the gear's ratio; empty if the ratio is a constant."""

    def __repr__(self) -> str:
        place = f"at {self.placement!r}" if self.placement != Placement() else ""
        if self.kind == "fixed":
            return one_line("Joint", repr(self.name), self.kind, place)
        motion = f"{self.kind} {'about' if self.turns else 'along'} {triple(self.axis)}"
        limits = f"from {self.lower:.4g} to {self.upper:.4g}, home {self.home:.4g}"
        if self.follows:
            limits = f"as {self.follows.joint!r} times {self.follows.ratio:.4g}"
        return one_line("Joint", repr(self.name), motion, limits, place)

    @property
    def limited(self) -> bool:
        """Whether the limits exclude a position: a revolute range of a full turn excludes none."""
        turns = self.kind == "revolute" and self.upper - self.lower >= 2 * np.pi
        return self.kind != "fixed" and not turns

    @property
    def turns(self) -> bool:
        """Whether the joint is revolute: its positions are angles."""
        return self.kind == "revolute"

    @property
    def leader(self) -> Follows:
        """The gear to the joint that moves this one; a joint that moves on its own leads itself."""
        return self.follows or Follows(self.name)

    def position(self, moving: Mapping[str, Any]) -> Any:
        """Return the joint's position; ``moving`` has positions, of any shape, by name of joint."""
        return self.leader.ratio * moving[self.leader.joint] + self.leader.offset

    def fixed_at(self, position: float) -> Joint:
        """Return the joint fixed at a position, [rad] or [m]; its coordinates are kept."""
        placement = self.placement
        if position:
            origin = placement.origin() @ self.motion(np.array([position]))[0]
            placement = replace(placement_of(origin), coordinates=placement.coordinates)
        still = Joint(self.name, "fixed", placement, parent=self.parent)
        return replace(still, mass=self.mass, centre=self.centre)

    def motion(self, positions: Array) -> Array:
        """Return the joint's displacements at positions, shape (N,), as matrices (N, 4, 4)."""
        motion = np.tile(np.eye(4), (len(positions), 1, 1))
        along = np.multiply.outer(positions, self.axis)
        if self.kind == "prismatic":
            motion[:, :3, 3] = along
        else:
            motion[:, :3, :3] = Rotation.from_rotvec(along).as_matrix()
        return motion


@dataclass(frozen=True)
class End:
    """Place where a leg meets the platform, or itself in a loop within the leg.

    >>> import pincal
    >>> pincal.End("coupler_tip", "hook", ("x", "y")).frames
    ('coupler_tip', 'hook')
    """

    tip: str
    """Name of the joint whose frame, the tip, meets the other frame."""
    meets: Joint | str
    """The other frame: a platform point, as a fixed joint from the platform frame, or the name of
    a joint of the leg."""
    closes: Closing | tuple[str, ...] = "point"
    """Whether the origins meet or the whole frames. A loop within the leg may also name the rows of
    ``x, y, z, rx, ry, rz`` that close, in the frame that is met: a planar loop closes x and y."""

    @property
    def point(self) -> Joint | None:
        """The platform point that the end meets; None if it closes a loop within the leg."""
        return None if isinstance(self.meets, str) else self.meets

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of the joints whose frames meet: one at the platform, two in a loop within."""
        return (self.tip, self.meets) if isinstance(self.meets, str) else (self.tip,)

    def renamed(self, names: Mapping[str, str]) -> End:
        """Return the end after its joints were renamed, old names to new ones."""
        meets = names[self.meets] if isinstance(self.meets, str) else self.meets
        return replace(self, tip=names[self.tip], meets=meets)

    def moved(self, move: Callable[[Joint], Joint]) -> End:
        """Return the end with its platform point moved, if it meets one."""
        return self if isinstance(self.meets, str) else replace(self, meets=move(self.meets))

    @property
    def rows(self) -> tuple[int, ...]:
        """Indices, in (x, y, z, rx, ry, rz), of the rows that the end closes in space."""
        if isinstance(self.closes, str):
            return (0, 1, 2) if self.closes == "point" else (0, 1, 2, 3, 4, 5)
        return tuple(TWIST.index(name) for name in self.closes)
