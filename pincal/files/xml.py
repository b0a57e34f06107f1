"""XML of strangers is read without resolving entities, without fetching, and up to a size."""

from __future__ import annotations

import re
from pathlib import Path

from lxml import etree

from pincal.errors import MechanismError
from pincal.files.input import LARGEST_FILE, read_bytes

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
        why = _PLACE.sub("", str(error.msg))
        raise MechanismError(
            f"{path}, line {error.lineno or 1}: the file does not parse: {why}"
        ) from error
    if element.tag != root:
        raise MechanismError(f"{path}: expected a <{root}> element, found <{element.tag}>")
    dtd = element.getroottree().docinfo.internalDTD
    if dtd is not None and any(True for _ in dtd.iterentities()):  # type: ignore[union-attr]
        raise MechanismError(f"{path}: declares entities, which are not read; write them out")
    return element
