"""What an explanation shows: the screen of terms, the models compared, and what to do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pincal.calibration.terms.choice import RULES
from pincal.calibration.terms.explain import Explanation
from pincal.calibration.terms.kinds import GROWTH, ORDER, parts_of, term_said
from pincal.calibration.terms.screen import Bound, Candidate
from pincal.estimation.residuals.courses import Slip
from pincal.words.numbers import SMALL, amount, chance, listed
from pincal.words.parameters import (
    AMPLITUDES,
    BOUNDS,
    CAUSES,
    COLUMN,
    DRIFT,
    GROWN,
    HELD_OUT,
    LOST,
    MEND,
    NO_LOAD,
    NO_TERM,
    NOTHING,
    OF_LEGS,
    OR_ELSE,
    OTHER_KIND,
    PLACES,
    SEEN,
    SLIP,
    SLIPPED,
    TOO_SMALL,
    UNPROMISED,
    VERDICTS,
)
from pincal.words.table import Cell, Column, Quantity, Table, Value, columns
from pincal.words.wording import NAMED


def screen_table(found: Explanation) -> Table:
    """Return what was tried, the least probable by chance first."""
    rows = [_row(one) for one in found.choice.candidates[:NAMED]]
    more = len(found.choice.candidates) - len(rows)
    return Table(
        f"{found.result.nominal.name}: what geometry does not explain",
        columns("reading", "term", "amplitudes", "off χ² [%]:.1f", "F:.3g", "chance"),
        rows,
        "; ".join(filter(None, (AMPLITUDES, f"{more} more are less clear" * bool(more)))),
    )


def _row(one: Candidate) -> tuple[Value, ...]:
    if not one.rank:
        return (one.reading, str(one.kind), Cell(None, "taken up by geometry"), None, None, None)
    clear = np.abs(one.amplitudes) > 2.0 * one.std
    sizes = [
        Quantity(float(value), one.unit, float(std))
        for value, std in zip(one.amplitudes[clear], one.std[clear], strict=True)
    ]
    names = [_amplitude(one, name) for name in np.array(one.names)[clear].tolist()]
    said = ", ".join(
        f"{name} {size.text(SMALL)} {SMALL[one.unit]}"
        for name, size in zip(names, sizes, strict=True)
    )
    return (
        one.reading,
        str(one.kind),
        said or "unclear",
        100.0 * one.share,
        one.F,
        chance(one.corrected),
    )


def _amplitude(one: Candidate, id_: str) -> str:
    """Return what an amplitude is called: by its id where several legs have one."""
    alone = len({name.partition(".")[0] for name in one.names}) == 1
    return id_.partition(".")[2] if alone else id_


def _place(found: Explanation, place: str) -> str:
    """Return what a place is called."""
    single = (*found.result.nominal.load_names, *PLACES)
    return PLACES.get(place, place) if place in single else OF_LEGS.format(name=place)


def models_table(found: Explanation) -> Table:
    """Return the models compared on rows held out, the one that was chosen marked."""
    shown = [name for name in ("position", "orientation") if _known(found, name)]
    units = {"position": "m", "orientation": "rad"}
    misses = [Column(name, units[name], ".3g") for name in shown]
    heads = columns("", "model", "chance", "free", "held out [σ]:.3f", "±:.3f")
    rows = [
        (
            "→" if index == found.choice.chosen else "",
            one.name if index < 2 else f"+ {one.name}",
            chance(one.chance) if index > 1 else "",
            one.parameters,
            one.held_out,
            one.spread if one.spread else None,
            *(getattr(one, name) for name in shown),
            one.bic,
        )
        for index, one in enumerate(found.choice.models)
    ]
    every = (*heads, *misses, *columns("BIC:.1f"))
    return Table("Models on rows held out", every, rows, HELD_OUT)


def _known(found: Explanation, name: str) -> bool:
    return all(np.isfinite(getattr(one, name)) for one in found.choice.models)


def explanation_lines(found: Explanation) -> list[str]:
    """Return what is seen, and the verdict."""
    tried = found.choice.candidates
    seen = [one for one in tried if one.corrected < RULES.level]
    lines = slip_lines(found)
    lines += _seen_lines(found, seen)
    if not seen:
        least = min((one.corrected for one in tried), default=1.0)
        lines.append(NOTHING.format(count=len(tried), least=f"{least:.2g}"))
    if any(one.kind.name == ORDER for one in seen):
        lines.append(NO_TERM)
    if found.result.nominal.load is None and found.result.nominal.platform.space == 3:
        lines.append(NO_LOAD)
    lines += [bound_line(one) for one in found.choice.bounds]
    models = found.choice.models
    lines += [LOST.format(fold=fold + 1, why=why) for fold, why in found.choice.lost]
    lines.append(
        VERDICTS[found.verdict].format(
            held_out=f"{found.choice.model.held_out:.2f} σ", before=f"{models[1].held_out:.2f} σ"
        )
    )
    terms = [one for one in seen if one.kind.name != ORDER]
    if terms and found.verdict == "geometry" and not found.result.promises:
        lines.append(UNPROMISED.format(terms=term_said(terms[0].reading, terms[0].kind)))
    return lines


def _seen_lines(found: Explanation, seen: Sequence[Candidate]) -> list[str]:
    """Return what is seen, with what these rows do not separate from it."""
    lines, left = list[str](), list(seen)
    while left and len(lines) < NAMED:
        one = left.pop(0)
        left = [other for other in left if other.pair not in one.or_else]
        others = [
            _place(found, place) if kind == one.kind else OTHER_KIND.format(kind)
            for place, kind in one.or_else
        ]
        lines.append(
            SEEN.format(
                reading=_place(found, one.reading),
                kind=one.kind,
                cause=CAUSES.get(one.kind.name, GROWN if _is_length(found, one) else COLUMN),
                share=one.share,
                or_else=OR_ELSE.format(what=listed(others, "or")) if others else "",
                chance=chance(one.corrected),
            )
        )
    return lines


def slip_lines(found: Explanation) -> list[str]:
    """Return what slipped or drifted, in which direction, and what to do."""
    lines = []
    for one in found.choice.slips:
        what, look = SLIPPED[one.what]
        others = " or ".join(SLIPPED[kind][0].format(name=name) for kind, name in one.or_else)
        lines.append(
            (DRIFT if one.steady else SLIP).format(
                row=one.row + 1,
                what=what.format(name=one.name),
                size=_vector(one),
                look=look,
                or_else=OR_ELSE.format(what=others.rstrip(",")) if others else "",
                chance=chance(one.p_value),
            )
        )
    return [*lines, MEND] if lines else []


def _vector(one: Slip) -> str:
    """Return how far something is off, and in which direction."""
    if len(one.size) == 1:
        return amount(float(one.size[0]), one.unit)
    parts = (
        f"{axis} {amount(float(value), one.unit)}"
        for axis, value in zip(one.axes, one.size, strict=True)
    )
    axes = "the platform's axes" if one.what == "target" else "the axes of the measurements"
    return f"{amount(float(np.linalg.norm(one.size)), one.unit)} ({', '.join(parts)}, in {axes})"


def bound_line(one: Bound) -> str:
    """Return what noise is surely there, and that it is not reckoned with."""
    size, least, reckoned = (amount(v, one.unit) for v in (one.size, one.least, one.reckoned))
    text = BOUNDS[one.cause].format(quantity=one.quantity, size=size, least=least)
    return TOO_SMALL.format(bound=text, reckoned=reckoned) if one.too_small else text


def _is_length(found: Explanation, one: Candidate) -> bool:
    """Return whether a candidate is of a length, or of all."""
    mechanism = found.result.nominal
    units = {known.id: known.unit for known in mechanism.parameters}
    parts = parts_of(one.reading, mechanism)
    return one.reading == GROWTH or all(units.get(part) == "m" for part in parts)


def explanation_page(found: Explanation) -> str:
    """Return tables and verdict as text."""
    parts = [str(screen_table(found)), str(models_table(found)), *explanation_lines(found)]
    return "\n".join(parts)
