"""What ``pincal workspace`` writes of poses, regions and spaces of readings, in SI units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pincal.model.mechanism import Mechanism
from pincal.workspace.articular import ArticularSymmetry
from pincal.workspace.axes import Orientations
from pincal.workspace.inscribed import Inscribed
from pincal.workspace.region import Workspace

Array = NDArray[np.float64]


def poses_answer(mechanism: Mechanism, poses: Array) -> dict[str, Any]:
    """Return how many poses were sampled, and between which coordinates they lie."""
    platform = mechanism.platform
    return {
        "mechanism": mechanism.name,
        "kind": "poses",
        "count": len(poses),
        "ranges": _ranges(platform.coordinates, platform.units, poses),
    }


def region_answer(found: Workspace, inscribed: Inscribed | None) -> dict[str, Any]:
    """Return how large a workspace is, what was asked, and by which symmetry."""
    test = found.test
    return {
        "mechanism": test.mechanism.name,
        "kind": found.kind,
        "measure": found.measure,
        "uncertainty": found.uncertainty,
        "unit": found.unit,
        "count": found.count,
        "asked": found.asked.size,
        "apart_from_home": found.apart,
        "cut_by_the_grid": found.cut,
        "orientations": len(test.orientations),
        "every_orientation": test.every,
        "margins": {
            "type1": test.least.type1,
            "type2": test.least.least_type2(test.mechanism),
        },
        "computed": found.computed,
        "elements": [str(one) for one in found.elements],
        "unused_elements": [str(one) for one in found.unused],
        "inscribed": None if inscribed is None else vars(inscribed),
    }


def articular_answer(
    mechanism: Mechanism, spaces: Mapping[str, Array], checks: Sequence[ArticularSymmetry]
) -> dict[str, Any]:
    """Return the extent of spaces of readings, and whether permuted readings are reached."""
    units = mechanism.reading_units
    return {
        "mechanism": mechanism.name,
        "kind": "articular",
        "spaces": {
            name: {
                "count": len(readings),
                "ranges": _ranges(mechanism.reading_names, units, readings),
            }
            for name, readings in spaces.items()
        },
        "permuted_readings": [vars(one) | {"element": str(one.element)} for one in checks],
    }


def articular_columns(
    mechanism: Mechanism, spaces: Mapping[str, Array], readings: Mapping[str, Array]
) -> dict[str, list[str] | list[float]]:
    """Return a table of poses and readings, with the space that each is of."""
    platform = mechanism.platform
    parts = [
        (platform.coordinates, platform.units, spaces),
        (mechanism.reading_names, mechanism.reading_units, readings),
    ]
    columns: dict[str, list[str] | list[float]] = {
        "space": [name for name, poses in spaces.items() for _ in poses]
    }
    for names, units, values in parts:
        every = np.concatenate(list(values.values()))
        for name, unit, column in zip(names, units, every.T, strict=True):
            columns[f"{name} [{unit}]"] = column.tolist()
    return columns


def orientation_name(mechanism: Mechanism, orientation: Orientations) -> str:
    """Return an orientation in the platform's coordinates, as text."""
    platform = mechanism.platform
    matrices = np.eye(4)[None].copy()
    matrices[:, :3, :3] = orientation.rotations.as_matrix()
    values = platform.from_matrices(matrices)[0] + 0.0
    turns = zip(platform.coordinates, platform.units, values, strict=True)
    return ", ".join(f"{name} = {value:.6g} rad" for name, unit, value in turns if unit == "rad")


def _ranges(names: Sequence[str], units: Sequence[str], values: Array) -> dict[str, Any]:
    """Return unit, least and largest value of each column; null where there is none."""
    return {
        name: {
            "unit": unit,
            "low": column.min(initial=np.inf),
            "high": column.max(initial=-np.inf),
        }
        for name, unit, column in zip(names, units, values.T, strict=True)
    }
