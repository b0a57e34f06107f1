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

        Args:
            parameters: Parameter values, shape (n_params,).
            joints: Joint positions of the leg, [rad] or [m], and behind them deformations, shape
                (N, n_joints [+ n_deformed]); nothing deforms if these are not given.
        """
        return motion((self,), (parameters,), joints)

    @cached_property
    def begun(self) -> Callable[[bytes], tuple[Array, Base | None]]:
        """Returns what parameters put into the moving joints, and where these begin; kept."""
        s = self.still.width

        @lru_cache(maxsize=8)  # the same parameters are asked for several times in turn
        def found(parameters: bytes) -> tuple[Array, Base | None]:
            values = self.from_parameters @ np.frombuffer(parameters)
            if not s and not self.first:
                return values, None
            base = self.still.begin(values[:s], self._rates[:, :s])
            first = (
                pin.SE3(np.array(self.first).reshape(4, 4)) if self.first else pin.SE3.Identity()
            )
            return values[s:], Base(base.placement * first, base.twists)

        return found

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
    """Return where the tips of alike chains are, and how joints and parameters move them.

    Args:
        chains: L chains of one form.
        parameters: Parameter values of each, shape (n_params,).
        joints: Of each N rows below those of the one before, shape (L N, n_joints …): see
            ``Chain.motion``.
    """
    begun = [one.begun(own.tobytes()) for one, own in zip(chains, parameters, strict=True)]
    values = np.stack([own for own, _ in begun])
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
    names = list(leg.parameter_names)
    deformed = [names.index(name) for name in leg.deformed]
    moving = [joint.name for joint in joints if joint.kind != "fixed"]
    elements: list[Elementary] = []
    rows: list[tuple[Array, Array]] = []
    pending = np.eye(4)  # constant placement in front of the next elementary joint

    def add(element: Elementary, parameter: Array, joint: Array) -> None:
        nonlocal pending
        if elements and not element.placement and element == replace(elements[-1], placement=()):
            rows[-1] = (rows[-1][0] + parameter, rows[-1][1] + joint)  # same axis: one joint
        else:
            elements.append(element)
            rows.append((parameter, joint))
        pending = np.eye(4)

    for joint in joints:
        for step in joint.placement.steps:
            if isinstance(step.value, str):
                entry = step.sign * np.eye(len(names))[names.index(step.value)]
                add(Elementary(step.axis, _key(pending)), entry, np.zeros(len(moving)))
            else:
                pending = pending @ step.matrix({})
        where = f"{leg.name}, joint {joint.name!r}"
        pending = pending @ joint.placement.rest(leg.nominal_by_name, where)
        if joint.kind != "fixed":
            entry = np.eye(len(moving))[moving.index(joint.name)]
            element, sign = _motion(joint, _key(pending))
            add(element, np.zeros(len(names)), sign * entry)
    moved = [i for i, (by, entry) in enumerate(rows) if entry.any() or by[deformed].any()]
    first = moved[0] if moved else 0
    begins = elements[first].placement if elements else ()
    moving_ones = tuple(elements[first:])
    if begins:
        moving_ones = (replace(elements[first], placement=()), *moving_ones[1:])
    return Chain(
        Forest(tuple(elements[:first]), (), spatial=True, copies=1),
        begins,
        forest(moving_ones, _key(pending), spatial=spatial, copies=copies),
        np.array([parameter for parameter, _ in rows]).reshape(len(rows), len(names)),
        np.array([entry for _, entry in rows]).reshape(len(rows), len(moving)),
        tuple(deformed),
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

    Homogeneous vectors, as ``batches.applied`` takes them: shape (4, …), or (4, …, N) of N rows.
    """

    parameters: Index
    """Indices of these parameters, shape (k,)."""
    place: Array
    """The point, shape (4, 1[, N]), [m]."""
    arm: Array
    """The vector to it from the platform's origin, shape (4, 1[, N]), [m]."""
    speeds: Array
    """The point's velocities by these parameters, shape (4, k[, N]), [m] a unit."""
    turn: Array
    """Its frame, shape ([N, ]3, 3)."""
    turning: Array
    """How these parameters turn it, shape ([N, ]3, k), [rad] a unit."""


def platform_point(leg: Leg, parameters: Array) -> PlatformPoint:
    """Return a leg's platform point at parameter values, shape (n_params,), made once."""
    return _point(leg, parameters[point_chain(leg).moving].tobytes())


@lru_cache(maxsize=1024)
def _point(leg: Leg, own: bytes) -> PlatformPoint:
    chain, parameters = point_chain(leg), np.zeros(len(leg.parameters))
    parameters[chain.moving] = np.frombuffer(own)
    many = _of(leg, chain.motion(parameters, np.zeros((1, 0))))
    return PlatformPoint(
        many.parameters,
        many.place[:, :, 0],
        many.arm[:, :, 0],
        many.speeds[:, :, 0],
        many.turn[0],
        many.turning[0],
    )


def alike_points(points: Sequence[PlatformPoint], count: int) -> PlatformPoint:
    """Return the platform points of alike legs, so many rows of each below the one before.

    Of points that stand still and are no frames.
    """

    def rows(vectors: Sequence[Array]) -> Array:
        return np.repeat(np.stack(vectors, axis=2), count, axis=2)

    return replace(
        points[0],
        place=rows([one.place for one in points]),
        arm=rows([one.arm for one in points]),
        speeds=rows([one.speeds for one in points]),
    )


def deformed_point(leg: Leg, parameters: Array, by: Array) -> PlatformPoint:
    """Return a leg's platform point in N rows, where its parameters deform.

    Args:
        leg: The leg.
        parameters: Values of all its parameters, shape (n_params,).
        by: How far those that deform do, shape (N, n_deformed), [m] or [rad].
    """
    places = [leg.parameter_names.index(name) for name in leg.deformed]
    if not point_chain(leg).from_parameters[:, places].any():
        return platform_point(leg, parameters)
    return _of(leg, point_chain(leg).motion(parameters, by))


def _of(leg: Leg, motion: Motion) -> PlatformPoint:
    """Return the point of N rows."""
    own = point_chain(leg).moving
    tips, twists = motion.tips[:, None], motion.twists()[:, own]
    zero = np.zeros((1, len(own), tips.shape[2]))
    return PlatformPoint(
        own,
        np.concatenate((tips, np.ones_like(tips[:1]))),
        np.concatenate((tips, np.zeros_like(tips[:1]))),
        np.concatenate((twists[:3], zero)),
        motion.turns,
        twists[3:].transpose(2, 0, 1),
    )
