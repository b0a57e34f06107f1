"""Units as people write and read them: one table for headers, options and everything printed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from math import pi
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
#: Names that are printed otherwise than they are typed.
PRINTED = {"deg": "°", "um": "µm", "μm": "µm"}


Columns: TypeAlias = Mapping[str, Iterable[float] | Iterable[str]]

COUNTS = "counts"
"""Unit of readings as an encoder counts them; its sensor says how many are in one rad or m."""
SCALE = "give counts_per_unit of its sensor in mechanism.yaml (651.9 per rad for 4096 in a turn)"


@dataclass(frozen=True)
class Units:
    """In which units columns and tables are written; SI where nothing else is said."""

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
            if self.last and not name.startswith(("sigma_", "cov_")):  # these may be as small
                values = values.round(max(0, round(-np.log10(self.last * scale)))) + 0.0  # no -0.0
            written[f"{name} [{shown}]"] = values
        return written

    @property
    def printed(self) -> dict[str, str]:
        """In which unit numbers are printed, by SI unit, where that was said."""
        return {dimension: PRINTED.get(unit, unit) for dimension, unit in self.names.items()}


SI = Units()
"""Nothing but SI, to the last bit."""
WRITTEN = Units(last=1e-12)
"""As commands write what was computed: to a picometre or picoradian, far below any noise."""
