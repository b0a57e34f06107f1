"""Code that turns joint positions into readings and back, of its own: a Python module, a C header.

A law is the same in both (``laws.py``); a language is the text around it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from string import Template

import numpy as np

from pincal.errors import MechanismError
from pincal.files.tables.units import SI, Units
from pincal.formats.corrections.laws import Law, laws_of
from pincal.model.mechanism import Mechanism
from pincal.model.sensors.sensor import STEPS
from pincal.model.sensors.terms import APPROACH, LOAD

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
    arguments = {name: of for law in laws for name, of in law.arguments.items()}
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
        one=repr(law.one),
        position=lines.join((f"{law.gain!r} * reading", repr(law.start), *law.terms)),
        slope=lines.join((repr(law.gain), *law.slopes)),
        declared="".join(map(language.argument.format, law.arguments)),
        given="".join(f", {name}" for name in law.arguments),
        steps=STEPS,
        small=_SMALL,
    )
    return "".join((*tables, text))
