"""Kinematic calibration of parallel robots, on Pinocchio.

Which poses to measure, what the kinematic parameters are, and how sure that is.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from pincal.calibration.calibrate import calibrate
from pincal.calibration.options import Options
from pincal.calibration.result import CalibrationResult
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
from pincal.estimation.observability.indices import indices
from pincal.estimation.residuals.losses import Loss
from pincal.files.mechanism_folders import load_mechanism
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
from pincal.model.placement import Placement
from pincal.model.platform import Platform
from pincal.model.platform_kind import PlatformKind
from pincal.model.sensor import Sensor, Term
from pincal.model.setup import Distance, Setup, Target
from pincal.old_names import old_name
from pincal.symmetry.detect import symmetry_group
from pincal.symmetry.elements import Element, cyclic, dihedral
from pincal.symmetry.generate import generate
from pincal.workspace.articular import articular_symmetry
from pincal.workspace.criteria import Margins
from pincal.workspace.inscribed import Inscribed, largest_inscribed
from pincal.workspace.orientations import Orientations
from pincal.workspace.positions import Grid
from pincal.workspace.region import Workspace, compute_workspace
from pincal.workspace.sampling import sample_configurations, sample_workspace

if TYPE_CHECKING:
    from pincal.calibration.result_files import load_result
    from pincal.show.pictures.picture import picture
    from pincal.show.view.view import view

__all__ = [
    "CalibrationResult",
    "Condition",
    "Distance",
    "Element",
    "FileError",
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
    "Target",
    "Term",
    "Workspace",
    "WorkspaceError",
    "accuracy",
    "articular_symmetry",
    "calibrate",
    "compute_workspace",
    "cyclic",
    "dihedral",
    "disturb",
    "forecast",
    "forward",
    "free_of_collision",
    "generate",
    "identification_jacobian",
    "indices",
    "inverse",
    "largest_inscribed",
    "load_mechanism",
    "load_result",
    "margins",
    "picture",
    "sample_configurations",
    "sample_workspace",
    "select_configurations",
    "select_poses",
    "simulate",
    "symmetry_group",
    "validate",
    "view",
]

#: Imported when first used: what they need is slow to import.
_LATER = {
    "load_result": "pincal.calibration.result_files",
    "picture": "pincal.show.pictures.picture",
    "view": "pincal.show.view.view",
}


def __getattr__(name: str) -> Any:
    if name in _LATER:
        found = globals()[name] = getattr(import_module(_LATER[name]), name)
        return found
    return old_name(name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
