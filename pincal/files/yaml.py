"""YAML, read strictly: plain data, no surprises, and a fault is named by its line and key."""

from __future__ import annotations

import re
import reprlib
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args

import yaml
from pydantic import BaseModel, Field, ValidationError
from pydantic_core import ErrorDetails
from yaml.composer import Composer

from pincal.errors import MeasurementError, PincalError
from pincal.files.text import LARGEST_FILE, Name, Number, Strict, read_text, why_no_number
from pincal.model.checks import must_be
from pincal.model.setup import ORIGIN, STEEL, Distance, Setup, Systematic, Target, Tracker

_SIMILAR = 0.75  # from which a key is another one, misspelt
Form = TypeVar("Form", bound=BaseModel)


class _Loader(Composer, yaml.CSafeLoader):
    """Loads plain data, scanned by libyaml: several times faster than in Python.

    Refuses repeated keys and aliases, which hide or multiply content, and numbers that YAML 1.1
    takes for others than people do: ``010`` is 8, ``1:30`` is 90, ``1_0`` is 10.
    """

    def __init__(self, text: str) -> None:
        yaml.CSafeLoader.__init__(self, text)
        Composer.__init__(self)

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            alias: Any = self.peek_event()
            raise yaml.composer.ComposerError(
                None, None, "aliases (*name) are not used here", alias.start_mark
            )
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
                f"{node.value!r} is no plain decimal number; write it as one, or text in quotes",
                node.start_mark,
            )
        if node.tag.endswith("int"):
            return int(self.construct_yaml_int(node))
        return float(self.construct_yaml_float(node))


_PLAIN = re.compile(r"[-+]?(0|[1-9][0-9]*|[0-9]*\.[0-9]*(e[-+]?[0-9]+)?|\.inf|\.nan)|\.nan", re.I)
for _kind in ("int", "float"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_kind}", _Loader.construct_number)


def read_yaml(path: Path, form: type[Form], error_type: type[PincalError]) -> Form:
    """Return what a YAML file says, read strictly in the form that it should have.

    Raises:
        FileError: the file is missing or cannot be read.
        PincalError: of the given type: it does not parse, or says something else than it should.
    """
    text = read_text(path, LARGEST_FILE["YAML"], error_type)
    try:
        data = yaml.load(text, _Loader)
    except yaml.MarkedYAMLError as error:
        raise error_type(f"{path}{_unparsed(error, text)}") from error
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
        place, words = _explained(error, data, form)
        line = _line_of(yaml.compose(text, _Loader), place)
        raise error_type(f"{path}, line {line}: {words}") from error


def meant(key: str, known: list[str]) -> str:
    """Return the question whether another key is meant; nothing if none is alike."""
    nearest = get_close_matches(key, known, 1, _SIMILAR)
    return f"did you mean {nearest[0]!r}?" if nearest else ""


def _unparsed(error: yaml.MarkedYAMLError, text: str) -> str:
    """Return where a text stops to be YAML, and why."""
    mark, begun = error.problem_mark or error.context_mark, error.context_mark
    place = "" if mark is None else f", line {mark.line + 1}"
    fault = " ".join(str(part) for part in (error.problem, error.context) if part)
    if error.problem and begun is not None and mark is not None and begun.line != mark.line:
        fault += f" that begins in line {begun.line + 1}"
    character = "" if mark is None else text[mark.index :][:1]
    fault = fault.replace("found character that", f"found character {character!r} that")
    tab = "; indent by blanks, not by tabs" if character == "\t" else ""
    return f"{place}: the YAML does not parse: {fault}{tab}"


def _explained(
    error: ValidationError, data: dict[str, Any], form: type[BaseModel]
) -> tuple[tuple[int | str, ...], str]:
    """Return the place of the first fault of a YAML file, and one sentence on it.

    A key that is unknown comes before those that are missing, of which it may be a misspelling.
    """
    faults = error.errors(include_url=False, include_context=False)
    first = min(faults, key=lambda fault: fault["type"] != "extra_forbidden")
    place = _place_in(first["loc"], data)
    named = _named(place, data)
    if first["type"] == "extra_forbidden":
        known = _keys(form, place[:-1])
        question = meant(str(place[-1]), known)
        text = f"unknown key {named!r}; " + (
            question or f"expected {', '.join(known)}" if known else "remove it"
        )
    elif first["type"] == "missing" and isinstance(first["loc"][-1], int):
        have = first["loc"][-1]
        text = f"{named} has {have} value{'s' * (have != 1)}, which is not enough"
        text += f"; {'one more is' if have else 'some are'} expected"
    elif first["type"] == "missing":
        text, place = f"key {named!r} is missing", place[:-1]
    else:
        fault, value = _words(first), reprlib.repr(first["input"])
        text = f"{named}: {fault}" + (f"; got {value}" if value not in fault else "")
    return place, text


def _place_in(place: tuple[int | str, ...], data: Any) -> tuple[int | str, ...]:
    """Return a place without what is none in the file, such as the kind of value tried."""
    for count, part in enumerate(place):
        last = count == len(place) - 1
        try:
            data = data[part]
        except (KeyError, IndexError, TypeError):
            return place[: count + (last and isinstance(data, dict))]
    return place


def _words(fault: ErrorDetails) -> str:
    """Return what is wrong with a value."""
    value = fault["input"]
    if fault["loc"][-1] == "[key]":
        return "a name is expected; decimals take a point"
    if isinstance(value, str) and re.match(r"\s*[-+.]?[0-9]", value):
        return why_no_number(value)
    return fault["msg"].removeprefix("Value error, ")


def _named(place: tuple[int | str, ...], data: dict[str, Any]) -> str:
    """Return a place as keys and dots, legs by their names."""
    parts = [str(part) for part in place]
    if len(parts) > 1 and parts[0] == "legs" and isinstance(data["legs"][int(parts[1])], dict):
        parts[1] = str(data["legs"][int(parts[1])].get("name", parts[1]))[:64]
    return ".".join(parts)


def _keys(form: type[BaseModel], place: tuple[int | str, ...]) -> list[str]:
    """Return the keys that a form knows at a place."""
    for part in place:
        if part in form.model_fields:
            form = _form_in(form.model_fields[str(part)].annotation) or form
    return [field.alias or name for name, field in form.model_fields.items()]


def _form_in(annotation: Any) -> type[BaseModel] | None:
    """Return the form that an annotation holds."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next(filter(None, map(_form_in, get_args(annotation))), None)


def _line_of(node: yaml.Node | None, place: tuple[int | str, ...]) -> int:
    """Return the line, from 1, of what is at a place, or around it."""
    line = 1
    for part in place:
        if isinstance(node, yaml.MappingNode):
            pairs = [pair for pair in node.value if pair[0].value == str(part)]
            if not pairs:
                break
            line, node = pairs[0][0].start_mark.line + 1, pairs[0][1]
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int):
            node = node.value[part]
            line = node.start_mark.line + 1
    return line


class _TargetSpec(Strict):
    offset: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)
    unknown: bool = False


class _DistanceSpec(Strict):
    start: tuple[Number, Number, Number] = Field(alias="from")
    target: Name = ORIGIN


class _TrackerSpec(Strict):
    at: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)
    range: Number = 0.0
    azimuth: Number = 0.0
    elevation: Number = 0.0


class _SystematicSpec(Strict):
    scale: Number = 0.0
    temperature: Number = 0.0
    expansion: Number = STEEL
    target: Number = 0.0


class _SetupSpec(Strict):
    pincal_setup: Literal[1]
    frame: Literal["base", "unknown"] = "base"
    targets: dict[Name, _TargetSpec] = Field(default_factory=dict)
    distances: dict[Name, _DistanceSpec] = Field(default_factory=dict)
    tracker: _TrackerSpec | None = None
    systematic: _SystematicSpec = Field(default_factory=_SystematicSpec)


def read_setup(source: Setup | str | Path) -> Setup:
    """Return a setup that is given as such or by its YAML file.

    Raises:
        FileError: the file is missing or cannot be read.
        MeasurementError: something else, or a file that does not say what it should.
    """
    if isinstance(source, Setup):
        return source
    path = Path(must_be(source, (Setup, str, Path), "a setup or its file", MeasurementError))
    spec = read_yaml(path, _SetupSpec, MeasurementError)
    try:
        return Setup(
            unknown_frame=spec.frame == "unknown",
            targets={name: Target(t.offset, t.unknown) for name, t in spec.targets.items()},
            distances={name: Distance(d.start, d.target) for name, d in spec.distances.items()},
            tracker=None if spec.tracker is None else Tracker(**spec.tracker.model_dump()),
            systematic=Systematic(**spec.systematic.model_dump()),
        )
    except MeasurementError as error:
        raise MeasurementError(f"{path}: {error}") from error
