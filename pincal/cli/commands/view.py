"""``pincal view`` and ``picture``: a mechanism, poses and a result, in the browser or in a file."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import Annotated

import numpy as np
import typer

from pincal.calibration.result import CalibrationResult
from pincal.calibration.result_files import load_result, read_result
from pincal.cli.app import (
    Force,
    Mech,
    command,
    output_option,
    remark,
    stderr,
    stdout,
    warn,
    working,
    wrote,
)
from pincal.errors import FileError, MeasurementError
from pincal.files.measurements import read_measurements, read_poses
from pincal.files.mechanism_folders import is_folder, load_mechanism
from pincal.files.output import refuse_existing
from pincal.files.table import read_table
from pincal.kinematics.forward import forward
from pincal.model.measurements import Plan
from pincal.model.mechanism import Mechanism
from pincal.show.result_tables import warnings
from pincal.show.view.scene import MAGNIFY, Scene
from pincal.show.view.view import View
from pincal.show.view.view import view as viewed
from pincal.types import Array
from pincal.words.wording import unreached


@dataclass(frozen=True)
class SeenOptions:
    """What is to be shown."""

    files: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="POSES.csv|RESULT",
            help="Poses, a plan or measurements; the folder of a calibration.",
        ),
    ] = None
    workspace: Annotated[
        Path | None,
        typer.Option(
            "--workspace", metavar="CSV", help="Cloud of positions, from 'pincal workspace'."
        ),
    ] = None
    magnify: Annotated[
        float | None,
        typer.Option(help=f"Factor on a RESULT's differences from nominal [default: {MAGNIFY:g}]."),
    ] = None

    def of(self, mech: str) -> Seen:
        """Return what the files hold.

        Raises:
            BadParameter: more than one file of a kind; a factor without a result.
            PincalError: a file that cannot be read, or does not belong to the mechanism.
        """
        given, workspace, magnify = self.files or [], self.workspace, self.magnify
        folders = [path for path in given if is_folder(path)]
        tables = [path for path in given if not is_folder(path)]
        for several in (folders, tables):
            if len(several) > 1:
                raise typer.BadParameter(
                    f"{' and '.join(map(str, several))}: expected one POSES.csv and one RESULT at "
                    "most"
                )
        if magnify is not None and not folders:
            raise typer.BadParameter("--magnify is for the errors of a RESULT, and none is given")
        mechanism = load_mechanism(mech)
        identified = _identified(folders[0]) if folders else None
        return Seen(
            mechanism,
            _plan(tables, folders, mechanism),
            None if workspace is None else _positions(workspace, mechanism),
            identified,
            MAGNIFY if magnify is None else magnify,
            ", ".join(path.name for path in (*tables, *folders)),
            *(_result(folders[0]) if folders else ((), None)),
        )


@dataclass(frozen=True)
class Seen:
    """What is to be shown, as read from files."""

    mechanism: Mechanism
    plan: Plan | None
    workspace: Array | None
    identified: Mechanism | None
    magnify: float
    source: str
    """Names of the files."""
    notices: tuple[str, ...] = ()
    """Warnings of the RESULT."""
    result: CalibrationResult | None = None


def _plan(tables: list[Path], folders: list[Path], mechanism: Mechanism) -> Plan | None:
    """Return the poses of a table; where it lacks some, those that the result estimated.

    Raises:
        MeasurementError: no row holds a whole pose, and there is no result with estimates of it.
    """
    estimates = [folder / "poses.csv" for folder in folders if (folder / "poses.csv").is_file()]
    if not tables:
        return read_poses(estimates[0], mechanism) if estimates else None
    (table,) = tables
    plan = _rows(table, mechanism)
    if mechanism.by_readings and plan.readings is not None:
        # they say where the mechanism is, in its own base frame
        solution = forward(mechanism, plan.readings)
        if not solution.converged.any():
            raise MeasurementError(
                f"{table}: {solution.reasons[0]} at {plan.place(0)}, and at all others"
            )
        rows = np.flatnonzero(solution.converged)
        sets = None if plan.sets is None else tuple(plan.sets[row] for row in rows)
        return Plan(solution.poses[rows], sets, plan.readings[rows])
    whole = np.isfinite(plan.poses).all(axis=1).astype(bool)
    if whole.all():
        return plan
    if estimates:
        poses = read_poses(estimates[0], mechanism).poses
        if len(poses) != len(whole):
            raise MeasurementError(
                f"{table} has {len(whole)} rows, {estimates[0]} has {len(poses)}; expected the "
                "measurements of this calibration"
            )
        remark(f"poses as estimated by the calibration: {estimates[0]}")
        return Plan(poses, plan.sets, plan.readings)
    advice = (
        "What was not measured, 'pincal calibrate -o RESULT' estimates for all rows; "
        "RESULT beside the measurements, or RESULT/poses.csv, shows it"
    )
    if not whole.any():
        try:
            read_poses(table, mechanism)
        except MeasurementError as error:
            raise MeasurementError(f"{error}. {advice}") from error
    warn(
        f"{table}: {len(whole) - whole.sum()} of {len(whole)} rows hold no whole pose, the first "
        f"is in {plan.place(int(np.argmin(whole)))}; only the others are drawn. {advice}"
    )
    sets = None if plan.sets is None else tuple(np.array(plan.sets)[whole].tolist())
    return Plan(plan.poses[whole], sets, None if plan.readings is None else plan.readings[whole])


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


def _result(folder: Path) -> tuple[tuple[str, ...], CalibrationResult]:
    """Return a result's warnings, and itself."""
    result = load_result(folder)
    return tuple(warnings(result)), result


def _positions(path: Path, mechanism: Mechanism) -> Array:
    """Return the positions in a CSV of 'pincal workspace', shape (M, 2) or (M, 3), [m]."""
    table = read_table(path)
    names = mechanism.platform.coordinates[: mechanism.platform.units.count("m")]
    return np.column_stack([table.numbers(name, "m") for name in names])


@dataclass(frozen=True)
class PageOptions:
    """What the page holds, and where it goes."""

    html: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write one file that opens anywhere, offline."),
    ] = None
    meshes: Annotated[
        Path | None,
        typer.Option(metavar="URDF", help="Your URDF: an arm's links as its meshes show them."),
    ] = None
    report: Annotated[
        bool,
        typer.Option("--report", help="RESULT's report beside it, linked; needs --html."),
    ] = False
    no_open: Annotated[
        bool, typer.Option("--no-open", help="Print the address, open no browser.")
    ] = False


@command()
def view(
    mech: Mech,
    how: SeenOptions,
    page: PageOptions,
    force: Force = False,
) -> None:
    """Look at a mechanism in the browser.

    The slider and the arrow keys go from pose to pose, the space bar plays. Without POSES.csv:
    home and some of the workspace, or the poses that RESULT estimated. With RESULT the
    calibrated machine is shown too, where it goes when the nominal model drives it, its errors
    magnified; arrows go from measured to predicted points, the workspace is coloured by error, and
    a slider moves the machine along the direction that the measurements determine least. The page
    is served to this machine alone, until Ctrl-C.
    """
    html = page.html
    if html is not None and html.suffix.lower() not in (".html", ".htm"):
        raise FileError(f"{html} would be a page; give it the ending .html")
    if page.report:
        _linked(how, html, force=force)
        return
    what = how.of(mech)
    if html is not None:
        refuse_existing(html, force=force)
    with working("placing the legs"):
        shown = viewed(
            what.mechanism,
            what.plan,
            workspace=what.workspace,
            identified=what.identified,
            magnify=what.magnify,
            source=what.source,
        )
        shown = shown.with_notices(what.notices)
        if what.result is not None:
            shown = shown.with_result(what.result)
        if page.meshes is not None:
            shown = shown.with_meshes(page.meshes)
        shown.html()
    _say_unreached(shown.scene)
    if html is not None:
        shown.save(html, force=force)
        wrote(html)
    else:
        _serve(shown, page.no_open)


def _linked(how: SeenOptions, html: Path | None, *, force: bool) -> None:
    """Write a result's report and view as one page.

    Raises:
        BadParameter: no RESULT alone, or no file to write.
    """
    from pincal.show.report import LinkedPage, report

    given = how.files or []
    if html is None or len(given) != 1 or not is_folder(given[0]):
        raise typer.BadParameter("--report needs RESULT alone, and --html FILE to write")
    with working("drawing"):
        page = LinkedPage(report(load_result(given[0])), how.magnify or MAGNIFY)
        page.html()
    page.save(html, force=force)
    wrote(html)


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


@command()
def picture(
    mech: Mech,
    output: Annotated[Path, output_option("FILE.svg|png|pdf", "The picture.")],
    how: SeenOptions,
    pose: Annotated[
        int, typer.Option(min=1, metavar="N", help="Which of the poses is drawn in full.")
    ] = 1,
    dimensions: Annotated[
        list[str] | None,
        typer.Option(
            metavar="LEG", help="Draw the parameters of a leg as lengths and angles; repeatable."
        ),
    ] = None,
    force: Force = False,
) -> None:
    """Draw a mechanism into a file, as 'pincal view' shows it.

    At home, or with POSES.csv at one of its poses, all of them as faint lines in the colours of
    their sets. With RESULT the calibrated machine is drawn too, its errors magnified. The same
    picture gives the same bytes.
    """
    from pincal.show.pictures.files import picture_path
    from pincal.show.pictures.picture import picture as drawn

    what = how.of(mech)
    refuse_existing(picture_path(output), force=force)
    with working("drawing"):
        found = drawn(
            what.mechanism,
            what.plan,
            row=pose - 1,
            workspace=what.workspace,
            identified=what.identified,
            magnify=what.magnify,
            dimensions=dimensions or (),
        )
        if what.result is not None:
            found = found.with_result(what.result)
        found.save(output, force=force)
    _say_unreached(found.scene)
    wrote(output)


def _say_unreached(scene: Scene) -> None:
    """Say at how many poses something is not drawn."""
    said = [unreached(None, scene.body.problems)]
    if scene.identified:
        said.append(unreached(scene.identified.magnify, scene.identified.body.problems))
    for text in filter(None, said):
        stderr.print(text, markup=False)
