"""Options that say how the platform is measured, and how well."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from pincal.files.setups import read_setup
from pincal.model.mechanism import Mechanism
from pincal.model.setup import ORIGIN, Setup

SetupFile = Annotated[
    Path | None,
    typer.Option("--setup", metavar="YAML", help="Frame, targets, distances of the measurements."),
]
UnknownFrame = Annotated[
    bool,
    typer.Option("--unknown-frame", help="The base stands anywhere in the frame of measurements."),
]
NoisePosition = Annotated[float, typer.Option(help="Standard deviation of positions [m].")]
NoiseOrientation = Annotated[float, typer.Option(help="Standard deviation of angles [rad].")]
NoiseReading = Annotated[float, typer.Option(help="Standard deviation of readings [rad or m].")]
Measure = Annotated[
    str | None,
    typer.Option(
        metavar="pose|position|orientation|nothing|x,y,…",
        help="What is measured of the platform; all sensors are read at every pose.",
    ),
]
UnknownTarget = Annotated[
    bool,
    typer.Option("--unknown-target", help="The point measured sits anywhere on the platform."),
]


def setup_from(path: Path | None, *, unknown_frame: bool, unknown_target: bool) -> Setup:
    """Return the setup of a file, and of options beside it.

    Raises:
        FileError: the file is missing or cannot be read.
        MeasurementError: it says something else than it should.
    """
    setup = Setup() if path is None else read_setup(path)
    if unknown_frame:
        setup = replace(setup, unknown_frame=True)
    if unknown_target:
        target = replace(setup.targets[ORIGIN], unknown=True)
        setup = replace(setup, targets={**setup.targets, ORIGIN: target})
    return setup


def measured_of(mechanism: Mechanism, measure: str, setup: Setup) -> tuple[str, ...]:
    """Return what is measured of the platform, as ``--measure`` says it."""
    platform, more = mechanism.platform, tuple(setup.columns(mechanism))
    pairs = list(zip(platform.freedoms, platform.units, strict=True))
    named = {
        "pose": platform.freedoms,
        "position": tuple(name for name, unit in pairs if unit == "m"),
        "orientation": tuple(name for name, unit in pairs if unit == "rad"),
        "nothing": (),
    }
    if measure in named:
        return (*named[measure], *more)
    return tuple(measure.replace(" ", "").split(","))
