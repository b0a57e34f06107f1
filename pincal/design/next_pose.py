"""Which pose of a plan to measure next, by what is known, and how the platform's error falls.

The information of priors and of the rows that were measured, M = diag(σ⁻²) + Σ Aⱼᵀ Aⱼ, says how far
the platform is off; each row of the plan, how much more would be known with it. Rows are those of
forecasts, by the nominal mechanism: which pose is next depends on no measured number.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import chdtri

from pincal.blas import one_thread
from pincal.design.forecast import forecast, information_rows, touching
from pincal.design.optimal import DETERMINANT, inverse_roots
from pincal.design.platform_error import CONFIDENCE, seen_of
from pincal.errors import MeasurementError
from pincal.kinematics.configurations import legs_at
from pincal.model.measurements import Noise, Plan
from pincal.model.mechanism import Mechanism
from pincal.model.setup import Setup
from pincal.types import Array, Mask
from pincal.workspace.sampling import sample_configurations

_WORKSPACE, _SEED = 200, 1  # configurations over which errors are stated
_FAR = 10.0  # sizes of the machine, or rad, within which frames are sought
_COURSE = 100  # poses that are looked ahead, at most


class Candidates:
    """Rows of a plan: which are offered, what they say of the unknowns and of the platform."""

    offered: Mask
    """Rows in reach that a fit follows, shape (N,)."""
    rows: Array
    """White rows of the plan, zero where not offered, shape (N, k, n)."""
    spread: Array
    """σ of what is known of each unknown beforehand, shape (n,)."""
    workspace: Plan
    """Configurations over which errors are stated."""

    @one_thread()
    def __init__(
        self,
        mechanism: Mechanism,
        plan: Plan,
        noise: Noise,
        measured: Sequence[str] | None,
        setup: Setup,
        priors: Mapping[str, float],
    ) -> None:
        """Look at a plan by the nominal mechanism, whose parameters are known to ± priors by id.

        What is measured, and what it means, is said as to ``forecast``.

        Raises:
            MeasurementError: measurements without noise or equations, or no pose in reach.
        """
        legs = legs_at(mechanism, touching(mechanism, plan, setup))
        frames = forecast(mechanism, plan, noise, measured, setup).frames
        white, _, unknowns, _ = information_rows(mechanism, legs, noise, measured, setup)
        self.offered = legs.reached & ~plan.verifying
        self.rows = np.zeros((len(plan), *white.shape[1:]))
        self.rows[legs.reached] = white * self.offered[legs.reached, None, None]
        far = _FAR * max(mechanism.size, 1.0)
        self.spread = np.array([priors.get(name, far) for name in unknowns])
        self.workspace = sample_configurations(mechanism, _WORKSPACE, _SEED)
        legs = legs_at(mechanism, self.workspace)
        gain, units = seen_of(mechanism, legs.poses, legs.gain, frames)
        gain = gain[np.isfinite(gain).all(axis=(1, 2))]
        lengths = np.array([unit == "m" for unit in units])
        G = gain[:, lengths if lengths.any() else ~lengths].reshape(-1, gain.shape[2])
        half = np.asarray(np.linalg.qr(G / np.sqrt(len(gain)), mode="r")).T
        unmoving = len(unknowns) - len(half)
        self._moved = np.pad(half, ((0, unmoving), (0, 0)))  # C: tr Cᵀ M⁻¹ C is a mean square

    def information(self, measured: Sequence[int]) -> Array:
        """Return M of priors and rows of the plan, shape (n, n)."""
        flat = self.rows[list(measured)].reshape(-1, self.rows.shape[2])
        return np.diag(self.spread**-2.0) + flat.T @ flat

    @one_thread()
    def limit(self, measured: Sequence[int]) -> float:
        """Return below which the platform's position error is in 95 of 100 machines, [m].

        Root mean square over the workspace, [rad] of a platform that only turns. Its square is a
        weighted sum of squares, with the quantile of the χ² of its mean and variance
        (Satterthwaite 1946).
        """
        half = inverse_roots(self.information(measured)[None])[0].T @ self._moved
        weights = np.linalg.eigvalsh(half.T @ half).clip(0.0)
        freedoms = weights.sum() ** 2 / (weights**2).sum()
        return float(np.sqrt(weights.sum() * chdtri(freedoms, 1.0 - CONFIDENCE) / freedoms))

    @one_thread()
    def best(self, measured: Sequence[int]) -> tuple[int, float]:
        """Return the row of the plan to measure next, and by what share errors then fall.

        By no other do they fall by more, in the geometric mean of all unknowns. Rows that were
        measured come again when no other is left.

        Raises:
            MeasurementError: no row is offered.
        """
        fresh = self.fresh(measured)
        places = np.flatnonzero(fresh if fresh.any() else self.offered)
        if not len(places):
            raise MeasurementError("no pose of the plan is in reach; give another plan")
        root = inverse_roots(self.information(measured)[None])
        gains = DETERMINANT.gain(self.rows[places], root)[0]
        falls = -np.expm1(-gains.max() / (2 * self.rows.shape[2]))
        return int(places[gains.argmax()]), float(falls)

    def fresh(self, measured: Sequence[int]) -> Mask:
        """Return which rows are offered and were not measured, shape (N,)."""
        fresh = self.offered.copy()
        fresh[list(measured)] = False
        return fresh

    def course(self) -> list[int]:
        """Return rows of the plan in the order in which they will be chosen, 100 at most."""
        measured: list[int] = []
        while len(measured) < _COURSE and self.fresh(measured).any():
            measured.append(self.best(measured)[0])
        return measured
