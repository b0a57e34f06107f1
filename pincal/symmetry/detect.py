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
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.kinematics.closed_forms import is_line
from pincal.kinematics.closure import LegClosure
from pincal.kinematics.inverse import inverse
from pincal.kinematics.reach import reach_of
from pincal.kinematics.starts import home_mode
from pincal.model.checks import number_of
from pincal.model.leg import Leg
from pincal.model.mechanism import Mechanism
from pincal.model.platform import Platform, Poses
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
        """Return the break as a sentence."""
        much = "differs" if self.deviation is None else f"is off by {self.deviation:.4g}"
        return f"{self.element}: {self.quantity} of {self.leg} {much}"


@dataclass(frozen=True, repr=False)
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
                    f"no symmetry of {self.mechanism.name!r} carries leg 1 onto {name}"
                    f"{broken and f' ({broken})'}. "
                    "Choose poses for each leg on its own (--independent)"
                )
        return tuple(found)

    def equivariance(self, poses: Poses) -> float:
        """Return the largest |reading of a carried leg at carried poses − reading| (Eq. 5).

        The identity carries nothing; readings need not follow from poses then.

        Args:
            poses: N poses that the mechanism reaches.
        """
        platform = self.mechanism.platform
        if len(self.elements) == 1:
            return 0.0
        before = inverse(self.mechanism, poses).readings
        worst = 0.0
        for element, permutation in zip(self.elements, self.permutations, strict=True):
            after = inverse(self.mechanism, element.poses(platform, poses)).readings
            worst = max(worst, float(np.abs(after[:, list(permutation)] - before).max()))
        return worst

    def __repr__(self) -> str:
        """Return the group in a line."""
        count = len(self.elements)
        return f"SymmetryGroup: {self.name} of {self.mechanism.name}, {count} element(s)"

    def __str__(self) -> str:
        """Return a page: the elements, and what breaks the others."""
        kind = "rotations" if not any(e.reflection for e in self.elements) else "elements"
        lines = [f"{len(self.elements)} {kind}: {', '.join(str(e) for e in self.elements)}"]
        return "\n".join(lines + [f"  broken: {b}" for b in self.breaks])


def symmetry_group(mechanism: GivenMechanism, tolerance: float = 1e-6) -> SymmetryGroup:
    """Return the symmetry group of a mechanism's nominal geometry, limits, modes and sensors.

    Args:
        mechanism: The mechanism.
        tolerance: Largest deviation, relative to the leg's size for lengths, [rad] for angles.
    """
    return _group(as_mechanism(mechanism), number_of(tolerance, "tolerance", SymmetryError))


@lru_cache(maxsize=64)
def _group(mechanism: Mechanism, tolerance: float) -> SymmetryGroup:
    """Return the symmetry group of a mechanism, found once."""
    legs = [canonical(leg) for leg in mechanism.legs]
    elements, permutations, breaks = [], [], []
    for element in _candidates(mechanism, legs):
        permutation, broken = _permutation(mechanism, legs, element, tolerance)
        if broken is None:
            elements.append(element)
            permutations.append(permutation)
        elif _nearly_maps_bases(element, legs):
            breaks.append(broken)
    return SymmetryGroup(mechanism, tuple(elements), tuple(permutations), tuple(breaks))


def _candidates(mechanism: Mechanism, legs: list[Leg]) -> list[Element]:
    """Return a rotation and a mirror for each leg that an off-axis leg might be carried to.

    If all legs start on the axis, a mirror can only be one that leaves home where it is.
    """
    x, y, _ = mechanism.platform.home_pose.translation[0]
    azimuths = [azimuth for leg in legs if (azimuth := _azimuth(leg)) is not None]
    azimuths = azimuths or [float(np.arctan2(y, x))]
    first = azimuths[0]
    turns = [Element(0.0), *(Element(wrapped(azimuth - first)) for azimuth in azimuths)]
    mirrors = [Element(wrapped(azimuth + first), reflection=True) for azimuth in azimuths]
    found: list[Element] = []
    for element in turns + mirrors:
        if not any(element.equals(other) for other in found):
            found.append(element)
    return found


def _nearly_maps_bases(element: Element, legs: list[Leg]) -> bool:
    """Return whether an element belongs to the group that the base points suggest."""
    bases = np.array([leg.joints[0].placement.xyz for leg in legs])
    apart = np.linalg.norm((bases @ element.matrix.T)[:, None] - bases, axis=2)
    size = np.linalg.norm(bases[:, :2], axis=1).max()
    return bool((apart.min(axis=1) <= _NEARLY * size).all())


def _azimuth(leg: Leg) -> float | None:
    """Return the azimuth of a leg's base, or of its platform point; None if both are central."""
    for joint in (leg.joints[0], leg.point):
        x, y, _ = joint.placement.xyz
        if np.hypot(x, y) > 0.0:
            return float(np.arctan2(y, x))
    return None


def _permutation(
    mechanism: Mechanism, legs: list[Leg], element: Element, tolerance: float
) -> tuple[tuple[int, ...], Break | None]:
    """Return where an element carries the legs, and what breaks it if something does."""
    if element.equals(Element(0.0)):
        return tuple(range(len(legs))), None
    permutation: list[int] = []
    home = np.array([mechanism.platform.home])
    carried_home = element.poses(mechanism.platform, home)
    moved = float(np.abs(mechanism.platform.twists_between(home, carried_home)).max())
    for leg in legs:
        if moved > tolerance and any(sensor.homed for sensor in leg.sensors):
            return (), Break(element, leg.name, "home pose from which the sensor counts", moved)
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
        order = np.argsort(distances, kind="stable")
        near = [i for i in order if distances[i] <= distances[order[0]] + tolerance]
        differences = {
            int(i): _difference(carried, legs[i], mechanism, tolerance)
            for i in near
            if i not in permutation
        }
        fitting = [i for i, difference in differences.items() if difference is None]
        if not fitting:  # of legs in the same place, the first is named
            index = int(near[0])
            difference = differences.get(index) or _difference(
                carried, legs[index], mechanism, tolerance
            )
            broken = difference or ("leg onto which two legs are carried", None)
            return (), Break(element, legs[index].name, *broken)
        permutation.append(fitting[0])
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
        turned = max(turn, tilt) > tolerance and (a, b) != (carried.point, leg.point)
        if turned and not _same_line(carried, leg, mechanism.platform, tolerance):
            return f"orientation of joint {b.name!r}", max(turn, tilt)
    if home_mode(carried, mechanism.platform) != home_mode(leg, mechanism.platform):
        return "working mode (the side on which the leg bends)", None
    if carried.active != leg.active or carried.closes != leg.closes:
        return "active joint" if carried.active != leg.active else "end", None
    for index, unit in enumerate(leg.reading_units):
        scale = 1.0 if unit == "rad" else size
        if found := _sensors_differ(carried, leg, index, tolerance * scale):
            return found
    for a, b in zip(carried.moving, leg.moving, strict=True):
        if not (a.limited or b.limited):
            continue
        ends = (a.lower - b.lower, a.upper - b.upper)
        shift = max(abs(wrapped(end) if a.kind == "revolute" else end) for end in ends)
        if shift <= 2 * tolerance * (size if a.kind == "prismatic" else 1.0):
            continue
        if a.kind == "prismatic" or not _same_line(carried, leg, mechanism.platform, tolerance):
            return f"limits of joint {b.name!r}", shift if np.isfinite(shift) else None
    return None


def _sensors_differ(
    carried: Leg, leg: Leg, index: int, tolerance: float
) -> tuple[str, float | None] | None:
    """Return the first quantity in which two legs' sensors differ, and by how much.

    Args:
        carried: One leg.
        leg: The other one.
        index: Of the sensor.
        tolerance: Largest deviation, [rad] or [m].
    """
    a, b = carried.sensors[index], leg.sensors[index]
    if [one.basis for one in a.terms] != [one.basis for one in b.terms]:
        return "terms of the sensor", None
    for one, its in zip(a.terms, b.terms, strict=True):
        amplitude = carried.nominal_by_name[one.parameter]
        apart = abs(amplitude - leg.nominal_by_name[its.parameter])
        if apart > tolerance:
            return "terms of the sensor", apart
    if (a.form, a.direction) != (b.form, b.direction):
        return "form or direction of the sensor", None
    gains, offsets = zip(
        a.constants(carried.nominal_by_name), b.constants(leg.nominal_by_name), strict=True
    )
    if abs(gains[0] - gains[1]) > tolerance:
        return "gain of the sensor", abs(gains[0] - gains[1])
    if a.homed != b.homed:
        return "zero of the sensor", None
    zeros = [0.0 if isinstance(one.zero, str) else one.zero for one in (a, b)]
    for what, (own, other) in (("offset", offsets), ("zero", zeros)):
        turning = leg.reading_units[index] == "rad"
        shift = abs(wrapped(own - other) if turning else own - other)
        if shift > tolerance:
            return f"{what} of the sensor", shift
    return None


def _same_line(carried: Leg, leg: Leg, platform: Platform, tolerance: float) -> bool:
    """Return whether two legs are lines whose universal joints bar the same directions."""
    normals = []
    for one in (carried, leg):
        closure = LegClosure(one, platform)
        reach = reach_of(closure)
        if not (reach and reach.exact and is_line(closure)):
            return False
        normals.append(np.sign(one.home[2]) * reach.normals)
    first, second = normals
    apart = np.linalg.norm(first[:, None] - second, axis=2)
    return len(first) == len(second) and bool((apart.min(1, initial=np.inf) <= tolerance).all())
