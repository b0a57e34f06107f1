"""Fits that outliers do not spoil, and the list of rows that did not fit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.special import chdtrc, ndtri

from pincal.errors import ObservabilityError, PincalError
from pincal.estimation.fit import Fit, fit, without
from pincal.estimation.linear import Linear, State
from pincal.estimation.observability.identifiable import check_covariance, check_weakly_determined
from pincal.estimation.problem import Problem
from pincal.estimation.residuals.losses import LOSSES, Loss, outlying, robust_scale, suspected
from pincal.estimation.solver import unsolved
from pincal.estimation.system import System
from pincal.kinematics.closure import largest_size
from pincal.model.mechanism import Mechanism
from pincal.types import Index, Mask

_LEAST = float(np.finfo(float).tiny)  # of probabilities that can be held
Progress = Callable[[str], None]

_ROUNDS = 10  # rounds of leaving rows out
_EVALUATIONS = 200  # evaluations of the fit without a loss, of which only the shift is said
_GOOD = 10.0  # reduced χ² up to which a fit says something about its poses
_LINEAR = 0.1  # share of the machine's size, or [rad], up to which noise acts linearly


@dataclass(frozen=True)
class Outlier:
    """A row of the measurements that does not fit the others."""

    row: int
    """Counted from 0."""
    legs: tuple[str, ...]
    """Legs in whose fit it does not fit."""
    sigma: float
    """Its residual in standard deviations: that of one residual as unlikely as its χ²."""
    weight: float
    """With which it took part, from 1 down to 0: rejected."""
    quantity: str
    """Which of its residuals is largest."""
    off: float
    """That residual in standard deviations."""


@dataclass(frozen=True)
class Robust:
    """A fit, the rows that did not fit, and the fit that they would have made."""

    fit: Fit
    rows: Index
    """Rows of the measurements that took part or were rejected."""
    outliers: tuple[Outlier, ...]
    without_loss: Fit | None
    """The fit without the loss, if there was one and the search converged."""

    @property
    def shift(self) -> float | None:
        """By how many standard errors a parameter would move without the loss, at most."""
        if self.without_loss is None:
            return None
        n = len(self.fit.parameters)
        std = np.sqrt(np.diagonal(self.fit.covariance))[:n]
        moved = np.abs(self.without_loss.parameters - self.fit.parameters)
        return float((moved[std > 0.0] / std[std > 0.0]).max(initial=0.0))


def robust_fit(
    mechanism: Mechanism,
    system: System,
    rows: Index,
    loss: Loss | None,
    start: State | None = None,
    progress: Progress | None = None,
) -> Robust:
    """Return the fit of a problem under a loss, and without it.

    Args:
        mechanism: The nominal mechanism.
        system: What is minimised, without a loss.
        rows: Rows of the measurements that are the problem's poses, shape (N,).
        loss: A robust loss, or none.
        start: Where the search starts; the nominal parameters if not given.
        progress: Called with what is being done.

    Raises:
        ObservabilityError: parameters are not determined, weakly, or by the noise only; a search
            that ran away.
        MeasurementError: residuals that do not exist, or have no noise.
    """
    try:
        robust = _fitted(system, rows, loss, partial(fit, start=start, progress=progress))
    except ObservabilityError as error:
        check_weakly_determined(mechanism, system.problem, system.unknowns, error)
        raise
    fit_is_good = robust.fit.chi2 <= _GOOD * max(robust.fit.degrees_of_freedom, 1)
    if fit_is_good or not system.known:
        failed_fit = robust.fit
        check_covariance(
            mechanism,
            failed_fit.problem,
            failed_fit.parameters,
            failed_fit.covariance,
            converged=failed_fit.converged,
        )
    return robust


def _fitted(system: System, rows: Index, loss: Loss | None, search: Callable[..., Fit]) -> Robust:
    if loss is None:
        optimum = search(system)
        outliers = _outliers(optimum, optimum.noise_scale, rows, system.kept, _seen_scale(optimum))
        return Robust(optimum, rows, outliers, None)
    rejecting = loss.name == "reject"
    coarse = search(replace(system, loss=LOSSES["cauchy"]))
    fine = LOSSES["tukey"] if rejecting else loss
    near = _near(system.problem, coarse.last)
    near = near if system.kept is None else near & system.kept
    fine_system = replace(system, loss=fine, held_scale=coarse.scale, kept=near)
    optimum = search(fine_system, start=coarse.last.state)
    scale = optimum.scale
    if rejecting:
        optimum = _without_outliers(optimum, search)
    try:
        plain = search(system, start=optimum.last.state, max_evaluations=_EVALUATIONS)
    except (PincalError, np.linalg.LinAlgError):
        plain = None
    return Robust(
        replace(optimum, first=coarse.first, costs=coarse.costs),
        rows,
        _outliers(optimum, scale, rows, system.kept),
        plain if plain is not None and plain.converged else None,
    )


def _seen_scale(fit: Fit) -> float:
    """Return the scale of the noise by which rows are judged: that given, or most rows' if larger.

    Where every row misses by more than the noise given explains, that noise is wrong, and no row.
    """
    linear = fit.last
    share = fit.degrees_of_freedom / max(int(linear.equations.sum()), 1)
    scale = robust_scale(linear.squares, linear.equations, share) if share > 0.0 else 0.0
    return max(fit.noise_scale, scale)


def _near(problem: Problem, linear: Linear) -> Mask:
    """Return which rows are near enough for their noise to act linearly, shape (N,).

    Of the others a pose was not found, or what explains them moves the machine by a good part of
    its size; neither has derivatives that say anything, and no loss bounds what they weigh.
    """
    moved = (linear.white.noise @ linear.noise[:, :, None])[:, :, 0]
    far = {"m": _LINEAR * largest_size(problem.legs), "rad": _LINEAR}
    observed_units = problem.observation.units if problem.latent else ()
    units = [*["m"] * problem.leg_block.n_rows, *observed_units]
    near = np.abs(moved) <= [far.get(unit, np.inf) for unit in units]
    return ~unsolved(problem, linear) & near.all(axis=1)


def _without_outliers(robust: Fit, search: Callable[..., Fit]) -> Fit:
    """Return the least-squares fit of the rows that fit each other."""
    current, rows = robust, np.ones(len(robust.weights), dtype=bool)
    counts = rows if robust.system.kept is None else robust.system.kept
    for _ in range(_ROUNDS):
        linear = current.last
        inliers = counts & ~outlying(linear.squares / robust.scale**2, linear.equations)
        if current is not robust and (inliers == rows).all():
            break
        rows = inliers
        current = search(without(robust.system, rows), start=current.last.state)
    return current


def _outliers(
    fit: Fit, scale: float, rows: Index, counts: Mask | None, judged: float = 0.0
) -> tuple[Outlier, ...]:
    """Return the rows that do not fit, the worst first.

    Args:
        fit: The fit.
        scale: Of the noise.
        rows: Rows of the measurements.
        counts: Which of them a fit may follow, shape (N,); all if not given. Others, such as those
            for verification, are judged elsewhere.
        judged: Scale by which rows in use are judged, if larger.
    """
    linear = fit.last
    if not (fit.converged and scale > 0.0):
        return ()
    equations = np.maximum(linear.equations, 1)
    relative = linear.squares / scale**2
    left_out = outlying(relative, equations) & (fit.weights == 0.0)
    far = np.where(linear.equations > 0, linear.squares / max(scale, judged) ** 2, 0.0)
    listed = (left_out | suspected(far, equations)) & (linear.equations > 0)
    listed = np.flatnonzero(listed if counts is None else listed & counts)
    legs = tuple(leg.name for leg in fit.problem.legs)
    noise = np.abs(linear.noise[:, : len(fit.problem.quantities)]) / scale
    worst = noise.argmax(axis=1)
    outliers = [
        Outlier(
            row=int(rows[i]),
            legs=legs,
            sigma=_as_one(float(relative[i]), int(equations[i])),
            weight=float(fit.weights[i]),
            quantity=tuple(fit.problem.quantities)[worst[i]],
            off=float(noise[i, worst[i]]),
        )
        for i in listed
    ]
    return tuple(sorted(outliers, key=lambda o: -o.sigma))


def _as_one(squares: float, equations: int) -> float:
    """Return the size of one normal residual that is as unlikely as a χ² of several."""
    chance = chdtrc(equations, squares)
    return float(-ndtri(chance / 2) if chance > _LEAST else np.sqrt(squares))
