"""Kinematics of a machine as one Python file, or as one C99 header, that need nothing of pincal."""

from __future__ import annotations

import re
from pathlib import Path
from pprint import pformat
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


def _number(value: float) -> str:
    if np.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    return repr(float(value))


def _array(values: Any, type_: str = "double") -> str:
    """Return a compound literal of numbers, NULL of none."""
    shown = map(
        _number if type_ == "double" else str, map(int if type_ == "int" else float, values)
    )
    return f"(const {type_}[]){{{', '.join(shown)}}}" if len(values) else "NULL"


def _numbers(values: Any) -> str:
    return f"{{{', '.join(map(_number, values))}}}"


def _several(type_: str, items: list[str]) -> str:
    return f"(const machine_{type_}[]){{{', '.join(items)}}}" if items else "NULL"


def _c_chain(chain: Table) -> str:
    moves = []
    for turns, axis, rates, behind in chain["joints"]:
        pairs = _several("rate", [f"{{{source}, {_number(rate)}}}" for source, rate in rates])
        moves.append(
            f"{{{int(turns)}, {_numbers(axis)}, {len(rates)}, {pairs}, {_numbers(behind)}}}"
        )
    return f"{{{_numbers(chain['start'])}, {len(moves)}, {_several('move', moves)}}}"


def _c_terms(terms: Any) -> str:
    items = [
        f"{{{_number(a)}, {place}, {_KINDS[kind]}, {_number(x)}, {_number(y)}, {exponent}}}"
        for a, place, (kind, x, y, exponent) in terms
    ]
    return f"{len(items)}, {_several('term', items)}"


def _c_sensors(sensors: Any) -> str:
    items = [
        f"{{{_number(s['slope'])}, {_number(s['start'])}, {_c_terms(s['terms'])}}}" for s in sensors
    ]
    return _several("sensor", items)


def _c_form(form: Table | None) -> str:
    if form is None:
        return "{0}"
    kind = 1 if form["frame"] is None else 3 if form["radius"] else 2
    frame = np.ravel(form["frame"] if form["frame"] else np.zeros(9))
    axes = np.ravel(form["axes"])
    scalars = (form["delta"], form["side"], form["length"], form["mode"], form["radius"])
    return (
        f"{{{kind}, {int(form['plane'])}, {_numbers(form['centre'])}, {_numbers(axes)}, "
        f"{', '.join(map(_number, scalars))}, {_numbers(frame)}}}"
    )


def _c_leg(leg: Table) -> str:
    ends, nothing = [], _c_chain({"start": np.eye(4)[:3].ravel(), "joints": []})
    for end in leg["ends"]:
        rows = [*end["rows"], *[0] * (6 - len(end["rows"]))]
        loop = end["frame"] is not None
        frame = _c_chain(end["frame"]) if loop else nothing
        ends.append(
            f"{{{len(end['rows'])}, {{{', '.join(map(str, rows))}}}, {int(loop)},\n      "
            f"{_c_chain(end['tip'])},\n      {frame},\n      {_c_chain(end['point'])}}}"
        )
    low, high = zip(*leg["limits"], strict=True)
    deformations = _several(
        "deformation", [f"{{{_c_terms(terms)}}}" for terms in leg["deformations"]]
    )
    counts = (
        len(leg["joints"]),
        len(leg["active"]),
        len(leg["passive"]),
        len(leg["deformations"]),
        len(ends),
        sum(len(end["rows"]) for end in leg["ends"]),
        int(leg["arm"]),
    )
    return (
        f"  {{{', '.join(map(str, counts))}, {_number(leg['size'])}, {_number(leg['mode'])},\n    "
        f"{_array([*leg['active'], *leg['passive']], 'int')}, {_array(leg['turns'], 'int')}, "
        f"{_array(leg['home'])}, {_array(low)}, {_array(high)},\n    {_c_sensors(leg['sensors'])}, "
        f"{deformations},\n    {_several('end', ends)},\n    {_c_form(leg['form'])}}}"
    )


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
    lines = [f"#define MACHINE_{name} {size}" for name, size in sizes.items()]
    lines += [
        "static const char *const machine_reading_names[] = {"
        + ", ".join(f'"{_plain(name)}"' for name in tables["readings"])
        + "};"
    ]
    vectors = {
        "home": tables["home"],
        "home_readings": tables["home_readings"],
        "frame": tables["frame"],
        "tool": tables["tool"],
        "turn_axis": [*tables["turns"], [0.0] * 3][0],
        "gravity": load["gravity"],
    }
    lines += [f"static const double machine_{k}[] = {_numbers(v)};" for k, v in vectors.items()]
    for name in ("size", "assembly"):
        lines.append(f"static const double machine_{name} = {_number(tables[name])};")
    lines.append(
        f"static const int machine_freedoms[] = {{{', '.join(map(str, tables['twist']))}}};"
    )
    bodies = [f"{{{_number(mass)}, {_c_chain(chain)}}}" for mass, chain in load["bodies"]]
    empty = "{0.0, {{0}, 0, NULL}}"
    lines.append(f"static const machine_body machine_bodies[] = {{{', '.join(bodies) or empty}}};")
    active = ", ".join(map(str, load["active"]))
    lines.append(f"static const int machine_load_active[] = {{{active}}};")
    sensors = _c_sensors(load["sensors"])
    lines.append(f"static const machine_sensor *const machine_load_sensors = {sensors};")
    loads = ", ".join(f"{{{place}, {source}}}" for place, source in load["columns"] or [(0, 0)])
    lines.append(f"static const int machine_loads[][2] = {{{loads}}};")
    shown = ",\n".join(map(_c_leg, tables["legs"]))
    return "\n".join([*lines, f"static const machine_leg machine_legs[] = {{\n{shown}\n}};"])
