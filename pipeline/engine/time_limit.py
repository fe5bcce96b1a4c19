"""The time limit of a pair: a worker that works too long on one ends its own process, even inside a library.

Nothing else stops a thread that is inside a library: no exception, no signal, no message of the
scheduler. The timer of `faulthandler` needs no interpreter. The time of each batch of a pair is
written to small files in the run's folder: so every worker knows how much is left, and whether
another one ended because nothing was.
"""

from __future__ import annotations

import faulthandler
import secrets
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import monotonic

from ...schemas.errors import StageError

NOTES = ".time_limit"  #: folder in that of a run, while it works
_FINISHED = ".seconds"
_OVER = "Timeout ("  # as faulthandler writes it


@dataclass(frozen=True)
class TimeLimit:
    """Time that workers may spend on a pair.

    seconds : of all its batches together, also of those that run at the same time
    folder : of what is noted about the pair; every worker sees it
    """

    seconds: float
    folder: Path


class OutOfTimeError(StageError):
    """A pair has used up its time."""


@contextmanager
def limited(limit: TimeLimit | None) -> Iterator[Callable[[str], object]]:
    """Context in which this process works on one pair; it ends if the pair's time is over.

    The function notes the name of the work that begins, for the case that it does not end.

    Parameters
    ----------
    limit : of the pair; None for none

    Raises
    ------
    OutOfTimeError
        On entry, if nothing is left.
    """
    if limit is None:
        yield str
        return
    limit.folder.mkdir(parents=True, exist_ok=True)
    left = limit.seconds - _seconds_used(limit)
    if left <= 0:
        raise OutOfTimeError(_used_up(limit))
    path = limit.folder / secrets.token_hex(8)
    begun = monotonic()
    with path.open("w", buffering=1, encoding="utf-8") as note:
        faulthandler.dump_traceback_later(left, exit=True, file=note)
        try:
            yield lambda work: note.write(f"{work}\n")
        finally:
            faulthandler.cancel_dump_traceback_later()
            path.with_suffix(_FINISHED).write_text(str(monotonic() - begun), encoding="utf-8")
            path.unlink(missing_ok=True)


def _seconds_used(limit: TimeLimit) -> float:
    """Seconds of the pair's finished batches; `OutOfTimeError` where one ended because time was over."""
    used = 0.0
    for path in list(limit.folder.iterdir()):
        try:
            text = path.read_text(encoding="utf-8")
        except FileNotFoundError:  # another batch has just finished
            continue
        if path.suffix == _FINISHED:
            used += float(text or 0)
        elif _OVER in text:
            began = text[: text.index(_OVER)].splitlines()
            raise OutOfTimeError(_used_up(limit, began[-1] if began else ""))
    return used


def _used_up(limit: TimeLimit, stage: str = "") -> str:
    where = f" in {stage}" if stage else ""
    return f"not finished after {limit.seconds:g} s of work{where}; a larger --pair-timeout gives it more"
