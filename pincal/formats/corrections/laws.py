"""Laws of sensors as expressions that mean the same in Python and in C.

Numbers, sums, ``sin``, ``cos``, ``pow`` and calls are written alike in both languages, so a law is
written once. Units are in its numbers.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MechanismError
from pincal.files.tables.units import COUNTS, SI, Units
from pincal.kinematics.legs.closing import sensor_law
from pincal.kinematics.legs.closure import nominal_legs
from pincal.model.mechanism import Mechanism
from pincal.model.sensors.sensor import PlacedTerm
from pincal.model.sensors.terms import Harmonic, Knot, Power, Share
from pincal.model.units import UNITS

Array = NDArray[np.float64]
Pair = tuple[str, str]
AT = "at_"
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
    one: float
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
    found: list[Law] = []
    for leg in nominal_legs(mechanism):
        law, own = sensor_law(leg), leg.leg
        for index, (name, si) in enumerate(zip(own.reading_names, own.reading_units, strict=True)):
            unit, counts = units.names.get(si, si), units.counts.get(name)
            per_joint = 1.0 / UNITS[unit][1]
            per_reading = counts or per_joint
            one = Law(
                _identifier(name, [law.name for law in found]),
                own.sensors[index].joint,
                unit,
                COUNTS if counts else unit,
                float(law.slope[index]) * per_joint / per_reading,
                float(law.start[index]) * per_joint,
                per_reading,
            )
            _add_terms(one, [each for each in law.terms if each.target == index], per_joint)
            found.append(one)
    return found


def _add_terms(law: Law, terms: Sequence[PlacedTerm], per_joint: float) -> None:
    """Add the terms of a sensor to its law.

    Raises:
        MechanismError: a term that is a function of one's own.
    """
    errors: dict[tuple[str, tuple[float, ...], bool], Array] = {}
    for one in terms:
        if not one.term.has_form:
            raise MechanismError(
                f"{law.name}: the term of {one.term.parameter!r} is a function of your own, which "
                "cannot be written in another language; a table over poses (.csv) holds it"
            )
        basis, amplitude = one.term.basis, one.amplitude * per_joint
        if isinstance(basis, Knot):
            table = errors.setdefault(
                (one.term.of, basis.knots, basis.periodic), np.zeros(len(basis.knots))
            )
            table[basis.knot] += amplitude
        else:
            x, per = _by(law, one.term.of)
            value, slope = _form(basis, x, per)
            _add(law, one.term.of, (f"{amplitude!r} * {value}", f"{amplitude!r} * {slope}"))
    for (of, knots, periodic), values in errors.items():
        x, per = _by(law, of)
        scaled = per * np.array(knots)
        if periodic:  # back into the first period
            values[-1] = values[0]
            first, period = float(scaled[0]), float(np.ptp(scaled))
            x = f"{x} - {period!r} * floor(({x} - {first!r}) / {period!r})"
        name = f"{law.name}_table_{len(law.tables) + 1}"
        law.tables[name] = _cubics(scaled, values, periodic)
        called = f"({x}, {name}, {len(law.tables[name])})"
        _add(law, of, (f"spline{called}", f"spline_slope{called}"))


def _by(law: Law, of: str) -> tuple[str, float]:
    """Return what a term depends on, as it is written in code, and how many of it are one of SI."""
    if not of:
        return "reading", law.one
    known = {column: name for name, column in law.arguments.items()}
    name = known.get(of) or _identifier(AT + of, [*law.arguments, f"{law.name}_joint"])
    law.arguments[name] = of
    return name, 1.0


def _add(law: Law, of: str, term: Pair) -> None:
    """Add a term and its slope; one of an influence is zero where that is not known."""
    value, slope = term
    law.terms.append(f"known({value})" if of else value)
    law.slopes.extend([] if of else [slope])


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
