"""A forest is one Pinocchio model with many copies of a chain: one call evaluates many poses.

A call from Python into Pinocchio costs more than the kinematics of one leg. With B
copies side by side in one model, one ``computeJointJacobians`` evaluates B
configurations, and ``data.J`` holds every joint column of every copy.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Array = NDArray[np.float64]

_JOINTS = {
    "x": pin.JointModelPX,
    "y": pin.JointModelPY,
    "z": pin.JointModelPZ,
    "rx": pin.JointModelRX,
    "ry": pin.JointModelRY,
    "rz": pin.JointModelRZ,
}
_COLUMNS = 64  # Creating Pinocchio's data costs nv³: keep nv near this


@dataclass(frozen=True)
class Elementary:
    """An elementary joint after a constant placement: axis letter, or ``t``/``r`` and a vector."""

    axis: str
    placement: tuple[float, ...] = ()
    """Homogeneous matrix, row by row; empty for the identity."""
    vector: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def pinocchio_joint(self) -> pin.JointModel:
        """Return Pinocchio's joint model."""
        if self.axis == "t":
            return pin.JointModelPrismaticUnaligned(np.array(self.vector))
        if self.axis == "r":
            return pin.JointModelRevoluteUnaligned(np.array(self.vector))
        return _JOINTS[self.axis]()

    def pinocchio_placement(self) -> pin.SE3:
        """Return the constant placement before the joint."""
        if not self.placement:
            return pin.SE3.Identity()
        return pin.SE3(np.array(self.placement).reshape(4, 4))


class Forest:
    """Copies of one chain of elementary joints, evaluated together.

    Dummy revolute joints at the end of the chain carry its tip: the column of a
    revolute joint about a unit axis a through p is (p × a, a), so a × (p × a) is
    p less its part along a. One dummy gives the tip in the plane across z, two
    give it in space.
    """

    def __init__(self, chain: tuple[Elementary, ...], spatial: bool, copies: int) -> None:
        self.spatial = spatial
        self.copies = copies
        self.width = len(chain)
        self._model = pin.Model()
        for copy in range(copies):
            parent = 0
            for index, joint in enumerate(chain):
                parent = self._model.addJoint(
                    parent,
                    joint.pinocchio_joint(),
                    joint.pinocchio_placement(),
                    f"{copy}_{index}",
                )
        self._data = self._model.createData()

    def columns(self, configurations: Array) -> tuple[Array, Array]:
        """Return the tips and the velocities of the tip for each joint's unit rate.

        Args:
            configurations: N configurations of the chain, shape (N, n), without dummies.

        Returns:
            Tips in the base frame, shape (N, 3), [m]; columns, shape (6, N, n), the
            velocity of the tip in the base frame (linear first) for each joint.
        """
        tips, columns, _ = self._evaluated(configurations)
        return tips, columns

    def frames(self, configurations: Array) -> tuple[Array, Array, Array]:
        """Return tips, columns (see ``columns``) and the tips' orientations, shape (N, 3, 3).

        Chains made with ``spatial`` only: their dummies turn about the tip's z and x.
        """
        tips, columns, dummies = self._evaluated(configurations)
        z, x = dummies[3:, :, 0].T, dummies[3:, :, 1].T
        return tips, columns, np.stack((x, cross(z, x), z), axis=2)

    def _evaluated(self, configurations: Array) -> tuple[Array, Array, Array]:
        """Return tips, columns, and the twists of the dummy joints, shape (6, N, 1 or 2)."""
        count, n = configurations.shape
        blocks = -(-count // self.copies)
        padded = np.zeros((blocks, self.copies, self.width))
        flat = padded.reshape(blocks * self.copies, self.width)
        flat[:count, :n] = configurations
        flat[count:, :n] = configurations[-1] if count else 0.0
        out = np.empty((blocks, 6, self.copies * self.width))
        evaluate, model, data = pin.computeJointJacobians, self._model, self._data
        for target, q in zip(out, padded.reshape(blocks, self.copies * self.width), strict=True):
            target[:] = evaluate(model, data, q)
        rows = out.reshape(blocks, 6, self.copies, self.width).transpose(1, 0, 2, 3)
        twists = rows.reshape(6, blocks * self.copies, self.width)[:, :count]
        tips = self._tips(twists[:, :, n:])
        return tips, _shifted(twists[:, :, :n], tips), twists[:, :, n:]

    def _tips(self, dummies: Array) -> Array:
        """Return the tips from the twists of the dummy joints, shapes (6, N, 1 or 2) to (N, 3)."""
        moment, axis = dummies[:3, :, 0].T, dummies[3:, :, 0].T
        tips = cross(axis, moment)
        if self.spatial:  # the part along the first axis, from the second
            second, third = dummies[:3, :, 1].T, cross(axis, dummies[3:, :, 1].T)
            tips += axis * np.einsum("ni,ni->n", second, third)[:, None]  # (p × b)·(a × b) = p·a
        return tips


def _shifted(twists: Array, tips: Array) -> Array:
    """Return twists (6, N, n) at the base origin as velocities of the tips (N, 3)."""
    x, y, z = (tips[:, i, None] for i in range(3))
    wx, wy, wz = twists[3:]
    shifted = twists.copy()
    shifted[0] += wy * z - wz * y
    shifted[1] += wz * x - wx * z
    shifted[2] += wx * y - wy * x
    return shifted


def cross(a: Array, b: Array) -> Array:
    """Return a × b for shapes (N, 3); NumPy's own is several times slower."""
    (x, y, z), (u, v, w) = a.T, b.T
    product = np.empty((len(a), 3))
    product[:, 0] = y * w - z * v
    product[:, 1] = z * u - x * w
    product[:, 2] = x * v - y * u
    return product


@lru_cache(maxsize=64)
def forest(
    chain: tuple[Elementary, ...],
    tip: tuple[float, ...] = (),
    *,
    spatial: bool,
    copies: int | None = None,
) -> Forest:
    """Return the forest of a chain, made once; by default with as many copies as pay.

    Args:
        chain: Elementary joints, base first.
        tip: Constant placement of the tip after the last joint, row by row.
        spatial: Whether tips are wanted in space, or in the plane across z only.
        copies: Number of chains side by side.
    """
    dummies = (Elementary("rz", tip), *((Elementary("rx"),) if spatial else ()))
    width = len(chain) + len(dummies)
    return Forest(chain + dummies, spatial, copies or max(1, _COLUMNS // width))
