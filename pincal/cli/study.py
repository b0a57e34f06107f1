"""``pincal study``: the papers, computed anew."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from pincal.cli.app import Force, Seed, answer, command, output_option, remark, working, wrote
from pincal.files.output import refuse_existing


@command(answers=True)
def study(
    name: Annotated[str, typer.Argument(metavar="5R|3RRR|6UPS|all", help="Whose paper.")],
    output: Annotated[Path, output_option("FOLDER", "Page, tables and figures.")],
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer draws, coarser grids: seconds, not minutes.")
    ] = False,
    seed: Seed = 0,
    page: Annotated[
        Path | None,
        typer.Option(metavar="FILE.md", help="Write the text there too, with links to FOLDER."),
    ] = None,
    force: Force = False,
) -> None:
    """Compute a paper's figures and tables anew.

    And what it lacks. 5R: divide and conquer; 3RRR: symmetrical observability; 6UPS: symmetrical
    workspace, and beyond its paper the calibration. FOLDER gets study.md, tables as
    CSV and Markdown, figures as SVG and PNG; with 'all' one folder for each. The same seed
    gives the same text and tables; times are in figures only.
    """
    from pincal.studies.catalogue import STUDIES, named, run_study
    from pincal.studies.study import write_page

    names = list(STUDIES) if name == "all" else [named(name)]
    folders = [output / one for one in names] if name == "all" else [output]
    if name == "all" and not output.is_dir():
        refuse_existing(output, force=False).mkdir()
    for folder in folders:
        refuse_existing(folder, force=force, folder=True)
    if page is not None:
        refuse_existing(page, force=force)
    pages = {}
    told = []
    for one, folder in zip(names, folders, strict=True):
        with working(f"study of the {one}") as tell:
            found = run_study(one, seed, quick, tell)
        found.write(folder, force=force)
        wrote(folder)
        told.append(
            {
                "name": one,
                "title": found.title,
                "paper": found.paper,
                "folder": str(folder),
                "tables": found.tables,
            }
        )
        if page is not None:
            pages[Path(os.path.relpath(folder, page.parent)).as_posix()] = found
    if page is not None:
        write_page(page, pages, force=force)
        wrote(page)
    else:
        remark(f"read {folders[0] / 'study.md'}")
    answer({"studies": told})
