"""What keeps elements that leg points suggest out of a mechanism's group, by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pincal.errors import SymmetryError
from pincal.model.leg import Leg
from pincal.model.mechanism import Mechanism
from pincal.symmetry.carry import canonical, carry
from pincal.symmetry.elements import Element, Isometry
from pincal.symmetry.fits import NEARLY, Fits, suggested
from pincal.symmetry.groups import exact, largest_closed, place_of, product_table
from pincal.words.numbers import POSES, amount, listed

HOME = "home pose"
HOME_MOVES = "the home pose, from which sensors count, is carried elsewhere"


@dataclass(frozen=True)
class Break:
    """What keeps an element out of the group: the first quantity that differs."""

    element: Element
    leg: str
    """The leg onto which another one should have been carried."""
    quantity: str
    deviation: float | None = None
    """By how much the quantity differs, in the unit; None where it is no number."""
    unit: str = "1"
    """m, rad or 1."""

    def __str__(self) -> str:
        """Return the break as a sentence."""
        return no_symmetries([self])[0]


def no_symmetries(breaks: Sequence[Break]) -> list[str]:
    """Return sentences that say what keeps elements out of a group, one for each reason."""
    by_reason: dict[str, list[Break]] = {}
    for broken in breaks:
        amount_text = (
            ""
            if broken.deviation is None
            else f", by {amount(broken.deviation, broken.unit, 4, POSES)}"
        )
        by_reason.setdefault(f"{broken.quantity}{amount_text}", []).append(broken)
    sentences = []
    for reason, breaks_alike in by_reason.items():
        elements = listed(dict.fromkeys(str(broken.element) for broken in breaks_alike))
        legs = list(dict.fromkeys(broken.leg for broken in breaks_alike))
        differ = f"differ{'s' * (len(legs) == 1)} from what is carried there in {reason}"
        why = HOME_MOVES if breaks_alike[0].quantity == HOME else f"{listed(legs)} {differ}"
        sentences.append(f"{elements}: {why}")
    return sentences


def breaks_of(
    mechanism: Mechanism, group: Sequence[Element], tolerance: float, readings: bool
) -> tuple[Break, ...]:
    """Return why elements that leg points suggest are not of a group.

    Args:
        mechanism: The mechanism.
        group: Elements of its group.
        tolerance: Within which it was found.
        readings: Whether sensors were compared.
    """
    fits = Fits(mechanism, readings)
    meant = _meant(fits, suggested(mechanism))
    legs = [canonical(leg) for leg in mechanism.legs]
    broken_elements = []
    for element in sorted(meant, key=place_of):
        if any(np.abs(element.matrix - member.matrix).max() < NEARLY for member in group):
            continue
        turned_over = fits.points.mechanism.platform.space == 3 and element.matrix[2, 2] < 0.0
        if turned_over and fits.home_moves(element) > NEARLY * fits.points.size:
            continue  # a machine upside down is not what was meant
        if broken := _first_break(fits, legs, element, tolerance):
            broken_elements.append(broken)
    return tuple(broken_elements)


def _meant(fits: Fits, elements: Sequence[Element]) -> list[Element]:
    """Return a group that leg points suggest, with exact isometries.

    About the base's z axis as it is drawn if that is nearly as good: a fit spreads what one leg is
    off over all of them.
    """
    from scipy.optimize import linear_sum_assignment  # slow to load: when needed

    labels = [tuple(linear_sum_assignment(fits.points.distances(e))[1].tolist()) for e in elements]
    closed = [elements[i] for i in largest_closed(product_table(elements, labels))]
    fitted = exact(closed, fits.centres, fits.points.size)
    drawn = [_about_z(element) for element in fitted]
    if all(element is not None for element in drawn):
        errors = [
            max(fits.points.distances(e).min(axis=1).max() for e in version if e is not None)
            for version in (drawn, fitted)
        ]
        if errors[0] <= len(fits.legs) * errors[1] + 1e-9:
            return [element for element in drawn if element is not None]
    return fitted


def _about_z(element: Element) -> Element | None:
    """Return the element about the base's z axis that is near one, or None if none is."""
    Q = element.matrix
    side = np.sign(np.linalg.det(Q[:2, :2]))
    turn = Element(float(np.arctan2(Q[1, 0], Q[0, 0])), bool(side < 0.0)).matrix.copy()
    turn[2, 2] = np.sign(Q[2, 2])
    if (
        max(np.linalg.norm(turn - isometry.Q) for isometry in (element.base, element.platform))
        > NEARLY
    ):
        return None
    near = Isometry.of(turn, np.zeros(3))
    return Element.of(near, near)


def _first_break(fits: Fits, legs: list[Leg], element: Element, tolerance: float) -> Break | None:
    """Return what breaks an element first, by the names of parameters where they can say it."""
    moved = fits.home_moves(element)
    distances = fits.points.distances(element)
    for index, leg in enumerate(legs):
        homed = fits.readings and any(sensor.homed for sensor in leg.sensors)
        if homed and moved > tolerance * max(1.0, fits.points.size):
            return Break(element, leg.name, HOME)
        near = [
            i
            for i in np.argsort(distances[index])
            if distances[index, i] <= distances[index].min() + 1e-6
        ]
        first: Break | None = None
        for image in near:
            broken = _leg_break(fits, (leg, legs[image]), index, int(image), tolerance, element)
            if broken is None:
                first = None
                break
            first = first or broken
        if first is not None:
            return first
    return None


def _leg_break(
    fits: Fits,
    legs: tuple[Leg, Leg],
    index: int,
    image: int,
    tolerance: float,
    element: Element,
) -> Break | None:
    """Return the first quantity in which a carried leg differs from another one."""
    size = fits.points.size
    pairs = [(fits.legs[index], fits.legs[image])]
    try:
        named = carry(legs[0], element, legs[0].name, legs[0].point.name)
        pairs = [(named, legs[1])]
    except SymmetryError:  # its coordinates cannot say it
        pairs = [(carry(pairs[0][0], element, "leg", "point"), pairs[0][1])]
    traits = fits.carried_traits(index, element)
    for carried, leg in pairs:
        for difference in fits.differences(carried, leg, traits, image):
            if difference.exceeds(tolerance, size):
                return Break(
                    element,
                    legs[1].name,
                    difference.quantity,
                    difference.deviation,
                    difference.unit,
                )
    return None
