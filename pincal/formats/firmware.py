"""Delta kinematics in files of Klipper, RepRapFirmware and Marlin; lengths in mm, angles in deg.

Klipper's ``printer.cfg`` ends with a block that SAVE_CONFIG appends; options above it win over
those in it. The block also holds heights that DELTA_CALIBRATE probed and distances given to
DELTA_ANALYZE, with "stable positions": steps that each carriage went down from its endstop, which
do not depend on the parameters (``klippy/extras/delta_calibrate.py``). Multiplied by the travel per
step they are readings.

``M665 L333.1:333.0:332.9 R174.7 H297.1 B140 X0.1 Y-0.2 Z0`` and ``M666 X0.1 Y-0.2 Z0.1 A0 B0``:
rods L, delta radius R, homed height H, print radius B, corrections of the towers' angles (counted
from 210°, 330°, 90°), endstop corrections, and a tilt of the bed in percent
(``LinearDeltaKinematics.cpp``). Marlin takes endstop corrections off the height where
RepRapFirmware adds them, and has trims of the rods A, B, C in M665, where B alone is the print
radius (``delta.cpp``, ``M665.cpp``).
"""

import configparser
import re
from collections.abc import Mapping
from dataclasses import replace
from math import inf, isfinite
from pathlib import Path
from textwrap import wrap
from typing import Literal

import numpy as np

from pincal.errors import MechanismError, located
from pincal.files.text import LARGEST_FILE, LINE_END, plain_number, read_text
from pincal.formats.delta_printer import ANGLES, DeltaPrinter
from pincal.model import ROW, TO, Measurements
from pincal.model.checks import LARGEST
from pincal.types import Array
from pincal.words.numbers import UNITS

_MM = UNITS["mm"][1]
_SAVED = "#*# "  # prefix of the lines of SAVE_CONFIG
_STEPPERS = ("stepper_a", "stepper_b", "stepper_c")
_OF_TOWERS = ("angle", "arm_length", "position_endstop")
_COMMENT = re.compile(r";.*|\([^)]*(?:\)|$)")
_COMMAND = re.compile(r"^\s*(?:N\d+\s+)?M0*(665|666)(?![\d.])(.*)$", re.I | re.A)
Firmware = Literal["reprap", "marlin"]
_HEADINGS: dict[Firmware, tuple[str, str]] = {
    "reprap": (
        "; Delta kinematics of RepRapFirmware, written by pincal. Put it into config.g in place of",
        "; the same lines, and remove M665 and M666 from config-override.g, which would win.",
    ),
    "marlin": (
        "; Delta kinematics of Marlin 2, written by pincal. Send it, then M500. With a bed probe",
        "; Marlin homes to H less Z of M851: add that Z to H, unless H came from Marlin.",
    ),
}
"""Comments above the lines for each firmware."""
#: Letters that each firmware's commands accept.
_KNOWN = {
    "reprap": {"665": "LRHBXYZ", "666": "XYZAB"},
    "marlin": {"665": "LRHBXYZABCS", "666": "XYZ"},
}


def read_klipper(path: str | Path) -> tuple[DeltaPrinter, Measurements]:
    """Return the delta of a ``printer.cfg``, and the heights and distances that it holds.

    Heights of the nozzle over the bed are z of the poses; readings are the distances of the
    carriages below their endstops.
    """
    with located(path, MechanismError):
        config = _Options(read_text(Path(path), LARGEST_FILE["printer"], MechanismError, pipe=True))
        kinematics = config.text("printer", "kinematics", "not given")
        if kinematics != "delta":
            raise MechanismError(f"[printer] kinematics is {kinematics!r}; expected 'delta'")
        usual = [config.number(_STEPPERS[0], option) for option in _OF_TOWERS[1:]]
        angles, arms, endstops = np.transpose(
            [
                [config.number(name, *pair) for pair in zip(_OF_TOWERS, (u, *usual), strict=True)]
                for name, u in zip(_STEPPERS, ANGLES, strict=True)
            ]
        )
        radius = config.number("printer", "delta_radius")
        printed = config.number("printer", "print_radius", np.nan)
        remarks = [
            f"{name[:100]!r} is not read: options of the delta in that file do not count"
            for name in config.sections()
            if name.startswith("include ")
        ]
        printer = _printer(radius, angles, arms, endstops, printed)
        return replace(printer, remarks=tuple(remarks)), config.probing()


def read_reprap(path: str | Path, firmware: Firmware | None = None) -> DeltaPrinter:
    """Return the delta kinematics of M665 and M666 in a file; a later line wins for each letter.

    The firmware must be given where firmwares interpret the commands differently.
    """
    with located(path, MechanismError):
        text = read_text(Path(path), LARGEST_FILE["printer"], MechanismError, pipe=True)
        numbers = _commands(text, _KNOWN[firmware or "reprap"])

        def values(command: str, letters: str) -> Array:
            return np.array([numbers.get(command + letter, [0.0])[0] for letter in letters])

        tilt, corrections = values("666", "AB"), values("666", "XYZ")
        if tilt.any():
            raise MechanismError(
                f"M666 tilts the bed by {tilt[tilt != 0.0][0]:g} %; a linear delta has no "
                "parameter for that. Calibrate without tilt (factors 6 or 7 of G30 S), or set "
                "A0 B0 and measure again"
            )
        if corrections.any() and firmware is None:
            raise MechanismError(
                "M666 corrects endstops: RepRapFirmware adds these to the height, Marlin subtracts "
                "them; say whose file it is: --format reprap or --format marlin"
            )
        sign = -1.0 if firmware == "marlin" else 1.0
        trimmed = firmware == "marlin" and not {"665A", "665C"}.isdisjoint(numbers)
        arms = np.array((numbers["665L"] * 3)[:3]) + (values("665", "ABC") if trimmed else 0.0)
        radius, height, printed = values("665", "RHB").tolist()
        bed = np.nan if trimmed else printed or np.nan
        angles = ANGLES + values("665", "XYZ")
        return _printer(radius, angles, arms, height + sign * corrections, bed)


def _commands(text: str, known: Mapping[str, str]) -> dict[str, list[float]]:
    """Return the numbers after each letter of M665 and M666, by command and letter: ``665L``."""
    numbers: dict[str, list[float]] = {}
    for number, line in enumerate(LINE_END.split(text), start=1):
        command = _COMMAND.match(_COMMENT.sub("", line).split("*")[0].removeprefix("echo:"))
        words = re.split(r"(?=[A-Za-z])", command[2].strip()) if command else []
        for word in filter(None, words):
            code, letter = command[1] if command else "", word[0].upper()
            place = f", line {number}: {word.strip()[:40]!r}"
            if letter not in known[code]:
                raise MechanismError(
                    f"{place} is not accepted by M{code}; expected {', '.join(known[code])} with "
                    "numbers (firmwares differ: --format says whose file it is)"
                )
            behind = [plain_number(part) for part in word[1:].split(":")]
            if not np.isfinite(behind).all():
                raise MechanismError(f"{place} of M{code} is not a letter and numbers")
            if letter != "L" and len(behind) > 1:
                raise MechanismError(f"{place} of M{code} has several numbers")
            numbers[code + letter] = behind
    if missing := [letter for letter in "LRH" if f"665{letter}" not in numbers]:
        raise MechanismError(
            f"no M665 with {', '.join(missing)}; expected such as 'M665 L333.0 R174.7 H297.1'"
        )
    if len(numbers["665L"]) not in (1, 3):
        count = len(numbers["665L"])
        raise MechanismError(f"M665 L has {count} lengths; expected 1, or 3 separated by colons")
    return numbers


def _printer(
    radius: float, angles: Array, arms: Array, endstops: Array, printed: float
) -> DeltaPrinter:
    """Return a printer of numbers in mm and degrees; ``printed``, the bed's radius, may be NaN."""
    lengths = (_MM * arms).tolist(), (_MM * endstops).tolist()
    bed = _MM * printed if isfinite(printed) else None
    return DeltaPrinter(_MM * radius, np.radians(angles).tolist(), *lengths, bed)


def write_klipper(printer: DeltaPrinter) -> str:
    """Return the delta's sections of a ``printer.cfg``, with 1e-6 mm and degrees as SAVE_CONFIG."""
    lines = [
        "# Delta kinematics, written by pincal. Put it into printer.cfg in the place of",
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


def write_reprap(printer: DeltaPrinter, firmware: Firmware = "reprap") -> str:
    """Return M665 and M666 of a delta, to 1e-4 mm and degrees; the print radius is not written.

    RepRapFirmware adds M666 to the homed height, the mean of the endstops. Marlin lowers carriages
    by M666, at most 0, to the homed height, the lowest endstop; its rods have trims.
    """
    marlin = firmware == "marlin"
    ends, arms = (np.round(np.array(v) / _MM, 4) for v in (printer.endstops, printer.arms))
    height = round(float(ends.min() if marlin else ends.mean()), 4)
    turns = (np.degrees(printer.angles) - ANGLES + 180.0) % 360.0 - 180.0
    rod = round(float(arms.mean()), 4)
    rods = f"{rod:.4f}" if marlin else ":".join(f"{arm:.4f}" for arm in arms)
    first = f"M665 L{rods} R{printer.radius / _MM:.4f} H{height:.4f} {_words('XYZ', turns)}"
    if marlin:
        lines = [f"{first} {_words('ABC', arms - rod)}", f"M666 {_words('XYZ', height - ends)}"]
    else:
        lines = [first, f"M666 {_words('XYZ', ends - height)} A0.00 B0.00"]
    return "\n".join([*_HEADINGS[firmware], *_notes(printer, ";"), *lines, ""])


def _words(letters: str, values: Array) -> str:
    """Return letters with numbers of four digits; no zero is negative."""
    rounded = np.round(values, 4) + 0.0
    return " ".join(f"{k}{v:.4f}" for k, v in zip(letters, rounded, strict=True))


def _notes(printer: DeltaPrinter, mark: str) -> list[str]:
    """Return a printer's remarks as comment lines that begin with a mark."""
    return [
        line
        for text in printer.remarks
        for line in wrap(text, 88, initial_indent=f"{mark} Note: ", subsequent_indent=f"{mark} ")
    ]


class _Options(configparser.RawConfigParser):
    """Options of a ``printer.cfg``; those above the SAVE_CONFIG block win over those in it."""

    def __init__(self, text: str) -> None:
        super().__init__(strict=False, inline_comment_prefixes=(";", "#"))
        lines = LINE_END.split(text)
        saved = [line[len(_SAVED) :] for line in lines if line.startswith(_SAVED.rstrip())]
        heading = next((i for i, line in enumerate(saved) if line.startswith("[")), len(saved))
        regular = [line.split("#")[0] for line in lines if not line.startswith(_SAVED.rstrip())]
        try:
            for part in (saved[heading:], regular):
                self.read_string("\n".join(part))
        except configparser.Error as error:
            fault = str(error).splitlines()[0]
            raise MechanismError(f"not a configuration of Klipper: {fault}") from error

    def text(self, section: str, option: str, default: str | None = None) -> str:
        """Return an option; raise MechanismError if it is missing and has no default."""
        text: str | None = self.get(section, option, fallback=default)
        if text is None:
            raise MechanismError(f"no option {option!r} in section [{section}]")
        return text.strip()

    def number(self, section: str, option: str, default: float | None = None) -> float:
        """Return an option as a number; raise MechanismError if missing and without default."""
        if default is not None and not self.has_option(section, option):
            return default
        return self.numbers(section, option, 1)[0]

    def numbers(self, section: str, option: str, count: int) -> list[float]:
        """Return an option as ``count`` numbers separated by commas."""
        text = self.text(section, option)
        values = [plain_number(part) for part in text.split(",")]
        if len(values) != count or not np.isfinite(values).all():
            expected = "a finite number" if count == 1 else f"{count} finite numbers"
            raise MechanismError(f"[{section}] {option} is {text!r}; expected {expected}")
        return values

    def probing(self) -> Measurements:
        """Return the measurements of DELTA_CALIBRATE and DELTA_ANALYZE.

        The rows of heights come first, manual ones before probed ones; then two rows per distance.
        """
        heights = self._saved("manual_height", "_pos") + self._saved("height", "_pos")
        distances = self._saved("distance", "_pos1", "_pos2")
        every, count = [*heights, *distances], len(heights)
        steps = np.reshape([end for _, ends in every for end in ends], (-1, 3))
        readings = steps * ([_MM * self._way_per_step(name) for name in _STEPPERS] if every else 1)
        z, spans = np.full((2, len(readings)), np.nan)
        z[:count] = [_MM * height for height, _ in heights]
        spans[count + 1 :: 2] = [_MM * distance for distance, _ in distances]
        sizes = np.abs(np.column_stack((z, spans, readings)))
        if not (np.isnan(sizes) | (sizes <= LARGEST)).all():
            raise MechanismError(
                "a height or distance of [delta_calibrate], or its steps times the travel per "
                f"step, is no number up to {LARGEST:g} m"
            )
        poses = np.column_stack((np.full((len(z), 2), np.nan), z))
        if not distances:
            return Measurements(poses=poses, readings=readings)
        names = tuple(str(1 + row) for row in range(len(readings)))
        led_to = (str(row) if np.isfinite(spans[row]) else "" for row in range(len(names)))
        contacts = {ROW: names, f"distance_1{TO}": tuple(led_to)}
        extra = {"distance_1": spans}
        return Measurements(poses=poses, readings=readings, extra=extra, contacts=contacts)

    def _saved(self, kind: str, *ends: str) -> list[tuple[float, list[list[float]]]]:
        """Return the numbers ``kind0``, ``kind1``, … of [delta_calibrate], with their steps."""
        section, numbers = "delta_calibrate", list[tuple[float, list[list[float]]]]()
        while self.has_option(section, name := f"{kind}{len(numbers)}"):
            steps = [self.numbers(section, f"{name}{end}", 3) for end in ends]
            numbers.append((self.number(section, name), steps))
        return numbers

    def _way_per_step(self, stepper: str) -> float:
        """Return the travel of a carriage per step, [mm] (``klippy/stepper.py``)."""
        steps = self.number(stepper, "full_steps_per_rotation", 200.0)
        per_turn = steps * self.number(stepper, "microsteps")
        for pair in filter(str.strip, self.text(stepper, "gear_ratio", "").split(",")):
            driven, _, driving = map(plain_number, pair.partition(":"))
            if not isfinite(driven) or not isfinite(driving) or not driving:
                raise MechanismError(
                    f"[{stepper}] gear_ratio is {pair.strip()!r}; expected two numbers, such as 3:1"
                )
            per_turn *= driven / driving
        way = self.number(stepper, "rotation_distance") / per_turn if per_turn else np.nan
        if not 0.0 < way < inf:
            raise MechanismError(f"[{stepper}]: the travel per step is not above zero")
        return way
