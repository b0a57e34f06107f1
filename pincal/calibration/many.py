"""Many machines, one table: how accurate machines of given tolerances are, once calibrated.

A row depends only on its item, such as a machine's number, and rows are added in the order of the
items. So the table is the same for any number of workers (joblib's processes, Dask's computers),
and rows that it already holds are not made again.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import lazy_loader
import numpy as np
from joblib import Parallel, cpu_count, delayed, parallel_config
from joblib.externals.loky.process_executor import TerminatedWorkerError
from numpy.random import Generator

from pincal.attached import attached
from pincal.blas import one_thread
from pincal.calibration.calibrate import identified, prepared
from pincal.calibration.options import Options, Progress
from pincal.calibration.promise import apart
from pincal.design.platform_error import root_mean_squares, sizes
from pincal.design.simulate import ERROR, disturb, simulate
from pincal.errors import FileError, MeasurementError, PincalError
from pincal.files.journal import FAILURE, Columns, Row, RowFile
from pincal.files.measurements import as_noise, read_poses
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.model import Mechanism, Noise, Plan, means
from pincal.model.checks import check_kinds, count_of
from pincal.option import option
from pincal.types import Array
from pincal.workspace.sampling import sample_configurations

distributed: Any = lazy_loader.load("distributed")
Item = tuple[Any, ...]
_SHARES, _LARGEST = 64, 50  # least number of shares of the work, largest number of rows in one
_ROUNDING = 1e-6  # relative difference of numbers on another processor
_POSES = 200  # poses of the workspace over which errors are stated


@dataclass(frozen=True)
class Workers:
    """The workers that make the rows: processes, or computers."""

    workers: int | None = option(None, "Processes [default: as many as cores].", least=1)
    scheduler: str = option(
        "", "Dask scheduler whose workers do the work.", metavar="tcp://HOST:PORT"
    )

    @contextmanager
    def parallel(self) -> Iterator[Parallel]:
        """Yield the parallel backend.

        Raises:
            PincalError: no scheduler or worker answers.
        """
        if not self.scheduler:
            yield Parallel(min(self.workers or cpu_count(), cpu_count()), return_as="generator")
            return
        try:
            client = distributed.Client(self.scheduler, timeout=10, set_as_default=False)
            client.wait_for_workers(1, timeout=30)
        except ModuleNotFoundError as error:
            raise PincalError(
                "--scheduler needs Dask, which is not installed: python -m pip install "
                "'pincal[cluster]'"
            ) from error
        except (OSError, ValueError) as error:
            raise PincalError(
                f"no Dask scheduler with workers answers at {self.scheduler}: start 'dask "
                "scheduler', and 'dask worker ADDRESS' on each computer, with pincal installed "
                "there too"
            ) from error
        with client, parallel_config("dask", client=client):
            yield Parallel(-1, return_as="generator")


def add_rows(
    make_row: Callable[..., Row],
    items: Sequence[Item],
    file: RowFile,
    workers: Workers,
    progress: Progress = None,
) -> Columns:
    """Return columns with a row of each item; missing rows are made and added to the table.

    Items are the first columns of the table; an error that ``make_row`` raises for an item is the
    row's failure. ``progress`` is called with a text that says what is done.

    Raises:
        FileError: the table cannot be read or written, or its rows were made differently.
        PincalError: no scheduler or worker answers, or processes end before a row is made.
    """
    waiting, keys = _without_rows(make_row, items, file), file.columns[: len(items[0])]
    size = min(max(len(waiting) // _SHARES, 1), _LARGEST)
    while before := len(waiting):
        shares = [waiting[start : start + size] for start in range(0, before, size)]
        try:
            with workers.parallel() as parallel, warnings.catch_warnings():
                warnings.filterwarnings("ignore", ".* tasks which were still being processed")
                for rows in parallel(delayed(_rows_of)(make_row, keys, share) for share in shares):
                    file.add(rows)
                    del waiting[: len(rows)]
                    if progress:
                        progress(f"{len(items) - len(waiting)} of {len(items)} machines")
        except TerminatedWorkerError as error:  # its share is repeated
            if len(waiting) == before:
                raise PincalError(
                    "processes were ended before they made a row, perhaps for want of memory: try "
                    f"fewer --workers; {file.path} keeps what is done, the same command goes on"
                ) from error
    columns = file.read()
    places = _places(columns, keys)
    return {name: values[[places[item] for item in items]] for name, values in columns.items()}


def error_columns(mechanism: Mechanism, last: str) -> list[str]:
    """Return columns of errors before and after a calibration, and the column ``last``."""
    units = [unit for unit in ("m", "rad") if unit in mechanism.platform.units]
    return [f"{name} [{unit}]" for unit in units for name in ("before", "after", last)]


def _places(columns: Columns, keys: Sequence[str]) -> dict[Item, int]:
    """Return the index of each item's row."""
    return {item: row for row, item in enumerate(zip(*(columns[k] for k in keys), strict=True))}


def _without_rows(make_row: Callable[..., Row], items: Sequence[Item], file: RowFile) -> list[Item]:
    """Return items without a row, after checking that one existing row is reproduced."""
    columns, keys = file.read(), file.columns[: len(items[0])]
    places = _places(columns, keys)
    if done := [item for item in items if item in places][:1]:
        (row,), place = _rows_of(make_row, keys, done), places[done[0]]
        pairs = [(row[name], values[place]) for name, values in columns.items() if name in row]
        if not all(
            v == held if isinstance(v, str) else np.isclose(v, held, _ROUNDING, 1e-12, True)
            for v, held in pairs
        ):
            raise FileError(
                f"{file.path} holds other rows: that of {done[0][0]} is another by this mechanism "
                "and these options; move it away, or name another"
            )
    return [item for item in items if item not in places]


@one_thread()
def _rows_of(make_row: Callable[..., Row], keys: Sequence[str], items: Sequence[Item]) -> list[Row]:
    """Return the rows of items, or the reasons why they failed."""
    rows = []
    for item in items:
        try:
            row = make_row(*item)
        except (OSError, MemoryError):  # not a property of the item
            raise
        except Exception as error:  # the other rows are made in any case
            kind = "" if isinstance(error, PincalError) else f"{type(error).__name__}: "
            row = {FAILURE: " ".join(f"{kind}{error}".split())}
        rows.append(dict(zip(keys, item, strict=True)) | row)
    return rows


class Cost(NamedTuple):
    """The tolerance σ of all parameters of a name, and its shares of the mean square error."""

    name: str
    unit: str
    sigma: float
    before: float
    after: float


@dataclass(frozen=True, eq=False, repr=False)
class MonteCarlo:
    """A study of machines that are drawn, measured and calibrated, and of their errors."""

    mechanism: Mechanism
    plan: Plan
    workspace: Plan
    """Poses over which errors are root mean squares."""
    noise: Noise
    options: Options
    """Options of the calibrations; tolerance and priors also say how far machines differ."""
    measured: Sequence[str] | None = None
    """Measured freedoms of the platform; None for all."""
    seed: int = 0
    columns: Columns = field(default_factory=dict)
    """A row of each machine, SI: errors before and after, true minus nominal parameters."""
    single: Columns = field(default_factory=dict)
    """A row of each parameter: errors of a machine in which only it is off, without noise."""

    @cached_property
    def sigmas(self) -> dict[str, float]:
        """Standard deviations of true from nominal parameters, by id."""
        parameters, size = self.mechanism.parameters, self.mechanism.size
        if not (by_name := self.options.priors_by_name(self.mechanism)):
            return {p.id: ERROR * (size if p.unit == "m" else 1.0) for p in parameters}
        return {
            p.id: sigma
            for name, sigma in by_name.items()
            for p in parameters
            if means(name, p.owner, p.name)
        }

    def row(self, machine: int) -> Row:
        """Return the row of a machine, which depends only on its number."""
        seeds = np.random.SeedSequence(self.seed, spawn_key=(machine,)).spawn(2)
        drawn, noisy = map(np.random.default_rng, seeds)
        truth = disturb(self.mechanism, self.sigmas, drawn)
        changes = (truth.parameters.values - self.mechanism.parameters.values).tolist()
        heads = [p.column for p in self.mechanism.parameters]
        return self.errors(truth, self.noise, noisy) | dict(zip(heads, changes, strict=True))

    def row_of(self, id_: str) -> Row:
        """Return the row of a machine in which only one parameter is off, without noise."""
        value = self.mechanism.parameters[id_].nominal + self.sigmas[id_]
        return self.errors(self.mechanism.with_parameters({id_: value}), Noise(0.0, 0.0, 0.0, 0.0))

    def errors(self, truth: Mechanism, noise: Noise, seed: Generator | int = 0) -> Row:
        """Return the errors of a true machine before and after it is calibrated."""
        nominal, setup, platform = self.mechanism, self.options.setup, self.mechanism.platform
        data = simulate(nominal, truth, self.plan, noise, seed, setup).measurements
        if self.measured is not None:
            turned = not set(platform.freedoms[platform.lengths :]).isdisjoint(self.measured)
            columns = zip(platform.coordinates, platform.units, strict=True)
            reads = [turned if unit == "rad" else name in self.measured for name, unit in columns]
            data = replace(data, poses=np.where(reads, data.poses, np.nan))
        result = identified(prepared(nominal, data, self.options))[0]  # a row has no findings
        if not result.converged:
            raise MeasurementError(result.message)
        row: Row = {"poses": len(data), "chi2": result.reduced_chi2}
        for name, model in (("before", nominal), ("after", result.identified)):
            twists, units = apart(result, self.workspace, model, truth)
            of_poses = sizes(units, twists)
            means_of_kinds = root_mean_squares(of_poses)
            for kind, unit in enumerate(("m", "rad")):
                if unit in units:
                    row[f"{name} [{unit}]"] = means_of_kinds[kind]
                    row[f"worst [{unit}]"] = float(np.nanmax(of_poses[:, kind]))
        return row

    @property
    def known(self) -> Array:
        """Errors before and after calibration of machines that were calibrated, shape (2, n)."""
        return self._first(self.columns)[:, self.columns[FAILURE] == ""]

    def _first(self, columns: Columns) -> Array:
        unit = self.mechanism.platform.units[0]
        return np.stack([columns[f"before [{unit}]"], columns[f"after [{unit}]"]])

    def costs(self) -> list[Cost]:
        """Return the shares of the tolerances in the error, the costliest first.

        They are of machines in which one parameter is off by a standard deviation. Parameters are
        independent, so that mean squares add up to first order; the rest of the error after
        calibration is due to noise.
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
        """Return the verdict, the distribution of errors, and what each tolerance costs."""


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
        plan: Poses at which each machine is measured.
        machines: Number of machines.
        path: CSV table of the machines; its rows are not made again.
        workers: Number of processes; by default one for each core.
        scheduler: Address of a Dask scheduler, whose workers replace the processes.
        **study: ``options``, whose tolerance and priors say how far machines differ, ``noise``,
            ``workspace``, ``measured`` and ``seed``: see ``MonteCarlo``.

    Raises:
        MeasurementError: plan, noise or options do not suit the mechanism.
        FileError: the table cannot be written, or holds other machines.
        PincalError: no Dask scheduler answers.

    Example:
        >>> import pincal
        >>> plan = pincal.sample_configurations("5R", 12)
        >>> study = pincal.montecarlo("5R", plan, 3, noise=pincal.Noise(position=1e-4))
        >>> study.known.shape
        (2, 3)
    """
    check_kinds({"path": path, "workers": workers}, montecarlo, MeasurementError)
    mechanism, noise = as_mechanism(mechanism), as_noise(study.pop("noise", None))
    asked: Options = study.pop("options", None) or Options()
    options = replace(asked, noise=noise, progress=None)
    plan = read_poses(plan, mechanism, setup=options.setup)
    if (workspace := study.pop("workspace", None)) is None:
        workspace = sample_configurations(mechanism, _POSES, study.get("seed", 0))
    workspace, made_by = read_poses(workspace, mechanism), Workers(workers, scheduler)
    drawn = MonteCarlo(mechanism, plan, workspace, noise, options, **study)
    items = [(machine,) for machine in range(count_of(machines, "machines", MeasurementError, 1))]
    names = [FAILURE, "poses", "chi2", *error_columns(mechanism, "worst")]
    heads = ["machine", *names, *(p.column for p in mechanism.parameters)]
    file = RowFile(Path(path) if path else None, heads)
    columns = add_rows(drawn.row, items, file, made_by, asked.progress)
    file = RowFile(None, ["parameter", *names])
    single = add_rows(drawn.row_of, [(id_,) for id_ in drawn.sigmas], file, made_by)
    return replace(drawn, columns=columns, single=single)
