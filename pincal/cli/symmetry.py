"""``pincal symmetry``: which isometries leave a mechanism as it is, and what breaks the others."""

from __future__ import annotations

from math import pi
from typing import Annotated

import typer

from pincal.cli.app import Mech, app, stdout, working
from pincal.errors import SymmetryError
from pincal.model.files import load_mechanism
from pincal.show.tables import symmetry_table
from pincal.symmetry.detect import symmetry_group
from pincal.symmetry.elements import Element
from pincal.workspace.sampling import sample_workspace


@app.command()
def symmetry(
    mech: Mech,
    group: Annotated[
        str | None,
        typer.Option(metavar="D2n", help="Claim a dihedral group, such as D6: fail if it is not."),
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
    mechanism = load_mechanism(mech)
    found = symmetry_group(mechanism, tolerance)
    with working("checking readings on sampled poses"):
        off = found.equivariance(sample_workspace(mechanism, 300))
    stdout.print(symmetry_table(found, off))
    if group is not None:
        _claim(group, [str(element) for element in found.elements], found.breaks)


def _claim(group: str, present: list[str], breaks: tuple[object, ...]) -> None:
    """Raise if rotations or mirrors of a dihedral group D_2n are missing."""
    order = group[1:].lstrip("_")
    if group[:1] not in ("D", "d") or not order.isdigit() or int(order) < 2 or int(order) % 2:
        raise typer.BadParameter(f"--group {group}: expected D and twice n, such as D6 for n = 3")
    n = int(order) // 2
    wanted = [str(Element(2 * pi * k / n)) for k in range(n)]
    missing = [text for text in wanted if text not in present]
    mirrors = sum(text.startswith("mirror") for text in present)
    if mirrors < n:
        missing.append(f"{n - mirrors} of {n} mirrors")
    if missing:
        why = "; ".join(str(b) for b in breaks)
        raise SymmetryError(f"not the group {group}: {', '.join(missing)} missing ({why})")
