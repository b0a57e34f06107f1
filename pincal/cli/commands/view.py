"""``pincal view`` and ``picture``: a mechanism, poses and a result, in the browser or in a file."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import Annotated

import typer

from pincal.calibration.result_files import load_result
from pincal.cli.app import (
    Force,
    Mech,
    command,
    output_option,
    stderr,
    stdout,
    working,
    wrote,
)
from pincal.cli.seen import SeenOptions
from pincal.errors import FileError
from pincal.files.mechanism_folders import is_folder
from pincal.files.output import refuse_existing
from pincal.show.view.scene import MAGNIFY, Scene
from pincal.show.view.view import View
from pincal.show.view.view import view as viewed
from pincal.words.views import unreached


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
    from pincal.show.report.linked import LinkedPage
    from pincal.show.report.report import report

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
