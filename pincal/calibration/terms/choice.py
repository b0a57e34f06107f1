"""Which terms pay: models compared on held-out rows, the simplest of the best kept.

Models are nested: the machine as drawn, its geometry identified, and one kind of term more each
time, the one that the screen of the residuals names first. Each fold goes this way by the rows that
it sees, so that the choice itself is held out (M. Stone 1974); rows of one pose are together. All
grow at once, and no further where two terms in turn have predicted held-out rows no better.
The simplest model within one standard error of the best is taken (L. Breiman et al., Classification
and Regression Trees, 1984): a term that does not pay is not kept, however probable it is.
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
from pincal.estimation.observability.courses import Slip, slips
from pincal.types import Array, Mask

LEVEL = 0.01
"""Probability by chance, of all tests of a screen, below which a term is tried."""
_MOST_TERMS = 8  # one after the other
_IN_VAIN = 2  # terms by which held-out rows are predicted no better, after which none is tried
_PINNED = 1e-12  # how well a parameter that is as drawn is known, [m], [rad] or [1]
_TROUBLE = (PincalError, np.linalg.LinAlgError)  # what rows that do not determine a model raise


@dataclass(frozen=True)
class Model:
    """One of the models compared: its fit of all rows, and how it predicts held-out rows."""

    name: str
    """``"as drawn"`` (``"rigid alignment"`` where frame or target are unknown), ``"geometry"``, or
    what was added last."""
    fits: Fits = field(repr=False)
    added: tuple[Pair, ...] = ()
    """All terms that the mechanism given has not: place and kind."""
    chance: float = 1.0
    """Probability by chance of the last term when it was added, the number of tests taken in."""
    held_out: float = np.nan
    """Root mean square of white residuals of held-out rows, [σ]; NaN if no fold is identified."""
    spread: float = 0.0
    """Standard error of how much larger that is than the best model's, poses as clusters, [σ]."""
    position: float = np.nan
    """Root mean square by which targets are missed at held-out rows, [m]; NaN if not measured."""
    orientation: float = np.nan
    """The same of the measured orientation, [rad]."""

    @property
    def parameters(self) -> int:
        """Number of free parameters: not those that are as drawn."""
        unknowns = [fit.unknowns for fit in self.fits.fits]
        return sum(
            unknown.map.shape[1] - int((unknown.priors <= _PINNED).sum()) for unknown in unknowns
        )

    def errors(self, held: Calibration) -> Array:
        """Return squares and numbers of white residuals at held-out rows, and of misses, (N, 4)."""
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
    """What residuals of a calibration follow, and which model predicts rows best.

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
    """Those compared, in the order of their size."""
    chosen: int
    """Index of the simplest within one standard error of the best."""
    candidates: Sequence[Candidate]
    """The screen of the geometry's residuals."""
    slips: Sequence[Slip]
    """What slipped or drifted, unless a term explains it better; rows those of the measurements."""
    lost: Sequence[tuple[int, str]]
    """Folds, from 0, that are not compared: without their rows geometry is not identified; why."""

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
        """The terms that pay, as options say them: ``leg_2=harmonics:1``, ``leg_1.l=warm``."""
        return tuple(term_text(*term) for term in self.model.added)

    @attached
    def __str__(self) -> str:
        """Return a page: what residuals follow, the models compared, and what to do."""

    def __repr__(self) -> str:
        chosen = ", ".join(self.terms) or self.verdict
        return f"Explanation({self.result.nominal.name!r}: {chosen})"


def choose(
    calibration: Calibration, pairs: Sequence[Pair], fits: Fits | None = None
) -> tuple[list[Model], int, list[Candidate], list[Slip], list[tuple[int, str]]]:
    """Return which terms pay, of places and kinds: an ``Explanation``'s fields behind its result.

    Of a calibration that is ``started``, by its fits of all rows if they are known. Rows whose
    ``set`` is ``verify`` have no part in the choice.
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
        errors = np.append(errors, errors[-1:], axis=0)  # a path that ended stays where it is
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
    """Yield models that grow by the likeliest term of a screen, the first one the geometry's."""
    fits, added = geometry, tuple[Pair, ...]()
    every = np.ones(len(fits.calibration.measurements), dtype=bool)
    while likely := [candidate for candidate in candidates if candidate.corrected < LEVEL]:
        added = (*added, likely[0].pair)
        longer = replace(extended(geometry.calibration, added), start=None)
        try:
            fits = converged(longer, "the search", fits, every)
        except _TROUBLE:  # what the rows do not determine
            return
        yield Model("{} {}".format(*added[-1]), fits, added, likely[0].corrected)
        candidates = screen(fits, pairs)


def _errors_along(models: Sequence[Model], fitted: Mask, pairs: Sequence[Pair]) -> Iterator[Array]:
    """Yield errors of held-out rows as drawn and by geometry, raising if these fail; then on."""
    drawn, geometry = (
        converged(model.fits.calibration.rows(fitted), "the search", model.fits, fitted)
        for model in models[:2]
    )
    held = held_rows(models[1].fits.calibration, ~fitted)
    yield Model("", drawn).errors(held)
    yield Model("", geometry).errors(held)
    with suppress(*_TROUBLE):  # a path that ends there
        for model in _grown(geometry, pairs, screen(geometry, pairs)):
            yield model.errors(held)


def _slips(models: Iterable[Model]) -> list[Slip]:
    """Return what slipped or drifted, by rows of the measurements.

    By the geometry; while a term is likelier than the clearest slip, by the model with that term: a
    slip may only follow it, as terms may follow a slip.
    """
    slipped: list[Slip] = []
    for index, model in enumerate(models):
        if index and not (slipped and model.chance < slipped[0].p_value):
            break
        slipped = [
            replace(slip, row=int(fit.rows[slip.row]))
            for fit in model.fits.fits
            for slip in slips(fit)
        ]
    known = model.fits.calibration.noise.known
    return slipped if known else slipped[:1]  # or estimated with slips in it


def _compared(
    models: Sequence[Model], errors: Array, places: Sequence[str]
) -> tuple[list[Model], int]:
    """Return models, by their errors (n_models, N, 4), and which is the simplest of the best.

    Within one standard error, rows of one place being one; errors of lost folds are NaN.
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
    """Return means along the first axis of what is known; NaN where nothing is."""
    return np.ma.masked_invalid(values).mean(axis=0).filled(np.nan)
