"""Repeated calibrations of simulated machines, and the bound that no estimator passes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Literal, TypeAlias

import numpy as np
from numpy.random import SeedSequence, default_rng
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares

import pincal

from .study import Study

Array = NDArray[np.float64]
Protocol: TypeAlias = Literal["independent", "common", "symmetric", "orbits"]
Method: TypeAlias = Literal["per-leg", "all-legs"]
_LITTLE = 1e-6  # of the noise: rows of one pose differ, as measured ones do


@dataclass(frozen=True)
class Way:
    """A way to calibrate: which poses, and how they are used."""

    name: str
    plan: pincal.Plan
    poses: Literal["own", "all"] = "own"
    method: Method = "per-leg"
    residual: Literal["joint", "closure"] = "joint"

    def run(
        self,
        mechanism: pincal.Mechanism,
        truth: pincal.Mechanism,
        noise: pincal.Noise,
        seed: SeedSequence,
    ) -> tuple[pincal.Mechanism, bool]:
        """Return what a true mechanism, measured with noise, is identified as; if it converged."""
        data = pincal.simulate(mechanism, truth, self.plan, noise, default_rng(seed)).measurements
        if self.residual == "joint":
            return least_squares_of_readings(mechanism, data, self.poses)
        result = pincal.calibrate(
            mechanism, data, method=self.method, poses=self.poses, noise=noise
        )
        return result.identified, result.converged

    def bound(
        self,
        mechanism: pincal.Mechanism,
        truth: pincal.Mechanism,
        noise: pincal.Noise,
        method: Method = "all-legs",
    ) -> Array:
        """Return the Cramér-Rao bound of the parameters, a covariance, shape (n, n).

        Of the poses that each leg uses, where the true mechanism goes when the nominal one
        commands them. Together, it is the bound of the data; leg by leg, of estimators that do
        not see the noise which legs share.
        """
        little = pincal.Noise(*(_LITTLE * sigma for sigma in vars(noise).values()))
        exact = pincal.simulate(mechanism, truth, self.plan, little, 0).measurements
        return pincal.calibrate(
            truth, exact, method=method, poses=self.poses, noise=noise
        ).covariance


def least_squares_of_readings(
    mechanism: pincal.Mechanism, data: pincal.Measurements, poses: Literal["own", "all"]
) -> tuple[pincal.Mechanism, bool]:
    """Return the mechanism of the papers' least squares, and whether they converged.

    Of readings predicted at measured poses less measured ones, not weighted, leg by leg (3-RRR
    paper, Eq. 24), by poses of a leg's own set or all.
    """
    every = np.ones(len(data), dtype=bool)
    ends = {
        name: _least_squares(mechanism, data, name, data.serves(name) if poses == "own" else every)
        for name in mechanism.leg_names
    }
    identified = mechanism.with_parameters({name: end.x for name, end in ends.items()})
    return identified, all(end.success for end in ends.values())


def _least_squares(
    mechanism: pincal.Mechanism, data: pincal.Measurements, name: str, rows: NDArray[np.bool_]
) -> OptimizeResult:
    """Return the end of least squares of the readings of one leg at some rows."""
    place = mechanism.leg_names.index(name)
    poses, readings = data.poses[rows], data.readings[rows, place]
    alone = replace(mechanism, legs=(mechanism.legs[place],))

    def missed(values: Array) -> Array:
        tried = alone.with_parameters({name: values})
        return pincal.inverse(tried, poses).readings[:, 0] - readings

    def slopes(values: Array) -> Array:
        return pincal.identification_jacobian(alone, name, poses, values)

    start, tight = mechanism.legs[place].nominal, {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}
    return least_squares(missed, start, slopes, method="lm", x_scale="jac", **tight)


def trial_seeds(seed: int, count: int) -> list[tuple[SeedSequence, SeedSequence]]:
    """Return, for each trial, independent seeds of the machine and of the noise."""
    trials = SeedSequence(seed).spawn(count)
    return [tuple(trial.spawn(2)) for trial in trials]  # type: ignore[misc]


def machines(
    mechanism: pincal.Mechanism, sigma: float, seed: int, count: int
) -> list[tuple[pincal.Mechanism, SeedSequence]]:
    """Return true mechanisms, parameters disturbed by sigma, each with the seed of its noise."""
    return [
        (pincal.disturb(mechanism, sigma, default_rng(machine)), noise)
        for machine, noise in trial_seeds(seed, count)
    ]


#: Rows by readings alone, all of equal weight: the papers' criterion to the letter.
UNWEIGHTED = pincal.Noise(position=0.0, orientation=0.0, reading=1e-4)


def choose(
    study: Study,
    candidates: Array,
    choices: Mapping[str, tuple[Protocol, int]],
    noise: pincal.Noise,
) -> tuple[dict[str, pincal.Selection], dict[str, float]]:
    """Return selections by name, and the time that each took, [s].

    Args:
        study: Its mechanism, seed and, if quick, few starts.
        candidates: Poses to choose from, coordinates of shape (M, dof).
        choices: Protocol and count, by name; a name that ends in "unweighted" looks at O₁ of the
            papers, rows not weighted.
        noise: Of the measurements to come.
    """
    selections: dict[str, pincal.Selection] = {}
    seconds: dict[str, float] = {}
    starts = 2 if study.quick else 20
    for name, (protocol, count) in choices.items():
        begin = perf_counter()
        selections[name] = pincal.select_poses(
            study.mechanism,
            candidates,
            count,
            protocol,
            noise=UNWEIGHTED if name.endswith("unweighted") else noise,
            seed=study.seed,
            starts=starts,
        )
        seconds[name] = perf_counter() - begin
    return selections, seconds


def values(mechanism: pincal.Mechanism) -> Array:
    """Return the parameters of all legs in order, shape (n,)."""
    return np.concatenate([leg.nominal for leg in mechanism.legs])


def position_errors(model: pincal.Mechanism, truth: pincal.Mechanism, poses: Array) -> Array:
    """Return how far from poses, that a planar model commands, the true one goes, shape (N,), [m].

    NaN where either does not reach them.
    """
    commanded = pincal.inverse(model, poses)
    errors = np.full(len(poses), np.nan)
    able = np.flatnonzero(commanded.reached.all(axis=1))
    there = pincal.forward(truth, commanded.readings[able], poses[able])
    able, found = able[there.converged], there.poses[there.converged]
    errors[able] = np.linalg.norm(found[:, :2] - poses[able, :2], axis=1)
    return errors


def platform_rms(
    model: pincal.Mechanism, truth: pincal.Mechanism, poses: Array
) -> tuple[float, float]:
    """Return the root mean square errors in position [m] and orientation [rad] over poses."""
    found = pincal.accuracy(model, truth, poses)
    return found.position, found.orientation


def root_mean_square(errors: Array) -> tuple[float, float]:
    """Return the root mean square over draws and columns, and its standard error.

    Args:
        errors: Shape (n_draws, n); draws are independent, columns need not be.
    """
    squares = (errors**2).mean(axis=1)
    mean = float(np.sqrt(squares.mean()))
    spread = float(squares.std(ddof=1) / np.sqrt(len(squares))) if len(squares) > 1 else 0.0
    return mean, spread / (2 * mean) if mean else 0.0


def medians(first: Array, second: Array) -> str:
    """Return the ratio of the medians of two ways' errors, of independent draws.

    Args:
        first: Errors of a first way by draw, shape (n,).
        second: Errors of a second way, shape (m,).
    """
    return f"{float(np.median(second) / np.median(first)):.2f} times as large by medians"


def compared(first: tuple[float, float], second: tuple[float, float], draws: int) -> str:
    """Return in a phrase whether a first mean is smaller than a second, by standard errors."""
    apart = (second[0] - first[0]) / np.hypot(first[1], second[1])
    if abs(apart) < 2.0:
        return f"not clearly different over {draws} draws ({apart:+.1f} standard errors)"
    return f"{'smaller' if apart > 0 else 'larger'} by {abs(apart):.1f} standard errors"


def paired(first: Array, second: Array) -> tuple[str, str]:
    """Return the mean ratio of paired errors with its 95 % half width, and which is better.

    Args:
        first: Errors of a first way by machine, shape (n,).
        second: Errors of a second way for the same machines, shape (n,).
    """
    logs = np.log(second / first)
    half = 1.96 * float(logs.std(ddof=1)) / np.sqrt(len(logs))
    ratio = float(np.exp(logs.mean()))
    times = f"{ratio:.2f} ± {ratio * half:.2f} times as large"
    times += f" ({float(np.median(second) / np.median(first)):.2f} by medians)"
    if abs(logs.mean()) <= half:
        return times, f"not clearly different over {len(logs)} machines"
    return times, "better" if logs.mean() > 0 else "worse"
