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

from pincal.calibration.calibration import Calibration
from pincal.calibration.fits import Fits, fitted
from pincal.calibration.missed import misses_of, per_row, predictions
from pincal.calibration.options import FOLDS, clusters, folds_of
from pincal.calibration.terms.candidates import extended, with_columns
from pincal.calibration.terms.kinds import ORDER, Kind
from pincal.calibration.terms.screen import Bound, Candidate, bounds, screen
from pincal.errors import MeasurementError, PincalError
from pincal.estimation.residuals.courses import Slip, slips
from pincal.model.measurements import Measurements
from pincal.types import Array

TROUBLE = (PincalError, np.linalg.LinAlgError)
"""What rows that do not determine a model raise."""


LEVEL = 0.01
"""Probability by chance, of all tests of a screen, below which a term is tried."""
_MOST_TERMS = 8  # one after the other
_PINNED = 1e-12  # how well a parameter that is as drawn is known, [m], [rad] or [1]


@dataclass(frozen=True)
class Step:
    """A model and its fit."""

    added: tuple[tuple[str, Kind], ...]
    chance: float
    """Of the last term, when it was added: by the screen, the number of tests taken in."""
    calibration: Calibration
    found: Fits

    @property
    def parameters(self) -> int:
        """Free parameters: not those that are as drawn."""
        unknowns = [fit.unknowns for fit in self.found.fits]
        return sum(
            unknown.map.shape[1] - int((unknown.priors <= _PINNED).sum()) for unknown in unknowns
        )

    @property
    def equations(self) -> int:
        """Residuals that the fits follow."""
        fits = self.found.fits
        return int(sum(fit.last.equations[fit.weights > 0.0].sum() for fit in fits))

    @property
    def chi2(self) -> float:
        """Of all residuals, at the noise of the geometry's fit."""
        return float(sum(fit.chi2 for fit in self.found.fits))


def grown(
    calibration: Calibration,
    screened: Sequence[Candidate],
    pairs: Sequence[tuple[str, Kind]],
    most: int = _MOST_TERMS,
) -> list[Step]:
    """Return models that grow by the likeliest term each time, until none is likely.

    Args:
        calibration: Of the geometry, its noise as it is.
        screened: The screen of its residuals.
        pairs: Readings, and kinds of term that they may lack.
        most: How many at most.
    """
    steps: list[Step] = []
    added: tuple[tuple[str, Kind], ...] = ()
    while len(steps) < most:
        likely = [one for one in screened if one.corrected < LEVEL and one.kind.name != ORDER]
        if not likely:
            break
        added = (*added, (likely[0].reading, likely[0].kind))
        larger = replace(extended(calibration, added), start=None)
        try:
            fits = _identified(larger)
        except TROUBLE:  # what the rows do not determine
            break
        steps.append(Step(added, likely[0].corrected, larger, fits))
        screened = screen(fits, pairs)
    return steps


def held_out(
    unseen: Calibration,
    seen: Sequence[Calibration],
    pairs: Sequence[tuple[str, Kind]],
    most: int,
) -> list[tuple[Array, Array]]:
    """Return ``squares`` and misses (see ``per_row``) of rows held out, by each model.

    Args:
        unseen: The rows held out.
        seen: Calibrations of the others: of the machine as drawn, and of its geometry.
        pairs: Readings, and kinds of term that they may lack.
        most: How many terms at most.

    Raises:
        PincalError, LinAlgError: these rows do not determine the geometry.
    """
    steps = [Step((), 1.0, one, _identified(one)) for one in seen]
    steps += grown(seen[1], screen(steps[1].found, pairs), pairs, most)
    parts = []
    for step in steps:
        there = replace(unseen, mechanism=step.calibration.mechanism)
        try:
            misses = per_row(misses_of(there, step.found), len(there.measurements))
            parts.append((squares(step.found, there), misses))
        except TROUBLE:
            if len(parts) < len(seen):
                raise
            break  # as a path that ended
    return parts


def _identified(calibration: Calibration) -> Fits:
    """Return fits that converged.

    Raises:
        PincalError, LinAlgError: rows that do not determine the model, or a search without end.
    """
    fits = fitted(calibration)
    if not all(fit.converged for fit in fits.fits):
        raise MeasurementError("the search does not converge")
    return fits


def squares(seen: Fits, unseen: Calibration) -> Array:
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
    choosing_rows = np.flatnonzero(~data.verifying)
    if len(choosing_rows) < len(data):
        calibration = calibration.rows(choosing_rows)
        data = calibration.measurements
    fits = fitted(calibration)
    first = fits.calibration.at_this_noise()
    screened = tuple(screen(fits, pairs))
    pinned = dict.fromkeys(
        (parameter.id for parameter in calibration.mechanism.parameters), _PINNED
    )
    drawn = first.with_options(priors=pinned)
    tried = [Step((), 1.0, drawn, fitted(drawn)), Step((), 1.0, first, fits)]
    tried += grown(first, screened, pairs)
    slipped = tuple(replace(slip, row=int(choosing_rows[slip.row])) for slip in _slips(tried[1:]))
    slips_and_bounds = (slipped, bounds(fits.calibration, screened))
    groups = folds_of(data, calibration.options.folds or FOLDS, "turn")
    lost = []
    squares = np.full((len(tried), len(data), 2), np.nan)
    misses = np.full((len(tried), len(data), 2), np.nan)
    for fold in range(int(groups.max()) + 1):
        first.options.report(f"models on held-out rows, fold {fold + 1} of {groups.max() + 1}")
        held_rows = np.flatnonzero(groups == fold)
        seen_rows = [
            calibration.rows(groups != fold).at_this_noise() for calibration in (drawn, first)
        ]
        try:
            parts = held_out(first.rows(held_rows), seen_rows, pairs, len(tried) - 2)
        except TROUBLE as error:
            lost.append((fold, str(error)))
            continue
        for place in range(len(tried)):  # a path that ended stays where it is
            squares[place, held_rows], misses[place, held_rows] = parts[min(place, len(parts) - 1)]
    known = np.isfinite(squares[0, :, 0])
    if not known.any():
        models = tuple(_model(one, index, np.nan, 0.0, misses) for index, one in enumerate(tried))
        return Choice(models, 1, screened, first, *slips_and_bounds, tuple(lost))
    models, chosen = _compared(tried, squares[:, known], misses[:, known], data.rows(known))
    own = tried[max(chosen, 1)].calibration
    return Choice(models, chosen, screened, own, *slips_and_bounds, tuple(lost))


def _slips(steps: Sequence[Step]) -> list[Slip]:
    """Return what slipped or drifted, its rows those of the measurements.

    By the residuals of the geometry; or, while a term is likelier than the clearest slip, of the
    model with that term: a slip may only follow it, as terms may follow a slip.

    Args:
        steps: The geometry, and models that grow by the likeliest term each time.
    """
    slipped: list[Slip] = []
    for index, step in enumerate(steps):
        if index and not (slipped and step.chance < slipped[0].p_value):
            break
        slipped = [
            replace(slip, row=int(fit.rows[slip.row]))
            for fit in step.found.fits
            for slip in slips(fit)
        ]
    noise_given = (
        steps[0].found.calibration.options.noise is not None
    )  # or estimated with slips in it
    return slipped if noise_given else slipped[:1]


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
    sums = np.stack(
        [np.bincount(cluster, weights=squares_of_model[:, 0]) for squares_of_model in squares]
    )
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
    position, orientation = (_root_mean_square(column) for column in misses[index].T)
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
