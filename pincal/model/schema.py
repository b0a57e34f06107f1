"""What ``mechanism.yaml`` may say, read strictly: keys, types, and where a fault is."""

from __future__ import annotations

import re
import reprlib
from math import isnan
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import yaml
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    FiniteFloat,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
)

from pincal.errors import MechanismError, PincalError
from pincal.model.input import LARGEST, plain_number, read_text

FORMAT = 1
_LARGEST = 1024 * 1024  # bytes
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
Value = Name | Number


def _number_or_home(value: object, number: ValidatorFunctionWrapHandler) -> object:
    try:
        return value if value == "home" else number(value)
    except ValidationError as error:
        raise ValueError("a finite number or 'home' is expected") from error


Zero = Annotated[Literal["home"] | Number, WrapValidator(_number_or_home)]


Form = TypeVar("Form", bound=BaseModel)


class Strict(BaseModel):
    """Refuses keys that it does not know."""

    model_config = ConfigDict(extra="forbid")


class SensorSpec(Strict):
    """Sensor of a leg."""

    joint: Name
    form: Literal["joint", "reading"]
    gain: Value = 1.0
    offset: Value = 0.0
    direction: Literal[1, -1] = 1
    zero: Zero = 0.0


class LegSpec(Strict):
    """One leg."""

    name: Name
    urdf: str
    tip: str
    platform_point: str
    home: dict[str, Number]
    closes: Literal["point", "frame"] = "point"
    sensors: list[SensorSpec] = Field(min_length=1)
    parameters: dict[Name, Number]
    placements: dict[str, list[dict[str, Value | list[Value]]]]


class PlatformSpec(Strict):
    """The platform."""

    kind: str
    urdf: str
    home: dict[str, Number]


class MechanismSpec(Strict):
    """The whole file."""

    pincal: Literal[1]
    name: str
    description: str = ""
    platform: PlatformSpec
    legs: list[LegSpec] = Field(min_length=1)


class _Loader(yaml.SafeLoader):
    """Loads plain data.

    Refuses repeated keys and aliases, which hide or multiply content, and numbers that YAML 1.1
    takes for others than people do: ``010`` is 8, ``1:30`` is 90, ``1_0`` is 10.
    """

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
            raise yaml.composer.ComposerError(None, None, "aliases (*name) are not used here", mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        keys: set[str] = set()
        for key, _ in node.value:
            if str(key.value) in keys:
                raise yaml.constructor.ConstructorError(
                    None, None, f"key {key.value!r} appears twice", key.start_mark
                )
            keys.add(str(key.value))
        return super().construct_mapping(node, deep)

    def construct_number(self, node: yaml.ScalarNode) -> int | float:
        if not _PLAIN.fullmatch(node.value):
            raise yaml.constructor.ConstructorError(
                None,
                None,
                f"{node.value[:100]!r} is no plain decimal number; write it as one, or text in "
                "quotes",
                node.start_mark,
            )
        if node.tag.endswith("int"):
            return int(self.construct_yaml_int(node))
        return float(self.construct_yaml_float(node))


_PLAIN = re.compile(r"[-+]?(0|[1-9][0-9]*|[0-9]*\.[0-9]*(e[-+]?[0-9]+)?|\.inf|\.nan)|\.nan", re.I)
for _kind in ("int", "float"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_kind}", _Loader.construct_number)


def read_spec(path: Path) -> MechanismSpec:
    """Return what a ``mechanism.yaml`` says.

    Raises:
        FileError: the file is missing or cannot be read.
        MechanismError: it does not parse, or says something else than it should.
    """
    return read_yaml(path, MechanismSpec, MechanismError)


def read_yaml(path: Path, form: type[Form], error_type: type[PincalError]) -> Form:
    """Return what a YAML file says, read strictly.

    Args:
        path: The file.
        form: What it may say.
        error_type: Raised if it says something else.

    Raises:
        FileError: the file is missing or cannot be read.
        PincalError: of the given type: it does not parse, or says something else than it should.
    """
    text = read_text(path, _LARGEST, error_type)
    try:
        data = yaml.load(text, _Loader)
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise error_type(f"{path}: the YAML does not parse: {error}") from error
    if not isinstance(data, dict):
        raise error_type(
            f"{path}: {'empty' if data is None else f'a {type(data).__name__}'}; expected the keys "
            f"{', '.join(form.model_fields)}"
        )
    try:
        return form.model_validate(data)
    except ValidationError as error:
        raise error_type(f"{path}: {_explain(error, data)}") from error


def _explain(error: ValidationError, data: dict[str, Any]) -> str:
    """Return one sentence on the first fault of a YAML file."""
    first = error.errors(include_url=False, include_context=False)[0]
    parts = [str(part) for part in first["loc"]]
    if len(parts) > 1 and parts[0] == "legs" and isinstance(data["legs"][int(parts[1])], dict):
        parts[1] = str(data["legs"][int(parts[1])].get("name", parts[1]))[:64]
    place = ".".join(parts)
    if first["type"] == "extra_forbidden":
        text = f"unknown key {place!r}; remove it, or correct its spelling"
    elif first["type"] == "missing":
        text = f"key {place!r} is missing"
    else:
        text = f"{place}: {first['msg']}; got {reprlib.repr(first['input'])}"
    others = error.error_count() - 1
    return text + (f" (and {others} more)" if others else "")
