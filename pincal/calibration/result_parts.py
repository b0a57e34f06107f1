"""Parts of a result: parameters; residuals of legs and measured quantities; held-out errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pincal.finding import Finding
from pincal.model.parameter import Parameter
from pincal.types import Array, Index
from pincal.words.numbers import SMALL, measured, shown_in

HELD = "held nearest to nominal"
CONTROLLED = 1e-3
"""Redundancy up to which a residual is what the fit made of it, whatever the noise."""


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean())) if len(values) else np.nan


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
    """What was given of it: ``"fixed"``, ``"tied"``, ``"prior"``, or several; or that it is
    ``"held nearest to nominal"``, since the measurements do not determine it."""

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
class ResidualGroup:
    """Residuals of one leg, with its parameters, or of one measured quantity of the platform.

    Of a leg they are closures at measured poses; at estimated ones, predicted less measured.
    """

    name: str
    """Of the leg, or of the quantity."""
    quantity: str
    """What residuals are of: ``"closure"`` or ``"reading"`` of a leg, or the measured quantity."""
    unit: str
    """Of the residuals: m of closures, that of what was measured otherwise."""
    rows: Index
    """Rows of the measurements used, shape (n,)."""
    sigma: Array
    """Standard deviations of the noise, shape (n,)."""
    residuals_before: Array
    """Residuals where the search started, shape (n,)."""
    residuals: Array
    """Residuals with identified parameters, predicted less measured, shape (n,)."""
    redundancy: Array
    """Variance of each residual over that of its noise, 1 − h of its leverage h, shape (n,)."""
    parameters: tuple[IdentifiedParameter, ...] = ()
    """Of the leg."""
    rank: int = 0
    """Of the leg's whitened identification Jacobian."""
    condition: float = np.nan
    """Of the same, columns scaled to unit length."""

    def __repr__(self) -> str:
        before, after = (shown_in(rms, self.unit) for rms in (self.rms_before, self.rms_after))
        of_leg = f"{len(self.parameters)} parameters, rank {self.rank}, " * bool(self.parameters)
        return (
            f"ResidualGroup({self.name!r}, {of_leg}{self.quantity} residuals {before:.3g} → "
            f"{after:.3g} {SMALL[self.unit]})"
        )

    @property
    def identified(self) -> Array:
        """Identified values, shape (n_params,)."""
        return np.array([p.identified for p in self.parameters])

    @property
    def std(self) -> Array:
        """Standard errors, shape (n_params,)."""
        return np.array([p.std for p in self.parameters])

    @property
    def n_residuals(self) -> int:
        """Number of residuals."""
        return len(self.residuals)

    @property
    def rms_before(self) -> float:
        """Root mean square residual where the search started."""
        return _rms(self.residuals_before)

    @property
    def rms_after(self) -> float:
        """Root mean square residual with identified parameters."""
        return _rms(self.residuals)

    @property
    def rms_noise(self) -> float:
        """Root mean square standard deviation of the noise."""
        return _rms(self.sigma)

    @property
    def standardised(self) -> Array:
        """Residuals over their standard deviations σ√(1−h), NaN where nothing checks one."""
        spread = self.sigma * np.sqrt(self.redundancy)
        checked = (self.redundancy > CONTROLLED) & (self.sigma > 0.0)
        return np.where(checked, self.residuals, np.nan) / np.where(checked, spread, 1.0)


KINDS = ("verification", "held-out")
"""What rows are called that are held out: those that the user reserves, and those of folds."""


@dataclass(frozen=True)
class Missed:
    """How far one target is missed, its position or its orientation."""

    target: str
    """``"platform"``, or the name of a further target, or of a contact, of the setup."""
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
    rms_ends: tuple[float, float]
    """Ends of the root mean square's 95 % interval, by a bootstrap of poses; infinite of one."""
    limit: float = np.inf
    """Below which the root mean square is at 95 %, if noise and model are right."""


@dataclass(frozen=True, repr=False)
class Validation:
    """Errors at rows that a fit has seen, and at held-out rows."""

    folds: int
    rows: int
    """Rows that were held out, each once."""
    fit: float
    """Root mean square residual of the fit in standard deviations of the noise."""
    held_out: float
    """The same at held-out rows."""
    expected: float
    """Of held-out rows, by the fit's own residuals and what the fits did not know."""
    p_value: float
    """Probability of such a growth, or a larger one, if the model is right."""
    findings: tuple[Finding, ...]
    """That held-out rows miss by more than is expected, if they do."""
    sigma: Array
    """Standard deviations of a normal number as unlikely as each held-out row, (N,); else NaN."""
    targets: tuple[Missed, ...]
    """How far each measured target is missed at held-out rows."""

    @property
    def kind(self) -> str:
        """``"held-out"`` of rows that folds leave out, ``"verification"`` of those reserved."""
        return KINDS[self.folds > 1]

    @property
    def position(self) -> tuple[float, float] | None:
        """Root mean square by which positions of targets are missed, [m], in fit and held out."""
        return self.missed.get("m")

    @property
    def orientation(self) -> tuple[float, float] | None:
        """The same of the measured orientation, [rad]."""
        return self.missed.get("rad")

    @property
    def missed(self) -> dict[str, tuple[float, float]]:
        """Both by their units: those of what was measured."""
        missed = {}
        for unit in dict.fromkeys(part.unit for part in self.targets):
            squares = [(part.fit**2, part.rms**2) for part in self.targets if part.unit == unit]
            fit, held_out = np.sqrt(np.mean(squares, axis=0)).tolist()
            missed[unit] = fit, held_out
        return missed

    def __repr__(self) -> str:
        return (
            f"Validation({self.folds} folds of {self.rows} rows, fit {self.fit:.2f} σ, held-out "
            f"{self.held_out:.2f} σ, expected {self.expected:.2f} σ)"
        )
