"""A forest is one Pinocchio model with many copies of a chain: one call evaluates many poses.

A call from Python into Pinocchio costs more than the kinematics of one leg. With B copies side by
side, ``data.J`` of one ``computeJointJacobians`` holds the joint columns of all copies. For other
programs, ``pinocchio_model`` makes one model of a mechanism with its loops as constraints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from threading import Lock

import numpy as np
import pinocchio as pin
from numpy.lib.stride_tricks import as_strided

from pincal.errors import MechanismError
from pincal.kinematics.batches import cross
from pincal.model import Leg, Mechanism
from pincal.types import Array

_JOINTS = {
    "x": pin.JointModelPX,
    "y": pin.JointModelPY,
    "z": pin.JointModelPZ,
    "rx": pin.JointModelRX,
    "ry": pin.JointModelRY,
    "rz": pin.JointModelRZ,
    "t": pin.JointModelPrismaticUnaligned,
    "r": pin.JointModelRevoluteUnaligned,
}
_COLUMNS = 40  # best nv: calls cost as much as with 64, Pinocchio's data a quarter
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Elementary:
    """An elementary joint behind a constant placement: an axis, or ``t``/``r`` and a vector."""

    axis: str
    placement: tuple[float, ...] = ()
    """Homogeneous matrix, row by row; empty for the identity."""
    vector: Vector = (0.0, 0.0, 1.0)

    def added_to(self, model: pin.Model, parent: int) -> int:
        """Add the joint to a Pinocchio model behind its parent; return its index."""
        kind, along = _JOINTS[self.axis], self.axis in ("t", "r")
        joint = kind(np.array(self.vector)) if along else kind()
        placement = np.reshape(self.placement, (4, 4)) if self.placement else np.eye(4)
        return int(model.addJoint(parent, joint, pin.SE3(placement), f"joint {model.njoints}"))


class Forest:
    """Copies of one chain of elementary joints, evaluated together."""

    def __init__(
        self,
        chain: tuple[Elementary, ...],
        tip: tuple[float, ...] = (),
        spatial: bool = True,
        copies: int | None = None,
    ) -> None:
        """Make copies of a chain of joints, base first; by default the best number of copies.

        The tip is a constant placement behind the last joint. A chain that is not spatial moves in
        the plane normal to z.
        """
        chain = chain or (Elementary("rz"),)  # a joint that stays at zero
        self.chain, self.spatial = chain, spatial
        self.copies = copies or max(1, _COLUMNS // len(chain))
        self.width = len(chain)
        self._tip = np.array(tip).reshape(4, 4) if tip else None
        self._model = pin.Model()
        for _ in range(self.copies):
            parent = 0
            for joint in chain:
                parent = joint.added_to(self._model, parent)
        self._data = self._model.createData()
        # views of Pinocchio's memory: the roots of the copies, and what each call writes
        self._roots = placements_in(self._model.jointPlacements)[1 :: self.width]
        self._origin = self._roots[0].copy()
        self._columns = _bytes(self._data.J.T)
        self._ends = placements_in(self._data.oMi)[self.width :: self.width]
        self._turn = Lock()  # one thread at a time may use Pinocchio's data

    def motion(
        self, configurations: Array, rates: Array, bases: Sequence[Motion | None] = (None,)
    ) -> Motion:
        """Return the tips of L chains and their motion.

        ``configurations`` are (L, N, n), ``rates`` of the joints in k motions (k, n). Each chain
        begins at the tip of a standing chain of ``bases``, or at the base's origin.
        """
        legs, count, n = configurations.shape
        blocks, size = -(-count // self.copies), self.copies * self.width
        padded = np.zeros((legs, blocks * self.copies, self.width))
        padded[:, :count, :n] = configurations
        columns = np.empty((legs * blocks, size, 6))
        ends = np.empty((legs * blocks, self.copies, 12))
        evaluate, model, data = pin.computeJointJacobians, self._model, self._data
        to_columns, length = _bytes(columns), len(self._columns)
        with self._turn:
            for leg, base in enumerate(bases):
                root = self._origin if base is None else np.append(base.turns[0].T, base.tips)
                self._roots[:] = root
                for block, q in enumerate(padded[leg].reshape(blocks, size), leg * blocks):
                    evaluate(model, data, q)
                    to_columns[block * length : (block + 1) * length] = self._columns  # as stored
                    ends[block] = self._ends
        rows = [0, 1, 2, 3, 4, 5] if self.spatial else [0, 1, 5]  # others are zero in the plane
        columns = columns.reshape(legs, -1, self.width, 6)[:, :count, :n]
        twists = np.empty((len(rows), n, legs, count))
        for target, row in zip(twists, rows, strict=True):
            target[:] = columns[:, :, :, row].transpose(2, 0, 1)
        ends = ends.reshape(legs, -1, 12)[:, :count].reshape(legs * count, 12)
        turns = ends[:, :9].reshape(-1, 3, 3).swapaxes(1, 2)
        m = 3 if self.spatial else 2
        tips = ends[:, 9 : 9 + m].T.copy()
        if self._tip is not None:
            tips += (turns[:, :m] @ self._tip[:3, 3]).T
            turns = turns @ self._tip[:3, :3]
        turns = turns if self.spatial else np.empty((0, 3, 3))
        begun = None
        if any(base is not None and base.rates.any() for base in bases):
            still = np.zeros((6, len(rates)))
            moved = [still if b is None else b.columns[:, :, 0] @ b.rates.T for b in bases]
            begun = np.stack(moved)[:, rows]
        return Motion(tips, turns, twists.reshape(len(rows), n, legs * count), rates, begun)


@dataclass(frozen=True)
class Motion:
    """Tips of chains at N configurations, and their twists in k motions, in the base frame.

    In the plane normal to z, positions have two rows, and twists x, y and the rate about z.
    """

    tips: Array
    """Positions of the tips, shape (2 or 3, N), [m]."""
    turns: Array
    """Orientations of the tips in space, shape (N, 3, 3); (0, 3, 3) in the plane."""
    columns: Array
    """Twists at the base's origin by the chain's joints, linear first, shape (3 or 6, n, N)."""
    rates: Array
    """Rates of the joints in each motion, shape (k, n)."""
    begun: Array | None
    """Twists at the base's origin of the points where the chains begin, (L, 3 or 6, k)."""
    products: tuple[tuple[int, int, Array], ...] = ()
    """Motions in which the rate of a joint differs from row to row: motion, joint, rates (N,)."""

    def twists_at_tip(self, motions: slice | list[int]) -> Array:
        """Return twists at the tip in some motions, linear first, shape (3 or 6, s, N)."""
        rates = self.rates[motions]
        twists = np.empty((len(self.columns), len(rates), self.columns.shape[2]))
        for twist, row in zip(twists, self.columns, strict=True):
            np.matmul(rates, row, out=twist)
        places = np.arange(len(self.rates))[motions].tolist()
        for motion, joint, amounts in self.products:
            if motion in places:
                twists[:, places.index(motion)] += self.columns[:, joint] * amounts
        if self.begun is not None and (begun := self.begun[:, :, motions]).any():
            by_chain = twists.reshape(*twists.shape[:2], len(begun), -1)
            by_chain += begun.transpose(1, 2, 0)[..., None]
        if len(self.tips) == 2:
            twists[0] -= twists[2] * self.tips[1]
            twists[1] += twists[2] * self.tips[0]
            return twists
        (x, y, z), (wx, wy, wz) = self.tips, twists[3:]
        twists[0] += wy * z - wz * y
        twists[1] += wz * x - wx * z
        twists[2] += wx * y - wy * x
        return twists

    def power(self, force: Array, after: int) -> Array:
        """Return the power (k', N) of forces (2 or 3, N) at the tip in motions from ``after``."""
        # power does not depend on the point: at the base's origin no twist has to be moved
        at_origin = wrench(self.tips, force)
        by_joint = np.einsum("rjn,rn->jn", self.columns, at_origin)
        power = self.rates[after:] @ by_joint
        for motion, joint, amounts in self.products:
            if motion >= after:
                power[motion - after] += by_joint[joint] * amounts
        if self.begun is not None:
            legs = len(self.begun)
            by_chain = at_origin.reshape(len(at_origin), legs, -1).swapaxes(0, 1)
            begun = self.begun[:, :, after:].swapaxes(1, 2) @ by_chain
            by_leg = power.reshape(len(power), legs, -1)
            by_leg += begun.swapaxes(0, 1)
        return np.asarray(power)

    def twists(self, motions: slice | list[int] = slice(None)) -> Array:
        """Return twists at the tip with all six rows, linear first, (6, k, N), in some motions."""
        rows, m = self.twists_at_tip(motions), len(self.tips)
        full = np.zeros((6, *rows.shape[1:]))
        full[:m], full[6 - (len(rows) - m) :] = rows[:m], rows[m:]
        return full


def wrench(arm: Array, force: Array) -> Array:
    """Return force and arm × force, (3 or 6, N), of shapes (2 or 3, N); in the plane x, y, rz."""
    if len(force) == 2:
        return np.concatenate((force, (arm[0] * force[1] - arm[1] * force[0])[None]))
    return np.concatenate((force, cross(arm.T, force.T).T))


def pinocchio_model(mechanism: Mechanism) -> tuple[pin.Model, list[pin.RigidConstraintModel]]:
    """Return a mechanism as one model, and its loop constraints: see ``Mechanism.pinocchio``."""
    model, met = pin.Model(), list[tuple[pin.ContactType, int, pin.SE3, int, pin.SE3]]()
    model.name, platform = mechanism.name, 0
    links = [_add_leg(model, leg) for leg in mechanism.legs]
    for row, name in zip(mechanism.platform.twist_rows, mechanism.platform.twist, strict=True):
        if row < 3 or mechanism.platform.turns == 1:
            axis = _JOINTS[name]()
            platform = model.addJoint(platform, axis, pin.SE3.Identity(), f"platform.{name}")
    if mechanism.platform.turns == 3:
        ball = pin.JointModelSpherical()
        platform = model.addJoint(platform, ball, pin.SE3.Identity(), "platform.orientation")
    model.addFrame(pin.Frame("platform", platform, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    if (load := mechanism.load) is not None:
        model.appendBodyToJoint(platform, _mass(load.mass, load.centre), pin.SE3.Identity())
        model.gravity.linear = np.array(load.gravity)
    for leg, placed in zip(mechanism.legs, links, strict=True):
        for end in leg.every_end:
            kind = {3: pin.ContactType.CONTACT_3D, 6: pin.ContactType.CONTACT_6D}.get(len(end.rows))
            if kind is None:
                raise MechanismError(
                    f"{leg.name} closes {', '.join(end.closes)}: constraints of Pinocchio's "
                    "close points or whole frames"
                )
            point = end.point and (platform, pin.SE3(end.point.placement.origin()))
            met.append((kind, *placed[end.tip], *(point or placed[str(end.meets)])))
    local = pin.ReferenceFrame.LOCAL
    return model, [pin.RigidConstraintModel(kind, model, *ends, local) for kind, *ends in met]


def _add_leg(model: pin.Model, leg: Leg) -> dict[str, tuple[int, pin.SE3]]:
    """Add the joints of a leg to a model; return the joint of each frame and its placement."""
    links: dict[str, tuple[int, pin.SE3]] = {}
    for joint, carrier in zip(leg.joints, leg.carriers, strict=True):
        if joint.follows:
            raise MechanismError(f"{leg.name}: {joint.name!r} follows another joint; not supported")
        base = (0, pin.SE3.Identity())
        parent, place = links[leg.joints[carrier].name] if carrier >= 0 else base
        place = place * pin.SE3(joint.placement.origin())
        if joint.kind != "fixed":
            kind = Elementary("r" if joint.turns else "t", tuple(place.homogeneous.ravel()))
            parent = replace(kind, vector=joint.axis).added_to(model, parent)
            model.names[parent], place = f"{leg.name}.{joint.name}", pin.SE3.Identity()
            if joint.limited:
                row = model.joints[parent].idx_q
                model.lowerPositionLimit[row] = joint.lower
                model.upperPositionLimit[row] = joint.upper
        if joint.mass:
            model.appendBodyToJoint(parent, _mass(joint.mass, joint.centre), place)
        links[joint.name] = parent, place
    return links


def _mass(mass: float, centre: Vector) -> pin.Inertia:
    return pin.Inertia(mass, np.array(centre), np.zeros((3, 3)))


def placements_in(memory: pin.StdVec_SE3) -> Array:
    """Return a view of n placements in Pinocchio's memory, shape (n, 12), to read and write.

    A row is a rotation matrix column by column, then the position. The view is valid as long as the
    model or data. Raises TypeError if this Pinocchio has another memory layout.
    """
    first, last, size = memory[0].rotation, memory[-1], memory[0].rotation.itemsize
    begin, end, position = (
        array.__array_interface__["data"][0] for array in (first, last.rotation, last.translation)
    )
    if end - begin != 12 * size * (len(memory) - 1) or position - end != 9 * size:
        raise TypeError(f"pin {pin.__version__} has another memory layout of placements")
    return as_strided(first, (len(memory), 12), (12 * size, size))


def _bytes(array: Array) -> memoryview:
    return array.reshape(-1).data.cast("B")
