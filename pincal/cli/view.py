"""``pincal view``: a mechanism and its poses in the browser."""

from __future__ import annotations

import sys
from pathlib import Path
from threading import Event
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from pincal.cli.app import Force, Mech, app, stderr, stdout, working, wrote
from pincal.errors import FileError, MeasurementError
from pincal.identification.result_files import read_result
from pincal.model.files import is_folder, load_mechanism
from pincal.model.measurement_files import read_poses
from pincal.model.mechanism import Mechanism
from pincal.model.output import refuse_existing
from pincal.model.table import read_table
from pincal.show.scene import MAGNIFY
from pincal.show.view import View
from pincal.show.view import view as viewed


@app.command()
def view(
    mech: Mech,
    files: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[POSES.csv|RESULT]",
            help="Poses, a plan or measurements; the folder of a calibration.",
        ),
    ] = None,
    workspace: Annotated[
        Path | None,
        typer.Option(metavar="CSV", help="Cloud of positions, from 'pincal workspace'."),
    ] = None,
    magnify: Annotated[
        float | None,
        typer.Option(help=f"Factor on a RESULT's differences from nominal [default: {MAGNIFY:g}]."),
    ] = None,
    html: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write one file that opens anywhere, offline."),
    ] = None,
    no_open: Annotated[
        bool, typer.Option("--no-open", help="Print the address, open no browser.")
    ] = False,
    force: Force = False,
) -> None:
    """Look at a mechanism in the browser.

    The slider and the arrow keys go from pose to pose, the space bar plays. Without POSES.csv:
    home and some of the workspace. With RESULT the calibrated machine is shown too, where it
    goes when the nominal model drives it, its errors magnified. The page is served to this
    machine alone, until Ctrl-C.
    """
    given = files or []
    folders = [path for path in given if is_folder(path)]
    tables = [path for path in given if not is_folder(path)]
    for several in (folders, tables):
        if len(several) > 1:
            raise typer.BadParameter(
                f"{' and '.join(map(str, several))}: expected one POSES.csv and one RESULT at most"
            )
    if magnify is not None and not folders:
        raise typer.BadParameter("--magnify is for the errors of a RESULT, and none is given")
    mechanism = load_mechanism(mech)
    if html is not None:
        refuse_existing(html, force=force)
    plan = read_poses(tables[0], mechanism) if tables else None
    identified = _identified(folders[0]) if folders else None
    cloud = None if workspace is None else _positions(workspace, mechanism)
    with working("placing the legs"):
        shown = viewed(
            mechanism,
            plan,
            workspace=cloud,
            identified=identified,
            magnify=MAGNIFY if magnify is None else magnify,
            source=", ".join(path.name for path in (*tables, *folders)),
        )
        shown.html()
    _tell_unreached(shown)
    if html is not None:
        shown.save(html, force=force)
        wrote(html)
    else:
        _serve(shown, no_open)


def _serve(shown: View, no_open: bool) -> None:
    """Serve a view until Ctrl-C."""
    import webbrowser

    try:
        stdout.print(shown.url, markup=False, soft_wrap=True)
        sys.stdout.flush()
        if not (no_open or webbrowser.open(shown.url)):
            stderr.print("no browser was found: open the address above in one", markup=False)
        stderr.print("Ctrl-C ends")
        Event().wait()
    except KeyboardInterrupt:
        shown.close()


def _tell_unreached(shown: View) -> None:
    """Say at how many poses something is not drawn."""
    scene = shown.scene
    bodies = [("the mechanism", scene.body)]
    if scene.identified:
        bodies.append(
            (
                f"the identified machine (errors × {scene.identified.magnify:g})",
                scene.identified.body,
            )
        )
    for name, body in bodies:
        problems = [text for text in body.problems if text]
        if problems:
            stderr.print(
                f"{name} is not drawn in full at {len(problems)} of {len(body.problems)} poses; "
                f"the first: {problems[0]}",
                markup=False,
            )


def _identified(folder: Path) -> Mechanism:
    """Return the calibrated mechanism of a result folder."""
    if not (folder / "result.json").is_file():
        raise FileError(f"{folder} is no folder of 'pincal calibrate': it has no result.json")
    if not read_result(folder).get("calibrated_mechanism"):
        raise MeasurementError(
            f"{folder}: the fit did not converge, so there is no calibrated mechanism to show"
        )
    return load_mechanism(folder)


def _positions(path: Path, mechanism: Mechanism) -> NDArray[np.float64]:
    """Return the positions in a CSV of 'pincal workspace', shape (M, 2) or (M, 3), [m]."""
    table = read_table(path)
    names = mechanism.platform.coordinates[: mechanism.platform.units.count("m")]
    return np.column_stack([table.numbers(name, "m") for name in names])
