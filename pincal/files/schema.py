"""What ``mechanism.yaml`` may say, read strictly: keys, types, and where a fault is."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError, ValidatorFunctionWrapHandler, WrapValidator

from pincal.errors import MechanismError
from pincal.files.strict import Name, Number, Strict
from pincal.files.terms import TermSpec
from pincal.files.yaml_reading import read_yaml

FORMAT = 1


Value = Name | Number


def _number_or_home(value: object, number: ValidatorFunctionWrapHandler) -> object:
    try:
        return value if value == "home" else number(value)
    except ValidationError as error:
        raise ValueError("a finite number or 'home' is expected") from error


Zero = Annotated[Literal["home"] | Number, WrapValidator(_number_or_home)]


class SensorSpec(Strict):
    """Sensor of a leg."""

    joint: str
    form: Literal["joint", "reading"] = "joint"
    gain: Value = 1.0
    offset: Value = 0.0
    direction: Literal[1, -1] = 1
    zero: Zero = 0.0
    counts_per_unit: Annotated[Number, Field(gt=0)] | None = None
    terms: dict[Name, TermSpec] = Field(default_factory=dict)


class LegSpec(Strict):
    """One leg."""

    name: Name
    urdf: str
    tip: str
    platform_point: str
    home: dict[str, Number]
    closes: Literal["point", "frame"] = "point"
    sensors: list[SensorSpec] = Field(min_length=1)
    parameters: dict[Name, Number]
    placements: dict[str, list[dict[str, Value | list[Value]]]]
    terms: dict[Name, dict[Name, TermSpec]] = Field(default_factory=dict)


class KindSpec(Strict):
    """A kind of platform of the user's own."""

    name: str
    freedoms: list[str]


class PlatformSpec(Strict):
    """The platform."""

    kind: str | KindSpec
    urdf: str
    home: dict[str, Number]


class LoadSpec(Strict):
    """What weighs on the mechanism."""

    mass: Number = 0.0
    centre: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)
    gravity: tuple[Number, Number, Number] = (0.0, 0.0, -9.81)
    drawn: dict[str, Number] = Field(default_factory=dict)


class MechanismSpec(Strict):
    """The whole file."""

    pincal: Literal[1]
    name: str
    description: str = ""
    platform: PlatformSpec
    labels: dict[str, str] = Field(default_factory=dict)
    load: LoadSpec | None = None
    legs: list[LegSpec] = Field(min_length=1)


def read_spec(path: Path) -> MechanismSpec:
    """Return what a ``mechanism.yaml`` says.

    Raises:
        FileError: the file is missing or cannot be read.
        MechanismError: it does not parse, or says something else than it should.
    """
    return read_yaml(path, MechanismSpec, MechanismError)
