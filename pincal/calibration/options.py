"""What a calibration is asked to do: one set of options for calibrate, validate and compare."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Final, Literal, get_args

import numpy as np

from pincal.design.information import Method
from pincal.errors import MeasurementError
from pincal.estimation.blocks.legs import Residual
from pincal.estimation.residuals.losses import Loss, LossName, loss_of
from pincal.model.measurements import Measurements, Noise
from pincal.model.setup import Setup
from pincal.types import Array, Index

By = Literal["region", "turn", "run"]
FOLDS = 5


def folds_of(data: Measurements, folds: int, by: By = "turn") -> Index:
    """Return the fold of each row, shape (N,); -1 of rows that are seen by every fit.

    Raises:
        MeasurementError: too few rows, or fewer than two folds or runs.
    """
    if data.verifying.any():
        return np.where(data.verifying, 0, -1)
    if by == "run":
        names = tuple(dict.fromkeys(data.runs or ()))
        if len(names) < 2:
            raise MeasurementError("runs are left out by a column 'run' with at least two in it")
        return np.array([names.index(run) for run in data.runs or ()])
    places = clusters(data)
    sets = data.sets or ("",) * len(data)
    groups: dict[str, dict[str, list[int]]] = {}
    for row, (chosen, place) in enumerate(zip(sets, places, strict=True)):
        groups.setdefault(chosen, {}).setdefault(place, []).append(row)
    most = max(len(poses) for poses in groups.values())
    if not 2 <= folds <= most:
        raise MeasurementError(
            f"{folds} folds of {most} poses; expected at least two folds, and no more than there "
            "are poses"
        )
    found = np.zeros(len(data), dtype=np.intp)
    for poses in groups.values():
        firsts = np.array([rows[0] for rows in poses.values()])
        own = np.arange(len(poses)) % folds
        if by == "region":
            own = _regions(_scaled(data.readings[firsts]), min(folds, len(poses)))
        for rows, fold in zip(poses.values(), own, strict=True):
            found[rows] = fold
    return found


def clusters(data: Measurements) -> list[str]:
    """Return the pose of each row: by its name, or by equal readings; length N."""
    if data.places is None:
        return [row.tobytes().hex() for row in data.readings]
    return [place or str(row) for row, place in enumerate(data.places)]  # an empty one is its own


def _scaled(readings: Array) -> Array:
    """Return readings over the ranges that they have, in the middle where there is none, (N, n)."""
    measured = np.isfinite(readings)
    low = np.min(readings, axis=0, where=measured, initial=np.inf)
    high = np.max(readings, axis=0, where=measured, initial=-np.inf)
    some = high > low
    shares = (readings - np.where(some, low, 0.0)) / np.where(some, high - low, 1.0)
    return np.where(measured & some, shares, 0.5)


def _regions(readings: Array, count: int) -> Index:
    """Return the region of each row, shape (N,): halves of halves along the widest reading."""
    if count == 1:
        return np.zeros(len(readings), dtype=np.intp)
    spread = np.ptp(readings, axis=0)
    order = np.argsort(readings[:, int(np.argmax(spread))], kind="stable")
    first = count // 2
    low, high = np.split(order, [round(len(order) * first / count)])
    found = np.empty(len(readings), dtype=np.intp)
    found[low] = _regions(readings[low], first)
    found[high] = first + _regions(readings[high], count - first)
    return found


Poses = Literal["own", "all"]
Intervals = Literal["wald", "profile"]
Progress = Callable[[str], None] | None
AUTO: Final = "auto"
"""What is found by the measurements: terms that pay, the size of tolerances."""

Tolerance = Mapping[str, float] | Literal["auto"]


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of a calibration; the default is the best that the measurements allow."""

    method: Method = "all-legs"
    """``"all-legs"`` identifies all legs at once from every row, each pose an unknown of which any
    part, or none, was measured. ``"per-leg"`` identifies each leg alone, poses as measured: the
    papers' divide and conquer."""
    residual: Residual = "closure"
    """``"closure"``, whitened by its noise, or ``"joint"``: predicted less measured reading,
    unweighted, poses as measured, as the papers have it."""
    poses: Poses = "own"
    """With ``"per-leg"``: each leg by the poses chosen for it (their ``set``), or by all."""
    noise: Noise | None = None
    """Standard deviations of the measurements. If neither this nor the measurements give them, they
    are taken from repeated rows, or else estimated by group from the residuals."""
    setup: Setup = field(default_factory=Setup)
    """What the measured numbers mean: unknown frame, targets, distances."""
    loss: LossName | Loss = "none"
    """A robust loss by which rows that do not fit count less: ``"huber"``, ``"cauchy"``,
    ``"tukey"``, or a ``Loss`` of one's own; ``"reject"`` leaves them out."""
    fixed: tuple[str, ...] = ()
    """Parameters held at their nominal values: ``"l"`` of every leg, ``"leg_1.l"`` of one."""
    tied: tuple[str, ...] = ()
    """Parameters that have one value for all legs; the result tests whether that holds."""
    priors: Mapping[str, float] = field(default_factory=dict)
    """Standard deviations with which nominal values are known, by name as above."""
    tolerance: Tolerance = field(default_factory=dict)
    """How far machines of this drawing differ from it, by unit: ``{"m": 5e-4, "rad": 5e-3}``, a
    standard deviation for each parameter of that unit (``"1"``: gains) that has no prior of its
    own and is no amplitude of a term. With few poses it predicts better than free parameters.
    ``"auto"`` finds these with the parameters, as variance components."""
    terms: tuple[str, ...] = ()
    """What sensors lack, added to the mechanism: ``"gravity"`` or ``"harmonics:1,2"`` of every
    reading, ``"leg_1=backlash"`` of one, or a column such as ``"temperature"``; ``"auto"`` takes
    those that pay on rows held out (see ``explain``)."""
    rough: bool = False
    """Whether the nominal mechanism is known so roughly that measurements need not look like its
    own; units, signs and the order of legs are then not checked."""
    hold_undetermined: bool = False
    """Whether directions of parameters that the measurements cannot observe are held as near to
    nominal as can be, and named; else they are refused."""
    folds: int = FOLDS
    """How many times a share of the poses is held out where models are compared, as by
    ``terms="auto"``; 2 or more."""
    intervals: Intervals = "wald"
    """Ends of the 95 % intervals: ``"wald"``, the estimate ± so many standard errors, or
    ``"profile"``, where the cost with a parameter held, all others fitted again, has risen as far:
    for problems that are curved within their uncertainty."""
    progress: Progress = field(default=None, compare=False, repr=False)
    """Called with what is being done."""

    def __post_init__(self) -> None:
        for name, known in _CHOICES.items():
            given = getattr(self, name)
            if given not in get_args(known):
                raise MeasurementError(
                    f"unknown {name} {given!r}; expected one of {', '.join(get_args(known))}"
                )
        loss_of(self.loss)  # raises where there is no such loss
        for name, kind in (("noise", Noise | None), ("setup", Setup)):
            given = getattr(self, name)
            if not isinstance(given, kind):
                what = "Noise" if name == "noise" else "Setup"
                raise MeasurementError(
                    f"{name} is {type(given).__name__}; expected pincal.{what}(…)"
                )
        by_unit = self.tolerance
        if isinstance(by_unit, str) and by_unit != AUTO:
            raise MeasurementError(
                f"tolerance {by_unit!r}: expected standard deviations by unit, such as "
                "{'m': 5e-4, 'rad': 5e-3}, or 'auto'"
            )
        for unit, sigma in () if isinstance(by_unit, str) else by_unit.items():
            if unit not in ("m", "rad", "1") or not 0.0 < sigma < np.inf:
                raise MeasurementError(
                    f"tolerance {{{unit!r}: {sigma!r}}}: expected standard deviations above 0 of "
                    "'m', 'rad' or '1', such as {'m': 5e-4, 'rad': 5e-3}"
                )
        if not isinstance(self.folds, int) or self.folds < 2:
            raise MeasurementError(
                f"folds is {self.folds!r}; expected at least two folds: models are compared on "
                "rows held out"
            )
        if self.setup.instruments and not self.latent:
            raise MeasurementError(
                "instruments need all legs at once and the closure residual; leave out "
                "method='per-leg' and residual='joint'"
            )
        if self.intervals == "profile" and not (self.latent or self.setup.plain):
            raise MeasurementError(
                "profile intervals of legs alone need poses measured in the base frame; identify "
                "all legs at once (leave out --per-leg), or leave out --intervals profile"
            )
        for name in ("fixed", "tied", "terms"):
            given = getattr(self, name)
            if isinstance(given, str):
                given = (given,)
            object.__setattr__(self, name, tuple(given))

    @classmethod
    def of(cls, options: Options | None = None, **given: Any) -> Options:
        """Return options from keywords.

        Raises:
            MeasurementError: unknown options or values.
        """
        known = {option.name: option for option in fields(cls)}
        if unknown := [name for name in given if name not in known]:
            raise MeasurementError(f"no option {unknown[0]!r}; expected some of {', '.join(known)}")
        given = {name: value for name, value in given.items() if value is not None}
        if options is not None:
            given = {one: getattr(options, one) for one in known} | given
        return cls(**given)

    @property
    def every_pose(self) -> bool:
        """Whether every pose serves every leg."""
        return self.method == "all-legs" or self.poses == "all"

    @property
    def latent(self) -> bool:
        """Whether poses are unknowns, or taken as measured."""
        return self.method == "all-legs" and self.residual == "closure"

    def report(self, what: str) -> None:
        """Say what is being done."""
        if self.progress is not None:
            self.progress(what)


_CHOICES = {"method": Method, "residual": Residual, "poses": Poses, "intervals": Intervals}
