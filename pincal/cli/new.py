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

from pincal.architectures.dimension import Architecture, Values, sized
from pincal.architectures.new import ARCHITECTURES, architecture_of, new_mechanism
from pincal.cli.app import command, remark, stdout, working, wrote
from pincal.cli.options import FORCE, SEED, output_option
from pincal.design.order import in_turns, with_verification
from pincal.design.select_configurations import ConfigurationChoice, select_configurations
from pincal.files.measurement_writing import columns_of, write_sheet
from pincal.files.mechanism_folders import MECHANISM_FILES, write_mechanism
from pincal.files.output import refuse_existing, writing
from pincal.files.table import write_table
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
    """How many poses are planned."""

    count: int = option(24, "Poses for the calibration.", least=1)
    verify: int = option(6, "Random poses beside them, to check it.", least=0)
    seed: int = option(0, SEED)
    force: bool = option(False, FORCE)


@command()
def new(
    architecture: Annotated[
        str, typer.Argument(metavar="ARCHITECTURE", help=f"{', '.join(ARCHITECTURES)}.")
    ],
    output: Annotated[Path, output_option("MECH", "Folder of the mechanism, plan and sheet.")],
    size: PlanSize,
    dimensions: DimensionOptions,  # type: ignore[valid-type]
) -> None:
    """Make a mechanism of your own from its dimensions.

    Writes a mechanism folder, and into it a picture with dimensions (picture.svg), poses to
    measure (plan.csv), and a sheet to fill in (sheet.csv). Dimensions that are not given are in
    proportion to those that are; the line that is printed says all of them.

    Then measure, fill in the sheet, and type 'pincal calibrate MECH MECH/sheet.csv -o RESULT'.
    """
    refuse_existing(output, force=size.force, folder=FOLDER)
    design = architecture_of(architecture)
    given = {name: value for name, value in asdict(dimensions).items() if value is not None}
    values = design.complete(given)
    name = re.sub(r"\W+", "_", output.absolute().name).strip("_") or design.name
    mechanism = new_mechanism(design.name, name=name, **values)
    with working("choosing poses"):
        plan, chosen = _plan(mechanism, _candidates(design, values, mechanism, size.seed), size)
    with writing(output, force=size.force, folder=FOLDER) as scratch:
        write_mechanism(mechanism, scratch)
        drawn = any(parameter.nominal for parameter in mechanism.parameters)
        picture(mechanism, dimensions=mechanism.leg_names[0] if drawn else "").save(
            scratch / "picture.svg"
        )
        write_table(scratch / "plan.csv", columns_of(mechanism, plan), units=WRITTEN)
        if plan.readings is None:
            plan = replace(plan, readings=inverse(mechanism, plan.poses).readings)
        write_sheet(scratch / "sheet.csv", mechanism, plan)
    stdout.print(mechanism.description)
    stdout.print(choice_table(mechanism, chosen))
    if len(given) < len(values):
        words = ["pincal", "new", design.name]
        for dimension in design.dimensions:
            value, unit = values[dimension.name], dimension.unit
            if text := sized(float(value), unit, ".12g", "") if unit else str(value):
                words += [f"--{dimension.name.replace('_', '-')}", text]
        remark(f"some dimensions are in proportion; all of them: {shlex.join(words)} -o {output}")
    wrote(output)
    for file, description in DESCRIPTIONS.items():
        remark(f"  {file}: {description}")
    remark(f"then: pincal calibrate {output} {output / 'sheet.csv'} -o RESULT")


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
