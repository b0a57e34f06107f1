"""Linear deltas as printer firmwares hold them: one radius, and angle, arm, endstop of each tower.

Klipper (``kinematics/delta.py``) and RepRapFirmware (``LinearDeltaKinematics.cpp``) share this
model: a tower is at (R cos α, R sin α), and its carriage, at its endstop, at the height
E + √(L² − R²). Three towers lie on one circle, so every mechanism of vertical carriages and rods
to a nozzle that does not turn has this form, with the origin at the centre of that circle.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import asin, hypot, pi, sqrt
from textwrap import wrap

import numpy as np

from pincal.errors import MechanismError
from pincal.files.mechanism_folders import load_mechanism
from pincal.kinematics.closed_forms import closed_form, driven_rod, rod_geometry
from pincal.kinematics.closing import sensor_law
from pincal.kinematics.closure import LegClosure
from pincal.model.checks import EXACT, LARGEST
from pincal.model.leg import Leg
from pincal.model.mechanism import Mechanism
from pincal.model.units import UNITS
from pincal.symmetry.carry import carry
from pincal.symmetry.elements import Element, wrapped
from pincal.symmetry.generate import at_home
from pincal.types import Array

Three = tuple[float, float, float]
TOWERS = ("tower_a", "tower_b", "tower_c")
_TEMPLATE = "linear_delta"
ANGLES = (210.0, 330.0, 90.0)  # of the towers, where none are given [deg]
MM = UNITS["mm"][1]
"""[m], in which firmware writes."""
_SMALL = 5e-10  # [m] and [1], below the digits that are written
_PRINTED = 0.7  # of the delta radius: the print radius where none is known


@dataclass(frozen=True)
class DeltaPrinter:
    """Parameters of a linear delta, towers in the order of the firmware's motors."""

    radius: float
    """Delta radius R, [m]."""
    angles: Three
    """Azimuths α of the towers, [rad]."""
    arms: Three
    """Lengths L of the rods, [m]."""
    endstops: Three
    """Heights E of the nozzle over the bed's centre with each carriage at its endstop, [m]."""
    print_radius: float | None = None
    """Radius of the bed, [m]."""

    def __post_init__(self) -> None:
        printed = 1.0 if self.print_radius is None else self.print_radius
        numbers = np.array([self.radius, *self.angles, *self.arms, *self.endstops, printed])
        if not (np.abs(numbers) <= LARGEST).all():
            raise MechanismError(
                f"a parameter of the printer is not a finite number, at most {LARGEST:g} m in size"
            )
        if printed <= 0.0:
            raise MechanismError(
                f"the print radius is {1e3 * printed:g} mm; a radius above 0 is expected"
            )
        if not 0.0 < self.radius < min(self.arms):
            raise MechanismError(
                f"the delta radius is {1e3 * self.radius:g} mm and the shortest rod "
                f"{1e3 * min(self.arms):g} mm; a radius above 0 and longer rods are expected"
            )

    @property
    def firmware_lines(self) -> str:
        """The parameters in the units of firmware."""
        numbers = np.degrees(self.angles) % 360.0, 1e3 * np.array(self.arms)
        rows = zip("abc", *numbers, 1e3 * np.array(self.endstops), strict=True)
        return "\n".join(
            [f"delta radius {1e3 * self.radius:.4f} mm"]
            + [
                f"tower {n}: angle {a:.4f}°, arm {b:.4f} mm, endstop {c:.4f} mm"
                for n, a, b, c in rows
            ]
        )

    def mechanism(self, name: str, description: str = "") -> Mechanism:
        """Return the printer as a mechanism; readings are the ways down from the endstops, [m].

        Raises:
            MechanismError: towers that do not close at home.
        """
        template = load_mechanism(_TEMPLATE)
        legs = tuple(self._leg(template, i) for i in range(3))
        return Mechanism(name, template.platform, legs, description, template.labels)

    def _leg(self, template: Mechanism, index: int) -> Leg:
        first = template.legs[0]
        angle, arm, endstop = wrapped(self.angles[index]), self.arms[index], self.endstops[index]
        turn = Element(angle - first.nominal_by_name["angle"])
        carried = carry(first, turn, TOWERS[index], first.point.name)
        leg = carried.with_parameters(
            {"radius": self.radius, "angle": angle, "arm": arm, "endstop": endstop}
        )
        printed = self.print_radius or _PRINTED * self.radius
        reach = min(self.radius + printed, 0.98 * arm)
        tilt, top = asin(reach / arm), sqrt(arm**2 - self.radius**2)
        limits = {
            "carriage": (sqrt(arm**2 - reach**2), top + endstop),
            "swing": (pi / 2 - tilt, pi / 2 + tilt),
            "sway": (-tilt, tilt),
        }
        joints = tuple(
            replace(joint, lower=limits[joint.name][0], upper=limits[joint.name][1])
            if joint.name in limits
            else joint
            for joint in leg.joints
        )
        return at_home(replace(leg, joints=joints), template.platform)


@dataclass(frozen=True)
class Expressed:
    """A mechanism in a firmware's parameters, and what these cannot say."""

    printer: DeltaPrinter
    origin: tuple[float, float]
    """Where the printer's origin is in the mechanism's base frame, [m]."""
    gains: Three
    """By how much each carriage moves for a reading of one."""
    remarks: tuple[str, ...]
    """What has no counterpart in the parameters, as sentences."""


def noted(remarks: Sequence[str], mark: str) -> list[str]:
    """Return remarks as lines of comments that begin with a mark."""
    return [
        line
        for text in remarks
        for line in wrap(text, 88, initial_indent=f"{mark} Note: ", subsequent_indent=f"{mark} ")
    ]


def delta_printer(mechanism: Mechanism) -> Expressed:
    """Return a mechanism in a firmware's parameters, its legs being the towers in order.

    Read off the geometry, whatever the parameters are called.

    Raises:
        MechanismError: not a linear delta with vertical carriages, or readings that do not count
            down from endstops.
    """
    if mechanism.platform.kind != "translational" or len(mechanism.legs) != 3:
        raise MechanismError(
            f"{mechanism.name!r} is no linear delta: three carriages and a platform that moves "
            "along x, y, z are expected"
        )
    towers = np.array([_tower(LegClosure(leg, mechanism.platform)) for leg in mechanism.legs])
    points, tops, arms, gains = towers[:, :2], towers[:, 2], towers[:, 3], towers[:, 4]
    origin = _centre(points)
    around = points - origin
    radius = float(np.linalg.norm(around, axis=1).mean())
    if radius >= arms.min():
        raise MechanismError(
            f"{mechanism.name!r}: the towers are {1e3 * radius:g} mm from their centre, farther "
            "than a rod is long; a firmware cannot home such a printer"
        )
    printer = DeltaPrinter(
        radius,
        three_floats(np.arctan2(around[:, 1], around[:, 0])),
        three_floats(arms),
        three_floats(tops - np.sqrt(arms**2 - radius**2)),
    )
    x, y = (float(v) for v in origin)
    remarks = [
        f"{leg.name}: terms of its sensor have no place in a firmware"
        for leg in mechanism.legs
        for sensor in leg.sensors
        if sensor.terms
    ]
    remarks += [
        f"{leg.name}: terms of {', '.join(leg.deformed)} have no place in a firmware; it gets what "
        "they are at the reference of what they follow"
        for leg in mechanism.legs
        if leg.terms
    ]
    if hypot(x, y) > _SMALL:
        remarks.append(
            f"the printer's origin is at x = {1e3 * x:.4f}, y = {1e3 * y:.4f} mm of the "
            "mechanism's base frame: a firmware has one radius for all towers, so that its origin "
            "is the centre of their circle. Prints move by that much as a whole"
        )
    for leg, gain in zip(mechanism.legs, gains, strict=True):
        if abs(gain - 1.0) > _SMALL:
            remarks.append(
                f"{leg.name} moves {gain:.9f} mm for each mm that the firmware believes: multiply "
                f"its way per step by that (Klipper: rotation_distance; RepRapFirmware: divide the "
                "steps per mm of M92)"
            )
    return Expressed(printer, (x, y), three_floats(gains), tuple(remarks))


def _tower(closure: LegClosure) -> Array:
    """Return x, y of a tower, its carriage's height at reading 0, the rod's length, the gain.

    Positions are of the rod's upper end with the platform's point in the origin, [m].

    Raises:
        MechanismError: another kind of leg.
    """
    leg = closure.leg
    slides = leg.active == [0] and leg.moving[0].kind == "prismatic"
    if not slides or closed_form(closure) is not driven_rod:
        raise MechanismError(
            f"{leg.name} is not a carriage, a universal joint and a rod, as a linear delta's legs "
            "are"
        )
    rod = rod_geometry(closure)
    vertical = rod.frame[:, 1]
    tilt = hypot(vertical[0], vertical[1])
    if tilt > EXACT:
        raise MechanismError(
            f"{leg.name}: its carriage moves {1e3 * tilt:.4g} mrad off the vertical; firmwares "
            "have no parameter for that"
        )
    law = sensor_law(closure)
    gain = -float(vertical[2]) * law.slope[0]
    if gain <= 0.0:
        raise MechanismError(
            f"{leg.name}: its readings grow upwards; a firmware's count down from the endstop "
            "(direction -1 of the sensor)"
        )
    top = rod.centre - closure.targets(np.eye(4)[None])[0] + vertical * law.start[0]
    return np.array([*top, rod.length, gain])


def _centre(points: Array) -> Array:
    """Return the centre of the circle through three points of the plane, shape (2,).

    Raises:
        MechanismError: points in line.
    """
    chords = points[1:] - points[0]
    if abs(np.linalg.det(chords)) <= 1e-6 * float((chords**2).sum()):
        raise MechanismError("the three towers are in line; no printer has them so")
    half = ((points[1:] ** 2).sum(axis=1) - (points[0] ** 2).sum()) / 2
    return np.asarray(np.linalg.solve(chords, half))


def three_floats(values: Iterable[float]) -> Three:
    """Return three numbers, one for each tower."""
    a, b, c = (float(v) for v in values)
    return a, b, c
