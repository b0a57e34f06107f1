"""In what a carried leg differs from another: places and axes, bending, limits, sensors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.kinematics.legs.closed_forms import is_line
from pincal.kinematics.legs.closure import LegClosure
from pincal.kinematics.legs.starts import home_mode
from pincal.kinematics.reach import reach_of
from pincal.model.joint import Joint
from pincal.model.leg import Leg
from pincal.model.platform import Platform
from pincal.symmetry.elements import Element, wrapped

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Difference:
    """One quantity in which two legs differ."""

    quantity: str
    deviation: float | None
    """By how much, in the unit; None where it is no number."""
    unit: str = "1"
    """m, rad or 1."""
    of_sensor: bool = False
    """Whether it is of a sensor: the legs move alike, their readings differ."""

    def exceeds(self, tolerance: float, size: float) -> bool:
        """Return whether it is more than a tolerance, relative to a size [m] for lengths."""
        scale = size if self.unit == "m" else 1.0
        return self.deviation is None or not self.deviation <= tolerance * scale


@dataclass(frozen=True)
class Traits:
    """What is read off a leg's loop; of a carried leg it follows from that of the leg."""

    mode: float
    """Working mode: sign of the determinant of the closure by its joints, at home."""
    barred: Array | None
    """Unit normals of half-spaces that bound a leg which is a line, shape (k, 3); else None."""

    @classmethod
    def of(cls, leg: Leg, platform: Platform) -> Traits:
        """Return the traits of a leg in canonical form."""
        closure = LegClosure(leg, platform)
        reach = reach_of(closure) if is_line(closure) else None
        barred = reach.normals if reach is not None and reach.exact else None
        return cls(home_mode(leg, platform), barred)

    def carried(self, leg: Leg, element: Element, platform: Platform) -> Traits:
        """Return the traits of the leg carried by an element, in canonical form.

        Columns of the closure turn by Q; a joint whose axis is turned over changes its sign.
        """
        barred = None if self.barred is None else self.barred @ element.matrix.T
        if not element.reflection:
            return Traits(self.mode, barred)
        sign = -1.0 if leg.closes == "point" or platform.space == 3 else 1.0
        for joint in leg.moving:
            along = int(np.argmax(np.abs(joint.axis)))  # the local mirror turns y over
            if (along == 1) != joint.turns:
                sign = -sign
        square = len(platform.closing(leg.closes)) == len(leg.moving) and leg.passive
        return Traits(self.mode * (sign if square else 1.0), barred)


def differences(carried: Leg, leg: Leg, own: Traits, its: Traits) -> Iterator[Difference]:
    """Yield every quantity in which a carried leg and another one differ, and by how much.

    Args:
        carried: The carried leg.
        leg: The other one.
        own: Traits of the carried leg.
        its: Of the other one.
    """
    kinds = [[joint.kind for joint in one.joints] for one in (carried, leg)]
    if kinds[0] != kinds[1]:
        yield Difference("sequence of joints", None)
        return
    if carried.parameter_names != leg.parameter_names:
        yield Difference("set of parameters", None)
        return
    for name, a, b in zip(leg.parameter_names, carried.nominal, leg.nominal, strict=True):
        unit = leg.units[name]
        off = abs(wrapped(a - b)) if unit == "rad" else abs(float(a - b))
        yield Difference(f"parameter {name!r}", off, unit)
    barred = _barred_apart(own.barred, its.barred)
    meets = (leg.joints[-1], leg.point) if leg.closes == "point" else ()  # points have no axes
    both = zip((*carried.joints, carried.point), (*leg.joints, leg.point), strict=True)
    for a, b in both:
        pointlike = b.kind == "fixed" and any(b is one for one in meets)
        yield from _places_differ(a, b, not pointlike and barred is None)
    if barred is not None:
        seen = barred if np.isfinite(barred) else None
        yield Difference(f"orientation of joint {leg.moving[0].name!r}", seen, "rad")
    elif own.mode != its.mode:
        yield Difference("working mode (the side on which the leg bends)", None)
    if carried.active != leg.active or carried.closes != leg.closes:
        yield Difference("active joint" if carried.active != leg.active else "end", None)
        return
    for index in range(len(leg.sensors)):
        yield from _sensors_differ(carried, leg, index)
    for a, b in zip(carried.moving, leg.moving, strict=True):
        if (a.limited or b.limited) and (a.kind == "prismatic" or barred is None):
            ends: list[float] = [abs(a.lower - b.lower), abs(a.upper - b.upper)]
            if a.turns and np.isfinite(ends).all():
                ends = [abs(wrapped(end)) for end in ends]
            off = max(ends)
            unit = "rad" if a.turns else "m"
            yield Difference(f"limits of joint {b.name!r}", off if np.isfinite(off) else None, unit)


def _places_differ(a: Joint, b: Joint, oriented: bool) -> Iterator[Difference]:
    """Yield by how much two joints' places differ, and if wanted their orientations."""
    shift = float(np.linalg.norm(np.subtract(a.placement.xyz, b.placement.xyz)))
    yield Difference(f"position of joint {b.name!r}", shift, "m")
    if oriented:
        turn = a.placement.origin()[:3, :3].T @ b.placement.origin()[:3, :3]
        sine = float(np.linalg.norm(turn - np.eye(3))) / 8**0.5
        off = 2.0 * float(np.arcsin(min(1.0, sine)))
        if a.kind != "fixed":
            off = max(off, float(np.linalg.norm(np.subtract(a.axis, b.axis))))
        yield Difference(f"orientation of joint {b.name!r}", off, "rad")


def _sensors_differ(carried: Leg, leg: Leg, index: int) -> Iterator[Difference]:
    """Yield by how much two legs' sensors of an index differ."""
    a, b = carried.sensors[index], leg.sensors[index]
    unit = leg.reading_units[index]

    def of(quantity: str, deviation: float | None, unit: str = "1") -> Difference:
        return Difference(quantity, deviation, unit, of_sensor=True)

    if [one.basis for one in a.terms] != [one.basis for one in b.terms]:
        yield of("terms of the sensor", None)
        return
    for one, its in zip(a.terms, b.terms, strict=True):
        values = carried.nominal_by_name[one.parameter], leg.nominal_by_name[its.parameter]
        yield of("terms of the sensor", abs(values[0] - values[1]), unit)
    if (a.form, a.direction) != (b.form, b.direction):
        yield of("form or direction of the sensor", None)
        return
    gains, offsets = zip(
        a.constants(carried.nominal_by_name), b.constants(leg.nominal_by_name), strict=True
    )
    yield of("gain of the sensor", abs(gains[0] - gains[1]))
    if a.homed != b.homed:
        yield of("zero of the sensor", None)
        return
    zeros = [0.0 if isinstance(one.zero, str) else one.zero for one in (a, b)]
    for what, (own, other) in (("offset", offsets), ("zero", zeros)):
        off = abs(wrapped(own - other) if unit == "rad" else own - other)
        yield of(f"{what} of the sensor", off, unit)


def _barred_apart(first: Array | None, second: Array | None) -> float | None:
    """Return how far apart are the directions that two legs bar which are lines, [rad].

    Such a leg is the same however its universal joint is turned about it. None if the legs are no
    lines, infinite if they bar other directions.
    """
    if first is None or second is None:
        return None
    if len(first) != len(second):
        return float("inf")
    apart = np.linalg.norm(first[:, None] - second, axis=2)
    return float(apart.min(axis=1).max()) if len(first) else 0.0
