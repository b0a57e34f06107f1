"""What must agree in a leg and in a mechanism: checked where they are made."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Iterator
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np

from pincal.errors import MechanismError
from pincal.model.checks import EXACT, LARGEST
from pincal.model.orientation import SINGLE_ANGLES, WAYS
from pincal.model.sensor import term_faults

if TYPE_CHECKING:
    from pincal.model.leg import Joint, Leg
    from pincal.model.mechanism import Mechanism

#: Columns of tables that mean something else than a reading.
RESERVED = {"x", "y", "z", "phi", "set", "run", "pose", *SINGLE_ANGLES} | {
    name for names, _ in WAYS.values() for name in names
}


def identifiers(names: Iterable[str]) -> tuple[str, ...]:
    """Return names of ASCII letters, digits and underscores for joints, no two alike.

    They head columns and stand in code; what a joint is called in a file stays its own name.
    """
    taken: list[str] = []
    for name in names:
        plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
        plain = re.sub(r"\W", "_", plain)[:50]
        if not re.match("[A-Za-z_]", plain) or plain in RESERVED or plain.startswith("sigma_"):
            plain = f"joint_{plain}"
        candidates = (f"{plain}_{count}" for count in range(2, len(taken) + 2))
        taken.append(next(name for name in (plain, *candidates) if name not in taken))
    return tuple(taken)


def check_leg(leg: Leg) -> None:
    """Raise MechanismError if joints, sensors, parameters and terms do not go together."""
    topics = (_joint_faults, _sensor_faults, term_faults, _parameter_faults)
    for fault in chain.from_iterable(faults(leg) for faults in topics):
        raise MechanismError(f"{leg.name}: {fault}")
    for joint in (*leg.joints, leg.point):
        joint.placement.rest(leg.nominal_by_name, f"{leg.name}, joint {joint.name!r}")


def _joint_faults(leg: Leg) -> Iterator[str]:
    """Yield what is wrong with joints: their limits and names."""
    for joint in leg.moving:
        ends = (joint.lower, joint.upper)
        limits = np.isfinite(ends).all() or (joint.turns and np.isinf(ends).all())
        if not (limits and joint.lower < joint.upper):
            yield (
                f"joint {joint.name!r} has limits {joint.lower:g} to {joint.upper:g}; expected "
                "finite ones, lower below upper"
            )
    names = [joint.name for joint in leg.joints]
    if len(set(names)) != len(names):
        yield f"joint names repeat: {names}"


def _sensor_faults(leg: Leg) -> Iterator[str]:
    """Yield with which joints the sensors cannot be."""
    moving, read = [joint.name for joint in leg.moving], [sensor.joint for sensor in leg.sensors]
    if still := [name for name in read if name not in moving]:
        yield (
            f"active joint {still[0]!r} is not a moving joint of the leg; it has "
            f"{', '.join(moving)}"
        )
    if not read or len(set(read)) != len(read):
        yield (
            f"its sensors read {', '.join(read) or 'nothing'}; expected one sensor or more, each "
            "of another joint"
        )


def _parameter_faults(leg: Leg) -> Iterator[str]:
    """Yield what is wrong with a leg's parameters: their names, their values, and gains."""
    used, declared = set(leg.units), leg.parameter_names
    if len(set(declared)) != len(declared):
        yield f"parameter names repeat: {list(declared)}"
    for name in sorted(used.difference(declared)):
        yield (
            f"parameter {name!r} is used in a placement or the sensor but has no nominal value "
            "under 'parameters'"
        )
    for name in sorted(set(declared) - used):
        yield (
            f"parameter {name!r} is used by no placement and not by the sensor; name it in one of "
            "them or remove it"
        )
    if not np.isfinite(leg.nominal).all():
        yield "a nominal parameter is not a finite number"
    for sensor in leg.sensors:
        gain, _ = sensor.constants(leg.nominal_by_name)
        if not 1.0 / LARGEST <= abs(gain) <= LARGEST:
            yield (
                f"the sensor's gain is {gain:g}; expected one that is neither zero nor more than "
                f"{LARGEST:g} times too small or large"
            )


def check_mechanism(mechanism: Mechanism) -> None:
    """Raise MechanismError if the legs, their names and what weighs on them do not go together."""
    title = mechanism.name
    if not (title and title.isprintable() and len(title) <= 100):
        raise MechanismError(f"{title!r} is no name for a mechanism")
    for fault in chain(_name_faults(mechanism), _load_faults(mechanism)):
        raise MechanismError(f"mechanism {title!r}: {fault}")
    for fault in _leg_faults(mechanism):
        raise MechanismError(fault)


def _name_faults(mechanism: Mechanism) -> Iterator[str]:
    """Yield what is wrong with names of legs, and of readings and influences, columns of tables."""
    names, readings = mechanism.leg_names, mechanism.reading_names
    if not names:
        yield "it has no legs"
    if len(set(names)) != len(names):
        yield f"leg names repeat: {list(names)}"
    for name in readings:
        if name in RESERVED or name.startswith("sigma_"):
            yield (
                f"a reading named {name!r} cannot be distinguished from that column of a pose; "
                f"rename its joint or leg ({name}_joint, say)"
            )
    for name in mechanism.influences:
        if name in RESERVED or name in readings:
            yield (
                f"a term depends on {name!r}, which is another column of tables; name the "
                "influence otherwise"
            )
        if name != name.strip() or not name or re.search(r"[][]|^(sigma|cov)_", name):
            yield (
                f"a term depends on {name!r}, which heads no column of a table; expected a name "
                "such as temperature: no brackets, no blanks around it, not sigma_… or cov_…"
            )
    if len(set(readings)) != len(readings):
        yield (
            f"names of readings repeat: {', '.join(readings)}; a leg's only sensor is named after "
            "the leg, several ones after their joints"
        )
    if "platform" in names:
        yield "'platform' names the platform's file; name the leg otherwise"


def _load_faults(mechanism: Mechanism) -> Iterator[str]:
    """Yield what is wrong with what weighs on the mechanism."""
    ids = mechanism.parameters.ids
    for name, _ in () if mechanism.load is None else mechanism.load.drawn:
        if name not in ids:
            yield f"the load's drawing has {name!r}, which is no parameter"
    if mechanism.load is None and mechanism.loaded:
        yield (
            "a term depends on a load, but what weighs on the mechanism is not said; give 'load' "
            "(mass, centre, gravity)"
        )


def _leg_faults(mechanism: Mechanism) -> Iterator[str]:
    """Yield which legs share a point that is not one, demand nothing, or leave the plane."""
    points: dict[str, Leg] = {}
    for leg in mechanism.legs:
        sharing, placement = points.setdefault(leg.point.name, leg), leg.point.placement
        if sharing is not leg and (
            placement != sharing.point.placement or placement.parameter_units
        ):
            yield (
                f"{sharing.name} and {leg.name} share the platform point {leg.point.name!r}, so "
                "it must be the same for both and have no parameters; give each leg its own point"
            )
        if mechanism.platform.equations(leg) <= 0:
            yield (
                f"{leg.name} has {len(leg.passive)} passive joints for "
                f"{len(mechanism.platform.closing(leg.closes))} rows of its closure: it demands "
                "nothing of the platform; read another of its joints, or leave it out"
            )
        for joint in leg.joints if mechanism.platform.space == 2 else ():
            if _leaves_plane(joint):
                yield (
                    f"{leg.name}: joint {joint.name!r} leaves the plane; in a planar mechanism "
                    "revolute axes are parallel to z, prismatic axes perpendicular to it, and "
                    "frames turn about z only"
                )


def _leaves_plane(joint: Joint) -> bool:
    """Return whether a joint would move the leg out of the x-y plane of the base."""
    across = abs(abs(joint.placement.origin()[2, 2]) - 1.0) <= EXACT
    height = abs(joint.axis[2])
    flat = abs(height - 1.0) < EXACT if joint.turns else height < EXACT
    return not (across and (flat or joint.kind == "fixed"))
