"""What an explanation shows: the screen of terms, the models compared, and what to do."""

from __future__ import annotations

import numpy as np

from pincal.calibration.terms.choice import RULES
from pincal.calibration.terms.explain import Explanation
from pincal.calibration.terms.kinds import GROWTH, ORDER
from pincal.calibration.terms.screen import Candidate
from pincal.words.numbers import SMALL, chance
from pincal.words.table import Cell, Column, Quantity, Table, Value, columns
from pincal.words.terms import (
    ALL_LENGTHS,
    AMPLITUDES,
    CAUSES,
    COLUMN,
    GROWN,
    HELD_OUT,
    NO_LOAD,
    NO_TERM,
    NOTHING,
    SEEN,
    VERDICTS,
)

_SHOWN = 12  # candidates


def screen_table(found: Explanation) -> Table:
    """Return what was tried, the least probable by chance first."""
    rows = [_row(one) for one in found.choice.candidates[:_SHOWN]]
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
    names = [name.partition(".")[2] for name in np.array(one.names)[clear]]
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
    lines = [
        SEEN.format(
            reading=ALL_LENGTHS if one.reading == GROWTH else one.reading,
            kind=one.kind,
            cause=CAUSES.get(one.kind.name, GROWN if _is_length(found, one) else COLUMN),
            share=one.share,
            chance=chance(one.corrected),
        )
        for one in seen[:_SHOWN]
    ]
    if not seen:
        least = min((one.corrected for one in tried), default=1.0)
        lines.append(NOTHING.format(count=len(tried), least=f"{least:.2g}"))
    if any(one.kind.name == ORDER for one in seen):
        lines.append(NO_TERM)
    if found.result.nominal.load is None and found.result.nominal.platform.space == 3:
        lines.append(NO_LOAD)
    models = found.choice.models
    lines.append(
        VERDICTS[found.verdict].format(
            held_out=f"{found.choice.model.held_out:.2f} σ", before=f"{models[1].held_out:.2f} σ"
        )
    )
    return lines


def _is_length(found: Explanation, one: Candidate) -> bool:
    """Return whether a candidate is of a length, or of all."""
    units = {known.id: known.unit for known in found.result.nominal.parameters}
    return one.reading == GROWTH or units.get(one.reading) == "m"


def explanation_page(found: Explanation) -> str:
    """Return tables and verdict as text."""
    parts = [str(screen_table(found)), str(models_table(found)), *explanation_lines(found)]
    return "\n".join(parts)
