"""What must agree in a leg and in a mechanism: checked where they are made."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from pincal.errors import MechanismError
from pincal.model.checks import LARGEST
from pincal.model.orientation import SINGLE_ANGLES, WAYS
from pincal.model.placement import Placement
from pincal.model.sensor import check_terms
from pincal.types import Array

if TYPE_CHECKING:
    from pincal.model.leg import Leg
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
        count, unlike = 1, plain
        while unlike in taken:
            count += 1
            unlike = f"{plain}_{count}"
        taken.append(unlike)
    return tuple(taken)


def check_leg(leg: Leg) -> None:
    """Raise if joints, sensors, parameters and terms of a leg do not go together.

    Raises:
        MechanismError: what is wrong.
    """
    for joint in leg.moving:
        finite = np.isfinite([joint.lower, joint.upper])
        unbounded = joint.kind == "revolute" and not finite.any()
        if not (joint.lower < joint.upper and (finite.all() or unbounded)):
            raise MechanismError(
                f"{leg.name}: joint {joint.name!r} has limits {joint.lower:g} to "
                f"{joint.upper:g}; expected finite ones, lower below upper"
            )
    names = [joint.name for joint in leg.joints]
    if len(set(names)) != len(names):
        raise MechanismError(f"{leg.name}: joint names repeat: {names}")
    read = [sensor.joint for sensor in leg.sensors]
    if wrong := [name for name in read if name not in {j.name for j in leg.moving}]:
        raise MechanismError(
            f"{leg.name}: active joint {wrong[0]!r} is not a moving joint of the "
            f"leg; it has {', '.join(j.name for j in leg.moving)}"
        )
    if not read or len(set(read)) != len(read):
        raise MechanismError(
            f"{leg.name}: its sensors read {', '.join(read) or 'nothing'}; expected one "
            "sensor or more, each of another joint"
        )
    check_terms(leg, leg.placed)
    used = set(leg.units)
    declared = [name for name, _ in leg.parameters]
    if len(set(declared)) != len(declared):
        raise MechanismError(f"{leg.name}: parameter names repeat: {declared}")
    if missing := used - set(declared):
        raise MechanismError(
            f"{leg.name}: parameter {sorted(missing)[0]!r} is used in a placement or the "
            "sensor but has no nominal value under 'parameters'"
        )
    if unused := set(declared) - used:
        raise MechanismError(
            f"{leg.name}: parameter {sorted(unused)[0]!r} is used by no placement and not "
            "by the sensor; name it in one of them or remove it"
        )
    if not all(np.isfinite(value) for _, value in leg.parameters):
        raise MechanismError(f"{leg.name}: a nominal parameter is not a finite number")
    for sensor in leg.sensors:
        gain, _ = sensor.constants(leg.nominal_by_name)
        if not 1.0 / LARGEST <= abs(gain) <= LARGEST:
            raise MechanismError(
                f"{leg.name}: the sensor's gain is {gain:g}; expected one that is neither "
                f"zero nor more than {LARGEST:g} times too small or large"
            )
    for joint in (*leg.joints, leg.point):
        joint.placement.rest(leg.nominal_by_name, f"{leg.name}, joint {joint.name!r}")


def check_mechanism(mechanism: Mechanism) -> None:
    """Raise if the legs, their names and what weighs on them do not go together.

    Raises:
        MechanismError: what is wrong.
    """
    where = f"mechanism {mechanism.name!r}"
    names = [leg.name for leg in mechanism.legs]
    if not names:
        raise MechanismError(f"{where} has no legs")
    if len(set(names)) != len(names):
        raise MechanismError(f"{where}: leg names repeat: {names}")
    if not (mechanism.name and mechanism.name.isprintable() and len(mechanism.name) <= 100):
        raise MechanismError(f"{mechanism.name[:100]!r} is no name for a mechanism")
    readings = mechanism.reading_names
    if taken := [name for name in readings if name in RESERVED or name.startswith("sigma_")]:
        raise MechanismError(
            f"{where}: a reading named {taken[0]!r} cannot be distinguished "
            f"from that column of a pose; rename its joint or leg ({taken[0]}_joint, say)"
        )
    if taken := [name for name in mechanism.influences if name in RESERVED or name in readings]:
        raise MechanismError(
            f"{where}: a term depends on {taken[0]!r}, which is another column "
            "of tables; name the influence otherwise"
        )
    if odd := [name for name in mechanism.influences if not _is_column(name)]:
        raise MechanismError(
            f"{where}: a term depends on {odd[0]!r}, which heads no column of a table; expected a "
            "name such as temperature: no brackets, no blanks around it, not sigma_… or cov_…"
        )
    known = {one.id for one in mechanism.parameters}
    drawn = () if mechanism.load is None else mechanism.load.drawn
    if odd := [name for name, _ in drawn if name not in known]:
        raise MechanismError(f"{where}: the load's drawing has {odd[0]!r}, which is no parameter")
    if mechanism.load is None and mechanism.loaded:
        raise MechanismError(
            f"{where}: a term depends on a load, but what "
            "weighs on the mechanism is not said; give 'load' (mass, centre, gravity)"
        )
    if len(set(readings)) != len(readings):
        raise MechanismError(
            f"{where}: names of readings repeat: {', '.join(readings)}; a "
            "leg's only sensor is named after the leg, several ones after their joints"
        )
    if "platform" in names:
        raise MechanismError("'platform' names the platform's file; name the leg otherwise")
    points: dict[str, tuple[str, Placement]] = {}
    for leg in mechanism.legs:
        other, placement = points.setdefault(leg.point.name, (leg.name, leg.point.placement))
        if other != leg.name and (placement != leg.point.placement or placement.parameter_units):
            raise MechanismError(
                f"{other} and {leg.name} share the platform point {leg.point.name!r}, so it "
                "must be the same for both and have no parameters; give each leg its own point"
            )
    for leg in mechanism.legs:
        rows, passive = len(mechanism.platform.closing(leg.closes)), len(leg.passive)
        if passive >= rows:
            raise MechanismError(
                f"{leg.name} has {passive} passive joints for {rows} rows of its closure: it "
                "demands nothing of the platform; read another of its joints, or leave it out"
            )
    planar = mechanism.platform.space == 2
    for leg in mechanism.legs if planar else ():
        for joint in leg.joints:
            _check_planar(leg.name, joint.name, joint.kind, joint.placement.origin(), joint.axis)


def _is_column(name: str) -> bool:
    """Return whether a table may have a column of an influence quantity by this name."""
    plain = name == name.strip() != "" and not set("[]") & set(name)
    return plain and not name.startswith(("sigma_", "cov_"))


def _check_planar(
    leg: str, joint: str, kind: str, origin: Array, axis: tuple[float, float, float]
) -> None:
    """Raise if a joint would move the leg out of the x-y plane of the base."""
    out_of_plane = abs(abs(origin[2, 2]) - 1.0) > 1e-9
    along_z = abs(abs(axis[2]) - 1.0) < 1e-9
    in_plane = abs(axis[2]) < 1e-9
    wrong_axis = (kind == "revolute" and not along_z) or (kind == "prismatic" and not in_plane)
    if out_of_plane or wrong_axis:
        raise MechanismError(
            f"{leg}: joint {joint!r} leaves the plane; in a planar mechanism revolute axes are "
            "parallel to z, prismatic axes perpendicular to it, and frames turn about z only"
        )
