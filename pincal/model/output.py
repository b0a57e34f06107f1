"""Files and folders are written whole or not at all, and never over what is there unasked."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from pincal.errors import FileError


def refuse_existing(path: str | Path, *, force: bool) -> Path:
    """Return the path if it may be written.

    Raises:
        FileError: it exists and ``force`` is not set, or its parent folder does not exist.
    """
    path = Path(path)
    if path.exists() and not force:
        raise FileError(f"{path} exists; choose another name, or say --force to replace it")
    if not path.absolute().parent.is_dir():
        raise FileError(f"cannot write {path}: the folder {path.absolute().parent} does not exist")
    return path


@contextmanager
def writing(path: str | Path, *, force: bool = False) -> Iterator[Path]:
    """Yield a temporary path beside ``path``; what is there at the end takes its place.

    The temporary path does not exist yet: write a file or make a folder there. On an
    error it is removed and ``path`` stays as it was.

    Raises:
        FileError: ``path`` exists and ``force`` is not set, or writing fails.
    """
    path = refuse_existing(path, force=force).absolute()
    try:
        scratch = Path(tempfile.mkdtemp(prefix=f".{path.name}-", dir=path.parent))
    except OSError as error:
        raise FileError(f"cannot write {path}: {error.strerror or error}") from error
    try:
        yield scratch / path.name
        if path.is_dir() and not path.is_symlink():
            path.replace(scratch / "replaced")
        (scratch / path.name).replace(path)
    except OSError as error:
        if isinstance(error, FileError):
            raise
        raise FileError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        with suppress(OSError):
            shutil.rmtree(scratch)
