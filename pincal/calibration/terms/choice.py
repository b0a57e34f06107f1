"""Which terms pay: models compared on rows that they have not seen, the simplest of the best kept.

Models are nested: the machine as drawn, its geometry identified, and one kind of term more each
time, the one that the screen of the residuals names first. Each fold goes this way by the rows that
it sees, so that the choice itself is held out (M. Stone 1974); rows of one pose are together.
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
from pincal.calibration.terms.candidates import ORDER, Kind, with_influences, with_terms
from pincal.calibration.terms.screen import Candidate, screen
from pincal.design.platform_error import root_mean_squares, sizes
from pincal.errors import PincalError

Array = NDArray[np.float64]
LEVEL = 0.01
"""Probability by chance, of all tests of a screen, below which a term is tried."""
_MOST = 8  # terms one after the other
_NAMES = ("as drawn", "geometry")
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


def choose(calibration: Calibration, kinds: Sequence[Kind], folds: int = FOLDS) -> Choice:
    """Return which terms of sensors pay, of some kinds.

    Args:
        calibration: Of the mechanism, its measurements looked at (see ``started``).
        kinds: What sensors may lack.
        folds: How many times a share of the poses is held out.

    Raises:
        PincalError: the geometry itself cannot be identified.
    """
    data = with_influences(calibration.mechanism, calibration.measurements, kinds)
    calibration = replace(calibration, measurements=data)
    found = fitted(calibration)
    first = found.calibration.at_this_noise()
    screened = screen(found, kinds)
    path = [_Step((), first, found), *_path(first, screened, kinds)]
    drawn = first.with_options(
        priors=dict.fromkeys((one.id for one in calibration.mechanism.parameters), _PINNED)
    )
    tried = [_Step((), drawn, fitted(drawn)), *path]
    groups = folds_of(calibration.measurements, folds, "turn")
    count = len(calibration.measurements)
    squares = np.full((len(tried), count), np.nan)
    twists = np.full((len(tried), *calibration.measurements.poses.shape), np.nan)
    for fold in range(int(groups.max()) + 1):
        first.options.report(f"models on held-out rows, fold {fold + 1} of {groups.max() + 1}")
        rows, out = groups != fold, np.flatnonzero(groups == fold)
        geometry = first.rows(rows).at_this_noise()
        at = fitted(geometry)
        own = [_Step((), geometry, at), *_path(geometry, screen(at, kinds), kinds, len(path) - 1)]
        pinned = drawn.rows(rows).at_this_noise()
        steps = [_Step((), pinned, fitted(pinned)), *own]
        for place in range(len(tried)):
            one = steps[min(place, len(steps) - 1)]  # a path that ended stays where it is
            unseen = replace(first.rows(out), mechanism=one.calibration.mechanism)
            squares[place, out] = _squares(one.found, unseen)
            twists[place, out] = misfit(unseen, one.found)
    models, chosen = _compared(tried, squares, twists, calibration.measurements.places)
    return Choice(models, chosen, tuple(screened), tried[max(chosen, 1)].calibration)


@dataclass(frozen=True)
class _Step:
    """A model and its fit."""

    added: tuple[tuple[str, Kind], ...]
    calibration: Calibration
    found: Fits

    @property
    def parameters(self) -> int:
        """Free parameters: not those that are as drawn."""
        unknowns = [robust.fit.unknowns for robust in self.found.fits]
        return sum(one.map.shape[1] - int(np.isfinite(one.priors).sum()) for one in unknowns)

    @property
    def chi2(self) -> float:
        return float(sum(robust.fit.chi2 for robust in self.found.fits))


def _path(
    calibration: Calibration,
    screened: Sequence[Candidate],
    kinds: Sequence[Kind],
    most: int = _MOST,
) -> list[_Step]:
    """Return models that grow by the likeliest term each time, until none is likely.

    Args:
        calibration: Of the geometry, its noise as it is.
        screened: The screen of its residuals.
        kinds: What sensors may lack.
        most: How many at most.
    """
    steps: list[_Step] = []
    added: tuple[tuple[str, Kind], ...] = ()
    while len(steps) < most:
        likely = [one for one in screened if one.corrected < LEVEL and one.kind.name != ORDER]
        if not likely:
            break
        added = (*added, (likely[0].reading, likely[0].kind))
        mechanism, _ = with_terms(calibration.mechanism, calibration.measurements, added)
        more = replace(calibration, mechanism=mechanism, start=None)
        try:
            found = fitted(more)
        except PincalError:  # what the rows do not determine
            break
        steps.append(_Step(added, more, found))
        screened = screen(found, kinds)
    return steps


def _squares(seen: Fits, unseen: Calibration) -> Array:
    """Return squared white residuals at rows that fits have not seen, shape (N,)."""
    total = np.zeros(len(unseen.measurements))
    for one, linear in predictions(seen, unseen):
        rows = unseen.used[:, [unseen.mechanism.leg_names.index(x.name) for x in one.problem.legs]]
        total[np.flatnonzero(rows.any(axis=1))] += linear.squares
    return total


def _compared(
    tried: Sequence[_Step], squares: Array, twists: Array, places: tuple[str, ...] | None
) -> tuple[tuple[Model, ...], int]:
    """Return models, and the index of the simplest within one standard error of the best.

    Args:
        tried: Models by their size, the machine as drawn first, then its geometry.
        squares: Squared white residuals of rows, held out, shape (n_models, N).
        twists: Misfits of the platform there, shape (n_models, N, dof).
        places: Pose of each row, if rows repeat poses.
    """
    known = np.isfinite(squares).all(axis=0)
    names = np.arange(squares.shape[1]).astype(str)
    names = np.array([place or name for place, name in zip(places or names, names, strict=True)])
    _, cluster = np.unique(names[known], return_inverse=True)
    sums = np.stack([np.bincount(cluster, weights=one[known]) for one in squares])
    means = sums.sum(axis=1) / known.sum()
    best = int(np.argmin(means))
    spread = (sums - sums[best]).std(axis=1, ddof=1) * np.sqrt(sums.shape[1]) / known.sum()
    chosen = int(np.flatnonzero(means - means[best] <= spread)[0])
    units = tried[0].calibration.mechanism.platform.units
    models = []
    for index, (one, mean, wide) in enumerate(zip(tried, means, spread, strict=True)):
        position, orientation = root_mean_squares(sizes(units, twists[index]))
        models.append(
            Model(
                name=_NAMES[index] if index < 2 else "{}: {}".format(*one.added[-1]),
                added=one.added,
                parameters=one.parameters,
                held_out=float(np.sqrt(mean)),
                spread=float(wide / (2.0 * np.sqrt(mean))) if mean else 0.0,
                position=position,
                orientation=orientation,
                bic=float(one.chi2 + one.parameters * np.log(known.sum())),
            )
        )
    return tuple(models), chosen
