"""Names that left the top of ``pincal``: each works in this release, and says what replaces it."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any
from warnings import warn

import numpy as np
from numpy.typing import NDArray

from pincal.calibration.checks.runs import RunComparison
from pincal.calibration.result import CalibrationResult
from pincal.design.platform_error import PlatformError
from pincal.model.placement import Coordinate, Placement, Value
from pincal.symmetry.elements import Element

Array = NDArray[np.float64]
#: Module and its names; those that only moved are found there in the next version too.
_HOMES = {
    "pincal.calibration.calibration": "Calibration",
    "pincal.calibration.result": "IdentifiedParameter",
    "pincal.calibration.result_files": "read_result",
    "pincal.calibration.checks.runs": "RunComparison compare_runs",
    "pincal.calibration.checks.validation": "Validation",
    "pincal.design.forecast": "Forecast",
    "pincal.design.platform_error": "PlatformError",
    "pincal.design.select_configurations": "ConfigurationChoice",
    "pincal.design.simulate": "Accuracy Simulation",
    "pincal.estimation.observability.indices": "Identifiability Indices identifiability r_diagonal",
    "pincal.files.tables.measurement_writing": "write_measurements write_poses write_readings",
    "pincal.files.tables.measurements": "read_measurements read_poses read_readings",
    "pincal.files.mechanism_folders": "bundled",
    "pincal.files.setups": "read_setup",
    "pincal.finding": "Finding",
    "pincal.formats.arm": "load_arm",
    "pincal.kinematics.forward": "ForwardSolution",
    "pincal.kinematics.inverse": "InverseSolution",
    "pincal.old_names": "along cartesian expected_error mirror placed polar rotations spherical "
    "RunConsistency",
    "pincal.show.pictures.picture": "Picture",
    "pincal.show.report.report": "Report report",
    "pincal.show.view.view": "View",
    "pincal.symmetry.detect": "SymmetryGroup",
    "pincal.words.table": "Table",
    "pincal.workspace.articular": "ArticularSymmetry articular_space equal_sums",
    "pincal.workspace.axes": "Axis",
    "pincal.workspace.box": "default_grid default_samples",
    "pincal.workspace.criteria": "in_workspace",
    "pincal.workspace.positions": "Samples",
}
#: What to write instead, where it is not the name in its module.
_REPLACED = {
    "along": "Placement.of",
    "articular_space": "inverse(mechanism, poses).readings",
    "cartesian": "Placement.of",
    "expected_error": "CalibrationResult.expected_error",
    "load_arm": "Mechanism.from_urdf",
    "mirror": "Element.mirror",
    "placed": "Placement.of",
    "polar": "Placement.of",
    "read_measurements": "Measurements.from_csv",
    "read_poses": "Plan.from_csv",
    "read_setup": "Setup.from_yaml",
    "report": "CalibrationResult.report",
    "rotations": "Element.rotations",
    "RunConsistency": "calibration.checks.runs.RunComparison",
    "spherical": "Placement.of",
    "write_measurements": "Measurements.to_csv",
    "write_poses": "Plan.to_csv",
}
OLD = {
    name: (module, _REPLACED.get(name, f"{module}.{name}").removeprefix("pincal."))
    for module, names in _HOMES.items()
    for name in names.split()
}
"""Names that left: where each is, and what replaces it, after ``pincal.``."""


def old_name(name: str) -> Any:
    """Return what a name meant at the top of ``pincal``, with a warning.

    Raises:
        AttributeError: it never was there.
    """
    if name not in OLD:
        raise AttributeError(f"module 'pincal' has no attribute {name!r}")
    module, now = OLD[name]
    said = f"pincal.{name} is now pincal.{now}; the old name goes with the next version"
    warn(said, DeprecationWarning, stacklevel=3)
    return getattr(import_module(module), name)


rotations, mirror = Element.rotations, Element.mirror
RunConsistency = RunComparison


def expected_error(result: CalibrationResult, poses: Array) -> PlatformError:
    """Return the platform error to expect of the calibrated mechanism over poses, (N, dof)."""
    return result.expected_error(poses)


def placed(parameters: Mapping[str, float], *coordinates: Coordinate) -> Placement:
    """Return ``Placement.of``, with coordinates of the functions below."""
    return Placement(coordinates).at(parameters, Placement().origin())


def polar(radius: Value, azimuth: Value) -> Coordinate:
    """Return the coordinate of a point at a radius and an azimuth about z."""
    return Coordinate("polar", (radius, azimuth))


def spherical(radius: Value, polar_angle: Value, azimuth: Value) -> Coordinate:
    """Return the coordinate of a point at a radius, an angle from z and an azimuth."""
    return Coordinate("spherical", (radius, polar_angle, azimuth))


def cartesian(x: Value, y: Value, z: Value | None = None) -> tuple[Coordinate, ...]:
    """Return the coordinates of a point given by x, y and, in space, z."""
    return tuple(along(axis, v) for axis, v in zip("xyz", (x, y, z), strict=True) if v is not None)


def along(axis: str, value: Value) -> Coordinate:
    """Return a displacement along an axis (``"x"``) or about it (``"rx"``)."""
    return Coordinate(axis, (value,))
