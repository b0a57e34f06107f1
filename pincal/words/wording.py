"""What is said of a code: title, sentence, meaning, remedy, and the values that these need."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

from pincal.finding import Finding, Severity
from pincal.words.numbers import chance

#: Words with the finding's values in braces, or a function of the finding.
Words: TypeAlias = str | Callable[[Finding], str]
#: Groups of parameters in a sentence; result.json has all.
LISTED = 4
#: Names in a message, rows of a long table.
NAMED = 12
#: What a p-value of a finding is.
P_VALUE = "probability of such a value, or a larger one, if the model is right"


@dataclass(frozen=True)
class Wording:
    """All that is said of one code."""

    title: str
    """What it is, in few words."""
    values: Mapping[str, str]
    """What each value of the finding is, with its unit."""
    says: Words
    """What was found, in one sentence without capital and full stop."""
    means: str
    """What that means, for the page of errors."""
    remedy: Words
    """What to do about it, in a sentence without full stop; may be empty."""
    severity: Severity = "warning"
    general: str = ""
    """The remedy as the page of errors says it, where ``remedy`` is a function."""

    @property
    def advice(self) -> str:
        """What to do about it in general."""
        return self.remedy if isinstance(self.remedy, str) else self.general

    def said(self, found: Finding) -> str:
        """Return what was found."""
        return _with(self.says, found)

    def remedied(self, found: Finding) -> str:
        """Return what to do about it."""
        return _with(self.remedy, found)


def _with(words: Words, found: Finding) -> str:
    """Return words with the values of a finding."""
    if not isinstance(words, str):
        return words(found)
    said = {"parameters": ", ".join(found.parameters), **found.values}
    if "p_value" in said:
        said["chance"] = chance(said["p_value"])
    return words.format(**said)


def group_in_words(group: tuple[str, ...]) -> str:
    """Return which parameters move together, by ids; one that is alone has no effect."""
    *first, last = group
    return f"{', '.join(first)} and {last} move together" if first else f"{last} has no effect"


def groups_in_words(groups: tuple[tuple[str, ...], ...], most: int = LISTED) -> str:
    """Return which parameters move together, a list cut where it is long.

    Args:
        groups: Ids of parameters; one that is alone has no effect.
        most: How many groups are listed.
    """
    parts = list(map(group_in_words, groups))
    if len(parts) > most + 1:
        parts[most:] = [f"and {len(parts) - most} more (result.json)"]
    return "; ".join(parts)
