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
from pincal.calibration.checks.folds import clusters, folds_of
from pincal.calibration.fits import fitted
from pincal.calibration.terms.bounds import Bound, bounds
from pincal.calibration.terms.candidates import with_columns
from pincal.calibration.terms.kinds import Kind
from pincal.calibration.terms.path import RULES, TROUBLE, Step, grown, held_out
from pincal.calibration.terms.screen import Candidate, screen
from pincal.errors import MeasurementError
from pincal.estimation.residuals.slips import Slip, slips
from pincal.model.measuring.measurements import Measurements

Array = NDArray[np.float64]
DRAWN, ALIGNED, GEOMETRY = "as drawn", "rigid alignment", "geometry"
"""The machine as drawn, where it stands known or found; its parameters identified."""


@dataclass(frozen=True)
class Model:
    """One of the models compared."""

    name: str
    """``"as drawn"`` (``"rigid alignment"`` where frame or target are unknown), ``"geometry"``, or
    what was added last."""
    added: tuple[tuple[str, Kind], ...]
    """All terms that the mechanism given has not: place and kind."""
    chance: float
    """Of the last term, when it was added: by the screen, the number of tests taken in."""
    parameters: int
    """Free parameters."""
    held_out: float
    """Root mean square of white residuals of held-out rows, [σ of the noise]; NaN where no fold
    can be identified."""
    spread: float
    """Standard error of how much larger that is than the best model's, poses as clusters, [σ]."""
    position: float
    """Root mean square by which positions of targets are missed at held-out rows, [m]; NaN where
    none were measured."""
    orientation: float
    """The same of the measured orientation, [rad]."""
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
    slips: tuple[Slip, ...] = ()
    """What slipped or drifted, unless a term explains it better; rows those of the measurements."""
    bounds: tuple[Bound, ...] = ()
    """Noise that is surely there."""
    lost: tuple[tuple[int, str], ...] = ()
    """Folds, from 0, without whose rows the geometry is not identified, and why: they are left out
    of the comparison."""

    @property
    def model(self) -> Model:
        """The model that was chosen."""
        return self.models[self.chosen]


def choose(calibration: Calibration, pairs: Sequence[tuple[str, Kind]]) -> Choice:
    """Return which terms pay, of some kinds.

    Rows whose ``set`` is ``verify`` have no part in the choice.

    Args:
        calibration: Of the mechanism, its measurements looked at (see ``started``).
        pairs: Readings, lengths and angles, and kinds of term that they may lack.

    Raises:
        PincalError: the geometry itself cannot be identified by all rows; fewer poses than folds;
            residuals of readings, which are not white.
    """
    if calibration.options.residual == "joint":
        raise MeasurementError(
            "what residuals follow is asked of white ones, which those of readings (--residual "
            "joint) are not; leave that out, and name the terms that it is to have (--terms)"
        )
    data = with_columns(calibration, [kind for _, kind in pairs])
    calibration = replace(calibration, measurements=data)
    kept = np.flatnonzero(~data.verifying)
    if len(kept) < len(data):
        calibration = calibration.rows(kept)
        data = calibration.measurements
    found = fitted(calibration)
    first = found.calibration.at_this_noise()
    screened = tuple(screen(found, pairs))
    pinned = dict.fromkeys((one.id for one in calibration.mechanism.parameters), RULES.pinned)
    drawn = first.with_options(priors=pinned)
    tried = [Step((), 1.0, drawn, fitted(drawn)), Step((), 1.0, first, found)]
    tried += grown(first, screened, pairs)
    slipped = tuple(replace(one, row=int(kept[one.row])) for one in _slips(tried[1:]))
    beside = (slipped, bounds(found.calibration, screened))
    groups = folds_of(data, calibration.options.folds, "turn")
    lost = []
    squares = np.full((len(tried), len(data), 2), np.nan)
    misses = np.full((len(tried), len(data), 2), np.nan)
    for fold in range(int(groups.max()) + 1):
        first.options.report(f"models on held-out rows, fold {fold + 1} of {groups.max() + 1}")
        out = np.flatnonzero(groups == fold)
        seen = [one.rows(groups != fold).at_this_noise() for one in (drawn, first)]
        try:
            parts = held_out(first.rows(out), seen, pairs, len(tried) - 2)
        except TROUBLE as error:
            lost.append((fold, str(error)))
            continue
        for place in range(len(tried)):  # a path that ended stays where it is
            squares[place, out], misses[place, out] = parts[min(place, len(parts) - 1)]
    known = np.isfinite(squares[0, :, 0])
    if not known.any():
        models = tuple(_model(one, index, np.nan, 0.0, misses) for index, one in enumerate(tried))
        return Choice(models, 1, screened, first, *beside, tuple(lost))
    models, chosen = _compared(tried, squares[:, known], misses[:, known], data.rows(known))
    own = tried[max(chosen, 1)].calibration
    return Choice(models, chosen, screened, own, *beside, tuple(lost))


def _slips(steps: Sequence[Step]) -> list[Slip]:
    """Return what slipped or drifted, its rows those of the measurements.

    By the residuals of the geometry; or, while a term is likelier than the clearest slip, of the
    model with that term: a slip may only follow it, as terms may follow a slip.

    Args:
        steps: The geometry, and models that grow by the likeliest term each time.
    """
    found: list[Slip] = []
    for index, step in enumerate(steps):
        if index and not (found and step.chance < found[0].p_value):
            break
        found = [
            replace(one, row=int(robust.rows[one.row]))
            for robust in step.found.fits
            for one in slips(robust.fit)
        ]
    given = steps[0].found.calibration.options.noise is not None  # or estimated with slips in it
    return found if given else found[:1]


def _compared(
    tried: Sequence[Step], squares: Array, misses: Array, data: Measurements
) -> tuple[tuple[Model, ...], int]:
    """Return models, and the index of the simplest within one standard error of the best.

    Args:
        tried: Models by their size, the machine as drawn first, then its geometry.
        squares: Sums of squared white residuals of rows, held out, and how many they are, shape
            (n_models, N, 2).
        misses: By how much targets are missed there, shape (n_models, N, 2), [m] and [rad].
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
    models = (
        _model(one, index, float(mean), float(wide), misses)
        for index, (one, mean, wide) in enumerate(zip(tried, means, spread, strict=True))
    )
    return tuple(models), chosen


def _model(one: Step, index: int, mean: float, wide: float, misses: Array) -> Model:
    """Return a model.

    Args:
        one: The model and its fit by all rows.
        index: Its place among all.
        mean: Mean square of white residuals held out.
        wide: Standard error of how much larger that is than the best model's.
        misses: By how much targets are missed there, shape (n_models, N, 2), [m] and [rad].
    """
    position, orientation = (_root_mean_square(own) for own in misses[index].T)
    outside = bool(one.calibration.observation.external.names)
    names = (ALIGNED if outside else DRAWN, GEOMETRY)
    return Model(
        name=names[index] if index < 2 else "{} {}".format(*one.added[-1]),
        added=one.added,
        chance=one.chance,
        parameters=one.parameters,
        held_out=float(np.sqrt(mean)),
        spread=float(wide / (2.0 * np.sqrt(mean))) if mean > 0.0 else 0.0,
        position=position,
        orientation=orientation,
        bic=float(one.chi2 + one.parameters * np.log(one.equations)),
    )


def _root_mean_square(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt((known**2).mean())) if len(known) else float("nan")
