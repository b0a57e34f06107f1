"""Fits that outliers do not spoil, and the list of rows that did not fit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, norm

from pincal.errors import ObservabilityError, PincalError
from pincal.identification.fit import Fit, fit
from pincal.identification.latent import LatentPoses
from pincal.identification.losses import LOSSES, LossName, outlying
from pincal.identification.problem import Problem
from pincal.identification.task import Task
from pincal.identification.undetermined import check_told
from pincal.identification.unknowns import Unknowns

Array = NDArray[np.float64]
_ROUNDS = 10
_LOG_LEAST = -650.0  # of probabilities that floating point can hold


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
    why: str
    """What of it is farthest off."""


@dataclass(frozen=True)
class Robust:
    """A fit, the rows that did not fit, and the fit that they would have made."""

    fit: Fit
    rows: NDArray[np.intp]
    """Rows of the measurements that took part or were rejected."""
    outliers: tuple[Outlier, ...]
    plain: Fit | None
    """Without the loss, if there was one and the search converged."""


def robust_fit(task: Task, problem: Problem, unknowns: Unknowns, rows: NDArray[np.intp]) -> Robust:
    """Return the fit of a problem under a task's loss, and without it.

    Args:
        task: What is to be identified.
        problem: Residuals of some legs.
        unknowns: What is free.
        rows: Rows of the measurements that are the problem's poses, shape (N,).

    Raises:
        ObservabilityError: parameters are not determined, hardly, or by the noise only; a search
            that ran away.
        MeasurementError: residuals that do not exist, or have no noise.
    """
    try:
        return _fitted(task, problem, unknowns, rows)
    except ObservabilityError as error:
        if isinstance(problem, LatentPoses):
            check_told(task.mechanism, problem, unknowns, error)
        raise


def _fitted(task: Task, problem: Problem, unknowns: Unknowns, rows: NDArray[np.intp]) -> Robust:
    known = task.noise.known
    latent = isinstance(problem, LatentPoses)  # whose every failure is explained, not only this
    told = None if latent else partial(check_told, task.mechanism, problem, unknowns)
    search = partial(fit, problem, unknowns, known=known, tell=task.tell, ran_away=told)
    if task.loss == "none":
        one = search()
        scale = (
            1.0 if known else float(np.sqrt(max(one.chi2 / max(one.degrees_of_freedom, 1), 0.0)))
        )
        return Robust(one, rows, _outliers(one, scale, rows), None)
    name: LossName = "tukey" if task.loss == "reject" else task.loss
    coarse = search(loss=LOSSES["cauchy"])
    one = search(loss=LOSSES[name], start=coarse.last.state)
    scale = one.scale
    if task.loss == "reject":
        one = _without_outliers(task, problem, unknowns, one)
    try:
        plain = search()
    except PincalError:
        plain = None
    return Robust(
        replace(one, first=coarse.first),
        rows,
        _outliers(one, scale, rows),
        plain if plain is not None and plain.converged else None,
    )


def _without_outliers(task: Task, problem: Problem, unknowns: Unknowns, robust: Fit) -> Fit:
    """Return the least-squares fit of the rows that fit each other."""
    one, kept = robust, np.ones(len(robust.weights), dtype=bool)
    for _ in range(_ROUNDS):
        linear = one.last
        now = ~outlying(linear.squares / robust.scale**2, linear.equations)
        if one is not robust and (now == kept).all():
            break
        kept = now
        one = fit(
            problem,
            unknowns,
            known=task.noise.known,
            kept=kept,
            start=one.last.state,
            tell=task.tell,
        )
    return one


def _outliers(one: Fit, scale: float, rows: NDArray[np.intp]) -> tuple[Outlier, ...]:
    """Return the rows that do not fit, the worst first."""
    linear = one.last
    if not (one.converged and scale > 0.0):
        return ()
    equations = np.maximum(linear.equations, 1)
    relative = linear.squares / scale**2
    listed = np.flatnonzero(outlying(relative, equations) & (linear.equations > 0))
    legs = tuple(leg.name for leg in one.problem.legs)
    found = [
        Outlier(
            row=int(rows[i]),
            legs=legs,
            sigma=_as_one(float(relative[i]), int(equations[i])),
            weight=float(one.weights[i]),
            why=_why(one, int(i), scale),
        )
        for i in listed
    ]
    return tuple(sorted(found, key=lambda o: -o.sigma))


def _as_one(squares: float, equations: int) -> float:
    """Return the size of one normal residual that is as unlikely as a χ² of several."""
    log = float(chi2.logsf(squares, equations))
    if log > _LOG_LEAST:
        return float(norm.isf(np.exp(log) / 2))
    return float(np.sqrt(squares))


def _why(one: Fit, index: int, scale: float) -> str:
    """Return which of a row's residuals is largest, and how much."""
    values = one.last.plain[index] / scale
    worst = int(np.argmax(np.abs(values)))
    return f"{one.problem.row_names[worst]} off by {abs(values[worst]):.1f} σ"
