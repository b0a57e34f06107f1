"""Parts of a result: one parameter, one leg, one measured quantity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pincal.model.parameter import Parameter
from pincal.types import Array, Index
from pincal.words.numbers import SMALL, measured, shown_in

HELD = "held nearest to nominal"


@dataclass(frozen=True)
class IdentifiedParameter(Parameter):
    """One parameter: nominal and identified value, and how sure the latter is."""

    identified: float
    """Identified value, SI."""
    std: float
    """Standard error; infinite where the measurements do not determine the value."""
    low: float
    """Lower end of the 95 % confidence interval; infinite if it has none."""
    high: float
    """Upper end of the 95 % confidence interval; infinite if it has none."""
    given: str = ""
    """What was given of it beforehand: ``"fixed"``, ``"tied"``, ``"prior"``, or several; or that
    it is ``"held nearest to nominal"``, since the measurements do not determine it."""

    @property
    def change(self) -> float:
        """Identified less nominal value."""
        return self.identified - self.nominal

    @property
    def half(self) -> float:
        """Half the width of the 95 % interval."""
        return (self.high - self.low) / 2

    @property
    def text(self) -> str:
        """Identified value ± half its 95 % interval, in the unit in which people read it."""
        return measured(self.identified, self.half, self.unit)

    def __str__(self) -> str:
        """Return what is known of it, in a line: ``leg_1.l: 1501.4 ± 0.8 mm (95 %), …``."""
        known = self.high > self.low and np.isfinite(self.std)
        sure = " (95 %)" if known else f", {self.given or 'held'}"
        nominal = measured(self.nominal, 0.0, self.unit)
        return f"{self.id}: {self.text}{sure}, nominal {nominal}"


@dataclass(frozen=True, repr=False)
class LegResult:
    """Calibration of one leg."""

    name: str
    parameters: tuple[IdentifiedParameter, ...]
    rank: int
    condition: float
    """Of the leg's whitened identification Jacobian, columns scaled to unit length."""
    rms_before: float
    """Root mean square residual with nominal parameters: closure or joint at measured poses, or
    predicted less measured reading at those that were estimated."""
    rms_after: float
    """Root mean square residual with identified parameters."""
    unit: str
    """Of the residuals: m of closures, that of the reading otherwise."""
    n_residuals: int
    sigma: Array
    """Modelled standard deviation of each residual used, shape (n_residuals,)."""
    rows: Index
    """Rows of the measurements used, shape (n_residuals,)."""
    residuals_before: Array
    """Residuals with nominal parameters, shape (n_residuals,)."""
    residuals: Array
    """Residuals with identified parameters, shape (n_residuals,)."""
    quantity: str = "closure"
    """What residuals are of: ``"closure"``, or ``"reading"``."""
    redundancy: Array | None = None
    """Variance of each residual over that of its noise, 1 − h of its leverage h: what the fit does
    not take up, shape (n_residuals,). None of results saved by version 0.2.0 and before."""

    def __repr__(self) -> str:
        return (
            f"LegResult({self.name!r}, {len(self.parameters)} parameters, rank {self.rank}, "
            f"{self.quantity} residuals {self._fell})"
        )

    def __str__(self) -> str:
        lines = [
            f"{self.name}: {self.quantity} residuals {self._fell} (root mean square), "
            f"{self.n_residuals} from {self.n_poses} poses",
            f"rank {self.rank} of {len(self.parameters)}, condition {self.condition:.3g}",
        ]
        return "\n".join([*lines, *(f"  {p.id}  {p.text}" for p in self.parameters)])

    @property
    def _fell(self) -> str:
        before, after = (shown_in(rms, self.unit) for rms in (self.rms_before, self.rms_after))
        return f"{before:.3g} → {after:.3g} {SMALL[self.unit]}"

    @property
    def n_poses(self) -> int:
        """Number of poses that served the leg."""
        return len(np.unique(self.rows))

    @property
    def identified(self) -> Array:
        """Identified values, shape (n_params,)."""
        return np.array([p.identified for p in self.parameters])

    @property
    def std(self) -> Array:
        """Standard errors, shape (n_params,)."""
        return np.array([p.std for p in self.parameters])


@dataclass(frozen=True)
class Observed:
    """How a measured quantity of the platform fits."""

    name: str
    unit: str
    count: int
    """How often it was measured."""
    rms: float
    """Root mean square of predicted less measured."""
    sigma: float
    """Root mean square standard deviation of the measurements."""
    rows: Index
    """Rows of the measurements, shape (count,)."""
    sigmas: Array
    """Standard deviations of the measurements, shape (count,)."""
    residuals_before: Array
    """Predicted less measured where the search started, shape (count,)."""
    residuals: Array
    """Predicted less measured, shape (count,)."""
    redundancy: Array | None = None
    """As of a leg's residuals, shape (count,)."""
