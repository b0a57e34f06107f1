"""``pincal mechanisms``, ``check`` and ``symmetry``: what there is, and what it is like."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from pincal.cli.app import command, remark, stdout, warn, working, wrote
from pincal.cli.options import Force, Mech, Seed, UnitOptions, output_option
from pincal.errors import FileError, SymmetryError
from pincal.estimation.observability.indices import identifiability
from pincal.files.mechanism_folders import bundled, load_mechanism
from pincal.files.output import refuse_existing, writing
from pincal.kinematics.closing import sensor_law
from pincal.kinematics.closure import LegClosure, joint_range
from pincal.kinematics.derivatives import leg_demand
from pincal.kinematics.readers import tips_by_reader
from pincal.model.leg import Leg
from pincal.model.measurements import Plan
from pincal.model.mechanism import Mechanism
from pincal.show.tables import nominal_table, symmetry_table
from pincal.symmetry.breaks import no_symmetries
from pincal.symmetry.detect import SymmetryGroup, symmetry_group
from pincal.symmetry.elements import cyclic
from pincal.words.numbers import reading_in
from pincal.workspace.sampling import sample_configurations, sample_workspace


@command()
def mechanisms() -> None:
    """List the mechanisms that come with pincal."""
    for name, folder in bundled().items():
        mechanism = load_mechanism(folder)
        coordinates = ", ".join(mechanism.platform.coordinates)
        stdout.print(f"{name:12s} {len(mechanism.legs)} legs, {coordinates}")
        stdout.print(f"{'':12s} {mechanism.description}")


@command()
def check(mech: Mech, options: UnitOptions) -> None:
    """Say whether a mechanism is sound.

    Loops closed at home, URDFs read alike by others, parameters observable, symmetry.
    """
    mechanism = load_mechanism(mech)
    with reading_in(options.written_in(mechanism).printed):
        stdout.print(nominal_table(mechanism))
    for leg in mechanism.legs:
        _check_closure(leg, mechanism)
    with working("sampling the workspace"):
        plan = sample_configurations(mechanism, 500)
    for index, leg in enumerate(mechanism.legs):
        _check_observability(index, leg, mechanism, plan)
    if len(mechanism.legs) > 1:
        stdout.print(f"symmetry: {symmetry_group(mechanism)}")


def _check_closure(leg: Leg, mechanism: Mechanism) -> None:
    """Say how well a leg closes at home, and whether others read its URDF alike."""
    closure = LegClosure(leg, mechanism.platform)
    home = mechanism.platform.home_pose.as_matrix()
    gap = float(np.abs(closure.evaluate(leg.home[None], home).gap).max())
    tips, expected = tips_by_reader(leg), closure.tips(leg.home[None])[0]
    difference = max(float(np.abs(tip - expected).max()) for tip in tips.values())
    close = f"closes at home within {gap:.2g} m"
    if gap > 1e-2 * closure.size:
        close = f"home is rough, it closes within {gap:.2g} m only and fixes the side of bending"
    stdout.print(f"{leg.name}: {close}")
    stdout.print(f"{leg.name}: URDF read alike by {' and '.join(tips)} within {difference:.2g} m")
    warn_of_turns(closure)


def _check_observability(index: int, leg: Leg, mechanism: Mechanism, plan: Plan) -> None:
    """Say which parameters of a leg full poses determine."""
    columns = mechanism.reading_columns[index]
    readings = None if plan.readings is None else plan.readings[:, columns]
    rows = leg_demand(mechanism.at_reference, leg.name, plan.poses, readings=readings)
    if rows.value.shape[1] == len(leg.sensors):
        rows = rows.as_joint()
    names = leg.at_reference.parameter_names
    jacobian = rows.parameter.reshape(-1, len(names))
    rank = identifiability(jacobian, [f"{leg.name}.{name}" for name in names])
    words = "" if rank.complete else f": {rank.describe()}"
    if influenced := [name for name in leg.parameter_names if name not in names]:
        words += f"; {', '.join(influenced)} by columns {', '.join(leg.influences)}"
    stdout.print(
        f"{leg.name}: {rank.rank} of {rank.n_params} parameters observable from full poses "
        f"(condition {rank.condition:.3g}){words}"
    )


def warn_of_turns(closure: LegClosure) -> None:
    """Say at which reading q(ψ) of a leg's sensors turns back, if it does."""
    leg = closure.leg
    turns = sensor_law(closure).turning(*(end[leg.active] for end in joint_range(leg)))
    for name, unit, reading in zip(leg.reading_names, leg.reading_units, turns, strict=True):
        if np.isfinite(reading):
            warn(
                f"{name}: with its terms the joint turns back at a reading of {reading:.4g} "
                f"{unit}, so that readings mean two positions; give smaller amplitudes, or a "
                "narrower range of the joint"
            )


@command()
def symmetry(
    mech: Mech,
    group: Annotated[
        str | None,
        typer.Option(metavar="D2n|Cn", help="Claim a group, such as D6 or C3: fail if it is not."),
    ] = None,
    tolerance: Annotated[
        float, typer.Option(min=0, help="Largest deviation, relative to its size or [rad].")
    ] = 1e-6,
) -> None:
    """Find the symmetry group of a mechanism.

    Prints where each element carries the legs, how well readings follow (equivariance, on
    sampled poses), and what breaks the elements that fail. With --group the exit code is 2 if
    the mechanism lacks an element of that group.
    """
    claimed = group and _parse_group(group)
    mechanism = load_mechanism(mech)
    detected = symmetry_group(mechanism, tolerance)
    with working("checking readings on sampled poses"):
        deviation = detected.equivariance(sample_workspace(mechanism, 300))
    stdout.print(symmetry_table(detected, deviation))
    if claimed:
        _check_claim(*claimed, detected)


def _parse_group(group: str) -> tuple[int, bool]:
    """Return the number of rotations of a claimed group, and whether it has mirrors."""
    match = re.fullmatch(r"([CD])_?([1-9]\d{0,2})", group, re.ASCII | re.IGNORECASE)
    mirrored = match is not None and match[1] in "dD"
    if match is None or (mirrored and int(match[2]) % 2):
        raise typer.BadParameter(
            f"--group {group}: expected D and its order, twice the number of rotations, such as D6 "
            "for three rotations and three mirrors; or C and the number of rotations, such as C3"
        )
    return int(match[2]) // (1 + mirrored), mirrored


def _check_claim(order: int, mirrored: bool, group: SymmetryGroup) -> None:
    """Raise if elements of a claimed group, about the axis of the mechanism's own, are missing."""
    name = f"D{2 * order}" if mirrored else f"C{order}"
    if any(subgroup.name == name for subgroup in group.subgroups()):
        return
    present = {str(element) for element in group.elements}
    missing = [text for text in map(str, cyclic(order)) if text not in present]
    mirrors = sum(element.reflection for element in group.elements)
    if mirrored and mirrors < order:
        missing.append(f"{order - mirrors} of {order} mirrors")
    reason = "; ".join(no_symmetries(group.breaks)) or "nothing near suggests it"
    raise SymmetryError(
        f"not the group {name} but {group.name}: {', '.join(missing) or 'elements'} missing "
        f"({reason})"
    )


STUDY = "study.md"
_ROOT = Path(__file__).resolve().parents[2]


@command()
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
    installed = [n for n in ("pincal_studies", "studies") if (_ROOT / n / "catalogue.py").is_file()]
    if not installed:
        raise FileError(
            f"the papers' studies are not installed: no folder pincal_studies or studies in {_ROOT}"
            "; install pincal from its wheel, or run this in its sources"
        )
    studies = import_module(f"{installed[0]}.catalogue")
    folders = dict.fromkeys(studies.named(name), output)
    if name == "all":
        folders = {study_name: output / study_name for study_name in folders}
        if not output.is_dir():
            refuse_existing(output, force=False).mkdir()
    for folder in folders.values():
        refuse_existing(folder, force=force, folder=(STUDY,))
    for study_name, folder in folders.items():
        with working(f"study of the {study_name}") as progress:
            result = studies.run_study(study_name, seed, quick, progress)
        with writing(folder, force=force, folder=(STUDY,)) as scratch:
            result.write(scratch)
        wrote(folder)
    remark(f"read {next(iter(folders.values())) / STUDY}")
