"""What an estimator hands over: fits of groups of legs, and what surrounds them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.estimation.external import External, ExternalUnknowns
from pincal.identification.gauge import Gauge
from pincal.identification.latent import LatentPoses
from pincal.identification.robust import Robust
from pincal.identification.undetermined import Held
from pincal.identification.unknowns import Unknowns
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Estimate:
    """Fits that together identify all legs."""

    fits: list[Robust]
    outside: ExternalUnknowns | None = None
    """Unknowns outside the mechanism, if poses were not given in the base frame."""
    external: External | None = None
    """Their values."""
    gauge: Gauge | None = None
    """Gauge freedoms."""
    unknowns: Unknowns | None = None
    """Of legs and what is outside, of which the gauge speaks."""
    latent: LatentPoses | None = None
    """The problem, if poses were latent."""
    held: Held | None = None
    """What the measurements do not tell, if that was held."""

    def parameters(self, mechanism: Mechanism) -> dict[str, Array]:
        """Return identified parameters by leg, each of shape (n_params,)."""
        found = {
            leg.name: one.fit.parameters[columns]
            for one in self.fits
            for leg, columns in zip(one.fit.problem.legs, one.fit.problem.columns, strict=True)
        }
        return {name: found[name] for name in mechanism.leg_names}
