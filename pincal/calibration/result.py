"""The result of a calibration: parameters with uncertainties, and what they were made from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pincal.attached import attached
from pincal.calibration.calibration import Calibration
from pincal.calibration.options import FOLDS, By, Options
from pincal.calibration.promise import excess_of, expected_error
from pincal.calibration.result_parts import IdentifiedParameter, ResidualGroup, Validation
from pincal.design.platform_error import PlatformError
from pincal.estimation.fit import Outlier
from pincal.estimation.unknowns import External
from pincal.finding import Finding
from pincal.kinematics.configurations import check_reached
from pincal.model import ORIGIN, Measurements, Mechanism, Noise, Plan, Poses
from pincal.model.parameter import Parameters
from pincal.types import Array
from pincal.words.findings import WORDINGS, sentences
from pincal.words.numbers import rounded

if TYPE_CHECKING:
    from pincal.show.charts import Plots
    from pincal.show.report import Report
    from pincal.words.table import Table


_PROMISED = 3.0  # residuals over the given noise, up to which the noise may just be larger
_MISSED = 0.01  # standard deviations below which residuals are negligible
_FELL = 0.5  # share of the residuals that may remain if anything was corrected
#: Findings that contradict the model or its noise.
CONTRADICTING = {code for code, wording in WORDINGS.items() if wording.title} - {"few-poses"}


@dataclass(frozen=True, repr=False, eq=False)
class CalibrationResult:
    """Result of ``calibrate``; holds the mechanism, measurements and options it was made from.

    Example:
        >>> import numpy as np, pincal
        >>> places = [[x, y] for x in (-0.3, 0.0, 0.3) for y in (1.0, 1.1, 1.2, 1.3)]
        >>> plan = pincal.Plan(np.array(places))
        >>> truth = pincal.disturb("5R", 1e-3, seed=1)
        >>> data = pincal.simulate("5R", truth, plan, seed=1).measurements
        >>> result = pincal.calibrate("5R", data, noise=pincal.Noise(position=1e-4))
        >>> result.converged, len(result.parameters)
        (True, 12)
        >>> result["leg_1.l"].unit
        'm'
    """

    calibration: Calibration
    legs: tuple[ResidualGroup, ...]
    external: tuple[IdentifiedParameter, ...]
    """The base in the frame of the measurements (``tracker.x`` …, a rotation vector), and the
    targets on the platform (``target.x`` …)."""
    covariance: Array
    """Covariance of the legs' parameters, legs in order, shape (n, n); only of the determined
    directions, where others were held."""
    noise: Noise | None
    """Standard deviations, given or estimated, of all rows; None if rows have their own."""
    noise_source: str
    """``"given"``, ``"rows"``, ``"repeats"`` of rows, or ``"estimated"`` from the residuals."""
    degrees_of_freedom: int
    reduced_chi2: float
    """χ² over degrees of freedom, near 1 if the noise is as given or was estimated."""
    chi2_p_value: float
    """Probability of such a χ² or a larger one; by F where repeated rows show the noise."""
    chi2_freedoms: float
    """Degrees of freedom of that test; fewer than of χ² where legs alone share noise of poses."""
    noise_freedoms: float | None
    """Fewest degrees of freedom of the noise in a standard error; None if the noise is known."""
    left: float
    """Distance from the optimum where the search ended, to first order, in standard errors."""
    converged: bool
    systematic: Array | None
    """Part of the covariance that is off by the same in all rows (type B), shape (n, n)."""
    outliers: tuple[Outlier, ...]
    """Rows that do not fit the others, the worst first."""
    misses: tuple[float, float]
    """By how much rows are missed by fits without them, to first order, [m] and [rad]: root mean
    squares over targets, without rejected rows and known noise; NaN of what was not measured."""
    gauge: tuple[Finding, ...]
    """What was fixed by choice, since no such measurement can observe it."""
    gauge_directions: Array | None
    """Directions of the legs' parameters along which that choice was made, shape (n, n_gauge)."""
    frames_moved: Array | None
    """Motions of frames that these are (see ``estimation.observability.gauge.split_frames``)."""
    undetermined_directions: Array | None
    """Directions of the legs' parameters that were held near nominal, shape (n, n_lost)."""
    observed: tuple[ResidualGroup, ...]
    """How the measured quantities of the platform fit, where poses were unknowns."""
    outside: External | None
    """Values of frame, targets and instruments behind ``external``, if they were unknown."""
    estimated_poses: Array | None
    """Poses of all rows in the base frame, shape (N, dof), where they were unknowns."""
    findings: tuple[Finding, ...] = ()
    """Warnings and remarks as data."""
    validation: Validation | None = None
    """Errors at held-out rows, if these were asked for."""

    @property
    def nominal(self) -> Mechanism:
        """The nominal mechanism."""
        return self.calibration.mechanism

    @cached_property
    def identified(self) -> Mechanism:
        """The calibrated mechanism."""
        return self.calibration.identified(np.concatenate([leg.identified for leg in self.legs]))

    @property
    def measured_frames(self) -> tuple[Array, Array]:
        """``T_frame_base`` of the measurements, and ``T_platform_tool`` of the measured point."""
        frame, tool = np.eye(4), np.eye(4)
        tool[:3, 3] = self.options.setup.targets[ORIGIN].offset
        if self.outside is not None:
            frame = self.outside.frame
            tool[:3, :3], tool[:3, 3] = self.outside.turn, self.outside.offsets[0]
        return frame, tool

    def in_base(self, poses: Poses) -> Array:
        """Return poses of the platform in the base frame, shape (N, dof).

        ``poses`` are coordinates or transforms of the measured point in the measurements' frame.
        """
        (frame, tool), platform = self.measured_frames, self.nominal.platform
        measured = platform.matrices(poses).copy()
        if not platform.turns:  # its orientation is fixed
            measured[:, :3, :3] = (frame @ tool)[:3, :3]
        return platform.from_matrices(np.linalg.inv(frame) @ measured @ np.linalg.inv(tool))

    @property
    def begun(self) -> Mechanism:
        """The mechanism where the search began: nominal, except zeros of motors that were found."""
        start = self.calibration.start
        return self.nominal if start is None else self.calibration.identified(start)

    @property
    def measurements(self) -> Measurements:
        """The measurements."""
        return self.calibration.measurements

    @property
    def options(self) -> Options:
        """The options of the calibration."""
        return self.calibration.options

    @property
    def method(self) -> str:
        """``"all-legs"`` or ``"per-leg"``."""
        return self.options.method

    @property
    def loss(self) -> str:
        """``"reject"`` if rows that do not fit were left out, else ``"none"``."""
        return self.options.loss

    @cached_property
    def parameters(self) -> Parameters:
        """All identified parameters, of the legs in order, then outside the mechanism."""
        return Parameters([*(p for leg in self.legs for p in leg.parameters), *self.external])

    def __getitem__(self, key: str) -> IdentifiedParameter:
        """Return a parameter by its id, ``result["leg_1.l"].std``, or raise a MechanismError."""
        return self.parameters[key]

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings as sentences."""
        return tuple(sentences(self.findings, "warning", "error"))

    @property
    def message(self) -> str:
        """Whether the search converged, in a sentence."""
        if self.converged:
            return "converged"
        return f"did not converge: the next step would be {self.left:.2g} standard errors"

    @property
    def parameter_covariance(self) -> Array:
        """Covariance of the parameters, NaN where they are not determined, shape (n, n)."""
        known = np.isfinite(np.concatenate([leg.std for leg in self.legs]))
        return np.where(np.outer(known, known), self.covariance, np.nan)

    @property
    def excess(self) -> float:
        """Factor by which residuals, and so standard errors, are larger than by the given noise.

        It is 1 if the noise explains them, or was estimated from them.
        """
        return excess_of(self.reduced_chi2, self.chi2_p_value)

    @property
    def explained(self) -> bool:
        """Whether residuals are near enough to the noise for uncertainties to have a meaning."""
        return self.excess <= _PROMISED and self.corrects

    @property
    def contradictions(self) -> tuple[Finding, ...]:
        """Findings that contradict the model or its noise, so that no limit is promised.

        Some leave it unproved: fewer equations than unknowns, or terms that were chosen by these
        measurements, which only held-out rows can confirm.
        """
        held = self.undetermined_directions
        codes = set(CONTRADICTING)
        if held is not None and self.degrees_of_freedom < held.shape[1]:
            codes.add("few-poses")
        if self.validation is not None:
            codes.remove("terms-chosen")
        return tuple(remark for remark in self.findings if remark.code in codes)

    @property
    def promises(self) -> bool:
        """Whether limits are promised, since nothing contradicts the model or its noise."""
        return self.explained and not self.contradictions

    @property
    def corrects(self) -> bool:
        """Whether residuals fell by at least half, in standard deviations, or are noise."""
        return self.excess == 1.0 or self.halves_residuals

    @property
    def halves_residuals(self) -> bool:
        """Whether residuals fell by at least half, in standard deviations."""
        before, after = _whitened(self.legs)
        if np.abs(before).max(initial=0.0) <= _MISSED:  # poses made from readings: they close
            before, after = _whitened([*self.legs, *self.observed])
        return bool((after**2).sum() <= _FELL**2 * (before**2).sum())

    def leg(self, name: str) -> ResidualGroup:
        """Return the result of one leg by name."""
        return self.legs[self.nominal.leg_names.index(self.nominal.leg(name).name)]

    @property
    def moves_frames(self) -> bool:
        """Whether the base or platform frame is unknown, or was placed by ``gauge``."""
        gauge = any(freedom.code.startswith("gauge-") for freedom in self.gauge)
        return gauge or len(self.calibration.observation.external) > 0

    def expected_error(self, poses: Plan | Array | None = None) -> PlatformError:
        """Return the expected platform error of the calibrated mechanism.

        Motions of frames that were fixed by choice do not count as errors. The error is infinite
        where held directions move the platform more than at the measured poses. While something
        contradicts the model, no limit is promised, and errors are by ``misses``.

        Args:
            poses: Poses over which to take the mean, coordinates of shape (N, dof), or a plan; by
                default the measured configurations.

        Raises:
            MechanismError: poses have a wrong shape, or are not finite.
        """
        error = expected_error(self, poses)
        if poses is not None and not error.poses:
            check_reached(self.identified, poses, "the poses")
        return error

    @property
    def poses(self) -> Array:
        """Poses of all rows in the base frame, measured or estimated, shape (N, dof)."""
        estimated = self.estimated_poses
        return self.measurements.poses if estimated is None else estimated

    @attached
    def validated(self, folds: int = FOLDS, by: By = "region") -> CalibrationResult:
        """Return the result with its errors at held-out rows, and findings on them.

        Rows whose ``set`` is ``verify`` are held out, if there are any. Otherwise each fold is left
        out in turn, with rows of every ``set``, and all rows of a ``pose`` together. Rejected rows
        are not counted.

        Args:
            folds: How many times a share of the rows is held out.
            by: ``"region"``: neighbours in the space of readings, so that no error of the model is
                hidden by rows nearby; ``"turn"``: rows in turn; ``"run"``: runs of the experiment.

        Raises:
            MeasurementError: there are too few rows or folds, or a fold does not converge.
            ObservabilityError: the remaining rows do not determine the parameters.
        """

    @attached
    def report(self, **origin: Any) -> Report:
        """Return the report as a page, with ``html()`` and ``save(path)``; notebooks show it.

        Options are ``command``, ``files`` and ``date``, which the page names; and ``workspace``,
        poses or their file for mean errors.

        Raises:
            PincalError: a file cannot be read.
        """

    @property
    @attached
    def plot(self) -> Plots:
        """Plots of this result, such as ``plot.residuals()``: each returns matplotlib axes."""

    @attached
    def tables(self) -> list[Table]:
        """Return all tables: parameters, frames and targets, residuals, outliers."""

    @attached
    def _repr_html_(self) -> str:
        """Return verdict, errors and tables for notebooks."""

    def __repr__(self) -> str:
        ended = "converged" if self.converged else "did not converge"
        return (
            f"CalibrationResult({self.nominal.name!r}, {len(self.parameters)} parameters, "
            f"reduced χ² {rounded(self.reduced_chi2, 3)}, {ended})"
        )

    def __str__(self) -> str:
        """Return what ``pincal calibrate`` prints: verdict, errors, warnings, next command."""
        return str(self.report())

    @attached
    def save(
        self, folder: str | Path, *, force: bool = False, report: Report | None = None
    ) -> Path:
        """Write the result to a folder, completely or not at all; ``load_result`` reads it.

        Args:
            folder: The folder.
            force: Whether to replace an existing result.
            report: Page of ``result.report()`` to write there as ``report.html``.

        Raises:
            FileError: the folder exists and ``force`` is not set, or it cannot be written.
        """


def _whitened(groups: Sequence[ResidualGroup]) -> tuple[Array, Array]:
    """Return residuals before and after in standard deviations, of quantities with noise."""
    parts = [(group.residuals_before, group.residuals, group.sigma) for group in groups]
    before, after, sigma = (np.concatenate(part) for part in zip(*parts, strict=True))
    noisy = sigma > 0.0
    return before[noisy] / sigma[noisy], after[noisy] / sigma[noisy]
