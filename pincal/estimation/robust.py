"""Fits that outliers do not spoil, and the list of rows that did not fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import chdtrc, ndtri

from pincal.errors import ObservabilityError
from pincal.estimation.fit import Fit, Outlier, fit
from pincal.estimation.observability.identifiable import check_covariance, check_weakly_determined
from pincal.estimation.problem import Linear, Problem
from pincal.estimation.solver import solve_poses, unsolved
from pincal.estimation.system import LOSSES, Loss, System, outlying, robust_scale, suspected
from pincal.estimation.unknowns import State
from pincal.kinematics.closure import largest_size
from pincal.model.mechanism import Mechanism
from pincal.types import Mask

_LEAST = float(np.finfo(float).tiny)  # of probabilities that can be held
_ROUNDS = 10  # rounds of leaving rows out
_GOOD = 10.0  # reduced χ² up to which a fit says something about its poses
_LINEAR = 0.1  # share of the machine's size, or [rad], up to which noise acts linearly


def robust_fit(
    mechanism: Mechanism, system: System, loss: Loss | None, start: State | None = None
) -> Fit:
    """Return the fit of a problem, of least squares or under a loss, with rows that did not fit.

    The search starts at the nominal parameters if no start is given.

    Raises:
        ObservabilityError: parameters are not determined, weakly, or by the noise only; a search
            that ran away.
        MeasurementError: residuals that do not exist, or have no noise.
    """
    try:
        if loss is None:
            optimum = fit(system, start)
            scale, judged = optimum.noise_scale, _seen_scale(optimum)
        else:
            optimum, scale = _under_loss(system, loss, start)
            judged = scale
    except ObservabilityError as error:
        check_weakly_determined(mechanism, system.problem, system.unknowns, error)
        raise
    fit_is_good = optimum.chi2 <= _GOOD * max(optimum.degrees_of_freedom, 1)
    if fit_is_good or not system.known:
        check_covariance(mechanism, system.problem, optimum, optimum.covariance)
    return replace(optimum, outliers=_outliers(optimum, scale, judged, system.kept))


def _under_loss(system: System, loss: Loss, start: State | None) -> tuple[Fit, float]:
    """Return the fit under a loss, and the scale of the noise by which it rejects rows.

    From nominal parameters by Cauchy's loss, which forgets no row, then, if rows are rejected, by
    Tukey's. A start is an optimum under the same loss, at other noise: it says the scale.
    """
    problem, coarse = system.problem, None
    if start is None:
        coarse = fit(replace(system, loss=LOSSES["cauchy"]))
        linear, scale = coarse.last, coarse.scale
    else:
        linear, _ = solve_poses(problem, problem.evaluate(start))
        _, scale = replace(system, loss=loss).weights(linear)
    near = _near(problem, linear) & system.in_use(linear)
    system = replace(system, held_scale=scale, kept=near)
    if loss.name != "reject" or coarse is not None:
        fine = LOSSES["tukey"] if loss.name == "reject" else loss
        optimum = fit(replace(system, loss=fine), linear.state)
        linear = optimum.last
    if loss.name == "reject":  # least squares of the rows that fit each other, until they stay
        rows = None
        for _ in range(_ROUNDS):
            inliers = near & ~outlying(linear.squares / scale**2, linear.equations)
            if rows is not None and (inliers == rows).all():
                break
            rows, optimum = inliers, fit(replace(system, kept=inliers), linear.state)
            linear = optimum.last
    return (replace(optimum, first=coarse.first) if coarse else optimum), scale


def _seen_scale(fit: Fit) -> float:
    """Return the scale of the noise by which rows are judged: that given, or most rows' if larger.

    Where every row misses by more than the noise given explains, that noise is wrong, and no row.
    """
    share = fit.degrees_of_freedom / max(int(fit.last.equations.sum()), 1)
    if not share > 0.0:
        return fit.noise_scale
    return max(fit.noise_scale, robust_scale(fit.last.squares, fit.last.equations, share))


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


def _outliers(fit: Fit, scale: float, judged: float, counts: Mask | None) -> tuple[Outlier, ...]:
    """Return the rows that do not fit at a scale of the noise, the worst first.

    Rows in use are judged by another scale if that is larger. Rows that no fit may follow, such as
    those for verification, are judged elsewhere.
    """
    linear = fit.last
    if not (fit.converged and scale > 0.0):
        return ()
    equations = np.maximum(linear.equations, 1)
    relative = linear.squares / scale**2
    left_out = outlying(relative, equations) & (fit.weights == 0.0)
    far = np.where(linear.equations > 0, linear.squares / max(scale, judged) ** 2, 0.0)
    listed = (left_out | suspected(far, equations)) & (linear.equations > 0)
    quantities = tuple(fit.problem.quantities)
    noise = np.abs(linear.noise[:, : len(quantities)]) / scale
    worst = noise.argmax(axis=1)
    outliers = [
        Outlier(
            row=int(fit.rows[i]),
            legs=tuple(leg.name for leg in fit.problem.legs),
            sigma=as_one(float(relative[i]), int(equations[i])),
            weight=float(fit.weights[i]),
            quantity=quantities[worst[i]],
            off=float(noise[i, worst[i]]),
        )
        for i in np.flatnonzero(listed if counts is None else listed & counts)
    ]
    return tuple(sorted(outliers, key=lambda outlier: -outlier.sigma))


def as_one(squares: float, equations: int) -> float:
    """Return the size of one normal residual that is as unlikely as a χ² of several."""
    chance = chdtrc(equations, squares)
    return float(-ndtri(chance / 2) if chance > _LEAST else np.sqrt(squares))
