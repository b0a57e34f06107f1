"""What a session says: where to drive, what of the last row, how far it is."""

from __future__ import annotations

from typing import Any

import numpy as np

from pincal.calibration.session import PLANNED, Checked, Session
from pincal.model.checks import counted
from pincal.words.faults import causes
from pincal.words.numbers import amount, percent
from pincal.words.table import Table

_NUMBERED = 1e4  # σ from which a number of them says nothing


def set_points(session: Session, row: int) -> dict[str, float]:
    """Return what to drive to at a row of the plan, readings and pose, in the sheet's units."""
    return {
        head.removeprefix(PLANNED): float(cells[row])
        for head, cells in session.sheet.items()
        if head.startswith(PLANNED) and cells[row]
    }


def verdict_on_row(checked: Checked) -> str:
    """Return what is to be said of a row as it came; whether to measure it again."""
    row = f"row {checked.row + 1}"
    if checked.sigma is None:
        return f"{row} is recorded; nothing predicts it yet"
    if not checked.off:
        return f"{row} is recorded: {checked.sigma:.1f} σ from what was predicted"
    far = "no pose of this machine belongs to it"
    if checked.sigma < _NUMBERED:
        far = f"{checked.sigma:.3g} σ off, most in the {checked.quantity}"
    likely = f"; it fits if {causes(checked.causes)}" if checked.causes else ""
    return f"{row} is recorded, but {far}{likely}. Measure it again (undo), or keep it?"


def progress(session: Session) -> list[str]:
    """Return how far the session is: error to expect, what is enough, what is in the way."""
    lines, error, accuracy = [], session.error, session.options.accuracy
    count = counted(len(session.measured), "pose")
    if error is None or not np.isfinite(error.position):
        expected = session.candidates.limit(session.measured)
        lines.append(f"{count}: not all parameters are determined yet")
        if session.why:
            lines.append(session.why)
    else:
        expected = error.limit[0]
        share = f" over {percent(session.share)} of the workspace" * (session.share < 0.995)
        lines.append(
            f"{count}: expected error {amount(error.position, 'm')}, 95 %: below "
            f"{amount(expected, 'm')}{share}"
        )
    if session.result is not None and not session.result.explained:
        lines.append(
            f"residuals are {session.result.excess:.1f} times as large as the noise given; say "
            "what it is (--noise-position …), or look for what is wrong"
        )
    if session.doubtful is not None:
        row, sigma = session.doubtful
        lines.append(f"row {row + 1} is {sigma:.1f} σ off what all others say: a slip?")
    if session.enough:
        lines.append(f"enough: {amount(accuracy or 0.0, 'm')} reached; 'pincal calibrate' next")
    elif accuracy is not None and error is not None and error.limit[0] <= accuracy:
        lines.append("the next pose widens the measured region, outside of which nothing is stated")
    elif accuracy is not None:
        poses = counted(session.missing, "more pose")
        lines.append(f"about {poses} for {amount(accuracy, 'm')}")
    return lines


def parameters(session: Session) -> Table | None:
    """Return the parameters as they are known now; None while there are none."""
    if session.result is None:
        return None
    return session.result.tables()[0]


def state(session: Session) -> dict[str, Any]:
    """Return all that a page shows of a session."""
    row, gain = session.next_pose()
    checked, table = session.checked, parameters(session)
    names = {name: session.sheet[name][row] for name in ("set", "pose") if name in session.sheet}
    readings = set(session.mechanism.reading_names)
    points = [
        (*head.removesuffix("]").split(" ["), f"{value:.7g}")
        for head, value in set_points(session, row).items()
    ]
    return {
        "name": session.mechanism.name,
        "count": len(session.journal.rows),
        "row": row + 1,
        "rows": len(session.plan),
        "named": ", ".join(filter(None, names.values())),
        "gain": percent(gain),
        "set_points": [point for point in points if point[0] in readings],
        "pose": [point for point in points if point[0] not in readings],
        "columns": session.columns,
        "observed": session.observed,
        "off": checked is not None and checked.off,
        "verdict": "" if checked is None else verdict_on_row(checked),
        "progress": progress(session),
        "enough": session.enough,
        "course": [1e3 * limit for limit in session.limits(session.measured)],
        "forecast": [1e3 * limit for limit in session.forecast],
        "goal": 1e3 * (session.options.accuracy or 0.0),
        "parameters": [] if table is None else [table.head_cells, *table.cells()],
    }
