"""Choice of terms: nested models are compared on held-out rows.

The models are the machine as drawn, its identified geometry, and models with one more kind of term
each time, the most significant one in the screen of the residuals. Each fold makes these choices by
the rows that it sees, so that the choice itself is held out (M. Stone 1974); rows of one pose stay
together. All folds grow at once, until two successive terms do not improve the prediction of
held-out rows. The simplest model within one standard error of the best is chosen (L. Breiman et
al., Classification and Regression Trees, 1984): no other term is kept, however significant it is.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import chain, islice

import numpy as np

from pincal.attached import attached
from pincal.calibration.calibration import Calibration
from pincal.calibration.fits import Fits, fitted
from pincal.calibration.options import FOLDS, clusters, folds_of
from pincal.calibration.promise import misses_of
from pincal.calibration.result import CalibrationResult
from pincal.calibration.terms.candidates import extended, with_columns
from pincal.calibration.terms.kinds import Pair, term_text
from pincal.calibration.terms.screen import Candidate, screen
from pincal.calibration.validation import converged, held_rows, predictions
from pincal.errors import PincalError
from pincal.estimation.observability.courses import Score, slips
from pincal.types import Array, Mask

LEVEL = 0.01
"""P-value, corrected for the number of tests in a screen, below which a term is tried."""
_MOST_TERMS = 8  # most terms that are added
_IN_VAIN = 2  # successive terms without a better prediction, after which none is tried
_PINNED = 1e-12  # prior standard deviation of a parameter as drawn, [m], [rad] or [1]
_TROUBLE = (PincalError, np.linalg.LinAlgError)  # errors if rows do not determine a model


@dataclass(frozen=True)
class Model:
    """One of the models compared: its fit of all rows, and its errors at held-out rows."""

    name: str
    """``"as drawn"`` (``"rigid alignment"`` where frame or target are unknown), ``"geometry"``, or
    the term added last."""
    fits: Fits = field(repr=False)
    added: tuple[Pair, ...] = ()
    """All terms in addition to those of the given mechanism: place and kind."""
    chance: float = 1.0
    """P-value of the last term when it was added, corrected for the number of tests."""
    held_out: float = np.nan
    """RMS of whitened residuals of held-out rows, [σ]; NaN if no fold is identified."""
    spread: float = 0.0
    """Standard error of ``held_out`` minus the best model's, with poses as clusters, [σ]."""
    position: float = np.nan
    """RMS position error of targets at held-out rows, [m]; NaN if not measured."""
    orientation: float = np.nan
    """RMS error of the measured orientation at held-out rows, [rad]; NaN if not measured."""

    @property
    def parameters(self) -> int:
        """Number of free parameters, without those held as drawn."""
        unknowns = [(fit.unknowns.n_free, fit.unknowns.priors) for fit in self.fits.fits]
        return sum(count - int((priors <= _PINNED).sum()) for count, priors in unknowns)

    def errors(self, held: Calibration) -> Array:
        """Return squares and numbers of whitened residuals by row, and squared misses, (N, 4)."""
        held = replace(held, mechanism=self.fits.calibration.mechanism)
        errors = np.tile([0.0, 0.0, np.nan, np.nan], (len(held.measurements), 1))
        misses = misses_of(held, self.fits.parameters, self.fits.external)
        for column, unit in ((2, "m"), (3, "rad")):
            if squares := [values**2 for (_, of), values in misses.items() if of == unit]:
                errors[:, column] = _mean_of_known(squares)
        for _, rows, linear in predictions(self.fits, held):
            errors[rows, 0] += linear.squares
            errors[rows, 1] += linear.equations
        return errors


@dataclass(frozen=True, repr=False)
class Explanation:
    """Terms that the residuals of a calibration follow, and the model that predicts rows best.

    Example:
        >>> import numpy as np, pincal
        >>> plan = pincal.Plan(pincal.sample_workspace("5R", 40, seed=0))
        >>> truth = pincal.disturb("5R", 1e-3, seed=1)
        >>> noise = pincal.Noise(position=1e-4)
        >>> data = pincal.simulate("5R", truth, plan, noise, seed=1).measurements
        >>> found = pincal.explain("5R", data, noise=noise, terms=["harmonics"])
        >>> found.terms  # geometry is all there is
        ()
    """

    result: CalibrationResult
    """The calibration of the geometry."""
    models: Sequence[Model]
    """Models that were compared, in the order of their size."""
    chosen: int
    """Index of the simplest model within one standard error of the best."""
    candidates: Sequence[Candidate]
    """Screen of the geometry's residuals."""
    slips: Sequence[Score]
    """Slips and drifts, unless a term explains them better; rows are those of the measurements."""
    lost: Sequence[tuple[int, str]]
    """Folds, from 0, that were not compared, as geometry needs their rows, with the reason."""

    @property
    def model(self) -> Model:
        """The model that was chosen."""
        return self.models[self.chosen]

    @property
    def verdict(self) -> str:
        """The model's name, or ``"terms"``; ``"not compared"`` where no fold can be identified."""
        if np.isnan(self.model.held_out):
            return "not compared"
        return "terms" if self.chosen > 1 else self.model.name

    @property
    def terms(self) -> tuple[str, ...]:
        """Chosen terms in the form of options: ``leg_2=harmonics:1``, ``leg_1.l=warm``."""
        return tuple(term_text(*term) for term in self.model.added)

    @attached
    def __str__(self) -> str:
        """Return the screen, the models compared, and the verdict as text."""

    def __repr__(self) -> str:
        chosen = ", ".join(self.terms) or self.verdict
        return f"Explanation({self.result.nominal.name!r}: {chosen})"


def choose(
    calibration: Calibration, pairs: Sequence[Pair], fits: Fits | None = None
) -> tuple[list[Model], int, list[Candidate], list[Score], list[tuple[int, str]]]:
    """Choose terms among places and kinds; return an ``Explanation``'s fields behind its result.

    The calibration is ``started``; ``fits`` are its fits of all rows, if known. Rows of the set
    ``verify`` have no part in the choice.
    """
    data = with_columns(calibration, [kind for _, kind in pairs])
    choosing_rows = np.flatnonzero(~data.verifying)
    calibration = replace(calibration, measurements=data)
    if fits is None or len(choosing_rows) < len(data):
        fits = fitted(calibration.rows(choosing_rows))
    data = data.rows(choosing_rows)
    geometry = replace(fits.calibration, measurements=data).at_this_noise()
    fits = replace(fits, calibration=geometry)
    priors = {parameter.id: _PINNED for parameter in geometry.mechanism.parameters}
    drawn = geometry.with_options(priors=priors)
    name = "rigid alignment" if drawn.observation.external.names else "as drawn"
    candidates = screen(fits, pairs)
    models = [Model(name, fitted(drawn)), Model("geometry", fits)]
    groups = folds_of(data, calibration.options.folds or FOLDS, "turn")
    errors, paths, lost = np.full((2, len(groups), 4), np.nan), [], []
    for fold in range(int(groups.max()) + 1):
        geometry.options.report(f"models on held-out rows, fold {fold + 1} of {groups.max() + 1}")
        path = _errors_along(models, groups != fold, pairs)
        try:
            errors[:, groups == fold] = list(islice(path, 2))
            paths.append((groups == fold, path))
        except _TROUBLE as error:
            lost.append((fold, str(error)))
    growing = islice(_grown(fits, pairs, candidates), _MOST_TERMS)
    for model in growing:
        geometry.options.report(f"models on held-out rows, with {model.name}")
        models.append(model)
        errors = np.append(errors, errors[-1:], axis=0)  # a path that ended keeps its errors
        for held, path in paths:
            errors[-1, held] = next(path, errors[-1, held])
        best = int(np.argmin(np.nansum(errors[1:, :, 0], axis=1)))
        if len(errors) - 2 - best >= _IN_VAIN:
            break
    slipped = _slips(chain(models[1:], growing))
    slipped = [replace(slip, row=int(choosing_rows[slip.row])) for slip in slipped]
    models, chosen = _compared(models, errors, clusters(data))
    return models, chosen, candidates, slipped, lost


def _grown(
    geometry: Fits, pairs: Sequence[Pair], candidates: Sequence[Candidate]
) -> Iterator[Model]:
    """Yield models, each with the most significant term of a screen in addition to the last's."""
    fits, added = geometry, tuple[Pair, ...]()
    every = np.ones(len(fits.calibration.measurements), dtype=bool)
    while likely := [candidate for candidate in candidates if candidate.corrected < LEVEL]:
        added = (*added, likely[0].pair)
        longer = replace(extended(geometry.calibration, added), start=None)
        try:
            fits = converged(longer, "the search", fits, every)
        except _TROUBLE:  # the rows do not determine this model
            return
        yield Model("{} {}".format(*added[-1]), fits, added, likely[0].corrected)
        candidates = screen(fits, pairs)


def _errors_along(models: Sequence[Model], fitted: Mask, pairs: Sequence[Pair]) -> Iterator[Array]:
    """Yield errors of held-out rows as drawn and by geometry, or raise; then with more terms."""
    drawn, geometry = (
        converged(model.fits.calibration.rows(fitted), "the search", model.fits, fitted)
        for model in models[:2]
    )
    held = held_rows(models[1].fits.calibration, ~fitted)
    yield Model("", drawn).errors(held)
    yield Model("", geometry).errors(held)
    with suppress(*_TROUBLE):  # the path ends there
        for model in _grown(geometry, pairs, screen(geometry, pairs)):
            yield model.errors(held)


def _slips(models: Iterable[Model]) -> list[Score]:
    """Return slips and drifts, with rows of the measurements.

    They are found in the residuals of the geometry; as long as a term is more significant than the
    clearest slip, in those of the model with that term, which may have caused the slip.
    """
    slipped: list[Score] = []
    for index, model in enumerate(models):
        if index and not (slipped and model.chance < slipped[0].p_value):
            break
        slipped = [
            replace(slip, row=int(fit.rows[slip.row]))
            for fit in model.fits.fits
            for slip in slips(fit)
        ]
    known = model.fits.calibration.noise.known
    return slipped if known else slipped[:1]  # estimated noise contains the slips


def _compared(
    models: Sequence[Model], errors: Array, places: Sequence[str]
) -> tuple[list[Model], int]:
    """Return models with their errors, (n_models, N, 4), NaN in lost folds, and the chosen index.

    It is the simplest within one standard error of the best, with rows of one place as a cluster.
    """
    known = np.isfinite(errors[0, :, 0])
    if not known.any():
        return list(models), 1
    squares, count = errors[:, known, 0], float(errors[0, known, 1].sum())
    _, cluster = np.unique(np.array(places)[known], return_inverse=True)
    sums = np.stack([np.bincount(cluster, weights=of_model) for of_model in squares])
    means = sums.sum(axis=1) / count
    best, poses = int(np.argmin(means)), sums.shape[1]
    spread = (sums - sums[best]).std(axis=1, ddof=int(poses > 1)) * np.sqrt(poses) / count
    compared = []
    for model, mean, wide, of_model in zip(models, means, spread, errors, strict=True):
        position, orientation = np.sqrt(_mean_of_known(of_model[:, 2:])).tolist()
        held_out = float(np.sqrt(mean))
        relative = float(wide) / (2.0 * held_out) if mean > 0.0 else 0.0
        errors_of_model = {"position": position, "orientation": orientation, "spread": relative}
        compared.append(replace(model, held_out=held_out, **errors_of_model))
    return compared, int(np.flatnonzero(means - means[best] <= spread)[0])


def _mean_of_known(values: Sequence[Array] | Array) -> Array:
    """Return means along the first axis over finite values; NaN where there are none."""
    return np.ma.masked_invalid(values).mean(axis=0).filled(np.nan)
