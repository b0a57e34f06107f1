"""``pincal view``, ``picture`` and ``plot``: mechanisms, poses and results, as pictures."""

from __future__ import annotations

import sys
import webbrowser
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from enum import StrEnum
from pathlib import Path
from threading import Event
from typing import Annotated, Literal, get_args

import numpy as np
import typer
from matplotlib.figure import Figure

from pincal.calibration.result import CalibrationResult
from pincal.calibration.result_files import load_result, read_result
from pincal.cli.app import command, remark, say, stderr, warn, working, wrote
from pincal.cli.options import FORCE, Force, Mech, output_option
from pincal.errors import FileError, MeasurementError
from pincal.files.measurements import read_measurements, read_poses
from pincal.files.mechanism_folders import is_folder, load_mechanism
from pincal.files.output import refuse_existing
from pincal.files.table import read_table
from pincal.kinematics.forward import forward
from pincal.model.measurements import Plan
from pincal.model.mechanism import Mechanism
from pincal.model.option import option
from pincal.show.pictures.files import drawing, picture_path, save_figure
from pincal.show.pictures.picture import picture as draw_picture
from pincal.show.pictures.sheet import sheet
from pincal.show.result_tables import warnings
from pincal.show.style import COLUMN, PAGE_WIDTH
from pincal.show.view.scene import MAGNIFY, Scene
from pincal.show.view.view import View
from pincal.show.view.view import view as make_view
from pincal.types import Array, Mask
from pincal.words.wording import unreached

Files = Annotated[
    list[Path] | None,
    typer.Argument(
        metavar="POSES.csv|RESULT",
        help="Poses, a plan or measurements; the folder of a calibration.",
    ),
]


@dataclass(frozen=True)
class SceneOptions:
    """What is shown beside the mechanism."""

    workspace: Path | None = option(
        None, "Cloud of positions, from 'pincal workspace'.", metavar="CSV"
    )
    magnify: float | None = option(
        None, f"Factor on a RESULT's differences from nominal [default: {MAGNIFY:g}]."
    )


@dataclass(frozen=True)
class Contents:
    """What is to be shown, as read from files."""

    mechanism: Mechanism
    plan: Plan | None
    workspace: Array | None
    identified: Mechanism | None
    magnify: float
    source: str
    """Names of the files."""
    result: CalibrationResult | None


def _read(mech: str, files: Sequence[Path], options: SceneOptions) -> Contents:
    """Return what files hold.

    Raises:
        BadParameter: more than one file of a kind; a factor without a result.
        PincalError: a file that cannot be read, or does not belong to the mechanism.
    """
    folder = _only([path for path in files if is_folder(path)])
    table = _only([path for path in files if not is_folder(path)])
    if options.magnify is not None and folder is None:
        raise typer.BadParameter("--magnify is for the errors of a RESULT, and none is given")
    mechanism = load_mechanism(mech)
    identified = result = estimates = plan = workspace = None
    if folder is not None:
        identified, result = _identified(folder), load_result(folder)
        estimates = folder / "poses.csv" if (folder / "poses.csv").is_file() else None
    if table is not None:
        plan = _plan(table, estimates, mechanism)
    elif estimates is not None:
        plan = read_poses(estimates, mechanism)
    if options.workspace is not None:
        workspace = _positions(options.workspace, mechanism)
    magnify = MAGNIFY if options.magnify is None else options.magnify
    source = ", ".join(path.name for path in (table, folder) if path is not None)
    return Contents(mechanism, plan, workspace, identified, magnify, source, result)


def _only(paths: list[Path]) -> Path | None:
    """Return the path of a kind, if there is one.

    Raises:
        BadParameter: there are several.
    """
    if len(paths) > 1:
        raise typer.BadParameter(
            f"{' and '.join(map(str, paths))}: expected one POSES.csv and one RESULT at most"
        )
    return paths[0] if paths else None


def _plan(table: Path, estimates: Path | None, mechanism: Mechanism) -> Plan:
    """Return the poses of a table; where it lacks some, those that a result estimated.

    Raises:
        MeasurementError: no row holds a whole pose, and there is no result with estimates of it.
    """
    plan = _rows(table, mechanism)
    if mechanism.by_readings and plan.readings is not None:
        # they say where the mechanism is, in its own base frame
        solution = forward(mechanism, plan.readings)
        if not solution.converged.any():
            raise MeasurementError(
                f"{table}: {solution.reasons[0]} at {plan.place(0)}, and at all others"
            )
        return _rows_of(replace(plan, poses=solution.poses), solution.converged)
    complete: Mask = np.isfinite(plan.poses).all(axis=1).astype(bool)
    if complete.all():
        return plan
    if estimates is not None:
        poses = read_poses(estimates, mechanism).poses
        if len(poses) != len(complete):
            raise MeasurementError(
                f"{table} has {len(complete)} rows, {estimates} has {len(poses)}; expected the "
                "measurements of this calibration"
            )
        remark(f"poses as estimated by the calibration: {estimates}")
        return Plan(poses, plan.sets, plan.readings)
    advice = (
        "What was not measured, 'pincal calibrate -o RESULT' estimates for all rows; "
        "RESULT beside the measurements, or RESULT/poses.csv, shows it"
    )
    if not complete.any():
        try:
            read_poses(table, mechanism)
        except MeasurementError as error:
            raise MeasurementError(f"{error}. {advice}") from error
    warn(
        f"{table}: {np.sum(~complete)} of {len(complete)} rows hold no whole pose, the first "
        f"is in {plan.place(int(np.argmin(complete)))}; only the others are drawn. {advice}"
    )
    return _rows_of(plan, complete)


def _rows_of(plan: Plan, chosen: Mask) -> Plan:
    """Return the rows of a plan that a mask of shape (N,) chooses."""
    rows = np.flatnonzero(chosen)
    sets = None if plan.sets is None else tuple(plan.sets[row] for row in rows)
    readings = None if plan.readings is None else plan.readings[rows]
    return Plan(plan.poses[rows], sets, readings)


def _rows(table: Path, mechanism: Mechanism) -> Plan:
    """Return a plan or, where the table has all readings, measurements; NaN where there is none."""
    if mechanism.by_readings or not set(mechanism.reading_names) <= set(read_table(table).units):
        return read_poses(table, mechanism, partial=True)
    return read_measurements(table, mechanism, partial=True)


def _identified(folder: Path) -> Mechanism:
    """Return the calibrated mechanism of a result folder."""
    if not (folder / "result.json").is_file():
        raise FileError(f"{folder} is no folder of 'pincal calibrate': it has no result.json")
    if not read_result(folder).get("calibrated_mechanism"):
        raise MeasurementError(
            f"{folder}: the fit did not converge, so there is no calibrated mechanism to show"
        )
    return load_mechanism(folder)


def _positions(path: Path, mechanism: Mechanism) -> Array:
    """Return the positions in a CSV of 'pincal workspace', shape (M, 2) or (M, 3), [m]."""
    table = read_table(path)
    names = mechanism.platform.coordinates[: mechanism.platform.units.count("m")]
    return np.column_stack([table.numbers(name, "m") for name in names])


@dataclass(frozen=True)
class PageOptions(SceneOptions):
    """What the page holds, and where it goes."""

    html: Path | None = option(None, "Write one file that opens anywhere, offline.", metavar="FILE")
    meshes: Path | None = option(
        None, "Your URDF: an arm's links as its meshes show them.", metavar="URDF"
    )
    open: bool = option(True, "Print the address, open no browser.")
    force: bool = option(False, FORCE)


@command()
def view(mech: Mech, options: PageOptions, files: Files = None) -> None:
    """Look at a mechanism in the browser.

    The slider and the arrow keys go from pose to pose, the space bar plays. Without POSES.csv:
    home and some of the workspace, or the poses that RESULT estimated. With RESULT the
    calibrated machine is shown too, where it goes when the nominal model drives it, its errors
    magnified; arrows go from measured to predicted points, the workspace is coloured by error, and
    a slider moves the machine along the direction that the measurements determine least. The page
    is served to this machine alone, until Ctrl-C.
    """
    if options.html is not None and options.html.suffix.lower() not in (".html", ".htm"):
        raise FileError(f"{options.html} would be a page; give it the ending .html")
    contents = _read(mech, files or [], options)
    if options.html is not None:
        refuse_existing(options.html, force=options.force)
    with working("placing the legs"):
        page = make_view(
            contents.mechanism,
            contents.plan,
            workspace=contents.workspace,
            identified=contents.identified,
            magnify=contents.magnify,
            source=contents.source,
        )
        if contents.result is not None:
            page = page.with_notices(tuple(warnings(contents.result)))
            page = page.with_result(contents.result)
        if options.meshes is not None:
            page = page.with_meshes(options.meshes)
        page.html()
    _say_unreached(page.scene)
    if options.html is not None:
        page.save(options.html, force=options.force)
        wrote(options.html)
    else:
        _serve(page, open_browser=options.open)


def _serve(page: View, *, open_browser: bool) -> None:
    """Serve a view until Ctrl-C."""
    try:
        say(page.url)
        sys.stdout.flush()
        if open_browser and not webbrowser.open(page.url):
            stderr.print("no browser was found: open the address above in one")
        stderr.print("Ctrl-C ends")
        Event().wait()
    except KeyboardInterrupt:
        page.close()


@dataclass(frozen=True)
class PictureOptions(SceneOptions):
    """What of the mechanism is drawn, and options."""

    pose: int = option(1, "Which of the poses is drawn in full.", least=1, metavar="N")
    dimensions: tuple[str, ...] = option(
        (), "Draw the parameters of a leg as lengths and angles; repeatable.", metavar="LEG"
    )


@command()
def picture(
    mech: Mech,
    output: Annotated[Path, output_option("FILE.svg|png|pdf", "The picture.")],
    options: PictureOptions,
    files: Files = None,
    force: Force = False,
) -> None:
    """Draw a mechanism into a file, as 'pincal view' shows it.

    At home, or with POSES.csv at one of its poses, all of them as faint lines in the colours of
    their sets. With RESULT the calibrated machine is drawn too, its errors magnified. The same
    picture gives the same bytes.
    """
    contents = _read(mech, files or [], options)
    refuse_existing(picture_path(output), force=force)
    with working("drawing"):
        image = draw_picture(
            contents.mechanism,
            contents.plan,
            row=options.pose - 1,
            workspace=contents.workspace,
            identified=contents.identified,
            magnify=contents.magnify,
            dimensions=options.dimensions,
        )
        if contents.result is not None:
            image = image.with_result(contents.result)
        image.save(output, force=force)
    _say_unreached(image.scene)
    wrote(output)


def _say_unreached(scene: Scene) -> None:
    """Say at how many poses something is not drawn."""
    texts = [unreached(None, scene.body.problems)]
    if scene.identified:
        texts.append(unreached(scene.identified.magnify, scene.identified.body.problems))
    for text in filter(None, texts):
        stderr.print(text)


Kind = Literal[
    "residuals",
    "workspace",
    "time",
    "images",
    "parameters",
    "platform",
    "correlation",
    "singular",
    "convergence",
    "poses",
    "error_map",
    "bed",
    "runs",
    "drawing",
]
"""What is drawn: the names of ``result.plot``'s methods."""
Width = StrEnum("Width", {"column": f"{COLUMN:g}", "page": f"{PAGE_WIDTH:g}"})
"""Width of a figure, [mm]."""


@dataclass(frozen=True)
class PlotOptions:
    """How a figure is drawn."""

    width: Width | None = option(None, "In mm: one column, or across the page, as if not given.")
    leg: str = option("", "Whose drawing; the first leg's if not given.", metavar="LEG")


@command()
def plot(
    result: Annotated[
        Path, typer.Argument(metavar="RESULT", help="Folder of 'pincal calibrate -o RESULT'.")
    ],
    kind: Annotated[
        Kind, typer.Argument(metavar="KIND", help=f"One of {', '.join(get_args(Kind))}.")
    ],
    output: Annotated[Path, output_option("FILE.svg|pdf|png", "The figure.")],
    options: PlotOptions,
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
    calibrated = load_result(result)
    refuse_existing(picture_path(output), force=force)
    if options.leg and kind != "drawing":
        raise typer.BadParameter("--leg is for the kind 'drawing'")
    if options.width and kind == "drawing":
        raise typer.BadParameter("--width is for other kinds: a drawing is a page of A4")
    with working("drawing"):
        if kind == "drawing":
            today = datetime.now().astimezone().strftime("%Y-%m-%d")
            figure = sheet(calibrated, options.leg, today)
        else:
            inches = float(options.width or PAGE_WIDTH) / 25.4
            height = max(0.62 * inches, 3.6 if kind == "platform" else 2.4)
            with drawing():
                figure = Figure(figsize=(inches, height), layout="compressed")
                getattr(calibrated.plot, kind)(figure.subplots())
        save_figure(figure, output, force=force, whole=True)
    wrote(output)
