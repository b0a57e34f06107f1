"""All public names in the order of the API's page: the build fails where one is missing."""

from __future__ import annotations

GROUPS = {
    "Mechanisms": "load_mechanism new_mechanism Mechanism Leg End Follows Joint Placement "
    "Parameter Platform generate over_pulley",
    "Sensors and terms": "Sensor Term Harmonic Power Share Load Cables",
    "Kinematics": "inverse forward margins tensions identification_jacobian",
    "Workspace": "sample_workspace sample_configurations sample_contacts compute_workspace "
    "Workspace Grid Orientations Margins free_of_collision",
    "Symmetry": "symmetry_group Element cyclic dihedral",
    "Poses to measure": "select select_poses Selection select_configurations Plan forecast indices",
    "Measurements": "Measurements Noise Setup Target Distance Contact Tracker Systematic "
    "Camera Lens Markers Instrument",
    "Calibration": "calibrate Options CalibrationResult load_result explain Explanation deploy",
    "Simulation": "disturb simulate accuracy montecarlo",
    "Pictures": "picture view",
    "Errors": "PincalError MechanismError MeasurementError ObservabilityError SymmetryError "
    "WorkspaceError FileError",
}
#: What functions return, by the module that holds it.
RETURNED = """
pincal.calibration.many.MonteCarlo
pincal.calibration.many.Cost
pincal.calibration.result.IdentifiedParameter
pincal.calibration.validation.Validation
pincal.design.forecast.Forecast
pincal.design.platform_error.PlatformError
pincal.design.simulate.Accuracy
pincal.design.simulate.Simulation
pincal.estimation.observability.identifiable.Identifiability
pincal.estimation.observability.identifiable.Indices
pincal.finding.Finding
pincal.kinematics.forward.ForwardSolution
pincal.kinematics.configurations.InverseSolution
pincal.show.picture.Picture
pincal.show.view.view.View
pincal.symmetry.detect.SymmetryGroup
pincal.words.table.Table
pincal.workspace.grid.Axis
"""
