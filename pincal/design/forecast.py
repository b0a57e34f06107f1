"""What measurements will give before they are made: rank, standard errors, platform error.

With all legs together the covariance is the inverse of the information that the best estimator
draws (see ``information``): the Cramér-Rao bound. Each leg alone takes no notice of what the legs
have in common, the pose, measured once, and poses that were chosen for other legs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, get_args

import numpy as np
from numpy.typing import NDArray

from pincal.blas import on_one_thread
from pincal.design.estimable import (
    Estimable,
    Method,
    all_legs,
    apart_from_frames,
    check_whole,
    each_leg,
)
from pincal.design.information import information_rows, parameter_ids
from pincal.design.platform_error import PlatformError, platform_error
from pincal.errors import MeasurementError
from pincal.estimation.observability.drawings import nearest_to_nominal
from pincal.estimation.observability.indices import NEGLIGIBLE
from pincal.estimation.observability.weak import WeakPair, weak_pairs
from pincal.files.given import as_noise, as_setup
from pincal.files.given_mechanism import GivenMechanism, as_mechanism
from pincal.kinematics.configurations import as_plan, check_reached, legs_at
from pincal.model.measuring.measurements import Noise, Plan
from pincal.model.measuring.setup import Setup
from pincal.model.mechanism import Mechanism
from pincal.model.overview import ROWS
from pincal.words.numbers import amount

if TYPE_CHECKING:
    from pandas import DataFrame

Array = NDArray[np.float64]


@dataclass(frozen=True, repr=False, eq=False)
class Forecast(Estimable):
    """What a plan of measurements will give: rank, standard errors, error of the platform.

    The covariance is the Cramér-Rao bound with ``"all-legs"``, that of each leg's own rows with
    ``"per-leg"``. Directions ``lost`` are less those that only move frames.
    """

    mechanism: Mechanism
    method: Method
    """All legs together, or each leg alone by the poses of its set."""
    poses: int
    """Number of poses that all legs reach."""
    gauge: Array
    """Directions that only move frames that are not measured, columns of shape (n, n_gauge):
    parameters are those nearest to the nominal ones."""
    frames: Array
    """Motions of frames that these are (see ``frames_moved``), shape (k, n_moved)."""
    when: Array
    """Part of the run at which each pose is measured, from -0.5 to 0.5, shape (N,)."""

    @cached_property
    def std(self) -> Array:
        """Standard error of each parameter, shape (n,); infinite where it is not determined."""
        blurred = np.abs(self.lost).max(axis=1, initial=0.0) > NEGLIGIBLE
        return np.where(blurred, np.inf, np.sqrt(np.diagonal(self.covariance)))

    @cached_property
    def weak(self) -> tuple[WeakPair, ...]:
        """Pairs of parameters that are weakly determined, the weakest first."""
        determined = np.isfinite(self.std)
        clear = np.outer(determined, determined)
        return weak_pairs(
            parameter_ids(self.mechanism), np.where(clear, self.covariance, 0.0), self.gauge
        )

    def platform_error(self, poses: Plan | Array) -> PlatformError:
        """Return the error to expect of the calibrated platform over poses, shape (N, dof).

        Where frames are not measured, less what a motion of the frames explains.
        """
        return platform_error(self.mechanism, self.covariance, poses, self.lost, self.frames)

    def poses_for(self, accuracy: float, poses: Plan | Array) -> float:
        """Return how many poses like the planned ones bring the position error to a value.

        Errors fall with the root of the number of poses. Infinite if no number does.

        Args:
            accuracy: Wanted root mean square position error over ``poses``, [m].
            poses: Where the platform is to be accurate, shape (N, dof).

        Raises:
            MeasurementError: an accuracy that is not positive.
        """
        if not accuracy > 0.0:
            raise MeasurementError(f"the wanted accuracy is {accuracy:g} m; expected more than 0")
        now = self.platform_error(poses).position
        return float(max(self.least, np.ceil(self.poses * (now / accuracy) ** 2)))

    def to_dataframe(self) -> DataFrame:
        """Return a row for each parameter: unit, nominal value and standard error, SI units."""
        import pandas as pd  # optional

        legs = self.mechanism.legs
        return pd.DataFrame(
            {
                "unit": [leg.units[name] for leg in legs for name in leg.parameter_names],
                "nominal": np.concatenate([leg.nominal for leg in legs]),
                "std": self.std,
            },
            index=pd.Index(parameter_ids(self.mechanism), name="parameter"),
        )

    def _repr_html_(self) -> str:
        """Return the standard errors to expect for notebooks."""
        from pincal.show.notebook import forecast_html

        return forecast_html(self)

    def __repr__(self) -> str:
        rank = f"rank {self.rank.rank} of {self.rank.n_params}"
        name = self.mechanism.name
        return f"Forecast({name!r}, {self.method}, {self.poses} poses, {rank})"

    def __str__(self) -> str:
        legs = self.mechanism.legs
        units = [leg.units[name] for leg in legs for name in leg.parameter_names]
        rows = [
            f"  {name:<24} {amount(std, unit, 4)}"
            if std < np.inf
            else f"  {name:<24} not determined"
            for name, std, unit in zip(parameter_ids(self.mechanism), self.std, units, strict=True)
        ]
        if more := len(rows) - ROWS:
            rows[ROWS:] = [f"  and {more} more (to_dataframe)"] if more > 0 else []
        words = [] if self.rank.complete else [f"not determined apart: {self.rank.describe()}"]
        return "\n".join([repr(self), "standard errors (1 σ):", *rows, *words])


@on_one_thread
def forecast(
    mechanism: GivenMechanism,
    poses: Plan | Array,
    noise: Noise | None = None,
    measured: Sequence[str] | None = None,
    setup: Setup | None = None,
    method: Method = "all-legs",
) -> Forecast:
    """Return what measurements at poses will say of the parameters of all legs.

    Args:
        mechanism: The mechanism, at its nominal parameters.
        poses: Poses to measure, coordinates of shape (N, dof), or a plan; all sensors are read.
        noise: Standard deviations of what is measured.
        measured: Freedoms of the platform that are measured (see ``Platform.freedoms``; axes of
            the measurements' frame) and columns of the setup; all if not given.
        setup: What measured numbers will mean: unknown frame, targets, distances.
        method: ``"all-legs"``: every row for every leg, as the best estimator does.
            ``"per-leg"``: each leg alone, by the poses of its set, measured in full in the base
            frame.

    Raises:
        MeasurementError: unknown freedoms, measurements without any noise, or no pose in reach;
            with ``"per-leg"`` poses that are not measured in full, or do not determine readings.
        MechanismError: poses of a wrong shape, or not finite.
    """
    mechanism = as_mechanism(mechanism)
    noise, setup = as_noise(noise), as_setup(setup)
    if not isinstance(method, str) or method not in get_args(Method):
        raise MeasurementError(f"no method {method!r}; expected {' or '.join(get_args(Method))}")
    every = as_plan(mechanism, poses)
    plan = every.rows(~every.verifying)  # no fit follows the others
    legs = legs_at(mechanism, plan)
    when = np.linspace(-0.5, 0.5, len(every))[~every.verifying][legs.reached]
    if not len(legs.poses):
        check_reached(mechanism, plan)
    if method == "per-leg":
        check_whole(mechanism, measured, setup)
        found = each_leg(mechanism, plan, legs.reached, noise)
    else:
        found = all_legs(legs, information_rows(mechanism, legs, noise, measured, setup))
    gauge, lost, frames = apart_from_frames(mechanism, legs, found.lost)
    P = nearest_to_nominal(mechanism, gauge)
    return Forecast(
        **vars(found)
        | {
            "lost": lost,
            "covariance": P @ found.covariance @ P.T,
            "influence": P @ found.influence,
        },
        mechanism=mechanism,
        method=method,
        poses=len(legs.poses),
        gauge=gauge,
        frames=frames,
        when=when,
    )
