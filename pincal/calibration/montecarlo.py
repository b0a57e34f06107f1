"""What accuracy machines of given tolerances will have: many are drawn, measured and calibrated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator

from pincal.attached import attached
from pincal.calibration.calibrate import calibrate
from pincal.calibration.many import FAILURE, Columns, Row, RowFile, Workers, add_rows
from pincal.calibration.options import Options
from pincal.calibration.promise import apart
from pincal.design.platform_error import root_mean_squares, sizes
from pincal.design.simulate import ERROR, disturb, simulate
from pincal.errors import MeasurementError
from pincal.files.measurements import as_noise, read_poses
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.model.checks import count_of
from pincal.model.measurements import Noise, Plan
from pincal.model.mechanism import Mechanism
from pincal.model.parameter import means
from pincal.types import Array
from pincal.workspace.sampling import sample_configurations

_POSES = 200  # of the workspace, over which errors are


class Cost(NamedTuple):
    """A tolerance of all parameters of a name: σ, and its shares of the mean square error."""

    name: str
    unit: str
    sigma: float
    before: float
    after: float


@dataclass(frozen=True, eq=False, repr=False)
class MonteCarlo:
    """Machines that are drawn, measured and calibrated: how far they are off, and by what."""

    mechanism: Mechanism
    plan: Plan
    workspace: Plan
    """Poses over which errors are root mean squares."""
    noise: Noise
    options: Options
    """How they are calibrated; tolerance and priors are by how much machines differ, too."""
    measured: Sequence[str] | None = None
    """Freedoms of the platform that are measured; all if None."""
    seed: int = 0
    columns: Columns = field(default_factory=dict)
    """A row of each machine, SI: errors before and after, true less nominal parameters."""
    single: Columns = field(default_factory=dict)
    """A row of each parameter: errors of a machine of which it alone is off, without noise."""

    @cached_property
    def sigmas(self) -> dict[str, float]:
        """By how much true parameters differ from nominal, by id, one standard deviation."""
        parameters, size = self.mechanism.parameters, self.mechanism.size
        if not (by_name := self.options.priors_by_name(self.mechanism)):
            return {p.id: ERROR * (size if p.unit == "m" else 1.0) for p in parameters}
        return {
            p.id: sigma
            for name, sigma in by_name.items()
            for p in parameters
            if means(name, p.owner, p.name)
        }

    @property
    def kinds(self) -> dict[str, type]:
        """What the columns of errors hold."""
        units = [unit for unit in ("m", "rad") if unit in self.mechanism.platform.units]
        errors = [f"{name} [{unit}]" for unit in units for name in ("before", "after", "worst")]
        return {FAILURE: str, **dict.fromkeys(["poses", "chi2", *errors], float)}

    def row(self, machine: int) -> Row:
        """Return the row of a machine, which its number alone determines.

        Raises:
            PincalError: it cannot be measured, or calibrated.
        """
        seeds = np.random.SeedSequence(self.seed, spawn_key=(machine,)).spawn(2)
        drawn, noisy = map(np.random.default_rng, seeds)
        truth = disturb(self.mechanism, self.sigmas, drawn)
        changes = (truth.parameters.values - self.mechanism.parameters.values).tolist()
        heads = [p.column for p in self.mechanism.parameters]
        return self.errors(truth, self.noise, noisy) | dict(zip(heads, changes, strict=True))

    def row_of(self, id_: str) -> Row:
        """Return the row of a machine of which a parameter alone is off, measured without noise."""
        value = self.mechanism.parameters[id_].nominal + self.sigmas[id_]
        return self.errors(self.mechanism.with_parameters({id_: value}), Noise(0.0, 0.0, 0.0, 0.0))

    def errors(self, truth: Mechanism, noise: Noise, seed: Generator | int = 0) -> Row:
        """Return how far a true machine is off before and after it is measured and calibrated."""
        nominal, setup, platform = self.mechanism, self.options.setup, self.mechanism.platform
        data = simulate(nominal, truth, self.plan, noise, seed, setup).measurements
        if self.measured is not None:
            turned = not set(platform.freedoms[platform.lengths :]).isdisjoint(self.measured)
            columns = zip(platform.coordinates, platform.units, strict=True)
            reads = [turned if unit == "rad" else name in self.measured for name, unit in columns]
            data = replace(data, poses=np.where(reads, data.poses, np.nan))
        result = calibrate(nominal, data, self.options)
        if not result.converged:
            raise MeasurementError(result.message)
        row: Row = {"poses": len(data), "chi2": result.reduced_chi2}
        for name, model in (("before", nominal), ("after", result.identified)):
            twists, units = apart(result, self.workspace, model, truth)
            of_poses = sizes(units, twists)
            parts = zip(("m", "rad"), root_mean_squares(of_poses), of_poses.T, strict=True)
            for unit, size, column in ((unit, *part) for unit, *part in parts if unit in units):
                row |= {f"{name} [{unit}]": size, f"worst [{unit}]": float(np.nanmax(column))}
        return row

    @property
    def known(self) -> Array:
        """Errors first told, before and after, of machines that were calibrated, (2, n)."""
        return self._first(self.columns)[:, self.columns[FAILURE] == ""]

    def _first(self, columns: Columns) -> Array:
        unit = self.mechanism.platform.units[0]
        return np.stack([columns[f"before [{unit}]"], columns[f"after [{unit}]"]])

    def costs(self) -> list[Cost]:
        """Return what each tolerance does, the costliest first.

        By machines of which a parameter alone is off by a standard deviation: parameters are
        independent, so that mean squares add up to first order. What they leave of that after the
        calibration is made by the noise.
        """
        ids = self.single["parameter"]
        squares, parameters = self._first(self.single) ** 2, self.mechanism.parameters
        names = np.array([parameters[id_].name for id_ in ids])
        totals = np.array([squares[0].sum(), np.mean(self.known[1] ** 2)])
        costs = []
        for name in dict.fromkeys(names):
            group = names == name
            sigma = float(np.sqrt(np.mean([self.sigmas[id_] ** 2 for id_ in ids[group]])))
            shares = (squares[:, group].sum(axis=1) / totals).tolist()
            costs.append(Cost(name, parameters[ids[group][0]].unit, sigma, *shares))
        return sorted(costs, key=lambda cost: -cost.before)

    def __repr__(self) -> str:
        return f"MonteCarlo({self.mechanism.name!r}, {len(self.columns[FAILURE])} machines)"

    @attached
    def __str__(self) -> str:
        """Return the verdict, how errors are distributed, and what each tolerance costs."""


def montecarlo(
    mechanism: GivenMechanism,
    plan: Plan | str | Path,
    machines: int = 1000,
    path: str | Path | None = None,
    workers: int | None = None,
    scheduler: str = "",
    **study: Any,
) -> MonteCarlo:
    """Return how accurate machines are that are made with tolerances, measured and calibrated.

    Args:
        mechanism: The nominal mechanism, its name or folder.
        plan: Poses that each machine is measured at.
        machines: How many.
        path: Table of the machines, ``*.csv`` or ``*.parquet``; what it holds is not done again.
        workers: Processes; as many as cores if not given.
        scheduler: Address of a Dask scheduler, whose workers take the place of processes.
        **study: ``options``, whose tolerance and priors are by how much machines differ, ``noise``,
            ``workspace``, ``measured`` and ``seed``: see ``MonteCarlo``.

    Raises:
        MeasurementError: a plan, noise or options that do not suit the mechanism.
        FileError: the table cannot be written, or holds other machines.
        PincalError: no Dask scheduler answers.

    Example:
        >>> import pincal
        >>> plan = pincal.sample_configurations("5R", 12)
        >>> study = pincal.montecarlo("5R", plan, 3, noise=pincal.Noise(position=1e-4))
        >>> study.known.shape
        (2, 3)
    """
    mechanism, seed = as_mechanism(mechanism), study.get("seed", 0)
    noise = as_noise(study.pop("noise", None))
    options: Options = study.pop("options", None) or Options()
    made_by, progress = Workers(workers, scheduler), options.progress
    options = replace(options, noise=noise, progress=None)
    plan = read_poses(plan, mechanism, setup=options.setup)
    if (workspace := study.pop("workspace", None)) is None:
        workspace = sample_configurations(mechanism, _POSES, seed)
    workspace = read_poses(workspace, mechanism)
    drawn = MonteCarlo(mechanism, plan, workspace, noise, options, **study)
    items = [(machine,) for machine in range(count_of(machines, "machines", MeasurementError, 1))]
    with TemporaryDirectory() as scratch:
        kinds = {"machine": int, **drawn.kinds, **{p.column: float for p in mechanism.parameters}}
        file = RowFile(Path(path or f"{scratch}/machines.csv"), kinds)
        columns = add_rows(drawn.row, items, file, made_by, progress)
        file = RowFile(Path(scratch, "parameters.csv"), {"parameter": str, **drawn.kinds})
        single = add_rows(drawn.row_of, [(id_,) for id_ in drawn.sigmas], file, made_by)
    return replace(drawn, columns=columns, single=single)
