"""A joint of a leg, what it follows, and an end: where joints meet the platform or each other."""

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
    """Gears: a joint's position is ratio times that of another one, plus an offset.

    >>> import pincal
    >>> pincal.Joint("elbow", "revolute", follows=pincal.Follows("shoulder", -2.0))
    Joint('elbow', revolute about (0, 0, 1), as 'shoulder' times -2)
    """

    joint: str
    """Name of the joint that is followed, which moves on its own."""
    ratio: float = 1.0
    offset: float = 0.0
    """[rad] or [m]."""


@dataclass(frozen=True)
class Joint:
    """One joint of a leg: a placement on the parent link, then a motion about or along an axis."""

    name: str
    kind: JointKind
    placement: Placement = field(default_factory=Placement)
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Unit axis in the joint's own frame; no meaning where fixed."""
    lower: float = -2 * np.pi
    upper: float = 2 * np.pi
    """Limits, [rad] or [m]."""
    home: float = 0.0
    """Position in the home configuration, [rad] or [m]; fixes the working mode."""
    mass: float = 0.0
    """Of the link behind the joint, [kg]."""
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Of that mass, in the joint's own frame, [m]."""
    parent: str | None = None
    """Joint of the leg whose link carries this one: the one before if not given, "" the base."""
    follows: Follows | None = None
    """Joint of the leg that it moves with, if it does not move on its own; then it has no home."""
    ratio: str = ""
    """Parameter that is the ratio of what it follows; empty if that is a constant."""

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
        """Whether the limits bar some position: a range of a full turn or more bars none."""
        turns = self.kind == "revolute" and self.upper - self.lower >= 2 * np.pi
        return self.kind != "fixed" and not turns

    @property
    def turns(self) -> bool:
        """Whether positions are angles."""
        return self.kind == "revolute"

    @property
    def leader(self) -> Follows:
        """What its position is, by that of a joint which moves on its own: its own, or another."""
        return self.follows or Follows(self.name)

    def position(self, moving: Mapping[str, Any]) -> Any:
        """Return its position, by those of joints that move on their own, of any shape."""
        return self.leader.ratio * moving[self.leader.joint] + self.leader.offset

    def fixed_at(self, position: float) -> Joint:
        """Return the joint fixed at a position, its parameters where they are."""
        placement = self.placement
        if position:
            origin = placement.origin() @ self.motion(np.array([position]))[0]
            placement = replace(placement_of(origin), coordinates=placement.coordinates)
        still = Joint(self.name, "fixed", placement, parent=self.parent)
        return replace(still, mass=self.mass, centre=self.centre)

    def motion(self, positions: Array) -> Array:
        """Return its motion by its positions, shape (N,) to (N, 4, 4)."""
        motion = np.tile(np.eye(4), (len(positions), 1, 1))
        along = np.multiply.outer(positions, self.axis)
        if self.kind == "prismatic":
            motion[:, :3, 3] = along
        else:
            motion[:, :3, :3] = Rotation.from_rotvec(along).as_matrix()
        return motion


@dataclass(frozen=True)
class End:
    """Where a leg meets the platform, or itself: a loop within it.

    >>> import pincal
    >>> pincal.End("coupler_tip", "hook", ("x", "y")).frames
    ('coupler_tip', 'hook')
    """

    tip: str
    """The joint whose frame it is."""
    meets: Joint | str
    """Platform point, a fixed joint from the platform frame; or a joint of the leg, whose frame is
    met."""
    closes: Closing | tuple[str, ...] = "point"
    """Whether origins meet or whole frames; of a loop within also some rows of a twist, as of
    ``x, y, z, rx, ry, rz`` in the frame that is met: a planar loop closes x and y across z."""

    @property
    def point(self) -> Joint | None:
        """The platform point, if the platform is met."""
        return None if isinstance(self.meets, str) else self.meets

    @property
    def frames(self) -> tuple[str, ...]:
        """The joints of the leg whose frames meet: one, or of a loop within it two."""
        return (self.tip, self.meets) if isinstance(self.meets, str) else (self.tip,)

    def renamed(self, names: Mapping[str, str]) -> End:
        """Return the end at joints of other names."""
        meets = names[self.meets] if isinstance(self.meets, str) else self.meets
        return replace(self, tip=names[self.tip], meets=meets)

    def moved(self, move: Callable[[Joint], Joint]) -> End:
        """Return the end with its platform point moved, if it meets one."""
        return self if isinstance(self.meets, str) else replace(self, meets=move(self.meets))

    @property
    def rows(self) -> tuple[int, ...]:
        """Rows of a twist in which it closes, in space."""
        if isinstance(self.closes, str):
            return (0, 1, 2) if self.closes == "point" else (0, 1, 2, 3, 4, 5)
        return tuple(TWIST.index(name) for name in self.closes)
