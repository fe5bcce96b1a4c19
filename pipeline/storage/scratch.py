"""Temporary files of a command and its workers: one locked folder, which the next command removes after a kill."""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing.util import Finalize
from pathlib import Path

from ...schemas.errors import DiskFullError
from .files import NO_SPACE

_PREFIX = f"fidpipe-{os.getuid()}-"
#: Characters; the sockets of worker processes are in the folder, and may have 107.
_LONGEST_PARENT = 50
#: Lower than that of the folder of `multiprocessing` in it.
_EXIT_PRIORITY = -101


@contextmanager
def scratch_folder() -> Iterator[None]:
    """Context in which this process and those that it starts have a temporary folder of their own.

    It is removed when the process ends, after `multiprocessing` has cleaned up in it; not used
    where it cannot be made.
    """
    lock = None
    with suppress(OSError):
        parent = Path(tempfile.gettempdir())
        _remove_leftovers(parent)
        if len(str(parent)) <= _LONGEST_PARENT:
            new = Path(tempfile.mkdtemp(prefix=f".{_PREFIX}", dir=parent))
            lock = _lock(new)  # before it has the name by which others look for it
            folder = new.rename(parent / new.name.removeprefix("."))
    if lock is None:
        yield
        return
    Finalize(
        None, shutil.rmtree, (folder,), {"ignore_errors": True}, exitpriority=_EXIT_PRIORITY
    )
    before = os.environ.get("TMPDIR")
    os.environ["TMPDIR"] = tempfile.tempdir = str(folder)
    try:
        yield
    finally:
        tempfile.tempdir = None
        if before is None:
            del os.environ["TMPDIR"]
        else:
            os.environ["TMPDIR"] = before
        with suppress(OSError):  # it is not empty until worker processes have ended
            folder.rmdir()
            os.close(lock)


def _remove_leftovers(parent: Path) -> None:
    """Remove the folders of this user's commands that were killed."""
    for folder in parent.glob(f"{_PREFIX}*"):
        lock = _lock(folder)
        if lock is not None:
            shutil.rmtree(folder, ignore_errors=True)
            os.close(lock)


def _lock(folder: Path) -> int | None:
    """Lock a folder until the returned file is closed, or this process ends; None if another one has locked it."""
    file = None
    with suppress(OSError):
        file = os.open(folder, os.O_RDONLY | os.O_NOFOLLOW)
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return file
    if file is not None:
        os.close(file)
    return None


@contextmanager
def temporary_space() -> Iterator[None]:
    """Context of what is written into the folder for temporary files, also by readers with errors of their own.

    Raises
    ------
    DiskFullError
        It has no space left.
    """
    try:
        yield
    except DiskFullError:
        raise
    except Exception as error:
        cause: BaseException | None = error
        while cause is not None and not (
            isinstance(cause, OSError) and cause.errno in NO_SPACE
        ):
            cause = cause.__cause__ or cause.__context__
        if cause is None:
            raise
        raise DiskFullError(
            f"TMPDIR: no space left in {tempfile.gettempdir()}; make room, or set TMPDIR to another "
            "folder, then run the same command again"
        ) from error
