"""JSON as pincal writes it: plain data, in which a number that is not finite is null.

JSON has no infinity. An uncertainty, or an end of an interval, is null where nothing bounds it; any
other number is null where it does not exist. What is loaded again bit for bit, the ``data`` of a
result, names such numbers instead: "inf", "-inf", "nan".
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np


def plain(value: Any) -> Any:
    """Return data of dataclasses, mappings, sequences and arrays as JSON holds it."""
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def json_text(value: Any) -> str:
    """Return data as JSON."""
    return json.dumps(plain(value), indent=2, ensure_ascii=False, allow_nan=False)
