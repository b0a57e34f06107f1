"""Results and mechanisms in notebooks: they show themselves as tables and pictures.

Notebooks ask an object for ``_repr_html_``. Mechanisms and results stand on lower floors, which
know nothing of pages; so this floor gives them the method, when ``pincal`` is imported.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pincal.calibration.result import CalibrationResult
from pincal.model.mechanism import Mechanism

if TYPE_CHECKING:  # lxml and matplotlib are imported where they are needed
    from pincal.show.markup import Element

_LISTED = 10  # outliers in a notebook


def register() -> None:
    """Give mechanisms and results their looks in notebooks."""
    for kind, shown in ((Mechanism, mechanism_html), (CalibrationResult, result_html)):
        kind._repr_html_ = shown  # type: ignore[union-attr]


def mechanism_html(mechanism: Mechanism) -> str:
    """Return a mechanism: a picture and its nominal parameters."""
    from pincal.show.markup import serialised, tag
    from pincal.show.markup_tables import nominal_table

    platform = mechanism.platform
    title = f"{mechanism.name}: {len(mechanism.legs)} legs, {', '.join(platform.coordinates)}"
    whole = tag("div", tag("h2", title))
    if mechanism.description:
        whole.append(tag("p", mechanism.description))
    whole.append(_picture(mechanism))
    whole.append(nominal_table(mechanism))
    return serialised(whole)


def result_html(result: CalibrationResult) -> str:
    """Return a calibration: what to know first, parameters, residuals."""
    from pincal.show.calibration import held_out_in_words, noise_in_words
    from pincal.show.markup import bullets, serialised, tag
    from pincal.show.markup_tables import outliers_table, parameters_table, residuals_table
    from pincal.show.report_answers import warnings_box

    whole = tag("div", tag("h2", f"{result.nominal.name}: calibration, {result.message}"))
    if (box := warnings_box(result)) is not None:
        whole.append(box)
    if not result.converged:
        return serialised(whole)
    lines = [noise_in_words(result)]
    if (one := result.validation) is not None:
        lines.append(held_out_in_words(one))
    whole.append(bullets(lines))
    whole.append(parameters_table(result))
    whole.append(residuals_table(result))
    if result.outliers:
        whole.append(outliers_table(result, _LISTED))
    return serialised(whole)


def _picture(mechanism: Mechanism) -> Element:
    """Return a mechanism at home."""
    from pincal.show.picture import picture
    from pincal.show.svg import drawing, figure

    with drawing():
        name = f"{mechanism.name} at home"
        element = figure(picture(mechanism).figure(), "figure-mechanism", name, name)
    element.set("style", "max-width: 30em")
    return element
