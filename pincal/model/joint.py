"""A joint of a leg: where it stands on the link before it, and how it moves."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from pincal.model.overview import one_line, triple
from pincal.model.placement import Placement

JointKind = Literal["revolute", "prismatic", "fixed"]


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

    def __repr__(self) -> str:
        axis = f" {'about' if self.turns else 'along'} {triple(self.axis)}"
        moves = (
            axis * (self.kind != "fixed"),
            f"from {self.lower:.4g} to {self.upper:.4g}, home {self.home:.4g}",
        )
        place = f"at {self.placement!r}" if self.placement != Placement() else ""
        own = moves[1] if self.kind != "fixed" else ""
        return one_line("Joint", repr(self.name), self.kind + moves[0], own, place)

    @property
    def limited(self) -> bool:
        """Whether the limits bar some position: a range of a full turn or more bars none."""
        turns = self.kind == "revolute" and self.upper - self.lower >= 2 * np.pi
        return self.kind != "fixed" and not turns

    @property
    def turns(self) -> bool:
        """Whether positions are angles."""
        return self.kind == "revolute"
