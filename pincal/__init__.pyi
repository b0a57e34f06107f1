"""The names of ``pincal``, and where each is: imported when it is first used."""

from .architectures.cables import over_pulley
from .architectures.catalogue import new_mechanism
from .calibration.calibrate import calibrate, explain
from .calibration.many import montecarlo
from .calibration.options import Options
from .calibration.result import CalibrationResult
from .calibration.result_files import load_result
from .calibration.terms.choice import Explanation
from .design.forecast import forecast
from .design.planning import select
from .design.select import Selection, select_configurations, select_poses
from .design.simulate import accuracy, disturb, simulate
from .errors import (
    FileError,
    MeasurementError,
    MechanismError,
    ObservabilityError,
    PincalError,
    SymmetryError,
    WorkspaceError,
)
from .estimation.observability.identifiable import indices
from .files.mechanism_folders import load_mechanism
from .instruments.camera import Camera, Markers
from .instruments.lens import Lens
from .kinematics.collision import free_of_collision
from .kinematics.configurations import inverse
from .kinematics.derivatives import identification_jacobian
from .kinematics.forward import forward
from .kinematics.singularity import margins, tensions
from .model.joint import End, Follows, Joint
from .model.leg import Leg
from .model.measurements import Measurements, Noise, Plan
from .model.mechanism import Mechanism
from .model.parameter import Parameter
from .model.placement import Placement
from .model.platform import Platform
from .model.relations import Contact, Distance, Instrument, Tracker
from .model.sensor import Sensor
from .model.setup import Setup, Systematic, Target
from .model.terms import Cables, Harmonic, Load, Power, Share, Term
from .show.deployment import deploy
from .show.picture import picture
from .show.view.view import view
from .symmetry.carry import generate
from .symmetry.detect import symmetry_group
from .symmetry.elements import Element, cyclic, dihedral
from .workspace.criteria import Margins, Orientations
from .workspace.grid import Grid
from .workspace.region import Workspace, compute_workspace
from .workspace.sampling import sample_configurations, sample_contacts, sample_workspace

__version__: str

__all__ = [
    "Cables",
    "CalibrationResult",
    "Camera",
    "Contact",
    "Distance",
    "Element",
    "End",
    "Explanation",
    "FileError",
    "Follows",
    "Grid",
    "Harmonic",
    "Instrument",
    "Joint",
    "Leg",
    "Lens",
    "Load",
    "Margins",
    "Markers",
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
    "Power",
    "Selection",
    "Sensor",
    "Setup",
    "Share",
    "SymmetryError",
    "Systematic",
    "Target",
    "Term",
    "Tracker",
    "Workspace",
    "WorkspaceError",
    "accuracy",
    "calibrate",
    "compute_workspace",
    "cyclic",
    "deploy",
    "dihedral",
    "disturb",
    "explain",
    "forecast",
    "forward",
    "free_of_collision",
    "generate",
    "identification_jacobian",
    "indices",
    "inverse",
    "load_mechanism",
    "load_result",
    "margins",
    "montecarlo",
    "new_mechanism",
    "over_pulley",
    "picture",
    "sample_configurations",
    "sample_contacts",
    "sample_workspace",
    "select",
    "select_configurations",
    "select_poses",
    "simulate",
    "symmetry_group",
    "tensions",
    "view",
]
