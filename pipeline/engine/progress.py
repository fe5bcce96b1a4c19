"""Progress on stderr: errors, counts and the time left; a live bar on a terminal, else a line every few seconds."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, TypeVar

from rich.console import Console

from ..terminal import Terminal, shown

if TYPE_CHECKING:
    from rich.progress import Progress

SECONDS_BETWEEN_LINES = 5.0
Item = TypeVar("Item")
_PACE_OVER_S = 600.0  # the time left follows the pace of this period


class Reporter:
    """Progress on stderr.

    Parameters
    ----------
    console : by default stderr
    seconds_between_lines : least time between two lines where stderr is not a terminal
    """

    def __init__(
        self,
        console: Console | None = None,
        *,
        seconds_between_lines: float = SECONDS_BETWEEN_LINES,
    ) -> None:
        self.console = console or Terminal(stderr=True, soft_wrap=True)
        self._between = seconds_between_lines
        self._bar: Progress | None = None
        self._n_pairs = self._n_ended = self._n_failed = 0
        self._objects = ""
        self._last_line = self.console.get_time()

    def say(self, text: str) -> None:
        """Print one line."""
        self.console.print(text, markup=False)

    def warn(self, *texts: str) -> None:
        """Print warnings, one line each, by one call of the console, because calls are slow."""
        if texts:
            self.console.print(
                "\n".join(f"warning: {shown(text)}" for text in texts),
                markup=False,
                style="yellow",
            )

    def fail(self, name: str, reason: str) -> None:
        """Print one line for each failure."""
        self.console.print(shown(f"{name}: {reason}"), markup=False, style="red")
        self._n_failed += 1

    def start(self, n_pairs: int, n_jobs: int) -> None:
        """Begin to show progress over the jobs of all pairs."""
        from rich.progress import (
            BarColumn,
            Progress,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )

        self._n_pairs = n_pairs
        self._n_ended = self._n_failed = 0
        self._last_line = self.console.get_time()
        self._bar = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=12),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=self.console,
            transient=True,
            speed_estimate_period=_PACE_OVER_S,
            disable=not self.console.is_terminal,
        )
        self._bar.add_task(self._counts(), total=n_jobs)
        self._bar.start()

    def advance(self, n_jobs: int, n_pairs: int = 0, objects: str = "") -> None:
        """Count jobs that are finished or will not be done, and pairs that have ended.

        Parameters
        ----------
        objects : text that follows the counts: how many objects of a large pair are done; "" for none
        """
        self._n_ended += n_pairs
        self._objects = objects
        if self._bar is None:
            return
        self._bar.update(self._bar.tasks[0].id, advance=n_jobs, description=self._counts())
        now = self.console.get_time()
        if self._bar.disable and now - self._last_line >= self._between:
            self._last_line = now
            task = self._bar.tasks[0]
            left_s = task.time_remaining
            left = "" if left_s is None else f"; about {_in_words(left_s)} left"
            self.say(f"{self._counts()}, {task.percentage:.0f} %{left}")

    def counted(self, items: Iterable[Item], n_items: int) -> Iterator[Item]:
        """The items, with progress: each counts as a pair when the next one is requested."""
        self.start(n_items, n_items)
        try:
            for item in items:
                yield item
                self.advance(1, 1)
        finally:
            self.stop()

    def stop(self) -> None:
        """End the progress."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def _counts(self) -> str:
        """Pairs that have ended and failed, and objects that are done."""
        return (
            f"{self._n_ended} of {self._n_pairs} pairs, {self._n_failed} failed{self._objects}"
        )


def _in_words(seconds: float) -> str:
    """A duration in seconds, or from 90 s on in minutes."""
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"
