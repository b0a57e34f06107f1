"""An independent simulator of 5R, 3-RRR and 6-UPS, and the Cramér-Rao bound of its data.

Readings are closed forms in plain NumPy; the bound is the inverse of the dense Fisher information
of all parameters and all poses, by central differences. Nothing uses pincal's kinematics.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from closed_forms import angles, near, reading
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import pincal

Array = NDArray[np.float64]
KINDS = ("5R", "3RRR", "6UPS")
NOISE = pincal.Noise(1e-4, 1e-4, 5e-5)


@dataclass(frozen=True)
class Machine:
    """A true machine of a bundled kind at true poses."""

    nominal: pincal.Mechanism
    parameters: Array
    """True ones, legs in order, shape (n,)."""
    positions: Array
    """Of the platform, shape (N, 2) or (N, 3), [m]."""
    rotations: Rotation
    """Of the platform, length N."""

    @property
    def kind(self) -> str:
        """Name of the bundled mechanism."""
        return self.nominal.name

    @property
    def dof(self) -> int:
        """Freedoms of the platform."""
        return self.nominal.platform.dof

    def readings(self, parameters: Array, twists: Array) -> Array:
        """Return readings at the true poses moved by twists in base axes, shape (N, n_legs)."""
        space = self.positions.shape[1]
        positions = self.positions + twists[:, :space]
        turns = np.zeros((len(twists), 3))
        if self.dof > space:
            turns[:, -(self.dof - space) :] = twists[:, space:]
        rotations = Rotation.from_rotvec(turns) * self.rotations
        columns, begin = [], 0
        for index, leg in enumerate(self.nominal.legs):
            names = leg.parameter_names
            p = dict(zip(names, parameters[begin : begin + len(names)].tolist(), strict=True))
            begin += len(names)
            if self.kind == "6UPS":
                A = _spherical(p["OA"], p["alpha"], p["beta"])
                b = _spherical(p["ob"], p["alpha_b"], p["beta_b"])
                length = np.linalg.norm(positions + rotations.apply(b) - A, axis=1)
                columns.append((length - p["gamma"]) / p["k"])
                continue
            poses = np.column_stack((positions, rotations.as_rotvec()[:, 2]))
            poses = poses[:, : self.dof]
            shoulder, _ = angles(self.kind, p, poses, 1 if np.sin(leg.home[1]) > 0 else -1)
            turn = leg.home[0] + near(shoulder, leg.home[0])
            columns.append(reading(self.kind, index, p, turn))
        return np.stack(columns, axis=1)

    def coordinates(self, twists: Array) -> Array:
        """Return the true poses, moved by twists, as the platform's coordinates, (N, dof)."""
        space = self.positions.shape[1]
        matrices = np.tile(np.eye(4), (len(twists), 1, 1))
        matrices[:, :space, 3] = self.positions + twists[:, :space]
        turns = np.zeros((len(twists), 3))
        if self.dof > space:
            turns[:, -(self.dof - space) :] = twists[:, space:]
        matrices[:, :3, :3] = (Rotation.from_rotvec(turns) * self.rotations).as_matrix()
        return self.nominal.platform.from_matrices(matrices)

    @cached_property
    def sigma(self) -> tuple[Array, Array]:
        """Standard deviations of readings (N, n_legs) and of the poses' freedoms (N, dof)."""
        n = len(self.positions)
        poses = np.tile(NOISE.of_poses(self.nominal), (n, 1))
        return np.full((n, len(self.nominal.legs)), NOISE.reading), poses

    @cached_property
    def estimate(self) -> Array:
        """Return the efficient estimate's error per unit of noise, shape (n, n_rows).

        F⁻¹ Jᵀ: J of whitened readings and poses by parameters and all poses, F = JᵀJ dense. Its
        product with its transpose is the bound of the covariance.
        """
        readings, poses = self.sigma
        n, (count, dof), h = len(self.parameters), poses.shape, 1e-6
        still, J = np.zeros((count, dof)), np.zeros((readings.size + poses.size, n + poses.size))

        def differences(parameters: Array, twists: Array) -> Array:
            ends = [self.readings(self.parameters + s * parameters, s * twists) for s in (1, -1)]
            return (ends[0] - ends[1]) / (2 * h) / readings

        for column, step in enumerate(h * np.eye(n)):
            J[: readings.size, column] = differences(step, still).ravel()
        for freedom, step in enumerate(h * np.eye(dof)):
            change = differences(0.0 * self.parameters, np.tile(step, (count, 1)))
            for row in range(count):
                legs = slice(row * readings.shape[1], (row + 1) * readings.shape[1])
                J[legs, n + row * dof + freedom] = change[row]
        J[readings.size :, n:] = np.diag(1.0 / poses.ravel())
        return np.asarray(np.linalg.solve(J.T @ J, J.T)[:n])

    @cached_property
    def bound(self) -> Array:
        """Least standard deviations of any unbiased estimate, shape (n,)."""
        return np.linalg.norm(self.estimate, axis=1)

    def measured(self, seed: int) -> tuple[pincal.Measurements, Array]:
        """Return measurements with noise, and the efficient estimate's error with it, (n,)."""
        readings, poses = self.sigma
        rng = np.random.default_rng(seed)
        noise = rng.standard_normal(readings.size + poses.size)
        shaken = self.readings(self.parameters, np.zeros(poses.shape))
        shaken += noise[: readings.size].reshape(readings.shape) * readings
        moved = self.coordinates(noise[readings.size :].reshape(poses.shape) * poses)
        return pincal.Measurements(poses=moved, readings=shaken), self.estimate @ noise


def _spherical(radius: float, polar: float, azimuth: float) -> Array:
    across = np.sin(polar)
    return radius * np.array([across * np.cos(azimuth), across * np.sin(azimuth), np.cos(polar)])


def machine(kind: str, count: int = 40, size: float = 2e-3) -> Machine:
    """Return a true machine, its parameters normally disturbed, at poses that all legs reach."""
    nominal = pincal.load_mechanism(kind)
    start = np.concatenate([leg.nominal for leg in nominal.legs])
    true = start + size * np.random.default_rng(1).standard_normal(len(start))
    platform = nominal.platform
    matrices = platform.transforms(pincal.sample_workspace(nominal, count, 0)).as_matrix()
    rotations = Rotation.from_matrix(matrices[:, :3, :3])
    found = Machine(nominal, true, matrices[:, : platform.space, 3], rotations)
    ok = np.isfinite(found.readings(true, np.zeros((count, platform.dof)))).all(axis=1)
    return Machine(nominal, true, found.positions[ok], rotations[ok])


def values_of(result: pincal.CalibrationResult) -> Array:
    """Return identified values, standard errors and intervals' ends, shape (4, n)."""
    found = [p for leg in result.legs for p in leg.parameters]
    return np.array([[p.identified, p.std, p.low, p.high] for p in found]).T


def drawn(
    one: Machine, noise: pincal.Noise, seed: int, more: Array | float = 0.0
) -> pincal.Measurements:
    """Return measurements with noise, and with more in the readings than the model knows."""
    rng = np.random.default_rng(seed)
    still = np.zeros((len(one.positions), one.dof))
    readings = one.readings(one.parameters, still) + more
    readings = readings + noise.reading * rng.standard_normal(readings.shape)
    twists = noise.of_poses(one.nominal) * rng.standard_normal(still.shape)
    return pincal.Measurements(poses=one.coordinates(twists), readings=readings)


def off(one: Machine, found: Array, more: Array | float = 0.0) -> Array:
    """Return by how much the platform misses its poses with identified parameters, (N,) [m]."""
    dof, h = one.dof, 1e-6 * np.abs(one.positions).max()
    twists = np.zeros((len(one.positions), dof))
    wanted = one.readings(found, twists)
    for _ in range(8):
        gap = one.readings(one.parameters, twists) + more - wanted
        J = np.stack(
            [
                (
                    one.readings(one.parameters, twists + d)
                    - one.readings(one.parameters, twists - d)
                )
                / (2 * h)
                for d in h * np.eye(dof)
            ],
            axis=2,
        )
        twists = twists - (np.linalg.pinv(J) @ gap[:, :, None])[:, :, 0]
    return np.asarray(np.linalg.norm(twists[:, : one.positions.shape[1]], axis=1))
