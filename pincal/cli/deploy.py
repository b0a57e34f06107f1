"""``pincal deploy``: what a controller needs of a calibrated machine."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

import pincal
from pincal.cli.app import command, wrote
from pincal.cli.options import Force, TableOptions, output_option
from pincal.show.deployment import GridOptions


@command
def deploy(
    machine: Annotated[
        str, typer.Argument(metavar="RESULT", help="Folder of a calibration; or a mechanism.")
    ],
    output: Annotated[Path, output_option("FOLDER", "Kinematics, data sheet and how to use them.")],
    correction: GridOptions,
    tables: TableOptions,
    force: Force = False,
) -> None:
    """Write kinematics for a controller.

    How do I command the robot now? Inverse and forward kinematics as one Python file and one C99
    header that need nothing else, in the frames that were measured; joint centres and lengths with
    standard errors; HAL lines for LinuxCNC where the machine is a hexapod or a delta.
    FOLDER/commanding.md says how to use them.

    Where the controller's geometry cannot be changed, --grid 4096 adds what to command in place of
    each pose (corrections.csv, and a function in both files), and says what error that leaves.

    For URDF, MJCF and printers see 'pincal export'.
    """
    pincal.deploy(machine, output, force=force, units=tables.units or "", **asdict(correction))
    wrote(output)
