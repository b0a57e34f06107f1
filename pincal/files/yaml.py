"""Strict reading of YAML: plain data only; messages name the line and the key of a fault."""

from __future__ import annotations

import re
import reprlib
from collections.abc import Callable, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NoReturn, TypeAlias, TypeVar, get_type_hints

import yaml
from yaml.composer import Composer

from pincal.errors import PincalError
from pincal.files.text import LARGEST_FILE, plain_number, read_text, why_no_number
from pincal.model.checks import LARGEST

T = TypeVar("T")
Vector: TypeAlias = tuple[float, float, float]
_SIMILAR = 0.75  # least likeness of a misspelt key
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,63}", re.ASCII)


class _Loader(Composer, yaml.CSafeLoader):
    """Loader of plain data, scanned by libyaml: several times faster than in Python.

    It refuses repeated keys and aliases, which hide or multiply content, and numbers that YAML 1.1
    reads differently from people: ``010`` is 8, ``1:30`` is 90, ``1_0`` is 10.
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


Readers: TypeAlias = "Mapping[str, Callable[[Entry], Any]]"


class Entry:
    """A value in a YAML file, which raises errors with its line and the keys that lead to it."""

    def __init__(
        self,
        node: yaml.Node,
        value: Any,
        named: str,
        line: int,
        fault: Callable[[str], PincalError],
    ) -> None:
        self.value = value
        self._node, self._named, self._line, self._fault = node, named, line, fault

    def fail(self, text: str) -> NoReturn:
        """Raise an error with the line."""
        raise self._fault(f", line {self._line}: {text}")

    def refuse(self, expected: str) -> NoReturn:
        """Raise an error that says what is expected, and the value."""
        got = reprlib.repr(self.value)
        self.fail(f"{self._named}: {expected}" + (f"; got {got}" if got not in expected else ""))

    def _inner(self, key: object, node: yaml.Node, value: Any, line: int) -> Entry:
        name = str(key)
        if isinstance(value, dict) and isinstance(key, int):  # legs are called by their names
            name = str(value.get("name", key))[:64]
        return Entry(node, value, f"{self._named}.{name}".lstrip("."), line, self._fault)

    def pairs(self) -> dict[str, Entry]:
        """Return the entries of a mapping by its keys, which are not restricted."""
        if not isinstance(self._node, yaml.MappingNode):
            self.refuse("keys with values are expected")
        entries = {}
        for (key, node), (name, value) in zip(self._node.value, self.value.items(), strict=True):
            entry = self._inner(name, node, value, key.start_mark.line + 1)
            if not isinstance(name, str):
                entry.refuse("a name is expected; decimals take a point")
            entries[name] = entry
        return entries

    def mapped(self, reader: Callable[[Entry], T]) -> dict[str, T]:
        """Return the entries of a mapping by key, each converted by a reader."""
        return {key: reader(part) for key, part in self.pairs().items()}

    def keys(
        self, needed: Sequence[str], known: Sequence[str] = (), *, others: bool = False
    ) -> dict[str, Entry]:
        """Return the entries of a mapping that needs some keys and may have other known ones.

        Unknown keys, unless ``others``, are refused before missing ones, which they may misspell.
        """
        entries, known = self.pairs(), [*needed, *known]
        for key in entries:
            if key not in known:
                absent = [name for name in known if name not in entries] if others else known
                question = meant(key, absent)
                if question or not others:
                    text = question or (f"expected {', '.join(known)}" if known else "remove it")
                    entries[key].fail(f"unknown key {entries[key]._named!r}; {text}")
        for key in needed:
            if key not in entries:
                self.fail(f"key {f'{self._named}.{key}'.lstrip('.')!r} is missing")
        return entries

    def values(self, readers: Readers, needed: Sequence[str] = ()) -> dict[str, Any]:
        """Return the values of a mapping by key, converted by readers; some keys are needed."""
        keys = self.keys(needed, [key for key in readers if key not in needed])
        return {key: readers[key](part) for key, part in keys.items()}

    def built(self, kind: type[T], /, *needed: str, **readers: Callable[[Entry], Any]) -> T:
        """Return a dataclass with the keys as fields, converted by readers or by their types."""
        hints = get_type_hints(kind).items()
        by_field = {name: readers.get(name) or _BY_TYPE[hint] for name, hint in hints}
        return kind(**self.values(by_field, needed))

    def items(self, least: int = 0, most: float = float("inf")) -> list[Entry]:
        """Return the entries of a list."""
        if not isinstance(self._node, yaml.SequenceNode):
            self.refuse("a list is expected")
        nodes = self._node.value
        if not least <= len(nodes) <= most:
            expected = f"at least {least}" if len(nodes) < least else f"at most {most}"
            self.fail(f"{self._named} has {len(nodes)} values; expected {expected}")
        return [
            self._inner(index, node, value, node.start_mark.line + 1)
            for index, (node, value) in enumerate(zip(nodes, self.value, strict=True))
        ]

    def text(self) -> str:
        """Return a text."""
        if not isinstance(self.value, str):
            self.refuse("text is expected")
        return self.value

    def name(self) -> str:
        """Return a name: letters, digits and underscores."""
        if not (isinstance(self.value, str) and _NAME.fullmatch(self.value)):
            self.refuse("a name of letters, digits and _ is expected")
        return self.value

    def number(self) -> float:
        """Return a finite number; 1e-3 is text to YAML, and a number here."""
        value = plain_number(self.value) if isinstance(self.value, str) else self.value
        if isinstance(value, bool) or not isinstance(value, int | float):
            self.refuse("a number is expected")
        if not abs(value) <= LARGEST:
            begun = re.match(r"\s*[-+.]?[0-9]", str(self.value))
            number = begun or not isinstance(self.value, str)
            self.refuse(why_no_number(str(self.value)) if number else "a number is expected")
        return float(value)

    def name_or_number(self) -> str | float:
        """Return the name of a parameter, or a number."""
        is_name = isinstance(self.value, str) and self.value.isidentifier()
        return self.name() if is_name else self.number()

    def vector(self) -> Vector:
        """Return three numbers."""
        x, y, z = (item.number() for item in self.items(3, 3))
        return x, y, z

    def choice(self, *options: T) -> T:
        """Return the value, which must be one of the options."""
        if isinstance(self.value, bool) or self.value not in options:
            self.refuse(f"expected {' or '.join(map(repr, options))}")
        return options[options.index(self.value)]

    def flag(self) -> bool:
        """Return true or false."""
        if not isinstance(self.value, bool):
            self.refuse("true or false is expected")
        return self.value


_BY_TYPE: dict[Any, Callable[[Entry], Any]] = {
    bool: Entry.flag,
    float: Entry.number,
    float | None: Entry.number,
    str: Entry.text,
    str | float: Entry.name_or_number,
    Vector: Entry.vector,
    Vector | None: Entry.vector,
}


def read_yaml(path: Path, error_type: type[PincalError]) -> Entry:
    """Read a YAML file with a mapping; its entries raise errors of ``error_type``."""
    text = read_text(path, LARGEST_FILE["YAML"], error_type)
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
        data = None if node is None else loader.construct_document(node)
    except yaml.MarkedYAMLError as error:
        raise error_type(f"{path}{_unparsed(error, text)}") from error
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise error_type(f"{path}: the YAML does not parse: {error}") from error
    if node is None or not isinstance(data, dict):
        raise error_type(
            f"{path}: {'empty' if data is None else f'a {type(data).__name__}'}; expected keys "
            "with values"
        )
    return Entry(node, data, "", 1, lambda fault: error_type(f"{path}{fault}"))


def meant(key: str, known: Sequence[str]) -> str:
    """Return the question whether a similar known key is meant; empty if there is none."""
    nearest = get_close_matches(key, known, 1, _SIMILAR)
    return f"did you mean {nearest[0]!r}?" if nearest else ""


def _unparsed(error: yaml.MarkedYAMLError, text: str) -> str:
    """Return the line at which a text does not parse, and the reason, for a message."""
    mark, begun = error.problem_mark or error.context_mark, error.context_mark
    place = "" if mark is None else f", line {mark.line + 1}"
    fault = " ".join(str(part) for part in (error.problem, error.context) if part)
    if error.problem and begun is not None and mark is not None and begun.line != mark.line:
        fault += f" that begins in line {begun.line + 1}"
    character = "" if mark is None else text[mark.index :][:1]
    fault = fault.replace("found character that", f"found character {character!r} that")
    tab = "; indent by blanks, not by tabs" if character == "\t" else ""
    return f"{place}: the YAML does not parse: {fault}{tab}"
