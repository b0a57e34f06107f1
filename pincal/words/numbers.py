"""Units as people write and read them, and numbers rounded to their uncertainty.

One table of units serves headers, options and all output. Values are in the SI unit ``"m"``,
``"rad"`` or ``"1"`` (pixels: ``"px"``); an argument ``units`` maps SI units to displayed units.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from math import floor, isfinite, log10, pi
from typing import Self, TypeAlias

import numpy as np

from pincal.errors import MeasurementError

#: Units by name: SI unit of their dimension, and factor to SI.
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
#: Displayed units of parameters' values, by SI unit.
VALUES = {"m": "mm", "rad": "deg", "1": "", "px": "px"}
#: Displayed units of small quantities: errors, residuals, standard deviations.
SMALL = {"m": "mm", "rad": "mrad", "1": "", "px": "px"}
#: Displayed units of poses and readings.
POSES = {"m": "mm", "rad": "°", "1": "", "px": "px"}
#: SI units, for values shown as they are stored.
STORED = {"m": "m", "rad": "rad", "1": "1", "px": "px"}
_LAST = 1e-6  # last digit shown of values without a known uncertainty, [m], [rad]
#: Sizes by SI unit below which nothing can be measured, so that digits beyond them are not shown.
_FINEST = {"1": 1e-9, "m": 1e-7, "rad": 1e-7, "px": 1e-4}


def shown_in(value: float, unit: str, units: Mapping[str, str] = SMALL) -> float:
    """Convert a value from its SI unit to the displayed unit."""
    return value / UNITS[units[unit] or "1"][1]


def per_si(unit: str, units: Mapping[str, str] = SMALL) -> float:
    """Return the factor from an SI unit to the displayed unit."""
    return shown_in(1.0, unit, units)


def _digits(read: str, last: float | None = None) -> int:
    """Return the decimals of a displayed unit that reach down to ``last`` in SI, or ``_FINEST``."""
    unit, factor = UNITS[read or "1"]
    return max(round(log10(factor / (last or _FINEST[unit]))), 0)


def amount(value: float, unit: str, digits: int = 3, units: Mapping[str, str] = SMALL) -> str:
    """Return a value with its displayed unit, such as ``0.12 mm`` for 0.00012 m."""
    return f"{number(value, unit, digits, units)} {units[unit]}".strip()


def number(value: float, unit: str, digits: int = 3, units: Mapping[str, str] = SMALL) -> str:
    """Return ``amount`` without the unit; ``< 0.0001`` if the value is immeasurably small."""
    if not (read := units[unit]):
        return rounded(value, digits)
    if bound := _bound(abs(value), unit, units):
        return bound
    shown = shown_in(value, unit, units)
    finest = digits - 1 - floor(log10(abs(shown))) if shown and isfinite(shown) else 0
    return rounded(round(shown, min(_digits(read), finest)), digits)  # rounded once


def _bound(value: float, unit: str, units: Mapping[str, str]) -> str:
    """Return ``< 0.0001`` for a positive but immeasurably small size, else an empty string."""
    least = 10.0 ** -(digits := _digits(units[unit]))
    return f"< {least:.{digits}f}" if 0.0 < shown_in(value, unit, units) < 0.5 * least else ""


def rounded(value: float, digits: int = 2) -> str:
    """Return a number with some significant digits, without an exponent where possible."""
    near = float(f"{value:.{digits}g}")
    if not 1e-9 <= abs(near) < 1e12:  # 0, or a size that is unreadable without an exponent
        return f"{near:g}"
    return np.format_float_positional(near, trim="-")


def chance(p_value: float) -> str:
    """Return a p-value in words: ``p = 0.003``, ``p < 1e-15``."""
    return f"p = {p_value:.2g}" if p_value >= 1e-15 else "p < 1e-15"


def percent(share: float) -> str:
    """Return a share in percent."""
    return f"{rounded(100 * share)} %"


def listed(words: Iterable[object], last: str = "and") -> str:
    """Return words as an enumeration: ``a, b and c``; ``last`` replaces the ``and``."""
    *first, end = map(str, words)
    return f"{', '.join(first)} {last} {end}" if first else end


def capital(text: str) -> str:
    """Capitalise a sentence, unless it begins with a name such as ``leg_1.l``."""
    first = text.partition(" ")[0].rstrip(":,")
    named = len(first) == 1 or any(letter.isdigit() or letter in "_." for letter in first)
    return text if named else f"{text[:1].upper()}{text[1:]}"


def measured(value: float, half: float, unit: str = "1", units: Mapping[str, str] = VALUES) -> str:
    """Return value ± uncertainty, to two digits of the uncertainty: ``1.23 ± 0.45 mm``.

    Without an uncertainty, the value has the default number of digits of its unit.
    """
    sure = f" ± {uncertainty(half, unit, units)}" if half > 0.0 and isfinite(half) else ""
    return f"{fixed(value, half, unit, units)}{sure} {units[unit]}".strip()


def uncertainty(half: float, unit: str, units: Mapping[str, str] = VALUES) -> str:
    """Return an uncertainty to two digits; ``< 0.0001`` if it is immeasurably small."""
    return _bound(half, unit, units) or fixed(half, half, unit, units)


def fixed(
    value: float, half: float, unit: str, units: Mapping[str, str] = VALUES, sign: str = ""
) -> str:
    """Return a value in its displayed unit, rounded to two digits of its uncertainty.

    Value and uncertainty ``half`` are in SI; 0 or infinity means that there is no uncertainty.
    Digits end at 0.1 µm, 0.1 µrad or 1e-9. The sign ``"+"`` also marks positive values.
    """
    read, digits = units[unit], _digits(units[unit], _LAST)
    if half > 0.0 and isfinite(half):
        digits = min(max(1 - floor(log10(shown_in(half, unit, units))), 0), _digits(read))
    return f"{shown_in(value, unit, units):{sign}.{digits}f}"


# How columns are written

Columns: TypeAlias = Mapping[str, Iterable[float] | Iterable[str]]

COUNTS = "counts"
"""Unit of readings in encoder counts; ``counts_per_unit`` of the sensor is per rad or m."""
SCALE = "give counts_per_unit of its sensor in mechanism.yaml (651.9 per rad for 4096 in a turn)"


@dataclass(frozen=True)
class Units:
    """The units in which columns are written; SI by default."""

    names: Mapping[str, str] = field(default_factory=dict)
    """Units to write, keys of ``UNITS``, by SI unit: ``{"m": "mm"}``."""
    counts: Mapping[str, float] = field(default_factory=dict)
    """Encoder counts per rad or m, by name of the readings that are written in counts."""
    last: float = 0.0
    """Rounding step of values in SI, not of standard deviations; 0 writes every bit."""

    @classmethod
    def of(cls, text: str, counts: Mapping[str, float], readings: Iterable[str] = ()) -> Self:
        """Parse a list such as ``mm,deg,counts``; numbers are rounded as by ``WRITTEN``.

        ``counts`` are encoder counts per rad or m by reading; if the list names counts, all of
        ``readings`` need them.
        """
        names: dict[str, str] = {}
        listed = list(filter(None, map(str.strip, text.split(","))))
        if COUNTS in listed and (lacking := [name for name in readings if name not in counts]):
            raise MeasurementError(
                f"--units {text}: the encoder counts per rad or m of {', '.join(lacking)} are not "
                f"known: {SCALE}"
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
        """Convert columns (header to values, in SI) to these units; headers name the units."""
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
            if self.last and not name.startswith("sigma_"):  # σ may be as small as the step
                values = values.round(max(0, round(-np.log10(self.last * scale)))) + 0.0  # no -0.0
            written[f"{name} [{shown}]"] = values
        return written


SI = Units()
"""SI units without rounding."""
WRITTEN = Units(last=1e-12)
"""SI units rounded to a picometre or picoradian, far below any noise, as commands write results."""
