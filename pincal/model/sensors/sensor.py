"""A sensor is the law between an active joint and its reading: gain, offset, direction, terms.

q = k ψ + γ + Σ a_j b_j: linear in all that is unknown. Where a row says more than readings, its
influence quantities stand beside them, as columns that follow the readings; what is not known of
them, NaN or no column, is at its reference, where its terms are zero.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MechanismError
from pincal.model.checks import LARGEST
from pincal.model.sensors.terms import Term

Array = NDArray[np.float64]
STEPS = 50


@dataclass(frozen=True)
class PlacedTerm:
    """A term at parameter values."""

    term: Term
    target: int
    """Which of the leg's active joints it is added to, or of the parameters that deform."""
    column: int
    """On which column it depends: a reading, or behind them an influence; an influence, if it is
    of a parameter."""
    parameter: int
    """Which of the leg's parameters its amplitude is."""
    amplitude: float

    def basis(self, known: Array) -> Array:
        """Return b at what is known of rows, shape (N, n_columns) to (N,)."""
        column = known[:, self.column]
        b = self.term.basis(column)
        return np.where(np.isfinite(column), b, 0.0) if self.term.of else b


def add_terms(terms: Iterable[PlacedTerm], known: Array, to: Array) -> None:
    """Add a b of terms whose columns are known, shape (N, n_columns), to targets (N, n)."""
    for one in terms:
        if one.column < known.shape[1]:
            to[:, one.target] += one.amplitude * one.basis(known)


def add_bases(terms: Iterable[PlacedTerm], known: Array, to: Array) -> None:
    """Add b, derivatives by amplitudes, likewise: to targets by parameters (N, n, n_params)."""
    for one in terms:
        if one.column < known.shape[1]:
            to[:, one.target, one.parameter] += one.basis(known)


@dataclass(frozen=True)
class SensorLaw:
    """Active joints' positions of readings, at parameter values: q = slope ψ + start + terms."""

    slope: Array
    """∂q/∂ψ, shape (n_active,), [1]."""
    start: Array
    """Joint positions at which readings are zero, shape (n_active,), [rad] or [m]."""
    slope_by_parameter: Array
    """∂slope/∂φ, shape (n_active, n_params)."""
    start_by_parameter: Array
    """∂start/∂φ, shape (n_active, n_params)."""
    terms: tuple[PlacedTerm, ...] = ()

    def reading(self, joints: Array, influences: Array | None = None) -> Array:
        """Return the readings ψ of active joints' positions, shape (N, n_active), [rad] or [m].

        By Newton's method where there are terms; NaN where it finds none.

        Args:
            joints: Shape (N, n_active), [rad] or [m].
            influences: Influence quantities, shape (N, n_influences); at reference if not given.
        """
        readings = (joints - self.start) / self.slope
        for _ in range(STEPS if self.terms else 0):
            known = readings if influences is None else np.hstack((readings, influences))
            step = (joints - self.position(known)) / self.slopes(known)
            readings = readings + step
            size = np.maximum(1.0, np.abs(readings))
            going = np.abs(step) > 4.0 * np.finfo(float).eps * size
            if not going.any():
                break
        else:
            if self.terms:  # that are not small: q(ψ) is not monotonic
                readings = np.where(
                    going & (np.abs(step) > np.sqrt(np.finfo(float).eps) * size), np.nan, readings
                )
        return readings

    def position(self, known: Array) -> Array:
        """Return the active joints' positions of readings ψ, shape (N, n_active).

        Args:
            known: Readings, and behind them influences, shape (N, n_active [+ n_influences]).
        """
        joints = self.slope * known[:, : len(self.slope)] + self.start
        add_terms(self.terms, known, joints)
        return joints

    def slopes(self, known: Array) -> Array:
        """Return ∂q/∂ψ at given readings, shape (N, n_active), or (n_active,) if everywhere."""
        if not self.terms:
            return self.slope
        slopes = np.tile(self.slope, (len(known), 1))
        for one in self.terms:
            if one.column < len(self.slope):
                by = one.term.slope_of(known[:, one.column])
                slopes[:, one.target] += one.amplitude * by
        return slopes

    @cached_property
    def parameter_places(self) -> NDArray[np.intp]:
        """Which of the leg's parameters change positions, in order, shape (k,)."""
        by = np.concatenate((self.slope_by_parameter, self.start_by_parameter)).any(axis=0)
        amplitudes = np.array([one.parameter for one in self.terms], dtype=np.intp)
        return np.union1d(np.flatnonzero(by), amplitudes)

    def by_parameter(self, known: Array) -> Array:
        """Return ∂q/∂φ by ``parameter_places``, shape (N, n_active, k).

        Args:
            known: Readings, and behind them influences, shape (N, n_active [+ n_influences]).
        """
        readings, own = known.T[: len(self.slope), None], self.parameter_places
        by_slope, by_start = self.slope_by_parameter[:, own], self.start_by_parameter[:, own]
        found = (by_slope[:, :, None] * readings + by_start[:, :, None]).transpose(2, 0, 1)
        add_bases(self._own_terms, known, found)
        return found

    @cached_property
    def _own_terms(self) -> tuple[PlacedTerm, ...]:
        """The terms, their parameters counted among ``parameter_places``."""
        places = np.searchsorted(self.parameter_places, [one.parameter for one in self.terms])
        pairs = zip(self.terms, places.tolist(), strict=True)
        return tuple(replace(one, parameter=place) for one, place in pairs)


@dataclass(frozen=True)
class Sensor:
    """Sensor on an active joint, linear but for its terms, in one of the two forms of the papers.

    With joint coordinate q (counted from ``zero``), direction d = ±1, gain k and offset γ:

    - form ``"joint"``:   q = d k ψ + γ, ψ the reading (3-RRR paper, Eq. 6)
    - form ``"reading"``: ψ = d k q + γ, ψ the reading (5R paper, Eq. 9)
    """

    joint: str
    """Name of the active joint."""
    form: Literal["joint", "reading"] = "joint"
    gain: str | float = 1.0
    """Gain's parameter name, or a constant [1]."""
    offset: str | float = 0.0
    """Offset's parameter name, or a constant [rad] or [m]."""
    direction: int = 1
    zero: float | Literal["home"] = 0.0
    """Joint position from which q counts, [rad] or [m]; ``"home"``: the joint's position at the
    platform's home pose, whatever the parameters, as on machines that are zeroed there."""
    terms: tuple[Term, ...] = ()
    """What is added to the joint's position in either form: Σ a_j b_j."""
    counts_per_unit: float | None = field(default=None, repr=False)
    """Encoder counts of one rad or m of the reading, above 0; None if it is not read in counts."""

    def __post_init__(self) -> None:
        by = self.counts_per_unit
        if by is not None and not 1.0 / LARGEST <= by <= LARGEST:
            raise MechanismError(
                f"sensor of {self.joint!r}: {by!r} counts of one unit; expected a number above 0 "
                "(which way it counts is the direction)"
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
        """Return whether readings are joint positions at the given parameter values."""
        return self.constants(parameters) == (1.0, 0.0) and self.zero == 0.0 and not self.terms

    def law(self, parameters: Mapping[str, float]) -> tuple[float, float, Array, Array]:
        """Return slope and start of q = slope ψ + start, and their derivatives by parameters.

        Args:
            parameters: Values of the leg's parameters by name, in order.
        """
        gain, offset = self.constants(parameters)
        by_gain, by_offset = (_unit(tuple(parameters), one) for one in (self.gain, self.offset))
        if self.form == "joint":
            slope, start = gain, offset
            slopes, starts = self.direction * by_gain, by_offset
        else:
            slope, start = 1.0 / gain, -offset / gain
            slopes = -self.direction * slope**2 * by_gain
            starts = -slope * by_offset + offset * self.direction * slope**2 * by_gain
        return slope, start, slopes, starts


@lru_cache(maxsize=256)
def _unit(names: tuple[str, ...], own: str | float) -> Array:
    """Return 1 where a parameter's name is one's own, else 0, shape (n_params,)."""
    return np.array([float(name == own) for name in names])


def sensor_laws(
    sensors: Sequence[Sensor],
    parameters: Mapping[str, float],
    home: Array,
    home_by_parameter: Array,
    columns: Sequence[str] = (),
) -> SensorLaw:
    """Return the law of a leg's sensors at parameter values.

    Args:
        sensors: The sensors.
        parameters: Values of the leg's parameters by name, in order.
        home: The active joints' positions at the platform's home pose, shape (n_active,).
        home_by_parameter: Their derivatives, shape (n_active, n_params).
        columns: Names of the leg's readings, one for each sensor, and of its influences; not
            needed where no term depends on any.
    """
    slope, start, slopes, starts = map(
        np.array, zip(*(sensor.law(parameters) for sensor in sensors), strict=True)
    )
    homed = np.array([sensor.homed for sensor in sensors])
    zeros = np.array([0.0 if isinstance(one.zero, str) else one.zero for one in sensors])
    place = {name: index for index, name in enumerate(parameters)}
    terms = tuple(
        PlacedTerm(
            term,
            index,
            columns.index(term.column(columns[index])) if term.of else index,
            place[term.parameter],
            parameters[term.parameter],
        )
        for index, sensor in enumerate(sensors)
        for term in sensor.terms
    )
    return SensorLaw(
        slope,
        start + np.where(homed, home, zeros),
        slopes,
        starts + np.where(homed[:, None], home_by_parameter, 0.0),
        terms,
    )
