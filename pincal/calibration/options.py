"""Options of a calibration, the same for fit and validation; and its folds."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Final, Literal, get_args

import numpy as np

from pincal.errors import MeasurementError
from pincal.files.text import in_si, plain_number
from pincal.model import Measurements, Mechanism, Noise, Parameter, Setup, means
from pincal.model.checks import check_kinds, choice_of, count_of, counted, must_be
from pincal.model.setup import Systematic
from pincal.option import option
from pincal.types import Array, Index
from pincal.words.numbers import UNITS

By = Literal["region", "turn", "run"]
FOLDS = 5


def folds_of(data: Measurements, folds: int, by: By = "turn") -> Index:
    """Return the fold of each row, shape (N,); -1 for rows that are in every fit."""
    choice_of(by, get_args(By), "by", MeasurementError)
    if data.verifying.any():
        return np.where(data.verifying, 0, -1)
    if by == "run":
        names = tuple(dict.fromkeys(data.runs or ()))
        if len(names) < 2:
            raise MeasurementError("runs are left out by a column 'run' with at least two in it")
        return np.array([names.index(run) for run in data.runs or ()])
    places = clusters(data)
    # each point is touched in other folds, too
    sets = list(zip(data.sets or ("",) * len(data), *data.touched, strict=True))
    groups: dict[tuple[str, ...], dict[str, list[int]]] = {}
    for row, (chosen, place) in enumerate(zip(sets, places, strict=True)):
        groups.setdefault(chosen, {}).setdefault(place, []).append(row)
    most = max(len(poses) for poses in groups.values())
    if not 2 <= count_of(folds, "folds", MeasurementError) <= most:
        raise MeasurementError(
            f"{counted(most, 'pose')}{' of a set' * bool(data.sets)} cannot be held out in {folds} "
            "folds; expected at least two folds, and a pose in each"
        )
    folds_of_rows = np.zeros(len(data), dtype=np.intp)
    for poses in groups.values():
        fold_of_pose = np.arange(len(poses)) % folds
        if by == "region":
            readings = data.readings[[rows[0] for rows in poses.values()]]
            measured = np.isfinite(readings)
            low = np.min(readings, axis=0, where=measured, initial=np.inf)
            high = np.max(readings, axis=0, where=measured, initial=-np.inf)
            with np.errstate(invalid="ignore"):  # relative to the ranges, 0.5 without a range
                shares = np.nan_to_num((readings - low) / (high - low), nan=0.5)
            fold_of_pose = _regions(shares, min(folds, len(poses)))
        for rows, fold in zip(poses.values(), fold_of_pose, strict=True):
            folds_of_rows[rows] = fold
    return folds_of_rows


def clusters(data: Measurements) -> list[str]:
    """Return the pose of each row, by its name or by equal readings, length N."""
    if data.places is None:
        return [row.tobytes().hex() for row in data.readings]
    return [place or str(row) for row, place in enumerate(data.places)]  # unnamed rows are single


def _regions(readings: Array, count: int) -> Index:
    """Return the region of each row, shape (N,), by repeated halving along the widest reading."""
    if count == 1:
        return np.zeros(len(readings), dtype=np.intp)
    order = np.argsort(readings[:, np.ptp(readings, axis=0).argmax()], kind="stable")
    first = count // 2
    low, high = np.split(order, [round(len(order) * first / count)])
    folds_of_rows = np.empty(len(readings), dtype=np.intp)
    folds_of_rows[low] = _regions(readings[low], first)
    folds_of_rows[high] = first + _regions(readings[high], count - first)
    return folds_of_rows


Method = Literal["all-legs", "per-leg"]
"""All legs together from every row, or each leg alone."""
Poses = Literal["own", "all"]
Loss = Literal["none", "reject"]
Progress = Callable[[str], None] | None
AUTO: Final = "auto"
"""Terms are to be found from the measurements."""

Tolerance = Mapping[str, float]


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of a calibration; the default is the best that the measurements allow."""

    method: Method = option(
        "all-legs",
        "Identify all legs together from every row, with poses as unknowns that may be measured in "
        "part or not at all; or each leg alone at measured poses: the papers' divide and conquer.",
    )
    poses: Poses = option(
        "own", "With --method per-leg: for each leg the poses of its set (own), or all."
    )
    noise: Noise | None = None
    """Standard deviations of the measurements. If neither this nor the measurements give them, they
    are taken from repeated rows, or else estimated by group from the residuals."""
    setup: Setup = field(default_factory=Setup)
    """What was measured: unknown frame, targets, distances, instruments."""
    loss: Loss = option("none", "Rows that do not fit count too (none), or are left out (reject).")
    fixed: tuple[str, ...] = option(
        (), "Hold a parameter: l of every leg, leg_1.l of one; leg_1.*, A_*.", metavar="NAME"
    )
    tied: tuple[str, ...] = option((), "One value for all legs.", metavar="NAME")
    priors: Mapping[str, Any] = option(
        dict,
        "Nominal value known to ± SIGMA [m, rad or 1], or as 0.5mm.",
        metavar="NAME=SIGMA",
        kind=tuple[str, ...],
    )
    """In Python a mapping in SI units, ``{"l": 5e-4}``."""
    tolerance: Tolerance = option(
        dict,
        "How far machines differ from the drawing: a prior for all parameters, by unit (a third "
        "number: gains).",
        metavar="0.5mm,5mrad",
        kind=str | None,
    )
    """Standard deviations by unit, ``{"m": 5e-4, "rad": 5e-3}`` (``"1"``: gains), or a text such as
    ``"0.5mm,5mrad"``, of parameters without a prior, except amplitudes of terms."""
    terms: tuple[str, ...] = option(
        (),
        "Terms to add to sensors: harmonics:1,2, period:5mm, polynomial, backlash, gravity, a "
        "column such as temperature; to lengths: leg_1.l=temperature, growth=temperature; auto: "
        "those that help (pincal explain).",
        metavar="[LEG=]KIND",
    )
    rough: bool = option(
        False,
        "The nominal mechanism is only roughly known: units, signs and the order of legs are not "
        "checked.",
    )
    strict: bool = option(
        False,
        "Stop if parameters are not determined, and name them, instead of holding them near "
        "nominal.",
    )
    folds: int = option(
        FOLDS, "Folds of held-out validation and of the choice of terms; 0: no validation.", least=0
    )
    progress: Progress = field(default=None, compare=False, repr=False)
    """Called with a text that says what is being done."""

    def __post_init__(self) -> None:
        for name, known in _CHOICES.items():
            choice_of(getattr(self, name), get_args(known), name, MeasurementError)
        for name in ("fixed", "tied", "terms"):
            texts = must_be(getattr(self, name), Iterable, name, MeasurementError)
            object.__setattr__(self, name, (texts,) if isinstance(texts, str) else tuple(texts))
        object.__setattr__(self, "tolerance", _tolerance(self.tolerance))
        object.__setattr__(self, "priors", _parse_priors(self.priors))
        check_kinds(vars(self), Options, MeasurementError)
        if self.folds < 0 or self.folds == 1:
            raise MeasurementError(
                f"--folds {self.folds}: expected 2 or more, or 0 for no held-out validation; "
                "models are compared on at least two folds"
            )
        if not (self.latent or (self.setup.plain and self.setup.systematic == Systematic())):
            raise MeasurementError(
                "unknown frames, targets, distances, contacts, instruments and systematic errors "
                "need all legs at once; leave out --method per-leg"
            )

    @classmethod
    def of(cls, options: Options | None = None, **given: Any) -> Options:
        """Return options from keywords; unknown_frame and unknown_target go into the setup.

        Raises:
            MeasurementError: an option is unknown, or its value.
        """
        unknowns = {name: given.pop(f"unknown_{name}", False) for name in ("frame", "target")}
        known = [option.name for option in fields(cls)]
        if unknown := [name for name in given if name not in known]:
            raise MeasurementError(f"no option {unknown[0]!r}; expected some of {', '.join(known)}")
        given = {name: value for name, value in given.items() if value is not None}
        options = must_be(cls() if options is None else options, cls, "options", MeasurementError)
        chosen = replace(options, **given)
        return replace(chosen, setup=chosen.setup.anywhere(**unknowns))

    def priors_of(self, parameters: Sequence[Parameter]) -> dict[str, float]:
        """Return the priors in SI by name; raise if one is not a number in the parameter's unit."""
        priors: dict[str, float] = {}
        for name, sigma in dict[str, Any](self.priors).items():
            units = {p.unit for p in parameters if means(name, p.owner, p.name)}
            dimensions = " ".join((units or {"m", "rad"}) - {"1"})
            try:
                priors[name] = in_si(sigma, dimensions) if isinstance(sigma, str) else sigma
            except MeasurementError:
                unit = f"; {name} is in {next(iter(units))}" if len(units) == 1 else ""
                raise MeasurementError(
                    f"--priors {f'{name}={sigma}'!r}: expected a name and a standard deviation, "
                    f"such as l=0.0005 [m] or l=0.5mm{unit}"
                ) from None
        return priors

    def priors_by_name(self, mechanism: Mechanism) -> dict[str, float]:
        """Return standard deviations about nominal by ids (tolerances) and names (priors)."""
        tolerances = {
            parameter.id: self.tolerance[parameter.unit]
            for parameter in mechanism.parameters
            if parameter.unit in self.tolerance and parameter.id not in mechanism.amplitudes
        }
        return {**tolerances, **self.priors}

    @property
    def every_pose(self) -> bool:
        """Whether every pose is used for every leg."""
        return self.method == "all-legs" or self.poses == "all"

    @property
    def latent(self) -> bool:
        """Whether poses are unknowns rather than taken as measured."""
        return self.method == "all-legs"

    @property
    def rejects(self) -> bool:
        """Whether rows that do not fit are left out."""
        return self.loss == "reject"

    def report(self, what: str) -> None:
        """Report what is being done."""
        if self.progress is not None:
            self.progress(what)


_CHOICES = {"method": Method, "poses": Poses, "loss": Loss}


def _parse_priors(priors: Mapping[str, Any] | Iterable[str]) -> Mapping[str, Any]:
    """Return standard deviations by name; texts such as ``l=0.5mm`` are split, not converted."""
    if isinstance(priors, Mapping):
        return priors
    by_name: dict[str, str] = {}
    for text in must_be(priors, Iterable, "priors", MeasurementError):
        entry = must_be(text, str, "priors", MeasurementError)
        name, _, sigma = map(str.strip, entry.partition("="))
        if name in by_name:
            raise MeasurementError(f"--priors {name} is said twice; leave out one of them")
        by_name[name] = sigma
    return by_name


def _tolerance(tolerance: Mapping[str, float] | str) -> Tolerance:
    """Return standard deviations by unit, also from a text ``0.5mm,5mrad,0.001``."""
    by_unit = _parse_tolerance(tolerance) if isinstance(tolerance, str) else tolerance
    for unit, sigma in must_be(by_unit, Mapping, "tolerance", MeasurementError).items():
        if unit not in ("m", "rad", "1") or not 0.0 < sigma < np.inf:
            raise MeasurementError(
                f"tolerance {{{unit!r}: {sigma!r}}}: expected standard deviations above 0 of "
                "'m', 'rad' or '1', such as {'m': 5e-4, 'rad': 5e-3}"
            )
    return by_unit


def _parse_tolerance(text: str) -> dict[str, float]:
    by_unit: dict[str, float] = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        unit = re.sub(r"^[-+\d.eE]*", "", part).strip()
        dimension = UNITS.get(unit or "1", ("", 0.0))[0]
        bare = not unit and not by_unit
        if bare or dimension not in ("m", "rad", "1") or dimension in by_unit:
            raise MeasurementError(
                f"--tolerance {text}: {part!r} {'has no unit' if bare else 'is not understood'}; "
                "expected one number for lengths, one for angles, and after them one without a "
                "unit for gains, such as 0.5mm,5mrad,0.001"
            )
        by_unit[dimension] = in_si(part, dimension) if unit else plain_number(part)
    return by_unit
