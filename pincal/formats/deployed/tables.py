"""The tables of a machine for kinematics without pincal: chains of joints, parameters put in.

Every kinematic parameter is a joint of a leg's calibration chain (``kinematics.chain``). Of these
stay the ones that move, each with the constant transform behind it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib.util import find_spec, module_from_spec
from typing import Any

import numpy as np

from pincal.errors import MechanismError
from pincal.formats.corrections import CorrectionGrid
from pincal.kinematics.chain import elementary_joints, leaders
from pincal.kinematics.closed_forms import closed_form
from pincal.kinematics.closing import home_mode, sensor_law
from pincal.kinematics.closure import LegClosure, nominal_legs
from pincal.kinematics.forest import Elementary
from pincal.kinematics.forward import reading_range
from pincal.model.joint import Joint
from pincal.model.leg import Leg
from pincal.model.mechanism import Mechanism
from pincal.model.sensor import PlacedTerm, SensorLaw
from pincal.model.terms import LOAD, Harmonic, Load, Power
from pincal.types import Array

Table = dict[str, Any]
_AXES = dict(zip("xyz", np.eye(3), strict=True))
_DIGITS = 9  # of twists on a grid, [m] and [rad]
_LEFT = "left"  # of a reason: closed, and in another mode


@dataclass(frozen=True)
class Deployed:
    """What goes onto a controller: a machine, and where it was measured."""

    mechanism: Mechanism
    frame: Array = field(default_factory=lambda: np.eye(4))
    """T_frame_base of the frame of the measurements, shape (4, 4)."""
    tool: Array = field(default_factory=lambda: np.eye(4))
    """T_platform_tool, of the point that was measured, shape (4, 4)."""
    grid: CorrectionGrid | None = None
    """Corrections of poses for a controller that knows another machine."""

    @cached_property
    def tables(self) -> Table:
        """The tables that ``kinematics.py`` and ``kinematics.h`` work with."""
        spec: Any = find_spec(f"{__package__}.kinematics")
        kinematics: Any = module_from_spec(spec)  # a copy, with tables of its own
        spec.loader.exec_module(kinematics)
        tables = kinematics.MACHINE = self._drawn()
        if kinematics.forward(tables["home_readings"]).reason.startswith(_LEFT):
            tables["assembly"] = -1.0
        return tables

    def _drawn(self) -> Table:
        """Return the tables, the assembly mode of home still to be seen."""
        machine, platform = self.mechanism, self.mechanism.platform
        turns = [np.eye(3)[row - 3].tolist() for row in platform.twist_rows if row >= 3]
        return {
            "name": machine.name,
            "readings": list(machine.reading_names),
            "units": list(machine.reading_units),
            "influences": list(machine.influences),
            "coordinates": list(platform.coordinates),
            "lengths": platform.lengths,
            "turns": turns,
            "twist": list(platform.twist_rows),
            "home": [float(value) for value in platform.home],
            "home_readings": reading_range(machine)[2].tolist(),
            "size": float(machine.size),
            "assembly": 1.0,
            "frame": _rows(self.frame),
            "tool": _rows(self.tool),
            "load": _load(machine),
            "grid": None if self.grid is None else _grid(self.grid),
            "legs": [_leg(machine, closure) for closure in nominal_legs(machine)],
        }


def _grid(grid: CorrectionGrid) -> Table:
    """Return ends of the grid, nodes along each coordinate, and twists node by node."""
    ends = {"low": grid.low.tolist(), "high": grid.high.tolist()}
    return {**ends, "count": grid.count, "twists": grid.twists.round(_DIGITS).ravel().tolist()}


def _leg(machine: Mechanism, closure: LegClosure) -> Table:
    leg, law = closure.leg, sensor_law(closure)
    sources = [len(leg.moving) + place for place in range(len(leg.deformed))]
    deformed = dict(zip(leg.deformed, sources, strict=True))
    deformations: list[list[Any]] = [[] for _ in leg.deformed]
    for term in closure.deformations.terms:
        deformations[term.target].append(_term(machine, leg, term, len(leg.deformed)))
    ends = []
    for end in leg.every_end:
        frame = end.meets if isinstance(end.meets, str) else None
        point = () if end.point is None else (end.point,)
        ends.append(
            {
                "rows": list(machine.platform.closing(end)),
                "tip": _chain(leg, _path(leg, end.tip), deformed),
                "frame": None if frame is None else _chain(leg, _path(leg, frame), deformed),
                "point": _chain(leg, point, deformed),
            }
        )
    return {
        "name": leg.name,
        "joints": [joint.name for joint in leg.moving],
        "turns": [joint.turns for joint in leg.moving],
        "limits": [(j.lower, j.upper) if j.limited else (-np.inf, np.inf) for j in leg.moving],
        "home": leg.home.tolist(),
        "active": leg.active,
        "passive": leg.passive,
        "size": float(leg.size),
        "arm": leg.is_arm,
        "mode": home_mode(leg, machine.platform),
        "sensors": _sensors(machine, leg, law),
        "deformations": deformations,
        "form": _form(closure),
        "ends": ends,
    }


def _path(leg: Leg, name: str) -> list[Joint]:
    return [leg.joints[place] for place in leg.path(name)]


def _chain(leg: Leg, joints: Sequence[Joint], sources: dict[str, int]) -> Table:
    """Return the joints of a chain that move, each with what is constant behind it.

    Joints have the places of the leg's moving joints; parameters move as well that have a source.
    """
    elements, rows, geared, tip = elementary_joints(leg, joints)
    for element, column, parameter, sign in geared:
        rows[element, column] += sign * leg.nominal[parameter]
    named = leaders(leg, joints)
    moving = [joint.name for joint in leg.moving]
    places: list[int | None] = [moving.index(name) for name in named]
    places += [sources.get(name) for name in leg.parameter_names]
    constants = rows[:, len(named) :] @ leg.nominal
    start, moves, pending = np.eye(4), list[Any](), np.eye(4)
    for elementary, row, constant in zip(elements, rows, constants, strict=True):
        if elementary.placement:
            pending = pending @ np.reshape(elementary.placement, (4, 4))
        joint = _joint(elementary)
        pairs = zip(places, row, strict=True)
        rates = [(place, float(rate)) for place, rate in pairs if place is not None and rate]
        if rates:
            if moves:
                moves[-1][3] = _rows(pending)
            else:
                start = pending
            moves.append([joint.turns, list(joint.axis), rates, None])
            pending = np.eye(4)
        pending = pending @ joint.motion(np.array([constant]))[0]
    pending = pending @ (np.reshape(tip, (4, 4)) if tip else np.eye(4))
    if moves:
        moves[-1][3] = _rows(pending)
    else:
        start = pending
    return {"start": _rows(start), "joints": [tuple(move) for move in moves]}


def _joint(elementary: Elementary) -> Joint:
    """Return an elementary joint as one of a leg's."""
    letter = elementary.axis.removeprefix("r")
    axis = _AXES[letter].tolist() if letter in _AXES else elementary.vector
    turns = elementary.axis.startswith("r")
    return Joint("", "revolute" if turns else "prismatic", axis=tuple(axis))


def _rows(matrix: Array) -> list[float]:
    return [float(value) for value in matrix[:3].ravel()]


def _sensors(machine: Mechanism, leg: Leg, law: SensorLaw) -> list[Table]:
    sensors: list[Table] = [
        {"slope": float(slope), "start": float(start), "terms": []}
        for slope, start in zip(law.slope, law.start, strict=True)
    ]
    for term in law.terms:
        sensors[term.target]["terms"].append(_term(machine, leg, term, len(sensors)))
    return sensors


def _term(machine: Mechanism, leg: Leg, placed: PlacedTerm, known: int) -> tuple[Any, ...]:
    """Return amplitude, place among influences (-1: the reading), and function of a term."""
    basis, term = placed.term.basis, placed.term
    if not term.has_form:
        raise MechanismError(
            f"term {term.parameter!r} of {leg.name} is a function of your own, which no file can "
            "hold; write a table of corrections instead (pincal export … -o corrections.csv)"
        )
    place = -1
    if placed.column >= known:
        place = machine.influences.index(leg.influences[placed.column - known])
    form: tuple[Any, ...]
    if isinstance(basis, Harmonic):
        form = (basis.phase, float(basis.rate), 0.0, 0)
    elif isinstance(basis, Power):
        form = ("power", float(basis.range), float(basis.centre), basis.power)
    else:
        form = ("power", float(basis.per), float(basis.reference), 1)  # type: ignore[attr-defined]
    return float(placed.amplitude), place, form


def _form(closure: LegClosure) -> Table | None:
    form = closed_form(closure)
    if form is None:
        return None
    return {
        "plane": closure.platform.space == 2,
        "centre": form.centre.tolist(),
        "axes": form.axes.tolist(),
        "delta": form.delta,
        "side": form.side,
        "length": form.length,
        "mode": form.mode,
        "radius": form.radius,
        "frame": None if form.frame is None else form.frame.tolist(),
    }


def _load(machine: Mechanism) -> Table | None:
    """Return what weighs on an arm as drawn, and which influences its loads are."""
    if not machine.weighs or not machine.loaded:
        return None
    drawing, load = machine.drawing, machine.load or Load()
    (leg, *further) = drawing.legs
    if further or not leg.is_arm:
        raise MechanismError(
            f"terms of {machine.name!r} follow loads of a machine with loops, which no file "
            "computes; write a table of corrections instead (pincal export … -o corrections.csv)"
        )
    n = len(leg.moving)
    sources = {name: n + place for place, name in enumerate(leg.parameter_names)}
    tip = _path(leg, leg.joints[-1].name)
    platform = _joined(_chain(leg, tip, sources), _reversed(_chain(leg, (leg.point,), sources)))
    bodies = [(load.mass, _with_tip(platform, np.array(load.centre)))]
    for place, joint in enumerate(leg.joints):
        if joint.mass:
            path = _path(leg, leg.joints[place].name)
            chain = _with_tip(_chain(leg, path, sources), np.array(joint.centre))
            bodies.append((float(joint.mass), chain))
    columns = []
    for name in machine.loaded:
        owner = name.removeprefix(f"{LOAD}_")
        if owner in leg.reading_names:
            source = leg.active[leg.reading_names.index(owner)]
        else:
            source = n + leg.parameter_ids.index(owner)
        columns.append((machine.influences.index(name), source))
    return {
        "gravity": [float(value) for value in load.gravity],
        "width": n + len(leg.parameters),
        "active": leg.active,
        "sensors": _sensors(drawing, leg, sensor_law(LegClosure(leg, drawing.platform))),
        "bodies": [body for body in bodies if body[0]],
        "columns": columns,
    }


def _matrix(rows: Sequence[float]) -> Array:
    return np.vstack((np.reshape(rows, (3, 4)), np.eye(4)[3]))


def _with_tip(chain: Table, shift: Array) -> Table:
    """Return a chain whose tip is shifted, in its own axes, [m]."""
    behind = np.eye(4)
    behind[:3, 3] = shift
    return _joined(chain, {"start": _rows(behind), "joints": []})


def _joined(chain: Table, second: Table) -> Table:
    """Return a chain that goes on as a second one."""
    *before, last = [chain["start"], *(behind for *_, behind in chain["joints"])]
    behind = [*before, _rows(_matrix(last) @ _matrix(second["start"]))]
    joints = [(*move[:3], place) for move, place in zip(chain["joints"], behind[1:], strict=True)]
    return {"start": behind[0], "joints": [*joints, *second["joints"]]}


def _reversed(chain: Table) -> Table:
    """Return the chain from a chain's tip to its beginning."""
    places = [chain["start"], *(behind for *_, behind in chain["joints"])]
    start, *behind = [
        _rows(np.asarray(np.linalg.inv(_matrix(place)), float)) for place in reversed(places)
    ]
    joints = [
        (turns, axis, [(source, -rate) for source, rate in rates], place)
        for (turns, axis, rates, _), place in zip(reversed(chain["joints"]), behind, strict=True)
    ]
    return {"start": start, "joints": joints}
