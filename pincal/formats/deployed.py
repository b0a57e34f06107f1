"""Kinematics of a machine as one Python file, or one C99 header, that do not need pincal.

Both use the same tables. Every kinematic parameter is a joint of a leg's calibration chain
(``kinematics.chain``); at given parameters, only the joints that move remain, each followed by a
constant transform.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib.util import find_spec, module_from_spec
from math import pi
from pathlib import Path
from pprint import pformat
from textwrap import fill
from typing import Any, cast

import numpy as np
from scipy.stats.qmc import Halton

from pincal import __version__
from pincal.errors import MechanismError
from pincal.formats.corrections import CorrectionGrid
from pincal.kinematics.chain import elementary_joints, leaders
from pincal.kinematics.closing import home_mode, sensor_law
from pincal.kinematics.closure import LegClosure, nominal_legs
from pincal.kinematics.configurations import joints_at
from pincal.kinematics.forward import forward, reading_range
from pincal.model import LOAD, Joint, Leg, Load, Mechanism, Plan
from pincal.model.sensor import PlacedTerm, SensorLaw
from pincal.model.terms import Harmonic, Power
from pincal.types import Array

Table = dict[str, Any]
_AXES = dict(zip("xyz", np.eye(3), strict=True))
_NO_SHIFT = np.eye(4)
_DIGITS = 9  # decimals of twists on a grid, [m] and [rad]
_STARTS, _DRAWN = 32, 256  # starting configurations for joints, and readings drawn for them
_START_DIGITS = 4  # decimals of starting configurations, [m] and [rad]
_LEFT = "left"  # prefix of the reason that all legs close, but in another mode
_TEMPLATE = Path(__file__).with_name("controller_kinematics.py")
_PLACE = "MACHINE: dict[str, Any] = {}\n"
_DECLARED = {
    "readings": "machine_text machine_reading_names[]",
    "home": "double machine_home[]",
    "home_readings": "double machine_home_readings[]",
    "frame": "double machine_frame[]",
    "tool": "double machine_tool[]",
    "size": "double machine_size",
    "assembly": "double machine_assembly",
    "twist": "int machine_freedoms[]",
    "turns": "double machine_turn_axes[][3]",
    "load": "machine_gravity machine_load",
    "grid": "machine_corrections machine_grid",
    "starts": "double machine_starts[][12]",
    "legs": "machine_leg machine_legs[]",
}
"""C declarations of a machine's tables."""


class Several(list[Any]):
    """A list of any length: in C a count and a pointer to the first item."""

    def __init__(self, kind: str, items: Sequence[Any]) -> None:
        super().__init__(items)
        self.kind = kind


@dataclass(frozen=True)
class Deployed:
    """A machine for a controller, with the frame and tool in which it was measured."""

    mechanism: Mechanism
    frame: Array = field(default_factory=lambda: np.eye(4))
    """T_frame_base, with the frame of the measurements, shape (4, 4)."""
    tool: Array = field(default_factory=lambda: np.eye(4))
    """T_platform_tool, with the tool at the measured point, shape (4, 4)."""
    grid: CorrectionGrid | None = None
    """Corrections of poses for a controller that knows other parameters."""

    @property
    def title(self) -> str:
        """Title of the files."""
        return f"Kinematics of {_plain(self.mechanism.name)}, written by pincal {__version__}."

    @property
    def tables(self) -> Table:
        """Tables of the machine; the sign of home's assembly mode is set by forward kinematics."""
        return cast(Table, self.kinematics.MACHINE)

    @cached_property
    def kinematics(self) -> Any:
        """A separate copy of the module that is deployed, with the tables of the machine."""
        spec: Any = find_spec(f"{__package__}.{_TEMPLATE.stem}")
        kinematics: Any = module_from_spec(spec)
        spec.loader.exec_module(kinematics)
        machine, platform, grid = self.mechanism, self.mechanism.platform, self.grid
        starts, joints = _starts(machine)
        tables = kinematics.MACHINE = {
            "name": machine.name,
            "readings": list(machine.reading_names),
            "units": list(machine.reading_units),
            "influences": list(machine.influences),
            "coordinates": list(platform.coordinates),
            "lengths": platform.lengths,
            "turns": [np.eye(3)[row - 3].tolist() for row in platform.twist_rows if row >= 3],
            "twist": list(platform.twist_rows),
            "home": [float(value) for value in platform.home],
            "home_readings": reading_range(machine)[2].tolist(),
            "size": float(machine.size),
            "assembly": 1.0,
            "frame": _rows(self.frame),
            "tool": _rows(self.tool),
            "load": _load(machine),
            "starts": [_rows(T) for T in platform.matrices(starts)],
            "legs": [
                _leg(machine, closure, joints[closure.leg.name])
                for closure in nominal_legs(machine)
            ],
        }
        if grid is not None:
            twists = grid.twists.round(_DIGITS).ravel().tolist()
            ends = {"low": grid.low.tolist(), "high": grid.high.tolist()}
            tables["grid"] = {**ends, "count": grid.count, "twists": Several("double", twists)}
        if kinematics.forward(tables["home_readings"]).reason.startswith(_LEFT):
            tables["assembly"] = -1.0
        return kinematics


def python_file(deployed: Deployed) -> str:
    """Return the kinematics of a machine as the text of a Python file."""
    literal = re.sub(r"\binf\b", 'float("inf")', pformat(deployed.tables, width=96, compact=True))
    source = _TEMPLATE.read_text("utf-8").replace('"""', f'"""{deployed.title}\n\n', 1)
    return source.replace(_PLACE, f"MACHINE: dict[str, Any] = {literal}\n")


def c_header(deployed: Deployed, prefix: str) -> str:
    """Return the kinematics of a machine as a C99 header; names begin with ``prefix``."""
    tables = deployed.tables
    legs, load = tables["legs"], tables["load"]
    chains = [chain for leg in legs for end in leg["ends"] for chain in (end["tip"], end["met"])]
    chains += [chain for _, chain in load["bodies"]]
    reduced = sum(leg["rows"] - len(leg["passive"]) for leg in legs)
    sizes = {
        "LEGS": len(legs),
        "DOF": len(tables["twist"]),
        "LENGTHS": tables["lengths"],
        "TURNS": len(tables["turns"]),
        "READINGS": len(tables["readings"]),
        "JOINTS": sum(len(leg["joints"]) for leg in legs),
        "INFLUENCES": len(tables["influences"]),
        "MOST": max(len(leg["joints"]) + len(leg["deformations"]) for leg in legs),
        "TALL": max(reduced, *(leg["rows"] + len(leg["unknown"]) for leg in legs)),
        "REDUCED": max(reduced, 1),
        "MOVES": max(1, *(len(chain["moves"]) for chain in chains)),
        "LOAD_WIDTH": load["width"],
        "STARTS": len(tables["starts"]),
        **({"GRID": tables["grid"]["count"]} if "grid" in tables else {}),
    }
    defined = "\n".join(f"#define MACHINE_{name} {size}" for name, size in sizes.items())
    values = "\n".join(
        fill(f"static const {declared} = {_c(tables[name])};", 100, break_on_hyphens=False)
        for name, declared in _DECLARED.items()
        if name in tables
    )
    text = _TEMPLATE.with_suffix(".h").read_text("utf-8")
    text = text.replace("/* ", f"/* {deployed.title}\n\n   ", 1)
    text = text.replace("/* SIZES */", defined).replace("/* TABLES */", values)
    return text.replace("machine_", f"{prefix}_").replace("MACHINE_", f"{prefix.upper()}_")


def _plain(text: str) -> str:
    """Return a name without characters that could end a comment or a string."""
    return re.sub(r"[^\w .+-]", "_", text)


def _c(value: Any) -> str:
    """Return a value in C; arrays and structs are in braces, fields are the keys of a table."""
    if isinstance(value, dict):
        counted = [(f"n_{name}", len(v)) for name, v in value.items() if isinstance(v, Several)]
        fields = (f".{name} = {_c(v)}" for name, v in (*counted, *value.items()))
        return f"{{{', '.join(fields)}}}"
    if isinstance(value, Several):
        return f"(const {value.kind}[]){_c([*value])}" if value else "NULL"
    if isinstance(value, str):
        return f'"{_plain(value)}"'
    if isinstance(value, float):
        return re.sub(r"\binf\b", "INFINITY", repr(value))
    if isinstance(value, int):
        return str(int(value))
    return f"{{{', '.join(map(_c, value)) or 0}}}"


def _starts(machine: Mechanism) -> tuple[Array, dict[str, Array]]:
    """Return poses from which the search for joints starts, (N, dof), and each leg's joints there.

    They are home, and the poses of readings spread evenly between the active joints' limits.
    """
    (low, high, _), legs = reading_range(machine), machine.legs
    readings = low + (high - low) * Halton(len(low), seed=0).random(_DRAWN)
    solution = forward(machine, readings)
    drawn, known = solution.poses[solution.converged], readings[solution.converged]
    solved = joints_at(machine, Plan(drawn, readings=known))
    count = _STARTS if any(leg.is_arm for leg in legs) else _STARTS // 4  # in one working mode
    rows = np.flatnonzero(solved.reached.all(axis=1))[:count]
    rounded = {name: q[rows].round(_START_DIGITS) for name, q in solved.joints.items()}
    joints = {leg.name: np.vstack((leg.home, rounded[leg.name])) for leg in legs}
    return np.vstack((machine.platform.home, drawn[rows].round(_START_DIGITS))), joints


def _leg(machine: Mechanism, closure: LegClosure, starts: Array) -> Table:
    leg, law = closure.leg, sensor_law(closure)
    sources = {name: len(leg.moving) + place for place, name in enumerate(leg.deformed)}
    deformations: list[Table] = [{"terms": Several("machine_term", ())} for _ in leg.deformed]
    for term in closure.deformations.terms:
        deformations[term.target]["terms"].append(_term(machine, leg, term, len(leg.deformed)))
    ends: list[Table] = [
        {
            "rows": Several("int", machine.platform.closing(end)),
            "loop": isinstance(end.meets, str),
            "tip": _chain(leg, _path(leg, end.tip), sources),
            "met": _chain(leg, _path(leg, end.meets), sources),
        }
        for end in leg.every_end
    ]
    limits = [[j.lower, j.upper] if j.limited else [-np.inf, np.inf] for j in leg.moving]
    return {
        "name": leg.name,
        "joints": Several("machine_text", [joint.name for joint in leg.moving]),
        "turns": [joint.turns for joint in leg.moving],
        "limits": limits,
        "home": leg.home.tolist(),
        "starts": Several("machine_positions", starts.tolist()),
        "active": Several("int", leg.active),
        "passive": Several("int", leg.passive),
        "unknown": Several("int", [*leg.active, *leg.passive]),
        "rows": sum(len(end["rows"]) for end in ends),
        "size": float(leg.size),
        "arm": leg.is_arm,
        "mode": home_mode(leg, machine.platform),
        "sensors": _sensors(machine, leg, law),
        "deformations": Several("machine_deformation", deformations),
        "ends": Several("machine_end", ends),
    }


def _path(leg: Leg, end: str | Joint) -> list[Joint]:
    """Return the joints from the base to a joint of the leg; a platform point is a single joint."""
    return [leg.joints[place] for place in leg.path(end)] if isinstance(end, str) else [end]


def _rows(matrix: Array) -> list[float]:
    return [float(value) for value in matrix[:3].ravel()]


def _chain(
    leg: Leg, joints: Sequence[Joint], sources: dict[str, int], tip: Array = _NO_SHIFT
) -> Table:
    """Return the table of a chain: its moving joints, each followed by a constant transform.

    Joints are indexed as the leg's moving joints; parameters that have an index in ``sources`` move
    too. ``tip``, shape (4, 4), is the chain's tip in the frame of the last joint's link.
    """
    elements, rows, geared, placed = elementary_joints(leg, joints)
    for element, column, parameter, sign in geared:
        rows[element, column] += sign * leg.nominal[parameter]
    named, moving = leaders(leg, joints), {j.name: place for place, j in enumerate(leg.moving)}
    places = [*map(moving.get, named), *map(sources.get, leg.parameter_names)]
    constants = rows[:, len(named) :] @ leg.nominal
    moves, behind = list[Any](), [np.eye(4)]
    for elementary, row, constant in zip(elements, rows, constants, strict=True):
        if elementary.placement:
            behind[-1] = behind[-1] @ np.reshape(elementary.placement, (4, 4))
        axis = _AXES.get(elementary.axis[-1], np.array(elementary.vector)).tolist()
        turns = elementary.axis.startswith("r")
        pairs = zip(places, row, strict=True)
        rates = [(place, float(rate)) for place, rate in pairs if place is not None and rate]
        if rates:
            moves.append((turns, axis, len(rates), Several("machine_rate", rates)))
            behind.append(np.eye(4))
        joint = Joint("", "revolute" if turns else "prismatic", axis=tuple(axis))
        behind[-1] = behind[-1] @ joint.motion(np.array([constant]))[0]
    if placed:
        behind[-1] = behind[-1] @ np.reshape(placed, (4, 4))
    behind[-1] = behind[-1] @ tip
    start, *ends = map(_rows, behind)
    joined = [(*move, end) for move, end in zip(moves, ends, strict=True)]
    return {"start": start, "moves": Several("machine_move", joined)}


def _sensors(machine: Mechanism, leg: Leg, law: SensorLaw) -> Several:
    sensors: list[Table] = [
        {"slope": float(slope), "start": float(start), "terms": Several("machine_term", ())}
        for slope, start in zip(law.slope, law.intercept, strict=True)
    ]
    for term in law.terms:
        sensors[term.target]["terms"].append(_term(machine, leg, term, len(sensors)))
    return Several("machine_sensor", sensors)


def _term(machine: Mechanism, leg: Leg, placed: PlacedTerm, known: int) -> tuple[Any, ...]:
    """Return a term's amplitude, the index of its influence (-1 for the reading), and function.

    The function is a, b and an exponent n: ((x - b) / a)ⁿ, or sin(a x + b) if n is 0.
    """
    basis, term = placed.term.basis, placed.term
    if not term.has_form:
        raise MechanismError(
            f"term {term.parameter!r} of {leg.name} is a Python function, which no file can hold; "
            "compute the readings of your poses instead (pincal.inverse)"
        )
    place = -1
    if placed.column >= known:
        place = machine.influences.index(leg.influences[placed.column - known])
    if isinstance(basis, Harmonic):
        form = (float(basis.rate), pi / 2 if basis.phase == "cosine" else 0.0, 0)
    elif isinstance(basis, Power):
        form = (float(basis.range), float(basis.centre), basis.power)
    else:
        form = (float(basis.per), float(basis.reference), 1)  # type: ignore[attr-defined]
    return float(placed.amplitude), place, *form


def _load(machine: Mechanism) -> Table:
    """Return the table of an arm's gravity loads, as drawn, and of the influences that they are."""
    if not machine.weighs or not machine.loaded:
        counted = ("active", "sensors", "bodies", "columns")
        return {"gravity": [0.0] * 3, "width": 1, **{name: Several("", ()) for name in counted}}
    drawing, load = machine.drawing, machine.load or Load()
    leg, n = drawing.legs[0], len(drawing.legs[0].moving)
    owners = [name.removeprefix(f"{LOAD}_") for name in machine.loaded]
    at_tool = [f"{leg.name}.{name}" for name in leg.point.placement.parameter_units]
    if len(drawing.legs) > 1 or not leg.is_arm or set(owners).intersection(at_tool):
        raise MechanismError(
            f"terms of {machine.name!r} depend on loads of a tool, or of a machine with loops, "
            "which no file computes; compute the readings of your poses instead (pincal inverse)"
        )
    named = dict(zip(leg.reading_names, leg.active, strict=True))
    named |= {name: n + place for place, name in enumerate(leg.parameter_ids)}
    places = map(machine.influences.index, machine.loaded)
    columns = list(zip(places, map(named.__getitem__, owners), strict=True))
    T_tip_platform = np.asarray(np.linalg.inv(leg.point.placement.origin()))
    carried = [(load.mass, leg.joints[-1].name, T_tip_platform, load.centre)]
    carried += [(j.mass, j.name, _NO_SHIFT, j.centre) for j in leg.joints]
    sources, bodies = {name: n + place for place, name in enumerate(leg.parameter_names)}, []
    for mass, link, T_link_body, centre in carried:
        shift = np.eye(4)
        shift[:3, 3] = centre
        chain = _chain(leg, _path(leg, link), sources, T_link_body @ shift)
        bodies += [(float(mass), chain)] * bool(mass)
    law = sensor_law(LegClosure(leg, drawing.platform))
    return {
        "gravity": [float(value) for value in load.gravity],
        "width": n + len(leg.parameters),
        "active": Several("int", leg.active),
        "sensors": _sensors(drawing, leg, law),
        "bodies": Several("machine_body", bodies),
        "columns": Several("machine_load_column", columns),
    }
