"""The calibration chain of a leg: its joints and one more joint for each parameter.

Configurations of the chain are linear in the leg's joints and parameters,
``q = J joints + S parameters``; a tie, such as an azimuth that turns a point but not
what follows, is a row of S with several entries.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from pincal.kinematics.forest import Base, Elementary, Forest, Motion, forest
from pincal.model.leg import Joint, Leg
from pincal.model.placement import Placement

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Chain:
    """Elementary joints in a row, and how parameters and leg joints move them.

    The first of them are parameters only: they stand still in all configurations.
    """

    still: Forest
    """The first s elementary joints, without dummies."""
    forest: Forest
    """The others."""
    from_parameters: Array
    """S, shape (n, n_params)."""
    from_joints: Array
    """J, shape (n, n_joints): one entry ±1 a column."""

    def motion(self, parameters: Array, joints: Array) -> Motion:
        """Return where the tip is, and how each leg joint and then each parameter moves it.

        Args:
            parameters: Parameter values, shape (n_params,).
            joints: Joint positions of the leg, shape (N, n_joints), [rad] or [m].
        """
        values, base = self._begun(parameters.tobytes())
        q = np.empty((len(joints), len(values)))
        q[:] = values
        for column, (row, sign) in enumerate(self._rows):
            q[:, row] += sign * joints[:, column]
        return self.forest.motion(q, self._wanted, base)

    @cached_property
    def _begun(self) -> Callable[[bytes], tuple[Array, Base | None]]:
        """Returns what parameters put into the moving joints, and where these begin; kept."""
        s = self.still.width

        @lru_cache(maxsize=8)  # the same parameters are asked for several times in turn
        def begun(parameters: bytes) -> tuple[Array, Base | None]:
            values = self.from_parameters @ np.frombuffer(parameters)
            return values[s:], self.still.begin(values[:s], self._rates[:, :s]) if s else None

        return begun

    @cached_property
    def _rows(self) -> list[tuple[int, float]]:
        """Moving elementary joint of each leg joint, and its sign."""
        rows = [int(np.flatnonzero(entries)[0]) for entries in self.from_joints.T]
        return [(row - self.still.width, self.from_joints[row, i]) for i, row in enumerate(rows)]

    @cached_property
    def moving(self) -> NDArray[np.intp]:
        """Parameters that move the tip, in order."""
        return np.flatnonzero(self.from_parameters.any(axis=0))

    @cached_property
    def _rates(self) -> Array:
        """Rates of elementary joints with each leg joint and parameter, shape (k, n)."""
        return np.concatenate((self.from_joints, self.from_parameters), axis=1).T

    @cached_property
    def _wanted(self) -> Array:
        return self.forest.wanted(self._rates[:, self.still.width :])


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
    moved = [index for index, (_, entry) in enumerate(rows) if entry.any()]
    first = moved[0] if moved else 0
    return Chain(
        Forest(tuple(elements[:first]), spatial=True, copies=1),
        forest(tuple(elements[first:]), _key(pending), spatial=spatial, copies=copies),
        np.array([parameter for parameter, _ in rows]).reshape(len(rows), len(names)),
        np.array([entry for _, entry in rows]).reshape(len(rows), len(moving)),
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
