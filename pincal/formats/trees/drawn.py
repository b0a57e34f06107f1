"""How far what a file draws is from closing its loops: said, and refused where it is far."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pincal.errors import MechanismError
from pincal.formats.trees.tree import Tree
from pincal.kinematics.assembly import opening
from pincal.kinematics.legs.closure import largest_size
from pincal.model.checks import ALIKE
from pincal.model.home import ROUGH
from pincal.model.leg import Leg
from pincal.model.mechanism import Mechanism

_WRITTEN = (r"xyz|pos|fromto", r"rpy|axis|quat|euler|axisangle|xyaxes|zaxis")
_NUMBERS = 10  # along a leg, whose digits may be cut: two across each of five joints


def slack_of(text: str) -> float:
    """Return how far digits that an XML file does not write may have moved a leg's frames.

    Half a unit in the last digit, of lengths over the largest or of directions, whichever is more,
    times the numbers along a leg: of its size, and [rad]. Numbers of less than four digits are
    taken as exact, but for right angles: 1.57 is cut.
    """
    cut = 0.0
    for kinds in _WRITTEN:
        values = " ".join(re.findall(rf"""\b(?:{kinds})\s*=\s*["']([^"']*)["']""", text)).split()
        plain = [re.sub(r"[eE].*|[-+.]", "", value).strip("0") for value in values]
        if long := [len(digits) for digits in plain if len(digits) > 3]:
            cut = max(cut, 5.0 * 10.0 ** -float(np.median(long)))
        if "rpy" in kinds:
            for value in values:
                if right := re.fullmatch(r"-?(1\.57|3\.14|4\.71|6\.28)(\d*)", value):
                    off = abs(np.remainder(float(value) + np.pi / 4, np.pi / 2) - np.pi / 4)
                    cut = max(cut, off if off < 0.1 ** (2 + len(right[2])) else 0.0)
    return _NUMBERS * cut


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
    if gap <= max(ALIKE, tree.slack) * largest_size(mechanism.legs):
        return f"the loops close as drawn, within {gap:.2g} m", False
    moved: dict[str, tuple[float, str]] = {}
    for joint in (one for leg in mechanism.legs for one in leg.moving if one.name in drawn):
        unit = "rad" if joint.turns else "m"
        moved[unit] = max(
            moved.get(unit, (0.0, "")), (abs(joint.home - drawn[joint.name]), joint.name)
        )
    far = " and ".join(f"{way:.3g} {unit} ({name})" for unit, (way, name) in moved.items())
    return f"as drawn the loops are open by {gap:.3g} m: joints were moved by up to {far}", True
