"""The first screen of a report: is it better, by how much, can it be relied on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2 as chi2_law

from pincal.calibration.result import CalibrationResult
from pincal.show.report.findings import Findings
from pincal.show.report.parts import Answers, Card, Part, Sizes
from pincal.show.results import noisy_series, unpromised, warnings
from pincal.show.summary import held_out_line, noise_line, platform_size
from pincal.show.workspace_errors import WorkspaceErrors
from pincal.words.numbers import SMALL, amount, capital, counted, rounded, shown_in
from pincal.words.sentences import WORDINGS

_CLEARLY = 2.0  # by how much an error must fall to be called better without reserve
_SIZE = "By how much?"
#: Looks of verdicts; those not listed ask for care.
_TONES = {
    "Yes": "good",
    "Nothing speaks against it": "good",
    "Hardly": "bad",
    "No sign of it": "bad",
    "There is no result": "bad",
    "No": "bad",
    "Not shown": "bad",
    "Not as it is": "bad",
}


def warning_lines(result: CalibrationResult) -> list[str]:
    """Return what the reader should know first."""
    if result.converged:
        return warnings(result)
    return [f"The fit {result.message}", *warnings(result)]


def answers(found: Findings, notes: Sequence[str]) -> Answers:
    """Return the three answers.

    Args:
        found: The calibration.
        notes: What was not done, and why.
    """
    if found.errors is None:
        lost = WORDINGS["not-converged"]
        said = (
            "The search for the parameters ended without an answer, so there is no calibrated "
            "mechanism, and none is shown or written."
        )
        return Answers((_card("Is it better?", "There is no result", said, f"{lost.remedy}."),))
    return Answers(
        (
            _better(found, found.errors),
            _how_much(found, found.errors),
            _reliable(found.result, notes),
        )
    )


def _card(question: str, verdict: str, *parts: Part) -> Card:
    tone = "" if question == _SIZE else _TONES.get(verdict.partition(":")[0], "care")
    return Card(question, verdict, parts, tone)


def _better(found: Findings, errors: WorkspaceErrors) -> Card:
    (before, turned), (after, turning) = errors.mean_before(), errors.mean_after()
    result, more = found.result, found.result.excess
    ratios = [before / after] + ([turned / turning] if found.turns else [])
    both = zip((before, turned)[: len(ratios)], errors.limit, strict=False)
    sure = [one / limit for one, limit in both]
    if not result.corrects:
        verdict = "No"
        said = (
            f"The fit failed: residuals hardly fell, and are {more:.3g} times as large as the "
            f"noise given makes them. {WORDINGS['not-corrected'].means}"
        )
    elif not result.explained:
        verdict = "Not shown"
        said = (
            f"Residuals fell, but are still {more:.3g} times as large as the noise given makes "
            "them: something is wrong with rows, noise or model, and parameters follow it."
        )
    elif min(ratios) >= _CLEARLY:
        checked = bool(result.degrees_of_freedom) and result.promises
        verdict = "Yes" if checked else "Probably"
        said = (
            f"The platform's root mean square error {errors.where} should be "
            f"{'about' if result.promises else 'at most'} {_times(ratios)} smaller than that of "
            "the nominal model"
        )
        said += f", with 95 % confidence {_times(sure)} at least." if result.promises else "."
    elif max(ratios) > 1.0:
        verdict = "Hardly"
        said = (
            "What the calibration corrects is little more than what it does not know: more or "
            "better measurements are needed."
        )
    else:
        verdict = "No sign of it"
        said = "The correction is smaller than its own uncertainty."
    return _card("Is it better?", verdict, said, _residuals(result))


def _residuals(result: CalibrationResult) -> str:
    """Return what became of the residuals, where they could have been anything else than zero."""
    if not result.degrees_of_freedom:
        return "Residuals are zero, since there are as many unknowns as measured values."
    series = noisy_series(result)
    legs = [one.name for one in series if one.of_leg]
    others = [one.name for one in series if not one.of_leg]
    whose = ", ".join([*(["all legs"] if legs else []), *others])
    if len(units := {one.unit for one in series}) > 1:
        before, after = (np.sqrt(np.mean(one**2)) for one in result.whitened)
        unit = "standard deviations"
    else:
        (si,) = units
        sizes = np.sqrt(np.mean([np.square(one.rms) for one in series], axis=0))
        before, after, unit = shown_in(sizes[0], si), shown_in(sizes[1], si), SMALL[si]
    where = "estimated" if others else "measured"
    return (
        f"At the {where} poses, residuals went from {before:.3g} to {after:.3g} {unit} (root mean "
        f"square, {whose})."
    )


def _times(ratios: Sequence[float]) -> str:
    """Return factors in position and, where the platform turns, in orientation."""
    shown = [f"{rounded(ratio)} times" for ratio in ratios]
    if len(set(shown)) == 1:
        return shown[0]
    return " and ".join(
        f"{one} ({what})" for one, what in zip(shown, ("position", "orientation"), strict=True)
    )


def _how_much(found: Findings, errors: WorkspaceErrors) -> Card:
    result = found.result
    if not result.explained:
        return _card(
            _SIZE,
            WORDINGS["residuals-too-large"].title,
            f"Residuals are {result.excess:.3g} times as large as the noise given makes them, so "
            "that the parameters' uncertainties mean nothing. Look at the warnings first.",
        )
    before, after = errors.mean_before(), errors.mean_after()
    names = ("position [mm]", "orientation [mrad]")[: 1 + found.turns]
    rows = [
        (name, f"{1e3 * old:.3g}", f"{1e3 * new:.3g}")
        for name, old, new in zip(names, before, after, strict=False)
    ]
    frames = ", but for where the base and platform frames lie" if result.moves_frames else ""
    verdict = f"{amount(before[0], 'm')} → {amount(after[0], 'm')}"
    said = f"Error of the platform, root mean square {errors.where}{frames}. After: "
    if result.promises:
        said += (
            "about what is to be expected by the parameters' uncertainties, if the model is right; "
            "95 of 100 such calibrations stay below "
            f"{platform_size(errors.limit, found.turns)}."
        )
        return _card(_SIZE, verdict, Sizes(rows), said)
    return _card(
        _SIZE,
        f"{verdict} or more",
        Sizes(rows),
        f"{said}what was seen at the measured poses, or more. No limit is promised: "
        f"{unpromised(result)}.",
        f"Residuals are {result.excess:.2g} times as large as the noise given makes them."
        if result.excess > 1.0
        else None,
    )


def _reliable(result: CalibrationResult, notes: Sequence[str]) -> Card:
    count = len(warnings(result))
    verdict = "Nothing speaks against it"
    if count:
        start = "With care" if result.promises else "Not as it is"
        verdict = f"{start}: {'one warning' if count == 1 else f'{count} warnings'} above"
    elif result.validation is None:
        verdict = "Not tested on rows left out"
    lines = [_chi2(result)]
    if (one := result.validation) is not None:
        lines.append(f"{capital(held_out_line(one))}.")
    if result.runs is not None:
        lines.append(
            f"Parameters of {len(result.runs.runs)} runs spread {result.runs.ratio:.2f} times as "
            "much as their standard errors say."
        )
    if result.outliers:
        rows = counted(len(result.outliers), "row does", "rows do")
        lines.append(f"{rows} not fit the others.")
    return _card("Can I rely on it?", verdict, [*lines, *notes])


def _chi2(result: CalibrationResult) -> str:
    """Return how the residuals compare with the noise."""
    if result.noise_source == "estimated":
        return f"{capital(noise_line(result))}; so residuals cannot contradict it."
    dof = result.degrees_of_freedom
    if not dof:
        return f"{capital(noise_line(result))}."
    text = f"Reduced χ² {result.reduced_chi2:.3g} on {dof} degrees of freedom"
    if result.loss == "none":
        low, high = chi2_law.ppf((0.025, 0.975), result.chi2_freedoms) / result.chi2_freedoms
        text += f"; {low:.2f} to {high:.2f} is expected by the noise"
    return text + "."
