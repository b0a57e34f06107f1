"""``pincal mechanisms``, ``check`` and ``symmetry``: what there is, and what it is like."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from pincal.cli.app import (
    Force,
    Mech,
    Seed,
    answer,
    command,
    output_option,
    remark,
    stdout,
    warn,
    working,
    wrote,
)
from pincal.cli.options import UnitOptions
from pincal.errors import FileError, SymmetryError
from pincal.estimation.observability.indices import identifiability
from pincal.files.mechanism_folders import bundled, load_mechanism
from pincal.files.output import refuse_existing, writing
from pincal.kinematics.closing import sensor_law
from pincal.kinematics.closure import LegClosure, joint_range
from pincal.kinematics.derivatives import leg_demand
from pincal.kinematics.readers import tips_by_reader
from pincal.model.sensor import turning
from pincal.show.tables import group_table, near_table, nominal_table, symmetry_table
from pincal.symmetry.breaks import no_symmetries
from pincal.symmetry.detect import SymmetryGroup, nearest_group, symmetry_group
from pincal.symmetry.elements import cyclic
from pincal.words.numbers import reading_in
from pincal.words.parameters import TURNS_BACK
from pincal.workspace.sampling import sample_configurations, sample_workspace


@command(answers=True)
def mechanisms() -> None:
    """List the mechanisms that come with pincal."""
    found = []
    for name, folder in bundled().items():
        mechanism = load_mechanism(folder)
        legs, platform = len(mechanism.legs), mechanism.platform
        stdout.print(f"{name:12s} {legs} legs, {', '.join(platform.coordinates)}", markup=False)
        stdout.print(f"{'':12s} {mechanism.description}", markup=False)
        coordinates = dict(zip(platform.coordinates, platform.units, strict=True))
        found.append(
            {
                "name": name,
                "legs": mechanism.leg_names,
                "coordinates": coordinates,
                "description": mechanism.description,
            }
        )
    answer({"mechanisms": found})


@command(answers=True)
def check(mech: Mech, how: UnitOptions) -> None:
    """Say whether a mechanism is sound.

    Loops closed at home, URDFs read alike by others, parameters observable, symmetry.
    """
    mechanism = load_mechanism(mech)
    with reading_in(how.written_in(mechanism).printed):
        stdout.print(nominal_table(mechanism))
    platform, legs = mechanism.platform, []
    home = platform.home_pose.as_matrix()
    for leg in mechanism.legs:
        closure = LegClosure(leg, platform)
        gap = float(np.abs(closure.evaluate(leg.home[None], home).gap).max())
        tips = tips_by_reader(leg)
        own = closure.tips(leg.home[None])[0]
        off = max(float(np.abs(tip - own).max()) for tip in tips.values())
        close = f"closes at home within {gap:.2g} m"
        if gap > 1e-2 * closure.size:
            close = (
                f"home is rough, it closes within {gap:.2g} m only and fixes the side of bending"
            )
        stdout.print(f"{leg.name}: {close}", markup=False)
        readers = " and ".join(tips)
        stdout.print(f"{leg.name}: URDF read alike by {readers} within {off:.2g} m", markup=False)
        legs.append({"name": leg.name, "home_gap": gap, "readers_differ_by": off})
        legs[-1]["turns_back_at"] = warn_of_turns(closure)
    with working("sampling the workspace"):
        plan = sample_configurations(mechanism, 500)
    for leg, own_answer, own in zip(mechanism.legs, legs, mechanism.reading_columns, strict=True):
        readings = None if plan.readings is None else plan.readings[:, own]
        still = leg.at_reference
        rows = leg_demand(mechanism.at_reference, leg.name, plan.poses, readings=readings)
        if rows.value.shape[1] == len(leg.sensors):
            rows = rows.as_joint()
        C = rows.parameter.reshape(-1, len(still.parameters))
        found = identifiability(C, [f"{leg.name}.{name}" for name in still.parameter_names])
        words = "" if found.complete else f": {found.describe()}"
        if more := [name for name in leg.parameter_names if name not in still.parameter_names]:
            words += f"; {', '.join(more)} by columns {', '.join(leg.influences)}"
        stdout.print(
            f"{leg.name}: {found.rank} of {found.n_params} parameters observable from full poses "
            f"(condition {found.condition:.3g}){words}",
            markup=False,
        )
        own_answer |= {
            "parameters": dict(zip(leg.parameter_names, leg.nominal.tolist(), strict=True)),
            "rank": found.rank,
            "condition": found.condition,
            "not_separable": found.groups,
        }
    group = symmetry_group(mechanism)
    if len(mechanism.legs) > 1:
        stdout.print(f"symmetry: {group}", markup=False)
    answer(
        {
            "mechanism": mechanism.name,
            "legs": legs,
            "labels": mechanism.used_labels,
            "symmetry": group.name,
        }
    )


def warn_of_turns(closure: LegClosure) -> list[float]:
    """Say where q(ψ) of a leg's sensors turns back; return the readings, NaN where it does not."""
    leg = closure.leg
    turns = turning(sensor_law(closure), *(end[leg.active] for end in joint_range(leg)))
    for reading, unit, where in zip(leg.reading_names, leg.reading_units, turns, strict=True):
        if np.isfinite(where):
            warn(TURNS_BACK.format(reading=reading, unit=unit, where=where))
    return [float(one) for one in turns]


@command(answers=True)
def symmetry(
    mech: Mech,
    group: Annotated[
        str | None,
        typer.Option(metavar="D2n|Cn", help="Claim a group, such as D6 or C3: fail if it is not."),
    ] = None,
    tolerance: Annotated[
        float, typer.Option(min=0.0, help="Largest deviation, relative to its size or [rad].")
    ] = 1e-6,
    table: Annotated[
        bool, typer.Option("--table", help="Also products, generators, subgroups and orbits.")
    ] = False,
) -> None:
    """Find the symmetry group of a mechanism.

    Prints where each element carries the legs, how well readings follow (equivariance, on
    sampled poses), what breaks the elements that fail, and how far the mechanism is from the
    largest group that it nearly has. With --group the exit code is 2 if the mechanism lacks an
    element of that group.
    """
    wanted = _parsed(group) if group is not None else None
    mechanism = load_mechanism(mech)
    found = symmetry_group(mechanism, tolerance)
    with working("checking readings on sampled poses"):
        off = found.equivariance(sample_workspace(mechanism, 300))
    near = nearest_group(mechanism)
    stdout.print(symmetry_table(found, off, near))
    if len(near.group.elements) > len(found.elements):
        stdout.print(near_table(near))
    answers: dict[str, Any] = {
        "mechanism": mechanism.name,
        "group": found.name,
        "elements": [
            {
                "element": str(element),
                "carries": dict(
                    zip(mechanism.leg_names, (mechanism.leg_names[i] for i in to), strict=True)
                ),
            }
            for element, to in zip(found.elements, found.permutations, strict=True)
        ],
        "readings_follow_within": off,
        "broken": [str(one) for one in found.breaks],
        "nearest": {
            "group": near.group.name,
            "displacement": near.displacement,
            "turn": near.turn,
        },
    }
    if table:
        for one in group_table(found):
            stdout.print(one)
        answers |= {
            "table": found.table.tolist(),
            "generators": [str(element) for element in found.generators],
            "leg_orbits": found.leg_orbits,
        }
    answer(answers)
    if wanted:
        _claim(wanted, found)


def _parsed(group: str) -> tuple[int, bool]:
    """Return the number of rotations of a claimed group, and whether it has mirrors."""
    letter, order = group[:1].upper(), group[1:].lstrip("_")
    least = {"D": 2, "C": 1}.get(letter, 0)
    counted = order.isdecimal() and len(order) <= 3  # no machine has a thousand legs
    if not least or not counted or int(order) < least or int(order) % least:
        raise typer.BadParameter(
            f"--group {group}: expected D and its order, twice the number of rotations, such as D6 "
            "for three rotations and three mirrors; or C and the number of rotations, such as C3"
        )
    return int(order) // least, letter == "D"


def _claim(wanted: tuple[int, bool], found: SymmetryGroup) -> None:
    """Raise if elements of a claimed group are missing.

    The axis is that of the mechanism's own group, wherever it is.
    """
    n, mirrored = wanted
    name = f"D{2 * n}" if mirrored else f"C{n}"
    if any(part.name == name for part in found.subgroups()):
        return
    present = [str(element) for element in found.elements]
    missing = [text for text in map(str, cyclic(n)) if text not in present]
    mirrors = sum(element.reflection for element in found.elements)
    if mirrored and mirrors < n:
        missing.append(f"{n - mirrors} of {n} mirrors")
    why = "; ".join(no_symmetries(found.breaks)) or "nothing near suggests it"
    raise SymmetryError(
        f"not the group {name} but {found.name}: {', '.join(missing) or 'elements'} missing ({why})"
    )


STUDY = "study.md"
_BESIDE = Path(__file__).resolve().parents[3]


@command(answers=True)
def study(
    name: Annotated[str, typer.Argument(metavar="5R|3RRR|6UPS|errors|all", help="Which study.")],
    output: Annotated[Path, output_option("FOLDER", "Page, tables and figures.")],
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer draws, coarser grids: seconds, not minutes.")
    ] = False,
    seed: Seed = 0,
    force: Force = False,
) -> None:
    """Compute a paper's figures and tables anew.

    And what it lacks. 5R: divide and conquer; 3RRR: symmetrical observability; 6UPS: symmetrical
    workspace and, after its paper, the calibration. errors: errors that are no geometry,
    simulated and, where PINCAL_DATA has them, of real arms. FOLDER gets study.md, tables as
    CSV, figures as SVG and PNG; with 'all' one folder for each. The same seed
    gives the same text and tables; times are in figures only.
    """
    studies = _installed()
    names = studies.named(name)
    folders = [output / one for one in names] if name == "all" else [output]
    if name == "all" and not output.is_dir():
        refuse_existing(output, force=False).mkdir()
    for folder in folders:
        refuse_existing(folder, force=force, folder=(STUDY,))
    found = []
    for one, folder in zip(names, folders, strict=True):
        with working(f"study of the {one}") as progress:
            done = studies.run_study(one, seed, quick, progress)
        with writing(folder, force=force, folder=(STUDY,)) as scratch:
            done.write(scratch)
        wrote(folder)
        kept = {key: getattr(done, key) for key in ("name", "title", "paper", "tables")}
        found.append({**kept, "folder": str(folder)})
    remark(f"read {folders[0] / 'study.md'}")
    answer({"studies": found})


def _installed() -> Any:
    """Return the catalogue of the studies, which stand beside pincal: installed or as sources.

    Raises:
        FileError: they are not there.
    """
    for name in ("pincal_studies", "studies"):
        if (_BESIDE / name / "catalogue.py").is_file():
            return import_module(f"{name}.catalogue")
    raise FileError(
        f"the papers' studies are not installed: no folder pincal_studies or studies in {_BESIDE}; "
        "install pincal from its wheel, or run this in its sources"
    )
