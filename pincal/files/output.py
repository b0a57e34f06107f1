"""Files and folders are written whole or not at all, and nothing that was there is lost.

What is written goes to a hidden folder beside its place and is moved there at the end. What it
replaces is kept as ``NAME.bak``, and only a backup that pincal wrote all of is replaced in turn. In
a folder only files that pincal writes are replaced; all others stay. A kill at any moment leaves
the old, the new, or the old as ``NAME.bak``.
"""

from __future__ import annotations

import filecmp
import logging
import os
import shutil
import stat
import tempfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from fcntl import LOCK_EX, LOCK_NB, flock
from itertools import count
from pathlib import Path

from pincal.errors import FileError
from pincal.model.checks import must_be

_PREFIX = ".pincal-"
_MILLISECOND = 10**6  # [ns]
_HELD = {"made", "kept", "gone"}  # in a hidden folder: never the only copy of anything
_log = logging.getLogger(__name__)


def refuse_existing(path: str | Path, *, force: bool, folder: str = "") -> Path:
    """Return the path, links followed, if a file or a folder may be written there.

    Args:
        path: Where to write.
        force: Whether what is there may be replaced.
        folder: Of a folder: the file by which one is known that pincal wrote.

    Raises:
        FileError: it exists and ``force`` is not set; a folder is in a file's place, or
            something not written by pincal in a folder's; links that lead nowhere; its parent
            does not exist.
    """
    path = Path(must_be(path, (str, Path), "where to write", FileError))
    if path == Path("-"):
        raise FileError("cannot write to standard output ('-'); name a file")
    try:
        real = Path(os.path.realpath(path))
        exists, is_folder, is_link = real.exists(), real.is_dir(), real.is_symlink()
        special = exists and not (is_folder or real.is_file())  # a device or a pipe
        has_parent = real.parent.is_dir()
        known = is_folder and bool(folder) and (real / folder).is_file()
        inside = is_folder and Path.cwd().is_relative_to(real)
    except (OSError, ValueError, RuntimeError) as error:
        raise FileError(f"cannot write {str(path)[:200]!r}: {error}") from error
    if is_link:
        raise FileError(f"{path} is a link that leads to itself; remove it, or name a file")
    if special:
        raise FileError(f"{path} is a device or a pipe; name a file to write")
    if is_folder and not folder:
        raise FileError(f"{path} is a folder; name a file to write")
    if exists and folder and not known:
        raise FileError(
            f"{path} exists and is not a folder that pincal wrote with a {folder} in it, so it is "
            "not replaced; choose another name"
        )
    if exists and not force:
        raise FileError(f"{path} exists; choose another name, or say --force to replace it")
    if inside:
        raise FileError(f"{path} holds the current folder, so it is not replaced; leave it first")
    if not has_parent:
        raise FileError(f"cannot write {path}: the folder {real.parent} does not exist")
    return real


@contextmanager
def writing(
    path: str | Path, *, force: bool = False, folder: str = "", own: Sequence[str] = ()
) -> Iterator[Path]:
    """Yield a temporary path beside ``path``; what is there at the end takes its place.

    On an error it is removed and ``path`` stays as it was.

    Args:
        path: Where to write; links are followed.
        force: Whether to replace what is there, which is kept as ``NAME.bak``.
        folder: Of a folder: the file by which one is known that pincal wrote. The temporary path
            is then an empty folder, else it does not exist yet.
        own: Files in a folder that is replaced, relative, that go with it; all others stay.

    Raises:
        FileError: ``path`` must not be replaced (see ``refuse_existing``), or writing fails.
    """
    named, path = path, refuse_existing(path, force=force, folder=folder)
    try:
        with _hidden(path.parent) as scratch:
            made = scratch / "made"
            if folder:
                made.mkdir()
            yield made
            refuse_existing(path, force=force, folder=folder)  # another may have been quicker
            for one in _below(made) if folder else [made]:
                _mark(one)
            if not os.path.lexists(path):
                _place(made, path)
            elif folder:
                _replace_folder(scratch, path, own)
            elif not filecmp.cmp(made, path, shallow=False):
                _replace_file(scratch, path)
    except FileError:
        raise
    except OSError as error:
        raise FileError(f"cannot write {named}: {error.strerror or error}") from error


def _place(made: Path, path: Path) -> None:
    """Move a file or a folder to where nothing is, not even since a moment."""
    if made.is_file():
        try:
            os.link(made, path)
        except FileExistsError:
            raise
        except OSError:  # a file system without links
            made.replace(path)
    else:
        made.replace(path)


def _replace_file(scratch: Path, path: Path) -> None:
    """Put a new file in an old one's place, which is kept; at any moment one of them is there."""
    backup, kept = _backup_of(path), scratch / "kept"
    _copy(path, kept)
    kept.replace(backup)
    shutil.copymode(path, scratch / "made")
    (scratch / "made").replace(path)
    _log.info("%s is replaced; what it was is kept as %s", path.name, backup.name)


def _replace_folder(scratch: Path, path: Path, own: Sequence[str]) -> None:
    """Put a new folder in an old one's place, which is kept; files of the user go along."""
    made, backup = scratch / "made", _backup_of(path)
    _carry(path, made, {path / name for name in own})
    shutil.copymode(path, made)
    if backup.exists():
        backup.replace(scratch / "gone")
    path.replace(backup)
    try:
        made.replace(path)
    except OSError:
        backup.replace(path)
        raise
    _log.info("%s is replaced; what it was is kept as %s", path.name, backup.name)


def _carry(old: Path, new: Path, own: set[Path]) -> None:
    """Give a new folder the files of an old one that are not pincal's.

    Raises:
        FileError: a folder is where a file is to be written.
    """
    for one in _below(old):
        there, is_folder = new / one.relative_to(old), stat.S_ISDIR(one.lstat().st_mode)
        if one in own or (os.path.lexists(there) and not is_folder):
            continue
        if any(part.is_file() for part in (there, *there.parents)):
            raise FileError(f"{one} is where a file is to be written; move it")
        if is_folder:
            there.mkdir(exist_ok=True)
            shutil.copystat(one, there)
        else:
            there.parent.mkdir(parents=True, exist_ok=True)
            _copy(one, there)


def _below(folder: Path) -> Iterator[Path]:
    """Yield what is in a folder and in folders below; links are not followed."""
    with os.scandir(folder) as entries:
        for entry in entries:
            yield Path(entry.path)
            if entry.is_dir(follow_symlinks=False):
                yield from _below(Path(entry.path))


def _copy(one: Path, there: Path) -> None:
    """Give a file a second name; a copy where the file system has none."""
    try:
        os.link(one, there, follow_symlinks=False)
    except FileExistsError:
        raise
    except OSError:
        shutil.copy2(one, there, follow_symlinks=False)


def _backup_of(path: Path) -> Path:
    """Return the first of NAME.bak, NAME.bak2, … that is free, or holds nothing of the user's."""
    for number in count(1):
        backup = path.with_name(f"{path.name}.bak{number if number > 1 else ''}")
        if not os.path.lexists(backup) or (
            backup.is_dir() == path.is_dir() and _replaceable(backup, path)
        ):
            return backup
    raise AssertionError


def _replaceable(backup: Path, path: Path) -> bool:
    """Return whether all of a backup was written by pincal, or is still in its place."""
    if not stat.S_ISDIR(backup.lstat().st_mode):
        return _marked(backup)
    return all(_marked(one) or _same(one, path / one.relative_to(backup)) for one in _below(backup))


def _same(one: Path, other: Path) -> bool:
    """Return whether two paths are folders, or the same file."""
    if stat.S_ISDIR(one.lstat().st_mode):
        return other.is_dir()
    return os.path.lexists(other) and os.path.samestat(one.lstat(), other.lstat())


def _mark(one: Path) -> None:
    """Mark a file as pincal's: less than a millisecond of its time says so, until it is changed."""
    status = one.lstat()
    changed = status.st_mtime_ns - status.st_mtime_ns % _MILLISECOND + _fraction(status)
    os.utime(one, ns=(status.st_atime_ns, changed), follow_symlinks=False)


def _marked(one: Path) -> bool:
    """Return whether a file is as pincal wrote it."""
    status = one.lstat()
    return status.st_mtime_ns % _MILLISECOND == _fraction(status)


def _fraction(status: os.stat_result) -> int:
    """Return a fraction of a millisecond, [ns], that a file has by chance once in a million."""
    return zlib.crc32(f"pincal {status.st_ino} {status.st_size}".encode()) % _MILLISECOND


@contextmanager
def _hidden(parent: Path) -> Iterator[Path]:
    """Yield a new hidden folder, locked and removed at the end; sweep those of killed processes."""
    for left in parent.glob(f"{_PREFIX}*"):
        with suppress(OSError), _locked(left) as free:
            if free and {one.name for one in left.iterdir()} <= _HELD:
                shutil.rmtree(left)
    with ExitStack() as lock:
        scratch, free = parent, False
        while not (free and scratch.is_dir()):  # another process may sweep it before it is locked
            scratch, free = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=parent)), True
            with suppress(OSError):  # a file system without locks: nothing is swept there
                free = lock.enter_context(_locked(scratch))
        try:
            yield scratch
        finally:
            shutil.rmtree(scratch, ignore_errors=True)


@contextmanager
def _locked(folder: Path) -> Iterator[bool]:
    """Lock a folder, at most until the process ends; yield whether it was free."""
    handle, free = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW), False
    try:
        with suppress(BlockingIOError):
            flock(handle, LOCK_EX | LOCK_NB)
            free = True
        yield free
    finally:
        os.close(handle)
