"""Serial arms: from a URDF, or from a table of Denavit and Hartenberg."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pincal.architectures.dimension import Architecture, Dimension, Values
from pincal.errors import MechanismError
from pincal.files.tables.table import is_dataframe
from pincal.files.tables.table_reading import read_table
from pincal.formats.arm import arm, load_arm
from pincal.model.joint import Joint
from pincal.model.mechanism import Mechanism
from pincal.model.placement import Step, placement_of

Array = NDArray[np.float64]


def dh_joints(table: Any, convention: str = "standard") -> tuple[Joint, ...]:
    """Return the joints of a table of Denavit and Hartenberg, the tool's frame last.

    Row i of the standard convention is Rz(θ) Tz(d) Tx(a) Rx(α), turned by its joint about z first;
    of the modified one (Craig) Rx(α) Tx(a) Rz(θ) Tz(d), turned about z behind Tx(a).

    Args:
        table: CSV file or pandas DataFrame of revolute joints: ``a [mm]``, ``alpha [deg]``,
            ``d [mm]``, ``theta [deg]`` (where the joint reads zero); if wanted ``lower [deg]`` and
            ``upper [deg]``, limits.
        convention: ``"standard"`` or ``"modified"``.

    Raises:
        FileError: the table is missing or cannot be read.
        MeasurementError: a column or cell that is missing or wrong; the message says where.
    """
    read = read_table(table)
    units = {"a": "m", "alpha": "rad", "d": "m", "theta": "rad"}
    rows = np.column_stack([read.numbers(name, unit) for name, unit in units.items()])
    limits = [
        read.numbers(name, "rad") if name in read else np.full(len(rows), usual)
        for name, usual in (("lower", -pi), ("upper", pi))
    ]
    left, joints = np.eye(4), []
    for number, ((a, alpha, d, theta), lower, upper) in enumerate(
        zip(rows.tolist(), *map(Array.tolist, limits), strict=True), start=1
    ):
        turn, lift = _moved(("rz", theta)), _moved(("z", d))
        link = _moved(("x", a), ("rx", alpha)) if convention == "standard" else np.eye(4)
        before = np.eye(4) if convention == "standard" else _moved(("rx", alpha), ("x", a))
        place = placement_of(left @ before @ turn)
        joints.append(Joint(f"joint_{number}", "revolute", place, lower=lower, upper=upper))
        left = lift @ link
    return (*joints, Joint("tip", "fixed", placement_of(left)))


def _moved(*steps: tuple[str, float]) -> Array:
    """Return displacements along and about axes, one after the other, shape (4, 4)."""
    found = np.eye(4)
    for axis, value in steps:
        found = found @ Step(axis, value).matrix({})
    return found


def _arm(d: Values) -> Mechanism:
    """Return the arm of a URDF, or of a table."""
    table = d["dh"] if is_dataframe(d["dh"]) else d["dh"] or None
    if bool(d["urdf"]) == (table is not None):
        raise MechanismError("an arm is made of one: urdf, with tip; or dh, a table")
    if table is not None:
        what = f"Serial arm of a table of Denavit and Hartenberg, {d['convention']} convention."
        return arm("arm", dh_joints(table, d["convention"]), what)
    if not d["tip"]:
        raise MechanismError(f"{d['urdf']}: name the link whose frame is measured (tip)")
    return load_arm(d["urdf"], d["tip"], d["base"] or None)


ARM = Architecture(
    "arm",
    "Serial arm",
    (
        Dimension("urdf", "URDF file", ""),
        Dimension("tip", "link whose frame is measured", "", goes_with="urdf"),
        Dimension("base", "link at the foot, if not the root", "", goes_with="urdf"),
        Dimension("dh", "CSV table of Denavit and Hartenberg", "", instead_of="urdf"),
        Dimension(
            "convention",
            "convention of the table",
            "",
            "standard",
            goes_with="dh",
            choices=("standard", "modified"),
        ),
    ),
    _arm,
)
