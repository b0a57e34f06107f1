"""A mechanism from one leg and the elements that carry it to the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pincal.errors import MechanismError
from pincal.kinematics.closing import close
from pincal.kinematics.closure import LegClosure
from pincal.model.leg import Leg
from pincal.model.mechanism import Mechanism
from pincal.model.platform import Platform
from pincal.symmetry.carry import carry
from pincal.symmetry.elements import Element


def generate(
    name: str,
    leg: Leg,
    elements: Sequence[Element],
    platform: Platform,
    description: str = "",
    labels: Mapping[str, str] | None = None,
) -> Mechanism:
    """Return the mechanism whose legs are one carried by the elements, the identity first.

    Legs are named ``leg_1``, ``leg_2``, …; a platform point whose name ends in ``_1`` is numbered
    alike. The leg's home may be rough: all legs are closed at the platform's home pose, on the side
    (working mode) that the rough home is on. Labels say by parameter's name what it is, for people.

    Raises:
        MechanismError: a leg does not close at the home pose.
        SymmetryError: a placement whose coordinates cannot express a carried leg.
    """
    closed = at_home(leg, platform)
    legs = []
    for number, element in enumerate(elements, start=1):
        point = closed.point.name
        if point.endswith("_1"):
            point = f"{point[:-2]}_{number}"
        carried = carry(closed, element, f"leg_{number}", point)
        legs.append(at_home(carried, platform))
    return Mechanism(name, platform, tuple(legs), description, tuple((labels or {}).items()))


def at_home(leg: Leg, platform: Platform) -> Leg:
    """Return the leg with its home closed at the platform's home pose.

    Raises:
        MechanismError: it does not close there in the working mode of its rough home.
    """
    closed = close((LegClosure(leg, platform),), platform.home_pose.as_matrix())
    if not closed.reached[0]:
        raise MechanismError(
            f"{leg.name} does not reach the home pose {platform.home}; correct the home pose, the "
            "leg's lengths, or its home (which says on which side the leg bends)"
        )
    return leg.with_home(np.round(closed.joints[0], 12) + 0.0)
