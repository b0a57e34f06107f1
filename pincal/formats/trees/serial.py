"""A serial arm out of a tree: the chain of joints to one of its links."""

from __future__ import annotations

import re
from pathlib import Path

from pincal.errors import MechanismError
from pincal.formats.arm import arm
from pincal.formats.trees.tree import Tree
from pincal.model.joint import Joint
from pincal.model.mechanism import Mechanism


def serial_arm(tree: Tree, tip: str, base: str | None = None) -> Mechanism:
    """Return the serial arm between two links of a tree; loops are left out.

    Raises:
        MechanismError: no such link, or no chain of joints from base to tip.
    """
    link = tree.link(tip, "the tip")
    foot = tree.root if base is None else tree.link(base, "the base")
    carrying = {edge.child: edge for edge in tree.edges}
    joints: list[Joint] = []
    while link != foot and link in carrying:
        joints.append(carrying[link].joint)
        link = carrying[link].parent
    if link != foot:
        raise MechanismError(f"{tree.source}: no chain of joints leads from {base!r} to {tip!r}")
    name = re.sub(r"\W", "_", tree.name)
    return arm(name, tuple(reversed(joints)), f"Serial arm to {tip} of {Path(tree.source).name}.")
