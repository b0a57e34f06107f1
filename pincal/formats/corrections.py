"""Corrections for controllers that know a machine without its terms: over poses, or as code.

Over poses they are differences of readings. Such a controller takes the plain machine, geometry,
gains and offsets, to a pose by readings ψ_plain; the machine with all its terms is there at ψ, so
that it needs ψ − ψ_plain. Or it is sent to another pose x', at which its own readings are ψ.

As code they are the laws of the sensors, joint positions of readings and back, in a Python module
or a C header that need nothing else. Expressions are the same in both; a language is the text
around them. Back they go by secants.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from string import Template
from typing import TypeVar

import numpy as np

from pincal.errors import MechanismError
from pincal.files.measurement_writing import Columns, columns_of, reason_column
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.kinematics.closing import sensor_law
from pincal.kinematics.closure import LegClosure, nominal_legs
from pincal.kinematics.configurations import as_plan, joints_at
from pincal.kinematics.forward import forward
from pincal.kinematics.influences import own_influences
from pincal.kinematics.inverse import inverse
from pincal.model.measurements import Plan
from pincal.model.mechanism import Mechanism
from pincal.model.sensor import STEPS
from pincal.model.terms import APPROACH, LOAD, Harmonic, Power, Share, Term
from pincal.model.units import COUNTS, SI, UNITS, Units
from pincal.types import Array

T = TypeVar("T")
CORRECTION, COMMAND = "correction", "command"


@dataclass(frozen=True, repr=False)
class Corrections:
    """What takes the whole machine to N poses by a controller that knows the plain one.

    Example:
        >>> import pincal
        >>> found = pincal.corrections("5R", [[0.0, 1.1], [0.2, 1.2]])
        >>> found.readings.shape  # of a machine without terms there is nothing to add
        (2, 2)
        >>> abs(found.readings).max() < 1e-9
        np.True_
    """

    plan: Plan
    """The poses; and the readings of the plain machine, where poses do not determine them."""
    readings: Array
    """What to add to readings of the plain machine, shape (N, n_readings), [rad] or [m]; NaN where
    there is none."""
    commands: Array | None
    """Poses to command instead, shape (N, dof), [m] and [rad]; NaN where there is none. None if
    the legs demand more than there are freedoms: no pose has just these readings then."""
    reasons: tuple[str, ...]
    """Why a row has no correction or command; empty strings where it has both."""

    def __repr__(self) -> str:
        """Return the corrections in a line."""
        count = self.reasons.count("")
        return f"Corrections: {count} of {len(self.reasons)} poses"


def corrections(mechanism: GivenMechanism, planned: Plan | Array) -> Corrections:
    """Return what a controller lacks at poses that knows the mechanism without its terms.

    Args:
        mechanism: The mechanism, at its nominal parameters.
        planned: N poses, coordinates of shape (N, dof), [m] and [rad]; or a plan, whose columns of
            influences count, NaN or none at their reference. Where readings do not follow from
            poses, as of an arm, its readings say by the plain machine which poses these are.

    Raises:
        MechanismError: poses or readings of a wrong shape, or not finite; a homed sensor and a
            home pose out of its leg's reach.
    """
    mechanism = as_mechanism(mechanism)
    plain, plan = mechanism.without_terms, as_plan(mechanism, planned)
    safe = poses = plan.poses
    reasons_plain: tuple[str, ...] = ("",) * len(plan)
    if plan.readings is not None:
        plain_poses = forward(plain, plan.readings, poses)
        poses, reasons_plain = plain_poses.poses, plain_poses.reasons
        safe = np.where(np.isfinite(poses), poses, mechanism.platform.home)
    started = joints_at(plain, Plan(safe, readings=plan.readings))
    influences = own_influences(mechanism, plan.influences)
    reached = inverse(mechanism, safe, influences, started.joints)
    reasons = [reason or reached.reason(row) for row, reason in enumerate(reasons_plain)]
    has_readings = np.array([not reason for reason in reasons], dtype=bool)
    commands = None if mechanism.redundant else np.full(poses.shape, np.nan)
    if commands is not None:
        commanded = forward(plain, reached.readings[has_readings], safe[has_readings])
        commands[has_readings] = commanded.poses
        for row, reason in zip(np.flatnonzero(has_readings), commanded.reasons, strict=True):
            reasons[row] = reason
    readings = started.readings if mechanism.by_readings else None
    return Corrections(
        Plan(poses, readings=readings, influences=influences),
        np.where(has_readings[:, None], reached.readings - started.readings, np.nan),
        commands,
        tuple(reasons),
    )


def correction_columns(
    mechanism: Mechanism, lacking: Corrections, orientation: str = "tilt-torsion"
) -> Columns:
    """Return a table of corrections: poses, ``correction_leg_1 [rad]``, ``command_x [m]``, reasons.

    Args:
        mechanism: The mechanism.
        lacking: The corrections.
        orientation: Way to write a spatial platform's orientation, a key of ``WAYS``.
    """
    columns = columns_of(mechanism, lacking.plan, orientation)
    named = zip(mechanism.reading_names, mechanism.reading_units, lacking.readings.T, strict=True)
    columns |= corrected({f"{name} [{unit}]": values for name, unit, values in named})
    if lacking.commands is not None:
        commands = columns_of(mechanism, Plan(lacking.commands), orientation)
        columns |= {f"{COMMAND}_{header}": values for header, values in commands.items()}
    return columns | reason_column(lacking.reasons)


def corrected(of_readings: Mapping[str, T]) -> dict[str, T]:
    """Return what belongs to readings, by their names, as of the columns of their corrections."""
    return {f"{CORRECTION}_{name}": value for name, value in of_readings.items()}


@dataclass(frozen=True)
class Language:
    """What is around laws in a language."""

    mark: str
    """Before a comment."""
    head: str
    tail: str
    known: str
    """A function that laws with further arguments call."""
    law: str
    argument: str
    """How an argument is declared."""


PYTHON = Language(
    mark="#",
    head='''"""Readings of joints' positions, and positions of readings."""

from math import cos, nan, sin
''',
    tail="",
    known='''

def known(term):
    """Return a term; 0 where what it depends on is not known (nan)."""
    return 0.0 if term != term else term
''',
    law='''

def ${name}_joint(reading$declared):
    """Return the position [$unit] of joint $joint at a reading [$read_in]."""
    return (
        $position
    )


def ${name}_reading(joint$declared):
    """Return the reading [$read_in] at a position [$unit] of joint $joint; nan if none is found."""
    reading, slope = (joint - $start) / $gain, $gain
    reached = ${name}_joint(reading$passed)
    for _ in range($steps):
        step = (joint - reached) / slope
        reading += step
        if abs(step) <= $small * max($one, abs(reading)):
            return reading
        before, reached = reached, ${name}_joint(reading$passed)
        slope = (reached - before) / step or nan
    return nan
''',
    argument=", {}=nan",
)
C = Language(
    mark="//",
    head="""// Readings of joints' positions, and positions of readings.
#ifndef PINCAL_CORRECTIONS_H
#define PINCAL_CORRECTIONS_H

#include <math.h>
""",
    tail="\n#endif\n",
    known="""
// A term; 0 where what it depends on is not known (NAN).
static inline double known(double term)
{
    return term != term ? 0.0 : term;
}
""",
    law="""
// The position [$unit] of joint $joint at a reading [$read_in].
static inline double ${name}_joint(double reading$declared)
{
    return (
        $position
    );
}

// The reading [$read_in] at a position [$unit] of joint $joint; NAN if none is found.
static inline double ${name}_reading(double joint$declared)
{
    double reading = (joint - $start) / $gain, slope = $gain;
    double reached = ${name}_joint(reading$passed);
    for (int k = 0; k < $steps; ++k) {
        const double step = (joint - reached) / slope, before = reached;
        reading += step;
        if (fabs(step) <= $small * fmax($one, fabs(reading)))
            return reading;
        reached = ${name}_joint(reading$passed);
        slope = (reached - before) / step;
    }
    return NAN;
}
""",
    argument=", double {}",
)
LANGUAGES = {"python": PYTHON, "c": C}
_SMALL = 1e-11  # of a reading: the step of secants after it is rounding
_MEANS = {
    APPROACH: "+1 where the reading rose to its value, -1 where it fell",
    LOAD: "what gravity does [N] or [N m] along the joint's positive direction, not the drive",
}


def code_of(mechanism: Mechanism, language: Language, units: Units = SI) -> str:
    """Return functions ``leg_1_joint(reading)`` and ``leg_1_reading(joint)`` for each sensor.

    What terms depend on besides are further arguments; those that are NaN count as at reference.

    Args:
        mechanism: The mechanism, at its nominal parameters.
        language: Of the code.
        units: Of joint positions and readings.

    Raises:
        MechanismError: readings are joint positions, so there is nothing to write; a term that is
            a function of one's own; a homed sensor and a home pose out of its leg's reach.
    """
    if mechanism.reads_positions:
        raise MechanismError(
            f"{mechanism.name!r}: readings are joint positions, without gains, offsets and terms "
            "of sensors; no code is needed"
        )
    names: list[str] = []
    for reading in mechanism.reading_names:
        names.append(_identifier(reading, names))
    arguments: dict[str, str] = {}  # names in code, of what terms follow; no word of a language
    sensors = [sensor for leg in mechanism.legs for sensor in leg.sensors]
    for of in dict.fromkeys(term.of for sensor in sensors for term in sensor.terms if term.of):
        functions = [f"{name}_joint" for name in names]
        arguments[of] = _identifier(f"at_{of}", [*arguments.values(), *functions])
    body = ""
    for leg, columns in zip(nominal_legs(mechanism), mechanism.reading_columns, strict=True):
        for index, name in enumerate(names[columns]):
            body += Template(language.law).substitute(
                name=name, **_law(leg, index, units, language, arguments)
            )
    comments = [f"Sensors of {mechanism.name!a}, written by pincal."]
    comments += [
        f"{name}: {_MEANS.get(of, f'column {of!a} of the measurements')}; nan: its terms are 0."
        for of, name in arguments.items()
    ]
    comment = "".join(f"{language.mark} {line}\n" for line in comments)
    return "".join((comment, language.head, language.known * bool(arguments), body, language.tail))


def _law(
    leg: LegClosure, index: int, units: Units, language: Language, arguments: Mapping[str, str]
) -> dict[str, object]:
    """Return what a language's template says of one sensor of a leg."""
    law, name, si = sensor_law(leg), leg.leg.reading_names[index], leg.leg.reading_units[index]
    unit, counts = units.names.get(si, si), units.counts.get(name)
    per_joint = 1.0 / UNITS[unit][1]
    per_reading = counts or per_joint  # how many are one rad or m
    gain = float(law.slope[index]) * per_joint / per_reading
    start = float(law.start[index]) * per_joint
    placed = [term for term in law.terms if term.target == index]
    used = {arguments[term.term.of]: None for term in placed if term.term.of}
    terms = [
        f"{term.amplitude * per_joint!r} * "
        + _form(term.term, arguments.get(term.term.of, "reading"), per_reading)
        for term in placed
    ]
    return {
        "joint": leg.leg.sensors[index].joint,
        "unit": unit,
        "read_in": COUNTS if counts else unit,
        "gain": repr(gain),
        "start": repr(start),
        "one": repr(per_reading),
        "position": "\n        + ".join((f"{gain!r} * reading", repr(start), *terms)),
        "declared": "".join(map(language.argument.format, used)),
        "passed": "".join(f", {argument}" for argument in used),
        "steps": STEPS,
        "small": _SMALL,
    }


def _form(term: Term, x: str, per: float) -> str:
    """Return a term as code by ``x``: the reading (``per`` are one rad or m), or a column."""
    basis, per = term.basis, 1.0 if term.of else per
    if isinstance(basis, Harmonic):
        function = "sin" if basis.phase == "sine" else "cos"
        form = f"{function}({basis.rate / per!r} * {x})"
    elif isinstance(basis, Power):
        form = f"pow(({x} - {basis.centre * per!r}) / {basis.range * per!r}, {basis.power})"
    elif isinstance(basis, Share):
        form = f"(({x} - {basis.reference * per!r}) / {basis.per * per!r})"
    else:
        raise MechanismError(
            f"the term of {term.parameter!r} is a function of your own, which cannot be written in "
            "another language; a table over poses (.csv) holds it"
        )
    return f"known({form})" if term.of else form


def _identifier(text: str, taken: Collection[str]) -> str:
    """Return a text as a name in code that is not taken."""
    name = re.sub(r"\W|^(?=\d)", "_", text, flags=re.ASCII)
    while name in taken:
        name += "_"
    return name
