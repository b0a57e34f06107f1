"""Kinematic calibration of parallel robots, on Pinocchio.

Which poses to measure, what the kinematic parameters are, and how sure that is.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any
from warnings import warn

from pincal.calibration.calibrate import calibrate
from pincal.calibration.calibration import Calibration
from pincal.calibration.options import Options
from pincal.calibration.result import CalibrationResult
from pincal.calibration.runs import compare_runs
from pincal.calibration.validation import validate
from pincal.design.forecast import forecast
from pincal.design.select import Selection, select_poses
from pincal.design.select_configurations import select_configurations
from pincal.design.simulate import accuracy, disturb, simulate
from pincal.errors import (
    FileError,
    MeasurementError,
    MechanismError,
    ObservabilityError,
    PincalError,
    SymmetryError,
    WorkspaceError,
)
from pincal.estimation.losses import Loss
from pincal.estimation.observability.indices import indices
from pincal.files.measurement_writing import write_measurements, write_poses
from pincal.files.measurements import read_measurements, read_poses
from pincal.files.mechanism_folders import bundled, load_mechanism
from pincal.files.setups import read_setup
from pincal.finding import Finding
from pincal.formats.arm import load_arm
from pincal.kinematics.derivatives import identification_jacobian
from pincal.kinematics.forward import forward
from pincal.kinematics.inverse import inverse
from pincal.kinematics.readers import free_of_collision
from pincal.kinematics.singularity import margins
from pincal.model.instrument import Condition, Instrument
from pincal.model.leg import Joint, Leg
from pincal.model.measurements import Measurements, Noise, Plan
from pincal.model.mechanism import Mechanism
from pincal.model.parameter import Parameter
from pincal.model.placement import Placement, along, cartesian, placed, polar, spherical
from pincal.model.platform import Platform
from pincal.model.platform_kind import PlatformKind
from pincal.model.sensor import Sensor, Term
from pincal.model.setup import Distance, Setup, Target
from pincal.symmetry.detect import nearest_group, symmetry_group
from pincal.symmetry.elements import Element, cyclic, dihedral, mirror, rotations
from pincal.symmetry.generate import generate
from pincal.words.table import Table
from pincal.workspace.articular import articular_space, articular_symmetry
from pincal.workspace.criteria import Margins, in_workspace
from pincal.workspace.inscribed import Inscribed, largest_inscribed
from pincal.workspace.orientations import Orientations
from pincal.workspace.positions import Grid
from pincal.workspace.region import Workspace, compute_workspace
from pincal.workspace.sampling import sample_configurations, sample_workspace

if TYPE_CHECKING:
    from pincal.calibration.result_files import load_result, read_result
    from pincal.show.pictures.picture import picture
    from pincal.show.report.report import report
    from pincal.show.view.view import view

__all__ = [
    "Calibration",
    "CalibrationResult",
    "Condition",
    "Distance",
    "Element",
    "FileError",
    "Finding",
    "Grid",
    "Inscribed",
    "Instrument",
    "Joint",
    "Leg",
    "Loss",
    "Margins",
    "MeasurementError",
    "Measurements",
    "Mechanism",
    "MechanismError",
    "Noise",
    "ObservabilityError",
    "Options",
    "Orientations",
    "Parameter",
    "PincalError",
    "Placement",
    "Plan",
    "Platform",
    "PlatformKind",
    "Selection",
    "Sensor",
    "Setup",
    "SymmetryError",
    "Table",
    "Target",
    "Term",
    "Workspace",
    "WorkspaceError",
    "accuracy",
    "along",
    "articular_space",
    "articular_symmetry",
    "bundled",
    "calibrate",
    "cartesian",
    "compare_runs",
    "compute_workspace",
    "cyclic",
    "dihedral",
    "disturb",
    "forecast",
    "forward",
    "free_of_collision",
    "generate",
    "identification_jacobian",
    "in_workspace",
    "indices",
    "inverse",
    "largest_inscribed",
    "load_arm",
    "load_mechanism",
    "load_result",
    "margins",
    "mirror",
    "nearest_group",
    "picture",
    "placed",
    "polar",
    "read_measurements",
    "read_poses",
    "read_result",
    "read_setup",
    "report",
    "rotations",
    "sample_configurations",
    "sample_workspace",
    "select_configurations",
    "select_poses",
    "simulate",
    "spherical",
    "symmetry_group",
    "validate",
    "view",
    "write_measurements",
    "write_poses",
]

#: Imported when first used: what they need is slow to import.
_LATER = {
    "load_result": "pincal.calibration.result_files",
    "read_result": "pincal.calibration.result_files",
    "picture": "pincal.show.pictures.picture",
    "report": "pincal.show.report.report",
    "view": "pincal.show.view.view",
}
#: Public in version 0.1: where they are now.
_MOVED = {
    "pincal.calibration.result": "IdentifiedParameter",
    "pincal.calibration.runs": "RunComparison",
    "pincal.calibration.validation": "Validation",
    "pincal.design.forecast": "Forecast",
    "pincal.design.platform_error": "PlatformError",
    "pincal.design.select_configurations": "ConfigurationChoice",
    "pincal.design.simulate": "Accuracy Simulation",
    "pincal.estimation.observability.indices": "Identifiability Indices identifiability r_diagonal",
    "pincal.files.measurement_writing": "write_readings",
    "pincal.files.measurements": "read_readings",
    "pincal.kinematics.forward": "ForwardSolution",
    "pincal.kinematics.inverse": "InverseSolution",
    "pincal.show.pictures.picture": "Picture",
    "pincal.show.report.report": "Report",
    "pincal.show.view.view": "View",
    "pincal.symmetry.detect": "SymmetryGroup",
    "pincal.workspace.articular": "ArticularSymmetry equal_sums",
    "pincal.workspace.axes": "Axis",
    "pincal.workspace.box": "default_grid default_samples",
    "pincal.workspace.positions": "Samples",
}


def __getattr__(name: str) -> Any:
    if name in _LATER:
        found = globals()[name] = getattr(import_module(_LATER[name]), name)
        return found
    for module, names in _MOVED.items():
        if name in names.split():
            warn(
                f"pincal.{name} is now {module}.{name}; the old name goes with the next version",
                DeprecationWarning,
                stacklevel=2,
            )
            return getattr(import_module(module), name)
    raise AttributeError(f"module 'pincal' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
