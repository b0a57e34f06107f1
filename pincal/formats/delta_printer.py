"""Linear deltas with the parameters of printer firmwares: radius, and towers' angle, arm, endstop.

Klipper (``kinematics/delta.py``) and RepRapFirmware (``LinearDeltaKinematics.cpp``) share this
model: a tower is at (R cos α, R sin α), and its carriage, at its endstop, at the height
E + √(L² − R²). Three towers lie on one circle, so every mechanism of vertical carriages and rods
to a nozzle that does not turn has this form, with the origin at the centre of that circle.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import asin, hypot, pi, sqrt

import numpy as np

from pincal.errors import MechanismError
from pincal.files.mechanism_folders import load_mechanism
from pincal.kinematics.closed_forms import closed_form
from pincal.kinematics.closing import sensor_law
from pincal.kinematics.closure import LegClosure
from pincal.model import Mechanism
from pincal.model.checks import EXACT, LARGEST
from pincal.symmetry.carry import at_home, carry
from pincal.symmetry.elements import Element, wrapped
from pincal.types import Array

TOWERS = ("tower_a", "tower_b", "tower_c")
ANGLES = (210.0, 330.0, 90.0)  # default azimuths of the towers, [deg]
_SMALL = 5e-10  # differences, [m] and [1], below the digits that are written
_PRINTED = 0.7  # default print radius, over the delta radius


@dataclass(frozen=True)
class DeltaPrinter:
    """Parameters of a linear delta, towers in the order of the firmware's motors."""

    radius: float
    """Delta radius R, [m]."""
    angles: Sequence[float]
    """Azimuths α of the three towers, [rad]."""
    arms: Sequence[float]
    """Lengths L of the rods, [m]."""
    endstops: Sequence[float]
    """Heights E of the nozzle over the bed's centre with each carriage at its endstop, [m]."""
    print_radius: float | None = None
    """Radius of the bed, [m]."""
    origin: tuple[float, float] = (0.0, 0.0)
    """Position of its origin in the base frame of the mechanism that it was made from, [m]."""
    remarks: tuple[str, ...] = ()
    """Sentences on contents of the file or mechanism that these parameters cannot hold."""

    def __post_init__(self) -> None:
        for name in ("angles", "arms", "endstops"):
            object.__setattr__(self, name, tuple(map(float, getattr(self, name))))
        printed = 1.0 if self.print_radius is None else self.print_radius
        numbers = np.array([self.radius, *self.angles, *self.arms, *self.endstops, printed])
        fault = ""
        if not (np.abs(numbers) <= LARGEST).all():
            fault = (
                f"a parameter of the printer is not a finite number, at most {LARGEST:g} m in size"
            )
        elif printed <= 0.0:
            fault = f"the print radius is {1e3 * printed:g} mm; expected a radius above 0"
        elif not 0.0 < self.radius < min(self.arms):
            fault = (
                f"the delta radius is {1e3 * self.radius:g} mm and the shortest rod "
                f"{1e3 * min(self.arms):g} mm; expected a radius above 0 and longer rods"
            )
        if fault:
            raise MechanismError(fault)

    @property
    def firmware_lines(self) -> str:
        """Lines with the parameters in the units of firmwares, mm and degrees."""
        angles = np.degrees(self.angles) % 360.0
        lines = [
            f"tower {name}: angle {angle:.4f}°, arm {1e3 * arm:.4f} mm, endstop {1e3 * end:.4f} mm"
            for name, angle, arm, end in zip("abc", angles, self.arms, self.endstops, strict=True)
        ]
        return "\n".join([f"delta radius {1e3 * self.radius:.4f} mm", *lines])

    def mechanism(
        self, name: str, description: str = "", legs: Sequence[str] = TOWERS
    ) -> Mechanism:
        """Return the printer as a mechanism; readings are distances below the endstops, [m]."""
        template = load_mechanism("linear_delta")
        first = template.legs[0]
        made = []
        for i, leg_name in enumerate(legs):
            angle, arm, endstop = wrapped(self.angles[i]), self.arms[i], self.endstops[i]
            turn = Element(angle - first.nominal_by_name["angle"])
            leg = replace(carry(first, turn), name=leg_name).with_parameters(
                {"radius": self.radius, "angle": angle, "arm": arm, "endstop": endstop}
            )
            reach = self.radius + (self.print_radius or _PRINTED * self.radius)
            reach = min(reach, 0.98 * arm)
            tilt, top = asin(reach / arm), sqrt(arm**2 - self.radius**2)
            limits = {
                "carriage": (sqrt(arm**2 - reach**2), top + endstop),
                "swing": (pi / 2 - tilt, pi / 2 + tilt),
                "sway": (-tilt, tilt),
            }
            made.append(at_home(leg.with_limits(limits), template.platform))
        return Mechanism(name, template.platform, tuple(made), description, template.labels)


def delta_printer(mechanism: Mechanism) -> DeltaPrinter:
    """Return a mechanism's firmware parameters, by its geometry; legs are the towers in order."""
    if mechanism.platform.kind != "translational" or len(mechanism.legs) != 3:
        raise MechanismError(
            f"{mechanism.name!r} is no linear delta: expected three carriages and a platform that "
            "moves along x, y, z"
        )
    towers = np.array([_tower(LegClosure(leg, mechanism.platform)) for leg in mechanism.legs])
    points, tops, arms, gains = towers[:, :2], towers[:, 2], towers[:, 3], towers[:, 4]
    chords = points[1:] - points[0]
    if abs(np.linalg.det(chords)) <= 1e-6 * float((chords**2).sum()):
        raise MechanismError("the three towers are in line; expected towers on a circle")
    half = ((points[1:] ** 2).sum(axis=1) - (points[0] ** 2).sum()) / 2
    x, y = np.linalg.solve(chords, half).tolist()  # the centre of their circle
    around = points - (x, y)
    radius = float(np.linalg.norm(around, axis=1).mean())
    if radius >= arms.min():
        raise MechanismError(
            f"{mechanism.name!r}: the towers are {1e3 * radius:g} mm from their centre, farther "
            "than a rod is long; a firmware cannot home such a printer"
        )
    remarks = [
        f"{leg.name}: a firmware cannot hold terms of {', '.join(('its sensor', *leg.deformed))}; "
        "its parameters are those at the reference of the terms' influences"
        for leg in mechanism.legs
        if leg.amplitudes
    ]
    if hypot(x, y) > _SMALL:
        remarks.append(
            f"the printer's origin is at x = {1e3 * x:.4f}, y = {1e3 * y:.4f} mm of the "
            "mechanism's base frame: a firmware has one radius for all towers, so that its origin "
            "is the centre of their circle. Prints move by that much as a whole"
        )
    remarks += [
        f"{leg.name} moves {gain:.9f} mm for each mm of the firmware: multiply its travel per step "
        "by that (Klipper: rotation_distance; RepRapFirmware: divide the steps per mm of M92)"
        for leg, gain in zip(mechanism.legs, gains, strict=True)
        if abs(gain - 1.0) > _SMALL
    ]
    return DeltaPrinter(
        radius,
        np.arctan2(around[:, 1], around[:, 0]).tolist(),
        arms.tolist(),
        (tops - np.sqrt(arms**2 - radius**2)).tolist(),
        origin=(x, y),
        remarks=tuple(remarks),
    )


def _tower(closure: LegClosure) -> Array:
    """Return x, y of a tower, the carriage's height at reading 0, the rod's length, and the gain.

    Positions, [m], are of the rod's upper end with the platform's point at the origin.
    """
    leg = closure.leg
    slides = leg.active == [0] and leg.moving[0].kind == "prismatic"
    rod = closed_form(closure)
    if not slides or rod is None or rod.frame is None:
        raise MechanismError(
            f"{leg.name} is no leg of a linear delta: expected a driven carriage, a universal "
            "joint and a rod"
        )
    vertical = rod.frame[:, 1]
    tilt = hypot(vertical[0], vertical[1])
    if tilt > EXACT:
        raise MechanismError(
            f"{leg.name}: its carriage moves {1e3 * tilt:.4g} mrad off the vertical; firmwares "
            "have no parameter for this tilt"
        )
    law = sensor_law(closure)
    gain = -float(vertical[2]) * law.slope[0]
    if gain <= 0.0:
        raise MechanismError(
            f"{leg.name}: its readings grow upwards; a firmware's count down from the endstop "
            "(direction -1 of the sensor)"
        )
    top = rod.centre - closure.targets(np.eye(4)[None])[0] + vertical * law.intercept[0]
    return np.array([*top, rod.length, gain])
