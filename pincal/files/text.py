"""Files are read whole, up to a size, as UTF-8 text; numbers in them are in plain digits."""

from __future__ import annotations

import logging
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from math import isnan, nan
from pathlib import Path
from typing import Annotated

from lxml import etree
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, FiniteFloat

from pincal.errors import FileError, MeasurementError, MechanismError, PincalError
from pincal.model.checks import LARGEST
from pincal.model.units import UNITS

LARGEST_FILE = {"table": 2**28, "result": 2**28, "XML": 2**24, "printer": 2**22, "YAML": 2**20}
"""Sizes up to which files are read, [bytes], by what they hold."""
_log = logging.getLogger(__name__)
_inputs: ContextVar[set[tuple[int, int]] | None] = ContextVar("inputs", default=None)
_CHUNK = 64 * 1024  # bytes
_UTF16 = re.compile(b"\xff\xfe|\xfe\xff|(?:[^\\0]\\0){2}|(?:\\0[^\\0]){2}", re.DOTALL)
_BEGUN = re.compile(r"\s*[-+.]?[0-9].*[^-+.0-9eE\s]")  # 0,02 and 0.02mm
_NUMBER_WITH_UNIT = re.compile(
    r"\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?|[-+]?(?:nan|inf))\s*\[?([^\d\s\]]*)\]?\s*"
)
_LINE = re.compile("\r\n|\r|\n")


@contextmanager
def sparing_inputs() -> Iterator[None]:
    """Remember which files are read inside, so that ``files.output`` never replaces them."""
    token = _inputs.set(set())
    try:
        yield
    finally:
        _inputs.reset(token)


def is_input(path: Path) -> bool:
    """Return whether a file that exists was read by the command at work, by whatever name."""
    inputs = _inputs.get()
    if not inputs:
        return False
    status = path.stat()
    return (status.st_dev, status.st_ino) in inputs


def read_bytes(
    path: Path, largest: int, error_type: type[PincalError], *, pipe: bool = False
) -> bytes:
    """Return what a file holds, of which no more than ``largest`` is ever read.

    Args:
        path: The file.
        largest: Size up to which it is read, [bytes].
        error_type: Raised if it is larger.
        pipe: Whether it may be a pipe or a device.

    Raises:
        FileError: the file is missing or cannot be read.
        PincalError: of the given type: it is too large.
    """
    parts, size = [], 0
    try:
        status = path.stat()
        if not (pipe or stat.S_ISREG(status.st_mode) or stat.S_ISDIR(status.st_mode)):
            raise FileError(f"cannot read {path}: a device or a pipe; name a file")
        if status.st_size <= largest:
            if (inputs := _inputs.get()) is not None:
                inputs.add((status.st_dev, status.st_ino))
            with path.open("rb") as file:
                while size <= largest and (part := file.read(_CHUNK)):
                    parts.append(part)
                    size += len(part)
    except FileError:
        raise
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror or error}") from error
    except ValueError as error:  # a name that no file can have
        raise FileError(f"cannot read {str(path)!r}: {error}") from error
    if max(size, status.st_size) > largest:
        raise error_type(f"{path}: larger than {largest // 2**20} MiB; not a file of this kind")
    return b"".join(parts)


def read_text(
    path: Path,
    largest: int,
    error_type: type[PincalError],
    *,
    pipe: bool = False,
    otherwise: str = "",
) -> str:
    """Return a file's text without its byte order mark; line ends stay: see ``read_bytes``.

    Args:
        path: The file.
        largest: Size up to which it is read, [bytes].
        error_type: Raised if it is no text.
        pipe: Whether it may be a pipe or a device.
        otherwise: Encoding of a file in which nothing outside ASCII is UTF-8; said if it is used.

    Raises:
        FileError: the file is missing or cannot be read.
        PincalError: of the given type: it is too large, not UTF-8, or no text.
    """
    data = read_bytes(path, largest, error_type, pipe=pipe)
    excel = " (in Excel: CSV UTF-8)" if path.suffix.lower() == ".csv" else ""
    if _UTF16.match(data):
        raise error_type(f"{path}: UTF-16 text; save it as UTF-8{excel}")
    if (nul := data.find(b"\0")) >= 0:
        line = len(_LINE.findall(data[:nul].decode("latin-1"))) + 1
        raise error_type(f"{path}: no text, line {line} has NUL bytes; save it as UTF-8{excel}")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if otherwise and data.decode("utf-8", "ignore").isascii():
            with suppress(UnicodeDecodeError):
                text = data.decode(otherwise)
                _log.info("%s: not UTF-8; read as %s", path, otherwise)
                return text
        line = len(_LINE.findall(data[: error.start].decode("latin-1"))) + 1
        raise error_type(
            f"{path}: not UTF-8 text ({error.reason} in line {line}); save it as UTF-8{excel}"
        ) from error


def lines_of(text: str) -> list[str]:
    """Return the lines of a text, which end as Unix, Windows or old Macs end them."""
    return _LINE.split(text)


def plain_number(text: str) -> float:
    """Return the number that a text says, NaN if it says none.

    Digits are ASCII and without gaps: other programs would take ``１`` or ``1_000`` for
    something else than Python does.
    """
    bare = text.strip()
    try:
        return float(bare) if bare.isascii() and "_" not in bare else nan
    except ValueError:
        return nan


def in_si(text: str, dimensions: str, bare: str | None = "") -> float:
    """Return a number that may have a unit, in SI: 2e-5, 20um, '20 µm', 5mrad.

    Args:
        text: What was typed.
        dimensions: Those of the units that it may have: ``"m"``, ``"rad"``, or both with a blank.
        bare: Unit of a number without one: SI if empty; None if it must have one.

    Raises:
        MeasurementError: no number, or another unit.
    """
    match = _NUMBER_WITH_UNIT.fullmatch(text)
    number, unit = match.groups() if match else (text, "")
    value = plain_number(number)
    dimension, factor = UNITS.get(unit or bare or "", ("", 1.0))
    no_number = isnan(value) and "nan" not in number
    foreign_unit = unit and dimension not in dimensions.split()
    if no_number or foreign_unit or (bare is None and not unit):
        known = [name for name, (kind, _) in UNITS.items() if kind in dimensions.split()]
        raise MeasurementError(f"{text!r}: expected a number, with one of {', '.join(known)}")
    return float(f"{value * factor:.15g}")  # 20um is 2e-05, not 1.9999999999999998e-05


def why_no_number(text: str, units: str = "m or rad", place: str = "") -> str:
    """Return why a text is no number that can be used.

    Args:
        text: What is written for a number; ``plain_number`` is NaN, or above ``LARGEST``.
        units: In which numbers are expected there.
        place: Where it is; follows the text.
    """
    named = f"{text!r}{place}"
    if abs(plain_number(text)) > LARGEST:
        return f"{named} is not a finite number, at most {LARGEST:g} in size"
    if not _BEGUN.match(text):
        return f"{named} is not a finite number"
    return f"{named} is not a finite number: decimals take a point, units ({units}) are not written"


_PLACE = re.compile(r", line \d+, column \d+$")


def read_xml(path: Path, root: str) -> etree._Element:
    """Return the root element of a file; entities are not resolved and nothing is fetched.

    Args:
        path: The file.
        root: Name that its root element must have.

    Raises:
        FileError: the file is missing or cannot be read.
        MechanismError: too large, not well-formed, with entities, or another root element.
    """
    text = read_bytes(path, LARGEST_FILE["XML"], MechanismError)
    parser = etree.XMLParser(resolve_entities=False, no_network=True, huge_tree=False)
    try:
        element = etree.fromstring(text, parser)
    except etree.XMLSyntaxError as error:
        fault = _PLACE.sub("", str(error.msg))
        raise MechanismError(
            f"{path}, line {error.lineno or 1}: the file does not parse: {fault}"
        ) from error
    if element.tag != root:
        raise MechanismError(f"{path}: expected a <{root}> element, found <{element.tag}>")
    dtd = element.getroottree().docinfo.internalDTD
    if dtd is not None and any(True for _ in dtd.iterentities()):  # type: ignore[union-attr]
        raise MechanismError(f"{path}: declares entities, which are not read; write them out")
    return element


Name = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$", max_length=64)]


def _number(value: object) -> object:
    if isinstance(value, bool):
        raise ValueError("a number, not true or false, is expected")
    if isinstance(value, str):  # 1e-3, which is text to YAML
        value = plain_number(value)
        if isnan(value):
            raise ValueError("a number is expected")
    return value


Number = Annotated[FiniteFloat, Field(ge=-LARGEST, le=LARGEST), BeforeValidator(_number)]


class Strict(BaseModel):
    """Refuses keys that it does not know."""

    model_config = ConfigDict(extra="forbid")
