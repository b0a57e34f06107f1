"""What is said of a session's rows: how far each is from its prediction, and what explains it.

χ² = rᵀ (s² (1 + J C Jᵀ))⁻¹ r    a row r against its prediction by a fit without it
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc, ndtri

from pincal.blas import one_thread
from pincal.calibration.calibration import Calibration
from pincal.calibration.fits import Fits
from pincal.calibration.hypotheses.faults import faults_of_a_row
from pincal.calibration.hypotheses.judging import Case, Hypothesis
from pincal.design.candidates import Candidates
from pincal.estimation.problem import Linear
from pincal.estimation.solver import solve_poses
from pincal.estimation.unknowns import State
from pincal.finding import Finding
from pincal.model import Mechanism, Plan
from pincal.types import Array, Index
from pincal.words.findings import finding

FALSE_ALARM = 3e-3
"""Probability with which each of two tests calls a sound row wrong."""
_CAUSES = 3  # largest number of causes that are named
_SEEN = 1e-6  # least share of a slip's square that shows in a residual
_CONFIRMED = 1e-8  # least share of the variance of a row's residuals that other rows predict
_LEAST = float(np.finfo(float).tiny)  # smallest probability that a float can hold
_NEARLY = 1e-4  # share of a row's χ² that rounding of a typed number may leave


class Checked(NamedTuple):
    """The verdict on a row when it was entered."""

    row: int
    """Index of the row, from 0."""
    sigma: float | None
    """Size of a normal residual as unlikely as the row, in standard deviations of prediction and
    noise; infinite if the row has no pose, None if nothing can be predicted yet."""
    off: bool = False
    """Whether it is farther off than sound rows are."""
    quantity: str = ""
    """The number whose slip would explain most of the residual."""
    causes: tuple[Finding, ...] = ()
    """Faults that would explain it: units, signs, swapped columns."""


class Predictor(NamedTuple):
    """Predictions of a session's rows, by the drawing, and by a fit of rows if there is one."""

    mechanism: Mechanism
    plan: Plan
    candidates: Candidates
    fits: Fits | None = None
    excess: float = 1.0
    """Residuals of that fit over the noise (``CalibrationResult.excess``)."""

    @one_thread()
    def check(self, calibration: Calibration, place: int) -> Checked:
        """Return the verdict on the last row, at a place in the plan, by its prediction."""
        row = len(calibration.measurements) - 1
        if self.fits is None and len(calibration.observation.external):
            return Checked(row, None)
        last = Case(calibration.rows(np.array([row])), np.zeros(1, dtype=np.intp))
        r, S, linear = self.predicted(last.calibration, [place])
        square, sigma, chance, worst, left = (v[0] for v in _row_verdicts(r, S, linear, slice(1)))
        if chance >= FALSE_ALARM:
            return Checked(row, float(sigma))
        tried = list(faults_of_a_row(last))
        squares = _squares(*self.predicted(last.corrected(tried), [place] * len(tried))[:2])
        equations = max(int(linear.equations[0]), 1)
        nearly = _NEARLY * square if np.isfinite(square) else 0.0
        fits = (chdtrc(equations, squares) >= FALSE_ALARM) | (squares <= nearly)
        likely = [tried[index] for index in np.argsort(squares) if fits[index]][:_CAUSES]
        quantity = linear.problem.observation.named(tuple(linear.problem.quantities)[worst], 0)
        if not likely and equations > 1 and chdtrc(equations - 1, left) >= FALSE_ALARM:
            likely = [Hypothesis("slip", lambda data: data, {"quantity": quantity})]
        legs = [tuple(self.mechanism.leg_names[leg] for leg in cause.legs) for cause in likely]
        causes = tuple(
            finding(cause.code, **cause.values, legs=names, unknown_frame=False)
            for cause, names in zip(likely, legs, strict=True)
        )
        return Checked(row, float(sigma), True, quantity, causes)

    def sigmas(self, calibration: Calibration, places: Sequence[int] | Index) -> Array:
        """Return how far rows are from their predictions, in standard deviations, shape (N,)."""
        return _row_verdicts(*self.predicted(calibration, places), slice(None))[1]

    def predicted(
        self, calibration: Calibration, places: Sequence[int] | Index
    ) -> tuple[Array, Array, Linear]:
        """Return residuals of rows against predictions, (N, k), their covariances, conditions.

        Predictions are those of the last fit; of the drawing, if there is none. Conditions are at
        the poses that fit best, searched from those planned at ``places``.
        """
        parameters = self.mechanism.parameters.values
        external = calibration.observation.external.start
        rows = self.candidates.beforehand
        if self.fits is not None:
            fit, external = self.fits.fits[0], self.fits.external
            parameters = fit.parameters
            known = self.candidates.vague if not self.fits.calibration.options.priors else rows
            fitted_rows = fit.last.jacobian[fit.good].reshape(-1, rows.shape[1])
            rows = np.concatenate((known, fitted_rows / self.excess))
        planned = self.mechanism.platform.matrices(self.plan.poses[places])
        state = State(parameters, planned, external=external)
        with np.errstate(all="ignore"):
            linear = solve_poses(calibration.latent_problem.evaluate(state))
            R = np.asarray(np.linalg.qr(rows, mode="r"))
            W = np.linalg.solve(R.T, linear.jacobian.mT)
            return linear.residuals, self.excess**2 * np.eye(W.shape[2]) + W.mT @ W, linear


def _squares(r: Array, S: Array) -> Array:
    """Return χ² = rᵀ S⁻¹ r of rows, shape (N,); infinite where a row has no pose."""
    known = np.isfinite(S).all(axis=(1, 2)) & np.isfinite(r).all(axis=1)
    squares = np.full(len(r), np.inf)
    squares[known] = (r[known] * np.linalg.solve(S[known], r[known, :, None])[:, :, 0]).sum(axis=1)
    return squares


def _row_verdicts(r: Array, S: Array, linear: Linear, rows: Index | slice) -> tuple[Array, ...]:
    """Return χ² of rows, σ, p-value, the worst quantity, and χ² without it, shape (N,) each.

    The residuals r, (N, k), have covariances S. A slip of one standard deviation moves residuals by
    its column w of the noise's root, and explains (wᵀ S⁻¹ r)² / wᵀ S⁻¹ w of χ². The p-value is that
    of χ² or, if less, of the most that a quantity explains. σ is the size of a normal number as
    unlikely; infinite where a row has no pose.
    """
    squares, equations = _squares(r, S), linear.equations[rows]
    w = np.nan_to_num(linear.white(linear.noise_root)[rows, :, : len(linear.problem.quantities)])
    known = np.isfinite(squares)
    gains, weighted = np.zeros((len(r), w.shape[2])), np.linalg.solve(S[known], w[known])
    sizes = (w[known] * weighted).sum(axis=1)
    taken = (r[known, None] @ weighted)[:, 0] ** 2
    gains[known] = np.where(sizes > _SEEN, taken / np.maximum(sizes, _SEEN), 0.0)
    worst, most = gains.argmax(axis=1), gains.max(axis=1)
    slips = (gains > 0.0).sum(axis=1) * chdtrc(1, most)
    chances = np.minimum(chdtrc(np.maximum(equations, 1), squares), np.where(most > 0, slips, 1.0))
    sigmas = np.where(chances > _LEAST, -ndtri(chances / 2.0), np.sqrt(squares))
    return squares, sigmas, chances, worst, np.maximum(squares - most, 0.0)


def doubtful_row(fits: Fits) -> tuple[int, float] | None:
    """Return the row farthest from its prediction by all others, and by how many σ; or None.

    A fit without a row leaves it the residual (1 − Q Qᵀ)⁻¹ r, with orthonormal columns Q, and the
    covariance (1 − Q Qᵀ)⁻¹. Where no other row determines it, r is rounding, and S is bounded.
    """
    fit = fits.fits[0]
    rows, r = np.flatnonzero(fit.good), fit.last.residuals[fit.good]
    unpredicted = (1.0 + _CONFIRMED) * np.eye(r.shape[1]) - fit.Q @ fit.Q.mT
    S = np.asarray(np.linalg.inv(unpredicted), dtype=float)
    _, sigmas, chances, *_ = _row_verdicts((S @ r[:, :, None])[:, :, 0], S, fit.last, rows)
    worst = int(sigmas.argmax())  # chances may all be zero
    if chances[worst] * len(rows) >= FALSE_ALARM:
        return None
    return int(rows[worst]), float(sigmas[worst])
