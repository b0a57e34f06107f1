"""Findings and their sentences: what was found and what to do about it, by code and values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from pincal.finding import Finding
from pincal.words.faults import FAULTS, HYPOTHESES, explanation
from pincal.words.findings import FINDINGS
from pincal.words.wording import Wording, filled

#: What is said of each code.
WORDINGS: Mapping[str, Wording] = FINDINGS | FAULTS | HYPOTHESES


def finding(
    code: str, rows: Iterable[int] = (), parameters: Iterable[str] = (), **values: Any
) -> Finding:
    """Return a finding of a code, its rows counted from 0, its values in SI.

    Raises:
        KeyError: a code that there is not.
        TypeError: values that are missing, or that the code does not have.
    """
    wording = WORDINGS[code]
    if set(values) != wording.value_names:
        named = f"{sorted(wording.value_names)}, got {sorted(values)}"
        raise TypeError(f"{code} has the values {named}: see pincal.words")
    places = tuple(int(row) for row in rows)
    return Finding(code, wording.severity, values, places, tuple(parameters))


def sentence(finding: Finding) -> str:
    """Return what was found and what to do about it.

    It begins with a small letter, as it follows ``warning:``, and ends without a full stop.
    """
    if finding.code in HYPOTHESES:
        return explanation([finding])
    wording = WORDINGS[finding.code]
    return ". ".join(filter(None, (wording.said(finding), filled(wording.remedy, finding))))


def sentences(findings: Iterable[Finding], *severities: str) -> list[str]:
    """Return the sentences of findings, of some severities if they are given.

    Hypotheses that explain the same measurements alike are one sentence.
    """
    chosen = [finding for finding in findings if not severities or finding.severity in severities]
    hypotheses = [finding for finding in chosen if finding.code in HYPOTHESES]
    others = [sentence(finding) for finding in chosen if finding.code not in HYPOTHESES]
    return [explanation(hypotheses), *others] if hypotheses else others
