"""Consistency checks of legs and mechanisms, run whenever one is made or read from a file."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Iterator
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from pincal.errors import MechanismError
from pincal.model.checks import EXACT, LARGEST
from pincal.model.platform import TWIST, WAYS
from pincal.model.terms import APPROACH

if TYPE_CHECKING:
    from pincal.model.joint import Joint
    from pincal.model.leg import Leg
    from pincal.model.mechanism import Mechanism
    from pincal.model.platform import Platform

#: Names of table columns that no reading may have.
RESERVED = {"x", "y", "z", "phi", "set", "run", "pose"} | {
    name for names, _ in WAYS.values() for name in names
}

ROUGH = 0.1
"""Largest gap at home, relative to the leg's size, of a drawing that is rough but not wrong."""


def identifiers(names: Iterable[str]) -> tuple[str, ...]:
    """Return a unique identifier of ASCII letters, digits and underscores for each joint name.

    Identifiers head columns and stand in code; the joints keep the names that files give them.
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
    """Raise MechanismError if a leg's joints, sensors, parameters and terms are inconsistent."""
    topics = (_joint_faults, _tree_faults, _gear_faults, _term_faults, _parameter_faults)
    for fault in chain.from_iterable(faults(leg) for faults in topics):
        raise MechanismError(f"{leg.name}: {fault}")
    for joint in (*leg.joints, *leg.points):
        joint.placement.rest(leg.nominal_by_name, f"{leg.name}, joint {joint.name!r}")


def _joint_faults(leg: Leg) -> Iterator[str]:
    """Yield faults of the joints' limits and names, and of the sensors' choice of joints."""
    for joint in leg.moving:
        ends = (joint.lower, joint.upper)
        limits = np.isfinite(ends).all() or (joint.turns and np.isinf(ends).all())
        if not (limits and joint.lower < joint.upper):
            yield (
                f"joint {joint.name!r} has limits {joint.lower:g} to {joint.upper:g}; expected "
                "finite ones, lower below upper"
            )
    names, moving = ([joint.name for joint in joints] for joints in (leg.joints, leg.moving))
    if len(set(names)) != len(names):
        yield f"joint names repeat: {names}"
    read = [sensor.joint for sensor in leg.sensors]
    if still := [name for name in read if name not in moving]:
        yield (
            f"active joint {still[0]!r} is not a moving joint of the leg; it has "
            f"{', '.join(moving)}"
        )
    if len(set(read)) != len(read):
        yield f"its sensors read {', '.join(read)}; expected each to read a different joint"


def _tree_faults(leg: Leg) -> Iterator[str]:
    """Yield faults of the joints' parents and of the leg's further ends."""
    names = [joint.name for joint in leg.joints]
    for place, joint in enumerate(leg.joints):
        if joint.parent and joint.parent not in names[:place]:
            yield f"joint {joint.name!r} has the parent {joint.parent!r}; expected an earlier joint"
    for end in leg.ends:
        if unknown := [name for name in end.frames if name not in names]:
            yield f"an end is at joint {unknown[0]!r}, which the leg does not have"
        if not isinstance(end.closes, str) and not (
            end.point is None and set(end.closes) <= set(TWIST)
        ):
            yield (
                f"the end at {end.tip!r} closes {', '.join(end.closes)}; expected 'point' or "
                f"'frame', or for a loop within the leg some of {', '.join(TWIST)}"
            )


def _gear_faults(leg: Leg) -> Iterator[str]:
    """Yield faults of joints that follow another joint, and of their ratios."""
    moving = {joint.name for joint in leg.moving}
    for joint in leg.articulated:
        if joint.leader.joint not in moving or not abs(joint.leader.ratio) > 0.0:
            yield (
                f"joint {joint.name!r} follows {joint.leader.joint!r} times "
                f"{joint.leader.ratio:g}; expected a joint of the leg that moves on its own"
            )
    for joint in (joint for joint in leg.joints if joint.ratio):
        ratio = leg.nominal_by_name.get(joint.ratio)
        if not joint.follows or ratio != joint.leader.ratio:
            yield f"joint {joint.name!r} follows no joint by {joint.ratio!r}, nominally {ratio}"
        if joint.ratio in leg.deformed:
            yield f"parameter {joint.ratio!r} is a gear ratio; a gear ratio can have no terms"


def _parameter_faults(leg: Leg) -> Iterator[str]:
    """Yield faults of a leg's parameters: names, nominal values, and gains of sensors."""
    used, declared = set(leg.units), leg.parameter_names
    if len(set(declared)) != len(declared):
        yield f"parameter names repeat: {list(declared)}"
    for name in (*sorted(used.difference(declared)), *sorted(set(declared) - used)):
        yield f"parameter {name!r} is used " + (
            "in a placement or a sensor but has no nominal value under 'parameters'"
            if name in used
            else "by no placement and no sensor; name it in one of them or remove it"
        )
    if not np.isfinite(leg.nominal).all():
        yield "a nominal parameter is not a finite number"
    for sensor in leg.sensors:
        gain, _ = sensor.constants(leg.nominal_by_name)
        if not 1.0 / LARGEST <= abs(gain) <= LARGEST:
            limits = f"±{1.0 / LARGEST:g} to ±{LARGEST:g}"
            yield f"the sensor's gain is {gain:g}; expected a number other than zero, {limits}"


def _term_faults(leg: Leg) -> Iterator[str]:
    """Yield faults of the terms of a leg's sensors and parameters."""
    constants = {name for sensor in leg.sensors for name in (sensor.gain, sensor.offset)}
    of_sensors = constants.difference(leg.placed)
    owners = [
        (f"sensor {sensor.joint!r}", term, term.unit or unit)
        for sensor, unit in zip(leg.sensors, leg.reading_units, strict=True)
        for term in sensor.terms
    ]
    for name, term in leg.terms:
        for wrong, fault in (
            (
                name in of_sensors,
                ": that is a gain or offset, and terms are added to the joint's position, not to "
                "these; give the term to the sensor (sensors: terms)",
            ),
            (
                name not in leg.placed,
                ": no placement has such a parameter; expected one of "
                f"{', '.join(leg.placed) or 'none'}",
            ),
            (
                not term.of,
                " depends on a reading; a parameter's term depends on an influence: a column such "
                "as 'temperature', or 'load'",
            ),
            (
                term.of == APPROACH,
                " depends on the side of approach, which only joints have; give the term to a "
                "sensor, or name a column of your own",
            ),
        ):
            if wrong:
                yield f"term {term.parameter!r} of parameter {name!r}{fault}"
        owners.append((f"parameter {name!r}", term, term.unit or leg.placed[name]))
    units: dict[str, str] = {}
    for owner, term, unit in owners:
        context = f"term {term.parameter!r} of {owner}: its amplitude"
        if term.parameter in leg.placed or term.parameter in constants:
            yield f"{context} is also a parameter of a placement or sensor; rename one of them"
        if units.setdefault(term.parameter, unit) != unit:
            yield (
                f"{context}, [{unit}], is also that of another term, [{units[term.parameter]}]; "
                "rename one of them"
            )


def check_mechanism(mechanism: Mechanism) -> None:
    """Raise MechanismError if the legs, the names of columns and the load are inconsistent."""
    title = mechanism.name
    if not (title and title.isprintable() and len(title) <= 100):
        raise MechanismError(f"mechanism name {title!r}: expected 1 to 100 printable characters")
    for fault in _name_faults(mechanism):
        raise MechanismError(f"mechanism {title!r}: {fault}")
    for leg in mechanism.legs if mechanism.cables else ():
        if (leg.reading_units, leg.closes) != (("m",), "point"):
            raise MechanismError(
                f"limits of tensions need cables, and {leg.name} is none; expected a leg that "
                "closes a point and whose only sensor reads a length"
            )
    for fault in _leg_faults(mechanism):
        raise MechanismError(fault)


def _name_faults(mechanism: Mechanism) -> Iterator[str]:
    """Yield faults of the names of legs, of table columns, and of parameters in the load."""
    names, readings = mechanism.leg_names, mechanism.reading_names
    if not readings:
        yield "no joint of its legs has a sensor" if names else "it has no legs"
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
                f"a term depends on {name!r}, which is another column of tables; rename the "
                "influence"
            )
        if not re.fullmatch(r"(?!sigma_)[^][\s]([^][]*[^][\s])?", name):
            yield (
                f"a term depends on {name!r}, which cannot head a column of a table; expected a "
                "name such as temperature, without brackets, outer blanks, or a leading sigma_"
            )
    if len(set(readings)) != len(readings):
        yield (
            f"names of readings repeat: {', '.join(readings)}; a reading has its leg's name, or "
            "its joint's if the leg has several sensors: rename a leg or joint"
        )
    if "platform" in names:
        yield "a leg is named 'platform', as is the platform's file; rename the leg"
    drawn = dict(mechanism.load.drawn) if mechanism.load else {}
    if unknown := sorted(set(drawn).difference(mechanism.parameters.ids)):
        yield f"the load's 'drawn' names {unknown[0]!r}, which is no parameter of the mechanism"


def _leg_faults(mechanism: Mechanism) -> Iterator[str]:
    """Yield faults of legs: shared points that differ, no equations, leaving the plane."""
    points: dict[str, tuple[Leg, Joint]] = {}
    for leg in mechanism.legs:
        for point in leg.points:
            sharing, first = points.setdefault(point.name, (leg, point))
            placement, judged = point.placement, sharing is leg and first is point
            if not judged and (first.placement != placement or placement.parameter_units):
                yield (
                    f"{sharing.name} and {leg.name} share the platform point {point.name!r}, so it "
                    "must be the same for both and have no parameters; give each leg its own point"
                )
        if mechanism.platform.equations(leg) <= 0:
            yield (
                f"{leg.name} has {len(leg.passive)} passive joints and its closure "
                f"{mechanism.platform.rows(leg)} equations, so it does not constrain the "
                "platform; put a sensor on another of its joints, or remove the leg"
            )
        for joint in leg.joints if mechanism.platform.space == 2 else ():
            across = abs(abs(joint.placement.origin()[2, 2]) - 1.0) <= EXACT
            height = abs(joint.axis[2])
            flat = abs(height - 1.0) < EXACT if joint.turns else height < EXACT
            if not (across and (flat or joint.kind == "fixed")):
                yield (
                    f"{leg.name}: joint {joint.name!r} leaves the plane; in a planar mechanism "
                    "revolute axes are parallel to z, prismatic axes perpendicular to it, and "
                    "frames turn about z only"
                )


def check_home(leg: Leg, platform: Platform) -> None:
    """Raise MechanismError if a leg is open at home by more than a tenth of its size.

    Such a home does not fix the side on which the leg bends. The message asks whether an angle of
    more than a full turn is in degrees.
    """
    gap, turn = home_gap(leg, platform)
    if max(gap, turn) <= ROUGH * leg.size:
        return
    gap_shown = (
        f"its tip is {gap:.2g} m from the platform's point {leg.point.name!r}, the leg is "
        f"{leg.size:.2g} m long; expected a tenth of that at most"
        if gap >= turn
        else f"its tip is turned by {turn / leg.size:.2g} rad against the platform's frame "
        f"{leg.point.name!r}; expected {ROUGH:g} rad at most"
    )
    angles = {f"{joint.name} of {leg.name}": joint.home for joint in leg.moving if joint.turns}
    named = zip(platform.coordinates, platform.units, platform.home, strict=True)
    angles |= {f"{name} of the platform": home for name, unit, home in named if unit == "rad"}
    questions = [
        f". {name} is {value:g} at home: radians are expected; is this degrees "
        f"({np.radians(value):.6g} rad)?"
        for name, value in angles.items()
        if abs(value) > 2 * np.pi
    ]
    raise MechanismError(
        f"{leg.name} does not close at home: {gap_shown}. Correct 'home' of {leg.name} or of the "
        f"platform{''.join(questions[:1])}"
    )


def home_gap(leg: Leg, platform: Platform) -> tuple[float, float]:
    """Return the largest closure errors, in position and orientation, of a leg's ends at home, [m].

    An angle counts times the leg's size; ends that close no frame have none.
    """
    gap = turn = 0.0
    for end, tip in zip(leg.every_end, leg.ends_at(leg.home[None])[:, 0], strict=True):
        met = np.eye(4)
        if end.point is not None:
            met = platform.home_pose.as_matrix()[0] @ end.point.placement.origin()
        shift = (tip - met)[[row for row in platform.closing(end) if row < 3], 3]
        gap = max(gap, float(np.linalg.norm(shift)))
        if end.closes == "frame":
            R = Rotation.from_matrix(met[:3, :3].T @ tip[:3, :3])
            turn = max(turn, leg.size * float(R.magnitude()))
    return gap, turn
