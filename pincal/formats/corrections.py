"""Code that turns joint positions into readings and back, of its own: a Python module, a C header.

A law is the same in both (``laws.py``); a language is the text around it.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from string import Template

import numpy as np

from pincal.errors import MechanismError
from pincal.kinematics.closing import sensor_law
from pincal.kinematics.closure import nominal_legs
from pincal.model.mechanism import Mechanism
from pincal.model.sensor import STEPS, PlacedTerm
from pincal.model.terms import APPROACH, LOAD, Harmonic, Knot, Power, Share
from pincal.model.units import COUNTS, SI, UNITS, Units
from pincal.types import Array

Pair = tuple[str, str]
ARGUMENT_PREFIX = "at_"
"""With which names of arguments begin, so that none is a word of a language."""


@dataclass(frozen=True)
class Law:
    """The law of one sensor: position = gain reading + start + terms, in units of its own."""

    name: str
    """Of the reading, as it may stand in code."""
    joint: str
    unit: str
    """Of the joint's position."""
    read_in: str
    """Unit of the reading."""
    gain: float
    start: float
    per_si: float
    """What one rad or m of the reading is in its unit."""
    terms: list[str] = field(default_factory=list)
    slopes: list[str] = field(default_factory=list)
    """By the reading, of the terms that depend on it."""
    arguments: dict[str, str] = field(default_factory=dict)
    """What terms depend on besides, by its name in code."""
    tables: dict[str, Array] = field(default_factory=dict)
    """Cubics between knots, by name: rows of start and coefficients of powers 0 to 3. The first
    row is for all below the first knot."""


def laws_of(mechanism: Mechanism, units: Units = SI) -> list[Law]:
    """Return the laws of all sensors of a mechanism, at its nominal parameters.

    Args:
        mechanism: The mechanism.
        units: Of joints' positions, readings and amplitudes.

    Raises:
        MechanismError: a term that is a function of one's own; a homed sensor and a home pose out
            of its leg's reach.
    """
    laws: list[Law] = []
    for leg in nominal_legs(mechanism):
        law, leg_of_law = sensor_law(leg), leg.leg
        for index, (name, si) in enumerate(
            zip(leg_of_law.reading_names, leg_of_law.reading_units, strict=True)
        ):
            unit, counts = units.names.get(si, si), units.counts.get(name)
            per_joint = 1.0 / UNITS[unit][1]
            per_reading = counts or per_joint
            sensor_code = Law(
                _identifier(name, [law.name for law in laws]),
                leg_of_law.sensors[index].joint,
                unit,
                COUNTS if counts else unit,
                float(law.slope[index]) * per_joint / per_reading,
                float(law.start[index]) * per_joint,
                per_reading,
            )
            _add_terms(sensor_code, [term for term in law.terms if term.target == index], per_joint)
            laws.append(sensor_code)
    return laws


def _add_terms(law: Law, terms: Sequence[PlacedTerm], per_joint: float) -> None:
    """Add the terms of a sensor to its law.

    Raises:
        MechanismError: a term that is a function of one's own.
    """
    errors: dict[tuple[str, tuple[float, ...], bool], Array] = {}
    for placed in terms:
        if not placed.term.has_form:
            raise MechanismError(
                f"{law.name}: the term of {placed.term.parameter!r} is a function of your own, "
                "which cannot be written in another language; a table over poses (.csv) holds it"
            )
        basis, amplitude = placed.term.basis, placed.amplitude * per_joint
        if isinstance(basis, Knot):
            table = errors.setdefault(
                (placed.term.of, basis.knots, basis.periodic), np.zeros(len(basis.knots))
            )
            table[basis.knot] += amplitude
        else:
            x, per = _argument_of(law, placed.term.of)
            value, slope = _form(basis, x, per)
            _add(law, placed.term.of, (f"{amplitude!r} * {value}", f"{amplitude!r} * {slope}"))
    for (of, knots, periodic), values in errors.items():
        x, per = _argument_of(law, of)
        scaled = per * np.array(knots)
        if periodic:  # back into the first period
            values[-1] = values[0]
            first, period = float(scaled[0]), float(np.ptp(scaled))
            x = f"{x} - {period!r} * floor(({x} - {first!r}) / {period!r})"
        name = f"{law.name}_table_{len(law.tables) + 1}"
        law.tables[name] = _cubics(scaled, values, periodic)
        called = f"({x}, {name}, {len(law.tables[name])})"
        _add(law, of, (f"spline{called}", f"spline_slope{called}"))


def _argument_of(law: Law, column: str) -> tuple[str, float]:
    """Return what a term depends on, as it is written in code, and how many of it are one of SI."""
    if not column:
        return "reading", law.per_si
    known = {column: name for name, column in law.arguments.items()}
    name = known.get(column) or _identifier(
        ARGUMENT_PREFIX + column, [*law.arguments, f"{law.name}_joint"]
    )
    law.arguments[name] = column
    return name, 1.0


def _add(law: Law, column: str, term: Pair) -> None:
    """Add a term and its slope; one of an influence is zero where that is not known."""
    value, slope = term
    law.terms.append(f"known({value})" if column else value)
    law.slopes.extend([] if column else [slope])


def _form(basis: object, x: str, per: float) -> Pair:
    """Return a form of terms, and its derivative, by ``x`` in a unit of which ``per`` are one."""
    if isinstance(basis, Harmonic):
        rate = basis.rate / per
        turn = f"({rate!r} * {x})"
        if basis.phase == "sine":
            return f"sin{turn}", f"{rate!r} * cos{turn}"
        return f"cos{turn}", f"{-rate!r} * sin{turn}"
    if isinstance(basis, Power):
        shared = f"(({x} - {basis.centre * per!r}) / {basis.range * per!r}"
        slope = basis.power / (basis.range * per)
        return f"pow{shared}, {basis.power})", f"{slope!r} * pow{shared}, {basis.power - 1})"
    assert isinstance(basis, Share)
    share = basis.per * per
    return f"(({x} - {basis.reference * per!r}) / {share!r})", f"{1.0 / share!r}"


def _cubics(knots: Array, values: Array, periodic: bool) -> Array:
    """Return the pieces of a table, straight outside its knots, shape (n_knots + 1, 5)."""
    from scipy.interpolate import CubicSpline  # slow to import, and needed here only

    spline = CubicSpline(knots, values, bc_type="periodic" if periodic else "natural")
    ends = np.zeros((2, 5))
    ends[:, 0] = knots[[0, -1]]
    ends[:, 1], ends[:, 2] = values[[0, -1]], spline(ends[:, 0], 1)
    return np.concatenate((ends[:1], np.column_stack((knots[:-1], spline.c[::-1].T)), ends[1:]))


def _identifier(text: str, taken: Collection[str]) -> str:
    """Return a text as a name in code that is not taken."""
    name = re.sub(r"\W|^(?=\d)", "_", text, flags=re.ASCII)
    while name in taken:
        name += "_"
    return name


_SMALL = f"{np.sqrt(np.finfo(float).eps):.1e}"  # the step of Newton's method after it is rounding
_MEANS = {
    APPROACH: "+1 where the reading rose to its value, -1 where it fell",
    LOAD: "what gravity does [N] or [N m] along the joint's positive direction, not the drive",
}


@dataclass(frozen=True)
class Language:
    """What is around laws in a language."""

    mark: str
    """Before a comment."""
    head: str
    tail: str
    helpers: Mapping[str, str]
    """By name, those that some law calls are written."""
    table: str
    row: str
    law: str
    argument: str
    """How an argument is declared."""


PYTHON = Language(
    mark="#",
    head='''"""Readings of joints' positions, and positions of readings."""

from math import cos, floor, nan, sin
''',
    tail="",
    helpers={
        "known": '''

def known(term):
    """Return a term; 0 where what it depends on is not known (nan)."""
    return 0.0 if term != term else term
''',
        "spline": '''

def piece(value, table, rows):
    """Return which row of a table a value is in: a start, and coefficients of powers 0 to 3."""
    k = 0
    while k + 1 < rows and table[k + 1][0] <= value:
        k += 1
    return table[k]


def spline(value, table, rows):
    """Return a table at a value."""
    start, a, b, c, d = piece(value, table, rows)
    x = value - start
    return a + x * (b + x * (c + x * d))


def spline_slope(value, table, rows):
    """Return the table's derivative."""
    start, _, b, c, d = piece(value, table, rows)
    x = value - start
    return b + x * (2.0 * c + x * 3.0 * d)
''',
    },
    table="\n\n$name = (\n$rows)\n",
    row="    ({}),\n",
    law='''

def ${name}_joint(reading$declared):
    """Return the position [$unit] of joint $joint at a reading [$read_in]."""
    return (
        $position
    )


def ${name}_slope(reading):
    """Return its derivative by the reading [$unit/$read_in]."""
    return (
        $slope
    )


def ${name}_reading(joint$declared):
    """Return the reading [$read_in] at a position [$unit] of joint $joint; nan if none is found."""
    reading = (joint - $start) / $gain
    for _ in range($steps):
        step = (joint - ${name}_joint(reading$given)) / ${name}_slope(reading)
        reading += step
        if abs(step) <= $small * max($one, abs(reading)):
            return reading
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
    helpers={
        "known": """
// A term; 0 where what it depends on is not known (NAN).
static inline double known(double term)
{
    return term != term ? 0.0 : term;
}
""",
        "spline": """
// Which row of a table a value is in: a start, and coefficients of powers 0 to 3.
static inline const double *piece(double value, const double table[][5], int rows)
{
    int k = 0;
    while (k + 1 < rows && table[k + 1][0] <= value)
        ++k;
    return table[k];
}

// A table at a value.
static inline double spline(double value, const double table[][5], int rows)
{
    const double *p = piece(value, table, rows), x = value - p[0];
    return p[1] + x * (p[2] + x * (p[3] + x * p[4]));
}

// The table's derivative.
static inline double spline_slope(double value, const double table[][5], int rows)
{
    const double *p = piece(value, table, rows), x = value - p[0];
    return p[2] + x * (2.0 * p[3] + x * 3.0 * p[4]);
}
""",
    },
    table="\nstatic const double $name[$count][5] = {\n$rows};\n",
    row="    {{{}}},\n",
    law="""
// The position [$unit] of joint $joint at a reading [$read_in].
static inline double ${name}_joint(double reading$declared)
{
    return (
        $position
    );
}

// Its derivative by the reading [$unit/$read_in].
static inline double ${name}_slope(double reading)
{
    (void)reading;
    return (
        $slope
    );
}

// The reading [$read_in] at a position [$unit] of joint $joint; NAN if none is found.
static inline double ${name}_reading(double joint$declared)
{
    double reading = (joint - $start) / $gain;
    for (int k = 0; k < $steps; ++k) {
        const double step = (joint - ${name}_joint(reading$given)) / ${name}_slope(reading);
        reading += step;
        if (fabs(step) <= $small * fmax($one, fabs(reading)))
            return reading;
    }
    return NAN;
}
""",
    argument=", double {}",
)
LANGUAGES = {"python": PYTHON, "c": C}


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
    laws = laws_of(mechanism, units)
    if mechanism.reads_positions:
        raise MechanismError(
            f"{mechanism.name!r}: readings are joint positions, without gains, offsets and terms "
            "of sensors; no code is needed"
        )
    body = "".join(_written(law, language) for law in laws)
    used = [text for name, text in language.helpers.items() if f"{name}(" in body]
    arguments = {name: column for law in laws for name, column in law.arguments.items()}
    legend = [f"Sensors of {mechanism.name!a}, written by pincal."]
    legend += [
        f"{name}: {_MEANS.get(of, f'column {of!a} of the measurements')}; nan: its terms are 0."
        for name, of in arguments.items()
    ]
    comment = "".join(f"{language.mark} {line}\n" for line in legend)
    return "".join((comment, language.head, *used, body, language.tail))


def _written(law: Law, language: Language) -> str:
    """Return a law, and its tables before it."""
    tables = [
        Template(language.table).substitute(
            name=name,
            count=len(rows),
            rows="".join(language.row.format(", ".join(map(repr, row))) for row in rows.tolist()),
        )
        for name, rows in law.tables.items()
    ]
    lines = "\n        + "
    text = Template(language.law).substitute(
        name=law.name,
        joint=law.joint,
        unit=law.unit,
        read_in=law.read_in,
        gain=repr(law.gain),
        start=repr(law.start),
        one=repr(law.per_si),
        position=lines.join((f"{law.gain!r} * reading", repr(law.start), *law.terms)),
        slope=lines.join((repr(law.gain), *law.slopes)),
        declared="".join(map(language.argument.format, law.arguments)),
        given="".join(f", {name}" for name in law.arguments),
        steps=STEPS,
        small=_SMALL,
    )
    return "".join((*tables, text))
