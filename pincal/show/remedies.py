"""What is said of remedies: what was put right, and what calibration then gave."""

from __future__ import annotations

from collections.abc import Sequence

from pincal.calibration.doctor import Remedy
from pincal.finding import Finding
from pincal.model.setup import ORIGIN
from pincal.show.result_tables import unpromised
from pincal.words.hypotheses import HYPOTHESES
from pincal.words.table import Table, columns
from pincal.words.wording import Wording


def tried(one: Remedy) -> str:
    """Return what was tried, in a few words."""
    options = one.calibration.options
    words = [_wording(found).said(found) for found in one.findings]
    if options.setup.unknown_frame and not any(f.code == "unknown-frame" for f in one.findings):
        words.append("the base is elsewhere in the frame of the measurements")
    if options.setup.targets[ORIGIN].unknown:
        words.append("the target is elsewhere on the platform")
    words += ["rows that do not fit are left out"] if options.loss == "reject" else []
    words += ["the machine is known roughly"] if options.rough else []
    return " and ".join(words) or "as measured"


def remedy_table(found: Sequence[Remedy]) -> Table:
    """Return the table of what was tried."""
    rows = [
        (tried(one), one.result.reduced_chi2 if one.result else None, _then(one)) for one in found
    ]
    return Table("What was tried", columns("if", "χ²/dof:.3g", "calibration"), rows)


def advice(found: Sequence[Remedy]) -> list[str]:
    """Return what to do: at the source of what works, or else about each refusal."""
    works = [one for one in found if one.works]
    if works:
        advised = [_wording(each).remedied(each) for one in works for each in one.findings]
        return [f"{text}." for text in dict.fromkeys(advised) if text]
    return [f"{tried(one)}: {one.trouble}" for one in found if one.trouble]


def _wording(found: Finding) -> Wording:
    return HYPOTHESES[found.code]


def _then(one: Remedy) -> str:
    if one.result is None:
        return "refused"
    if one.works:
        return "works"
    if not one.result.converged:
        return "does not converge"
    if one.result.promises:
        return "rows do not fit the others"
    return f"contradicted: {unpromised(one.result) or 'residuals are larger than the noise'}"
