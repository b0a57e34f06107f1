"""``pincal view``, ``picture`` and ``plot``: mechanisms, poses and results, as pictures."""

import sys
import webbrowser
from collections.abc import Callable
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from threading import Event
from typing import Annotated, Any

import typer
from matplotlib.figure import Figure

import pincal
from pincal import CalibrationResult, FileError, MeasurementError, Mechanism, MechanismError, Plan
from pincal.cli.app import command, say, stderr, working, wrote
from pincal.cli.options import Force, Mech, output_option
from pincal.files.measurements import read_measurements, read_poses
from pincal.files.mechanism_folders import is_folder
from pincal.files.output import refuse_existing
from pincal.files.table import read_table
from pincal.show.charts import Plots
from pincal.show.style import PAGE_WIDTH, drawing, picture_path, save_figure
from pincal.show.view.scene import Scene

Shown = Annotated[
    Path | None,
    typer.Argument(
        metavar="POSES.csv|RESULT",
        help="Poses, a plan or measurements; or the folder of a calibration.",
    ),
]


def _read(mech: str, shown: Path | None) -> tuple[dict[str, Any], CalibrationResult | None]:
    """Return the arguments of ``pincal.view`` for the shown files, and the result if it is one."""
    mechanism = pincal.load_mechanism(mech)
    if shown is None and (Path(mech) / "result.json").is_file():
        shown = Path(mech)
    if shown is None or not is_folder(shown):
        poses = {} if shown is None else {"poses": _plan(shown, mechanism)}
        return {"mechanism": mechanism, **poses}, None
    if not (shown / "result.json").is_file():
        raise FileError(f"{shown} is no result of 'pincal calibrate': it has no result.json")
    result = pincal.load_result(shown)
    if not result.converged:
        raise MeasurementError(
            f"{shown}: the fit did not converge, so there is no calibrated mechanism to show"
        )
    mechanism = result.nominal if shown == Path(mech) else mechanism  # MECH is the result itself
    if result.nominal.leg_names != mechanism.leg_names:
        raise MechanismError(f"{shown} is of {result.nominal.name!r}, which has other legs")
    plan = replace(result.measurements, poses=result.poses)
    return {"mechanism": mechanism, "identified": result.identified, "poses": plan}, result


def _plan(table: Path, mechanism: Mechanism) -> Plan:
    """Return the poses of a table; those of arms follow from its readings, if it has any.

    Raises:
        MeasurementError: no readings belong to a pose.
    """
    has_readings = set(mechanism.reading_names) <= set(read_table(table).units)
    measured = has_readings and not mechanism.by_readings
    read: Callable[..., Plan] = read_measurements if measured else read_poses
    plan = read(table, mechanism, partial=True)
    if not mechanism.by_readings or plan.readings is None:
        return plan
    held = mechanism.constraints >= mechanism.platform.dof
    solution = pincal.forward(mechanism, plan.readings, None if held else plan.poses)
    if not solution.converged.any():
        raise MeasurementError(
            f"{table}: {solution.reasons[0]} at {plan.place(0)}, and at all others"
        )
    return replace(plan, poses=solution.poses).rows(solution.converged)


_PAGES = (".html", ".htm")


@command
def view(
    mech: Mech,
    shown: Shown = None,
    output: Annotated[
        Path | None,
        output_option("FILE", "Page (.html) that opens anywhere; picture (.svg, .png, .pdf)."),
    ] = None,
    meshes: Annotated[
        Path | None,
        typer.Option(metavar="URDF", help="URDF whose meshes are drawn as the arm's links."),
    ] = None,
    no_open: Annotated[
        bool, typer.Option("--no-open", help="Print the address without opening a browser.")
    ] = False,
    force: Force = False,
) -> None:
    """Show a mechanism in the browser, or draw it into a file.

    The slider and the arrow keys step through the poses. Without POSES.csv these are home and
    samples of the workspace. With RESULT (alone, too) they are the measured poses, and the
    calibrated machine is shown as the nominal model drives it, with magnified errors; arrows lead
    from measured to predicted points. The page is served to this machine alone, until Ctrl-C.

    A picture shows the mechanism at home, or at the first pose of POSES.csv, and all poses as dots
    in the colours of their sets. The same picture gives the same bytes.
    """
    suffix = ".html" if output is None else output.suffix.lower()
    if suffix not in (*_PAGES, ".svg", ".png", ".pdf"):
        raise FileError(f"{output}: give it the ending .html, .svg, .png or .pdf")
    arguments, result = _read(mech, shown)
    if output is not None:
        refuse_existing(output, force=force)
    if output is not None and suffix not in _PAGES:
        with working("drawing"):
            image = pincal.picture(**arguments)
            image.save(output, force=force)
        _say_unreached(image.scene)
        wrote(output)
        return
    with working("placing the legs"):
        page = pincal.view(**arguments)
        if result is not None:
            page = page.with_result(result)
        if meshes is not None:
            page = page.with_meshes(meshes)
        page.html()
    _say_unreached(page.scene)
    if output is not None:
        page.save(output, force=force)
        wrote(output)
        return
    try:
        say(page.url)
        sys.stdout.flush()
        if not no_open and not webbrowser.open(page.url):
            stderr.print("no browser was found: open the address above in one")
        stderr.print("Ctrl-C ends")
        Event().wait()
    except KeyboardInterrupt:
        page.close()


def _say_unreached(scene: Scene) -> None:
    """Print at how many poses something is not drawn."""
    machines = {"mechanism": scene.body}
    if scene.magnified:
        machines[f"identified machine (errors × {scene.magnify:g})"] = scene.magnified
    for name, body in machines.items():
        if problems := list(filter(None, body.problems)):
            text = f"the {name} is not fully drawn at {len(problems)} of {len(body.problems)}"
            stderr.print(f"{text} poses; the first: {problems[0]}")


#: Names of charts of ``result.plot``.
Kind = StrEnum("Kind", [name for name in vars(Plots) if name[0] != "_"])  # type: ignore[misc]


@command
def plot(
    result: Annotated[
        Path, typer.Argument(metavar="RESULT", help="Folder of 'pincal calibrate -o RESULT'.")
    ],
    kind: Annotated[Kind, typer.Argument(metavar="KIND", help=f"One of {', '.join(Kind)}.")],
    output: Annotated[Path, output_option("FILE.svg|pdf|png", "The figure.")],
    force: Force = False,
) -> None:
    """Draw a figure of a calibration.

    It is 170 mm wide, with letters of 7 to 9 points. KIND is residuals (by row) or images
    (residuals in camera images).
    """
    calibrated = pincal.load_result(result)
    refuse_existing(picture_path(output), force=force)
    with working("drawing"), drawing():
        figure = Figure((PAGE_WIDTH / 25.4, 4.15), layout="compressed")
        getattr(calibrated.plot, kind)(figure.subplots())
        save_figure(figure, output, force=force, whole=True)
    wrote(output)
