"""How far what a file draws is from closing its loops: said, and refused where it is far."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from pincal.errors import MechanismError
from pincal.formats.trees.tree import Tree
from pincal.kinematics.assembly import opening
from pincal.kinematics.legs.closure import largest_size
from pincal.model.checks import ALIKE
from pincal.model.home import ROUGH
from pincal.model.leg import Leg
from pincal.model.mechanism import Mechanism


def check_drawn(tree: Tree, legs: Sequence[Leg], kind: str) -> None:
    """Raise if loops are wide open as drawn, and the file does not say where else to begin.

    Args:
        tree: What the file says.
        legs: Its legs, at home as drawn.
        kind: Of the platform.

    Raises:
        MechanismError: loops drawn open by more than a tenth of the longest leg.
    """
    if tree.homed:
        return
    gap = opening(legs, kind)
    size = largest_size(legs)
    if gap > ROUGH * size:
        raise MechanismError(
            f"{tree.source}: the loops do not close near the joint positions that the file draws: "
            f"ends that should meet are {gap:.3g} m apart, and the longest leg is {size:.3g} m. "
            "Say positions near which they close (keyframe of MJCF, 'home' of the YAML file), or "
            "look at the frames of the loops and at units (metres, radians)"
        )


def closing_in_words(tree: Tree, mechanism: Mechanism) -> tuple[str, bool]:
    """Return by how much loops are open as drawn and how far joints were moved, as sentences.

    And whether that is more than rounding.
    """
    drawn = {edge.joint.name: edge.joint.home for edge in tree.edges}
    legs = [
        replace(leg, joints=tuple(replace(j, home=drawn.get(j.name, 0.0)) for j in leg.joints))
        for leg in mechanism.legs
    ]
    gap = opening(legs, mechanism.platform.form)
    if gap <= ALIKE * largest_size(mechanism.legs):
        return f"the loops close as drawn, within {gap:.2g} m", False
    moved: dict[str, tuple[float, str]] = {}
    for joint in (one for leg in mechanism.legs for one in leg.moving if one.name in drawn):
        unit = "rad" if joint.turns else "m"
        moved[unit] = max(
            moved.get(unit, (0.0, "")), (abs(joint.home - drawn[joint.name]), joint.name)
        )
    far = " and ".join(f"{way:.3g} {unit} ({name})" for unit, (way, name) in moved.items())
    return f"as drawn the loops are open by {gap:.3g} m: joints were moved by up to {far}", True
