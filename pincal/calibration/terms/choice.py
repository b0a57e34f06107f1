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
from pincal.calibration.missed import misses_of, per_row
from pincal.calibration.options import FOLDS, clusters, folds_of
from pincal.calibration.terms.candidates import extended, with_columns
from pincal.calibration.terms.kinds import ORDER, Kind
from pincal.calibration.terms.screen import Candidate, screen
from pincal.calibration.validation import predictions
from pincal.errors import MeasurementError, PincalError
from pincal.estimation.observability.courses import Slip, slips
from pincal.types import Array

LEVEL = 0.01
"""Probability by chance, of all tests of a screen, below which a term is tried."""
_MOST_TERMS = 8  # one after the other
_PINNED = 1e-12  # how well a parameter that is as drawn is known, [m], [rad] or [1]
_TROUBLE = (PincalError, np.linalg.LinAlgError)  # what rows that do not determine a model raise


@dataclass(frozen=True)
class NestedModel:
    """A model and its fit."""

    added: tuple[tuple[str, Kind], ...]
    """All terms that the mechanism given has not: place and kind."""
    chance: float
    """Probability by chance of the last term when it was added, the number of tests taken in."""
    calibration: Calibration
    fits: Fits

    @property
    def parameters(self) -> int:
        """Number of free parameters: not those that are as drawn."""
        unknowns = [fit.unknowns for fit in self.fits.fits]
        return sum(
            unknown.map.shape[1] - int((unknown.priors <= _PINNED).sum()) for unknown in unknowns
        )

    def errors(self, unseen: Calibration) -> Array:
        """Return errors at rows not seen: shape (N, 4).

        Squared white residuals and how many they are; by how much targets are missed, [m] and
        [rad].
        """
        unseen_rows = replace(unseen, mechanism=self.calibration.mechanism)
        count = len(unseen_rows.measurements)
        errors = np.hstack(
            (np.zeros((count, 2)), per_row(misses_of(unseen_rows, self.fits), count))
        )
        for fit, linear in predictions(self.fits, unseen_rows):
            legs = [unseen_rows.mechanism.leg_names.index(leg.name) for leg in fit.problem.legs]
            serves = unseen_rows.used[:, legs].any(axis=1) | self.fits.latent
            errors[serves, 0] += linear.squares
            errors[serves, 1] += linear.equations
        return errors


@dataclass(frozen=True)
class Model:
    """One of the models compared."""

    name: str
    """``"as drawn"`` (``"rigid alignment"`` where frame or target are unknown), ``"geometry"``, or
    what was added last."""
    added: tuple[tuple[str, Kind], ...]
    """All terms that the mechanism given has not: place and kind."""
    chance: float
    """Probability by chance of the last term when it was added, the number of tests taken in."""
    parameters: int
    """Number of free parameters."""
    held_out: float
    """Root mean square of white residuals of held-out rows, [σ of the noise]; NaN where no fold
    can be identified."""
    spread: float
    """Standard error of how much larger that is than the best model's, poses as clusters, [σ]."""
    position: float
    """Root mean square by which positions of targets are missed at held-out rows, [m]; NaN where
    none were measured."""
    orientation: float
    """Root mean square by which the measured orientation is missed there, [rad]."""
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
    slips: tuple[Slip, ...] = ()
    """What slipped or drifted, unless a term explains it better; rows those of the measurements."""
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
    choosing_rows = np.flatnonzero(~data.verifying)
    calibration = replace(calibration, measurements=data)
    if len(choosing_rows) < len(data):
        calibration = calibration.rows(choosing_rows)
    fits = fitted(calibration)
    geometry = fits.calibration.at_this_noise()
    parameters = calibration.mechanism.parameters
    drawn = geometry.with_options(priors={parameter.id: _PINNED for parameter in parameters})
    steps = [NestedModel((), 1.0, drawn, fitted(drawn)), NestedModel((), 1.0, geometry, fits)]
    candidates = screen(fits, pairs)
    steps += _grown(geometry, candidates, pairs, _MOST_TERMS)
    slipped = [replace(slip, row=int(choosing_rows[slip.row])) for slip in _slips(steps[1:])]
    groups = folds_of(calibration.measurements, calibration.options.folds or FOLDS, "turn")
    errors, lost = np.full((len(steps), len(groups), 4), np.nan), []
    for fold in range(int(groups.max()) + 1):
        geometry.options.report(f"models on held-out rows, fold {fold + 1} of {groups.max() + 1}")
        held_rows = np.flatnonzero(groups == fold)
        seen = [
            calibration_of_all.rows(groups != fold).at_this_noise()
            for calibration_of_all in (drawn, geometry)
        ]
        try:
            parts = _errors_of_fold(geometry.rows(held_rows), seen, pairs, len(steps) - 2)
        except _TROUBLE as error:
            lost.append((fold, str(error)))
            continue
        parts += parts[-1:] * (len(steps) - len(parts))  # a path that ended stays where it is
        errors[:, held_rows] = parts[: len(steps)]
    models, chosen = _compared(steps, errors, clusters(calibration.measurements))
    return Choice(models, chosen, tuple(candidates), tuple(slipped), tuple(lost))


def _grown(
    geometry: Calibration,
    candidates: Sequence[Candidate],
    pairs: Sequence[tuple[str, Kind]],
    most: int,
) -> list[NestedModel]:
    """Return models that grow by the likeliest term of a screen, until none is likely, or most."""
    steps: list[NestedModel] = []
    while len(steps) < most:
        likely = [term for term in candidates if term.corrected < LEVEL and term.kind.name != ORDER]
        if not likely:
            break
        added = (*(steps[-1].added if steps else ()), likely[0].pair)
        larger = replace(extended(geometry, added), start=None)
        try:
            fits = _identified(larger)
        except _TROUBLE:  # what the rows do not determine
            break
        steps.append(NestedModel(added, likely[0].corrected, larger, fits))
        candidates = screen(fits, pairs)
    return steps


def _errors_of_fold(
    unseen: Calibration,
    seen: Sequence[Calibration],
    pairs: Sequence[tuple[str, Kind]],
    most: int,
) -> list[Array]:
    """Return errors of rows held out by each model, of the machine as drawn and its geometry first.

    Raises:
        PincalError, LinAlgError: the rows seen do not determine the geometry.
    """
    steps = [NestedModel((), 1.0, calibration, _identified(calibration)) for calibration in seen]
    errors = [step.errors(unseen) for step in steps]
    for step in _grown(seen[1], screen(steps[1].fits, pairs), pairs, most):
        try:
            errors.append(step.errors(unseen))
        except _TROUBLE:
            break  # as a path that ended
    return errors


def _identified(calibration: Calibration) -> Fits:
    """Return fits that converged.

    Raises:
        PincalError, LinAlgError: rows that do not determine the model, or a search without end.
    """
    fits = fitted(calibration)
    if not fits.converged:
        raise MeasurementError("the search does not converge")
    return fits


def _slips(steps: Sequence[NestedModel]) -> list[Slip]:
    """Return what slipped or drifted, its rows those of the measurements.

    By the residuals of the geometry, the first step; or, while a term is likelier than the clearest
    slip, of the model with that term: a slip may only follow it, as terms may follow a slip.
    """
    slipped: list[Slip] = []
    for index, step in enumerate(steps):
        if index and not (slipped and step.chance < slipped[0].p_value):
            break
        slipped = [
            replace(slip, row=int(fit.rows[slip.row]))
            for fit in step.fits.fits
            for slip in slips(fit)
        ]
    noise_given = steps[0].fits.calibration.options.noise is not None
    return slipped if noise_given else slipped[:1]  # or estimated with slips in it


def _compared(
    steps: Sequence[NestedModel], errors: Array, places: Sequence[str]
) -> tuple[tuple[Model, ...], int]:
    """Return models, and the index of the simplest within one standard error of the best.

    Args:
        steps: Models by their size, the machine as drawn first, then its geometry.
        errors: Of held-out rows (see ``errors``), shape (n_models, N, 4); NaN of folds lost.
        places: Poses of the rows: those of one go together.
    """
    known = np.isfinite(errors[0, :, 0])
    chosen, means, spread = 1, np.full(len(steps), np.nan), np.zeros(len(steps))
    if known.any():
        squares, count = errors[:, known, 0], float(errors[0, known, 1].sum())
        _, cluster = np.unique(np.array(places)[known], return_inverse=True)
        sums = np.stack([np.bincount(cluster, weights=of_model) for of_model in squares])
        means = sums.sum(axis=1) / count
        best, poses = int(np.argmin(means)), sums.shape[1]
        spread = (sums - sums[best]).std(axis=1, ddof=int(poses > 1)) * np.sqrt(poses) / count
        chosen = int(np.flatnonzero(means - means[best] <= spread)[0])
    outside = bool(steps[0].calibration.observation.external.names)
    names = ["rigid alignment" if outside else "as drawn", "geometry"]
    names += ["{} {}".format(*step.added[-1]) for step in steps[2:]]
    models = []
    for step, name, mean, wide, of_model in zip(steps, names, means, spread, errors, strict=True):
        position, orientation = (_root_mean_square(column) for column in of_model.T[2:])
        chi2, equations = _chi2(step.fits)
        models.append(
            Model(
                name=name,
                added=step.added,
                chance=step.chance,
                parameters=step.parameters,
                held_out=float(np.sqrt(mean)),
                spread=float(wide / (2.0 * np.sqrt(mean))) if mean > 0.0 else 0.0,
                position=position,
                orientation=orientation,
                bic=chi2 + step.parameters * float(np.log(equations)),
            )
        )
    return tuple(models), chosen


def _chi2(fits: Fits) -> tuple[float, int]:
    """Return χ² of all residuals, at the noise of the geometry's fit, and how many they are."""
    counts = [fit.last.equations[fit.weights > 0.0].sum() for fit in fits.fits]
    return float(sum(fit.chi2 for fit in fits.fits)), int(sum(counts))


def _root_mean_square(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt((known**2).mean())) if len(known) else float("nan")
