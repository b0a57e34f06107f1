"""What was found: a code and the numbers behind it. Sentences are made in ``pincal.words``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

Severity = Literal["info", "warning", "error"]


@dataclass(frozen=True)
class Finding:
    """Something that whoever holds a result should know."""

    code: str
    """Which kind of thing, such as ``"chi2-too-large"``: kebab case, stable between releases."""
    severity: Severity
    values: Mapping[str, Any] = field(default_factory=dict)
    """Numbers and names of which its sentence is made, SI units."""
    rows: tuple[int, ...] = ()
    """Rows of the measurements concerned, counted from 0."""
    parameters: tuple[str, ...] = ()
    """Parameters concerned, by their ids such as ``"leg_1.l"``."""
