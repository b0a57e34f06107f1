"""The calibration chain of a leg: its joints and one more joint for each parameter.

Configurations of the chain are linear in the leg's joints and parameters,
``q = J joints + S parameters``; a tie, such as an azimuth that turns a point but not
what follows, is a row of S with several entries. A parameter that deforms from row to row is at
p + ε: its deformation ε is one more joint, whose column of J is the parameter's of S. On the
platform's side a chain of parameters alone leads to the leg's platform point.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
import pinocchio as pin

from pincal.kinematics.forest import Base, Elementary, Forest, Motion, forest
from pincal.model.leg import Joint, Leg
from pincal.model.placement import Placement
from pincal.types import Array, Index


@dataclass(frozen=True)
class Chain:
    """Elementary joints in a row, and how parameters and leg joints move them.

    The first of them are parameters that do not deform: they stand still in all configurations.
    """

    still: Forest
    """The first s elementary joints."""
    first: tuple[float, ...]
    """Constant placement of the next one, row by row; empty for the identity."""
    forest: Forest
    """The others, from there on: chains that differ only in where they begin share it."""
    from_parameters: Array
    """S, shape (n, n_params)."""
    from_joints: Array
    """J, shape (n, n_joints): one entry ±1 a column."""
    deformed: tuple[int, ...] = ()
    """Parameters that deform."""

    def motion(self, parameters: Array, joints: Array) -> Motion:
        """Return where the tip is, and how each leg joint and then each parameter moves it.

        Parameters have shape (n_params,), joints, [rad] or [m], and behind them deformations, if
        there are any, shape (N, n_joints [+ n_deformed]).
        """
        return motion((self,), (parameters,), joints)

    @cached_property
    def begun(self) -> Callable[[bytes], tuple[Array, Base | None]]:
        """Returns what parameters put into the moving joints, and where these begin; kept."""
        s = self.still.width

        @lru_cache(maxsize=8)  # the same parameters are asked for several times in turn
        def beginning(parameters: bytes) -> tuple[Array, Base | None]:
            values = self.from_parameters @ np.frombuffer(parameters)
            if not s and not self.first:
                return values, None
            base = self.still.begin(values[:s], self._rates[:, :s])
            first = (
                pin.SE3(np.array(self.first).reshape(4, 4)) if self.first else pin.SE3.Identity()
            )
            return values[s:], Base(base.placement * first, base.twists)

        return beginning

    @cached_property
    def entries(self) -> list[tuple[int, int, float]]:
        """What is not zero of J, deformations last, of what moves: row, column, entry."""
        every = np.concatenate((self.from_joints, self.from_parameters[:, self.deformed]), axis=1).T
        s = self.still.width
        return [(int(row) - s, int(col), every[col, row]) for col, row in np.argwhere(every)]

    @cached_property
    def moving(self) -> Index:
        """Parameters that move the tip, in order."""
        return np.flatnonzero(self.from_parameters.any(axis=0))

    @cached_property
    def form(self) -> tuple[object, ...]:
        """What alike chains have in common, wherever they begin."""
        arrays = (self.from_parameters.tobytes(), self.from_joints.tobytes())
        return (self.forest, *arrays, self.deformed, self.still.width)

    @cached_property
    def _rates(self) -> Array:
        """Rates of elementary joints with each leg joint and parameter, shape (k, n)."""
        return np.concatenate((self.from_joints, self.from_parameters), axis=1).T

    @cached_property
    def moving_rates(self) -> Array:
        """Rates of the moving elementary joints, shape (k, n_moving)."""
        return self._rates[:, self.still.width :]


def motion(chains: Sequence[Chain], parameters: Sequence[Array], joints: Array) -> Motion:
    """Return where the tips of L alike chains are, and how joints and parameters move them.

    Joints of each stand below those of the one before, shape (L N, n_joints …): see
    ``Chain.motion``.
    """
    begun = [
        chain.begun(values_of_leg.tobytes())
        for chain, values_of_leg in zip(chains, parameters, strict=True)
    ]
    values = np.stack([values_of_leg for values_of_leg, _ in begun])
    q = np.empty((len(chains), len(joints) // len(chains), values.shape[1]))
    q[:] = values[:, None]
    moving = joints.reshape(*q.shape[:2], joints.shape[1])
    for row, column, entry in chains[0].entries:
        if column < joints.shape[1]:
            q[:, :, row] += entry * moving[:, :, column]
    return chains[0].forest.motion(q, chains[0].moving_rates, [base for _, base in begun])


@lru_cache(maxsize=64)  # a chain keeps its forest, of some megabytes
def leg_chain(leg: Leg, spatial: bool) -> Chain:
    """Return the chain from the base to the leg's tip."""
    return _chain(leg, leg.joints, spatial)


@lru_cache(maxsize=64)
def body_chain(leg: Leg, index: int) -> Chain:
    """Return the chain from the base to the centre of mass of the link behind a joint."""
    joints = leg.joints[: index + 1]
    centre = Joint("centre", "fixed", Placement(xyz=joints[-1].centre))
    return _chain(leg, (*joints, centre), spatial=True)


@lru_cache(maxsize=256)
def point_chain(leg: Leg) -> Chain:
    """Return the chain from the platform frame to the leg's platform point."""
    return _chain(leg, (leg.point,), spatial=True, copies=1)


def _chain(leg: Leg, joints: Sequence[Joint], spatial: bool, copies: int | None = None) -> Chain:
    """Return the chain of some joints of a leg, which stands still up to what moves first."""
    elements, by_parameter, by_joint, tip = _elements(leg, joints)
    deformed = [leg.parameter_names.index(name) for name in leg.deformed]
    moves = by_joint.any(axis=1) | by_parameter[:, deformed].any(axis=1)
    first = int(next(iter(np.flatnonzero(moves)), 0))
    still, moving = elements[:first], elements[first:]
    beginning = moving[0].placement if moving else ()
    if beginning:
        moving = (replace(moving[0], placement=()), *moving[1:])
    return Chain(
        Forest(still, (), spatial=True, copies=1),
        beginning,
        forest(moving, tip, spatial=spatial, copies=copies),
        by_parameter,
        by_joint,
        tuple(deformed),
    )


def _elements(
    leg: Leg, joints: Sequence[Joint]
) -> tuple[tuple[Elementary, ...], Array, Array, tuple[float, ...]]:
    """Return elementary joints, how they follow parameters and leg joints, and the tip behind."""
    names = list(leg.parameter_names)
    moving = [joint.name for joint in joints if joint.kind != "fixed"]
    elements: list[Elementary] = []
    by_parameter: list[Array] = []
    by_joint: list[Array] = []
    pending = np.eye(4)  # constant placement in front of the next elementary joint

    def add(element: Elementary, parameter: Array, joint: Array) -> None:
        nonlocal pending
        if elements and not element.placement and element == replace(elements[-1], placement=()):
            by_parameter[-1] = by_parameter[-1] + parameter  # same axis: one joint
            by_joint[-1] = by_joint[-1] + joint
        else:
            elements.append(element)
            by_parameter.append(parameter)
            by_joint.append(joint)
        pending = np.eye(4)

    for joint in joints:
        for step in joint.placement.steps:
            if isinstance(step.value, str):
                entry = step.sign * np.eye(len(names))[names.index(step.value)]
                add(Elementary(step.axis, _key(pending)), entry, np.zeros(len(moving)))
            else:
                pending = pending @ step.matrix({})
        context = f"{leg.name}, joint {joint.name!r}"
        pending = pending @ joint.placement.rest(leg.nominal_by_name, context)
        if joint.kind != "fixed":
            entry = np.eye(len(moving))[moving.index(joint.name)]
            element, sign = _motion(joint, _key(pending))
            add(element, np.zeros(len(names)), sign * entry)
    return (
        tuple(elements),
        np.array(by_parameter).reshape(len(elements), len(names)),
        np.array(by_joint).reshape(len(elements), len(moving)),
        _key(pending),
    )


def _motion(joint: Joint, placement: tuple[float, ...]) -> tuple[Elementary, float]:
    """Return a joint's elementary motion, along or about a coordinate axis where it can be."""
    turn = "r" if joint.kind == "revolute" else ""
    for letter, component in zip("xyz", joint.axis, strict=True):
        if abs(component) == 1.0:
            return Elementary(turn + letter, placement), component
    return Elementary(turn or "t", placement, joint.axis), 1.0


def _key(matrix: Array) -> tuple[float, ...]:
    """Return a homogeneous matrix as a hashable row, empty for the identity."""
    return () if np.array_equal(matrix, np.eye(4)) else tuple(float(v) for v in matrix.ravel())


@dataclass(frozen=True)
class PlatformPoint:
    """A platform point and its frame; k of the leg's parameters place it.

    Homogeneous vectors, as ``batches.applied`` takes them, of N rows or of one for all.
    """

    parameters: Index
    """Indices of these parameters, shape (k,)."""
    place: Array
    """The point, shape (4, 1, N), [m]."""
    arm: Array
    """The vector to it from the platform's origin, shape (4, 1, N), [m]."""
    speeds: Array
    """The point's velocities by these parameters, shape (4, k, N), [m] a unit."""
    turn: Array
    """Its frame, shape (N, 3, 3)."""
    turning: Array
    """How these parameters turn it, shape (N, 3, k), [rad] a unit."""


def platform_point(leg: Leg, parameters: Array) -> PlatformPoint:
    """Return a leg's platform point at parameter values, shape (n_params,), made once."""
    return _point(leg, parameters[point_chain(leg).moving].tobytes())


@lru_cache(maxsize=1024)
def _point(leg: Leg, placing: bytes) -> PlatformPoint:
    chain, parameters = point_chain(leg), np.zeros(len(leg.parameters))
    parameters[chain.moving] = np.frombuffer(placing)
    return _placed_point(leg, chain.motion(parameters, np.zeros((1, 0))))


def alike_points(points: Sequence[PlatformPoint], count: int) -> PlatformPoint:
    """Return the platform points of alike legs, so many rows of each below the one before.

    Of points that stand still and are no frames.
    """

    def rows(vectors: Sequence[Array]) -> Array:
        return np.repeat(np.concatenate(vectors, axis=2), count, axis=2)

    return replace(
        points[0],
        place=rows([point.place for point in points]),
        arm=rows([point.arm for point in points]),
        speeds=rows([point.speeds for point in points]),
    )


def deformed_point(leg: Leg, parameters: Array, deformations: Array) -> PlatformPoint:
    """Return a leg's platform point in N rows, where its parameters deform.

    By deformations of shape (N, n_deformed), [m] or [rad], from values of all its parameters.
    """
    places = [leg.parameter_names.index(name) for name in leg.deformed]
    if not point_chain(leg).from_parameters[:, places].any():
        return platform_point(leg, parameters)
    return _placed_point(leg, point_chain(leg).motion(parameters, deformations))


def _placed_point(leg: Leg, motion: Motion) -> PlatformPoint:
    """Return the point of N rows."""
    placing = point_chain(leg).moving
    tips, twists = motion.tips[:, None], motion.twists()[:, placing]
    zero = np.zeros((1, len(placing), tips.shape[2]))
    return PlatformPoint(
        placing,
        np.concatenate((tips, np.ones_like(tips[:1]))),
        np.concatenate((tips, np.zeros_like(tips[:1]))),
        np.concatenate((twists[:3], zero)),
        motion.turns,
        twists[3:].transpose(2, 0, 1),
    )
