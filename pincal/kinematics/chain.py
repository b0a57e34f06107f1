"""The calibration chain of a leg: its joints and one more joint for each parameter.

Configurations of the chain are linear in the leg's joints and parameters,
``q = J joints + S parameters``. A tie, such as an azimuth that turns a point but not what follows,
is a row of S with several entries; a geared joint is a row of J in the column of the joint that it
follows. A parameter that deforms from row to row is p + ε, where ε is one more joint whose column
of J is the parameter's column of S. Only where a gear ratio is a parameter is a position not
linear, but a product.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from pincal.kinematics.forest import Elementary, Forest, Motion
from pincal.model import Joint, Leg, Placement
from pincal.types import Array, Index

Begun = tuple[Array, Array, Motion | None]
"""Positions of the moving joints by parameters, gear ratios, and the standing chain before them."""
_forest = lru_cache(maxsize=64)(Forest)


class Chain:
    """Elementary joints in series, moved by leg joints and parameters.

    The first joints depend on parameters only and stand still from row to row; chains that differ
    only in these share the forest of the others.
    """

    def __init__(
        self, leg: Leg, joints: Sequence[Joint], spatial: bool, copies: int | None = None
    ) -> None:
        elements, rows, geared, tip = elementary_joints(leg, joints)
        named = leaders(leg, joints)
        self.columns = [i for i, joint in enumerate(leg.moving) if joint.name in named]
        """Indices of the leg's moving joints that move its tip."""
        by_joint, self.by_parameter = np.split(rows, [rows.shape[1] - len(leg.parameters)], axis=1)
        deformed = [leg.parameter_names.index(name) for name in leg.deformed]
        varying = np.concatenate((by_joint, self.by_parameter[:, deformed]), axis=1)
        moving_rows = [*np.flatnonzero(varying.any(axis=1)), *(row for row, *_ in geared)]
        self.standing = int(min(moving_rows, default=0))
        """Number of elementary joints that stand still."""
        standing, moving = elements[: self.standing], elements[self.standing :]
        start = moving[0].placement if moving else ()
        self.still = Forest(standing, start, True, 1) if standing or start else None
        if start:
            moving = (replace(moving[0], placement=()), *moving[1:])
        self.forest = _forest(moving, tip, spatial, copies)
        self.rates = rows.T
        """Derivatives of elementary joints by each leg joint and parameter, shape (k, n)."""
        self.entries = [
            (row - self.standing, column, varying[row, column])
            for column, row in np.argwhere(varying.T)
        ]
        """Moving elementary joint, leg joint (or deformation) that it follows, and derivative."""
        self.geared = tuple((row - self.standing, i, p, sign) for row, i, p, sign in geared)
        """Moving elementary joints with a parameter as gear ratio, see ``elementary_joints``."""
        self.moving = np.flatnonzero(self.by_parameter.any(axis=0))
        """Indices of parameters that move the tip."""
        shape = (rows.tobytes(), rows.shape, tuple(deformed), self.standing, self.geared)
        self.form = (self.forest, *shape)
        """Key that is equal for chains of the same form, wherever they begin."""

    def begin(self, parameters: Array) -> Begun:
        """Return what depends on the parameters (n_params,) only: see ``Begun``."""
        return _begun(self, parameters.tobytes())

    def motion(self, parameters: Array, joints: Array) -> Motion:
        """Return the tip and its motion with each leg joint, then with each parameter.

        ``parameters`` are (n_params,), ``joints`` with deformations (N, n_joints [+ n_deformed]).
        """
        return motion((self,), (self.begin(parameters),), joints)


@lru_cache(maxsize=256)  # the same parameters are used several times in turn
def _begun(chain: Chain, parameters: bytes) -> Begun:
    amounts, s = np.frombuffer(parameters), chain.standing
    values, ratios = chain.by_parameter @ amounts, amounts[[p for _, _, p, _ in chain.geared]]
    if chain.still is None:
        return values, ratios, None
    still = chain.still.motion(values[None, None, :s], chain.rates[:, :s])
    return values[s:], ratios, still


def motion(chains: Sequence[Chain], begun: Sequence[Begun], joints: Array) -> Motion:
    """Return the tips of L chains of the same form and their motion: see ``Chain.motion``.

    Joints are stacked chain by chain, shape (L N, n_joints …).
    """
    values = np.stack([values_of_leg for values_of_leg, _, _ in begun])
    q = np.empty((len(chains), len(joints) // len(chains), values.shape[1]))
    q[:] = values[:, None]
    moving = joints.reshape(*q.shape[:2], joints.shape[1])
    for row, column, entry in chains[0].entries:
        if column < joints.shape[1]:
            q[:, :, row] += entry * moving[:, :, column]
    products, joint_count = [], len(chains[0].columns)
    for place, (row, column, parameter, sign) in enumerate(chains[0].geared):
        ratio = np.repeat([[ratios[place]] for _, ratios, _ in begun], q.shape[1], axis=1)
        q[:, :, row] += sign * ratio * moving[:, :, column]
        products.append((column, row, sign * ratio.ravel()))
        products.append((joint_count + parameter, row, sign * moving[:, :, column].ravel()))
    rates = chains[0].rates[:, chains[0].standing :]
    moved = chains[0].forest.motion(q, rates, [base for _, _, base in begun])
    return replace(moved, products=tuple(products)) if products else moved


@lru_cache(maxsize=64)  # a chain keeps its forest, of some megabytes
def leg_chain(leg: Leg, spatial: bool, name: str | None = None) -> Chain:
    """Return the chain from the base to the leg's tip, or to the frame of one of its joints."""
    path = leg.path(name or leg.joints[-1].name)
    return Chain(leg, [leg.joints[place] for place in path], spatial)


@lru_cache(maxsize=64)
def body_chain(leg: Leg, joint: Joint) -> Chain:
    """Return the chain from the base to the centre of mass of the link behind a joint."""
    joints = [leg.joints[place] for place in leg.path(joint.name)]
    return Chain(leg, (*joints, Joint("centre", "fixed", Placement(xyz=joint.centre))), True)


@lru_cache(maxsize=256)
def point_chain(leg: Leg, end: int) -> Chain:
    """Return the chain from the platform frame to the platform point of one of a leg's ends."""
    point = leg.every_end[end].point
    return Chain(leg, () if point is None else (point,), spatial=True, copies=1)


def leaders(leg: Leg, joints: Sequence[Joint]) -> list[str]:
    """Return the names of the leg's moving joints among some joints, or followed by them."""
    led = {joint.leader.joint for joint in joints}
    return [joint.name for joint in leg.moving if joint.name in led]


def elementary_joints(
    leg: Leg, joints: Sequence[Joint]
) -> tuple[tuple[Elementary, ...], Array, list[tuple[int, int, int, float]], tuple[float, ...]]:
    """Return n elementary joints, their derivatives, geared ones, and the placement of the tip.

    Derivatives, (n, k), are by leg joints, then by parameters. Where a parameter is the ratio of a
    gear, the third item has the elementary joint, the leg joint, the parameter and the sign. The
    tip is a constant placement behind the last joint.
    """
    columns = leaders(leg, joints)
    behind, width = len(columns), len(columns) + len(leg.parameters)
    elements: list[Elementary] = []
    rows: list[Array] = []
    geared: list[tuple[int, int, int, float]] = []
    pending = np.eye(4)  # constant placement in front of the next elementary joint

    def add(element: Elementary, column: int, sign: float) -> None:
        nonlocal pending
        row = sign * np.eye(width)[column]
        if elements and element == replace(elements[-1], placement=()):  # same axis: one joint
            rows[-1] = rows[-1] + row
        else:
            elements.append(element)
            rows.append(row)
        pending = np.eye(4)

    for joint in joints:
        for step in joint.placement.steps:
            if isinstance(step.value, str):
                column = behind + leg.parameter_names.index(step.value)
                add(Elementary(step.axis, _key(pending)), column, step.sign)
            else:
                pending = pending @ step.matrix({})
        context = f"{leg.name}, joint {joint.name!r}"
        pending = pending @ joint.placement.rest(leg.nominal_by_name, context)
        if joint.kind != "fixed":
            name, ratio, offset = joint.leader
            pending = pending @ joint.motion(np.array([offset]))[0]
            column, turn = columns.index(name), "r" if joint.turns else ""
            element, sign = Elementary(turn or "t", _key(pending), joint.axis), 1.0
            if 1.0 in np.abs(joint.axis):
                place = int(np.argmax(np.abs(joint.axis)))
                element, sign = Elementary(turn + "xyz"[place], _key(pending)), joint.axis[place]
            add(element, column, 0.0 if joint.ratio else sign * ratio)
            if joint.ratio:
                parameter = leg.parameter_names.index(joint.ratio)
                geared.append((len(rows) - 1, column, parameter, sign))
    return tuple(elements), np.reshape(rows, (len(rows), width)), geared, _key(pending)


def _key(matrix: Array) -> tuple[float, ...]:
    """Return a homogeneous matrix as a hashable row, empty for the identity."""
    return () if np.array_equal(matrix, np.eye(4)) else tuple(float(v) for v in matrix.ravel())


class PlatformPoint(NamedTuple):
    """A platform point and its frame in N rows (or 1 for all), placed by k parameters."""

    parameters: Index
    """Indices of the parameters, shape (k,)."""
    arm: Array
    """Vector from the platform's origin to the point, shape (3, 1, N), platform axes, [m]."""
    twists: Array
    """Twists of the frame by the parameters, linear first, shape (6, k, N), platform axes."""
    turn: Array
    """Orientation of the frame, shape (N, 3, 3)."""


def platform_point(leg: Leg, end: int, parameters: Array, deformations: Array) -> PlatformPoint:
    """Return the platform point of a leg's end, in N rows if deformations (N, n) move it."""
    chain = point_chain(leg, end)
    if chain.entries and deformations.shape[1]:
        return _placed(chain, parameters, deformations)
    return _still_point(leg, end, parameters[chain.moving].tobytes())


@lru_cache(maxsize=1024)
def _still_point(leg: Leg, end: int, placing: bytes) -> PlatformPoint:
    chain, parameters = point_chain(leg, end), np.zeros(len(leg.parameters))
    parameters[chain.moving] = np.frombuffer(placing)
    return _placed(chain, parameters, np.zeros((1, 0)))


def _placed(chain: Chain, parameters: Array, deformations: Array) -> PlatformPoint:
    motion = chain.motion(parameters, deformations)
    return PlatformPoint(
        chain.moving, motion.tips[:, None], motion.twists(list(chain.moving)), motion.turns
    )
