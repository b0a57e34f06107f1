"""Terms that may be added to sensors, lengths and angles, scaled by the range of measurements."""

import logging
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain, product

import numpy as np

from pincal.architectures.cables import is_cable, over_pulley
from pincal.calibration.calibration import Calibration, located, with_followed_influences
from pincal.calibration.terms.kinds import (
    BACKLASH,
    GRAVITY,
    GROWTH,
    HARMONICS,
    PERIOD,
    POLYNOMIAL,
    PULLEY,
    Kind,
    Pair,
    parts_of,
    term_text,
    weighed,
)
from pincal.errors import MeasurementError
from pincal.kinematics.forward import loads_at
from pincal.kinematics.influences import sides
from pincal.model import LOAD, Leg, Measurements, Mechanism
from pincal.model.checks import ROUNDING, listed
from pincal.model.terms import APPROACH, Harmonic, Power, Share, Term
from pincal.types import Array

_log = logging.getLogger(__name__)
_NOTHING = np.zeros(0)
_POINT = 1e-6  # initial radius of a pulley, [m]
_TRUE = 1e-3  # uncertainty of the direction of a joint's axis, [rad]


def with_terms(
    mechanism: Mechanism, measurements: Measurements, kinds: Iterable[Pair]
) -> tuple[Mechanism, dict[Pair, tuple[str, ...]]]:
    """Return a mechanism with further terms of amplitude zero, and the ids of the amplitudes.

    Terms that it already has are not added again; only revolute joints get harmonics. Growth of all
    lengths has an amplitude in each leg, which the caller ties. ``kinds`` are pairs of a place (or
    a name of several places) and a kind; the ranges of measurements scale the terms.
    """
    parts = {pair: [(place, pair[1]) for place in parts_of(pair[0], mechanism)] for pair in kinds}
    pairs = list(dict.fromkeys(chain.from_iterable(parts.values())))
    data = with_influences(mechanism, measurements, [kind for _, kind in pairs])
    idle = {*product(idle_places(mechanism, data), [GRAVITY])}
    tried_pairs = [(place, kind) for place, kind in pairs if (place, kind.name) not in idle]
    legs, labels = [], list(mechanism.labels)
    ids: dict[Pair, tuple[str, ...]] = dict.fromkeys(pairs, ())
    for leg, columns in zip(mechanism.legs, mechanism.reading_columns, strict=True):
        known, new = _known(leg), dict[str, dict[int | str, Term]]()
        for pair, terms, label in _lacking(leg, tried_pairs, data, data.readings[:, columns]):
            same: dict[int | str, object] = {key: _what(term) for key, term in terms.items()}
            if terms and same not in known:
                stem = next(iter(terms.values())).parameter
                name = _new_name(stem, (*leg.parameter_names, *new))
                known.append(same)
                new[name] = terms
                ids[pair] += (f"{leg.name}.{name}",)
                labels.append((f"{leg.name}.{name}", label))
        longer = _extended(leg, new)
        if (pair := (leg.name, Kind(PULLEY))) in tried_pairs and is_cable(longer):
            longer = over_pulley(longer, _POINT, _new_name("r", longer.parameter_names))
            ids[pair] = longer.parameter_ids[-1:]
            labels.append((ids[pair][0], "radius of the pulley"))
        legs.append(longer)
    named = {pair: sum((ids[single] for single in part), ()) for pair, part in parts.items()}
    return replace(mechanism, legs=tuple(legs), labels=tuple(labels)), named


def _lacking(
    leg: Leg, tried_pairs: Sequence[Pair], data: Measurements, readings: Array
) -> Iterator[tuple[Pair, dict[int | str, Term], str]]:
    """Yield place and kind, the terms of an amplitude by parameter or sensor index, and a label."""
    several = len(leg.sensors) > 1
    sensors = zip(leg.reading_names, leg.reading_units, readings.T, strict=True)
    places: list[tuple[int | str, str, str, Array]]
    places = [(i, name, unit, values) for i, (name, unit, values) in enumerate(sensors)]
    places += [(n, f"{leg.name}.{n}", unit, _NOTHING) for n, unit in leg.placed.items()]
    for key, place, unit, values in places:
        stem, of_place = (key, f"of {key} ") if isinstance(key, str) else (place * several, "")
        for kind in (k for wanted_place, k in tried_pairs if wanted_place == place and k != PULLEY):
            for name, basis, of, label in _bases(kind, place, unit, values, data):
                term = Term(_identifier(stem, name), basis, of=of)
                yield (place, kind), {key: term}, f"{of_place}{label}"
    for kind in (kind for wanted_place, kind in tried_pairs if wanted_place == GROWTH):
        for name, basis, of, label in _bases(kind, "", "", _NOTHING, data):
            term = Term(_identifier(GROWTH, name), basis, of=of, unit="1")
            yield (GROWTH, kind), _in_proportion(term, leg), f"share of all lengths {label}"


def _in_proportion(term: Term, leg: Leg) -> dict[int | str, Term]:
    """Return a term for each length of a leg, in proportion to the length, by its name."""
    basis, by_length = term.basis, dict[int | str, Term]()
    for name, unit in leg.placed.items():
        value = leg.nominal_by_name[name]
        if isinstance(basis, Share) and unit == "m" and value:
            by_length[name] = replace(term, basis=replace(basis, per=basis.per / value))
    return by_length


def _identifier(stem: str, name: str) -> str:
    """Return a valid name for a parameter, which begins with the stem unless this is empty."""
    identifier = re.sub(r"\W", "_", f"{stem}_{name}" if stem else name, flags=re.ASCII)
    return f"_{identifier}" if identifier[0].isdigit() else identifier


def _bases(
    kind: Kind, place: str, unit: str, readings: Array, data: Measurements
) -> Iterator[tuple[str, Harmonic | Power | Share, str, str]]:
    """Yield name, basis function, influence and label of each amplitude of a kind."""
    if kind == PERIOD:  # unknown: the screen searches for it in a constant error of the reading
        yield kind.name, Harmonic(ROUNDING, "cosine"), "", "of any period"
    elif kind.name in (HARMONICS, PERIOD):
        for number in kind.numbers if unit == "rad" or kind.name == PERIOD else ():
            sine, of = Harmonic(number, "sine"), f"{number:g} times the reading"
            if kind.name == PERIOD:
                sine, of = Harmonic(1.0, "sine", number), f"a period of {number:g} {unit}"
            for wave in (sine, replace(sine, phase="cosine")):
                yield f"{wave.phase}_{number:g}", wave, "", f"{wave.phase} of {of}"
    elif kind.name == POLYNOMIAL:
        centre, half = _range(readings)
        for power in map(int, kind.numbers):
            label = f"power {power} at {centre + half:g} {unit}"
            yield f"power_{power}", Power(power, half, centre), "", label
    elif kind.name == BACKLASH:
        yield kind.name, Share(), APPROACH, "half the play"
    elif kind.name == GRAVITY:
        loads = data.influences.get(f"{LOAD}_{place}", np.ones(1))
        per = _rounded(float(np.nanmax(np.abs(loads)))) or 1.0
        label = f"under a load of {per:g} { {'m': 'N', 'rad': 'N m'}[unit] }"
        yield kind.name, Share(per), LOAD, label
    elif kind.name in data.influences:
        centre, half = _range(data.influences[kind.name])
        label = f"at {kind.name} {centre + half:g}, none at {centre:g}"
        yield kind.name, Share(half, centre), kind.name, label
    else:
        raise MeasurementError(
            f"terms {str(kind)!r}: neither a kind of term nor a column of the measurements (those "
            f"with numbers: {', '.join(data.influences) or 'none'})"
        )


def _known(leg: Leg) -> list[dict[int | str, object]]:
    """Return the terms of each amplitude of a leg, by parameter or sensor index."""
    by_amplitude = dict[str, dict[int | str, object]]()
    of_sensors = ((i, term) for i, sensor in enumerate(leg.sensors) for term in sensor.terms)
    for place, term in chain[tuple[int | str, Term]](of_sensors, leg.terms):
        by_amplitude.setdefault(term.parameter, {})[place] = _what(term)
    return list(by_amplitude.values())


def _extended(leg: Leg, new: Mapping[str, Mapping[int | str, Term]]) -> Leg:
    """Return a leg with new last parameters, amplitudes of terms at parameters or sensors."""
    named = [(k, replace(t, parameter=name)) for name, ts in new.items() for k, t in ts.items()]
    parts = ((s, [t for k, t in named if k == i]) for i, s in enumerate(leg.sensors))
    longer = replace(
        leg,
        sensors=tuple(replace(sensor, terms=(*sensor.terms, *terms)) for sensor, terms in parts),
        terms=(*leg.terms, *((k, t) for k, t in named if isinstance(k, str))),
        parameters=(*leg.parameters, *((name, 0.0) for name in new)),
        settled=True,
    )
    return longer if new else leg


def _new_name(name: str, names: Sequence[str]) -> str:
    """Return a name for a parameter that a leg with parameters of these names does not have."""
    while name in names:
        name += "_term"
    return name


def extended(calibration: Calibration, pairs: Sequence[Pair]) -> Calibration:
    """Return a calibration whose mechanism has further terms; amplitudes of growth are tied."""
    if unknown := [term_text(place, kind) for place, kind in pairs if kind == PERIOD]:
        raise MeasurementError(
            f"terms {unknown[0]!r}: give the period, such as {unknown[0]}:5mm; 'pincal explain' "
            "searches for it"
        )
    kinds = [kind for _, kind in pairs]
    mechanism = weighed(calibration.mechanism, calibration.measurements, kinds)
    calibration = replace(calibration, mechanism=mechanism)
    data = with_columns(calibration, kinds)
    idle = idle_places(calibration.mechanism, data)
    if names := [place for place, kind in pairs if kind.name == GRAVITY and place in idle]:
        _log.info("gravity: no term for %s, whose load hardly varies", listed(names))
    mechanism, ids = with_terms(calibration.mechanism, data, pairs)
    growths = [names for (place, _), names in ids.items() if place == GROWTH and len(names) > 1]
    tied = (*calibration.options.tied, *(names[0].partition(".")[2] for names in growths))
    options = replace(calibration.options, tied=tuple(dict.fromkeys(tied)))
    return with_followed_influences(replace(calibration, mechanism=mechanism, options=options))


def _what(term: Term) -> tuple[object, ...]:
    """Return the identity of a term without its scale: equal terms differ only by scale."""
    basis = term.basis
    if isinstance(basis, Harmonic):
        return (term.of, basis.phase, round(basis.rate, 9))
    if isinstance(basis, Power):
        return (term.of, basis.power)
    return (term.of, Share) if isinstance(basis, Share) else (term.of, basis)


def with_influences(
    mechanism: Mechanism, measurements: Measurements, kinds: Iterable[Kind]
) -> Measurements:
    """Return measurements with the columns on which terms of some kinds would depend."""
    names, columns, data = {kind.name for kind in kinds}, dict[str, Array](), measurements
    if BACKLASH in names:
        readings = zip(mechanism.reading_names, data.readings.T, strict=True)
        columns |= {f"{APPROACH}_{name}": sides(values, data.runs) for name, values in readings}
    loads = {f"{LOAD}_{name}" for name in mechanism.load_names}
    if GRAVITY in names and mechanism.weighs and loads - set(data.influences):
        columns |= loads_at(mechanism, data.readings, data.poses)
    return replace(data, influences={**columns, **data.influences})


def with_columns(calibration: Calibration, kinds: Iterable[Kind]) -> Measurements:
    """Return a calibration's measurements with the columns on which terms of kinds would depend.

    Loads are computed at the platform's poses in the base frame, in whatever frame it was measured.
    """
    tried, data = list(kinds), calibration.measurements
    mechanism = weighed(calibration.mechanism, data, tried)
    missing = {f"{LOAD}_{name}" for name in mechanism.load_names} - set(data.influences)
    weigh = missing and mechanism.weighs and any(kind.name == GRAVITY for kind in tried)
    completed = with_influences(mechanism, located(calibration) if weigh else data, tried)
    return replace(data, influences=completed.influences)


def idle_places(mechanism: Mechanism, measurements: Measurements) -> set[str]:
    """Return readings and ids whose load by gravity varies too little to show.

    The load of a joint with a vertical axis varies only by rounding, or as its axis leans. Forces
    are compared by their moment at a lever of the machine's size.
    """
    units = dict(zip(mechanism.reading_names, mechanism.reading_units, strict=True))
    units |= {parameter.id: parameter.unit for parameter in mechanism.parameters}
    loads = {}
    for owner in mechanism.load_names:
        values = measurements.influences.get(f"{LOAD}_{owner}", np.zeros(1))
        arm = mechanism.size if units[owner] == "m" else 1.0
        known = values[np.isfinite(values)]
        loads[owner] = arm * float(np.ptp(known)) if known.size else 0.0
    least = _TRUE * max(loads.values())
    return {owner for owner, load in loads.items() if load <= least}


def _range(values: Array) -> tuple[float, float]:
    """Return the middle and half the range of values, to two digits; half is 1 for equal values."""
    known = values[np.isfinite(values)]
    if not len(known):
        return 0.0, 1.0
    half = _rounded(float(np.ptp(known)) / 2.0) or 1.0
    middle = float(known.max() + known.min()) / 2.0
    return float(np.round(middle / half, 1) * half), half


def _rounded(value: float) -> float:
    return float(f"{value:.1e}")
