"""Results and mechanisms in notebooks and in print: their ``_repr_html_`` and ``__str__``."""

from __future__ import annotations

from pincal.calibration.result import CalibrationResult
from pincal.model.mechanism import Mechanism


def mechanism_html(mechanism: Mechanism) -> str:
    """Return a mechanism: a picture and its nominal parameters."""
    from pincal.show.pictures.files import on_page
    from pincal.show.pictures.picture import picture
    from pincal.show.tables import nominal_table
    from pincal.words.pages import rendered

    drawn = on_page("figure-mechanism")(
        lambda: (picture(mechanism).figure(), f"{mechanism.name} at home")
    )
    table = nominal_table(mechanism)
    return rendered("mechanism.html", mechanism=mechanism, figure=drawn(), table=table)


def result_html(result: CalibrationResult) -> str:
    """Return a calibration: what to know first, parameters, residuals."""
    from pincal.show import result_tables, summary
    from pincal.show.report.answers import warning_lines
    from pincal.words.pages import rendered

    warnings = warning_lines(result)
    return rendered(
        "result.html", result=result, warnings=warnings, tables=result_tables, summary=summary
    )


def result_text(result: CalibrationResult) -> str:
    """Return a calibration as a page of text: how it was made, tables, what to know first."""
    from pincal.show.report.answers import warning_lines
    from pincal.show.result_tables import calibration_tables
    from pincal.show.summary import (
        check_lines,
        method_line,
        noise_line,
        systematic_lines,
        tie_lines,
        tolerance_lines,
    )

    parts = [f"{result.nominal.name}: {method_line(result)}; {result.message}"]
    if result.converged:
        parts += [str(table) for table in calibration_tables(result)]
        lines = [noise_line(result), *systematic_lines(result), *tie_lines(result)]
        lines += [*tolerance_lines(result), *check_lines(result)]
        parts.append("\n".join(lines))
    return "\n\n".join([*parts, *(f"warning: {one}" for one in warning_lines(result))])
