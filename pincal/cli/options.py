"""Options of commands, declared as fields of dataclasses, and groups that commands share."""

import inspect
import re
from collections.abc import Iterable, Iterator
from dataclasses import Field, dataclass, fields
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import typer

from pincal import MeasurementError, Mechanism, PincalError, Setup, Target
from pincal.files.text import in_si
from pincal.instruments.setup_file import read_setup
from pincal.option import Option, option, option_of
from pincal.words.numbers import Units

FORCE = Option("Replace the output if it exists.")
SEED = Option("Seed of all random choices.", least=0)


def offered(name: str, declared: Option) -> typer.models.OptionInfo:
    """Return a declared option for typer; numbers may have a unit."""

    def parse(text: str | float) -> float:
        if isinstance(text, float):
            return text
        try:
            value = in_si(text, declared.unit, None if declared.needs_unit else "")
            return value if " " in declared.unit else float(value)  # else its dimension is known
        except MeasurementError as error:
            raise typer.BadParameter(str(error)) from None

    number = "NUMBER+UNIT" if declared.needs_unit else "NUMBER[UNIT]"
    info: typer.models.OptionInfo = typer.Option(
        f"--{name}",
        help=declared.help,
        metavar=declared.metavar or (number if declared.unit else None),
        min=declared.least,
        max=declared.most,
        parser=parse if declared.unit else None,
    )
    return info


def output_option(metavar: str, text: str) -> typer.models.OptionInfo:
    """Return the ``-o`` option of a command."""
    output: typer.models.OptionInfo = typer.Option("-o", "--output", metavar=metavar, help=text)
    return output


Mech = Annotated[str, typer.Argument(metavar="MECH", help="Bundled mechanism or folder.")]
Measured = Annotated[
    Path, typer.Argument(metavar="MEASUREMENTS.csv", help="Measured poses and readings.")
]
Force = Annotated[bool, offered("force", FORCE)]
Seed = Annotated[int, offered("seed", SEED)]


def named_after(output: Path) -> str:
    """Return a mechanism's name made from the name of its folder."""
    return re.sub(r"\W+", "_", output.absolute().name).strip("_") or "mechanism"


def option_parameters(group: type) -> Iterator[inspect.Parameter]:
    """Yield the parameters for typer that offer the options of a dataclass."""
    kinds = get_type_hints(group)
    for option_field in _option_fields(group):
        declared: Option = option_field.metadata["option"]
        kind = declared.kind or kinds[option_field.name]
        default = None if callable(option_field.default_factory) else option_field.default
        if get_origin(kind) is tuple:  # an option that is typed several times
            kind, default = list[get_args(kind)[0]] | None, None  # type: ignore[misc]
        if kind is bool:
            default = False
        name = typed_name(option_field)
        yield inspect.Parameter(
            name.replace("-", "_"),
            inspect.Parameter.KEYWORD_ONLY,
            default=default,
            annotation=Annotated[kind, offered(name, declared)],
        )


def filled(group: type, values: dict[str, Any]) -> Any:
    """Return a dataclass with the typed options, which are removed from ``values``."""
    arguments = {}
    for option_field in _option_fields(group):
        value = values.pop(typed_name(option_field).replace("-", "_"))
        if option_field.default is True:
            value = not value
        if value is not None:
            arguments[option_field.name] = tuple(value) if isinstance(value, list) else value
    return group(**arguments)


def _option_fields(group: type) -> list[Field[Any]]:
    return [option_field for option_field in fields(group) if "option" in option_field.metadata]


def typed_name(option_field: Field[Any]) -> str:
    """Return the name of an option on the command line, without ``--``."""
    name = (option_field.metadata["option"].name or option_field.name).replace("_", "-")
    return f"no-{name}" if option_field.default is True else name


def refuse_options(options: Any, names: Iterable[str], purpose: str) -> None:
    """Raise if some of the named options were typed; ``purpose`` says where they do not apply."""
    typed = [
        f"--{typed_name(field)}"
        for field in _option_fields(type(options))
        if field.name in names and getattr(options, field.name) != field.default
    ]
    if typed:
        raise PincalError(f"leave out {', '.join(typed)}: not for {purpose}")


@dataclass(frozen=True)
class TableOptions:
    """Options on units of output."""

    units: str | None = option(
        None,
        "Units to write in: m, cm, mm, um or in; rad, mrad, deg or turn; counts of readings.",
        metavar="mm,deg",
    )

    def written_in(self, mechanism: Mechanism) -> Units:
        """Return the units of output; SI by default."""
        return Units.of(self.units or "", mechanism.counts, mechanism.reading_names)


@dataclass(frozen=True)
class SetupOptions:
    """Options on the meaning of the measured numbers."""

    setup_file: Path | None = option(
        None,
        "Measurement setup: frame, targets, distances, contacts.",
        name="setup",
        metavar="YAML",
    )
    unknown_frame: bool = option(False, option_of(Setup, "unknown_frame"))
    unknown_target: bool = option(False, option_of(Target, "unknown"))

    def read_setup(self) -> Setup:
        """Return the setup of the file, changed by the other options."""
        setup = Setup() if self.setup_file is None else read_setup(self.setup_file)
        return setup.anywhere(frame=self.unknown_frame, target=self.unknown_target)


@dataclass(frozen=True)
class PlanOptions(SetupOptions):
    """Options on the quantities to measure."""

    measure: str | None = option(
        None,
        "Measured quantities of the platform; all sensors are read at every pose.",
        metavar="pose|position|orientation|nothing|x,y,…",
    )
    seed: int = option(0, SEED)

    def measured(self, mechanism: Mechanism, setup: Setup) -> tuple[str, ...]:
        """Return the measured freedoms of the platform and columns, by ``--measure``."""
        platform = mechanism.platform
        of_kind = {"pose": ("m", "rad"), "position": ("m",), "orientation": ("rad",), "nothing": ()}
        if self.measure is None:
            return setup.measured(mechanism)
        if self.measure not in of_kind:
            return tuple(self.measure.replace(" ", "").split(","))
        units = zip(platform.freedoms, platform.units, strict=True)
        freedoms = (name for name, unit in units if unit in of_kind[self.measure])
        return (*freedoms, *setup.columns(mechanism))
