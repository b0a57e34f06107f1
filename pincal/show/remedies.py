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


def tried(remedy: Remedy) -> str:
    """Return what was tried, in a few words."""
    options = remedy.calibration.options
    words = [_wording(finding).said(finding) for finding in remedy.findings]
    if options.setup.unknown_frame and not any(f.code == "unknown-frame" for f in remedy.findings):
        words.append("the base is elsewhere in the frame of the measurements")
    if options.setup.targets[ORIGIN].unknown:
        words.append("the target is elsewhere on the platform")
    words += ["rows that do not fit are left out"] if options.loss == "reject" else []
    words += ["the machine is known roughly"] if options.rough else []
    return " and ".join(words) or "as measured"


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
        return [f"{text}." for text in dict.fromkeys(advised) if text]
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
