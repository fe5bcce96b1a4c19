"""Atomic file writes and content hashes."""

from __future__ import annotations

import csv
import errno
import fcntl
import hashlib
import io
import json
import os
import secrets
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from ...schemas.errors import DiskFullError, RunError

#: Of an OSError: the disk is full, or the user's share of it.
NO_SPACE = (errno.ENOSPC, errno.EDQUOT)

#: True if a path read from a file exists; False also for one that is too long or not a valid path.
path_exists = os.path.exists
_to_canonical_json = json.JSONEncoder(sort_keys=True, allow_nan=False).encode


def write_whole(
    path: Path, content: bytes | memoryview, *, outlasts_power: bool = True
) -> None:
    """Write a file atomically: next to its path under a dot name, then renamed.

    A device such as /dev/null is written to, and stays.

    Parameters
    ----------
    path : of the file; its folder is created if missing
    outlasts_power : wait until it is on the disk, a millisecond or more; False for a file whose
        readers check its hash

    Raises
    ------
    RunError
        It cannot be written there.
    """
    temporary = path.with_name(f".{path.name[:100]}.{secrets.token_hex(4)}")
    try:
        with named_errors(path):
            if path.is_char_device():
                path.write_bytes(content)
                return
            path.parent.mkdir(parents=True, exist_ok=True)
            with temporary.open("wb") as file:
                file.write(content)
                file.flush()
                if outlasts_power:
                    os.fsync(file.fileno())
            temporary.replace(path)
    except BaseException:
        with suppress(OSError):  # its folder may be what cannot be written
            temporary.unlink()
        raise


def csv_bytes(head: Iterable[object], rows: Iterable[Iterable[object]]) -> bytes:
    """A table as the content of a CSV file."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([head, *rows])
    return text.getvalue().encode()


@contextmanager
def named_errors(path: Path) -> Iterator[None]:
    """Makes errors of the system one `RunError` that names the file being written and ends with advice."""
    try:
        yield
    except OSError as error:
        if error.errno in NO_SPACE:
            raise DiskFullError(
                f"{path}: {error.strerror}; make room, then run the same command again"
            ) from error
        raise RunError(
            f"{path}: cannot be written ({error.strerror}); give another --out"
        ) from error


def is_locked(path: Path) -> bool:
    """True if a process holds the lock of a file; False if there is no file, or its file system has no locks."""
    try:
        with path.open() as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError as error:
        return isinstance(error, BlockingIOError)
    return False


def refuse_link(path: Path) -> None:
    """Raises `RunError` where a folder that is written into, and cleared, is a link to another."""
    if path.is_symlink():
        raise RunError(f"{path}: expected a folder, got a symbolic link; remove the link")


def key_of(*parts: Any) -> str:
    """A hash of plain values (numbers, strings, lists, dictionaries): equal if and only if they are."""
    return hashlib.sha256(_to_canonical_json(parts).encode()).hexdigest()


def file_marks(path: Path) -> str:
    """Length, times and inode of a file, as text: while they stay the same, so does the content."""
    status = path.stat()
    return f"{status.st_size} {status.st_mtime_ns} {status.st_ctime_ns} {status.st_ino}"


def hash_file(path: Path | str) -> str:
    """SHA-256 of a file's content, as hexadecimal digits; OSError where it cannot be read."""
    with Path(path).open("rb", buffering=0) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
