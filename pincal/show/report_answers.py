"""The first screen of a report: is it better, by how much, may I trust it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2 as chi2_law

from pincal.calibration.result import CalibrationResult
from pincal.show.calibration import (
    held_out_in_words,
    noise_in_words,
    scaled_in_words,
    sentence,
    size_in_words,
    warnings_of,
)
from pincal.show.findings import Findings
from pincal.show.markup import Element, bullets, tag
from pincal.show.series import series_of
from pincal.show.tables import SHOWN
from pincal.show.workspace_errors import WorkspaceErrors

_CLEARLY = 2.0  # by how much an error must fall to be called better without reserve
_SIZE = "By how much?"
#: Looks of verdicts, by colour, sign and border; those not listed ask for care.
_TONES = {
    "Yes": "good",
    "Nothing speaks against it": "good",
    "Hardly": "bad",
    "No sign of it": "bad",
    "There is no result": "bad",
    "No": "bad",
    "Not shown": "bad",
    "Not as it stands": "bad",
}


def warnings_box(result: CalibrationResult) -> Element | None:
    """Return what the reader should know first, or None."""
    lines = warnings_of(result)
    if not result.converged:
        lines.insert(0, f"The fit did not converge: {result.message}")
    if not lines:
        return None
    title = "One warning" if len(lines) == 1 else f"{len(lines)} warnings"
    return tag("div", tag("h2", title), bullets(lines), id="warnings", role="alert")


def answers(found: Findings, notes: Sequence[str]) -> Element:
    """Return the three answers.

    Args:
        found: The calibration.
        notes: What was not done, and why.
    """
    section = tag("section", id="answers", aria_label="Summary")
    if found.errors is None:
        section.append(
            _answer(
                "Is it better?",
                "There is no result",
                "The search for the parameters ended without an answer, so there is no calibrated "
                "mechanism, and none is shown or written.",
                "Look at the warnings, at the units and at the working mode; give a better nominal "
                "mechanism, more poses, or a robust loss (--robust reject).",
            )
        )
        return section
    section.append(_better(found, found.errors))
    section.append(_how_much(found, found.errors))
    section.append(_trust(found.result, notes))
    return section


def doubtful(result: CalibrationResult) -> bool:
    """Return whether noise, held-out rows, runs or ties contradict the model."""
    return (
        result.excess > 1.0
        or (result.validation is not None and bool(result.validation.findings))
        or (result.runs is not None and not result.runs.agree)
        or not all(tie.holds for tie in result.ties)
    )


def _answer(question: str, verdict: str, *lines: Element | str) -> Element:
    tone = "" if question == _SIZE else _TONES.get(verdict.partition(":")[0], "care")
    card = tag("article", tag("h2", question), tag("p", verdict, class_="verdict"), class_=tone)
    card.extend(tag("p", line) if isinstance(line, str) else line for line in lines)
    return card


def _better(found: Findings, errors: WorkspaceErrors) -> Element:
    (before, turned), (after, turning) = errors.mean_before(), errors.mean_after()
    more = found.result.excess
    ratios = [before / after / more] + ([turned / turning / more] if found.turns else [])
    both = zip((before, turned)[: len(ratios)], errors.limit, strict=False)
    sure = [one / limit / more for one, limit in both]
    worst = min(ratios)
    if not found.result.corrects:
        verdict = "No"
        said = (
            f"The fit failed: residuals hardly fell, and are {more:.3g} times as large as the "
            "noise given makes them. Parameters that fit no better than nominal ones correct "
            "nothing."
        )
    elif not found.result.promises:
        verdict = "Not shown"
        said = (
            f"Residuals fell, but are still {more:.3g} times as large as the noise given makes "
            "them: something is wrong with rows, noise or model, and parameters follow it."
        )
    elif worst >= _CLEARLY:
        checked = bool(found.result.degrees_of_freedom) and not doubtful(found.result)
        verdict = "Yes" if checked else "Probably"
        said = (
            f"The platform's root mean square error {errors.where} should be about "
            f"{_times(ratios)} smaller than that of the nominal model, with 95 % confidence "
            f"{_times(sure)} at least."
        )
    elif max(ratios) > 1.0:
        verdict = "Hardly"
        said = (
            "What the calibration corrects is little more than what it does not know: more or "
            "better measurements are needed."
        )
    else:
        verdict = "No sign of it"
        said = "The correction is smaller than its own uncertainty."
    return _answer("Is it better?", verdict, said, _residuals(found.result))


def _residuals(result: CalibrationResult) -> str:
    """Return what became of the residuals, where they could have been anything else than zero."""
    if not result.degrees_of_freedom:
        return "Residuals are zero, since there are as many unknowns as measured values."
    series = series_of(result)
    alike = [one for one in series if one.unit == series[0].unit]
    unit, factor = SHOWN[alike[0].unit]
    fell = [
        np.sqrt(np.mean([(residuals**2).mean() for residuals in of]))
        for of in ([one.before for one in alike], [one.after for one in alike])
    ]
    whose = "all legs" if alike[0].of_leg else ", ".join(one.name for one in alike)
    return (
        f"At the measured poses, residuals went from {factor * fell[0]:.3g} to "
        f"{factor * fell[1]:.3g} {unit} (root mean square, {whose})."
    )


def _times(ratios: Sequence[float]) -> str:
    """Return factors in position and, where the platform turns, in orientation."""
    shown = [f"{float(f'{ratio:.2g}'):g} times" for ratio in ratios]
    if len(set(shown)) == 1:
        return shown[0]
    return " and ".join(
        f"{one} ({what})" for one, what in zip(shown, ("position", "orientation"), strict=True)
    )


def _how_much(found: Findings, errors: WorkspaceErrors) -> Element:
    rows, more = tag("tbody"), found.result.excess
    for column, (name, unit) in enumerate((("position", "mm"), ("orientation", "mrad"))):
        if column == 0 or found.turns:
            before, after = errors.mean_before()[column], more * errors.mean_after()[column]
            rows.append(
                tag(
                    "tr",
                    tag("th", f"{name} [{unit}]", scope="row"),
                    tag("td", f"{1e3 * before:.3g}", class_="n"),
                    tag("td", f"{1e3 * after:.3g}", class_="n"),
                )
            )
    names = (tag("th", text, scope="col", class_="n") for text in ("before", "after"))
    head = tag("tr", tag("td"), *names)
    frames = ", but for where the base and platform frames lie" if found.result.moves_frames else ""
    sizes = [errors.mean_before()[0], more * errors.mean_after()[0]]
    verdict = " → ".join(size_in_words(one, 0.0, turns=False) for one in sizes)
    said = (
        f"Error of the platform, root mean square {errors.where}{frames}. After: about what is to "
        "be expected by the parameters' uncertainties, if the model is right; 95 of 100 such "
        "calibrations stay below "
        f"{scaled_in_words(errors.limit, more, found.turns)}."
    )
    if not (found.result.promises and found.result.corrects):
        return _answer(
            _SIZE,
            "No accuracy can be promised",
            f"Residuals are {more:.3g} times as large as the noise given makes them, so that the "
            "parameters' uncertainties mean nothing. Look at the warnings first.",
        )
    if more == 1.0:
        return _answer("By how much?", verdict, _sizes_table(head, rows), said)
    return _answer(
        _SIZE,
        f"{verdict} or more",
        _sizes_table(head, rows),
        said,
        f"Residuals are {more:.2g} times as large as the noise given makes them, and errors after "
        "are scaled by that: so large they are if the noise is larger than given; if the model "
        "lacks something, no number says how large.",
    )


def _sizes_table(head: Element, rows: Element) -> Element:
    return tag("table", tag("thead", head), rows, id="platform-error")


def _trust(result: CalibrationResult, notes: Sequence[str]) -> Element:
    count = len(warnings_of(result))
    verdict = "Nothing speaks against it"
    if count:
        start = "Not as it stands" if doubtful(result) else "With care"
        verdict = f"{start}: {'one warning' if count == 1 else f'{count} warnings'} above"
    elif result.validation is None:
        verdict = "Not tested on rows left out"
    lines = [_chi2(result)]
    if (one := result.validation) is not None:
        lines.append(f"{sentence(held_out_in_words(one))}.")
    if result.runs is not None:
        lines.append(
            f"Parameters of {len(result.runs.runs)} runs spread {result.runs.ratio:.2f} times as "
            "much as their standard errors say."
        )
    if result.outliers:
        count = len(result.outliers)
        lines.append(f"{count} row{'s do' if count > 1 else ' does'} not fit the others.")
    return _answer("May I trust it?", verdict, bullets([*lines, *notes]))


def _chi2(result: CalibrationResult) -> str:
    """Return how the residuals compare with the noise."""
    words = noise_in_words(result)
    if result.noise_source == "estimated":
        return f"{sentence(words)}; so residuals cannot contradict it."
    dof = result.degrees_of_freedom
    if not dof:
        return f"{sentence(words)}."
    text = f"Reduced χ² {result.reduced_chi2:.3g} on {dof} degrees of freedom"
    if result.loss == "none":
        low, high = chi2_law.ppf((0.025, 0.975), dof) / dof
        text += f"; {low:.2f} to {high:.2f} is expected by the noise"
    return text + "."
