"""``pincal symmetry``: which isometries leave a mechanism as it is, and what breaks the others."""

from __future__ import annotations

from math import pi
from typing import Annotated

import typer

from pincal.cli.app import Mech, answer, command, stdout, working
from pincal.errors import SymmetryError
from pincal.files.mechanism_folders import load_mechanism
from pincal.show.tables import symmetry_table
from pincal.symmetry.detect import SymmetryGroup, symmetry_group
from pincal.symmetry.elements import Element
from pincal.workspace.sampling import sample_workspace


@command(answers=True)
def symmetry(
    mech: Mech,
    group: Annotated[
        str | None,
        typer.Option(metavar="D2n|Cn", help="Claim a group, such as D6 or C3: fail if it is not."),
    ] = None,
    tolerance: Annotated[
        float, typer.Option(min=0.0, help="Largest deviation, relative to a leg's size or [rad].")
    ] = 1e-6,
) -> None:
    """Find the symmetry group of a mechanism.

    Prints where each element carries the legs, how well readings follow (equivariance, on
    sampled poses), and what breaks the elements that fail. With --group the exit code is 2
    if the mechanism lacks an element of that group.
    """
    wanted = _parsed(group) if group is not None else None
    mechanism = load_mechanism(mech)
    found = symmetry_group(mechanism, tolerance)
    with working("checking readings on sampled poses"):
        off = found.equivariance(sample_workspace(mechanism, 300))
    stdout.print(symmetry_table(found, off))
    answer(
        {
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
        }
    )
    if wanted:
        _claim(wanted, found)


def _parsed(group: str) -> tuple[int, bool]:
    """Return the number of rotations of a claimed group, and whether it has mirrors."""
    letter, order = group[:1].upper(), group[1:].lstrip("_")
    least = {"D": 2, "C": 1}.get(letter, 0)
    if not least or not order.isdigit() or int(order) < least or int(order) % least:
        raise typer.BadParameter(
            f"--group {group}: expected D and its order, twice the number of rotations, such as D6 "
            "for three rotations and three mirrors; or C and the number of rotations, such as C3"
        )
    return int(order) // least, letter == "D"


def _claim(wanted: tuple[int, bool], found: SymmetryGroup) -> None:
    """Raise if elements of a claimed group are missing."""
    n, mirrored = wanted
    present = [str(element) for element in found.elements]
    rotations = [str(Element(2 * pi * k / n)) for k in range(n)]
    missing = [text for text in rotations if text not in present]
    mirrors = sum(element.reflection for element in found.elements)
    if mirrored and mirrors < n:
        missing.append(f"{n - mirrors} of {n} mirrors")
    if missing:
        name = f"D{2 * n}" if mirrored else f"C{n}"
        why = "; ".join(str(b) for b in found.breaks) or "nothing near suggests it"
        raise SymmetryError(
            f"not the group {name} but {found.name}: {', '.join(missing)} missing ({why})"
        )
