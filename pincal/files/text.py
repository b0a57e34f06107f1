"""Reading of whole files up to a size, as UTF-8 text, and of numbers in plain digits.

JSON that pincal writes has no infinity: an unbounded uncertainty or end of an interval is null, and
so is any number that does not exist.
"""

import logging
import re
import stat
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import fields, is_dataclass
from math import isfinite, isnan, nan
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree

from pincal.errors import FileError, MeasurementError, MechanismError, PincalError, explaining
from pincal.model.checks import LARGEST
from pincal.types import Quantity
from pincal.words.numbers import UNITS

LARGEST_FILE = {"table": 2**28, "result": 2**28, "XML": 2**24, "printer": 2**22, "YAML": 2**20}
"""Largest sizes of files that are read, [bytes], by contents."""
_log = logging.getLogger(__name__)
_inputs: ContextVar[set[tuple[int, int]] | None] = ContextVar("inputs", default=None)
_CHUNK = 64 * 1024  # bytes
_UTF16 = re.compile(b"\xff\xfe|\xfe\xff|(?:[^\\0]\\0){2}|(?:\\0[^\\0]){2}", re.DOTALL)
_BEGUN = re.compile(r"\s*[-+.]?[0-9].*[^-+.0-9eE\s]")  # 0,02 and 0.02mm
_NUMBER_WITH_UNIT = re.compile(
    r"\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?|[-+]?(?:nan|inf))\s*\[?([^\d\s\]]*)\]?\s*"
)
LINE_END = re.compile("\r\n|\r|\n")
"""End of a line by Unix, Windows or old Macs."""
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+(?:[eE][-+]?\d+)?", re.ASCII)
_DECIMAL_POINT = re.compile(r"[-+]?\d*\.\d*(?:[eE][-+]?\d+)?", re.ASCII)
_GROUPED, _SPACES = r"[-+]?[1-9]\d{{0,2}}({0}\d{{3}})+", "['’ \u00a0\u202f]"
_THOUSANDS = {
    ",": re.compile(_GROUPED.format(",") + r"\.\d+", re.ASCII),
    r"\.": re.compile(_GROUPED.format(r"\.") + r",\d+", re.ASCII),
    _SPACES: re.compile(_GROUPED.format(_SPACES) + r"([.,]\d+)?", re.ASCII),
}
"""Separators of thousands, as patterns, and numbers that certainly contain them."""


@contextmanager
def sparing_inputs() -> Iterator[None]:
    """Record the files that are read inside, so that ``files.output`` never replaces them."""
    token = _inputs.set(set())
    try:
        yield
    finally:
        _inputs.reset(token)


def is_input(path: Path) -> bool:
    """Return whether the running command has read an existing file, by whatever name."""
    inputs = _inputs.get()
    if not inputs:
        return False
    status = path.stat()
    return (status.st_dev, status.st_ino) in inputs


def read_bytes(
    path: Path, largest: int, error_type: type[PincalError], *, pipe: bool = False
) -> bytes:
    """Return the contents of a file of at most ``largest`` bytes.

    Raises ``error_type`` if it is larger, and FileError if it cannot be read, or is a device or a
    pipe and ``pipe`` is not set.
    """
    with explaining(f"cannot read {path}", ValueError):  # a name that no file can have
        status = path.stat()
        if not (pipe or stat.S_ISREG(status.st_mode) or stat.S_ISDIR(status.st_mode)):
            raise FileError(f"cannot read {path}: a device or a pipe; name a file")
        if tables := sorted(path.glob("*.csv")):
            raise FileError(f"{path} is a folder; name a table in it, such as {tables[-1]}")
        data = bytearray()
        if status.st_size <= largest:
            if (inputs := _inputs.get()) is not None:
                inputs.add((status.st_dev, status.st_ino))
            with path.open("rb") as file:
                while len(data) <= largest and (part := file.read(_CHUNK)):
                    data += part
    if max(len(data), status.st_size) > largest:
        raise error_type(f"{path}: larger than {largest // 2**20} MiB; not a file of this kind")
    return bytes(data)


def read_text(
    path: Path,
    largest: int,
    error_type: type[PincalError],
    *,
    pipe: bool = False,
    otherwise: str = "",
) -> str:
    """Return a file's text with its line ends unchanged: see ``read_bytes``.

    If no character outside ASCII is UTF-8, the encoding ``otherwise`` is taken and logged.
    """
    data = read_bytes(path, largest, error_type, pipe=pipe)
    excel = " (in Excel: CSV UTF-8)" if path.suffix.lower() == ".csv" else ""
    if _UTF16.match(data):
        raise error_type(f"{path}: UTF-16 text; save it as UTF-8{excel}")
    if (nul := data.find(b"\0")) >= 0:
        line = len(LINE_END.findall(data[:nul].decode("latin-1"))) + 1
        raise error_type(f"{path}: no text, line {line} has NUL bytes; save it as UTF-8{excel}")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if otherwise and data.decode("utf-8", "ignore").isascii():
            with suppress(UnicodeDecodeError):
                text = data.decode(otherwise)
                _log.info("%s: not UTF-8; read as %s", path, otherwise)
                return text
        line = len(LINE_END.findall(data[: error.start].decode("latin-1"))) + 1
        raise error_type(
            f"{path}: not UTF-8 text ({error.reason} in line {line}); save it as UTF-8{excel}"
        ) from error


class Numeral(str):
    """The text of a cell that holds a number, not text, so that its point is a decimal point."""


def plain_number(text: str) -> float:
    """Return the number that a text holds in ASCII digits, NaN if it is none."""
    bare = text.strip()  # Python reads ``１`` and ``1_000`` otherwise than other programs
    try:
        return float(bare) if bare.isascii() and "_" not in bare else nan
    except ValueError:
        return nan


def in_plain_digits(
    rows: list[list[str]], units: Sequence[str | None], *, commas: bool
) -> list[str]:
    """Write 1234.5 for 1,234.5, 1.234,5 and 1234,5 in place; return notes on what was replaced.

    A sign separates thousands if a number in a column with a unit certainly has it as a separator,
    and no number has it as the decimal sign. Commas are decimal commas if ``commas`` allows it and
    no cell has a decimal point (numbers of a sheet do not count). Other cells are not changed.
    """
    texts = _typed(rows, range(len(units)))
    measured = _typed(rows, [place for place, unit in enumerate(units) if unit])
    signs = [sign for sign in _THOUSANDS if _separates(sign, measured)]
    plain = {cell: _ungrouped(cell, signs) for cell in texts}
    decimal = {cell for cell, digits in plain.items() if _DECIMAL_COMMA.fullmatch(digits)}
    commas &= bool(decimal) and not any(map(_DECIMAL_POINT.fullmatch, plain.values()))
    plain |= {cell: plain[cell].replace(",", ".") for cell in decimal if commas}
    for row in rows:
        row[:] = [x if isinstance(x, Numeral) else plain[x.strip()] for x in row]
    return ["thousands separators"] * bool(signs) + ["decimal commas"] * commas


def _typed(rows: list[list[str]], columns: Sequence[int]) -> set[str]:
    """Return the cells of some columns that were typed as text, unlike numbers of a sheet."""
    return {row[i].strip() for row in rows for i in columns if not isinstance(row[i], Numeral)}


def _separates(sign: str, cells: Iterable[str]) -> bool:
    """Return whether a sign separates thousands in some cell, and is the decimal sign of none."""
    decimal = {",": _DECIMAL_COMMA, r"\.": _DECIMAL_POINT}.get(sign)
    sure, numbers = _THOUSANDS[sign], [cell for cell in cells if re.search(sign, cell)]
    if decimal and any(map(decimal.fullmatch, (_ungrouped(cell, [sign]) for cell in numbers))):
        return False
    return any(map(sure.fullmatch, numbers))


def _ungrouped(cell: str, signs: Sequence[str]) -> str:
    """Return a cell without its separators of thousands, if it is a number with such signs."""
    for sign in signs:
        if re.fullmatch(_GROUPED.format(sign) + r"([.,]\d+)?", cell, re.ASCII):
            return re.sub(sign, "", cell)
    return cell


def in_si(text: str, dimensions: str, bare: str | None = "") -> Quantity:
    """Return a number with an optional unit in SI, from 2e-5, 20um, '20 µm' or 5mrad.

    ``dimensions`` are the allowed ones: "m", "rad", or several separated by blanks. ``bare`` is the
    unit of a number without a unit: SI if empty; None if a unit is required.
    """
    match = _NUMBER_WITH_UNIT.fullmatch(text)
    number, unit = match.groups() if match else (text, "")
    value = plain_number(number)
    dimension, factor = UNITS.get(unit or bare or "", ("", 1.0))
    no_number = isnan(value) and "nan" not in number
    foreign_unit = unit and dimension not in dimensions.split()
    if no_number or foreign_unit or (bare is None and not unit):
        known = [name for name, (kind, _) in UNITS.items() if kind in dimensions.split()]
        pointed = " and a decimal point, no comma" * ("," in number)
        units = f"with one of {', '.join(known)}{pointed}"
        raise MeasurementError(f"{text!r}: expected a number, {units}")
    quantity = Quantity(f"{value * factor:.15g}")  # 20um is 2e-05, not 1.9999999999999998e-05
    quantity.dimension = dimension if unit else ""
    return quantity


def why_no_number(text: str, units: str = "m or rad", place: str = "") -> str:
    """Return why a text is no usable number, for a message; ``place`` follows the text there."""
    named = f"{text!r}{place}"
    if abs(plain_number(text)) > LARGEST:
        return f"{named} is not a finite number, at most {LARGEST:g} in size"
    if not _BEGUN.match(text):
        return f"{named} is not a finite number"
    return f"{named} is not a finite number: one decimal point is expected, and no unit ({units})"


def check_name(name: str) -> None:
    """Raise FileError if a file's name or path, which goes into other files, is not UTF-8."""
    if any("\ud800" <= character <= "\udfff" for character in name):
        raise FileError(f"{name}: a name that is not UTF-8 text; rename it")


def read_xml(path: Path, root: str) -> etree._Element:
    """Return the root element, named ``root``, of an XML file, without resolving entities."""
    check_name(path.name)
    parser = etree.XMLParser(resolve_entities=False, no_network=True, huge_tree=False, recover=True)
    with suppress(etree.XMLSyntaxError):  # for an empty file, which the log reports, too
        element = etree.fromstring(read_bytes(path, LARGEST_FILE["XML"], MechanismError), parser)
    for fault in parser.error_log.filter_from_fatals():  # a prefix without a namespace is not fatal
        raise MechanismError(
            f"{path}, line {fault.line}: the file does not parse: {fault.message.strip()}"
        )
    if element.tag != root:
        raise MechanismError(f"{path}: expected a <{root}> element, found <{element.tag}>")
    dtd = element.getroottree().docinfo.internalDTD
    if dtd is not None and any(True for _ in dtd.iterentities()):  # type: ignore[union-attr]
        raise MechanismError(f"{path}: declares entities, which are not read; write them out")
    return element


def plain(value: Any) -> Any:
    """Convert dataclasses, mappings, sequences and arrays to plain data for JSON."""
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    return None if isinstance(value, float) and not isfinite(value) else value
