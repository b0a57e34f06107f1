"""What a calibration means: the verdict first, then its accuracy, what supports it, what next."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import gammaincinv

from pincal.calibration.result import CalibrationResult
from pincal.calibration.validation import MISSES
from pincal.estimation.observability.identifiable import WeakPair
from pincal.model.checks import counted
from pincal.model.mechanism import Mechanism
from pincal.show.misses import WorkspaceErrors, workspace_errors
from pincal.show.tables import accuracy_table, calibration_tables
from pincal.words.findings import WORDINGS, sentence
from pincal.words.numbers import amount, capital, listed, number, percent, rounded
from pincal.words.table import Table
from pincal.words.wording import NAMED, UNCOVERED, noise_in_words

_MOST_PAIRS = 3  # weak pairs that are named
_MARKS = {"bad": ("✗", "bold red"), "care": ("⚠", "bold yellow"), "good": ("✓", "bold green")}
_UNDETERMINED = "Not determined anywhere, since what was held moves it at every pose"
_FOLLOWED = "Something is wrong with rows, noise or model, and the parameters follow it"
_NO_BETTER = "Parameters that fit no better than nominal ones correct nothing"
_HELD = "The machine itself was held"
_ONLY_FRAMES = "No parameter of it was identified, only where the frames lie"
_LITTLE = (
    "What the calibration corrects is little more than what it does not know: more or better "
    "measurements are needed"
)
_NO_RESULT = (
    "The search for the parameters ended without an answer: there is no calibrated mechanism."
)
_NOISE_SOURCES = {
    "given": "as given",
    "repeats": "from rows that were measured repeatedly",
    "estimated": "estimated from the residuals, since none was given",
}


class Answer(NamedTuple):
    """A question that people ask, its answer in few words, and what supports it."""

    question: str
    verdict: str
    tone: str
    """``"good"``, ``"care"``, ``"bad"``, or empty of what is neither."""
    parts: Sequence[str | list[str] | Table]
    """Paragraphs, lists and tables."""


def answers(
    result: CalibrationResult, errors: WorkspaceErrors | None, notes: Sequence[str] = ()
) -> list[Answer]:
    """Return whether it is better, by how much, whether to rely on it, and what next.

    Errors are the platform's over the workspace, None if the fit did not converge; notes say what
    was not done, and why.
    """
    steps = next_steps(result, errors)
    following = Answer("What next?", "Use it" if steps[1:] else "Look into it", "", [steps])
    if errors is None:
        return [Answer("Is it better?", "There is no result", "bad", [_NO_RESULT]), following]
    better, tone, reason, by = _improvement(result, errors)
    limits = [f"{capital(line)}." for line in _limit_lines(result, errors)]
    return [
        Answer("Is it better?", better, tone, [f"{reason}."]),
        Answer("By how much?", by, "", [accuracy_table(result, errors), *limits]),
        _reliable(result, notes),
        following,
    ]


def verdict(result: CalibrationResult, errors: WorkspaceErrors | None) -> tuple[str, str]:
    """Return the verdict in a line, and its style in a terminal."""
    better, *others, _ = answers(result, errors)
    tones = {better.tone, *(answer.tone for answer in others)}
    mark, style = next(look for tone, look in _MARKS.items() if tone in tones)
    first, *following = [answer.verdict for answer in others or [better]]
    words = [first, *(text[:1].lower() + text[1:] for text in following)]
    if result.converged and result.degrees_of_freedom:
        words.append(f"χ² {rounded(result.reduced_chi2)}")
    return f"{mark} {result.nominal.name}: {' · '.join(words)}", style


def _improvement(result: CalibrationResult, errors: WorkspaceErrors) -> tuple[str, str, str, str]:
    """Return whether the platform's errors fall, its tone and reason, and by how much."""
    if not result.explained:
        by = "No accuracy can be promised"
        excess = f"{result.excess:.3g} times as large as the noise given makes them"
        if not result.corrects:
            return "No", "bad", f"Residuals are {excess}. {_NO_BETTER}", by
        return "Not shown", "bad", f"Residuals fell, but are still {excess}. {_FOLLOWED}", by
    if not errors.determined:
        return "Not determined", "bad", _UNDETERMINED, "Not determined"
    if not errors.moved:
        return _HELD, "good", _ONLY_FRAMES, _HELD
    sizes = np.array([errors.mean_before(), errors.mean_after(), errors.inside.limit])
    kind, unit = (0, "m") if result.nominal.platform.lengths else (1, "rad")
    by = f"{number(sizes[0, kind], unit)} → {amount(sizes[1, kind], unit)}"
    by += f" (95 %: ≤ {number(sizes[2, kind], unit)})" if result.promises else " or more"
    before, after, limit = sizes[:, sizes[:2].any(axis=0)]  # of what moves and was measured
    ratios = before / after
    if min(ratios) >= 2.0:
        reason = f"Expect the platform's error to be smaller by a factor of {_factors(ratios)}"
        reason += f", with 95 % confidence {_factors(before / limit)} at least" * result.promises
        sound = result.promises and result.degrees_of_freedom
        return *(("Yes", "good") if sound else ("Probably", "care")), reason, by
    if max(ratios) > 1.0:
        return "Hardly", "bad", _LITTLE, by
    return "No sign of it", "bad", "The correction is smaller than its own uncertainty", by


def _factors(ratios: Sequence[float]) -> str:
    """Return factors in position and, where the platform turns, in orientation."""
    position, *orientation = dict.fromkeys(map(rounded, ratios))
    return f"{position} (position) and {orientation[0]} (orientation)" if orientation else position


def _reliable(result: CalibrationResult, notes: Sequence[str]) -> Answer:
    """Return whether the result can be relied on: warnings, χ², held-out rows, outliers."""
    lines = [_noise_line(result), *_tolerances(result), *check_lines(result)[:1]]
    lines += _unmeasured_lines(result)
    if result.outliers:
        lines.append(f"{counted(len(result.outliers), 'row does', 'rows do')} not fit the others")
    shown, tone = "No problems found", "good"
    if result.validation is None:
        shown, tone = "Not tested on rows left out", "care"
    if count := len(warnings(result)):
        warned = "one warning" if count == 1 else f"{count} warnings"
        shown, tone = f"With care: {warned}", "care"
        if not result.promises:
            shown, tone = f"Not as it is: {warned}", "bad"
    lines = [f"{capital(line)}." for line in lines]
    return Answer("Can I rely on it?", shown, tone, [[*lines, *notes]])


def _again(command: str, *added: str) -> str:
    """Return a command line of the same measurements, where what was typed is not known."""
    return " ".join(("pincal", command, "MECH", "DATA.csv", *added))


def next_steps(
    result: CalibrationResult,
    errors: WorkspaceErrors | None,
    again: Callable[..., str] = _again,
    folder: str = "RESULT",
) -> list[str]:
    """Return the commands that come next.

    Args:
        result: What was found.
        errors: The platform's over the workspace; None if they are not known.
        again: Returns a command line of the same measurements, of its command and further words.
        folder: Where the result is.
    """
    codes = {finding.code for finding in result.findings}
    if not result.converged or not result.corrects:
        return [again("doctor")]
    if codes & {"wrong-rows", "wrong-held-out", "outliers"} and result.loss == "none":
        return [again("calibrate", "--loss", "reject")]
    if errors is not None and not errors.determined:
        platform, noise = result.nominal.platform, ""
        if result.nominal.redundant and result.noise is not None:  # readings cannot be exact
            noise = f" --noise-reading {result.noise.reading:.2g}"
        measure = "pose" if platform.turns == 3 else ",".join(platform.freedoms)
        return [f"pincal select {folder} --measure {measure}{noise} -o PLAN.csv"]
    if not result.promises:
        return [f"pincal select {folder} -o PLAN.csv" if "few-poses" in codes else again("explain")]
    return [f"pincal view {folder}", f"pincal inverse {folder} POSES.csv -o READINGS.csv"]


# What supports the answers, one line each


def warnings(result: CalibrationResult) -> list[str]:
    """Return what to know first."""
    return [*([] if result.converged else [f"The fit {result.message}"]), *result.warnings]


def unpromised(result: CalibrationResult) -> str:
    """Return why no limit is promised, in titles of findings; empty if one is."""
    return ", ".join(dict.fromkeys(WORDINGS[lack.code].title for lack in result.contradictions))


def _limit_lines(result: CalibrationResult, errors: WorkspaceErrors) -> list[str]:
    """Return why no limit is promised, or where and against what none is, in a line."""
    if not result.promises:
        return [f"no limit is promised: {unpromised(result)}"] if result.contradictions else []
    parts = [UNCOVERED[code] for code in errors.inside.uncovered]
    if errors.beyond is not None:
        parts.insert(0, f"outside the measured region ({percent(1.0 - errors.share)})")
    return [f"no limit: {', '.join(parts)}"] if parts else []


def _tolerances(result: CalibrationResult) -> list[str]:
    return [sentence(finding) for finding in result.findings if finding.code == "tolerance-found"]


def remarks(result: CalibrationResult, errors: WorkspaceErrors) -> list[str]:
    """Return what a terminal shows below the platform's errors."""
    lines = [*rejected_lines(result), *_limit_lines(result, errors), *_tolerances(result)]
    return [*lines, *_unmeasured_lines(result)]


def _unmeasured_lines(result: CalibrationResult) -> list[str]:
    """Return which coordinates of the platform no row measures, and what that means, in a line."""
    data, platform, setup = result.measurements, result.nominal.platform, result.options.setup
    missing = [bool(np.isnan(values).all()) for values in data.poses.T]
    elsewhere = data.extra or setup.distances or setup.contacts or setup.instruments
    if not any(missing) or elsewhere:
        return []
    names = [name for name, lacks in zip(platform.coordinates, missing, strict=True) if lacks]
    if platform.turns == 3 and all(missing[platform.lengths :]):
        names[-3:] = ["the orientation"]
    follow, are = ("follow", "are") if len(names) > 1 else ("follows", "is")
    return [
        f"not measured: {listed(names)}, which {follow} from the readings at each pose and {are} "
        "checked by no measurement"
    ]


def rejected_lines(result: CalibrationResult) -> list[str]:
    """Return which rows a robust loss left out, and what is wrong with the worst, in a line."""
    rejected = [outlier for outlier in result.outliers if outlier.weight == 0.0]
    if not rejected or result.loss == "none":
        return []
    rows = sorted(outlier.row + 1 for outlier in rejected)
    words = f"data row{'s' * (len(rows) > 1)} {listed(rows[:NAMED])}"
    words += f" and {len(rows) - NAMED} more" * (len(rows) > NAMED)
    worst = rejected[0]
    of_worst = f"data row {worst.row + 1}: " * (len(rows) > 1)
    return [f"left out: {words} ({of_worst}{worst.quantity} off by {worst.off:.0f} σ)"]


def supporting_lines(result: CalibrationResult, errors: WorkspaceErrors | None) -> list[str]:
    """Return what a calibration means, beside its tables and remarks."""
    lines = [f"{method_line(result)}; {result.message}", _noise_line(result)]
    if not result.converged:
        return lines
    lines += region_lines(result, errors) if errors is not None else []
    lines += [*check_lines(result), *weak_lines(result.weak, result.nominal)]
    lines += [f"fixed by choice, {gauge_line(result)}"] if result.gauge else []
    return lines


def gauge_line(result: CalibrationResult) -> str:
    """Return what no such measurement can determine, and how it was chosen."""
    freedoms = "; ".join(map(sentence, result.gauge))
    return f"of equal parameters those nearest to nominal: {freedoms}"


def method_line(result: CalibrationResult) -> str:
    """Return how parameters were identified."""
    options = result.options
    if options.latent:
        return "all legs together, the poses estimated with the parameters"
    if options.method == "all-legs":
        return "all legs together, the poses taken as measured"
    has_sets = result.measurements.sets is not None and not options.every_pose
    poses = "the poses of its set" if has_sets else "all poses"
    return f"each leg alone by {poses}, taken as measured"


def _noise_line(result: CalibrationResult) -> str:
    """Return how residuals compare with the noise."""
    dof, parts = result.degrees_of_freedom, list[str]()
    if not dof:
        parts = [
            "as many unknowns as measured values: residuals vanish whatever the machine is, and "
            "show nothing; measure more poses"
        ]
    elif result.noise_source != "estimated":
        parts = [f"reduced χ² {rounded(result.reduced_chi2, 3)} on {dof} degrees of freedom"]
        if result.loss == "none":
            free = result.chi2_freedoms
            low, high = 2.0 * gammaincinv(free / 2.0, (0.025, 0.975)) / free
            parts.append(f"{low:.2f} to {high:.2f} is expected by the noise")
    if dof and result.noise_source in ("estimated", "repeats"):
        parts.insert(0, f"noise {noise_line(result)}")
    return "; ".join(parts)


def noise_line(result: CalibrationResult) -> str:
    """Return where the noise comes from, and standard deviations of what was measured."""
    noise, observed = result.noise, result.calibration.observation
    if noise is None:
        return "of each row, as the measurements say"
    columns = zip(observed.units, observed.measured.T, strict=True)
    measured = {unit for unit, values in columns if values.any()}
    sizes = noise_in_words(
        noise.position if "m" in measured else None,
        noise.orientation if "rad" in measured else None,
        noise.reading,
        sorted(set(result.nominal.reading_units)),
    )
    return f"{_NOISE_SOURCES[result.noise_source]}: σ {sizes}"


def region_lines(result: CalibrationResult, errors: WorkspaceErrors) -> list[str]:
    """Return what is to be expected outside the measured region, and what is compared."""
    if not result.explained:
        return []
    begun = "the nominal model is taken with the zeros of motors as found"
    lines = [begun] if result.begun is not result.nominal else []
    return [*lines, *([sentence(errors.beyond)] if errors.beyond is not None else [])]


def check_lines(result: CalibrationResult) -> list[str]:
    """Return how held-out rows compare, and how far held-out targets are missed."""
    if (validation := result.validation) is None:
        return []
    folds, count = validation.folds, validation.rows
    rows = f"{folds} folds" if folds > 1 else f"{count} rows of the set verify"
    if validation.fit > MISSES:
        return [
            "held-out rows show nothing: the fit misses even its own rows by "
            f"{validation.fit:.3g} σ. Look at the warnings first ({rows})"
        ]
    compared = (
        f"held-out rows miss by {validation.held_out:.2f} σ, those of the fit by "
        f"{validation.fit:.2f} σ; {validation.expected:.2f} σ are expected held out ({rows})"
    )
    lines = [compared]
    for missed in validation.targets:
        unit, (low, high) = missed.unit, missed.rms_ends
        what = "position" if unit == "m" else "orientation"
        ends = f" (95 %: {number(low, unit)} to {number(high, unit)})" if np.isfinite(high) else ""
        lines.append(
            f"{what} of {missed.target!r} is missed by {amount(missed.rms, unit)}{ends} held out, "
            f"root mean square of {counted(missed.poses, 'pose')}, by {number(missed.mean, unit)} "
            f"on average and {number(missed.largest, unit)} at most; by {number(missed.fit, unit)} "
            "in the fit"
        )
    return lines


def weak_lines(pairs: Sequence[WeakPair], mechanism: Mechanism) -> list[str]:
    """Return which pairs of parameters are weakly determined; legs alike in one line."""
    groups: dict[tuple[str, ...], list[WeakPair]] = {}
    for pair in pairs:
        parameters = [mechanism.parameters[id_] for id_ in (pair.first, pair.second)]
        same_leg = parameters[0].owner == parameters[1].owner
        groups.setdefault(tuple(p.name if same_leg else p.id for p in parameters), []).append(pair)
    lines = []
    for names, (worst, *others) in list(groups.items())[:_MOST_PAIRS]:
        parameters, owner = [mechanism.parameters[id_] for id_ in (worst.first, worst.second)], ""
        if others:
            legs = [pair.first.rpartition(".")[0] for pair in (worst, *others)]
            owner = f" of {'every leg' if len(legs) == len(mechanism.legs) else ', '.join(legs)}"
        shown = names if others else [p.id for p in parameters]
        known = [
            f"{amount(exact, p.unit)} instead of {number(std, p.unit)} for {name}"
            for p, name, exact, std in zip(parameters, shown, worst.known, worst.std, strict=True)
            if number(exact, p.unit) != number(std, p.unit)
        ]
        lines.append(
            f"{shown[0]} and {shown[1]}{owner} are weakly determined together, correlation "
            f"{worst.correlation:+.3f}: if the other one were known, the standard error would be "
            f"{' and '.join(known)}"
        )
    omitted = len(groups) - len(lines)
    return [*lines, f"and {counted(omitted, 'more such pair')}"] if omitted else lines


def result_text(result: CalibrationResult) -> str:
    """Return a calibration as a page of text: the verdict, accuracy, tables, what to know."""
    errors = workspace_errors(result) if result.converged else None
    parts, lines = [verdict(result, errors)[0]], supporting_lines(result, errors)
    if errors is not None:
        parts += map(str, (accuracy_table(result, errors), *calibration_tables(result)))
        lines = [*remarks(result, errors), *lines]
    parts.append("\n".join(lines))
    return "\n\n".join([*parts, *(f"warning: {warning}" for warning in warnings(result))])
