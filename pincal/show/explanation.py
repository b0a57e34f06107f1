"""Output of ``explain``, ``doctor`` and ``identifiability``, in sentences."""

from collections.abc import Sequence

import numpy as np

from pincal.calibration.calibrate import Remedy
from pincal.calibration.terms.choice import LEVEL, Explanation
from pincal.calibration.terms.kinds import GROWTH, PULLEY, READINGS, parts_of, term_text
from pincal.calibration.terms.screen import Candidate
from pincal.design.forecast import Forecast
from pincal.design.platform_error import PlatformError
from pincal.estimation.observability.courses import Score
from pincal.estimation.system import FALSE_ALARM
from pincal.model import ORIGIN, Mechanism
from pincal.model.checks import counted
from pincal.show.answers import rejected_lines, unpromised
from pincal.show.tables import models_table, screen_table
from pincal.words.findings import HYPOTHESES
from pincal.words.numbers import POSES, SMALL, amount, chance, listed, measured
from pincal.words.table import Table
from pincal.words.wording import CAUSES, NAMED, SLIPPED, filled, groups_in_words, slipped

_KEEP = (
    "identified parameters predict held-out rows no better; measure more poses, or more precisely"
)
_VERDICTS = {
    "as drawn": f"keep the nominal machine: {_KEEP}",
    "rigid alignment": "rigid alignment only: keep the nominal machine, and locate its base; "
    + _KEEP,
    "not compared": "models cannot be compared, since the rows without one fold do not determine "
    "the geometry: measure more poses",
    "geometry": "geometry is enough: no term predicts held-out rows better",
    "terms": "these terms help: held-out rows miss by {held_out:.2f} σ instead of {before:.2f} σ "
    "with geometry alone",
}
_MEND = (
    "fix that first: repeat the measurements after a slip, or name the parts in a column 'run'; "
    "until then other terms may only mimic it"
)
_BY_CHANCE = (
    f"no term explains it, and 1 in {1 / FALSE_ALARM:.0f} sets of sound measurements shows a "
    "pattern by chance: measure again in another order"
)


def explanation_lines(explanation: Explanation) -> list[str]:
    """Return slips, significant terms (the most significant first) and the verdict, in lines."""
    result, candidates = explanation.result, explanation.candidates
    nominal, visible = result.nominal, [c for c in candidates if c.corrected < LEVEL]
    lines, remaining = list(map(_slip_line, explanation.slips)), visible
    lines += [_MEND] * bool(explanation.slips)
    while remaining and len(lines) < NAMED + len(explanation.slips):
        first, *further = remaining
        lines.append(_seen_line(first, nominal))
        remaining = [rival for rival in further if rival.pair not in first.or_else]
    if not visible:
        least = min((candidate.corrected for candidate in candidates), default=1.0)
        lines.append(
            f"no term is significant: the least probable of {len(candidates)} has p = {least:.2g}, "
            "corrected for their number"
        )
    lines += [
        f"fold {fold + 1} is not compared, since the other rows do not determine a model: {reason}"
        for fold, reason in explanation.lost
    ]
    return [*lines, *_verdict_lines(explanation, visible)]


def _verdict_lines(explanation: Explanation, visible: Sequence[Candidate]) -> list[str]:
    """Return the verdict, and a remedy if residuals follow a pattern nevertheless."""
    result = explanation.result
    sizes = {"held_out": explanation.model.held_out, "before": explanation.models[1].held_out}
    lines = [_VERDICTS[explanation.verdict].format(**sizes)]
    follows = visible or "model-lacks" in {remark.code for remark in result.contradictions}
    if follows and explanation.verdict == "geometry" and not (result.promises or explanation.slips):
        ends = f"--terms {term_text(*visible[0].pair)} models it" if visible else _BY_CHANCE
        lines.append(f"but no limit is stated while residuals follow a pattern; {ends}")
    return lines


def _seen_line(candidate: Candidate, mechanism: Mechanism) -> str:
    lengths = {parameter.id for parameter in mechanism.parameters if parameter.unit == "m"}
    cause = "warming, a load or a setting that is in this column"
    if candidate.reading == GROWTH or lengths.issuperset(parts_of(candidate.reading, mechanism)):
        cause = "lengths that grow with this column"
    cause = CAUSES.get(candidate.kind.name, cause)
    if candidate.kind == PULLEY:
        radii = np.unique(np.round(np.abs(candidate.values), 3))
        shown = dict.fromkeys(amount(radius, "m", 2) for radius in radii[[0, -1]])
        cause += f", with a radius of {' to '.join(shown)} after one step of the fit"
    if candidate.spread:
        sizes, unit = np.hypot.reduce(candidate.values.reshape(-1, 2), axis=1), candidate.unit
        std, (period,) = candidate.std.reshape(-1, 2).max(axis=1), candidate.kind.numbers
        size, error = max(zip(sizes.tolist(), std.tolist(), strict=True), key=lambda v: v[0] / v[1])
        cause += f"; amplitude {measured(size, 2.0 * error, unit, SMALL)}, "
        cause += f"period {measured(period, 2.0 * candidate.spread, unit, POSES)}"

    def called(place: str) -> str:
        name = {GROWTH: "every length", READINGS: "each reading"}.get(place, f"{place} of each leg")
        return place if place in mechanism.load_names else name

    alternatives = [
        called(place) if rival == candidate.kind else f"{rival} of the same reading"
        for place, rival in candidate.or_else
    ]
    return (
        f"{called(candidate.reading)} follows {candidate.kind}: {cause}; {candidate.share:.0%} of "
        f"χ²{_or_else(alternatives)} ({chance(candidate.corrected)})"
    )


def _or_else(alternatives: Sequence[str]) -> str:
    words = listed(alternatives, "or") if alternatives else ""
    return f"; or it is {words}, which these rows cannot separate" if words else ""


def _slip_line(slip: Score) -> str:
    subject, look = slipped(slip.what, slip.name), SLIPPED[slip.what][1]
    alternatives = [slipped(*other).rstrip(",") for other in slip.or_else]
    shown = amount(slip.total, slip.unit)
    if len(slip.axes) > 1:
        parts = zip(slip.axes, slip.size.tolist(), strict=True)
        along = ", ".join(f"{axis} {amount(value, slip.unit)}" for axis, value in parts)
        axes = "the platform's axes" if slip.what == "target" else "the axes of the measurements"
        shown += f" ({along}, in {axes})"
    course = f"from data row {slip.row + 1} on {subject} is off by {shown}"
    if slip.term == "order":
        course = f"{subject} drifts, by {shown} from the first row to the last"
    return f"{course}: {look}{_or_else(alternatives)} ({chance(slip.p_value)})"


def explanation_page(explanation: Explanation) -> str:
    """Return the tables and lines of an explanation as text."""
    tables = [str(screen_table(explanation)), str(models_table(explanation))]
    return "\n".join([*tables, *explanation_lines(explanation)])


def tried(remedy: Remedy) -> str:
    """Return the assumptions of a remedy in a few words."""
    options = remedy.calibration.options
    framed = any(finding.values["unknown_frame"] for finding in remedy.findings)
    parts = [filled(HYPOTHESES[finding.code].says, finding) for finding in remedy.findings]
    if options.setup.unknown_frame and not framed:
        parts.append("the place of the base in the frame of the measurements is unknown")
    if options.setup.targets[ORIGIN].unknown:
        parts.append("the place of the target on the platform is unknown")
    parts += ["rows that do not fit are left out"] if options.loss == "reject" else []
    parts += ["its dimensions are known only roughly"] if options.rough else []
    return " and ".join(parts) or "as measured"


def remedy_table(remedies: Sequence[Remedy]) -> Table:
    """Return a table of the remedies tried, with χ²/dof and outcome."""
    rows = []
    for remedy in remedies:
        result, outcome = remedy.result, "refused"
        if remedy.works:
            outcome = "works"
        elif result and not result.converged:
            outcome = "does not converge"
        elif result and result.promises:
            outcome = "rows do not fit the others"
        elif result:
            titles = unpromised(result) or "residuals are larger than the noise"
            outcome = f"contradicted: {titles}"
        rows.append((tried(remedy), result.reduced_chi2 if result else None, outcome))
    return Table("What was tried", ["if", "χ²/dof:.3g", "calibration"], rows)


def advice(remedies: Sequence[Remedy]) -> list[str]:
    """Return the corrections behind the remedies that work, else why each remedy was refused."""
    working = [finding for remedy in remedies if remedy.works for finding in remedy.findings]
    if any(remedy.works for remedy in remedies):
        results = [remedy.result for remedy in remedies if remedy.works and remedy.result]
        left_out = dict.fromkeys(line for result in results for line in rejected_lines(result))
        sources = [f"{HYPOTHESES[code].remedy}." for code in dict.fromkeys(f.code for f in working)]
        return [*left_out, *sources]
    return [f"{tried(remedy)}: {remedy.trouble}" for remedy in remedies if remedy.trouble]


# Plans


def forecast_lines(forecast: Forecast, error: PlatformError) -> list[str]:
    """Return what a plan determines, and the expected error of the platform over the workspace.

    The first lines name everything undetermined, whether or not the plan could determine it.
    """
    rank = forecast.rank
    count = rank.n_params - rank.rank - forecast.lost.shape[1]
    lines = [f"rank {rank.rank} of {rank.n_params}"]
    if count:
        group_name = f" ({groups_in_words(rank.groups)})" if len(rank.groups) == 1 else ""
        lines[0] += f": {counted(count, 'freedom')} of frames or redundant parameters{group_name} "
        lines[0] += "cannot be determined; errors of the platform are after a best fit of frames"
    else:
        lines[0] += f", condition {rank.condition:.3g}"
    if more := forecast.lost.shape[1]:
        further = f", {counted(more, 'freedom')} more" if count else ""
        lines.append(f"not determined (—){further}: {groups_in_words(forecast.undetermined)}")
    sizes = [("position", error.position, "m"), ("orientation", error.orientation, "rad")]
    sizes = sizes if "rad" in error.units else sizes[:1]
    known = [amount(size, unit) for _, size, unit in sizes if size < np.inf]
    parts = [f"root mean square {listed(known)} at best"] if known else []
    parts += [f"{name} not determined" for name, size, _ in sizes if not size < np.inf]
    return [*lines, f"platform over the workspace: {', '.join(parts)}"]
