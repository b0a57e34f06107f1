"""Kinematics of a machine as one Python file, or as one C99 header, that need nothing of pincal."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from pprint import pformat
from textwrap import fill
from typing import Any

import numpy as np

from pincal import __version__
from pincal.formats.deployed.tables import Deployed, Table

_HERE = Path(__file__).parent
_PLACE = "MACHINE: dict[str, Any] = {}\n"
_NO_LOAD: Table = {
    "bodies": [],
    "columns": [],
    "active": [0],
    "sensors": [],
    "gravity": [0.0] * 3,
    "width": 1,
}
_NOWHERE: Table = {"start": np.eye(4)[:3].ravel(), "joints": []}
_KINDS = {"sine": 0, "cosine": 1, "power": 2}


def python_file(deployed: Deployed) -> str:
    """Return the kinematics of a machine as the text of a Python file."""
    source = (_HERE / "kinematics.py").read_text("utf-8")
    literal = re.sub(r"\binf\b", 'float("inf")', pformat(deployed.tables, width=96, compact=True))
    title = (
        f'"""Kinematics of {_plain(deployed.mechanism.name)}, written by pincal {__version__}.\n\n'
    )
    return source.replace('"""', title, 1).replace(_PLACE, f"MACHINE: dict[str, Any] = {literal}\n")


def c_header(deployed: Deployed, prefix: str) -> str:
    """Return the kinematics of a machine as the text of a C99 header.

    Args:
        deployed: The machine.
        prefix: What names of functions begin with, such as ``hexapod``.
    """
    source = (_HERE / "kinematics.h").read_text("utf-8")
    title = f"/* {_title(deployed)}\n\n   "
    text = source.replace("/* ", title, 1).replace("/* TABLES */", _c_tables(deployed.tables))
    return text.replace("machine_", f"{prefix}_").replace("MACHINE_", f"{prefix.upper()}_")


def _title(deployed: Deployed) -> str:
    return f"Kinematics of {_plain(deployed.mechanism.name)}, written by pincal {__version__}."


def _plain(text: str) -> str:
    """Return a name that ends neither a comment nor a text."""
    return re.sub(r"[^\w .+-]", "_", text)


def _c(value: Any) -> str:
    """Return a value in C, tuples and arrays in braces; a text stands for itself."""
    if isinstance(value, str):
        return value
    if isinstance(value, (int, np.integer)):
        return str(int(value))
    if isinstance(value, float):
        return re.sub(r"\binf\b", "INFINITY", repr(float(value)))
    return f"{{{', '.join(map(_c, value))}}}"


def _several(type_: str, items: Sequence[Any]) -> str:
    """Return where the first of these items is, NULL of none."""
    return f"(const {type_}[]){_c(items)}" if len(items) else "NULL"


def _c_chain(chain: Table) -> tuple[Any, ...]:
    moves = [
        (turns, axis, len(rates), _several("machine_rate", rates), behind)
        for turns, axis, rates, behind in chain["joints"]
    ]
    return chain["start"], len(moves), _several("machine_move", moves)


def _c_terms(terms: Any) -> tuple[int, str]:
    items = [(a, place, _KINDS[kind], *rest) for a, place, (kind, *rest) in terms]
    return len(items), _several("machine_term", items)


def _c_sensors(sensors: Any) -> str:
    items = [(s["slope"], s["start"], *_c_terms(s["terms"])) for s in sensors]
    return _several("machine_sensor", items)


def _c_form(form: Table | None) -> tuple[Any, ...]:
    if form is None:
        return (0,)
    kind = 1 if form["frame"] is None else 3 if form["radius"] else 2
    scalars = (form["delta"], form["side"], form["length"], form["mode"], form["radius"])
    axes, frame = np.ravel(form["axes"]), np.ravel(form["frame"] or np.zeros(9))
    return kind, form["plane"], form["centre"], axes, *scalars, frame


def _c_end(end: Table) -> tuple[Any, ...]:
    rows, chains = end["rows"], (end["tip"], end["frame"] or _NOWHERE, end["point"])
    padded = [*rows, *[0] * (6 - len(rows))]
    return len(rows), padded, end["frame"] is not None, *map(_c_chain, chains)


def _c_leg(leg: Table) -> str:
    unknown, deformations = [*leg["active"], *leg["passive"]], leg["deformations"]
    positions = (leg["home"], *zip(*leg["limits"], strict=True))
    counted = (leg["joints"], leg["active"], leg["passive"], deformations, leg["ends"])
    fields = (
        *map(len, counted),
        sum(len(end["rows"]) for end in leg["ends"]),
        leg["arm"],
        leg["size"],
        leg["mode"],
        *(_several("int", values) for values in (unknown, leg["turns"])),
        *(_several("double", values) for values in positions),
        _c_sensors(leg["sensors"]),
        _several("machine_deformation", list(map(_c_terms, deformations))),
        _several("machine_end", list(map(_c_end, leg["ends"]))),
        _c_form(leg["form"]),
    )
    return "\n" + fill(_c(fields), 100, break_long_words=False, break_on_hyphens=False)


def _c_sizes(tables: Table, load: Table) -> dict[str, int]:
    """Return the sizes of a machine's tables, and of what is worked out with them."""
    legs = tables["legs"]
    rows = [sum(len(end["rows"]) for end in leg["ends"]) for leg in legs]
    unknown = [len(leg["active"]) + len(leg["passive"]) for leg in legs]
    reduced = sum(n - len(leg["passive"]) for n, leg in zip(rows, legs, strict=True))
    tall = [n + (k if n < k else 0) for n, k in zip(rows, unknown, strict=True)]
    chains = [c for leg in legs for end in leg["ends"] for c in (end["tip"], end["frame"]) if c]
    chains += [chain for _, chain in load["bodies"]]
    return {
        "LEGS": len(legs),
        "DOF": len(tables["twist"]),
        "LENGTHS": tables["lengths"],
        "TURNS": len(tables["turns"]),
        "READINGS": len(tables["readings"]),
        "JOINTS": sum(len(leg["joints"]) for leg in legs),
        "INFLUENCES": len(tables["influences"]),
        "MOST": max(len(leg["joints"]) + len(leg["deformations"]) for leg in legs),
        "TALL": max(*tall, reduced),
        "REDUCED": max(reduced, 1),
        "MOVES": max(1, *(len(chain["joints"]) for chain in chains)),
        "BODIES": len(load["bodies"]),
        "LOADS": len(load["columns"]),
        "LOAD_WIDTH": load["width"],
    }


def _c_tables(tables: Table) -> str:
    """Return sizes and tables of a machine in C."""
    load = tables["load"] or _NO_LOAD
    sizes = _c_sizes(tables, load)
    bodies = [(mass, _c_chain(chain)) for mass, chain in load["bodies"]]
    values = {
        "char *const machine_reading_names[]": [f'"{_plain(n)}"' for n in tables["readings"]],
        "double machine_home[]": tables["home"],
        "double machine_home_readings[]": tables["home_readings"],
        "double machine_frame[]": tables["frame"],
        "double machine_tool[]": tables["tool"],
        "double machine_turn_axis[]": [*tables["turns"], [0.0] * 3][0],
        "double machine_gravity[]": load["gravity"],
        "double machine_size": tables["size"],
        "double machine_assembly": tables["assembly"],
        "int machine_freedoms[]": tables["twist"],
        "machine_body machine_bodies[]": bodies or [(0.0, _c_chain(_NOWHERE))],
        "int machine_load_active[]": load["active"],
        "machine_sensor *const machine_load_sensors": _c_sensors(load["sensors"]),
        "int machine_loads[][2]": load["columns"] or [(0, 0)],
        "machine_leg machine_legs[]": list(map(_c_leg, tables["legs"])),
    }
    if grid := tables["grid"]:
        sizes["GRID"] = grid["count"]
        ends = {f"double machine_grid_{end}[]": grid[end] for end in ("low", "high")}
        values |= {**ends, "double machine_grid[]": grid["twists"]}
    lines = [f"#define MACHINE_{name} {size}" for name, size in sizes.items()]
    lines += [f"static const {name} = {_c(value)};" for name, value in values.items()]
    return "\n".join(lines)
