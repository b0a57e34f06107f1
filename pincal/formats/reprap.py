"""M665 and M666 of RepRapFirmware and of Marlin: delta kinematics in lines of G-code.

``M665 L333.1:333.0:332.9 R174.7 H297.1 B140 X0.1 Y-0.2 Z0`` and ``M666 X0.1 Y-0.2 Z0.1 A0 B0``:
rods L, delta radius R, homed height H, print radius B, corrections of the towers' angles (counted
from 210°, 330°, 90°), endstop corrections, and a tilt of the bed in percent. Lengths in mm, angles
in degrees (``LinearDeltaKinematics.cpp``). Marlin takes endstop corrections off the height where
RepRapFirmware adds them, and has trims of the rods A, B, C in M665, where B
alone is the print radius (``delta.cpp``, ``M665.cpp``).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np

from pincal.errors import MechanismError
from pincal.files.text import LARGEST_FILE, lines_of, plain_number, read_text
from pincal.formats.delta_printer import ANGLES, MM, DeltaPrinter, Expressed, noted, three_floats
from pincal.types import Array

_COMMENT = re.compile(r";.*|\([^)]*(?:\)|$)")
_COMMAND = re.compile(r"^\s*(?:N\d+\s+)?M0*(665|666)(?![\d.])(.*)$", re.I | re.A)
_WORD = re.compile(r"\s*([A-Z])\s*([-+.\d:\s]*)", re.I | re.A)
Firmware = Literal["reprap", "marlin"]
#: What each firmware's commands take, and what only its files have.
_KNOWN = {
    "reprap": {"665": "LRHBXYZ", "666": "XYZAB"},
    "marlin": {"665": "LRHBXYZABCS", "666": "XYZ"},
}
_SHOWS: dict[Firmware, re.Pattern[str]] = {
    "reprap": re.compile(
        r"RepRapFirmware|\bRRF\b|\bDuet|config(-override)?\.g\b|^\s*M(550|552|563|584|586)\b"
        r"|^\s*M666[^;(\n]*[AB]|^\s*M665[^;(\n]*L[-+.\d\s]*:",
        re.I | re.M,
    ),
    "marlin": re.compile(r"Marlin|^\s*echo:|^\s*M50[03]\b|^\s*M665[^;(\n]*[ACS]", re.I | re.M),
}


def read_reprap(path: str | Path, firmware: Firmware | None = None) -> DeltaPrinter:
    """Return the delta kinematics of M665 and M666 in a file; later lines win, letter by letter.

    Args:
        path: The file.
        firmware: Whose file it is; what the file shows if not given.

    Raises:
        FileError: the file is missing or cannot be read.
        MechanismError: no M665, a letter missing or unknown, a tilt of the bed, or corrections of
            endstops in a file that does not show whose it is.
    """
    path = Path(path)
    text = read_text(path, LARGEST_FILE["printer"], MechanismError, pipe=True)
    meant, certain = (firmware, True) if firmware else _firmware_of(text)
    numbers = _commands(text, _KNOWN[meant], path)

    def value(code: str, letter: str) -> float:
        return numbers.get((code, letter), [0.0])[0]

    def three(code: str, letters: str) -> Array:
        return np.array([value(code, letter) for letter in letters])

    if tilted := [tilt for tilt in three("666", "AB") if tilt]:
        raise MechanismError(
            f"{path}: M666 tilts the bed by {tilted[0]:g} %, which a linear delta has no parameter "
            "for. Calibrate without tilt (factors 6 or 7 of G30 S), or set A0 B0 and measure anew"
        )
    lengths = numbers["665", "L"]
    if len(lengths) not in (1, 3):
        raise MechanismError(
            f"{path}: M665 L has {len(lengths)} lengths; expected 1 or 3, by colons"
        )
    corrections = three("666", "XYZ")
    if corrections.any() and not certain:
        raise MechanismError(
            f"{path}: M666 corrects endstops, which RepRapFirmware adds to the height and Marlin "
            "takes off, and the file does not show whose it is; say --format reprap or --format "
            "marlin"
        )
    trims = meant == "marlin" and bool({("665", "A"), ("665", "C")} & numbers.keys())
    arms = np.array((lengths * 3)[:3]) + (three("665", "ABC") if trims else 0.0)
    ends = value("665", "H") + (-corrections if meant == "marlin" else corrections)
    try:
        return DeltaPrinter(
            radius=MM * value("665", "R"),
            angles=three_floats(np.radians(ANGLES + three("665", "XYZ"))),
            arms=three_floats(MM * arms),
            endstops=three_floats(MM * ends),
            print_radius=None if trims else MM * value("665", "B") or None,
        )
    except MechanismError as error:
        raise MechanismError(f"{path}: {error}") from error


def _firmware_of(text: str) -> tuple[Firmware, bool]:
    """Return whose file a text is, and whether it shows that."""
    shown: list[Firmware] = [name for name, signs in _SHOWS.items() if signs.search(text)]
    return ("marlin" if shown == ["marlin"] else "reprap"), len(shown) == 1


def _commands(
    text: str, known: Mapping[str, str], path: Path
) -> dict[tuple[str, str], list[float]]:
    """Return the numbers of M665 and M666, by number of the command and letter.

    Raises:
        MechanismError: no M665, a letter missing or unknown, or no numbers behind one.
    """
    values: dict[tuple[str, str], list[float]] = {}
    for number, line in enumerate(lines_of(text), start=1):
        command = _COMMAND.match(_COMMENT.sub("", line).split("*")[0].removeprefix("echo:"))
        if command:
            words = _words(command[1], command[2], known, f"{path}, line {number}")
            values |= {(command[1], letter): numbers for letter, numbers in words.items()}
    if missing := [letter for letter in "LRH" if ("665", letter) not in values]:
        raise MechanismError(
            f"{path}: no M665 with {', '.join(missing)}; expected a line such as "
            "'M665 L333.0 R174.7 H297.1'"
        )
    return values


def _words(code: str, text: str, known: Mapping[str, str], line: str) -> dict[str, list[float]]:
    """Return the numbers behind each letter of a command."""
    numbers: dict[str, list[float]] = {}
    text, place = text.strip(), 0
    while place < len(text):
        match = _WORD.match(text, place)
        letter = match[1].upper() if match else ""
        if match is None or letter not in known[code]:
            raise MechanismError(
                f"{line}: {text[place : place + 20]!r} is nothing that M{code} takes; expected "
                f"{', '.join(known[code])} with numbers (--format says whose file it is: firmwares "
                "mean different things by it)"
            )
        word = match[0].strip()
        numbers[letter] = [plain_number(part) for part in match[2].split(":")]
        if not np.isfinite(numbers[letter]).all():
            raise MechanismError(f"{line}: {word!r} of M{code} is not a letter and numbers")
        if letter != "L" and len(numbers[letter]) > 1:
            raise MechanismError(f"{line}: {word!r} of M{code} has several numbers")
        place = match.end()
    return numbers


def write_reprap(expressed: Expressed) -> str:
    """Return the lines M665 and M666 of a delta's parameters, to 1e-4 mm and 1e-4 degrees.

    As the firmware does, the mean of the endstops is the homed height. The print radius B stays
    as the printer has it.
    """
    printer = expressed.printer
    endstops = np.array(printer.endstops) / MM
    height = round(float(endstops.mean()), 4)
    arms = ":".join(f"{arm / MM:.4f}" for arm in printer.arms)
    turns = (np.degrees(printer.angles) - ANGLES + 180.0) % 360.0 - 180.0
    angles = _lettered(turns)
    ends = _lettered(endstops - height)
    lines = ["; Delta kinematics, calibrated by pincal. Put it into config.g in the place of the"]
    lines += ["; same lines, and remove M665 and M666 from config-override.g, which would win."]
    lines += noted(expressed.remarks, ";")
    lines += [f"M665 L{arms} R{printer.radius / MM:.4f} H{height:.4f} {angles}"]
    lines += [f"M666 {ends} A0.00 B0.00"]
    return "\n".join(lines) + "\n"


def _lettered(values: Array) -> str:
    """Return three numbers behind X, Y and Z; no zero is negative."""
    rounded = np.round(values, 4) + 0.0
    return " ".join(f"{k}{v:.4f}" for k, v in zip("XYZ", rounded, strict=True))
