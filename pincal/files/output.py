"""Files and folders are written whole or not at all, and no existing file is lost.

Outputs that belong together are completed in temporary folders beside their places. Then existing
files become ``NAME.bak``, or ``NAME.bak2``, …, as no backup is ever replaced, and the new ones are
moved to their places. A kill at any moment leaves the old, the new, or the old as ``NAME.bak``. In
a folder only the files that pincal writes are replaced; all others stay.
"""

import logging
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from errno import EEXIST
from itertools import combinations, count
from pathlib import Path

from pincal.errors import FileError, PincalError, explaining
from pincal.files.text import is_input
from pincal.model.checks import must_be

_log = logging.getLogger(__name__)
#: Suffixes of tables that are neither read nor written, and the kind to use for them.
OTHER_TABLES = {".xls": ".xlsx", ".ods": ".xlsx", ".parquet": "CSV"}


def refuse_existing(path: str | Path, *, force: bool, folder: Sequence[str] = ()) -> Path:
    """Return the path, links followed, if a file or a folder may be written there.

    For a folder, ``folder`` has patterns of the files that pincal writes in it, first of the file
    that identifies it. ``force`` allows to replace existing files, but neither inputs of the
    command, nor a folder by a file, nor a folder that pincal did not write.
    """
    path = Path(must_be(path, (str, Path), "where to write", FileError))
    if path == Path("-"):
        raise FileError("cannot write to standard output ('-'); name a file")
    with explaining(f"cannot write {str(path)!r}", ValueError, RuntimeError):
        real = Path(os.path.realpath(path))
        exists, is_folder, is_link = real.exists(), real.is_dir(), real.is_symlink()
        special = exists and not (is_folder or real.is_file())  # a device or a pipe
        has_parent, known = real.parent.is_dir(), bool(folder) and (real / folder[0]).is_file()
        inside = is_folder and Path.cwd().is_relative_to(real)
        read = _inputs_in(_made_in(real, folder) if known else [] if is_folder else [real])
    known_by, suffix = folder[0] if folder else "", path.suffix.lower()
    refusals = {
        f"{path}: {suffix} files are not written; name a {OTHER_TABLES.get(suffix)} file": suffix
        in OTHER_TABLES,
        f"{path} is a link that leads to itself; remove it, or name a file": is_link,
        f"{path} is a device or a pipe; name a file to write": special,
        f"{path} is a folder; name a file to write": is_folder and not folder,
        f"{path} exists and is not a folder that pincal wrote with a {known_by} in it, so it is "
        "not replaced; choose another name": exists and folder and not known,
        f"{path} would replace {', '.join(map(str, read[:1]))}, which this command reads; choose "
        "another name": read,
        f"{path} exists; choose another name, or say --force (force=True) to replace it": exists
        and not force,
        f"{path} holds the current folder, so it is not replaced; leave it first": inside,
        f"cannot write {path}: the folder {real.parent} does not exist": not has_parent,
    }
    for message, refused in refusals.items():
        if refused:
            raise FileError(message)
    return real


def refuse_existing_of(
    outputs: Sequence[tuple[str | Path, Sequence[str]]], *, force: bool
) -> list[Path]:
    """Return the real paths of outputs, each a path and its ``folder``, if all may be written."""
    targets = [refuse_existing(path, force=force, folder=folder) for path, folder in outputs]
    for first, second in combinations(targets, 2):
        if first.is_relative_to(second) or second.is_relative_to(first):
            raise FileError(
                f"this command writes both {first} and {second}, which need places of their own; "
                "choose another name for one of them"
            )
    return targets


@contextmanager
def writing(path: str | Path, *, force: bool = False, folder: Sequence[str] = ()) -> Iterator[Path]:
    """Yield a temporary path beside ``path``, that of an empty folder if ``folder`` is given.

    At the end it is moved to ``path``; on an error ``path`` stays as it was. For the arguments see
    ``refuse_existing``.
    """
    with writing_together([(path, folder)], force=force) as (made,):
        yield made


@contextmanager
def writing_together(
    outputs: Sequence[tuple[str | Path, Sequence[str]]], *, force: bool = False
) -> Iterator[list[Path]]:
    """Yield temporary paths for outputs that belong together: all take their places, or none.

    Each output is a path with the ``folder`` of ``refuse_existing``, empty for a file. The first
    output is moved last: if it exists, the others do.
    """
    names = ", ".join(str(path) for path, _ in outputs)
    shown: dict[str, str] = {}  # names of temporary paths in messages
    try:
        with explaining(f"cannot write {names}"), ExitStack() as scratch:
            targets = refuse_existing_of(outputs, force=force)
            made = []
            for target, (named, folder) in zip(targets, outputs, strict=True):
                place = Path(tempfile.mkdtemp(prefix=".pincal-", dir=target.parent))
                scratch.callback(shutil.rmtree, place, ignore_errors=True)
                made.append(place / target.name)
                shown[str(made[-1])] = str(named)
                if folder:
                    made[-1].mkdir()
            yield made
            refuse_existing_of(outputs, force=force)  # another process may have written meanwhile
            for new, target, (_, folder) in zip(made, targets, outputs, strict=True):
                if target.exists():
                    if folder:
                        _carry(target, new, folder)
                    shutil.copymode(target, new)
            _move_all(list(zip(made, targets, strict=True)))
    except PincalError as error:
        for temporary, named in shown.items():
            error.args = tuple(str(part).replace(temporary, named) for part in error.args)
        raise


def _made_in(place: Path, folder: Sequence[str]) -> list[Path]:
    return [path for pattern in folder for path in place.glob(pattern)]


def _inputs_in(places: list[Path]) -> list[Path]:
    """Return the files at and below places that the running command has read."""
    below = (file for place in places for file in (place, *place.rglob("*")))
    return [file for file in below if file.is_file() and is_input(file)]


def _carry(old: Path, new: Path, folder: Sequence[str]) -> None:
    """Copy the files that pincal did not write from an old folder to a new one, links as links."""
    replaced = _made_in(old, folder)

    def not_carried(place: str, names: list[str]) -> list[str]:
        skipped = []
        for source in (Path(place, name) for name in names):
            target = new / source.relative_to(old)
            is_folder = source.is_dir() and not source.is_symlink()
            if is_folder and target.is_file():
                raise FileError(f"{source} is where a file is to be written; move it")
            if source in replaced or (os.path.lexists(target) and not is_folder):
                skipped.append(source.name)
        return skipped

    shutil.copytree(
        old, new, symlinks=True, ignore=not_carried, copy_function=_copy, dirs_exist_ok=True
    )
    os.utime(new)


def _copy(source: str, target: str) -> None:
    """Make a hard link to a file, or a copy where the file system has no links."""
    try:
        os.link(source, target, follow_symlinks=False)
    except OSError:
        shutil.copy2(source, target, follow_symlinks=False)


def _move_all(moves: Sequence[tuple[Path, Path]]) -> None:
    """Move outputs to their places, the first last; restore the old state on an error."""
    with ExitStack() as undo:
        for _, target in moves:
            if os.path.lexists(target):
                backup = _set_aside(target)
                undo.callback(_move, backup, target)
                _log.info("replaced %s; the old one is now %s", target.name, backup.name)
        for made, target in reversed(moves):
            _move(made, target)
            undo.callback(_move, target, made)
        undo.pop_all()


def _set_aside(path: Path) -> Path:
    """Move a file or folder to the first free name of NAME.bak, NAME.bak2, …, and return it."""
    for number in count(1):
        backup = path.with_name(f"{path.name}.bak{number if number > 1 else ''}")
        with suppress(FileExistsError):
            _move(path, backup)
            return backup
    raise AssertionError


def _move(source: Path, target: Path) -> None:
    """Move a file or folder; raise FileExistsError if the target exists, even since a moment."""
    if os.path.lexists(target):
        raise FileExistsError(EEXIST, os.strerror(EEXIST), str(target))
    if source.is_dir():
        source.rename(target)  # raises if a folder that is not empty appeared there meanwhile
        return
    try:
        os.link(source, target)
        source.unlink()
    except FileExistsError:
        raise
    except OSError:  # a file system without links
        source.rename(target)
