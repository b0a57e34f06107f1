"""The architectures: their dimensions, and the functions that make mechanisms of them.

Hexapods, deltas, five-bars and 3-RRRs are the bundled mechanisms with other parameters, home poses
and limits of joints; joints, placements, sensors and labels are those of the bundled mechanisms.
Cable robots and arms are built from numbers.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from difflib import get_close_matches
from itertools import cycle
from math import pi, radians
from typing import Any

import numpy as np

from pincal.architectures.architecture import Architecture, Values, angle, length, text
from pincal.architectures.cables import CABLE_ROBOTS
from pincal.errors import MechanismError
from pincal.files.mechanism_folders import load_mechanism
from pincal.files.table import read_table
from pincal.formats.arm import arm
from pincal.formats.delta_printer import ANGLES, DeltaPrinter
from pincal.model import Joint, Mechanism, Placement, placement_of
from pincal.model.checks import must_be
from pincal.symmetry.elements import wrapped
from pincal.types import Array

Limits = Mapping[str, tuple[float, float]]


def _resized(
    bundled: str, legs: list[dict[str, float]], home: tuple[float, ...], *limits: Limits
) -> Mechanism:
    """Return a bundled mechanism with other parameters of each leg, home pose and joint limits.

    ``limits`` are by name of joint, [rad] or [m], once for all legs or once per leg.
    """
    template = load_mechanism(bundled)
    made = template.with_parameters(dict(zip(template.leg_names, legs, strict=True)))
    pairs = zip(made.legs, cycle(limits or ({},)), strict=False)
    limited = tuple(leg.with_limits(ends) for leg, ends in pairs)
    return replace(made, platform=replace(made.platform, home=home), legs=limited, description="")


def _hexapod(d: Values) -> Mechanism:
    """Return a hexapod: base joints in pairs at 0°, 120°, 240°, platform joints halfway."""
    legs = []
    for k in range(6):
        side = 1 - 2 * (k % 2)
        base = 2 * pi / 3 * ((k + 1) // 2) + side * d["base_half_angle"]
        platform = pi / 3 + 2 * pi / 3 * (k // 2) - side * d["platform_half_angle"]
        radii = {"OA": d["base_radius"], "ob": d["platform_radius"], "gamma": d["zero_length"]}
        legs.append(radii | {"beta": wrapped(base), "beta_b": wrapped(platform)})
    stroke = {"leg": (d["shortest"], d["longest"])}
    return _resized("6UPS", legs, (0.0, 0.0, d["height"], 0.0, 0.0, 0.0), stroke)


def _delta(d: Values) -> Mechanism:
    """Return a delta with drives at azimuths 0°, 120°, 240° and the platform below them."""
    sizes = {"OA": d["base_radius"], "l": d["arm"], "L": d["rod"]}
    limits = {"drive": (d["arm_up"], d["arm_down"])}
    made = _resized("delta", [sizes] * 3, (0.0, 0.0, -d["height"]), limits)
    legs = []
    for leg in made.legs:
        _, azimuth = leg.point.placement.coordinates[0].values
        placement = Placement.of({}, polar=(d["platform_radius"], azimuth))
        legs.append(replace(leg, point=replace(leg.point, placement=placement)))
    return replace(made, legs=tuple(legs))


def _linear_delta(d: Values) -> Mechanism:
    """Return a linear delta, towers at azimuths −150°, −30°, 90°, home on the bed's middle."""
    radius, rod, reach = d["delta_radius"], d["rod"], d["delta_radius"] + d["print_radius"]
    if rod <= reach:
        raise MechanismError(
            f"a rod of {1e3 * rod:.6g} mm does not reach from a tower to the far side of the bed, "
            f"{1e3 * reach:.6g} mm away; it must be longer than delta_radius + print_radius"
        )
    ends, angles = [d["endstop_height"]] * 3, [radians(angle) for angle in ANGLES]
    printer = DeltaPrinter(radius, angles, [rod] * 3, ends, d["print_radius"])
    return printer.mechanism("linear_delta", legs=("leg_1", "leg_2", "leg_3"))


def _five_bar(d: Values) -> Mechanism:
    """Return a five-bar, symmetric about the y axis, with motors on x and elbows outward."""
    links = {"l": d["driving_link"], "L": d["conducted_link"]}
    x = d["motor_distance"] / 2
    low, high = d["motor_least"], d["motor_most"]
    sides = {"shoulder": (low, high)}, {"shoulder": (pi - high, pi - low)}
    return _resized("5R", [links | {"A_x": -x}, links | {"A_x": x}], (0.0, d["height"]), *sides)


def _3rrr(d: Values) -> Mechanism:
    """Return a 3-RRR with motors and, at home, platform joints at azimuths −150°, −30°, 90°."""
    names = {"OA": "base_radius", "ob": "platform_radius", "l": "proximal", "L": "distal"}
    return _resized("3RRR", [{key: d[name] for key, name in names.items()}] * 3, (0.0,) * 3)


_SIXTH = radians(60)
_HEXAPOD = (
    length("base_radius", "radius of the base joints", 0.25),
    length("platform_radius", "radius of the platform joints", 0.6, "base_radius"),
    angle("base_half_angle", "half the angle between paired base joints", 15, 0.0, _SIXTH),
    angle("platform_half_angle", "half the angle between paired platform joints", 15, 0.0, _SIXTH),
    length("height", "height of the platform joints at home", 1.5, "base_radius"),
    length("shortest", "length of a leg drawn in", 0.9, "height"),
    length("longest", "length of a leg drawn out", 1.5, "shortest", above="shortest"),
    length("zero_length", "length of a leg where it reads zero", 0.0, least=0.0),
)
_DELTA = (
    length("base_radius", "radius of the drives' axes", 0.2),
    length("platform_radius", "radius of the rods' ends", 0.3, "base_radius"),
    length("arm", "length of the arms", 1.25, "base_radius"),
    length("rod", "length of the rods", 2.2, "arm"),
    length("height", "depth of the platform below the drives at home", 0.9, "rod"),
    angle("arm_up", "angle of an arm below the horizontal, least", -35, -pi),
    angle("arm_down", "angle of an arm below the horizontal, most", 80, -pi, pi, above="arm_up"),
)
_LINEAR_DELTA = (
    length("delta_radius", "radius of the towers less the offsets of carriage and effector", 0.175),
    length("rod", "length of the rods", 1.9, "delta_radius"),
    length("endstop_height", "height of the nozzle at the endstops", 1.7, "delta_radius"),
    length("print_radius", "radius of the bed that is reached", 0.65, "delta_radius"),
)
_FIVE_BAR = (
    length("motor_distance", "distance between the motors", 0.2),
    length("driving_link", "length of the driving links", 0.75, "motor_distance"),
    length("conducted_link", "length of the conducted links", 1.1, "motor_distance"),
    length("height", "distance of the end from the motors at home", 1.0, "conducted_link"),
    angle("motor_least", "least angle of a motor, 0 towards the other one", 30, -2 * pi),
    angle("motor_most", "largest angle of a motor", 225, most=2 * pi, above="motor_least"),
)
_3RRR = (
    length("base_radius", "radius of the motors", 0.3),
    length("platform_radius", "radius of the platform joints", 0.25, "base_radius"),
    length("proximal", "length of the proximal links", 0.45, "base_radius"),
    length("distal", "length of the distal links", 1.0, "proximal"),
)


def _printable(d: Values) -> str:
    """Return the ranges of the room over the bed."""
    x = y = f"{-d['print_radius']:g}..{d['print_radius']:g}"
    return f"x={x}, y={y}, z=0..{d['endstop_height']:g}"


_GOUGH = "Hexapod (Gough-Stewart platform), six legs with linear drives"
_TOWERS = "Linear delta, three carriages on upright towers"


def dh_joints(table: Any, convention: str = "standard") -> tuple[Joint, ...]:
    """Return the joints of a Denavit-Hartenberg table, the tool's frame last.

    A row of the standard convention is Rz(θ) Tz(d) Tx(a) Rx(α); its joint turns about z first. A
    row of the modified convention (Craig) is Rx(α) Tx(a) Rz(θ) Tz(d); its joint turns with Rz(θ).

    The table, a CSV file, has revolute joints only, with the columns
    ``a [mm]``, ``alpha [deg]``, ``d [mm]``, ``theta [deg]`` (at zero reading), and optionally
    the limits ``lower [deg]`` and ``upper [deg]``.
    """
    read = read_table(table)
    units = {"a": "m", "alpha": "rad", "d": "m", "theta": "rad"}
    rows = np.column_stack([read.numbers(name, unit) for name, unit in units.items()])
    limits = [
        read.numbers(name, "rad") if name in read else np.full(len(rows), usual)
        for name, usual in (("lower", -pi), ("upper", pi))
    ]
    T_behind_joint, joints = np.eye(4), []
    for number, ((a, alpha, d, theta), lower, upper) in enumerate(
        zip(rows.tolist(), *map(Array.tolist, limits), strict=True), start=1
    ):
        before, behind = {"rz": theta}, {"z": d, "x": a, "rx": alpha}
        if convention != "standard":
            before, behind = {"rx": alpha, "x": a, "rz": theta}, {"z": d}
        place = placement_of(T_behind_joint @ Placement.of({}, **before).origin())
        joints.append(Joint(f"joint_{number}", "revolute", place, lower=lower, upper=upper))
        T_behind_joint = Placement.of({}, **behind).origin()
    return (*joints, Joint("tip", "fixed", placement_of(T_behind_joint)))


def _arm(d: Values) -> Mechanism:
    if isinstance(d["dh"], str) and not d["dh"]:
        raise MechanismError(
            "an arm needs a Denavit-Hartenberg table (dh); to read an arm from a URDF, use "
            "'pincal import --tip LINK' or Mechanism.from_urdf"
        )
    convention = d["convention"]
    described = f"Serial arm of a table of Denavit and Hartenberg, {convention} convention."
    return arm("arm", dh_joints(d["dh"], convention), described)


_ARM = (
    text("dh", "CSV table of Denavit and Hartenberg"),
    text("convention", "convention of the table", "standard", "modified"),
)

_MADE = (
    Architecture("hexapod", _GOUGH, _HEXAPOD, _hexapod),
    Architecture("delta", "Delta robot, three rotary drives", _DELTA, _delta),
    Architecture("linear-delta", _TOWERS, _LINEAR_DELTA, _linear_delta, _printable),
    Architecture("five-bar", "Planar five-bar, two motors, elbows outward", _FIVE_BAR, _five_bar),
    Architecture("3-RRR", "Planar 3-RRR, three motors", _3RRR, _3rrr),
    *CABLE_ROBOTS,
    Architecture("arm", "Serial arm", _ARM, _arm),
)
ARCHITECTURES = {kind.name: kind for kind in _MADE}


def new_mechanism(architecture: str, *, name: str = "", **dimensions: Any) -> Mechanism:
    """Return a mechanism with a data sheet's dimensions: ``new_mechanism("hexapod", height=0.4)``.

    Args:
        architecture: ``"hexapod"``, ``"delta"``, ``"linear-delta"``, ``"five-bar"``, ``"3-RRR"``,
            ``"cable-4"``, ``"cable-8"``, or ``"arm"``.
        name: Name of the mechanism; by default the architecture's.
        **dimensions: Dimensions by name (``pincal new --help`` lists them): lengths [m], angles
            [rad], texts. Those not given are in proportion to the others.

    Raises:
        MechanismError: an architecture or dimension does not exist, a value is impossible, a leg
            does not reach home or is outside its limits there, or the legs do not hold the
            platform there.
        FileError: the table of an arm is missing or cannot be read.
        MeasurementError: a column or cell of an arm's table is missing or wrong.
    """
    kind = architecture_of(architecture)
    values = kind.complete(dimensions)
    made, described = kind.make(values), f"{kind.title}: {', '.join(kind.sheet(values))}."
    name, description = name or kind.name.replace("-", "_"), made.description or described
    made = replace(made, name=name, description=description)
    return made if made.by_readings else kind.at_home(made, values)


def architecture_of(name: str) -> Architecture:
    """Return an architecture by its name; capitals, hyphens and underscores do not matter."""
    known = {key.lower().replace("-", ""): kind for key, kind in ARCHITECTURES.items()}
    plain = re.sub("[-_]", "", must_be(name, str, "the architecture", MechanismError).lower())
    if plain not in known:
        near = get_close_matches(plain, known, 1)
        meant = f"; did you mean {known[near[0]].name!r}?" if near else ""
        raise MechanismError(
            f"no architecture {name!r}; expected one of {', '.join(ARCHITECTURES)}{meant}"
        )
    return known[plain]
