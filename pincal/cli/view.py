"""``pincal view``: a mechanism and its poses in the browser."""

from __future__ import annotations

import sys
from pathlib import Path
from threading import Event
from typing import Annotated

import typer

from pincal.cli.app import Force, Mech, app, stderr, stdout, working, wrote
from pincal.cli.seen import Cloud, Files, Magnify, seen, tell_unreached
from pincal.errors import FileError
from pincal.files.output import refuse_existing
from pincal.show.view.view import View
from pincal.show.view.view import view as viewed


@app.command()
def view(
    mech: Mech,
    files: Files = None,
    workspace: Cloud = None,
    magnify: Magnify = None,
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
    home and some of the workspace, or the poses that RESULT estimated. With RESULT the
    calibrated machine is shown too, where it goes when the nominal model drives it, its errors
    magnified. The page is served to this machine alone, until Ctrl-C.
    """
    if html is not None:
        if html.suffix.lower() not in (".html", ".htm"):
            raise FileError(f"{html} would be a page; give it the ending .html")
        refuse_existing(html, force=force)
    what = seen(mech, files, workspace, magnify)
    with working("placing the legs"):
        shown = viewed(
            what.mechanism,
            what.plan,
            workspace=what.workspace,
            identified=what.identified,
            magnify=what.magnify,
            source=what.source,
        )
        shown.html()
    tell_unreached(shown.scene)
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
