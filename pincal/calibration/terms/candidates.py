"""Terms that a sensor may lack, by kind, in the scale of what was measured.

Kinds are said as ``harmonics:1,2``, ``polynomial:2,3``, ``backlash``, ``gravity``, ``order``, or by
the name of a column of the measurements, such as ``temperature``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MeasurementError
from pincal.kinematics.configurations import planned_influences
from pincal.kinematics.influences.columns import by_name
from pincal.model.checks import ROUNDING
from pincal.model.leg import Leg
from pincal.model.measurements import Measurements
from pincal.model.mechanism import Mechanism
from pincal.model.sensors.terms import APPROACH, LOAD, Harmonic, Power, Share, Term

Array = NDArray[np.float64]
HARMONICS, POLYNOMIAL, BACKLASH, GRAVITY = "harmonics", "polynomial", "backlash", "gravity"
AUTO = "auto"
"""Those that pay, of all kinds."""
ORDER = "order"
"""The order of rows, from -1 to 1: no term, since no command has it, but a sign of drift."""
_OF_ONES_OWN = {BACKLASH: APPROACH, GRAVITY: LOAD}
_KINDS = (HARMONICS, POLYNOMIAL, BACKLASH, GRAVITY, ORDER)
_NUMBERS = {HARMONICS: (1.0, 2.0), POLYNOMIAL: (2.0, 3.0)}


@dataclass(frozen=True)
class Kind:
    """A kind of term, such as harmonics of orders 1 and 2."""

    name: str
    """``"harmonics"``, ``"polynomial"``, ``"backlash"``, ``"gravity"``, or a column."""
    numbers: tuple[float, ...] = ()
    """Orders of harmonics, powers of a polynomial."""

    @classmethod
    def of(cls, said: str) -> Kind:
        """Return the kind that a text names.

        Raises:
            MeasurementError: numbers that are none, or that the kind does not have.
        """
        name, colon, numbers = said.partition(":")
        usual = _NUMBERS.get(name.strip(), ())
        try:
            given = tuple(float(one) for one in numbers.split(",")) if colon else usual
        except ValueError:
            given = (np.nan,)
        whole = name.strip() != POLYNOMIAL or all(one in range(2, 21) for one in given)
        if not (all(0.0 < one < np.inf for one in given) and whole and bool(usual) >= bool(colon)):
            raise MeasurementError(
                f"terms {said!r}: expected harmonics:1,2 (periods in a turn), polynomial:2,3 "
                "(powers, 2 to 20), backlash, gravity, or a column of the measurements"
            )
        return cls(name.strip(), given)

    def __str__(self) -> str:
        if self.numbers == _NUMBERS.get(self.name, ()):
            return self.name
        return f"{self.name}:{','.join(f'{one:g}' for one in self.numbers)}"


def kinds_of(mechanism: Mechanism, measurements: Measurements) -> tuple[Kind, ...]:
    """Return the kinds of term that measurements can show: gravity where the load is known."""
    angles = "rad" in mechanism.reading_units
    names = [HARMONICS] * angles + [POLYNOMIAL, BACKLASH, ORDER]
    names += [GRAVITY] if mechanism.load is not None else []
    other = {*mechanism.followed, *_KINDS}
    own = [name for name in measurements.influences if name not in other]
    return tuple(Kind.of(name) for name in dict.fromkeys((*names, *own)))


def every_pair(mechanism: Mechanism, measurements: Measurements) -> list[tuple[str, Kind]]:
    """Return all readings with all kinds of term that measurements can show."""
    kinds = kinds_of(mechanism, measurements)
    return [(name, kind) for kind in kinds for name in mechanism.reading_names]


def with_terms(
    mechanism: Mechanism,
    measurements: Measurements,
    kinds: Iterable[tuple[str, Kind]],
) -> tuple[Mechanism, dict[tuple[str, Kind], tuple[str, ...]]]:
    """Return a mechanism with more terms, at zero, and the ids of their amplitudes.

    What it has already is not added again, and harmonics are of turning joints only.

    Args:
        mechanism: The mechanism.
        measurements: Say over what range terms are scaled.
        kinds: Readings, and what is added to each.

    Raises:
        MeasurementError: an unknown reading, or a column that was not measured.
    """
    pairs = list(kinds)
    wanted: dict[str, list[Kind]] = {}
    for reading, kind in pairs:
        _check_reading(reading, mechanism)
        wanted.setdefault(reading, []).append(kind)
    data = with_influences(mechanism, measurements, [kind for _, kind in pairs])
    legs, labels, ids, column = [], [], {}, 0
    for leg in mechanism.legs:
        sensors, parameters = [], dict(leg.parameters)
        for index, sensor in enumerate(leg.sensors):
            reading, terms = leg.reading_names[index], list(sensor.terms)
            for kind in wanted.get(reading, ()):
                added = []
                for one in _terms(leg, index, kind, data.readings[:, column], data):
                    if _what(one) in map(_what, terms):
                        continue
                    name = one.parameter
                    while name in parameters:
                        name += "_term"
                    added.append(term := replace(one, parameter=name))
                    terms.append(term)
                    parameters[name] = 0.0
                    labels.append((f"{leg.name}.{name}", _label(one, leg.reading_units[index])))
                ids[reading, kind] = tuple(f"{leg.name}.{one.parameter}" for one in added)
            sensors.append(replace(sensor, terms=tuple(terms)))
            column += 1
        legs.append(replace(leg, sensors=tuple(sensors), parameters=tuple(parameters.items())))
    return replace(mechanism, legs=tuple(legs), labels=(*mechanism.labels, *labels)), ids


def _what(term: Term) -> tuple[object, ...]:
    """Return what a term is, whatever its scale: two of one kind are the same but for that."""
    basis = term.basis
    if isinstance(basis, Harmonic):
        return (term.of, basis.phase, round(basis.rate, 9))
    if isinstance(basis, Power):
        return (term.of, basis.power)
    return (term.of, Share) if isinstance(basis, Share) else (term.of, basis)


def _terms(
    leg: Leg, index: int, kind: Kind, readings: Array, measurements: Measurements
) -> list[Term]:
    """Return the terms of a kind for one sensor, whose readings have shape (N,)."""
    stem = "" if len(leg.sensors) == 1 else f"{leg.reading_names[index]}_"

    def named(name: str) -> str:
        return re.sub(r"\W", "_", f"{stem}{name}", flags=re.ASCII)

    if kind.name == HARMONICS:
        if leg.reading_units[index] != "rad":
            return []
        return [
            Term(named(f"{phase}_{order:g}"), Harmonic(order, phase))
            for order in kind.numbers
            for phase in ("sine", "cosine")
        ]
    if kind.name == POLYNOMIAL:
        centre, half = _range(readings)
        return [
            Term(named(f"power_{power:g}"), Power(int(power), half, centre))
            for power in kind.numbers
        ]
    if kind.name in _OF_ONES_OWN:
        of = _OF_ONES_OWN[kind.name]
        column = f"{of}_{leg.reading_names[index]}"
        values = measurements.influences.get(column, np.ones(1))
        per = 1.0 if kind.name == BACKLASH else _rounded(float(np.nanmax(np.abs(values))))
        if kind.name == GRAVITY and per <= ROUNDING * _largest_load(measurements):
            return []  # a joint on which nothing weighs, such as one about the vertical
        return [Term(named(kind.name), Share(per or 1.0), of=of)]
    if kind.name not in measurements.influences:
        known = ", ".join(name for name in measurements.influences) or "none"
        raise MeasurementError(
            f"terms {str(kind)!r}: neither a kind of term nor a column of the measurements (those "
            f"with numbers: {known})"
        )
    centre, half = _range(measurements.influences[kind.name])
    name = named(kind.name)
    return [Term(f"_{name}" if name[0].isdigit() else name, Share(half, centre), of=kind.name)]


def _label(term: Term, unit: str) -> str:
    """Return what an amplitude is, in a few words.

    Args:
        term: The term.
        unit: Of the reading.
    """
    basis = term.basis
    if isinstance(basis, Harmonic):
        return f"{basis.phase} of {basis.order:g} times the reading"
    if isinstance(basis, Power):
        return f"power {basis.power} at {basis.centre + basis.range:g} {unit}"
    if term.of == APPROACH:
        return "half the play"
    if not isinstance(basis, Share):
        return ""
    if term.of == LOAD:
        return f"under a load of {basis.per:g} N{' m' if unit == 'rad' else ''}"
    return f"at {term.of} {basis.reference + basis.per:g}, none at {basis.reference:g}"


def with_influences(
    mechanism: Mechanism, measurements: Measurements, kinds: Iterable[Kind]
) -> Measurements:
    """Return measurements with the columns that terms of some kinds would depend on.

    Sides of approach and loads follow from all rows in their order, which parts do not know.

    Raises:
        MeasurementError: what weighs on the mechanism is not known.
    """
    asked_for = {_OF_ONES_OWN[kind.name] for kind in kinds if kind.name in _OF_ONES_OWN}
    if LOAD in asked_for and mechanism.load is None:
        raise MeasurementError(
            f"terms 'gravity': what weighs on {mechanism.name!r} is not known; say it in "
            "mechanism.yaml: 'load: {mass: …, centre: […], gravity: […]}'"
        )
    names, given = mechanism.reading_names, measurements.influences
    own = sorted(of for of in asked_for if any(f"{of}_{name}" not in given for name in names))
    if not own:
        return measurements
    drawing = mechanism.drawing
    legs = tuple(
        replace(
            leg,
            sensors=tuple(
                replace(one, terms=tuple(Term(f"{of}_{i}", Share(), of=of) for of in own))
                for i, one in enumerate(leg.sensors)
            ),
            parameters=(
                *leg.parameters,
                *((f"{of}_{i}", 0.0) for of in own for i in range(len(leg.sensors))),
            ),
        )
        for leg in drawing.legs
    )
    asked = replace(drawing, legs=legs)
    columns = planned_influences(asked, replace(measurements, influences={}))
    return replace(measurements, influences={**by_name(asked, columns), **given})


def _largest_load(measurements: Measurements) -> float:
    own = [v for name, v in measurements.influences.items() if name.startswith(f"{LOAD}_")]
    return max((float(np.nanmax(np.abs(one), initial=0.0)) for one in own), default=0.0)


def _range(values: Array) -> tuple[float, float]:
    """Return the middle of values and half their range, to two digits; 1 where they are one."""
    known = values[np.isfinite(values)]
    if not len(known):
        return 0.0, 1.0
    half = _rounded(float(np.ptp(known)) / 2.0) or 1.0
    middle = float(known.max() + known.min()) / 2.0
    return float(np.round(middle / half, 1) * half), half


def _rounded(value: float) -> float:
    return float(f"{value:.1e}")


def said(terms: Sequence[str], mechanism: Mechanism) -> list[tuple[str, Kind]]:
    """Return readings and kinds that texts name: ``backlash`` of all, ``leg_1=backlash`` of one.

    Raises:
        MeasurementError: a text that is not understood, or an unknown reading.
    """
    pairs = []
    for text in terms:
        reading, kind = _parts(text)
        if reading:
            _check_reading(reading, mechanism)
        pairs += [(one, kind) for one in ([reading] if reading else mechanism.reading_names)]
    return pairs


def _check_reading(reading: str, mechanism: Mechanism) -> None:
    if reading not in mechanism.reading_names:
        raise MeasurementError(
            f"terms of {reading!r}: {mechanism.name!r} reads {', '.join(mechanism.reading_names)}"
        )


def columns_said(terms: Sequence[str]) -> tuple[str, ...] | None:
    """Return the columns of measurements that terms name; None if all columns may be tried."""
    if AUTO in terms:
        return None
    names = (_parts(text)[1].name for text in terms)
    return tuple(name for name in names if name not in _KINDS)


def _parts(text: str) -> tuple[str, Kind]:
    """Return the reading that a text names, empty if it is all, and the kind."""
    reading, _, kind = text.rpartition("=")
    return reading.strip(), Kind.of(kind)
