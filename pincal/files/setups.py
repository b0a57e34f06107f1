"""A setup file: in which frame and at which targets a platform was measured, as YAML."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from pincal.errors import MeasurementError
from pincal.files.strict import Name, Number, Strict
from pincal.files.yaml_reading import read_yaml
from pincal.model.checks import must_be
from pincal.model.measuring.setup import ORIGIN, Distance, Setup, Target
from pincal.model.measuring.uncertainty import STEEL, Systematic, Tracker


class _TargetSpec(Strict):
    offset: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)
    unknown: bool = False


class _DistanceSpec(Strict):
    start: tuple[Number, Number, Number] = Field(alias="from")
    target: Name = ORIGIN


class _TrackerSpec(Strict):
    at: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)
    range: Number = 0.0
    azimuth: Number = 0.0
    elevation: Number = 0.0


class _SystematicSpec(Strict):
    scale: Number = 0.0
    temperature: Number = 0.0
    expansion: Number = STEEL
    target: Number = 0.0


class _SetupSpec(Strict):
    pincal_setup: Literal[1]
    frame: Literal["base", "unknown"] = "base"
    targets: dict[Name, _TargetSpec] = Field(default_factory=dict)
    distances: dict[Name, _DistanceSpec] = Field(default_factory=dict)
    tracker: _TrackerSpec | None = None
    systematic: _SystematicSpec = Field(default_factory=_SystematicSpec)


def read_setup(path: str | Path) -> Setup:
    """Return the setup that a YAML file says: see ``Setup.from_yaml``."""
    path = Path(must_be(path, (str, Path), "a setup file", MeasurementError))
    spec = read_yaml(path, _SetupSpec, MeasurementError)
    distances = {name: Distance(one.start, one.target) for name, one in spec.distances.items()}
    try:
        return Setup(
            unknown_frame=spec.frame == "unknown",
            targets={name: Target(one.offset, one.unknown) for name, one in spec.targets.items()},
            distances=distances,
            tracker=None if spec.tracker is None else Tracker(**spec.tracker.model_dump()),
            systematic=Systematic(**spec.systematic.model_dump()),
        )
    except MeasurementError as error:
        raise MeasurementError(f"{path}: {error}") from error
