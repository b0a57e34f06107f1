"""How far targets are missed at held-out rows, in metres and radians, with intervals.

The calibrated machine goes where its readings take it; each target is predicted there and compared
with what was measured, measuring noise included. Rows of one pose are no more than one piece of
evidence, so intervals are by a bootstrap of poses (A. C. Davison and D. V. Hinkley 1997).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc, betaincinv, chdtri

from pincal.calibration.calibration import Calibration
from pincal.calibration.fits import Fits
from pincal.calibration.options import clusters
from pincal.design.platform_error import CONFIDENCE, DRAWS
from pincal.estimation.fit import Fit
from pincal.estimation.problem import Linear
from pincal.estimation.solver import solve_poses
from pincal.estimation.start import placed, poses_at_rest
from pincal.estimation.system import NormalEquations
from pincal.kinematics.batches import CHUNK
from pincal.kinematics.forward import forward
from pincal.model.setup import ORIGIN
from pincal.types import Array, Index


@dataclass(frozen=True)
class Missed:
    """How far one target is missed, its position or its orientation."""

    target: str
    """``"platform"``, or the name of a further target of the setup."""
    unit: str
    """``"m"`` of its position, ``"rad"`` of the measured orientation."""
    poses: int
    """Poses that were held out; rows of one pose count as one cluster."""
    fit: float
    """Root mean square at rows of the fit, [m] or [rad]."""
    mean: float
    """Mean at held-out rows."""
    rms: float
    """Root mean square at held-out rows."""
    largest: float
    """The largest; no bootstrap says how much larger another would be."""
    mean_ends: tuple[float, float]
    """Ends of the mean's 95 % interval; infinite of a single pose."""
    rms_ends: tuple[float, float]
    """Ends of the root mean square's 95 % interval."""


Misses = dict[tuple[str, str], Array]


def misses_of(calibration: Calibration, fits: Fits) -> Misses:
    """Return by how much targets are missed, by target and unit, each of shape (N,).

    NaN where a target was not measured, a reading is missing, or no pose belongs to the readings.

    Args:
        calibration: What was measured.
        fits: The fits that predict it.
    """
    observation, data = calibration.observation, calibration.measurements
    machine = calibration.mechanism.with_parameters(fits.parameters(calibration.mechanism))
    platform, setup = machine.platform, calibration.options.setup
    external = fits.external or observation.external.start
    complete = np.isfinite(data.readings).all(axis=1) & observation.measured.any(axis=1)
    rows = np.flatnonzero(complete)
    influences = None if calibration.influences is None else calibration.influences[rows]
    guess = None  # measured in another frame
    if fits.external is None or setup.plain:
        guess = np.where(np.isfinite(data.poses[rows]), data.poses[rows], platform.home)
    solution = forward(machine, data.readings[rows], guess, influences)
    rows, poses = rows[solution.converged], solution.poses[solution.converged]
    observed = observation.at(rows)
    errors = np.where(
        observed.measured, observed.residuals(platform.matrices(poses), external)[0], np.nan
    )
    names = list(observation.names)
    columns = {
        (target, "m"): [
            names.index(name)
            for axis in "xyz"
            if (name := axis if target == ORIGIN else f"{target}_{axis}") in names
        ]
        for target in setup.targets
    }
    turns = zip(platform.freedoms, platform.units, strict=True)
    columns[ORIGIN, "rad"] = [names.index(name) for name, unit in turns if unit == "rad"]
    found_: Misses = {}
    for key, column in columns.items():
        known = np.isfinite(errors[:, column]).any(axis=1)
        if known.any():
            values = np.full(len(data), np.nan)
            values[rows[known]] = np.sqrt(np.nansum(errors[known][:, column] ** 2, axis=1))
            found_[key] = values
    return found_


def per_row(misses: Misses, count: int) -> Array:
    """Return sizes of misses of position [m], of all targets, and orientation [rad], (N, 2)."""
    sizes = np.full((count, 2), np.nan)
    for column, unit in enumerate(("m", "rad")):
        of_unit = [values for (_, own_unit), values in misses.items() if own_unit == unit]
        if of_unit:
            known = np.isfinite(of_unit)
            squares = np.where(known, np.square(of_unit), 0.0).sum(axis=0)
            times = known.sum(axis=0)
            sizes[times > 0, column] = np.sqrt(squares[times > 0] / times[times > 0])
    return sizes


def missed(fitted: Misses, unseen: Sequence[tuple[Calibration, Misses]]) -> tuple[Missed, ...]:
    """Return how far targets are missed, each over all rows held out.

    Args:
        fitted: Misses at rows of the fit.
        unseen: Of each fold, its rows and misses there.
    """
    answers = []
    for (target, unit), fitted_values in fitted.items():
        parts = [one[target, unit] for _, one in unseen if (target, unit) in one]
        places = [
            place
            for data, one in unseen
            if (target, unit) in one
            for place in clusters(data.measurements)
        ]
        if not parts:
            continue
        values = np.concatenate(parts)
        known = np.isfinite(values)
        values, poses_of_rows = values[known], np.array(places)[known]
        mean_ends, rms_ends, poses = _ends(values, poses_of_rows)
        answers.append(
            Missed(
                target=target,
                unit=unit,
                poses=poses,
                fit=float(np.sqrt(np.nanmean(fitted_values**2))),
                mean=float(values.mean()),
                rms=float(np.sqrt((values**2).mean())),
                largest=float(values.max()),
                mean_ends=mean_ends,
                rms_ends=rms_ends,
            )
        )
    return tuple(answers)


def _ends(
    values: Array, places: NDArray[np.str_]
) -> tuple[tuple[float, float], tuple[float, float], int]:
    """Return ends of the intervals of mean and root mean square, and the number of poses.

    Args:
        values: Misses, shape (N,).
        places: Name of each row's pose, shape (N,).
    """
    _, cluster = np.unique(places, return_inverse=True)
    counts = np.bincount(cluster).astype(float)
    sums = np.stack([np.bincount(cluster, weights=w) for w in (values, values**2)])
    poses = len(counts)
    if poses < 2:
        return (0.0, np.inf), (0.0, np.inf), poses
    random, every = np.random.default_rng(0), np.vstack((sums, counts))
    drawn = [
        every @ _times(random.integers(poses, size=(len(some), poses))).T
        for some in np.array_split(np.empty(DRAWS), min(DRAWS, 1 + DRAWS * poses // CHUNK))
    ]
    own, number = np.split(np.concatenate(drawn, axis=1), [2])
    means = (own / number).T
    low, high = np.quantile(means, (0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2), axis=0)
    return (
        (float(low[0]), float(high[0])),
        (float(np.sqrt(low[1])), float(np.sqrt(high[1]))),
        poses,
    )


def _times(drawn: Index) -> Array:
    """Return how often each of n poses was drawn, by draws of n: shape (draws, n) both."""
    draws, n = drawn.shape
    places = drawn + n * np.arange(draws)[:, None]
    return np.bincount(places.ravel(), minlength=draws * n).reshape(draws, n).astype(float)


@dataclass(frozen=True)
class Predicted:
    """Residuals of a fit at rows that it has not seen."""

    statistic: float
    """Σ rᵀ (1 + J C Jᵀ)⁻¹ r."""
    squares: float
    """Σ rᵀ r."""
    unknown: float
    """Σ tr(J C Jᵀ): growth of the squares by what the fit does not know."""
    equations: int

    @classmethod
    def of(cls, one: Fit, linear: Linear) -> Predicted:
        """Return how a fit does at rows, noise of unit variance."""
        scale = one.noise_scale**2
        J, r = linear.jacobian, linear.residuals
        spread = J @ (one.covariance / scale) @ J.transpose(0, 2, 1)
        weighed = np.linalg.solve(np.eye(J.shape[1]) + spread, r[:, :, None])[:, :, 0]
        return cls(
            float((r * weighed).sum()),
            float((r**2).sum()),
            float(np.einsum("nkk->", spread)),
            int(linear.equations.sum()),
        )


def predictions(fits_of_all: Fits, unseen: Calibration) -> list[tuple[Fit, Linear]]:
    """Return fits with their residuals and derivatives at rows that they have not seen."""
    fits = fits_of_all.fits
    if fits_of_all.latent:
        (one,) = fits
        problem = unseen.latent_problem
        external = one.last.state.external
        state = placed(problem, unseen.measurements, one.parameters, external)
        linear = problem.evaluate(poses_at_rest(problem, state))
        return [(one, solve_poses(problem, linear)[0])]
    names = list(unseen.mechanism.leg_names)
    measured_poses = unseen.given_poses(fits_of_all.external)
    pairs = []
    for one in fits:
        group = [names.index(leg.name) for leg in one.problem.legs]
        problem, _ = unseen.measured_problem(group, *measured_poses)
        pairs.append((one, problem.evaluate(problem.start(one.parameters))))
    return pairs


_RANK = 1e-10  # least share of a direction in a fold


def least_of_folds(least: float, fits: Sequence[Fit], groups: Index, *, known: bool) -> float:
    """Return the probability that the least of all folds' probabilities is so small, or smaller.

    By draws from what the model would make of noise; where none is as small, what independent folds
    would give (Šidák 1967) if that is less.

    Args:
        least: The least probability of a fold.
        fits: Of all rows.
        groups: The fold of each row of the measurements, shape (N,); below 0 in none.
        known: Whether the scale of the noise is known, else folds are compared with the others.
    """
    count = int(groups.max()) + 1
    bound = float(bdtrc(0, count, least))
    if count < 2 or (groups < 0).any():
        return bound
    random = np.random.default_rng(0)
    parts = [_drawn(fit, groups[fit.rows], count, random) for fit in fits]
    inside, own, equations = (np.sum(one, axis=0) for one in zip(*parts, strict=True))
    dof = sum(fit.degrees_of_freedom for fit in fits)
    if known:
        unlikely = inside >= chdtri(equations, least)
    else:  # of a share x of all, or more: the chance that 1 − x follows a beta distribution
        rest = own.sum(axis=1, keepdims=True) - inside
        share = betaincinv(0.5 * (dof - equations), 0.5 * equations, least)
        unlikely = (rest > 0.0) & (inside * share >= rest * (1.0 - share))
    below = int(unlikely.any(axis=1).sum())
    return (1 + below) / (1 + DRAWS) if below else min(bound, 1 / (1 + DRAWS))


def _drawn(
    fit: Fit, folds: Index, count: int, random: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Return drawn statistics and squared residuals of folds, (draws, count), their equations."""
    used = fit.weights > 0.0
    J = np.where(used[:, None, None], fit.last.jacobian @ fit.unknowns.map, 0.0)
    _, prior = fit.unknowns.prior_rows(fit.parameters)
    normal = NormalEquations.of(fit.system.triangle(fit.last, used.astype(float), white=True))
    Q = normal.orthonormal(J).transpose(0, 2, 1)
    roots, equations = [], []  # draws need no more than single precision
    for fold in range(count):
        part = Q[folds == fold]
        share, V = np.linalg.eigh(np.einsum("nim,njm->ij", part, part))
        has = share > _RANK
        root = np.sqrt(share[has])[:, None] * V[:, has].T
        roots.append((root.astype(np.float32), (1.0 - share[has]).astype(np.float32)))
        equations.append(int(fit.last.equations[folds == fold][used[folds == fold]].sum()))
    drawn = [random.standard_normal((DRAWS, len(left)), np.float32) for _, left in roots]
    taken = sum(u @ root for u, (root, _) in zip(drawn, roots, strict=True))
    if len(prior):
        held = normal.orthonormal(prior).astype(np.float32)
        taken = taken + random.standard_normal((DRAWS, len(prior)), np.float32) @ held
    inside, squared = np.empty((DRAWS, count)), np.empty((DRAWS, count))
    for fold, (u, (root, left)) in enumerate(zip(drawn, roots, strict=True)):
        squares = np.square(u - taken @ root.T)
        rest = random.chisquare(max(equations[fold] - len(left), 1e-9), DRAWS)
        inside[:, fold] = squares @ (1.0 / np.maximum(left, _RANK)) + rest
        squared[:, fold] = squares.sum(axis=1) + rest
    return inside, squared, np.array(equations, dtype=float)
