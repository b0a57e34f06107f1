"""Kinematic calibration of parallel robots, on Pinocchio.

Which poses to measure, what the kinematic parameters are, and how sure that is.
"""

from pincal.errors import (
    FileError,
    MeasurementError,
    MechanismError,
    ObservabilityError,
    PincalError,
    SymmetryError,
    WorkspaceError,
)
from pincal.experiment.observability import (
    Identifiability,
    Indices,
    identifiability,
    indices,
    r_diagonal,
)
from pincal.experiment.selection import Selection, select_poses
from pincal.experiment.simulation import Accuracy, Simulation, accuracy, disturb, simulate
from pincal.identification.calibrate import calibrate
from pincal.identification.expected import ExpectedError, expected_error
from pincal.identification.result import CalibrationResult
from pincal.identification.result_files import read_result
from pincal.kinematics.derivatives import identification_jacobian
from pincal.kinematics.forward import ForwardSolution, forward
from pincal.kinematics.inverse import InverseSolution, inverse
from pincal.kinematics.singularity import margins
from pincal.model.files import bundled, load_mechanism
from pincal.model.leg import Joint, Leg
from pincal.model.measurements import (
    Measurements,
    Noise,
    Plan,
    read_measurements,
    read_poses,
    read_readings,
    write_measurements,
    write_poses,
    write_readings,
)
from pincal.model.mechanism import Mechanism
from pincal.model.placement import Placement, along, cartesian, placed, polar, spherical
from pincal.model.platform import Platform
from pincal.model.sensor import Sensor
from pincal.symmetry.detect import SymmetryGroup, symmetry_group
from pincal.symmetry.elements import Element, mirror, rotations
from pincal.symmetry.generate import generate
from pincal.workspace.sampling import Margins, in_workspace, sample_workspace

__all__ = [
    "Accuracy",
    "CalibrationResult",
    "Element",
    "ExpectedError",
    "FileError",
    "ForwardSolution",
    "Identifiability",
    "Indices",
    "InverseSolution",
    "Joint",
    "Leg",
    "Margins",
    "MeasurementError",
    "Measurements",
    "Mechanism",
    "MechanismError",
    "Noise",
    "ObservabilityError",
    "PincalError",
    "Placement",
    "Plan",
    "Platform",
    "Selection",
    "Sensor",
    "Simulation",
    "SymmetryError",
    "SymmetryGroup",
    "WorkspaceError",
    "accuracy",
    "along",
    "bundled",
    "calibrate",
    "cartesian",
    "disturb",
    "expected_error",
    "forward",
    "generate",
    "identifiability",
    "identification_jacobian",
    "in_workspace",
    "indices",
    "inverse",
    "load_mechanism",
    "margins",
    "mirror",
    "placed",
    "polar",
    "r_diagonal",
    "read_measurements",
    "read_poses",
    "read_readings",
    "read_result",
    "rotations",
    "sample_workspace",
    "select_poses",
    "simulate",
    "spherical",
    "symmetry_group",
    "write_measurements",
    "write_poses",
    "write_readings",
]
