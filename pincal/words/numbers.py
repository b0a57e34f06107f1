"""Units as people write and read them, and numbers to the digits that their uncertainty leaves.

One table of units for headers, options and everything printed. Values are SI with their unit,
``"m"``, ``"rad"`` or ``"1"``; ``units`` say in what they are read.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from math import floor, isfinite, log10, pi
from typing import TypeAlias

import numpy as np

from pincal.errors import MeasurementError

#: Units by the name that is written: dimension, and factor to SI.
UNITS: dict[str, tuple[str, float]] = {
    "m": ("m", 1.0),
    "cm": ("m", 1e-2),
    "mm": ("m", 1e-3),
    "um": ("m", 1e-6),
    "µm": ("m", 1e-6),  # micro sign
    "μm": ("m", 1e-6),  # Greek letter
    "in": ("m", 0.0254),
    "1": ("1", 1.0),
    "rad": ("rad", 1.0),
    "mrad": ("rad", 1e-3),
    "deg": ("rad", pi / 180),
    "°": ("rad", pi / 180),
    "turn": ("rad", 2 * pi),
    "px": ("px", 1.0),
}
#: In which units values of parameters are read, by SI unit.
VALUES = {"m": "mm", "rad": "deg", "1": "", "px": "px"}
#: Small quantities: errors, residuals, standard deviations.
SMALL = {"m": "mm", "rad": "mrad", "1": "", "px": "px"}
#: Poses and readings.
POSES = {"m": "mm", "rad": "°", "1": "", "px": "px"}
#: As they are stored.
STORED = {"m": "m", "rad": "rad", "1": "1", "px": "px"}
_LAST = 1e-6  # last digit shown of values whose uncertainty is not known, [m], [rad]
#: Below what nobody measures, [1], [m], [rad].
_FINEST = {"1": 1e-9, "m": 1e-7, "rad": 1e-7, "px": 1e-4}


def shown_in(value: float, unit: str, units: Mapping[str, str] = SMALL) -> float:
    """Return a number of SI units in those in which it is read."""
    return value / UNITS[units[unit] or "1"][1]


def per_si(unit: str, units: Mapping[str, str] = SMALL) -> float:
    """Return how many of the unit in which it is read a number has of one SI unit."""
    return shown_in(1.0, unit, units)


def _digits(read: str, last: float | None = None) -> int:
    """Return how many digits behind the point show a last one in SI, or what anybody measures."""
    unit, factor = UNITS[read or "1"]
    return max(round(log10(factor / (last or _FINEST[unit]))), 0)


def amount(value: float, unit: str, digits: int = 3, units: Mapping[str, str] = SMALL) -> str:
    """Return a number with the unit in which it is read: ``0.12 mm`` of 0.00012 m."""
    return f"{number(value, unit, digits, units)} {units[unit]}".strip()


def number(value: float, unit: str, digits: int = 3, units: Mapping[str, str] = SMALL) -> str:
    """Return what ``amount`` does, without the unit; less than anybody measures is a bound."""
    if not (read := units[unit]):
        return rounded(value, digits)
    if bound := _bound(abs(value), unit, units):
        return bound
    shown = shown_in(value, unit, units)
    finest = digits - 1 - floor(log10(abs(shown))) if shown and isfinite(shown) else 0
    return rounded(round(shown, min(_digits(read), finest)), digits)  # rounded once


def _bound(value: float, unit: str, units: Mapping[str, str]) -> str:
    """Return ``< 0.0001`` of a size above zero that nobody measures, else an empty string."""
    least = 10.0 ** -(digits := _digits(units[unit]))
    return f"< {least:.{digits}f}" if 0.0 < shown_in(value, unit, units) < 0.5 * least else ""


def rounded(value: float, digits: int = 2) -> str:
    """Return a number rounded to some digits, without an exponent where it can be."""
    near = float(f"{value:.{digits}g}")
    if not 1e-9 <= abs(near) < 1e12:  # 0, or of a size that nobody reads without an exponent
        return f"{near:g}"
    places = max(digits - 1 - floor(log10(abs(near))), 0)
    text = f"{near:.{places}f}"
    return text.rstrip("0").rstrip(".") if places else text


def chance(p_value: float) -> str:
    """Return a probability as it is said: ``p = 0.003``, ``p < 1e-15``."""
    return f"p = {p_value:.2g}" if p_value >= 1e-15 else "p < 1e-15"


def percent(share: float) -> str:
    """Return a share in percent."""
    return f"{rounded(100 * share)} %"


def listed(words: Iterable[object], last: str = "and") -> str:
    """Return words with commas between them and a word before the last: ``a, b and c``."""
    *first, end = map(str, words)
    return f"{', '.join(first)} {last} {end}" if first else end


def capital(text: str) -> str:
    """Return a sentence with a capital, unless it begins with a name such as ``leg_1.l``."""
    first = text.partition(" ")[0].rstrip(":,")
    named = len(first) == 1 or any(letter.isdigit() or letter in "_." for letter in first)
    return text if named else f"{text[:1].upper()}{text[1:]}"


def measured(value: float, half: float, unit: str = "1", units: Mapping[str, str] = VALUES) -> str:
    """Return value ± uncertainty to two digits of the latter, with the unit: ``1.23 ± 0.45 mm``.

    Without an uncertainty, the value to the digits of its unit.
    """
    sure = f" ± {uncertainty(half, unit, units)}" if half > 0.0 and isfinite(half) else ""
    return f"{fixed(value, half, unit, units)}{sure} {units[unit]}".strip()


def uncertainty(half: float, unit: str, units: Mapping[str, str] = VALUES) -> str:
    """Return an uncertainty to two digits; less than anybody measures is a bound."""
    return _bound(half, unit, units) or fixed(half, half, unit, units)


def fixed(
    value: float, half: float, unit: str, units: Mapping[str, str] = VALUES, sign: str = ""
) -> str:
    """Return a value, as it is read, to two digits of an uncertainty, both in SI.

    No more digits than anybody measures: to 0.1 µm or µrad, or nine. Uncertainties of 0 or infinity
    are none. The sign ``"+"`` is also that of what is positive.
    """
    read, digits = units[unit], _digits(units[unit], _LAST)
    if half > 0.0 and isfinite(half):
        digits = min(max(1 - floor(log10(shown_in(half, unit, units))), 0), _digits(read))
    return f"{shown_in(value, unit, units):{sign}.{digits}f}"


# How columns are written

Columns: TypeAlias = Mapping[str, Iterable[float] | Iterable[str]]

COUNTS = "counts"
"""Unit of readings as an encoder counts them; its sensor says how many are in one rad or m."""
SCALE = "give counts_per_unit of its sensor in mechanism.yaml (651.9 per rad for 4096 in a turn)"


@dataclass(frozen=True)
class Units:
    """In which units columns are written; SI where nothing else is said."""

    names: Mapping[str, str] = field(default_factory=dict)
    """A key of ``UNITS`` for each SI unit, ``{"m": "mm"}``."""
    counts: Mapping[str, float] = field(default_factory=dict)
    """Encoder counts of one rad or m, by the column of a reading that is written in counts."""
    last: float = 0.0
    """To what values are written, in SI, but for standard deviations; 0 is to the last bit."""

    @classmethod
    def of(cls, text: str, counts: Mapping[str, float], readings: Iterable[str] = ()) -> Units:
        """Return the units that a list such as ``mm,deg,counts`` names.

        Counts are those of one rad or m, by reading, and all readings need theirs. Numbers end
        where those of ``WRITTEN`` do.
        """
        names: dict[str, str] = {}
        listed = list(filter(None, map(str.strip, text.split(","))))
        if COUNTS in listed and (lacking := [name for name in readings if name not in counts]):
            raise MeasurementError(
                f"--units {text}: how many counts one rad or m of {', '.join(lacking)} has is not "
                f"said: {SCALE}"
            )
        for unit in listed:
            if unit == COUNTS:
                continue
            dimension = UNITS.get(unit, ("1", 1.0))[0]
            if dimension not in ("m", "rad") or dimension in names:
                fault = {"m": "a second unit of length", "rad": "a second unit of angle"}
                known = (name for name, (kind, _) in UNITS.items() if kind in ("m", "rad"))
                raise MeasurementError(
                    f"--units {text}: {unit!r} is {fault.get(dimension, 'not a known unit')}; give "
                    "at most one unit of length and one of angle, such as mm,deg "
                    f"(known units: {', '.join(filter(str.isascii, known))}, {COUNTS})"
                )
            names[dimension] = unit
        return cls(names, counts if COUNTS in listed else {}, WRITTEN.last)

    def written(self, columns: Columns) -> Columns:
        """Return columns (header to values, SI) in these units, which their headers say."""
        written: dict[str, Iterable[float] | Iterable[str]] = {}
        for header, column in columns.items():
            name, bracket, bracketed = header.partition(" [")
            unit = bracketed.removesuffix("]")
            reading = name.removeprefix("sigma_").removeprefix("planned_")
            shown, scale = self.names.get(unit, unit), self.counts.get(reading)
            if not bracket or (shown == unit and scale is None and not self.last):
                written[header] = column
                continue
            if scale is None:
                scale = 1.0 / UNITS.get(shown, ("", 1.0))[1]
            else:
                shown = COUNTS
            values = np.asarray(column, dtype=np.float64) * scale
            if self.last and not name.startswith("sigma_"):  # these may be as small
                values = values.round(max(0, round(-np.log10(self.last * scale)))) + 0.0  # no -0.0
            written[f"{name} [{shown}]"] = values
        return written


SI = Units()
"""Nothing but SI, to the last bit."""
WRITTEN = Units(last=1e-12)
"""As commands write what was computed: to a picometre or picoradian, far below any noise."""
