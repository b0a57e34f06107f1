"""Laws of sensors, between an active joint and its reading: gain, offset, direction, terms.

q = k ψ + γ + Σ a_j b_j is linear in the unknowns. The basis functions b_j depend on the ``known``
columns of a row: its readings, followed by its influence quantities. An influence that is unknown,
a NaN or a missing column, is at its reference, where its terms are zero. Lengths and angles that
have terms follow such a law without a reading: ε = Σ a_j b_j is added to them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from pincal.errors import MechanismError
from pincal.model.checks import LARGEST, check_kinds
from pincal.model.terms import Term
from pincal.types import Array, Index

if TYPE_CHECKING:
    from pincal.model.leg import Leg

_STEPS = 50  # largest number of Newton steps from a position to its reading


class PlacedTerm(NamedTuple):
    """A term at parameter values, with the indices of what it depends on and changes."""

    term: Term
    target: int
    """Index, among the leg's active joints or deformed parameters, to which it is added."""
    column: int
    """Index, among the readings and then influences, of the column on which it depends."""
    parameter: int
    """Index of its amplitude among the leg's parameters."""
    amplitude: float

    def basis(self, known: Array) -> Array:
        """Return b at the known columns, shape (N, n_columns) to (N,); 0 for unknown influences."""
        if self.column >= known.shape[1]:
            return np.zeros(len(known))
        column = known[:, self.column]
        b = self.term.basis(column)
        return np.where(np.isfinite(column), b, 0.0) if self.term.of else b


@dataclass(frozen=True)
class SensorLaw:
    """Active joints' positions by readings, at parameter values: q = slope ψ + intercept + terms.

    ``known`` are the readings, then the influences, shape (N, n_active [+ n_influences]).
    """

    slope: Array
    """∂q/∂ψ, shape (n_active,), [1]."""
    intercept: Array
    """Joint positions at which readings are zero, shape (n_active,), [rad] or [m]."""
    linear_by_parameter: Array
    """∂slope/∂φ and ∂intercept/∂φ, shape (2, n_active, n_params)."""
    terms: tuple[PlacedTerm, ...] = ()

    def reading(self, joints: Array, influences: Array | None = None) -> Array:
        """Return the readings ψ of active joints' positions, shapes (N, n_active), [rad] or [m].

        With terms, Newton's method solves for them; they are NaN where it does not converge.
        Influences, shape (N, n_influences), are at their reference if not given.
        """
        readings = (joints - self.intercept) / self.slope
        if not self.terms:
            return readings
        for _ in range(_STEPS):
            known = readings if influences is None else np.hstack((readings, influences))
            step = (joints - self.position(known)) / self.slopes(known)
            readings = readings + step
            size = np.maximum(1.0, np.abs(readings))
            going = np.abs(step) > 4.0 * np.finfo(float).eps * size
            if not going.any():
                return readings
        lost = np.abs(step) > np.sqrt(np.finfo(float).eps) * size  # q(ψ) is not monotonic there
        return np.where(lost, np.nan, readings)

    def position(self, known: Array) -> Array:
        """Return the active joints' positions at the known columns, shape (N, n_active)."""
        positions = self.slope * known[:, : len(self.slope)] + self.intercept
        for term in self.terms:
            positions[:, term.target] += term.amplitude * term.basis(known)
        return positions

    def slopes(self, known: Array) -> Array:
        """Return ∂q/∂ψ at the known columns, shape (N, n_active), or (n_active,) if constant."""
        if not self.terms:
            return self.slope
        slopes = np.tile(self.slope, (len(known), 1))
        for placed in self.terms:
            if placed.column < len(self.slope):
                basis: Any = placed.term.basis
                slope = placed.term.slope or basis.slope
                slopes[:, placed.target] += placed.amplitude * slope(known[:, placed.column])
        return slopes

    @cached_property
    def parameter_places(self) -> Index:
        """Indices of the leg's parameters that change positions, in order, shape (k,)."""
        amplitudes = np.array([term.parameter for term in self.terms], dtype=np.intp)
        return np.union1d(np.flatnonzero(self.linear_by_parameter.any(axis=(0, 1))), amplitudes)

    def by_parameter(self, known: Array) -> Array:
        """Return ∂q/∂φ, by ``parameter_places``, at the known columns, shape (N, n_active, k)."""
        readings, places = known.T[: len(self.slope), None], self.parameter_places
        by_slope, by_intercept = self.linear_by_parameter[:, :, places, None]
        derivatives = (by_slope * readings + by_intercept).transpose(2, 0, 1)
        for term in self.terms:
            place = np.searchsorted(places, term.parameter)
            derivatives[:, term.target, place] += term.basis(known)
        return derivatives


def law_of_sensors(
    leg: Leg, parameters: Mapping[str, float], home: Array, home_by_parameter: Array
) -> SensorLaw:
    """Return the law of a leg's sensors at parameter values, given by name in order.

    ``home`` are the active joints' positions at the platform's home pose, shape (n_active,), and
    ``home_by_parameter`` their derivatives, shape (n_active, n_params).
    """
    laws = np.zeros((2, len(leg.sensors), 1 + len(parameters)))
    for index, sensor in enumerate(leg.sensors):
        laws[:, index] = sensor.law(parameters)
        if sensor.homed:
            laws[1, index] += (home[index], *home_by_parameter[index])
        else:
            laws[1, index, 0] += float(sensor.zero)
    terms = [(index, term) for index, sensor in enumerate(leg.sensors) for term in sensor.terms]
    placed = _placed(leg, leg.reading_names, terms, parameters)
    slope, intercept = laws[:, :, 0]
    return SensorLaw(slope, intercept, laws[:, :, 1:], placed)


def law_of_deformations(leg: Leg, parameters: Mapping[str, float]) -> SensorLaw:
    """Return the law of what is added to the ``leg.deformed``, at values by name in order.

    Its known columns are n_deformed zeros in place of readings, then the leg's influences.
    """
    terms = [(leg.deformed.index(name), term) for name, term in leg.terms]
    owners = [f"{leg.name}.{name}" for name in leg.deformed]
    none = np.zeros((2, len(owners), len(parameters)))
    placed = _placed(leg, owners, terms, parameters)
    return SensorLaw(none[0, :, 0], none[0, :, 0], none, placed)


def _placed(
    leg: Leg,
    owners: Sequence[str],
    terms: Sequence[tuple[int, Term]],
    parameters: Mapping[str, float],
) -> tuple[PlacedTerm, ...]:
    """Return terms with their indices; the columns are those of the owners, then influences."""
    columns, names, placed = [*owners, *leg.influences], list(parameters), []
    for target, term in terms:
        column, name = columns.index(term.column(owners[target]) or owners[target]), term.parameter
        placed.append(PlacedTerm(term, target, column, names.index(name), parameters[name]))
    return tuple(placed)


@dataclass(frozen=True)
class Sensor:
    """Sensor on an active joint, linear apart from its terms, in one of the papers' two forms.

    With joint coordinate q (counted from ``zero``), direction d = ±1, gain k and offset γ:

    - form ``"joint"``:   q = d k ψ + γ, ψ the reading (3-RRR paper, Eq. 6)
    - form ``"reading"``: ψ = d k q + γ, ψ the reading (5R paper, Eq. 9)
    """

    joint: str
    """Name of the active joint."""
    form: Literal["joint", "reading"] = "joint"
    gain: str | float = 1.0
    """Parameter name of the gain, or a constant [1]."""
    offset: str | float = 0.0
    """Parameter name of the offset, or a constant [rad] or [m]."""
    direction: int = 1
    zero: float | Literal["home"] = 0.0
    """Joint position from which q counts, [rad] or [m]; ``"home"`` is the joint's position at the
    platform's home pose, at any parameters, as on machines that are zeroed there."""
    terms: tuple[Term, ...] = ()
    """Terms Σ a_j b_j that are added to the joint's position in either form."""
    counts_per_unit: float | None = field(default=None, repr=False)
    """Encoder counts per rad or m of the reading, above 0; None if it is not read in counts."""

    def __post_init__(self) -> None:
        check_kinds(vars(self), Sensor, MechanismError)
        counts = self.counts_per_unit
        if counts is not None and not 1.0 / LARGEST <= counts <= LARGEST:
            raise MechanismError(
                f"sensor of {self.joint!r}: counts_per_unit is {counts!r}; expected a number above "
                "0 (the sign belongs to 'direction')"
            )

    @property
    def homed(self) -> bool:
        """Whether the reading counts from the platform's home pose."""
        return self.zero == "home"

    def constants(self, parameters: Mapping[str, float]) -> tuple[float, float]:
        """Return d k and γ at the given parameter values."""
        gain = parameters[self.gain] if isinstance(self.gain, str) else self.gain
        offset = parameters[self.offset] if isinstance(self.offset, str) else self.offset
        return self.direction * gain, offset

    def reads_position(self, parameters: Mapping[str, float]) -> bool:
        """Return whether readings equal joint positions at the given parameter values."""
        return self.constants(parameters) == (1.0, 0.0) and self.zero == 0.0 and not self.terms

    def law(self, parameters: Mapping[str, float]) -> Array:
        """Return slope and intercept of q = slope ψ + intercept, each before its derivatives.

        ``parameters`` are values by name, in the leg's order; the shape is (2, 1 + n_params).
        """
        gain, offset = self.constants(parameters)
        by_gain = np.array([self.direction * float(name == self.gain) for name in parameters])
        by_offset = np.array([float(name == self.offset) for name in parameters])
        if self.form == "joint":
            return np.array([[gain, *by_gain], [offset, *by_offset]])
        slope, slopes = 1.0 / gain, -by_gain / gain**2
        intercepts = -slope * by_offset - offset * slopes
        return np.array([[slope, *slopes], [-offset / gain, *intercepts]])
