"""Which elements of a mechanism's group map the positions and orientations that are asked."""

from __future__ import annotations

from itertools import product

import numpy as np

from pincal.errors import WorkspaceError
from pincal.kinematics.singularity import margins
from pincal.model.mechanism import Mechanism
from pincal.symmetry.elements import Element, Isometry
from pincal.workspace.criteria import Margins
from pincal.workspace.orientations import Orientations
from pincal.workspace.positions import Positions


def keep_side(
    mechanism: Mechanism, group: tuple[Element, ...], least: Margins
) -> tuple[Element, ...]:
    """Return the elements that keep home on its side of type-2 singularities.

    An element that permutes legs oddly turns the determinant's sign over, which the margin
    looks at, unless home is where it was.
    """
    platform = mechanism.platform
    if least.least_type2(mechanism) == -np.inf:
        return group
    home = np.array([platform.home])
    images = np.concatenate([element.poses(platform, home) for element in group])
    with np.errstate(invalid="ignore"):
        same = margins(mechanism, images).type2 > 0.0
    return tuple(element for element, ok in zip(group, same, strict=True) if ok)


def usable(
    group: tuple[Element, ...], positions: Positions, asked: Orientations
) -> tuple[Element, ...]:
    """Return the elements of a group that map positions and orientations onto themselves.

    Raises:
        WorkspaceError: they are no group, so that orbits would not be what they stand for.
    """
    turns = asked.rotations.as_matrix()
    found = []
    for element in group:
        move = element.positions(turns)
        if move is not None and asked.maps(element) and positions.carrier(move):
            found.append(element)
    for first, second in product(found, found):
        if not any(first.after(second).equals(one) for one in found):
            raise WorkspaceError(
                f"the elements that map these positions onto themselves are no group: {first} "
                f"after {second} is missing. Compute all positions (symmetry=False, --no-symmetry)"
            )
    return tuple(found)


def moves_of(elements: tuple[Element, ...], asked: Orientations) -> tuple[Isometry, ...]:
    """Return what elements do to positions in all of some orientations."""
    turns = asked.rotations.as_matrix()
    return tuple(move for element in elements if (move := element.positions(turns)) is not None)
