"""The symmetry group of a mechanism, detected from geometry, limits, working modes, sensors.

An element of the group carries leg 1 to some leg j, so the only candidates are one
rotation and one mirror for each j. A candidate holds if it carries every leg onto a
leg; if not, the first thing that breaks it is named.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pincal.errors import SymmetryError
from pincal.kinematics.inverse import inverse
from pincal.kinematics.starts import home_mode
from pincal.model.leg import Leg
from pincal.model.mechanism import Mechanism
from pincal.model.platform import Poses
from pincal.symmetry.carry import canonical, carry
from pincal.symmetry.elements import Element, wrapped

Array = NDArray[np.float64]
_NEARLY = 0.1  # of the base's radius: a symmetry meant, though not kept


@dataclass(frozen=True)
class Break:
    """What keeps an element out of the group: the first quantity that differs."""

    element: Element
    leg: str
    """The leg onto which another one should have been carried."""
    quantity: str
    deviation: float | None = None
    """How far the quantity is off, [m] or [rad]; None where it is no number."""

    def __str__(self) -> str:
        """Return the break in words."""
        much = "differs" if self.deviation is None else f"is off by {self.deviation:.4g}"
        return f"{self.element}: {self.quantity} of {self.leg} {much}"


@dataclass(frozen=True)
class SymmetryGroup:
    """Elements that leave a mechanism as it is, and where they carry its legs."""

    mechanism: Mechanism
    elements: tuple[Element, ...]
    """The identity first."""
    permutations: tuple[tuple[int, ...], ...]
    """For each element: index of the leg onto which each leg is carried."""
    breaks: tuple[Break, ...]
    """Why the other candidates of the full dihedral group fail."""

    @property
    def name(self) -> str:
        """Return the group's name: D_2n with its order 2n, or C_n of rotations only."""
        n = sum(not element.reflection for element in self.elements)
        return f"D{2 * n}" if len(self.elements) > n else f"C{n}"

    def carriers(self) -> tuple[Element, ...]:
        """Return G_C: for each leg, an element that carries leg 1 onto it (3-RRR paper, Eq. 7).

        Raises:
            SymmetryError: some leg cannot be reached from leg 1.
        """
        found = []
        for index, name in enumerate(self.mechanism.leg_names):
            for element, permutation in zip(self.elements, self.permutations, strict=True):
                if permutation[0] == index:
                    found.append(element)
                    break
            else:
                broken = "; ".join(str(b) for b in self.breaks)
                raise SymmetryError(
                    f"no symmetry of {self.mechanism.name!r} carries leg 1 onto {name} ({broken}). "
                    "Choose poses for each leg on its own (--independent)"
                )
        return tuple(found)

    def equivariance(self, poses: Poses) -> float:
        """Return the largest |reading of a carried leg at carried poses − reading| (Eq. 5).

        Args:
            poses: N poses that the mechanism reaches.
        """
        platform = self.mechanism.platform
        before = inverse(self.mechanism, poses).readings
        worst = 0.0
        for element, permutation in zip(self.elements, self.permutations, strict=True):
            after = inverse(self.mechanism, element.poses(platform, poses)).readings
            worst = max(worst, float(np.abs(after[:, list(permutation)] - before).max()))
        return worst

    def __str__(self) -> str:
        """Return the group in words."""
        kind = "rotations" if not any(e.reflection for e in self.elements) else "elements"
        lines = [f"{len(self.elements)} {kind}: {', '.join(str(e) for e in self.elements)}"]
        return "\n".join(lines + [f"  broken: {b}" for b in self.breaks])


@lru_cache(maxsize=64)
def symmetry_group(mechanism: Mechanism, tolerance: float = 1e-6) -> SymmetryGroup:
    """Return the symmetry group of a mechanism's nominal geometry, limits, modes and sensors.

    Args:
        mechanism: The mechanism.
        tolerance: Largest deviation, relative to the leg's size for lengths, [rad] for angles.
    """
    legs = [canonical(leg) for leg in mechanism.legs]
    elements, permutations, breaks = [], [], []
    for element in _candidates(legs):
        permutation, broken = _permutation(mechanism, legs, element, tolerance)
        if broken is None:
            elements.append(element)
            permutations.append(permutation)
        elif _nearly_maps_bases(element, legs):
            breaks.append(broken)
    return SymmetryGroup(mechanism, tuple(elements), tuple(permutations), tuple(breaks))


def _candidates(legs: list[Leg]) -> list[Element]:
    """Return a rotation and a mirror for each leg that leg 1 might be carried to."""
    first = _azimuth(legs[0])
    turns = [Element(wrapped(_azimuth(leg) - first)) for leg in legs]
    mirrors = [Element(wrapped(_azimuth(leg) + first), reflection=True) for leg in legs]
    return [e for e in turns if abs(e.angle) > 1e-9 or e is turns[0]] + mirrors


def _nearly_maps_bases(element: Element, legs: list[Leg]) -> bool:
    """Return whether an element belongs to the group that the base points suggest."""
    bases = np.array([leg.joints[0].placement.xyz for leg in legs])
    apart = np.linalg.norm((bases @ element.matrix.T)[:, None] - bases, axis=2)
    size = np.linalg.norm(bases[:, :2], axis=1).max()
    return bool((apart.min(axis=1) <= _NEARLY * size).all())


def _azimuth(leg: Leg) -> float:
    """Return the azimuth of a leg's base, or of its platform point if the base is central."""
    for joint in (leg.joints[0], leg.point):
        x, y, _ = joint.placement.xyz
        if np.hypot(x, y) > 0.0:
            return float(np.arctan2(y, x))
    return 0.0


def _permutation(
    mechanism: Mechanism, legs: list[Leg], element: Element, tolerance: float
) -> tuple[tuple[int, ...], Break | None]:
    """Return where an element carries the legs, and what breaks it if something does."""
    permutation = []
    for leg in legs:
        try:
            carried = carry(leg, element, leg.name, leg.point.name)
        except SymmetryError:
            return (), Break(element, leg.name, "parametrisation of the base point")
        distances = [
            np.linalg.norm(
                np.subtract(carried.joints[0].placement.xyz, other.joints[0].placement.xyz)
            )
            + np.linalg.norm(np.subtract(carried.point.placement.xyz, other.point.placement.xyz))
            for other in legs
        ]
        index = int(np.argmin(distances))
        difference = _difference(carried, legs[index], mechanism, tolerance)
        if difference:
            return (), Break(element, legs[index].name, *difference)
        permutation.append(index)
    if len(set(permutation)) != len(legs):
        return (), Break(element, legs[0].name, "leg onto which two legs are carried")
    return tuple(permutation), None


def _difference(
    carried: Leg, leg: Leg, mechanism: Mechanism, tolerance: float
) -> tuple[str, float | None] | None:
    """Return the first quantity in which two legs differ, and by how much."""
    if [j.kind for j in carried.joints] != [j.kind for j in leg.joints]:
        return "sequence of joints", None
    if carried.parameter_names != leg.parameter_names:
        return "set of parameters", None
    size = max(float(np.linalg.norm(j.placement.xyz)) for j in leg.joints) or 1.0
    for name, a, b in zip(leg.parameter_names, carried.nominal, leg.nominal, strict=True):
        angle = leg.units[name] == "rad"
        deviation = wrapped(a - b) if angle else float(a - b)
        if abs(deviation) > tolerance * (size if leg.units[name] == "m" else 1.0):
            return f"parameter {name!r}", abs(deviation)
    for a, b in zip((*carried.joints, carried.point), (*leg.joints, leg.point), strict=True):
        shift = float(np.linalg.norm(np.subtract(a.placement.xyz, b.placement.xyz)))
        if shift > 2 * tolerance * size:
            return f"position of joint {b.name!r}", shift
        turn = float(np.abs(a.placement.origin() - b.placement.origin())[:3, :3].max())
        tilt = float(np.abs(np.subtract(a.axis, b.axis)).max()) if a.kind != "fixed" else 0.0
        if max(turn, tilt) > tolerance and (a, b) != (carried.point, leg.point):
            return f"orientation of joint {b.name!r}", max(turn, tilt)
    if home_mode(carried, mechanism.platform) != home_mode(leg, mechanism.platform):
        return "working mode (the side on which the leg bends)", None
    if (carried.sensor.form, carried.sensor.direction) != (leg.sensor.form, leg.sensor.direction):
        return "form or direction of the sensor", None
    shift = abs(wrapped(carried.sensor.zero - leg.sensor.zero))
    if shift > tolerance:
        return "zero of the sensor", shift
    for a, b in zip(carried.moving, leg.moving, strict=True):
        if min(a.upper - a.lower, b.upper - b.lower) >= 2 * np.pi and a.kind == "revolute":
            continue  # goes all round, wherever that is counted from
        ends = (a.lower - b.lower, a.upper - b.upper)
        shift = max(abs(wrapped(end) if a.kind == "revolute" else end) for end in ends)
        if not shift <= 2 * tolerance * (size if a.kind == "prismatic" else 1.0):
            return f"limits of joint {b.name!r}", shift if np.isfinite(shift) else None
    return None
