"""The commands of ``pincal``: each is imported when it is asked for, as what it needs is much."""

from __future__ import annotations

import ast
from collections.abc import Callable
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from typer import BadParameter
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command_from_info
from typer.models import CommandInfo

#: Modules and the commands in them, as people come to need them.
MODULES = {
    "mechanisms": "mechanisms check symmetry",
    "new": "new",
    "view": "view picture",
    "kinematics": "inverse forward",
    "workspace": "workspace",
    "selection": "select",
    "simulation": "simulate",
    "identifiability": "identifiability",
    "calibration": "calibrate",
    "doctor": "doctor",
    "explain": "explain",
    "importing": "import",
    "plot": "plot",
    "exporting": "export",
    "demo": "demo",
    "study": "study",
    "bench": "bench",
}
NAMES = {
    name: f"pincal.cli.commands.{module}"
    for module, names in MODULES.items()
    for name in names.split()
}
"""Commands, and the module of each."""
_REGISTERED: dict[str, CommandInfo] = {}


def register(name: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that makes a function the command of a name."""

    def made(function: Callable[..., None]) -> Callable[..., None]:
        _REGISTERED[name] = CommandInfo(name=name, callback=function)
        return function

    return made


def registered(name: str) -> CommandInfo:
    """Return what is known of a command, after importing it."""
    if name not in _REGISTERED:
        import_module(NAMES[name])
    return _REGISTERED[name]


def _untyped(record: Callable[[Any], tuple[str, str] | None], ctx: Any) -> tuple[str, str] | None:
    """Return how an argument is helped with, without its type in Python."""
    found = record(ctx)
    return None if found is None else (found[0].partition(" <")[0], found[1])


class Commands(TyperGroup):
    """All commands, none of them imported before it is asked for."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings | {"commands": dict.fromkeys(NAMES)})

    def invoke(self, ctx: Any) -> Any:
        """Run a command; what was typed wrong is said without the checker's own words."""
        try:
            return super().invoke(ctx)
        except BadParameter as error:
            error.message = error.message.removeprefix("Value error, ")
            raise

    def get_command(self, ctx: Any, cmd_name: str) -> Any:  # noqa: ARG002
        """Return a command by its name, None if there is none."""
        if cmd_name not in NAMES:
            return None
        found = get_command_from_info(
            registered(cmd_name), pretty_exceptions_short=False, rich_markup_mode=None
        )
        for one in found.params:  # their names say what they are, not '<list[Path]>'
            if one.param_type_name == "argument":
                setattr(one, "get_help_record", partial(_untyped, one.get_help_record))  # noqa: B010
        return found

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # noqa: ARG002
        """List the commands, each with the first sentence of its help."""
        room = formatter.width - 6 - max(map(len, NAMES))
        with formatter.section("Commands"):
            formatter.write_dl(
                [
                    (name, TyperCommand(name, help=_help(name)).get_short_help_str(room))
                    for name in NAMES
                ]
            )


def _help(name: str) -> str:
    """Return the help of a command, read from its module without importing that."""
    place = find_spec(NAMES[name])
    if place is None or place.origin is None:
        return ""
    tree = ast.parse(Path(place.origin).read_text(encoding="utf-8"))
    functions = {one.name: one for one in tree.body if isinstance(one, ast.FunctionDef)}
    return ast.get_docstring(functions.get(name) or functions[f"{name}_"]) or ""
