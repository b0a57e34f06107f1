"""Terms that sensors, lengths and angles may lack, in the scale of what was measured."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pincal.calibration.calibration import Calibration, located, with_followed_influences
from pincal.calibration.terms.kinds import (
    BACKLASH,
    GRAVITY,
    GROWTH,
    HARMONICS,
    OF_ONES_OWN,
    POLYNOMIAL,
    Kind,
    check_place,
    parts_of,
)
from pincal.errors import MeasurementError
from pincal.kinematics.closure import largest_size
from pincal.kinematics.configurations import planned_influences
from pincal.kinematics.influences import by_name
from pincal.model.leg import Leg
from pincal.model.measurements import Measurements
from pincal.model.mechanism import Mechanism
from pincal.model.parameter import listed
from pincal.model.terms import APPROACH, LOAD, Harmonic, Power, Share, Term
from pincal.types import Array

_log = logging.getLogger(__name__)
_TRUE = 1e-3  # [rad], to which a joint's axis is known to stand


def with_terms(
    mechanism: Mechanism,
    measurements: Measurements,
    kinds: Iterable[tuple[str, Kind]],
) -> tuple[Mechanism, dict[tuple[str, Kind], tuple[str, ...]]]:
    """Return a mechanism with more terms, at zero, and the ids of their amplitudes.

    What it has already is not added again, and harmonics are of turning joints only. Growth of all
    lengths has one amplitude in each leg, which belong together (see ``tied_by``).

    Args:
        mechanism: The mechanism.
        measurements: Say over what range terms are scaled.
        kinds: Places, single or several as one, and what is added to each (see ``kinds``).

    Raises:
        MeasurementError: an unknown place, a kind that it cannot have, or a column that was not
            measured.
    """
    parts = {pair: [(place, pair[1]) for place in parts_of(pair[0], mechanism)] for pair in kinds}
    pairs = list(dict.fromkeys(one for part in parts.values() for one in part))
    wanted: dict[str, list[Kind]] = {}
    for place, kind in pairs:
        check_place(place, kind, mechanism)
    data = with_influences(mechanism, measurements, [kind for _, kind in pairs])
    idle = idle_places(mechanism, data)
    for place, kind in pairs:
        if kind.name != GRAVITY or place not in idle:
            wanted.setdefault(place, []).append(kind)
    legs, labels, column = [], list(mechanism.labels), 0
    ids: dict[tuple[str, Kind], tuple[str, ...]] = dict.fromkeys(pairs, ())
    for leg in mechanism.legs:
        grown = _Extended(leg)
        for index, reading in enumerate(leg.reading_names):
            for kind in wanted.get(reading, ()):
                for one in _terms(leg, index, kind, data.readings[:, column], data):
                    grown.at_sensor(index, one, (reading, kind))
            column += 1
        for name in leg.placed:
            id_ = f"{leg.name}.{name}"
            for kind in wanted.get(id_, ()):
                one = _of_influence(name, id_, kind, data)
                label = f"of {name} {_label(one, leg.placed[name])}"
                grown.at_parameters({name: one}, label, (id_, kind))
        for kind in wanted.get(GROWTH, ()):
            one = _of_influence(GROWTH, "", kind, data)
            label = f"share of all lengths {_label(one, '')}"
            grown.at_parameters(_in_proportion(one, leg), label, (GROWTH, kind))
        legs.append(grown.leg)
        labels += grown.labels
        for pair, names in grown.ids.items():
            ids[pair] += tuple(names)
    found = {pair: tuple(id_ for one in part for id_ in ids[one]) for pair, part in parts.items()}
    return replace(mechanism, legs=tuple(legs), labels=tuple(labels)), found


class _Extended:
    """A leg that gets more terms, and the amplitudes that they bring."""

    def __init__(self, leg: Leg) -> None:
        self.leg = leg
        self.labels: list[tuple[str, str]] = []
        self.ids: dict[tuple[str, Kind], list[str]] = {}

    def at_sensor(self, index: int, term: Term, pair: tuple[str, Kind]) -> None:
        """Add a term to a sensor, unless it has it."""
        sensor = self.leg.sensors[index]
        if _what(term) in map(_what, sensor.terms):
            return
        term = self._named(term, _label(term, self.leg.reading_units[index]), pair)
        sensors = list(self.leg.sensors)
        sensors[index] = replace(sensor, terms=(*sensor.terms, term))
        self._grow(term, sensors=tuple(sensors))

    def at_parameters(self, terms: Mapping[str, Term], label: str, pair: tuple[str, Kind]) -> None:
        """Add terms to parameters, all with one amplitude, unless they have them."""
        had: dict[str, dict[str, object]] = {}
        for name, one in self.leg.terms:
            had.setdefault(one.parameter, {})[name] = _what(one)
        if not terms or {name: _what(term) for name, term in terms.items()} in had.values():
            return
        named = self._named(next(iter(terms.values())), label, pair)
        more = ((name, replace(term, parameter=named.parameter)) for name, term in terms.items())
        self._grow(named, terms=(*self.leg.terms, *more))

    def _named(self, term: Term, label: str, pair: tuple[str, Kind]) -> Term:
        """Return a term whose amplitude has a name of its own."""
        name = term.parameter
        while name in self.leg.parameter_names:
            name += "_term"
        id_ = f"{self.leg.name}.{name}"
        self.labels.append((id_, label))
        self.ids.setdefault(pair, []).append(id_)
        return replace(term, parameter=name)

    def _grow(self, term: Term, **changes: Any) -> None:
        more = (*self.leg.parameters, (term.parameter, 0.0))
        self.leg = replace(self.leg, parameters=more, **changes)


def extended(calibration: Calibration, pairs: Sequence[tuple[str, Kind]]) -> Calibration:
    """Return a calibration of a mechanism with more terms; errors are those of ``with_terms``.

    Growth of all lengths is one amplitude for all legs: they are tied.
    """
    data = with_columns(calibration, [kind for _, kind in pairs])
    idle = idle_places(calibration.mechanism, data)
    if names := [place for place, kind in pairs if kind.name == GRAVITY and place in idle]:
        _log.info("gravity: %s: loaded by no more than rounding or a lean: no term", listed(names))
    mechanism, ids = with_terms(calibration.mechanism, data, pairs)
    tied = [name for name in tied_by(ids) if name not in calibration.options.tied]
    options = replace(calibration.options, tied=(*calibration.options.tied, *tied))
    return with_followed_influences(replace(calibration, mechanism=mechanism, options=options))


def tied_by(ids: Mapping[tuple[str, Kind], Sequence[str]]) -> tuple[str, ...]:
    """Return the names of amplitudes that are one for all legs: of growth.

    Args:
        ids: Of amplitudes, by place and kind.
    """
    every = [own for (place, _), own in ids.items() if place == GROWTH and len(own) > 1]
    return tuple(dict.fromkeys(own[0].partition(".")[2] for own in every))


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
    own = leg.reading_names[index]
    return [_of_influence(own if stem else "", own, kind, measurements)]


def _of_influence(stem: str, owner: str, kind: Kind, measurements: Measurements) -> Term:
    """Return the term of a kind that follows an influence.

    Args:
        stem: With what the amplitude's name begins; nothing if empty.
        owner: Reading, or id of the parameter, that has the term.
        kind: The kind.
        measurements: Say over what range it is scaled.

    Raises:
        MeasurementError: a column that was not measured.
    """
    name = re.sub(r"\W", "_", f"{stem}_{kind.name}" if stem else kind.name, flags=re.ASCII)
    name = f"_{name}" if name[0].isdigit() else name
    if kind.name in OF_ONES_OWN:
        of = OF_ONES_OWN[kind.name]
        values = measurements.influences.get(f"{of}_{owner}", np.ones(1))
        per = 1.0 if kind.name == BACKLASH else _rounded(float(np.nanmax(np.abs(values))))
        return Term(name, Share(per or 1.0), of=of)
    if kind.name not in measurements.influences:
        known = ", ".join(name for name in measurements.influences) or "none"
        raise MeasurementError(
            f"terms {str(kind)!r}: neither a kind of term nor a column of the measurements (those "
            f"with numbers: {known})"
        )
    centre, half = _range(measurements.influences[kind.name])
    return Term(name, Share(half, centre), of=kind.name)


def _in_proportion(term: Term, leg: Leg) -> dict[str, Term]:
    """Return a term by each length of a leg, in proportion to it: a share of all lengths."""
    basis, by_length = term.basis, {}
    for name, unit in leg.placed.items():
        value = leg.nominal_by_name[name]
        if isinstance(basis, Share) and unit == "m" and value:
            by_length[name] = replace(term, basis=replace(basis, per=basis.per / value), unit="1")
    return by_length


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
    asked_for = {OF_ONES_OWN[kind.name] for kind in kinds if kind.name in OF_ONES_OWN}
    if LOAD in asked_for and mechanism.load is None:
        raise MeasurementError(
            f"terms 'gravity': what weighs on {mechanism.name!r} is not known; say it in "
            "mechanism.yaml: 'load: {mass: …, centre: […], gravity: […]}'"
        )
    names = {APPROACH: mechanism.reading_names, LOAD: mechanism.load_names}
    given = measurements.influences
    own = sorted(
        influence
        for influence in asked_for
        if any(f"{influence}_{one}" not in given for one in names[influence])
    )
    if not own:
        return measurements
    drawing = mechanism.drawing
    legs = tuple(_with_each(leg, own) for leg in drawing.legs)
    asked = replace(drawing, legs=legs)
    columns = planned_influences(asked, replace(measurements, influences={}))
    return replace(measurements, influences={**by_name(asked, columns), **given})


def with_columns(calibration: Calibration, kinds: Iterable[Kind]) -> Measurements:
    """Return measurements of a calibration with the columns that terms of kinds would depend on.

    Loads are those where the platform is, wherever it was measured from. Errors are those of
    ``with_influences`` and ``located``.
    """
    every_kind, data, mechanism = list(kinds), calibration.measurements, calibration.mechanism
    missing = {f"{LOAD}_{name}" for name in mechanism.load_names} - set(data.influences)
    weigh = (
        missing and mechanism.load is not None and any(one.name == GRAVITY for one in every_kind)
    )
    completed = with_influences(mechanism, located(calibration) if weigh else data, every_kind)
    return replace(data, influences=completed.influences)


def idle_places(mechanism: Mechanism, measurements: Measurements) -> set[str]:
    """Return readings and ids that gravity loads no more than their axes are true.

    As joints about the vertical: what loads them is rounding, or how far the axis leans. Forces
    count by the moment that they have about the machine's size.
    """
    size = largest_size(mechanism.legs)
    units = dict(zip(mechanism.reading_names, mechanism.reading_units, strict=True))
    units |= {parameter.id: parameter.unit for parameter in mechanism.parameters}
    loads = {}
    for name, values in measurements.influences.items():
        owner = name.removeprefix(f"{LOAD}_")
        if owner != name and owner in units:
            largest = float(np.nanmax(np.abs(values), initial=0.0))
            loads[owner] = largest * (size if units[owner] == "m" else 1.0)
    least = _TRUE * max(loads.values(), default=0.0)
    return {owner for owner, load in loads.items() if load <= least}


def _with_each(leg: Leg, influences: Sequence[str]) -> Leg:
    """Return a leg whose every joint, length and angle follows influences of its own."""
    sensors = tuple(
        replace(
            sensor,
            terms=tuple(
                Term(f"{influence}_{i}", Share(), of=influence) for influence in influences
            ),
        )
        for i, sensor in enumerate(leg.sensors)
    )
    placed = leg.placed if LOAD in influences else ()
    terms = tuple((name, Term(f"{LOAD}_{name}", Share(), of=LOAD)) for name in placed)
    every = [*(term for sensor in sensors for term in sensor.terms), *(one for _, one in terms)]
    more = tuple((one.parameter, 0.0) for one in every)
    return replace(leg, sensors=sensors, terms=terms, parameters=(*leg.parameters, *more))


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
