"""Which terms pay: models compared on rows that they have not seen, the simplest of the best kept.

Models are nested: the machine as drawn, its geometry identified, and one kind of term more each
time, the one that the screen of the residuals names first. Rows of one pose are held out together.
The simplest model within one standard error of the best is taken (L. Breiman et al., Classification
and Regression Trees, 1984): a term that does not pay is not kept, however probable it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pincal.calibration.calibration import Calibration
from pincal.calibration.checks.folds import FOLDS, folds_of
from pincal.calibration.checks.unseen import misfit, predictions
from pincal.calibration.fits import Fits, fitted
from pincal.calibration.terms.candidates import ORDER, Kind, with_terms
from pincal.calibration.terms.screen import Candidate, screen
from pincal.design.platform_error import root_mean_squares, sizes
from pincal.errors import PincalError

Array = NDArray[np.float64]
LEVEL = 0.01
"""Probability by chance, of all tests of a screen, below which a term is tried."""
_MOST = 8  # terms one after the other
_PINNED = 1e-12  # [m], [rad] or [1]: how well a parameter that is as drawn is known


@dataclass(frozen=True)
class Model:
    """One of the models compared."""

    name: str
    """``"as drawn"``, ``"geometry"``, or what was added last."""
    added: tuple[tuple[str, Kind], ...]
    """All terms that it has beyond the mechanism given: reading and kind."""
    parameters: int
    """Free parameters."""
    held_out: float
    """Root mean square of white residuals of held-out rows, [σ of the noise]."""
    spread: float
    """Standard error of how much larger that is than the best model's, poses as clusters, [σ]."""
    position: float
    """Root mean square misfit of the platform's position at held-out rows, [m]; NaN where poses
    were not measured in full."""
    orientation: float
    """The same of its orientation, [rad]."""
    bic: float
    """Schwarz's criterion of all rows, χ² + k ln n, at the noise of the geometry's fit."""


@dataclass(frozen=True)
class Choice:
    """Models compared, and the one to take."""

    models: tuple[Model, ...]
    """In the order of their size."""
    chosen: int
    """Index of the simplest within one standard error of the best."""
    candidates: tuple[Candidate, ...]
    """The screen of the geometry's residuals."""
    calibration: Calibration
    """Of the model that was chosen; of the geometry, if the machine as drawn was."""

    @property
    def model(self) -> Model:
        """The model that was chosen."""
        return self.models[self.chosen]


@dataclass(frozen=True)
class _Tried:
    name: str
    added: tuple[tuple[str, Kind], ...]
    squares: Array
    """Squared white residuals of each row, held out, shape (N,)."""
    misses: tuple[float, float]
    """Root mean square misfit of position and orientation, held out; NaN where not measured."""
    parameters: int
    chi2: float


def choose(calibration: Calibration, kinds: Sequence[Kind], folds: int = FOLDS) -> Choice:
    """Return which terms of sensors pay, of some kinds.

    Args:
        calibration: Of the mechanism, its measurements looked at (see ``started``).
        kinds: What sensors may lack.
        folds: How many times a share of the poses is held out.

    Raises:
        PincalError: the geometry itself cannot be identified.
    """
    found = fitted(calibration)
    first = found.calibration.at_this_noise()
    groups = folds_of(calibration.measurements, folds, "turn")
    ids = [one.id for one in calibration.mechanism.parameters]
    drawn = first.with_options(priors=dict.fromkeys(ids, _PINNED))
    tried = [
        _tried("as drawn", (), drawn, fitted(drawn), groups),
        _tried("geometry", (), first, found, groups),
    ]
    screened = candidates = screen(found, kinds)
    added: tuple[tuple[str, Kind], ...] = ()
    calibrations = [first, first]
    for _ in range(_MOST):
        likely = [one for one in screened if one.corrected < LEVEL and one.kind.name != ORDER]
        if not likely:
            break
        best = likely[0]
        added = (*added, (best.reading, best.kind))
        mechanism, _ = with_terms(calibration.mechanism, calibration.measurements, added)
        more = replace(first, mechanism=mechanism, start=None)
        try:
            found = fitted(more)
            one = _tried(f"{best.reading}: {best.kind}", added, more, found, groups)
        except PincalError:  # what the rows left in a fold do not determine
            break
        tried.append(one)
        calibrations.append(more)
        screened = screen(found, kinds)
    models, chosen = _compared(tried, calibration.measurements.places)
    return Choice(models, chosen, tuple(candidates), calibrations[chosen])


def _tried(
    name: str,
    added: tuple[tuple[str, Kind], ...],
    calibration: Calibration,
    found: Fits,
    groups: NDArray[np.intp],
) -> _Tried:
    """Return how a model does at rows held out."""
    count = len(calibration.measurements)
    squares, twists = np.full(count, np.nan), np.full(calibration.measurements.poses.shape, np.nan)
    for fold in range(int(groups.max()) + 1):
        out = np.flatnonzero(groups == fold)
        seen = fitted(calibration.rows(groups != fold).at_this_noise())
        unseen = calibration.rows(out)
        squares[out] = _squares(seen, unseen)
        twists[out] = misfit(unseen, seen)
    unknowns = [robust.fit.unknowns for robust in found.fits]
    free = sum(one.map.shape[1] - int(np.isfinite(one.priors).sum()) for one in unknowns)
    chi2 = float(sum(robust.fit.chi2 for robust in found.fits))
    size = sizes(calibration.mechanism.platform.units, twists)
    return _Tried(name, added, squares, root_mean_squares(size), free, chi2)


def _squares(seen: Fits, unseen: Calibration) -> Array:
    """Return squared white residuals at rows that fits have not seen, shape (N,)."""
    total = np.zeros(len(unseen.measurements))
    for one, linear in predictions(seen, unseen):
        rows = unseen.used[:, [unseen.mechanism.leg_names.index(x.name) for x in one.problem.legs]]
        total[np.flatnonzero(rows.any(axis=1))] += linear.squares
    return total


def _compared(
    tried: Sequence[_Tried], places: tuple[str, ...] | None
) -> tuple[tuple[Model, ...], int]:
    """Return models, and the index of the simplest within one standard error of the best."""
    squares = np.array([one.squares for one in tried])
    known = np.isfinite(squares).all(axis=0)
    names = np.array(places if places is not None else [""] * squares.shape[1])
    alone = names == ""
    names = np.where(alone, np.arange(len(names)).astype(str), names)
    _, cluster = np.unique(names[known], return_inverse=True)
    sums = np.stack([np.bincount(cluster, weights=one[known]) for one in squares])
    means = sums.sum(axis=1) / known.sum()
    best = int(np.argmin(means))
    more = sums - sums[best]
    spread = more.std(axis=1, ddof=1) * np.sqrt(sums.shape[1]) / known.sum()
    chosen = int(np.flatnonzero(means - means[best] <= spread)[0])
    models = tuple(
        Model(
            name=one.name,
            added=one.added,
            parameters=one.parameters,
            held_out=float(np.sqrt(mean)),
            spread=float(wide / (2.0 * np.sqrt(mean))) if mean else 0.0,
            position=one.misses[0],
            orientation=one.misses[1],
            bic=float(one.chi2 + one.parameters * np.log(known.sum())),
        )
        for one, mean, wide in zip(tried, means, spread, strict=True)
    )
    return models, chosen
