"""Reading of setups from YAML files: targets, contacts, distances, instruments and boards."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from pincal.errors import MeasurementError, located
from pincal.files.yaml import Entry, Readers, Vector, read_yaml
from pincal.instruments.board import CHEQUERED, UNCHECKED, read_board
from pincal.instruments.camera import Camera, Markers
from pincal.instruments.lens import Lens
from pincal.model import Setup, Target
from pincal.model.checks import must_be
from pincal.model.relations import Contact, Distance, Tracker
from pincal.model.setup import Systematic

T = TypeVar("T", Lens, Markers)


def read_setup(source: Setup | str | Path) -> Setup:
    """Return a setup as it is, or that of a YAML file: see ``Setup.from_yaml``."""
    if isinstance(source, Setup):
        return source
    path = Path(must_be(source, (Setup, str, Path), "a setup or its file", MeasurementError))
    readers: Readers = {
        "pincal_setup": lambda part: part.choice(1),
        "frame": lambda part: part.choice("base", "unknown"),
        "targets": lambda part: part.mapped(lambda p: p.built(Target)),
        "distances": lambda part: part.mapped(_distance),
        "contacts": lambda part: part.mapped(lambda p: p.built(Contact, "points", points=_points)),
        "mark": Entry.name,
        "columns": lambda part: part.mapped(Entry.text),
        "tracker": lambda part: part.built(Tracker),
        "systematic": lambda part: part.built(Systematic),
        "corners": lambda part: str(path.parent / part.text()),
        "boards": lambda part: {n: _board(p, n, path.parent) for n, p in part.pairs().items()},
        "lenses": lambda part: {n: _lens(p, n) for n, p in part.pairs().items()},
        "cameras": Entry.pairs,
    }
    with located(path, MeasurementError):
        values = read_yaml(path, MeasurementError).values(readers, ("pincal_setup",))
        unknown = values.pop("frame", "base") == "unknown"
        values["headers"] = values.pop("columns", {})
        del values["pincal_setup"]
        boards, lenses = values.pop("boards", {}), values.pop("lenses", {})
        cameras = values.pop("cameras", {}).items()
        values["instruments"] = tuple(_camera(p, name, boards, lenses) for name, p in cameras)
        return Setup(**values, unknown_frame=unknown)


def _points(part: Entry) -> dict[str, Vector | None]:
    return part.mapped(lambda p: None if p.value == "unknown" else p.vector())


def _board(entry: Entry, name: str, folder: Path) -> Markers:
    """Return the markers of a board that has points, or the file of a printed board."""
    if isinstance(entry.value, str):
        return Markers(name=name, **_printed(folder / entry.text()))
    place = dict.fromkeys(("at", "rotation", "normal"), Entry.vector)
    numbers = dict.fromkeys(("tolerance", "scale", "stretch", "clear"), Entry.number)
    readers: Readers = {"points": _points, "file": Entry.text, "known": Entry.flag}
    values = entry.values({**readers, **place, **numbers})
    if "file" in values:
        values = _printed(folder / values.pop("file")) | values
    elif "points" not in values:
        entry.refuse("points by name, or the file of a board is expected")
    return Markers(name=name, **values)


def _printed(path: Path) -> dict[str, Any]:
    """Return the fields of a printed board's markers; positions of loose ones are unknown."""
    board = read_board(path)
    if board.kind == "markers":
        return {"points": dict.fromkeys(board.points)}
    clear = board.clear if board.kind in CHEQUERED else 0.0  # only OpenCV can tell for markers
    fields = {"points": board.points, "scale": board.scale_sigma, "stretch": UNCHECKED}
    return {**fields, "clear": clear, "normal": (0.0, 0.0, 1.0)}


def _lens(entry: Entry, name: str) -> Lens:
    def pair(part: Entry) -> tuple[float, float]:
        first, second = (item.number() for item in part.items(2, 2))
        return first, second

    readers: Readers = {
        "size": lambda part: tuple(int(number) for number in pair(part)),
        "focal": lambda part: pair(part) if isinstance(part.value, list) else part.number(),
        "centre": pair,
        "distortion": lambda part: tuple(item.number() for item in part.items(0, 8)),
        "fisheye": Entry.flag,
        "unknown": lambda part: (
            part.value if isinstance(part.value, bool) else part.mapped(Entry.number)
        ),
        "focus": pair,
    }
    return Lens(name=name, **entry.values(readers, ("size",)))


def _camera(
    entry: Entry, name: str, boards: Mapping[str, Markers], lenses: Mapping[str, Lens]
) -> Camera:
    """Return a camera with the named lens and board; by default the only ones of the setup."""
    readers: Readers = {
        "lens": lambda part: _named(part, lenses, "lens"),
        "board": lambda part: _named(part, boards, "board"),
        "on": lambda part: part.choice("room", "platform") == "platform",
        "known": Entry.flag,
        **dict.fromkeys(("at", "towards", "rotation"), Entry.vector),
    }
    values = entry.values(readers)
    for key, known in (("lens", lenses), ("board", boards)):
        if key not in values and len(known) != 1:
            entry.fail(f"key {f'cameras.{name}.{key}'!r} is missing: there are {len(known)}")
        values.setdefault(key, *known.values())
    markers, on_platform = values.pop("board"), values.pop("on", False)
    return Camera(name, values.pop("lens"), markers, on_platform, **values)


def _named(entry: Entry, known: Mapping[str, T], kind: str) -> T:
    if (name := entry.text()) not in known:
        entry.refuse(f"expected the name of a {kind}: {', '.join(known) or 'there are none'}")
    return known[name]


def _distance(entry: Entry) -> Distance:
    readers: Readers = {"from": Entry.vector, "target": Entry.name, "noise": Entry.number}
    values = entry.values(readers, ("from",))
    return Distance(values.pop("from"), **values)
