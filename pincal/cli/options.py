"""Options that commands share, in groups: a command takes a group as one argument."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from math import isnan
from pathlib import Path
from typing import Annotated

import typer

from pincal.cli.app import Seed
from pincal.files.mechanism_folders import load_mechanism
from pincal.files.text import plain_number
from pincal.files.yaml import read_setup
from pincal.model.measurements import Noise
from pincal.model.mechanism import Mechanism
from pincal.model.setup import ORIGIN, Setup
from pincal.model.units import UNITS, Units, counts_of

_NUMBER = re.compile(r"\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?|[-+]?(?:nan|inf))\s*\[?([^\d\s\]]*)\]?\s*")


def in_si(text: str | float, dimensions: str, bare: str | None = "") -> float:
    """Return a number that may have a unit, in SI: 2e-5, 20um, '20 µm', 5mrad.

    Args:
        text: What was typed.
        dimensions: Those of the units that it may have: ``"m"``, ``"rad"``, or both with a blank.
        bare: Unit of a number without one: SI if empty; None if it must have one.

    Raises:
        BadParameter: no number, or another unit.
    """
    if isinstance(text, float):
        return text
    found = _NUMBER.fullmatch(text)
    number, unit = found.groups() if found else (text, "")
    value = plain_number(number)
    lacks = bare is None and not unit
    dimension, factor = UNITS.get(unit or bare or "", ("", 1.0))
    wrong = (isnan(value) and "nan" not in number) or (unit and dimension not in dimensions.split())
    if wrong or lacks:
        some = [one for one, (kind, _) in UNITS.items() if kind in dimensions.split()]
        raise typer.BadParameter(f"{text!r}: expected a number, with one of {', '.join(some)}")
    return float(f"{value * factor:.15g}")  # 20um is 2e-05, not 1.9999999999999998e-05


def with_unit(dimensions: str, what: str, bare: str | None = "") -> typer.models.OptionInfo:
    """Return an option for a number that may have a unit, or must: see ``in_si``."""

    def parse(text: str | float) -> float:
        return in_si(text, dimensions, bare)

    metavar = "NUMBER[UNIT]" if bare is not None else "NUMBER+UNIT"
    option: typer.models.OptionInfo = typer.Option(parser=parse, metavar=metavar, help=what)
    return option


@dataclass(frozen=True)
class SetupOptions:
    """What the measured numbers mean."""

    setup: Annotated[
        Path | None,
        typer.Option(metavar="YAML", help="Frame, targets, distances of the measurements."),
    ] = None
    unknown_frame: Annotated[
        bool,
        typer.Option("--unknown-frame", help="The base is anywhere in the frame of measurements."),
    ] = False
    unknown_target: Annotated[
        bool,
        typer.Option("--unknown-target", help="The point measured sits anywhere on the platform."),
    ] = False

    def read(self) -> Setup:
        """Return the setup of the file, and of the options beside it.

        Raises:
            FileError: the file is missing or cannot be read.
            MeasurementError: it says something else than it should.
        """
        found = Setup() if self.setup is None else read_setup(self.setup)
        if self.unknown_frame:
            found = replace(found, unknown_frame=True)
        if self.unknown_target:
            target = replace(found.targets[ORIGIN], unknown=True)
            found = replace(found, targets={**found.targets, ORIGIN: target})
        return found


@dataclass(frozen=True)
class CountOptions:
    """What encoders count."""

    counts: Annotated[
        list[str] | None,
        typer.Option(
            "--counts",
            metavar="[LEG=]NUMBER/UNIT",
            help="How many counts columns such as 'leg_1 [counts]' have: leg_1=4096/turn, "
            "12.5/mm, 651.9/rad; without a leg of all.",
        ),
    ] = None

    def load(self, mech: str) -> Mechanism:
        """Return a mechanism, its readings in the counts given.

        Raises:
            PincalError: a file that cannot be read, or counts that are not understood.
        """
        mechanism = load_mechanism(mech)
        units = dict(zip(mechanism.reading_names, mechanism.reading_units, strict=True))
        return mechanism.with_counts(counts_of(self.counts or (), units))


@dataclass(frozen=True)
class UnitOptions:
    """In which units numbers are written."""

    units: Annotated[
        str | None,
        typer.Option(
            "--units",
            metavar="mm,deg",
            help="Units to write and print in: m, cm, mm, um or in; rad, mrad, deg or turn; "
            "counts of readings.",
        ),
    ] = None

    def written_in(self, mechanism: Mechanism) -> Units:
        """Return the units; SI where nothing is said.

        Raises:
            MeasurementError: a unit that is not understood, or counts that are not known.
        """
        return Units.of(self.units or "", mechanism.counts, mechanism.reading_names)


@dataclass(frozen=True)
class TableOptions(UnitOptions, CountOptions):
    """Units of tables that are read and written."""


@dataclass(frozen=True)
class NoiseOptions:
    """How well is measured."""

    noise_position: Annotated[
        float, with_unit("m", "Standard deviation of positions [m], or as 20um.")
    ] = 1e-4
    noise_orientation: Annotated[
        float, with_unit("rad", "Standard deviation of angles [rad], or as 5mrad.")
    ] = 1e-4
    noise_reading: Annotated[
        float, with_unit("m rad", "Standard deviation of readings [rad or m].")
    ] = 0.0

    def noise(self) -> Noise:
        """Return the noise."""
        return Noise(self.noise_position, self.noise_orientation, self.noise_reading)


@dataclass(frozen=True)
class PlanOptions(SetupOptions, NoiseOptions):
    """What will be measured, and how well."""

    measure: Annotated[
        str | None,
        typer.Option(
            metavar="pose|position|orientation|nothing|x,y,…",
            help="What is measured of the platform; all sensors are read at every pose.",
        ),
    ] = None
    seed: Seed = 0

    def measured(self, mechanism: Mechanism, setup: Setup) -> tuple[str, ...]:
        """Return what is measured of the platform, as ``--measure`` says it."""
        platform, more = mechanism.platform, tuple(setup.columns(mechanism))
        pairs = list(zip(platform.freedoms, platform.units, strict=True))
        named = {
            "pose": platform.freedoms,
            "position": tuple(name for name, unit in pairs if unit == "m"),
            "orientation": tuple(name for name, unit in pairs if unit == "rad"),
            "nothing": (),
        }
        measure = self.measure or "pose"
        if measure in named:
            return (*named[measure], *more)
        return tuple(measure.replace(" ", "").split(","))
