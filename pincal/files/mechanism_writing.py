"""A mechanism's folder as text: ``mechanism.yaml`` and the URDFs of legs and platform."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from pincal.files.schema import FORMAT
from pincal.files.terms import described
from pincal.files.urdf_writing import leg_urdf, platform_urdf
from pincal.model.leg import Leg
from pincal.model.mechanism import Mechanism
from pincal.model.placement import Coordinate
from pincal.model.platform_kind import KINDS
from pincal.model.sensors.load import Load
from pincal.model.sensors.terms import Term

YAML = "mechanism.yaml"
MECHANISM_FILES = (YAML, "platform.urdf")
"""Files by which pincal knows a mechanism folder of its own, and replaces them."""


def write_mechanism(mechanism: Mechanism, folder: Path) -> None:
    """Write a mechanism's files into a folder that exists."""
    (folder / YAML).write_text(_dump(mechanism), encoding="utf-8")
    for leg in mechanism.legs:
        (folder / f"{leg.name}.urdf").write_text(leg_urdf(leg), encoding="utf-8")
    platform = platform_urdf(mechanism.name, mechanism.legs)
    (folder / "platform.urdf").write_text(platform, encoding="utf-8")


def _dump(mechanism: Mechanism) -> str:
    platform = mechanism.platform
    data = {
        "pincal": FORMAT,
        "name": mechanism.name,
        **({"description": mechanism.description} if mechanism.description else {}),
        "platform": {
            "kind": platform.kind
            if platform.kind in KINDS
            else _Flow(name=platform.kind, freedoms=list(platform.form.freedoms)),
            "urdf": "platform.urdf",
            "home": _Flow(zip(platform.coordinates, platform.home, strict=True)),
        },
        "legs": [_dump_leg(leg) for leg in mechanism.legs],
        **({"labels": dict(mechanism.labels)} if mechanism.labels else {}),
        **({} if mechanism.load is None else {"load": _dump_load(mechanism.load)}),
    }
    header = "# A mechanism of pincal. Lengths in m, angles in rad. See docs/mechanism_files.md\n"
    return header + yaml.dump(data, Dumper=_Dumper, sort_keys=False, width=100)


def _dump_load(load: Load) -> dict[str, Any]:
    return {
        "mass": load.mass,
        "centre": list(load.centre),
        "gravity": list(load.gravity),
        **({"drawn": dict(load.drawn)} if load.drawn else {}),
    }


def _dump_leg(leg: Leg) -> dict[str, Any]:
    """Return a leg as plain data.

    Raises:
        MechanismError: a term that is code.
    """
    own = {
        name: _dump_terms((one for of, one in leg.terms if of == name), leg.name)
        for name in leg.deformed
    }
    return {
        "name": leg.name,
        "urdf": f"{leg.name}.urdf",
        "tip": leg.tip,
        "platform_point": leg.point.name,
        **({} if leg.closes == "point" else {"closes": leg.closes}),
        "home": _Flow((joint.name, joint.home) for joint in leg.moving),
        "sensors": [
            (dict if sensor.terms else _Flow)(
                joint=sensor.joint,
                form=sensor.form,
                gain=sensor.gain,
                offset=sensor.offset,
                direction=sensor.direction,
                zero=sensor.zero,
                **({} if (by := sensor.counts_per_unit) is None else {"counts_per_unit": by}),
                **({"terms": _dump_terms(sensor.terms, leg.name)} if sensor.terms else {}),
            )
            for sensor in leg.sensors
        ],
        "parameters": dict(leg.parameters),
        "placements": {
            joint.name: [_Flow({c.kind: _values(c)}) for c in joint.placement.coordinates]
            for joint in (*leg.joints, leg.point)
            if joint.placement.coordinates
        },
        **({"terms": own} if own else {}),
    }


def _dump_terms(terms: Iterable[Term], leg: str) -> dict[str, Any]:
    return {one.parameter: _Flow(described(one, leg)) for one in terms}


def _values(coordinate: Coordinate) -> Any:
    values = coordinate.values
    return values[0] if len(values) == 1 else list(values)


class _Flow(dict[str, Any]):
    """A mapping that YAML writes on one line."""


class _Dumper(yaml.CSafeDumper):
    """Writes ``_Flow`` mappings on one line, and NumPy's numbers as Python's."""


_Dumper.add_representer(
    _Flow,
    lambda dumper, data: dumper.represent_mapping("tag:yaml.org,2002:map", data, flow_style=True),
)
for _number in (np.floating, np.integer):
    _Dumper.add_multi_representer(_number, lambda dumper, own: dumper.represent_data(own.item()))
