"""What is to be identified from what: a calibration's arguments, as the estimators take them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pincal.identification.losses import LossName
from pincal.identification.noise import NoiseModel
from pincal.identification.residuals import LegResidual, Residual
from pincal.identification.unknowns import Unknowns, unknowns
from pincal.model.measurements import Measurements
from pincal.model.mechanism import Mechanism
from pincal.model.setup import ORIGIN, Setup

Method = Literal["per-leg", "together", "latent"]


@dataclass(frozen=True)
class Task:
    """A calibration to be done."""

    mechanism: Mechanism
    data: Measurements
    setup: Setup
    noise: NoiseModel
    fixed: tuple[str, ...]
    tied: tuple[str, ...]
    priors: Mapping[str, float]
    loss: LossName
    method: Method
    kind: Residual
    """What is minimised where poses were measured in full."""
    every_pose: bool
    """Whether every pose serves every leg, or those of its set."""
    untied: bool
    """Whether ties are left out, for the test of the same estimator without them."""
    rough: bool
    """Whether the nominal mechanism is known so roughly that nothing is checked against it."""
    hold: bool
    """Whether what the measurements do not tell is held near its nominal values."""
    tell: Callable[[str], None]
    """Called with what is being done."""

    def unknowns(self, external: Sequence[str] = ()) -> Unknowns:
        """Return the unknowns of all legs.

        Raises:
            MeasurementError: a parameter that does not exist, or is held twice.
        """
        return unknowns(
            self.mechanism.legs,
            external,
            fixed=self.fixed,
            tied=() if self.untied else self.tied,
            priors=self.priors,
        )

    @property
    def used(self) -> NDArray[np.bool_]:
        """Which row serves which leg, shape (N, n_legs)."""
        if self.method == "latent":
            told = np.isfinite(self.data.readings)
            columns = self.mechanism.reading_columns
            return np.stack([told[:, own].all(axis=1) for own in columns], axis=1)
        if self.every_pose:
            return np.ones((len(self.data), len(self.mechanism.legs)), dtype=bool)
        names = self.mechanism.leg_names
        return np.stack([self.data.serves(name) for name in names], axis=1)

    def residual(
        self, leg: int, kind: Residual = "closure", rows: NDArray[np.intp] | None = None
    ) -> LegResidual:
        """Return the residual of a leg at some rows of the measurements, all if not given."""
        mechanism = self.mechanism
        rows = np.arange(len(self.data)) if rows is None else rows
        readings = self.data.readings[rows][:, mechanism.reading_columns[leg]]
        told = np.isfinite(readings)
        usual = [
            np.median(own[one]) if one.any() else 0.0
            for own, one in zip(readings.T, told.T, strict=True)
        ]
        readings = np.where(told, readings, usual)  # not used where not measured
        return LegResidual(mechanism.legs[leg], mechanism.platform, readings, kind, rows)


def unsaid(setup: Setup) -> str:
    """Return which options that free frame and target a setup leaves out, in words."""
    options = {
        "if the base stands elsewhere in it: --unknown-frame": setup.unknown_frame,
        "if the target is not the platform's origin: --unknown-target or --setup": (
            setup.targets[ORIGIN].unknown
        ),
    }
    left = "; ".join(words for words, said in options.items() if not said)
    return f" ({left})" if left else ""
