"""A calibration to be run: mechanism, measurements and options, and the problems they pose."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from pincal.calibration.options import Options
from pincal.errors import MeasurementError, ObservabilityError
from pincal.estimation.noise import NoiseModel, noise_model
from pincal.estimation.observation import Observation
from pincal.estimation.problem import LegBlock, Problem
from pincal.estimation.start import align_start, check_start
from pincal.estimation.unknowns import State, Unknowns, unknowns
from pincal.kinematics.configurations import planned_influences
from pincal.kinematics.influences import by_name, influence_columns
from pincal.model import ROW, Measurements, Mechanism, Noise
from pincal.types import Array, Index, Mask


@dataclass(frozen=True)
class Calibration:
    """A mechanism to be identified from measurements, with options."""

    mechanism: Mechanism
    """The nominal mechanism."""
    measurements: Measurements
    options: Options = field(default_factory=Options)
    start: Array | None = field(default=None, compare=False, repr=False)
    """Parameters of all legs from which the search starts, shape (n_params,); nominal if None."""
    known_noise: NoiseModel | None = field(default=None, compare=False, repr=False)
    """Noise of these rows from an earlier fit; None for that of the options and measurements."""
    fixed_noise: bool = field(default=False, compare=False, repr=False)
    """Whether an estimated noise is not to be estimated again: it is from more rows than these."""
    lacks: bool = field(default=False, compare=False, repr=False)
    """Whether residuals said that the model lacks something: see ``tie_of``."""

    def __post_init__(self) -> None:
        mechanism, data = self.mechanism, self.measurements
        if not len(data):
            raise MeasurementError("there are no measurements; give a row for each measured pose")
        if np.isinf(data.poses).any() or np.isinf(data.readings).any():
            raise MeasurementError("a measured pose or reading is infinite")
        known = mechanism.followed - (set() if mechanism.weighs else set(mechanism.loaded))
        for name in (name for name in mechanism.influences if name not in known):
            values = data.influences.get(name, np.full(len(data), np.nan))
            if np.isnan(values).any():
                raise MeasurementError(
                    f"data row {int(np.argmax(np.isnan(values))) + 1}: {name!r} is not known, on "
                    "which terms of sensors depend; fill it in, or leave the row out"
                )

    @property
    def shift(self) -> Array:
        """Where the search starts less the nominal parameters, shape (n_params,)."""
        nominal = self.mechanism.parameters.values
        return np.zeros_like(nominal) if self.start is None else self.start - nominal

    def identified(self, parameters: Array) -> Mechanism:
        """Return the mechanism with parameters of all legs, shape (n_params,)."""
        by_id = zip(self.mechanism.parameters.ids, parameters.tolist(), strict=True)
        return self.mechanism.with_parameters(dict(by_id))

    @cached_property
    def noise(self) -> NoiseModel:
        """Standard deviations of the measurements, or where their estimate begins."""
        return self.known_noise or noise_model(
            self.mechanism, self.measurements, self.options.noise, self.options.setup
        )

    def with_noise(self, noise: Noise) -> Self:
        """Return the calibration with estimated noise; columns of pixels' noise are scaled."""
        data, before = self.measurements, self.noise
        scaled = {n: s * (noise.pixel / before.noise.pixel) for n, s in data.sigma_extra.items()}
        data = replace(data, sigma_extra=scaled)
        model = noise_model(self.mechanism, data, noise, self.options.setup)
        return replace(self, measurements=data, known_noise=replace(model, source=before.source))

    def at_this_noise(self) -> Self:
        """Return the calibration with its noise as it is, not estimated again."""
        options = replace(self.options, noise=self.noise.noise)
        return replace(self, options=options, known_noise=self.noise, fixed_noise=True)

    def with_options(self, **changes: Any) -> Self:
        """Return the calibration with other options, its noise as it is."""
        return replace(self, options=replace(self.options, **changes), known_noise=self.noise)

    def rows(self, chosen: Index | Mask) -> Self:
        """Return the calibration on some of its rows, their noise as it is."""
        noise = self.noise
        known = replace(noise, poses=noise.poses.rows(chosen), readings=noise.readings[chosen])
        return replace(self, measurements=self.measurements.rows(chosen), known_noise=known)

    @property
    def unknowns(self) -> Unknowns:
        """The unknowns of all legs, and those outside the mechanism if poses are unknown."""
        external = self.observation.external
        options, priors = self.options, self.options.priors_by_name(self.mechanism)
        known = {"fixed": options.fixed, "tied": options.tied}
        free = unknowns(self.mechanism.legs, external.names, priors=priors, **known)
        start, n = free.start.copy(), len(free.start) - len(external)
        start[:n] = start[:n] if self.start is None else self.start
        nominal = np.append(free.nominal[:n], external.coordinates(external.start))
        sigmas = np.append(free.priors[:n], external.priors)
        return replace(free, start=start, nominal=nominal, priors=sigmas)

    @cached_property
    def observation(self) -> Observation:
        """What was measured of the platform."""
        return Observation(self.mechanism, self.measurements, self.options.setup)

    @cached_property
    def used(self) -> Mask:
        """Which rows are used for which leg, shape (N, n_legs)."""
        data = self.measurements
        if self.options.latent:
            measured = np.isfinite(data.readings)
            columns = self.mechanism.reading_columns
            return np.stack([measured[:, column].all(axis=1) for column in columns], axis=1)
        if self.options.every_pose:
            return np.ones((len(data), len(self.mechanism.legs)), dtype=bool)
        serves = [data.serves(name) for name in self.mechanism.leg_names]
        return np.stack(serves, axis=1) | data.verifying[:, None]  # these predict every leg

    @cached_property
    def counts(self) -> Mask:
        """Which rows the fit uses, shape (N,): not those for verification, nor copies.

        Equal repeats of a ``pose`` count once: at a sensor's resolution they say no more.
        """
        data = self.measurements
        counted = ~data.verifying
        counted[[row for _, row in self.copies]] = False
        places, runs = (names or ("",) * len(data) for names in (data.places, data.runs))
        keys: set[tuple[str, str, bytes]] = set()
        for row, key in enumerate(zip(places, runs, self._values, strict=True)):
            counted[row] &= not key[0] or key not in keys
            keys.add(key)
        return counted

    @cached_property
    def copies(self) -> list[tuple[int, int]]:
        """Rows equal in every measured value, the first and a later one, that serve the same leg.

        Rows of one ``pose`` are repeats. So are equal readings with different poses; of these, some
        may be equal by chance.
        """
        data, groups = self.measurements, dict[tuple[str, bytes], list[int]]()
        measured = np.isfinite(np.column_stack([data.poses, *data.extra.values()])).any(axis=1)
        measured |= not measured.any() and ROW not in data.contacts
        for row in np.flatnonzero(measured & ~data.verifying).tolist():
            served = "" if data.sets is None or self.options.every_pose else data.sets[row]
            groups.setdefault((served, data.readings[row].tobytes()), []).append(row)
        pairs = [(first, row) for first, *others in groups.values() for row in others]
        if any(self._values[first] != self._values[row] for first, row in pairs):
            return []
        places = data.places or ("",) * len(data)
        return [(a, b) for a, b in pairs if not places[a] or places[a] != places[b]]

    @cached_property
    def _values(self) -> list[bytes]:
        data = self.measurements
        return [*map(bytes, np.column_stack([data.poses, data.readings, *data.extra.values()]))]

    def leg_block(
        self,
        places: Sequence[int],
        rows: Index,
        used: Mask | None = None,
        pose_roots: Array | None = None,
    ) -> LegBlock:
        """Return the residual block of some legs at some rows.

        ``used``, (N, n_legs), is which rows are used for which leg, by default all; ``pose_roots``
        are roots of the covariance of poses that are taken as measured.
        """
        mechanism = self.mechanism
        every = np.arange(len(mechanism.reading_names))
        columns = np.concatenate([every[mechanism.reading_columns[place]] for place in places])
        readings = self.measurements.readings[np.ix_(rows, columns)]
        measured = np.isfinite(readings)
        pairs = zip(readings.T, measured.T, strict=True)
        usual = [np.median(column[has]) if has.any() else 0.0 for column, has in pairs]
        return LegBlock(
            tuple(mechanism.legs[place] for place in places),
            mechanism.platform,
            np.where(measured, readings, usual),  # not used where not measured
            by_name(mechanism, self.influences[rows]),
            rows,
            np.ones((len(rows), len(places)), dtype=bool) if used is None else used,
            self.noise.readings[np.ix_(rows, columns)],
            pose_roots,
        )

    def every_leg(self, used: Mask | None = None) -> Problem:
        """Return the problem of all legs at all rows without a start; ``used`` as in leg_block."""
        rows, legs = np.arange(len(self.measurements)), range(len(self.mechanism.legs))
        noise = self.observation.row_noise(self.measurements, self.noise.noise)
        return Problem(self.leg_block(legs, rows, used), self.observation.changed(noise=noise))

    @cached_property
    def influences(self) -> Array:
        """Influence quantities of the terms, shape (N, n_influences)."""
        data = self.measurements
        values = {name: data.influences[name] for name in self.mechanism.influences}
        return influence_columns(self.mechanism, values, len(data))

    @cached_property
    def latent_problem(self) -> Problem:
        """The problem of all legs with unknown poses, at rows that determine them, no start yet."""
        problem = self.every_leg(self.used)
        leg_block, dof = problem.leg_block, problem.platform.dof
        if (problem.equations < 0).any():
            row = int(np.argmax(problem.equations < 0))
            raise MeasurementError(
                f"data row {row + 1} has {problem.equations[row] + dof} measured quantities, which "
                f"do not fix the {dof} freedoms of the platform; measure more, or leave the row out"
            )
        noisy = [(leg_block.sigma[:, part] > 0.0).any(axis=1) for part in leg_block.reading_columns]
        exact = leg_block.used & ~np.stack(noisy, axis=1)
        if (exact @ np.array(leg_block.widths) > dof).any():
            raise MeasurementError(
                f"{len(problem.legs)} exact readings contradict each other in {dof} freedoms of "
                "the platform; give the readings a standard deviation (--noise-reading)"
            )
        return problem

    def started(self, problem: Problem) -> Problem:
        """Return the problem with poses and frames from which a search may start."""
        self.options.report("finding poses and frames to start from")
        nominal = self.unknowns.start[: problem.leg_block.n_parameters]
        first = align_start(self.mechanism, problem, self.measurements, nominal)
        complete = self.options.setup.plain and np.isfinite(self.measurements.poses).all()
        if not (self.options.rough or complete):  # complete poses are checked elsewhere
            check_start(problem, first)
        return replace(problem, first=first)

    def measured_problem(self, names: Sequence[str]) -> tuple[Problem, Index]:
        """Return the problem of some legs at poses as measured, and the rows that it uses."""
        legs = [self.mechanism.leg_names.index(name) for name in names]
        used, rows = self.used[:, legs], np.flatnonzero(self.used[:, legs].any(axis=1))
        matrices = self.mechanism.platform.matrices(self.measurements.poses[rows])
        nominal = np.concatenate([self.mechanism.legs[i].nominal for i in legs])
        leg_block = self.leg_block(legs, rows, used[rows], self.noise.poses.roots[rows])
        return Problem(leg_block, self.observation.at(rows), State(nominal, matrices)), rows

    def short_legs(self) -> Iterator[tuple[str, int, int, int]]:
        """Yield legs that have too few poses: name, poses, unknowns, and how many are needed."""
        free, served = self.unknowns, self.used[self.counts].sum(axis=0)
        for leg, count in zip(self.mechanism.legs, served.tolist(), strict=True):
            of_leg = free.part([leg.name])
            n = of_leg.map.shape[1] - int(np.isfinite(of_leg.priors).sum())
            scale = not (self.noise.known or self.options.latent)
            least = -(-(n + scale) // self.mechanism.platform.equations(leg))
            if count < least:
                yield leg.name, count, n, least

    def check_counts(self) -> None:
        """Raise if a leg has too few poses, or if poses are to be complete and are not."""
        data, mechanism = self.measurements, self.mechanism
        columns = (*mechanism.platform.coordinates, *mechanism.reading_names)
        gaps = np.argwhere(np.isnan(np.column_stack([data.poses, data.readings])))
        if not self.options.latent and len(gaps):
            raise MeasurementError(
                f"data row {gaps[0, 0] + 1}: {columns[gaps[0, 1]]!r} is not measured; rows in "
                "which something is missing need all legs at once: leave out --method per-leg"
            )
        for name, count, n, least in self.short_legs():
            added = " and the scale of the noise" * (not (self.noise.known or self.options.latent))
            remedy = ". --poses all uses every pose for every leg" * (not self.options.every_pose)
            if self.options.latent and not self.noise.known:  # only the noise cannot be estimated
                remedy = (
                    ". The noise was not given, and so few rows do not show it; give it "
                    "(--noise-position, --noise-orientation, --noise-reading) to identify what "
                    "they determine, the rest held at nominal"
                )
            raise ObservabilityError(
                f"{name}: {count} measured poses for {n} parameters{added}; at least {least} are "
                f"needed, {2 * least} or more advised{remedy}"
            )


def with_followed_influences(calibration: Calibration) -> Calibration:
    """Return a calibration whose measurements have all columns that terms depend on."""
    mechanism, data = calibration.mechanism, calibration.measurements
    if not set(mechanism.influences) - set(data.influences):
        return calibration
    rows = located(calibration) if set(mechanism.loaded) - set(data.influences) else data
    followed = by_name(mechanism, planned_influences(mechanism, rows))
    data = replace(data, influences={**data.influences, **followed})
    return replace(calibration, measurements=data)


def located(calibration: Calibration) -> Measurements:
    """Return the measurements with complete poses in the base frame of the nominal machine."""
    drawing, data = calibration.mechanism.drawing, calibration.measurements
    options = Options(noise=calibration.options.noise, setup=calibration.options.setup)
    drawn = Calibration(drawing, data, options, known_noise=calibration.known_noise)
    state = align_start(drawing, drawn.latent_problem, data, drawing.parameters.values)
    return replace(data, poses=drawing.platform.from_matrices(state.matrices))
