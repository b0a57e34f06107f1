"""What an estimator hands over: fits of groups of legs, and what surrounds them."""

from __future__ import annotations

from dataclasses import dataclass

from pincal.experiment.external import External, ExternalUnknowns
from pincal.identification.latent import LatentPoses
from pincal.identification.robust import Robust


@dataclass(frozen=True)
class Estimate:
    """Fits that together identify all legs."""

    fits: list[Robust]
    outside: ExternalUnknowns | None = None
    """Unknowns outside the mechanism, if poses were not given in the base frame."""
    external: External | None = None
    """Their values."""
    gauge: tuple[str, ...] = ()
    """Gauge freedoms in words."""
    latent: LatentPoses | None = None
    """The problem, if poses were latent."""
