"""Files and folders are written whole or not at all, and never over what is not pincal's.

What is written goes to a temporary path beside its place and is moved there at the end.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from pincal.errors import FileError
from pincal.model.checks import must_be

#: A folder that holds one of these was written by pincal and may be replaced.
MARKERS = ("mechanism.yaml", "result.json", "study.md")


def refuse_existing(path: str | Path, *, force: bool, folder: bool = False) -> Path:
    """Return the path if a file, or a folder, may be written there.

    Raises:
        FileError: it exists and ``force`` is not set; a folder is in a file's place, or
            something not written by pincal in a folder's; its parent does not exist.
    """
    path = Path(must_be(path, (str, Path), "where to write", FileError))
    if path == Path("-"):
        raise FileError("cannot write to standard output ('-'); name a file")
    try:
        exists, is_folder = path.exists(), path.is_dir()
        special = exists and not (is_folder or path.is_file())  # a device or a pipe
        parent = path.absolute().parent
        has_parent = parent.is_dir()
    except (OSError, ValueError) as error:
        raise FileError(f"cannot write {str(path)[:200]!r}: {error}") from error
    if special:
        raise FileError(f"{path} is a device or a pipe; name a file to write")
    if exists and is_folder and not folder:
        raise FileError(f"{path} is a folder; name a file to write")
    if exists and folder and not (is_folder and any((path / m).is_file() for m in MARKERS)):
        raise FileError(
            f"{path} exists and is not a folder that pincal wrote, so it is not replaced; choose "
            "another name"
        )
    if exists and not force:
        raise FileError(f"{path} exists; choose another name, or say --force to replace it")
    if not has_parent:
        raise FileError(f"cannot write {path}: the folder {parent} does not exist")
    return path


@contextmanager
def writing(path: str | Path, *, force: bool = False, folder: bool = False) -> Iterator[Path]:
    """Yield a temporary path beside ``path``; what is there at the end takes its place.

    With ``folder`` the temporary path is an empty folder, else it does not exist yet. On an
    error it is removed and ``path`` stays as it was.

    Raises:
        FileError: ``path`` must not be replaced (see ``refuse_existing``), or writing fails.
    """
    path = refuse_existing(path, force=force, folder=folder).absolute()
    try:
        scratch = Path(tempfile.mkdtemp(prefix=".pincal-", dir=path.parent))
    except OSError as error:
        raise FileError(f"cannot write {path}: {error.strerror or error}") from error
    made, replaced = scratch / "new", scratch / "old"
    try:
        if folder:
            made.mkdir()
        yield made
        refuse_existing(path, force=force, folder=folder)  # somebody else may have been quicker
        if path.is_dir():
            path.replace(replaced)
        try:
            made.replace(path)
        except OSError:
            if replaced.exists():
                replaced.replace(path)
            raise
    except FileError:
        raise
    except OSError as error:
        raise FileError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        with suppress(OSError):
            shutil.rmtree(scratch)
