"""Elements of a dihedral group as isometries about the base's z axis, and how they move poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.model.platform import Platform, Poses

Array = NDArray[np.float64]
#: Angles, [rad], and positions relative to their extent that differ by rounding errors only.
SAME = 1e-9


@dataclass(frozen=True)
class Element:
    """Rotation about z, or reflection through a plane that holds z, of the base frame.

    A rotation takes an azimuth β to β + angle; a reflection takes it to angle − β, so the
    mirror plane is at angle / 2.
    """

    angle: float
    """[rad]."""
    reflection: bool = False

    @staticmethod
    def rotations(n: int) -> tuple[Element, ...]:
        """Return the n rotations of D_2n, the identity first."""
        return tuple(Element(wrapped(2 * np.pi * k / n)) for k in range(n))

    @staticmethod
    def mirror(azimuth: float) -> Element:
        """Return the reflection through the plane that holds z at an azimuth, [rad]."""
        return Element(wrapped(2 * azimuth), reflection=True)

    @property
    def matrix(self) -> Array:
        """Orthogonal matrix Q, shape (3, 3)."""
        cos, sin = np.cos(self.angle), np.sin(self.angle)
        if self.reflection:
            return np.array([[cos, sin, 0.0], [sin, -cos, 0.0], [0.0, 0.0, 1.0]])
        return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])

    def azimuth(self, azimuth: float) -> float:
        """Return where an azimuth goes, [rad] in (-pi, pi]."""
        return wrapped((self.angle - azimuth) if self.reflection else (azimuth + self.angle))

    def after(self, other: Element) -> Element:
        """Return the composition: first ``other``, then this one."""
        angle = self.angle + (-other.angle if self.reflection else other.angle)
        return Element(wrapped(angle), self.reflection != other.reflection)

    def inverse(self) -> Element:
        """Return the element that undoes this one."""
        return self if self.reflection else Element(wrapped(-self.angle))

    def equals(self, other: Element) -> bool:
        """Return whether two elements are the same but for rounding errors."""
        same = abs(wrapped(self.angle - other.angle)) <= SAME
        return self.reflection == other.reflection and same

    def poses(self, platform: Platform, poses: Poses) -> Array:
        """Return where poses go, coordinates of shape (N, dof): r → Q r, R → Q R Qᵀ."""
        matrices = platform.transforms(poses).as_matrix().copy()
        Q = self.matrix
        matrices[:, :3, 3] = matrices[:, :3, 3] @ Q.T
        matrices[:, :3, :3] = Q @ matrices[:, :3, :3] @ Q.T
        return platform.from_matrices(matrices)

    def __str__(self) -> str:
        """Return the element's name."""
        degrees = np.degrees(self.angle)
        if self.reflection:
            return f"mirror at azimuth {degrees / 2 % 180.0:.4g}°"
        return "identity" if abs(degrees) < 1e-9 else f"rotation by {degrees % 360.0:.4g}°"


def wrapped(angle: float) -> float:
    """Return an angle in (-pi, pi], [rad]."""
    return float(np.pi - (np.pi - angle) % (2 * np.pi))


#: What the package calls them by.
rotations, mirror = Element.rotations, Element.mirror
