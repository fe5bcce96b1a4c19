"""Writing a file that people and programs read, whole or not at all, and removing one that is out of date."""

from __future__ import annotations

import os
import secrets
from pathlib import Path

from ...schemas.errors import RunError


def write_whole(path: Path, content: bytes) -> None:
    """Puts a file in place of another, if any: written beside it under a dot name, flushed, renamed.

    Folders that are not there are made. If it fails, the file that was there stays as it is.

    Raises
    ------
    RunError
        It cannot be written there.
    """
    temporary = path.with_name(f".{secrets.token_hex(8)}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        raise RunError(f"{path}: cannot be written ({error.strerror}); give another file") from error
    finally:
        temporary.unlink(missing_ok=True)


def remove_stale(path: Path) -> None:
    """Removes a file that is out of date, such as a page of an earlier report; one that is not there is no error.

    Raises
    ------
    RunError
        It cannot be removed.
    """
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise RunError(f"{path}: out of date, but cannot be removed ({error.strerror}); remove it") from error
