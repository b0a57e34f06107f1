"""What weighs on a mechanism: its platform and what that carries; links say their own masses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pincal.errors import MechanismError

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Load:
    """The weight of platform and payload, on which terms may depend (``of="load"``).

    Example:
        >>> import pincal
        >>> tool = pincal.Load(mass=2.5, centre=(0.0, 0.0, -0.05))
        >>> tool.gravity
        (0.0, 0.0, -9.81)
    """

    mass: float = 0.0
    """Of platform and payload, [kg]."""
    centre: Triple = (0.0, 0.0, 0.0)
    """Of that mass, in the platform's frame, [m]."""
    gravity: Triple = (0.0, 0.0, -9.81)
    """Acceleration in the base's frame, [m/s²]."""
    drawn: tuple[tuple[str, float], ...] = ()
    """Parameters of the machine whose loads these are, by id: those of the drawing, so that loads
    of a row are the same before and after calibration. The mechanism's own if empty."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.mass < np.inf:
            raise MechanismError(f"the load's mass is {self.mass!r}; expected 0 or more [kg]")
        for name in ("centre", "gravity"):
            if len(values := getattr(self, name)) != 3 or not np.isfinite(values).all():
                raise MechanismError(f"the load's {name} is {values!r}; expected three numbers")
