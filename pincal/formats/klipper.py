"""Klipper's ``printer.cfg``: delta kinematics, and what DELTA_CALIBRATE measured.

Lengths are in mm, angles in degrees. The block that SAVE_CONFIG appends holds probed heights with
"stable positions": steps that each carriage went down from its endstop, which do not depend on
the parameters (``klippy/extras/delta_calibrate.py``). Times the way per step they are readings.
"""

from __future__ import annotations

import configparser
import glob
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import degrees, inf, isfinite, radians
from pathlib import Path

import numpy as np

from pincal.errors import MechanismError
from pincal.files.text import LARGEST_FILE, lines_of, plain_number, read_text
from pincal.formats.delta_printer import ANGLES, MM, DeltaPrinter, Expressed, noted, three_floats
from pincal.model.checks import LARGEST
from pincal.types import Array

_SAVED = "#*# "  # begins the lines of SAVE_CONFIG
_STEPPERS = ("stepper_a", "stepper_b", "stepper_c")
_ONE_MORE = 4096  # bytes for which an included file counts at least


@dataclass(frozen=True)
class KlipperFile:
    """What a ``printer.cfg`` says of a delta."""

    printer: DeltaPrinter
    heights: Array
    """Probed and manual heights of the nozzle over the bed, shape (N,), [m]."""
    readings: Array
    """Ways of the carriages down from their endstops there, shape (N, 3), [m]."""
    remarks: tuple[str, ...]
    """What was in the file and could not be used, as sentences."""


def read_klipper(path: str | Path) -> KlipperFile:
    """Return the delta kinematics of a ``printer.cfg``, and the heights it holds.

    As in Klipper, options above the SAVE_CONFIG block win over those in it.

    Raises:
        FileError: the file is missing or cannot be read.
        MechanismError: not a configuration of Klipper, not a delta, or a missing or wrong option.
    """
    path = Path(path)
    config = _Config(path)
    kinematics = config.text("printer", "kinematics", "")
    if kinematics != "delta":
        raise MechanismError(
            f"{path}: [printer] kinematics is {kinematics or 'not given'!r}; expected 'delta'"
        )
    arm = config.number(_STEPPERS[0], "arm_length")
    endstop = config.number(_STEPPERS[0], "position_endstop")
    printed = config.number("printer", "print_radius", np.nan)
    try:
        printer = DeltaPrinter(
            radius=MM * config.number("printer", "delta_radius"),
            angles=three_floats(
                radians(config.number(name, "angle", usual))
                for name, usual in zip(_STEPPERS, ANGLES, strict=True)
            ),
            arms=three_floats(MM * config.number(name, "arm_length", arm) for name in _STEPPERS),
            endstops=three_floats(
                MM * config.number(name, "position_endstop", endstop) for name in _STEPPERS
            ),
            print_radius=MM * printed if isfinite(printed) else None,
        )
    except MechanismError as error:
        raise MechanismError(
            str(error) if str(path) in str(error) else f"{path}: {error}"
        ) from error
    return KlipperFile(printer, *_heights(config))


def write_klipper(expressed: Expressed) -> str:
    """Return the sections of a ``printer.cfg`` that hold a delta's parameters.

    Digits are those that Klipper's own SAVE_CONFIG writes: 1e-6 mm and 1e-6 degrees.
    """
    printer = expressed.printer
    lines = ["# Delta kinematics, calibrated by pincal. Put it into printer.cfg in the place of"]
    lines += ["# the same options, above the SAVE_CONFIG block: there it wins over what is saved."]
    lines += noted(expressed.remarks, "#")
    lines += ["[printer]", "kinematics: delta", f"delta_radius: {printer.radius / MM:.6f}"]
    for name, angle, arm, endstop in zip(
        _STEPPERS, printer.angles, printer.arms, printer.endstops, strict=True
    ):
        lines += [
            "",
            f"[{name}]",
            f"angle: {degrees(angle) % 360.0:.6f}",
            f"arm_length: {arm / MM:.6f}",
            f"position_endstop: {endstop / MM:.6f}",
        ]
    return "\n".join(lines) + "\n"


def _heights(config: _Config) -> tuple[Array, Array, tuple[str, ...]]:
    """Return heights, readings, and remarks on what else was measured."""
    remarks = list(config.remarks)
    heights, steps = [], []
    for kind in ("manual_height", "height"):
        for number in range(1000):
            height = config.number("delta_calibrate", f"{kind}{number}", np.nan)
            if not isfinite(height):
                break
            heights.append(MM * height)
            steps.append(config.numbers("delta_calibrate", f"{kind}{number}_pos", 3))
    distances = [o for o in config.options("delta_calibrate") if o.startswith("distance")]
    count = sum(not option.endswith(("_pos1", "_pos2")) for option in distances)
    if count:
        remarks.append(
            f"{count} distance{'s' * (count > 1)} of DELTA_ANALYZE left out: distances between two "
            "measured poses are not read. They show how long the arms are; say what you know of "
            "them by --priors arm=… or --fixed arm"
        )
    if not heights:
        return np.empty(0), np.empty((0, 3)), tuple(remarks)
    ways = [MM * config.way_per_step(name) for name in _STEPPERS]
    readings = np.array(steps) * ways
    if not np.abs(np.column_stack((heights, readings))).max() <= LARGEST:
        raise MechanismError(
            f"{config.path}: a height of [delta_calibrate], or its steps times their way, is no "
            f"number up to {LARGEST:g} m"
        )
    return np.array(heights), readings, tuple(remarks)


class _Config:
    """Options of a configuration file, those of SAVE_CONFIG and of included files among them."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.remarks: list[str] = []
        self._left = LARGEST_FILE["printer"]  # of all files together
        regular: list[str] = []
        saved: list[str] = []
        for line in self._lines(path, ()):
            if line.startswith(_SAVED.rstrip()):
                if saved or line.startswith(f"{_SAVED}["):  # behind the block's heading
                    saved.append(line[len(_SAVED) :])
            else:
                regular.append(line.split("#")[0])
        self._parsers = (self._parsed(regular), self._parsed(saved))

    def _lines(self, path: Path, above: tuple[Path, ...]) -> Iterator[str]:
        """Yield the lines of a file, those of included files in their place.

        Args:
            path: The file.
            above: The files that include it.

        Raises:
            FileError: the file is missing or cannot be read.
            MechanismError: files that include each other, or too many of them.
        """
        text = read_text(path, LARGEST_FILE["printer"], MechanismError, pipe=not above)
        if path.resolve() in above:
            raise MechanismError(f"{self.path}: files include each other, {path.name} among them")
        if self._left < 0:
            raise MechanismError(f"{self.path}: more is included than a configuration can be")
        self._left -= max(len(text), _ONE_MORE)
        for line in lines_of(text):
            bare = line.split("#")[0].strip()
            if not (bare.startswith("[include ") and bare.endswith("]")):
                yield line
                continue
            name = bare[len("[include ") : -1].strip()
            included = self._included(path, name)
            if not included:
                self.remarks.append(
                    f"{name[:100]!r}, which {path.name} includes, was not found in its folder"
                )
            for file in included:
                yield from self._lines(file, (*above, path.resolve()))

    def _included(self, path: Path, name: str) -> list[Path]:
        """Return the files that a name or pattern means, none outside the first file's folder.

        Patterns do not lead upwards, where there may be much to search.
        """
        if name.startswith("/") or (".." in Path(name).parts and glob.has_magic(name)):
            return []
        top = self.path.resolve().parent
        try:
            names = sorted(glob.glob(name, root_dir=path.parent))  # noqa: PTH207
            files = [file for file in (path.parent / n for n in names) if file.is_file()]
            return [file for file in files if file.resolve().is_relative_to(top)]
        except (OSError, ValueError):  # a name that no file can have
            return []

    def _parsed(self, lines: Sequence[str]) -> configparser.RawConfigParser:
        parser = configparser.RawConfigParser(strict=False, inline_comment_prefixes=(";", "#"))
        try:
            parser.read_string("\n".join(lines), str(self.path))
        except configparser.Error as error:
            fault = str(error).splitlines()[0]
            raise MechanismError(f"{self.path}: not a configuration of Klipper: {fault}") from error
        return parser

    def options(self, section: str) -> set[str]:
        """Return the names of the options of a section."""
        return {o for p in self._parsers if p.has_section(section) for o in p.options(section)}

    def text(self, section: str, option: str, default: str | None = None) -> str:
        """Return an option.

        Raises:
            MechanismError: there is none, and no default.
        """
        for parser in self._parsers:
            if parser.has_option(section, option):
                return parser.get(section, option).strip()
        if default is None:
            raise MechanismError(f"{self.path}: no option {option!r} in section [{section}]")
        return default

    def number(self, section: str, option: str, default: float | None = None) -> float:
        """Return an option as a number.

        Raises:
            MechanismError: there is none, and no default; not a finite number.
        """
        if default is not None and option not in self.options(section):
            return default
        return self.numbers(section, option, 1)[0]

    def numbers(self, section: str, option: str, count: int) -> list[float]:
        """Return an option as so many numbers.

        Raises:
            MechanismError: there is none, or it is something else.
        """
        text = self.text(section, option)
        values = [plain_number(part) for part in text.split(",")]
        if len(values) != count or not np.isfinite(values).all():
            expected = "a finite number" if count == 1 else f"{count} finite numbers"
            raise MechanismError(
                f"{self.path}: [{section}] {option} is {text!r}; expected {expected}"
            )
        return values

    def way_per_step(self, stepper: str) -> float:
        """Return the way of a carriage for a step, [mm] (``klippy/stepper.py``).

        Raises:
            MechanismError: options that do not determine it.
        """
        if "rotation_distance" not in (known := self.options(stepper)) and "step_distance" in known:
            return self.number(stepper, "step_distance")  # before 2021
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
