"""Findings: a code and the numbers behind it. ``pincal.words`` makes sentences of them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

Severity = Literal["info", "warning", "error"]


@dataclass(frozen=True)
class Finding:
    """A fact that a user of a result should know."""

    code: str
    """Kind of finding, such as ``"chi2-too-large"``: kebab case, stable between releases."""
    severity: Severity
    values: Mapping[str, Any] = field(default_factory=dict)
    """Numbers, in SI units, and names that its sentence states."""
    rows: tuple[int, ...] = ()
    """Rows of the measurements concerned, counted from 0."""
    parameters: tuple[str, ...] = ()
    """Parameters concerned, by their ids such as ``"leg_1.l"``."""
