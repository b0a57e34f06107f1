"""What is said of a code: title, sentence, meaning, remedy, and the values that these need.

With what sentences share: groups of parameters in words, text that pages can hold, templates.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeAlias

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

from pincal.finding import Finding, Severity
from pincal.model.checks import ALIKE
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

    def said(self, finding: Finding) -> str:
        """Return what was found."""
        return _with(self.says, finding)

    def remedied(self, finding: Finding) -> str:
        """Return what to do about it."""
        return _with(self.remedy, finding)


def _with(words: Words, finding: Finding) -> str:
    """Return words with the values of a finding."""
    if not isinstance(words, str):
        return words(finding)
    values = {"parameters": ", ".join(finding.parameters), **finding.values}
    if "p_value" in values:
        values["chance"] = chance(values["p_value"])
    return words.format(**values)


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


_UNPRINTABLE = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def clean(text: str) -> str:
    """Return text without characters that no page can hold."""
    return _UNPRINTABLE.sub("\ufffd", text)


def _cleaned(value: Any) -> Any:
    if value is None:
        return ""
    return clean(value) if isinstance(value, str) and not hasattr(value, "__html__") else value


def rendered(template: str, **values: Any) -> str:
    """Return a template of ``pincal/words/pages`` or ``pincal/show/pages`` with values."""
    return _environment().get_template(template).render(**values)


@cache
def _environment() -> Environment:
    return Environment(
        loader=ChoiceLoader(
            [PackageLoader("pincal.words", ""), PackageLoader("pincal.show", "pages")]
        ),
        autoescape=True,
        finalize=_cleaned,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def mapped_diagonals(differ: float) -> str:
    """Return whether mapped legs are as observable as their references, parameter by parameter.

    Args:
        differ: Largest part by which |R_ii| of a leg differ from those of its reference leg.
    """
    if differ < ALIKE:
        return "|R_ii| of mapped legs are those of their reference legs (Eq. 10)"
    return (
        f"|R_ii| of mapped legs differ by up to {100 * differ:.2g} %: offsets, gains or Cartesian "
        "coordinates turn into each other. Their product, and O1, is equal but for a constant"
    )


def unreached(magnify: float | None, problems: Sequence[str]) -> str:
    """Return at how many poses a machine is not drawn in full; empty where it is everywhere.

    Args:
        magnify: Factor on the identified machine's errors; None of the mechanism itself.
        problems: Of each pose; empty strings where there is none.
    """
    reasons = [text for text in problems if text]
    if not reasons:
        return ""
    name = "the mechanism"
    if magnify is not None:
        name = f"the identified machine (errors × {magnify:g})"
    return (
        f"{name} is not drawn in full at {len(reasons)} of {len(problems)} poses; the first: "
        f"{reasons[0]}"
    )
