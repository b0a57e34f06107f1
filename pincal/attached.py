"""Methods of low-level classes whose work is done by functions of higher-level packages.

A mechanism saves and draws itself, measurements are read from a table, a result makes its report:
the class declares such a method, with its arguments and documentation, and marks it ``@attached``.
A function of a higher package does the work, and is imported at the first call. This table is the
only place where a lower package refers to a higher one.
"""

from collections.abc import Callable
from functools import wraps
from importlib import import_module
from typing import Any, TypeVar

Method = TypeVar("Method", bound=Callable[..., Any])

DONE_BY = {
    "CalibrationResult._repr_html_": "pincal.show.report.result_html",
    "CalibrationResult.plot": "pincal.show.charts.Plots",
    "CalibrationResult.report": "pincal.show.report.report",
    "CalibrationResult.save": "pincal.calibration.result_files.save_result",
    "CalibrationResult.tables": "pincal.show.tables.calibration_tables",
    "CalibrationResult.validated": "pincal.calibration.validation.with_validation",
    "Explanation.__str__": "pincal.show.explanation.explanation_page",
    "Forecast.__str__": "pincal.show.tables.forecast_text",
    "Measurements.from_csv": "pincal.files.measurements.read_measurements",
    "Mechanism.__str__": "pincal.show.report.mechanism_text",
    "Mechanism._repr_html_": "pincal.show.report.mechanism_html",
    "Mechanism.from_urdf": "pincal.formats.arm.load_arm",
    "Mechanism.pinocchio": "pincal.kinematics.forest.pinocchio_model",
    "Mechanism.save": "pincal.files.mechanism_folders.save_mechanism",
    "MonteCarlo.__str__": "pincal.show.many.montecarlo_text",
    "Plan.from_csv": "pincal.files.measurements.read_poses",
    "Plan.to_csv": "pincal.files.columns.write_plan",
    "Selection.__str__": "pincal.show.tables.selection_text",
    "Setup.from_yaml": "pincal.instruments.setup_file.read_setup",
}
"""Function or class that is called with each method's arguments, the object first."""


def attached(method: Method) -> Method:
    """Return a method that calls its function in ``DONE_BY``; the declaration has no body."""
    module, _, name = DONE_BY[method.__qualname__].rpartition(".")

    @wraps(method)
    def done_above(*arguments: Any, **options: Any) -> Any:
        return getattr(import_module(module), name)(*arguments, **options)

    return done_above  # type: ignore[return-value]
