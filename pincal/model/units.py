"""Units as people write and read them: one table for headers, options and everything printed."""

from __future__ import annotations

from math import pi

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
}
#: Names that are printed otherwise than they are typed.
PRINTED = {"deg": "°", "um": "µm", "μm": "µm"}
