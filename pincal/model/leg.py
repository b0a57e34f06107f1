"""A leg is a tree of joints from base to platform with named kinematic parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from pincal.errors import MechanismError
from pincal.model.checks import array_of, check_kinds, counted, listed, number_of, one_line
from pincal.model.consistency import check_leg, identifiers
from pincal.model.joint import Closing, End, Joint
from pincal.model.sensor import Sensor
from pincal.model.terms import Term
from pincal.types import Array

_ABOUT, _PLACES = 0.3, 4  # spread, [rad] or over the size, and count of tests for idle joints
_IDLE = 1e-7  # singular value, of motions over the size, below which a motion moves no end
_STEP = 1e-5  # of a joint, [rad] or over the size, by whose differences motions are computed


@dataclass(frozen=True)
class Leg:
    """Joints from the base to a platform point, or to a frame of the platform.

    The joints are a serial chain, or a tree with several ends. The frame of the last joint, the
    tip, meets the platform's ``point``: its origin alone, or, if the leg ``closes`` a frame, its
    orientation too; further ``ends`` meet the platform or the leg itself. A serial arm is a leg
    that closes a frame and whose joints all have sensors. Joint positions are ordered as the moving
    joints, base first; readings as the sensors. Passive joints that move no end, such as a strut's
    spin, are fixed at home; the rank of the motions about home finds them.
    """

    name: str
    joints: tuple[Joint, ...]
    """All joints, base first, fixed ones included; the frame of the last one is the tip."""
    sensors: tuple[Sensor, ...]
    """Sensors, one for each active joint; a leg that only guides the platform has none."""
    parameters: tuple[tuple[str, float], ...]
    """Names and nominal values of the identified parameters, in order."""
    point: Joint
    """Platform point: a fixed joint from the platform frame."""
    closes: Closing = "point"
    """Whether the tip's origin meets the platform, or its whole frame."""
    terms: tuple[tuple[str, Term], ...] = ()
    """Terms of lengths and angles, with the parameter's name: ``("l", Term("grow", Share(10.0,
    20.0), of="temperature"))``; the amplitude is a parameter too."""
    ends: tuple[End, ...] = ()
    """Further ends of a tree, beside the end at the last joint."""
    settled: bool = field(default=False, compare=False, repr=False)
    """Whether the joints that move no end are fixed already; other parameter values free none."""

    def __post_init__(self) -> None:
        check_kinds(vars(self), Leg, MechanismError)
        check_leg(self)
        if not self.settled and (idle := self._idle()):
            joints = tuple(
                joint.fixed_at(joint.position(self.homes))
                if joint.kind != "fixed" and joint.leader.joint in idle
                else joint
                for joint in self.joints
            )
            for name in vars(self).keys() - {field.name for field in fields(self)}:
                del vars(self)[name]  # cached properties of the joints before
            object.__setattr__(self, "joints", joints)

    def __repr__(self) -> str:
        reads = f"reads {listed(sensor.joint for sensor in self.sensors)}"
        count = counted(len(self.parameters), "parameter")
        letters = "".join("R" if joint.turns else "P" for joint in self.articulated)
        return one_line("Leg", repr(self.name), letters, reads, self.closing, count)

    @property
    def closing(self) -> str:
        """What the leg closes, in words: ``closes a point and 1 further end``."""
        further = counted(len(self.ends), "further end")
        return f"closes a {self.closes}" + f" and {further}" * bool(self.ends)

    @cached_property
    def moving(self) -> tuple[Joint, ...]:
        """Joints that move on their own, base first."""
        return tuple(joint for joint in self.articulated if joint.follows is None)

    @cached_property
    def articulated(self) -> tuple[Joint, ...]:
        """Joints that move, base first, those that follow others included."""
        return tuple(joint for joint in self.joints if joint.kind != "fixed")

    @cached_property
    def active(self) -> list[int]:
        """Indices of the active joints among the moving joints, in the order of the sensors."""
        return [list(self.homes).index(sensor.joint) for sensor in self.sensors]

    @cached_property
    def passive(self) -> list[int]:
        """Indices of the passive joints among the moving joints."""
        return [i for i in range(len(self.moving)) if i not in self.active]

    def _idle(self) -> list[str]:
        """Return names of the passive joints that move no end, by the rank of their motions."""
        idle, free = list[str](), list(self.passive)
        if not (free and np.isfinite(self.home).all()):
            return idle
        motions = self.motions()[1]
        while free and np.linalg.matrix_rank(motions[:, free], tol=_IDLE).max() < len(free):
            null = np.abs(np.linalg.svd(motions[0, free])[0][:, -1])
            idle.append(self.moving[free.pop(int(null.argmax()))].name)
        return idle

    def motions(self) -> tuple[Array, Array]:
        """Return places about home, (4, n), and by each joint the rows of ends, (4, n, n_rows)."""
        n = len(self.moving)
        shares = np.random.default_rng(0).uniform(-1.0, 1.0, (_PLACES, 1, n))
        steps = _STEP * np.array((-np.eye(n), np.eye(n)))[:, None]  # to central differences
        joints = self.home + (_ABOUT * shares + steps) * self.scales
        before, after = np.split(self.ends_at(joints.reshape(-1, n)), 2, axis=1)
        turns = (after[..., :3, :3] @ before[..., :3, :3].mT).reshape(-1, 3, 3)
        shifts = (after - before)[..., :3, 3].reshape(-1, 3) / self.size
        twists = np.hstack((shifts, Rotation.from_matrix(turns).as_rotvec())) / (2.0 * _STEP)
        by_end = zip(twists.reshape(-1, _PLACES, n, 6), self.every_end, strict=True)
        rows = [twist[:, :, list(end.rows)] for twist, end in by_end]
        places = self.home + _ABOUT * shares[:, 0] * self.scales
        return places, np.concatenate(rows, axis=2)

    @cached_property
    def every_end(self) -> tuple[End, ...]:
        """All ends, the one at the last joint first."""
        return (End(self.joints[-1].name, self.point, self.closes), *self.ends)

    @cached_property
    def points(self) -> tuple[Joint, ...]:
        """Platform points, the one of the last joint first."""
        return tuple(end.point for end in self.every_end if end.point is not None)

    def index(self, name: str) -> int:
        """Return the index of a joint among all joints, fixed ones included."""
        return self._places[name]

    @cached_property
    def _places(self) -> dict[str, int]:
        return {joint.name: place for place, joint in enumerate(self.joints)}

    @cached_property
    def carriers(self) -> tuple[int, ...]:
        """Index of each joint's parent among all joints, -1 for the base."""
        return tuple(
            i - 1 if joint.parent is None else self._places.get(joint.parent, -1)
            for i, joint in enumerate(self.joints)
        )

    def path(self, name: str) -> tuple[int, ...]:
        """Return the indices of the joints from the base to a joint, both included."""
        place, path = self.index(name), []
        while place >= 0:
            path.append(place)
            place = self.carriers[place]
        return tuple(reversed(path))

    @property
    def is_arm(self) -> bool:
        """Whether the leg alone determines the pose: it closes a frame, every joint is read."""
        return self.closes == "frame" and not self.passive

    @cached_property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the identified parameters, in order."""
        return tuple(name for name, _ in self.parameters)

    @property
    def parameter_ids(self) -> tuple[str, ...]:
        """Ids of the parameters: ``leg_1.l``."""
        return tuple(f"{self.name}.{name}" for name in self.parameter_names)

    @cached_property
    def nominal(self) -> Array:
        """Nominal parameter values, shape (n_params,), SI units; not writable."""
        values = np.array([value for _, value in self.parameters], dtype=np.float64)
        values.setflags(write=False)
        return values

    @property
    def nominal_by_name(self) -> dict[str, float]:
        """Nominal parameter values by name."""
        return dict(self.parameters)

    @cached_property
    def placed(self) -> dict[str, str]:
        """Units of the parameters of placements, lengths and angles, by name."""
        units: dict[str, str] = {}
        for joint in (*self.joints, *self.points):
            units |= joint.placement.parameter_units
            if joint.ratio:
                units.setdefault(joint.ratio, "1" if joint.turns else "m")
        return units

    @cached_property
    def units(self) -> dict[str, str]:
        """Units of the parameters, by name: m, rad, or 1 for a gain."""
        units = dict(self.placed)
        for sensor, unit in zip(self.sensors, self.reading_units, strict=True):
            if isinstance(sensor.gain, str):
                units[sensor.gain] = "1"
            if isinstance(sensor.offset, str):
                units[sensor.offset] = unit
            units |= {term.parameter: term.unit or unit for term in sensor.terms}
        units |= {term.parameter: term.unit or self.placed[name] for name, term in self.terms}
        return units

    @property
    def reading_units(self) -> tuple[str, ...]:
        """Unit of each sensor's reading: rad or m."""
        turns = {joint.name: joint.turns for joint in self.joints}
        return tuple("rad" if turns[sensor.joint] else "m" for sensor in self.sensors)

    @property
    def reading_names(self) -> tuple[str, ...]:
        """Names of the readings: the leg's name, or, of several sensors, their joints' names."""
        if len(self.sensors) == 1:
            return (self.name,)
        return identifiers(sensor.joint for sensor in self.sensors)

    @cached_property
    def influences(self) -> tuple[str, ...]:
        """Columns of the influence quantities on which terms depend, sensors' terms first."""
        named = zip(self.sensors, self.reading_names, strict=True)
        columns = [term.column(name) for sensor, name in named for term in sensor.terms]
        columns += [term.column(f"{self.name}.{name}") for name, term in self.terms]
        return tuple(dict.fromkeys(name for name in columns if name))

    @cached_property
    def deformed(self) -> tuple[str, ...]:
        """Names of the parameters that have terms."""
        return tuple(dict.fromkeys(name for name, _ in self.terms))

    @cached_property
    def without_terms(self) -> Leg:
        """The leg without terms and their amplitudes: sensors have gain and offset only."""
        return self._with_terms(lambda _: False)

    @cached_property
    def at_reference(self) -> Leg:
        """The leg while all influences are at their reference: without the terms they cause."""
        return self._with_terms(lambda term: not term.of)

    @cached_property
    def amplitudes(self) -> frozenset[str]:
        """Names of the parameters that are amplitudes of terms."""
        of_sensors = (term for sensor in self.sensors for term in sensor.terms)
        return frozenset(t.parameter for t in (*of_sensors, *(term for _, term in self.terms)))

    def _with_terms(self, stays: Callable[[Term], bool]) -> Leg:
        """Return the leg with the sensors' terms for which ``stays`` is true, and no others."""
        sensors = tuple(
            replace(sensor, terms=tuple(filter(stays, sensor.terms))) for sensor in self.sensors
        )
        used = {*self.placed, *(name for s in sensors for name in (s.gain, s.offset))}
        used |= {term.parameter for sensor in sensors for term in sensor.terms}
        parameters = tuple(item for item in self.parameters if item[0] in used)
        return replace(self, sensors=sensors, parameters=parameters, terms=())

    @property
    def homes(self) -> dict[str, float]:
        """Home positions of the joints that move on their own, by name, [rad] or [m]."""
        return {joint.name: joint.home for joint in self.moving}

    @cached_property
    def home(self) -> Array:
        """Home positions of the moving joints, shape (n_joints,), [rad] or [m]."""
        return np.array([joint.home for joint in self.moving])

    def __hash__(self) -> int:
        return self._hash

    @cached_property
    def _hash(self) -> int:
        points = (self.point, self.ends) if self.ends else self.point
        return hash((self.name, self.joints, self.sensors, self.parameters, points, self.terms))

    def __getstate__(self) -> dict[str, Any]:
        """Return the state to pickle, without the hash: hashes of strings differ by process."""
        return {name: value for name, value in self.__dict__.items() if name != "_hash"}

    @cached_property
    def size(self) -> float:
        """Length of the stretched leg at home, [m]: the scale against which gaps are small.

        It is the reach if the leg has no length at home, a metre if it has none anywhere, and the
        distance from the base's origin if a leg that closes a frame is below 1 % of it (an ankle).
        """
        far = float(np.linalg.norm(self.joints[0].placement.xyz)) * (self.closes == "frame")
        lengths = self._stretched(lambda joint: abs(joint.home)), self.reach, far, 1.0
        return next(length for length in lengths if length > 0.01 * far)

    @cached_property
    def reach(self) -> float:
        """Largest distance of the platform's origin from the leg's base, [m]."""
        return self._stretched(lambda joint: max(abs(joint.lower), abs(joint.upper)))

    def _stretched(self, slide: Callable[[Joint], float]) -> float:
        lengths = []
        for end in self.every_end:
            path = [self.joints[place] for place in self.path(end.tip)]
            placed = (*path[1:], end.point) if end.point else path[1:]
            arms = sum(np.linalg.norm(joint.placement.xyz) for joint in placed)
            slides = sum(slide(joint) for joint in path if joint.kind == "prismatic")
            lengths.append(float(arms) + slides)
        return max(lengths)

    def link_placements(self, joints: Array) -> Array:
        """Return ``T_base_link`` of the link after each joint, shape (N, n_all_joints, 4, 4), [m].

        Fixed joints count; the last link is the tip. ``joints`` are positions of the moving joints,
        shape (N, n_joints), [rad] or [m]; links that a NaN position moves are NaN.
        """
        columns = np.asarray(joints, dtype=np.float64).T
        positions = {joint.name: q for joint, q in zip(self.moving, columns, strict=True)}
        T_base = np.broadcast_to(np.eye(4), (len(joints), 4, 4))
        placements: list[Array] = []
        for joint, carrier in zip(self.joints, self.carriers, strict=True):
            T_base_link = placements[carrier] if carrier >= 0 else T_base
            T_base_link = T_base_link @ joint.placement.origin()
            if joint.kind != "fixed":
                T_base_link = T_base_link @ joint.motion(joint.position(positions))
            placements.append(T_base_link)
        return np.stack(placements, axis=1)

    def ends_at(self, joints: Array) -> Array:
        """Return the tips of k ends in the frames of the leg that they meet, or in the base's.

        Shape (k, N, 4, 4); ``joints`` are positions of the moving joints, shape (N, n_joints).
        """
        T, ends = self.link_placements(joints), []
        for end in self.every_end:
            tip, *met = (T[:, self.index(name)] for name in end.frames)
            ends.append(np.linalg.solve(met[0], tip) if met else tip)
        return np.stack(ends)

    @cached_property
    def scales(self) -> Array:
        """Unit of a step of each moving joint: 1 rad, or the leg's size, [m]; shape (n_joints,)."""
        return np.array([1.0 if joint.turns else self.size for joint in self.moving])

    def with_parameters(self, values: Mapping[str, float] | Sequence[float] | Array) -> Leg:
        """Return the leg with other nominal parameter values, and URDF origins that agree.

        Args:
            values: New values by name (the others are kept), or all values in order.

        Raises:
            MechanismError: an unknown name, or a wrong number of values.
        """
        old = self.nominal_by_name
        if not isinstance(values, Mapping):
            numbers = array_of(values, (len(old),), self.name, MechanismError)
            values = dict(zip(old, numbers.tolist(), strict=True))
        if unknown := sorted(set(values) - set(old)):
            raise MechanismError(
                f"{self.name} has no parameter {unknown[0]!r}; it has {', '.join(old)}"
            )
        new = old | {k: number_of(v, f"{self.name}.{k}", MechanismError) for k, v in values.items()}
        if new == old:
            return self

        def moved(joint: Joint) -> Joint:
            law = joint.follows and joint.leader._replace(
                ratio=new.get(joint.ratio, joint.leader.ratio)
            )
            placement = joint.placement.moved(old, new, self.name)
            return replace(joint, placement=placement, follows=law)

        return replace(
            self,
            joints=tuple(moved(joint) for joint in self.joints),
            point=moved(self.point),
            ends=tuple(end.moved(moved) for end in self.ends),
            parameters=tuple(new.items()),
            settled=True,
        )

    def with_limits(self, limits: Mapping[str, tuple[float, float]]) -> Leg:
        """Return the leg with other limits of some joints, by name, [rad] or [m]."""
        ends = (limits.get(joint.name, (joint.lower, joint.upper)) for joint in self.joints)
        pairs = zip(self.joints, ends, strict=True)
        return replace(self, joints=tuple(replace(j, lower=a, upper=b) for j, (a, b) in pairs))

    def with_home(self, positions: Sequence[float] | Array) -> Leg:
        """Return the leg with other home positions of its moving joints, [rad] or [m]."""
        home = dict(zip(self.homes, map(float, positions), strict=True))
        joints = tuple(replace(j, home=home.get(j.name, j.home)) for j in self.joints)
        return replace(self, joints=joints)
