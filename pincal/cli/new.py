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
from pincal.cli.app import answer, command, remark, stderr, stdout, working, wrote
from pincal.cli.options import FORCE, SEED, output_option
from pincal.design.select import in_turns, with_verification
from pincal.design.select_configurations import ConfigurationChoice, select_configurations
from pincal.errors import MeasurementError, MechanismError
from pincal.files.measurement_writing import write_plan, write_sheet
from pincal.files.mechanism_folders import MECHANISM_FILES, write_mechanism
from pincal.files.output import refuse_existing, writing
from pincal.files.text import in_si
from pincal.kinematics.inverse import inverse
from pincal.model.measurements import Noise, Plan
from pincal.model.mechanism import Mechanism
from pincal.model.option import option
from pincal.model.units import WRITTEN
from pincal.show.pictures.picture import picture
from pincal.show.tables import choice_table
from pincal.workspace.criteria import in_workspace
from pincal.workspace.sampling import sample_configurations

#: Files in the folder beside the mechanism, and what they are.
DESCRIPTIONS = {
    "picture.svg": "a picture with dimensions",
    "plan.csv": "poses to measure",
    "sheet.csv": "the sheet to fill in",
}
FOLDER = (*MECHANISM_FILES, *DESCRIPTIONS)
_CANDIDATES, _STARTS = 1000, 5
_READ = 1e-4  # standard deviation of readings, where there are more than freedoms [m or rad]
_BARE = {"m": "mm", "rad": "deg"}


def _dimension_options() -> type[Any]:
    """Return all dimensions of all architectures as a group of options."""
    meanings: dict[str, list[str]] = defaultdict(list)
    units: dict[str, str] = {}
    for architecture in ARCHITECTURES.values():
        for dimension in architecture.dimensions:
            choices = f" ({' or '.join(dimension.choices)})" if dimension.choices else ""
            meanings[dimension.name].append(f"{architecture.name}: {dimension.label}{choices}")
            units.setdefault(dimension.name, dimension.unit)
    return make_dataclass(
        "DimensionOptions",
        [
            (
                name,
                (float if units[name] else str) | None,
                option(
                    None,
                    f"{'; '.join(meanings[name])}.",
                    metavar=None if units[name] else "TEXT",
                    unit=units[name],
                    needs_unit=True,
                ),
            )
            for name in meanings
        ],
        frozen=True,
    )


DimensionOptions = _dimension_options()


@dataclass(frozen=True)
class PlanSize:
    """How many poses are planned, and whether dimensions are asked for."""

    count: int = option(24, "Poses for the calibration.", least=1)
    verify: int = option(6, "Random poses beside them, to check it.", least=0)
    defaults: bool = option(False, "Ask nothing: what is not given is in proportion.")
    seed: int = option(0, SEED)
    force: bool = option(False, FORCE)


@command(answers=True)
def new(
    output: Annotated[Path, output_option("MECH", "Folder of the mechanism, plan and sheet.")],
    size: PlanSize,
    dimensions: DimensionOptions,  # type: ignore[valid-type]
    architecture: Annotated[
        str | None,
        typer.Argument(metavar="ARCHITECTURE", help=f"{', '.join(ARCHITECTURES)}; else asked."),
    ] = None,
) -> None:
    """Make a mechanism of your own from its dimensions.

    Writes a mechanism folder, and into it a picture with dimensions (picture.svg), poses to
    measure (plan.csv), and a sheet to fill in (sheet.csv).
    Dimensions that are not given are asked for, in mm and degrees.

    Then measure, fill in the sheet, and type 'pincal calibrate MECH MECH/sheet.csv -o RESULT'.
    """
    refuse_existing(output, force=size.force, folder=FOLDER)
    values = {name: value for name, value in asdict(dimensions).items() if value is not None}
    architecture = architecture or _ask("architecture", "hexapod", ", ".join(ARCHITECTURES))
    design = architecture_of(architecture)
    if foreign := sorted(values.keys() - {dimension.name for dimension in design.dimensions}):
        raise MechanismError(
            f"{_option(foreign[0])} is no dimension of a {design.name}; it has "
            f"{', '.join(_option(dimension.name) for dimension in design.dimensions)}"
        )
    if not size.defaults:
        values = _ask_dimensions(design, values, output)
    name = re.sub(r"\W+", "_", output.absolute().name).strip("_") or design.name
    mechanism = new_mechanism(design.name, name=name, **values)
    with working("choosing poses"):
        candidates = _candidates(design, design.complete(values), mechanism, size.seed)
        plan, chosen = _plan(mechanism, candidates, size)
    _write(output, mechanism, plan, force=size.force)
    stdout.print(mechanism.description)
    stdout.print(choice_table(mechanism, chosen))
    wrote(output)
    for file, description in DESCRIPTIONS.items():
        remark(f"  {file}: {description}")
    hold = "" if chosen.rank.complete else " --hold-undetermined"
    remark(f"then: pincal calibrate {output} {output / 'sheet.csv'}{hold} -o RESULT")
    answer(
        {
            "mechanism": mechanism.name,
            "folder": str(output),
            "dimensions": design.complete(values),
            "parameters": len(mechanism.parameters),
            "poses": len(plan),
            "efficiency": chosen.efficiency,
        }
    )


def _ask_dimensions(design: Architecture, values: dict[str, Any], output: Path) -> dict[str, Any]:
    """Return all dimensions, asking for those without a value, and say how to give them all."""
    complete: dict[str, Any] = {}
    for dimension in design.dimensions:
        value = values.get(dimension.name)
        if value is not None or not dimension.applies(complete):
            value = dimension.usual(complete) if value is None else value
            complete[dimension.name] = dimension.checked(value, complete)
            continue
        while dimension.name not in complete:
            usual = dimension.text(dimension.usual(complete))
            choices, name = ", ".join(dimension.choices), _option(dimension.name)
            text = _ask(dimension.label, usual, choices, name)
            try:
                bare = _BARE.get(dimension.unit)
                typed = in_si(text, dimension.unit, bare) if dimension.unit else text
                complete[dimension.name] = dimension.checked(typed, complete)
            except (MechanismError, MeasurementError) as error:
                stderr.print(str(error))
    if any(dimension.name not in values for dimension in design.dimensions):
        words = []
        for dimension in design.dimensions:
            if text := dimension.text(complete[dimension.name], typed=True):
                words += [_option(dimension.name), text]
        remark(f"the same again: {shlex.join(['pincal', 'new', design.name, *words])} -o {output}")
    return complete


def _ask(label: str, usual: str, choices: str = "", option: str = "ARCHITECTURE") -> str:
    """Return what is typed, or what is usual."""
    listed = f" ({choices})" if choices else ""
    stderr.print(f"{label}{listed}{f' [{usual}]' * bool(usual)}: ", end="")
    try:
        return input().strip() or usual
    except EOFError as error:
        raise typer.BadParameter(
            f"the {label} is not given: {option}, or --defaults for all that is not given"
        ) from error


def _option(name: str) -> str:
    """Return a dimension's name as an option."""
    return f"--{name.replace('_', '-')}"


def _candidates(design: Architecture, values: Values, mechanism: Mechanism, seed: int) -> Plan:
    """Return poses to choose from: where the machine works, or all that its readings reach."""
    if design.region is None:
        return sample_configurations(mechanism, _CANDIDATES, seed)
    low, high = design.region(values)
    poses = np.random.default_rng(seed).uniform(low, high, (4 * _CANDIDATES, len(low)))
    return Plan(poses[in_workspace(mechanism, poses)][:_CANDIDATES])


def _plan(
    mechanism: Mechanism, candidates: Plan, size: PlanSize
) -> tuple[Plan, ConfigurationChoice]:
    """Return a plan in the order of measuring, with the readings there, and how good it is."""
    noise = Noise(reading=_READ if mechanism.redundant else 0.0)
    chosen = select_configurations(
        mechanism, candidates, size.count, noise=noise, seed=size.seed, starts=_STARTS
    )
    plan = with_verification(mechanism, chosen.plan, candidates, size.verify, size.seed)
    return in_turns(plan, size.seed), chosen


def _write(output: Path, mechanism: Mechanism, plan: Plan, *, force: bool) -> None:
    """Write mechanism, picture, plan and sheet into a folder, whole or not at all."""
    drawn = any(parameter.nominal for parameter in mechanism.parameters)
    readings = plan.readings
    if readings is None:
        readings = inverse(mechanism, plan.poses).readings
    with writing(output, force=force, folder=FOLDER) as scratch:
        write_mechanism(mechanism, scratch)
        picture(mechanism, dimensions=drawn).save(scratch / "picture.svg")
        write_plan(plan, scratch / "plan.csv", mechanism, units=WRITTEN)
        write_sheet(scratch / "sheet.csv", mechanism, replace(plan, readings=readings))
