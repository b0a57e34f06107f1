"""What a calibration means: the verdict first, then its accuracy, what supports it, what next."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import gammaincinv

from pincal.calibration.promise import seen_by
from pincal.calibration.result import CalibrationResult
from pincal.calibration.validation import MISSES
from pincal.design.platform_error import platform_error
from pincal.estimation.observability.identifiable import WeakPair
from pincal.model.checks import counted
from pincal.model.mechanism import Mechanism
from pincal.model.setup import ORIGIN
from pincal.show.misses import WorkspaceErrors, workspace_errors
from pincal.show.tables import calibration_tables
from pincal.words.numbers import amount, capital, listed, number, percent, rounded, size
from pincal.words.sentences import WORDINGS, finding, sentence
from pincal.words.table import Table
from pincal.words.wording import NAMED, UNCOVERED, missed_line, noise_in_words

_MOST_PAIRS = 3  # weak pairs that are named
_MARKS = {"good": "✓", "care": "⚠", "bad": "✗"}
_STYLES = {"good": "bold green", "care": "bold yellow", "bad": "bold red"}
_UNDETERMINED = "not determined anywhere, since what was held moves it at every pose"
_FOLLOWED = "Something is wrong with rows, noise or model, and the parameters follow it."
_NO_BETTER = "Parameters that fit no better than nominal ones correct nothing."
_HELD = "The machine itself was held"
_ONLY_FRAMES = "No parameter of it was identified, only where the frames lie"
_FRAMES = ", but for where the base and platform frames lie"


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

    Args:
        result: The calibration.
        errors: The platform's over the workspace; None if the fit did not converge.
        notes: Sentences on what was not done, and why.
    """
    if errors is None:
        text = "The search for the parameters ended without an answer: there is no calibrated "
        failed = Answer("Is it better?", "There is no result", "bad", [f"{text}mechanism."])
        return [failed, _next(result)]
    return [
        _better(result, errors),
        _accuracy(result, errors),
        _reliable(result, notes),
        _next(result),
    ]


def verdict(result: CalibrationResult, errors: WorkspaceErrors | None) -> tuple[str, str]:
    """Return the verdict in a line, and its style in a terminal."""
    better, *others, _ = answers(result, errors)
    tones = {better.tone, *(answer.tone for answer in others)}
    tone = next(tone for tone in ("bad", "care", "good") if tone in tones)
    first, *following = [answer.verdict for answer in others or [better]]
    words = [first, *(text[:1].lower() + text[1:] for text in following)]
    if result.converged and result.degrees_of_freedom:
        words.append(f"χ² {rounded(result.reduced_chi2)}")
    return f"{_MARKS[tone]} {result.nominal.name}: {' · '.join(words)}", _STYLES[tone]


def _better(result: CalibrationResult, errors: WorkspaceErrors) -> Answer:
    """Return whether the machine is better: by what the platform's errors fall."""
    question = "Is it better?"
    if not result.explained:
        text = f"Residuals are {_excess(result)}. {_NO_BETTER}"
        if result.corrects:
            text = f"Residuals fell, but are still {_excess(result)}. {_FOLLOWED}"
        return Answer(question, "Not shown" if result.corrects else "No", "bad", [text])
    if not _determined(errors):
        return Answer(question, "Not determined", "bad", [f"{_UNDETERMINED}."])
    if not _moved(errors):
        return Answer(question, _HELD, "good", [f"{_ONLY_FRAMES}."])
    sizes = np.array([errors.mean_before(), errors.mean_after(), errors.inside.limit])
    before, after, limit = sizes[:, sizes[:2].any(axis=0)]  # of what moves and was measured
    ratios = before / after
    if min(ratios) >= 2.0:
        text = f"Expect the platform's error to be smaller by a factor of {_factors(ratios)}"
        text += f", with 95 % confidence {_factors(before / limit)} at least" * result.promises
        sound = result.promises and result.degrees_of_freedom
        return Answer(question, *(("Yes", "good") if sound else ("Probably", "care")), [f"{text}."])
    if max(ratios) > 1.0:
        text = "What the calibration corrects is little more than what it does not know: more or "
        text += "better measurements are needed."
        return Answer(question, "Hardly", "bad", [text])
    text = "The correction is smaller than its own uncertainty."
    return Answer(question, "No sign of it", "bad", [text])


def _moved(errors: WorkspaceErrors) -> bool:
    """Return whether parameters that were identified move the platform at all."""
    return any((*errors.mean_before(), *errors.mean_after()))


def _determined(errors: WorkspaceErrors) -> bool:
    """Return whether the measurements say how far the calibrated platform is off anywhere."""
    return bool(errors.expected.determined.any() and np.isfinite(errors.mean_after()).all())


def _factors(ratios: Sequence[float]) -> str:
    """Return factors in position and, where the platform turns, in orientation."""
    shown = [rounded(ratio) for ratio in ratios]
    if len(set(shown)) == 1:
        return shown[0]
    return f"{shown[0]} (position) and {shown[1]} (orientation)"


def _excess(result: CalibrationResult) -> str:
    return f"{result.excess:.3g} times as large as the noise given makes them"


def _accuracy(result: CalibrationResult, errors: WorkspaceErrors) -> Answer:
    """Return by how much the platform is off: before, as expected, held out."""
    lines = [f"{capital(line)}." for line in limit_lines(result, errors)]
    if not (result.explained and _determined(errors) and _moved(errors)):
        shown = WORDINGS["residuals-too-large"].title
        if result.explained:
            shown = _HELD if _determined(errors) else "Not determined"
        return Answer("By how much?", shown, "", [accuracy_table(result, errors), *lines])
    kind, unit = (0, "m") if result.nominal.platform.lengths else (1, "rad")
    before, after = (sizes()[kind] for sizes in (errors.mean_before, errors.mean_after))
    text = f"{number(before, unit)} → {amount(after, unit)}"
    text += (
        f" (95 %: ≤ {number(errors.inside.limit[kind], unit)})" if result.promises else " or more"
    )
    return Answer("By how much?", text, "", [accuracy_table(result, errors), *lines])


def accuracy_table(result: CalibrationResult, errors: WorkspaceErrors) -> Table:
    """Return the platform's errors: of the nominal and the calibrated machine, and held out.

    Of the model alone where it can be promised; held-out rows miss by what they miss.
    """
    names, rows = list(errors.units.items()), dict[str, dict[tuple[str, str], float]]()
    if result.explained and _determined(errors) and _moved(errors):
        sizes = {"nominal": errors.mean_before(), "calibrated": errors.mean_after()}
        sizes |= {"95 %: below": errors.inside.limit} if result.promises else {}
        kinds = {"m": 0, "rad": 1}
        rows = {
            head: {(name, unit): values[kinds[unit]] for name, unit in names}
            for head, values in sizes.items()
        }
    region = f" {errors.where}{_FRAMES * result.moves_frames}" if rows else ""
    validation = result.validation
    for missed in validation.targets if validation and validation.fit <= MISSES else ():
        name = "position" if missed.unit == "m" else "orientation"
        name += "" if missed.target == ORIGIN else f" of {missed.target}"
        rows.setdefault("held out", {})[name, missed.unit] = missed.rms
    names = list(dict.fromkeys([*names, *rows.get("held out", {})]))
    return Table(
        f"RMS error of the platform{region}",
        ["", *(f"{name} [{unit}]:.3g" for name, unit in names)],
        [[head, *(row.get(name) for name in names)] for head, row in rows.items()],
        "held out: rows not fitted, noise included" * ("held out" in rows),
    )


def _reliable(result: CalibrationResult, notes: Sequence[str]) -> Answer:
    """Return whether the result can be relied on: warnings, χ², held-out rows, outliers."""
    lines = [*noise_lines(result), *check_lines(result)[:1]]
    if result.outliers:
        lines.append(f"{counted(len(result.outliers), 'row does', 'rows do')} not fit the others")
    lines = [f"{capital(line)}." for line in lines] + list(notes)
    shown, tone = "No problems found", "good"
    if result.validation is None:
        shown, tone = "Not tested on rows left out", "care"
    if count := len(warnings(result)):
        warned = "one warning" if count == 1 else f"{count} warnings"
        sound = result.promises
        shown = f"{'With care' if sound else 'Not as it is'}: {warned}"
        tone = "care" if sound else "bad"
    return Answer("Can I rely on it?", shown, tone, [lines])


def _again(command: str, *added: str) -> str:
    """Return a command line of the same measurements, where what was typed is not known."""
    return " ".join(("pincal", command, "MECH", "DATA.csv", *added))


def next_steps(
    result: CalibrationResult, again: Callable[..., str] = _again, folder: str = "RESULT"
) -> list[str]:
    """Return the commands that come next.

    Args:
        result: What was found.
        again: Returns a command line of the same measurements, of its command and further words.
        folder: Where the result is.
    """
    codes = {finding.code for finding in result.findings}
    if not result.converged or not result.corrects:
        return [again("doctor")]
    if codes & {"wrong-rows", "wrong-held-out", "outliers"} and result.loss == "none":
        return [again("calibrate", "--loss", "reject")]
    if not result.promises and "few-poses" in codes:
        return [f"pincal select {folder} -o PLAN.csv"]
    if not result.promises:
        return [again("explain")]
    return [f"pincal view {folder}", f"pincal inverse {folder} POSES.csv -o READINGS.csv"]


def _next(result: CalibrationResult) -> Answer:
    """Return what to do next."""
    steps = next_steps(result)
    purpose = "Use it" if len(steps) > 1 else "Look into it"
    return Answer("What next?", purpose, "", [steps])


# What supports the answers, one line each


def warnings(result: CalibrationResult) -> list[str]:
    """Return what to know first; what several legs share is said once, with their names."""
    legs: dict[str, list[str]] = {}
    for text in result.warnings:
        name, colon, text_of_leg = text.partition(": ")
        of_leg = bool(colon) and name in result.nominal.leg_names
        legs.setdefault(text_of_leg if of_leg else text, []).extend([name] if of_leg else [])
    lines = [f"{', '.join(names)}: {text}" if names else text for text, names in legs.items()]
    return lines if result.converged else [f"The fit {result.message}", *lines]


def unpromised(result: CalibrationResult) -> str:
    """Return why no limit is promised, in titles of findings; empty if one is."""
    titles = dict.fromkeys(WORDINGS[finding.code].title for finding in result.contradictions)
    return ", ".join(title[:1].lower() + title[1:] for title in titles)


def supporting_lines(result: CalibrationResult, errors: WorkspaceErrors | None) -> list[str]:
    """Return all that a calibration means, beside its tables: for terminals, and in Python."""
    lines = [f"{method_line(result)}; {result.message}", *noise_lines(result)]
    if not result.converged:
        return lines
    lines += platform_lines(result, errors) if errors is not None else []
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


def noise_lines(result: CalibrationResult) -> list[str]:
    """Return how residuals compare with the noise, what all rows share, and tolerances found."""
    dof, line = result.degrees_of_freedom, ""
    if result.noise_source in ("estimated", "repeats"):
        line = f"noise {noise_line(result)}; "
    if not dof:
        line = (
            "as many unknowns as measured values: residuals vanish whatever the machine is, and "
            "show nothing; measure more poses"
        )
    elif result.noise_source != "estimated":
        line += f"reduced χ² {rounded(result.reduced_chi2, 3)} on {dof} degrees of freedom"
        if result.loss == "none":
            free = result.chi2_freedoms
            low, high = 2.0 * gammaincinv(free / 2.0, (0.025, 0.975)) / free
            line += f"; {low:.2f} to {high:.2f} is expected by the noise"
    return [line.removesuffix("; "), *systematic_lines(result), *_tolerances(result)]


_NOISE_SOURCES = {
    "given": "as given",
    "repeats": "from rows that were measured repeatedly",
    "estimated": "estimated from the residuals, since none was given",
}


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


def systematic_lines(result: CalibrationResult) -> list[str]:
    """Return what is off by the same in all rows, if anything is said to be."""
    if result.systematic is None or not result.converged:
        return []
    part, total = (
        platform_error(
            result.identified, covariance, result.poses, frames=seen_by(result)
        ).where_determined[0]
        for covariance in (result.systematic, result.covariance)
    )
    scale, share = result.options.setup.systematic, (part / total) ** 2 if total else 0.0
    parts = [f"{1e6 * scale.relative:.3g} µm/m of all lengths"] if scale.relative else []
    parts += [f"{amount(scale.target, 'm')} of each known target"] if scale.target else []
    return [
        f"every ± holds what more rows do not make smaller, {listed(parts)}: {100 * share:.2g} % "
        "of the platform's expected mean square error of position"
    ]


def platform_lines(result: CalibrationResult, errors: WorkspaceErrors) -> list[str]:
    """Return what limits the platform's accuracy: why none is promised, where, what is left out."""
    if not errors.expected.determined.any():
        return [f"platform: {_UNDETERMINED}"]
    if not result.explained:
        before = errors.mean_before()
        differs = size(before[0], before[1] if len(errors.units) > 1 else None)
        failed = "" if result.corrects else ", and hardly fell"
        return [
            f"platform: the calibrated model differs from the nominal one by {differs}, but no "
            f"accuracy can be promised of it: residuals are {_excess(result)}{failed}"
        ]
    lines = []
    if not result.promises:
        lines.append(f"platform: no limit is promised: {unpromised(result)}")
    if result.begun is not result.nominal:
        lines.append("platform: the nominal model is taken with the zeros of motors as found")
    if errors.beyond is not None:
        lines.append(sentence(errors.beyond))
    if result.promises and errors.inside.uncovered:
        lines.append(sentence(finding("promise-leaves-out", what=errors.inside.uncovered)))
    return lines


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
    return [compared, *(missed_line(**vars(missed)) for missed in validation.targets)]


def weak_lines(pairs: Sequence[WeakPair], mechanism: Mechanism) -> list[str]:
    """Return which pairs of parameters are weakly determined; legs alike in one line."""
    units = {p.id: p.unit for p in mechanism.parameters}
    groups: dict[tuple[str, str], list[WeakPair]] = {}
    for pair in pairs:
        leg, _, name = pair.first.rpartition(".")
        other_leg, _, second = pair.second.rpartition(".")
        names = (name, second) if leg == other_leg else (pair.first, pair.second)
        groups.setdefault(names, []).append(pair)
    lines = []
    for shown, alike_pairs in groups.items():
        worst, legs = alike_pairs[0], [pair.first.rpartition(".")[0] for pair in alike_pairs]
        ids, owner = (worst.first, worst.second), ""
        if len(legs) == 1:
            shown = ids
        elif shown != ids:
            owner = f" of {'every leg' if len(legs) == len(mechanism.legs) else ', '.join(legs)}"
        known = []
        for id_, name, exact, std in zip(ids, shown, worst.known, worst.std, strict=True):
            after, before = amount(exact, units[id_]), number(std, units[id_])
            if number(exact, units[id_]) != before:
                known.append(f"{after} instead of {before} for {name}")
        first, second = shown
        lines.append(
            f"{first} and {second}{owner} are weakly determined together, correlation "
            f"{worst.correlation:+.3f}: if the other one were known, the standard error would be "
            f"{' and '.join(known)}"
        )
    if (omitted := len(lines) - _MOST_PAIRS) > 0:
        lines[_MOST_PAIRS:] = [f"and {counted(omitted, 'more such pair')}"]
    return lines


def limit_lines(result: CalibrationResult, errors: WorkspaceErrors) -> list[str]:
    """Return why no limit is promised, or where and against what none is, in a line."""
    if not result.promises:
        return [f"no limit is promised: {unpromised(result)}"] if result.contradictions else []
    parts = [UNCOVERED[code] for code in errors.inside.uncovered]
    if errors.beyond is not None:
        parts.insert(0, f"outside the measured region ({percent(1.0 - errors.share)})")
    return [f"no limit: {', '.join(parts)}"] if parts else []


def remarks(result: CalibrationResult, errors: WorkspaceErrors) -> list[str]:
    """Return what a terminal shows below the platform's errors."""
    return [*rejected_lines(result), *limit_lines(result, errors), *_tolerances(result)]


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


def _tolerances(result: CalibrationResult) -> list[str]:
    return [sentence(finding) for finding in result.findings if finding.code == "tolerance-found"]


def result_text(result: CalibrationResult) -> str:
    """Return a calibration as a page of text: the verdict, accuracy, tables, what to know."""
    errors = workspace_errors(result) if result.converged else None
    parts = [verdict(result, errors)[0]]
    if errors is not None:
        tables = [accuracy_table(result, errors), *calibration_tables(result)]
        parts += map(str, tables)
    parts.append("\n".join(supporting_lines(result, errors)))
    return "\n\n".join([*parts, *(f"warning: {warning}" for warning in warnings(result))])
