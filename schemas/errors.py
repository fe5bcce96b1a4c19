"""Errors for users. A message is one line: where, what is wrong, expected, got, next step."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

_MOST = 15


def suggestion(name: str, known: Iterable[str]) -> str:
    """End of a message about an unknown name: the known name that it resembles, else the nearest ones."""
    known = list(known)
    near = nearest(name, known)
    if near:
        return f"did you mean {near}?"
    return f"the nearest are {', '.join(get_close_matches(name.lower(), known, _MOST, 0.0))}"


def nearest(name: str, known: Iterable[str]) -> str | None:
    """The known name most similar to a name, upper or lower case; None if no name is similar."""
    by_lower = {other.lower(): other for other in known}
    near = get_close_matches(name.lower(), by_lower, 1)
    return by_lower[near[0]] if near else None


class FidpipeError(Exception):
    """Invalid input or setting. The command prints a one-line message and exits with 1."""

    def __str__(self) -> str:
        """Message in one line; line breaks in names become spaces."""
        return " ".join(super().__str__().splitlines())


class SettingsError(FidpipeError):
    """Unknown setting, or a value out of bounds."""


class DatasetError(FidpipeError):
    """Problem of the dataset as a whole: nothing can start."""


class ScanError(FidpipeError):
    """Problem of one scan file: its pair fails, the others run."""


class StoreError(FidpipeError):
    """Problem of a URL: it cannot be read or written."""


class StageError(FidpipeError):
    """Input that a stage cannot process: its pair fails, the others run."""


class RunError(FidpipeError):
    """Problem of the run folder, such as one that is in use or was not written by fidpipe."""


class DiskFullError(RunError):
    """No space left on the disk of the run: no pair can continue."""
