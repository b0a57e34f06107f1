"""Deformations: parameters that differ from row to row, p + ε with ε = Σ a_j b_j of influences.

Links that grow with temperature, stretch or bend under their load, sag with time. A parameter is a
joint of its leg's chain, and ε one more position of it, known from the columns of influences.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MechanismError
from pincal.model.sensors.sensor import PlacedTerm, add_bases, add_terms
from pincal.model.sensors.terms import APPROACH, Term

if TYPE_CHECKING:
    from pincal.model.leg import Leg

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Deformations:
    """How far a leg's parameters deform, at parameter values."""

    parameters: tuple[int, ...]
    """Indices of the parameters that deform, length n_deformed."""
    terms: tuple[PlacedTerm, ...]
    """What is added to these, by the leg's influences."""
    n_parameters: int
    """All parameters of the leg."""

    @classmethod
    def of(cls, leg: Leg, values: Array) -> Deformations:
        """Return those of a leg at parameter values, shape (n_params,)."""
        place = {name: index for index, name in enumerate(leg.parameter_names)}
        terms = tuple(
            PlacedTerm(
                term,
                leg.deformed.index(name),
                leg.influences.index(term.column(f"{leg.name}.{name}")),
                place[term.parameter],
                float(values[place[term.parameter]]),
            )
            for name, term in leg.terms
        )
        return cls(tuple(place[name] for name in leg.deformed), terms, len(place))

    def __call__(self, influences: Array) -> Array:
        """Return deformations ε, shape (N, n_deformed), [m] or [rad].

        Args:
            influences: Of the leg, shape (N, n_influences); zero where NaN, or none are given.
        """
        by = np.zeros((len(influences), len(self.parameters)))
        add_terms(self.terms, influences, by)
        return by

    def by_parameter(self, influences: Array) -> Array:
        """Return ∂ε/∂φ, shape (N, n_deformed, n_params): that of an amplitude is its b."""
        found = np.zeros((len(influences), len(self.parameters), self.n_parameters))
        add_bases(self.terms, influences, found)
        return found


def check_terms(leg: Leg, placed: Mapping[str, str]) -> None:
    """Raise if a term of a leg's sensors or parameters cannot be one.

    Args:
        leg: The leg.
        placed: Units of the parameters of its placements, by name.

    Raises:
        MechanismError: one of a parameter is of no length or angle, or follows a reading or a side
            of approach; an amplitude that is a parameter of a placement or sensor itself, or that
            terms of different units share.
    """
    of_sensors = {one for s in leg.sensors for one in (s.gain, s.offset) if isinstance(one, str)}
    for name, term in leg.terms:
        where = f"{leg.name}: term {term.parameter!r} of parameter {name!r}"
        if name in of_sensors and name not in placed:
            raise MechanismError(
                f"{where}: that is the sensor's, whose position terms are added to as it is; give "
                "the term to the sensor (sensors: terms)"
            )
        if name not in placed:
            raise MechanismError(
                f"{where}: no placement has such a parameter; expected one of "
                f"{', '.join(placed) or 'none'}"
            )
        if not term.of:
            raise MechanismError(
                f"{where} depends on a reading; a parameter's depends on an influence: of a "
                "column such as 'temperature', or of 'load'"
            )
        if term.of == APPROACH:
            raise MechanismError(
                f"{where} depends on the side of approach, which is a joint's; give the term to a "
                "sensor, or name a column of your own"
            )
    units: dict[str, str] = {}
    for owner, term, unit in _amplitudes(leg, placed):
        where = f"{leg.name}: term {term.parameter!r} of {owner}"
        if term.parameter in placed or term.parameter in of_sensors:
            raise MechanismError(
                f"{where}: its amplitude is also a parameter of a placement or sensor; name the "
                "amplitude otherwise"
            )
        if units.setdefault(term.parameter, unit) != unit:
            raise MechanismError(
                f"{where}: its amplitude, [{unit}], is also that of another term, "
                f"[{units[term.parameter]}]; name one of them otherwise"
            )


def _amplitudes(leg: Leg, placed: Mapping[str, str]) -> Iterator[tuple[str, Term, str]]:
    """Yield owners of a leg's terms, for messages, the terms, and the units of their amplitudes."""
    for sensor, unit in zip(leg.sensors, leg.reading_units, strict=True):
        for term in sensor.terms:
            yield f"sensor {sensor.joint!r}", term, term.unit or unit
    for name, term in leg.terms:
        yield f"parameter {name!r}", term, term.unit or placed[name]
