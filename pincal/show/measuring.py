"""Input and output of a session: lines from a terminal, a page or an instrument, and replies."""

import json
import re
from collections.abc import Mapping, Sequence
from threading import Lock
from typing import Any

import numpy as np

from pincal.calibration.session import PLANNED, Session, place_of
from pincal.calibration.verdicts import Checked
from pincal.design.candidates import MANY
from pincal.errors import FileError, MeasurementError
from pincal.model.checks import counted
from pincal.show.picture import picture
from pincal.show.style import figure_bytes
from pincal.show.view.view import Respond
from pincal.words.findings import causes
from pincal.words.numbers import amount, percent
from pincal.words.wording import rendered


def set_points(session: Session, row: int) -> dict[str, float]:
    """Return the planned readings and pose of a row by column, in the units of the sheet."""
    return {
        head.removeprefix(PLANNED): float(cells[row])
        for head, cells in session.sheet.items()
        if head.startswith(PLANNED) and cells[row]
    }


def verdict_on_row(checked: Checked) -> str:
    """Return a sentence on a row just measured: whether it agrees, or whether to repeat it."""
    row = f"row {checked.row + 1}"
    if checked.sigma is None:
        return f"{row} is recorded; nothing predicts it yet"
    if not checked.off:
        return f"{row} is recorded: {checked.sigma:.1f} σ from the prediction"
    far = "no pose of this machine belongs to it"
    if np.isfinite(checked.sigma):
        far = f"{checked.sigma:.3g} σ off, most in the {checked.quantity}"
    likely = f": likely {causes(checked.causes)}" if checked.causes else ""
    return f"{row} is recorded, but {far}{likely}. Measure it again, or keep it?"


def progress(session: Session) -> list[str]:
    """Return the progress of a session: expected error, obstacles, and what is still missing."""
    error, accuracy = session.error, session.options.accuracy
    count = counted(len(session.measured), "pose")
    if error is None or not np.isfinite(error.position):
        lines = [f"{count}: not all parameters are determined yet", session.why]
    else:
        share = f" over {percent(session.share)} of the workspace" * (session.share < 0.995)
        below = f"95 %: below {amount(session.limit, 'm')}"
        limit = below if np.isfinite(session.limit) else "no 95 % limit yet"
        lines = [f"{count}: expected error {amount(error.position, 'm')}, {limit}{share}"]
    if session.result is not None and not session.result.explained:
        lines.append(
            f"residuals are {session.result.excess:.1f} times as large as the noise given; correct "
            "the noise (--noise-position …), or look for a fault"
        )
    if session.doubtful is not None:
        row, sigma = session.doubtful
        lines.append(
            f"row {row + 1} is {sigma:.3g} σ off the prediction by all others: undo (u {row + 1})?"
        )
    if accuracy is not None:
        lines += _until(session, accuracy)
    return [line for line in lines if line]


def _until(session: Session, accuracy: float) -> list[str]:
    """Return what is missing until an accuracy, [m], is reached."""
    wanted, missing, lines = amount(accuracy, "m"), session.missing, list[str]()
    if session.enough:
        return [f"enough: {wanted} reached"]
    if session.limit <= accuracy:
        lines = ["the next pose widens the measured region, outside of which nothing is stated"]
    if session.contradicted:
        return lines  # a forecast would not be of the error that is stated
    if missing >= MANY:
        return [*lines, f"no number of these poses suffices for {wanted}"]
    return [*lines, f"about {counted(missing, 'more pose')} for {wanted}"]


def parsed(line: str, session: Session, pattern: str | None = None) -> dict[str, str]:
    """Parse a line into cells by column: JSON, named groups of a pattern, or numbers in order.

    Raises:
        MeasurementError: the line is none of these, or has a wrong count of numbers.
    """
    line = line.strip()
    if pattern is not None:
        match = re.search(pattern, line)
        if match is None:
            raise MeasurementError(f"the line {line!r} does not match --pattern {pattern}")
        if named := match.groupdict(""):
            return named
        cells = [*match.groups("")]
    elif line.startswith("{"):
        try:
            return {name: str(value) for name, value in json.loads(line).items()}
        except (ValueError, RecursionError) as error:
            raise MeasurementError(f"{line!r} is no JSON: {error}") from error
    else:
        parts = re.split(r"\s*[;\s]\s*", line)  # a comma may then be a decimal point
        cells = [part.strip(",").replace(",", ".") for part in parts]
        cells = cells if len(parts) > 1 else line.split(",")
    for columns in (session.observed, session.columns):
        if len(cells) == len(columns):
            return dict(zip(columns, cells, strict=True))
    both = session.observed != session.columns
    further = f", or all of {', '.join(session.columns)}" * both
    raise MeasurementError(
        f"{line!r} is no row: expected {', '.join(session.observed)}{further}; or u, k, s, r"
    )


def obeyed(session: Session, line: str, row: int, pattern: str | None = None) -> list[str]:
    """Execute a line of input at a row of the plan, and return the reply.

    ``u`` undoes the last row, ``u 3`` row 3; ``k`` keeps the last; ``s`` skips the pose, ``r 12``
    goes to pose 12 of the plan; anything else is a measurement at the row.
    """
    match line.split():
        case ["u", *number] if len(number) < 2:
            rows = len(session.measured)
            session.undo(place_of("row", number[0], rows) if number else None)
        case ["k"]:
            session.keep()
        case ["s"]:
            session.skip(row)
        case ["r", number]:
            session.chosen = place_of("pose", number, len(session.plan))
            return []
        case _:
            checked = session.add(parsed(line, session, pattern), row)
            return [verdict_on_row(checked), *progress(session)]
    return progress(session)


def responding(session: Session, pattern: str | None, lock: Lock) -> Respond:
    """Return the handler of requests by the session's page; the lock guards the session."""
    rows = range(len(session.plan))

    def respond(path: str, query: Mapping[str, str], posted: str) -> tuple[str, str | bytes] | None:
        if path == "/":
            return "text/html", rendered("measure.html", title=session.mechanism.name)
        if path == "/picture":
            pose = session.plan.rows(np.array([rows.index(int(query["row"]))]))
            return "image/svg+xml", figure_bytes(picture(session.mechanism, pose).figure(), "svg")
        if path != "/state":
            return None
        trouble = ""
        with lock:
            if posted and (order := json.loads(posted))["version"] == version(session):
                try:
                    line, row = str.strip(order["line"]), rows.index(order["row"])
                    obeyed(session, line, row, pattern)
                except (MeasurementError, FileError) as error:
                    trouble = str(error)
            elif posted:
                trouble = "the session changed in another window; check its state and enter again"
            return "application/json", json.dumps({**state(session), "trouble": trouble})

    return respond


def version(session: Session) -> str:
    """Return a text that changes with every action in a session."""
    offered, rows = session.candidates.offered.sum(), session.journal.rows
    return f"{len(rows)} {rows[-1:]} {session.questioned} {offered} {session.chosen}"


def state(session: Session) -> dict[str, Any]:
    """Return the state of a session that its page shows, for JSON."""
    row, _ = session.next_pose()
    table = None if session.result is None else session.result.tables()[0]
    names = [session.sheet[name][row] for name in ("set", "pose") if name in session.sheet]
    readings = set(session.mechanism.reading_names)
    points = [
        (*head.removesuffix("]").split(" ["), f"{value:.7g}")
        for head, value in set_points(session, row).items()
    ]
    return {
        "count": len(session.journal.rows),
        "row": row + 1,
        "rows": len(session.plan),
        "named": ", ".join(filter(None, names)),
        "set_points": [point for point in points if point[0] in readings],
        "pose": [point for point in points if point[0] not in readings],
        "columns": session.columns,
        "observed": session.observed,
        "off": session.questioned,
        "version": version(session),
        "verdict": "" if session.checked is None else verdict_on_row(session.checked),
        "progress": [*progress(session), *[session.options.following] * session.enough],
        "enough": session.enough,
        "doubtful": session.doubtful[0] + 1 if session.doubtful else 0,
        "course": _in_mm(session.candidates.limits(session.measured)),
        "forecast": _in_mm(session.forecast),
        "goal": 1e3 * (session.options.accuracy or 0.0),
        "parameters": [] if table is None else [table.head_cells, *table.cells()],
    }


def _in_mm(lengths: Sequence[float]) -> list[float | None]:
    """Return lengths in mm for JSON, None where infinite."""
    return [1e3 * length if np.isfinite(length) else None for length in lengths]
