"""Parts of a result: parameters; residuals of legs and measured quantities; held-out errors."""

from dataclasses import dataclass

import numpy as np

from pincal.finding import Finding
from pincal.model import Parameter
from pincal.types import Array, Index
from pincal.words.numbers import SMALL, measured, shown_in

HELD = "held nearest to nominal"
CONTROLLED = 1e-3
"""Redundancy number up to which a residual says nothing about the noise."""


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean())) if len(values) else np.nan


@dataclass(frozen=True)
class IdentifiedParameter(Parameter):
    """A parameter: nominal and identified value, with standard error and interval."""

    identified: float
    """Identified value, SI."""
    std: float
    """Standard error; infinite if the measurements do not determine the value."""
    low: float
    """Lower end of the 95 % confidence interval; infinite without one."""
    high: float
    """Upper end of the 95 % confidence interval; infinite without one."""
    given: str = ""
    """``"fixed"``, ``"tied"``, ``"prior"`` or several of them as given; or ``"held nearest to
    nominal"`` if the measurements do not determine the value."""

    @property
    def change(self) -> float:
        """Identified minus nominal value."""
        return self.identified - self.nominal

    @property
    def half(self) -> float:
        """Half the width of the 95 % interval."""
        return (self.high - self.low) / 2

    @property
    def text(self) -> str:
        """Identified value ± half its 95 % interval, in a readable unit."""
        return measured(self.identified, self.half, self.unit)

    def __str__(self) -> str:
        """Return a line such as ``leg_1.l: 1501.4 ± 0.8 mm (95 %), …``."""
        known = self.high > self.low and np.isfinite(self.std)
        sure = " (95 %)" if known else f", {self.given or 'held'}"
        nominal = measured(self.nominal, 0.0, self.unit)
        return f"{self.id}: {self.text}{sure}, nominal {nominal}"


@dataclass(frozen=True, repr=False)
class ResidualGroup:
    """Residuals of one leg, with its parameters, or of one measured quantity of the platform.

    Residuals of a leg are closures at measured poses, or predicted minus measured readings at
    estimated poses.
    """

    name: str
    """Name of the leg or quantity."""
    quantity: str
    """``"closure"`` or ``"reading"`` for a leg, else the measured quantity."""
    unit: str
    """Unit of the residuals: m for closures, else that of the measured quantity."""
    rows: Index
    """Indices of the measured rows that were used, shape (n,)."""
    sigma: Array
    """Standard deviations of the noise, shape (n,)."""
    residuals_before: Array
    """Residuals where the search started, shape (n,)."""
    residuals: Array
    """Residuals with identified parameters, predicted minus measured, shape (n,)."""
    redundancy: Array
    """Redundancy numbers 1 − h with leverages h: variances over those of the noise, shape (n,)."""
    parameters: tuple[IdentifiedParameter, ...] = ()
    """Parameters of the leg."""
    rank: int = 0
    """Rank of the leg's whitened identification Jacobian."""
    condition: float = np.nan
    """Condition number of that Jacobian with columns of unit length."""

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
        """Residuals over their standard deviations σ√(1−h), NaN where nothing checks them."""
        spread = self.sigma * np.sqrt(self.redundancy)
        checked = (self.redundancy > CONTROLLED) & (self.sigma > 0.0)
        return np.where(checked, self.residuals, np.nan) / np.where(checked, spread, 1.0)


KINDS = ("verification", "held-out")
"""Kinds of held-out rows: reserved by the user, and left out by folds."""


@dataclass(frozen=True)
class Missed:
    """Errors of the predicted position, or orientation, of a target."""

    target: str
    """``"platform"``, or the name of a further target or of a contact in the setup."""
    unit: str
    """``"m"`` for a position, ``"rad"`` for the measured orientation."""
    poses: int
    """Number of held-out poses; rows of one pose count as one cluster."""
    fit: float
    """Root mean square at rows of the fit, [m] or [rad]."""
    mean: float
    """Mean at held-out rows."""
    rms: float
    """Root mean square at held-out rows."""
    largest: float
    """Largest error at held-out rows."""
    limit: float
    """95 % limit of the root mean square if noise and model are right."""


@dataclass(frozen=True, repr=False)
class Validation:
    """Errors at rows that a fit has seen, and at held-out rows."""

    folds: int
    rows: int
    """Number of rows that were held out."""
    fit: float
    """Root mean square residual of the fit in standard deviations of the noise."""
    held_out: float
    """The same at held-out rows."""
    expected: float
    """Expected value at held-out rows, by the fit's residuals and the parameters' uncertainty."""
    p_value: float
    """Probability of such an excess or a larger one if the model is right."""
    findings: tuple[Finding, ...]
    """A finding that held-out rows are worse than expected, if they are."""
    sigma: Array
    """Size of a normal residual as unlikely as each held-out row, (N,); NaN for other rows."""
    targets: tuple[Missed, ...]
    """Errors of each measured target at held-out rows."""

    @property
    def kind(self) -> str:
        """``"held-out"`` for rows left out by folds, ``"verification"`` for reserved rows."""
        return KINDS[self.folds > 1]

    @property
    def position(self) -> tuple[float, float] | None:
        """Root mean square position errors of targets, [m], in the fit and held out."""
        return self.missed.get("m")

    @property
    def orientation(self) -> tuple[float, float] | None:
        """Root mean square orientation errors, [rad], in the fit and held out."""
        return self.missed.get("rad")

    @property
    def missed(self) -> dict[str, tuple[float, float]]:
        """Both pairs by unit, for what was measured."""
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
