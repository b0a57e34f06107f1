"""Results and mechanisms in notebooks and in print: their ``_repr_html_`` and ``__str__``."""

from __future__ import annotations

from pincal.calibration.result import CalibrationResult
from pincal.model.mechanism import Mechanism


def mechanism_html(mechanism: Mechanism) -> str:
    """Return a mechanism: a picture and its nominal parameters."""
    from pincal.show.pictures.picture import picture
    from pincal.show.pictures.svg import drawing, figure
    from pincal.show.tables import nominal_table
    from pincal.words.pages import rendered

    platform, name = mechanism.platform, f"{mechanism.name} at home"
    with drawing():
        drawn = figure(picture(mechanism).figure(), "figure-mechanism", name)
    return rendered(
        "mechanism.html",
        title=f"{mechanism.name}: {len(mechanism.legs)} legs, {', '.join(platform.coordinates)}",
        description=mechanism.description,
        figure=drawn,
        table=nominal_table(mechanism),
    )


def result_html(result: CalibrationResult) -> str:
    """Return a calibration: what to know first, parameters, residuals."""
    from pincal.show.report.answers import warning_lines
    from pincal.show.report.parts import Part
    from pincal.show.result_tables import legs_table, outliers_table, parameters_table
    from pincal.show.summary import held_out_line, method_line, noise_line
    from pincal.words.pages import rendered

    shown: list[Part] = []
    if result.converged:
        lines = [f"identified with {method_line(result)}", noise_line(result)]
        lines += [held_out_line(result.validation)] if result.validation is not None else []
        shown = [lines, parameters_table(result), legs_table(result)]
        shown += [outliers_table(result)] if result.outliers else []
    return rendered(
        "result.html",
        title=f"{result.nominal.name}: calibration, {result.message}",
        warnings=warning_lines(result),
        shown=shown,
    )


def result_text(result: CalibrationResult) -> str:
    """Return a calibration as a page of text: how it was made, tables, what to know first."""
    from pincal.show.report.answers import warning_lines
    from pincal.show.result_tables import calibration_tables
    from pincal.show.summary import check_lines, method_line, noise_line, tie_lines

    parts = [f"{result.nominal.name}: {method_line(result)}; {result.message}"]
    if result.converged:
        parts += [str(table) for table in calibration_tables(result)]
        lines = (noise_line(result), *tie_lines(result), *check_lines(result))
        parts.append("\n".join(lines))
    return "\n\n".join([*parts, *(f"warning: {one}" for one in warning_lines(result))])
