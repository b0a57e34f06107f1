"""Delta kinematics in files of firmwares: Klipper, RepRapFirmware, Marlin. Lengths mm, angles deg.

Klipper's ``printer.cfg`` ends with a block that SAVE_CONFIG appends, in which options count that
are not above it. There are also heights that DELTA_CALIBRATE probed, with "stable positions": steps
that each carriage went down from its endstop, which do not depend on the parameters
(``klippy/extras/delta_calibrate.py``). Times the way per step they are readings.

``M665 L333.1:333.0:332.9 R174.7 H297.1 B140 X0.1 Y-0.2 Z0`` and ``M666 X0.1 Y-0.2 Z0.1 A0 B0``:
rods L, delta radius R, homed height H, print radius B, corrections of the towers' angles (counted
from 210°, 330°, 90°), endstop corrections, and a tilt of the bed in percent
(``LinearDeltaKinematics.cpp``). Marlin takes endstop corrections off the height where
RepRapFirmware adds them, and has trims of the rods A, B, C in M665, where B alone is the print
radius (``delta.cpp``, ``M665.cpp``).
"""

from __future__ import annotations

import configparser
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import inf, isfinite
from pathlib import Path
from textwrap import wrap
from typing import Literal

import numpy as np

from pincal.errors import MechanismError
from pincal.files.text import LARGEST_FILE, lines_of, plain_number, read_text
from pincal.formats.delta_printer import ANGLES, DeltaPrinter
from pincal.model.checks import LARGEST
from pincal.model.units import UNITS
from pincal.types import Array

_MM = UNITS["mm"][1]
_SAVED = "#*# "  # begins the lines of SAVE_CONFIG
_STEPPERS = ("stepper_a", "stepper_b", "stepper_c")
_COMMENT = re.compile(r";.*|\([^)]*(?:\)|$)")
_COMMAND = re.compile(r"^\s*(?:N\d+\s+)?M0*(665|666)(?![\d.])(.*)$", re.I | re.A)
Firmware = Literal["reprap", "marlin"]
#: What each firmware's commands take, by letters.
_KNOWN = {
    "reprap": {"665": "LRHBXYZ", "666": "XYZAB"},
    "marlin": {"665": "LRHBXYZABCS", "666": "XYZ"},
}


def read_klipper(path: str | Path) -> tuple[DeltaPrinter, Array, Array]:
    """Return the delta of a ``printer.cfg``, heights that it holds, and readings there.

    Probed and manual heights of the nozzle over the bed have shape (N,), [m]; ways of the carriages
    down from their endstops, (N, 3), [m].
    """
    config = _KlipperOptions(Path(path))
    kinematics = config.text("printer", "kinematics", "")
    if kinematics != "delta":
        raise MechanismError(
            f"{path}: [printer] kinematics is {kinematics or 'not given'!r}; expected 'delta'"
        )

    def towers(option: str, usual: Sequence[float]) -> Array:
        pairs = zip(_STEPPERS, usual, strict=True)
        return np.array([config.number(name, option, default) for name, default in pairs])

    arm = config.number(_STEPPERS[0], "arm_length")
    endstop = config.number(_STEPPERS[0], "position_endstop")
    printed = config.number("printer", "print_radius", np.nan)
    radius, angles = config.number("printer", "delta_radius"), towers("angle", ANGLES)
    arms, endstops = towers("arm_length", [arm] * 3), towers("position_endstop", [endstop] * 3)
    printer = _printer(path, radius, angles, arms, endstops, printed if isfinite(printed) else None)
    return replace(printer, remarks=tuple(config.remarks())), *config.heights()


def read_reprap(path: str | Path, firmware: Firmware | None = None) -> DeltaPrinter:
    """Return the delta kinematics of M665 and M666 in a file; later lines win, letter by letter.

    Whose file it is must be said where firmwares mean different things by it.
    """
    text = read_text(Path(path), LARGEST_FILE["printer"], MechanismError, pipe=True)
    numbers = _commands(text, _KNOWN[firmware or "reprap"], path)

    def values(command: str, letters: str) -> Array:
        return np.array([numbers.get(command + letter, [0.0])[0] for letter in letters])

    tilt, corrections = values("666", "AB"), values("666", "XYZ")
    if tilt.any():
        raise MechanismError(
            f"{path}: M666 tilts the bed by {tilt[tilt != 0.0][0]:g} %, which a linear delta has "
            "no parameter for. Calibrate without tilt (factors 6 or 7 of G30 S), or set A0 B0 and "
            "measure anew"
        )
    if corrections.any() and firmware is None:
        raise MechanismError(
            f"{path}: M666 corrects endstops, which RepRapFirmware adds to the height and Marlin "
            "takes off; say whose file it is: --format reprap or --format marlin"
        )
    is_marlin = firmware == "marlin"
    has_trims = is_marlin and not {"665A", "665C"}.isdisjoint(numbers)
    arms = np.array((numbers["665L"] * 3)[:3]) + (values("665", "ABC") if has_trims else 0.0)
    radius, height, printed = values("665", "RHB").tolist()
    endstops = height + (-corrections if is_marlin else corrections)
    bed = None if has_trims else printed or None
    return _printer(path, radius, ANGLES + values("665", "XYZ"), arms, endstops, bed)


def _commands(text: str, known: Mapping[str, str], path: str | Path) -> dict[str, list[float]]:
    """Return the numbers behind each letter of M665 and M666, by ``665L`` and so on."""
    numbers: dict[str, list[float]] = {}
    for number, line in enumerate(lines_of(text), start=1):
        command = _COMMAND.match(_COMMENT.sub("", line).split("*")[0].removeprefix("echo:"))
        words = re.split(r"(?=[A-Za-z])", command[2].strip()) if command else []
        for word in filter(None, words):
            code, letter = command[1] if command else "", word[0].upper()
            place = f"{path}, line {number}: {word.strip()[:40]!r}"
            if letter not in known[code]:
                raise MechanismError(
                    f"{place} is nothing that M{code} takes; expected {', '.join(known[code])} "
                    "with numbers (--format says whose file it is: firmwares mean different "
                    "things by it)"
                )
            behind = [plain_number(part) for part in word[1:].split(":")]
            if not np.isfinite(behind).all():
                raise MechanismError(f"{place} of M{code} is not a letter and numbers")
            if letter != "L" and len(behind) > 1:
                raise MechanismError(f"{place} of M{code} has several numbers")
            numbers[code + letter] = behind
    if missing := [letter for letter in "LRH" if f"665{letter}" not in numbers]:
        raise MechanismError(
            f"{path}: no M665 with {', '.join(missing)}; expected a line such as "
            "'M665 L333.0 R174.7 H297.1'"
        )
    if len(numbers["665L"]) not in (1, 3):
        raise MechanismError(
            f"{path}: M665 L has {len(numbers['665L'])} lengths; expected 1 or 3, by colons"
        )
    return numbers


def _printer(
    path: str | Path,
    radius: float,
    angles: Array,
    arms: Array,
    endstops: Array,
    print_radius: float | None,
) -> DeltaPrinter:
    """Return a printer of numbers in mm and degrees, or raise with the file's name."""
    lengths = (_MM * arms).tolist(), (_MM * endstops).tolist()
    printed = None if print_radius is None else _MM * print_radius
    try:
        return DeltaPrinter(_MM * radius, np.radians(angles).tolist(), *lengths, printed)
    except MechanismError as error:
        raise MechanismError(f"{path}: {error}") from error


def write_klipper(printer: DeltaPrinter) -> str:
    """Return the sections of a ``printer.cfg`` that hold a delta's parameters.

    Digits are those that Klipper's own SAVE_CONFIG writes: 1e-6 mm and 1e-6 degrees.
    """
    lines = [
        "# Delta kinematics, calibrated by pincal. Put it into printer.cfg in the place of",
        "# the same options, above the SAVE_CONFIG block: there it wins over what is saved.",
        *_notes(printer, "#"),
        "[printer]",
        "kinematics: delta",
        f"delta_radius: {printer.radius / _MM:.6f}",
    ]
    towers = zip(_STEPPERS, printer.angles, printer.arms, printer.endstops, strict=True)
    for name, angle, arm, endstop in towers:
        lines += ["", f"[{name}]", f"angle: {np.degrees(angle) % 360.0:.6f}"]
        lines += [f"arm_length: {arm / _MM:.6f}", f"position_endstop: {endstop / _MM:.6f}"]
    return "\n".join([*lines, ""])


def write_reprap(printer: DeltaPrinter) -> str:
    """Return the lines M665 and M666 of a delta's parameters, to 1e-4 mm and 1e-4 degrees.

    As the firmware does, the mean of the endstops is the homed height. The print radius B stays
    as the printer has it.
    """
    endstops = np.array(printer.endstops) / _MM
    height = round(float(endstops.mean()), 4)
    arms = ":".join(f"{arm / _MM:.4f}" for arm in printer.arms)
    turns = (np.degrees(printer.angles) - ANGLES + 180.0) % 360.0 - 180.0
    angles, ends = (  # no zero is negative
        " ".join(f"{k}{v:.4f}" for k, v in zip("XYZ", np.round(values, 4) + 0.0, strict=True))
        for values in (turns, endstops - height)
    )
    lines = [
        "; Delta kinematics, calibrated by pincal. Put it into config.g in the place of the",
        "; same lines, and remove M665 and M666 from config-override.g, which would win.",
        *_notes(printer, ";"),
        f"M665 L{arms} R{printer.radius / _MM:.4f} H{height:.4f} {angles}",
        f"M666 {ends} A0.00 B0.00",
    ]
    return "\n".join([*lines, ""])


def _notes(printer: DeltaPrinter, mark: str) -> list[str]:
    """Return a printer's remarks as lines of comments that begin with a mark."""
    return [
        line
        for text in printer.remarks
        for line in wrap(text, 88, initial_indent=f"{mark} Note: ", subsequent_indent=f"{mark} ")
    ]


class _KlipperOptions:
    """Options of a ``printer.cfg``; those above the SAVE_CONFIG block win over those in it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        lines = lines_of(read_text(path, LARGEST_FILE["printer"], MechanismError, pipe=True))
        saved = [line[len(_SAVED) :] for line in lines if line.startswith(_SAVED.rstrip())]
        heading = next((i for i, line in enumerate(saved) if line.startswith("[")), len(saved))
        regular = [line.split("#")[0] for line in lines if not line.startswith(_SAVED.rstrip())]
        self._parser = configparser.RawConfigParser(
            strict=False, inline_comment_prefixes=(";", "#")
        )
        try:
            for part in (saved[heading:], regular):
                self._parser.read_string("\n".join(part), str(path))
        except configparser.Error as error:
            fault = str(error).splitlines()[0]
            raise MechanismError(f"{path}: not a configuration of Klipper: {fault}") from error

    def remarks(self) -> list[str]:
        """Return what the file says and is not read, as sentences."""
        remarks = [
            f"{name[:100]!r} is not read: options of the delta that are there do not count"
            for name in self._parser.sections()
            if name.startswith("include ")
        ]
        section = "delta_calibrate"
        probed = self._parser.options(section) if self._parser.has_section(section) else []
        distances = [option for option in probed if option.startswith("distance")]
        if count := sum(not option.endswith(("_pos1", "_pos2")) for option in distances):
            remarks.append(
                f"{count} distance{'s' * (count > 1)} of DELTA_ANALYZE left out: distances between "
                "two measured poses are not read. They show how long the arms are; say what you "
                "know of them by --priors arm=… or --fixed arm"
            )
        return remarks

    def text(self, section: str, option: str, default: str | None = None) -> str:
        """Return an option; one without a default must be there."""
        text: str | None = self._parser.get(section, option, fallback=default)
        if text is None:
            raise MechanismError(f"{self.path}: no option {option!r} in section [{section}]")
        return text.strip()

    def number(self, section: str, option: str, default: float | None = None) -> float:
        """Return an option as a number: see ``numbers``."""
        if default is not None and not self._parser.has_option(section, option):
            return default
        return self.numbers(section, option, 1)[0]

    def numbers(self, section: str, option: str, count: int) -> list[float]:
        """Return an option as so many numbers."""
        text = self.text(section, option)
        values = [plain_number(part) for part in text.split(",")]
        if len(values) != count or not np.isfinite(values).all():
            expected = "a finite number" if count == 1 else f"{count} finite numbers"
            raise MechanismError(
                f"{self.path}: [{section}] {option} is {text!r}; expected {expected}"
            )
        return values

    def heights(self) -> tuple[Array, Array]:
        """Return the heights, shape (N,), [m], and the readings there, shape (N, 3), [m]."""
        heights, steps = [], []
        for kind in ("manual_height", "height"):
            for number in range(1000):
                height = self.number("delta_calibrate", f"{kind}{number}", np.nan)
                if not isfinite(height):
                    break
                heights.append(_MM * height)
                steps.append(self.numbers("delta_calibrate", f"{kind}{number}_pos", 3))
        if not heights:
            return np.empty(0), np.empty((0, 3))
        readings = np.array(steps) * [_MM * self._way_per_step(name) for name in _STEPPERS]
        if not np.abs(np.column_stack((heights, readings))).max() <= LARGEST:
            raise MechanismError(
                f"{self.path}: a height of [delta_calibrate], or its steps times their way, is no "
                f"number up to {LARGEST:g} m"
            )
        return np.array(heights), readings

    def _way_per_step(self, stepper: str) -> float:
        """Return the way of a carriage for a step, [mm] (``klippy/stepper.py``)."""
        gearing = 1.0
        for pair in self.text(stepper, "gear_ratio", "").split(","):
            if pair.strip():
                try:
                    driven, driving = (plain_number(part) for part in pair.split(":"))
                    gearing *= driven / driving
                except (ValueError, ZeroDivisionError):
                    raise MechanismError(
                        f"{self.path}: [{stepper}] gear_ratio is {pair.strip()!r}; expected "
                        "two numbers, such as 3:1"
                    ) from None
        steps = self.number(stepper, "full_steps_per_rotation", 200.0)
        per_turn = steps * self.number(stepper, "microsteps") * gearing
        way = self.number(stepper, "rotation_distance") / per_turn if per_turn else np.nan
        if not 0.0 < way < inf:
            raise MechanismError(f"{self.path}: [{stepper}] has no way per step above zero")
        return way
