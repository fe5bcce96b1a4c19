"""Temporary files of a command and its workers: one locked folder, which the next command removes after a kill."""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from multiprocessing.util import Finalize
from pathlib import Path

from ...schemas.errors import DiskFullError
from .files import NO_SPACE, free_text

_LAST = -200  # after multiprocessing has removed its own folder, at -100
_LONGEST_PARENT = 50  # characters; the sockets of worker processes are in the folder, and may have 107
_PREFIX = f"fidpipe-{os.getuid()}-"


@cache
def use_scratch_folder() -> None:
    """Give this process and those that it starts a temporary folder that ends with it."""
    parent = Path(tempfile.gettempdir())
    _remove_leftovers(parent)
    if len(str(parent)) > _LONGEST_PARENT:
        return
    with temporary_space():
        new = Path(tempfile.mkdtemp(prefix=f".{_PREFIX}"))
        _is_locked_now(new)  # before it has the name by which others look for it
        folder = new.rename(parent / new.name.removeprefix("."))
    Finalize(None, shutil.rmtree, (folder, True), exitpriority=_LAST)
    os.environ["TMPDIR"] = tempfile.tempdir = str(folder)


def _remove_leftovers(parent: Path) -> None:
    """Remove the folders of this user's commands that were killed."""
    for folder in parent.glob(f"{_PREFIX}*"):
        if folder.lstat().st_uid == os.getuid() and _is_locked_now(folder):
            shutil.rmtree(folder, ignore_errors=True)


def _is_locked_now(folder: Path) -> bool:
    """Lock a folder as long as this process lives; False if another one has locked it."""
    with suppress(OSError):
        fcntl.flock(os.open(folder, os.O_RDONLY | os.O_NOFOLLOW), fcntl.LOCK_EX | fcntl.LOCK_NB)
        return True
    return False


@contextmanager
def temporary_space() -> Iterator[None]:
    """Context of what is written into the folder for temporary files.

    Raises
    ------
    DiskFullError
        It has no space left.
    """
    try:
        yield
    except OSError as error:
        if error.errno not in NO_SPACE:
            raise
        folder = tempfile.gettempdir()
        raise DiskFullError(
            f"TMPDIR: no space left in {folder}, {free_text(Path(folder))}; make room, or set TMPDIR "
            "to another folder, then run the same command again"
        ) from error
