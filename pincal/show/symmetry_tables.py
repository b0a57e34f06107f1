"""Symmetry in tables: elements, what breaks them, the nearest group, products and subgroups."""

from __future__ import annotations

from collections import Counter

from pincal.symmetry.breaks import no_symmetries
from pincal.symmetry.detect import NearestGroup, SymmetryGroup
from pincal.words.numbers import amount, counted
from pincal.words.table import Column, Table


def symmetry_table(group: SymmetryGroup, equivariance: float, near: NearestGroup) -> Table:
    """Return a group's elements, where they carry the legs, what breaks others, how nearly."""
    names = group.mechanism.leg_names
    lines = [f"readings follow within {equivariance:.2g} (Eq. 5: F(λ q) = λ F(q))"]
    lines += [f"no symmetry: {text}" for text in no_symmetries(group.breaks)]
    if len(near.group.elements) > 1:
        lines.append(_nearness(near))
    size = f"{group.name}, {counted(len(group.elements), 'element')}"
    return Table(
        f"{group.mechanism.name}: {size}, nominal geometry and modes",
        (Column("element"), *(Column(f"{name} to") for name in names)),
        [
            (str(element), *(names[i] for i in permutation))
            for element, permutation in zip(group.elements, group.permutations, strict=True)
        ],
        "\n".join(lines),
        wrap=False,
    )


def near_table(near: NearestGroup) -> Table:
    """Return how far a mechanism is from the group that it nearly has, element by element."""
    group = near.group
    return Table(
        f"{group.mechanism.name}: nearest group {group.name}, "
        f"{counted(len(group.elements), 'element')}",
        (Column("element"), Column("legs' points off", "m"), Column("axes off", "rad")),
        [
            (str(element), points, axes)
            for element, (points, axes) in zip(group.elements, near.each, strict=True)
        ],
        "readings are not compared",
    )


def _nearness(near: NearestGroup) -> str:
    """Return how far a mechanism is from the nearest group, as a sentence."""
    size = f"{near.group.name}, {counted(len(near.group.elements), 'element')}"
    return (
        f"nearest group {size}: leg points are off by {amount(near.displacement, 'm')} at most, "
        f"axes by {amount(near.turn, 'rad')}"
    )


def group_table(group: SymmetryGroup) -> tuple[Table, Table]:
    """Return the products of a group's elements, and its generators, subgroups and orbits."""
    count = len(group.elements)
    letters = ["e", *(f"g{i}" for i in range(1, count))]
    products = Table(
        f"{group.name}: products, first the column's element, then the row's",
        (Column(""), *(Column(letter) for letter in letters), Column("is")),
        [
            (letters[a], *(letters[int(b)] for b in row), str(group.elements[a]))
            for a, row in enumerate(group.table)
        ],
        wrap=False,
    )
    parts = group.subgroups()
    alike = Counter((part.name, count // len(part.elements)) for part in parts)
    facts = [
        ("generators", "; ".join(map(str, group.generators)) or "none"),
        *((f"orbit of {len(orbit)}", ", ".join(orbit)) for orbit in group.leg_orbits),
        *(
            (f"subgroup {name}", f"{times} of index {index}")
            for (name, index), times in alike.items()
        ),
    ]
    return products, Table("generators, legs, subgroups", (Column("what"), Column("is")), facts)
