"""Answers of a calibration: is it better, by how much, is it reliable, and what comes next."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from markupsafe import Markup
from scipy.special import gammaincinv

from pincal.calibration.findings import noise_values
from pincal.calibration.result import CalibrationResult
from pincal.calibration.validation import MISSES
from pincal.errors import MechanismError
from pincal.estimation.fit import Outlier
from pincal.estimation.system import UNLIKELY
from pincal.formats.delta_printer import delta_printer
from pincal.show.misses import WorkspaceErrors
from pincal.show.tables import accuracy_table, held_out_errors
from pincal.words.findings import WORDINGS, sentence
from pincal.words.numbers import amount, capital, chance, number, rounded
from pincal.words.table import Table
from pincal.words.wording import NOISE_SOURCES, UNCOVERED, clean, named, noise_in_words

_NEXT = {
    "doctor": "Find out what is wrong",
    "calibrate": "Measure wrong rows again, or leave them out",
    "select": "Measure more poses",
    "explain": "Find out what the model lacks",
}
_WRONG_ROWS = {"wrong-rows", "wrong-verification", "outliers"}
_MARKS = {"bad": ("✗", "bold red"), "care": ("⚠", "bold yellow"), "good": ("✓", "bold green")}
_HELD, _UNKNOWN = "Only frames were identified", "Not determined"


class Answer(NamedTuple):
    """A question that users ask, the short answer, and its support."""

    question: str
    verdict: str
    tone: str
    """``"good"``, ``"care"`` or ``"bad"``; empty for a neutral answer."""
    parts: Sequence[str | list[str] | Table]


def answers(
    result: CalibrationResult,
    errors: WorkspaceErrors | None,
    steps: Sequence[str],
    notes: Sequence[str] = (),
) -> list[Answer]:
    """Return the answers: is it better, by how much, can I rely on it, what next.

    ``errors`` is None if the fit did not converge; ``notes`` say what was not done, and why.
    """
    verdict = _NEXT.get(steps[0].split()[1], "Use it")
    following = Answer("What next?", verdict, "", [*map(command_block, steps)])
    if errors is None:
        reason = "The fit did not converge: there is no calibrated mechanism."
        return [Answer("Is it better?", "There is no result", "bad", [reason]), following]
    better, tone, reason = _improvement(result, errors)
    lines = _limit_lines(result, errors)
    if result.moves_frames and errors.determined:
        lines += ["best-fit frames: unknown frames are placed where the errors are smallest"]
    lines, table = [f"{capital(line)}." for line in lines], accuracy_table(result, errors)
    return [
        Answer("Is it better?", better, tone, [f"{reason}."]),
        Answer("By how much?", _by(result, errors), "", [*table, *lines]),
        _reliable(result, notes),
        following,
    ]


def verdict(result: CalibrationResult, errors: WorkspaceErrors | None) -> tuple[str, str]:
    """Return the verdict as one line, and its style in a terminal."""
    better, *further, _ = answers(result, errors, next_steps(result, errors))
    tones = {better.tone, *(answer.tone for answer in further)}
    mark, style = next(look for tone, look in _MARKS.items() if tone in tones)
    first, *following = [answer.verdict for answer in further or [better]]
    words = [first, *(text[:1].lower() + text[1:] for text in following)]
    words += [f"χ² {rounded(result.reduced_chi2)}"] if errors and result.degrees_of_freedom else []
    return f"{mark} {result.nominal.name}: {' · '.join(words)}", style


def _improvement(result: CalibrationResult, errors: WorkspaceErrors) -> tuple[str, str, str]:
    if not result.explained:
        excess = f"{result.excess:.3g} times as large as the noise given"
        if not result.corrects:
            no_better = "The identified parameters fit no better than the nominal parameters"
            return "No", "bad", f"Residuals are {excess}. {no_better}"
        follows = "Wrong rows, noise or model distort the parameters"
        return "Not shown", "bad", f"Residuals fell, but are still {excess}. {follows}"
    if not errors.determined:
        if not errors.share:
            return _UNKNOWN, "bad", "No pose lies in the measured region"
        return _UNKNOWN, "bad", "Parameters that had to be held move the platform at every pose"
    if not errors.moved:
        return _HELD, "good", "All parameters of the machine were fixed"
    sizes = np.array([errors.mean_before(), errors.mean_after(), errors.inside.limit])
    before, after, limit = sizes[:, sizes[:2].any(axis=0)]  # position or orientation that moves
    ratios = before / after
    if max(ratios) > 1.0 and not (result.promises and result.degrees_of_freedom):
        return "Probably", "care", "The error falls, but no limit can be stated"
    if min(ratios) >= 2.0:
        likely, least = (rounded(ratio[0]) for ratio in (ratios, before / limit))
        reason = f"The error falls by a factor of {likely} (at least {least}, with 95 % confidence)"
        return "Yes", "good", reason
    if max(ratios) > 1.0:
        return "Hardly", "bad", "The correction is hardly larger than its uncertainty"
    return "No sign of it", "bad", "The correction is smaller than its own uncertainty"


def _by(result: CalibrationResult, errors: WorkspaceErrors) -> str:
    """Return the error before and after; only at held-out poses where no limit is stated."""
    held = f"{result.validation.kind} poses" if result.validation else ""
    missed = [f"{amount(size, unit)} at {held}" for unit, size in held_out_errors(result).items()]
    if not result.explained:
        return missed[0] if missed else "No accuracy can be stated"
    if not errors.determined or not errors.moved:
        return _HELD if errors.determined else _UNKNOWN
    kind, unit = (0, "m") if result.nominal.platform.lengths else (1, "rad")
    before, after = number(errors.mean_before()[kind], unit), errors.mean_after()[kind]
    below = f"{amount(after, unit)} (95 %: ≤ {number(errors.inside.limit[kind], unit)})"
    unsure = missed[0] if missed else f"{amount(after, unit)} or more"
    return f"{before} → {below if result.promises else unsure}"


def _reliable(result: CalibrationResult, notes: Sequence[str]) -> Answer:
    lines = [_noise_line(result), *check_lines(result)]
    lines += _found_lines(result, "points-left-out", "readings-exact")
    if result.outliers:
        lines.append(f"do not fit the others: {_rows(result.outliers)}")
    shown, tone = "No problems", "good"
    if result.validation is None:
        shown, tone = "No poses were held out", "care"
    if warnings(result):
        shown, tone = ("With care", "care") if result.promises else ("Not yet reliable", "bad")
    lines = [f"{capital(line)}." for line in lines]
    return Answer("Can I rely on it?", shown, tone, [[*lines, *notes]])


def again(command: str, *added: str) -> str:
    """Return a command line for the same measurements, with placeholders for their files."""
    return " ".join(("pincal", command, "MECH", "DATA.csv", *added))


def next_steps(
    result: CalibrationResult,
    errors: WorkspaceErrors | None,
    again: Callable[..., str] = again,
    folder: str = "RESULT",
) -> list[str]:
    """Return the commands to run next; ``again`` makes a command for the same measurements."""
    codes = {finding.code for finding in result.findings}
    if not result.converged or not result.corrects:
        return [again("doctor")]
    if "model-lacks" not in codes and codes & _WRONG_ROWS and result.loss == "none":
        return [again("calibrate", "--loss", "reject")]
    if errors is not None and not errors.determined:
        platform, noise = result.nominal.platform, ""
        if result.nominal.redundant and result.noise is not None:  # readings cannot be exact
            noise = f" --noise-reading {result.noise.reading:.2g}"
        measure = "pose" if platform.turns == 3 else ",".join(platform.freedoms)
        return [f"pincal select {folder} --measure {measure}{noise} -o PLAN.csv"]
    if "few-poses" in codes:
        return [f"pincal select {folder} -o PLAN.csv"]
    return _uses(result, folder) if result.promises else [again("explain")]


def _uses(result: CalibrationResult, folder: str) -> list[str]:
    deploy, view = f"pincal deploy {folder} -o controller", f"pincal view {folder}"
    with suppress(MechanismError):
        delta_printer(result.identified)
        return [f"pincal export {folder} -o printer.cfg", view]
    if result.nominal.by_readings and len(result.legs) == 1:
        return [f"pincal export {folder} --original ROBOT.urdf -o CALIBRATED.urdf", deploy, view]
    return [deploy, f"pincal inverse {folder} POSES.csv -o READINGS.csv", view]


def next_line(steps: Sequence[str]) -> str:
    """Return the first of the next steps as a line for the terminal."""
    other = "measure again, or " * (steps[0].split()[1] == "calibrate")
    return f"next: {other}{steps[0]}"


def command_block(step: str) -> Markup:
    """Return a command as HTML, in a block of its own."""
    return Markup("<pre><code>{}</code></pre>").format(clean(step))


# What supports the answers, one line each


def warnings(result: CalibrationResult) -> list[str]:
    """Return the warnings, first that the fit did not converge."""
    return [*([] if result.converged else [f"The fit {result.message}"]), *result.warnings]


def unpromised(result: CalibrationResult) -> str:
    """Return the titles of the findings that forbid a limit of the error; empty if none does."""
    return ", ".join(dict.fromkeys(WORDINGS[lack.code].title for lack in result.contradictions))


def _limit_lines(result: CalibrationResult, errors: WorkspaceErrors) -> list[str]:
    """Return a line that says why no limit is stated, or which effects the limit leaves out."""
    if not result.promises:
        return [f"no limit is stated: {unpromised(result)}"] if result.contradictions else []
    parts = [UNCOVERED[code] for code in errors.inside.uncovered]
    exact = [remark.values for remark in result.findings if remark.code == "readings-exact"]
    parts += [f"noise of readings above {amount(v['reading'], v['unit'])}" for v in exact]
    return [f"excluding {', '.join(parts)}"] if parts else []


def summary(
    result: CalibrationResult, errors: WorkspaceErrors | None, notes: Sequence[str] = ()
) -> list[str | Table]:
    """Return the lines and tables below the verdict, in a terminal and in Python."""
    if errors is None:
        return [*notes]
    lines = [*rejected_lines(result), *_limit_lines(result, errors)]
    lines += _found_lines(result, "points-left-out")
    return [*accuracy_table(result, errors), *lines, *notes]


def _found_lines(result: CalibrationResult, *remarks: str) -> list[str]:
    """Return lines on findings with some codes, and on coordinates that were never measured."""
    lines = [sentence(finding) for finding in result.findings if finding.code in remarks]
    data, platform, setup = result.measurements, result.nominal.platform, result.options.setup
    missing = [bool(np.isnan(values).all()) for values in data.poses.T]
    elsewhere = data.extra or setup.distances or setup.contacts or setup.instruments
    if not any(missing) or elsewhere:
        return lines
    names = [name for name, lacks in zip(platform.coordinates, missing, strict=True) if lacks]
    if platform.turns == 3 and all(missing[platform.lengths :]):
        names[-3:] = ["the orientation"]
    return [*lines, f"{', '.join(names)}: forecast, not measured"]


def rejected_lines(result: CalibrationResult) -> list[str]:
    """Return a line that names the rows that a fit left out, and how far the worst is off."""
    rejected = [outlier for outlier in result.outliers if outlier.weight == 0.0]
    if not rejected or result.loss == "none":
        return []
    worst = rejected[0]
    of_worst = f"data row {worst.row + 1}: " * (len(rejected) > 1)
    return [f"left out: {_rows(rejected)} ({of_worst}{worst.quantity} off by {worst.off:.0f} σ)"]


def _rows(outliers: Sequence[Outlier]) -> str:
    rows = sorted(outlier.row + 1 for outlier in outliers)
    return f"data row{'s' * (len(rows) > 1)} {named(rows)}"


def supporting_lines(result: CalibrationResult) -> list[str]:
    """Return lines on the fit, its noise, held-out rows and choices of gauge."""
    lines = [result.message, _noise_line(result)]
    if not result.converged:
        return lines
    if result.begun is not result.nominal:
        lines.append("nominal errors are stated with the zeros of motors as identified")
    lines += check_lines(result)
    lines += [f"fixed by choice, {gauge_line(result)}"] if result.gauge else []
    return lines


def gauge_line(result: CalibrationResult) -> str:
    """Name the freedoms that measurements of this kind cannot determine, and their choice."""
    freedoms = "; ".join(map(sentence, result.gauge))
    return f"the nearest to nominal of all equivalent parameters: {freedoms}"


def _noise_line(result: CalibrationResult) -> str:
    dof, free, source = result.degrees_of_freedom, result.chi2_freedoms, result.noise_source
    if not dof:
        return "there are as many unknowns as measured values, so residuals vanish: measure more"
    parts = [f"noise {noise_line(result)}"] if source in ("estimated", "repeats") else []
    if source != "estimated":
        parts.append(f"reduced χ² {rounded(result.reduced_chi2, 3)}, {dof} degrees of freedom")
        if result.loss == "none":
            low, high = 2.0 * gammaincinv(free / 2.0, (0.025, 0.975)) / free
            parts.append(f"{low:.2f} to {high:.2f} is expected")
    return "; ".join(parts)


def noise_line(result: CalibrationResult) -> str:
    """Return the source of the noise, and the standard deviations of the measurements."""
    if result.noise is None:
        return "by row, from the columns of the measurements"
    sizes = noise_in_words(**noise_values(result, result.noise))
    return f"{NOISE_SOURCES[result.noise_source]}: σ {sizes}"


def check_lines(result: CalibrationResult) -> list[str]:
    """Return a line that compares the error of held-out rows with its expectation."""
    if (validation := result.validation) is None:
        return []
    folds, count, kind = validation.folds, validation.rows, validation.kind
    rows = f"{folds} folds" if folds > 1 else f"{count} rows"
    if validation.fit > MISSES:
        return [
            f"{kind} rows prove nothing, since the fit misses even its own rows by "
            f"{validation.fit:.3g} σ ({rows}). See the warnings first"
        ]
    return [
        f"{kind} error {validation.held_out:.2f} σ, {validation.expected:.2f} σ is expected "
        f"({chance(validation.p_value)}, a warning below {UNLIKELY:g}); in the fit "
        f"{validation.fit:.2f} σ ({rows})"
    ]
