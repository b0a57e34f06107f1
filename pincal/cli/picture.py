"""``pincal picture``: a mechanism and its poses as a picture."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pincal.cli.app import Force, Mech, command, output_option, working, wrote
from pincal.cli.seen import Cloud, Files, Magnify, seen, tell_unreached
from pincal.files.output import refuse_existing


@command()
def picture(
    mech: Mech,
    output: Annotated[Path, output_option("FILE.svg|png|pdf", "The picture.")],
    files: Files = None,
    pose: Annotated[
        int, typer.Option(min=1, metavar="N", help="Which of the poses is drawn in full.")
    ] = 1,
    workspace: Cloud = None,
    magnify: Magnify = None,
    force: Force = False,
) -> None:
    """Draw a mechanism into a file, as 'pincal view' shows it.

    At home, or with POSES.csv at one of its poses, all of them as faint lines in the colours of
    their sets. With RESULT the calibrated machine is drawn too, its errors magnified. The same
    picture gives the same bytes.
    """
    from pincal.show.pictures.files import picture_path
    from pincal.show.pictures.picture import picture as drawn

    refuse_existing(picture_path(output), force=force)
    what = seen(mech, files, workspace, magnify)
    with working("drawing"):
        found = drawn(
            what.mechanism,
            what.plan,
            row=pose - 1,
            workspace=what.workspace,
            identified=what.identified,
            magnify=what.magnify,
        )
        found.save(output, force=force)
    tell_unreached(found.scene)
    wrote(output)
