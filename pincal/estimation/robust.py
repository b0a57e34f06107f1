"""Fits that outliers do not spoil, and the list of rows that did not fit."""

from dataclasses import replace

import numpy as np
from scipy.special import chdtrc, ndtri

from pincal.errors import ObservabilityError
from pincal.estimation.fit import Fit, Outlier, easier_start, fit
from pincal.estimation.observability.identifiable import DIFFER, check_rank, plausible_changes
from pincal.estimation.problem import Linear
from pincal.estimation.solver import search, solve_poses, unsolved
from pincal.estimation.system import System, outlying, robust_scale, suspected
from pincal.model import ROW, Mechanism
from pincal.types import Mask
from pincal.words.numbers import listed
from pincal.words.wording import NAMED

_LEAST = float(np.finfo(float).tiny)  # smallest probability that a float can hold
_ROUNDS = 10  # largest number of rounds of leaving rows out
_GOOD = 10.0  # reduced χ² up to which a fit says something about its poses
_LINEAR = 0.1  # share of the machine's size, or [rad], up to which noise acts linearly


def robust_fit(system: System, begin: Linear, *, near: bool = False) -> Fit:
    """Return the fit of a problem and its outliers, which a ``robust`` system leaves out.

    The search begins at nominal parameters, or near the optimum.
    """
    if system.robust:
        optimum, scale = _fit_rejecting(system, begin, near=near)
        judged = scale
    else:
        optimum = fit(system, begin, near=near)
        scale = judged = optimum.noise_scale
        squares, equations = optimum.last.squares, optimum.last.equations
        share = optimum.degrees_of_freedom / max(int(equations.sum()), 1)
        if share > 0.0:  # where every row misses by more, the noise given is wrong, and no row
            judged = max(scale, robust_scale(squares, equations, share))
    return replace(optimum, outliers=_outliers(optimum, scale, judged, system.kept))


def _fit_rejecting(system: System, begin: Linear, *, near: bool) -> tuple[Fit, float]:
    """Return the least-squares fit of the rows that fit each other, and the scale of the noise.

    From nominal parameters a search by Cauchy's loss, which gives every row some weight, comes
    first. Near an optimum the conditions there give the scale.
    """
    problem, squares_only = system.problem, replace(system, robust=False)
    linear = first = solve_poses(begin)
    if not near:
        check_rank(problem, system.unknowns, first)
        linear = search(system, easier_start(system, begin, first)).last
    scale = system.scale(linear.squares)
    # Rows whose pose was not found, or whose noise moves the machine by a large part of its size,
    # have meaningless derivatives, and no loss bounds their influence.
    moved = (linear.white.noise @ linear.noise[:, :, None])[:, :, 0]
    largest = {"m": _LINEAR * problem.size, "rad": _LINEAR}
    sound = (np.abs(moved) <= [largest.get(unit, np.inf) for unit in problem.units]).all(axis=1)
    sound &= system.kept & ~unsolved(linear)
    rows = None
    for _ in range(_ROUNDS):
        inliers = sound & ~outlying(linear.squares / scale**2, linear.equations)
        if rows is not None and (inliers == rows).all():
            break
        rows = inliers
        optimum = fit(replace(squares_only, kept=inliers), linear, near=True)
        linear = optimum.last
    return replace(optimum, first=first), scale


def check_covariance(mechanism: Mechanism, optimum: Fit) -> Fit:
    """Return the fit; raise if its search ran away, or if its parameters are arbitrary.

    A search ran away where noise moves parameters farther than machines differ from their drawing.
    Parameters are arbitrary if they moved so far, and two standard errors are longer than the
    machine, or more than a radian: no linear covariance holds that far.
    """
    if optimum.system.known and optimum.chi2 > _GOOD * max(optimum.degrees_of_freedom, 1):
        return optimum
    legs = optimum.problem.legs
    limit = plausible_changes(mechanism, legs)
    std = np.sqrt(np.diagonal(optimum.covariance))[: len(limit)]
    nominal = np.concatenate([leg.nominal for leg in legs])
    moved, far = np.abs(optimum.parameters - nominal) > limit, std > limit
    if not ((moved & (2.0 * std > limit / DIFFER)).any() if optimum.converged else far.any()):
        return optimum
    ids = np.array([name for leg in legs for name in leg.parameter_ids])[far].tolist()
    single, hidden = len(ids) == 1, len(ids) - NAMED
    named = listed([*ids[:NAMED], f"{hidden} more parameters"] if hidden > 1 else ids)
    them = "it" if single else "them"
    raise ObservabilityError(
        f"{named} {'is' if single else 'are'} weakly determined by the measured poses: noise moves "
        f"{them} farther than machines differ from their drawings. Measure poses that differ more "
        f"(in orientation above all), hold {them} as near to nominal as can be "
        "(leave out --strict), or say how well nominal values are known (--priors)"
    )


def _outliers(fit: Fit, scale: float, judged: float, counted: Mask) -> tuple[Outlier, ...]:
    """Return the rows that do not fit at a scale of the noise, the worst first.

    Rows in use are judged by the larger of ``scale`` and ``judged``. Rows that do not count, such
    as verification rows, are judged elsewhere.
    """
    linear = fit.last
    if not (fit.converged and scale > 0.0):
        return ()
    equations = np.maximum(linear.equations, 1)
    relative = linear.squares / scale**2
    left_out = outlying(relative, equations) & ~fit.good
    far = np.where(linear.equations > 0, linear.squares / max(scale, judged) ** 2, 0.0)
    listed_rows = (left_out | suspected(far, equations)) & (linear.equations > 0) & counted
    worst = {int(i): most_off(linear, int(i)) for i in np.flatnonzero(listed_rows)}
    outliers = [
        Outlier(
            row=int(fit.rows[i]),
            legs=tuple(leg.name for leg in fit.problem.legs),
            sigma=as_one(float(relative[i]), int(equations[i])),
            weight=float(fit.good[i]),
            quantity=quantity,
            off=sigma / scale,
        )
        for i, (sigma, quantity) in worst.items()
    ]
    return tuple(sorted(outliers, key=lambda outlier: -outlier.sigma))


def most_off(linear: Linear, row: int) -> tuple[float, str]:
    """Return by how much a row's worst quantity is off, in standard deviations, and its name.

    The place of a row itself, which follows distances measured from it, does not count.
    """
    noise = zip(np.abs(linear.noise[row]).tolist(), linear.problem.quantities, strict=False)
    sigma, name = max(pair for pair in noise if not pair[1].startswith(f"measured {ROW}_"))
    return sigma, linear.problem.observation.named(name, row)


def as_one(squares: float, equations: int) -> float:
    """Return the size of a single normal residual that is as unlikely as a χ² of several."""
    chance = chdtrc(equations, squares)
    return float(-ndtri(chance / 2) if chance > _LEAST else np.sqrt(squares))
