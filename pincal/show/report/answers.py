"""The first screen of a report: is it better, by how much, can it be relied on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2 as chi2_law

from pincal.calibration.result import CalibrationResult
from pincal.show.report.findings import Findings
from pincal.show.results import contradicted, noisy_series, promised, warnings
from pincal.show.summary import FRAMES, held_out_line, noise_line, platform_size
from pincal.show.workspace_errors import WorkspaceErrors
from pincal.words.numbers import SMALL, amount, capital, counted, rounded, shown_in
from pincal.words.pages import rendered
from pincal.words.sentences import WORDINGS

_BETTER = "Is it better?"
_AS_LARGE = "times as large as the noise given makes them"


@dataclass(frozen=True)
class Card:
    """An answer on the first screen."""

    question: str
    verdict: str
    tone: str
    """``"good"``, ``"care"``, ``"bad"``, or empty for neither."""
    texts: Sequence[str] = ()
    lines: Sequence[str] = ()
    sizes: Sequence[tuple[str, float, float]] = ()
    """Errors of the platform before and after, [m] or [rad], by what is shown in 1e-3 of that."""


@dataclass(frozen=True)
class Answers:
    """The first screen."""

    cards: tuple[Card, ...]

    def __html__(self) -> str:
        """Return the section for a page."""
        return rendered("answers.html", answers=self)


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
        said = (
            "The search for the parameters ended without an answer, so there is no calibrated "
            "mechanism, and none is shown or written.",
            f"{WORDINGS['not-converged'].remedy}.",
        )
        return Answers((Card(_BETTER, "There is no result", "bad", said),))
    last = _reliable(found.result, notes)
    return Answers((_better(found, found.errors), _how_much(found, found.errors), last))


def _better(found: Findings, errors: WorkspaceErrors) -> Card:
    result, more = found.result, found.result.excess
    both = errors.mean_before(), errors.mean_after(), errors.limit
    before, after, limit = np.array(both)[:, : 1 + found.turns]
    ratios, sure = before / after / more, before / limit / more
    if not result.corrects:
        verdict, tone = "No", "bad"
        said = (
            f"The fit failed: residuals hardly fell, and are {more:.3g} {_AS_LARGE}. "
            f"{WORDINGS['not-corrected'].means}"
        )
    elif not result.promises:
        verdict, tone = "Not shown", "bad"
        said = (
            f"Residuals fell, but are still {more:.3g} {_AS_LARGE}: something is wrong with rows, "
            "noise or model, and parameters follow it."
        )
    elif ratios.min() >= 2.0:
        checked = bool(result.degrees_of_freedom) and not contradicted(result)
        verdict, tone = ("Yes", "good") if checked else ("Probably", "care")
        said = (
            f"The platform's root mean square error {errors.where} should be about "
            f"{_times(ratios)} smaller than that of the nominal model, with 95 % confidence "
            f"{_times(sure)} at least."
        )
    elif ratios.max() > 1.0:
        verdict, tone = "Hardly", "bad"
        said = (
            "What the calibration corrects is little more than what it does not know: more or "
            "better measurements are needed."
        )
    else:
        verdict, tone = "No sign of it", "bad"
        said = "The correction is smaller than its own uncertainty."
    return Card(_BETTER, verdict, tone, (said, _residuals(result)))


def _residuals(result: CalibrationResult) -> str:
    """Return what became of the residuals, where they could have been anything else than zero."""
    if not result.degrees_of_freedom:
        return "Residuals are zero, since there are as many unknowns as measured values."
    series = noisy_series(result)
    others = [one.name for one in series if not one.of_leg]
    whose = ", ".join([*(["all legs"] if len(others) < len(series) else []), *others])
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
    return f"{shown[0]} (position) and {shown[1]} (orientation)"


def _how_much(found: Findings, errors: WorkspaceErrors) -> Card:
    question, result = "By how much?", found.result
    if (more := promised(result)) is None:
        said = (
            f"Residuals are {result.excess:.3g} {_AS_LARGE}, so that the parameters' uncertainties "
            "mean nothing. Look at the warnings first."
        )
        return Card(question, WORDINGS["residuals-too-large"].title, "", (said,))
    before, after = errors.mean_before(), tuple(more * one for one in errors.mean_after())
    names = ("position [mm]", "orientation [mrad]")[: 1 + found.turns]
    verdict = f"{amount(before[0], 'm')} → {amount(after[0], 'm')}"
    texts = [
        f"Error of the platform, root mean square {errors.where}"
        f"{FRAMES if result.moves_frames else ''}. After: about what is to be expected by the "
        "parameters' uncertainties, if the model is right; 95 of 100 such calibrations stay below "
        f"{platform_size(errors.limit, found.turns, more)}."
    ]
    if more > 1.0:
        verdict += " or more"
        texts.append(
            f"Residuals are {more:.2g} {_AS_LARGE}, and errors after are scaled by that: so large "
            "they are if the noise is larger than given; if the model lacks something, no number "
            "says how large."
        )
    sizes = tuple(zip(names, before, after, strict=False))
    return Card(question, verdict, "", texts, sizes=sizes)


def _reliable(result: CalibrationResult, notes: Sequence[str]) -> Card:
    verdict, tone = "Nothing speaks against it", "good"
    if count := len(warnings(result)):
        poor = contradicted(result)
        warned = "one warning" if count == 1 else f"{count} warnings"
        verdict = f"{'Not as it is' if poor else 'With care'}: {warned} above"
        tone = "bad" if poor else "care"
    elif result.validation is None:
        verdict, tone = "Not tested on rows left out", "care"
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
    return Card("Can I rely on it?", verdict, tone, lines=[*lines, *notes])


def _chi2(result: CalibrationResult) -> str:
    """Return how the residuals compare with the noise."""
    if result.noise_source == "estimated":
        return f"{capital(noise_line(result))}; so residuals cannot contradict it."
    if not (dof := result.degrees_of_freedom):
        return f"{capital(noise_line(result))}."
    text = f"Reduced χ² {result.reduced_chi2:.3g} on {dof} degrees of freedom"
    if result.loss == "none":
        low, high = chi2_law.ppf((0.025, 0.975), dof) / dof
        text += f"; {low:.2f} to {high:.2f} is expected by the noise"
    return text + "."
