"""Templates of pages: whatever people's files hold stays text on them.

Every value that a template puts in is escaped, and loses characters that no page can hold; only
objects that say themselves that they are HTML (``__html__``, such as a ``Table``) are not.
"""

from __future__ import annotations

import re
from functools import cache
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

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
