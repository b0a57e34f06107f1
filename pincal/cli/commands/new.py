"""``pincal new``: a mechanism of one's own from the dimensions of a data sheet."""

from __future__ import annotations

import re
import shlex
from collections import defaultdict
from dataclasses import asdict, dataclass, make_dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from pincal.architectures.dimension import Architecture, Values
from pincal.architectures.new import ARCHITECTURES, architecture_of, new_mechanism
from pincal.cli.app import (
    Force,
    Seed,
    answer,
    command,
    output_option,
    remark,
    stderr,
    stdout,
    working,
    wrote,
)
from pincal.cli.options import in_si, with_unit
from pincal.design.select import in_turns, with_verification
from pincal.design.select_configurations import ConfigurationChoice, select_configurations
from pincal.errors import MechanismError
from pincal.files.measurement_writing import write_plan, write_sheet
from pincal.files.mechanism_folders import MECHANISM_FILES, write_mechanism
from pincal.files.output import refuse_existing, writing
from pincal.kinematics.inverse import inverse
from pincal.model.measurements import Noise, Plan
from pincal.model.mechanism import Mechanism
from pincal.model.units import WRITTEN
from pincal.show.tables import choice_table
from pincal.workspace.criteria import in_workspace
from pincal.workspace.sampling import sample_configurations

#: Files in the folder beside the mechanism, and what they are.
BESIDE = {
    "picture.svg": "a picture with dimensions",
    "plan.csv": "poses to measure",
    "sheet.csv": "the sheet to fill in",
    "columns.csv": "what its columns are",
}
FOLDER = (*MECHANISM_FILES, *BESIDE)
_CANDIDATES, _STARTS = 1000, 5
_READ = 1e-4  # standard deviation of readings, where there are more than freedoms [m or rad]
_BARE = {"m": "mm", "rad": "deg"}


def _options() -> type[Any]:
    """Return all dimensions of all architectures as a group of options."""
    meanings: dict[str, list[tuple[str, str]]] = defaultdict(list)
    for architecture in ARCHITECTURES.values():
        for one in architecture.dimensions:
            choices = f" ({' or '.join(one.choices)})" if one.choices else ""
            meanings[one.name].append((f"{architecture.name}: {one.label}{choices}", one.unit))
    fields: list[Any] = []
    for name, own in meanings.items():
        help_, unit = "; ".join(what for what, _ in own) + ".", own[0][1]
        kind: Any = float if unit else str
        option = with_unit(unit, help_, None) if unit else typer.Option(metavar="TEXT", help=help_)
        fields.append((name, Annotated[kind | None, option], None))
    return make_dataclass("DimensionOptions", fields, frozen=True)


DimensionOptions = _options()


@dataclass(frozen=True)
class PlanSize:
    """How many poses are planned, and whether dimensions are asked for."""

    count: Annotated[int, typer.Option(min=1, help="Poses for the calibration.")] = 24
    verify: Annotated[int, typer.Option(min=0, help="Random poses beside them, to check it.")] = 6
    defaults: Annotated[
        bool, typer.Option("--defaults", help="Ask nothing: what is not given is in proportion.")
    ] = False
    seed: Seed = 0


@command(answers=True)
def new(
    output: Annotated[Path, output_option("MECH", "Folder of the mechanism, plan and sheet.")],
    size: PlanSize,
    sizes: DimensionOptions,  # type: ignore[valid-type]
    architecture: Annotated[
        str | None,
        typer.Argument(metavar="ARCHITECTURE", help=f"{', '.join(ARCHITECTURES)}; else asked."),
    ] = None,
    force: Force = False,
) -> None:
    """Make a mechanism of your own from its dimensions.

    Writes a mechanism folder, and into it a picture with dimensions (picture.svg), poses to
    measure (plan.csv), and a sheet to fill in (sheet.csv, its columns explained in columns.csv).
    Dimensions that are not given are asked for, in mm and degrees.

    Then measure, fill in the sheet, and type 'pincal calibrate MECH MECH/sheet.csv -o RESULT'.
    """
    refuse_existing(output, force=force, folder=FOLDER)
    given = {name: value for name, value in asdict(sizes).items() if value is not None}
    one = architecture_of(architecture or _ask("architecture", "hexapod", ", ".join(ARCHITECTURES)))
    if other := given.keys() - {d.name for d in one.dimensions}:
        raise MechanismError(
            f"{_option(sorted(other)[0])} is no dimension of a {one.name}; it has "
            f"{', '.join(_option(d.name) for d in one.dimensions)}"
        )
    if not size.defaults:
        given = _asked(one, given, output)
    name = re.sub(r"\W+", "_", output.absolute().name).strip("_") or one.name
    mechanism = new_mechanism(one.name, name=name, **given)
    with working("choosing poses"):
        offered = _offered(one, one.complete(given), mechanism, size.seed)
        plan, chosen = _planned(mechanism, offered, size)
    _write(output, mechanism, plan, force=force)
    stdout.print(mechanism.description, markup=False)
    stdout.print(choice_table(mechanism, chosen))
    wrote(output)
    for file, what in BESIDE.items():
        remark(f"  {file}: {what}")
    hold = "" if chosen.rank.complete else " --hold-undetermined"
    remark(f"then: pincal calibrate {output} {output / 'sheet.csv'}{hold} -o RESULT")
    answer(
        {
            "mechanism": mechanism.name,
            "folder": str(output),
            "dimensions": one.complete(given),
            "parameters": len(mechanism.parameters),
            "poses": len(plan),
            "efficiency": chosen.efficiency,
        }
    )


def _asked(one: Architecture, given: dict[str, Any], output: Path) -> dict[str, Any]:
    """Return all dimensions, those not given as they are typed, and say how to give them all."""
    found: dict[str, Any] = {}
    missing = [d for d in one.dimensions if d.name not in given]
    for each in one.dimensions:
        value = given.get(each.name)
        if value is not None or not each.applies(found):
            usual = each.usual(found)
            found[each.name] = each.checked(usual if value is None else value, found)
            continue
        while each.name not in found:
            usual = each.text(each.usual(found))
            text = _ask(each.label, usual, ", ".join(each.choices), _option(each.name))
            try:
                typed = in_si(text, each.unit, _BARE[each.unit]) if each.unit else text
                found[each.name] = each.checked(typed, found)
            except (MechanismError, typer.BadParameter) as error:
                stderr.print(str(error), markup=False)
    if missing:
        own = {d.name: d.text(found[d.name], typed=True) for d in one.dimensions}
        words = [word for key, text in own.items() if text for word in (_option(key), text)]
        remark(f"the same again: {shlex.join(['pincal', 'new', one.name, *words])} -o {output}")
    return found


def _ask(label: str, usual: str, choices: str = "", option: str = "ARCHITECTURE") -> str:
    """Return what is typed, or what is usual.

    Raises:
        BadParameter: there is nobody to ask.
    """
    more = f" ({choices})" if choices else ""
    stderr.print(f"{label}{more}{f' [{usual}]' * bool(usual)}: ", markup=False, end="")
    try:
        return input().strip() or usual
    except EOFError as error:
        raise typer.BadParameter(
            f"the {label} is not given: {option}, or --defaults for all that is not given"
        ) from error


def _option(name: str) -> str:
    """Return a dimension's name as an option."""
    return f"--{name.replace('_', '-')}"


def _offered(one: Architecture, values: Values, mechanism: Mechanism, seed: int) -> Plan:
    """Return poses to choose from: where the machine works, or all that its readings reach."""
    if one.region is None:
        return sample_configurations(mechanism, _CANDIDATES, seed)
    low, high = one.region(values)
    poses = np.random.default_rng(seed).uniform(low, high, (4 * _CANDIDATES, len(low)))
    return Plan(poses[in_workspace(mechanism, poses)][:_CANDIDATES])


def _planned(
    mechanism: Mechanism, offered: Plan, size: PlanSize
) -> tuple[Plan, ConfigurationChoice]:
    """Return a plan in the order of measuring, with the readings there, and how good it is."""
    noise = Noise(reading=_READ if mechanism.redundant else 0.0)
    chosen = select_configurations(
        mechanism, offered, size.count, noise=noise, seed=size.seed, starts=_STARTS
    )
    plan = with_verification(mechanism, chosen.plan, offered, size.verify, size.seed)
    return in_turns(plan, size.seed), chosen


def _write(output: Path, mechanism: Mechanism, plan: Plan, *, force: bool) -> None:
    """Write mechanism, picture, plan and sheet into a folder, whole or not at all."""
    from pincal.show.pictures.picture import picture

    drawn = any(one.nominal for one in mechanism.parameters)
    readings = plan.readings
    if readings is None:
        readings = inverse(mechanism, plan.poses).readings
    with writing(output, force=force, folder=FOLDER) as scratch:
        write_mechanism(mechanism, scratch)
        picture(mechanism, dimensions=drawn).save(scratch / "picture.svg")
        write_plan(plan, scratch / "plan.csv", mechanism, units=WRITTEN)
        known = replace(plan, readings=readings)
        write_sheet(scratch / "sheet.csv", scratch / "columns.csv", mechanism, known)
