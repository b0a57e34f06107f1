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
from pincal.calibration.checks.folds import FOLDS, clusters, folds_of
from pincal.calibration.checks.unseen import misfit, predictions
from pincal.calibration.fits import Fits, fitted
from pincal.calibration.terms.candidates import extended, with_influences
from pincal.calibration.terms.kinds import ORDER, Kind
from pincal.calibration.terms.screen import Candidate, screen
from pincal.design.platform_error import root_mean_squares, sizes
from pincal.errors import PincalError
from pincal.model.measurements import Measurements

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Rules:
    """When terms are tried, and how many."""

    level: float = 0.01
    """Probability by chance, of all tests of a screen, below which a term is tried."""
    most: int = 8
    """Terms one after the other."""
    pinned: float = 1e-12
    """How well a parameter that is as drawn is known, [m], [rad] or [1]."""


RULES = Rules()
_NAMES = ("as drawn", "geometry")


@dataclass(frozen=True)
class Model:
    """One of the models compared."""

    name: str
    """``"as drawn"``, ``"geometry"``, or what was added last."""
    added: tuple[tuple[str, Kind], ...]
    """All terms that the mechanism given has not: place and kind."""
    chance: float
    """Of the last term, when it was added: by the screen, the number of tests taken in."""
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
    """Schwarz's criterion, χ² + k ln n of n residuals, at the noise of the geometry's fit."""


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


def choose(
    calibration: Calibration, pairs: Sequence[tuple[str, Kind]], folds: int = FOLDS
) -> Choice:
    """Return which terms pay, of some kinds.

    Rows whose ``set`` is ``verify`` have no part in the choice.

    Args:
        calibration: Of the mechanism, its measurements looked at (see ``started``).
        pairs: Readings, lengths and angles, and kinds of term that they may lack.
        folds: How many times a share of the poses is held out.

    Raises:
        PincalError: the geometry itself cannot be identified, by all rows or without a fold.
    """
    data, kinds = calibration.measurements, [kind for _, kind in pairs]
    data = with_influences(calibration.mechanism, data, kinds)
    calibration = replace(calibration, measurements=data)
    if data.verifying.any():
        calibration = calibration.rows(~data.verifying)
        data = calibration.measurements
    found = fitted(calibration)
    first = found.calibration.at_this_noise()
    screened = screen(found, pairs)
    path = [_Step((), 1.0, first, found), *_path(first, screened, pairs)]
    pinned = dict.fromkeys((one.id for one in calibration.mechanism.parameters), RULES.pinned)
    drawn = first.with_options(priors=pinned)
    tried = [_Step((), 1.0, drawn, fitted(drawn)), *path]
    groups = folds_of(data, folds, "turn")
    squares = np.full((len(tried), len(data), 2), np.nan)
    twists = np.full((len(tried), *data.poses.shape), np.nan)
    for fold in range(int(groups.max()) + 1):
        first.options.report(f"models on held-out rows, fold {fold + 1} of {groups.max() + 1}")
        out = np.flatnonzero(groups == fold)
        geometry, at_rest = (one.rows(groups != fold).at_this_noise() for one in (first, drawn))
        at = fitted(geometry)
        more = _path(geometry, screen(at, pairs), pairs, len(path) - 1)
        own = _Step((), 1.0, geometry, at)
        steps = [_Step((), 1.0, at_rest, fitted(at_rest)), own, *more]
        for place in range(len(tried)):
            one = steps[min(place, len(steps) - 1)]  # a path that ended stays where it is
            unseen = replace(first.rows(out), mechanism=one.calibration.mechanism)
            squares[place, out] = _squares(one.found, unseen)
            twists[place, out] = misfit(unseen, one.found)
    models, chosen = _compared(tried, squares, twists, data)
    return Choice(models, chosen, tuple(screened), tried[max(chosen, 1)].calibration)


@dataclass(frozen=True)
class _Step:
    """A model and its fit."""

    added: tuple[tuple[str, Kind], ...]
    chance: float
    """Of the last term, when it was added: by the screen, the number of tests taken in."""
    calibration: Calibration
    found: Fits

    @property
    def parameters(self) -> int:
        """Free parameters: not those that are as drawn."""
        unknowns = [robust.fit.unknowns for robust in self.found.fits]
        return sum(one.map.shape[1] - int((one.priors <= RULES.pinned).sum()) for one in unknowns)

    @property
    def equations(self) -> int:
        """Residuals that the fits follow."""
        fits = [robust.fit for robust in self.found.fits]
        return int(sum(one.last.equations[one.weights > 0.0].sum() for one in fits))

    @property
    def chi2(self) -> float:
        return float(sum(robust.fit.chi2 for robust in self.found.fits))


def _path(
    calibration: Calibration,
    screened: Sequence[Candidate],
    pairs: Sequence[tuple[str, Kind]],
    most: int = RULES.most,
) -> list[_Step]:
    """Return models that grow by the likeliest term each time, until none is likely.

    Args:
        calibration: Of the geometry, its noise as it is.
        screened: The screen of its residuals.
        pairs: Readings, and kinds of term that they may lack.
        most: How many at most.
    """
    steps: list[_Step] = []
    added: tuple[tuple[str, Kind], ...] = ()
    while len(steps) < most:
        likely = [one for one in screened if one.corrected < RULES.level and one.kind.name != ORDER]
        if not likely:
            break
        added = (*added, (likely[0].reading, likely[0].kind))
        more = replace(extended(calibration, added), start=None)
        try:
            found = fitted(more)
        except PincalError:  # what the rows do not determine
            break
        steps.append(_Step(added, likely[0].corrected, more, found))
        screened = screen(found, pairs)
    return steps


def _squares(seen: Fits, unseen: Calibration) -> Array:
    """Return squared white residuals at rows not seen, and how many they are, shape (N, 2)."""
    total = np.zeros((len(unseen.measurements), 2))
    for one, linear in predictions(seen, unseen):
        legs = [unseen.mechanism.leg_names.index(leg.name) for leg in one.problem.legs]
        rows = np.flatnonzero(unseen.used[:, legs].any(axis=1))
        if seen.latent:
            rows = np.arange(len(total))
        total[rows, 0] += linear.squares
        total[rows, 1] += linear.equations
    return total


def _compared(
    tried: Sequence[_Step], squares: Array, twists: Array, data: Measurements
) -> tuple[tuple[Model, ...], int]:
    """Return models, and the index of the simplest within one standard error of the best.

    Args:
        tried: Models by their size, the machine as drawn first, then its geometry.
        squares: Sums of squared white residuals of rows, held out, and how many they are, shape
            (n_models, N, 2).
        twists: Misfits of the platform there, shape (n_models, N, dof).
        data: The rows, of which those of one pose go together.
    """
    _, cluster = np.unique(clusters(data), return_inverse=True)
    count = float(squares[0, :, 1].sum())
    sums = np.stack([np.bincount(cluster, weights=one[:, 0]) for one in squares])
    means = sums.sum(axis=1) / count
    best = int(np.argmin(means))
    several = sums.shape[1] > 1
    spread = (sums - sums[best]).std(axis=1, ddof=int(several)) * np.sqrt(sums.shape[1]) / count
    chosen = int(np.flatnonzero(means - means[best] <= spread)[0])
    units = tried[0].calibration.mechanism.platform.units
    models = []
    for index, (one, mean, wide) in enumerate(zip(tried, means, spread, strict=True)):
        position, orientation = root_mean_squares(sizes(units, twists[index]))
        models.append(
            Model(
                name=_NAMES[index] if index < 2 else "{} {}".format(*one.added[-1]),
                added=one.added,
                chance=one.chance,
                parameters=one.parameters,
                held_out=float(np.sqrt(mean)),
                spread=float(wide / (2.0 * np.sqrt(mean))) if mean else 0.0,
                position=position,
                orientation=orientation,
                bic=float(one.chi2 + one.parameters * np.log(one.equations)),
            )
        )
    return tuple(models), chosen
