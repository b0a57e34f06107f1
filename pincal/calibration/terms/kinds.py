"""Kinds of terms that a model may lack, and their places: readings, lengths and angles.

Options are ``leg_1=harmonics:1,2``. A place is a reading, a length or angle by id (``leg_1.l``) or
by name in all legs (``l``), ``growth`` for all lengths as one, or by default every reading.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Self

import numpy as np

from pincal.architectures.cables import is_cable
from pincal.calibration.options import AUTO
from pincal.errors import MeasurementError
from pincal.files.text import in_si
from pincal.model import LOAD, Load, Measurements, Mechanism
from pincal.model.checks import LARGEST, listed

HARMONICS, POLYNOMIAL, BACKLASH, GRAVITY = "harmonics", "polynomial", "backlash", "gravity"
PULLEY = "pulley"
"""A pulley under a cable, which swivels about the vertical; its radius is the amplitude."""
PERIOD = "period"
"""Sine and cosine of a period, such as ``period:5mm``; without a number it is searched for."""
_OF_READINGS = (HARMONICS, PERIOD, POLYNOMIAL, BACKLASH, PULLEY)
_KINDS = (*_OF_READINGS, GRAVITY)
_NUMBERS = {HARMONICS: (1.0, 2.0), POLYNOMIAL: (2.0, 3.0)}
_KNOWN: dict[str, Callable[[float], bool]] = {  # the finest gratings have 100,000 periods a turn
    HARMONICS: lambda order: 0.0 < order <= 1e5,
    PERIOD: lambda period: 1e-9 <= period <= LARGEST,
    POLYNOMIAL: lambda power: power in range(2, 21),
}
GROWTH = "growth"
"""Place of a term: all lengths of the machine, which grow by a common share."""
READINGS = "readings"
"""Place of a term: all readings, each with amplitudes of its own."""


def _value(name: str, text: str) -> float:
    """Return the number of a kind from its text, NaN if it is none; periods have a unit."""
    try:
        return in_si(text, "m rad", None) if name == PERIOD else in_si(text, "")
    except MeasurementError:
        return np.nan


class Kind(str):
    """A kind of term in the form of options: ``harmonics:1``, ``backlash``, or a column's name."""

    @classmethod
    def of(cls, text: str) -> Self:
        """Return the kind that a text names; numbers equal to the default ones are dropped."""
        name, colon, numbers = (part.strip() for part in text.partition(":"))
        texts = [number.replace(" ", "") for number in numbers.split(",")] if colon else []
        values = tuple(_value(name, number) for number in texts)
        known = not values or (name in _KNOWN and all(map(_KNOWN[name], values)))
        if not name or "," in name or not known:
            raise MeasurementError(
                f"terms {text!r}: expected harmonics:1,2 (periods in a turn, up to 100,000), "
                "period:5mm, polynomial:2,3 (powers, 2 to 20), backlash, pulley, gravity, or a "
                "column of the measurements; repeat the option for several"
            )
        if name != PERIOD:
            texts = [f"{value:.12g}" for value in values]
        usual = values == _NUMBERS.get(name, ())
        return cls(name if usual or not values else f"{name}:{','.join(texts)}")

    @property
    def name(self) -> str:
        """Name of the kind: ``"harmonics"``, ``"polynomial"``, ``"backlash"``, … , or a column."""
        return str(self).partition(":")[0]

    @property
    def numbers(self) -> tuple[float, ...]:
        """Orders of harmonics, periods [m] or [rad], powers of a polynomial."""
        numbers = str(self).partition(":")[2].split(",")
        given = tuple(in_si(number, "m rad") for number in numbers if number)
        return given or _NUMBERS.get(self, ())


Pair = tuple[str, Kind]
"""A place and a kind of term."""


def loads_known(mechanism: Mechanism, measurements: Measurements) -> bool:
    """Return whether loads can be computed, or some were measured."""
    columns = {f"{LOAD}_{name}" for name in mechanism.load_names}
    return mechanism.weighs or not columns.isdisjoint(measurements.influences)


def weighed(mechanism: Mechanism, measurements: Measurements, kinds: Sequence[Kind]) -> Mechanism:
    """Return a mechanism with a load, if it is to have terms of gravity.

    If no load is known, it is 1 kg on the platform, in space with the weight along −z; amplitudes
    are then per kg. In the plane the direction of gravity must be given.
    """
    if GRAVITY not in kinds or loads_known(mechanism, measurements):
        return mechanism
    if mechanism.platform.space == 2:
        raise MeasurementError(
            f"terms 'gravity': the loads of {mechanism.name!r} are not known; measure columns "
            f"{LOAD}_{mechanism.reading_names[0]} …, or give them in mechanism.yaml: 'load: "
            "{mass: …, centre: […], gravity: […]}'"
        )
    return replace(mechanism, load=Load(1.0, assumed=True))


def every_pair(mechanism: Mechanism, measurements: Measurements) -> list[Pair]:
    """Return all places and kinds of term that the measurements can show.

    Readings have all kinds; lengths, each alone and all as one, have terms of columns; lengths and
    angles between a leg's joints have gravity (see ``weighed``). Places are tried alone, and
    repeated parts of the machine together: all readings, and places of one name.
    """
    names = [HARMONICS] * ("rad" in mechanism.reading_units) + [POLYNOMIAL, BACKLASH, PERIOD]
    names += [GRAVITY] * (mechanism.platform.space == 3 or loads_known(mechanism, measurements))
    names += [n for n in measurements.influences if n not in {*mechanism.followed, *_KINDS}]
    kinds, long = [Kind.of(name) for name in dict.fromkeys(names)], lengths(mechanism)
    every = [READINGS] * (len(mechanism.reading_names) > 1)
    pairs = [(name, kind) for kind in kinds for name in (*mechanism.reading_names, *every)]
    names = cables(mechanism)
    every = [READINGS] * (1 < len(names) == len(mechanism.legs))
    pairs += [(name, Kind(PULLEY)) for name in (*names, *every)]
    for kind in kinds:
        if kind.name == GRAVITY:
            pairs += [(place, kind) for place in _with_names(_of_links(mechanism))]
        elif kind.name not in _KINDS:
            pairs += [(name, kind) for name in [GROWTH] * (len(long) > 1) + _with_names(long)]
    return pairs


def cables(mechanism: Mechanism, *, over_pulleys: bool = False) -> list[str]:
    """Return the names of straight cables in space; optionally also of cables over pulleys."""
    if mechanism.platform.space == 2:
        return []
    pulleys = [over_pulleys and any(j.ratio for j in leg.joints) for leg in mechanism.legs]
    pairs = zip(mechanism.legs, pulleys, strict=True)
    return [leg.name for leg, over_pulley in pairs if over_pulley or is_cable(leg)]


def _with_names(ids: Sequence[str]) -> list[str]:
    """Return ids, followed by the names that several of them share."""
    names = [id_.rpartition(".")[2] for id_ in ids]
    return [*ids, *(name for name in dict.fromkeys(names) if names.count(name) > 1)]


def parts_of(place: str, mechanism: Mechanism) -> list[str]:
    """Return the single places of a place: readings, ids of lengths and angles, or growth."""
    if place == READINGS:
        return list(mechanism.reading_names)
    if place in (*mechanism.load_names, GROWTH):
        return [place]
    return [name for name in mechanism.load_names if name.rpartition(".")[2] == place] or [place]


def lengths(mechanism: Mechanism) -> list[str]:
    """Return the ids of the lengths of a mechanism that are not zero."""
    names = mechanism.load_names
    return [p.id for p in mechanism.parameters if p.id in names and p.unit == "m" and p.nominal]


def _of_links(mechanism: Mechanism) -> list[str]:
    """Return the ids of lengths and angles between a leg's first moving joint and its tip."""
    return [
        f"{leg.name}.{name}"
        for leg in mechanism.legs
        for joint in leg.joints[leg.joints.index(leg.moving[0]) + 1 :]
        for name in joint.placement.parameter_units
    ]


def parse_terms(terms: Sequence[str], mechanism: Mechanism) -> list[Pair]:
    """Parse options into places and kinds; several places of one text come singly and together."""
    pairs = []
    for place, kind in (_parts(text) for text in terms if text != AUTO):
        single_places = parts_of(place, mechanism)
        for single in single_places:
            check_place(single, kind, mechanism)
            pairs.append((single, kind))
        pairs += [(place, kind)] * (len(single_places) > 1)
    return pairs


def term_text(place: str, kind: Kind) -> str:
    """Return a term in the form of options: ``backlash``, ``leg_1=backlash``."""
    return str(kind) if place == READINGS else f"{place}={kind}"


def check_place(place: str, kind: Kind, mechanism: Mechanism) -> None:
    """Raise a MeasurementError if there is no such place, or it cannot have a kind of term."""
    readings, ids = mechanism.reading_names, mechanism.load_names
    problem = ""
    if place not in (*ids, GROWTH):
        problem = (
            f"{mechanism.name!r} reads {', '.join(readings)}; its lengths and angles are "
            f"{listed(ids[len(readings) :])}, {GROWTH!r} is all lengths as one"
        )
    elif place not in readings and kind.name in _OF_READINGS:
        problem = (
            f"{kind.name} is for readings; lengths and angles can follow a column of the "
            "measurements, or gravity"
        )
    elif kind == PULLEY and place not in cables(mechanism, over_pulleys=True):
        problem = "pulleys are for cables in space: a universal joint at the anchor and a line"
    elif kind.name == PERIOD != kind:
        for period in kind.partition(":")[2].split(","):
            in_si(period, mechanism.reading_units[readings.index(place)])
    elif (place, kind.name) == (GROWTH, GRAVITY):
        problem = (
            "gravity loads each length differently, so they do not grow as one; name a length or "
            "an angle, such as leg_1.l=gravity"
        )
    if problem:
        raise MeasurementError(f"terms {term_text(place, kind)!r}: {problem}")


def columns_of_terms(terms: Sequence[str]) -> tuple[str, ...] | None:
    """Return the columns of measurements that terms name; None if all columns may be tried."""
    if AUTO in terms:
        return None
    return tuple(name for text in terms if (name := _parts(text)[1].name) not in _KINDS)


def _parts(text: str) -> tuple[str, Kind]:
    """Return the place that a text names, by default every reading, and the kind."""
    reading, of, kind = text.rpartition("=")
    if of and kind.strip() == AUTO:
        raise MeasurementError(
            f"terms {text!r}: {AUTO!r} tries every kind in every place, so it takes no place; name "
            f"a kind, such as {reading.strip()}=backlash"
        )
    return reading.strip() or READINGS, Kind.of(kind)
