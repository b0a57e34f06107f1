"""What people hold, in notebooks and in print."""

from __future__ import annotations

from pincal.calibration.result import CalibrationResult
from pincal.model.mechanism import Mechanism
from pincal.show import answers, tables
from pincal.show.pictures.files import page_figure
from pincal.show.pictures.picture import picture
from pincal.words.wording import rendered


def mechanism_text(mechanism: Mechanism) -> str:
    """Return a mechanism as a page of text: platform, legs, nominal parameters."""
    platform = mechanism.platform
    home = zip(platform.coordinates, platform.home, platform.units, strict=True)
    lines = [
        f"{mechanism.name}{': ' * bool(mechanism.description)}{mechanism.description}",
        f"platform {platform.kind}, at home "
        + ", ".join(f"{name} = {value:.6g} {unit}" for name, value, unit in home),
    ]
    lines += [
        f"{leg.name}: {leg.joint_letters}, reads {', '.join(leg.reading_names)}, closes a "
        f"{leg.closes}"
        for leg in mechanism.legs
    ]
    return "\n".join([*lines, "", str(tables.nominal_table(mechanism))])


def mechanism_html(mechanism: Mechanism) -> str:
    """Return a mechanism: a picture and its nominal parameters."""
    caption = f"{mechanism.name} at home"
    drawn = page_figure("mechanism", picture(mechanism).draw, caption)
    coordinates = ", ".join(mechanism.platform.coordinates)
    title = f"{mechanism.name}: {len(mechanism.legs)} legs, {coordinates}"
    description = [mechanism.description] if mechanism.description else []
    parts = [*description, drawn, tables.nominal_table(mechanism)]
    return rendered("notebook.html", title=title, warnings=[], parts=parts)


def result_html(result: CalibrationResult) -> str:
    """Return a calibration: what to know first, what supports it, its tables."""
    shown = tables.calibration_tables(result) if result.converged else []
    title = f"{result.nominal.name}: calibration, {result.message}"
    parts = [answers.supporting_lines(result, None), *shown]
    return rendered("notebook.html", title=title, warnings=answers.warnings(result), parts=parts)
