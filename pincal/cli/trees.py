"""What ``pincal import`` and ``export`` do with URDF and MJCF: trees of links with loops."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

from pincal.cli.app import remark, stdout, warn, wrote
from pincal.errors import FileError, MechanismError
from pincal.files.mechanism_folders import save_mechanism
from pincal.files.output import refuse_existing, writing
from pincal.files.urdf import turns_beyond
from pincal.formats.trees.calibrated_urdf import calibrated_urdf
from pincal.formats.trees.closed import closed_mechanism
from pincal.formats.trees.drawn import closing_in_words
from pincal.formats.trees.loops_yaml import read_loops
from pincal.formats.trees.mjcf import read_mjcf
from pincal.formats.trees.serial import serial_arm
from pincal.formats.trees.tree_mjcf import mjcf
from pincal.formats.trees.tree_of import tree_of, unwritten
from pincal.formats.trees.tree_urdf import loops_urdf, loops_yaml
from pincal.kinematics.arm import load_arm
from pincal.kinematics.closure import largest_size
from pincal.model.mechanism import Mechanism

TREES = ("urdf", "mjcf")
_LARGE = 20.0  # [m]


def import_tree(
    file: Path,
    output: Path,
    whose: str,
    *,
    loops: Path | None,
    platform: str | None,
    tip: str | None,
    base: str | None,
    force: bool,
) -> None:
    """Write the mechanism of a URDF or MJCF file to a folder, and say what it is.

    Raises:
        FileError: a file cannot be read or written.
        MechanismError: the file does not say what it should.
    """
    refuse_existing(output, force=force, folder=True)
    if tip is None and base is not None:
        raise MechanismError("--base goes with --tip; loops are closed from the root link on")
    if tip is not None and (platform or loops):
        raise MechanismError("--tip is for serial arms, --platform and --loops for closed loops")
    if whose == "mjcf" and loops is not None:
        raise MechanismError("--loops goes with URDF; MJCF holds its loops in <equality>")
    remarks: tuple[str, ...] = _turned(file) if whose == "urdf" else ()
    if tip is not None:
        serial = whose == "urdf"
        found = load_arm(file, tip, base) if serial else serial_arm(read_mjcf(file), tip, base)
    else:
        yaml = None if whose == "mjcf" else loops or _beside(file)
        tree = read_mjcf(file) if yaml is None else read_loops(file, yaml)
        found, more = closed_mechanism(tree, platform)
        if yaml is not None:
            stdout.print(f"loops closed by {yaml}", markup=False, soft_wrap=True)
        words, moved = closing_in_words(tree, found)
        if moved:
            remarks += (words,)
        else:
            stdout.print(words, markup=False, soft_wrap=True)
        remarks += more
    remarks += _huge(found)
    name = re.sub(r"\W+", "_", output.absolute().name).strip("_") or found.name
    save_mechanism(replace(found, name=name), output, force=force)
    _say(found)
    for text in remarks:
        warn(text)
    wrote(output)


def _turned(file: Path) -> tuple[str, ...]:
    """Return what to say of origins that are turned by more than a full turn."""
    beyond = turns_beyond(file)
    if not beyond:
        return ()
    more = f" (and {len(beyond) - 1} more)" if len(beyond) > 1 else ""
    return (f"{beyond[0]}{more} is more than a turn: radians are expected; is this degrees?",)


def _huge(mechanism: Mechanism) -> tuple[str, ...]:
    """Return what to say of a mechanism larger than machines are."""
    size = largest_size(mechanism.legs, mechanism.platform)
    if size <= _LARGE:
        return ()
    return (f"the longest leg is {size:.4g} m: metres are expected; is this millimetres?",)


def _beside(file: Path) -> Path:
    """Return the YAML file that belongs to a URDF.

    Raises:
        FileError: there is none.
    """
    places = (file.with_suffix(".yaml"), file.parent / "robot.yaml")
    for place in places:
        if place.is_file():
            return place
    raise FileError(
        f"no {' or '.join(dict.fromkeys(one.name for one in places))} beside {file} says what "
        "closes its loops; name one with --loops, or import a serial arm with --tip LINK"
    )


def _say(mechanism: Mechanism) -> None:
    """Print what was understood: platform, legs, drives, parameters."""
    platform = mechanism.platform
    home = ", ".join(
        f"{name} {round(value, 9) + 0.0:.6g} {unit}"
        for name, value, unit in zip(
            platform.coordinates, platform.home, platform.units, strict=True
        )
    )
    stdout.print(f"{platform.kind} platform, at home {home}", markup=False, soft_wrap=True)
    for leg in mechanism.legs:
        driven = {sensor.joint for sensor in leg.sensors}
        joints = ", ".join(f"{j.name}{'*' * (j.name in driven)}" for j in leg.moving)
        stdout.print(
            f"{leg.name}: {joints}; closes a {leg.closes}; {len(leg.parameters)} parameters",
            markup=False,
            soft_wrap=True,
        )
    stdout.print("* driven: its position is read")


def export_tree(
    mechanism: Mechanism,
    output: Path,
    whose: str,
    *,
    original: Path | None,
    leg: str | None,
    force: bool,
) -> None:
    """Write a mechanism as URDF or MJCF, or into a copy of the user's URDF.

    Raises:
        FileError: a file cannot be read or written.
        MechanismError: a joint that the user's URDF has no place for.
    """
    refuse_existing(output, force=force)
    if original is not None:
        if whose != "urdf":
            raise MechanismError("--original goes with URDF, not with MJCF")
        data = calibrated_urdf(original, mechanism, leg)
        with writing(output, force=force) as scratch:
            scratch.write_bytes(data)
        for line in unwritten(mechanism):
            warn(line)
        remark(f"{_changed(original.read_bytes(), data)} lines are other than in {original}")
        wrote(output)
        return
    if leg is not None:
        raise MechanismError("--leg goes with --original; the whole mechanism is written")
    tree, remarks = tree_of(mechanism)
    files = {output: mjcf(tree) if whose == "mjcf" else loops_urdf(tree)}
    if whose == "urdf" and tree.loops:
        files[output.with_suffix(".yaml")] = loops_yaml(tree)
    for path in files:
        refuse_existing(path, force=force)
    for path, text in files.items():
        with writing(path, force=force) as scratch:
            scratch.write_text(text, encoding="utf-8")
    for line in remarks:
        warn(line)
    for path in files:
        wrote(path)


def _changed(before: bytes, after: bytes) -> int:
    """Return how many lines of a file are not as they were."""
    kept = set(before.splitlines())
    return sum(line not in kept for line in after.splitlines())
