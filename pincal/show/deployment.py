"""Folders for controllers of calibrated machines: kinematics, a data sheet, instructions."""

from __future__ import annotations

import logging
import re
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pincal import __version__
from pincal.calibration.result import CalibrationResult
from pincal.calibration.result_files import RESULT, load_result
from pincal.design.platform_error import sizes
from pincal.design.simulate import platform_errors
from pincal.errors import FileError, MeasurementError, MechanismError
from pincal.files.mechanism_folders import as_mechanism
from pincal.files.output import writing
from pincal.files.table import write_table
from pincal.formats.corrections import correction_grid, grid_columns
from pincal.formats.data_sheet import deltakins, genhexkins, geometry_sheet
from pincal.formats.deployed import Deployed, c_header, python_file
from pincal.kinematics.configurations import command, home_of
from pincal.model import Mechanism, Plan, Setup
from pincal.model.checks import check_kinds, count_of
from pincal.option import option, option_of
from pincal.types import Array
from pincal.words.numbers import Units, amount
from pincal.words.wording import rendered
from pincal.workspace.limits import Limits
from pincal.workspace.sampling import sample_workspace

SHEET, HOW_TO, LINUXCNC = "geometry.csv", "commanding.md", "linuxcnc.hal"
CORRECTIONS = "corrections.csv"
_FITTED = 4000  # poses of LinuxCNC's deltas: of so many, 95 % are known to about 3 %
_UNSEEN = 500  # poses at which a grid is tested; it is fitted to three per node and 500 more
_FEW = 100  # fewest poses in a box, of which a quarter test the grid
_log = logging.getLogger(__name__)
_TRIED = 100  # poses of an arm for which solutions are sought


@dataclass(frozen=True)
class GridOptions:
    """Options of corrections for a controller whose geometry cannot be changed."""

    grid: int = option(
        0,
        "Correct commanded poses on a grid with this many nodes, for a controller whose geometry "
        "cannot be changed; 4096 is a good number.",
    )
    box: str = option("", option_of(Limits, "box"))
    controller: Path | None = option(
        None,
        "Mechanism that this controller assumes [default: the nominal mechanism of RESULT].",
        metavar="MECH",
    )

    def __post_init__(self) -> None:
        """Check that there is a grid if a box or a controller is given."""
        count = count_of(self.grid, "grid", MeasurementError, 0, 5000)
        if not count and (self.box or self.controller):
            raise MeasurementError("--box and --controller are for --grid; give --grid 4096, too")


def deploy(
    machine: CalibrationResult | Mechanism | str | Path,
    folder: str | Path,
    *,
    force: bool = False,
    units: str = "",
    **correction: Any,
) -> None:
    """Write a folder with all that a controller needs of a machine.

    It holds pincal's kinematics as one Python file and one C99 header without dependencies; a sheet
    of joint centres and lengths, with standard errors for a result; HAL lines for LinuxCNC if the
    machine is a hexapod or a delta; and ``commanding.md``, which says how to use these files.

    Args:
        machine: A result of ``calibrate`` or its folder, whose frame and measured point are
            written too; or a mechanism, its name or its folder.
        folder: Folder to write.
        force: Overwrite the folder if it exists.
        units: Units of the tables, such as ``"mm,deg"``; SI if not given.
        **correction: Fields ``grid``, ``box``, ``controller`` of ``GridOptions``. Corrections of
            commanded poses become ``corrections.csv`` and a function ``corrected`` in both files.

    Raises:
        MechanismError: the machine has terms that the files cannot hold, or a grid is asked for
            and its poses do not determine its readings, or it has more readings than freedoms.
        MeasurementError: the result did not converge.
        FileError: the folder exists, or cannot be written.

    Example:
        >>> import pincal, pathlib, tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     pincal.deploy("5R", folder + "/controller")
        ...     sorted(path.name for path in pathlib.Path(folder, "controller").iterdir())
        ['commanding.md', 'geometry.csv', 'kinematics.py', 'machine_5r.h']
    """
    check_kinds(locals(), deploy, FileError)
    if isinstance(machine, str | Path) and (Path(machine) / RESULT).is_file():
        machine = load_result(machine)
    result = machine if isinstance(machine, CalibrationResult) else None
    if result is not None and not result.converged:
        raise MeasurementError("the fit did not converge, so there is no machine to deploy")
    options, frames = GridOptions(**correction), () if result is None else result.measured_frames
    deployed = Deployed(as_mechanism(machine) if result is None else result.identified, *frames)
    misses: tuple[str, ...] = ()
    if options.grid:
        nominal = deployed.mechanism if result is None else result.nominal
        controller = as_mechanism(options.controller or nominal)
        deployed, misses = _with_grid(deployed, controller, options)
    mechanism, source, uncertain = deployed.mechanism, "the mechanism as drawn", None
    written = Units.of(units, mechanism.counts, mechanism.reading_names)
    if result is not None:
        uncertain = result.covariance, result.undetermined_directions
        unsure = ", which states no limit of its error: see its report" * (not result.promises)
        source = f"a calibration{unsure}"
    prefix = re.sub(r"[^a-z0-9]", "_", mechanism.name.lower())
    prefix = "machine_" * prefix[:1].isdigit() + prefix
    files = {"kinematics.py": python_file(deployed), f"{prefix}.h": c_header(deployed, prefix)}
    files |= _linuxcnc(mechanism)
    facts = {"source": source, "linuxcnc": LINUXCNC in files, "misses": misses}
    files[HOW_TO] = _how_to(deployed, prefix=prefix, **facts)
    tables: dict[str, Any] = {SHEET: geometry_sheet(mechanism, uncertain, written)}
    if deployed.grid is not None:
        tables[CORRECTIONS] = written.written(grid_columns(mechanism, deployed.grid))
    with writing(folder, force=force, folder=(*files, *tables)) as scratch:
        for name, text in files.items():
            (scratch / name).write_text(text, "utf-8")
        for name, columns in tables.items():
            write_table(scratch / name, columns)


def _linuxcnc(mechanism: Mechanism) -> dict[str, str]:
    """Return the file for LinuxCNC by name; empty if LinuxCNC has no kinematics for the machine."""
    with suppress(MechanismError):
        return {LINUXCNC: genhexkins(mechanism)}
    with suppress(MechanismError):
        if mechanism.platform.kind == "translational" and not mechanism.by_readings:
            return {LINUXCNC: deltakins(mechanism, sample_workspace(mechanism, _FITTED))}
    return {}


def _with_grid(
    deployed: Deployed, controller: Mechanism, options: GridOptions
) -> tuple[Deployed, tuple[str, str]]:
    """Return ``deployed`` with a grid of corrections, and errors with and without it, in words."""
    machine, platform = deployed.mechanism, deployed.mechanism.platform
    if machine.by_readings:
        raise MechanismError(
            f"poses of {machine.name!r} do not determine its readings, so a grid cannot correct "
            "them; use 'pincal inverse' and 'pincal forward CONTROLLER' on a program's poses"
        )
    if controller.platform.coordinates != platform.coordinates:
        raise MechanismError(
            f"--controller {controller.name} moves {', '.join(controller.platform.coordinates)}, "
            f"{machine.name} moves {', '.join(platform.coordinates)}; name one that moves the same"
        )
    count = 3 * options.grid + 2 * _UNSEEN
    drawn = sample_workspace(machine, count * (8 if options.box else 1))
    poses = drawn[Limits(options.box).allow(machine, Plan(drawn), Setup())]
    if len(poses) < _FEW:
        raise MechanismError(f"only {len(poses)} of {len(drawn)} poses are within --box; widen it")
    tried = min(_UNSEEN, len(poses) // 4)
    poses, unseen = poses[tried:count], poses[:tried]
    grid = correction_grid(machine, controller, poses, options.grid)

    def missed_by(commands: Array) -> str:
        errors = platform_errors(controller, machine, commands)
        reached = np.isfinite(errors).all(axis=1)
        arrived = platform.moved(commands[reached], errors[reached])
        missed = sizes(platform.units, platform.twists_between(unseen[reached], arrived))
        parts = list(zip(missed.T, ("m", "rad")[: 1 + (platform.turns > 0)], strict=False))
        largest = " and ".join(amount(part.max(), unit) for part, unit in parts)
        usual = " and ".join(amount(np.quantile(part, 0.95), unit) for part, unit in parts)
        return f"{usual} (95 %), {largest} at most"

    after, before = missed_by(grid.commands(unseen)), missed_by(unseen)
    _log.info("unseen poses are missed by %s; without corrections by %s", after, before)
    return replace(deployed, grid=grid), (after, before)


def _example(deployed: Deployed) -> tuple[list[float], list[float], dict[str, int]]:
    """Return a reachable pose (home's if it is), its readings, and how many poses an arm finds."""
    kinematics, machine = deployed.kinematics, deployed.mechanism
    poses = command(machine, home_of(machine))[0].tolist()
    if any(leg.is_arm for leg in machine.legs):
        poses += sample_workspace(machine, _TRIED).tolist()
    tries = [(pose, kinematics.inverse(kinematics.pose(*pose))) for pose in poses]
    pose, solution = next((pose, way) for pose, way in tries if not way.reason)
    ways = [not kinematics.beyond_limits(way.joints) for _, way in tries[1:] if not way.reason]
    return pose, solution.values, {"found": len(ways), "tried": len(poses) - 1, "within": sum(ways)}


def _how_to(deployed: Deployed, **facts: Any) -> str:
    """Return the instructions for commanding the machine, in Markdown."""
    machine = deployed.mechanism
    pose, values, arm = _example(deployed)
    return rendered(
        HOW_TO,
        machine=machine,
        pose=pose,
        readings=list(zip(machine.reading_names, machine.reading_units, values, strict=True)),
        arm=arm,
        starts=len(deployed.tables["starts"]),
        framed=not np.allclose((deployed.frame, deployed.tool), np.eye(4)),
        version=__version__,
        **facts,
    )
