"""The errors that users meet. Each is one line: the thing, the value found, the value wanted, the next step."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


def suggestion(name: str, known: Iterable[str]) -> str:
    """The end of a message about an unknown name: the known one that is nearest, or all of them."""
    known = list(known)
    near = get_close_matches(name.lower(), known, 1)
    return f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}"


class FidpipeError(Exception):
    """A fault of the input or of a setting; the command prints its one line and exits with 1."""

    def __str__(self) -> str:
        """The message in one line, whatever the names in it are made of."""
        return " ".join(super().__str__().splitlines())


class SettingsError(FidpipeError):
    """A setting that does not exist or whose value is out of bounds."""


class DatasetError(FidpipeError):
    """A fault of the dataset as a whole: nothing can start."""


class ScanError(FidpipeError):
    """A fault of one scan file: its pair fails, the others run."""


class StageError(FidpipeError):
    """A stage that cannot go on with what it was given: its pair fails, the others run."""


class RunError(FidpipeError):
    """A fault of the run folder: it is in use, or it is not ours."""


class DiskFullError(RunError):
    """No space is left where a run writes: nothing can go on, of whichever pair."""
