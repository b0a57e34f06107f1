"""Repeated calibrations of simulated machines, and the bound that no estimator passes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Literal

import numpy as np
from matplotlib.figure import Figure
from numpy.random import SeedSequence
from numpy.typing import NDArray

from pincal.design.select import Protocol, Selection, select_poses
from pincal.design.simulate import accuracy, disturb, simulate
from pincal.identification.calibrate import calibrate
from pincal.identification.residuals import Residual
from pincal.identification.result import CalibrationResult
from pincal.identification.task import Method
from pincal.model.measurements import Noise, Plan
from pincal.model.mechanism import Mechanism
from pincal.show.style import COLOURS

Array = NDArray[np.float64]
_LITTLE = 1e-6  # of the noise: rows of one pose differ, as measured ones do


@dataclass(frozen=True)
class Way:
    """A way to calibrate: which poses, and how they are used."""

    name: str
    plan: Plan
    poses: Literal["own", "all"] = "own"
    method: Method = "per-leg"
    residual: Residual = "joint"

    def run(
        self, mechanism: Mechanism, truth: Mechanism, noise: Noise, seed: SeedSequence
    ) -> CalibrationResult:
        """Return the calibration of a true mechanism, measured with noise."""
        rng = np.random.default_rng(seed)
        data = simulate(mechanism, truth, self.plan, noise, rng).measurements
        return calibrate(
            mechanism,
            data,
            method=self.method,
            residual=self.residual,
            poses=self.poses,
            noise=noise,
        )

    def bound(
        self,
        mechanism: Mechanism,
        truth: Mechanism,
        noise: Noise,
        method: Method = "together",
    ) -> Array:
        """Return the Cramér-Rao bound of the parameters, a covariance, shape (n, n).

        Of the poses that each leg uses, where the true mechanism goes when the nominal one
        commands them. Together, it is the bound of the data; leg by leg, of estimators that do
        not see the noise which legs share.
        """
        little = Noise(*(_LITTLE * sigma for sigma in vars(noise).values()))
        exact = simulate(mechanism, truth, self.plan, little, 0).measurements
        return calibrate(truth, exact, method=method, poses=self.poses, noise=noise).covariance


def trial_seeds(seed: int, count: int) -> list[tuple[SeedSequence, SeedSequence]]:
    """Return, for each trial, independent seeds of the machine and of the noise."""
    trials = SeedSequence(seed).spawn(count)
    return [tuple(trial.spawn(2)) for trial in trials]  # type: ignore[misc]


def machines(
    mechanism: Mechanism, sigma: float, seed: int, count: int
) -> list[tuple[Mechanism, SeedSequence]]:
    """Return true mechanisms, parameters disturbed by sigma, each with the seed of its noise."""
    return [
        (disturb(mechanism, sigma, np.random.default_rng(machine)), noise)
        for machine, noise in trial_seeds(seed, count)
    ]


def compared(first: tuple[float, float], second: tuple[float, float], draws: int) -> str:
    """Return in words whether a first mean is smaller than a second, by their standard errors."""
    apart = (second[0] - first[0]) / np.hypot(first[1], second[1])
    if abs(apart) < 2.0:
        return f"not told apart by {draws} draws ({apart:+.1f} standard errors)"
    return f"{'smaller' if apart > 0 else 'larger'} by {abs(apart):.1f} standard errors"


def paired(first: Array, second: Array) -> tuple[float, float, str]:
    """Return the mean ratio of paired errors, its 95 % half width, and which is better in words.

    Args:
        first: Errors of a first way by machine, shape (n,).
        second: Errors of a second way for the same machines, shape (n,).
    """
    logs = np.log(second / first)
    half = 1.96 * float(logs.std(ddof=1)) / np.sqrt(len(logs))
    ratio = float(np.exp(logs.mean()))
    if abs(logs.mean()) <= half:
        return ratio, ratio * half, f"not told apart by {len(logs)} machines"
    return ratio, ratio * half, "better" if logs.mean() > 0 else "worse"


def values(mechanism: Mechanism) -> Array:
    """Return the parameters of all legs in order, shape (n,)."""
    return np.concatenate([leg.nominal for leg in mechanism.legs])


def parameter_errors(
    way: Way, mechanism: Mechanism, truth: Mechanism, noise: Noise, seeds: Sequence[SeedSequence]
) -> tuple[Array, list[Mechanism]]:
    """Return identified less true parameters, shape (n_seeds, n), and the identified ones."""
    found = [way.run(mechanism, truth, noise, seed).identified for seed in seeds]
    return np.stack([values(one) for one in found]) - values(truth), found


def choose(
    mechanism: Mechanism,
    candidates: Array,
    choices: Mapping[str, tuple[Protocol, int]],
    noise: Noise,
    seed: int,
    quick: bool = False,
) -> tuple[dict[str, Selection], dict[str, float]]:
    """Return selections by name, and the time that each took, [s].

    Args:
        mechanism: The mechanism.
        candidates: Poses to choose from, coordinates of shape (M, dof).
        choices: Protocol and count, by name.
        noise: Of the measurements to come.
        seed: Of the random starts.
        quick: Try few starts.
    """
    selections: dict[str, Selection] = {}
    seconds: dict[str, float] = {}
    for name, (protocol, count) in choices.items():
        begin = perf_counter()
        selections[name] = select_poses(
            mechanism,
            candidates,
            count,
            protocol,
            noise=noise,
            seed=seed,
            starts=2 if quick else 20,
        )
        seconds[name] = perf_counter() - begin
    return selections, seconds


def platform_rms(model: Mechanism, truth: Mechanism, poses: Array) -> tuple[float, float]:
    """Return the root mean square errors in position [m] and orientation [rad] over poses."""
    found = accuracy(model, truth, poses)
    return found.position, found.orientation


def times_figure(seconds: Mapping[str, float], title: str = "") -> Figure:
    """Return bars of times, [s]."""
    figure = Figure(figsize=(9, 0.34 * len(seconds) + 1), layout="constrained")
    axes = figure.subplots()
    bars = axes.barh(list(seconds), list(seconds.values()), color=COLOURS[0])
    axes.bar_label(bars, [f" {time:.3g} s" for time in seconds.values()], fontsize=8)
    axes.set_xscale("log")
    axes.invert_yaxis()
    axes.margins(x=0.15)
    axes.set_xlabel("time on the machine that drew this [s]")
    axes.set_title(title, fontsize=10)
    return figure


def root_mean_square(errors: Array) -> tuple[float, float]:
    """Return the root mean square over draws and columns, and its standard error.

    Args:
        errors: Shape (n_draws, n); draws are independent, columns need not be.
    """
    squares = (errors**2).mean(axis=1)
    mean = float(np.sqrt(squares.mean()))
    spread = float(squares.std(ddof=1) / np.sqrt(len(squares))) if len(squares) > 1 else 0.0
    return mean, spread / (2 * mean) if mean else 0.0
