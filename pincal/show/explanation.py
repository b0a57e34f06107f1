"""What ``explain`` and ``doctor`` show: terms screened, models compared, remedies tried, advice."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pincal.calibration.doctor import Remedy
from pincal.calibration.terms.choice import LEVEL
from pincal.calibration.terms.explain import Explanation
from pincal.calibration.terms.kinds import GROWTH, ORDER, parts_of, term_said
from pincal.calibration.terms.screen import Candidate
from pincal.estimation.residuals.courses import Slip
from pincal.finding import Finding
from pincal.model.setup import ORIGIN
from pincal.show.result_tables import unpromised
from pincal.words import terms as words
from pincal.words.faults import HYPOTHESES
from pincal.words.numbers import SMALL, amount, chance, listed
from pincal.words.table import Cell, Column, Quantity, Table, Value, columns
from pincal.words.wording import NAMED, Wording


def screen_table(explanation: Explanation) -> Table:
    """Return what was tried, the least probable by chance first."""
    rows = [_row(candidate) for candidate in explanation.choice.candidates[:NAMED]]
    omitted = len(explanation.choice.candidates) - len(rows)
    return Table(
        f"{explanation.result.nominal.name}: what geometry does not explain",
        columns("reading", "term", "amplitudes", "off χ² [%]:.1f", "F:.3g", "chance"),
        rows,
        "; ".join(
            filter(None, (words.AMPLITUDES, f"{omitted} more are less clear" * bool(omitted)))
        ),
    )


def _row(candidate: Candidate) -> tuple[Value, ...]:
    if not candidate.rank:
        return (
            candidate.reading,
            str(candidate.kind),
            Cell(None, "taken up by geometry"),
            None,
            None,
            None,
        )
    clear = np.abs(candidate.amplitudes) > 2.0 * candidate.std
    sizes = [
        Quantity(float(value), candidate.unit, float(std))
        for value, std in zip(candidate.amplitudes[clear], candidate.std[clear], strict=True)
    ]
    names = [_amplitude(candidate, name) for name in np.array(candidate.names)[clear].tolist()]
    amplitudes = ", ".join(
        f"{name} {size.text(SMALL)} {SMALL[candidate.unit]}"
        for name, size in zip(names, sizes, strict=True)
    )
    return (
        candidate.reading,
        str(candidate.kind),
        amplitudes or "unclear",
        100.0 * candidate.share,
        candidate.F,
        chance(candidate.corrected),
    )


def _amplitude(candidate: Candidate, id_: str) -> str:
    """Return what an amplitude is called: by its id where several legs have one."""
    single_leg = len({name.partition(".")[0] for name in candidate.names}) == 1
    return id_.partition(".")[2] if single_leg else id_


def _place(explanation: Explanation, place: str) -> str:
    """Return what a place is called."""
    single = (*explanation.result.nominal.load_names, *words.PLACES)
    return words.PLACES.get(place, place) if place in single else words.OF_LEGS.format(name=place)


def models_table(explanation: Explanation) -> Table:
    """Return the models compared on rows held out, the one that was chosen marked."""
    shown = [name for name in ("position", "orientation") if _known(explanation, name)]
    units = {"position": "m", "orientation": "rad"}
    misses = [Column(name, units[name], ".3g") for name in shown]
    heads = columns("", "model", "chance", "free", "held out [σ]:.3f", "±:.3f")
    rows = [
        (
            "→" if index == explanation.choice.chosen else "",
            model.name if index < 2 else f"+ {model.name}",
            chance(model.chance) if index > 1 else "",
            model.parameters,
            model.held_out,
            model.spread if model.spread else None,
            *(getattr(model, name) for name in shown),
            model.bic,
        )
        for index, model in enumerate(explanation.choice.models)
    ]
    every = (*heads, *misses, *columns("BIC:.1f"))
    return Table("Models on rows held out", every, rows, words.HELD_OUT)


def _known(explanation: Explanation, name: str) -> bool:
    return all(np.isfinite(getattr(model, name)) for model in explanation.choice.models)


def explanation_lines(explanation: Explanation) -> list[str]:
    """Return what is seen, and the verdict."""
    tried = explanation.choice.candidates
    visible = [item for item in tried if item.corrected < LEVEL]
    terms = [item for item in visible if item.kind.name != ORDER]
    lines = slip_lines(explanation)
    lines += _seen_lines(explanation, visible)
    if not visible:
        least = min((item.corrected for item in tried), default=1.0)
        lines.append(words.NOTHING.format(count=len(tried), least=f"{least:.2g}"))
    if len(terms) < len(visible):  # the order of rows is none
        lines.append(words.NO_TERM)
    if explanation.result.nominal.load is None and explanation.result.nominal.platform.space == 3:
        lines.append(words.NO_LOAD)
    models = explanation.choice.models
    lines += [
        words.LOST.format(fold=fold + 1, why=reason) for fold, reason in explanation.choice.lost
    ]
    lines.append(
        words.VERDICTS[explanation.verdict].format(
            held_out=f"{explanation.choice.model.held_out:.2f} σ",
            before=f"{models[1].held_out:.2f} σ",
        )
    )
    if terms and explanation.verdict == "geometry" and not explanation.result.promises:
        lines.append(words.UNPROMISED.format(terms=term_said(terms[0].reading, terms[0].kind)))
    return lines


def _seen_lines(explanation: Explanation, visible: Sequence[Candidate]) -> list[str]:
    """Return what is seen, with what these rows do not separate from it."""
    lines, remaining = list[str](), list(visible)
    while remaining and len(lines) < NAMED:
        candidate = remaining.pop(0)
        remaining = [rival for rival in remaining if rival.pair not in candidate.or_else]
        alternatives = [
            _place(explanation, place) if kind == candidate.kind else words.OTHER_KIND.format(kind)
            for place, kind in candidate.or_else
        ]
        lines.append(
            words.SEEN.format(
                reading=_place(explanation, candidate.reading),
                kind=candidate.kind,
                cause=words.CAUSES.get(
                    candidate.kind.name,
                    words.GROWN if _is_length(explanation, candidate) else words.COLUMN,
                ),
                share=candidate.share,
                or_else=words.OR_ELSE.format(what=listed(alternatives, "or"))
                if alternatives
                else "",
                chance=chance(candidate.corrected),
            )
        )
    return lines


def slip_lines(explanation: Explanation) -> list[str]:
    """Return what slipped or drifted, in which direction, and what to do."""
    lines = []
    for slip in explanation.choice.slips:
        subject, look = words.SLIPPED[slip.what]
        alternatives = " or ".join(
            words.SLIPPED[kind][0].format(name=name) for kind, name in slip.or_else
        )
        lines.append(
            (words.DRIFT if slip.steady else words.SLIP).format(
                row=slip.row + 1,
                what=subject.format(name=slip.name),
                size=_vector(slip),
                look=look,
                or_else=words.OR_ELSE.format(what=alternatives.rstrip(",")) if alternatives else "",
                chance=chance(slip.p_value),
            )
        )
    return [*lines, words.MEND] if lines else []


def _vector(slip: Slip) -> str:
    """Return how far something is off, and in which direction."""
    if len(slip.size) == 1:
        return amount(float(slip.size[0]), slip.unit)
    parts = (
        f"{axis} {amount(float(value), slip.unit)}"
        for axis, value in zip(slip.axes, slip.size, strict=True)
    )
    axes = "the platform's axes" if slip.what == "target" else "the axes of the measurements"
    return f"{amount(float(np.linalg.norm(slip.size)), slip.unit)} ({', '.join(parts)}, in {axes})"


def _is_length(explanation: Explanation, candidate: Candidate) -> bool:
    """Return whether a candidate is of a length, or of all."""
    mechanism = explanation.result.nominal
    units = {known.id: known.unit for known in mechanism.parameters}
    parts = parts_of(candidate.reading, mechanism)
    return candidate.reading == GROWTH or all(units.get(part) == "m" for part in parts)


def explanation_page(explanation: Explanation) -> str:
    """Return tables and verdict as text."""
    parts = [
        str(screen_table(explanation)),
        str(models_table(explanation)),
        *explanation_lines(explanation),
    ]
    return "\n".join(parts)


def tried(remedy: Remedy) -> str:
    """Return what was tried, in a few words."""
    options = remedy.calibration.options
    parts = [_wording(finding).said(finding) for finding in remedy.findings]
    if options.setup.unknown_frame and not any(f.code == "unknown-frame" for f in remedy.findings):
        parts.append("the base is elsewhere in the frame of the measurements")
    if options.setup.targets[ORIGIN].unknown:
        parts.append("the target is elsewhere on the platform")
    parts += ["rows that do not fit are left out"] if options.loss == "reject" else []
    parts += ["the machine is known roughly"] if options.rough else []
    return " and ".join(parts) or "as measured"


def remedy_table(remedies: Sequence[Remedy]) -> Table:
    """Return the table of what was tried."""
    rows = [
        (tried(remedy), remedy.result.reduced_chi2 if remedy.result else None, _outcome(remedy))
        for remedy in remedies
    ]
    return Table("What was tried", columns("if", "χ²/dof:.3g", "calibration"), rows)


def advice(remedies: Sequence[Remedy]) -> list[str]:
    """Return what to do: at the source of what works, or else about each refusal."""
    works = [remedy for remedy in remedies if remedy.works]
    if works:
        advised = [
            _wording(finding).remedied(finding) for remedy in works for finding in remedy.findings
        ]
        return [f"{remedied}." for remedied in dict.fromkeys(advised) if remedied]
    return [f"{tried(remedy)}: {remedy.trouble}" for remedy in remedies if remedy.trouble]


def _wording(finding: Finding) -> Wording:
    return HYPOTHESES[finding.code]


def _outcome(remedy: Remedy) -> str:
    if remedy.result is None:
        return "refused"
    if remedy.works:
        return "works"
    if not remedy.result.converged:
        return "does not converge"
    if remedy.result.promises:
        return "rows do not fit the others"
    return f"contradicted: {unpromised(remedy.result) or 'residuals are larger than the noise'}"
