"""``pincal plot``: one figure of a calibration, for papers and pages."""

from __future__ import annotations

from datetime import datetime
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from pincal.calibration.result_files import load_result
from pincal.cli.app import Force, command, output_option, working, wrote
from pincal.files.output import refuse_existing
from pincal.show.style import COLUMN, PAGE_WIDTH


class Kind(StrEnum):
    """What is drawn: the names of ``result.plot``'s methods."""

    residuals = "residuals"
    workspace = "workspace"
    time = "time"
    images = "images"
    parameters = "parameters"
    platform = "platform"
    correlation = "correlation"
    singular = "singular"
    convergence = "convergence"
    poses = "poses"
    error_map = "error_map"
    bed = "bed"
    runs = "runs"
    drawing = "drawing"


class Width(StrEnum):
    """Width of a figure, [mm]."""

    column = f"{COLUMN:g}"
    page = f"{PAGE_WIDTH:g}"


@command()
def plot(
    result: Annotated[
        Path, typer.Argument(metavar="RESULT", help="Folder of 'pincal calibrate -o RESULT'.")
    ],
    kind: Annotated[Kind, typer.Argument(metavar="KIND", help=f"One of {', '.join(Kind)}.")],
    output: Annotated[Path, output_option("FILE.svg|pdf|png", "The figure.")],
    width: Annotated[
        Width | None,
        typer.Option(help="In mm: one column, or across the page, as if not given."),
    ] = None,
    leg: Annotated[
        str, typer.Option(metavar="LEG", help="Whose drawing; the first leg's if not given.")
    ] = "",
    force: Force = False,
) -> None:
    """Draw a figure of a calibration.

    One column or a page wide, letters of 7 to 9 points. residuals: by row; workspace: where they
    were measured; time: their means over the run; images: over those of cameras;
    parameters: changes in units of their ±;
    platform: what changes move the platform by; correlation; singular: how well each direction is
    determined; convergence: residuals by step of the search; poses: accuracy by number of poses,
    with the bound; error_map: expected error over x and y; bed: z over a printer's bed; runs: runs
    side by side; drawing: a leg with dimensions, and a table of all values, on A4.
    """
    from matplotlib.figure import Figure

    from pincal.show.pictures.files import drawing, picture_path, save_figure
    from pincal.show.pictures.sheet import sheet

    found = load_result(result)
    refuse_existing(picture_path(output), force=force)
    if leg and kind is not Kind.drawing:
        raise typer.BadParameter("--leg is for the kind 'drawing'")
    if width and kind is Kind.drawing:
        raise typer.BadParameter("--width is for other kinds: a drawing is a page of A4")
    with working("drawing"):
        if kind is Kind.drawing:
            figure = sheet(found, leg, datetime.now().astimezone().strftime("%Y-%m-%d"))
        else:
            inches = float(width or Width.page) / 25.4
            height = max(0.62 * inches, 3.6 if kind is Kind.platform else 2.4)
            with drawing():
                figure = Figure(figsize=(inches, height), layout="compressed")
                getattr(found.plot, kind)(figure.subplots())
        save_figure(figure, output, force=force, whole=True)
    wrote(output)
