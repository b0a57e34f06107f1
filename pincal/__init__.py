"""Kinematic calibration of parallel robots, on Pinocchio.

Which poses to measure, what the kinematic parameters are, and how sure that is.
"""

from pincal.calibration.calibrate import calibrate
from pincal.calibration.calibration import Calibration
from pincal.calibration.options import Options
from pincal.calibration.result import CalibrationResult, IdentifiedParameter
from pincal.calibration.result_files import load_result, read_result
from pincal.calibration.runs import RunComparison, compare_runs
from pincal.calibration.validation import Validation, validate
from pincal.design.forecast import Forecast, forecast
from pincal.design.platform_error import PlatformError
from pincal.design.select import Selection, select_poses
from pincal.design.select_configurations import ConfigurationChoice, select_configurations
from pincal.design.simulate import Accuracy, Simulation, accuracy, disturb, simulate
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
from pincal.estimation.observability import (
    Identifiability,
    Indices,
    identifiability,
    indices,
    r_diagonal,
)
from pincal.files.measurement_writing import write_measurements, write_poses, write_readings
from pincal.files.measurements import read_measurements, read_poses, read_readings
from pincal.files.mechanism_folders import bundled, load_mechanism
from pincal.files.setups import read_setup
from pincal.kinematics.arm import load_arm
from pincal.kinematics.derivatives import identification_jacobian
from pincal.kinematics.forward import ForwardSolution, forward
from pincal.kinematics.inverse import InverseSolution, inverse
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
from pincal.show.pictures.picture import Picture, picture
from pincal.show.report.report import Report, report
from pincal.show.view.view import View, view
from pincal.symmetry.detect import SymmetryGroup, symmetry_group
from pincal.symmetry.elements import Element, mirror, rotations
from pincal.symmetry.generate import generate
from pincal.workspace.articular import (
    ArticularSymmetry,
    articular_space,
    articular_symmetry,
    equal_sums,
)
from pincal.workspace.axes import Axis
from pincal.workspace.box import default_grid, default_samples
from pincal.workspace.criteria import Margins, in_workspace
from pincal.workspace.inscribed import Inscribed, largest_inscribed
from pincal.workspace.orientations import Orientations
from pincal.workspace.positions import Grid, Samples
from pincal.workspace.region import Workspace, compute_workspace
from pincal.workspace.sampling import sample_configurations, sample_workspace

__all__ = [
    "Accuracy",
    "ArticularSymmetry",
    "Axis",
    "Calibration",
    "CalibrationResult",
    "Condition",
    "ConfigurationChoice",
    "Distance",
    "Element",
    "FileError",
    "Forecast",
    "ForwardSolution",
    "Grid",
    "Identifiability",
    "IdentifiedParameter",
    "Indices",
    "Inscribed",
    "Instrument",
    "InverseSolution",
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
    "Picture",
    "PincalError",
    "Placement",
    "Plan",
    "Platform",
    "PlatformError",
    "PlatformKind",
    "Report",
    "RunComparison",
    "Samples",
    "Selection",
    "Sensor",
    "Setup",
    "Simulation",
    "SymmetryError",
    "SymmetryGroup",
    "Target",
    "Term",
    "Validation",
    "View",
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
    "default_grid",
    "default_samples",
    "disturb",
    "equal_sums",
    "forecast",
    "forward",
    "free_of_collision",
    "generate",
    "identifiability",
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
    "picture",
    "placed",
    "polar",
    "r_diagonal",
    "read_measurements",
    "read_poses",
    "read_readings",
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
    "write_readings",
]
