"""Plain values that files may hold, read strictly: names, finite numbers, no unknown keys."""

from __future__ import annotations

from math import isnan
from typing import Annotated

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, FiniteFloat

from pincal.files.input import plain_number
from pincal.model.checks import LARGEST

Name = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$", max_length=64)]


def _number(value: object) -> object:
    if isinstance(value, bool):
        raise ValueError("a number, not true or false, is expected")
    if isinstance(value, str):  # 1e-3, which is text to YAML
        value = plain_number(value)
        if isnan(value):
            raise ValueError("a number is expected")
    return value


Number = Annotated[FiniteFloat, Field(ge=-LARGEST, le=LARGEST), BeforeValidator(_number)]


class Strict(BaseModel):
    """Refuses keys that it does not know."""

    model_config = ConfigDict(extra="forbid")
