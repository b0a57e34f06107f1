"""``pincal study``: the papers, computed anew, where their studies are installed."""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from pincal.cli.app import Force, Seed, answer, command, output_option, remark, working, wrote
from pincal.errors import FileError
from pincal.files.output import refuse_existing, writing

STUDY = "study.md"
_BESIDE = Path(__file__).resolve().parents[3]


@command(answers=True)
def study(
    name: Annotated[str, typer.Argument(metavar="5R|3RRR|6UPS|errors|all", help="Which study.")],
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
    workspace and, after its paper, the calibration. errors: errors that are no geometry,
    simulated and, where PINCAL_DATA has them, of real arms. FOLDER gets study.md, tables as
    CSV and Markdown, figures as SVG and PNG; with 'all' one folder for each. The same seed
    gives the same text and tables; times are in figures only.
    """
    studies = _installed()
    names = studies.named(name)
    folders = [output / one for one in names] if name == "all" else [output]
    if name == "all" and not output.is_dir():
        refuse_existing(output, force=False).mkdir()
    for folder in folders:
        refuse_existing(folder, force=force, folder=(STUDY,))
    if page is not None:
        refuse_existing(page, force=force)
    pages, found = [], []
    for one, folder in zip(names, folders, strict=True):
        with working(f"study of the {one}") as progress:
            done = studies.run_study(one, seed, quick, progress)
        with writing(folder, force=force, folder=(STUDY,)) as scratch:
            done.write(scratch)
        wrote(folder)
        kept = {key: getattr(done, key) for key in ("name", "title", "paper", "tables")}
        found.append({**kept, "folder": str(folder)})
        if page is not None:
            pages.append(done.page(Path(os.path.relpath(folder, page.parent)).as_posix()))
    if page is not None:
        with writing(page, force=force) as scratch:
            scratch.write_text("\n".join(pages), encoding="utf-8")
        wrote(page)
    else:
        remark(f"read {folders[0] / 'study.md'}")
    answer({"studies": found})


def _installed() -> Any:
    """Return the catalogue of the studies, which stand beside pincal: installed or as sources.

    Raises:
        FileError: they are not there.
    """
    for name in ("pincal_studies", "studies"):
        if (_BESIDE / name / "catalogue.py").is_file():
            return import_module(f"{name}.catalogue")
    raise FileError(
        f"the papers' studies are not installed: no folder pincal_studies or studies in {_BESIDE}; "
        "install pincal from its wheel, or run this in its sources"
    )
